"""Equilibria continued from zero load: first the pressure rises, without load, then the load, in proportion.

A predictor-corrector method: a step along the tangent, then Newton's method, accepted only where Newton contracts at
once (Deuflhard, *Newton Methods for Nonlinear Problems*, 2004, ch. 5) and the stiffness keeps its number of unstable
directions. Both guard against landing on another branch: under compression an arm has several equilibria. Where the
branch ends the arm snaps, and is followed by pseudo-transient continuation (Kelley and Keyes 1998): overdamped motion
`D dz/dt = R` by implicit Euler steps that grow as the motion slows down, and become Newton's.

Without load, sections do not know of each other: each segment is one element then.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from torcharm.engine.arms import Arms
from torcharm.engine.compilation import kernel, part, routine
from torcharm.engine.newton_step import factor_section, first_angular, solve, write_balance, write_shape
from torcharm.engine.sections import set_pressure, write_rates, write_section
from torcharm.statics.balance import RIGID

Array = NDArray[Any]

FIRST_PRESSURE_STEP = 0.3
"""Of the pressure, taken by the first step."""
FIRST_LOAD_STEP = 0.25
"""Of the load, taken by the first step."""
SHORTEST_STEP = 1e-4
"""Of the load; where no longer step succeeds, the branch has ended."""
MOST_EVALUATIONS = 200
"""Of the balance along one path: ten times what hard cases take; more is a path that goes nowhere."""
LARGEST_MOVE = 1.0
"""Longest step along the tangent, as `_size` measures: about a radian, or a third of the length."""
SMALL_MOVE = 0.06
"""A correction so short needs no contraction: at a kink of a force model Newton has none, however short.
On the way, a Newton step so short is taken, and the path goes on from there."""
AIMED_MOVE = 0.03
"""Newton step for which the steps along the path are made."""
UNLOADED = 4.0
"""Times as much of both, without load: sections do not know of each other, and there are no branches to miss."""
CONTRACTION = 0.5
"""Largest ratio of the second Newton step to the first: above it, Newton's method may be leaving for another root."""
CORRECTIONS = 8
"""Newton steps at one point of a path: a contraction of a half or better has converged by then."""
TRANSIENT_STEPS = 60
"""Pseudo-transient steps at most: of 450 arms that came to rest one took more than 40, and none more than 50."""
TRANSIENT_DAMPING = 0.4
"""Of the first pseudo-transient step, D/h over the sections' own stiffness: slower than the motion, so that an arm
goes to the equilibrium that it would roll into."""
WARM_DAMPING = 1e-3
"""The same from a warm start: next to Newton's step."""
UPHILL = 1.5
"""Times the last imbalance: a pseudo-transient step that led to more was too long."""
STIFF_STRAIN = 1e-4
"""The strain whose force counts as load, where it is more than the loads themselves: so that a tolerance of 1e-10 of
the load is never below the rounding of a strain, 1e-16, times the stiffness."""

CONTINUED, SNAPPED, WARM, FAILED = range(4)
"""How an equilibrium was reached: along one branch; from its end, by a snap; from a warm start; or not."""


class Scale(NamedTuple):
    """What imbalances and moves of B arms are measured by.

    Attributes:
        load: (B,) [N], 1 N at least.
        length: (B,) mean neutral length of the segments [m].
        reach: (B,) largest offset [m].
    """

    load: Array
    length: Array
    reach: Array


class Path(NamedTuple):
    """Room for one path.

    Attributes:
        trial, base: (N, K) twists of an attempt, and of the last equilibrium.
        tangent, bend: (N, C) change of the unknowns by the factor there, and half its slope.
        change: (2, N, C) a Newton step, and the tangent.
    """

    trial: Array
    base: Array
    tangent: Array
    bend: Array
    change: Array


class Found(NamedTuple):
    """Equilibria of B arms.

    Attributes:
        twists: (B, N, K) [m, rad].
        residual: (B,) the largest imbalance of an element: forces, and moments over the length, over the load scale.
        reached: (B,) CONTINUED, SNAPPED, WARM or FAILED.
        pivots: (B, 2) numbers of positive pivots of J, and of zero ones.
    """

    twists: Array
    residual: Array
    reached: Array
    pivots: Array


def make_path(arms: Arms) -> Path:
    """Room for one arm's path."""
    nodes, size, columns = arms.first_node[-1], len(arms.column), len(arms.unknown)
    return Path(*np.zeros((2, nodes, size)), *np.zeros((2, nodes, columns)), np.zeros((2, nodes, columns)))


@part
def elements_under_way(arms, segment, loaded):  # type: ignore[no-untyped-def]
    """The first of a segment's elements, and the one after its last; without load one stands for all."""
    first = arms.first_node[segment]
    return first, arms.first_node[segment + 1] if loaded else first + 1


@routine
def write_step(arms, loads, room, path, b, factor, loaded, linear_shift, angular_shift):  # type: ignore[no-untyped-def]
    """Write the residual and Newton's step at the trial, with a shift on the diagonal of J.

    Args:
        factor: λ on the loads; without load on nothing: the pressures must be set.
        linear_shift, angular_shift: as of `write_balance`.
    """
    if loaded:
        write_shape(arms, loads, room, b, path.trial, False)
        write_balance(arms, loads, room, b, path.trial, factor, linear_shift, angular_shift)
    else:
        room.pivots[0] = room.pivots[1] = 0
        room.sections.stiffness[0] = 0.0
        for segment in range(len(arms.first_node) - 1):
            i = arms.first_node[segment]
            write_section(arms, room.drive, room.sections, b, segment, i, path.trial)
            for c in range(len(arms.unknown)):
                room.residual[i, c] = room.sections.reaction[i, c]
            factor_section(arms, room, i, linear_shift, angular_shift)
    for segment in range(len(arms.first_node) - 1):
        first, last = elements_under_way(arms, segment, loaded)
        for i in range(first, last):
            for c in range(len(arms.unknown)):
                path.change[0, i, c] = -room.residual[i, c]
    _solve(arms, loads, room, path, 0, loaded)


@part
def _solve(arms, loads, room, path, x, loaded):  # type: ignore[no-untyped-def]
    if loaded:
        solve(arms, loads, room, path.change, x)
        return
    matrix, columns = room.factor, len(arms.unknown)
    for segment in range(len(arms.first_node) - 1):
        i = arms.first_node[segment]
        for c in range(columns):
            for e in range(c):
                path.change[x, i, c] -= matrix[i, c, e] * path.change[x, i, e]
        for c in range(columns - 1, -1, -1):
            for e in range(c + 1, columns):
                path.change[x, i, c] -= matrix[i, c, e] * path.change[x, i, e]
            path.change[x, i, c] *= matrix[i, c, c]


@routine
def write_tangent(arms, loads, room, path, pressures, b, loaded):  # type: ignore[no-untyped-def]
    """Write the change of the unknowns by the factor on the load, or without load on the pressure."""
    for segment in range(len(arms.first_node) - 1):
        first, last = elements_under_way(arms, segment, loaded)
        if not loaded:
            write_rates(arms, room.drive, room.sections, b, segment, first, path.trial)
        for i in range(first, last):
            for c in range(len(arms.unknown)):
                rate = 0.0
                if loaded:
                    rate = room.carried[i, c]
                else:
                    for a in range(arms.first_actuator[segment], arms.first_actuator[segment + 1]):
                        rate += room.sections.rate[i, c, a] * pressures[b, a]
                path.change[1, i, c] = -rate
    _solve(arms, loads, room, path, 1, loaded)


@part
def imbalance(arms, scale, room, b, loaded):  # type: ignore[no-untyped-def]
    """The largest residual: forces, and moments over the arm's length, over the load scale. NaN if one is."""
    most = 0.0
    for segment in range(len(arms.first_node) - 1):
        first, last = elements_under_way(arms, segment, loaded)
        for i in range(first, last):
            for c in range(len(arms.unknown)):
                size = abs(room.residual[i, c])
                if arms.unknown[c] >= first_angular(arms):
                    size /= scale.length[b]
                if not size <= most:  # takes a NaN, and keeps it
                    most = size
    return most / max(scale.load[b], STIFF_STRAIN * room.sections.stiffness[0])


@part
def move_size(arms, scale, path, b, x, loaded):  # type: ignore[no-untyped-def]
    """The size of a change of the unknowns: headings along the arm [rad], or three times the strains."""
    turn_x = turn_y = turn_z = heading = stretch = bend = 0.0
    angular, change = first_angular(arms), path.change
    for segment in range(len(arms.first_node) - 1):
        first, last = elements_under_way(arms, segment, loaded)
        share = 1.0 / (last - first)
        for i in range(first, last):
            for c in range(len(arms.unknown)):
                value = change[x, i, c]
                if arms.unknown[c] < angular:
                    stretch = max(stretch, abs(value))
                    continue
                bend = max(bend, abs(value))
                if arms.unknown[c] == len(arms.column) - 1:
                    turn_z += value * share
                elif arms.unknown[c] == 4:
                    turn_y += value * share
                else:
                    turn_x += value * share
            heading = max(heading, turn_x * turn_x + turn_y * turn_y + turn_z * turn_z)
    size = max(math.sqrt(heading), 3.0 * (stretch + scale.reach[b] * bend) / scale.length[b])
    return size if math.isfinite(stretch + bend + turn_x + turn_y + turn_z) else math.nan


@part
def _move(arms, path, factor, loaded):  # type: ignore[no-untyped-def]
    """Add a factor times Newton's step to the trial."""
    for segment in range(len(arms.first_node) - 1):
        first, last = elements_under_way(arms, segment, loaded)
        for i in range(first, last):
            for c in range(len(arms.unknown)):
                path.trial[i, arms.unknown[c]] += factor * path.change[0, i, c]


@part
def _branch(loads, room):  # type: ignore[no-untyped-def]
    """What stays the same along a branch: the number of unstable directions; with following loads, whether it is odd."""
    for q in range(len(loads.follows)):
        if loads.follows[q]:
            return room.pivots[0] % 2
    return room.pivots[0]


@part
def _copy_twists(out, given):  # type: ignore[no-untyped-def]
    for i in range(out.shape[0]):
        for c in range(out.shape[1]):
            out[i, c] = given[i, c]


@routine
def follow(arms, loads, scale, pressures, room, path, b, loaded, tolerance):  # type: ignore[no-untyped-def]
    """Follow the branch of the trial from nothing to all of the load, or of the pressure; returns whether it arrives.

    The trial takes the last equilibrium on the branch. With load, the pressures must be set.
    """
    columns, ease = len(arms.unknown), 1.0 if loaded else UNLOADED
    at, aim, step, branch, started = 0.0, 0.0, FIRST_LOAD_STEP if loaded else FIRST_PRESSURE_STEP, 0, False
    corrections, first_size, ratio, moved = 0, 0.0, 0.0, 0.0
    _copy_twists(path.base, path.trial)
    for _ in range(MOST_EVALUATIONS):
        if not loaded:
            set_pressure(arms, room.drive, pressures, b, aim)
        write_step(arms, loads, room, path, b, aim, loaded, 0.0, 0.0)
        size = move_size(arms, scale, path, b, 0, loaded)
        if corrections == 0:
            first_size = size
        elif corrections == 1:
            ratio = size / max(first_size, 1e-300)
        there = size <= ease * SMALL_MOVE
        if aim >= 1.0:
            there = imbalance(arms, scale, room, b, loaded) <= tolerance
        if not there:
            moved += size
        trusted = ratio < CONTRACTION or moved < ease * SMALL_MOVE
        same = not started or _branch(loads, room) == branch
        if there and trusted and same and math.isfinite(size):
            _move(arms, path, 1.0, loaded)
            _copy_twists(path.base, path.trial)
            if aim >= 1.0:
                return True
            write_tangent(arms, loads, room, path, pressures, b, loaded)
            taken, started_before = aim - at if started else step, started
            half = 0.5 / max(taken, 1e-12)
            for i in range(path.tangent.shape[0]):
                for c in range(columns):
                    new = path.change[1, i, c]
                    path.bend[i, c] = (new - path.tangent[i, c]) * half if started else 0.0
                    path.tangent[i, c] = new
            at, branch, started = aim, _branch(loads, room), True
            stretch = min(max((ease * AIMED_MOVE / max(first_size, 1e-12)) ** (1 / 3), 0.3), 4.0)
            step = taken * stretch if started_before else taken
            speed = move_size(arms, scale, path, b, 1, loaded)
            if not math.isfinite(speed):
                break
            step = min(step, LARGEST_MOVE / max(speed, 1e-12))
        elif not there and trusted and moved < LARGEST_MOVE and corrections < CORRECTIONS:
            _move(arms, path, 1.0, loaded)
            corrections += 1
            continue
        else:
            step = 0.25 * (aim - at if started else step)
        if not started or step < SHORTEST_STEP:
            break
        aim = at + step
        if aim > 1.0 - 1e-9:
            aim = 1.0
        ahead = aim - at
        for i in range(path.tangent.shape[0]):
            for c in range(columns):
                u = arms.unknown[c]
                path.trial[i, u] = path.base[i, u] + ahead * (path.tangent[i, c] + path.bend[i, c] * ahead)
        corrections, first_size, ratio, moved = 0, 0.0, 0.0, 0.0
    _copy_twists(path.trial, path.base)
    return False


@part
def _own_stiffness(arms, room, loaded, angular):  # type: ignore[no-untyped-def]
    """The largest slope of a section's reaction by its own unknown, of linear or of angular components."""
    most, size = 1e-9, room.sections.slope
    for segment in range(len(arms.first_node) - 1):
        first, last = elements_under_way(arms, segment, loaded)
        for i in range(first, last):
            for c in range(len(arms.unknown)):
                if (arms.unknown[c] >= first_angular(arms)) == angular and abs(size[i, c, c]) < 1e-9 * RIGID:
                    most = max(most, abs(size[i, c, c]))
    return most


@routine
def come_to_rest(arms, loads, scale, room, path, b, loaded, damping, tolerance):  # type: ignore[no-untyped-def]
    """Follow the trial by pseudo-transient continuation under all of the load; returns whether it comes to rest.

    The pressures must be set. A step is held to half of a move of size 1.
    """
    amount, last = 2.5 * damping, math.inf
    factor = 1.0 if loaded else 0.0
    write_step(arms, loads, room, path, b, factor, loaded, 0.0, 0.0)
    for _ in range(TRANSIENT_STEPS):
        miss = imbalance(arms, scale, room, b, loaded)
        if miss <= tolerance:
            _move(arms, path, 1.0, loaded)
            return True
        if not math.isfinite(miss):
            return False
        amount = min(max(amount * 4.0 if miss > UPHILL * last else amount * 0.4, 1e-12), 1e6)
        linear, angular = _own_stiffness(arms, room, loaded, False), _own_stiffness(arms, room, loaded, True)
        write_step(arms, loads, room, path, b, factor, loaded, amount * linear, amount * angular)
        size = move_size(arms, scale, path, b, 0, loaded)
        if not math.isfinite(size):
            return False
        if size > 0.5:
            amount *= 2.0
        _move(arms, path, min(0.5 / max(size, 1e-12), 1.0), loaded)
        last = miss
        write_step(arms, loads, room, path, b, factor, loaded, 0.0, 0.0)
    return False


@routine
def rest_unloaded(arms, loads, scale, pressures, room, path, b, tolerance):  # type: ignore[no-untyped-def]
    """Continue the arm without load from no pressure to all of it; returns whether along one branch, or at all."""
    for segment in range(len(arms.first_node) - 1):
        first, total = arms.first_node[segment], 0.0
        for c in range(len(arms.column)):
            path.trial[first, c] = 0.0
        for a in range(arms.first_actuator[segment], arms.first_actuator[segment + 1]):
            total += arms.neutral[b, a]
        path.trial[first, 0] = total / (arms.first_actuator[segment + 1] - arms.first_actuator[segment])
    set_pressure(arms, room.drive, pressures, b, 0.0)
    write_step(arms, loads, room, path, b, 0.0, False, 0.0, 0.0)
    rests = imbalance(arms, scale, room, b, False) <= tolerance
    if not rests:
        rests = come_to_rest(arms, loads, scale, room, path, b, False, TRANSIENT_DAMPING, tolerance)
    along = follow(arms, loads, scale, pressures, room, path, b, False, tolerance) and rests
    set_pressure(arms, room.drive, pressures, b, 1.0)
    if not along:  # where a force model jumps, say
        come_to_rest(arms, loads, scale, room, path, b, False, TRANSIENT_DAMPING, tolerance)
    for segment in range(len(arms.first_node) - 1):
        first, last = arms.first_node[segment], arms.first_node[segment + 1]
        for i in range(first + 1, last):
            for c in range(len(arms.column)):
                path.trial[i, c] = path.trial[first, c]
    return along


@routine
def find_equilibrium(arms, loads, scale, pressures, start, room, path, b, tolerance):  # type: ignore[no-untyped-def]
    """Write the equilibrium of arm b as the trial; returns how it was reached.

    Args:
        start: (B, N, K) twists of warm starts; of no arms where there are none.
    """
    if len(start):
        set_pressure(arms, room.drive, pressures, b, 1.0)
        _copy_twists(path.trial, start[b])
        if come_to_rest(arms, loads, scale, room, path, b, True, WARM_DAMPING, tolerance):
            return WARM
    along = rest_unloaded(arms, loads, scale, pressures, room, path, b, tolerance)
    if follow(arms, loads, scale, pressures, room, path, b, True, tolerance):
        return CONTINUED if along else SNAPPED
    if come_to_rest(arms, loads, scale, room, path, b, True, TRANSIENT_DAMPING, tolerance):
        return SNAPPED
    return FAILED


@kernel
def find_equilibria(arms, loads, scale, pressures, start, tolerance, first, last, room, path, found):  # type: ignore[no-untyped-def]
    """Find the equilibria of the arms from one to another, without the last.

    Args:
        pressures: (B, M) [kPa].
        start: as of `find_equilibrium`.
        tolerance: of the load scale.
        found: is written.
    """
    for b in range(first, last):
        found.reached[b] = find_equilibrium(arms, loads, scale, pressures, start, room, path, b, tolerance)
        write_step(arms, loads, room, path, b, 1.0, True, 0.0, 0.0)
        found.residual[b] = imbalance(arms, scale, room, b, True)
        found.pivots[b, 0], found.pivots[b, 1] = room.pivots[0], room.pivots[1]
        _copy_twists(found.twists[b], path.trial)
