"""What a search keeps of one arm: points with what their load continuations passed, ends that were lost, a boundary."""

import math
from typing import NamedTuple

from jaxtyping import Float64, Int64

from torcharm.engine.arrays import Array
from torcharm.engine.bifurcation import Saddle
from torcharm.engine.compilation import part
from torcharm.engine.copies import copy_rows
from torcharm.engine.pressure_model import HALF_COST, copy_point, distance_of, reach
from torcharm.engine.references import by_reference

BEST, CURRENT, ENDED, TRIED, AIM, NEAR, FIRST_LOST = 2, 3, 4, 5, 6, 7, 8
"""Slots: the best point that is reached from zero load; where a search along a boundary is; what is reached at the end
of a descent; a trial; pressures of trials; one that is reached on the near side of a boundary; and the first of LOST
ends of descents, behind which as many hold where these began. The first two slots are those of descents."""
SAME_BRANCH = 0.1
"""Difference of two shapes, as of `move_size`, of equilibria of one branch at pressures that are near: other branches
are further away."""
SAME_END = 0.02
"""Difference of the normalised pressures of two lost ends that counts as none: kinks of force models hold descents up
here and there."""
LOST = 6
"""Ends of descents that are kept, as load continuation leads elsewhere there."""
LOADED = FIRST_LOST + 2 * LOST
"""The first slot of points at which the arm was loaded at first."""


@by_reference
class Search(NamedTuple):
    """Scratch of one search."""

    # of points that were reached: the equilibrium on the way at which the arm gave way most, its change by the load
    # factor, and that factor; and how they were reached, as of `find_equilibrium`
    quick: Float64[Array, "slots N K"]
    rush: Float64[Array, "slots N C"]
    factor: Float64[Array, "slots"]
    how: Int64[Array, "slots"]
    start_cost: Float64[Array, "starts"]  # what each start came to [m²]; NaN where it was not needed
    expected: Float64[Array, "pool"]  # half the costs of pressures, after a Newton step from the shape
    saddle: Saddle
    # the boundary that was found, as of `Saddle`
    edge_pressure: Float64[Array, "M"]
    edge_twists: Float64[Array, "N K"]
    edge_factor: Float64[Array, "1"]
    edge_normal: Float64[Array, "M"]
    edge_shift: Float64[Array, "M N C"]
    way: Float64[Array, "M"]  # the direction away from it, along bounds of the box


@part
def keep_point(work, search, to, at):  # type: ignore[no-untyped-def]
    """Copy a point with what its load continuation passed."""
    copy_point(work.points, to, at)
    copy_rows(search.quick[to], search.quick[at])
    copy_rows(search.rush[to], search.rush[at])
    search.factor[to], search.how[to] = search.factor[at], search.how[at]


@part
def improves(work, at, on):  # type: ignore[no-untyped-def]
    """Whether a point is better than another, by more than rounding."""
    return work.points.known[at, HALF_COST] < work.points.known[on, HALF_COST] * (1.0 - 1e-12)


@part
def reach_and_keep(problem, work, search, b, at, to, start, tolerance):  # type: ignore[no-untyped-def]
    """As `reach`, with what the load continuation passed."""
    how = reach(problem, work, b, at, to, start, tolerance)
    path = work.path
    copy_rows(search.quick[to], path.quick)
    copy_rows(search.rush[to], path.rush)
    search.factor[to], search.how[to] = path.fastest[1], how
    return how


@part
def keep_lost(problem, work, search, b, at, begun):  # type: ignore[no-untyped-def]
    """Keep the end of a descent, and where it began, among those that are lost, unless it is worse than all; whether it
    was among them before."""
    points, worst = work.points, FIRST_LOST
    for j in range(FIRST_LOST, FIRST_LOST + LOST):
        gap = 0.0
        for m in range(points.normalised.shape[1]):
            gap = max(gap, abs(points.normalised[j, m] - points.normalised[at, m]))
        known = gap < SAME_END and points.known[j, HALF_COST] < math.inf
        if known and distance_of(problem, work, b, at, j) <= SAME_BRANCH:
            return True
        if points.known[j, HALF_COST] > points.known[worst, HALF_COST]:
            worst = j
    if points.known[at, HALF_COST] < points.known[worst, HALF_COST]:
        copy_point(points, worst, at)
        keep_point(work, search, worst + LOST, begun)
    return False
