"""Shapes that are predicted, while designs and tasks change: with pressures that stay at their minimum.

At a minimum of the cost C(p, u) over the pressures that their limits leave free, `∂C/∂p = 0` for all u, so that

    dp = -H⁻¹ d(∂C/∂p),   H = ∂²C/∂p².

Of errors that are minimised the envelope theorem spares this; strains follow it, and are far off without. Derivatives
by pressure of the cost's gradient, which is exact, are central differences along the tangent of the equilibria.
"""

from dataclasses import replace

import torch
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries
from torcharm.equilibrium.gradient import with_gradients
from torcharm.equilibrium.sensitivity import pressure_sensitivity
from torcharm.equilibrium.stability import share_beyond_range
from torcharm.pressure.errors import errors_at
from torcharm.pressure.pose_cost import PoseCost
from torcharm.pressure.predicted_error import PredictedError
from torcharm.pressure.prepared import Prepared, detached, prepare
from torcharm.task import Task

STEP = 1e-4
"""Of normalised pressures either way: what it leaves out, and rounding, are some 1e-7 of a derivative. A pressure that
is as close to a limit counts as held there."""
LEAST_CURVATURE = 1e-9
"""Of the largest: along pressures that change the cost less, as those that balance each other, none is preferred."""


def followed_twists(
    arm: ArmDesign | ArmSeries, task: Task, pose_cost: PoseCost | None, found: PredictedError
) -> Tensor:
    """The shapes (*batch, N, K) of a prediction, with the gradients of the minimum's, where it is one and smooth.

    Args:
        arm, task, pose_cost: of the prediction.
        found: the prediction.
    """
    prepared = prepare(arm, task, pose_cost)
    pressure = followed_pressure(prepared, found)
    twists, known = found.twists.detach().to(pressure), found.stable.cpu()
    return prepared.given_back(with_gradients(replace(prepared.problem, pressure=pressure), twists, known))


def followed_pressure(prepared: Prepared, found: PredictedError) -> Tensor:
    """The pressures (*batch, M) [kPa] of a prediction of these problems, with the gradients of the minimum's."""
    limit = prepared.problem.pressure
    with torch.no_grad():
        normalised = torch.where(limit > 0, found.pressure.to(limit) / limit.clamp(min=1e-300), 0.0).clamp(0, 1)
    followed = _followed(prepared, normalised, found.twists.detach().to(limit))
    return torch.where(normalised >= 1, limit, followed * limit.detach())


def beyond_range(arm: ArmDesign | ArmSeries, task: Task, twists: Tensor) -> Tensor:
    """(*batch) by which share of its characterised range's width a strain of shapes (*batch, N, K) leaves it, the
    largest; negative within."""
    prepared = prepare(arm, task, None)
    found = share_beyond_range(prepared.problem, twists.to(prepared.problem.pressure))
    return prepared.given_back(found.expand(prepared.batch))


def _followed(prepared: Prepared, normalised: Tensor, twists: Tensor) -> Tensor:
    """Normalised pressures (*batch, M) at minima, as functions of what the problems depend on."""
    count, limit = normalised.shape[-1], prepared.problem.pressure
    ahead = STEP * torch.eye(count, dtype=normalised.dtype).reshape(count, *(1 for _ in prepared.batch), count)
    rate = pressure_sensitivity(detached(prepared).at(normalised), twists) * limit.detach()[..., None, None]
    along = STEP * rate.movedim(-3, 0)
    ways = torch.tensor([1.0, -1.0], dtype=normalised.dtype).reshape(2, *(1 for _ in ahead.shape))
    at = (normalised + ways * ahead).requires_grad_()
    wide = replace(prepared, problem=replace(prepared.problem, batch=(2, count, *prepared.batch)))
    every = torch.ones(wide.batch, dtype=torch.bool)
    cost = errors_at(wide, at, twists + ways.unsqueeze(-1) * along, every, every).cost
    (slope,) = torch.autograd.grad(cost.sum(), at, retain_graph=True)
    free = (normalised > STEP) & (normalised < 1 - STEP)
    curvature = ((slope[0] - slope[1]) / (2 * STEP)).movedim(0, -2) * (free.unsqueeze(-1) & free.unsqueeze(-2))
    rise = ((cost[0] - cost[1]) / (2 * STEP)).movedim(0, -1)
    # NaN only where no equilibrium is known; gradients end there, and pinv refuses a batch with one
    inverse = torch.linalg.pinv(((curvature + curvature.mT) / 2).nan_to_num(), rtol=LEAST_CURVATURE, hermitian=True)
    moved = (inverse @ rise.unsqueeze(-1)).squeeze(-1)
    return normalised - moved + moved.detach()
