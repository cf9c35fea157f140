"""Wrenches along the arm: what a task requires, and what pressures provide.

Planar hull wrenches are `(f_x, m)` in N and N·m, in the frame of their node. Shear is carried by
the arm's shear stiffness and has no part in them.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torcharm import rod, se2
from torcharm._inputs import as_floating, broadcast_shapes, check_at_least, check_finite, check_tensor
from torcharm.actuators import Actuator, force_slopes
from torcharm.actuators.bending import (
    active_moment,
    bending_model,
    linear_stiffness,
    passive_moment,
    reference_pressure,
)
from torcharm.actuators.inspection import same_model
from torcharm.arm import ArmDesign

PLANAR = (0, 2)
"""Components of a wrench `(f_x, f_y, m)` that a planar hull holds."""


def required_wrench(
    twists: Float[Tensor, "*#batch N 3"],
    tip_load: Float[Tensor, "*#batch 3"],
    base_pose: Float[Tensor, "*#batch 3"] | None = None,
) -> Float[Tensor, "... N 3"]:
    """The reaction `w_i = -q_i` that the task asks of each node, `(f_x, f_y, m)` in its frame.

    Plain statics: the force F is `R_iᵀ F` in node i's frame, the moment about node i is
    `m_tip + (p_tip - p_i) × F`. The same as carrying the load by `Ad^{-T}_{g_i⁻¹ g_tip}`.

    Args:
        twists: the task's shape [m, m, rad].
        tip_load: `(f_x, f_y, m)` at the tip in the world frame [N, N, N·m].
        base_pose: pose of node 1; None hangs the arm.

    Raises:
        ValueError: shapes do not fit.
    """
    pose = rod.poses(twists, base_pose)
    check_tensor("tip_load", tip_load, 3)
    broadcast_shapes(twists=pose.shape[:-2], tip_load=tip_load.shape[:-1])
    node, tip = pose[..., :-1, :], pose[..., -1:, :]
    force = tip_load[..., None, :2]
    local = se2.rotate(-node[..., 2], force.expand(*_joint(node, force), 2))
    arm = (tip - node)[..., :2]
    moment = tip_load[..., None, 2] + arm[..., 0] * force[..., 1] - arm[..., 1] * force[..., 0]
    return -torch.cat((local, moment.unsqueeze(-1)), -1)


def _joint(node: Tensor, force: Tensor) -> torch.Size:
    return torch.broadcast_shapes(node.shape[:-1], force.shape[:-1])


def along(values: Sequence[float | Tensor], like: Tensor, dim: int) -> Tensor:
    """One number per actuator, shaped to broadcast along dimension `dim` (counted from the end); tensors keep their
    graphs."""
    if any(isinstance(value, Tensor) for value in values):
        row = torch.stack([torch.as_tensor(value, dtype=like.dtype, device=like.device).squeeze() for value in values])
    else:
        row = like.new_tensor(values)
    return row.view(-1, *(1,) * (-1 - dim))


def reference_pressures(actuators: tuple[Actuator, ...]) -> list[float | Tensor]:
    """The pressures [kPa] at which the models' bending stiffness holds."""
    return [reference_pressure(model.bending_stiffness, model.max_pressure) for model in actuators]


def actuator_state(
    actuators: tuple[Actuator, ...],
    length: Tensor,
    curvature: Tensor,
    radius: Tensor,
    neutral_length: Tensor,
    dim: int = -1,
) -> tuple[Tensor, Tensor]:
    """Strains, and bending moments at full reference pressure [N·m], of M actuators.

    The moment is linear in pressure: at pressure p an actuator bears `p / p_ref` of it, with p_ref one of
    `reference_pressures` (a limit set on the arm does not stiffen its material). What it bears besides, at any
    pressure, is `resting_moment`.

    Args:
        actuators: M force models, along dimension `dim` (counted from the end).
        length, curvature: of the centreline, l [m] and κ [rad].
        radius, neutral_length: of the actuators [m].
    """
    own_length = rod.offset_length(length, curvature, radius)
    material = rod.material_curvature(curvature, own_length, neutral_length)
    stiffness = [linear_stiffness(model.bending_stiffness) for model in actuators]
    if None in stiffness:
        parts = material.expand_as(own_length).unbind(dim)
        moments = [active_moment(model.bending_stiffness, k) for model, k in zip(actuators, parts, strict=True)]
        bending = torch.stack(moments, dim)
    else:
        bending = along([k for k in stiffness if k is not None], own_length, dim) * material
    return rod.strain(own_length, neutral_length), bending


def resting_moment(
    actuators: tuple[Actuator, ...],
    length: Tensor,
    curvature: Tensor,
    radius: Tensor,
    neutral_length: Tensor,
    dim: int = -1,
) -> Tensor | None:
    """The sum over the actuators of the bending moments that no pressure changes [N·m], without dimension `dim`.

    None where there are none, as for the paper's models. Arguments as for `actuator_state`.
    """
    if all(bending_model(model.bending_stiffness) is None for model in actuators):
        return None
    own_length = rod.offset_length(length, curvature, radius)
    material = rod.material_curvature(curvature, own_length, neutral_length).expand_as(own_length).unbind(dim)
    parts = [passive_moment(model.bending_stiffness, k) for model, k in zip(actuators, material, strict=True)]
    found = [part for part in parts if part is not None]
    return torch.stack(found).sum(0) if found else None


def actuator_force(actuators: tuple[Actuator, ...], strain: Tensor, pressure: Tensor, dim: int = -1) -> Tensor:
    """Axial forces [N] of M actuators along dimension `dim` (counted from the end).

    Models that are the same are evaluated in one call, so the cost follows the number of kinds.
    """
    groups = group_alike(actuators)
    shape = torch.broadcast_shapes(strain.shape, pressure.shape)
    if len(groups) == 1:  # which may not depend on pressure
        return actuators[0].force(strain, pressure).expand(shape)
    force = strain.new_empty(shape, dtype=torch.result_type(strain, pressure))
    for model, members in groups:
        index = (..., members, *(slice(None),) * (-1 - dim))
        force[index] = model.force(strain[index], pressure[index])
    return force


def actuator_slopes(
    actuators: tuple[Actuator, ...], strain: Tensor, pressure: Tensor, by_pressure: bool = True, dim: int = -1
) -> tuple[Tensor, Tensor, Tensor | None]:
    """`actuator_force` with its derivatives by strain and, if wanted, by pressure [1/kPa]; detached.

    Pressure broadcasts to strain.
    """
    groups = group_alike(actuators)
    if len(groups) == 1:
        return force_slopes(actuators[0], strain, pressure, by_pressure)
    out = [torch.empty_like(strain) for _ in range(3 if by_pressure else 2)]
    for model, members in groups:
        index = (..., members, *(slice(None),) * (-1 - dim))
        for whole, part in zip(out, force_slopes(model, strain[index], pressure[index], by_pressure), strict=False):
            if part is not None:
                whole[index] = part
    return out[0], out[1], out[2] if by_pressure else None


def group_alike(actuators: tuple[Actuator, ...]) -> list[tuple[Actuator, slice | list[int]]]:
    """Each kind of model, and where it sits: as a slice, which costs no copy, if evenly spaced."""
    groups: list[tuple[Actuator, list[int]]] = []
    for index, model in enumerate(actuators):
        for known, members in groups:
            if same_model(known, model):
                members.append(index)
                break
        else:
            groups.append((model, [index]))
    return [(model, _as_slice(members)) for model, members in groups]


def _as_slice(members: list[int]) -> slice | list[int]:
    step = members[1] - members[0] if len(members) > 1 else 1
    evenly = slice(members[0], members[-1] + 1, step)
    return evenly if list(range(members[-1] + 1))[evenly] == members else members


def reaction_wrench(
    arm: ArmDesign, twists: Float[Tensor, "*#batch N 3"], pressure: Float[Tensor, "*#batch M"]
) -> Float[Tensor, "... N 2"]:
    """Reaction `(f_x, m)` [N, N·m] of each node to pressures [kPa], in the node's frame.

    `f_x = Σ f_α(ε_α, p_α)` and `m = Σ (-r_α f_α + τ_α)`. The paper prints `+r`; virtual work
    (`∂l_α/∂κ = -r_α`) asks for the minus.

    Raises:
        ValueError: a pressure is negative or not finite, or shapes do not fit.
    """
    check_tensor("twists", twists, "N", 3)
    pressure, _ = as_floating(pressure=pressure, radii=arm.radii)
    check_tensor("pressure", pressure, arm.actuator_count)
    broadcast_shapes(twists=twists.shape[:-2], pressure=pressure.shape[:-1], radii=arm.batch_shape)
    check_finite("pressure", pressure)
    check_at_least("pressure", pressure, 0.0, unit="kPa")
    length, _, curvature = twists.unsqueeze(-2).unbind(-1)
    radii, neutral, pressure = arm.radii.unsqueeze(-2), arm.length.unsqueeze(-2), pressure.unsqueeze(-2)
    strain, bending = actuator_state(arm.actuators, length, curvature, radii, neutral)
    force = actuator_force(arm.actuators, strain, pressure)
    share = pressure / along(reference_pressures(arm.actuators), pressure, -1)
    moment = (bending * share - radii * force).sum(-1)
    resting = resting_moment(arm.actuators, length, curvature, radii, neutral)
    return torch.stack((force.sum(-1), moment if resting is None else moment + resting), -1)
