"""Pressures whose reactions come closest to what a shape requires: least squares in wrenches, the shape held.

Nothing moves, so a look costs no more than the actuators' forces. Some pressures have nearly no effect, and least
squares creep along the curved valleys that these make: steps are bent to follow them, by the second derivative along
the step (geodesic acceleration; Transtrum & Sethna 2012, arXiv:1201.5885).
"""

from typing import NamedTuple

import torch
from torch import Tensor

from torcharm import mechanics
from torcharm._box import optimality
from torcharm._box_least_squares import box_step
from torcharm.arm import ArmDesign

STEPS = 120
START_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-2, 1e-14, 1e8
"""Shares of the largest curvature."""
GAIN = 1e-14
NOTHING = 1e-30
"""Of a squared distance [N²]: it has vanished."""
LOOK_AHEAD = 0.1
"""Part of a step after which its second derivative is measured."""
BEND = 0.75
"""Most that a step is bent, over its length."""


class Fit(NamedTuple):
    """Where B fits ended.

    Attributes:
        share: (B, M) pressures in shares of their limits.
        cost: (B,) squared distance of the reactions from what is required.
        miss: (B, 2, N) scaled.
        optimality: (B,) the largest entry of the projected gradient of half the cost.
        done: (B,) whether the descent came to its end.
    """

    share: Tensor
    cost: Tensor
    miss: Tensor
    optimality: Tensor
    done: Tensor


def fit_wrenches(
    arm: ArmDesign, unknowns: Tensor, load: Tensor, scale: Tensor, start: Tensor, steps: int = STEPS, gain: float = GAIN
) -> Fit:
    """Minimise `‖s (a(z, p) + q)‖²` over the box of pressures, by Levenberg and Marquardt's method.

    Args:
        arm: B designs.
        unknowns: z (B, 2, N).
        load: q (B, 2, N).
        scale: s (2, 1) or (B, 2, 1) of forces and moments.
        start: (B, M) in shares of the limits.
        steps: at most so many.
        gain: a step that promises no more of the cost is the last.
    """
    limits = arm.max_pressure

    def model(index: Tensor | slice, share: Tensor) -> tuple[Tensor, Tensor]:
        part = mechanics.actuator_part(arm[index], unknowns[index], share * limits[index])
        s = scale if scale.ndim == 2 else scale[index]
        rates = s.unsqueeze(-1) * part.by_pressure * limits[index][:, None, None, :]
        return s * (part.wrench + load[index]), rates.flatten(1, 2)

    every = slice(None)
    share = start.clone()
    miss, rates = model(every, share)
    cost = miss.square().sum((-1, -2))
    end = Fit(share, cost, miss, torch.zeros_like(cost), torch.zeros_like(cost, dtype=torch.bool))
    active = torch.arange(len(share), device=share.device)
    damping, optimal = torch.full_like(cost, START_DAMPING), torch.zeros_like(cost)
    for turn in range(steps + 1):
        gradient = _times(rates.mT, miss.flatten(1))
        normal = rates.mT @ rates
        size = normal.diagonal(dim1=-2, dim2=-1).amax(-1).clamp(min=1e-30)
        step, promise = box_step(gradient, normal, share, damping * size)
        optimal = optimality(gradient, share)
        done = (2 * promise <= gain * cost + NOTHING) | (damping > MOST_DAMPING)
        left = done | ~cost.isfinite() | (turn == steps)
        if bool(left.any()):
            at = active[left]
            for column, now in zip(end, (share, cost, miss, optimal, done & cost.isfinite()), strict=True):
                column[at] = now[left]
            if bool(left.all()):
                break
            on = ~left
            active, share, cost, miss, rates = active[on], share[on], cost[on], miss[on], rates[on]
            damping, gradient, normal, size, step = damping[on], gradient[on], normal[on], size[on], step[on]
        ahead, _ = model(active, share + LOOK_AHEAD * step)
        bent = (ahead - miss).flatten(1) / LOOK_AHEAD - _times(rates, step)  # half of LOOK_AHEAD times r''
        free = (step != 0).to(step)
        matrix = normal * free.unsqueeze(-1) * free.unsqueeze(-2)
        matrix = matrix + torch.diag_embed((damping * size).unsqueeze(-1) + (1 - free) * size.unsqueeze(-1))
        side, info = torch.linalg.solve_ex(matrix, free * _times(rates.mT, bent) / LOOK_AHEAD)
        straight = (info != 0) | ~(side.norm(dim=-1) <= BEND * step.norm(dim=-1))
        there = (share + torch.where(straight.unsqueeze(-1), step, step - side)).clamp(0, 1)
        seen, slopes = model(active, there)
        tried = seen.square().sum((-1, -2))
        better = tried < cost
        share = torch.where(better[:, None], there, share)
        miss = torch.where(better[:, None, None], seen, miss)
        rates = torch.where(better[:, None, None], slopes, rates)
        cost = torch.where(better, tried, cost)
        damping = torch.where(better, damping / 10, damping * 5).clamp(min=LEAST_DAMPING)
    return end


def _times(matrix: Tensor, vector: Tensor) -> Tensor:
    return (matrix @ vector.unsqueeze(-1)).squeeze(-1)
