"""Small quadratic programs in a batch: the step of every constrained method, and projections.

A design's constraints are linear in its radii, lengths and limits, so the feasible designs are a
polytope `A u ≤ b`, and a step of any first- or second-order method is

    min_d  ½ dᵀ H d + gᵀ d   s.t.  A d ≤ c,   c = b - A u.

F variables and C constraints are few and the batch may be large: a primal-dual interior-point method
(Mehrotra's predictor and corrector; Nocedal & Wright, algorithm 16.4) whose every operation is batched. One
program, or a few, are sooner solved one by one, by an active set.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

FEW = 32
"""Up to so many programs are solved one by one, which is also the more accurate; a batch of more takes less time."""
MOST_STEPS = 60
TOLERANCE = 1e-11
CHECKED = 1e-11
"""By how much the answer of an active set may be outside, relative to its size."""
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


Array = npt.NDArray[Any]


def solve(hessian: Tensor, gradient: Tensor, rows: Tensor, room: Tensor) -> Step:
    """Solve S programs.

    Args:
        hessian: (S, F, F) symmetric, positive definite.
        gradient: (S, F).
        rows: (S or 1, C, F) A, its rows of unit length.
        room: (S, C) c; where negative, the start is outside, and the step leads back in.
    """
    size = len(gradient)
    if size > FEW:
        return _by_interior_points(hessian, gradient, rows, room)
    steps, duals = torch.zeros_like(gradient), torch.zeros_like(room)
    solved = torch.zeros(size, dtype=torch.bool)
    for index in range(size):
        own = rows[index % len(rows)]
        found = _by_active_set(hessian[index].numpy(), gradient[index].numpy(), own.numpy(), room[index].numpy())
        if found is not None:
            steps[index], duals[index] = torch.from_numpy(found[0]), torch.from_numpy(found[1])
            solved[index] = True
    if not bool(solved.all()):
        left = (~solved).nonzero().squeeze(-1)
        other = _by_interior_points(hessian[left], gradient[left], rows if len(rows) == 1 else rows[left], room[left])
        steps[left], duals[left], solved[left] = other.step, other.multipliers, other.converged
    return Step(steps, duals, solved)


def _by_active_set(hessian: Array, gradient: Array, rows: Array, room: Array) -> tuple[Array, Array] | None:
    """The step (F) and multipliers (C) of one program; None where they fail the check.

    With `H = L Lᵀ` and `y = Lᵀ d + L⁻¹ g` the program asks for the shortest y within half-spaces, which is a
    problem of nonnegative least squares over the multipliers (Lawson & Hanson 1974, chapter 23). The step is then
    solved for anew from the constraints found active.
    """
    from scipy.optimize import nnls

    unit = max(hessian.diagonal().max(), 1e-300)
    hessian, gradient = hessian / unit, gradient / unit
    try:
        inverse = np.linalg.inv(np.linalg.cholesky(hessian))
    except np.linalg.LinAlgError:
        return None
    free = inverse @ gradient
    walls = -rows @ inverse.T
    height = walls @ free - room  # walls y ≥ height
    dual, active = np.zeros_like(room), np.zeros(0, dtype=np.int64)
    if (height > 0).any():
        scale = height.max()
        goal = np.zeros(len(free) + 1)
        goal[-1] = 1.0
        try:
            weight, _ = nnls(np.vstack((walls.T, height / scale)), goal)
        except RuntimeError:
            return None
        active = np.flatnonzero(weight)
        try:
            while True:  # rounding may have taken in a constraint that pulls the wrong way
                near = walls[active]
                pull = np.linalg.solve(near @ near.T, height[active])
                if (pull >= 0).all():
                    break
                active = active[pull > 0]
        except np.linalg.LinAlgError:
            return None
        dual[active] = pull
    step = inverse.T @ (walls.T @ dual - free)
    # A stiff model leaves rounding in the constraints; they come first.
    met = rows[active]
    step = step - np.linalg.lstsq(met, met @ step - room[active], rcond=None)[0]
    off = (rows @ step - room).max()
    return (step, unit * dual) if off <= CHECKED * (1 + np.abs(step).max()) else None


def _by_interior_points(hessian: Tensor, gradient: Tensor, rows: Tensor, room: Tensor) -> Step:
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
