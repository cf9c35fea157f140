"""What a distance solver answers, and how far its answer can be trusted.

Solvers that look for convex weights (qpth, scipy) share this frame: inputs are brought to one flat,
scaled batch in float64, and every answer is checked from its weights alone.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torcharm._inputs import broadcast_shapes
from torcharm.distance.closed_form import BOUNDARY_ULPS

TOLERANCE = 1e-6
"""Largest primal residual, and largest error of the distance over max|H - w|, of a converged answer."""


@dataclass(frozen=True, eq=False)
class HullDistance:
    """Distances from points to convex hulls, with what it takes to trust them.

    `value` is differentiable where its solver says so, once; everything else carries no gradient.
    An element with a number that is not finite has NaN everywhere and is not converged.

    Attributes:
        value: distance, in the unit of the points; exactly 0 inside and on the boundary.
        nearest: the hull's point nearest to `point`; `point` itself where the value is 0.
        weights: convex weights of the vertices; they mix to `nearest`.
        primal, dual, gap: relative residuals of the weights, as of `kkt_residuals`.
        converged: whether the residuals are within tolerance.
        resolved: whether an exact method answered, because the solver asked for had failed.
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
class KktResiduals:
    """How far weights are from optimal; nothing has a unit.

    Attributes:
        primal: how far the weights are from convex.
        dual: how far a vertex lies below the supporting line that the weights claim.
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
    point: Float[Tensor, "*#batch D"], vertices: Float[Tensor, "*#batch V D"], weights: Float[Tensor, "*#batch V"]
) -> KktResiduals:
    """Residuals of convex weights s as a solution of `min_s ½‖Hᵀ s - w‖², s ≥ 0, 1ᵀs = 1`.

    With the scale c = max|H - w|, the residual vector r = (H - w)ᵀ s and the gradient g = (H - w) r:

        primal = max(|Σs - 1|, max(-s))
        dual   = max(0, μ - min g) / c²,   μ = s·g
        gap    = (½‖r‖² - (min g - ½‖r‖²)) / c²
        error  = (‖r‖ - max(0, min g) / ‖r‖) / c

    Since s·g = ‖r‖², gap and μ - min g are one number: of this problem the duality gap *is* the
    largest violation of stationarity, and `dual` is its positive part. The plane with normal r at
    distance min g / ‖r‖ separates w from the hull, so `error` bounds the distance's relative error, and
    ‖r - r*‖ ≤ c √gap that of the nearest point, whatever solver the weights came from.

    Computed in float64 and without gradients; independent of units and of any solver's claim.

    Args:
        point: where from.
        vertices: V points.
        weights: one for each vertex.
    """
    with torch.no_grad():
        offsets, _, _ = _scaled_offsets(point.double(), vertices.double())
        found = offset_residuals(offsets, weights.double())
    dtype = torch.promote_types(torch.promote_types(point.dtype, vertices.dtype), weights.dtype)
    return KktResiduals(*(value.to(dtype) for value in vars(found).values()))


def offset_residuals(offsets: Float[Tensor, "*#batch V D"], weights: Float[Tensor, "*#batch V"]) -> KktResiduals:
    """`kkt_residuals` of vertices that are already taken relative to the point and scaled."""
    residual = mix(weights, offsets)
    slope = (offsets * residual.unsqueeze(-2)).sum(-1)
    square, least = residual.square().sum(-1), slope.amin(-1)
    length = square.sqrt()
    support = least.clamp(min=0) / torch.where(length > 0, length, torch.ones_like(length))
    primal = torch.maximum((weights.sum(-1) - 1).abs(), (-weights).amax(-1))
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


@dataclass(frozen=True, eq=False)
class HullProblem:
    """B finite problems, scaled so that nothing overflows and no unit matters.

    Attributes:
        point: (B, D), divided by a power of two near the largest coordinate: exact.
        vertices: (B, V, D), divided by the same.
        offsets: (B, V, D) vertices minus point, divided by their largest entry.
        unit: (B) that power of two.
        scale: (B) that largest entry, 1 where it is zero. An offset times scale times unit is in the user's unit.
        blur: (B) the rounding of coordinates this large, on the scale of the offsets.
        eps: the inputs' relative rounding.
    """

    point: Tensor
    vertices: Tensor
    offsets: Tensor
    unit: Tensor
    scale: Tensor
    blur: Tensor
    eps: float

    def length(self, weights: Tensor, touching: Tensor) -> Tensor:
        """Length (B) of the mixed offset, differentiable in the offsets with the weights held.

        Where the point touches the hull the residual is rounding, and its direction nothing: there
        it is a constant.
        """
        residual = mix(weights.detach(), self.offsets)
        residual = torch.where(touching.unsqueeze(-1), torch.ones_like(residual), residual)
        return torch.linalg.vector_norm(residual, dim=-1)


@dataclass(frozen=True, eq=False)
class HullAnswer:
    """What a solver found for B problems.

    Attributes:
        weights: (B, V).
        touching: (B) whether the point is inside or on the boundary.
        resolved: (B) whether an exact method had to answer.
        length: (B) distance on the scale of the offsets, with whatever gradient it has.
        slack: (B) a primal residual that the weights do not show.
    """

    weights: Tensor
    touching: Tensor
    resolved: Tensor
    length: Tensor
    slack: Tensor


def solve_hulls(
    point: Float[Tensor, "*#batch D"],
    vertices: Float[Tensor, "*#batch V D"],
    solve: Callable[[HullProblem], HullAnswer],
    chunk_size: int,
) -> HullDistance:
    """Broadcast, scale, take out what is not finite, solve chunk by chunk, and check the answers.

    Raises:
        ValueError: there is no vertex, or dimensions or batches do not fit.
    """
    count, dimension = vertices.shape[-2:]
    if count == 0:
        raise ValueError("vertices: must hold at least one point, got none")
    if point.shape[-1] != dimension:
        raise ValueError(f"vertices: must have the point's {point.shape[-1]} coordinates, got {dimension}")
    batch = broadcast_shapes(point=tuple(point.shape[:-1]), vertices=tuple(vertices.shape[:-2]))
    eps = max(torch.finfo(point.dtype).eps, torch.finfo(vertices.dtype).eps)
    flat_point = _once(point).double().expand(*batch, dimension).reshape(-1, dimension)
    flat = _once(vertices).double().expand(*batch, count, dimension).reshape(-1, count, dimension)

    finite = (flat_point.isfinite().all(-1) & flat.isfinite().flatten(1).all(-1)).nonzero().squeeze(-1)
    parts = []
    for index in finite.split(chunk_size) if len(finite) else ():
        problem = _problem(flat_point[index], flat[index], eps)
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
        found = offset_residuals(problem.offsets, answer.weights)
        primal = torch.maximum(found.primal, answer.slack)
        converged = (primal <= TOLERANCE) & (found.error <= TOLERANCE)
        step = mix(answer.weights, problem.offsets).masked_fill(touching.unsqueeze(-1), 0.0)
        unit = problem.unit.unsqueeze(-1)
        nearest = (problem.point + step * problem.scale.unsqueeze(-1)) * unit
    return (
        length * problem.scale * problem.unit,
        nearest,
        answer.weights,
        primal,
        found.dual,
        found.gap,
        converged,
        answer.resolved,
    )


def _placed(columns: list[Tensor] | None, index: Tensor, flat: Tensor) -> list[Tensor]:
    """Columns with NaN, or False, for the elements that were taken out."""
    total, count, dimension = flat.shape
    real = [(), (dimension,), (count,), (), (), ()]
    empty = [flat.new_full((total, *shape), float("nan")) for shape in real]
    empty += [torch.zeros(total, dtype=torch.bool, device=flat.device) for _ in range(2)]
    if columns is None:
        return empty
    return [full.index_copy(0, index, column) for full, column in zip(empty, columns, strict=True)]


def _problem(point: Tensor, vertices: Tensor, eps: float) -> HullProblem:
    offsets, unit, scale = _scaled_offsets(point, vertices)
    with torch.no_grad():
        coordinates = vertices.abs().amax(-2).sum(-1) / unit + point.abs().sum(-1) / unit
        blur = BOUNDARY_ULPS * eps * coordinates / scale
    return HullProblem(
        point=point / unit.unsqueeze(-1),
        vertices=vertices / unit[:, None, None],
        offsets=offsets,
        unit=unit,
        scale=scale,
        blur=blur,
        eps=eps,
    )


def _scaled_offsets(point: Tensor, vertices: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Vertices minus point over their largest entry; and that entry as a unit times a scale.

    The unit is a power of two, so that dividing by it rounds nothing, and differences of
    the largest numbers do not overflow.
    """
    with torch.no_grad():
        unit = _power_of_two(torch.maximum(point.abs().amax(-1), vertices.abs().flatten(-2).amax(-1)))
    difference = vertices / unit[..., None, None] - (point / unit.unsqueeze(-1)).unsqueeze(-2)
    with torch.no_grad():
        scale = difference.abs().flatten(-2).amax(-1)
        scale = torch.where(scale > 0, scale, torch.ones_like(scale))
    return difference / scale[..., None, None], unit, scale


def _power_of_two(size: Tensor) -> Tensor:
    """The power of two at or just below sizes; 1 for zero."""
    size = torch.where(size > 0, size, torch.ones_like(size))
    return size / (2 * torch.frexp(size).mantissa)


class _Once(torch.autograd.Function):
    """The identity, which refuses a second derivative instead of giving a wrong one.

    With the weights held (and in qpth's backward pass) second derivatives miss how the nearest point
    moves along its face.
    """

    @staticmethod
    def forward(ctx: Any, value: Tensor) -> Tensor:
        ctx.save_for_backward(value)
        return value.view_as(value)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> Tensor:
        return _Refused.apply(gradient, *ctx.saved_tensors) if torch.is_grad_enabled() else gradient


class _Refused(torch.autograd.Function):
    """A gradient that depends on `value`, one does not say how."""

    @staticmethod
    def forward(ctx: Any, gradient: Tensor, value: Tensor) -> Tensor:
        return gradient.view_as(gradient)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        raise RuntimeError("distance: this solver has no second derivatives; use 'closed_form'")


def _once(value: Tensor) -> Tensor:
    return _Once.apply(value) if value.requires_grad and torch.is_grad_enabled() else value
