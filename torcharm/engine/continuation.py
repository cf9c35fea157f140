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
from torcharm.engine.compilation import kernel, part, routine, spliced
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
"""Times the last imbalance: a pseudo-transient step that led to more was too long, and the next one is damped more."""
STIFF_STRAIN = 1e-4
"""The strain whose force counts as load, where it is more than the loads themselves: so that a tolerance of 1e-10 of
the load is never below the rounding of a strain, 1e-16, times the stiffness."""

STIFFEST = 1e-9 * RIGID
"""Stiffness [N·m] that is not an arm's own but stands for a direction in which it is rigid."""

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
        newton: (N, C) Newton's step.
        ahead: (N, C) the tangent at the trial.
        loaded: (1,) whether the load acts; without it one element stands for each segment.
    """

    trial: Array
    base: Array
    tangent: Array
    bend: Array
    newton: Array
    ahead: Array
    loaded: Array


class Found(NamedTuple):
    """Equilibria of B arms.

    Attributes:
        twists: (B, N, K) [m, rad].
        residual: (B,) the largest imbalance of an element: forces, and moments over the length, over the load scale.
        reached: (B,) CONTINUED, SNAPPED, WARM or FAILED.
        pivots: (B, 2) numbers of positive pivots of J, and of zero ones.
        scale: (B, 2) by which imbalances of forces [N] and of moments [N·m] are measured.
    """

    twists: Array
    residual: Array
    reached: Array
    pivots: Array
    scale: Array


def make_path(arms: Arms) -> Path:
    """Room for one arm's path."""
    nodes, size, columns = arms.first_node[-1], len(arms.column), len(arms.unknown)
    return Path(*np.zeros((2, nodes, size)), *np.zeros((4, nodes, columns)), np.zeros(1, dtype=np.bool_))


@spliced
def elements_under_way(arms, path, segment):  # type: ignore[no-untyped-def]
    """The first of a segment's elements, and the one after its last; without load one stands for all."""
    first = arms.first_node[segment]
    return first, arms.first_node[segment + 1] if path.loaded[0] else first + 1


@routine
def write_step(arms, loads, room, path, b, factor, linear_shift, angular_shift):  # type: ignore[no-untyped-def]
    """Write the residual and Newton's step at the trial, with a shift on the diagonal of J.

    Args:
        factor: λ on the loads; without load on nothing: the pressures must be set.
        linear_shift, angular_shift: as of `write_balance`.
    """
    if path.loaded[0]:
        write_shape(arms, loads, room, b, path.trial, False)
        write_balance(arms, loads, room, b, path.trial, factor, linear_shift, angular_shift)
    else:
        room.pivots[0] = room.pivots[1] = 0
        room.sections.stiffness[0] = room.sections.stiffness[1] = 0.0
        for segment in range(len(arms.first_node) - 1):
            i = arms.first_node[segment]
            write_section(arms, room.drive, room.sections, b, segment, i, path.trial)
            for c in range(len(arms.unknown)):
                room.residual[i, c] = room.sections.reaction[i, c]
            factor_section(arms, room, i, linear_shift, angular_shift)
    for segment in range(len(arms.first_node) - 1):
        first, last = elements_under_way(arms, path, segment)
        for i in range(first, last):
            for c in range(len(arms.unknown)):
                path.newton[i, c] = -room.residual[i, c]
    _solve(arms, loads, room, path, path.newton)


@spliced
def _solve(arms, loads, room, path, change):  # type: ignore[no-untyped-def]
    if path.loaded[0]:
        solve(arms, loads, room, change)
        return
    matrix, columns = room.factor, len(arms.unknown)
    for segment in range(len(arms.first_node) - 1):
        i = arms.first_node[segment]
        for c in range(columns):
            for e in range(c):
                change[i, c] -= matrix[i, c, e] * change[i, e]
        for c in range(columns - 1, -1, -1):
            for e in range(c + 1, columns):
                change[i, c] -= matrix[i, c, e] * change[i, e]
            change[i, c] *= matrix[i, c, c]


@routine
def write_tangent(arms, loads, room, path, pressures, b):  # type: ignore[no-untyped-def]
    """Write the change of the unknowns by the factor on the load, or without load on the pressure."""
    for segment in range(len(arms.first_node) - 1):
        first, last = elements_under_way(arms, path, segment)
        if not path.loaded[0]:
            write_rates(arms, room.drive, room.sections, b, segment, first, path.trial)
        for i in range(first, last):
            for c in range(len(arms.unknown)):
                rate = 0.0
                if path.loaded[0]:
                    rate = room.carried[i, c]
                else:
                    for a in range(arms.first_actuator[segment], arms.first_actuator[segment + 1]):
                        rate += room.sections.rate[i, c, a] * pressures[b, a]
                path.ahead[i, c] = -rate
    _solve(arms, loads, room, path, path.ahead)


@spliced
def _scales(scale, room, b):  # type: ignore[no-untyped-def]
    """By what imbalances of forces and of moments are measured."""
    force = max(scale.load[b], STIFF_STRAIN * room.sections.stiffness[0])
    return force, max(scale.load[b] * scale.length[b], STIFF_STRAIN * room.sections.stiffness[1])


@spliced
def imbalance(arms, scale, room, path, b):  # type: ignore[no-untyped-def]
    """The largest residual: of forces over the load scale, of moments over that times the length. NaN if one is."""
    most = 0.0
    force_scale, moment_scale = _scales(scale, room, b)
    for segment in range(len(arms.first_node) - 1):
        first, last = elements_under_way(arms, path, segment)
        for i in range(first, last):
            for c in range(len(arms.unknown)):
                size = abs(room.residual[i, c])
                size /= force_scale if arms.unknown[c] < first_angular(arms) else moment_scale
                if not size <= most:  # takes a NaN, and keeps it
                    most = size
    return most


@part
def move_size(arms, scale, path, b, change):  # type: ignore[no-untyped-def]
    """The size of a change of the unknowns: headings along the arm [rad], or three times the strains."""
    turn_x = turn_y = turn_z = heading = stretch = bend = 0.0
    angular = first_angular(arms)
    for segment in range(len(arms.first_node) - 1):
        first, last = elements_under_way(arms, path, segment)
        share = 1.0 / (last - first)
        for i in range(first, last):
            for c in range(len(arms.unknown)):
                value = change[i, c]
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


@spliced
def _move(arms, path, factor):  # type: ignore[no-untyped-def]
    """Add a factor times Newton's step to the trial."""
    for segment in range(len(arms.first_node) - 1):
        first, last = elements_under_way(arms, path, segment)
        for i in range(first, last):
            for c in range(len(arms.unknown)):
                path.trial[i, arms.unknown[c]] += factor * path.newton[i, c]


@spliced
def _branch(loads, room):  # type: ignore[no-untyped-def]
    """What stays the same along a branch: the number of unstable directions, or whether it is odd if loads follow."""
    for q in range(len(loads.follows)):
        if loads.follows[q]:
            return room.pivots[0] % 2
    return room.pivots[0]


@spliced
def _copy_twists(out, given):  # type: ignore[no-untyped-def]
    for i in range(out.shape[0]):
        for c in range(out.shape[1]):
            out[i, c] = given[i, c]


@routine
def follow(arms, loads, scale, pressures, room, path, b, tolerance):  # type: ignore[no-untyped-def]
    """Follow the branch of the trial from nothing to all of the load, or of the pressure; returns whether it arrives.

    The trial takes the last equilibrium on the branch. With load, the pressures must be set.
    """
    columns, loaded = len(arms.unknown), path.loaded[0]
    ease = 1.0 if loaded else UNLOADED
    at, aim, step, branch, started = 0.0, 0.0, FIRST_LOAD_STEP if loaded else FIRST_PRESSURE_STEP, 0, False
    corrections, first_size, ratio, moved = 0, 0.0, 0.0, 0.0
    _copy_twists(path.base, path.trial)
    for _ in range(MOST_EVALUATIONS):
        if not loaded:
            set_pressure(arms, room.drive, pressures, b, aim)
        write_step(arms, loads, room, path, b, aim, 0.0, 0.0)
        size = move_size(arms, scale, path, b, path.newton)
        if corrections == 0:
            first_size = size
        elif corrections == 1:
            ratio = size / max(first_size, 1e-300)
        there = size <= ease * SMALL_MOVE
        if aim >= 1.0:
            there = imbalance(arms, scale, room, path, b) <= tolerance
        if not there:
            moved += size
        trusted = ratio < CONTRACTION or moved < ease * SMALL_MOVE
        same = not started or _branch(loads, room) == branch
        if there and trusted and same and math.isfinite(size):
            _move(arms, path, 1.0)
            _copy_twists(path.base, path.trial)
            if aim >= 1.0:
                return True
            write_tangent(arms, loads, room, path, pressures, b)
            taken, started_before = aim - at if started else step, started
            half = 0.5 / max(taken, 1e-12)
            for i in range(path.tangent.shape[0]):
                for c in range(columns):
                    new = path.ahead[i, c]
                    path.bend[i, c] = (new - path.tangent[i, c]) * half if started else 0.0
                    path.tangent[i, c] = new
            at, branch, started = aim, _branch(loads, room), True
            stretch = min(max((ease * AIMED_MOVE / max(first_size, 1e-12)) ** (1 / 3), 0.3), 4.0)
            step = taken * stretch if started_before else taken
            speed = move_size(arms, scale, path, b, path.ahead)
            if not math.isfinite(speed):
                break
            step = min(step, LARGEST_MOVE / max(speed, 1e-12))
        elif not there and trusted and moved < LARGEST_MOVE and corrections < CORRECTIONS:
            _move(arms, path, 1.0)
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


@spliced
def _own_stiffness(arms, room, path):  # type: ignore[no-untyped-def]
    """The largest slopes of sections' reactions by their own unknowns, of linear and of angular components."""
    linear = angular = 1e-9
    for segment in range(len(arms.first_node) - 1):
        first, last = elements_under_way(arms, path, segment)
        for i in range(first, last):
            for c in range(len(arms.unknown)):
                size = abs(room.sections.slope[i, c, c])
                if arms.unknown[c] < first_angular(arms):
                    linear = max(linear, size)
                elif size < STIFFEST:
                    angular = max(angular, size)
    return linear, angular


@routine
def come_to_rest(arms, loads, scale, room, path, b, damping, tolerance):  # type: ignore[no-untyped-def]
    """Follow the trial by pseudo-transient continuation under all of the load; returns whether it comes to rest.

    The pressures must be set. A step is held to half of a move of size 1.
    """
    amount, last, linear, angular, turned_back = damping, math.inf, 0.0, 0.0, True
    factor = 1.0 if path.loaded[0] else 0.0
    for _ in range(2 * TRANSIENT_STEPS):
        write_step(arms, loads, room, path, b, factor, amount * linear, amount * angular)
        miss = imbalance(arms, scale, room, path, b)
        if miss <= tolerance:
            _move(arms, path, 1.0)
            return True
        size = move_size(arms, scale, path, b, path.newton)
        if not (math.isfinite(miss) and math.isfinite(size)):
            return False
        first, uphill = linear == 0.0, miss > UPHILL * last
        linear, angular = _own_stiffness(arms, room, path)
        if first or (uphill and not turned_back):  # the same step again, with more damping
            amount, turned_back = amount * (1.0 if first else 10.0), not first
            continue
        amount, turned_back, last = min(max(amount * (0.8 if size > 0.5 else 0.4), 1e-12), 1e6), False, miss
        _move(arms, path, min(0.5 / max(size, 1e-12), 1.0))
    return False


@spliced
def _begin(arms, room, path, pressures, b):  # type: ignore[no-untyped-def]
    """Begin with straight segments of their mean neutral lengths, without pressure or load."""
    for segment in range(len(arms.first_node) - 1):
        first, total = arms.first_node[segment], 0.0
        for c in range(len(arms.column)):
            path.trial[first, c] = 0.0
        for a in range(arms.first_actuator[segment], arms.first_actuator[segment + 1]):
            total += arms.neutral[b, a]
        path.trial[first, 0] = total / (arms.first_actuator[segment + 1] - arms.first_actuator[segment])
    set_pressure(arms, room.drive, pressures, b, 0.0)
    path.loaded[0] = False


@spliced
def _take_load(arms, path):  # type: ignore[no-untyped-def]
    """From one element a segment to all of them, for the load."""
    for segment in range(len(arms.first_node) - 1):
        first, last = arms.first_node[segment], arms.first_node[segment + 1]
        for i in range(first + 1, last):
            for c in range(len(arms.column)):
                path.trial[i, c] = path.trial[first, c]
    path.loaded[0] = True


@spliced
def find_equilibrium(arms, loads, scale, pressures, start, room, path, b, tolerance):  # type: ignore[no-untyped-def]
    """Write the equilibrium of arm b as the trial; returns how it was reached.

    A warm start goes first, then rest without pressure, then the pressure, then the load. What cannot be followed comes
    to rest where it should have arrived.

    Args:
        start: (B, N, K) twists of warm starts; of no arms where there are none.
    """
    along, arrived = True, False
    for stage in range(0 if len(start) else 1, 4):
        if stage == 0:
            set_pressure(arms, room.drive, pressures, b, 1.0)
            _copy_twists(path.trial, start[b])
            path.loaded[0] = True
        elif stage == 1:
            _begin(arms, room, path, pressures, b)
        else:
            arrived = follow(arms, loads, scale, pressures, room, path, b, tolerance)
            along = along and arrived
        if stage == 2:
            set_pressure(arms, room.drive, pressures, b, 1.0)
        if stage < 2 or not arrived:
            damping = WARM_DAMPING if stage == 0 else TRANSIENT_DAMPING
            arrived = come_to_rest(arms, loads, scale, room, path, b, damping, tolerance)
        if stage == 0 and arrived:
            return WARM
        if stage == 1:
            along = arrived
        elif stage == 2:
            _take_load(arms, path)
    if not arrived:
        return FAILED
    return CONTINUED if along else SNAPPED


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
        write_step(arms, loads, room, path, b, 1.0, 0.0, 0.0)
        found.residual[b] = imbalance(arms, scale, room, path, b)
        found.pivots[b, 0], found.pivots[b, 1] = room.pivots[0], room.pivots[1]
        found.scale[b, 0], found.scale[b, 1] = _scales(scale, room, b)
        _copy_twists(found.twists[b], path.trial)
