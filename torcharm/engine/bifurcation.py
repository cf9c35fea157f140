"""The boundary of what continuation reaches: where, as the load rises, an arm just goes to one side or to the other.

Next to a bifurcation the equilibria are no function of load and pressure. They are one of the load factor s and of a
coordinate x along which the arm gives way: with pressures changed along one direction only, `t = P(x, s)`. An arm that
comes along t = const. from below passes a saddle of P on one side or on the other; a pressure is on the boundary if it
meets the saddle, `P_x = P_s = 0` (an unfolding of a transcritical bifurcation; Golubitsky and Schaeffer,
*Singularities and Groups in Bifurcation Theory*, 1985, ch. III). Both slopes follow from the arm's derivatives by
pressure and load, and are regular where the stiffness is singular. Newton's method on them, with their own slopes from
two equilibria beside, finds the saddle from either side.
"""

import math
from typing import NamedTuple

from jaxtyping import Float64

from torcharm.engine.arrays import Array
from torcharm.engine.compilation import part
from torcharm.engine.copies import copy_rows
from torcharm.engine.newton_step import solve, write_balance, write_shape
from torcharm.engine.references import by_reference
from torcharm.engine.sections import set_pressure

ASIDE = 1e-4
"""Steps to the two equilibria beside, in the load factor, and in x over the arm's length: the error of the slopes'
differences falls with them, that of rounding grows."""
LARGEST = 0.3
"""Newton step in these units, at most: further away the saddle of another bifurcation is found."""
FOUND = 1e-3
"""Newton step at which the saddle counts as found: what is left is of the order of its square."""


@by_reference
class Saddle(NamedTuple):
    """Scratch of one bifurcation: the saddle and two equilibria beside."""

    normalised: Float64[Array, "3 M"]  # normalised pressures
    twists: Float64[Array, "3 N K"]
    factor: Float64[Array, "3"]  # load factors
    measure: Float64[Array, "N C"]  # of x, the sum of its products with the unknowns; a unit vector
    way: Float64[Array, "M"]  # unit vector along which pressures change
    shift: Float64[Array, "M N C"]  # change of the unknowns by the normalised pressures, at x held
    normal: Float64[Array, "M"]  # unit normal of the boundary; pressures along it make the arm give way further
    change: Float64[Array, "2 N C"]  # Newton's step, and the change by the load factor
    by_way: Float64[Array, "N C"]  # the change of the unknowns along the way
    slope: Float64[Array, "3 2"]  # P_x and P_s at the three


@part
def write_changes(problem, work, saddle, b, k):  # type: ignore[no-untyped-def]
    """Write Newton's step and the changes by load factor and pressures at one of the three equilibria."""
    arms, loads, balance = problem.arms, problem.loads, work.balance
    for m in range(saddle.normalised.shape[1]):
        work.pressure[b, m] = saddle.normalised[k, m] * problem.limit[b, m]
    set_pressure(arms, balance.drive, work.pressure, b, 1.0)
    write_shape(arms, loads, balance, b, saddle.twists[k], True)
    write_balance(arms, loads, balance, b, saddle.twists[k], saddle.factor[k], 0.0, 0.0)
    for i in range(saddle.change.shape[1]):
        for c in range(saddle.change.shape[2]):
            saddle.change[0, i, c] = -balance.residual[i, c]
            saddle.change[1, i, c] = -balance.carried[i, c]
            for m in range(saddle.normalised.shape[1]):
                work.change[1 + m, i, c] = -balance.sections.rate[i, c, m] * problem.limit[b, m]
    for x in range(2):
        solve(arms, loads, balance, saddle.change[x])
    for m in range(saddle.normalised.shape[1]):
        solve(arms, loads, balance, work.change[1 + m])


@part
def times_measure(saddle, change):  # type: ignore[no-untyped-def]
    """The change of x by one of the unknowns (N, C)."""
    total = 0.0
    for i in range(change.shape[0]):
        for c in range(change.shape[1]):
            total += saddle.measure[i, c] * change[i, c]
    return total


@part
def _move(arms, saddle, k, factor, change):  # type: ignore[no-untyped-def]
    """Add a factor times a change of the unknowns to one of the three."""
    for i in range(change.shape[0]):
        for c in range(change.shape[1]):
            saddle.twists[k, i, arms.unknown[c]] += factor * change[i, c]


@part
def _advance(problem, work, saddle, b, beside):  # type: ignore[no-untyped-def]
    """One Newton step to the saddle, or with the first evaluation to the equilibria beside; returns its size."""
    arms, aside = problem.arms, ASIDE / problem.scale.length[b]
    count, slope, change = saddle.normalised.shape[1], saddle.slope, saddle.change
    for k in range(2 if beside else 0, -1, -1):  # the saddle itself comes last, and its changes are kept
        write_changes(problem, work, saddle, b, k)
        for i in range(change.shape[1]):
            for c in range(change.shape[2]):
                total = 0.0
                for m in range(count):
                    total += saddle.way[m] * work.change[1 + m, i, c]
                saddle.by_way[i, c] = total
        gain = times_measure(saddle, saddle.by_way)
        slope[k, 0], slope[k, 1] = 1.0 / gain, -times_measure(saddle, change[1]) / gain
        back = -times_measure(saddle, change[0]) / gain
        _move(arms, saddle, k, 1.0, change[0])
        _move(arms, saddle, k, back, saddle.by_way)
        for m in range(count):
            saddle.normalised[k, m] += saddle.way[m] * back
    x, s, move_x, move_s, size = slope[0, 0], slope[0, 1], 0.0, 0.0, math.inf
    if beside:
        xx, sx = (slope[1, 0] - x) / aside, (slope[1, 1] - s) / aside
        xs, ss = (slope[2, 0] - x) / ASIDE, (slope[2, 1] - s) / ASIDE
        determinant = xx * ss - xs * sx
        move_x, move_s = (xs * s - ss * x) / determinant, (sx * x - xx * s) / determinant
        size = max(abs(move_x) * ASIDE / aside, abs(move_s))
        short = min(LARGEST / max(size, 1e-300), 1.0)
        move_x, move_s = move_x * short, move_s * short
    for m in range(count):
        saddle.normal[m] = times_measure(saddle, work.change[1 + m])
        copy_rows(saddle.shift[m], work.change[1 + m])
    _move(arms, saddle, 0, move_s, change[1])
    _move(arms, saddle, 0, x * move_x + s * move_s, saddle.by_way)
    saddle.factor[0] += move_s
    for m in range(count):
        saddle.normalised[0, m] += saddle.way[m] * (x * move_x + s * move_s)
    for k in range(1, 3):
        copy_rows(saddle.twists[k], saddle.twists[0])
        saddle.factor[k] = saddle.factor[0]
        along = x * aside if k == 1 else s * ASIDE
        if k == 2:
            saddle.factor[k] += ASIDE
            _move(arms, saddle, k, ASIDE, change[1])
        _move(arms, saddle, k, along, saddle.by_way)
        for m in range(count):
            saddle.normalised[k, m] = saddle.normalised[0, m] + saddle.way[m] * along
    return size


@part
def find_saddle(problem, work, saddle, b, steps):  # type: ignore[no-untyped-def]
    """Newton's method to the saddle from the first pressures, twists and load factor; whether it is found.

    Args:
        steps: of Newton's method, at most.
    """
    size = math.inf
    for step in range(steps + 1):
        size = _advance(problem, work, saddle, b, step > 0)
        if step > 0 and not size > FOUND:
            break
    length, along, sound = 0.0, 0.0, 0.0
    for m in range(saddle.normalised.shape[1]):
        length += saddle.normal[m] * saddle.normal[m]
        along += saddle.normal[m] * saddle.way[m]
        sound += saddle.normalised[0, m]
    length = math.sqrt(length)
    for i in range(saddle.by_way.shape[0]):
        for c in range(saddle.by_way.shape[1]):
            gone = 0.0
            for m in range(saddle.normalised.shape[1]):
                gone += saddle.way[m] * saddle.shift[m, i, c]
            for m in range(saddle.normalised.shape[1]):
                saddle.shift[m, i, c] -= gone * saddle.normal[m] / along
                sound += saddle.shift[m, i, c]
    for m in range(saddle.normalised.shape[1]):
        saddle.normal[m] /= length
        sound += saddle.normal[m]
    return math.isfinite(sound) and size < FOUND and 0.0 < saddle.factor[0] < 1.0
