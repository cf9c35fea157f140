"""The actuators' part: the reaction of a cross-section, and its derivatives."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torcharm.actuators import Actuator
from torcharm.actuators.bending import active_moment, bending_model, is_bent, passive_moment
from torcharm.arm import ArmDesign
from torcharm.geometry import rod
from torcharm.mechanics.kinematics import rows_of
from torcharm.wrenches import (
    actuator_force,
    actuator_slopes,
    actuator_state,
    along,
    reference_pressures,
    resting_moment,
)


class ActuatorPart(NamedTuple):
    """The reaction of the cross-sections.

    Attributes:
        wrench: (..., C, N), a_i.
        stiffness: (..., C, C, N), the local ∂a_i/∂z_i.
        by_pressure: (..., C, N, M), ∂a_i/∂p [N/kPa, N·m/kPa].
    """

    wrench: Tensor
    stiffness: Tensor
    by_pressure: Tensor


def actuator_wrench(
    arm: ArmDesign,
    unknowns: Float[Tensor, "*#batch C N"],
    pressure: Float[Tensor, "*#batch M"],
    shear_stiffness: float | None = None,
) -> Float[Tensor, "... C N"]:
    """a_i: `Σ f_α` and `Σ (-r_α f_α + τ_α)`; with shear `-k Σ γ_α` between them.

    Differentiable in everything, to any order that the force models allow.
    """
    models, (length, curvature, radii, neutral) = arm.actuators, _columns(arm, unknowns)
    pressure = pressure.unsqueeze(-1)
    strain, bending = actuator_state(models, length, curvature, radii, neutral, -2)
    force = actuator_force(models, strain, pressure, -2)
    share = pressure / along(reference_pressures(models), strain, -2)
    moment = (bending * share - radii * force).sum(-2)
    resting = resting_moment(models, length, curvature, radii, neutral, -2)
    moment = moment if resting is None else moment + resting
    return _stacked(force.sum(-2), moment, unknowns, arm.actuator_count, shear_stiffness)


def _columns(arm: ArmDesign, unknowns: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """l and κ (..., 1, N), r and l̂ (..., M, 1)."""
    length, _, curvature = rows_of(unknowns)
    return length.unsqueeze(-2), curvature.unsqueeze(-2), arm.radii.unsqueeze(-1), arm.length.unsqueeze(-1)


def actuator_part(
    arm: ArmDesign,
    unknowns: Float[Tensor, "*#batch C N"],
    pressure: Float[Tensor, "*#batch M"],
    shear_stiffness: float | None = None,
    *,
    pressure_slope: bool = True,
    create_graph: bool = False,
) -> ActuatorPart:
    """a_i with its local derivatives by twist and pressure.

    Force models that write out no slopes are differentiated by autograd, all nodes and actuators in one sweep (forces
    are element-wise); all else is closed form. Without pressure_slope, by_pressure is of no actuators: (..., C, N, 0).
    With create_graph the derivatives can be differentiated again, else they come detached.
    """
    models = arm.actuators
    with torch.set_grad_enabled(create_graph):
        length, curvature, radii, neutral = _columns(arm, unknowns)
        own_length = rod.offset_length(length, curvature, radii)
        strain = rod.strain(own_length, neutral)
        force, by_strain, by_pressure = _force_slopes(arm, strain, pressure.unsqueeze(-1), pressure_slope, create_graph)
        by_length = by_strain / neutral
        first = radii * by_length
        moment, moment_length, moment_curvature = -radii * force, -first.sum(-2), (radii * first).sum(-2)
        bends = any_bending(models)
        active = reference = None
        if bends:  # a term that is switched off costs nothing
            reference = along(reference_pressures(models), strain, -2)
            bent = bending_moments(
                models, curvature, own_length, neutral, pressure.unsqueeze(-1) / reference, create_graph
            )
            active = bent.active
            # k = κ/l_α, with l_α = l - r κ
            squeeze = bent.slope * bent.squeezed
            moment = moment + bent.moment
            moment_length = moment_length - squeeze.sum(-2)
            moment_curvature = moment_curvature + (bent.slope * bent.per_length + radii * squeeze).sum(-2)
        size = unknowns.shape[-2]
        blocks = moment_length.new_zeros(*moment_length.shape[:-1], size, size, moment_length.shape[-1])
        blocks[..., 0, 0, :], blocks[..., 0, -1, :] = by_length.sum(-2), -first.sum(-2)
        blocks[..., -1, 0, :], blocks[..., -1, -1, :] = moment_length, moment_curvature
        if shear_stiffness is not None and size == 3:
            blocks[..., 1, 1, :] = -shear_stiffness * arm.actuator_count
        wrench = _stacked(force.sum(-2), moment.sum(-2), unknowns, arm.actuator_count, shear_stiffness)
        if by_pressure is None:
            return ActuatorPart(wrench, blocks, wrench.new_empty(*wrench.shape, 0))
        moment_pressure = -radii * by_pressure
        if active is not None and reference is not None:
            moment_pressure = moment_pressure + active / reference
        rows = [by_pressure, moment_pressure]
        if size == 3:
            rows.insert(1, torch.zeros_like(by_pressure))
        return ActuatorPart(wrench, blocks, torch.stack(rows, -3).transpose(-1, -2))


def any_bending(models: tuple[Actuator, ...]) -> bool:
    """Whether any actuator bears bending moments."""
    return any(is_bent(model.bending_stiffness) for model in models)


class Bent(NamedTuple):
    """Bending moments, each broadcasting to (..., M, N).

    Attributes:
        moment: at the given share of the reference pressures [N·m].
        active: what the reference pressure adds [N·m].
        slope: of the moment by material curvature [N·m²].
        per_length: 1/l_α [1/m].
        squeezed: `κ/l_α²`, minus the derivative of κ/l_α by l_α [1/m²].
    """

    moment: Tensor
    active: Tensor
    slope: Tensor
    per_length: Tensor
    squeezed: Tensor


def bending_moments(
    models: tuple[Actuator, ...],
    curvature: Tensor,
    own_length: Tensor,
    neutral: Tensor,
    share: Tensor,
    create_graph: bool,
) -> Bent:
    """Moments at shares of the reference pressures."""
    per_length = rod.material_curvature(torch.ones_like(own_length), own_length, neutral)
    material = curvature * per_length
    # where the length is held, see `rod.material_curvature`, it has no derivative
    live = (own_length.detach().abs() >= 1e-6 * neutral.detach()).to(own_length.dtype)
    squeezed = material * per_length * live
    if all(bending_model(model.bending_stiffness) is None for model in models):
        stiffness = along([model.bending_stiffness for model in models], material, -2)  # type: ignore[misc]
        active = stiffness * material
        return Bent(active * share, active, stiffness * share, per_length, squeezed)
    with torch.enable_grad():
        bend = material.clone() if create_graph and material.requires_grad else material.detach().requires_grad_()
        parts = list(zip((model.bending_stiffness for model in models), bend.unbind(-2), strict=True))
        active = torch.stack([active_moment(stiffness, k) for stiffness, k in parts], -2)
        passive = [passive_moment(stiffness, k) for stiffness, k in parts]
        resting = torch.stack(
            [torch.zeros_like(k) if tau is None else tau for tau, (_, k) in zip(passive, parts, strict=True)], -2
        )
        moment = active * share + resting
        slope = torch.zeros_like(moment)
        if moment.requires_grad:
            (slope,) = torch.autograd.grad(
                moment.sum(), bend, create_graph=create_graph, allow_unused=True, materialize_grads=True
            )
    if not create_graph:
        moment, active = moment.detach(), active.detach()
    return Bent(moment, active, slope, per_length, squeezed)


def _stacked(axial: Tensor, moment: Tensor, unknowns: Tensor, actuators: int, shear_stiffness: float | None) -> Tensor:
    rows = [axial, moment]
    if unknowns.shape[-2] == 3:
        assert shear_stiffness is not None
        rows.insert(1, (-shear_stiffness * actuators * unknowns[..., 1, :]).expand_as(axial))
    return torch.stack(rows, -2)


def _force_slopes(
    arm: ArmDesign, strain: Tensor, pressure: Tensor, pressure_slope: bool, create_graph: bool
) -> tuple[Tensor, Tensor, Tensor | None]:
    """Forces f, ∂f/∂ε, and ∂f/∂p if wanted, each (..., M, N)."""
    if not create_graph:
        strain = strain.expand(torch.broadcast_shapes(strain.shape, pressure.shape))
        return actuator_slopes(arm.actuators, strain.detach(), pressure.detach(), pressure_slope, -2)
    strain, pressure = torch.broadcast_tensors(strain, pressure)
    with torch.enable_grad():
        strain = strain.clone() if strain.requires_grad else strain.contiguous().requires_grad_()
        if pressure_slope:  # node by node: a view would gather it over the nodes
            pressure = pressure.clone() if pressure.requires_grad else pressure.clone().requires_grad_()
        force = actuator_force(arm.actuators, strain, pressure, -2)
        wanted = (strain, pressure) if pressure_slope else (strain,)
        if force.requires_grad:
            slopes = torch.autograd.grad(
                force.sum(), wanted, create_graph=True, allow_unused=True, materialize_grads=True
            )
        else:  # a constant force
            slopes = tuple(torch.zeros_like(force) for _ in wanted)
    return force, slopes[0], slopes[1] if pressure_slope else None
