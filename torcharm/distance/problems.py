"""Searches for points' nearest ones on sets of curves that are written out: what is asked, and what is found."""

from dataclasses import dataclass

import numpy as np

from torcharm._arrays import Array
from torcharm.distance.closed_form import BOUNDARY_ULPS

GAP = 1e-12
"""By how much the two bounds of a distance may differ, relative to the size of the coordinates."""
LEAST_GAP = 8.0
"""The same in blurs, where numbers hold less."""


@dataclass(frozen=True)
class Problems:
    """Q searches for a nearest point.

    Attributes:
        point: (2, Q) x and y.
        normal: (2, Q) outward unit vectors to start from, those of a polygon inside the set.
        side: (Q) 1 outside the polygon and -1 inside.
        distance: (Q) to it.
        tolerance: (Q) what counts as nothing, as a length.
        edge: (Q) whether the polygon's nearest point lies inside an edge.
        ends: (2, 2, Q) ends of the nearest edge, clockwise first, and x and y.
    """

    point: Array
    normal: Array
    side: Array
    distance: Array
    tolerance: Array
    edge: Array
    ends: Array


@dataclass(frozen=True)
class Found:
    """What came of Q problems.

    Attributes:
        square: (Q) squared distances; meaningless unless done.
        inside: (Q).
        fraction: (2, M, Q) pressure fractions at both ends of the nearest faces, if asked for.
        done: (Q).
    """

    square: Array
    inside: Array
    fraction: Array | None
    done: Array


def gap_of(blur: Array) -> Array:
    """By how much the two bounds of distances may differ."""
    gap: Array = blur * max(LEAST_GAP, GAP / (BOUNDARY_ULPS * float(np.finfo(blur.dtype).eps)))
    return gap


def problems_of(
    x: Array,
    y: Array,
    begin_x: Array,
    begin_y: Array,
    edge_x: Array,
    edge_y: Array,
    square: Array,
    inside: Array,
    blur: Array,
) -> Problems:
    """Searches for points' nearest ones, from polygons' nearest edges, (Q) each.

    Args:
        x, y: the points.
        begin_x, begin_y, edge_x, edge_y: the edges.
        square: squared distances from them.
        inside: whether points are inside the polygons.
        blur: as of `NearestFaces`.
    """
    tiny = np.finfo(x.dtype).tiny
    side = 1 - 2 * inside.astype(x.dtype)
    from_x, from_y, span = x - begin_x, y - begin_y, edge_x * edge_x + edge_y * edge_y
    foot = from_x * edge_x + from_y * edge_y
    edge = (foot > 0) & (foot < span)
    share = np.clip(foot / np.maximum(span, tiny), 0, 1)
    # Of a polygon without area the point may be on either side of either edge.
    facing = np.sign(side * (from_x * edge_y - from_y * edge_x))
    nx = np.where(edge, facing * edge_y, side * (from_x - share * edge_x))
    ny = np.where(edge, -facing * edge_x, side * (from_y - share * edge_y))
    length = np.hypot(nx, ny)
    nowhere = (length <= tiny).astype(x.dtype)
    normal = np.stack((nx + nowhere, ny)) / (length + nowhere)
    begin = np.stack((begin_x, begin_y))
    ends = np.stack((begin, begin + np.stack((edge_x, edge_y))))
    turned = facing < 0
    if turned.any():
        ends = np.where(turned, ends[::-1], ends)
    return Problems(np.stack((x, y)), normal, side, np.sqrt(square), gap_of(blur), edge & (nowhere == 0), ends)
