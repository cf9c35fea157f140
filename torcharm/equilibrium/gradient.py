"""Gradients of equilibria by the implicit function theorem: `dz = -J⁻¹ dR` at the answer."""

from typing import Any

import numpy as np
import torch
from torch import Tensor

from torcharm.actuators import want_gradients
from torcharm.arm_series import segments_of
from torcharm.engine.arms import numbers
from torcharm.engine.questions import inverse
from torcharm.equilibrium.problem import Problem

AT_ONCE = 4096
"""Problems whose inverse matrices are held at once: 15 MB of 20 by 20."""

REFINEMENTS = 3
"""Of gradients of sampled models: each gains the digits to which a table's slopes are good, four or more."""


def with_gradients(problem: Problem, twists: Tensor, converged: Tensor) -> Tensor:
    """The same equilibria (*batch, N, K), as functions of what the problem depends on.

    Args:
        problem: in float64 on the CPU, with the graphs of its tensors.
        twists: that solve it.
        converged: (*batch).
    """
    if not _is_followed(problem):
        return twists
    found: Tensor = _Implicit.apply(problem.residual(twists), twists, converged, problem)
    return found


def _is_followed(problem: Problem) -> bool:
    """Whether anything that the problem depends on wants a gradient."""
    if not torch.is_grad_enabled():
        return False
    segments, links = segments_of(problem.arm)
    tensors = [problem.pressure, problem.base_pose, *problem.load.tensors().values()]
    for segment in segments:
        tensors += segment.tensors()
    for link in links:
        tensors += [value for value in vars(link).values() if isinstance(value, Tensor)] if link is not None else []
    if any(value.requires_grad for value in tensors):
        return True
    return any(want_gradients(segment.actuators, problem.pressure) for segment in segments)


class _Implicit(torch.autograd.Function):
    """Twists that solve R = 0, with the gradient `-J⁻ᵀ g` for R."""

    @staticmethod
    def forward(ctx: Any, residual: Tensor, twists: Tensor, converged: Tensor, problem: Problem) -> Tensor:
        ctx.save_for_backward(twists, converged)
        ctx.problem = problem
        return twists.clone()

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None, None]:
        twists, converged = ctx.saved_tensors
        problem: Problem = ctx.problem
        wanted = (gradient != 0).flatten(-2).any(-1)
        right = gradient[..., problem.unknown]
        right = right.reshape(problem.count, right.shape[-2] * right.shape[-1])
        answer, flat = torch.zeros_like(right), numbers(twists.reshape(problem.count, *twists.shape[-2:]))
        rows = np.flatnonzero((wanted & converged).reshape(-1).numpy())
        for index in np.split(rows, range(AT_ONCE, len(rows), AT_ONCE)):
            whole = torch.from_numpy(inverse(problem.packed, flat, index))
            answer[index] = -(whole.mT @ right[index].unsqueeze(-1)).squeeze(-1)
            if not problem.packed.arms.tables.is_empty:
                _refine(problem, twists, right, answer, index, whole)
        answer = answer.reshape(*gradient.shape[:-1], len(problem.unknown))
        lost = torch.where(wanted & ~converged, float("nan"), 0.0).to(answer)
        return answer + lost[..., None, None], None, None, None


def _refine(problem: Problem, twists: Tensor, right: Tensor, answer: Tensor, index: Any, whole: Tensor) -> None:
    """Correct answers of `Jᵀ x = -g` at an index by the slope of sampled models themselves, in place."""
    for _ in range(REFINEMENTS):
        with torch.enable_grad():
            at = twists.detach().requires_grad_()
            residual = problem.residual(at)
            (product,) = torch.autograd.grad(residual, at, answer.reshape(residual.shape))
        product = product[..., problem.unknown].reshape(answer.shape)
        answer[index] -= (whole.mT @ (right + product)[index].unsqueeze(-1)).squeeze(-1)
