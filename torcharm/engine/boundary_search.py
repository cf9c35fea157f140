"""Search along the boundary of what load continuation reaches, where a descent leads over it.

The best pressure is on the boundary then, or near. A descent along its tangent, set back on it, is the next place; a
little away from it continuation can be followed. Where no bifurcation is found, the way to where the descent led is
divided.
"""

import math

from torcharm.engine.bifurcation import find_saddle, times_measure, write_changes
from torcharm.engine.box_step import largest_curvature
from torcharm.engine.compilation import part, routine
from torcharm.engine.continuation import FAILED
from torcharm.engine.descent import descend
from torcharm.engine.newton_step import first_angular
from torcharm.engine.path import copy_twists
from torcharm.engine.pressure_model import HALF_COST, add_wall, copy_point, distance_of
from torcharm.engine.search_room import (
    AIM,
    BEST,
    BETWEEN,
    CURRENT,
    ENDED,
    TRIED,
    improves,
    keep_point,
    reach_and_keep,
)

SAME_SHAPE = 1e-4
"""Difference of two shapes, as of `move_size`, that counts as none: both are solved to within 1e-8."""
ROUNDS = 10
"""Steps along a boundary, at most: most searches gain nothing after three, some follow a long curved one."""
RELEASES = 3
"""Free descents from what was found along a boundary, at most: where it ends, or bends away, they lead on."""
WORTH = 1e-4
"""Share of the cost that a step along a boundary must save to be followed by another, or a lost end by a search."""
NEWTON_STEPS, AGAIN_STEPS = 8, 4
"""To the boundary; and from there to another place on it."""
STIFF = 1e4
"""Of the wall in a descent along a boundary, over the largest curvature: across it a descent goes a ten-thousandth of
the way."""
SATISFIED = 3e-4
"""Share of the cost that a descent along the boundary must promise: the places that are tried cost more than that."""
PARTS = (1.0, 0.4, 0.15, 0.05)
"""Parts of a step along the boundary that are tried."""
MARGINS = (1e-4, 1e-3, 4e-3)
"""Distances from the boundary that are tried, in lengths of the box: continuation is the harder to follow the closer
it is."""
BLIND_MARGINS = (4e-3, -4e-3, -2e-2)
"""The same where the boundary is not found again, as where it has ended: on either side of where it would be."""
CROSS, FLIPS = (3e-4, 1e-3, 4e-3, 1.6e-2), (0.01, 0.03, 0.1, 0.3)
"""Steps across a boundary, from it, and from a place somewhere on the other side, in lengths of the box."""
SHORTENED = (0.9, 0.7, 0.4, 0.1)
"""Parts of the way to where a free descent led, that are tried where no boundary is known, or none leads on."""
STEEP = 1e-3
"""Least share of a step that goes across a boundary: along a bound of the box that nearly touches it there is no way
back."""


@part
def _write_way(search, place, sign):  # type: ignore[no-untyped-def]
    """Write the way away from the boundary, or across it, along bounds of the box."""
    length = 0.0
    for m in range(len(place)):
        n = sign * search.edge_normal[m]
        inner = n if (place[m] > 0.0 or n > 0.0) and (place[m] < 1.0 or n < 0.0) else 0.0
        search.way[m] = inner
        length += inner * inner
    for m in range(len(place)):
        search.way[m] /= max(math.sqrt(length), 1e-9)


@routine
def find_boundary(problem, work, search, b, at):  # type: ignore[no-untyped-def]
    """Write the boundary next to a point, with the normal into its side, and the way there; whether it is found.

    Where it is not, the place is the point's, and the normal is the direction in which the arm gives way more where it
    gives way most: next to a bifurcation all changes are along one vector.
    """
    saddle, points = search.saddle, work.points
    square, angular = 0.0, first_angular(problem.arms)
    for i in range(saddle.measure.shape[0]):
        for c in range(saddle.measure.shape[1]):
            one = search.rush[at, i, c]
            if problem.arms.unknown[c] < angular:
                one /= problem.scale.length[b] ** 2
            saddle.measure[i, c] = one
            square += one * one
    for i in range(saddle.measure.shape[0]):
        for c in range(saddle.measure.shape[1]):
            saddle.measure[i, c] /= max(math.sqrt(square), 1e-300)
    copy_twists(saddle.twists[0], search.quick[at])
    saddle.factor[0] = search.factor[at]
    for m in range(points.place.shape[1]):
        saddle.place[0, m] = search.edge_place[m] = points.place[at, m]
    write_changes(problem, work, saddle, b, 0)
    length = 0.0
    for m in range(points.place.shape[1]):
        search.edge_normal[m] = times_measure(saddle, work.change[1 + m])
        length += search.edge_normal[m] ** 2
    if not math.isfinite(length) or length == 0.0:
        for m in range(points.place.shape[1]):
            search.edge_normal[m] = search.way[m] = 0.0
        return False
    for m in range(points.place.shape[1]):
        search.edge_normal[m] /= math.sqrt(length)
    _write_way(search, points.place[at], 1.0)
    for m in range(points.place.shape[1]):
        saddle.way[m] = search.way[m]
    if not find_saddle(problem, work, saddle, b, NEWTON_STEPS):
        return False
    side = 0.0
    for m in range(points.place.shape[1]):
        side += saddle.normal[m] * search.edge_normal[m]
    for m in range(points.place.shape[1]):
        search.edge_place[m] = saddle.place[0, m]
        search.edge_normal[m] = -saddle.normal[m] if side < 0.0 else saddle.normal[m]
        copy_twists(search.edge_shift[m], saddle.shift[m])
    copy_twists(search.edge_twists, saddle.twists[0])
    search.edge_factor[0] = saddle.factor[0]
    return True


@part
def _write_trial(work, search, base, margin):  # type: ignore[no-untyped-def]
    """Write the place of a trial, a margin along the way from a base, in the box."""
    for m in range(len(base)):
        work.points.place[AIM, m] = min(max(base[m] + margin * search.way[m], 0.0), 1.0)


@routine
def _try(problem, work, search, b, start, tolerance):  # type: ignore[no-untyped-def]
    """See what is reached at a trial's place; whether it is better than where the search is, which goes there then."""
    if reach_and_keep(problem, work, search, b, AIM, TRIED, start, tolerance) == FAILED:
        return False
    if improves(work, TRIED, BEST):
        keep_point(work, search, BEST, TRIED)
    if not improves(work, TRIED, CURRENT):
        return False
    keep_point(work, search, CURRENT, TRIED)
    return True


@routine
def _slide(problem, work, search, b, start, tolerance):  # type: ignore[no-untyped-def]
    """Go along the boundary that is known, by part of a descent along its tangent; whether that leads anywhere."""
    points, saddle, count = work.points, search.saddle, work.points.place.shape[1]
    copy_point(points, 0, CURRENT)
    stiffness = math.sqrt(STIFF * largest_curvature(points.curvature[0]))
    for m in range(count):
        work.wall[m] = stiffness * search.edge_normal[m]
        work.wall_at[0] += work.wall[m] * points.place[0, m]
    add_wall(work, 0)
    along, _ = descend(problem, work, b, 0, 1, False, math.inf)
    hoped = points.known[along, HALF_COST]
    work.wall_at[0] = 0.0
    for m in range(count):
        work.wall[m] = 0.0
        points.place[BETWEEN, m] = points.place[along, m]
    if not hoped < (1.0 - SATISFIED) * points.known[CURRENT, HALF_COST]:
        return False
    steep = 0.0
    _write_way(search, points.place[CURRENT], 1.0)
    for m in range(count):
        steep += search.edge_normal[m] * search.way[m]
        saddle.way[m] = search.way[m]
    for part_of_it in PARTS:
        across = 0.0
        for m in range(count):
            across += search.edge_normal[m] * part_of_it * (points.place[BETWEEN, m] - search.edge_place[m])
        copy_twists(saddle.twists[0], search.edge_twists)
        saddle.factor[0] = search.edge_factor[0]
        for m in range(count):
            move = part_of_it * (points.place[BETWEEN, m] - search.edge_place[m])
            move -= saddle.way[m] * across / max(steep, STEEP)
            saddle.place[0, m] = points.place[AIM, m] = search.edge_place[m] + move
            for i in range(saddle.measure.shape[0]):
                for c in range(saddle.measure.shape[1]):
                    saddle.twists[0, i, problem.arms.unknown[c]] += search.edge_shift[m, i, c] * move
        found = find_saddle(problem, work, saddle, b, AGAIN_STEPS)
        _write_way(search, points.place[AIM], 1.0)
        for m in range(count):
            base = saddle.place[0, m] if found else points.place[AIM, m]
            saddle.place[1, m] = min(max(base, 0.0), 1.0)
        for k in range(len(MARGINS)):
            _write_trial(work, search, saddle.place[1], MARGINS[k] if found else BLIND_MARGINS[k])
            if _try(problem, work, search, b, start, tolerance):
                return True
    return False


@routine
def _shorten(problem, work, search, b, start, tolerance):  # type: ignore[no-untyped-def]
    """Go part of the way to where the free descent led; whether that is better."""
    points = work.points
    for part_of_it in SHORTENED:
        for m in range(points.place.shape[1]):
            here = points.place[CURRENT, m]
            points.place[AIM, m] = here + part_of_it * (search.aim[m] - here)
        if _try(problem, work, search, b, start, tolerance):
            return True
    return False


@routine
def _release(problem, work, search, b, start, tolerance):  # type: ignore[no-untyped-def]
    """Descend freely from the current point, and see what is reached where that leads: whether it is the same shape."""
    points = work.points
    copy_point(points, 0, CURRENT)
    end, _ = descend(problem, work, b, 0, 1, False, math.inf)
    points.known[ENDED, HALF_COST] = math.inf
    for m in range(points.place.shape[1]):
        search.aim[m] = points.place[end, m]
    if not math.isfinite(points.known[end, HALF_COST]):
        return False
    how = reach_and_keep(problem, work, search, b, end, ENDED, start, tolerance)
    return how != FAILED and distance_of(problem, work, b, end, ENDED) <= SAME_SHAPE


@routine
def follow_boundary(problem, work, search, b, start, tolerance):  # type: ignore[no-untyped-def]
    """Search on from the current point; whether the best point is the end of a descent then that is reached itself."""
    points, at_end = work.points, False
    for _ in range(RELEASES):
        same = _release(problem, work, search, b, start, tolerance)
        if improves(work, ENDED, BEST):
            keep_point(work, search, BEST, ENDED)
            at_end = same
        if same:
            break
        released = points.known[CURRENT, HALF_COST]
        for _ in range(ROUNDS):
            before = points.known[CURRENT, HALF_COST]
            went = find_boundary(problem, work, search, b, CURRENT)
            went = went and _slide(problem, work, search, b, start, tolerance)
            went = went or _shorten(problem, work, search, b, start, tolerance)
            if went and not improves(work, BEST, CURRENT):
                at_end = False
            if not went or points.known[CURRENT, HALF_COST] > (1.0 - WORTH) * before:
                break
        if points.known[CURRENT, HALF_COST] > (1.0 - WORTH) * released:
            break
    return at_end


@routine
def cross_boundary(problem, work, search, b, j, start, tolerance):  # type: ignore[no-untyped-def]
    """Write as the current point one across the boundary from a lost end, whether there is any.

    What is reached at the end lies on the other side than the equilibrium to which the descent led.
    """
    points, saddle = work.points, search.saddle
    for m in range(points.place.shape[1]):
        points.place[AIM, m] = search.lost_place[j, m]
    if reach_and_keep(problem, work, search, b, AIM, ENDED, start, tolerance) == FAILED:
        return False
    known = find_boundary(problem, work, search, b, ENDED)
    for m in range(points.place.shape[1]):
        saddle.place[1, m] = min(max(search.edge_place[m], 0.0), 1.0)
    _write_way(search, saddle.place[1], -1.0)
    for k in range(len(CROSS)):
        _write_trial(work, search, saddle.place[1], CROSS[k] if known else FLIPS[k])
        if reach_and_keep(problem, work, search, b, AIM, TRIED, start, tolerance) == FAILED:
            continue
        if times_measure(saddle, search.rush[TRIED]) < 0.0:
            keep_point(work, search, CURRENT, TRIED)
            if improves(work, TRIED, BEST):
                keep_point(work, search, BEST, TRIED)
            return True
    return False
