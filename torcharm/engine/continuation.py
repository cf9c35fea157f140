"""Equilibria continued from zero load: first the pressure rises, without load, then the load, in proportion.

A predictor-corrector method: a step along the tangent, then Newton's method, accepted only where Newton contracts at
once (Deuflhard, *Newton Methods for Nonlinear Problems*, 2004, ch. 5) and the stiffness keeps its number of unstable
directions. Both guard against landing on another branch: under compression an arm has several equilibria. Where the
branch ends the arm snaps, and is followed by pseudo-transient continuation (Kelley and Keyes 1998): overdamped motion
`D dz/dt = R` by implicit Euler steps that grow as the motion slows down, and become Newton's.

Without load, sections do not know of each other: each segment is one element then.
"""

import math

from torcharm.engine.compilation import part
from torcharm.engine.copies import copy_row, copy_rows
from torcharm.engine.newton_step import factor_section, solve, write_balance, write_shape
from torcharm.engine.path import (
    elements_under_way,
    imbalance,
    move,
    move_size,
    own_stiffness,
    scales,
)
from torcharm.engine.sections import set_pressure, write_rates, write_section

FIRST_PRESSURE_STEP = 0.6
"""Of the pressure, taken by the first step."""
FIRST_LOAD_STEP = 0.25
"""Of the load, taken by the first step, or more if it moves the arm by less than `FIRST_MOVE`."""
FIRST_MOVE = 0.5
"""Length of that step along the tangent, as `move_size` measures: most loads are taken in one."""
SHORTEST_STEP = 1e-4
"""Of the load; where no longer step succeeds, the branch has ended."""
MOST_EVALUATIONS = 200
"""Of the balance along one path: ten times what hard cases take; more is a path that goes nowhere."""
LARGEST_MOVE = 1.0
"""Longest step along the tangent, as `move_size` measures: about a radian, or a third of the length."""
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
"""Times the last imbalance: a pseudo-transient step that led to more was too long, and the next one is damped more."""
CONTINUED, SNAPPED, WARM, FAILED = range(4)
"""How an equilibrium was reached: along one branch; from its end, by a snap; from a warm start; or not."""


@part
def write_step(arms, loads, balance, path, b, factor, linear_shift, angular_shift):  # type: ignore[no-untyped-def]
    """Write the residual and Newton's step at the trial, with a shift on the diagonal of J.

    Args:
        factor: λ on the loads; without load on nothing: the pressures must be set.
        linear_shift, angular_shift: as of `write_balance`.
    """
    if path.loaded[0]:
        write_shape(arms, loads, balance, b, path.trial, False)
        write_balance(arms, loads, balance, b, path.trial, factor, linear_shift, angular_shift)
    else:
        balance.pivots[0] = balance.pivots[1] = 0
        balance.sections.stiffness[0] = balance.sections.stiffness[1] = 0.0
        for segment in range(len(arms.first_node) - 1):
            i = arms.first_node[segment]
            write_section(arms, balance.drive, balance.sections, b, segment, i, path.trial)
            copy_row(balance.residual[i], balance.sections.reaction[i])
            factor_section(arms, balance, i, linear_shift, angular_shift)
    for segment in range(len(arms.first_node) - 1):
        first, last = elements_under_way(arms, path, segment)
        for i in range(first, last):
            for c in range(len(arms.unknown)):
                path.newton[i, c] = -balance.residual[i, c]
    _solve(arms, loads, balance, path, path.newton)


@part
def _solve(arms, loads, balance, path, change):  # type: ignore[no-untyped-def]
    if path.loaded[0]:
        solve(arms, loads, balance, change)
        return
    matrix, columns = balance.factor, len(arms.unknown)
    for segment in range(len(arms.first_node) - 1):
        i = arms.first_node[segment]
        for c in range(columns):
            for e in range(c):
                change[i, c] -= matrix[i, c, e] * change[i, e]
        for c in range(columns - 1, -1, -1):
            for e in range(c + 1, columns):
                change[i, c] -= matrix[i, c, e] * change[i, e]
            change[i, c] *= matrix[i, c, c]


@part
def write_tangent(arms, loads, balance, path, pressures, b):  # type: ignore[no-untyped-def]
    """Write the change of the unknowns by the factor on the load, or without load on the pressure."""
    for segment in range(len(arms.first_node) - 1):
        first, last = elements_under_way(arms, path, segment)
        if not path.loaded[0]:
            write_rates(arms, balance.drive, balance.sections, b, segment, first, path.trial)
        for i in range(first, last):
            for c in range(len(arms.unknown)):
                rate = 0.0
                if path.loaded[0]:
                    rate = balance.carried[i, c]
                else:
                    for a in range(arms.first_actuator[segment], arms.first_actuator[segment + 1]):
                        rate += balance.sections.rate[i, c, a] * pressures[b, a]
                path.ahead[i, c] = -rate
    _solve(arms, loads, balance, path, path.ahead)


@part
def _branch(loads, balance):  # type: ignore[no-untyped-def]
    """What stays the same along a branch: the number of unstable directions, or whether it is odd if loads follow."""
    for q in range(len(loads.follows)):
        if loads.follows[q]:
            return balance.pivots[0] % 2
    return balance.pivots[0]


@part
def follow(arms, loads, scale, pressures, balance, path, b, tolerance):  # type: ignore[no-untyped-def]
    """Follow the branch of the trial from nothing to all of the load, or of the pressure; returns whether it arrives.

    The trial takes the last equilibrium on the branch. With load, the pressures must be set.
    """
    columns, loaded = len(arms.unknown), path.loaded[0]
    ease = 1.0 if loaded else UNLOADED
    at, aim, step, branch, started = 0.0, 0.0, FIRST_LOAD_STEP if loaded else FIRST_PRESSURE_STEP, 0, False
    corrections, first_size, ratio, moved = 0, 0.0, 0.0, 0.0
    copy_rows(path.base, path.trial)
    for _ in range(MOST_EVALUATIONS):
        if not loaded:
            set_pressure(arms, balance.drive, pressures, b, aim)
        write_step(arms, loads, balance, path, b, aim, 0.0, 0.0)
        size = move_size(arms, scale, path, b, path.newton)
        if corrections == 0:
            first_size = size
        elif corrections == 1:
            ratio = size / max(first_size, 1e-300)
        there = size <= ease * SMALL_MOVE
        if aim >= 1.0:
            there = imbalance(arms, scale, balance, path, b) <= tolerance
        if not there:
            moved += size
        trusted = ratio < CONTRACTION or moved < ease * SMALL_MOVE
        same = not started or _branch(loads, balance) == branch
        if there and trusted and same and math.isfinite(size):
            if aim >= 1.0:
                return True
            move(arms, path, 1.0)
            copy_rows(path.base, path.trial)
            write_tangent(arms, loads, balance, path, pressures, b)
            taken, started_before = aim - at if started else step, started
            half = 0.5 / max(taken, 1e-12)
            for i in range(path.tangent.shape[0]):
                for c in range(columns):
                    new = path.ahead[i, c]
                    path.bend[i, c] = (new - path.tangent[i, c]) * half if started else 0.0
                    path.tangent[i, c] = new
            at, branch, started = aim, _branch(loads, balance), True
            stretch = min(max((ease * AIMED_MOVE / max(first_size, 1e-12)) ** (1 / 3), 0.3), 4.0)
            step = taken * stretch if started_before else taken
            speed = move_size(arms, scale, path, b, path.ahead)
            if not math.isfinite(speed):
                break
            if loaded and speed > path.fastest[0]:
                path.fastest[0], path.fastest[1] = speed, at
                copy_rows(path.quick, path.base)
                copy_rows(path.rush, path.ahead)
            if loaded and not started_before:
                step = min(max(step, FIRST_MOVE / max(speed, 1e-12)), 1.0)
            step = min(step, LARGEST_MOVE / max(speed, 1e-12))
        elif not there and trusted and moved < LARGEST_MOVE and corrections < CORRECTIONS:
            move(arms, path, 1.0)
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
    copy_rows(path.trial, path.base)
    return False


@part
def come_to_rest(arms, loads, scale, balance, path, b, damping, tolerance):  # type: ignore[no-untyped-def]
    """Follow the trial by pseudo-transient continuation under all of the load; returns whether it comes to rest.

    The pressures must be set. A step is held to half of a move of size 1.
    """
    amount, last, linear, angular, turned_back = damping, math.inf, 0.0, 0.0, True
    factor = 1.0 if path.loaded[0] else 0.0
    for _ in range(2 * TRANSIENT_STEPS):
        write_step(arms, loads, balance, path, b, factor, amount * linear, amount * angular)
        miss = imbalance(arms, scale, balance, path, b)
        if miss <= tolerance:
            return True
        size = move_size(arms, scale, path, b, path.newton)
        if not (math.isfinite(miss) and math.isfinite(size)):
            return False
        first, uphill = linear == 0.0, miss > UPHILL * last
        linear, angular = own_stiffness(arms, balance, path)
        if first or (uphill and not turned_back):  # the same step again, with more damping
            amount, turned_back = amount * (1.0 if first else 10.0), not first
            continue
        amount, turned_back, last = min(max(amount * (0.8 if size > 0.5 else 0.4), 1e-12), 1e6), False, miss
        move(arms, path, min(0.5 / max(size, 1e-12), 1.0))
    return False


@part
def _begin(arms, balance, path, pressures, b):  # type: ignore[no-untyped-def]
    """Begin with straight segments of their mean neutral lengths, without pressure or load."""
    for segment in range(len(arms.first_node) - 1):
        first, total = arms.first_node[segment], 0.0
        for c in range(arms.size):
            path.trial[first, c] = 0.0
        for a in range(arms.first_actuator[segment], arms.first_actuator[segment + 1]):
            total += arms.neutral[b, a]
        path.trial[first, 0] = total / (arms.first_actuator[segment + 1] - arms.first_actuator[segment])
    set_pressure(arms, balance.drive, pressures, b, 0.0)
    path.loaded[0] = False


@part
def _take_load(arms, path):  # type: ignore[no-untyped-def]
    """From one element a segment to all of them, for the load."""
    for segment in range(len(arms.first_node) - 1):
        first, last = arms.first_node[segment], arms.first_node[segment + 1]
        for i in range(first + 1, last):
            copy_row(path.trial[i], path.trial[first])
    path.loaded[0], path.fastest[0] = True, 0.0


@part
def find_equilibrium(arms, loads, scale, pressures, start, balance, path, b, tolerance):  # type: ignore[no-untyped-def]
    """Write the equilibrium of arm b as the trial; returns how it was reached.

    A warm start goes first, then rest without pressure, then the pressure, then the load. What cannot be followed comes
    to rest where it should have arrived.

    Args:
        start: (B, N, K) twists of warm starts; of no arms where there are none.
    """
    along, arrived = True, False
    for stage in range(0 if len(start) else 1, 4):
        if stage == 0:
            set_pressure(arms, balance.drive, pressures, b, 1.0)
            copy_rows(path.trial, start[b])
            path.loaded[0] = True
        elif stage == 1:
            _begin(arms, balance, path, pressures, b)
        else:
            arrived = follow(arms, loads, scale, pressures, balance, path, b, tolerance)
            along = along and arrived
        if stage == 2:
            set_pressure(arms, balance.drive, pressures, b, 1.0)
        if stage == 3 and not arrived and path.stays[0]:
            break
        if stage < 2 or not arrived:
            damping = WARM_DAMPING if stage == 0 else TRANSIENT_DAMPING
            arrived = come_to_rest(arms, loads, scale, balance, path, b, damping, tolerance)
        if stage == 0 and arrived:
            return WARM
        if stage == 1:
            along = arrived
        elif stage == 2:
            _take_load(arms, path)
    if not arrived:
        return FAILED
    return CONTINUED if along else SNAPPED


@part
def find_equilibria(arms, loads, scale, pressures, start, tolerance, first, last, balance, path, found):  # type: ignore[no-untyped-def]
    """Find the equilibria of the arms from one to another, without the last.

    Args:
        pressures: (B, M) [kPa].
        start: as of `find_equilibrium`.
        tolerance: of the load scale.
        found: is written.
    """
    for b in range(first, last):
        found.reached[b] = find_equilibrium(arms, loads, scale, pressures, start, balance, path, b, tolerance)
        if found.reached[b] != CONTINUED:  # else it was the last evaluation
            write_step(arms, loads, balance, path, b, 1.0, 0.0, 0.0)
        found.residual[b] = imbalance(arms, scale, balance, path, b)
        found.pivots[b, 0], found.pivots[b, 1] = balance.pivots[0], balance.pivots[1]
        found.scale[b, 0], found.scale[b, 1] = scales(scale, balance, b)
        copy_rows(found.twists[b], path.trial)
