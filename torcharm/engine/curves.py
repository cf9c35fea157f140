"""Pressure curves of actuators as cubic pieces.

An actuator at a node provides the wrenches `f(p) u + p t` over the pressures of its limits. The graph (p, f) is cut
into pieces on each of which f is a cubic, held by its four Bézier coefficients: a piece lies in the convex hull of its
control points, which tells at a glance that it cannot reach furthest.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from torcharm.engine.arrays import Array, make
from torcharm.engine.compilation import part
from torcharm.engine.copies import copy_row
from torcharm.engine.forces import (
    POLYNOMIAL,
    STRETCHED_FROM,
    Models,
    force_by_pressure,
    muscle,
    muscle_corners,
    muscle_power,
    polynomial_row,
)
from torcharm.engine.references import by_reference

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


@by_reference
class Curves(NamedTuple):
    """The curves of M actuators at one node, of at most K pieces each."""

    pieces: Int64[Array, "M"]  # how many each has
    side: Int64[Array, "M"]  # as of `sides`
    edge: Float64[Array, "M K+1"]  # pressures at which pieces begin and end [kPa]
    control: Float64[Array, "M K 4"]  # Bézier coefficients of the forces [N]
    lever: Float64[Array, "M D"]  # u, the wrench of a force of 1 N
    bending: Float64[Array, "M D-1"]  # t, the moments of a pressure of 1 kPa
    off: Float64[Array, "M"]  # more than pieces are off the forces that the engine knows [N]; 0 where they are these
    power: Float64[Array, "M 2"]  # k of `f(0) + c p^(1 + k)` in one piece, 0 of others; the slope at the limit [N/kPa]
    strain: Float64[Array, "M 2"]  # the actuators' strains, here and, of differences, at the first node
    terms: Int64[Array, "1"]  # 1, or 2 for differences
    row: Float64[Array, "J"]  # scratch of a polynomial
    models: Models  # whose forces they are


@by_reference
class Samples(NamedTuple):
    """Pieces of the curves of M actuators that torch has sampled, of models that the engine does not know."""

    pieces: Float64[Array, "R K 6"]  # where each begins and ends [kPa], the force [N] and slope [N/kPa] there
    grid: Float64[Array, "R"]  # at which strains, in order; of no meaning where each curve has its own
    start: Int64[Array, "M"]  # the first of an actuator's own of the R
    strains: Int64[Array, "M"]  # how many of them there are to interpolate between; 0 where each curve has its own
    rest: Float64[Array, "Q"]  # forces at no pressure of the curves that are interpolated [N]
    first_rest: Int64[Array, "M"]  # the first of an actuator's own of the Q


def make_curves(models: Models, dimension: int, pieces: int, terms: int = 1) -> Curves:
    """Scratch of the curves of one node, or, of two terms, for differences of curves."""
    sizes = {"M": len(models.kind), "D": dimension, "K": pieces, "J": max(4, models.table.shape[1])}
    return make(Curves, sizes, terms=np.array([terms]), models=models)


def most_pieces(samples: Samples) -> int:
    """How many pieces a curve may have."""
    return max(MUSCLE_PIECES, HIGH_DEGREE_PIECES, samples.pieces.shape[1])


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
def write_muscle(curves, a, scale, strain, limit, whole):  # type: ignore[no-untyped-def]
    """The pieces of a McKibben muscle's force: lines between corners where it is contracted, else graded cubics.

    Args:
        whole: whether the curve of a stretched muscle is one piece: its power tells how far it reaches.
    """
    curves.edge[a, 0] = 0.0
    if strain >= STRETCHED_FROM:
        log_limit, stride = math.log(max(limit, NO_PRESSURE)), MUSCLE_PIECES if whole else 1
        force_low, slope_low = 0.0, 0.0
        for k in range(0, MUSCLE_PIECES + 1, stride):
            force, _, slope = muscle(strain, limit * GRADES[k], log_limit + LOG_GRADES[k])
            force, slope = -scale * force, -scale * slope
            if k > 0:
                write_piece(curves, a, k // stride - 1, limit * GRADES[k], force_low, slope_low, force, slope)
            force_low, slope_low = force, slope
        curves.pieces[a] = MUSCLE_PIECES // stride
        curves.power[a, 0] = muscle_power(strain) if whole and limit > 0.0 else 0.0
        curves.power[a, 1] = slope_low
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
def write_sampled(curves, a, strain, limit, samples, number):  # type: ignore[no-untyped-def]
    """The pieces of a sampled force: of the curve's own number, or by a cubic through those at four strains around."""
    row, w0, w1, w2, w3, shift = samples.start[a] + number, 1.0, 0.0, 0.0, 0.0, 0.0
    if samples.strains[a] > 0:
        row = samples.start[a] + _row_before(samples, a, strain)
        x0, x1, x2, x3 = samples.grid[row], samples.grid[row + 1], samples.grid[row + 2], samples.grid[row + 3]
        d0, d1, d2, d3 = strain - x0, strain - x1, strain - x2, strain - x3
        w0 = d1 * d2 * d3 / ((x0 - x1) * (x0 - x2) * (x0 - x3))
        w1 = d0 * d2 * d3 / ((x1 - x0) * (x1 - x2) * (x1 - x3))
        w2 = d0 * d1 * d3 / ((x2 - x0) * (x2 - x1) * (x2 - x3))
        w3 = d0 * d1 * d2 / ((x3 - x0) * (x3 - x1) * (x3 - x2))
        shift = samples.rest[samples.first_rest[a] + number] - _blend(samples.pieces, row, 0, 2, w0, w1, w2, w3)
    curves.edge[a, 0], pieces = 0.0, 0
    for k in range(samples.pieces.shape[1]):
        low, high = curves.edge[a, k], _blend(samples.pieces, row, k, 1, w0, w1, w2, w3)
        f0, s0 = _blend(samples.pieces, row, k, 2, w0, w1, w2, w3), _blend(samples.pieces, row, k, 3, w0, w1, w2, w3)
        f1, s1 = _blend(samples.pieces, row, k, 4, w0, w1, w2, w3), _blend(samples.pieces, row, k, 5, w0, w1, w2, w3)
        write_piece(curves, a, k, max(high, low), f0 + shift, s0, f1 + shift, s1)
        pieces += 1
        if high > limit:  # the rest is beyond it
            c0, c1, c2, c3 = cut(curves, a, k, low, limit)
            curves.control[a, k, 0], curves.control[a, k, 1] = c0, c1
            curves.control[a, k, 2], curves.control[a, k, 3] = c2, c3
        if high >= limit:
            break
    curves.edge[a, pieces], curves.pieces[a] = limit, pieces


@part
def _row_before(samples, a, strain):  # type: ignore[no-untyped-def]
    """The first of four strains of an actuator's grid with the given one between the middle ones, but at the ends."""
    first, last = 0, samples.strains[a] - 1
    while last - first > 1:
        k = (first + last) // 2
        first, last = (k, last) if samples.grid[samples.start[a] + k] <= strain else (first, k)
    return min(max(first - 1, 0), samples.strains[a] - 4)


@part
def _blend(pieces, row, k, column, w0, w1, w2, w3):  # type: ignore[no-untyped-def]
    """A number of four neighbours, each with a weight."""
    value = w0 * pieces[row, k, column]
    if w0 != 1.0:
        value += w1 * pieces[row + 1, k, column] + w2 * pieces[row + 2, k, column] + w3 * pieces[row + 3, k, column]
    return value


@part
def write_curve(curves, a, strain, limit, samples, number, whole):  # type: ignore[no-untyped-def]
    """The pieces of actuator a, by its own force model.

    Args:
        samples: of the models that the engine does not know.
        number: which of the curves of this actuator it is, where each has its own samples.
        whole: whether it is asked how far the curve itself reaches, and not a difference with another.
    """
    curves.strain[a, 0], curves.off[a], curves.power[a, 0] = strain, 0.0, 0.0
    if curves.models.kind[a] == POLYNOMIAL:
        write_polynomial(curves, a, strain, limit)
    elif curves.models.kind[a] > POLYNOMIAL:
        write_muscle(curves, a, curves.models.scale[a], strain, limit, whole)
    else:
        write_sampled(curves, a, strain, limit, samples, number)


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
    copy_row(out.lever[a], own.lever[a])
    for c in range(out.bending.shape[1]):
        out.bending[a, c] = own.bending[a, c] - first.bending[a, c]


@part
def copy_curve(out, a, own):  # type: ignore[no-untyped-def]
    """Keep an actuator's curve."""
    out.pieces[a], out.edge[a, 0] = own.pieces[a], own.edge[a, 0]
    out.off[a], out.strain[a, 0] = own.off[a], own.strain[a, 0]
    copy_row(out.power[a], own.power[a])
    copy_row(out.bending[a], own.bending[a])
    for k in range(own.pieces[a]):
        out.edge[a, k + 1] = own.edge[a, k + 1]
        copy_row(out.control[a, k], own.control[a, k])
