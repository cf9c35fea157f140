"""Pressure curves of actuators as cubic pieces, and how far they reach along a direction.

An actuator at a node provides the wrenches `f(p) u + p t` over the pressures of its limits. The graph (p, f) is cut
into pieces on each of which f is a cubic, held by its four Bézier coefficients: a piece lies in the convex hull of its
control points, which tells at a glance that it cannot reach furthest. Where a force that the engine knows is no cubic,
pieces tell where to look, and Newton's method finds the place on the force itself.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from torcharm.engine.compilation import part
from torcharm.engine.forces import (
    POLYNOMIAL,
    STRETCHED_FROM,
    Models,
    force_by_pressure,
    muscle,
    muscle_corners,
    polynomial_row,
)
from torcharm.engine.references import by_reference

Array = np.ndarray[Any, Any]

MUSCLE_PIECES = 8
"""Pieces of the power of pressure with which a stretched muscle pulls: good to 1e-4 of its pull."""
MUSCLE_OFF = 1e-3
"""More than a muscle's pieces are off, as a part of its pull, up to strains of 0.6."""
MUSCLE_GRADING = 3.6
"""Pieces end at pressures `(k / MUSCLE_PIECES) ** MUSCLE_GRADING` of the limit: each is then as far from a cubic."""
NO_PRESSURE = 1e-30
"""A pressure [kPa] that is as good as none, whose logarithm is a number."""
GRADES = tuple((k / MUSCLE_PIECES) ** MUSCLE_GRADING for k in range(MUSCLE_PIECES + 1))
LOG_GRADES = tuple(math.log(max(grade, NO_PRESSURE)) for grade in GRADES)
HIGH_DEGREE_PIECES = 8
"""Pieces of a polynomial of more than the third degree in pressure."""
NEWTON_STEPS = 40
"""Steps to the place on a force itself at most: 2 or 3 are usual."""
SETTLED = 1e-10
"""By this part of the limit a last step may still move a pressure: its square counts."""


@by_reference
class Curves(NamedTuple):
    """The curves of M actuators at one node, of at most K pieces each.

    Attributes:
        pieces: (M,) how many each has.
        side: (M,) as of `sides`.
        edge: (M, K + 1) pressures at which pieces begin and end [kPa].
        control: (M, K, 4) Bézier coefficients of the forces [N].
        lever: (M, D) u, the wrench of a force of 1 N.
        bending: (M, D - 1) t, the moments of a pressure of 1 kPa.
        off: (M,) more than the pieces are off the forces that the engine knows [N]; 0 where they are these.
        strain: (M, 2) the actuators' strains, here and, of differences, at the first node.
        terms: (1,) 1, or 2 for differences.
        row: room for a polynomial.
        models: whose forces they are.
    """

    pieces: Array
    side: Array
    edge: Array
    control: Array
    lever: Array
    bending: Array
    off: Array
    strain: Array
    terms: Array
    row: Array
    models: Models


def make_curves(models: Models, dimension: int, pieces: int, terms: int = 1) -> Curves:
    """Room for the curves of one node, or, of two terms, for differences of curves."""
    actuators = len(models.kind)
    return Curves(
        np.zeros(actuators, np.int64),
        np.zeros(actuators, np.int64),
        np.zeros((actuators, pieces + 1)),
        np.zeros((actuators, pieces, 4)),
        np.zeros((actuators, dimension)),
        np.zeros((actuators, dimension - 1)),
        np.zeros(actuators),
        np.zeros((actuators, 2)),
        np.array([terms]),
        np.zeros(max(4, models.table.shape[1])),
        models,
    )


def most_pieces(models: Models, sampled: int) -> int:
    """How many pieces a curve may have, where those sampled by torch have so many."""
    return max(MUSCLE_PIECES, HIGH_DEGREE_PIECES, sampled)


@part
def write_piece(curves, a, k, high, force_low, slope_low, force_high, slope_high):  # type: ignore[no-untyped-def]
    """Write piece k, from where the last one ended to `high` [kPa], by forces [N] and slopes [N/kPa] at its ends."""
    third = (high - curves.edge[a, k]) / 3.0
    curves.control[a, k, 0] = force_low
    curves.control[a, k, 1] = force_low + third * slope_low
    curves.control[a, k, 2] = force_high - third * slope_high
    curves.control[a, k, 3] = force_high
    curves.edge[a, k + 1] = high


@part
def write_polynomial(curves, a, strain, limit):  # type: ignore[no-untyped-def]
    """The pieces of a polynomial force. Up to the third degree in pressure one piece is the force itself."""
    row = curves.row
    degree = polynomial_row(curves.models, a, strain, row)
    pieces = 1 if degree <= 3 else HIGH_DEGREE_PIECES
    fourth = 0.0
    for j in range(degree, 3, -1):
        fourth = fourth * limit + j * (j - 1) * (j - 2) * (j - 3) * abs(row[j])
    curves.off[a] = fourth * (limit / pieces) ** 4 / 384.0
    curves.edge[a, 0] = 0.0
    force_low, slope_low = row[0], row[1]
    for k in range(pieces):
        high = limit * (k + 1) / pieces
        force_high, slope_high = row[degree], 0.0
        for j in range(degree - 1, -1, -1):
            slope_high = slope_high * high + force_high
            force_high = force_high * high + row[j]
        write_piece(curves, a, k, high, force_low, slope_low, force_high, slope_high)
        force_low, slope_low = force_high, slope_high
    curves.pieces[a] = pieces


@part
def write_muscle(curves, a, scale, strain, limit):  # type: ignore[no-untyped-def]
    """The pieces of a McKibben muscle's force: lines between corners where it is contracted, else graded cubics."""
    curves.edge[a, 0] = 0.0
    if strain >= STRETCHED_FROM:
        log_limit = math.log(max(limit, NO_PRESSURE))
        force_low, slope_low = 0.0, 0.0
        for k in range(MUSCLE_PIECES + 1):
            force, _, slope = muscle(strain, limit * GRADES[k], log_limit + LOG_GRADES[k])
            force, slope = -scale * force, -scale * slope
            if k > 0:
                write_piece(curves, a, k - 1, limit * GRADES[k], force_low, slope_low, force, slope)
            force_low, slope_low = force, slope
        curves.pieces[a] = MUSCLE_PIECES
        curves.off[a] = MUSCLE_OFF * limit * abs(slope_low)
        return
    onset, pull = muscle_corners(strain)
    pieces, low = 0, 0.0
    for k in range(3):
        high = limit if k == 2 else min(max(onset if k == 0 else pull, 0.0), limit)
        if high > low or (k == 2 and pieces == 0):
            force, _, slope = muscle(strain, 0.5 * (low + high), 0.0)
            force, slope = -scale * force, -scale * slope
            rise = 0.5 * (high - low) * slope
            write_piece(curves, a, pieces, high, force - rise, slope, force + rise, slope)
            pieces += 1
            low = high
    curves.pieces[a] = pieces


@part
def write_curve(curves, a, strain, limit, sampled):  # type: ignore[no-untyped-def]
    """The pieces of actuator a, by its own force model.

    Args:
        sampled: (K, 6) pieces that torch has sampled, of models that the engine does not know: where each begins and
            ends, and the forces and slopes at its ends.
    """
    curves.strain[a, 0], curves.off[a] = strain, 0.0
    if curves.models.kind[a] == POLYNOMIAL:
        write_polynomial(curves, a, strain, limit)
    elif curves.models.kind[a] > POLYNOMIAL:
        write_muscle(curves, a, curves.models.scale[a], strain, limit)
    else:
        curves.edge[a, 0] = sampled[0, 0]
        for k in range(len(sampled)):
            write_piece(curves, a, k, sampled[k, 1], sampled[k, 2], sampled[k, 3], sampled[k, 4], sampled[k, 5])
        curves.pieces[a] = len(sampled)


@part
def _mix(b0, b1, b2, s, t):  # type: ignore[no-untyped-def]
    """The blossom of a quadratic at s and t."""
    c0, c1 = b0 + s * (b1 - b0), b1 + s * (b2 - b1)
    return c0 + t * (c1 - c0)


@part
def cut(curves, a, k, start, end):  # type: ignore[no-untyped-def]
    """The coefficients of the part [start, end] of a piece, by its blossom: none, one, two, all arguments the end."""
    c0, c1, c2, c3 = curves.control[a, k, 0], curves.control[a, k, 1], curves.control[a, k, 2], curves.control[a, k, 3]
    low, high = curves.edge[a, k], curves.edge[a, k + 1]
    if start == low and end == high:
        return c0, c1, c2, c3
    if curves.off[a] > 0.0:  # of a force without kinks: by itself, so that the ends are where the force is
        third = (end - start) / 3.0
        f0, s0, _ = force_by_pressure(curves.models, a, curves.strain[a, 0], start, curves.row)
        f3, s3, _ = force_by_pressure(curves.models, a, curves.strain[a, 0], end, curves.row)
        return f0, f0 + third * s0, f3 - third * s3, f3
    s, t = (start - low) / (high - low), (end - low) / (high - low)
    d0, d1, d2 = c0 + s * (c1 - c0), c1 + s * (c2 - c1), c2 + s * (c3 - c2)
    e0, e1, e2 = c0 + t * (c1 - c0), c1 + t * (c2 - c1), c2 + t * (c3 - c2)
    return _mix(d0, d1, d2, s, s), _mix(d0, d1, d2, s, t), _mix(d0, d1, d2, t, t), _mix(e0, e1, e2, t, t)


@part
def write_difference(out, a, own, first):  # type: ignore[no-untyped-def]
    """The pieces of an actuator's curve less those of the same actuator at the first node, at equal pressures."""
    i, j, pieces = 0, 0, 0
    low = own.edge[a, 0]
    out.edge[a, 0] = low
    while i < own.pieces[a] and j < first.pieces[a]:
        own_end, first_end = own.edge[a, i + 1], first.edge[a, j + 1]
        high = min(own_end, first_end)
        if high > low or (pieces == 0 and high == own.edge[a, own.pieces[a]]):
            c0, c1, c2, c3 = cut(own, a, i, low, high)
            f0, f1, f2, f3 = cut(first, a, j, low, high)
            out.control[a, pieces, 0], out.control[a, pieces, 1] = c0 - f0, c1 - f1
            out.control[a, pieces, 2], out.control[a, pieces, 3] = c2 - f2, c3 - f3
            pieces += 1
            out.edge[a, pieces] = high
            low = high
        if own_end <= high:
            i += 1
        if first_end <= high:
            j += 1
    out.pieces[a], out.off[a] = pieces, own.off[a] + first.off[a]
    out.strain[a, 0], out.strain[a, 1] = own.strain[a, 0], first.strain[a, 0]
    for c in range(out.bending.shape[1]):
        out.bending[a, c] = own.bending[a, c] - first.bending[a, c]
        out.lever[a, c] = own.lever[a, c]
    out.lever[a, out.bending.shape[1]] = own.lever[a, out.bending.shape[1]]


@part
def copy_curve(out, a, own):  # type: ignore[no-untyped-def]
    """Keep an actuator's curve."""
    out.pieces[a], out.edge[a, 0] = own.pieces[a], own.edge[a, 0]
    out.off[a], out.strain[a, 0] = own.off[a], own.strain[a, 0]
    for k in range(own.pieces[a]):
        out.edge[a, k + 1] = own.edge[a, k + 1]
        for j in range(4):
            out.control[a, k, j] = own.control[a, k, j]
    for c in range(own.bending.shape[1]):
        out.bending[a, c] = own.bending[a, c]


@part
def sides(curves, a):  # type: ignore[no-untyped-def]
    """Whether any control point lies above the curve's chord, and whether any lies below: 1 and 2, added.

    Where none is on the side that a direction points to, the curve reaches furthest at one of its ends.
    """
    last = curves.pieces[a]
    start, first = curves.edge[a, 0], curves.control[a, 0, 0]
    span = curves.edge[a, last] - start
    slope = (curves.control[a, last - 1, 3] - first) / span if span > 0.0 else 0.0
    above = below = 0
    for k in range(last):
        third = (curves.edge[a, k + 1] - curves.edge[a, k]) / 3.0
        for j in range(4):
            off = curves.control[a, k, j] - first - slope * (curves.edge[a, k] + j * third - start)
            if off > 0.0:
                above = 1
            elif off < 0.0:
                below = 2
    return above + below


@part
def exact_force(curves, a, p):  # type: ignore[no-untyped-def]
    """The force of a curve at a pressure, and its two derivatives, by the model itself."""
    force, slope, bend = force_by_pressure(curves.models, a, curves.strain[a, 0], p, curves.row)
    if curves.terms[0] == 2:
        less, less_slope, less_bend = force_by_pressure(curves.models, a, curves.strain[a, 1], p, curves.row)
        force, slope, bend = force - less, slope - less_slope, bend - less_bend
    return force, slope, bend


@part
def settle(curves, a, by_force, by_pressure, k, p):  # type: ignore[no-untyped-def]
    """From a pressure within piece k go to where g is largest by the force itself; also the force and -g'' there.

    Newton's method, and half of what is left where that would leave the place at which the slope of g falls through 0.
    """
    low, high = curves.edge[a, k], curves.edge[a, k + 1]
    close = SETTLED * high
    force, slope, bend = exact_force(curves, a, p)
    for _ in range(NEWTON_STEPS):
        rise, fall, last = by_force * slope + by_pressure, -by_force * bend, p
        low, high = (p, high) if rise > 0.0 else (low, p)
        p += rise / fall if fall > 0.0 else 0.0
        p = p if low < p < high else 0.5 * (low + high)
        force, slope, bend = exact_force(curves, a, p)
        if abs(p - last) <= close:
            break
    return p, force, max(-by_force * bend, 0.0)


@part
def furthest(curves, a, by_force, by_pressure):  # type: ignore[no-untyped-def]
    """The pressure p and force f of a curve that make `g = by_force f + by_pressure p` largest, and -g'' there.

    At an end of a piece, where a small turn of the direction does not move the maximum, the last is 0.
    """
    last = curves.pieces[a]
    if curves.side[a] & (1 if by_force > 0.0 else 2) == 0:
        start, end = curves.control[a, 0, 0], curves.control[a, last - 1, 3]
        if by_force * start + by_pressure * curves.edge[a, 0] >= by_force * end + by_pressure * curves.edge[a, last]:
            return curves.edge[a, 0], start, 0.0
        return curves.edge[a, last], end, 0.0
    low = curves.edge[a, 0]
    at, force, fall = low, curves.control[a, 0, 0], 0.0
    best, slack = by_force * force + by_pressure * low, abs(by_force) * curves.off[a]
    for k in range(last):
        high = curves.edge[a, k + 1]
        third = (high - low) / 3.0
        f0, f1, f2, f3 = (
            curves.control[a, k, 0],
            curves.control[a, k, 1],
            curves.control[a, k, 2],
            curves.control[a, k, 3],
        )
        g0, g1 = by_force * f0 + by_pressure * low, by_force * f1 + by_pressure * (low + third)
        g2, g3 = by_force * f2 + by_pressure * (high - third), by_force * f3 + by_pressure * high
        if g0 > best:
            best, at, force, fall = g0, low, f0, 0.0
        if g3 > best:
            best, at, force, fall = g3, high, f3, 0.0
        if g1 > best - slack or g2 > best - slack:
            # Of the slope `q t² + 2 b t + c`, a quadratic over t from 0 to 1, the root at which it falls through 0.
            c = g1 - g0
            b = g2 - g1 - c
            q = g3 - g2 - (g2 - g1) - b
            square = b * b - q * c
            if square > 0.0:
                root, t = math.sqrt(square), -1.0
                if b <= 0.0:
                    t = c / (root - b)
                elif q < 0.0:
                    t = -(b + root) / q
                if 0.0 < t < 1.0:
                    s, p = 1.0 - t, low + t * (high - low)
                    f = s * s * (s * f0 + 3.0 * t * f1) + t * t * (3.0 * s * f2 + t * f3)
                    down = 6.0 * root / ((high - low) * (high - low))
                    if slack > 0.0:
                        p, f, down = settle(curves, a, by_force, by_pressure, k, p)
                    g = by_force * f + by_pressure * p
                    if g > best:
                        best, at, force, fall = g, p, f, down
        low = high
    return at, force, fall


@part
def step_nearby(curves, a, by_force, by_pressure, p):  # type: ignore[no-untyped-def]
    """From a pressure one Newton step to where `g = by_force f + by_pressure p` is largest nearby; f and -g'' there.

    Pressures at ends of pieces stay, and their -g'' is 0.
    """
    last = curves.pieces[a]
    k = 0
    while k < last - 1 and p > curves.edge[a, k + 1]:
        k += 1
    low, high = curves.edge[a, k], curves.edge[a, k + 1]
    if not low < p < high:
        return p, curves.control[a, k, 3 if p >= high and high > low else 0], 0.0
    force, slope, bend = smooth_force(curves, a, k, p)
    fall = -by_force * bend
    if not fall > 0.0:
        return p, force, 0.0
    there = p + (by_force * slope + by_pressure) / fall
    if not low < there < high:
        return p, force, fall
    force, _, bend = smooth_force(curves, a, k, there)
    return there, force, max(-by_force * bend, 0.0)


@part
def smooth_force(curves, a, k, p):  # type: ignore[no-untyped-def]
    """The force of a curve at a pressure within piece k, and its two derivatives."""
    if curves.off[a] > 0.0:
        return exact_force(curves, a, p)
    low, width = curves.edge[a, k], curves.edge[a, k + 1] - curves.edge[a, k]
    t = (p - low) / width
    s = 1.0 - t
    f0, f1, f2, f3 = curves.control[a, k, 0], curves.control[a, k, 1], curves.control[a, k, 2], curves.control[a, k, 3]
    force = s * s * (s * f0 + 3.0 * t * f1) + t * t * (3.0 * s * f2 + t * f3)
    slope = 3.0 * (s * s * (f1 - f0) + 2.0 * s * t * (f2 - f1) + t * t * (f3 - f2)) / width
    bend = 6.0 * (s * (f2 - 2.0 * f1 + f0) + t * (f3 - 2.0 * f2 + f1)) / (width * width)
    return force, slope, bend
