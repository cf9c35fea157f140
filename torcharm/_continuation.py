"""Following an equilibrium as the load, or the pressure, rises from nothing.

A predictor-corrector method, the whole batch at once and each element at its own pace: a step along the
tangent, then Newton's method, accepted only where Newton contracts at once (Deuflhard, *Newton Methods for
Nonlinear Problems*, 2004, ch. 5) and the determinant of the stiffness keeps its sign. Both guard against
landing on another branch: under compression an arm has several equilibria.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from torcharm import mechanics
from torcharm.arm import ArmDesign

FIRST_SHARE = 0.25
"""Of the load, taken by the first step."""
LEAST_SHARE = 1e-4
"""Of the load; where no shorter step succeeds, the branch has ended."""
LARGEST_MOVE = 1.0
"""Longest step along the tangent, as `_move` measures: about a radian, or a third of the length."""
SMALL_MOVE = 0.02
"""A correction so short needs no contraction: at a kink of a force model Newton has none, however short."""
CONTRACTION = 0.5
"""Largest ratio of the second Newton step to the first."""
PATH_TOLERANCE = 1e-4
"""Of the load scale, on the way to the full load."""
CORRECTIONS = 8
"""Newton steps in a step along the path."""
LOOKS = 600
"""Evaluations of the balance along a path, at most."""
SETTLING_STEPS = 150


@dataclass(frozen=True)
class Problem:
    """B problems of equilibrium, flattened.

    Attributes:
        arm: B designs.
        pressure: (B, M) [kPa].
        tip_load: (B, 3).
        base_pose: (B, 3).
        shear_stiffness: k [N/m] of each actuator, or None.
        length: (B,) the designs' mean neutral length [m].
        reach: (B,) their largest offset [m].
        tolerance: of the load scale.
    """

    arm: ArmDesign
    pressure: Tensor
    tip_load: Tensor
    base_pose: Tensor
    shear_stiffness: float | None
    length: Tensor
    reach: Tensor
    tolerance: float

    @staticmethod
    def of(
        arm: ArmDesign,
        pressure: Tensor,
        tip_load: Tensor,
        base_pose: Tensor,
        shear_stiffness: float | None,
        tolerance: float,
    ) -> "Problem":
        """The problem of flattened tensors."""
        length, reach = arm.length.detach().mean(-1), arm.radii.detach().abs().amax(-1)
        return Problem(arm, pressure, tip_load, base_pose, shear_stiffness, length, reach, tolerance)

    @property
    def components(self) -> int:
        """C, unknowns a segment."""
        return 2 if self.shear_stiffness is None else 3

    @property
    def load_scale(self) -> Tensor:
        """(B,) [N]: the larger of the force and the moment over the arm's length, and 1 N at least."""
        force, moment = self.tip_load[:, :2].norm(dim=-1), self.tip_load[:, 2].abs() / self.length
        return torch.maximum(force, moment).clamp(min=1.0)

    def __getitem__(self, index: Tensor | slice) -> "Problem":
        return replace(
            self,
            arm=self.arm[index],
            pressure=self.pressure[index],
            tip_load=self.tip_load[index],
            base_pose=self.base_pose[index],
            length=self.length[index],
            reach=self.reach[index],
        )

    def balance(self, unknowns: Tensor) -> mechanics.Balance:
        """R and its derivatives, detached."""
        return mechanics.balance(self.arm, unknowns, self.pressure, self.tip_load, self.base_pose, self.shear_stiffness)

    def residual(self, unknowns: Tensor) -> Tensor:
        """R (B, C, N), with its graph."""
        return mechanics.balance_residual(
            self.arm, unknowns, self.pressure, self.tip_load, self.base_pose, self.shear_stiffness
        )

    def imbalance(self, residual: Tensor) -> Tensor:
        """(B,) the largest entry of R, forces over the load scale and moments over that times the length."""
        force, moment = residual[:, :-1].abs().flatten(1).amax(-1), residual[:, -1].abs().amax(-1)
        return torch.maximum(force, moment / self.length) / self.load_scale

    def straight(self) -> Tensor:
        """One segment (B, C, 1) of the mean neutral length, straight."""
        start = self.pressure.new_zeros(len(self.pressure), self.components, 1)
        start[:, 0, 0] = self.length
        return start


class Traced(NamedTuple):
    """Where the paths ended.

    Attributes:
        unknowns: (B, C, N).
        tangent: (B, C, N), by the share of the path.
        arrived: (B,) whether at the end of the path.
    """

    unknowns: Tensor
    tangent: Tensor
    arrived: Tensor


def unloaded(problem: Problem, looks: int = LOOKS) -> Traced:
    """The arm without load, one segment for all, continued from zero pressure; there, settled from straight."""
    idle = replace(problem, pressure=torch.zeros_like(problem.pressure), tip_load=torch.zeros_like(problem.tip_load))
    rest = settle(idle, problem.straight())
    filled = replace(idle, pressure=problem.pressure)
    path = trace(Path(filled, pressure=idle.pressure), rest.unknowns, first_step=1.0, looks=looks)
    left = ~(path.arrived & rest.arrived)
    if bool(left.any()):  # where a force model jumps, say
        still = settle(filled[left], path.unknowns[left])
        path.unknowns[left], path.arrived[left] = still
    return path


def loaded(problem: Problem, start: Tensor, looks: int = LOOKS) -> Traced:
    """The equilibrium of `start` (B, C, N), which bears no load, continued to the full load."""
    return trace(Path(problem, tip_load=torch.zeros_like(problem.tip_load)), start, looks=looks)


@dataclass(frozen=True)
class Path:
    """Problems that change in proportion to a share s from 0 to 1.

    Attributes:
        end: the problems at s = 1.
        pressure: (B, M) at s = 0 [kPa]; None where it does not change.
        tip_load: (B, 3) at s = 0; None where it does not change.
    """

    end: Problem
    pressure: Tensor | None = None
    tip_load: Tensor | None = None

    def __getitem__(self, index: Tensor) -> "Path":
        pressure, load = (None if x is None else x[index] for x in (self.pressure, self.tip_load))
        return Path(self.end[index], pressure, load)

    def look(self, unknowns: Tensor, share: Tensor) -> "Look":
        """Newton's step `-J⁻¹R`, the path's tangent `-J⁻¹ ∂R/∂s`, and the sign of det J, at z and s."""
        end, part = self.end, share.unsqueeze(-1)
        pressure, load = end.pressure, end.tip_load
        if self.pressure is not None:
            pressure = self.pressure.lerp(pressure, part)
        if self.tip_load is not None:
            load = self.tip_load.lerp(load, part)
        found = mechanics.balance(
            end.arm,
            unknowns,
            pressure,
            load,
            end.base_pose,
            end.shear_stiffness,
            pressure_slope=self.pressure is not None,
        )
        rate = torch.zeros_like(unknowns)
        if self.pressure is not None:
            rate = rate + (found.by_pressure * (end.pressure - self.pressure)[:, None, None, :]).sum(-1)
        if self.tip_load is not None:
            rise = end.tip_load - self.tip_load
            rate = rate + mechanics.load_wrench(found.kinematics, rise, shear=end.components == 3)
        steps, sign = mechanics.solve_signed(found.stiffness, -torch.stack((found.residual, rate), -1))
        return Look(end.imbalance(found.residual), steps[..., 0], steps[..., 1], sign)


class Look(NamedTuple):
    """The balance as Newton's method sees it: numbers (B,), steps (B, C, N)."""

    imbalance: Tensor
    newton: Tensor
    tangent: Tensor
    sign: Tensor


class _Walk(NamedTuple):
    """The state of elements under way: the last equilibrium found, and an attempt at the next.

    Attributes:
        element: (A,) place in the batch.
        share, step: (A,) of the path: gone so far, and to be tried.
        base, tangent: (A, C, N) the last equilibrium, and dz/ds there.
        sign: (A,) of det J along the path; 0 before it is known.
        aim, trial: (A,) share and (A, C, N) unknowns of the attempt.
        turn: (A,) Newton steps made.
        first, ratio, moved: (A,) size of the first step, of the second over the first, and of all together.
    """

    element: Tensor
    share: Tensor
    step: Tensor
    base: Tensor
    tangent: Tensor
    sign: Tensor
    aim: Tensor
    trial: Tensor
    turn: Tensor
    first: Tensor
    ratio: Tensor
    moved: Tensor

    def at(self, index: Tensor) -> "_Walk":
        """These elements."""
        return _Walk(*(value[index] for value in self))


def trace(path: Path, start: Tensor, first_step: float = FIRST_SHARE, looks: int = LOOKS) -> Traced:
    """Follow the equilibria of s = 0 to s = 1, as far as they go.

    Args:
        path: B of them.
        start: (B, C, N), near enough to the equilibrium at s = 0 for Newton's method.
        first_step: share that the first step tries.
        looks: evaluations of the balance, at most.
    """
    count = len(start)
    none = start.new_zeros(count)
    element = torch.arange(count, device=start.device)
    walk = _Walk(
        element, none, none + first_step, start, torch.zeros_like(start), none, none, start, none, none, none, none
    )
    out = Traced(start.clone(), torch.zeros_like(start), torch.zeros(count, dtype=torch.bool, device=start.device))
    own = path
    for _ in range(looks):
        walk, under_way = _advance(own, walk)
        if bool(under_way.all()):
            continue
        left = ~under_way
        # Whoever is through is dropped at once only if worth the copying; meanwhile it stays where it is.
        ended = walk.element[left]
        out.unknowns[ended], out.tangent[ended] = walk.base[left], walk.tangent[left]
        out.arrived[ended] = walk.share[left] >= 1
        if not bool(under_way.any()):
            return out
        walk, own = walk.at(under_way), own[under_way]
    out.unknowns[walk.element] = walk.base
    return out


def _advance(path: Path, walk: _Walk) -> tuple[_Walk, Tensor]:
    """One evaluation of the balance for each, and what follows from it; whether any is to follow."""
    look = path.look(walk.trial, walk.aim)
    size = _move(path.end, look.newton)
    first = torch.where(walk.turn == 0, size, walk.first)
    ratio = torch.where(walk.turn == 1, size / first.clamp(min=1e-300), walk.ratio)
    goal = torch.where(walk.aim >= 1, path.end.tolerance, max(PATH_TOLERANCE, path.end.tolerance))
    there = look.imbalance <= goal
    moved = torch.where(there, walk.moved, walk.moved + size)
    trusted = (ratio < CONTRACTION) | (moved < SMALL_MOVE)
    same = (look.sign == walk.sign) | (walk.sign == 0)
    good = there & trusted & same & look.tangent.isfinite().flatten(1).all(-1)
    on = ~there & trusted & (moved < LARGEST_MOVE) & (walk.turn < CORRECTIONS)  # a NaN is not on

    # Ahead from a new equilibrium, or once more from the last with a shorter step
    stretch = (0.5 * CONTRACTION / ratio.clamp(min=1e-6)).sqrt().clamp(0.5, 4.0)
    stretch = torch.where(moved < SMALL_MOVE / 4, stretch.clamp(min=2.0), stretch)
    started = walk.sign != 0
    taken = torch.where(started, walk.aim - walk.share, walk.step)
    step = torch.where(on, walk.step, taken * torch.where(good, torch.where(started, stretch, 1.0), 0.25))
    share = torch.where(good, walk.aim, walk.share)
    base = torch.where(good[:, None, None], walk.trial, walk.base)
    tangent = torch.where(good[:, None, None], look.tangent, walk.tangent)
    sign = torch.where(good, look.sign, walk.sign)
    longest = LARGEST_MOVE / _move(path.end, tangent).clamp(min=1e-12)
    ahead = torch.minimum(torch.minimum(step, longest), 1 - share)
    aim = share + ahead
    aim = torch.where(aim > 1 - 1e-9, torch.ones_like(aim), aim)
    nothing = torch.zeros_like(size)
    after = _Walk(
        walk.element,
        share,
        step,
        base,
        tangent,
        sign,
        torch.where(on, walk.aim, aim),
        torch.where(on[:, None, None], walk.trial + look.newton, base + ahead[:, None, None] * tangent),
        torch.where(on, walk.turn + 1, nothing),
        torch.where(on, first, nothing),
        torch.where(on, ratio, nothing),
        torch.where(on, moved, nothing),
    )
    return after, on | ((sign != 0) & (share < 1) & (step >= LEAST_SHARE))


def _move(problem: Problem, step: Tensor) -> Tensor:
    """(B,) the size of a change of z: headings along the arm [rad], and three times the strains."""
    heading = step[:, -1].cumsum(-1).abs().amax(-1) / step.shape[-1]
    stretch = step[:, :-1].abs().flatten(1).amax(-1) + problem.reach * step[:, -1].abs().amax(-1)
    return torch.maximum(heading, 3 * stretch / problem.length)


class Settled(NamedTuple):
    """Where the arms came to rest: (B, C, N), and whether they did (B,)."""

    unknowns: Tensor
    arrived: Tensor


def settle(problem: Problem, start: Tensor, damping: float = 0.4) -> Settled:
    """Let the arms go, and follow them to rest: what follows where a branch ends is a snap.

    Overdamped motion `D ż = R` by implicit Euler steps `(J - D/h) δ = -R` that grow as the motion slows down
    (pseudo-transient continuation; Kelley and Keyes 1998) and become Newton's.

    Args:
        problem, start: (B, C, N) where they are let go.
        damping: of the first step, D/h over the sections' own stiffness; little of it makes Newton steps at once.
    """
    here, arrived = start.clone(), torch.zeros(len(start), dtype=torch.bool, device=start.device)
    active = torch.arange(len(start), device=start.device)
    amount = start.new_full((len(start),), 2.5 * damping)
    last = start.new_full((len(start),), float("inf"))
    for _ in range(SETTLING_STEPS):
        part, z = problem[active], here[active]
        found = part.balance(z)
        miss = part.imbalance(found.residual)
        done = miss <= problem.tolerance
        arrived[active[done]] = True
        keep = ~done & miss.isfinite()
        if not bool(keep.any()):
            break
        unit = _mobility(part, found)
        # A step that led uphill was too long; those that lead down become Newton's
        amount = torch.where(miss > 1.5 * last, amount * 4, amount * 0.4).clamp(1e-12, 1e6)
        matrix = found.stiffness
        matrix.diagonal(dim1=-3, dim2=-1).diagonal(dim1=-3, dim2=-2).sub_((amount[:, None] * unit)[:, None, :])
        step = -mechanics.solve(matrix, found.residual.unsqueeze(-1)).squeeze(-1)
        size = _move(part, step)
        short = (0.5 / size.clamp(min=1e-12)).clamp(max=1.0)
        amount = torch.where(size > 0.5, amount * 2, amount)
        z = z + short[:, None, None] * step
        keep &= size.isfinite()
        here[active[keep]] = z[keep]
        active, amount, last = active[keep], amount[keep], miss[keep]
    return Settled(here, arrived)


def _mobility(problem: Problem, found: mechanics.Balance) -> Tensor:
    """(B, C): a stiffness to measure damping by, the largest of the sections' own in each component."""
    own = found.stiffness.diagonal(dim1=-3, dim2=-1).diagonal(dim1=-3, dim2=-2)  # (B, N, C)
    return own.abs().amax(-2).clamp(min=1e-9)
