"""Distance as a quadratic programme, on the differentiable solver qpth.

It answers what the exact methods answer, more slowly: for comparison with them and with the paper. qpth says nothing of
its failures, so every answer is checked from its weights.
"""

import math
from collections.abc import Callable
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from torcharm.inputs import check_choice, check_count, shown
from torcharm.wrench_sets.hull_distance import (
    TOLERANCE,
    HullAnswer,
    HullDistance,
    HullProblem,
    mix,
    offset_residuals,
    solve_hulls,
)
from torcharm.wrench_sets.reference import member_rows, nnls_weights, touches

GRADIENTS = ("kkt", "envelope")
CHUNK = 1000
"""Problems that qpth is given at once: more only take memory."""
REGULARISATION = 1e-10
"""ε of the first solve: the least that stays clear of qpth's rounding."""
SUM_CURVATURE = 1e-2
"""μ, by which the square of each group's sum of weights is added to the objective: a constant, as sums are 1. Without
it qpth's factorisation fails at small ε of several groups, and loses digits of one. At μ = 1 digits go again."""
PROXIMITY = 1e-4
"""ρ of the solve that is differentiated: large enough for qpth's backward pass to keep its digits."""
SHARPNESS = 1e-2
"""Largest error of a nearest point over its distance: larger, and the gradient's direction suffers."""
FAR = 100
"""Distances of fewer blurs than this are left to the exact method, which knows where the boundary is."""
ANSWERED = 1e-3
"""Duality gap over ε within which the programme with ε counts as solved."""
RETRY_SHARE = 0.1
"""If more of a group fails, one of its members may have ended the others' iterations: try again, apart."""

Layer = Callable[..., Tensor]


def qp_distance(
    point: Float[Tensor, "*#batch D"],
    vertices: Float[Tensor, "*#batch V D"],
    *,
    groups: int = 1,
    gradient: str = "kkt",
    regularisation: float = REGULARISATION,
    chunk_size: int | None = None,
) -> HullDistance:
    """Distance from points to hulls of vertices by qpth's interior-point method, in float64.

    `min_s ½‖H̃ᵀ s‖² + ½ ε‖s‖²` over the simplex or, for sums of hulls, over one simplex for each group, with
    H̃ = H - w/G divided by its largest entry, so that neither units nor a far-off origin matter.

    Every answer is checked by its residuals. It is kept if the point is certainly outside, the distance
    good to 1e-6 of max|H̃| and the nearest point to 1e-2 of the distance; or if non-negative least squares find
    the point inside or on the boundary. All others are answered by non-negative least squares and marked
    `resolved`. So the value is exactly 0 where that of `nnls_distance` is; a small residual alone never counts as
    touching.

    The value is differentiable with respect to point and vertices, once (a second derivative
    raises). "envelope" holds the weights. "kkt" goes through qpth's own backward pass, which cannot be taken at the
    small ε that the value needs: it loses all digits, and at a larger ε the solution is another one. So it is taken
    through one proximal step from the solution, `min_s ½‖H̃ᵀ s‖² + ½ ρ‖s - s*‖²`, whose solution is s* again and whose
    ρ may be large; a second solve, made only where gradients are wanted. Elements touching the hull have gradient 0;
    resolved ones have the envelope's. Where several weights are optimal (duplicated vertices), the gradient
    in the vertices is one of several.

    A larger ε makes errors of the value larger, and more elements be resolved. The gradient's error, some 1e-6 in w, is
    qpth's, whose backward pass lifts multipliers and slacks to 1e-8; with "envelope" it is 1e-10. Between edges almost
    in line the gradients in single vertices may differ by more, their sum does not.

    Args:
        point: where from.
        vertices: V points of any dimension, in any order within their group, duplicates allowed.
        groups: into which the vertices are divided evenly, group after group; the set is the sum of the groups' hulls.
        gradient: "kkt" or "envelope".
        regularisation: ε.
        chunk_size: problems that qpth is given at once; None for 1000.

    Raises:
        ValueError: qpth is not installed, an argument is none of those allowed, there is no vertex, or
            dimensions, batches or groups do not fit.

    Example:
        >>> point = torch.ones(2, requires_grad=True)
        >>> ta.qp_distance(point, torch.eye(2)).value.backward()  # to the line from (1, 0) to (0, 1)
        >>> [round(slope, 3) for slope in point.grad.tolist()]
        [0.707, 0.707]
    """
    check_choice("gradient", gradient, GRADIENTS)
    if isinstance(regularisation, bool) or not isinstance(regularisation, (int, float)) or regularisation <= 0:
        raise ValueError(f"regularisation: must be a number above 0, got {shown(regularisation)}")
    if not math.isfinite(regularisation):
        raise ValueError(f"regularisation: must be finite, got {regularisation}")
    count = CHUNK if chunk_size is None else check_count("chunk_size", chunk_size, 1)
    work = partial(_solve, require_qpth(), regularisation, gradient == "kkt")
    return solve_hulls(point, vertices, groups, work, count)


def require_qpth() -> Layer:
    """qpth's layer, or the reason why there is none, as a ValueError."""
    try:
        from qpth.qp import QPFunction
    except ImportError as error:
        raise ValueError(
            "distance: 'qpth' needs the package qpth, which is not installed: `pip install qpth`, on Python up to 3.12 "
            "and with numpy below 2, or use 'gjk'"
        ) from error
    # Without its check that Q is positive definite, one bad element does not stop a whole batch at once.
    return QPFunction(verbose=-1, check_Q_spd=False)


def programme_weights(
    layer: Layer, offsets: Tensor, groups: int, proximity: float, centre: Tensor | None = None
) -> Tensor:
    """`min_s ½‖H̃ᵀ s‖² + ½ ρ‖s - c‖²` over each group's simplex: weights (B, V), NaN where qpth fails.

    Nothing is shared over the batch: qpth would average the gradients of what is. What it is given has one term more, a
    constant on the simplex: see `SUM_CURVATURE`.

    Args:
        layer: qpth.
        offsets: H̃ (B, V, D).
        groups: G.
        proximity: ρ.
        centre: c (B, V); None is 0.
    """
    gram = offsets @ offsets.mT
    batch, count, _ = gram.shape
    unit = torch.eye(count, dtype=gram.dtype, device=gram.device).expand_as(gram)
    zero = gram.new_zeros(batch, count)
    linear = zero if centre is None else -proximity * centre
    members = torch.from_numpy(member_rows(groups, count)).to(gram).expand(batch, groups, count)
    try:
        curved = gram + proximity * unit + SUM_CURVATURE * (members.mT @ members)
        found = layer(curved, linear, -unit, zero, members, members.new_ones(batch, groups))
    except RuntimeError:
        found = None
    if found is None:
        return torch.full_like(zero, float("nan"))
    by_group = found.clamp(min=0).unflatten(-1, (groups, -1))  # within rounding they are convex
    return (by_group / by_group.sum(-1, keepdim=True)).flatten(-2)


def _solve(layer: Layer, regularisation: float, kkt: bool, problem: HullProblem) -> HullAnswer:
    with torch.no_grad():
        offsets, groups = problem.offsets.detach(), problem.groups
        weights = _solve_apart(layer, regularisation, offsets, groups)
        found = offset_residuals(offsets, weights, groups)
        sound = _sound(offsets, weights, groups)
        outside = sound & (found.gap <= SHARPNESS**2 * found.length**2) & (found.length > FAR * problem.blur)
        touching, resolved = torch.zeros_like(sound), torch.zeros_like(sound)
        rest = (~outside).nonzero().squeeze(-1)
        if len(rest):
            exact = nnls_weights(offsets[rest], groups)
            touching[rest] = touches(offsets[rest], exact, groups, problem.blur[rest])
            kept = sound[rest] & touching[rest]
            resolved[rest] = ~kept
            weights[rest] = torch.where(kept.unsqueeze(-1), weights[rest], exact)
    length = problem.length(weights, touching)
    if kkt and length.requires_grad:
        length = _with_solver_gradient(layer, problem, weights, length, outside.nonzero().squeeze(-1))
    return HullAnswer(weights, touching, resolved, length)


def _solve_apart(layer: Layer, regularisation: float, offsets: Tensor, groups: int) -> Tensor:
    """Weights (B, V), NaN where qpth fails, and where it is not asked: where all vertices are at the point.

    One element whose factorisation is singular ends the iterations of its whole batch, and nothing
    says which. So where many fail, they are tried again without the others, or in halves; not those whose ε was
    too large, for which qpth has done what it was asked.
    """
    weights = torch.full_like(offsets[..., 0], float("nan"))
    batches = [(offsets != 0).flatten(1).any(-1).nonzero().squeeze(-1)]
    while batches:
        batch = batches.pop()
        if not len(batch):
            continue
        own = offsets[batch]
        found = weights[batch] = programme_weights(layer, own, groups, regularisation)
        failed = batch[~_sound(own, found, groups) & ~_answered(own, found, groups, regularisation)]
        if len(batch) > 1 and len(failed) > RETRY_SHARE * len(batch):
            batches += failed.tensor_split(2) if len(failed) == len(batch) else [failed]
    return weights


def _answered(offsets: Tensor, weights: Tensor, groups: int, regularisation: float) -> Tensor:
    """Whether weights (B, V) solve the programme with ε, however far that is from the one without."""
    slope = (offsets * mix(weights, offsets).unsqueeze(-2)).sum(-1) + regularisation * weights
    least = slope.unflatten(-1, (groups, -1)).amin(-1).sum(-1)
    return (weights * slope).sum(-1) - least <= ANSWERED * regularisation


def _sound(offsets: Tensor, weights: Tensor, groups: int) -> Tensor:
    """Whether weights pass their check; never those with NaN."""
    found = offset_residuals(offsets, weights, groups)
    return (found.primal <= TOLERANCE) & (found.error <= TOLERANCE)


def _with_solver_gradient(layer: Layer, problem: HullProblem, weights: Tensor, length: Tensor, index: Tensor) -> Tensor:
    """The same lengths, of which those in `index` have the gradient of qpth's backward pass."""
    if not len(index):
        return length
    offsets = problem.offsets[index]
    moved = programme_weights(layer, offsets, problem.groups, PROXIMITY, weights[index])
    found = torch.linalg.vector_norm(mix(moved, offsets), dim=-1)
    agrees = (found - length[index]).detach().abs() <= TOLERANCE
    # Whatever the backward pass makes of an element that went wrong stays out of the sum.
    offsets.register_hook(partial(_kept, agrees))
    envelope = length[index]
    own = torch.where(agrees, envelope.detach() + (found - found.detach()), envelope)
    return length.index_copy(0, index, own)


def _kept(chosen: Tensor, gradient: Tensor) -> Tensor:
    mask = chosen.view(-1, *[1] * (gradient.dim() - 1))
    return torch.where(mask, gradient, torch.zeros_like(gradient))
