"""Convex polygons in the plane, in batches.

Layout: inside torcharm polygons are kept slots first, batch last, `(V, B)` for each coordinate.
Work that runs along the batch is several times faster than work along a short last dimension.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from torcharm._select import select


@dataclass(frozen=True)
class Polygons:
    """B convex polygons of up to V vertices each, in counter-clockwise order.

    Vertex k and the edge from it to the next vertex share slot k. An edge may be zero: its slot is
    then idle. Edges are kept beside the vertices, not taken as their differences, because the
    direction of a short edge does not survive the rounding of a running sum.

    Attributes:
        x, y: (V, B) vertices.
        edge_x, edge_y: (V, B) edges.
    """

    x: Tensor
    y: Tensor
    edge_x: Tensor
    edge_y: Tensor


def heading_key(edge_x: Tensor, edge_y: Tensor) -> Tensor:
    """A number that grows with an edge's heading, from -π/2 round to (and without) 3π/2.

    The diamond angle: as good as atan2 for sorting, and cheap. A zero edge may go anywhere.
    """
    size = edge_x.abs().add_(edge_y.abs()).add_(torch.finfo(edge_x.dtype).tiny)
    rightward = torch.ones_like(edge_x).copysign_(edge_x + 0.0)  # adding zero turns -0 into 0
    return (edge_y / size).sub_(1.0).mul_(rightward)


def minkowski_sum(start_x: Tensor, start_y: Tensor, edge_x: Tensor, edge_y: Tensor) -> Polygons:
    """The Minkowski sum of convex polygons from all their edges, headed counter-clockwise.

    The sum's boundary is the summands' edges in order of heading. Parallel edges follow one
    another, so identical summands need no care. Differentiable, with the order held.

    Args:
        start_x, start_y: (B) the sum's vertex of least x and, among those, of most y.
        edge_x, edge_y: (V, B) the summands' edges, in any order.
    """
    with torch.no_grad():
        order = heading_key(edge_x, edge_y).argsort(0)
    edge_x, edge_y = edge_x.gather(0, order), edge_y.gather(0, order)
    x = edge_x.cumsum(0).sub_(edge_x).add_(start_x)
    y = edge_y.cumsum(0).sub_(edge_y).add_(start_y)
    return Polygons(x, y, edge_x, edge_y)


def face_square(point: tuple[Tensor, Tensor], start: tuple[Tensor, Tensor], end: tuple[Tensor, Tensor]) -> Tensor:
    """Squared distance from points to segments, differentiable twice in all three.

    Its first derivatives are the envelope's: those of the nearest point are at right angles to
    the residual or at a clamp, and drop out.
    """
    edge_x, edge_y = end[0] - start[0], end[1] - start[1]
    from_x, from_y = point[0] - start[0], point[1] - start[1]
    span = edge_x.square() + edge_y.square()
    idle = (span <= torch.finfo(span.dtype).tiny).to(span.dtype)
    along = ((from_x * edge_x + from_y * edge_y) / (span + idle)).clamp(0, 1) * (1 - idle)
    return (from_x - along * edge_x).square() + (from_y - along * edge_y).square()


def corner_normals(polygons: Polygons, slot: Tensor) -> tuple[Tensor, Tensor]:
    """Outward directions (K, B), not of unit length, at the vertices of slots (K, B).

    Between the normals of the two faces that meet there. Where parallel edges join, that is the
    normal of both; at the end of a polygon without area, the way out; of a point, `(1, 0)`.
    """
    into_x, into_y = _direction_from(polygons, (slot - 1) % len(polygons.x), -1)
    from_x, from_y = _direction_from(polygons, slot, 1)
    normal_x, normal_y = into_y + from_y, -into_x - from_x
    turned_back = normal_x.abs() + normal_y.abs() < 1e-3
    normal_x, normal_y = select(turned_back, into_x, normal_x), select(turned_back, into_y, normal_y)
    return normal_x + ((into_x == 0) & (into_y == 0)).to(normal_x.dtype), normal_y


def _direction_from(polygons: Polygons, slot: Tensor, step: int) -> tuple[Tensor, Tensor]:
    """Unit vectors (K, B) along the first edges that are not idle, from slots on by steps of 1 or -1.

    Zero if all edges are idle.
    """
    edge_x, edge_y = polygons.edge_x.gather(0, slot), polygons.edge_y.gather(0, slot)
    for _ in range(1, len(polygons.x)):
        row, column = ((edge_x == 0) & (edge_y == 0)).nonzero(as_tuple=True)
        if len(row) == 0:
            break
        slot = slot.index_put((row, column), (slot[row, column] + step) % len(polygons.x))
        ahead = slot[row, column], column
        edge_x[row, column], edge_y[row, column] = polygons.edge_x[ahead], polygons.edge_y[ahead]
    length = torch.hypot(edge_x, edge_y).clamp_(min=torch.finfo(edge_x.dtype).tiny)
    return edge_x / length, edge_y / length


def all_faces(polygons: Polygons) -> tuple[Tensor, Tensor, Tensor]:
    """Every slot (B, V) and its face's outward normal, idle slots standing for the face before them.

    A polygon that is a point has no faces; its normals are `(1, 0)`.
    """
    length = torch.hypot(polygons.edge_x, polygons.edge_y).clamp(min=torch.finfo(polygons.x.dtype).tiny)
    along_x, along_y = polygons.edge_x / length, polygons.edge_y / length
    busy = (along_x != 0) | (along_y != 0)
    own = torch.arange(len(busy), device=busy.device).unsqueeze(-1)
    latest = torch.where(busy, own, -1).cummax(0).values
    slot = torch.where(latest < 0, latest[-1:].clamp(min=0), latest)
    normal_x = torch.where(busy.any(0), along_y.gather(0, slot), torch.ones_like(along_y))
    return slot.T, normal_x.T, -along_x.gather(0, slot).T


def convex_hull(x: Tensor, y: Tensor) -> tuple[Polygons, Tensor, Tensor]:
    """The convex hulls of B sets of V points, in any order, duplicates allowed.

    Andrew's two chains over the sorted points, both walked so that a hull turns left. Instead of a
    stack, every point that does not turn left between its present neighbours is dropped at
    once, until none is: such a point lies on or behind the chord of those that stay, so no corner
    is lost, and the passes are few.

    Args:
        x, y: (V, B) points.

    Returns:
        Polygons of 2V slots, most of them idle, and (2V, B) the points each slot's edge joins. The polygons are
        differentiable, with the points that are corners held.
    """
    with torch.no_grad():
        source, target = _hull_edges(x, y)
    corner_x, corner_y = x.gather(0, source), y.gather(0, source)
    polygons = Polygons(corner_x, corner_y, x.gather(0, target) - corner_x, y.gather(0, target) - corner_y)
    return polygons, source, target


def _hull_edges(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """(2V, B) the points that edges of `convex_hull` join."""
    count = x.shape[0]
    order = y.argsort(0)
    order = order.gather(0, x.gather(0, order).argsort(dim=0, stable=True))
    both = torch.stack((order, order.flip(0)))
    chain_x, chain_y = x.gather(0, both.flatten(0, 1)).view_as(both), y.gather(0, both.flatten(0, 1)).view_as(both)

    slot = torch.arange(count, device=x.device).view(1, count, 1)
    inner = (slot > 0) & (slot < count - 1)
    kept = ~(inner & _repeats(chain_x, chain_y))
    while True:
        before, after = _neighbours(kept, slot)
        ahead_x, ahead_y = chain_x.gather(1, after) - chain_x, chain_y.gather(1, after) - chain_y
        behind_x, behind_y = chain_x - chain_x.gather(1, before), chain_y - chain_y.gather(1, before)
        straight = behind_x * ahead_y - behind_y * ahead_x <= 0
        dropped = kept & inner & straight
        if not bool(dropped.any()):
            break
        kept = kept & ~dropped

    here = torch.where(kept, slot, before)
    source = both.gather(1, here).flatten(0, 1)
    return source, torch.where(kept, both.gather(1, after), both.gather(1, here)).flatten(0, 1)


def _repeats(chain_x: Tensor, chain_y: Tensor) -> Tensor:
    """Whether a point of a chain equals the one before it or the chain's last."""
    previous = (chain_x == chain_x.roll(1, 1)) & (chain_y == chain_y.roll(1, 1))
    return previous | ((chain_x == chain_x[:, -1:]) & (chain_y == chain_y[:, -1:]))


def _neighbours(kept: Tensor, slot: Tensor) -> tuple[Tensor, Tensor]:
    """The nearest kept slots before and after each slot of a chain (its ends are their own)."""
    last = kept.shape[1] - 1
    upto = torch.where(kept, slot, torch.zeros_like(slot)).cummax(1).values
    before = torch.cat((torch.zeros_like(upto[:, :1]), upto[:, :-1]), 1)
    since = torch.where(kept, slot, torch.full_like(slot, last)).flip(1).cummin(1).values.flip(1)
    after = torch.cat((since[:, 1:], torch.full_like(since[:, :1], last)), 1)
    return before, after
