"""Descent to the pressure that brings an arm closest to a shape: many problems and starts in one batch.

Projected Levenberg-Marquardt on the pose errors, in pressures and twists together: a step changes the pressures, moves
the twists by their implicit derivative, and takes the Newton step that was due. One evaluation of the balance
serves both methods, and poses count as Newton's step corrects them, so that no time is spent on settling. Where
Newton's step is not small, or the determinant of the stiffness changes its sign, the step was too long. Each element
goes at its own pace. The batch comes last, as in `mechanics.march`.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor

from torcharm import mechanics
from torcharm._box import LEAST_DAMPING, START_DAMPING, box_step
from torcharm._tracing import CONTRACTION, LARGEST_MOVE, Scale
from torcharm._underway import run
from torcharm.mechanics import Arms, Marched, pick

if TYPE_CHECKING:
    from torcharm.kernels.fleet import Fleet

NEAR = 0.05
"""Newton's step, as `Scale.moves` measures, up to which poses are trusted once it corrects them."""
NEWTON_STEPS = 5
"""Of these, one after the other, where the step is longer."""
NARROWEST = 1e5
"""Damping at which the descent ends: it is held up, at a kink or where the branch ends."""
FLOOR = 1e-14
"""Promised decrease of the cost at which the descent ends, absolute [m²]."""
STIFF = 100.0
"""Of a wall, over the largest entry of the normal matrix."""
SETTLED = 1e-7
"""Newton's step at which it may end."""
ROUNDING = 50.0
"""Machine epsilons below which neither decreases nor steps mean anything."""


@dataclass(frozen=True)
class Goal:
    """What B searches aim at.

    Attributes:
        target: (3, N, B) poses after the segments.
        weight: (3, N, 1) square roots of the weights on their errors.
        turned: whether errors along and across the arm weigh differently, so that they are told apart.
    """

    target: Tensor
    weight: Tensor
    turned: bool

    @staticmethod
    def of(target: Tensor, weight: Tensor) -> "Goal":
        """From poses (B, N+1, 3), the base's among them, and square roots of weights (N+1, 3)."""
        rows = target[:, 1:].permute(2, 1, 0).contiguous()
        root = weight[1:].mT.unsqueeze(-1).contiguous()
        return Goal(rows, root, not torch.equal(root[0], root[1]))

    def __getitem__(self, index: Tensor) -> "Goal":
        return Goal(pick(self.target, index), self.weight, self.turned)

    def cost(self, unknowns: Tensor, base_pose: Tensor) -> Tensor:
        """(B,) [m²] the sum of squares at z (C, N, B), from base poses (3, B)."""
        pose = mechanics.kinematics(unknowns.movedim(-1, 0), base_pose.mT).pose[:, 1:].permute(2, 1, 0)
        return (self.error(pose) * self.weight).square().sum((0, 1))

    def error(self, pose: Tensor) -> Tensor:
        """(3, N, B) of poses, the target seen from them; in the world frame where that makes no difference."""
        gap = self.target - pose
        if not self.turned:
            return gap
        cos, sin = pose[2].cos(), pose[2].sin()
        return torch.stack((cos * gap[0] + sin * gap[1], cos * gap[1] - sin * gap[0], gap[2]))

    def model(self, look: Marched) -> tuple[Tensor, Tensor, Tensor]:
        """The cost (B,) after Newton's step, and of its Gauss-Newton model by the M other changes the half gradient
        (M, B) and the matrix (M, M, B)."""
        columns = torch.cat((look.slid, look.turned.unsqueeze(0))).neg_()  # (3, N, 1+M, B)
        pose = torch.cat((look.position, look.heading.unsqueeze(0)))
        error = self.error(pose)
        if self.turned:
            cos, sin = pose[2].cos().unsqueeze(1), pose[2].sin().unsqueeze(1)
            x, y, turn = columns
            first, second = error[:2].unsqueeze(2)
            columns = torch.stack((cos * x + sin * y - second * turn, cos * y - sin * x + first * turn, turn))
        columns[:, :, 0] += error
        columns = (columns * self.weight.unsqueeze(2)).flatten(0, 1)
        size = columns.shape[1]
        products = columns.new_empty(size, size, columns.shape[-1])
        for k in range(size):
            row = (columns[:, k : k + 1] * columns[:, k:]).sum(0)
            products[k, k:] = row
            products[k:, k] = row
        return products[0, 0], products[0, 1:], products[1:, 1:]


class Setting(NamedTuple):
    """What B searches are of: arms, what imbalances are measured by, limits (M, B) of pressure [kPa], and goals."""

    arms: Arms
    scale: Scale
    limits: Tensor
    goal: Goal


@dataclass(frozen=True)
class Searches:
    """B searches.

    Attributes:
        setting: of T.
        rows: (B,) which of these.
        tolerance: of the load scale.
        fleet: the same for compiled steps, if they are to run compiled.
        wall: (M, B) normals, along which the pressures are held, if they are.
    """

    setting: Setting
    rows: Tensor
    tolerance: float
    fleet: "Fleet | None" = None
    wall: Tensor | None = None

    @staticmethod
    def of(setting: Setting, tolerance: float, *, compiled: bool = False) -> "Searches":
        """All of them."""
        rows = torch.arange(setting.limits.shape[-1], device=setting.limits.device)
        if not compiled:
            return Searches(setting, rows, tolerance)
        from torcharm.kernels.fleet import Fleet

        goal = setting.goal
        fleet = Fleet.of(setting.arms, setting.scale, setting.limits, tolerance)
        return Searches(setting, rows, tolerance, fleet.aiming(goal.target, goal.weight, goal.turned))

    def __getitem__(self, index: Tensor) -> "Searches":
        fleet = None if self.fleet is None else self.fleet[index]
        return Searches(self.setting, self.rows[index], self.tolerance, fleet, pick(self.wall, index))

    @cached_property
    def arms(self) -> Arms:
        """B of them."""
        return self.setting.arms[self.rows]

    @cached_property
    def scale(self) -> Scale:
        """Theirs."""
        return pick(self.setting.scale, self.rows)

    @cached_property
    def limits(self) -> Tensor:
        """(M, B) [kPa]."""
        return pick(self.setting.limits, self.rows)

    @cached_property
    def goal(self) -> Goal:
        """Of each."""
        return self.setting.goal[self.rows]

    def cost(self, unknowns: Tensor) -> Tensor:
        """(B,) at z (C, N, B)."""
        if self.fleet is not None:
            return self.fleet.cost(unknowns)
        return self.goal.cost(unknowns, self.arms.base_pose)

    def model(self, place: Tensor, unknowns: Tensor, rows: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
        """As of `Goal.model`, at places (M, B) and equilibria z (C, N, B), or nearly; or at places (M, R) of `rows`
        (R,) of these searches and shapes."""
        if self.fleet is not None:
            return self.fleet.model(place, unknowns, rows)
        own, unknowns = (self, unknowns) if rows is None else (self[rows], pick(unknowns, rows))
        return own.goal.model(mechanics.march(own.arms, unknowns, place * own.limits, each_pressure=own.limits))

    def gains(self, place: Tensor, unknowns: Tensor, share: Tensor, measure: Tensor) -> Tensor:
        """(M, B) changes, by the place, of the sum of products of a measure (C, N, B) and z, under shares (B,) of the
        load."""
        if self.fleet is not None:
            return self.fleet.gains(place, unknowns, share, measure)
        limits = self.limits
        look = mechanics.march(self.arms, unknowns, place * limits, share, each_pressure=limits, poses=False)
        return (look.change[:, :, 1:] * measure.unsqueeze(2)).sum((0, 1))


class Descended(NamedTuple):
    """Where the searches ended.

    Attributes:
        place: (M, B) pressures as shares of their limits.
        unknowns: (C, N, B).
        cost: (B,) infinite where no equilibrium was reached.
        ended: (B,) whether the descent ended by itself.
    """

    place: Tensor
    unknowns: Tensor
    cost: Tensor
    ended: Tensor


class _State(NamedTuple):
    """Elements under way: the best point so far with its model, and an attempt at a better."""

    element: Tensor
    place: Tensor
    unknowns: Tensor
    cost: Tensor
    unsettled: Tensor  # size of the Newton step that led here
    sign: Tensor
    normal: Tensor
    gradient: Tensor
    motion: Tensor  # (C, N, M, A) dz by the place
    turned: Tensor  # (N, M, A)
    damping: Tensor
    promise: Tensor
    trial_place: Tensor
    trial: Tensor
    turn: Tensor
    first: Tensor
    stalled: Tensor
    over: Tensor


def descend(searches: Searches, place: Tensor, unknowns: Tensor, *, gain: float, looks: int) -> Descended:
    """Follow the cost down from starts that are equilibria, or nearly.

    Args:
        searches: B of them.
        place: (M, B) pressures to start from, as shares of the limits.
        unknowns: (C, N, B) the equilibria there.
        gain: promised decrease of the cost, relative, at which the descent ends.
        looks: evaluations of the balance, at most.
    """
    least = ROUNDING * torch.finfo(place.dtype).eps
    gain, settled = max(gain, least), max(SETTLED, least)
    if searches.fleet is not None:
        return Descended(*searches.fleet.descend(searches.wall, place, unknowns, gain, settled, looks))
    size, count = place.shape
    components, nodes, _ = unknowns.shape
    none = place.new_zeros(count)
    state = _State(
        torch.arange(count, device=place.device),
        place,
        unknowns,
        none + float("inf"),
        none,
        none,
        place.new_zeros(size, size, count),
        torch.zeros_like(place),
        place.new_zeros(components, nodes, size, count),
        place.new_zeros(nodes, size, count),
        none + START_DAMPING,
        none,
        place,
        unknowns,
        none,
        none,
        none,
        none.bool(),
    )
    out = Descended(place.clone(), unknowns.clone(), state.cost.clone(), none.bool())

    def store(state: _State) -> None:
        at = state.element
        out.place[:, at], out.unknowns[:, :, at], out.cost[at] = state.place, state.unknowns, state.cost
        out.ended[at] = state.cost.isfinite() & state.over

    run(_advance, searches, state, looks, store, (gain, settled))
    return out


def _advance(own: Searches, state: _State, gain: float, settled: float) -> _State:
    """One evaluation of the balance for each, and what follows. What is over stays as it is."""
    arms, scale, limits, goal = own.arms, own.scale, own.limits, own.goal
    look = mechanics.march(arms, state.trial, state.trial_place * limits, each_pressure=limits)
    newton = look.change[:, :, 0]
    size = scale.moves(look.change[:, :, :1], look.turned[:, :1])[0]
    near = size <= NEAR
    first = torch.where(state.turn == 0, size, state.first)
    on = ~near & ((state.turn != 1) | (size < CONTRACTION * first)) & (size < LARGEST_MOVE)
    on &= (state.turn < NEWTON_STEPS) & ~state.over

    # The model of the cost at the trial point, of use where it is accepted
    cost, gradient, normal = goal.model(look)
    branch = (look.sign == state.sign) | (state.sign == 0)
    sound = near & branch & cost.isfinite() & gradient.isfinite().all(0) & ~state.over
    better = sound & (cost < state.cost)
    drop = state.cost - cost
    quality = drop / state.promise.clamp(min=1e-300)
    wrong = ~on & ~better

    damping = state.damping
    damping = torch.where(better & (quality > 0.75), damping / 10, damping)
    damping = torch.where(better & (quality < 0.25) & (state.promise > 0), damping * 3, damping)
    damping = torch.where(wrong, damping.clamp(min=1e-6) * torch.where(sound, 5.0, 10.0), damping)
    damping = damping.clamp(LEAST_DAMPING, NARROWEST)
    place = torch.where(better, state.trial_place, state.place)
    unknowns = torch.where(better, state.trial + newton, state.unknowns)
    best = torch.where(better, cost, state.cost)
    unsettled = torch.where(better, size, state.unsettled)
    normal = torch.where(better, normal, state.normal)
    gradient = torch.where(better, gradient, state.gradient)
    motion = torch.where(better, look.change[:, :, 1:], state.motion)
    turned = torch.where(better, look.turned[:, 1:], state.turned)
    # decreases that are next to nothing, one after the other
    stalled = torch.where(better, torch.where(drop < gain * cost, state.stalled + 1, 0.0), state.stalled)

    bound = normal
    if own.wall is not None:
        stiff = STIFF * normal.diagonal(dim1=0, dim2=1).amax(-1)
        bound = normal + stiff * own.wall.unsqueeze(0) * own.wall.unsqueeze(1)
    step = box_step(bound, gradient, place, damping)
    curved = (step * (normal * step).sum(1)).sum(0)
    dz, dturn = (motion * step).sum(2), (turned * step).sum(1)
    # Too far along the tangent to come back from: shorter
    length = scale.moves(dz.unsqueeze(2), dturn.unsqueeze(1))[0]
    short = (0.7 * LARGEST_MOVE / length.clamp(min=1e-12)).clamp(max=1.0)
    promise = -((gradient * step).sum(0) * 2 + curved) * short
    # A cost that was corrected too much is in the way: look at the best point once more
    again = wrong & (unsettled > settled) & best.isfinite() & ~better
    done = ((promise <= gain * best + FLOOR) & (unsettled <= settled)) | (stalled >= 5)
    hopeless = best.isinf() | (damping >= NARROWEST)
    trial_place = torch.where(again, place, torch.addcmul(place, step, short).clamp(0, 1))
    trial = torch.where(again, unknowns, torch.addcmul(unknowns, dz, short))
    return _State(
        state.element,
        place,
        unknowns,
        torch.where(again, float("inf"), best),
        torch.where(again, 0.0, unsettled),
        torch.where(better, look.sign, state.sign),
        normal,
        gradient,
        motion,
        turned,
        damping,
        torch.where(on, state.promise, torch.where(again, 0.0, promise)),
        torch.where(on, state.trial_place, trial_place),
        torch.where(on, state.trial + newton, trial),
        torch.where(on, state.turn + 1, 0.0),
        first,
        stalled,
        state.over | (~on & ~again & (hopeless | done)),
    )
