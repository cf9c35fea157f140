"""The predicted error as a convex QP: with J frozen, actuators' forces along the arm mix within their convex hulls.

At mid pressure J is frozen, so that `δz = -J⁻¹(q + Σ_α c_α)` with c_α in the hull of the curve of actuator α's wrenches
at all nodes at once, sampled at some pressures: one simplex of weights for each actuator. To first order poses move by
E δz, and the cost is a sum of squares of an affine function of the weights.
"""

import math
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import torch
from torch import Tensor

import torcharm as ta
from torcharm.engine.questions import inverse
from torcharm.pressure.pose_cost import pose_errors
from torcharm.pressure.prepared import detached, prepare
from torcharm.wrench_sets.qp import require_qpth

SAMPLES = 5
REGULARISATION = 1e-8


def qp_surrogate(arm: ta.ArmDesign, task: ta.Task) -> Tensor:
    """The square root of the cost (L,) [m] of one design on the loads (L, 3) of one shape; NaN where qpth fails, or
    is not installed."""
    offset, columns = _affine(arm, task)
    if find_spec("qpth") is None:  # it has no release for Python 3.13 and later
        return torch.full_like(offset[:, 0], math.nan)
    count, size = arm.actuator_count, columns.shape[-1]
    gram = columns.mT @ columns
    scale = gram.diagonal(dim1=-2, dim2=-1).amax(-1)[:, None, None]
    eye = torch.eye(size, dtype=offset.dtype)
    linear = (columns.mT @ offset.unsqueeze(-1)).squeeze(-1) / scale.squeeze(-1)
    simplex = torch.block_diag(*[torch.ones(1, size // count, dtype=offset.dtype)] * count)
    many = len(offset)
    weights = require_qpth()(
        gram / scale + REGULARISATION * eye,
        linear,
        -eye.expand(many, -1, -1),
        offset.new_zeros(many, size),
        simplex.expand(many, -1, -1),
        offset.new_ones(many, count),
    )
    return (offset + (columns @ weights.unsqueeze(-1)).squeeze(-1)).norm(dim=-1)


def _affine(arm: ta.ArmDesign, task: ta.Task) -> tuple[Tensor, Tensor]:
    """Weighted pose errors `b + A s`: (L, K) and (L, K, M·S)."""
    prepared = detached(prepare(arm, task, None))
    problem, shape = prepared.problem, task.twists
    middle = replace(problem, pressure=0.5 * problem.pressure)
    whole = torch.from_numpy(inverse(middle.packed, prepared.shape, np.arange(problem.count)))
    unloaded = replace(problem, pressure=torch.zeros_like(problem.pressure)).residual(shape)
    shares = torch.linspace(0, 1, SAMPLES, dtype=shape.dtype)
    one = torch.eye(arm.actuator_count, dtype=shape.dtype) * arm.max_pressure
    curves = ta.reaction_wrench(arm, shape, one.unsqueeze(1) * shares[:, None])  # (M, S, N, 2)
    curves = curves - ta.reaction_wrench(arm, shape, torch.zeros_like(arm.max_pressure))
    each = curves.flatten(2).flatten(0, 1).mT.expand(problem.count, -1, -1)
    moves = -whole @ torch.cat((unloaded.flatten(1).unsqueeze(-1), each), -1)

    def errors(unknown: Tensor) -> Tensor:
        length, curvature = unknown.unbind(-1)
        moved = torch.stack((length, torch.zeros_like(length), curvature), -1)
        return pose_errors(prepared.poses(moved), prepared.poses(shape))

    slope = torch.autograd.functional.jacobian(errors, shape[..., [0, 2]]).flatten(2).flatten(0, 1)
    root = ta.PoseCost().weights(task.nodes, arm.neutral_length).sqrt().flatten()
    weighted = root.unsqueeze(-1) * (slope @ moves)
    return weighted[..., 0], weighted[..., 1:]
