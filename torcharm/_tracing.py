"""Paths of equilibria as load or pressure grows, followed for many arms at once, each at its own pace.

A step along the tangent, then Newton's method, accepted only where Newton contracts at once (Deuflhard, *Newton Methods
for Nonlinear Problems*, 2004, ch. 5) and the determinant of the stiffness keeps its sign. Both guard against landing
on another branch: under compression an arm has several equilibria. The batch comes last, as in `mechanics.march`.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor

from torcharm import mechanics
from torcharm._underway import run
from torcharm.mechanics import Arms, Marched, pick

if TYPE_CHECKING:
    from torcharm.kernels.fleet import Fleet

FIRST_SHARE = 0.25
"""Of the load, taken by the first step."""
LEAST_SHARE = 1e-4
"""Of the load; where no shorter step succeeds, the branch has ended."""
LARGEST_MOVE = 1.0
"""Longest step along the tangent, as `moves` measures: about a radian, or a third of the length."""
SMALL_MOVE = 0.06
"""A correction so short needs no contraction: at a kink of a force model Newton has none, however short.
On the way, a Newton step so short is taken, and the path goes on from there."""
AIMED_MOVE = 0.03
"""Newton step for which the steps along the path are made."""
UNLOADED = 4.0
"""Times as much of both, without load: sections do not know of each other, and there are no branches to miss."""
CONTRACTION = 0.5
"""Largest ratio of the second Newton step to the first."""
CORRECTIONS = 8
"""Newton steps in a step along the path."""


class Scale(NamedTuple):
    """What imbalances and moves are measured by, (B,): the load scale [N], the arms' length and largest offset [m]."""

    load: Tensor
    length: Tensor
    reach: Tensor

    def imbalance(self, found: Marched) -> Tensor:
        """(B,) the largest imbalance of a node, as of `Equilibrium`."""
        return torch.maximum(found.force, found.moment / self.length) / self.load

    def moves(self, change: Tensor, turned: Tensor) -> Tensor:
        """(K, B) the sizes of K changes of z: headings along the arm [rad], and three times the strains."""
        size = change.abs()
        stretch = torch.addcmul(size[:-1].amax((0, 1)), self.reach, size[-1].amax(0))
        return torch.maximum(turned.abs().amax(0), stretch * (3 / self.length))


@dataclass(frozen=True)
class Course:
    """B paths, on which pressure or load grows from nothing with a share s from 0 to 1.

    Attributes:
        arms: with the load at s = 1.
        pressure: (M, B) at s = 1 [kPa].
        loading: whether the load grows, at full pressure; else the pressure, without load.
        scale: of these.
        tolerance: of the load scale, at s = 1.
        fleet: the same for compiled steps, with the pressures as limits, if they are to run compiled.
    """

    arms: Arms
    pressure: Tensor
    loading: bool
    scale: Scale
    tolerance: float
    fleet: "Fleet | None" = None

    def __getitem__(self, index: Tensor) -> "Course":
        scale = pick(self.scale, index)
        return replace(self, arms=self.arms[index], pressure=pick(self.pressure, index), scale=scale, fleet=None)

    def look(self, unknowns: Tensor, share: Tensor) -> Marched:
        """The balance at z and s, with Newton's step and the tangent dz/ds as its two changes."""
        if self.loading:
            return mechanics.march(self.arms, unknowns, self.pressure, share, load=self.arms.tip_load, poses=False)
        return mechanics.relax(self.arms, unknowns, self.pressure * share, self.pressure)


class Traced(NamedTuple):
    """Where the paths ended: (C, N, B), and whether at their end (B,); and their quickest points, which are next to a
    bifurcation if there is any: z and dz/ds (C, N, B), and s (B,)."""

    unknowns: Tensor
    arrived: Tensor
    quick: Tensor
    rush: Tensor
    share: Tensor


class _Walk(NamedTuple):
    """The state of elements under way: the last equilibrium found, and an attempt at the next.

    Attributes:
        element: (A,) place in the batch.
        share, step: (A,) of the path: gone so far, and to be tried.
        base, tangent, bend: (C, N, A) the last equilibrium, dz/ds there, and half of d²z/ds², by the last two tangents.
        speed: (A,) the tangent's size.
        sign: (A,) of det J along the path; 0 before it is known.
        aim, trial: (A,) share and (C, N, A) unknowns of the attempt.
        turn: (A,) Newton steps made.
        first, ratio, moved: (A,) size of the first step, of the second over the first, and of all together.
        quick, rush, haste, when: the quickest equilibrium so far, its tangent and speed, and the share.
        over: (A,) whether the path is at its end, or can be followed no further.
    """

    element: Tensor
    share: Tensor
    step: Tensor
    base: Tensor
    tangent: Tensor
    bend: Tensor
    speed: Tensor
    sign: Tensor
    aim: Tensor
    trial: Tensor
    turn: Tensor
    first: Tensor
    ratio: Tensor
    moved: Tensor
    over: Tensor
    quick: Tensor
    rush: Tensor
    haste: Tensor
    when: Tensor


def trace(course: Course, start: Tensor, first_step: float, looks: int, least_share: float = LEAST_SHARE) -> Traced:
    """Follow the equilibria of s = 0 to s = 1, as far as they go.

    Args:
        course: B of them.
        start: (C, N, B), near enough to the equilibrium at s = 0 for Newton's method.
        first_step: share that the first step tries.
        looks: evaluations of the balance, at most.
        least_share: where no longer step succeeds, the path has ended.
    """
    if course.fleet is not None:
        whole = torch.ones_like(course.pressure)
        return Traced(*course.fleet.trace(whole, course.loading, start, first_step, looks, least_share))
    count = start.shape[-1]
    none = start.new_zeros(count)

    def store(walk: _Walk) -> None:
        out.unknowns[:, :, walk.element] = walk.base
        out.arrived[walk.element] = walk.share >= 1
        out.quick[:, :, walk.element], out.rush[:, :, walk.element] = walk.quick, walk.rush
        out.share[walk.element] = walk.when

    walk = _Walk(
        torch.arange(count, device=start.device),
        none,
        none + first_step,
        start,
        torch.zeros_like(start),
        torch.zeros_like(start),
        none,
        none,
        none,
        start,
        none,
        none,
        none,
        none,
        none.bool(),
        start,
        torch.zeros_like(start),
        none,
        none,
    )
    out = Traced(start.clone(), none.bool(), start.clone(), torch.zeros_like(start), none.clone())
    run(_advance, course, walk, looks, store, (least_share,))
    return out


def _advance(course: Course, walk: _Walk, least_share: float) -> _Walk:
    """One evaluation of the balance for each, and what follows from it. What is over stays as it is."""
    look = course.look(walk.trial, walk.aim)
    newton, new_tangent = look.change.unbind(2)
    size, new_speed = course.scale.moves(look.change, look.turned)
    first = torch.where(walk.turn == 0, size, walk.first)
    ratio = torch.where(walk.turn == 1, size / first.clamp(min=1e-300), walk.ratio)
    ease = 1.0 if course.loading else UNLOADED
    last = walk.aim >= 1
    there = torch.where(last, course.scale.imbalance(look) <= course.tolerance, size <= ease * SMALL_MOVE)
    moved = torch.where(there, walk.moved, walk.moved + size)
    trusted = (ratio < CONTRACTION) | (moved < ease * SMALL_MOVE)
    same = (look.sign == walk.sign) | (walk.sign == 0)
    good = there & trusted & same & new_speed.isfinite() & ~walk.over
    on = ~there & trusted & (moved < LARGEST_MOVE) & (walk.turn < CORRECTIONS) & ~walk.over  # a NaN is not on

    # Ahead from a new equilibrium, or once more from the last with a shorter step
    started = walk.sign != 0
    taken = torch.where(started, walk.aim - walk.share, walk.step)
    stretch = (ease * AIMED_MOVE / first.clamp(min=1e-12)).pow(1 / 3).clamp(0.3, 4.0)
    step = torch.where(on, walk.step, taken * torch.where(good, torch.where(started, stretch, 1.0), 0.25))
    share = torch.where(good, walk.aim, walk.share)
    base = torch.where(good, walk.trial + newton, walk.base)  # the step is there, and the next ones build on it
    bend = (new_tangent - walk.tangent) * (0.5 / taken.clamp(min=1e-12))
    bend = torch.where(good, torch.where(started & (share < 1), bend, 0.0), walk.bend)
    tangent = torch.where(good, new_tangent, walk.tangent)
    speed = torch.where(good, new_speed, walk.speed)
    sign = torch.where(good, look.sign, walk.sign)
    faster = good & (new_speed > walk.haste)
    ahead = torch.minimum(torch.minimum(step, LARGEST_MOVE / speed.clamp(min=1e-12)), 1 - share)
    aim = share + ahead
    aim = torch.where(aim > 1 - 1e-9, 1.0, aim)
    guess = torch.addcmul(base, torch.addcmul(tangent, bend, ahead), ahead)
    return _Walk(
        walk.element,
        share,
        step,
        base,
        tangent,
        bend,
        speed,
        sign,
        torch.where(on, walk.aim, aim),
        torch.where(on, walk.trial + newton, guess),
        torch.where(on, walk.turn + 1, 0.0),
        torch.where(on, first, 0.0),
        torch.where(on, ratio, 0.0),
        torch.where(on, moved, 0.0),
        walk.over | ~(on | ((sign != 0) & (share < 1) & (step >= least_share))),
        torch.where(faster, base, walk.quick),
        torch.where(faster, new_tangent, walk.rush),
        torch.where(faster, new_speed, walk.haste),
        torch.where(faster, share, walk.when),
    )


def relaxed(course: Course, unknowns: Tensor, steps: int) -> tuple[Tensor, Tensor]:
    """Unloaded arms at full pressure: Newton steps from z (C, N, B), and the sizes (B,) of the last."""
    size = course.pressure.new_zeros(unknowns.shape[-1])
    for _ in range(steps):
        look = mechanics.relax(course.arms, unknowns, course.pressure, course.pressure)
        unknowns = unknowns + look.change[:, :, 0]
        size = course.scale.moves(look.change[:, :, :1], look.turned[:, :1])[0]
    return unknowns, size
