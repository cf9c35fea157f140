"""The pressures at which arms that are put down at a shape come closest to it.

From half the limits, or the most promising of other pressures where there is no stable equilibrium near the shape, the
cost is followed to a minimum, through stable equilibria wherever there are any; and from pressures that come closest
to holding the very shape, as the wrenches there say: first from these where they nearly do.
"""

import math
from typing import NamedTuple

from jaxtyping import Bool, Float64, Int64

from torcharm.engine.arrays import Array
from torcharm.engine.compilation import part
from torcharm.engine.continuation import CONTINUED
from torcharm.engine.copies import copy_row, copy_rows
from torcharm.engine.descent import (
    CLOSE,
    FLOOR,
    NO_START,
    RUNNING,
    STABILITY_ENDS,
    STEPS,
    descend,
    error_slope,
    mean_error,
)
from torcharm.engine.path import move_size
from torcharm.engine.pressure_model import (
    EVALUATIONS,
    HALF_COST,
    STABLE,
    copy_point,
    distance_of,
    evaluate_point,
    reach,
    take_pressure,
    write_newton,
    write_point,
)
from torcharm.engine.references import by_reference
from torcharm.engine.wrench_fit import FIT_GAIN, FIT_STEPS, fit_wrenches, write_carried

START, HOLDS, BEST = 0, 2, 4
"""Slots: where the arm is put down; pressures that almost hold the shape; and the best point. Behind the first two is
room for descents."""
SCREENED = (3, 8, 64)
"""Pressures at which an arm is tried that does not stay near the shape at half the limits; and again, of more."""
ALMOST_HOLDS = 5e-2
"""Mean error over the arm's length of pressures from which the first descent begins, as they nearly hold the very
shape; and below which such pressures are looked for with patience."""
FITS, PATIENT_FITS = 2, 10
"""Pressures from which it is looked for."""
PATIENT_STEPS, PATIENT_GAIN = 20, 1e-4
"""Of the latter fits."""

SAME_SHAPE = 1e-2
"""Difference of two shapes, as of `move_size`, that counts as none: other equilibria are much further away."""


@by_reference
class Predictions(NamedTuple):
    """What B descents found."""

    normalised: Float64[Array, "B M"]  # normalised pressures
    twists: Float64[Array, "B N K"]  # of the equilibria
    half_cost: Float64[Array, "B"]  # [m²], infinite where there is no equilibrium
    slope: Float64[Array, "B"]  # the largest slope of the error by a pressure [m]
    ended: Int64[Array, "B"]  # how, as of `descent`
    stable: Bool[Array, "B"]  # whether the equilibria are stable, by the pivots of J
    reached: Bool[Array, "B"]  # whether continuation from zero load leads there


@part
def _better(points, a, b):  # type: ignore[no-untyped-def]
    """Whether the point of one slot is to be preferred to that of another: stable ones first."""
    first, second = points.known[a, STABLE], points.known[b, STABLE]
    if first != second:
        return first > second
    return points.known[a, HALF_COST] < points.known[b, HALF_COST]


@part
def _start(problem, work, b, shape, draws):  # type: ignore[no-untyped-def]
    """Write the first slot: at half the limits, or where the arm comes to rest nearest to the shape."""
    points, tried = work.points, -1
    for screened in SCREENED:
        while tried < screened:
            at = min(tried + 1, 1)
            for m in range(points.normalised.shape[1]):
                points.normalised[at, m] = 0.5 if tried < 0 else draws[tried, m]
            copy_rows(work.path.trial, shape)
            evaluate_point(problem, work, b, at, CLOSE, EVALUATIONS)
            if at == 1 and _better(points, 1, 0):
                copy_point(points, 0, 1)
            tried += 1
            if tried == 0 and points.known[0, STABLE] > 0.0:
                return
        if points.known[0, STABLE] > 0.0:
            return


@part
def _holding(problem, work, fit, b, shape, draws, first, starts, steps, gain, best):  # type: ignore[no-untyped-def]
    """Write HOLDS: of pressures whose reactions come closest to what the shape requires, the best, at an equilibrium.

    Pressures are compared by the cost after one Newton step from the shape. Returns whether any promises
    less than the best slot's.
    """
    points, path = work.points, work.path
    least, found = points.known[best, HALF_COST], False
    write_carried(problem, work, b, shape)  # Newton's steps below are at the same shape, and write the same
    for s in range(-1, starts):
        copy_row(fit.normalised[0], points.normalised[best] if s < 0 else draws[first + s])
        fit_wrenches(problem, work, fit, b, shape, steps, gain)
        at = HOLDS + 1
        copy_row(points.normalised[at], fit.normalised[0])
        copy_rows(path.trial, shape)
        take_pressure(problem, work, b, at)
        write_newton(problem, work, b)
        write_point(problem, work, b, at, move_size(problem.arms, problem.scale, path, b, work.change[0]))
        if points.known[at, STABLE] > 0.0 and points.known[at, HALF_COST] < least:
            least, found = points.known[at, HALF_COST], True
            copy_row(points.normalised[HOLDS], points.normalised[at])
            if mean_error(problem, work, b, at) <= FLOOR:  # it is held: nothing can do better
                break
    if found:
        copy_rows(path.trial, shape)
        evaluate_point(problem, work, b, HOLDS, CLOSE, EVALUATIONS)
    return found


@part
def _descend(problem, work, b, here, free, ended):  # type: ignore[no-untyped-def]
    """Descend from a slot; where that leads to a better point, it is the best.

    Returns how the descent to the best point ended, where that to the last best one ended in the last way.
    """
    end, how = descend(problem, work, b, here, here + 1, free, math.inf, STEPS)
    if not _better(work.points, end, BEST):
        return ended
    copy_point(work.points, BEST, end)
    return how


@part
def _predict(problem, work, fit, b, shape, draws):  # type: ignore[no-untyped-def]
    """Write the best point that is found; returns how its descent ended."""
    points, ended = work.points, NO_START
    points.known[BEST, HALF_COST], points.known[BEST, STABLE] = math.inf, -1.0
    _start(problem, work, b, shape, draws)
    free = not points.known[START, STABLE] > 0.0
    found = _holding(problem, work, fit, b, shape, draws, 0, FITS, FIT_STEPS, FIT_GAIN, START)
    first, other = START, HOLDS
    if found and mean_error(problem, work, b, HOLDS) < ALMOST_HOLDS:
        first, other = HOLDS, START
    ended = _descend(problem, work, b, first, free, ended)
    unsure = ended in (RUNNING, STABILITY_ENDS)
    if (first == HOLDS and unsure) or (found and _better(points, other, BEST)):
        ended = _descend(problem, work, b, other, free, ended)
    if FLOOR < mean_error(problem, work, b, BEST) < ALMOST_HOLDS and _holding(
        problem, work, fit, b, shape, draws, FITS, PATIENT_FITS, PATIENT_STEPS, PATIENT_GAIN, BEST
    ):
        ended = _descend(problem, work, b, HOLDS, free, ended)
    return ended


@part
def predict_all(problem, shape, draws, start, tolerance, first, last, work, fit, out):  # type: ignore[no-untyped-def]
    """Predict for the arms from one to another, without the last.

    Args:
        shape: (B, N, K) twists of the shapes to hold.
        draws: (Q, M) normalised pressures, spread over the box: as many as the last of SCREENED.
        start, tolerance: of continuation, as of `find_equilibrium`.
        out: is written.
    """
    points = work.points
    work.path.stays[0] = True
    for b in range(first, last):
        ended = _predict(problem, work, fit, b, shape[b], draws)
        copy_row(out.normalised[b], points.normalised[BEST])
        copy_rows(out.twists[b], points.twists[BEST])
        out.half_cost[b], out.stable[b] = points.known[BEST, HALF_COST], points.known[BEST, STABLE]
        out.ended[b], out.slope[b], out.reached[b] = ended, math.inf, False
        if ended != NO_START and math.isfinite(out.half_cost[b]):
            out.slope[b] = error_slope(problem, work, b, BEST)
            if points.known[BEST, STABLE] > 0.0:
                how = reach(problem, work, b, BEST, START, start, tolerance)
                out.reached[b] = how == CONTINUED and distance_of(problem, work, b, BEST, START) <= SAME_SHAPE
