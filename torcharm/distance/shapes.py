"""What curves that are written out bend by: their maxima along normals.

A force is a cubic in pressure, or a line and a power: its maximum along a normal is a root of a quadratic, or a power.
Where a curve is the difference of two powers Newton's method finds it, from a side on which it cannot overshoot.

All in NumPy: what is left to search for is soon so little that calls cost more than arithmetic, and NumPy's are cheap.
"""

from dataclasses import dataclass

import numpy as np

from torcharm._arrays import Array, pick
from torcharm.laws import LEAST

FLAT = 256.0
"""Roundings of its slope by which a curve may bend and count as straight: its peak would be anywhere."""
STEPS, MORE_STEPS, MOST_STEPS = 5, 2, 20
"""Newton's on a difference of two powers: from afar, from where the last ones led, and at most."""
NEAR = 1e-4
"""By how much the logarithm of a fraction may still change when the next step would square that."""
FLOOR = -69.0
"""The logarithm of a fraction as good as none."""
MANY = 8192
"""From so many numbers on passes over them cost more than calls."""
BETWEEN = (0.3, 0.7)
"""Fractions that stand for a power's curve."""

Span = tuple[Array, Array] | None


def _within(u: Array, span: Span) -> Array:
    inside: Array = (u > 0) & (u < 1) if span is None else (u > span[0]) & (u < span[1])
    return inside


def at_index(values: Array, index: Array) -> Array:
    """Of values (S, m, Q) those (m, Q) at an index along the first dimension."""
    if len(values) == 1:
        return values[0]
    flat = index * index.size
    flat += np.arange(index.size).reshape(index.shape)
    chosen: Array = values.reshape(-1).take(flat)
    return chosen


def first_highest(values: Array) -> Array:
    """Where along the first dimension values (S, m, Q) are highest, first; as argmax, faster of many."""
    if values.size < MANY or not 1 < len(values) < 256:
        return values.argmax(0)
    top = values.max(0)
    if np.isnan(top.sum()):
        return values.argmax(0)
    rows = len(values)
    places = np.arange(rows, 0, -1, dtype=np.uint8).reshape(-1, 1, 1)
    places = places * (values == top)
    return rows - places.max(0).astype(np.intp)


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
        inside = (share > 0) & (share < 1) & (fall > 0)
        if share.size < MANY:
            u = np.exp(np.log(share) / self.less)
        else:  # powers cost more than finding out where they are needed
            u = np.zeros(share.shape, share.dtype)
            at = inside.reshape(-1).nonzero()[0]
            less = self.less.reshape(-1).take(at % self.less.size)
            u.reshape(-1)[at] = np.exp(np.log(share.reshape(-1).take(at)) / less)
        return Peaks(u, self.gain * share * u, self.less * slope / u, _within(u, span) & inside)

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
        table: (7, m, Q) p, q, g, h, the logarithm of the turning point (1 at most), and there and at 1 the slope;
            0 for other curves.
        latest: (m, Q) logarithms of the fractions last found, 1 if none: a search's own, see `CurveSums.afresh`.
    """

    table: Array
    latest: Array

    def between(self) -> Array:
        """Of `Powers.between`, how far from their chords."""
        p, q, g, h = self.table[:4]
        return np.stack([g * _bow(share, p) + h * _bow(share, q) for share in BETWEEN])

    def at(self) -> tuple[Array, Array]:
        """Which of m Q curves they are; gains of others are 0."""
        return self.table[2].nonzero()

    def peaks(self, at: tuple[Array, Array], along: Array, slope: Array) -> tuple[Array, Peaks, Array]:
        """Which (f) of curves of slopes (n) at fraction 0 have local maxima, these, and how much higher they may be."""
        p, q, g, h, turn, at_turn, at_end = table = self.table[:, at[0], at[1]]
        before = along * g < 0
        middle, end = slope + along * at_turn, slope + along * at_end
        there = np.where(before, (slope > 0) & (middle < 0), (middle > 0) & (end < 0))
        latest = self.latest[at]
        self.latest[at] = 1.0
        which = there.nonzero()[0]
        if not len(which):
            none = slope[which]
            return which, Peaks(none, none, none, there[which]), none
        at = at[0][which], at[1][which]
        table, along, slope, before, latest = pick((table, along, slope, before, latest), which)
        p, q, g, h, turn = table[:5]
        a, b = along * g * (1 + p), along * h * (1 + q)
        less = np.where(before, p, q)
        low, high = np.where(before, FLOOR, turn), np.where(before, turn, 0.0)
        known = (latest > low) & (latest < high)
        t = np.where(known, latest, np.where(before, np.log(slope / -a) / p, 0.0))

        def slopes() -> tuple[Array, Array, Array, Array]:
            """At fractions of logarithms t the slopes, their derivatives in t, and both powers of the fractions."""
            first, second = np.exp(p * t), np.exp(q * t)
            one, two = a * first, b * second
            return slope + one + two, p * one + q * two, first, second

        fewest = MORE_STEPS if known.all() else STEPS
        for count in range(MOST_STEPS):
            miss, fall, _, _ = slopes()
            step = np.log(np.maximum(1 - less * miss / fall, 1e-6)) / less
            last, t = t, np.minimum(np.maximum(t + step, low), high)
            if count + 1 >= fewest and not (np.abs(t - last) > NEAR).any():
                break
        miss, fall, first, second = slopes()
        u = np.exp(t)
        drop = -fall / u
        rest = np.where(drop > 0, miss * miss / (2 * drop), np.inf)
        found = drop > 0
        self.latest[at] = np.where(found, t, 1.0)
        return which, Peaks(u, (g * first + h * second) * u, drop, found), rest
