"""What an arm does when it is let go at a shape: its balance made linear there, its poses not.

At unknowns z and pressures p the residual is `R(z, p)` and the stiffness `J(z, p) = ∂R/∂z`. To first order the arm
moves by `δz = -J⁻¹ R`. Differentiating `J δz = -R` by a pressure gives what a minimiser needs,

    dδz/dp = -J⁻¹ (∂R/∂p + ∂J/∂p δz),

with a ∂J/∂p that is local to the nodes. The poses are those of the shape `z + δz` itself, by exact kinematics. Where
-J is not positive definite the arm would leave for good: a small δz then means nothing, and is not believed.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from torcharm import mechanics, rod
from torcharm.arm import ArmDesign
from torcharm.wrenches import actuator_force, along, reference_pressures


@dataclass(frozen=True)
class Points:
    """B shapes at which balances are made linear, each with its design, load and target.

    Attributes:
        arm: B designs.
        unknowns: z (B, 2, N) [m, rad].
        target: (B, N+1, 3) poses wanted.
        base_pose: (3,).
        tip_load: (B, 3).
        load: q and ∂q/∂z at z.
        strain: (B, M, N).
        bend: (B, M, N) moment of a pressure, per curvature and kPa, `K / (p_ref l_α)`; None if no actuator bends.
        per_length: (B, M, N) `1/l_α` [1/m], 0 where it is held.
    """

    arm: ArmDesign
    unknowns: Tensor
    target: Tensor
    base_pose: Tensor
    tip_load: Tensor
    load: mechanics.LoadPart
    strain: Tensor
    bend: Tensor | None
    per_length: Tensor

    @staticmethod
    def of(arm: ArmDesign, unknowns: Tensor, target: Tensor, base_pose: Tensor, tip_load: Tensor) -> "Points":
        """Everything of the points that does not depend on pressure."""
        load = mechanics.load_part(mechanics.kinematics(unknowns, base_pose), tip_load)
        length, curvature = unknowns[:, 0].unsqueeze(-2), unknowns[:, 1].unsqueeze(-2)
        neutral = arm.length.unsqueeze(-1)
        own = rod.offset_length(length, curvature, arm.radii.unsqueeze(-1))
        inverse = rod.material_curvature(torch.ones_like(own), own, neutral)
        live = (own.abs() >= 1e-6 * neutral).to(own.dtype)
        stiffness = [model.bending_stiffness for model in arm.actuators]
        bend = None
        if any(stiffness):  # a term that is switched off costs nothing
            bend = along(stiffness, own, -2) / along(reference_pressures(arm.actuators), own, -2) * inverse
        strain = rod.strain(own, neutral)
        return Points(arm, unknowns, target, base_pose, tip_load, load, strain, bend, inverse * live)

    def __len__(self) -> int:
        return len(self.unknowns)

    def __getitem__(self, index: Tensor) -> "Points":
        return Points(
            self.arm[index],
            self.unknowns[index],
            self.target[index],
            self.base_pose,
            self.tip_load[index],
            mechanics.LoadPart(*(part[index] for part in self.load)),
            self.strain[index],
            None if self.bend is None else self.bend[index],
            self.per_length[index],
        )


class Response(NamedTuple):
    """Where arms go.

    Attributes:
        error: (B, N+1, 3) of the poses reached [m, m, rad]; NaN where J is singular.
        slope: (B, N+1, 3, M) its derivative by pressure [1/kPa].
        move: δz (B, 2, N).
        stable: (B,) whether the symmetric part of -J is positive definite.
    """

    error: Tensor
    slope: Tensor
    move: Tensor
    stable: Tensor


def respond(points: Points, pressure: Tensor) -> Response:
    """The response to pressures (B, M) [kPa], detached."""
    with torch.no_grad():
        force, by_strain, by_pressure, mixed = _forces(points, pressure.unsqueeze(-1))
        stiffness, residual = _stiffness(points, pressure, force, by_strain)
        factors, pivots, info = torch.linalg.lu_factor_ex(stiffness)
        move = -torch.linalg.lu_solve(factors, pivots, residual.flatten(1).unsqueeze(-1)).view_as(points.unknowns)
        move = torch.where((info == 0)[:, None, None], move, move.new_tensor(float("nan")))
        motion = mechanics.kinematics(points.unknowns + move, points.base_pose)
        error, by_pose = mechanics.pose_error(motion.pose, points.target)
        right = _pressure_slope(points, move, by_pressure, mixed)
        rate = -torch.linalg.lu_solve(factors, pivots, right).unflatten(1, points.unknowns.shape[1:])
        return Response(error, by_pose @ _carried(motion, rate), move, is_stable(stiffness))


def is_stable(stiffness: Tensor) -> Tensor:
    """(...) whether the symmetric part of -J (..., 2N, 2N) is positive definite.

    Then every motion against friction, `D ż = R` with D positive definite, comes back. (J itself is not quite
    symmetric: a balance at the start of each segment is not the derivative of an energy, nor is τ.)
    """
    _, info = torch.linalg.cholesky_ex(-0.5 * (stiffness + stiffness.mT))
    return info == 0


def size(move: Tensor, length: Tensor) -> Tensor:
    """(B,) the size of moves (B, 2, N): the largest heading [rad], or `STRETCH` times the largest stretch.

    Args:
        length: (B,) of the arms [m].
    """
    heading = (move[:, 1].cumsum(-1) / move.shape[-1]).abs().amax(-1)
    return torch.maximum(heading, STRETCH * move[:, 0].abs().amax(-1) / length)


STRETCH = 3.0
"""Radians that a stretch by the whole length counts as."""


def _forces(points: Points, pressure: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """f, ∂f/∂ε, ∂f/∂p and ∂²f/∂ε∂p: (B, M, N)."""
    strain = points.strain.detach().clone().requires_grad_()
    pressure = pressure.detach().expand_as(strain).clone().requires_grad_()
    with torch.enable_grad():
        force = actuator_force(points.arm.actuators, strain, pressure, -2)
        by_strain = _slope(force, strain, True)
        by_pressure = _slope(force, pressure, True)
        mixed = _slope(by_strain, pressure, False)
    return force.detach(), by_strain.detach(), by_pressure.detach(), mixed.detach()


def _slope(value: Tensor, by: Tensor, again: bool) -> Tensor:
    if not value.requires_grad:
        return torch.zeros_like(by)
    (slope,) = torch.autograd.grad(
        value.sum(), by, create_graph=again, retain_graph=True, allow_unused=True, materialize_grads=True
    )
    return slope


def _stiffness(points: Points, pressure: Tensor, force: Tensor, by_strain: Tensor) -> tuple[Tensor, Tensor]:
    """J (B, 2N, 2N) and R (B, 2, N)."""
    radii = points.arm.radii.unsqueeze(-1)
    by_length = by_strain / points.arm.length.unsqueeze(-1)
    first = radii * by_length
    second = radii * first
    moment = radii * force
    axial_length, axial_curvature = by_length.sum(1), -first.sum(1)
    moment_length, moment_curvature, moment = axial_curvature, second.sum(1), -moment.sum(1)
    if points.bend is not None:
        bent = points.bend * pressure.unsqueeze(-1)
        curvature = points.unknowns[:, 1:]
        squeeze = bent * curvature * points.per_length
        moment = moment + (bent * curvature).sum(1)
        moment_length = moment_length - squeeze.sum(1)
        moment_curvature = moment_curvature + (bent + radii * squeeze).sum(1)
    residual = torch.stack((force.sum(1), moment), 1) + points.load.wrench
    stiffness = points.load.stiffness.clone()
    for row, column, block in (
        (0, 0, axial_length),
        (0, 1, axial_curvature),
        (1, 0, moment_length),
        (1, 1, moment_curvature),
    ):
        stiffness[:, row, :, column].diagonal(dim1=-2, dim2=-1).add_(block)
    return stiffness.flatten(3).flatten(1, 2), residual


def _pressure_slope(points: Points, move: Tensor, by_pressure: Tensor, mixed: Tensor) -> Tensor:
    """`∂R/∂p + ∂J/∂p δz`, (B, 2N, M): the slope of the linear balance after the move."""
    radii = points.arm.radii.unsqueeze(-1)
    stretch = move[:, :1] - radii * move[:, 1:]  # δl_α
    axial = by_pressure + mixed * stretch / points.arm.length.unsqueeze(-1)
    moment = -radii * axial
    if points.bend is not None:
        curvature = points.unknowns[:, 1:]
        moment = moment + points.bend * (curvature + move[:, 1:] - curvature * points.per_length * stretch)
    return torch.cat((axial, moment), -1).transpose(1, 2)


def _carried(motion: mechanics.Kinematics, rate: Tensor) -> Tensor:
    """Rates of the poses (B, N+1, 3, M) when the unknowns change at rates (B, 2, N, M): E times those."""
    count = rate.shape[2]
    turn = rate[:, 1].cumsum(1) / count  # of the end of each segment
    start = torch.nn.functional.pad(turn[:, :-1], (0, 0, 1, 0))
    step = motion.pose[:, 1:, :2] - motion.pose[:, :-1, :2]
    across = torch.stack((-step[..., 1], step[..., 0]), -1)
    ends = (
        motion.by_length.unsqueeze(-1) * rate[:, 0].unsqueeze(-2)
        + motion.by_curvature.unsqueeze(-1) * rate[:, 1].unsqueeze(-2)
        + across.unsqueeze(-1) * start.unsqueeze(-2)
    ).cumsum(1)
    return torch.nn.functional.pad(torch.cat((ends, turn.unsqueeze(-2)), -2), (0, 0, 0, 0, 1, 0))
