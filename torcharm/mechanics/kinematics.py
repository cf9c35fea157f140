"""Unknowns, poses and their derivatives; no matrix where a running sum does."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torcharm.geometry import se2


class Kinematics(NamedTuple):
    """Poses of the nodes, and how each segment's end moves, in the world frame, with its own twist.

    Attributes:
        pose: (..., N+1, 3) [m, m, rad].
        by_length, by_shear, by_curvature: (..., N, 2) derivative of segment j's end position, its start held,
            with respect to l_j, γ_j [1] and κ_j [m/rad].
    """

    pose: Tensor
    by_length: Tensor
    by_shear: Tensor
    by_curvature: Tensor


def to_unknowns(twists: Float[Tensor, "*batch N 3"], *, shear: bool = False) -> Float[Tensor, "... C N"]:
    """The unknowns z of twists; without shear γ is left out."""
    rows = twists.transpose(-1, -2)
    return rows if shear else rows[..., ::2, :]


def to_twists(unknowns: Float[Tensor, "*batch C N"]) -> Float[Tensor, "*batch N 3"]:
    """Twists `(l, γ, κ)` of the unknowns; γ = 0 where it is none of them."""
    length, shear, curvature = rows_of(unknowns)
    return torch.stack((length, torch.zeros_like(length) if shear is None else shear, curvature), -1)


def rows_of(unknowns: Tensor) -> tuple[Tensor, Tensor | None, Tensor]:
    """Rows l, γ (None where it is none of the unknowns) and κ."""
    if unknowns.shape[-2] == 3:
        return unknowns[..., 0, :], unknowns[..., 1, :], unknowns[..., 2, :]
    return unknowns[..., 0, :], None, unknowns[..., 1, :]


def kinematics(unknowns: Float[Tensor, "*#batch C N"], base_pose: Float[Tensor, "*#batch 3"]) -> Kinematics:
    """Poses and the segments' own derivatives, with `p_{j+1} = p_j + R_j V(κ_j/N) (l_j, γ_j)/N`.

    A whole segment is a straight step half-way turned: `V(2h) = sin(h)/h` times the rotation by h.
    """
    length, shear, curvature = rows_of(unknowns)
    count = unknowns.shape[-1]
    half = curvature / (2 * count)
    zero = torch.zeros_like(half[..., :1])
    turned = 2 * half.cumsum(-1)
    heading = base_pose[..., 2:] + torch.cat((zero, turned), -1)
    middle = heading[..., :-1] + half
    cos, sin = middle.cos(), middle.sin()
    # V(2h) is a rotation by h, scaled by sin(h)/h
    scale, slope = se2.sine_ratio(half), se2.sine_ratio_slope(half)
    a, b = cos * scale, sin * scale
    da, db = (cos * slope - b) / 2, (sin * slope + a) / 2
    along_x, along_y, bend_x, bend_y = a * length, b * length, da * length, db * length
    if shear is not None:
        along_x, along_y = along_x - b * shear, along_y + a * shear
        bend_x, bend_y = bend_x - db * shear, bend_y + da * shear
    step = torch.stack((along_x, along_y), -1) / count
    start = base_pose[..., None, :2].expand(*step.shape[:-2], 1, 2)
    position = torch.cat((start, start + step.cumsum(-2)), -2)
    return Kinematics(
        torch.cat((position, heading.unsqueeze(-1).expand(*position.shape[:-1], 1)), -1),
        torch.stack((a, b), -1) / count,
        torch.stack((-b, a), -1) / count,
        torch.stack((bend_x, bend_y), -1) / count**2,
    )


def pose_jacobian(motion: Kinematics, *, shear: bool = False) -> Float[Tensor, "... 3 K C N"]:
    """E = ∂(x, y, θ)_i/∂z_j, component by node by unknown by segment; segment j moves the nodes after it."""
    count = motion.by_length.shape[-2]
    moved = motion.by_length.new_ones(count + 1, count).tril(-1)  # node i, segment j: j < i
    position = motion.pose[..., :2]
    lever = (position.unsqueeze(-2) - position[..., None, 1:, :]) / count  # (..., N+1, N, 2)
    turned = torch.stack((-lever[..., 1], lever[..., 0]), -1) + motion.by_curvature.unsqueeze(-3)
    columns = [motion.by_length.unsqueeze(-3).expand_as(turned), turned]
    if shear:
        columns.insert(1, motion.by_shear.unsqueeze(-3).expand_as(turned))
    slides = torch.stack(columns, -3) * moved.unsqueeze(-1).unsqueeze(-3)  # (..., N+1, C, N, 2)
    turns = torch.stack((torch.zeros_like(moved),) * (len(columns) - 1) + (moved / count,), -2)
    return torch.cat((slides.movedim(-1, -4), turns.expand(*slides.shape[:-1]).unsqueeze(-4)), -4)


def pose_change(motion: Kinematics, change: Float[Tensor, "*#batch C N K"]) -> Float[Tensor, "... 3 P K"]:
    """E times K changes of z, by running sums: how far the poses move, without the matrix E."""
    count = change.shape[-2]
    turn = change[..., -1, :, :].cumsum(-2) / count
    turn = torch.cat((torch.zeros_like(turn[..., :1, :]), turn), -2)
    stride = motion.pose[..., 1:, :2] - motion.pose[..., :-1, :2]
    columns = [motion.by_length, motion.by_curvature]
    if change.shape[-3] == 3:
        columns.insert(1, motion.by_shear)
    moved = []
    for axis, across in ((0, -stride[..., 1]), (1, stride[..., 0])):
        slide = across.unsqueeze(-1) * turn[..., :-1, :]
        for row, column in enumerate(columns):
            slide = slide + column[..., axis].unsqueeze(-1) * change[..., row, :, :]
        moved.append(torch.cat((torch.zeros_like(slide[..., :1, :]), slide.cumsum(-2)), -2))
    return torch.stack((*moved, turn), -3)


def pose_error(
    pose: Float[Tensor, "*#batch K 3"], target: Float[Tensor, "*#batch K 3"]
) -> tuple[Float[Tensor, "... K 3"], Float[Tensor, "... K 3 3"]]:
    """`(x, y, θ)` of `g⁻¹ g*` [m, m, rad], the target seen from the pose, and its derivative by the pose.

    Headings are not wrapped: a whole turn too many is an error of 2π.
    """
    cos, sin = pose[..., 2].cos(), pose[..., 2].sin()
    gap = target - pose
    along_x = cos * gap[..., 0] + sin * gap[..., 1]
    along_y = cos * gap[..., 1] - sin * gap[..., 0]
    zero = torch.zeros_like(along_x)
    cos, sin = cos.expand_as(zero), sin.expand_as(zero)
    rows = ((-cos, -sin, along_y), (sin, -cos, -along_x), (zero, zero, zero - 1))
    slope = torch.stack([torch.stack(row, -1) for row in rows], -2)
    return torch.stack((along_x, along_y, gap[..., 2].expand_as(zero)), -1), slope
