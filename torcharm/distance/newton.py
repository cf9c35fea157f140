"""From polygons to the sets they lie in, by Newton's method on the normal.

The distance from w to a convex set with support function h is `max_n n·w - h(n)` over unit vectors n; inside,
its negative is the least `h(n) - n·w`. Where a line with normal n touches the set, at s, the derivative in
the normal's angle is `t·(w - s)` with t to the left of n, and the second one minus the distance to s along n and the
boundary's radius of curvature there. `n·(w - s)` is a lower bound on the distance, `|w - s|` and the distance from a
polygon inside the set are upper ones: their gap says when it is found.
"""

import numpy as np

from torcharm._arrays import Array, pick
from torcharm.distance.brackets import CLOSING, FEWER, search
from torcharm.distance.problems import Found, Problems
from torcharm.distance.touch import CurveSums, Touch

STEPS = 6
"""So many steps of Newton's are taken without looking left or right."""


@np.errstate(all="ignore")
def solve(problems: Problems, curves: CurveSums, *, fractions: bool) -> Found:
    """Search for all nearest points at once; those that are done are left out."""
    count, actuators, curves = len(problems.side), len(curves.radii), curves.afresh()
    none, no = np.zeros_like(problems.side), np.zeros(count, dtype=bool)
    fraction = np.zeros((2, actuators, count), none.dtype) if fractions else None
    found = Found(none, no, fraction, no.copy())
    first = _step(problems, curves, found)
    left = (~found.done).nonzero()[0]
    if len(left):
        if len(left) < count:
            problems, curves, first = pick((problems, curves, first), left)
        search(problems, curves, found, left, first)
    return found


def _step(p: Problems, curves: CurveSums, found: Found) -> Touch:
    """Newton's steps alone, as long as they close in: all that most points outside need. And what was touched first."""
    x, y = p.point
    tolerance, number = p.tolerance, np.arange(len(p.side))
    # Of no face, the distance from the polygon does not say where the nearest point is.
    most = p.distance if found.fraction is None else np.full_like(p.distance, np.inf)
    before = np.full_like(most, np.inf)
    first = touch = curves.touch(*p.normal)
    for _ in range(STEPS):
        from_x, from_y = x - touch.x, y - touch.y
        over, aside = touch.nx * from_x + touch.ny * from_y, touch.nx * from_y - touch.ny * from_x
        squared = aside * aside
        distance = np.sqrt(over * over + squared)
        done = squared <= tolerance * (distance + over)
        if found.fraction is None:
            distance = np.where(done, distance, most)
            done |= np.abs(most - over) <= tolerance
        else:
            done &= ~(touch.margin <= tolerance).any(0)
        done &= over > tolerance
        if touch.rest is not None:
            done &= touch.rest <= tolerance
        fresh = done.nonzero()[0]
        own = number[fresh]
        found.square[own], found.done[own] = np.square(distance[fresh]), True
        if found.fraction is not None:
            found.fraction[:, :, own] = touch.u[:, fresh]
        left = ((np.abs(aside) < CLOSING * np.abs(before)) & ~done & (over > 0)).nonzero()[0]
        if 2 * len(left) <= len(found.done) - int(found.done.sum()):
            break  # most of what is left, if anything is, has to be searched for
        before = aside
        if len(left) < FEWER * len(number):
            curves, touch, x, y, over, aside, tolerance, most, number, before = pick(
                (curves, touch, x, y, over, aside, tolerance, most, number, before), left
            )
        steep = over + touch.radius
        turn = curves.turn(touch, aside / steep, steep)
        nx: Array = touch.nx - turn * touch.ny
        ny: Array = touch.ny + turn * touch.nx
        length = np.sqrt(nx * nx + ny * ny)
        touch = curves.touch(nx / length, ny / length)
    return first
