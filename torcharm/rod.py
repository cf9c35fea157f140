"""The rod: from twists to poses, and from the centreline to each actuator."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torcharm import se2
from torcharm._inputs import broadcast_shapes, check_tensor

BASE_POSE = (0.0, 0.0, -math.pi / 2)
"""The arm hangs: x right, y up, the base pointing down."""


def poses(
    twists: Float[Tensor, "*#batch N 3"], base_pose: Float[Tensor, "*#batch 3"] | None = None
) -> Float[Tensor, "... N+1 3"]:
    """Poses of the N+1 nodes of a rod of N segments of constant twist, in the world frame.

    The product of exponentials `g_{i+1} = g_i ∘ exp(twist_i / N)`, written as two running
    sums because headings add in the plane: no loop over the nodes.

    Args:
        twists: centreline twists `(l, γ, κ)` per unit of normalised arc [m, m, rad].
        base_pose: pose of node 1 [m, m, rad]; None hangs the arm from the origin.

    Raises:
        ValueError: shapes do not fit.
    """
    check_tensor("twists", twists, "N", 3)
    segments = twists.shape[-2]
    base = twists.new_tensor(BASE_POSE) if base_pose is None else base_pose
    check_tensor("base_pose", base, 3)
    broadcast_shapes(twists=twists.shape[:-2], base_pose=base.shape[:-1])
    step = se2.exp(twists / segments)
    turned = torch.cat((torch.zeros_like(step[..., :1, 2]), step[..., 2].cumsum(-1)), -1)
    heading = base[..., 2:] + turned
    moved = se2.rotate(heading[..., :-1], step[..., :2].expand(*heading.shape[:-1], segments, 2)).cumsum(-2)
    start = base[..., None, :2].expand(*moved.shape[:-2], 1, 2)
    return torch.cat((torch.cat((start, start + moved), -2), heading.unsqueeze(-1)), -1)


def actuator_twists(
    twists: Float[Tensor, "*#batch N 3"], radii: Float[Tensor, "*#batch M"]
) -> Float[Tensor, "... N M 3"]:
    """Each actuator's own twists: `Ad⁻¹` of the centreline's for an offset r across the arm.

    `l_α = l - r_α κ`, `γ_α = γ`, `κ_α = κ` (m, m, rad).
    """
    length, shear, curvature = twists.unsqueeze(-2).unbind(-1)
    own_length = offset_length(length, curvature, radii.unsqueeze(-2))
    return torch.stack((own_length, shear.expand_as(own_length), curvature.expand_as(own_length)), -1)


def offset_length(
    length: Float[Tensor, "..."], curvature: Float[Tensor, "..."], radius: Float[Tensor, "..."]
) -> Float[Tensor, "..."]:
    """Length `l - r κ` [m] of an actuator at radius r [m] from a centreline of length l and curvature κ."""
    return length - radius * curvature


def strain(actuator_length: Float[Tensor, "..."], neutral_length: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
    """`ε = (l_α - l̂_α)/l̂_α`, without unit."""
    return (actuator_length - neutral_length) / neutral_length


def material_curvature(
    curvature: Float[Tensor, "..."],
    actuator_length: Float[Tensor, "..."],
    neutral_length: Float[Tensor, "..."],
) -> Float[Tensor, "..."]:
    """Curvature per metre of the actuator as it lies, `κ/l_α` [rad/m].

    An actuator squeezed to nothing has no curvature: below a millionth of its neutral length
    (a strain of -1, far outside every force model's range) the length is held there, so that the
    quotient stays finite.
    """
    floor = 1e-6 * neutral_length
    held = torch.where(actuator_length < 0, -floor, floor)
    return curvature / torch.where(actuator_length.abs() < floor, held, actuator_length)
