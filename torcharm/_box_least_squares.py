"""Nonlinear least squares in a box, B small problems at once: Levenberg and Marquardt with active bounds.

    min ½‖r(u)‖²,  0 ≤ u ≤ upper,   u (B, M) with M small

Each step minimises the Gauss-Newton model, damped, within the box; what has converged leaves the batch.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

LEAST_GAIN = 1e-4
"""Of the decrease that the model promised; less is refused."""
FIRST_DAMPING = 1e-3
"""Of the model's largest curvature."""
LARGEST_DAMPING = 1e8
INNER_STEPS = 12
BACKTRACKS = 6


class Model(NamedTuple):
    """The Gauss-Newton model: half the sum of squares (B,), its gradient (B, M), and `JᵀJ` (B, M, M)."""

    value: Tensor
    gradient: Tensor
    curvature: Tensor


class Minimum(NamedTuple):
    """Where the search ended.

    Attributes:
        place: u (B, M).
        value: ½‖r‖² (B,).
        gradient: its gradient (B, M).
        stalled: (B,) whether no step, however short, went down.
        converged: (B,) as judged.
    """

    place: Tensor
    value: Tensor
    gradient: Tensor
    stalled: Tensor
    converged: Tensor


def projected(gradient: Tensor, place: Tensor, upper: Tensor) -> Tensor:
    """The gradient (B, M) less what points out of the box: `u - P(u - g)` for a step of unit length."""
    return place - torch.minimum((place - gradient).clamp(min=0), upper)


def minimise(
    look: Callable[[Tensor, Tensor], Model],
    start: Tensor,
    upper: Tensor,
    judge: Callable[[Tensor, Model, Tensor], Tensor],
    steps: int,
) -> Minimum:
    """Minimise from a start (B, M) within the box.

    Args:
        look: from indices (b,) of problems and places (b, M) to models.
        start: (B, M), in the box.
        upper: (B, M), at least 0.
        judge: from indices, models and places to whether they have converged.
        steps: at most so many.
    """
    place = start.clone()
    active = torch.arange(len(start), device=start.device)
    here, model = start, look(active, start)
    value, gradient = model.value.clone(), model.gradient.clone()
    converged = torch.zeros(len(start), dtype=torch.bool, device=start.device)
    stalled = torch.zeros_like(converged)
    damping = FIRST_DAMPING * model.curvature.diagonal(dim1=-2, dim2=-1).amax(-1)
    growth = torch.full_like(damping, 2.0)
    bound = upper
    for step in range(steps + 1):
        done = judge(active, model, here)
        stuck = ~done & (damping > LARGEST_DAMPING * model.curvature.diagonal(dim1=-2, dim2=-1).amax(-1))
        leave = done | stuck | ~model.value.isfinite() | (step == steps)
        if bool(leave.any()):
            gone = active[leave]
            place[gone], value[gone], gradient[gone] = here[leave], model.value[leave], model.gradient[leave]
            converged[gone], stalled[gone] = done[leave], stuck[leave]
            keep = ~leave
            active, here, bound, damping, growth = (x[keep] for x in (active, here, bound, damping, growth))
            model = Model(*(part[keep] for part in model))
            if not len(active):
                break
        move, promised = box_step(model, here, bound, damping)
        there = here + move
        tried = look(active, there)
        gain = (model.value - tried.value) / promised.clamp(min=1e-300)
        good = (gain > LEAST_GAIN) & tried.value.isfinite()
        here = torch.where(good.unsqueeze(-1), there, here)
        model = Model(
            *(
                torch.where(good.view(-1, *[1] * (new.ndim - 1)), new, old)
                for new, old in zip(tried, model, strict=True)
            )
        )
        easier = (1 - (2 * gain.clamp(-1, 2) - 1) ** 3).clamp(min=0.1)  # Nielsen's rule
        damping = torch.where(good, damping * easier, damping * growth)
        growth = torch.where(good, torch.full_like(growth, 2.0), growth * 2)
    return Minimum(place, value, gradient, stalled, converged)


def box_step(model: Model, place: Tensor, upper: Tensor, damping: Tensor) -> tuple[Tensor, Tensor]:
    """The step (B, M) that minimises the damped model in the box, and the decrease (B,) the model promises.

    Newton's method on the free variables, projected; a variable at a bound is free unless the gradient pushes it out.
    """
    eye = torch.eye(place.shape[-1], dtype=place.dtype, device=place.device)
    scale = model.curvature.diagonal(dim1=-2, dim2=-1).amax(-1).clamp(min=1e-300)
    curvature = model.curvature + (damping + 1e-14 * scale)[:, None, None] * eye
    trials = 0.5 ** torch.arange(BACKTRACKS, dtype=place.dtype, device=place.device)
    there = place
    slope = model.gradient
    for _ in range(INNER_STEPS):
        held = ((there <= 0) & (slope > 0)) | ((there >= upper) & (slope < 0))
        free = (~held).to(place.dtype)
        if bool(((free * slope).abs() <= 1e-13 * (scale.unsqueeze(-1))).all()):
            break
        reduced = curvature * free.unsqueeze(-1) * free.unsqueeze(-2) + torch.diag_embed(
            (1 - free) * scale.unsqueeze(-1)
        )
        factor, _ = torch.linalg.cholesky_ex(reduced)
        newton = -torch.cholesky_solve((free * slope).unsqueeze(-1), factor).squeeze(-1)
        newton = torch.where(newton.isfinite(), newton, torch.zeros_like(newton))
        cauchy = -free * slope / scale.unsqueeze(-1)
        ahead = torch.stack((newton, cauchy), -2).unsqueeze(-3) * trials.view(-1, 1, 1)  # (B, T, 2, M)
        ends = torch.minimum((there[:, None, None] + ahead).clamp(min=0), upper[:, None, None]).flatten(1, 2)
        step = ends - there.unsqueeze(1)
        change = (step * slope.unsqueeze(1)).sum(-1) + 0.5 * ((step @ curvature) * step).sum(-1)
        best = change.argmin(-1)
        chosen = step[torch.arange(len(step), device=step.device), best]
        chosen = torch.where((change.amin(-1) < 0).unsqueeze(-1), chosen, torch.zeros_like(chosen))
        there = there + chosen
        slope = slope + (curvature @ chosen.unsqueeze(-1)).squeeze(-1)
    move = there - place
    promised = -(move * model.gradient).sum(-1) - 0.5 * ((model.curvature @ move.unsqueeze(-1)).squeeze(-1) * move).sum(
        -1
    )
    return move, promised
