"""How equilibria change with pressure: `dz/dp = -J⁻¹ ∂R/∂p`, for all actuators at once and without a graph."""

import torch
from torch import Tensor

from torcharm.engine.arms import numbers
from torcharm.equilibrium.problem import Problem
from torcharm.statics.balance import segment_reaction, segments_of


def pressure_sensitivity(problem: Problem, twists: Tensor) -> Tensor:
    """The change (B, M, N, K) of the twists by each actuator's pressure [m/kPa, rad/kPa].

    Forces of sampled models change as their tables do, which is good to some four digits.

    Args:
        problem: B problems, of a batch of one dimension, in float64 on the CPU.
        twists: (B, N, K) their equilibria.
    """
    rate = torch.zeros(problem.count, problem.arm.actuator_count, *twists.shape[1:], dtype=torch.float64)
    right, columns = _pressure_slope(problem, twists.detach()).numpy(), problem.unknown
    problem.packed.solve(numbers(twists), torch.arange(problem.count).numpy(), right)
    rate[..., columns] = -torch.from_numpy(right)
    return rate


def _pressure_slope(problem: Problem, twists: Tensor) -> Tensor:
    """∂R/∂p (B, M, N, C): a pressure changes what the sections of its own segment provide, each by itself."""
    columns, count = problem.unknown, problem.arm.actuator_count
    slope = torch.zeros(problem.count, count, twists.shape[1], len(columns), dtype=torch.float64)
    actuator = node = 0
    segments = segments_of(problem.arm)[0]
    for segment, shape in zip(segments, twists.split(problem.nodes, 1), strict=True):
        own = slice(actuator, actuator + segment.actuator_count)
        here = slice(node, node + shape.shape[1])
        actuator, node = own.stop, here.stop
        with torch.enable_grad():
            pressure = problem.pressure[:, None, own].detach().expand(-1, shape.shape[1], -1).clone().requires_grad_()
            reaction = segment_reaction(segment, shape, pressure, problem.shear_stiffness)
            for place, column in enumerate(columns):
                total = reaction[..., column].sum()
                if total.requires_grad:
                    (one,) = torch.autograd.grad(total, pressure, retain_graph=True, allow_unused=True)
                    if one is not None:
                        slope[:, own, here, place] = one.mT
    return slope
