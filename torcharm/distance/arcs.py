"""Curves that are written out, as arcs between corners: where lines touch them."""

from dataclasses import dataclass

import numpy as np

from torcharm._arrays import Array
from torcharm.distance.shapes import Cubics, Powers, Span, Twins, at_index, first_highest
from torcharm.laws import STRAIGHT, Law


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
class _Candidates:
    """Places on curves (C, m, Q) that may be maxima: fractions, forces, and reaches (-inf: there is none)."""

    u: Array
    force: Array
    reach: Array


def _others(candidates: _Candidates, u: Array) -> Array:
    """How far (m, Q) they reach elsewhere than at fractions u."""
    best: Array = np.where(candidates.u == u, -np.inf, candidates.reach).max(0)
    return best


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
            found, top = self._highest_of_all(lines)
            at_zero = None
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

    def _highest_of_all(self, lines: Lines) -> tuple[Highest, Array]:
        """Of all corners and peaks; and reaches."""
        corners, peaks, drops = self._candidates(lines)
        best = first_highest(corners.reach)
        u, force, top = (at_index(value, best) for value in (corners.u, corners.force, corners.reach))
        if peaks is None or drops is None:
            return Highest(u, force, None, None, top - _others(corners, u)), top
        best = first_highest(peaks.reach)
        high, there, peak, drop = (at_index(value, best) for value in (peaks.u, peaks.force, peaks.reach, drops))
        further = (peak > top) | np.isnan(peak)
        u, force, top = np.where(further, high, u), np.where(further, there, force), np.where(further, peak, top)
        margin = top - np.maximum(_others(corners, u), _others(peaks, u))
        return Highest(u, force, np.where(further, drop, np.inf), None, margin), top

    def _candidates(self, lines: Lines) -> tuple[_Candidates, _Candidates | None, Array | None]:
        """All corners (S, m, Q); if there are any, all peaks (J, m, Q) and their drops."""
        along, per_fraction = lines.along, lines.per_fraction
        grid, force = self.grid, self.force
        if grid is None:
            grid = np.zeros_like(force)
            grid[1] = 1
        reach = along * force
        reach += per_fraction * grid
        corners = _Candidates(grid, force, reach)
        if self.shape is None:
            return corners, None, None
        peaks = self.shape.peaks(along, per_fraction + along * self.rate, self.span)
        there = self.rate * peaks.u
        there += self.base
        there += peaks.force
        further = np.where(peaks.found, along * there + per_fraction * peaks.u, -np.inf)
        return corners, _Candidates(peaks.u, there, further), peaks.drop

    def _twins_too(self, twins: Twins, lines: Lines, one: Highest, top: Array | None, slope: Array | None) -> Highest:
        """Put maxima of differences of two powers in place of lower ones; how much higher (m, Q) they may be."""
        assert top is not None
        assert one.drop is not None
        at = twins.at()
        if not len(at[0]):
            return one
        along, rate = lines.along[at], self.rate[0][at]
        sloped = lines.per_fraction[at] + along * rate if slope is None else slope[at]
        found, twin, higher = twins.peaks(at, along, sloped)
        rest = np.zeros_like(top)
        if not len(found):
            return Highest(one.u, one.force, one.drop, rest, one.margin)
        at = at[0][found], at[1][found]
        force = self.base[0][at] + twin.force + rate[found] * twin.u
        lead = lines.along[at] * force + lines.per_fraction[at] * twin.u - top[at]
        better = twin.found & (lead > 0)
        for old, new in zip((one.u, one.force, one.drop), (twin.u, force, twin.drop), strict=True):
            old[at] = np.where(better, new, old[at])
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
        corners, peaks, _ = self._candidates(lines)
        grid, forces, reach = corners.u, corners.force, corners.reach
        if peaks is not None:
            grid, forces, reach = (
                np.concatenate(pair) for pair in ((grid, peaks.u), (forces, peaks.force), (reach, peaks.reach))
            )
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
    coefficients, kinks, slopes, gains = law.coefficients, law.kinks, law.slopes, law.gain
    base = coefficients[0]
    rate = coefficients[1] if len(coefficients) > 1 else np.zeros_like(base)
    if len(gains):  # powers that are lines
        rate = rate + np.where(law.exponent - 1 > STRAIGHT, 0.0, gains).sum(0)
    holds = np.ones(base.shape[-1], dtype=bool)
    last = sum(coefficients[1:], base) + gains.sum(0)
    grid, force = None, np.stack((base, last))
    if len(kinks):
        force[0] += (slopes * np.maximum(-kinks, 0)).sum(0)
        force[1] += (slopes * np.maximum(1 - kinks, 0)).sum(0)
    inner = ((kinks > 0) & (kinks < 1) & (slopes != 0)).reshape(len(kinks), base.size).any(1)
    if inner.any():
        corners = kinks[inner].clip(0, 1)
        grid = np.concatenate((np.zeros_like(force[:1]), corners, np.ones_like(force[:1])))
        force = np.concatenate((force[:1], law.force(corners), force[1:]))
    shape: Cubics | Powers | None = None
    twins = None
    if len(law.gain):
        shape, twins = _powers(gains, law.exponent)
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
    at = real.any(0).reshape(-1).nonzero()[0]
    if not len(at):
        return base[None], rate[None], None
    real, kinks, slopes = (value.reshape(len(value), base.size).take(at, -1) for value in (real, kinks, slopes))
    ends, slopes = np.where(real, np.maximum(kinks, 0), 1.0), np.where(real, slopes, 0.0)
    place = (ends.argsort(0, kind="stable") * len(at) + np.arange(len(at)))[: real.sum(0).max()]
    shifts, slopes, ends = (value.reshape(-1).take(place) for value in (slopes * kinks, slopes, ends))
    bases, rates, begins, finishes = (np.empty((len(place) + 1, base.size), base.dtype) for _ in range(4))
    bases[:], rates[:], begins[0], begins[1:], finishes[:] = base.reshape(-1), rate.reshape(-1), 0, 1, 1
    bases[1:, at] -= shifts.cumsum(0)
    rates[1:, at] += slopes.cumsum(0)
    begins[1:, at] = finishes[:-1, at] = ends
    bases, rates, begins, finishes = (value.reshape(-1, *base.shape) for value in (bases, rates, begins, finishes))
    return bases, rates, (begins, finishes)


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
    at = both.reshape(-1).nonzero()[0]
    if not len(at):
        return alone, None
    less, gains = (value.reshape(2, both.size).take(at, -1) for value in (less, gains))
    swap = less[0] > less[1]
    (p, q), (g, h) = (np.where(swap, value[::-1], value) for value in (less, gains))
    ratio = -(g * (1 + p) * p) / (h * (1 + q) * q)
    turn = np.minimum(np.log(ratio) / (q - p), 0)
    turn = np.where((ratio > 0) & np.isfinite(turn), turn, 0.0)
    at_turn = g * (1 + p) * np.exp(p * turn) + h * (1 + q) * np.exp(q * turn)
    table = np.zeros((7, both.size), g.dtype)
    table[:, at] = np.stack((p, q, g, h, turn, at_turn, g * (1 + p) + h * (1 + q)))
    return alone, Twins(table.reshape(7, *both.shape), np.ones(both.shape, g.dtype))
