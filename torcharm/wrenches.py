"""What pressures provide at cross-sections of planar arms, for the mechanics.

Planar hull wrenches are `(f_x, m)` in N and N·m, in the frame of their node. Shear is carried by
the arm's shear stiffness and has no part in them.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from torcharm.actuators import Actuator, force_slopes
from torcharm.actuators.bending import (
    active_moment,
    bending_model,
    linear_stiffness,
    passive_moment,
    reference_pressure,
)
from torcharm.actuators.inspection import same_model
from torcharm.geometry import rod
from torcharm.statics.external_load import HULL

PLANAR = HULL[3]
"""Components of a wrench `(f_x, f_y, m)` that a planar hull holds."""


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
