"""How equilibria change with pressure: `dz/dp = -J⁻¹ ∂R/∂p`, for all actuators at once and without a graph."""

import numpy as np
import torch
from torch import Tensor

from torcharm.arm_series import segments_of, with_slices
from torcharm.engine.arms import numbers
from torcharm.engine.questions import solve
from torcharm.equilibrium.problem import Problem
from torcharm.statics.balance import segment_reaction


def pressure_sensitivity(problem: Problem, twists: Tensor) -> Tensor:
    """The change (*batch, M, N, K) of the twists by each actuator's pressure [m/kPa, rad/kPa].

    Forces of sampled models change as their tables do, which is good to some four digits.

    Args:
        problem: in float64 on the CPU.
        twists: (*batch, N, K) its equilibria.
    """
    whole = twists.detach().expand(*problem.batch, *twists.shape[-2:])
    rate = torch.zeros(*problem.batch, problem.arm.actuator_count, *twists.shape[-2:], dtype=torch.float64)
    slope = _pressure_slope(problem, whole)
    right = slope.reshape(problem.count, *slope.shape[-3:]).numpy()
    solve(problem.packed, numbers(whole.reshape(-1, *twists.shape[-2:])), np.arange(problem.count), right)
    rate[..., problem.unknown] = -torch.from_numpy(right).view_as(slope)
    return rate


def _pressure_slope(problem: Problem, twists: Tensor) -> Tensor:
    """∂R/∂p (*batch, M, N, C): a pressure changes what the sections of its own segment provide, each by itself."""
    columns, node = problem.unknown, 0
    slope = torch.zeros(*problem.batch, problem.arm.actuator_count, twists.shape[-2], len(columns), dtype=torch.float64)
    segments = with_slices(segments_of(problem.arm)[0])
    for (segment, own), shape in zip(segments, twists.split(problem.nodes, -2), strict=True):
        here = slice(node, node + shape.shape[-2])
        node = here.stop
        with torch.enable_grad():
            given = problem.pressure[..., None, own].detach()
            pressure = given.expand(*shape.shape[:-1], given.shape[-1]).clone().requires_grad_()
            reaction = segment_reaction(segment, shape, pressure, problem.shear_stiffness)
            for place, column in enumerate(columns):
                total = reaction[..., column].sum()
                if total.requires_grad:
                    (one,) = torch.autograd.grad(total, pressure, retain_graph=True, allow_unused=True)
                    if one is not None:
                        slope[..., own, here, place] = one.mT
    return slope
