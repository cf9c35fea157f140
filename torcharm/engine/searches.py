"""Pressures that bring loaded arms closest to their goals: descents from several starts, along equilibria continued
from zero load.

What a pressure costs is decided by continuation from zero load. A descent goes along warm equilibria, which
continuation may not reach: under compression an arm buckles to one side or to the other, and a small change of pressure
decides to which. The best pressures often lie where it does. So the end of each descent is confirmed by continuation;
where it is not, the search goes on along the boundary: see `boundary_search`.
"""

import math
from typing import NamedTuple

from jaxtyping import Bool, Float64, Int64

from torcharm.engine.arrays import Array
from torcharm.engine.boundary_search import SAME_SHAPE, WORTH, follow_boundary, release
from torcharm.engine.box_step import optimality
from torcharm.engine.compilation import kernel, part
from torcharm.engine.continuation import FAILED
from torcharm.engine.copies import copy_row, copy_rows
from torcharm.engine.descent import CLOSE, OPTIMUM, RUNNING, STABILITY_ENDS, STEPS, descend, mean_error
from torcharm.engine.pressure_model import (
    EVALUATIONS,
    HALF_COST,
    STABLE,
    TIP_ERROR,
    copy_point,
    distance_of,
    evaluate_point,
    expected_cost,
)
from torcharm.engine.references import by_reference
from torcharm.engine.search_state import (
    AIM,
    BEST,
    ENDED,
    FIRST_LOST,
    LOADED,
    LOST,
    NEAR,
    TRIED,
    improves,
    keep_lost,
    keep_point,
    reach_and_keep,
)
from torcharm.engine.wrench_fit import FIT_GAIN, FIT_STEPS, fit_wrenches, write_carried

LOT = 4
"""Pressures of which the arm is loaded at one: that of the least expected cost."""
AGREE, AGREES, AGREES_AT_KINK = 6, 2, 1
"""What descents must count together that end where others have, before the rest is spared; what one counts, and one
that is held up there, as at a kink of a force model: from elsewhere there may be a way on."""
CONFIRM, NEARLY_SAME = 3, 5e-4
"""How many descents must end nearly as close as the best for it to be converged; and the difference of mean errors over
the arm's length that is meant: valleys are flat where actuators work against each other."""
OTHER_TIP = 2e-3
"""Difference of the tip's errors over the arm's length from which on a descent that ends nearly as close is a rival:
which of the two is found may depend on where descents begin, so that neither is an answer."""
NEEDS_NO_OTHER = 1e-3
"""Mean error over the arm's length below which none need confirm the best: no other end can be better by more."""
NO_ERROR = 1e-5
"""Mean error over the arm's length below which one descent is enough: there is nothing to gain."""
CONFIRMS, NEITHER, RIVALS = range(3)
"""What an end says of the best one: it is as close, or nearly so; it is not; it is, but for the tip's error."""
NOWHERE, AGREED, AGREED_AT_KINK, ELSEWHERE, BEST_UNDER_WAY, BEST_ENDED = range(6)
"""What came of a descent: no equilibrium; an end that is known, at an optimum or not; one that is no better; the best
that is known, but where the arm moves on, or is about to lose its stability; or the best, at its end."""

FAR_BELOW = 0.5
"""Of the best cost: a lost end below that is worth loading the arm around it."""
NEARBY, NEARER, TRIES_BETWEEN = 0.02, 0.75, 40
"""How far around it, in normalised pressures, by which factor each try is nearer than the last, and how many are made
between the best of these and the end."""
HALFWAY = 0.5
"""Part of the way from the best to the end that is tried first; each failure makes it shorter by the factor NEARER."""


@by_reference
class Searches(NamedTuple):
    """What B searches found."""

    normalised: Float64[Array, "B M"]  # normalised pressures
    twists: Float64[Array, "B N K"]  # the equilibria there
    half_cost: Float64[Array, "B"]  # [m²], infinite where none was found
    how: Int64[Array, "B"]  # they are reached, as of `find_equilibrium`
    confirmed: Bool[Array, "B"]  # whether others confirm it, and none led to a better one that is not reached
    optimality: Float64[Array, "B"]  # the largest entry of the cost's projected gradient [m²]
    start_cost: Float64[Array, "B starts"]  # what each came to [m²]; infinite where it failed, NaN where it was spared


@part
def _write_expected(problem, work, search, b, shape, pool):  # type: ignore[no-untyped-def]
    """Write the expected costs of all pressures of a pool."""
    for q in range(len(pool)):
        copy_row(work.points.normalised[AIM], pool[q])
        search.expected[q] = expected_cost(problem, work, b, AIM, shape)


@part
def _best_of(values, first, last):  # type: ignore[no-untyped-def]
    """The index of the least value from one to another, without the last."""
    best = first
    for q in range(first, last):
        if values[q] < values[best]:
            best = q
    return best


@part
def _load_many(problem, work, search, b, shape, pool, spread, start, tolerance):  # type: ignore[no-untyped-def]
    """Load the arm at the most promising pressures of each lot of the pool, and at those spread over the box."""
    points = work.points
    _write_expected(problem, work, search, b, shape, pool)
    lots = len(pool) // LOT
    for k in range(lots + len(spread)):
        q = _best_of(search.expected, k * LOT, (k + 1) * LOT) if k < lots else 0
        copy_row(points.normalised[AIM], pool[q] if k < lots else spread[k - lots])
        reach_and_keep(problem, work, search, b, AIM, LOADED + k, start, tolerance)
        if improves(work, LOADED + k, BEST):
            keep_point(work, search, BEST, LOADED + k)


@part
def _begin(problem, work, search, fit, b, s, shape, pool, above):  # type: ignore[no-untyped-def]
    """Write the first slot: the start of descent s. Returns the slot of the point that was loaded; or -1.

    The first is at the shape itself, with the pressures of the pool that are best there to first order, or those near
    them that come closest to holding it: the best point that was loaded stands for it. Then come the pressures at which
    the arm was loaded, from the best on.
    """
    points = work.points
    if s > 0:
        best = -1
        for k in range(LOADED, len(points.known)):
            if above < points.known[k, HALF_COST] < (points.known[best, HALF_COST] if best >= 0 else math.inf):
                best = k
        if best >= 0:
            copy_point(points, 0, best)
        return best
    q = _best_of(search.expected, 0, len(pool))
    copy_row(points.normalised[0], pool[q])
    copy_row(fit.normalised[0], pool[q])
    write_carried(problem, work, b, shape)
    fit_wrenches(problem, work, fit, b, shape, FIT_STEPS, FIT_GAIN)
    copy_row(points.normalised[AIM], fit.normalised[0])
    if expected_cost(problem, work, b, AIM, shape) < search.expected[q]:
        copy_row(points.normalised[0], points.normalised[AIM])
    copy_rows(work.path.trial, shape)
    found = evaluate_point(problem, work, b, 0, CLOSE, EVALUATIONS) and points.known[0, STABLE] > 0.0
    return BEST if found else -1


@part
def _says_of_best(problem, work, b):  # type: ignore[no-untyped-def]
    """What the end of a descent says of the best point."""
    if abs(mean_error(problem, work, b, ENDED) - mean_error(problem, work, b, BEST)) > NEARLY_SAME:
        return NEITHER
    known = work.points.known
    apart = abs(known[ENDED, TIP_ERROR] - known[BEST, TIP_ERROR]) / problem.scale.length[b]
    return RIVALS if apart > OTHER_TIP else CONFIRMS


@part
def _descend_and_load(problem, work, search, b, begun, at_end, start, tolerance):  # type: ignore[no-untyped-def]
    """Descend from the first slot, and load the arm at the end; returns what came of it, what that costs, and what it
    says of the best.

    Args:
        begun: slot of the point that was loaded, where the descent begins.
        at_end: whether the best point is the end of a descent.
    """
    points = work.points
    end, ended = descend(problem, work, b, 0, 1, False, points.known[BEST, HALF_COST], STEPS)
    if not math.isfinite(points.known[end, HALF_COST]):
        return NOWHERE, math.inf, NEITHER
    if at_end and distance_of(problem, work, b, end, BEST) <= SAME_SHAPE:
        return AGREED if ended == OPTIMUM else AGREED_AT_KINK, points.known[BEST, HALF_COST], CONFIRMS
    how = reach_and_keep(problem, work, search, b, end, ENDED, start, tolerance)
    same = how != FAILED and distance_of(problem, work, b, end, ENDED) <= SAME_SHAPE
    came = ELSEWHERE
    if not same and keep_lost(problem, work, search, b, end, begun):
        came = AGREED
    if how == FAILED:
        return came, math.inf, NEITHER
    value = points.known[ENDED, HALF_COST]
    says = _says_of_best(problem, work, b) if same and at_end else NEITHER
    if not improves(work, BEST, ENDED):  # it may have begun at the best that is known
        keep_point(work, search, BEST, ENDED)
        there = same and ended != RUNNING and ended != STABILITY_ENDS
        came = BEST_ENDED if there else BEST_UNDER_WAY
    return came, value, says


@part
def _multistart(problem, work, search, fit, b, shape, pool, spread, start, tolerance):  # type: ignore[no-untyped-def]
    """Descend from all starts, and confirm the ends; whether the best point is one, and whether enough confirm it."""
    points, at_end, agreed, confirmed, rivals, above = work.points, False, 0, 0, 0, -1.0
    _load_many(problem, work, search, b, shape, pool, spread, start, tolerance)
    for s in range(len(search.start_cost)):
        if agreed >= AGREE or (at_end and mean_error(problem, work, b, BEST) <= NO_ERROR):
            break
        search.start_cost[s] = math.inf
        begun = _begin(problem, work, search, fit, b, s, shape, pool, above)
        if begun < 0:
            continue
        if s > 0:
            above = points.known[begun, HALF_COST]
        came, value, says = _descend_and_load(problem, work, search, b, begun, at_end, start, tolerance)
        search.start_cost[s] = 2.0 * value
        agreed += AGREES * (came == AGREED) + AGREES_AT_KINK * (came == AGREED_AT_KINK)
        if came >= BEST_UNDER_WAY:  # none has agreed with this one yet
            at_end, agreed = came == BEST_ENDED, 0
            if says == NEITHER:  # better than all others by what one sees
                confirmed, rivals = 0, 0
        confirmed, rivals = confirmed + (says == CONFIRMS), rivals + (says == RIVALS)
    # of few descents few can confirm
    return at_end, rivals == 0 and confirmed >= min(CONFIRM, len(search.start_cost) - 1)


@part
def _try_other_ends(problem, work, search, b, at_end, start, tolerance):  # type: ignore[no-untyped-def]
    """Descend from where one pressure of the best point is at its other end, as long as that leads to a better one.

    Minima lie in corners of the box, and the way from one to the next is often uphill. Returns whether the best point
    is the end of a descent, and whether it has no rival there.
    """
    points, count, alone = work.points, work.points.normalised.shape[1], True
    for _ in range(count):
        points.known[NEAR, HALF_COST] = math.inf
        for other in range(count):
            copy_row(points.normalised[AIM], points.normalised[BEST])
            points.normalised[AIM, other] = 1.0 if points.normalised[BEST, other] < 0.5 else 0.0
            reach_and_keep(problem, work, search, b, AIM, TRIED, start, tolerance)
            if points.known[TRIED, HALF_COST] < points.known[NEAR, HALF_COST]:
                keep_point(work, search, NEAR, TRIED)
        if not math.isfinite(points.known[NEAR, HALF_COST]):
            break
        if improves(work, NEAR, BEST):
            keep_point(work, search, BEST, NEAR)
            at_end = False
        copy_point(points, 0, NEAR)
        came, _, says = _descend_and_load(problem, work, search, b, NEAR, at_end, start, tolerance)
        alone = alone and says != RIVALS
        if came < BEST_UNDER_WAY:
            break
        at_end = came == BEST_ENDED
    return at_end, alone


@part
def _load_nearby(problem, work, search, b, j, pool, start, tolerance):  # type: ignore[no-untyped-def]
    """Load the arm ever closer around a lost end, and between it and the best of them: beside it the arm may be led
    there."""
    points, reach_out, found, step = work.points, NEARBY, False, HALFWAY
    for q in range(len(pool) + TRIES_BETWEEN):
        around = q < len(pool)
        reach_out *= NEARER
        for m in range(pool.shape[1]):
            pressure = points.normalised[j, m]
            if around:
                pressure += reach_out * (2.0 * pool[q, m] - 1.0)
            else:
                pressure = points.normalised[BEST, m] + step * (pressure - points.normalised[BEST, m])
            points.normalised[AIM, m] = min(max(pressure, 0.0), 1.0)
        if not around and not found:
            break
        reach_and_keep(problem, work, search, b, AIM, TRIED, start, tolerance)
        if improves(work, TRIED, BEST):
            keep_point(work, search, BEST, TRIED)
            found, step = True, HALFWAY
        elif not around:
            step *= NEARER


@part
def _search(problem, work, search, fit, b, shape, pool, spread, rounds, start, tolerance):  # type: ignore[no-untyped-def]
    """Write the best point; whether it is the end of a descent that others confirm, and none led to a better one."""
    points = work.points
    for s in range(len(search.start_cost)):
        search.start_cost[s] = math.nan
    for j in range(FIRST_LOST, FIRST_LOST + LOST):
        points.known[j, HALF_COST] = math.inf
    points.known[BEST, HALF_COST] = math.inf
    at_end, sure = _multistart(problem, work, search, fit, b, shape, pool, spread, start, tolerance)
    multistart_cost = points.known[BEST, HALF_COST]
    if math.isfinite(multistart_cost) and mean_error(problem, work, b, BEST) > NO_ERROR:
        at_end, alone = _try_other_ends(problem, work, search, b, at_end, start, tolerance)
        sure = sure and alone
    work.path.stays[0] = False
    if rounds > 0 and not at_end and math.isfinite(points.known[BEST, HALF_COST]):
        at_end = release(problem, work, search, b, BEST, start, tolerance)
    first_lost = _best_of(points.known[:, HALF_COST], FIRST_LOST, FIRST_LOST + LOST)
    lost = points.known[first_lost, HALF_COST]
    for _ in range(rounds):
        before, j = points.known[BEST, HALF_COST], _best_of(points.known[:, HALF_COST], FIRST_LOST, FIRST_LOST + LOST)
        if not points.known[j, HALF_COST] < (1.0 - WORTH) * before:
            break
        ended = follow_boundary(problem, work, search, b, j, start, tolerance)
        points.known[j, HALF_COST] = math.inf
        if points.known[BEST, HALF_COST] < before:
            at_end = ended
    if rounds > 0 and lost < FAR_BELOW * points.known[BEST, HALF_COST]:
        before = points.known[BEST, HALF_COST]
        _load_nearby(problem, work, search, b, first_lost, pool, start, tolerance)
        at_end = at_end and not points.known[BEST, HALF_COST] < before
    sure = sure and not points.known[BEST, HALF_COST] < (1.0 - WORTH) * multistart_cost
    sure = sure or mean_error(problem, work, b, BEST) <= NEEDS_NO_OTHER
    return at_end and sure and not lost < (1.0 - WORTH) * points.known[BEST, HALF_COST]


@kernel
def search_all(problem, shape, pool, spread, rounds, start, tolerance, first, last, work, search, fit, out):  # type: ignore[no-untyped-def]
    """Search for the arms from one to another, without the last.

    Args:
        shape: (B, N, K) twists that are wanted.
        pool: (P, M) normalised pressures, LOT of them for each at which the arm is loaded.
        spread: (Q, M) others, spread over the box.
        rounds: searches along boundaries at most; 0 does without.
        start, tolerance: of continuation, as of `find_equilibrium`.
        out: is written.
    """
    points = work.points
    for b in range(first, last):
        for snaps in range(2):  # where no branch is found to the full load at any start, arms may snap
            work.path.stays[0] = snaps == 0
            out.confirmed[b] = _search(problem, work, search, fit, b, shape[b], pool, spread, rounds, start, tolerance)
            if math.isfinite(points.known[BEST, HALF_COST]):
                break
        copy_row(out.normalised[b], points.normalised[BEST])
        copy_rows(out.twists[b], points.twists[BEST])
        out.half_cost[b], out.how[b], out.optimality[b] = points.known[BEST, HALF_COST], search.how[BEST], math.nan
        if math.isfinite(out.half_cost[b]):
            out.optimality[b] = 2.0 * optimality(points.gradient[BEST], points.normalised[BEST])
        else:
            out.how[b] = FAILED
        copy_row(out.start_cost[b], search.start_cost)
