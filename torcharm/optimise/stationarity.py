"""How near a point is to a minimum where the objective has kinks."""

import numpy as np
import torch
from torch import Tensor

from torcharm.optimise.objective import Problem

RADIUS = 1e-4
"""Around the point, of the distance between bounds, gradients are gathered."""
ACTIVE = 1e-4
"""Constraints with less room count as met with equality."""


def stationarity(
    problem: Problem, point: Tensor, owner: int, radius: float = RADIUS, count: int | None = None
) -> float:
    """The least norm of a convex mix of nearby gradients plus normals of active constraints, over their mean norm.

    At a minimum of a function with kinks some convex mix of the gradients on the sides of the kinks is balanced by
    the constraints (Goldstein's ε-subdifferential; Burke, Lewis & Overton 2005). Where the objective is smooth this
    is the projected gradient.

    Args:
        problem: what is minimised.
        point: (F,).
        owner: whose polytope it is in.
        radius: of the ball in which gradients are gathered.
        count: of gradients; None takes 4 F.

    Returns:
        The norm; NaN if the objective is no number at the point.
    """
    from scipy.optimize import nnls

    polytope, free = problem.polytopes[owner], problem.dimension
    number = 4 * free if count is None else count
    generator = torch.Generator().manual_seed(0)
    offset = torch.randn(number, free, generator=generator, dtype=torch.float64)
    offset = radius * offset / offset.norm(dim=-1, keepdim=True).clamp(min=1e-300)
    around = polytope.project(torch.cat((point[None], point + offset)))
    warm = torch.full((len(around),), 1e-6, dtype=torch.float64)
    judged = problem.judge(around, torch.full((len(around),), owner), warm, gradient=True)
    assert judged.gradient is not None
    known = judged.smooth.isfinite()
    if not bool(known[0]):
        return float("nan")
    slopes = judged.gradient[known]
    size = float(slopes.norm(dim=-1).mean())
    if size == 0.0:
        return 0.0
    room = polytope.bound - point @ polytope.rows.T
    normals = polytope.rows[room < ACTIVE]
    # min ‖Gᵀλ + Aᵀμ‖, 1ᵀλ = 1: the sum is a heavily weighted row.
    heavy = 1e4
    top = torch.cat((slopes / size, normals)).T.numpy()
    bottom = heavy * np.concatenate((np.ones(len(slopes)), np.zeros(len(normals))))[None]
    weights, _ = nnls(np.vstack((top, bottom)), np.append(np.zeros(free), heavy), maxiter=50 * (top.shape[1] + 1))
    share = weights[: len(slopes)].sum()
    return float(np.linalg.norm(top @ weights) / share)
