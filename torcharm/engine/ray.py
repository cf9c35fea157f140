"""Where a ray `start + t direction` leaves an attainable set: the largest t, for batches of designs, shapes and loads.

The distance d(t) of the ray's point from the set is convex in t. From a t beyond the set Newton's method goes to where
the ray meets the plane that separates point and set: with its normal n, `t ← (h(n) - n·start) / (n·direction)`, h the
set's support function. Whatever n is, the set lies before that plane: t falls, and never below where the ray leaves the
set. Of a set with corners the steps are finitely many, of a smooth one they converge quadratically. A ray that misses
the set is known by a plane that it does not come nearer to: `n·direction ≤ 0`. The least t is the largest along the
opposite direction.
"""

import math
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64

from torcharm.engine.arrays import Array
from torcharm.engine.compilation import kernel, part
from torcharm.engine.copies import copy_row
from torcharm.engine.distance import GAP, TOUCHING, curve_support, nearest_part
from torcharm.engine.node_sets import aim, keep_answer, measure, write_node
from torcharm.engine.references import by_reference
from torcharm.engine.sharpen import BEYOND, sharpen_part

STEPS = 60
"""Steps of Newton's method at most: 3 to 6 are usual. Where the ray grazes a round set each only halves the rest."""
PARALLEL = 32 * float(np.finfo(np.float64).eps)
"""A cosine between plane and ray below which they count as parallel: what rounding makes of a right angle."""
PROBE = 1e-10
"""So far beyond its end, as a part of the problem's size, the ray is looked at for normal, weights and pressures:
nearer to the set rounding would turn the normal, and further away the nearest points are others by as much."""
FOUND, MISSED, UNBOUNDED = 0, 1, 2
"""What became of a ray."""


@by_reference
class Ray(NamedTuple):
    """Scratch for one ray."""

    start: Float64[Array, "D"]
    direction: Float64[Array, "D"]


@by_reference
class Ends(NamedTuple):
    """Where rays enter (even rows) and leave (odd rows) the sets of B designs, P shapes, L loads and N nodes."""

    factor: Float64[Array, "2*B P L N"]  # t; entry above exit if the ray misses the set, infinite if it stays within
    slack: Float64[Array, "2*B P L N"]  # how far off rounding may put t
    gap: Float64[Array, "2*B P L N"]  # the distance from the set that is left at the end, of the problem's size
    normal: Float64[Array, "2*B P L N D"]  # outward unit normals; empty if not asked for, like what follows
    weight: Float64[Array, "2*B P L N D"]  # of the points of the set whose mix is where the ray ends
    pressure: Float64[Array, "2*B P L N D M"]  # of these points [kPa]


@part
def along(normal, vector):  # type: ignore[no-untyped-def]
    """`n·v`."""
    total = 0.0
    for c in range(len(normal)):
        total += normal[c] * vector[c]
    return total


@part
def write_direction(ray, direction, h, l, i, relative):  # type: ignore[no-untyped-def]
    """Write what the load adds to the wrench asked of a node."""
    for c in range(len(ray.direction)):
        ray.direction[c] = direction[h, l, i, c]
        if relative:
            ray.direction[c] -= direction[h, l, 0, c]


@part
def go_to(simplex, ray, t):  # type: ignore[no-untyped-def]
    """Write the ray's point at t as the target; returns the sum of the sizes of what it is made of."""
    size = 0.0
    for c in range(len(ray.start)):
        simplex.target[c] = ray.start[c] + t * ray.direction[c]
        size += abs(ray.start[c]) + abs(t * ray.direction[c])
    return size


def leave_part(D: int, ask: Any, nearest: Any) -> Any:
    """`leave` for wrenches of D components, of support points and nearest points as from `distance`."""
    sharpen = sharpen_part(D)

    @part
    def ahead(curves, simplex, distance, size):  # type: ignore[no-untyped-def]
        """How far the target lies beyond a supporting plane; its normal is kept.

        It is the plane that was last asked for, or that across the shortest way to the set, if that one is further from
        the target and the first is not as far as the set.
        """
        first = -math.inf
        for attempt in range(2):
            ask(curves, simplex)
            beyond = -along(simplex.normal, simplex.point)
            if beyond >= distance - 10.0 * GAP * size:
                return beyond
            if attempt == 0:
                first = beyond
                length = math.sqrt(along(simplex.nearest, simplex.nearest))
                for c in range(D):
                    simplex.trial[c] = simplex.normal[c]
                    simplex.normal[c] = -simplex.nearest[c] / length
            elif beyond < first:
                for c in range(D):
                    simplex.normal[c] = simplex.trial[c]
            else:
                first = beyond
        return first

    @part
    def leave(curves, simplex, ray, extent, still, probe):  # type: ignore[no-untyped-def]
        """The largest t, how far off rounding may put it, the distance that is left, and what became of the ray.

        Args:
            extent: the most that the curves' numbers can add up to.
            still: whether the direction is nothing but rounding.
            probe: whether normal, weights and pressures are wanted.
        """
        length = math.sqrt(along(ray.direction, ray.direction))
        for c in range(D):
            simplex.normal[c] = ray.direction[c] / length if length > 0.0 else 1.0
        t, end, rate, slack, left, gap, probing = 0.0, 0.0, length, 0.0, 0.0, 0.0, False
        for step in range(STEPS):
            size = extent + go_to(simplex, ray, t)
            distance = -math.inf  # at first only the plane across the ray is asked for
            if step > 0 or still:
                distance, gap, _ = nearest(curves, simplex, size)
            beyond = ahead(curves, simplex, distance, size) if distance != 0.0 else 0.0
            if still:
                return math.inf, 0.0, 0.0, UNBOUNDED if distance == 0.0 else MISSED
            if probing:
                if distance > 0.0:
                    sharpen(curves, simplex, BEYOND * max(gap, GAP * size) / distance)
                return end, slack, left, FOUND
            end = t
            if distance == -math.inf:
                t -= beyond / length
                continue
            left = distance / size if size > 0.0 else 0.0
            if beyond > TOUCHING * size:
                towards = along(simplex.normal, ray.direction)
                if towards <= PARALLEL * length:
                    return t, 0.0, 0.0, MISSED
                rate = towards
                t -= beyond / rate
                if t < end:
                    continue
            slack = TOUCHING * size / rate
            if not probe:
                return end, slack, left, FOUND
            probing = True
            t = end + PROBE * size / rate
        return end, slack, max(left, 1.0), FOUND

    return leave


@cache
def ray_kernel(dimension: int) -> Any:
    """The kernel for wrenches of so many components."""
    ask = curve_support(dimension)
    nearest = nearest_part(dimension, ask)
    leave = leave_part(dimension, ask, nearest)

    @part
    def holds(curves, simplex, ray, extent, t):  # type: ignore[no-untyped-def]
        """Whether the set holds the ray's point at t."""
        size = extent + go_to(simplex, ray, t)
        distance, _, _ = nearest(curves, simplex, size)
        return distance == 0.0

    @kernel
    def ends_of_rays(sections, start, direction, still, relative, least, begin, end, scratch, ray, ends):  # type: ignore[no-untyped-def]
        """Of designs from `begin` to `end`; starts (B, P, L, N, D), directions (P, L, N, D), of which `still` are none.

        Args:
            least: whether of all nodes only the least exit is wanted: where a set holds the point of the least exit of
                the nodes before, its own is left infinite, and no entry is looked for.
        """
        curves = scratch.change if relative else scratch.own
        simplex = scratch.simplex
        wanted = len(ends.normal) > 0
        for b in range(begin, end):
            for h in range(start.shape[1]):
                for i in range(start.shape[3]):
                    write_node(sections, scratch, b, h, i, relative)
                    extent = measure(curves, scratch.middle)
                    for l in range(start.shape[2]):
                        aim(sections, start, scratch, b, h, l, i, relative)
                        write_direction(ray, direction, h, l, i, relative)
                        copy_row(ray.start, simplex.target)
                        lowest = math.inf
                        for before in range(i if least else 0):
                            lowest = min(lowest, ends.factor[2 * b + 1, h, l, before])
                        passed = math.isfinite(lowest) and holds(curves, simplex, ray, extent, lowest)
                        for side in range(2):
                            at = (2 * b + side, h, l, i)
                            sign = 1.0 if side == 1 else -1.0
                            if passed or (least and side == 0):
                                ends.factor[at], ends.slack[at], ends.gap[at] = sign * math.inf, 0.0, 0.0
                                for c in range(dimension):
                                    ray.direction[c] = -ray.direction[c]
                                continue
                            for c in range(dimension):
                                ray.direction[c] = -ray.direction[c]
                            t, slack, left, became = leave(curves, simplex, ray, extent, still[h, l, i], wanted)
                            if became == MISSED:
                                t = -math.inf
                            ends.factor[at] = sign * t
                            ends.slack[at] = slack
                            ends.gap[at] = left
                            keep_answer(ends, simplex, at)

    return ends_of_rays
