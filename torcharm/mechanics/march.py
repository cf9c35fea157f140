"""The balance solved along the arm: Newton's step and other solutions with the stiffness, without its matrix.

A change δz of the twists acts on node i through two numbers, the heading δθ_i and δw_i = δ(p_i × F), and through
δu = δ(p_tip × F), one number for all nodes. So with the sections' own stiffness A_i (C × C)

    A_i δz_i = -r_i - (q_y, -q_x, 0)_i δθ_i - (0, 0, 1) (δu - δw_i)        (without shear, no second row)

and a march from the base, where δθ = δw = 0, solves the linear balance for every right side r; at the tip δw = δu
closes it. The work grows with N, where a factorisation's grows with its cube. By the same elimination
`det J = Π det A_i · (1 - ∂w_tip/∂u)`.

**Here the batch comes last**, so that an operation runs over whole rows of arms: z (C, N, B), pressures (M, B).
"""

from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torcharm.actuators import Actuator, force_slopes
from torcharm.actuators.bending import bending_model
from torcharm.arm import ArmDesign
from torcharm.mechanics.sections import any_bending, bending_moments
from torcharm.wrenches import group_alike, reference_pressures


@dataclass(frozen=True)
class Arms:
    """B arms in a row, each with its tip load.

    Attributes:
        models: M actuators.
        radii, length: (M, 1, B) [m].
        tip_load, base_pose: (3, B).
        shear_stiffness: k [N/m] of each actuator, or None.
    """

    models: tuple[Actuator, ...]
    radii: Tensor
    length: Tensor
    tip_load: Tensor
    base_pose: Tensor
    shear_stiffness: float | None

    @staticmethod
    def of(arm: ArmDesign, tip_load: Tensor, base_pose: Tensor, shear_stiffness: float | None) -> "Arms":
        """From B designs, loads (B, 3) and base poses (B, 3)."""
        rows = (arm.radii.mT.unsqueeze(1), arm.length.mT.unsqueeze(1), tip_load.mT, base_pose.mT)
        return Arms(arm.actuators, *(row.contiguous() for row in rows), shear_stiffness)

    def __getitem__(self, index: Tensor) -> "Arms":
        return Arms(*(pick(getattr(self, field.name), index) for field in fields(self)))


def pick(value: Any, index: Tensor) -> Any:
    """Some of the batch of a tensor; anything else as it is."""
    return value.index_select(-1, index) if isinstance(value, Tensor) else value


class _Rod(NamedTuple):
    """Kinematics in the world frame, each (N, B) or (2, N, B).

    Attributes:
        heading, position: after the segments.
        cos, sin: of the nodes' headings.
        stride: of the segments.
        by_length, by_curvature: derivative of a segment's stride; that by shear is by_length turned left.
    """

    heading: Tensor
    position: Tensor
    cos: Tensor
    sin: Tensor
    stride: Tensor
    by_length: Tensor
    by_curvature: Tensor


def _rod(unknowns: Tensor, base_pose: Tensor, sums: Tensor) -> _Rod:
    """A whole segment is a straight step half-way turned: see `kinematics`."""
    count, batch = unknowns.shape[-2:]
    length, curvature, step = unknowns[0], unknowns[-1], 1.0 / count
    heading = torch.addmm(base_pose[2:].expand(count, batch), sums, curvature, alpha=step)
    half = curvature * (step / 2)
    middle = heading - half
    cos, sin = middle.cos(), middle.sin()
    least = torch.finfo(half.dtype).eps ** 0.375  # nearer to zero the quotients are as at zero
    held = torch.where(half.abs() < least, half.new_tensor(least), half)
    cos_half, sin_half = held.cos(), held.sin()
    ratio = sin_half / held
    slope = (cos_half - ratio).div_(held).mul_(step**2 / 2)
    scale = ratio.mul_(step)
    by_length = torch.stack((cos * scale, sin * scale))
    a, b = by_length
    bend = torch.stack((cos, sin)).mul_(slope)
    bend[0].sub_(b, alpha=step / 2)
    bend[1].add_(a, alpha=step / 2)
    stride, by_curvature = by_length * length, bend * length
    if len(unknowns) == 3:
        stride[0].addcmul_(b, unknowns[1], value=-1)
        stride[1].addcmul_(a, unknowns[1])
        by_curvature[0].addcmul_(bend[1], unknowns[1], value=-1)
        by_curvature[1].addcmul_(bend[0], unknowns[1])
    position = (sums @ stride).add_(base_pose[:2].unsqueeze(1))
    node = (cos * cos_half).addcmul_(sin, sin_half), (sin * cos_half).addcmul_(cos, sin_half, value=-1)
    return _Rod(heading, position, *node, stride, by_length, by_curvature)


class Marched(NamedTuple):
    """The balance at z, and solutions with its stiffness.

    Attributes:
        force, moment: (B,) the largest imbalance of a node [N], [N·m].
        change: (C, N, K, B) `-J⁻¹ r` for K right sides: R itself, then the others.
        turned: (N, K, B) the change of the headings after the segments.
        slid: (2, N, K, B) that of the positions; empty if not wanted.
        heading, position: (N, B) and (2, N, B) after the segments [rad, m].
        sign: (B,) of det J.
    """

    force: Tensor
    moment: Tensor
    change: Tensor
    turned: Tensor
    slid: Tensor
    heading: Tensor
    position: Tensor
    sign: Tensor


def march(
    arms: Arms,
    unknowns: Tensor,
    pressure: Tensor,
    share: Tensor | None = None,
    *,
    each_pressure: Tensor | None = None,
    pressures: Tensor | None = None,
    load: Tensor | None = None,
    poses: bool = True,
) -> Marched:
    """The balance at z (C, N, B), and what follows to first order.

    Args:
        arms: B of them.
        unknowns: z.
        pressure: (M, B) [kPa].
        share: (B,) of the tip load that acts; None is all.
        each_pressure: (M, B) changes of pressure: adds M right sides, one for each.
        pressures: (M, B) changes of pressure, all at once: adds one right side.
        load: (3, B) a change of the load: adds one right side; or to that of `pressures`.
        poses: whether the changes of positions are wanted.
    """
    components, count, batch = unknowns.shape
    step, shear = 1.0 / count, arms.shear_stiffness
    sums = unknowns.new_ones(count, count).tril()
    acting = arms.tip_load if share is None else arms.tip_load * share
    force_x, force_y, tip_moment = acting
    rod = _rod(unknowns, arms.base_pose, sums)
    carried = rod.position[0] * force_y - rod.position[1] * force_x  # p × F after the segments
    lifted = rod.stride[0] * force_y - rod.stride[1] * force_x
    axial = rod.cos * force_x + rod.sin * force_y
    across = rod.cos * force_y - rod.sin * force_x
    own = _sections(arms, unknowns[0], unknowns[-1], pressure, each_pressure is not None or pressures is not None)

    # Right sides: that of u, R, and the others
    single = pressures is not None or load is not None
    total = 2 + (0 if each_pressure is None else len(each_pressure)) + single
    right = unknowns.new_empty(components, count, total, batch)
    right[:, :, 0] = 0
    right[-1, :, 0] = 1
    right[0, :, 1] = own.axial + axial
    right[-1, :, 1] = own.moment + (carried[-1] + tip_moment) - carried + lifted
    sideways = acting.new_zeros(())
    if shear is not None:
        sideways = across / (shear * len(arms.models))  # γ where the arm is at rest
        right[1, :, 1] = across - (shear * len(arms.models)) * unknowns[1]
    missing = right[:, :, 1].abs().amax(1)
    if own.axial_rate is not None and own.moment_rate is not None:
        if each_pressure is not None:
            torch.mul(own.axial_rate, each_pressure, out=right[0, :, 2:total - single])
            torch.mul(own.moment_rate, each_pressure, out=right[-1, :, 2:total - single])
            if shear is not None:
                right[1, :, 2:total - single] = 0
        if single:
            right[:, :, -1] = 0
        if pressures is not None:
            right[0, :, -1] = (own.axial_rate * pressures).sum(1)
            right[-1, :, -1] = (own.moment_rate * pressures).sum(1)
    elif single:
        right[:, :, -1] = 0
    if load is not None:
        right[0, :, -1] += rod.cos * load[0] + rod.sin * load[1]
        lever = rod.position[:, -1:] - rod.position + rod.stride
        right[-1, :, -1] += load[2] + lever[0] * load[1] - lever[1] * load[0]
        if shear is not None:
            right[1, :, -1] += rod.cos * load[1] - rod.sin * load[0]

    # Each section by itself
    a11, a12, a21, a22 = own.stiffness
    determinant = torch.addcmul(a11 * a22, a12, a21, value=-1)
    inverse = torch.stack((a22, -a12, -a21, a11)).div_(determinant)
    i11, i12, i21, i22 = inverse.unsqueeze(2)
    free = torch.empty_like(right)
    torch.mul(i11, right[0], out=free[0]).addcmul_(i12, right[-1]).neg_()
    torch.mul(i21, right[0], out=free[-1]).addcmul_(i22, right[-1]).neg_()
    bowed = inverse[::2] * across  # -δz by δθ
    lift_length = rod.by_length[0] * force_y - rod.by_length[1] * force_x  # δw by δz
    lift_curvature = rod.by_curvature[0] * force_y - rod.by_curvature[1] * force_x

    # The march
    transfer = unknowns.new_empty(count, 2, 2, batch)  # by column, row
    torch.mul(bowed[1], -step, out=transfer[:, 0, 0]).add_(1)
    torch.mul(inverse[3], step, out=transfer[:, 1, 0])
    falling = -(rod.stride[0] * force_x + rod.stride[1] * force_y)
    falling.addcmul_(lift_length, bowed[0], value=-1).addcmul_(lift_curvature, bowed[1], value=-1)
    transfer[:, 0, 1] = falling
    transfer[:, 1, 1] = (lift_length * inverse[1]).addcmul_(lift_curvature, inverse[3]).add_(1)
    forced = unknowns.new_empty(count, 2, total, batch)
    torch.mul(free[-1], step, out=forced[:, 0])
    torch.mul(free[0], lift_length.unsqueeze(1), out=forced[:, 1]).addcmul_(free[-1], lift_curvature.unsqueeze(1))
    if shear is not None:
        each = 1.0 / (shear * len(arms.models))
        torch.mul(right[1], each, out=free[1])
        yielding = axial * each  # -δγ by δθ
        lift_shear = -(rod.by_length[1] * force_y + rod.by_length[0] * force_x)
        transfer[:, 0, 1].addcmul_(lift_shear, yielding, value=-1)
        forced[:, 1].addcmul_(free[1], lift_shear.unsqueeze(1))
    state = unknowns.new_empty(count + 1, 2, total, batch)
    state[0] = 0
    state[1] = forced[0]
    rows = state.unbind(0)[1:]
    for before, after, push, part in zip(
        rows[:-1], rows[1:], forced.unbind(0)[1:], transfer.unsqueeze(3).unbind(0)[1:], strict=True
    ):
        torch.addcmul(push, part[0], before[0], out=after).addcmul_(part[1], before[1])

    # The tip closes it: δw is δu
    closing = 1 - state[-1, 1, 0]
    tip = state[-1, 1, 1:] / closing
    state = torch.addcmul(state[:, :, 1:], state[:, :, :1], tip)
    turned, raised = state[:-1].unbind(1)
    change = torch.addcmul(free[:, :, 1:], free[:, :, :1], tip)
    change[0].addcmul_(bowed[0].unsqueeze(1), turned, value=-1).addcmul_(i12, raised)
    change[-1].addcmul_(bowed[1].unsqueeze(1), turned, value=-1).addcmul_(i22, raised)
    if shear is not None:
        change[1].addcmul_(yielding.unsqueeze(1), turned, value=-1)
    sign = closing.sign() * (1 - 2 * ((determinant < 0).sum(0) % 2)).to(closing.dtype)
    if shear is not None and count % 2:
        sign = -sign
    slid = state[:0]
    if poses:
        slid = unknowns.new_empty(2, *turned.shape)
        torch.mul(turned, -rod.stride[1].unsqueeze(1), out=slid[0])
        torch.mul(turned, rod.stride[0].unsqueeze(1), out=slid[1])
        slid.addcmul_(change[0], rod.by_length.unsqueeze(2)).addcmul_(change[-1], rod.by_curvature.unsqueeze(2))
        if shear is not None:
            slid[0].addcmul_(change[1], rod.by_length[1].unsqueeze(1), value=-1)
            slid[1].addcmul_(change[1], rod.by_length[0].unsqueeze(1))
        slid = (sums @ slid.flatten(2)).view_as(slid)
    return Marched(missing[:-1].amax(0), missing[-1], change, state[1:, 0], slid, rod.heading, rod.position, sign)


def relax(arms: Arms, unknowns: Tensor, pressure: Tensor, pressures: Tensor) -> Marched:
    """As `march` for arms that bear no load, whose sections do not know of each other; without shear and positions."""
    own = _sections(arms, unknowns[0], unknowns[-1], pressure, True)
    assert own.axial_rate is not None
    assert own.moment_rate is not None
    right = torch.stack((own.axial, (own.axial_rate * pressures).sum(1)), 1)
    moment = torch.stack((own.moment, (own.moment_rate * pressures).sum(1)), 1)
    missing = own.axial.abs().amax(0), own.moment.abs().amax(0)
    a11, a12, a21, a22 = (entry.unsqueeze(1) for entry in own.stiffness)
    determinant = torch.addcmul(a11 * a22, a12, a21, value=-1)
    change = unknowns.new_zeros(len(unknowns), *right.shape)
    torch.div(torch.addcmul(a12 * moment, a22, right, value=-1), determinant, out=change[0])
    torch.div(torch.addcmul(a21 * right, a11, moment, value=-1), determinant, out=change[-1])
    turned = change[-1].cumsum(0) / unknowns.shape[1]
    sign = 1.0 - 2.0 * ((determinant < 0).sum((0, 1)) % 2).to(unknowns.dtype)
    none = unknowns[:0]
    return Marched(*missing, change, turned, none, none, none, sign)


class _Sections(NamedTuple):
    """The reaction of the cross-sections, and its derivatives.

    Attributes:
        axial, moment: (N, B).
        stiffness: a11, a12, a21, a22 (N, B), of (axial, moment) by (l, κ).
        axial_rate, moment_rate: (N, M, B) by pressure; None if not wanted.
    """

    axial: Tensor
    moment: Tensor
    stiffness: tuple[Tensor, Tensor, Tensor, Tensor]
    axial_rate: Tensor | None
    moment_rate: Tensor | None


def _sections(arms: Arms, length: Tensor, curvature: Tensor, pressure: Tensor, rates: bool) -> _Sections:
    """The sections' reaction at l and κ (N, B) and pressures (M, B)."""
    radii, neutral, pressure = arms.radii, arms.length, pressure.unsqueeze(1)
    own = torch.addcmul(length, radii, curvature, value=-1)  # (M, N, B)
    strain = own.div(neutral).sub_(1)
    force, by_strain, by_pressure = _forces(arms.models, strain, pressure, rates)
    stiff = by_strain.div_(neutral)
    leaning = stiff * radii
    axial, moment = force.sum(0), (force * radii).sum(0).neg_()
    a11, a12 = stiff.sum(0), leaning.sum(0).neg_()
    a21, a22 = a12, leaning.mul_(radii).sum(0)
    moment_rate = None if by_pressure is None else by_pressure * -radii
    if any_bending(arms.models):  # a term that is switched off costs nothing
        reference = own.new_tensor(reference_pressures(arms.models)).view(-1, 1, 1)
        if all(bending_model(model.bending_stiffness) is None for model in arms.models):
            # as `bending_moments`, for moments linear in curvature
            floor = 1e-6 * neutral
            per_length = torch.where(own.abs() < floor, floor.copysign(own), own).reciprocal_()
            factors = [float(model.bending_stiffness) for model in arms.models]  # type: ignore[arg-type]
            slope = own.new_tensor(factors).view(-1, 1, 1) / reference
            if moment_rate is not None:
                moment_rate.addcmul_(slope * curvature, per_length)
            bent = per_length * (slope * pressure)
            total = bent.sum(0)
            squeezed = per_length.mul_(bent)
            moment.addcmul_(curvature, total)
            a21 = torch.addcmul(a21, curvature, squeezed.sum(0), value=-1)
            a22.add_(total).addcmul_(curvature, squeezed.mul_(radii).sum(0))
        else:
            given = (curvature.unsqueeze(0), own, neutral, pressure / reference)
            bend = bending_moments(arms.models, *(value.movedim(-1, 0) for value in given), create_graph=False)
            tau, active, slope, per_length, squeezed = (value.movedim(0, -1) for value in bend)
            squeezed = slope * squeezed
            moment = moment + tau.sum(0)
            a21 = a21 - squeezed.sum(0)
            a22 = a22 + (slope * per_length + radii * squeezed).sum(0)
            if moment_rate is not None:
                moment_rate = moment_rate + active / reference
    if by_pressure is None or moment_rate is None:
        return _Sections(axial, moment, (a11, a12, a21, a22), None, None)
    return _Sections(axial, moment, (a11, a12, a21, a22), by_pressure.transpose(0, 1), moment_rate.transpose(0, 1))


def _forces(
    models: tuple[Actuator, ...], strain: Tensor, pressure: Tensor, rates: bool
) -> tuple[Tensor, Tensor, Tensor | None]:
    """f, ∂f/∂ε and, if wanted, ∂f/∂p (M, N, B)."""
    groups = group_alike(models)
    if len(groups) == 1:
        return force_slopes(models[0], strain, pressure, rates)
    out = [torch.empty_like(strain) for _ in range(3 if rates else 2)]
    for model, members in groups:
        for whole, part in zip(out, force_slopes(model, strain[members], pressure[members], rates), strict=False):
            if part is not None:
                whole[members] = part
    return out[0], out[1], out[2] if rates else None
