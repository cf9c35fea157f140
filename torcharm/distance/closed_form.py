"""Exact distance from points to convex polygons, by projection on every edge."""

from dataclasses import dataclass
from typing import Any, no_type_check

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torcharm._inputs import broadcast_shapes, check_tensor
from torcharm._select import select
from torcharm.polygon import Polygons, convex_hull, corner_normals, face_square

BOUNDARY_ULPS = 8
"""Within so many roundings of the boundary a point counts as on it: its distance is 0."""
INSIDE_ULPS = 2
"""Roundings by which a point must be left of an edge to be on its inner side."""
CLOSE = 1e6
"""Within so many blurs of the boundary a point's direction from it is not to be trusted."""


@dataclass(frozen=True)
class NearestFaces:
    """Where points (B, L) stand to B polygons.

    Attributes:
        square: (B, L) squared distance to the boundary.
        inside: (B, L) whether the point is strictly inside.
        blur: (B, L) the rounding of coordinates this large: what is nearer counts as touching.
        slot: (B, L) the polygon's slot that holds the nearest face, if asked for.
    """

    square: Float[Tensor, "B L"]
    inside: Bool[Tensor, "B L"]
    blur: Float[Tensor, "B L"]
    slot: Int[Tensor, "B L"] | None


def nearest_faces(polygons: Polygons, x: Float[Tensor, "B L"], y: Float[Tensor, "B L"], *, slots: bool) -> NearestFaces:
    """Project L points on every edge of their polygon, clamp, and keep the nearest.

    A point is inside if it is left of every edge. That is asked for, not inferred from a small
    distance; and never true of a polygon without area.

    Args:
        polygons: B polygons.
        x, y: L points for each polygon.
        slots: whether to say which face is nearest (costs a third more).
    """
    real = torch.finfo(x.dtype)
    edge_x, edge_y = polygons.edge_x.unsqueeze(-1), polygons.edge_y.unsqueeze(-1)
    span = (edge_x * edge_x).addcmul_(edge_y, edge_y)
    inverse = (span + real.tiny).reciprocal_()
    never = (span <= real.tiny).to(x.dtype).mul_(real.max / 4)

    from_x, from_y = x - polygons.x.unsqueeze(-1), y - polygons.y.unsqueeze(-1)
    along = (from_x * edge_x).addcmul_(from_y, edge_y).mul_(inverse).clamp_(0, 1)
    width = (span.sum(0) * len(span)).sqrt()  # at least the polygon's own
    size = width + (polygons.x[0].abs() + polygons.y[0].abs()).unsqueeze(-1) + x.abs() + y.abs()
    # Left of every edge by more than the product's rounding: in line with a flat polygon is not inside it.
    extent = edge_x.abs() + edge_y.abs()
    innermost = (edge_x * from_y).addcmul_(edge_y, from_x, value=-1)
    innermost = innermost.addcmul_(extent, size, value=-INSIDE_ULPS * real.eps).add_(never).amin(0)
    inside = (innermost > 0) & (innermost < real.max / 8)
    off_x, off_y = from_x.addcmul_(along, edge_x, value=-1), from_y.addcmul_(along, edge_y, value=-1)
    square = off_x.square_().addcmul_(off_y, off_y)

    blur = BOUNDARY_ULPS * real.eps * size
    if slots:
        nearest, slot = square.min(0)
        return NearestFaces(nearest, inside, blur, slot)
    return NearestFaces(square.amin(0), inside, blur, None)


def _nearest_edges(polygons: Polygons, faces: NearestFaces, x: Tensor, y: Tensor) -> tuple[Tensor, ...]:
    """Of the edges nearest to points (B, L): both components, the points from their starts, and where along them."""
    assert faces.slot is not None
    slot = faces.slot.T
    corner_x, corner_y, edge_x, edge_y = (
        value.gather(0, slot).T for value in (polygons.x, polygons.y, polygons.edge_x, polygons.edge_y)
    )
    from_x, from_y = x - corner_x, y - corner_y
    span = edge_x.square() + edge_y.square()
    return edge_x, edge_y, from_x, from_y, (from_x * edge_x + from_y * edge_y) / (span + torch.finfo(x.dtype).tiny)


def face_normals(
    polygons: Polygons, faces: NearestFaces, x: Float[Tensor, "B L"], y: Float[Tensor, "B L"]
) -> tuple[Float[Tensor, "B L"], Float[Tensor, "B L"]]:
    """Outward unit normals of the nearest faces; at a corner, a direction between its faces' normals.

    Between corners, edge and gap to the point give the same normal; the longer of them gives it
    with less rounding.
    """
    edge_x, edge_y, from_x, from_y, along = _nearest_edges(polygons, faces, x, y)
    outward = 1 - 2 * faces.inside.to(x.dtype)
    off_x, off_y = outward * (from_x - along * edge_x), outward * (from_y - along * edge_y)
    by_edge = edge_x.square() + edge_y.square() > off_x.square() + off_y.square()
    # Of a hull without area either side may be the nearest face; the point is outside both.
    facing = 1 - 2 * (~faces.inside & (edge_y * off_x < edge_x * off_y)).to(x.dtype)
    face_x, face_y = select(by_edge, facing * edge_y, off_x), select(by_edge, -facing * edge_x, off_y)

    assert faces.slot is not None
    slot = faces.slot.T
    turn_x, turn_y = (value.T for value in corner_normals(polygons, (slot + (along.T >= 1)) % len(polygons.x)))
    at_corner = (along <= 0) | (along >= 1)
    normal_x, normal_y = select(at_corner, turn_x, face_x), select(at_corner, turn_y, face_y)
    length = torch.hypot(normal_x, normal_y).clamp(min=torch.finfo(x.dtype).tiny)
    return normal_x / length, normal_y / length


def start_normals(
    polygons: Polygons, faces: NearestFaces, x: Float[Tensor, "B L"], y: Float[Tensor, "B L"]
) -> tuple[Float[Tensor, "B L"], Float[Tensor, "B L"]]:
    """Unit vectors from the polygons' nearest points to the points (inside, the other way).

    Where the two almost touch, the face's normal.
    """
    edge_x, edge_y, from_x, from_y, along = _nearest_edges(polygons, faces, x, y)
    along = along.clamp(0, 1)
    outward = 1 - 2 * faces.inside.to(x.dtype)
    off_x, off_y = outward * (from_x - along * edge_x), outward * (from_y - along * edge_y)
    apart = faces.square > (CLOSE * faces.blur).square()
    normal_x, normal_y = select(apart, off_x, edge_y), select(apart, off_y, -edge_x)
    length = torch.hypot(normal_x, normal_y)
    nowhere = (length <= torch.finfo(x.dtype).tiny).to(x.dtype)
    return (normal_x + nowhere) / (length + nowhere), normal_y / (length + nowhere)


def signed_length(square: Tensor, inside: Tensor, blur: Tensor, *, signed: bool) -> Tensor:
    """The distance: positive outside, zero touching, and inside zero or (signed) minus the margin.

    Differentiable in `square` where the distance is not zero; there the gradient is zero.
    """
    dropped = square <= blur.square()  # and not a NaN
    dropped = dropped if signed else dropped | inside
    length = (1 - dropped.to(square.dtype)) * torch.where(dropped, 1.0, square).sqrt()
    return length * (1 - 2 * inside.to(square.dtype)) if signed else length


class _FaceDistance(torch.autograd.Function):
    """Distances known already, with the envelope's derivatives in polygons (4, V, B) and points (2, B, L)."""

    @staticmethod
    def forward(ctx: Any, length: Tensor, slot: Tensor, polygons: Tensor, points: Tensor) -> Tensor:
        ctx.save_for_backward(length, slot, polygons, points)
        return length.clone()

    @staticmethod
    @no_type_check
    def backward(ctx, slope):
        length, slot, polygons, points = ctx.saved_tensors
        index = slot.expand(4, -1, -1)
        start_x, start_y, edge_x, edge_y = polygons.mT.gather(2, index).unbind(0)
        from_x, from_y = points[0] - start_x, points[1] - start_y
        span = edge_x.square() + edge_y.square()
        along = (from_x * edge_x + from_y * edge_y) / span.clamp(min=torch.finfo(span.dtype).tiny)
        along = along.clamp(0, 1)
        off_x, off_y = from_x - along * edge_x, from_y - along * edge_y
        apart = length != 0
        square = off_x.square() + off_y.square()
        # Where the distance is 0, or a step away from it in rounding, so is the slope.
        apart = apart & (square > 0)
        pull = slope * length.sign() * apart.to(slope.dtype) / torch.where(apart, square, 1.0).sqrt()
        pull_x, pull_y = pull * off_x, pull * off_y
        of_points = torch.stack((pull_x, pull_y))
        of_faces = -torch.stack((pull_x, pull_y, along * pull_x, along * pull_y))
        of_polygons = torch.zeros_like(polygons.mT).scatter_add(2, index, of_faces).mT
        return None, None, of_polygons, of_points


def face_distance(polygons: Polygons, faces: NearestFaces, x: Tensor, y: Tensor, *, signed: bool) -> Tensor:
    """Distances (B, L), as of `signed_length`, to faces already found.

    Differentiable twice in polygons and points, faces held. The first derivatives are the envelope's: the unit
    vector from the nearest point; the nearest point's own move along its face drops out.
    """
    assert faces.slot is not None
    length = signed_length(faces.square, faces.inside, faces.blur, signed=signed)
    sides = torch.stack((polygons.x, polygons.y, polygons.edge_x, polygons.edge_y))
    answer: Tensor = _FaceDistance.apply(length, faces.slot, sides, torch.stack((x, y)))
    return answer


def distance_to_hull(
    point: Float[Tensor, "*#batch 2"], vertices: Float[Tensor, "*#batch V 2"], *, signed: bool = False
) -> Float[Tensor, "..."]:
    """Distance from points to the convex hulls of point sets in the plane.

    Differentiable in both arguments. The gradient is zero inside (unless signed) and on the
    boundary; where two faces are equally near it is that of one of them.

    Args:
        point: where from.
        vertices: V points in any order, duplicates allowed; their hull may be a segment or a point.
        signed: whether points inside get minus their distance to the boundary.

    Raises:
        ValueError: shapes do not fit, or there is no vertex.
    """
    check_tensor("point", point, 2)
    if isinstance(vertices, Tensor) and vertices.ndim > 1 and vertices.shape[-2] == 0:
        raise ValueError("vertices: must hold at least one point, got none")
    check_tensor("vertices", vertices, "V", 2)
    batch = broadcast_shapes(point=point.shape[:-1], vertices=vertices.shape[:-2])
    flat_point = point.expand(*batch, 2).reshape(-1, 2)
    flat = vertices.expand(*batch, *vertices.shape[-2:]).reshape(-1, *vertices.shape[-2:])
    with torch.no_grad():
        polygons, source, target = convex_hull(flat[..., 0].T.contiguous(), flat[..., 1].T.contiguous())
        faces = nearest_faces(polygons, flat_point[:, :1], flat_point[:, 1:], slots=True)
        assert faces.slot is not None
        ends = torch.cat((source.gather(0, faces.slot.T), target.gather(0, faces.slot.T))).T
    start, end = flat.gather(1, ends.unsqueeze(-1).expand(-1, -1, 2)).unbind(1)
    square = face_square(_columns(flat_point), _columns(start), _columns(end))
    length = signed_length(square, faces.inside[:, 0], faces.blur[:, 0], signed=signed)
    return length.reshape(batch)


def _columns(pairs: Tensor) -> tuple[Tensor, Tensor]:
    return pairs[:, 0], pairs[:, 1]
