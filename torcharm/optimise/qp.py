"""Small quadratic programs in a batch: the step of every constrained method, and projections.

A design's constraints are linear in its radii, lengths and limits, so the feasible designs are a
polytope `A u ≤ b`, and a step of any first- or second-order method is

    min_d  ½ dᵀ H d + gᵀ d   s.t.  A d ≤ c,   c = b - A u.

F variables and C constraints are few and the batch may be large: a primal-dual interior-point method
(Mehrotra's predictor and corrector; Nocedal & Wright, algorithm 16.4) whose every operation is batched.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

MOST_STEPS = 60
TOLERANCE = 1e-11
_SHORTEN = 0.995


@dataclass(frozen=True)
class Step:
    """Solutions of S quadratic programs.

    Attributes:
        step: (S, F).
        multipliers: (S, C), of the constraints.
        converged: (S,) whether all residuals are below 1e-8 of the problem's scale.
    """

    step: Tensor
    multipliers: Tensor
    converged: Tensor


def solve(hessian: Tensor, gradient: Tensor, rows: Tensor, room: Tensor) -> Step:
    """Solve S programs.

    Args:
        hessian: (S, F, F) symmetric, positive definite.
        gradient: (S, F).
        rows: (S or 1, C, F) A, its rows of unit length.
        room: (S, C) c; where negative, the start is outside, and the step leads back in.
    """
    # H and g may be of any size: divided by the largest entry of H, the step is the same.
    scale = hessian.diagonal(dim1=-2, dim2=-1).abs().amax(-1).clamp(min=1e-300)
    hessian, gradient = hessian / scale[:, None, None], gradient / scale[:, None]
    size = 1 + gradient.abs().amax(-1)
    step = torch.zeros_like(gradient)
    slack = room.clamp(min=0.1)
    dual = size[:, None].expand_as(slack).clone()
    best = (torch.full_like(size, torch.inf), step, dual)
    for _ in range(MOST_STEPS):
        stationary = _times(hessian, step) + gradient + _transposed(rows, dual)
        primal = _times(rows, step) + slack - room
        gap = (slack * dual).mean(-1)
        error = torch.maximum(stationary.abs().amax(-1) / size, primal.abs().amax(-1))
        error = torch.maximum(error, gap / size)
        better = error < best[0]  # past the accuracy of the arithmetic, iterates get worse again
        chosen = better.unsqueeze(-1)
        best = (
            torch.where(better, error, best[0]),
            torch.where(chosen, step, best[1]),
            torch.where(chosen, dual, best[2]),
        )
        if bool((best[0] < TOLERANCE).all()):
            break
        weight = dual / slack
        matrix = hessian + (rows.mT * weight.unsqueeze(-2)) @ rows
        factor, _ = torch.linalg.cholesky_ex(matrix)

        system = (factor, rows, weight, slack, stationary, primal)
        _, opened, raised = _direction(*system, slack * dual)
        ahead = ((slack + _reach(slack, opened) * opened) * (dual + _reach(dual, raised) * raised)).mean(-1)
        centring = (ahead / gap.clamp(min=1e-300)).clamp(0, 1).pow(3)
        target = slack * dual + opened * raised - (centring * gap).unsqueeze(-1)
        moved, opened, raised = _direction(*system, target)
        primal_reach = (_SHORTEN * _reach(slack, opened)).clamp(max=1)
        dual_reach = (_SHORTEN * _reach(dual, raised)).clamp(max=1)
        reach = torch.minimum(primal_reach, dual_reach)  # one length: the stationarity residual then shrinks by it
        going = (best[0] >= TOLERANCE) & moved.isfinite().all(-1) & raised.isfinite().all(-1)
        if not bool(going.any()):
            break
        reach = torch.where(going.unsqueeze(-1), reach, 0.0)
        step = torch.where(going.unsqueeze(-1), step + reach * moved, step)
        slack = torch.where(going.unsqueeze(-1), slack + reach * opened, slack).clamp(min=1e-18)
        dual = torch.where(going.unsqueeze(-1), dual + reach * raised, dual).clamp(min=1e-18)
    return Step(best[1], best[2] * scale.unsqueeze(-1), best[0] < 1e-8)


def _direction(
    factor: Tensor, rows: Tensor, weight: Tensor, slack: Tensor, stationary: Tensor, primal: Tensor, complement: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Newton's direction, in step, slack and multipliers, towards `slack · dual` less by `complement`."""
    right = -stationary - _transposed(rows, weight * primal - complement / slack)
    moved = torch.cholesky_solve(right.unsqueeze(-1), factor).squeeze(-1)
    opened = -primal - _times(rows, moved)
    return moved, opened, -(complement / slack) - weight * opened


def project(point: Tensor, rows: Tensor, bound: Tensor, metric: Tensor | None = None) -> Step:
    """The nearest points of polytopes `A u ≤ b` to points (S, F), as steps from them.

    Args:
        point: (S, F).
        rows: (S or 1, C, F) A.
        bound: (S or 1, C) b.
        metric: (S, F) weights of the squared distance; None for ones.
    """
    weight = torch.ones_like(point) if metric is None else metric
    return solve(torch.diag_embed(weight), torch.zeros_like(point), rows, bound - _times(rows, point))


def _times(matrix: Tensor, vector: Tensor) -> Tensor:
    return (matrix @ vector.unsqueeze(-1)).squeeze(-1)


def _transposed(matrix: Tensor, vector: Tensor) -> Tensor:
    return (matrix.mT @ vector.unsqueeze(-1)).squeeze(-1)


def _reach(value: Tensor, change: Tensor) -> Tensor:
    """How far (S, 1), at most 1, positive values may go along a change and stay so."""
    ratio = torch.where(change < 0, value / (-change).clamp(min=1e-300), torch.inf)
    return ratio.amin(-1, keepdim=True).clamp(max=1.0)
