"""Where lines touch sums of curves that are written out: every actuator's maximum along a normal.

Between its kinks a force is a cubic in pressure, or a line and a power: its maximum along a normal is a root of a
quadratic, or a power. Where a curve is the difference of two powers Newton's method finds it, from a side on
which it cannot overshoot.
"""

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from torcharm.laws import LEAST, STRAIGHT, Law, Laws

FLAT = 256.0
"""Roundings of its slope by which a curve may bend and count as straight: its peak would be anywhere."""
STEPS, MORE_STEPS = 5, 2
"""Newton's on a difference of two powers: from afar, and from where the last ones led."""
FLOOR = -69.0
"""The logarithm of a fraction as good as none."""

LEAST_TURN, MOST_TURN = 0.1, 4.0
"""Bounds on the factor by which a curve's change of curvature may change the turn of a normal."""
MOST_SWAY = 0.3
"""Bound on what its second order may change of a step along a curve."""
ENDING = 0.06
"""Share of the way to a corner that is kept if it is missed by no more."""

Span = tuple[Tensor, Tensor] | None


@dataclass(frozen=True)
class Peaks:
    """Local maxima of curves, or of pieces of them, along normals, (..., m, Q) or (n) each.

    Attributes:
        u: fractions.
        force: [N].
        reach: along the normals.
        drop: minus the reaches' second derivatives.
        found: whether there is one inside the piece; the rest means nothing if not.
    """

    u: Tensor
    force: Tensor
    reach: Tensor
    drop: Tensor
    found: Tensor


def _within(u: Tensor, span: Span) -> Tensor:
    return (u > 0) & (u < 1) if span is None else (u > span[0]) & (u < span[1])


@dataclass(frozen=True)
class Cubics:
    """What curves bend by: `c_2 u² + c_3 u³`, (m, Q) each.

    Attributes:
        bend: c_2.
        twist: c_3; None if there is none.
        winding: whether any is convex here and concave there, so that a peak may be no maximum.
    """

    bend: Tensor
    twist: Tensor | None
    winding: bool


    def peaks(self, along: Tensor, slope: Tensor, span: Span) -> Peaks:
        """The local maxima of pieces within spans, of slopes (J, m, Q) at fraction 0 and reaches a newton (m, Q)."""
        drop = (along * self.bend).mul_(-2)
        least = (slope.abs() + drop.abs()).mul_(FLAT * torch.finfo(slope.dtype).eps)
        if self.twist is None:
            steep = drop.expand_as(slope)
            u = slope / steep
        else:
            third = (along * self.twist).mul_(3)
            steep = torch.addcmul(drop * drop, third, slope, value=-4).clamp_(min=0).sqrt_()
            u = 2 * slope / (drop + steep)
            if self.winding:  # the same root, where the sum cancels
                u = torch.where(drop < 0, (drop - steep) / (2 * third), u)
        found = _within(u, span) & (steep > least)
        bend = self.bend if self.twist is None else torch.addcmul(self.bend, self.twist, u)
        force = bend * u * u
        return Peaks(u, force, torch.addcmul(along * force, slope, u), steep, found)

    def slope_change(self, u: Tensor, step: Tensor) -> Tensor:
        """By how much slopes (m, Q) change from fractions on by steps."""
        change = 2 * self.bend
        return (change if self.twist is None else torch.addcmul(change, self.twist, 2 * u + step, value=3)) * step


@dataclass(frozen=True)
class Powers:
    """What curves bend by: `g u^x`, (m, Q) each.

    Attributes:
        gain: g; 0 where there is no power.
        less: x - 1, above 0.
    """

    gain: Tensor
    less: Tensor


    def peaks(self, along: Tensor, slope: Tensor, span: Span) -> Peaks:
        """As of `Cubics`."""
        fall = along * self.gain * (-1 - self.less)
        share = slope / fall  # u^(x - 1)
        u = share.log().div_(self.less).exp_()
        force = self.gain * share * u
        drop = self.less * slope / u
        return Peaks(u, force, slope * u * (self.less / (1 + self.less)), drop, _within(u, span) & (fall > 0))

    def slope_change(self, u: Tensor, step: Tensor) -> Tensor:
        """As of `Cubics`."""
        first, last = (self.less * value.clamp(min=LEAST).log() for value in (u, u + step))
        return self.gain * (1 + self.less) * (last.exp_() - first.exp_())


@dataclass(frozen=True)
class Twins:
    """What some curves bend by: `g u^(1 + p) + h u^(1 + q)` with p < q.

    Where the two gains differ in sign there is one turning point. Along a normal the maximum lies before it, or
    else behind it; in `u^p`, or else in `u^q`, the slope is curved such that Newton's method stays on one side.

    Attributes:
        table: (7, m, Q) p, q, g, h, the logarithm of the turning point (1 at most), and there and at 1 the slope.
        latest: (m, Q) logarithms of the fractions last found, 1 if none; set anew by each search.
    """

    table: Tensor
    latest: Tensor


    @cached_property
    def at(self) -> Tensor:
        """Which of m Q curves they are; gains of others are 0."""
        return self.table[2].reshape(-1).nonzero().squeeze(-1)

    @cached_property
    def _entries(self) -> Tensor:
        return self.table.flatten(1).index_select(-1, self.at)

    def peaks(self, along: Tensor, slope: Tensor) -> tuple[Peaks, Tensor]:
        """The local maxima (n) of curves of slopes (n) at fraction 0; and how much higher they may be."""
        p, q, g, h, turn, at_turn, at_end = self._entries
        a, b = along * g * (1 + p), along * h * (1 + q)
        before = a < 0
        middle, end = torch.addcmul(slope, along, at_turn), torch.addcmul(slope, along, at_end)
        found = torch.where(before, (slope > 0) & (middle < 0), (middle > 0) & (end < 0))
        less = torch.where(before, p, q)
        low, high = torch.where(before, FLOOR, turn), torch.where(before, turn, 0.0)
        latest = self.latest.view(-1)[self.at]
        known = (latest > low) & (latest < high)
        begin = torch.where(before, (slope / -a).log_().div_(p), 0.0)
        t = torch.where(known, latest, begin)
        for _ in range(STEPS if not bool((known | ~found).all()) else MORE_STEPS):
            miss, fall, _, _ = self._slopes(t, a, b, slope)
            step = (1 - less * miss / fall).clamp_(min=1e-6).log_().div_(less)
            t = torch.minimum(torch.maximum(t + step, low), high)
        miss, fall, first, second = self._slopes(t, a, b, slope)
        u = t.exp()
        drop = -fall / u
        force = (g * first + h * second) * u
        found = found & (drop > 0)
        rest = torch.where(found, miss * miss / (2 * drop), 0.0)
        self.latest.view(-1)[self.at] = torch.where(found, t, 1.0)
        return Peaks(u, force, torch.addcmul(along * force, slope, u), drop, found), rest

    def _slopes(self, t: Tensor, a: Tensor, b: Tensor, slope: Tensor) -> tuple[Tensor, ...]:
        """At fractions of logarithms t the slopes, their derivatives in t, and both powers p and q of the fractions."""
        p, q = self._entries[:2]
        first, second = (p * t).exp_(), (q * t).exp_()
        return slope + a * first + b * second, a * p * first + b * q * second, first, second


@dataclass(frozen=True)
class Arcs:
    """m curves of one kind for each of Q problems, as pieces between S corners.

    Attributes:
        grid: (S, m, Q) corners' fractions; None for 0 and 1.
        force: (S, m, Q) there.
        base, rate: (J, m, Q) the pieces' lines.
        span: their first and last fractions (J, m, Q); None for 0 and 1.
        shape: what the pieces bend by; None if they are straight.
        twins: the same of curves that are differences of two powers; None if there is none.
    """

    grid: Tensor | None
    force: Tensor
    base: Tensor
    rate: Tensor
    span: Span
    shape: Cubics | Powers | None
    twins: Twins | None


    def highest(self, lines: "_Lines", slack: Tensor | None) -> "_Highest":
        """The curves' maxima along normals, and within slack (Q) of them."""
        along, per_fraction = lines.along, lines.per_fraction
        top, u, force = self._corners(along, per_fraction)
        if self.shape is None:
            return _Highest(u, force, None, None, self._faces(lines, top, u, force, None, slack))
        slope = torch.addcmul(per_fraction, along, self.rate)
        peaks = self.shape.peaks(along, slope, self.span)
        there = torch.addcmul(self.base + peaks.force, self.rate, peaks.u)
        reach = torch.addcmul(peaks.reach, along, self.base)
        values = [peaks.u, there, peaks.drop]
        if len(reach) > 1:
            best_reach, best = torch.where(peaks.found, reach, -torch.inf).max(0)
            values = [value.gather(0, best[None])[0] for value in values]
        else:
            values, best_reach = [value[0] for value in values], reach[0]
        better = best_reach > top
        if len(reach) == 1:
            better = better & peaks.found[0]
        old = (u, force, torch.inf)
        u, force, drop = (torch.where(better, new, kept).contiguous() for new, kept in zip(values, old, strict=True))
        rest = None
        if self.twins is not None:
            top = top.contiguous()
            rest = self._twins_too(lines, slope[0], top, (u, force, drop))
        faces = None
        if slack is not None:
            top = torch.where(better, best_reach, top)
            faces = self._faces(lines, top, u, force, (peaks.u, there, reach, peaks.found), slack)
        return _Highest(u, force, drop, rest, faces)

    def _twins_too(self, lines: "_Lines", slope: Tensor, top: Tensor, found: tuple[Tensor, ...]) -> Tensor:
        """Put maxima of differences of two powers in place of what was found lower; how much higher (m, Q) they may be."""
        assert self.twins is not None
        at = self.twins.at
        along, slope, base, rate, level = (
            value.reshape(-1)[at] for value in (lines.along, slope, self.base[0], self.rate[0], top)
        )
        twin, higher = self.twins.peaks(along, slope)
        reach = torch.addcmul(twin.reach, along, base)
        better = twin.found & (reach > level)
        chosen = at[better]
        for old, new in zip(found, (twin.u, base + twin.force + rate * twin.u, twin.drop), strict=True):
            old.view(-1)[chosen] = new[better]
        top.view(-1)[chosen] = reach[better]
        rest = top.new_zeros(top.shape)
        rest.view(-1)[at] = torch.where(reach + higher > level, higher, 0.0)
        return rest

    def _corners(self, along: Tensor, per_fraction: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The furthest corners: reaches, fractions and forces."""
        if self.grid is None:
            first, rise = self.force[0], self.force[1] - self.force[0]
            climb = torch.addcmul(per_fraction, along, rise)
            u = (climb > 0).to(climb.dtype)
            return torch.addcmul(climb.clamp_(min=0), along, first), u, torch.addcmul(first, rise, u)
        top, best = torch.addcmul(along * self.force, per_fraction, self.grid).max(0)
        return top, self.grid.gather(0, best[None])[0], self.force.gather(0, best[None])[0]

    def _faces(
        self,
        lines: "_Lines",
        top: Tensor,
        u: Tensor,
        force: Tensor,
        peaks: tuple[Tensor, ...] | None,
        slack: Tensor | None,
    ) -> tuple[Tensor, ...] | None:
        """From maxima how far (m, Q) others reach along the lines, to the right and to the left; and their fractions."""
        if slack is None:
            return None
        grid = self.grid
        if grid is None:
            grid = torch.stack((torch.zeros_like(u), torch.ones_like(u)))
        forces, missing = self.force, None
        reach = torch.addcmul(lines.along * forces, lines.per_fraction, grid)
        off = reach < top - slack
        if peaks is not None:
            grid, forces = torch.cat((grid, peaks[0])), torch.cat((forces, peaks[1]))
            off = torch.cat((off, (peaks[2] < top - slack) | ~peaks[3]))
        place = torch.addcmul(lines.across * (forces - force), lines.across_fraction, grid - u)
        low, first = torch.where(off, torch.inf, place).min(0)
        high, last = torch.where(off, -torch.inf, place).max(0)
        low_u, high_u = (grid.gather(0, index[None])[0] for index in (first, last))
        return low.clamp(max=0), high.clamp(min=0), torch.where(low < 0, low_u, u), torch.where(high > 0, high_u, u)


@dataclass(frozen=True)
class _Lines:
    """Lines that touch, with normals n: reaches `n·c` and places `t·c` along them of (m, Q) curves, a newton and a
    fraction."""

    along: Tensor
    per_fraction: Tensor
    across: Tensor
    across_fraction: Tensor


@dataclass(frozen=True)
class _Highest:
    """Maxima (m, Q): fractions, forces; `drop` of `Peaks` (infinite at corners; None if all are); how much higher they
    may be (None: not at all); and how far faces reach, if asked for."""

    u: Tensor
    force: Tensor
    drop: Tensor | None
    rest: Tensor | None
    faces: tuple[Tensor, ...] | None


def arcs(law: Law) -> tuple[Arcs, Tensor]:
    """The curves of a law at B sections as pieces; and whether (B) they are all there is to them."""
    holds = torch.ones_like(law.coefficients[0][0], dtype=torch.bool)
    zero, one = torch.zeros_like(law.coefficients[0])[None], torch.ones_like(law.coefficients[0])[None]
    inner = ((law.kinks > 0) & (law.kinks < 1) & (law.slopes != 0)).flatten(1).any(1) if len(law.kinks) else None
    grid = None if inner is None else torch.cat((zero, law.kinks[inner].clamp(0, 1), one))
    force = law.force(torch.cat((zero[:, :1, :1], one[:, :1, :1])) if grid is None else grid)
    base, rate = law.coefficients[0], law.coefficients[1] if len(law.coefficients) > 1 else zero[0]
    shape: Cubics | Powers | None = None
    twins = None
    if len(law.gain):
        shape, twins = _powers(law)
        bent = (law.gain != 0).any(0)
    elif len(law.coefficients) > 2:
        bend, twist = law.coefficients[2], law.coefficients[3] if len(law.coefficients) > 3 else None
        winding = twist is not None and (len(law.kinks) > 0 or bool((bend * (bend + 3 * twist) < 0).any()))
        shape, bent = Cubics(bend, twist, winding), torch.ones_like(holds).expand_as(base)
    if shape is None or not len(law.kinks):
        return Arcs(grid, force, base[None], rate[None], None, shape, twins), holds
    base, rate, span = _pieces(law, base, rate, bent)
    if twins is not None and span is not None:
        divided = (twins.table[2] != 0) & (span[1][0] < 1)
        holds = ~divided.any(0)
    return Arcs(grid, force, base, rate, span, shape, twins), holds


def _pieces(law: Law, base: Tensor, rate: Tensor, bent: Tensor) -> tuple[Tensor, Tensor, Span]:
    """Lines and spans (J, m, B) of the pieces between kinks, of curves that are bent (m, B)."""
    real = (law.slopes != 0) & (law.kinks < 1) & bent
    ends, order = torch.where(real, law.kinks.clamp(min=0), 1.0).sort(0)
    slopes = torch.where(real, law.slopes, 0.0)
    shifts = (slopes * torch.where(real, law.kinks, 0.0)).gather(0, order).cumsum(0)
    slopes = slopes.gather(0, order).cumsum(0)
    count = int((ends < 1).flatten(1).any(1).sum())
    base = torch.cat((base[None], base - shifts[:count]))
    rate = torch.cat((rate[None], rate + slopes[:count]))
    if not count:
        return base, rate, None
    zero, one = torch.zeros_like(base[:1]), torch.ones_like(base[:1])
    return base, rate, (torch.cat((zero, ends[:count])), torch.cat((ends[:count], one)))


def _powers(law: Law) -> tuple[Powers, Twins | None]:
    """The powers of curves that have one, and of those that have two."""
    less = law.exponent - 1
    if len(law.gain) == 1:
        gain, less = law.gain[0], less[0]
        return Powers(torch.where(less > STRAIGHT, gain, 0.0), less.clamp(min=STRAIGHT)), None
    some = (law.gain != 0) & (less > STRAIGHT)
    both = some.all(0)
    gain = torch.where(some, law.gain, 0.0).sum(0)
    alone = Powers(torch.where(both, 0.0, gain), torch.where(some, less, 0.0).amax(0).clamp(min=STRAIGHT))
    if not bool(both.any()):
        return alone, None
    swap = less[0] > less[1]
    (p, q), (g, h) = (torch.where(swap, value.flip(0), value) for value in (less, law.gain))
    ratio = -(g * (1 + p) * p) / (h * (1 + q) * q)
    turn = (ratio.log() / (q - p)).clamp(max=0)
    turn = torch.where((ratio > 0) & turn.isfinite(), turn, 0.0)
    at_turn = g * (1 + p) * (p * turn).exp() + h * (1 + q) * (q * turn).exp()
    table = torch.stack((p, q, torch.where(both, g, 0.0), h, turn, at_turn, g * (1 + p) + h * (1 + q)))
    return alone, Twins(table, g.new_ones(g.shape))


@dataclass(frozen=True)
class Touch:
    """Where sets are touched.

    Attributes:
        point: (2, Q) x and y.
        parts: (2, M, Q) the actuators' parts of them.
        u: (M, Q) the pressure fractions that provide them.
        along, across: (M, Q) reaches, and places along the lines, a newton.
        drop: (M, Q) minus the reaches' second derivatives; infinite at corners. None if all are.
        bends: (M, Q) the curves' radii of curvature in the plane.
        radius: (Q) the boundary's: their sum; 0 at corners.
        rest: (Q) how much further the sets may reach; None: not at all.
        face: (M, Q) each, if asked for: how far actuators may go, and be touched, to the right and to the left, and their
            fractions there.
    """

    point: Tensor
    parts: Tensor
    u: Tensor
    along: Tensor
    across: Tensor
    drop: Tensor | None
    bends: Tensor | None
    radius: Tensor
    rest: Tensor | None
    face: tuple[Tensor, ...] | None


@dataclass(frozen=True)
class CurveSums:
    """Q sums of M actuators' reaction curves in the plane, actuators in the order of the groups.

    Attributes:
        groups: of actuators alike, and how many.
        bending: (M, Q) bending moment at fraction 1, scaled by moment.
        lever: (M, Q) the same, scaled by force too.
        radii: (M, Q) scaled by moment.
        scale: factors on force and moment.
        order: where in it each of the arm's actuators is.
    """

    groups: tuple[tuple[Arcs, int], ...]
    bending: Tensor
    lever: Tensor
    radii: Tensor
    scale: tuple[float, float]
    order: tuple[int, ...]

    def touch(self, normal: Tensor, slack: Tensor | None = None) -> Touch:
        """Where lines with normals (2, Q) touch the sets, and if asked for within slack (Q) of there.

        As the normal turns, with a lever `k = s_f s_m b` of the bending moment b and a reach a newton, a fraction changes by
        `k / (a drop)`, and the place along the line by the radius `k² / (a² drop)`.
        """
        nx, ny = normal
        fx, fy = self.scale[0] * normal
        along, across = torch.addcmul(fx, self.radii, ny, value=-1), -torch.addcmul(fy, self.radii, nx)
        lines = _Lines(along, self.bending * ny, across, self.bending * nx)
        parts: list[_Highest] = []
        for group, own in self.by_group():
            whole = len(self.groups) == 1
            part = lines if whole else _Lines(*(value[own] for value in vars(lines).values()))
            parts.append(group.highest(part, slack))
        if len(parts) == 1:
            u, force, drop, rest, face = vars(parts[0]).values()
        else:
            u, force = torch.cat([part.u for part in parts]), torch.cat([part.force for part in parts])
            drops = [torch.full_like(part.u, torch.inf) if part.drop is None else part.drop for part in parts]
            drop = None if all(part.drop is None for part in parts) else torch.cat(drops)
            rests = [part.rest for part in parts if part.rest is not None]
            rest = torch.cat(rests) if rests else None
            face = None
            if slack is not None:
                face = tuple(torch.cat(values) for values in zip(*(part.faces or () for part in parts), strict=True))
        shares = torch.stack((self.scale[0] * force, torch.addcmul(self.bending * u, self.radii, force, value=-1)))
        bends = None if drop is None else (self.lever / along).square_().div_(drop)
        radius = torch.zeros_like(nx) if bends is None else bends.sum(0)
        rest = None if rest is None else rest.sum(0)
        return Touch(shares.sum(1), shares, u, along, across, drop, bends, radius, rest, face)

    def by_group(self) -> list[tuple[Arcs, slice]]:
        """The groups, and which actuators they are."""
        starts = [0]
        for _, count in self.groups:
            starts.append(starts[-1] + count)
        return [(group, slice(start, start + count)) for (group, count), start in zip(self.groups, starts, strict=False)]

    def turn(self, touch: Touch, angle: Tensor, steep: Tensor) -> Tensor:
        """How far (Q, as tangents) normals turn in Newton's step, if to first order that is an angle.

        Of the rate (steep) at which the points come ahead as the normal turns, that part which is the curves' radii
        changes on the way: to how much, they say themselves.
        """
        if touch.drop is None or touch.bends is None:
            return angle
        lever, along, u, bends = self.lever, touch.along, touch.u, touch.bends
        # The place along the line is quadratic in the fraction.
        sway = (0.5 * touch.across * angle / along).clamp(-MOST_SWAY, MOST_SWAY)
        target = u + angle * lever / (along * touch.drop) * (1 + sway)
        # Short of a corner that is missed by little.
        left, right = ENDING * u, ENDING * (1 - u)
        low, high = (target > -left) * left, 1 - (target < 1 + right) * right
        step = torch.minimum(torch.maximum(target, low), high).sub_(u)
        change = -step * touch.drop / along
        for group, own in self.by_group():
            if group.shape is not None:
                known = group.shape.slope_change(u[own], step[own])
                change[own] = known if group.twins is None else torch.where(known != 0, known, change[own])
        curved = (bends > 0) & (angle != 0)
        slope = along * torch.where(curved, change, 0.0)
        turns = -along * slope / (torch.addcmul(lever, touch.across, slope) * angle)
        gain = (bends * torch.where(curved, turns.clamp(LEAST_TURN, MOST_TURN) - 1, 0.0)).sum(0) / steep
        return angle * (1 + gain.clamp(LEAST_TURN - 1, MOST_TURN - 1))


def curve_sums(laws: Laws, bending: Tensor, radii: Tensor, scale: tuple[float, float]) -> tuple[CurveSums, Tensor]:
    """The sums of laws' curves at B sections; and whether (B) they are right.

    Args:
        laws: of M actuators.
        bending: (M, B) bending moments at fraction 1 [N·m].
        radii: (M, B) [m].
        scale: factors on force and moment.
    """
    holds, groups = laws.holds, []
    for law in laws.groups:
        group, known = arcs(law)
        holds = holds & known
        groups.append((group, len(law.coefficients[0])))
    count = len(radii)
    places = [place for law in laws.groups for place in (range(count)[law.rows] if isinstance(law.rows, slice) else law.rows)]
    order = tuple(places.index(own) for own in range(count))
    if len(groups) > 1:
        bending, radii = (torch.cat([value[law.rows] for law in laws.groups]) for value in (bending, radii))
    bending = scale[1] * bending
    return CurveSums(tuple(groups), bending, scale[0] * bending, scale[1] * radii, scale, order), holds
