"""The tip load, carried to the nodes."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torcharm.mechanics.kinematics import Kinematics


class LoadPart(NamedTuple):
    """The tip load at the nodes.

    Attributes:
        wrench: (..., C, N), q_i in node i's frame.
        stiffness: (..., C, N, C, N), ∂q/∂z.
    """

    wrench: Tensor
    stiffness: Tensor


def load_wrench(motion: Kinematics, tip_load: Float[Tensor, "*#batch 3"], *, shear: bool = False) -> Tensor:
    """q_i (..., C, N): the force `R_iᵀ F` and the moment `m_tip + (p_tip - p_i) × F` in each node's frame."""
    force_x, force_y, moment = (tip_load[..., k : k + 1] for k in range(3))
    node, tip = motion.pose[..., :-1, :], motion.pose[..., -1:, :]
    cos, sin = node[..., 2].cos(), node[..., 2].sin()
    lever = (tip - node)[..., :2]
    rows = [cos * force_x + sin * force_y, moment + lever[..., 0] * force_y - lever[..., 1] * force_x]
    if shear:
        rows.insert(1, cos * force_y - sin * force_x)
    return torch.stack(rows, -2)


def load_part(motion: Kinematics, tip_load: Float[Tensor, "*#batch 3"], *, shear: bool = False) -> LoadPart:
    """q and ∂q/∂z. Independent of pressures and of the design.

    `∂(R_iᵀF)/∂κ_j = (f_y, -f_x)_i / N` for j < i. The moment about node i turns with the rod between node and
    tip: for j ≥ i it changes as `∂p_tip/∂z_j × F`, for j < i by `-(p_tip - p_i)·F / N` with κ_j alone.
    """
    force = tip_load[..., None, :2]
    wrench = load_wrench(motion, tip_load, shear=True)
    axial, across, _ = wrench.unbind(-2)
    count = axial.shape[-1]
    position = motion.pose[..., :2]
    reach = -((position[..., -1:, :] - position) * force).sum(-1) / count  # (..., N+1): a turn about node i
    later = axial.new_ones(count, count).triu()  # node i, segment j: j ≥ i
    earlier = 1 - later

    size = 3 if shear else 2
    stiffness = wrench.new_zeros(*wrench.shape[:-2], size, count, size, count)
    stiffness[..., 0, :, -1, :] = (across / count).unsqueeze(-1) * earlier
    by_length, by_curvature = _cross(motion.by_length, force), _cross(motion.by_curvature, force) + reach[..., 1:]
    stiffness[..., -1, :, 0, :] = by_length.unsqueeze(-2) * later
    stiffness[..., -1, :, -1, :] = by_curvature.unsqueeze(-2) * later + reach[..., :-1].unsqueeze(-1) * earlier
    if shear:
        stiffness[..., 1, :, -1, :] = (-axial / count).unsqueeze(-1) * earlier
        stiffness[..., -1, :, 1, :] = _cross(motion.by_shear, force).unsqueeze(-2) * later
    return LoadPart(wrench if shear else wrench[..., ::2, :], stiffness)


def _cross(vector: Tensor, other: Tensor) -> Tensor:
    return vector[..., 0] * other[..., 1] - vector[..., 1] * other[..., 0]
