"""Curves that are written out, as arcs between corners: their maxima along normals.

Between its kinks a force is a cubic in pressure, or a line and a power: its maximum along a normal is a root of a
quadratic, or a power. Where a curve is the difference of two powers Newton's method finds it, from a side on
which it cannot overshoot.
"""

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from torcharm.laws import LEAST, STRAIGHT, Law

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

    def tangent(self, rate: Tensor, first: Tensor, last: Tensor) -> tuple[Tensor, Tensor]:
        """Slopes (m, Q) of lines from a curve's end at fraction 0 or 1 that touch it between fractions; where they do.

        With one inflection, a cubic has no other face but its chord. About an end, `f = r v + b v² + c v³` is touched
        by the line through it where `b + 2 c v = 0`.
        """
        assert self.twist is not None
        low, high = torch.minimum(first, last), torch.maximum(first, last)
        end = (high == 1).to(rate.dtype)
        bend = torch.addcmul(self.bend, self.twist, end, value=3)
        v = bend / (-2 * self.twist)
        u = end + v
        slope = rate + end * (self.bend + bend) + v * torch.addcmul(bend, v, self.twist)
        return slope, ((low == 0) | (high == 1)) & (u > low) & (u < high)


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
        rest = torch.where(found, torch.where(drop > 0, miss * miss / (2 * drop), torch.inf), 0.0)
        found = found & (drop > 0)
        self.latest.view(-1)[self.at] = torch.where(found, t, 1.0)
        return Peaks(u, force, torch.addcmul(along * force, slope, u), drop, found), rest

    def _slopes(self, t: Tensor, a: Tensor, b: Tensor, slope: Tensor) -> tuple[Tensor, ...]:
        """At fractions of logarithms t the slopes, their derivatives in t, and both powers p and q of the fractions."""
        p, q = self._entries[:2]
        first, second = (p * t).exp_(), (q * t).exp_()
        return slope + a * first + b * second, a * p * first + b * q * second, first, second


@dataclass(frozen=True)
class Lines:
    """Lines that touch, with normals n: reaches `n·c` and places `t·c` along them of (m, Q) curves, a newton and a
    fraction."""

    along: Tensor
    per_fraction: Tensor
    across: Tensor
    across_fraction: Tensor


@dataclass(frozen=True)
class Highest:
    """Maxima (m, Q): fractions, forces; `drop` of `Peaks` (infinite at corners; None if all are); how much higher they
    may be (None: not at all); and how far faces reach, if asked for."""

    u: Tensor
    force: Tensor
    drop: Tensor | None
    rest: Tensor | None
    faces: tuple[Tensor, ...] | None


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

    def tangent(self, first: Tensor, last: Tensor) -> tuple[Tensor, Tensor] | None:
        """As of `Cubics`, if the curves are cubics whose hulls may have such faces."""
        shape = self.shape
        if not isinstance(shape, Cubics) or not shape.winding or shape.twist is None or self.span is not None:
            return None
        return shape.tangent(self.rate[0], first, last)

    def highest(self, lines: Lines, slack: Tensor | None) -> Highest:
        """The curves' maxima along normals, and within slack (Q) of them."""
        along, per_fraction = lines.along, lines.per_fraction
        top, u, force = self._corners(along, per_fraction)
        if self.shape is None:
            return Highest(u, force, None, None, self._faces(lines, top, u, force, None, slack))
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
        u, force = (torch.where(better, new, old).contiguous() for new, old in zip(values, (u, force), strict=False))
        drop = torch.where(better, values[2], torch.inf).contiguous()
        rest = None
        if self.twins is not None:
            top = top.contiguous()
            rest = self._twins_too(lines, slope[0], top, (u, force, drop))
        faces = None
        if slack is not None:
            top = torch.where(better, best_reach, top)
            faces = self._faces(lines, top, u, force, (peaks.u, there, reach, peaks.found), slack)
        return Highest(u, force, drop, rest, faces)

    def _twins_too(self, lines: Lines, slope: Tensor, top: Tensor, found: tuple[Tensor, ...]) -> Tensor:
        """Put maxima of differences of two powers in place of lower ones; how much higher (m, Q) they may be."""
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
        lines: Lines,
        top: Tensor,
        u: Tensor,
        force: Tensor,
        peaks: tuple[Tensor, ...] | None,
        slack: Tensor | None,
    ) -> tuple[Tensor, ...] | None:
        """How far (m, Q) from maxima others are along the lines, to the right and to the left; and their fractions."""
        if slack is None:
            return None
        grid = self.grid
        if grid is None:
            grid = torch.stack((torch.zeros_like(u), torch.ones_like(u)))
        forces = self.force
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
