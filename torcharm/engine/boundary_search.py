"""Search along the boundary of what load continuation reaches, where a descent led over it.

The best pressure on the branch of the descent is on the boundary then, or near. A descent along its tangent, set back
on it, leads to the next pressures; all are evaluated at equilibria nearby. What comes of it is loaded from zero, a
little away from the boundary, where continuation can be followed. Where that leads elsewhere still, another boundary is
in between, and the search goes on along that.
"""

import math

from torcharm.engine.bifurcation import find_saddle, times_measure, write_changes
from torcharm.engine.box_step import largest_curvature
from torcharm.engine.compilation import part
from torcharm.engine.continuation import FAILED
from torcharm.engine.copies import copy_row, copy_rows
from torcharm.engine.descent import STEPS, descend
from torcharm.engine.newton_step import first_angular
from torcharm.engine.pressure_model import (
    FEW_EVALUATIONS,
    HALF_COST,
    STABLE,
    add_wall,
    copy_point,
    distance_of,
    evaluate_point,
)
from torcharm.engine.search_state import (
    AIM,
    BEST,
    CURRENT,
    ENDED,
    LOST,
    NEAR,
    SAME_BRANCH,
    TRIED,
    improves,
    keep_lost,
    keep_point,
    reach_and_keep,
)

SAME_SHAPE = 1e-4
"""Difference of two shapes, as of `move_size`, that counts as none: both are solved to within 1e-8."""
ROUNDS, SLIDE_STEPS = 12, 8
"""Descents along a boundary, at most, and steps of each, after which it is found again: it is curved."""
BOUNDARIES = 3
"""Boundaries that are followed one after the other, at most."""
WORTH = 1e-4
"""Share of the cost that a step along a boundary must save to be followed by another, or a lost end by a search."""
HALVINGS = 4
"""Of the way between two points on either side of a boundary, from which Newton's method does not find it."""
NEWTON_STEPS, AGAIN_STEPS = 12, 6
"""To the boundary; and from there to other pressures on it."""
STIFF = 300.0
"""Of the wall in a descent along a boundary, over the largest curvature: across it a descent goes a 300th of the way,
and is set back. The stiffer it is, the shorter are the first steps along it."""
PARTS = (1.0, 0.3, 0.1)
"""Parts of a step along the boundary that are tried."""
CLOSE = 1e-4
"""Newton step left to equilibria along the boundary, as of `move_size`."""
MARGINS = (5e-5, 1e-3, 1e-2)
"""Distances from the boundary, in lengths of the box: the first is kept along it, and from there and then from the
others the arm is loaded. Continuation is the harder to follow the closer it is."""
STEEP = 1e-3
"""Least share of a step that goes across a boundary: along a bound of the box that nearly touches it there is no way
back."""


@part
def _write_way(search, pressure):  # type: ignore[no-untyped-def]
    """Write the way away from the boundary, along bounds of the box."""
    length = 0.0
    for m in range(len(pressure)):
        n = search.edge_normal[m]
        inner = n if (pressure[m] > 0.0 or n > 0.0) and (pressure[m] < 1.0 or n < 0.0) else 0.0
        search.way[m] = inner
        length += inner * inner
    for m in range(len(pressure)):
        search.way[m] /= max(math.sqrt(length), 1e-9)


@part
def _keep_boundary(search, forwards):  # type: ignore[no-untyped-def]
    """Keep the boundary that was found, with the normal into a half space."""
    saddle, side = search.saddle, 0.0
    for m in range(len(forwards)):
        side += saddle.normal[m] * forwards[m]
    for m in range(len(forwards)):
        search.edge_pressure[m] = saddle.normalised[0, m]
        search.edge_normal[m] = -saddle.normal[m] if side < 0.0 else saddle.normal[m]
        copy_rows(search.edge_shift[m], saddle.shift[m])
    copy_rows(search.edge_twists, saddle.twists[0])
    search.edge_factor[0] = saddle.factor[0]


@part
def _find_boundary(problem, work, search, b, at, sign):  # type: ignore[no-untyped-def]
    """Write the boundary next to a point that was reached; whether it is found.

    The normal is into the point's own side, or, if the sign is -1, to the other.

    It is looked for in the direction in which the arm gives way more where it gives way most: next to a bifurcation all
    changes are along one vector.
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
    copy_rows(saddle.twists[0], search.quick[at])
    saddle.factor[0] = search.factor[at]
    copy_row(saddle.normalised[0], points.normalised[at])
    write_changes(problem, work, saddle, b, 0)
    length = 0.0
    for m in range(points.normalised.shape[1]):
        search.edge_normal[m] = times_measure(saddle, work.change[1 + m])
        length += search.edge_normal[m] ** 2
    if not math.isfinite(length) or length == 0.0:
        return False
    for m in range(points.normalised.shape[1]):
        search.edge_normal[m] /= sign * math.sqrt(length)
    _write_way(search, points.normalised[at])
    copy_row(saddle.way, search.way)
    if not find_saddle(problem, work, saddle, b, NEWTON_STEPS):
        return False
    _keep_boundary(search, search.edge_normal)
    return True


@part
def _between(problem, work, search, b, start, tolerance):  # type: ignore[no-untyped-def]
    """Write the boundary between the near point and where the current point's pressures lead; whether it is found.

    Newton's method is tried from both; then the way between them is halved. The current point becomes the near one
    if the boundary is found from there.
    """
    points = work.points
    if reach_and_keep(problem, work, search, b, CURRENT, ENDED, start, tolerance) == FAILED:
        return False
    nearer = False
    for k in range(1 + HALVINGS):
        if not nearer and _find_boundary(problem, work, search, b, ENDED, -1.0):
            return True
        if (nearer or k == 0) and _find_boundary(problem, work, search, b, NEAR, 1.0):
            copy_point(points, CURRENT, NEAR)
            return True
        for m in range(points.normalised.shape[1]):
            points.normalised[AIM, m] = 0.5 * (points.normalised[NEAR, m] + points.normalised[ENDED, m])
        if reach_and_keep(problem, work, search, b, AIM, TRIED, start, tolerance) == FAILED:
            return False
        if improves(work, TRIED, BEST):
            keep_point(work, search, BEST, TRIED)
        nearer = distance_of(problem, work, b, TRIED, NEAR) < distance_of(problem, work, b, TRIED, ENDED)
        keep_point(work, search, NEAR if nearer else ENDED, TRIED)
    return False


@part
def _write_trial(work, search, margin):  # type: ignore[no-untyped-def]
    """Write the pressures of a trial, a margin along the way from the boundary, in the box."""
    pressure = work.points.normalised[AIM]
    for m in range(len(pressure)):
        pressure[m] = min(max(search.edge_pressure[m], 0.0), 1.0)
    _write_way(search, pressure)
    for m in range(len(pressure)):
        pressure[m] = min(max(pressure[m] + margin * search.way[m], 0.0), 1.0)


@part
def _descend_along(problem, work, search, b):  # type: ignore[no-untyped-def]
    """The slot to which a descent from the current point leads along the boundary's tangent, a margin away."""
    points = work.points
    copy_point(points, 0, CURRENT)
    stiffness = math.sqrt(STIFF * largest_curvature(points.curvature[0]))
    work.wall_at[0] = stiffness * MARGINS[0]
    for m in range(points.normalised.shape[1]):
        work.wall[m] = stiffness * search.edge_normal[m]
        work.wall_at[0] += work.wall[m] * search.edge_pressure[m]
    add_wall(work, 0)
    along, _ = descend(problem, work, b, 0, 1, False, math.inf, SLIDE_STEPS)
    work.wall_at[0] = 0.0
    for m in range(points.normalised.shape[1]):
        work.wall[m] = 0.0
    return along


@part
def _set_back(problem, work, search, b, along, part_of_it):  # type: ignore[no-untyped-def]
    """Go part of the way to a slot's pressures, set back on the boundary: write what is next to it on the branch as the
    point of a trial, whether there is any. The boundary is not yet kept."""
    points, saddle, count = work.points, search.saddle, work.points.normalised.shape[1]
    _write_way(search, points.normalised[along])
    steep = across = 0.0
    for m in range(count):
        saddle.way[m] = search.way[m]
        steep += search.edge_normal[m] * search.way[m]
        across += search.edge_normal[m] * part_of_it * (points.normalised[along, m] - search.edge_pressure[m])
    copy_rows(saddle.twists[0], search.edge_twists)
    saddle.factor[0] = search.edge_factor[0]
    for m in range(count):
        move = part_of_it * (points.normalised[along, m] - search.edge_pressure[m])
        move -= saddle.way[m] * across / max(steep, STEEP)
        saddle.normalised[0, m] = search.edge_pressure[m] + move
        for i in range(saddle.measure.shape[0]):
            for c in range(saddle.measure.shape[1]):
                saddle.twists[0, i, problem.arms.unknown[c]] += search.edge_shift[m, i, c] * move
    if not find_saddle(problem, work, saddle, b, AGAIN_STEPS):
        return False
    begun = along if part_of_it == 1.0 else CURRENT
    copy_rows(work.path.trial, points.twists[begun])
    for m in range(count):
        pressure = min(max(saddle.normalised[0, m], 0.0), 1.0) + MARGINS[0] * search.way[m]
        points.normalised[TRIED, m] = min(max(pressure, 0.0), 1.0)
        move = points.normalised[TRIED, m] - points.normalised[begun, m]
        for i in range(saddle.measure.shape[0]):
            for c in range(saddle.measure.shape[1]):
                work.path.trial[i, problem.arms.unknown[c]] += points.rates[begun, m, i, c] * move
    return evaluate_point(problem, work, b, TRIED, CLOSE, FEW_EVALUATIONS) and points.known[TRIED, STABLE] > 0.0


@part
def _slide(problem, work, search, b):  # type: ignore[no-untyped-def]
    """Descend along the boundary that is known, from the branch of the current point; whether that leads anywhere."""
    points, value = work.points, math.inf
    for _ in range(ROUNDS):
        before, along = value, _descend_along(problem, work, search, b)
        if not math.isfinite(points.known[along, HALF_COST]):
            break
        for part_of_it in PARTS:
            if not _set_back(problem, work, search, b, along, part_of_it):
                continue
            if points.known[TRIED, HALF_COST] < value:
                value = points.known[TRIED, HALF_COST]
                copy_point(points, CURRENT, TRIED)
                _keep_boundary(search, search.edge_normal)
                break
        if not value < (1.0 - WORTH) * before:
            break
    return math.isfinite(value)


@part
def release(problem, work, search, b, at, start, tolerance):  # type: ignore[no-untyped-def]
    """Descend freely from a slot, and load the arm at the end; whether that is the best point then, of the same shape.

    An end that is not reached is kept.
    """
    points = work.points
    copy_point(points, 0, at)
    end, _ = descend(problem, work, b, 0, 1, False, math.inf, STEPS)
    if not math.isfinite(points.known[end, HALF_COST]):
        return False
    how = reach_and_keep(problem, work, search, b, end, ENDED, start, tolerance)
    same = how != FAILED and distance_of(problem, work, b, end, ENDED) <= SAME_SHAPE
    if not same:
        keep_lost(problem, work, search, b, end, at)
    if not improves(work, ENDED, BEST):
        return False
    keep_point(work, search, BEST, ENDED)
    return same


@part
def follow_boundary(problem, work, search, b, at, start, tolerance):  # type: ignore[no-untyped-def]
    """Search along the boundary that a lost end is behind; whether the best point is the end of a descent then."""
    points = work.points
    copy_point(points, CURRENT, at)
    keep_point(work, search, NEAR, at + LOST)
    for _ in range(BOUNDARIES):
        if not _between(problem, work, search, b, start, tolerance):
            break
        if not _slide(problem, work, search, b):  # the branch may end where the descent has
            copy_point(points, CURRENT, NEAR)
            if not _slide(problem, work, search, b):
                break
        for margin in MARGINS:
            _write_trial(work, search, margin)
            if reach_and_keep(problem, work, search, b, AIM, TRIED, start, tolerance) == FAILED:
                continue
            better = improves(work, TRIED, BEST)
            if better:
                keep_point(work, search, BEST, TRIED)
            if distance_of(problem, work, b, CURRENT, TRIED) > SAME_BRANCH:
                continue
            inwards = 0.0
            for m in range(points.normalised.shape[1]):
                inwards += points.gradient[TRIED, m] * search.edge_normal[m]
            return better and inwards < 0.0 and release(problem, work, search, b, TRIED, start, tolerance)
    return False
