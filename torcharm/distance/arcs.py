"""Curves that are written out, as arcs between corners: their maxima along normals.

Between its kinks a force is a cubic in pressure, or a line and a power: its maximum along a normal is a root of a
quadratic, or a power. Where a curve is the difference of two powers Newton's method finds it, from a side on
which it cannot overshoot.

All in NumPy: what is left to search for is soon so little that calls cost more than arithmetic, and NumPy's are cheap.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torcharm.laws import LEAST, STRAIGHT, Law

FLAT = 256.0
"""Roundings of its slope by which a curve may bend and count as straight: its peak would be anywhere."""
STEPS, MORE_STEPS = 5, 2
"""Newton's on a difference of two powers: from afar, and from where the last ones led."""
FLOOR = -69.0
"""The logarithm of a fraction as good as none."""
BETWEEN = (0.3, 0.7)
"""Fractions that stand for a power's curve."""

Array = NDArray[Any]
Span = tuple[Array, Array] | None


def as_array(value: Tensor) -> Array:
    """A tensor's numbers, not copied if they are the processor's own."""
    array: Array = value.detach().cpu().numpy()
    return array


def _within(u: Array, span: Span) -> Array:
    inside: Array = (u > 0) & (u < 1) if span is None else (u > span[0]) & (u < span[1])
    return inside


def at_index(values: Array, index: Array) -> Array:
    """Of values (S, m, Q) those (m, Q) at an index along the first dimension."""
    flat = index * index.size
    flat += np.arange(index.size).reshape(index.shape)
    chosen: Array = values.reshape(-1).take(flat)
    return chosen


@dataclass(frozen=True)
class Peaks:
    """Local maxima of pieces of curves along normals, (J, m, Q) each, or (n).

    Attributes:
        u: fractions.
        force: what the curves bend by there [N].
        drop: minus the second derivatives of what they reach along the normals.
        found: whether there is one inside the piece; the rest means nothing if not.
    """

    u: Array
    force: Array
    drop: Array
    found: Array


@dataclass(frozen=True)
class Cubics:
    """What curves bend by: `c_2 u² + c_3 u³`, (m, Q) each.

    Attributes:
        bend: c_2.
        twist: c_3; None if there is none.
        winding: whether any is convex here and concave there, so that a peak may be no maximum.
    """

    bend: Array
    twist: Array | None
    winding: bool

    def peaks(self, along: Array, slope: Array, span: Span) -> Peaks:
        """The local maxima of pieces within spans, of slopes (J, m, Q) at fraction 0 and reaches a newton (m, Q)."""
        drop = -2 * along * self.bend
        least = np.abs(slope) + np.abs(drop)
        least *= FLAT * np.finfo(slope.dtype).eps
        if self.twist is None:
            steep = drop + np.zeros_like(slope)
            u = slope / steep
            bend = self.bend
        else:
            third = 3 * along * self.twist
            steep = np.sqrt(np.maximum(drop * drop - 4 * third * slope, 0))
            u = 2 * slope / (drop + steep)
            if self.winding:  # the same root, where the sum cancels
                u = np.where(drop < 0, (drop - steep) / (2 * third), u)
            bend = self.bend + self.twist * u
        return Peaks(u, bend * u * u, steep, _within(u, span) & (steep > least))

    def between(self) -> tuple[Array, Array]:
        """Fractions (C, m, Q), and how far above their chords curves are there.

        There they are furthest from the chords; winding ones are touched there by lines from their ends.
        """
        b, c = self.bend, 0.0 if self.twist is None else self.twist
        u = (b + c) / (b + np.copysign(np.sqrt(b * b + 3 * c * (b + c)), b))
        u = np.where((u > 0) & (u < 1), u, 0.5)[None]
        if self.winding:
            turns, touched = b * (b + 3 * c) < 0, b / (-2 * c)
            u = np.concatenate((np.where(turns, touched, u), np.where(turns, touched - 0.5, u)))
            u = np.where((u > 0) & (u < 1), u, u[::-1])
        return u, (b + c * u) * u * u - (b + c) * u

    def slope_change(self, u: Array, step: Array) -> Array:
        """By how much slopes (m, Q) change from fractions on by steps."""
        change: Array = 2 * self.bend
        if self.twist is not None:
            change += 3 * self.twist * (2 * u + step)
        return change * step

    def tangent(self, rate: Array, first: Array, last: Array) -> tuple[Array, Array]:
        """Slopes (m, Q) of lines from a curve's end at fraction 0 or 1 that touch it between fractions; where they do.

        With one inflection, a cubic has no other face but its chord. About an end, `f = r v + b v² + c v³` is touched
        by the line through it where `b + 2 c v = 0`.
        """
        assert self.twist is not None
        low, high = np.minimum(first, last), np.maximum(first, last)
        end = (high == 1).astype(rate.dtype)
        bend = self.bend + 3 * self.twist * end
        v = bend / (-2 * self.twist)
        u = end + v
        slope = rate + end * (self.bend + bend) + v * (bend + v * self.twist)
        return slope, ((low == 0) | (high == 1)) & (u > low) & (u < high)


def _bow(share: float, less: Array) -> Array:
    """How far `u^(1 + less)` is above its chord at a fraction."""
    bow: Array = share * (np.exp(np.log(share) * less) - 1)
    return bow


@dataclass(frozen=True)
class Powers:
    """What curves bend by: `g u^x`, (m, Q) each.

    Attributes:
        gain: g; 0 where there is no power.
        less: x - 1, above 0.
    """

    gain: Array
    less: Array

    def peaks(self, along: Array, slope: Array, span: Span) -> Peaks:
        """As of `Cubics`."""
        fall = along * self.gain * (-1 - self.less)
        share = slope / fall  # u^(x - 1)
        u = np.exp(np.log(share) / self.less)
        return Peaks(u, self.gain * share * u, self.less * slope / u, _within(u, span) & (fall > 0))

    def between(self) -> tuple[Array, Array]:
        """As of `Cubics`: some fractions and how far from their chords curves are there."""
        u = np.empty((len(BETWEEN), *self.gain.shape), self.gain.dtype)
        u[:] = np.reshape(BETWEEN, (-1, 1, 1))
        return u, np.stack([self.gain * _bow(share, self.less) for share in BETWEEN])

    def slope_change(self, u: Array, step: Array) -> Array:
        """As of `Cubics`."""
        first, last = (np.exp(self.less * np.log(np.maximum(value, LEAST))) for value in (u, u + step))
        change: Array = self.gain * (1 + self.less) * (last - first)
        return change


@dataclass(frozen=True)
class Twins:
    """What some curves bend by: `g u^(1 + p) + h u^(1 + q)` with p < q.

    Where the two gains differ in sign there is one turning point. Along a normal the maximum lies before it, or
    else behind it; in `u^p`, or else in `u^q`, the slope is curved such that Newton's method stays on one side.

    Attributes:
        table: (7, m, Q) p, q, g, h, the logarithm of the turning point (1 at most), and there and at 1 the slope.
        latest: (m, Q) logarithms of the fractions last found, 1 if none; set anew by each search.
    """

    table: Array
    latest: Array

    def between(self) -> Array:
        """Of `Powers.between`, how far from their chords."""
        p, q, g, h = self.table[:4]
        h = np.where(g == 0, 0.0, h)
        return np.stack([g * _bow(share, p) + h * _bow(share, q) for share in BETWEEN])

    def at(self) -> tuple[Array, Array]:
        """Which of m Q curves they are; gains of others are 0."""
        return self.table[2].nonzero()

    def peaks(self, at: tuple[Array, Array], along: Array, slope: Array) -> tuple[Peaks, Array]:
        """The local maxima (n) of curves of slopes (n) at fraction 0; and how much higher they may be."""
        p, q, g, h, turn, at_turn, at_end = self.table[:, at[0], at[1]]
        a, b = along * g * (1 + p), along * h * (1 + q)
        before = a < 0
        middle, end = slope + along * at_turn, slope + along * at_end
        found = np.where(before, (slope > 0) & (middle < 0), (middle > 0) & (end < 0))
        less = np.where(before, p, q)
        low, high = np.where(before, FLOOR, turn), np.where(before, turn, 0.0)
        latest = self.latest[at]
        known = (latest > low) & (latest < high)
        t = np.where(known, latest, np.where(before, np.log(slope / -a) / p, 0.0))

        def slopes() -> tuple[Array, Array, Array, Array]:
            """At fractions of logarithms t the slopes, their derivatives in t, and both powers of the fractions."""
            first, second = np.exp(p * t), np.exp(q * t)
            one, two = a * first, b * second
            return slope + one + two, p * one + q * two, first, second

        for _ in range(STEPS if not (known | ~found).all() else MORE_STEPS):
            miss, fall, _, _ = slopes()
            step = np.log(np.maximum(1 - less * miss / fall, 1e-6)) / less
            t = np.minimum(np.maximum(t + step, low), high)
        miss, fall, first, second = slopes()
        u = np.exp(t)
        drop = -fall / u
        rest = np.where(found, np.where(drop > 0, miss * miss / (2 * drop), np.inf), 0.0)
        found = found & (drop > 0)
        self.latest[at] = np.where(found, t, 1.0)
        return Peaks(u, (g * first + h * second) * u, drop, found), rest


@dataclass(frozen=True)
class Lines:
    """Lines with normals n, of (m, Q) curves: how far along them a newton and a fraction reach."""

    along: Array
    per_fraction: Array


@dataclass(frozen=True)
class Highest:
    """Maxima (m, Q): fractions, forces; `drop` of `Peaks` (infinite at corners; None if all are); how much higher they
    may be (None: not at all); and by how much other corners and peaks reach less far."""

    u: Array
    force: Array
    drop: Array | None
    rest: Array | None
    margin: Array


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

    grid: Array | None
    force: Array
    base: Array
    rate: Array
    span: Span
    shape: Cubics | Powers | None
    twins: Twins | None

    def tangent(self, first: Array, last: Array) -> tuple[Array, Array] | None:
        """As of `Cubics`, if the curves are cubics whose hulls may have such faces."""
        shape = self.shape
        if not isinstance(shape, Cubics) or not shape.winding or shape.twist is None or self.span is not None:
            return None
        return shape.tangent(self.rate[0], first, last)

    @property
    def corners(self) -> int:
        """How many corners curves may have beside their ends."""
        return 0 if self.grid is None else len(self.grid) - 2

    def highest(self, lines: Lines) -> Highest:
        """The curves' maxima along normals."""
        winding = isinstance(self.shape, Cubics) and self.shape.winding
        if self.grid is None and len(self.base) == 1 and not winding:
            found, top, at_zero = self._highest_of_one(lines)
        else:
            u, force, reach, drops = self._candidates(lines)
            best = reach.argmax(0)
            top, at_zero = at_index(reach, best), None
            chosen = at_index(u, best)
            margin = top - np.where(u == chosen, -np.inf, reach).max(0)
            drop = None if drops is None else at_index(drops, best)
            found = Highest(chosen, at_index(force, best), drop, None, margin)
        if self.twins is None:
            return found
        return self._twins_too(self.twins, lines, found, top, at_zero)

    def _highest_of_one(self, lines: Lines) -> tuple[Highest, Array | None, Array | None]:
        """Of curves without kinks or inflection, of which a peak inside is the maximum; reaches, and slopes at 0."""
        along, per_fraction = lines.along, lines.per_fraction
        first, rise = self.force[0], self.force[1] - self.force[0]
        climb = per_fraction + along * rise
        up = climb > 0
        margin = np.abs(climb)
        if self.shape is None:
            return Highest(up.astype(climb.dtype), first + rise * up, None, None, margin), None, None
        slope = per_fraction + along * self.rate[0]
        peaks = self.shape.peaks(along, slope, None)
        found = peaks.found
        force = np.where(found, self.base[0] + peaks.force + self.rate[0] * peaks.u, first + rise * up)
        u, drop = np.where(found, peaks.u, up), np.where(found, peaks.drop, np.inf)
        top = along * force + per_fraction * u
        margin = np.where(found, top - along * first - np.maximum(climb, 0), margin)
        return Highest(u, force, drop, None, margin), top, slope

    def _candidates(self, lines: Lines) -> tuple[Array, Array, Array, Array | None]:
        """All corners and peaks (S + J, m, Q): fractions, forces, reaches (-inf: there is none), and drops."""
        along, per_fraction = lines.along, lines.per_fraction
        grid, force = self.grid, self.force
        if grid is None:
            grid = np.zeros_like(force)
            grid[1] = 1
        reach = along * force + per_fraction * grid
        if self.shape is None:
            return grid, force, reach, None
        peaks = self.shape.peaks(along, per_fraction + along * self.rate, self.span)
        there = self.base + peaks.force + self.rate * peaks.u
        further = np.where(peaks.found, along * there + per_fraction * peaks.u, -np.inf)
        drop = np.concatenate((np.full_like(grid, np.inf), peaks.drop))
        return (
            np.concatenate((grid, peaks.u)),
            np.concatenate((force, there)),
            np.concatenate((reach, further)),
            drop,
        )

    def _twins_too(self, twins: Twins, lines: Lines, one: Highest, top: Array | None, slope: Array | None) -> Highest:
        """Put maxima of differences of two powers in place of lower ones; how much higher (m, Q) they may be."""
        assert top is not None
        assert one.drop is not None
        at = twins.at()
        if not len(at[0]):
            return one
        along, per_fraction, rate = lines.along[at], lines.per_fraction[at], self.rate[0][at]
        twin, higher = twins.peaks(at, along, per_fraction + along * rate if slope is None else slope[at])
        force = self.base[0][at] + twin.force + rate * twin.u
        reach = along * force + per_fraction * twin.u
        lead = reach - top[at]
        better = twin.found & (lead > 0)
        for old, new in zip((one.u, one.force, one.drop), (twin.u, force, twin.drop), strict=True):
            old[at] = np.where(better, new, old[at])
        rest = np.zeros_like(top)
        rest[at] = np.where(lead + higher > 0, higher, 0.0)
        one.margin[at] = np.where(twin.found, np.minimum(np.abs(lead), one.margin[at]), one.margin[at])
        return Highest(one.u, one.force, one.drop, rest, one.margin)

    def spread(self, lines: Lines, across: Lines, u: Array, force: Array, slack: Array) -> tuple[Array, ...]:
        """What else is within slack (Q) of maxima: how far (m, Q) along the lines to the right and to the left, the
        fractions there, and the forces.

        Args:
            lines: that touch.
            across: the same turned to the left: places along them.
            u, force: the maxima.
            slack: as a length.
        """
        grid, forces, reach, _ = self._candidates(lines)
        off = reach < lines.along * force + lines.per_fraction * u - slack
        place = across.along * (forces - force) + across.per_fraction * (grid - u)
        right, left = np.where(off, np.inf, place), np.where(off, -np.inf, place)
        first, last = right.argmin(0), left.argmax(0)
        low, high = np.minimum(at_index(right, first), 0), np.maximum(at_index(left, last), 0)
        return (
            low,
            high,
            np.where(low < 0, at_index(grid, first), u),
            np.where(high > 0, at_index(grid, last), u),
            np.where(low < 0, at_index(forces, first), force),
            np.where(high > 0, at_index(forces, last), force),
        )


def arcs(law: Law) -> tuple[Arcs, Array]:
    """The curves of a law at B sections as pieces; and whether (B) they are all there is to them."""
    coefficients = [as_array(value) for value in law.coefficients]
    kinks, slopes, gains = as_array(law.kinks), as_array(law.slopes), as_array(law.gain)
    base = coefficients[0]
    rate = coefficients[1] if len(coefficients) > 1 else np.zeros_like(base)
    holds = np.ones(base.shape[-1], dtype=bool)
    last = sum(coefficients[1:], base) + gains.sum(0)
    grid, force = None, np.stack((base, last))
    if len(kinks):
        force[0] += (slopes * np.maximum(-kinks, 0)).sum(0)
        force[1] += (slopes * np.maximum(1 - kinks, 0)).sum(0)
    inner = ((kinks > 0) & (kinks < 1) & (slopes != 0)).reshape(len(kinks), base.size).any(1)
    if inner.any():
        corners = law.kinks[torch.as_tensor(inner, device=law.kinks.device)].clamp(0, 1)
        grid = np.concatenate((np.zeros_like(force[:1]), as_array(corners), np.ones_like(force[:1])))
        force = np.concatenate((force[:1], as_array(law.force(corners)), force[1:]))
    shape: Cubics | Powers | None = None
    twins = None
    if len(law.gain):
        shape, twins = _powers(gains, as_array(law.exponent))
        bent = (gains != 0).any(0)
    elif len(coefficients) > 2:
        bend, twist = coefficients[2], coefficients[3] if len(coefficients) > 3 else None
        winding = twist is not None and (len(kinks) > 0 or bool((bend * (bend + 3 * twist) < 0).any()))
        shape, bent = Cubics(bend, twist, winding), np.broadcast_to(True, base.shape)
    if shape is None or not len(kinks):
        return Arcs(grid, force, base[None], rate[None], None, shape, twins), holds
    bases, rates, span = _pieces(kinks, slopes, base, rate, bent)
    if twins is not None and span is not None:
        divided = (twins.table[2] != 0) & (span[1][0] < 1)
        holds = ~divided.any(0)
    return Arcs(grid, force, bases, rates, span, shape, twins), holds


def _pieces(kinks: Array, slopes: Array, base: Array, rate: Array, bent: Array) -> tuple[Array, Array, Span]:
    """Lines and spans (J, m, B) of the pieces between kinks, of curves that are bent (m, B)."""
    real = (slopes != 0) & (kinks < 1) & bent
    at = real.any(0).nonzero()
    if not len(at[0]):
        return base[None], rate[None], None
    real, kinks, slopes = (value[:, at[0], at[1]] for value in (real, kinks, slopes))
    ends, slopes = np.where(real, np.maximum(kinks, 0), 1.0), np.where(real, slopes, 0.0)
    place = ends.argsort(0, kind="stable"), np.arange(len(at[0]))
    count = int(real.sum(0).max())
    shifts, slopes, ends = (slopes * kinks)[place].cumsum(0)[:count], slopes[place].cumsum(0)[:count], ends[place]
    bases, rates, begins = (np.empty((count + 1, *base.shape), base.dtype) for _ in range(3))
    bases[:], rates[:], begins[:] = base, rate, 1
    begins[0] = 0
    finishes = np.ones_like(begins)
    bases[1:, at[0], at[1]] -= shifts
    rates[1:, at[0], at[1]] += slopes
    begins[1:, at[0], at[1]] = finishes[:-1, at[0], at[1]] = ends[:count]
    return bases, rates, (begins, finishes)


@np.errstate(all="ignore")
def _powers(gains: Array, exponents: Array) -> tuple[Powers, Twins | None]:
    """The powers of curves that have one, and of those that have two."""
    less = exponents - 1
    some = (gains != 0) & (less > STRAIGHT)
    both = some.all(0)
    if len(gains) == 1:
        both = np.zeros_like(both)
    alone = Powers(
        np.where(both, 0.0, np.where(some, gains, 0.0).sum(0)), np.where(some, less, 0.0).max(0).clip(min=STRAIGHT)
    )
    if not both.any():
        return alone, None
    swap = less[0] > less[1]
    (p, q), (g, h) = (np.where(swap, value[::-1], value) for value in (less, gains))
    ratio = -(g * (1 + p) * p) / (h * (1 + q) * q)
    turn = np.minimum(np.log(ratio) / (q - p), 0)
    turn = np.where((ratio > 0) & np.isfinite(turn), turn, 0.0)
    at_turn = g * (1 + p) * np.exp(p * turn) + h * (1 + q) * np.exp(q * turn)
    table = np.stack((p, q, np.where(both, g, 0.0), h, turn, at_turn, g * (1 + p) + h * (1 + q)))
    return alone, Twins(table, np.ones_like(g))
