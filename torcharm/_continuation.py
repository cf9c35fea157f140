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
LEAST_SHARE = 1e-5
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
STEPS = 400
"""Steps along a path, and of settling."""


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
        return mechanics.balance(
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
        arrived: (B,) whether at the full load.
        sign: (B,) of the stiffness' determinant along the path.
    """

    unknowns: Tensor
    arrived: Tensor
    sign: Tensor


def unloaded(problem: Problem) -> Traced:
    """The arm without load, one segment for all, continued from zero pressure; there, settled from straight."""
    idle = replace(problem, pressure=torch.zeros_like(problem.pressure), tip_load=torch.zeros_like(problem.tip_load))
    rest = settle(idle, problem.straight())
    path = trace(replace(idle, pressure=problem.pressure), rest.unknowns, by="pressure")
    left = ~(path.arrived & rest.arrived)
    if bool(left.any()):  # where a force model jumps, say
        still = settle(replace(idle, pressure=problem.pressure)[left], path.unknowns[left])
        path.unknowns[left], path.arrived[left] = still
    return path


def trace(problem: Problem, start: Tensor, *, by: str) -> Traced:
    """Follow the equilibrium from none to all of the load, or of the pressure.

    Args:
        problem: with the full load and pressure.
        start: (B, C, N), the equilibrium without.
        by: "load" or "pressure", which rises.
    """
    here = start.clone()
    count = len(here)
    share = here.new_zeros(count)
    step = here.new_full((count,), FIRST_SHARE)
    look = _look(problem, here, share, by)
    tangent, sign = look.tangent, look.sign
    active = torch.arange(count, device=here.device)
    for _ in range(STEPS):
        if not len(active):
            break
        part, along = problem[active], tangent[active]
        longest = LARGEST_MOVE / _move(part, along).clamp(min=1e-12)
        tried = torch.minimum(torch.minimum(step[active], longest), 1 - share[active])
        reached = share[active] + tried
        reached = torch.where(reached > 1 - 1e-9, torch.ones_like(reached), reached)
        end = _correct(part, here[active] + tried[:, None, None] * along, reached, by, sign[active])
        good = end.good
        moved = active[good]
        here[moved], tangent[moved], share[moved] = end.unknowns[good], end.tangent[good], reached[good]
        step[active] = tried * torch.where(good, end.stretch, 0.25)
        active = active[(share[active] < 1) & (step[active] >= LEAST_SHARE)]
    return Traced(here, share >= 1, sign)


class _Look(NamedTuple):
    """The balance as Newton's method sees it: (B,), and (B, C, N) steps."""

    imbalance: Tensor
    newton: Tensor
    tangent: Tensor
    sign: Tensor


def _look(problem: Problem, unknowns: Tensor, share: Tensor, by: str) -> _Look:
    """Newton's step `-J⁻¹R`, the path's tangent `-J⁻¹ ∂R/∂s`, and the sign of det J, at a share s."""
    part = share.unsqueeze(-1)
    if by == "pressure":
        here = replace(problem, pressure=part * problem.pressure)
        found = here.balance(unknowns)
        rate = (found.by_pressure * problem.pressure[:, None, None, :]).sum(-1)
    else:
        here = replace(problem, tip_load=part * problem.tip_load)
        found = here.balance(unknowns)
        rate = mechanics.load_wrench(found.kinematics, problem.tip_load, shear=problem.components == 3)
    steps, sign = mechanics.solve_signed(found.stiffness, -torch.stack((found.residual, rate), -1))
    return _Look(problem.imbalance(found.residual), steps[..., 0], steps[..., 1], sign)


class _Corrected(NamedTuple):
    """Where Newton's method ended, whether it may be trusted, and how much longer the next step may be."""

    unknowns: Tensor
    tangent: Tensor
    good: Tensor
    stretch: Tensor


def _correct(problem: Problem, guess: Tensor, share: Tensor, by: str, sign: Tensor) -> _Corrected:
    """Newton's method from a guess near the path, at each element's share of the load."""
    count = len(guess)
    end, tangent = guess.clone(), torch.zeros_like(guess)
    good = torch.zeros(count, dtype=torch.bool, device=guess.device)
    first, ratio, moved = (guess.new_zeros(count) for _ in range(3))
    goal = torch.where(share >= 1, problem.tolerance, PATH_TOLERANCE)
    goal = torch.where(share >= 1, goal, goal.clamp(min=problem.tolerance))
    active, here = torch.arange(count, device=guess.device), guess
    for turn in range(CORRECTIONS):
        look = _look(problem[active], here, share[active], by)
        length = _move(problem[active], look.newton)
        if turn == 0:
            first[active] = length
        elif turn == 1:
            ratio[active] = length / first[active].clamp(min=1e-300)
        done = look.imbalance <= goal[active]
        ended = active[done]
        end[ended], tangent[ended] = here[done], look.tangent[done]
        good[ended] = (look.sign[done] == sign[ended]) & look.tangent[done].isfinite().flatten(1).all(-1)
        moved[active] += torch.where(done, torch.zeros_like(length), length)
        near = (ratio[active] < CONTRACTION) | (moved[active] < SMALL_MOVE)
        keep = ~done & near & (moved[active] < LARGEST_MOVE)  # a NaN is left behind
        active, here = active[keep], (here + look.newton)[keep]
        if not len(active):
            break
    good &= (ratio < CONTRACTION) | (moved < SMALL_MOVE)
    stretch = (0.5 * CONTRACTION / ratio.clamp(min=1e-6)).sqrt().clamp(0.5, 4.0)
    stretch = torch.where(moved < SMALL_MOVE / 4, stretch.clamp(min=2.0), stretch)
    return _Corrected(end, tangent, good, stretch)


def _move(problem: Problem, step: Tensor) -> Tensor:
    """(B,) the size of a change of z: headings along the arm [rad], and three times the strains."""
    heading = step[:, -1].cumsum(-1).abs().amax(-1) / step.shape[-1]
    stretch = step[:, :-1].abs().flatten(1).amax(-1) + problem.reach * step[:, -1].abs().amax(-1)
    return torch.maximum(heading, 3 * stretch / problem.length)


class Settled(NamedTuple):
    """Where the arms came to rest: (B, C, N), and whether they did (B,)."""

    unknowns: Tensor
    arrived: Tensor


def settle(problem: Problem, start: Tensor) -> Settled:
    """Let the arms go, and follow them to rest: what follows where a branch ends is a snap.

    Overdamped motion `D ż = R` by implicit Euler steps `(J - D/h) δ = -R` that grow as the motion slows down
    (pseudo-transient continuation; Kelley and Keyes 1998) and become Newton's.
    """
    here, arrived = start.clone(), torch.zeros(len(start), dtype=torch.bool, device=start.device)
    active = torch.arange(len(start), device=start.device)
    damping: Tensor | None = None
    last: Tensor | None = None
    for _ in range(STEPS):
        part, z = problem[active], here[active]
        found = part.balance(z)
        miss = part.imbalance(found.residual)
        done = miss <= problem.tolerance
        arrived[active[done]] = True
        keep = ~done & miss.isfinite()
        if not bool(keep.any()):
            break
        unit = _mobility(part, found)
        if damping is None or last is None:
            damping, last = torch.ones_like(miss), miss
        # A step that led uphill was too long; one that did not gain little by little becomes Newton's
        damping = torch.where(miss > 1.5 * last, damping * 4, damping * 0.4).clamp(1e-12, 1e6)
        matrix = found.stiffness.clone()
        matrix.diagonal(dim1=-3, dim2=-1).diagonal(dim1=-3, dim2=-2).sub_((damping[:, None] * unit)[:, None, :])
        step = -mechanics.solve(matrix, found.residual.unsqueeze(-1)).squeeze(-1)
        size = _move(part, step)
        short = (0.5 / size.clamp(min=1e-12)).clamp(max=1.0)
        damping = torch.where(size > 0.5, damping * 2, damping)
        z = z + short[:, None, None] * step
        keep &= size.isfinite()
        here[active[keep]] = z[keep]
        active, damping, last = active[keep], damping[keep], miss[keep]
    return Settled(here, arrived)


def _mobility(problem: Problem, found: mechanics.Balance) -> Tensor:
    """(B, C): a stiffness to measure damping by, the largest of the sections' own in each component."""
    own = found.stiffness.diagonal(dim1=-3, dim2=-1).diagonal(dim1=-3, dim2=-2)  # (B, N, C)
    return own.abs().amax(-2).clamp(min=1e-9)
