"""The predicted error as a convex QP: with J frozen, actuators' forces along the arm mix within their convex hulls.

At mid pressure J is frozen, so that `δz = -J⁻¹(q + Σ_α c_α)` with c_α in the hull of the curve of actuator α's wrenches
at all nodes at once, sampled at some pressures: one simplex of weights for each actuator. To first order poses move by
E δz, and the cost is a sum of squares of an affine function of the weights.
"""

import torch
from torch import Tensor

import torcharm as ta
from torcharm import mechanics
from torcharm.wrench_sets.qp import require_qpth

SAMPLES = 5
REGULARISATION = 1e-8


def qp_surrogate(arm: ta.ArmDesign, task: ta.Task) -> Tensor:
    """The square root of the cost (L,) [m] of one design on the loads (L, 3) of one shape; NaN where qpth fails."""
    offset, columns = _affine(arm, task)
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
    unknowns = mechanics.to_unknowns(task.twists)
    loads = task.tip_load
    balance = mechanics.balance(arm, unknowns, 0.5 * arm.max_pressure, loads, task.base_pose)
    load = mechanics.load_wrench(balance.kinematics, loads)
    shares = torch.linspace(0, 1, SAMPLES, dtype=loads.dtype)
    none = mechanics.actuator_wrench(arm, unknowns, torch.zeros_like(arm.max_pressure))
    one = torch.eye(arm.actuator_count, dtype=loads.dtype) * arm.max_pressure
    curves = mechanics.actuator_wrench(arm, unknowns, one.unsqueeze(1) * shares[:, None]) - none  # (M, S, 2, N)
    right = torch.cat(
        ((load + none).unsqueeze(-1), curves.flatten(0, 1).movedim(0, -1).expand(len(loads), -1, -1, -1)), -1
    )
    moves = -mechanics.solve(balance.stiffness, right)
    jacobian = mechanics.pose_jacobian(balance.kinematics)  # (..., 3, N+1, 2, N)
    pose = balance.kinematics.pose
    _, slope = mechanics.pose_error(pose, pose)
    errors = torch.einsum("...iab,...bicn,...cnk->...iak", slope, jacobian, moves)
    root = ta.PoseCost().weights(unknowns.shape[-1], loads).sqrt()
    weighted = (root.unsqueeze(-1) * errors).flatten(1, 2)
    return weighted[..., 0], weighted[..., 1:]
