"""Nearest points from outside of sets whose curves are written out, by way of small polygons inside the sets."""

from dataclasses import dataclass

import numpy as np

from torcharm._arrays import Array, pick
from torcharm.distance.closed_form import BOUNDARY_ULPS, INSIDE_ULPS
from torcharm.distance.newton import solve
from torcharm.distance.problems import problems_of
from torcharm.distance.rings import rings
from torcharm.distance.touch import CurveSums


@dataclass(frozen=True)
class Outside:
    """Where points (B, L) stand to B sets.

    Attributes:
        square: squared distances to the sets; of points inside, to the polygons.
        inside: whether they are strictly inside.
        blur: as of `NearestFaces`.
        fraction: (2, M, B, L) pressure fractions at the ends of the faces that were searched for, if asked for; else 0.
        converged: whether they are within rounding of a set, or as far outside as was proved.
    """

    square: Array
    inside: Array
    blur: Array
    fraction: Array | None
    converged: Array


@dataclass(frozen=True)
class _Edges:
    """Those of B polygons counter-clockwise, (V, B) each: where they begin, and the edges themselves."""

    x: Array
    y: Array
    edge_x: Array
    edge_y: Array


@np.errstate(all="ignore")  # of a NaN there is no distance, and it says so
def nearest_outside(sums: CurveSums, x: Array, y: Array, *, fractions: bool) -> Outside:
    """Nearest faces to points x, y (B, L)."""
    edges = _polygons(sums)
    square, slot, inside, blur = _nearest(edges, x, y)
    wanted = ~(inside | (square <= blur * blur))  # a NaN is wanted, and not found
    section, load = wanted.nonzero()
    converged, fraction = ~wanted, None
    if fractions:
        fraction = np.zeros((2, len(sums.radii), *square.shape), square.dtype)
    if len(section):
        place = section, load
        begin = slot[place] * x.shape[0] + section
        edge = _Edges(*(value.reshape(-1).take(begin) for value in vars(edges).values()))
        problems = problems_of(
            x[place],
            y[place],
            edge.x,
            edge.y,
            edge.edge_x,
            edge.edge_y,
            square[place],
            np.zeros(len(section), dtype=bool),
            blur[place],
        )
        own = sums if x.shape[1] == 1 and len(section) == len(x) else pick(sums, section)
        found = solve(problems, own, fractions=fractions)
        # The polygon lies inside the set: the distance from it bounds that from the set.
        nearer = np.sqrt(found.square) <= problems.distance + 2 * problems.tolerance
        better = found.done & (nearer | found.inside)
        square[place] = np.where(better, found.square, square[place])
        inside[place], converged[place] = found.inside & better, better
        if fraction is not None and found.fraction is not None:
            fraction[:, :, section, load] = found.fraction[:, sums.order]
    return Outside(square, inside, blur, fraction, converged)


def _polygons(sums: CurveSums) -> _Edges:
    """The sums of the curves' rings, as of `minkowski_sum`: edges in order of heading, from the leftmost point."""
    u, force, turn = rings(sums)
    # The graph of force over pressure turns the other way in the (f, m) plane if the moment grows with pressure.
    falls = sums.bending < 0
    turn = np.where(sums.bending > 0, -turn, turn)
    rise = np.concatenate((force[1:], force[:1])) - force
    step = np.concatenate((u[1:], u[:1])) - u
    edge_x = turn * rise
    edge_y = (turn * sums.bending) * step - edge_x * sums.radii
    edge_x *= sums.scale[0]
    least = force.min(0)
    ties = force == least
    start = np.where(falls, np.where(ties, u, np.inf).min(0), np.where(ties, u, -np.inf).max(0))
    edge_x, edge_y = edge_x.reshape(-1, edge_x.shape[-1]), edge_y.reshape(-1, edge_y.shape[-1])
    size = np.abs(edge_x) + np.abs(edge_y) + np.finfo(edge_x.dtype).tiny
    order = np.where(edge_x < 0, 1 - edge_y / size, edge_y / size - 1).argsort(0)
    order *= edge_x.shape[1]
    order += np.arange(edge_x.shape[1])
    edge_x, edge_y = edge_x.reshape(-1).take(order), edge_y.reshape(-1).take(order)
    x, y = np.empty_like(edge_x), np.empty_like(edge_y)
    x[0], y[0] = sums.places(start, least)
    for slot in range(len(x) - 1):
        np.add(x[slot], edge_x[slot], x[slot + 1])
        np.add(y[slot], edge_y[slot], y[slot + 1])
    return _Edges(x, y, edge_x, edge_y)


def _nearest(edges: _Edges, x: Array, y: Array) -> tuple[Array, Array, Array, Array]:
    """Of points (B, L) the squared distances from polygons, the nearest edges, whether they are inside, and blurs.

    As of `nearest_faces`.
    """
    real = np.finfo(x.dtype)
    begin_x, begin_y, edge_x, edge_y = (value[..., None] for value in vars(edges).values())
    span = edge_x * edge_x + edge_y * edge_y
    from_x, from_y = x - begin_x, y - begin_y
    along = from_x * edge_x
    along += from_y * edge_y
    along /= span + real.tiny
    np.maximum(along, 0, out=along)
    np.minimum(along, 1, out=along)
    width = np.sqrt(span.sum(0) * len(span))
    size = width + np.abs(begin_x[0]) + np.abs(begin_y[0]) + np.abs(x) + np.abs(y)
    left = edge_x * from_y
    left -= edge_y * from_x
    left -= (INSIDE_ULPS * real.eps) * (np.abs(edge_x) + np.abs(edge_y)) * size
    idle = span <= real.tiny
    inside = ((left > 0) | idle).all(0) & ~idle.all(0)
    from_x -= along * edge_x
    from_y -= along * edge_y
    square = from_x * from_x
    square += from_y * from_y
    slot = square.argmin(0)
    return square.min(0), slot, inside, BOUNDARY_ULPS * real.eps * size
