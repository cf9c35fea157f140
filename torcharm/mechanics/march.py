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
from typing import NamedTuple, TypeVar, cast

import torch
from torch import Tensor

from torcharm.actuators import Actuator
from torcharm.actuators.bending import bending_model
from torcharm.arm import ArmDesign
from torcharm.mechanics.sections import any_bending, bending_moments
from torcharm.wrenches import actuator_slopes, along, reference_pressures

T = TypeVar("T")


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
        radii, length = (row.mT.unsqueeze(1).contiguous() for row in (arm.radii, arm.length))
        return Arms(arm.actuators, radii, length, tip_load.mT.contiguous(), base_pose.mT.contiguous(), shear_stiffness)

    def __getitem__(self, index: Tensor) -> "Arms":
        return Arms(*(pick(getattr(self, field.name), index) for field in fields(self)))


def pick(value: T, index: Tensor) -> T:
    """Some of the batch of a tensor, or of those in a named tuple; anything else as it is."""
    if isinstance(value, Tensor):
        return cast(T, value.index_select(-1, index))
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return cast(T, type(value)(*(pick(part, index) for part in value)))
    return value


def put(whole: tuple[Tensor, ...], index: Tensor, part: tuple[Tensor, ...]) -> None:
    """Set some of the batch of the tensors in a named tuple."""
    for old, new in zip(whole, part, strict=True):
        old[..., index] = new


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
    cos_half, sin_half = half.cos(), half.sin()
    ratio = torch.where(half == 0, 1.0, sin_half / half)
    least = torch.finfo(half.dtype).eps ** 0.375  # nearer to zero the difference is of rounding, and a series exact
    slope = torch.where(half.abs() < least, half / -3, (cos_half - ratio) / half).mul_(step**2 / 2)
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
        load: (3, B) a change of the load: adds one right side.
        poses: whether the changes of positions are wanted.
    """
    count, batch = unknowns.shape[-2:]
    step, shear = 1.0 / count, arms.shear_stiffness
    sums = unknowns.new_ones(count, count).tril()
    force_x, force_y, tip_moment = (arms.tip_load if share is None else arms.tip_load * share).unbind(0)
    rod = _rod(unknowns, arms.base_pose, sums)
    x, y = rod.position.unbind(0)
    stride_x, stride_y = rod.stride.unbind(0)
    length_x, length_y = rod.by_length.unbind(0)
    curve_x, curve_y = rod.by_curvature.unbind(0)
    axial = (rod.cos * force_x).addcmul_(rod.sin, force_y)
    across = (rod.cos * force_y).addcmul_(rod.sin, force_x, value=-1)
    behind_x, behind_y = x - stride_x, y - stride_y
    lever_x, lever_y = x[-1] - behind_x, y[-1] - behind_y
    carried = torch.addcmul(tip_moment, lever_x, force_y).addcmul_(lever_y, force_x, value=-1)
    own = _sections(arms, unknowns[0], unknowns[-1], pressure, each_pressure is not None)

    # Right sides (N, K, B): that of u, R, and the others
    axial_miss, moment_miss = own.axial + axial, own.moment + carried
    none = torch.zeros_like(axial_miss)
    axials, moments = [none, axial_miss], [none + 1, moment_miss]
    sideways = [none, across - (shear * len(arms.models)) * unknowns[1]] if shear is not None else []
    if load is not None:
        load_x, load_y, load_moment = load.unbind(0)
        axials.append((rod.cos * load_x).addcmul_(rod.sin, load_y))
        moments.append(torch.addcmul(load_moment, lever_x, load_y).addcmul_(lever_y, load_x, value=-1))
        sideways += [rod.cos * load_y - rod.sin * load_x] if sideways else []
    right, right_moment = torch.stack(axials, 1), torch.stack(moments, 1)
    if each_pressure is not None and own.axial_rate is not None and own.moment_rate is not None:
        right = torch.cat((right, own.axial_rate * each_pressure), 1)
        right_moment = torch.cat((right_moment, own.moment_rate * each_pressure), 1)
        sideways += [none] * len(each_pressure) if sideways else []

    # Each section by itself
    a11, a12, a21, a22 = own.stiffness
    determinant = torch.addcmul(a11 * a22, a12, a21, value=-1)
    i11, i12, i21, i22 = torch.stack((a22, a12.neg(), a21.neg(), a11)).div_(determinant).unbind(0)
    first, second = i12.unsqueeze(1), i22.unsqueeze(1)
    free_length = torch.mul(i11.unsqueeze(1), right).addcmul_(first, right_moment).neg_()
    free_curvature = torch.mul(i21.unsqueeze(1), right).addcmul_(second, right_moment).neg_()
    bow_length, bow_curvature = i11 * across, i21 * across  # -δz by δθ
    lift_length = (length_x * force_y).addcmul_(length_y, force_x, value=-1)  # δw by δz
    lift_curvature = (curve_x * force_y).addcmul_(curve_y, force_x, value=-1)

    # The march
    falling = (stride_x * force_x).addcmul_(stride_y, force_y)
    falling.addcmul_(lift_length, bow_length).addcmul_(lift_curvature, bow_curvature).neg_()
    forced = (free_length * lift_length.unsqueeze(1)).addcmul_(free_curvature, lift_curvature.unsqueeze(1))
    if shear is not None:
        each = 1.0 / (shear * len(arms.models))
        free_shear, yielding = torch.stack(sideways, 1) * each, axial * each  # and -δγ by δθ
        lift_shear = -(length_y * force_y + length_x * force_x)
        falling.addcmul_(lift_shear, yielding, value=-1)
        forced.addcmul_(free_shear, lift_shear.unsqueeze(1))
    stay = torch.mul(bow_curvature, -step).add_(1)
    rise = torch.addcmul(lift_length * i12, lift_curvature, i22).add_(1)
    # rows (1 - h·, ·) act on δθ, rows (h·, 1 + ·) on δw
    transfer = torch.stack((stay, falling, i22 * step, rise), 1).view(2 * count, 2, 1, batch).unbind(0)
    pushes = torch.stack((free_curvature * step, forced), 1)
    rows = [torch.zeros_like(pushes[0]), pushes[0]]
    for node in range(1, count):
        turn, raised = rows[-1].unbind(0)
        row = torch.addcmul(pushes[node], transfer[2 * node], turn)
        rows.append(row.addcmul_(transfer[2 * node + 1], raised))
    state = torch.stack(rows)

    # The tip closes it: δw is δu
    last = rows[-1][1]
    closing = 1 - last[0]
    tip = last[1:] / closing
    state = torch.addcmul(state[:, :, 1:], state[:, :, :1], tip)
    turned, raised = state[:-1].unbind(1)
    d_length = torch.addcmul(free_length[:, 1:], free_length[:, :1], tip)
    d_length.addcmul_(bow_length.unsqueeze(1), turned, value=-1).addcmul_(first, raised)
    d_curvature = torch.addcmul(free_curvature[:, 1:], free_curvature[:, :1], tip)
    d_curvature.addcmul_(bow_curvature.unsqueeze(1), turned, value=-1).addcmul_(second, raised)
    sign = closing.sign() * (1 - 2 * ((determinant < 0).sum(0) % 2)).to(closing.dtype)
    parts, force_missing = [d_length, d_curvature], axial_miss.abs().amax(0)
    if shear is not None:
        d_shear = torch.addcmul(free_shear[:, 1:], yielding.unsqueeze(1), turned, value=-1)
        parts.insert(1, d_shear)
        force_missing = torch.maximum(force_missing, sideways[1].abs().amax(0))
        sign = -sign if count % 2 else sign
    slid = state[:0]
    if poses:
        slid = torch.stack((turned * -stride_y.unsqueeze(1), turned * stride_x.unsqueeze(1)))
        slid.addcmul_(d_length, rod.by_length.unsqueeze(2)).addcmul_(d_curvature, rod.by_curvature.unsqueeze(2))
        if shear is not None:
            slid[0].addcmul_(d_shear, length_y.unsqueeze(1), value=-1)
            slid[1].addcmul_(d_shear, length_x.unsqueeze(1))
        slid = (sums @ slid.flatten(2)).view_as(slid)
    return Marched(
        force_missing,
        moment_miss.abs().amax(0),
        torch.stack(parts),
        state[1:, 0],
        slid,
        rod.heading,
        rod.position,
        sign,
    )


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
    by_length = torch.addcmul(a12 * moment, a22, right, value=-1) / determinant
    by_curvature = torch.addcmul(a21 * right, a11, moment, value=-1) / determinant
    none = [torch.zeros_like(by_length)] * (len(unknowns) - 2)
    change = torch.stack((by_length, *none, by_curvature))
    turned = change[-1].cumsum(0) / unknowns.shape[1]
    sign = 1.0 - 2.0 * ((determinant < 0).sum((0, 1)) % 2).to(unknowns.dtype)
    empty = unknowns[:0]
    return Marched(*missing, change, turned, empty, empty, empty, sign)


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
    force, by_strain, by_pressure = actuator_slopes(arms.models, strain, pressure, rates, -3)
    stiff = by_strain.div_(neutral)
    leaning = stiff * radii
    axial, moment = force.sum(0), (force * radii).sum(0).neg_()
    a11, a12 = stiff.sum(0), leaning.sum(0).neg_()
    a21, a22 = a12, leaning.mul_(radii).sum(0)
    moment_rate = None if by_pressure is None else by_pressure * -radii
    if any_bending(arms.models):  # a term that is switched off costs nothing
        reference = along(reference_pressures(arms.models), own, -3)
        if all(bending_model(model.bending_stiffness) is None for model in arms.models):
            # as `bending_moments`, for moments linear in curvature
            floor = 1e-6 * neutral
            per_length = torch.where(own.abs() < floor, floor.copysign(own), own).reciprocal_()
            slope = along([model.bending_stiffness for model in arms.models], own, -3) / reference  # type: ignore[misc]
            if moment_rate is not None:
                moment_rate.addcmul_(slope * curvature, per_length)
            bent = per_length * (slope * pressure)
            total = bent.sum(0)
            squeezed = per_length.mul_(bent)
            moment.addcmul_(curvature, total)
            a21 = torch.addcmul(a21, curvature, squeezed.sum(0), value=-1)
            a22.add_(total).addcmul_(curvature, squeezed.mul_(radii).sum(0))
        else:
            kappa, own_length, start, share = (
                value.movedim(-1, 0) for value in (curvature.unsqueeze(0), own, neutral, pressure / reference)
            )
            bend = bending_moments(arms.models, kappa, own_length, start, share, create_graph=False)
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
