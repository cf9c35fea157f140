"""The distance of a point from the convex hull of vertices, in D dimensions, outside and inside.

The iterations are those of sets of curves (`distance`, `depth`); here the support function is the largest of the
vertices' products with the normal.
"""

from functools import cache
from typing import Any

import numpy as np

from torcharm.engine.compilation import kernel, part
from torcharm.engine.depth import signed_distance_part
from torcharm.engine.distance import nearest_part
from torcharm.engine.node_sets import keep_answer
from torcharm.engine.sharpen import leave_as_it_is


@cache
def vertex_support(D: int) -> Any:
    """`ask` for hulls of vertices in D components."""

    @part
    def ask(vertices, simplex):  # type: ignore[no-untyped-def]
        """Find the vertex of (V, D) furthest along the normal, seen from the target; its number is its pressure.

        Products are taken of differences from the target, which keep their digits far from the origin. No vertex moves
        as the normal turns: none is smooth.
        """
        best, at = -np.inf, 0
        for v in range(len(vertices)):
            reach = 0.0
            for c in range(D):
                reach += simplex.normal[c] * (vertices[v, c] - simplex.target[c])
            if reach > best:
                best, at = reach, v
        simplex.fresh[0] = at
        for c in range(D):
            simplex.point[c] = vertices[at, c] - simplex.target[c]
        return 0

    return ask


@part
def aim_at(vertices, point, simplex):  # type: ignore[no-untyped-def]
    """Begin with the direction from the middle of the vertices' box; returns the problem's size, and its coordinates'.

    The size is the most that differences from the point can add up to; what coordinates add up to decides on rounding.
    """
    size, coordinates = 0.0, 0.0
    for c in range(len(point)):
        low, high = np.inf, -np.inf
        for v in range(len(vertices)):
            low, high = min(low, vertices[v, c]), max(high, vertices[v, c])
        simplex.target[c] = point[c]
        simplex.normal[c] = point[c] - 0.5 * (low + high)
        size += max(abs(low - point[c]), abs(high - point[c]))
        coordinates += max(abs(low), abs(high)) + abs(point[c])
    return size, coordinates


@cache
def vertex_kernel(dimension: int, signed: bool = False) -> Any:
    """The kernel for so many components, which measures from the outside or, signed, from both sides."""
    ask = vertex_support(dimension)
    nearest, signed_distance = nearest_part(dimension, ask), signed_distance_part(dimension, ask, leave_as_it_is)

    @kernel
    def vertex_distances(vertices, points, rounding, begin, end, simplex, polytope, answers):  # type: ignore[no-untyped-def]
        """Of hulls from `begin` to `end` of vertices (B, V, D), for points (B, L, D).

        Distances below `rounding` of the coordinates' size are 0. Answers are those of B designs of one shape and node.
        """
        for b in range(begin, end):
            for l in range(points.shape[1]):
                size, coordinates = aim_at(vertices[b], points[b, l], simplex)
                if signed:
                    distance, gap = signed_distance(vertices[b], simplex, polytope, size)
                else:
                    distance, gap, _ = nearest(vertices[b], simplex, size)
                answers.distance[b, 0, l, 0] = distance if abs(distance) > rounding * coordinates else 0.0
                answers.gap[b, 0, l, 0] = gap / size if size > 0.0 else gap
                keep_answer(answers, simplex, (b, 0, l, 0))

    return vertex_distances
