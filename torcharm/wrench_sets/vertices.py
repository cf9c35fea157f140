"""Distances from points to hulls of vertices: found by the engine, evaluated once more by torch for gradients."""

from math import prod

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torcharm.engine.arrays import make
from torcharm.engine.depth import Polytope, sizes_of_set
from torcharm.engine.node_sets import Answers
from torcharm.engine.simplex import Simplex
from torcharm.engine.threads import spread
from torcharm.engine.vertices import vertex_kernel
from torcharm.inputs import broadcast_shapes, check_flag, check_tensor, shown
from torcharm.wrench_sets.distance import CERTIFIED
from torcharm.wrench_sets.hull_distance import ROUNDINGS, power_of_two
from torcharm.wrench_sets.once import once

DIMENSIONS = (2, 3)
"""Components that the engine is written for."""


@torch.no_grad()
def find_nearest_vertices(point: Tensor, vertices: Tensor, *, signed: bool = False) -> tuple[Tensor, ...]:
    """Ask the engine for distances from points (B, L, D) to the hulls of vertices (B, V, D), in float64 on the CPU.

    A distance below 16 roundings of the coordinates' size is 0; roundings are those of the points' dtype.

    Returns:
        Without a graph, and NaN where a number is not finite: distances (B, L), 0 inside or, signed, negative; whether
        they are known to rounding (B, L); unit normals (B, L, D); and of the vertices whose mix is nearest the weights
        (B, L, D), and which these are (B, L, D).
    """
    dimension, eps = point.shape[-1], torch.finfo(point.dtype).eps
    points, corners = point.double().cpu(), vertices.double().cpu()
    finite = points.isfinite().all(-1) & corners.isfinite().flatten(1).all(-1, keepdim=True)
    # the engine gets numbers only; what had none is told so below, by `finite`
    points, corners = points.nan_to_num(0.0, 0.0, 0.0), corners.nan_to_num(0.0, 0.0, 0.0)
    unit = power_of_two(torch.maximum(points.abs().amax((1, 2)), corners.abs().amax((1, 2))))
    contiguous = [np.ascontiguousarray((x / unit.view(-1, 1, 1)).numpy()) for x in (points, corners)]
    sizes = sizes_of_set(1, dimension)
    answers = make(Answers, sizes | {"B": points.shape[0], "L": points.shape[1], "P": 1, "N": 1})
    kernel = vertex_kernel(dimension, signed)

    def work(first: int, last: int) -> None:
        simplex, polytope = make(Simplex, sizes), make(Polytope, sizes)
        kernel(contiguous[1], contiguous[0], ROUNDINGS * eps, first, last, simplex, polytope, answers)

    spread(len(points), work)
    distance, gap, normal, weight, vertex, _ = (torch.from_numpy(part[:, 0, :, 0]) for part in answers)
    distance = torch.where(finite, distance * unit.unsqueeze(-1), torch.nan)
    normal = torch.where(finite.unsqueeze(-1), normal, torch.nan)
    found = distance.to(point), ((gap <= CERTIFIED) & finite).to(point.device), normal.to(point), weight.to(point)
    return *found, vertex.squeeze(-1).long().to(point.device)


def distance_to_hull(
    point: Float[Tensor, "*#batch D"], vertices: Float[Tensor, "*#batch V D"], *, signed: bool = False
) -> Float[Tensor, "..."]:
    """Distance from points to the convex hulls of point sets, in the plane or in space.

    Known to 1e-12 of the largest difference between a vertex and its point (signed, inside: 1e-10). Below 16 roundings
    of the coordinates it is 0. Where a number is not finite it is NaN.

    Differentiable once in both arguments, by the envelope theorem: the gradient in the point is the unit normal. It is
    zero inside (unless signed) and on the boundary; where two faces are equally near it is that of one of them.

    Args:
        point: where from; D is 2 or 3.
        vertices: V points in any order, duplicates allowed; their hull may be flat, a segment or a point.
        signed: whether points inside get minus their distance to the boundary.

    Raises:
        ValueError: shapes do not fit, or there is no vertex.

    Example:
        >>> square = torch.tensor([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
        >>> ta.distance_to_hull(torch.tensor([[2.0, 0.5], [0.5, 0.75]]), square, signed=True).tolist()  # out and in
        [1.0, -0.25]
    """
    check_flag("signed", signed)
    if isinstance(vertices, Tensor) and vertices.ndim > 1 and vertices.shape[-2] == 0:
        raise ValueError("vertices: must hold at least one point, got none")
    dimension = point.shape[-1] if isinstance(point, Tensor) and point.ndim else 2
    if dimension not in DIMENSIONS:
        raise ValueError(f"point: must have 2 or 3 coordinates, got {shown(point)}")
    check_tensor("point", point, dimension)
    check_tensor("vertices", vertices, "V", dimension)
    batch = broadcast_shapes(point=point.shape[:-1], vertices=vertices.shape[:-2])
    dtype = torch.promote_types(point.dtype, vertices.dtype)
    # What shares vertices comes last, and is measured against one hull.
    sizes = (*[1] * (len(batch) - vertices.ndim + 2), *vertices.shape[:-2])
    own = [axis for axis, size in enumerate(sizes) if size != 1]
    shared = [axis for axis, size in enumerate(sizes) if size == 1]
    hulls = vertices.to(dtype).reshape(-1, *vertices.shape[-2:])
    points = point.to(dtype).expand(*batch, dimension).permute(*own, *shared, len(batch))
    order = tuple(points.shape[:-1])
    points = points.reshape(len(hulls), prod(batch[axis] for axis in shared), dimension)
    found = _distance(once(points), once(hulls), signed=signed).reshape(order)
    return found.permute([(own + shared).index(axis) for axis in range(len(batch))])


def _distance(point: Tensor, vertices: Tensor, *, signed: bool) -> Tensor:
    """Distances (B, L) of points (B, L, D) from hulls of vertices (B, V, D)."""
    if not point.numel():
        return point.sum(-1)
    found, _, normal, weight, vertex = find_nearest_vertices(point, vertices, signed=signed)
    if not (torch.is_grad_enabled() and (point.requires_grad or vertices.requires_grad)):
        return found
    count, dimension = len(vertices), vertices.shape[-1]
    places = vertex.reshape(count, -1, 1).expand(-1, -1, dimension)
    corner = vertices.gather(1, places).unflatten(1, vertex.shape[1:])
    away = (weight.unsqueeze(-1) * (point.unsqueeze(-2) - corner)).sum(-2)
    distance = (normal * away).sum(-1)
    return torch.where(found == 0, torch.zeros_like(distance), distance)
