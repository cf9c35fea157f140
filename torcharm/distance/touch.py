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

Span = tuple[Tensor, Tensor] | None


@dataclass(frozen=True)
class Peaks:
    """Local maxima of curves, or of pieces of them, along normals, (..., m, Q) or (n) each.

    Attributes:
        u: fractions.
        force: [N].
        reach: along the normals.
        drop: minus the reaches' second derivatives.
        swerve: the forces' third derivatives over the square of `drop`.
        found: whether there is one inside the piece; the rest means nothing if not.
    """

    u: Tensor
    force: Tensor
    reach: Tensor
    drop: Tensor
    swerve: Tensor
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
        swerve = torch.zeros_like(u) if self.twist is None else 6 * self.twist / (steep * steep)
        return Peaks(u, force, torch.addcmul(along * force, slope, u), steep, swerve, found)


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
        swerve = (1 - self.less) / (along * u * drop)
        found = _within(u, span) & (fall > 0)
        return Peaks(u, force, slope * u * (self.less / (1 + self.less)), drop, swerve, found)


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
        swerve = (a * p * p * first + b * q * q * second - fall) / (along * (drop * u).square())
        self.latest.view(-1)[self.at] = torch.where(found, t, 1.0)
        return Peaks(u, force, torch.addcmul(along * force, slope, u), drop, swerve, found), rest

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


    def highest(self, along: Tensor, per_fraction: Tensor) -> tuple[Tensor, ...]:
        """Of curves with reaches (m, Q) a newton and a fraction the maxima: fractions and forces; unless all pieces are
        straight, `drop` and `swerve` of `Peaks` (infinite and 0 at corners); and with twins how much higher they may be.
        """
        top, *found = self._corners(along, per_fraction)
        if self.shape is None:
            return tuple(found)
        found += [torch.full_like(top, torch.inf), torch.zeros_like(top)]
        slope = torch.addcmul(per_fraction, along, self.rate)
        peaks = self.shape.peaks(along, slope, self.span)
        force = torch.addcmul(self.base + peaks.force, self.rate, peaks.u)
        reach = torch.addcmul(peaks.reach, along, self.base)
        values = [peaks.u, force, peaks.drop, peaks.swerve]
        if len(reach) > 1:
            reach, best = torch.where(peaks.found, reach, -torch.inf).max(0)
            values = [value.gather(0, best[None])[0] for value in values]
            better = reach > top
        else:
            values, better = [value[0] for value in values], peaks.found[0] & (reach[0] > top)
        found = [torch.where(better, new, old) for new, old in zip(values, found, strict=True)]
        if self.twins is None:
            return tuple(found)

        at = self.twins.at
        own, base, rate, level, own_slope = (
            value.reshape(-1)[at] for value in (along, self.base[0], self.rate[0], top, slope[0])
        )
        twin, higher = self.twins.peaks(own, own_slope)
        reach = torch.addcmul(twin.reach, own, base)
        better = twin.found & (reach > level)
        chosen = at[better]
        for old, new in zip(found, (twin.u, base + twin.force + rate * twin.u, twin.drop, twin.swerve), strict=True):
            old.reshape(-1)[chosen] = new[better]
        rest = torch.zeros_like(top)
        rest.view(-1)[at] = torch.where(reach + higher > level, higher, 0.0)
        return *found, rest

    def _corners(self, along: Tensor, per_fraction: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The furthest corners: reaches, fractions and forces."""
        if self.grid is None:
            first, rise = self.force[0], self.force[1] - self.force[0]
            climb = torch.addcmul(per_fraction, along, rise)
            u = (climb > 0).to(climb.dtype)
            return torch.addcmul(climb.clamp_(min=0), along, first), u, torch.addcmul(first, rise, u)
        top, best = torch.addcmul(along * self.force, per_fraction, self.grid).max(0)
        return top, self.grid.gather(0, best[None])[0], self.force.gather(0, best[None])[0]


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
    return alone, Twins(table, torch.ones_like(g))


@dataclass(frozen=True)
class Touch:
    """Where sets are touched.

    Attributes:
        x, y: (Q) the points.
        radius: (Q) the boundary's radius of curvature there; 0 at corners.
        widening: (Q) its derivative in the angle of the normals.
        u: (M, Q) the pressure fractions that provide them.
        rest: (Q) how much further the sets may reach; None: not at all.
    """

    x: Tensor
    y: Tensor
    radius: Tensor
    widening: Tensor
    u: Tensor
    rest: Tensor | None


@dataclass(frozen=True)
class CurveSums:
    """Q sums of M actuators' reaction curves in the plane, actuators in the order of the groups.

    Attributes:
        groups: of actuators alike, and how many.
        bending: (M, Q) scaled bending moment at fraction 1.
        radii: (M, Q) scaled by moment.
        scale: factors on force and moment.
        order: where in it each of the arm's actuators is.
    """

    groups: tuple[tuple[Arcs, int], ...]
    bending: Tensor
    radii: Tensor
    scale: tuple[float, float]
    order: tuple[int, ...]


    def touch(self, nx: Tensor, ny: Tensor) -> Touch:
        """Where lines with normals (Q) touch the sets.

        As the normal turns, with `k = s_f s_m b` of the bending moment b and a reach a newton, a fraction changes by
        `k / (a drop)`, and the place along the line by the radius `k² / (a² drop)`.
        """
        along = torch.addcmul(self.scale[0] * nx, self.radii, ny, value=-1)
        per_fraction = self.bending * ny
        radius, widening, rest, parts, start = torch.zeros_like(nx), torch.zeros_like(nx), None, [], 0
        for group, count in self.groups:
            own = slice(start, start + count)
            start += count
            part = group.highest(along[own], per_fraction[own])
            parts.append(part)
            if len(part) > 2:
                lever = self.scale[0] * self.bending[own]
                ahead, drop, swerve = along[own], part[2], part[3]
                aside = torch.addcmul(self.scale[0] * ny, self.radii[own], nx)
                bends = lever.square() / (ahead.square() * drop)
                radius += bends.sum(0)
                widening += (bends * (lever * swerve + 3 * aside / ahead)).sum(0)
            if len(part) > 4:
                rest = part[4].sum(0) if rest is None else rest + part[4].sum(0)
        u, force = (torch.cat([part[i] for part in parts]) if len(parts) > 1 else parts[0][i] for i in (0, 1))
        y = (self.bending * u).addcmul_(self.radii, force, value=-1).sum(0)
        return Touch(self.scale[0] * force.sum(0), y, radius, widening, u, rest)


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
    return CurveSums(tuple(groups), scale[1] * bending, scale[1] * radii, scale, order), holds
