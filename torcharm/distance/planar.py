"""The exact answer in the plane as convex weights, and the edges of a hull as pairs of vertices."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torcharm.distance.closed_form import nearest_faces
from torcharm.distance.result import HullAnswer, HullDistance, HullProblem, solve_hulls
from torcharm.polygon import convex_hull

CHUNK = 100_000
"""Problems answered at once, over their vertices."""
SLIVER = 1e-9
"""As half-spaces, edges shorter than this over max|H - w| are left out, for their direction may be rounding;
and so are polygons of a smaller width, for their interior may be."""


def planar_distance(point: Float[Tensor, "*#batch 2"], vertices: Float[Tensor, "*#batch V 2"]) -> HullDistance:
    """The closed form's distance from points to convex hulls in the plane, with its residuals.

    The same polygons and faces as `distance_to_hull`, read as convex weights, so that the answer can be
    checked like any other solver's. Differentiable once, with the weights held.

    Args:
        point: where from.
        vertices: V points in any order, duplicates allowed.

    Raises:
        ValueError: there is no vertex, or dimensions or batches do not fit.
    """

    def answer(problem: HullProblem) -> HullAnswer:
        index = torch.arange(len(problem.offsets), device=problem.offsets.device)
        with torch.no_grad():
            weights, touching = planar_weights(problem, index)
        never = torch.zeros_like(touching)
        return HullAnswer(weights, touching, never, problem.length(weights, touching), torch.zeros_like(problem.blur))

    if point.shape[-1] != 2:
        raise ValueError(f"point: must have 2 coordinates, got {point.shape[-1]}")
    return solve_hulls(point, vertices, answer, max(1, CHUNK // max(1, vertices.shape[-2])))


def planar_weights(problem: HullProblem, index: Tensor) -> tuple[Tensor, Tensor]:
    """Weights (b, V) of the nearest points, and whether (b) the points touch, of some problems."""
    offsets = problem.offsets.detach()[index]
    polygons, source, target = convex_hull(*coordinate_rows(problem.vertices.detach()[index]))
    point = problem.point.detach()[index]
    faces = nearest_faces(polygons, point[:, :1], point[:, 1:], slots=True)
    assert faces.slot is not None
    edges = PlanarEdges(source.T, target.T, torch.ones_like(index, dtype=torch.bool))
    share = edge_share(*edges.ends(offsets))
    on_face = spread_weights(offsets, (edges.source, 1 - share), (edges.target, share), slot=faces.slot)
    blur = faces.blur * (problem.eps / torch.finfo(point.dtype).eps)
    touching = faces.square <= blur.square()
    # Between edges that are only rounding apart a point may seem inside: there a face is as near.
    weights = torch.where(faces.inside & ~touching, edges.inner_weights(offsets), on_face)
    return weights, (faces.inside | touching)[:, 0]


@dataclass(frozen=True)
class PlanarEdges:
    """The edges of B convex hulls in the plane, as pairs of vertices; idle ones join a vertex to itself.

    Attributes:
        source, target: (B, E) vertices, counter-clockwise.
        usable: (B) whether the edges enclose an area.
    """

    source: Tensor
    target: Tensor
    usable: Tensor

    @classmethod
    def of(cls, offsets: Tensor) -> "PlanarEdges":
        """The hulls' edges, with no more idle ones than the largest hull needs."""
        polygons, source, target = convex_hull(*coordinate_rows(offsets.detach()))
        span = torch.hypot(polygons.edge_x, polygons.edge_y)
        idle = span < SLIVER
        target = torch.where(idle, source, target)
        order = idle.to(torch.uint8).argsort(dim=0, stable=True)[: max(1, int((~idle).sum(0).max()))]
        area = (polygons.x * polygons.edge_y - polygons.y * polygons.edge_x).sum(0)
        usable = area >= SLIVER * span.sum(0)
        return cls(source.gather(0, order).T, target.gather(0, order).T, usable)

    def ends(self, offsets: Tensor) -> tuple[Tensor, Tensor]:
        """Both ends (B, E, 2) of the edges."""
        return _pick(offsets, self.source), _pick(offsets, self.target)

    def halfspaces(self, offsets: Tensor) -> tuple[Tensor, Tensor]:
        """Outward unit normals (B, E, 2) and bounds (B, E): `normal · x ≤ bound` in the hull; idle ones 0 ≤ 1."""
        start, end = self.ends(offsets)
        edge = end - start
        idle = (self.source == self.target).unsqueeze(-1)
        outward = torch.stack((edge[..., 1], -edge[..., 0]), -1)
        span = torch.linalg.vector_norm(torch.where(idle, torch.ones_like(edge), edge), dim=-1, keepdim=True)
        normal = torch.where(idle, torch.zeros_like(edge), outward / span)
        bound = (normal * start).sum(-1)
        return normal, torch.where(idle.squeeze(-1), torch.ones_like(bound), bound)

    def weights(self, offsets: Tensor, near: Tensor) -> Tensor:
        """Convex weights (B, V) of the points of edges nearest to `near` (B, 2); of the origin, if it is inside."""
        start, end = self.ends(offsets)
        share = edge_share(start - near.unsqueeze(-2), end - near.unsqueeze(-2))
        gap = torch.linalg.vector_norm(start + share.unsqueeze(-1) * (end - start) - near.unsqueeze(-2), dim=-1)
        slot = gap.argmin(-1, keepdim=True)
        on_edge = spread_weights(offsets, (self.source, 1 - share), (self.target, share), slot=slot)
        inside = (self.halfspaces(offsets)[1] >= 0).all(-1, keepdim=True)
        return torch.where(inside, self.inner_weights(offsets), on_edge)

    def inner_weights(self, offsets: Tensor) -> Tensor:
        """Convex weights (B, V) of the origin, if it is inside: in that triangle of a fan that holds it."""
        start, end = self.ends(offsets)
        apex = start[:, :1].expand_as(start)
        areas = torch.stack((_cross(start, end), _cross(end, apex), _cross(apex, start)))
        total = areas.sum(0)
        flat = total <= torch.finfo(total.dtype).tiny
        parts = areas / torch.where(flat, torch.ones_like(total), total)
        slot = torch.where(flat, -torch.inf, parts.amin(0)).argmax(-1, keepdim=True)
        parts = parts.clamp(min=0)
        parts = parts / parts.sum(0)
        first = self.source[:, :1].expand_as(self.source)
        return spread_weights(offsets, (first, parts[0]), (self.source, parts[1]), (self.target, parts[2]), slot=slot)


def coordinate_rows(pairs: Tensor) -> tuple[Tensor, Tensor]:
    """(B, V, 2) as coordinates (V, B)."""
    return pairs[..., 0].T.contiguous(), pairs[..., 1].T.contiguous()


def _pick(offsets: Tensor, index: Tensor) -> Tensor:
    return offsets.gather(1, index.unsqueeze(-1).expand(-1, -1, 2))


def _cross(a: Tensor, b: Tensor) -> Tensor:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def edge_share(start: Tensor, end: Tensor) -> Tensor:
    """Where on segments the point nearest to the origin lies: 0 at their start, 1 at their end."""
    edge = end - start
    span = edge.square().sum(-1)
    idle = span <= torch.finfo(span.dtype).tiny
    share = -(start * edge).sum(-1) / torch.where(idle, torch.ones_like(span), span)
    return torch.where(idle, torch.zeros_like(share), share.clamp(0, 1))


def spread_weights(offsets: Tensor, *terms: tuple[Tensor, Tensor], slot: Tensor) -> Tensor:
    """Weights (B, V) from pairs of vertices and shares (B, E), of the edges in slots (B, 1)."""
    weights = torch.zeros_like(offsets[..., 0])
    for vertex, share in terms:
        weights = weights.scatter_add(1, vertex.gather(1, slot), share.gather(1, slot))
    return weights
