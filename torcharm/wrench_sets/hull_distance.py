"""What a solver of distances to hulls answers, and how far its answer can be trusted.

A set is the convex hull of vertices or, in G groups, the sum of such hulls: `Σ_α Conv(vertices of group α)`, with one
simplex of weights for each group. Solvers that look for these weights share this frame: inputs are brought to one flat,
scaled batch in float64, and every answer is checked from its weights alone.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torcharm.inputs import HoldsTensors, broadcast_shapes, check_count
from torcharm.wrench_sets.once import once

TOLERANCE = 1e-6
"""Largest primal residual, and largest error of the distance over max|H - w|, of a converged answer."""
ROUNDINGS = 16
"""So many roundings of the coordinates' size a distance must exceed to be one; below it is 0."""


@dataclass(frozen=True, eq=False, repr=False)
class HullDistance(HoldsTensors):
    """Distances from points to sets given by vertices, with what it takes to trust them.

    `value` is differentiable where its solver says so, once; everything else carries no gradient.
    An element with a number that is not finite has NaN everywhere and is not converged; so does one that its solver
    could not answer.

    Attributes:
        value: distance, in the unit of the points; exactly 0 inside and on the boundary.
        nearest: the set's point nearest to `point`; `point` itself where the value is 0.
        weights: convex weights of the vertices, of each group by itself; they mix to `nearest`.
        primal, dual, gap: relative residuals of the weights, as of `kkt_residuals`.
        converged: whether the residuals are within tolerance.
        resolved: whether an exact method answered, because the solver asked for had failed.

    Example:
        >>> ta.nnls_distance(torch.ones(2), torch.eye(2)).nearest.round(decimals=3).tolist()  # of (1, 0) to (0, 1)
        [0.5, 0.5]
    """

    value: Float[Tensor, "*batch"]
    nearest: Float[Tensor, "*batch D"]
    weights: Float[Tensor, "*batch V"]
    primal: Float[Tensor, "*batch"]
    dual: Float[Tensor, "*batch"]
    gap: Float[Tensor, "*batch"]
    converged: Bool[Tensor, "*batch"]
    resolved: Bool[Tensor, "*batch"]


@dataclass(frozen=True, eq=False)
class KktResiduals(HoldsTensors):
    """How far weights are from optimal; nothing has a unit.

    Attributes:
        primal: how far the weights are from convex.
        dual: how far a point of the set lies below the supporting plane that the weights claim.
        gap: primal minus dual objective.
        error: a bound on how much the distance is too long, over the scale.
        length: the distance that the weights give, over the scale.
    """

    primal: Float[Tensor, "*batch"]
    dual: Float[Tensor, "*batch"]
    gap: Float[Tensor, "*batch"]
    error: Float[Tensor, "*batch"]
    length: Float[Tensor, "*batch"]


def kkt_residuals(
    point: Float[Tensor, "*#batch D"],
    vertices: Float[Tensor, "*#batch V D"],
    weights: Float[Tensor, "*#batch V"],
    *,
    groups: int = 1,
) -> KktResiduals:
    """Residuals of weights s as a solution of `min_s ½‖Hᵀ s - w‖², s ≥ 0`, with a sum of 1 in each group.

    With H̃ = H - w/G of G groups, the scale c = max|H̃|, the residual vector r = H̃ᵀ s, the gradient g = H̃ r, and m the
    sum of each group's least g:

        primal = max(|Σs - 1|, max(-s))
        dual   = max(0, μ - m) / c²,   μ = s·g
        gap    = (½‖r‖² - (m - ½‖r‖²)) / c²
        error  = (‖r‖ - max(0, m) / ‖r‖) / c

    Since s·g = ‖r‖², gap and μ - m are one number: of this problem the duality gap *is* the
    largest violation of stationarity, and `dual` is its positive part. The plane with normal r at
    distance m / ‖r‖ separates w from the set, so `error` bounds the distance's relative error, and
    ‖r - r*‖ ≤ c √gap that of the nearest point, whatever solver the weights came from.

    Computed in float64 and without gradients; independent of units and of any solver's claim.

    Args:
        point: where from.
        vertices: V points, group after group.
        weights: one for each vertex.
        groups: G, into which the vertices are divided evenly.

    Raises:
        ValueError: the groups do not divide the vertices evenly.

    Example:
        >>> good, bad = torch.tensor([0.5, 0.5]), torch.tensor([1.0, 0.0])  # weights of (1, 0) and (0, 1)
        >>> [round(float(ta.kkt_residuals(torch.ones(2), torch.eye(2), weights).gap), 3) for weights in (good, bad)]
        [0.0, 1.0]
    """
    check_groups(groups, vertices.shape[-2])
    with torch.no_grad():
        offsets, _, _ = _scaled_offsets(point.double(), vertices.double(), groups)
        found = offset_residuals(offsets, weights.double(), groups)
    dtype = torch.promote_types(torch.promote_types(point.dtype, vertices.dtype), weights.dtype)
    return KktResiduals(*(value.to(dtype) for value in vars(found).values()))


def offset_residuals(
    offsets: Float[Tensor, "*#batch V D"], weights: Float[Tensor, "*#batch V"], groups: int
) -> KktResiduals:
    """`kkt_residuals` of vertices that are already taken relative to the point and scaled."""
    residual = mix(weights, offsets)
    slope = (offsets * residual.unsqueeze(-2)).sum(-1)
    square, least = residual.square().sum(-1), slope.unflatten(-1, (groups, -1)).amin(-1).sum(-1)
    length = square.sqrt()
    support = least.clamp(min=0) / torch.where(length > 0, length, torch.ones_like(length))
    sums = weights.unflatten(-1, (groups, -1)).sum(-1)
    primal = torch.maximum((sums - 1).abs().amax(-1), (-weights).amax(-1))
    multiplier = (weights * slope).sum(-1)
    return KktResiduals(
        primal=primal.expand_as(square),
        dual=(multiplier - least).clamp(min=0),
        gap=0.5 * square - (least - 0.5 * square),
        error=(length - support).clamp(min=0),
        length=length,
    )


def mix(weights: Tensor, vertices: Tensor) -> Tensor:
    """Σ weights · vertices, (..., D)."""
    return (weights.unsqueeze(-1) * vertices).sum(-2)


def check_groups(groups: int, count: int) -> None:
    """Raise a ValueError unless the groups divide so many vertices evenly."""
    if count % check_count("groups", groups, 1):
        raise ValueError(f"groups: must divide the {count} vertices evenly, got {groups}")


@dataclass(frozen=True, eq=False)
class HullProblem:
    """B finite problems, scaled so that nothing overflows and no unit matters.

    Attributes:
        groups: G.
        point: (B, D), divided by a power of two near the largest coordinate: exact.
        offsets: (B, V, D) vertices minus a G-th of the point, divided by their largest entry.
        unit: (B) that power of two.
        scale: (B) that largest entry, 1 where it is zero. An offset times scale times unit is in the user's unit.
        blur: (B) the rounding of coordinates this large, on the scale of the offsets.
    """

    groups: int
    point: Tensor
    offsets: Tensor
    unit: Tensor
    scale: Tensor
    blur: Tensor

    def length(self, weights: Tensor, touching: Tensor) -> Tensor:
        """Length (B) of the mixed offset, differentiable in the offsets with the weights held.

        Where the point touches the set the residual is rounding, and its direction nothing: there
        it is a constant.
        """
        residual = mix(weights.detach(), self.offsets)
        residual = torch.where(touching.unsqueeze(-1), torch.ones_like(residual), residual)
        return torch.linalg.vector_norm(residual, dim=-1)


@dataclass(frozen=True, eq=False)
class HullAnswer:
    """What a solver found for B problems.

    Attributes:
        weights: (B, V); NaN where it found none.
        touching: (B) whether the point is inside or on the boundary.
        resolved: (B) whether an exact method had to answer.
        length: (B) distance on the scale of the offsets, with whatever gradient it has.
    """

    weights: Tensor
    touching: Tensor
    resolved: Tensor
    length: Tensor


def solve_hulls(
    point: Float[Tensor, "*#batch D"],
    vertices: Float[Tensor, "*#batch V D"],
    groups: int,
    solve: Callable[[HullProblem], HullAnswer],
    chunk_size: int,
) -> HullDistance:
    """Broadcast, scale, take out what is not finite, solve chunk by chunk, and check the answers.

    Raises:
        ValueError: there is no vertex, or dimensions, batches or groups do not fit.
    """
    count, dimension = vertices.shape[-2:]
    if count == 0:
        raise ValueError("vertices: must hold at least one point, got none")
    if point.shape[-1] != dimension:
        raise ValueError(f"vertices: must have the point's {point.shape[-1]} coordinates, got {dimension}")
    check_groups(groups, count)
    batch = broadcast_shapes(point=tuple(point.shape[:-1]), vertices=tuple(vertices.shape[:-2]))
    eps = max(torch.finfo(point.dtype).eps, torch.finfo(vertices.dtype).eps)
    flat_point = once(point).double().expand(*batch, dimension).reshape(-1, dimension)
    flat = once(vertices).double().expand(*batch, count, dimension).reshape(-1, count, dimension)

    finite = (flat_point.isfinite().all(-1) & flat.isfinite().flatten(1).all(-1)).nonzero().squeeze(-1)
    parts = []
    for index in finite.split(chunk_size) if len(finite) else ():
        problem = _problem(flat_point[index], flat[index], groups, eps)
        parts.append(_checked(problem, solve(problem)))
    columns = [torch.cat(column) for column in zip(*parts, strict=True)] if parts else None
    if columns is None or len(finite) < len(flat):
        columns = _placed(columns, finite, flat)
    dtype = torch.promote_types(point.dtype, vertices.dtype)
    shaped = (column.reshape((*batch, *column.shape[1:])) for column in columns)
    return HullDistance(*(column if column.dtype == torch.bool else column.to(dtype) for column in shaped))


def _checked(problem: HullProblem, answer: HullAnswer) -> tuple[Tensor, ...]:
    """The columns of a HullDistance."""
    touching = answer.touching
    length = torch.where(touching, torch.zeros_like(answer.length), answer.length)
    with torch.no_grad():
        found = offset_residuals(problem.offsets, answer.weights, problem.groups)
        converged = (found.primal <= TOLERANCE) & (found.error <= TOLERANCE)
        step = mix(answer.weights, problem.offsets).masked_fill(touching.unsqueeze(-1), 0.0)
        unit = problem.unit.unsqueeze(-1)
        nearest = (problem.point + step * problem.scale.unsqueeze(-1)) * unit
    value = length * problem.scale * problem.unit
    return value, nearest, answer.weights, found.primal, found.dual, found.gap, converged, answer.resolved


def _placed(columns: list[Tensor] | None, index: Tensor, flat: Tensor) -> list[Tensor]:
    """Columns with NaN, or False, for the elements that were taken out."""
    total, count, dimension = flat.shape
    real = [(), (dimension,), (count,), (), (), ()]
    empty = [flat.new_full((total, *shape), float("nan")) for shape in real]
    empty += [torch.zeros(total, dtype=torch.bool, device=flat.device) for _ in range(2)]
    if columns is None:
        return empty
    return [full.index_copy(0, index, column) for full, column in zip(empty, columns, strict=True)]


def _problem(point: Tensor, vertices: Tensor, groups: int, eps: float) -> HullProblem:
    offsets, unit, scale = _scaled_offsets(point, vertices, groups)
    with torch.no_grad():
        furthest = vertices.abs().unflatten(1, (groups, -1)).amax(2).sum((1, 2))
        blur = ROUNDINGS * eps * (furthest / unit + point.abs().sum(-1) / unit) / scale
    return HullProblem(groups, point / unit.unsqueeze(-1), offsets, unit, scale, blur)


def _scaled_offsets(point: Tensor, vertices: Tensor, groups: int) -> tuple[Tensor, Tensor, Tensor]:
    """Vertices minus a group's part of the point over their largest entry; and that entry as a unit times a scale.

    The unit is a power of two, so that dividing by it rounds nothing, and differences of
    the largest numbers do not overflow.
    """
    with torch.no_grad():
        unit = power_of_two(torch.maximum(point.abs().amax(-1), vertices.abs().flatten(-2).amax(-1)))
    difference = vertices / unit[..., None, None] - (point / (groups * unit.unsqueeze(-1))).unsqueeze(-2)
    with torch.no_grad():
        scale = difference.abs().flatten(-2).amax(-1)
        scale = torch.where(scale > 0, scale, torch.ones_like(scale))
    return difference / scale[..., None, None], unit, scale


def power_of_two(size: Tensor) -> Tensor:
    """The power of two at or just below sizes; 1 for zero."""
    size = torch.where(size > 0, size, torch.ones_like(size))
    return size / (2 * torch.frexp(size).mantissa)
