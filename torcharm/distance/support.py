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
from torcharm.pieces import Pieces

ROUNDS = 40
WIDEN = 8.0
"""Factor on the turn of a direction that has not yet found the other side."""
FIRST_TURN = 1e-3
CLOSING = 0.25
"""Factor by which a step must bring the touched point nearer to straight ahead."""
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

    def of(self, index: Tensor) -> "Touch":
        """Those of the sums in `index`."""
        return Touch(*(value[..., index] for value in vars(self).values()))


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

    def corner(self, side: int, index: Tensor | slice = slice(None)) -> tuple[Tensor, Tensor]:
        """One end (0 or 1) of the faces in `index`."""
        return self.x[side, index], self.y[side, index]

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
        inside: (Q) whether the point is strictly inside.
        converged: (Q).
    """

    ends: Ends
    normal: Tensor
    inside: Tensor
    converged: Tensor

    def put(self, index: Tensor, other: "NearestPoints") -> None:
        """Replace those in `index` by others, found on stretches of the same pieces."""
        for name in ("x", "y", "fraction", "rough"):
            getattr(self.ends, name)[..., index] = getattr(other.ends, name)
        for name in ("normal", "inside", "converged"):
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
    search = _Search.begin(x, y, torch.stack(normal), tolerance, len(sums.radii))
    index = torch.arange(len(x), device=x.device)
    for _ in range(ROUNDS):
        touch = sums.touch(*search.normal[:, index])
        finished = search.settle(index, touch)
        index, sums = _left(index, finished, sums)
        if not len(index):
            break
        search.turn_on(index, touch, ~finished)
    return NearestPoints(search.ends, search.normal, search.inside, search.done)


def _left(index: Tensor, finished: Tensor, sums: CurveSum) -> tuple[Tensor, CurveSum]:
    if not bool(finished.any()):
        return index, sums
    going = (~finished).nonzero().squeeze(-1)
    return index[going], sums.of(going)


@dataclass(frozen=True)
class _Search:
    """Where Q searches stand.

    Attributes:
        x, y, tolerance: (Q) as given.
        normal: (2, Q) present directions.
        ends: what was touched clockwise and counter-clockwise of the nearest points.
        limits: (2, 2, Q) the directions in which that was.
        known: (2, Q) whether it was.
        chord: (Q) whether the present direction is the normal of the chord between the ends.
        aside: (Q) by how much the last touched point was off to a side.
        turn: (Q) the next turn where Newton's step makes no sense [rad].
        inside, done: (Q).
    """

    x: Tensor
    y: Tensor
    tolerance: Tensor
    normal: Tensor
    ends: Ends
    limits: Tensor
    known: Tensor
    chord: Tensor
    aside: Tensor
    turn: Tensor
    inside: Tensor
    done: Tensor

    @classmethod
    def begin(cls, x: Tensor, y: Tensor, normal: Tensor, tolerance: Tensor, actuators: int) -> "_Search":
        count = len(x)
        flags = torch.zeros(5, count, dtype=torch.bool, device=x.device)
        real = x.new_zeros(3, 2, actuators, count)
        place, rough = x.new_zeros(2, 2, count), torch.zeros_like(real[0], dtype=torch.bool)
        ends = Ends(place[0], place[1], real[0], real[1], real[2], rough)
        return cls(
            x,
            y,
            tolerance,
            normal.clone(),
            ends,
            torch.stack((normal, normal)),
            flags[:2],
            flags[2],
            torch.full_like(x, torch.inf),
            torch.full_like(x, FIRST_TURN),
            flags[3],
            flags[4],
        )

    def settle(self, index: Tensor, touch: Touch) -> Tensor:
        """Take in what searches in `index` touched; which of them (q) are finished.

        A chord that nothing overtakes is a face. If the point is past its end, that end takes the
        other's place. Any other touched point replaces the end on its side, or, straight ahead, both.
        """
        nx, ny = self.normal[:, index]
        over, aside = _along(nx, ny, self.x[index] - touch.x, self.y[index] - touch.y)
        slack = self.tolerance[index]
        (ax, ay), (bx, by) = self.ends.corner(0, index), self.ends.corner(1, index)
        face = self.chord[index] & (nx * (touch.x - ax) + ny * (touch.y - ay) <= slack)
        foot = _share(self.x[index] - ax, self.y[index] - ay, bx - ax, by - ay)
        ahead = ~face & (aside.abs() <= slack)
        finished = (face & (foot >= 0) & (foot <= 1)) | ahead
        side = torch.where(face, foot < 0, aside <= 0).long()

        past = (face & ~finished).nonzero().squeeze(-1)
        self.ends.copy(index[past], side[past])
        fresh = (~face).nonzero().squeeze(-1)
        self.ends.put(index[fresh], side[fresh], touch.of(fresh))
        both = ahead.nonzero().squeeze(-1)
        self.ends.put(index[both], 1 - side[both], touch.of(both))
        moved = (~(face & finished)).nonzero().squeeze(-1)
        self.limits[side[moved], :, index[moved]] = self.normal[:, index[moved]].T
        self.known[side[moved], index[moved]] = True
        self.inside[index] = finished & (over < 0)
        self.done[index] = finished
        return finished

    def turn_on(self, index: Tensor, touch: Touch, going: Tensor) -> None:
        """Choose where searches in `index`, those `going` of the touched, look next.

        By Newton's step, as long as it stays between the ends and closes in; else along the normal of the
        chord between them or, from outside and past its end, straight away from that end. Newton's
        step sees the boundary as a circle, and makes no sense from inside it beyond its centre.
        """
        touch = touch.of(going.nonzero().squeeze(-1))
        nx, ny = self.normal[:, index]
        x, y = self.x[index], self.y[index]
        over, aside = _along(nx, ny, x - touch.x, y - touch.y)
        steep = over + touch.radius
        newton = steep > aside.abs()
        angle = self.turn[index] * aside.sign()
        next_x = torch.where(newton, steep * nx - aside * ny, nx - angle * ny)
        next_y = torch.where(newton, steep * ny + aside * nx, ny + angle * nx)

        (low_x, low_y), (high_x, high_y) = self.limits[0][:, index], self.limits[1][:, index]
        within = (low_x * next_y - low_y * next_x > 0) & (next_x * high_y - next_y * high_x > 0)
        closing = aside.abs() < CLOSING * self.aside[index]
        across = self.known[:, index].all(0) & ~(within & closing)
        (ax, ay), (bx, by) = self.ends.corner(0, index), self.ends.corner(1, index)
        dx, dy = bx - ax, by - ay
        share = _share(x - ax, y - ay, dx, dy)
        point = (dx == 0) & (dy == 0)
        outside = (over > 0) & (dy * (x - ax) - dx * (y - ay) >= 0)
        at_end = across & outside & ((share <= 0) | (share >= 1) | point)
        chord = across & ~at_end & ~point
        first = share <= 0
        next_x = torch.where(chord, dy, torch.where(at_end, x - torch.where(first, ax, bx), next_x))
        next_y = torch.where(chord, -dx, torch.where(at_end, y - torch.where(first, ay, by), next_y))

        self.normal[:, index] = torch.stack((next_x, next_y)) / torch.hypot(next_x, next_y)
        self.chord[index] = chord
        self.aside[index] = torch.where(chord, torch.inf, aside.abs())
        self.turn[index] = torch.where(newton, FIRST_TURN, self.turn[index] * WIDEN)


def _along(nx: Tensor, ny: Tensor, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """Vectors (x, y) along a direction, and to the left of it."""
    return nx * x + ny * y, nx * y - ny * x


def _share(x: Tensor, y: Tensor, dx: Tensor, dy: Tensor) -> Tensor:
    """Where along a chord (dx, dy) the foot of (x, y), from its start, lies: 0 at its start, 1 at its end."""
    span = dx.square() + dy.square()
    return (x * dx + y * dy) / (span + (span == 0).to(span.dtype))
