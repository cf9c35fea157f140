"""What a search keeps of one arm: points with what their load continuations passed, ends that were lost, a boundary."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from torcharm.engine.arms import Arms
from torcharm.engine.bifurcation import Saddle, make_saddle
from torcharm.engine.compilation import part, routine
from torcharm.engine.path import copy_twists
from torcharm.engine.pressure_model import HALF_COST, copy_point, reach

Array = NDArray[Any]

BEST, CURRENT, ENDED, TRIED, AIM, BETWEEN = 2, 3, 4, 5, 6, 7
"""Slots: the best point that is reached from zero load; where a search along a boundary is; what is reached at the end
of a descent; what is reached at a trial; and places of trials. The first two slots are those of descents, those after the last
hold where the arm was loaded at first, at an infinite cost once a descent began there."""
SAME_END = 0.02
"""Difference of the places of two lost ends that counts as none: kinks of force models hold descents up here and
there."""
LOST = 6
"""Ends of descents that are kept, as load continuation leads elsewhere there."""


class Search(NamedTuple):
    """Room for one search.

    Attributes:
        quick, rush, factor: (Q, N, K), (Q, N, C), (Q,) of points that were reached: the equilibrium
            on the way at which the arm gave way most, its change by the load factor, and that factor.
        how: (Q,) how points were reached, as `find_equilibrium`.
        start_cost: (S,) what each start came to [m²]; NaN where it was not needed.
        expected: (P,) half the costs of places, after a Newton step from the shape.
        lost_value, lost_place: (LOST,) half costs and (LOST, M) places of lost ends, from the best on.
        saddle: room for bifurcations.
        edge_place, edge_twists, edge_factor, edge_normal, edge_shift: the boundary that was found, as of `Saddle`.
        aim: (M,) where the free descent from the current point led.
        way: (M,) room.
    """

    quick: Array
    rush: Array
    factor: Array
    how: Array
    start_cost: Array
    expected: Array
    lost_value: Array
    lost_place: Array
    saddle: Saddle
    edge_place: Array
    edge_twists: Array
    edge_factor: Array
    edge_normal: Array
    edge_shift: Array
    aim: Array
    way: Array


def make_search(arms: Arms, starts: int, pool: int, slots: int) -> Search:
    """Room for one arm at a time."""
    nodes, size, columns, count = arms.first_node[-1], len(arms.column), len(arms.unknown), len(arms.models.kind)
    return Search(
        np.zeros((slots, nodes, size)),
        np.zeros((slots, nodes, columns)),
        np.zeros(slots),
        np.zeros(slots, dtype=np.int64),
        np.zeros(starts),
        np.zeros(pool),
        np.zeros(LOST),
        np.zeros((LOST, count)),
        make_saddle(arms),
        np.zeros(count),
        np.zeros((nodes, size)),
        np.zeros(1),
        np.zeros(count),
        np.zeros((count, nodes, columns)),
        *np.zeros((2, count)),
    )


@part
def keep_point(work, search, to, at):  # type: ignore[no-untyped-def]
    """Copy a point with what its load continuation passed."""
    copy_point(work.points, to, at)
    copy_twists(search.quick[to], search.quick[at])
    copy_twists(search.rush[to], search.rush[at])
    search.factor[to], search.how[to] = search.factor[at], search.how[at]


@part
def improves(work, at, on):  # type: ignore[no-untyped-def]
    """Whether a point is better than another, by more than rounding."""
    return work.points.known[at, HALF_COST] < work.points.known[on, HALF_COST] * (1.0 - 1e-12)


@routine
def reach_and_keep(problem, work, search, b, at, to, start, tolerance):  # type: ignore[no-untyped-def]
    """As `reach`, with what the load continuation passed."""
    how = reach(problem, work, b, at, to, start, tolerance)
    path = work.path
    copy_twists(search.quick[to], path.quick)
    copy_twists(search.rush[to], path.rush)
    search.factor[to], search.how[to] = path.fastest[1], how
    return how


@part
def keep_lost(work, search, at):  # type: ignore[no-untyped-def]
    """Keep the end of a descent among those that are lost, from the best on, unless it is worse than all or there:
    whether it is."""
    value, place = work.points.known[at, HALF_COST], work.points.place[at]
    for j in range(LOST):
        gap = 0.0
        for m in range(len(place)):
            gap = max(gap, abs(search.lost_place[j, m] - place[m]))
        if gap < SAME_END and search.lost_value[j] < math.inf:
            return True
    for j in range(LOST):
        if value < search.lost_value[j]:
            for k in range(LOST - 1, j, -1):
                search.lost_value[k] = search.lost_value[k - 1]
                for m in range(len(place)):
                    search.lost_place[k, m] = search.lost_place[k - 1, m]
            search.lost_value[j] = value
            for m in range(len(place)):
                search.lost_place[j, m] = place[m]
            return False
    return False
