"""Where an arm comes to rest when it is let go at a shape.

At unknowns z and pressures p the balance is

    R(z, p) = a(z, p) + q(z) = 0,

with the actuators' reaction a and the load q, exact or to first order from a shape z°, `q(z°) + Q (z - z°)`. Newton's
method solves it. By the pressures the shape then changes at the rates `-J⁻¹ ∂a/∂p`, with `J = ∂R/∂z`. The poses are
those of the shape by exact kinematics. Where -J is not positive definite the arm would leave for good: such a balance
is not believed.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from torcharm import mechanics
from torcharm.arm import ArmDesign
from torcharm.geometry import rod

LARGE_MOVE = 1.0
"""Longest Newton step, as of `size`, and the longest move through which a load is carried to first order."""
SUFFICIENT = 1e-4
"""Share of the decrease of the imbalance that a step promises."""
DEFINITE = 64
"""Least eigenvalue of a stiffness that counts as positive definite, over the rounding of its entries: those on the
diagonal are scaled to 1."""
STRETCH = 3.0
"""Radians that a stretch by the whole length counts as."""


@dataclass(frozen=True)
class Points:
    """B shapes at which loads are made linear, each with its design, load and target.

    Attributes:
        arm: B designs.
        unknowns: z° (B, 2, N) [m, rad].
        target: (B, N+1, 3) poses wanted.
        base_pose: (3,).
        tip_load: (B, 3).
        load: q and Q at z°.
        exact: whether loads are carried by exact kinematics instead, to wherever the arm goes.
    """

    arm: ArmDesign
    unknowns: Tensor
    target: Tensor
    base_pose: Tensor
    tip_load: Tensor
    load: mechanics.LoadPart
    exact: bool

    @staticmethod
    def of(
        arm: ArmDesign, unknowns: Tensor, target: Tensor, base_pose: Tensor, tip_load: Tensor, exact: bool
    ) -> "Points":
        """With the load at the shapes."""
        load = mechanics.load_part(mechanics.kinematics(unknowns, base_pose), tip_load)
        return Points(arm, unknowns, target, base_pose, tip_load, load, exact)

    def load_at(self, unknowns: Tensor) -> mechanics.LoadPart:
        """The load at other shapes (B, 2, N)."""
        if self.exact:
            return mechanics.load_part(mechanics.kinematics(unknowns, self.base_pose), self.tip_load)
        moved = (unknowns - self.unknowns).flatten(1).unsqueeze(-1)
        carried = self.load.stiffness.flatten(3).flatten(1, 2) @ moved
        return mechanics.LoadPart(self.load.wrench + carried.view_as(unknowns), self.load.stiffness)

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
            self.exact,
        )

    @property
    def length(self) -> Tensor:
        """(B,) of the arms [m]."""
        return self.arm.length.mean(-1)


class Look(NamedTuple):
    """The balance as Newton's method sees it.

    Attributes:
        imbalance: (B,) norm of the residual, moments over the largest offset [N].
        step: (B, 2, N) Newton's.
        rate: (B, 2, N, M) of the shape by the pressures [1/kPa].
        stiffness: J (B, 2N, 2N).
    """

    imbalance: Tensor
    step: Tensor
    rate: Tensor
    stiffness: Tensor


def look(points: Points, unknowns: Tensor, pressure: Tensor, rates: bool = True) -> Look:
    """The balance at shapes (B, 2, N) and pressures (B, M) [kPa], detached; without rates those of no pressures."""
    own = mechanics.actuator_part(points.arm, unknowns, pressure, pressure_slope=rates)
    load = points.load_at(unknowns)
    stiffness = load.stiffness.clone()
    stiffness.diagonal(dim1=-3, dim2=-1).add_(own.stiffness)
    stiffness = stiffness.flatten(3).flatten(1, 2)
    residual = own.wrench + load.wrench
    right = torch.cat((residual.flatten(1).unsqueeze(-1), own.by_pressure.flatten(1, 2)), -1)
    answer, info = torch.linalg.solve_ex(stiffness, right)
    answer = torch.where((info == 0)[:, None, None], -answer, answer.new_tensor(float("nan")))
    answer = answer.unflatten(1, unknowns.shape[1:])
    reach = points.arm.radii.abs().amax(-1) + 1e-3 * points.length
    imbalance = (residual[:, 0].square() + (residual[:, 1] / reach.unsqueeze(-1)).square()).sum(-1).sqrt()
    return Look(imbalance, answer[..., 0], answer[..., 1:], stiffness)


class Rest(NamedTuple):
    """Where arms come to rest.

    Attributes:
        unknowns: (B, 2, N).
        rate: (B, 2, N, M) by the pressures [1/kPa].
        stable: (B,) whether the arms stay there, with all lengths above 0.
        settled: (B,) whether the balance was found.
    """

    unknowns: Tensor
    rate: Tensor
    stable: Tensor
    settled: Tensor


def settle(points: Points, pressure: Tensor, guess: Tensor, looks: int, close: Tensor) -> Rest:
    """Solve the balance at pressures (B, M) by Newton's method from guesses (B, 2, N).

    A step no larger than `close` (B,) is the last: it leaves an error of about its square. Steps are at most
    `LARGE_MOVE` long, and halved where the imbalance does not fall.
    """
    element, own = torch.arange(len(guess), device=guess.device), points
    base, trial, step = guess, guess, torch.zeros_like(guess)
    last, factor = guess.new_full((len(guess),), float("inf")), torch.ones_like(points.length)
    end = Rest(
        guess.clone(),
        guess.new_zeros(*guess.shape, pressure.shape[-1]),
        torch.zeros(len(guess), dtype=torch.bool, device=guess.device),
        torch.zeros(len(guess), dtype=torch.bool, device=guess.device),
    )
    for _ in range(looks):
        seen = look(own, trial, pressure)
        moved = size(seen.step, own.length)
        fell = (seen.imbalance <= (1 - SUFFICIENT * factor) * last) | ((moved <= close) & (factor == 1))
        fell &= moved.isfinite()
        there = fell & (moved <= close)
        if bool(there.any()):
            left = element[there]
            end.unknowns[left] = (trial + seen.step)[there]
            end.rate[left], end.settled[left] = seen.rate[there], True
            end.stable[left] = is_stable(seen.stiffness[there]) & has_lengths(own.arm[there], end.unknowns[left])
            if bool(there.all()):
                return end
        short = (LARGE_MOVE / moved.clamp(min=1e-30)).clamp(max=1.0)
        taken = fell[:, None, None]
        base = torch.where(taken, trial, base)
        step = torch.where(taken, short[:, None, None] * seen.step, step)
        last = torch.where(fell, seen.imbalance, last)
        factor = torch.where(fell, torch.ones_like(factor), 0.5 * factor)
        trial = base + factor[:, None, None] * step
        on = ~there & (fell | last.isfinite())  # a first look that is no number leads nowhere
        if bool(on.all()):
            continue
        element, own, pressure, close = element[on], own[on], pressure[on], close[on]
        base, trial, step, last, factor = base[on], trial[on], step[on], last[on], factor[on]
        if not len(element):
            break
    end.unknowns[element] = base
    return end


class Poses(NamedTuple):
    """Pose errors of shapes.

    Attributes:
        error: (B, N+1, 3), the target seen from the pose [m, m, rad].
        slope: (B, N+1, 3, M) its derivative by pressure [1/kPa].
    """

    error: Tensor
    slope: Tensor


def pose_errors(points: Points, unknowns: Tensor, rate: Tensor) -> Poses:
    """Of shapes (B, 2, N) that change at rates (B, 2, N, M)."""
    motion = mechanics.kinematics(unknowns, points.base_pose)
    error, by_pose = mechanics.pose_error(motion.pose, points.target)
    return Poses(error, by_pose @ _carried(motion, rate))


def is_stable(stiffness: Tensor) -> Tensor:
    """(...) whether the symmetric part of -J (..., 2N, 2N) is positive definite.

    Then every motion against friction, `D ż = R` with D positive definite, comes back. (J itself is not quite
    symmetric: a balance at the start of each segment is not the derivative of an energy, nor is τ.) It is definite by
    more than rounding: an arm that resists nothing, in one direction or in all, stays nowhere.
    """
    matrix = -0.5 * (stiffness + stiffness.mT)
    scale = matrix.diagonal(dim1=-2, dim2=-1).clamp(min=torch.finfo(matrix.dtype).tiny).rsqrt()
    matrix = matrix * scale.unsqueeze(-1) * scale.unsqueeze(-2)
    matrix.diagonal(dim1=-2, dim2=-1).sub_(DEFINITE * torch.finfo(matrix.dtype).eps)
    _, info = torch.linalg.cholesky_ex(matrix)
    return info == 0


def has_lengths(arm: ArmDesign, unknowns: Tensor) -> Tensor:
    """(B,) whether all lengths at shapes (B, 2, N) of B designs are above 0, the centreline's and the actuators'."""
    length, curvature = unknowns[:, 0], unknowns[:, -1]
    own = rod.offset_length(length.unsqueeze(-2), curvature.unsqueeze(-2), arm.radii.unsqueeze(-1))
    return (length > 0).all(-1) & (own > 0).flatten(1).all(-1)


def size(move: Tensor, length: Tensor) -> Tensor:
    """(B,) the size of moves (B, 2, N): the largest heading [rad], or `STRETCH` times the largest stretch.

    Args:
        length: (B,) of the arms [m].
    """
    heading = (move[:, 1].cumsum(-1) / move.shape[-1]).abs().amax(-1)
    return torch.maximum(heading, STRETCH * move[:, 0].abs().amax(-1) / length)


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
