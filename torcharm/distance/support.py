"""Exact distance from points to sums of curves, by directions instead of vertices.

The distance from w to a convex set with support function h is `max_n n·w - h(n)` over unit vectors n; inside,
its negative is the least `h(n) - n·w`. At every n the support function of a sum of curves is a maximum for each
actuator alone, over pieces that are cubics: closed form. What remains is a search for one angle. It has
a bracket from both sides, the points a and b where the set is touched clockwise and counter-clockwise of the
nearest point: Newton's steps close in where the boundary is curved, and the normal of the chord ab is
the answer where it is flat.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torcharm._select import select
from torcharm.distance.closed_form import NearestFaces, start_normals
from torcharm.hulls import Sections
from torcharm.pieces import Pieces, fit_pieces, refit_pieces
from torcharm.polygon import Polygons, face_square

ROUNDS = 40
WIDEN = 8.0
"""Factor on the turn of a direction that has not yet found the other side."""
FIRST_TURN = 1e-3
STRAIGHT = 256.0
"""Roundings of the slope by which a curve may bend and count as straight: its peak would be anywhere."""
WINDOW, NARROW, LEAST, REFITS = 0.1, 0.2, 0.003, 8
"""A force that is no cubic is fitted again, about where it was touched, on this share of its piece; then on
shares smaller by this factor, down to this one; so many times at most."""


@dataclass(frozen=True)
class CurveSum:
    """Q sums of M actuators' reaction curves in the plane.

    Attributes:
        pieces: forces (…, M, Q).
        bending: (M, Q) bending moment at fraction 1 [N·m].
        radii: (M, Q) [m].
        scale: factors on force and moment.
    """

    pieces: Pieces
    bending: Tensor
    radii: Tensor
    scale: tuple[float, float]

    def of(self, index: Tensor) -> "CurveSum":
        """Those in `index`."""
        return replace(self, pieces=self.pieces.of(index), bending=self.bending[:, index], radii=self.radii[:, index])

    def touch(self, x: Tensor, y: Tensor) -> "Touch":
        """Where lines with normals (x, y), each (Q), touch the sets."""
        along_force = self.scale[0] * x - self.scale[1] * y * self.radii
        along_fraction = self.scale[1] * y * self.bending
        start, width, (c0, c1, c2, c3) = self.pieces.start, self.pieces.width, self.pieces.coefficients

        by_force, by_bending = along_force * c1, along_fraction * width
        least = STRAIGHT * torch.finfo(x.dtype).eps * (by_force.abs() + by_bending.abs())
        peak = _peak(by_force + by_bending, 2 * along_force * c2, 3 * along_force * c3, least)
        at_start = along_force * c0 + along_fraction * start
        at_peak = along_force * (((c3 * peak + c2) * peak + c1) * peak) + along_fraction * width * peak + at_start
        at_end = along_force * (c3 + c2 + c1) + along_fraction * width + at_start
        best = torch.cat((at_start, at_peak, at_end)).max(0).indices
        piece = (best % len(start)).unsqueeze(0)
        share = torch.stack((torch.zeros_like(peak), peak, torch.ones_like(peak))).flatten(0, 1).gather(0, best[None])

        begin, span, (c0, c1, c2, c3) = (
            start.gather(0, piece),
            width.gather(0, piece),
            self.pieces.coefficients.gather(1, piece.expand(4, -1, -1, -1)),
        )
        force = (((c3 * share + c2) * share + c1) * share + c0)[0]
        slope, curve = ((3 * c3 * share + 2 * c2) * share + c1)[0], (6 * c3 * share + 2 * c2)[0]
        fraction = (begin + span * share)[0]
        sideways = self.scale[1] * x * (self.bending * span[0] - self.radii * slope) - self.scale[0] * y * slope
        drop = -along_force * curve
        inner = (share[0] > 0) & (share[0] < 1) & (drop > 0)
        rough = self.pieces.rough.gather(0, piece)[0]
        radius = inner.to(drop.dtype) * sideways.square() / (drop + (~inner).to(drop.dtype))
        return Touch(
            self.scale[0] * force.sum(0),
            self.scale[1] * (self.bending * fraction - self.radii * force).sum(0),
            radius.sum(0),
            fraction,
            begin[0],
            span[0],
            rough,
        )


def _peak(slope: Tensor, bend: Tensor, twist: Tensor, least: Tensor) -> Tensor:
    """Where in [0, 1] a cubic with derivative `slope + bend t + twist t²` has its local maximum.

    Without one, and if it bends less than `least`, the end to which it rises.
    """
    discriminant = bend.square() - 4 * twist * slope
    root = 2 * slope / (discriminant.clamp(min=0).sqrt() - bend)
    curved = (discriminant >= 0) & ~root.isnan() & (bend.abs() + twist.abs() > least)
    return torch.where(curved, root, (slope > 0).to(slope.dtype)).clamp(0, 1)


@dataclass(frozen=True)
class Touch:
    """Where a set is touched.

    Attributes:
        x, y: (Q) the point.
        radius: (Q) the boundary's radius of curvature there; 0 at corners.
        fraction: (M, Q) the pressures that provide it, as fractions of the limits.
        begin, span: (M, Q) the pieces they lie in.
        rough: (M, Q) whether that piece is only near the force.
    """

    x: Tensor
    y: Tensor
    radius: Tensor
    fraction: Tensor
    begin: Tensor
    span: Tensor
    rough: Tensor


@dataclass(frozen=True)
class Ends:
    """The two ends of Q faces, clockwise first.

    Attributes:
        x, y: (2, Q).
        fraction, begin, span: (2, M, Q), as of `Touch`.
        rough: (2, M, Q).
    """

    x: Tensor
    y: Tensor
    fraction: Tensor
    begin: Tensor
    span: Tensor
    rough: Tensor

    def copy(self, index: Tensor, side: Tensor) -> None:
        """Put the other end, for the sums in `index`, in place of the end that `side` says."""
        for name in ("x", "y"):
            value = getattr(self, name)
            value[side, index] = value[1 - side, index]
        for name in ("fraction", "begin", "span", "rough"):
            value = getattr(self, name)
            value[side, :, index] = value[1 - side, :, index]

    def window(self, index: Tensor, share: Tensor) -> tuple[Tensor, Tensor]:
        """Starts and widths (2, M, q) of stretches about the ends in `index`, within their pieces.

        Where a piece is only near the force they are this share (q) of it; else all of it.
        """
        begin, span, fraction = self.begin[..., index], self.span[..., index], self.fraction[..., index]
        reach = select(self.rough[..., index], share * span, span)
        start = torch.maximum(begin, fraction - reach)
        return start, torch.minimum(begin + span, fraction + reach) - start

    def held(self, index: Tensor, start: Tensor, width: Tensor) -> Tensor:
        """Whether (2, M, q) ends lie at the edge of their window but not of their piece."""
        begin, span, fraction = self.begin[..., index], self.span[..., index], self.fraction[..., index]
        slack = 1e-6 * width
        low = (fraction <= start + slack) & (start > begin + 1e-9 * span)
        high = (fraction >= start + width - slack) & (start + width < begin + span * (1 - 1e-9))
        return (low | high) & (width > 0)

    def put(self, index: Tensor, side: Tensor, touch: Touch) -> None:
        """Replace, for the sums in `index`, the end that `side` (0 or 1) says."""
        for name in ("x", "y"):
            getattr(self, name)[side, index] = getattr(touch, name)
        for name in ("fraction", "begin", "span", "rough"):
            getattr(self, name)[side, :, index] = getattr(touch, name).T


@dataclass(frozen=True)
class NearestPoints:
    """Where Q points stand to their sets.

    Attributes:
        ends: of the nearest faces; the same point twice where the boundary is curved or a corner.
        normal: (2, Q) outward unit normals there.
        beyond: (Q) by how much the point lies beyond the line that touches the set with this
            normal: a bound from below on the distance, negative inside.
        inside: (Q) whether the point is strictly inside.
        converged: (Q).
    """

    ends: Ends
    normal: Tensor
    beyond: Tensor
    inside: Tensor
    converged: Tensor

    def put(self, index: Tensor, other: "NearestPoints") -> None:
        """Replace those in `index` by others, found on stretches of the same pieces."""
        for name in ("x", "y", "fraction", "rough"):
            getattr(self.ends, name)[..., index] = getattr(other.ends, name)
        for name in ("normal", "beyond", "inside", "converged"):
            getattr(self, name)[..., index] = getattr(other, name)


def nearest_points(
    sums: CurveSum, x: Tensor, y: Tensor, normal: tuple[Tensor, Tensor], tolerance: Tensor
) -> NearestPoints:
    """Search from directions (Q) near the nearest points' normals.

    Args:
        sums: Q sets.
        x, y: (Q) the points.
        normal: unit vectors to start from.
        tolerance: (Q) what counts as nothing, as a length.
    """
    count, actuators = len(x), len(sums.radii)
    blank = x.new_zeros(2, count)
    several = x.new_zeros(2, actuators, count)
    ends = Ends(
        blank, blank.clone(), several, several.clone(), several.clone(), torch.zeros_like(several, dtype=torch.bool)
    )
    n = torch.stack(normal)
    limits = torch.stack((n, n))  # directions at the clockwise and counter-clockwise ends
    known = torch.zeros(2, count, dtype=torch.bool, device=x.device)
    turn = torch.full_like(x, FIRST_TURN)
    last = torch.full_like(x, torch.inf)
    chord = torch.zeros_like(known[0])
    beyond = torch.full_like(x, -torch.inf)
    inside, done = torch.zeros_like(chord), torch.zeros_like(chord)
    index = torch.arange(count, device=x.device)

    own = sums
    for _ in range(ROUNDS):
        nx, ny = n[:, index]
        touch = own.touch(nx, ny)
        off_x, off_y = x[index] - touch.x, y[index] - touch.y
        over, aside = nx * off_x + ny * off_y, nx * off_y - ny * off_x
        slack = tolerance[index]

        # A chord that nothing overtakes is a face; if the point is past its end, the end takes its place.
        a, b = _corner(ends, 0, index), _corner(ends, 1, index)
        reach = nx * (touch.x - a[0]) + ny * (touch.y - a[1])
        face = chord[index] & (reach <= slack)
        foot = _share(x[index] - a[0], y[index] - a[1], b[0] - a[0], b[1] - a[1])
        finished = (face & (foot >= 0) & (foot <= 1)) | (~face & (aside.abs() <= slack))
        side = torch.where(face, foot < 0, aside <= 0).long()
        past = (face & ~finished).nonzero().squeeze(-1)
        ends.copy(index[past], side[past])
        fresh = (~face).nonzero().squeeze(-1)
        ends.put(index[fresh], side[fresh], _pick(touch, fresh))
        point = (finished & ~face).nonzero().squeeze(-1)
        ends.put(index[point], 1 - side[point], _pick(touch, point))
        moved = (~(face & finished)).nonzero().squeeze(-1)
        limits[side[moved], :, index[moved]] = n[:, index[moved]].T
        known[side[moved], index[moved]] = True
        beyond[index] = over
        inside[index] = finished & (over < 0)
        done[index] = finished

        # where to look next
        (ax, ay), (bx, by) = _corner(ends, 0, index), _corner(ends, 1, index)
        dx, dy = bx - ax, by - ay
        span = dx.square() + dy.square()
        share = _share(x[index] - ax, y[index] - ay, dx, dy)
        steep = over + touch.radius
        newton = steep > aside.abs()
        angle = turn[index] * aside.sign()
        ahead_x = torch.where(newton, steep * nx - aside * ny, nx - angle * ny)
        ahead_y = torch.where(newton, steep * ny + aside * nx, ny + angle * nx)
        pinched = known[:, index].all(0)
        (lo_x, lo_y), (hi_x, hi_y) = limits[0][:, index], limits[1][:, index]
        within = (lo_x * ahead_y - lo_y * ahead_x > 0) & (ahead_x * hi_y - ahead_y * hi_x > 0)
        closing = aside.abs() < 0.25 * last[index]
        across = pinched & ~(within & closing)
        outside = (over > 0) & (dy * (x[index] - ax) - dx * (y[index] - ay) >= 0)
        at_end = across & outside & ((share <= 0) | (share >= 1) | (span == 0))
        flat = across & ~at_end & (span > 0)
        end_x, end_y = torch.where(share <= 0, ax, bx), torch.where(share <= 0, ay, by)
        ahead_x = torch.where(flat, dy, torch.where(at_end, x[index] - end_x, ahead_x))
        ahead_y = torch.where(flat, -dx, torch.where(at_end, y[index] - end_y, ahead_y))
        ahead = torch.stack((ahead_x, ahead_y)) / torch.hypot(ahead_x, ahead_y)
        n[:, index] = torch.where(finished, n[:, index], ahead)
        chord[index] = flat
        last[index] = torch.where(flat, torch.inf, aside.abs())
        turn[index] = torch.where(newton, FIRST_TURN, turn[index] * WIDEN)
        going = (~finished).nonzero().squeeze(-1)
        if not len(going):
            break
        if len(going) < len(index):
            index, own = index[going], own.of(going)
    return NearestPoints(ends, n, beyond, inside, done)


def _corner(ends: Ends, side: int, index: Tensor) -> tuple[Tensor, Tensor]:
    return ends.x[side, index], ends.y[side, index]


def _share(x: Tensor, y: Tensor, dx: Tensor, dy: Tensor) -> Tensor:
    """Where along a chord (dx, dy) the foot of (x, y), from its start, lies: 0 at its start, 1 at its end."""
    span = dx.square() + dy.square()
    return (x * dx + y * dy) / (span + (span == 0).to(span.dtype))


def _pick(touch: Touch, index: Tensor) -> Touch:
    return Touch(*(value[..., index] for value in vars(touch).values()))


@dataclass(frozen=True)
class Polished:
    """Nearest faces of the sets themselves, where those of sampled polygons do not do.

    Attributes:
        faces: squared distances and sides, as of the polygons' faces.
        fraction: (2, M, B, L) pressure fractions at the ends of the faces; meaningless for points that
            were not polished, whose distance is 0.
        converged: (B, L).
    """

    faces: NearestFaces
    fraction: Tensor
    converged: Tensor


def polish(
    sections: Sections,
    polygons: Polygons,
    faces: NearestFaces,
    point: tuple[Tensor, Tensor],
    scale: tuple[float, float],
    *,
    relative: bool,
    signed: bool,
) -> Polished:
    """From the nearest faces of polygons inside the sets to those of the sets.

    A point inside its polygon is inside its set; unless margins are asked for, only the others are looked at.

    Args:
        sections: the actuators.
        polygons: sampled from their curves.
        faces: nearest to the points, with slots.
        point: (B, L) each.
        scale: factors on force and moment.
        relative: whether the sets are of differences from node 1.
        signed: whether points inside are asked for.
    """
    open_ones = torch.ones_like(faces.inside) if signed else ~(faces.inside | (faces.square <= faces.blur.square()))
    section, load = open_ones.nonzero(as_tuple=True)
    start = start_normals(polygons, faces, *point)
    x, y, nx, ny, blur = (value[section, load] for value in (*point, *start, faces.blur))
    bending = sections.bending - sections.at_first_node(sections.bending) if relative else sections.bending
    pieces = fit_pieces(sections, relative=relative)
    sums = CurveSum(pieces.of(section), bending[:, section], sections.radii[:, section], scale)
    found = nearest_points(sums, x, y, (nx, ny), 4 * blur)
    loose = found.ends.rough.flatten(0, 1).any(0).nonzero().squeeze(-1)
    share = torch.full_like(x[loose], WINDOW)
    index = torch.arange(len(loose), device=x.device)
    for _ in range(REFITS if len(loose) else 0):
        own = loose[index]
        begin, width = found.ends.window(own, share[index])
        near = replace(sums.of(own), pieces=refit_pieces(sections, section[own], begin, width, relative=relative))
        normal = found.normal[0, own], found.normal[1, own]
        found.put(own, nearest_points(near, x[own], y[own], normal, 4 * blur[own]))
        held = found.ends.held(own, begin, width).flatten(0, 1).any(0)
        found.converged[own] &= ~held
        share[index] = torch.where(held, share[index], share[index] * NARROW)
        index = index[share[index] >= LEAST]
        if not len(index):
            break
    ends = found.ends
    square = face_square((x, y), (ends.x[0], ends.y[0]), (ends.x[1], ends.y[1]))
    sampled = faces.square[section, load]
    # The polygon lies inside the set: its distance bounds the set's, from above outside and from below inside.
    kept_inside = faces.inside[section, load] & found.inside
    gain = sampled.sqrt() - square.sqrt()
    better = found.converged & (torch.where(kept_inside, -gain, gain) >= -16 * blur)
    fraction = x.new_zeros(2, len(bending), *faces.inside.shape)
    fraction[:, :, section, load] = ends.fraction
    section, load = section[better], load[better]
    whole = replace(
        faces,
        square=faces.square.index_put((section, load), square[better]),
        inside=faces.inside.index_put((section, load), found.inside[better]),
    )
    converged = (~open_ones).index_put((section, load), better[better])
    return Polished(whole, fraction, converged)
