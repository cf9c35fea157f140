"""The cost of one arm's poses at pressures, along equilibria: half the sum of squares, with its Gauss-Newton model.

An equilibrium is found by Newton's method from one nearby. Poses, and so the cost, are taken as the last Newton step
corrects them: what that leaves is of the order of its square. Pressures are normalised by their limits, `u = p/p̄`; by
the implicit function theorem the unknowns change by `-J⁻¹ ∂R/∂p p̄`.
"""

import math
from typing import NamedTuple

from jaxtyping import Float64

from torcharm.engine.arms import Arms, Loads
from torcharm.engine.arrays import Array
from torcharm.engine.balance import Balance
from torcharm.engine.box_step import BoxStep
from torcharm.engine.compilation import part
from torcharm.engine.continuation import FAILED, find_equilibrium
from torcharm.engine.copies import copy_row, copy_rows
from torcharm.engine.newton_step import first_angular, solve, write_balance, write_shape
from torcharm.engine.path import Path, Scale, move_size
from torcharm.engine.pose_error import Errors, Goal, tip_error, write_errors
from torcharm.engine.references import by_reference
from torcharm.engine.sections import set_pressure, write_rates

LARGE_MOVE = 1.0
"""Longest Newton step, as of `move_size`: about a radian, or a third of the length."""
SUFFICIENT = 1e-4
"""Share of the decrease of the imbalance that a Newton step promises; a step that saves less is halved."""
EVALUATIONS, FEW_EVALUATIONS = 12, 5
"""Of the balance at one equilibrium, at most: from a shape that is no equilibrium, and from nearby, where Newton's
method takes one to four unless there is none."""
SLOTS = 8
"""Points that are kept: where a descent is and where it tries to go, the best, and others on the way."""
HALF_COST, TIP_ERROR, LAST_MOVE, STABLE = range(4)
"""What is known of a point: half the cost [m²]; how far the tip is off [m]; the Newton step that led there, as of
`move_size`; and 1 if the equilibrium is stable, with every length above 0."""


@by_reference
class Problem(NamedTuple):
    """B arms, and what their poses are to be."""

    arms: Arms
    loads: Loads
    scale: Scale
    goal: Goal
    limit: Float64[Array, "B M"]  # of pressures [kPa]


@by_reference
class Points(NamedTuple):
    """Normalised pressures of one arm, with the equilibria and the models of half the cost there; a slot for each."""

    normalised: Float64[Array, "slots M"]  # normalised pressures
    twists: Float64[Array, "slots N K"]
    rates: Float64[Array, "slots M N C"]  # of the unknowns by the normalised pressures
    known: Float64[Array, "slots 4"]  # HALF_COST, TIP_ERROR, LAST_MOVE and STABLE
    gradient: Float64[Array, "slots M"]  # [m²]
    curvature: Float64[Array, "slots M M"]  # Gauss and Newton's [m²]


@by_reference
class Work(NamedTuple):
    """Scratch of one thread."""

    balance: Balance
    path: Path
    errors: Errors
    box: BoxStep
    change: Float64[Array, "1+M N C"]  # Newton's step, and the changes of the unknowns by M normalised pressures
    points: Points
    base: Float64[Array, "N K"]  # where a step of Newton's method starts
    way: Float64[Array, "N C"]  # and the step
    # half the square of `wall·u - wall_at` is added to the value of every point: a descent keeps to that plane; zeros
    # if there is none
    wall: Float64[Array, "M"]
    wall_at: Float64[Array, "1"]
    extra: Float64[Array, "M M"]  # what is added to a curvature
    missed: Float64[Array, "M"]  # scratch
    pressure: Float64[Array, "B M"]  # [kPa] at which arms are evaluated, for all threads; each uses its arms' rows


@part
def lengths_positive(arms, b, twist):  # type: ignore[no-untyped-def]
    """Whether the centreline's and all actuators' lengths are above 0 at twists (N, K)."""
    planar, last = arms.size == 3, arms.size - 1
    for segment in range(len(arms.first_node) - 1):
        for i in range(arms.first_node[segment], arms.first_node[segment + 1]):
            if not twist[i, 0] > 0.0:
                return False
            for a in range(arms.first_actuator[segment], arms.first_actuator[segment + 1]):
                own = twist[i, 0] - arms.y[b, a] * twist[i, last]
                if not planar:
                    own += arms.z[b, a] * twist[i, last - 1]
                if not own > 0.0:
                    return False
    return True


@part
def copy_point(points, to, at):  # type: ignore[no-untyped-def]
    """Copy what one slot holds to another."""
    copy_row(points.normalised[to], points.normalised[at])
    copy_row(points.gradient[to], points.gradient[at])
    copy_rows(points.curvature[to], points.curvature[at])
    for m in range(points.normalised.shape[1]):
        copy_rows(points.rates[to, m], points.rates[at, m])
    copy_rows(points.twists[to], points.twists[at])
    copy_row(points.known[to], points.known[at])


@part
def take_pressure(problem, work, b, at):  # type: ignore[no-untyped-def]
    """Set the pressures [kPa] of a slot."""
    for m in range(problem.limit.shape[1]):
        work.pressure[b, m] = work.points.normalised[at, m] * problem.limit[b, m]
    set_pressure(problem.arms, work.balance.drive, work.pressure, b, 1.0)
    work.path.loaded[0] = True


@part
def write_newton(problem, work, b):  # type: ignore[no-untyped-def]
    """Write Newton's step at the path's trial as its first change; returns the norm of the imbalance [N]."""
    arms, loads, balance, path = problem.arms, problem.loads, work.balance, work.path
    write_shape(arms, loads, balance, b, path.trial, False)
    write_balance(arms, loads, balance, b, path.trial, 1.0, 0.0, 0.0)
    total, reach = 0.0, problem.scale.reach[b] + 1e-3 * problem.scale.length[b]
    for i in range(balance.residual.shape[0]):
        for c in range(balance.residual.shape[1]):
            one = balance.residual[i, c]
            work.change[0, i, c] = -one
            if arms.unknown[c] >= first_angular(arms):
                one /= reach
            total += one * one
    solve(arms, loads, balance, work.change[0])
    return math.sqrt(total)


@part
def approach(problem, work, b, close, evaluations):  # type: ignore[no-untyped-def]
    """Newton's method for the balance from the path's trial, at pressures that are set.

    A step no larger than `close` is the last, and is not taken: it stands as the first change. Steps are at most
    LARGE_MOVE long, and halved where the imbalance does not fall. Returns the size of the last step; infinite where
    that is not reached.
    """
    arms, path = problem.arms, work.path
    last, factor, step = math.inf, 1.0, 0.0
    for _ in range(evaluations):
        norm = write_newton(problem, work, b)
        size = move_size(arms, problem.scale, path, b, work.change[0])
        if not math.isfinite(size):
            size, fell = math.inf, False
        else:
            fell = norm <= (1.0 - SUFFICIENT * factor) * last or (size <= close and factor == 1.0)
        if fell and size <= close:
            return size
        if fell:
            copy_rows(work.base, path.trial)
            step = min(LARGE_MOVE / size, 1.0)
            for i in range(work.way.shape[0]):
                for c in range(work.way.shape[1]):
                    work.way[i, c] = step * work.change[0, i, c]
            last, factor = norm, 1.0
        elif last == math.inf:
            return math.inf
        else:
            factor *= 0.5
        for i in range(work.way.shape[0]):
            for c in range(work.way.shape[1]):
                u = arms.unknown[c]
                path.trial[i, u] = work.base[i, u] + factor * work.way[i, c]
    return math.inf


@part
def write_point(problem, work, b, at, size):  # type: ignore[no-untyped-def]
    """Write the model of a slot at the path's trial, of which Newton's step of that size is known."""
    arms, balance, path, points = problem.arms, work.balance, work.path, work.points
    count, nodes, columns = points.normalised.shape[1], work.change.shape[1], work.change.shape[2]
    for segment in range(len(arms.first_node) - 1):
        for i in range(arms.first_node[segment], arms.first_node[segment + 1]):
            write_rates(arms, balance.drive, balance.sections, b, segment, i, path.trial)
    for m in range(count):
        for i in range(nodes):
            for c in range(columns):
                work.change[1 + m, i, c] = -balance.sections.rate[i, c, m] * problem.limit[b, m]
        solve(arms, problem.loads, balance, work.change[1 + m])
        copy_rows(points.rates[at, m], work.change[1 + m])
    copy_rows(points.twists[at], path.trial)
    for i in range(nodes):
        for c in range(columns):
            points.twists[at, i, arms.unknown[c]] += work.change[0, i, c]
    write_errors(arms, problem.goal, balance, b, path.trial, work.change, count, work.errors)
    value = work.errors.value
    for m in range(count + 1):
        for k in range(m + 1):
            total = 0.0
            for i in range(nodes):
                for e in range(value.shape[2]):
                    total += value[m, i, e] * value[k, i, e]
            if m == 0:
                points.known[at, HALF_COST] = 0.5 * total if math.isfinite(total) else math.inf
            elif k == 0:
                points.gradient[at, m - 1] = total
            else:
                points.curvature[at, m - 1, k - 1] = points.curvature[at, k - 1, m - 1] = total
    stable = balance.pivots[0] == 0 and balance.pivots[1] == 0 and lengths_positive(arms, b, points.twists[at])
    points.known[at, LAST_MOVE], points.known[at, STABLE] = size, stable
    points.known[at, TIP_ERROR] = tip_error(arms, problem.goal, balance, b)


@part
def add_wall(work, at):  # type: ignore[no-untyped-def]
    """Add the square of the distance from the wall to the model of a slot."""
    points, off = work.points, -work.wall_at[0]
    for m in range(len(work.wall)):
        off += work.wall[m] * points.normalised[at, m]
    points.known[at, HALF_COST] += 0.5 * off * off
    for m in range(len(work.wall)):
        points.gradient[at, m] += off * work.wall[m]
        for k in range(len(work.wall)):
            points.curvature[at, m, k] += work.wall[m] * work.wall[k]


@part
def expected_cost(problem, work, b, at, shape):  # type: ignore[no-untyped-def]
    """Half the cost at a slot's pressures after one Newton step from a shape (N, K); infinite if it is no number."""
    take_pressure(problem, work, b, at)
    copy_rows(work.path.trial, shape)
    write_newton(problem, work, b)
    write_errors(problem.arms, problem.goal, work.balance, b, shape, work.change, 0, work.errors)
    total, value = 0.0, work.errors.value
    for i in range(value.shape[1]):
        for e in range(value.shape[2]):
            total += value[0, i, e] * value[0, i, e]
    return 0.5 * total if math.isfinite(total) else math.inf


@part
def evaluate_point(problem, work, b, at, close, evaluations):  # type: ignore[no-untyped-def]
    """Write the model of a slot at its pressures, at the equilibrium near the path's trial; whether that is found."""
    take_pressure(problem, work, b, at)
    size = approach(problem, work, b, close, evaluations)
    if not math.isfinite(size):
        work.points.known[at, HALF_COST], work.points.known[at, STABLE] = math.inf, 0.0
        return False
    write_point(problem, work, b, at, size)
    add_wall(work, at)
    return math.isfinite(work.points.known[at, HALF_COST])


@part
def load_from_zero(problem, work, b, start, tolerance):  # type: ignore[no-untyped-def]
    """Write as the path's trial where continuation from zero load leads at the pressures; returns how, as
    `find_equilibrium`."""
    arms, loads, scale = problem.arms, problem.loads, problem.scale
    return find_equilibrium(arms, loads, scale, work.pressure, start, work.balance, work.path, b, tolerance)


@part
def distance_of(problem, work, b, at, to):  # type: ignore[no-untyped-def]
    """The difference of the shapes of two slots, as of `move_size`."""
    twists, change = work.points.twists, work.change
    for i in range(change.shape[1]):
        for c in range(change.shape[2]):
            u = problem.arms.unknown[c]
            change[0, i, c] = twists[to, i, u] - twists[at, i, u]
    return move_size(problem.arms, problem.scale, work.path, b, change[0])


@part
def reach(problem, work, b, at, to, start, tolerance):  # type: ignore[no-untyped-def]
    """Write the point of slot `to` at the pressures of another, at the equilibrium that continuation from zero load
    reaches.

    Returns how it is reached, as `find_equilibrium`; FAILED where the arm does not stay there.
    """
    points = work.points
    copy_row(points.normalised[to], points.normalised[at])
    points.known[to, HALF_COST], points.known[to, STABLE] = math.inf, 0.0
    take_pressure(problem, work, b, to)
    how = load_from_zero(problem, work, b, start, tolerance)
    if how == FAILED:
        return FAILED
    write_newton(problem, work, b)
    size = move_size(problem.arms, problem.scale, work.path, b, work.change[0])
    write_point(problem, work, b, to, size)
    if points.known[to, STABLE] > 0.0 and math.isfinite(points.known[to, HALF_COST]):
        return how
    points.known[to, HALF_COST] = math.inf
    return FAILED
