"""Balance of the arm at its nodes: residual, stiffness and pose derivatives, batched and in closed form.

What the forward solver, the pressure search and predictions from the task shape share. The unknowns are

    z (..., C, N),   rows (l, κ), or (l, γ, κ) with finite shear     [m, (m,) rad]

one column a segment, and the balance at node i, the start of segment i, is

    R (..., C, N) = a + q,   rows (f_x, m), or (f_x, f_y, m)         [N, (N,) N·m]

with a the reaction to pressures and q the tip load carried to the node, in the node's frame. The load's
part of R and of its derivative depends on z alone; the actuators' part is local to a node. Rows of
components come before nodes so that every matrix is made of whole N × N blocks.

These functions check nothing: their callers do.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torcharm import rod, se2
from torcharm.arm import ArmDesign
from torcharm.wrenches import actuator_force, along, reference_pressures


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


class LoadPart(NamedTuple):
    """The tip load at the nodes.

    Attributes:
        wrench: (..., C, N), q_i in node i's frame.
        stiffness: (..., C, N, C, N), ∂q/∂z.
    """

    wrench: Tensor
    stiffness: Tensor


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


@dataclass(frozen=True)
class Balance:
    """The balance at z and its derivatives.

    Attributes:
        residual: R (..., C, N).
        stiffness: J = ∂R/∂z (..., C, N, C, N), the load's part included.
        by_pressure: ∂R/∂p (..., C, N, M).
        kinematics: of z.
    """

    residual: Tensor
    stiffness: Tensor
    by_pressure: Tensor
    kinematics: Kinematics


def to_unknowns(twists: Float[Tensor, "*batch N 3"], *, shear: bool = False) -> Float[Tensor, "... C N"]:
    """The unknowns z of twists; without shear γ is left out."""
    rows = twists.transpose(-1, -2)
    return rows if shear else rows[..., ::2, :]


def to_twists(unknowns: Float[Tensor, "*batch C N"]) -> Float[Tensor, "*batch N 3"]:
    """Twists `(l, γ, κ)` of the unknowns; γ = 0 where it is none of them."""
    length, shear, curvature = _rows(unknowns)
    return torch.stack((length, torch.zeros_like(length) if shear is None else shear, curvature), -1)


def _rows(unknowns: Tensor) -> tuple[Tensor, Tensor | None, Tensor]:
    if unknowns.shape[-2] == 3:
        return unknowns[..., 0, :], unknowns[..., 1, :], unknowns[..., 2, :]
    return unknowns[..., 0, :], None, unknowns[..., 1, :]


# Kinematics


def kinematics(unknowns: Float[Tensor, "*#batch C N"], base_pose: Float[Tensor, "*#batch 3"]) -> Kinematics:
    """Poses and the segments' own derivatives, with `p_{j+1} = p_j + R_j V(κ_j/N) (l_j, γ_j)/N`.

    A whole segment is a straight step half-way turned: `V(2h) = sin(h)/h` times the rotation by h.
    """
    length, shear, curvature = _rows(unknowns)
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


# The load's part


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


# The actuators' part


def actuator_wrench(
    arm: ArmDesign,
    unknowns: Float[Tensor, "*#batch C N"],
    pressure: Float[Tensor, "*#batch M"],
    shear_stiffness: float | None = None,
) -> Float[Tensor, "... C N"]:
    """a_i: `Σ f_α` and `Σ (-r_α f_α + τ_α)`; with shear `-k Σ γ_α` between them.

    Differentiable in everything, to any order that the force models allow.
    """
    section = _Section.of(arm, unknowns, pressure)
    force = actuator_force(arm.actuators, section.strain, section.pressure, -2)
    moment = -section.radii * force
    if section.bending is not None:
        moment = moment + section.bending * section.share * section.curvature * section.per_length
    return _stacked(force.sum(-2), moment.sum(-2), unknowns, arm.actuator_count, shear_stiffness)


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

    Force models are differentiated by autograd, all nodes and actuators in one sweep (forces are element-wise);
    all else is closed form. Without pressure_slope, by_pressure is of no actuators: (..., C, N, 0). With
    create_graph the derivatives can be differentiated again, else they come detached.
    """
    with torch.set_grad_enabled(create_graph):
        section = _Section.of(arm, unknowns, pressure)
        force, by_strain, by_pressure = _force_slopes(
            arm, section.strain, section.pressure, pressure_slope, create_graph
        )
        by_length = by_strain / section.neutral
        radii = section.radii
        first, second = radii * by_length, radii.square() * by_length
        moment, moment_length, moment_curvature = -radii * force, -first.sum(-2), second.sum(-2)
        if section.bending is not None:
            bent = section.bending * section.per_length  # per unit of share and curvature
            rate = bent * section.share
            squeeze = rate * section.curvature * section.per_length * section.live
            moment = moment + rate * section.curvature
            moment_length = moment_length - squeeze.sum(-2)
            moment_curvature = moment_curvature + (rate + radii * squeeze).sum(-2)
        size = unknowns.shape[-2]
        batch = moment_length.shape[:-1]
        blocks = moment_length.new_zeros(*batch, size, size, moment_length.shape[-1])
        blocks[..., 0, 0, :], blocks[..., 0, -1, :] = by_length.sum(-2), -first.sum(-2)
        blocks[..., -1, 0, :], blocks[..., -1, -1, :] = moment_length, moment_curvature
        if shear_stiffness is not None and size == 3:
            blocks[..., 1, 1, :] = -shear_stiffness * arm.actuator_count
        wrench = _stacked(force.sum(-2), moment.sum(-2), unknowns, arm.actuator_count, shear_stiffness)
        if by_pressure is None:
            return ActuatorPart(wrench, blocks, wrench.new_empty(*wrench.shape, 0))
        moment_pressure = -radii * by_pressure
        if section.bending is not None:
            moment_pressure = moment_pressure + bent * section.curvature / section.reference
        rows = [by_pressure, moment_pressure]
        if size == 3:
            rows.insert(1, torch.zeros_like(by_pressure))
        return ActuatorPart(wrench, blocks, torch.stack(rows, -3).transpose(-1, -2))


class _Section(NamedTuple):
    """What the formulas of a cross-section need, each broadcasting to (..., M, N)."""

    radii: Tensor
    neutral: Tensor
    pressure: Tensor
    curvature: Tensor
    strain: Tensor
    bending: Tensor | None
    reference: Tensor
    share: Tensor
    per_length: Tensor
    live: Tensor

    @staticmethod
    def of(arm: ArmDesign, unknowns: Tensor, pressure: Tensor) -> "_Section":
        length, _, curvature = (None if row is None else row.unsqueeze(-2) for row in _rows(unknowns))
        assert length is not None
        assert curvature is not None
        radii, neutral, pressure = arm.radii.unsqueeze(-1), arm.length.unsqueeze(-1), pressure.unsqueeze(-1)
        own_length = rod.offset_length(length, curvature, radii)
        strain = rod.strain(own_length, neutral)
        bends = [model.bending_stiffness for model in arm.actuators]
        reference = along(reference_pressures(arm.actuators), strain, -2)
        if not any(bends):  # a term that is switched off costs nothing
            return _Section(radii, neutral, pressure, curvature, strain, None, reference, *(reference,) * 3)
        per_length = rod.material_curvature(torch.ones_like(own_length), own_length, neutral)
        live = (own_length.detach().abs() >= 1e-6 * neutral.detach()).to(strain.dtype)
        bending = along(bends, strain, -2)
        return _Section(
            radii, neutral, pressure, curvature, strain, bending, reference, pressure / reference, per_length, live
        )


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
    strain, pressure = torch.broadcast_tensors(strain, pressure)
    with torch.enable_grad():
        if not create_graph:
            strain, pressure = strain.detach(), pressure.detach()
        strain = strain.clone() if strain.requires_grad else strain.contiguous().requires_grad_()
        if pressure_slope:  # node by node: a view would gather it over the nodes
            pressure = pressure.clone() if pressure.requires_grad else pressure.clone().requires_grad_()
        force = actuator_force(arm.actuators, strain, pressure, -2)
        wanted = (strain, pressure) if pressure_slope else (strain,)
        if force.requires_grad:
            slopes = torch.autograd.grad(
                force.sum(), wanted, create_graph=create_graph, allow_unused=True, materialize_grads=True
            )
        else:  # a constant force
            slopes = tuple(torch.zeros_like(force) for _ in wanted)
    return (force if create_graph else force.detach()), slopes[0], slopes[1] if pressure_slope else None


# The balance


def balance_residual(
    arm: ArmDesign,
    unknowns: Float[Tensor, "*#batch C N"],
    pressure: Float[Tensor, "*#batch M"],
    tip_load: Float[Tensor, "*#batch 3"],
    base_pose: Float[Tensor, "*#batch 3"],
    shear_stiffness: float | None = None,
) -> Tensor:
    """R = a + q (..., C, N) [N, (N,) N·m], differentiable in everything."""
    motion = kinematics(unknowns, base_pose)
    reaction = actuator_wrench(arm, unknowns, pressure, shear_stiffness)
    return reaction + load_wrench(motion, tip_load, shear=shear_stiffness is not None)


def balance(
    arm: ArmDesign,
    unknowns: Float[Tensor, "*#batch C N"],
    pressure: Float[Tensor, "*#batch M"],
    tip_load: Float[Tensor, "*#batch 3"],
    base_pose: Float[Tensor, "*#batch 3"],
    shear_stiffness: float | None = None,
    *,
    pressure_slope: bool = True,
    create_graph: bool = False,
) -> Balance:
    """R with its derivatives by twists and pressure.

    Args:
        arm: designs (..., M).
        unknowns: z (..., C, N), C = 3 exactly if there is a shear stiffness.
        pressure: (..., M) [kPa].
        tip_load: (..., 3) in the world frame [N, N, N·m].
        base_pose: (..., 3).
        shear_stiffness: k [N/m] of each actuator; None is rigid.
        pressure_slope: whether ∂R/∂p is wanted; else it is of no actuators.
        create_graph: whether the results can be differentiated.
    """
    with torch.set_grad_enabled(create_graph):
        motion = kinematics(unknowns, base_pose)
        load = load_part(motion, tip_load, shear=shear_stiffness is not None)
        own = actuator_part(
            arm, unknowns, pressure, shear_stiffness, pressure_slope=pressure_slope, create_graph=create_graph
        )
        stiffness = load.stiffness
        if create_graph or stiffness.shape[:-4] != own.stiffness.shape[:-3]:
            stiffness = assemble(stiffness, own.stiffness)
        else:
            stiffness.diagonal(dim1=-3, dim2=-1).add_(own.stiffness)
        return Balance(load.wrench + own.wrench, stiffness, own.by_pressure, motion)


def assemble(
    load: Float[Tensor, "*#batch C N C N"], local: Float[Tensor, "*#batch C C N"]
) -> Float[Tensor, "... C N C N"]:
    """J: the load's stiffness with the sections' own on the diagonals of its blocks."""
    shape = torch.broadcast_shapes(load.shape[:-4], local.shape[:-3])
    total = load.expand(*shape, *load.shape[-4:]).clone()
    total.diagonal(dim1=-3, dim2=-1).add_(local)
    return total


def solve(
    stiffness: Float[Tensor, "*#batch C N C N"], right: Float[Tensor, "*#batch C N K"]
) -> Float[Tensor, "... C N K"]:
    """`J⁻¹ B`; what is singular comes out as NaN, and leaves the rest of the batch alone."""
    size, count = stiffness.shape[-4:-2]
    flat = stiffness.reshape(*stiffness.shape[:-4], size * count, size * count)
    answer, info = torch.linalg.solve_ex(flat, right.reshape(*right.shape[:-3], size * count, right.shape[-1]))
    answer = torch.where((info == 0)[..., None, None], answer, answer.new_tensor(float("nan")))
    return answer.unflatten(-2, (size, count))


def solve_signed(
    stiffness: Float[Tensor, "*batch C N C N"], right: Float[Tensor, "*batch C N K"]
) -> tuple[Float[Tensor, "*batch C N K"], Float[Tensor, "*batch"]]:
    """`J⁻¹ B` as by `solve`, and the sign of det J, by one factorisation."""
    size, count = stiffness.shape[-4:-2]
    flat = stiffness.reshape(*stiffness.shape[:-4], size * count, size * count)
    factors, pivots, info = torch.linalg.lu_factor_ex(flat)
    answer = torch.linalg.lu_solve(factors, pivots, right.reshape(*right.shape[:-3], size * count, right.shape[-1]))
    answer = torch.where((info == 0)[..., None, None], answer, answer.new_tensor(float("nan")))
    swaps = pivots != torch.arange(1, size * count + 1, dtype=pivots.dtype, device=pivots.device)
    negative = (factors.diagonal(dim1=-2, dim2=-1) < 0).logical_xor(swaps).sum(-1)
    return answer.unflatten(-2, (size, count)), 1.0 - 2.0 * (negative % 2).to(flat.dtype)
