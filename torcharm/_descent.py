"""Descent to the pressure that brings an arm closest to a shape: many problems and starts in one batch.

Projected Levenberg-Marquardt on the pose errors, along the equilibria: a pressure step moves the twists by their
implicit derivative, Newton's method brings them back to equilibrium, and what fails to come back, or lands on
another branch, counts as a step too long. One evaluation of the balance serves both methods; each element goes at
its own pace.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from torcharm import mechanics
from torcharm._box import LEAST_DAMPING, START_DAMPING, box_step, optimality
from torcharm._continuation import Problem, _move
from torcharm._tracing import CONTRACTION, LARGEST_MOVE

EQUILIBRIUM = 1e-9
"""Imbalance, of the load scale, at which a cost is trusted on the way."""
NEWTON_STEPS = 6
NARROWEST = 1e5
"""Damping at which the descent ends: it is held up, at a kink or where the branch ends."""
FLOOR = 1e-14
"""The same, absolute [m²]."""


@dataclass(frozen=True)
class Goal:
    """What B searches aim at.

    Attributes:
        target: (B, N+1, 3) poses.
        weight: (B, N+1, 3) square roots of the weights on their errors.
    """

    target: Tensor
    weight: Tensor

    def __getitem__(self, index: Tensor) -> "Goal":
        return Goal(self.target[index], self.weight[index])

    def residual(self, pose: Tensor) -> tuple[Tensor, Tensor]:
        """Weighted errors (B, N+1, 3), and their derivative by the poses (B, N+1, 3, 3)."""
        error, slope = mechanics.pose_error(pose, self.target)
        return self.weight * error, self.weight.unsqueeze(-1) * slope

    def cost(self, pose: Tensor) -> Tensor:
        """(B,) the sum of squares."""
        return self.residual(pose)[0].square().sum((-1, -2))


class Descended(NamedTuple):
    """Where the searches ended.

    Attributes:
        place: (B, M) pressures as shares of their limits.
        unknowns: (B, C, N).
        cost: (B,) infinite where no equilibrium was reached.
        optimality: (B,) see `_box.optimality`; of the gradient by pressures as shares of their limits.
        ended: (B,) whether the descent ended by itself.
    """

    place: Tensor
    unknowns: Tensor
    cost: Tensor
    optimality: Tensor
    ended: Tensor


class _State(NamedTuple):
    """Elements under way: the best point so far with its model, and an attempt at a better."""

    element: Tensor
    place: Tensor
    unknowns: Tensor
    cost: Tensor
    optimality: Tensor
    sign: Tensor
    normal: Tensor
    gradient: Tensor
    motion: Tensor  # (A, C, N, M) dz by the place
    damping: Tensor
    promise: Tensor
    trial_place: Tensor
    trial: Tensor
    turn: Tensor
    first: Tensor
    stalled: Tensor

    def at(self, index: Tensor) -> "_State":
        """These elements."""
        return _State(*(value[index] for value in self))


def descend(problem: Problem, goal: Goal, place: Tensor, unknowns: Tensor, *, gain: float, looks: int) -> Descended:
    """Follow the cost down from starts that are equilibria.

    Args:
        problem: B, of which the pressures do not count.
        goal: of each.
        place: (B, M) pressures to start from, as shares of the limits.
        unknowns: (B, C, N) the equilibria there.
        gain: promised decrease of the cost, relative, at which the descent ends.
        looks: evaluations of the balance, at most.
    """
    count, size = place.shape
    none = place.new_zeros(count)
    state = _State(
        torch.arange(count, device=place.device),
        place,
        unknowns,
        none + float("inf"),
        none + float("inf"),
        none,
        place.new_zeros(count, size, size),
        torch.zeros_like(place),
        place.new_zeros(*unknowns.shape, size),
        none + START_DAMPING,
        none,
        place,
        unknowns,
        none,
        none,
        none,
    )
    out = Descended(place.clone(), unknowns.clone(), state.cost.clone(), state.cost.clone(), none.bool())
    own, aims = problem, goal
    for _ in range(looks):
        state, under_way = _advance(own, aims, state, gain)
        if bool(under_way.all()):
            continue
        _store(out, state.at(~under_way), ended=True)
        if not bool(under_way.any()):
            return out
        state, own, aims = state.at(under_way), own[under_way], aims[under_way]
    _store(out, state, ended=False)
    return out


def _store(out: Descended, state: _State, *, ended: bool) -> None:
    at = state.element
    out.place[at], out.unknowns[at], out.cost[at] = state.place, state.unknowns, state.cost
    out.optimality[at], out.ended[at] = state.optimality, state.cost.isfinite() & ended


def _advance(problem: Problem, goal: Goal, state: _State, gain: float) -> tuple[_State, Tensor]:
    """One evaluation of the balance for each, and what follows; whether any is to follow."""
    limits = problem.arm.max_pressure
    found = mechanics.balance(
        problem.arm,
        state.trial,
        state.trial_place * limits,
        problem.tip_load,
        problem.base_pose,
        problem.shear_stiffness,
    )
    right = torch.cat((found.residual.unsqueeze(-1), found.by_pressure * limits[:, None, None, :]), -1)
    answer, sign = mechanics.solve_signed(found.stiffness, -right)
    newton, motion = answer[..., 0], answer[..., 1:]
    size = _move(problem, newton)
    there = problem.imbalance(found.residual) <= max(EQUILIBRIUM, problem.tolerance)
    first = torch.where(state.turn == 0, size, state.first)
    contracts = (state.turn != 1) | (size < CONTRACTION * first) | (size < 1e-2)
    on = ~there & contracts & (size < LARGEST_MOVE) & (state.turn < NEWTON_STEPS)

    # The model of the cost at the trial point, of use where it is accepted
    error, slope = goal.residual(found.kinematics.pose)
    cost = error.square().sum((-1, -2))
    poses = mechanics.pose_change(found.kinematics, motion).movedim(-3, -2)  # (A, N+1, 3, M)
    rates = (slope @ poses).flatten(1, 2)
    gradient = (rates.mT @ error.flatten(1).unsqueeze(-1)).squeeze(-1)
    normal = rates.mT @ rates

    branch = (sign == state.sign) | (state.sign == 0)
    sound = there & branch & cost.isfinite() & gradient.isfinite().all(-1)
    better = sound & (cost < state.cost)
    quality = (state.cost - cost) / state.promise.clamp(min=1e-300)
    wrong = ~on & ~better

    def taken(new: Tensor, old: Tensor) -> Tensor:
        return torch.where(better.view(-1, *[1] * (new.ndim - 1)), new, old)

    damping = state.damping
    damping = torch.where(better & (quality > 0.75), damping / 10, damping)
    damping = torch.where(better & (quality < 0.25) & (state.promise > 0), damping * 3, damping)
    damping = torch.where(wrong, damping.clamp(min=1e-6) * torch.where(sound, 5.0, 10.0), damping)
    damping = damping.clamp(LEAST_DAMPING, NARROWEST)
    base = state._replace(
        place=taken(state.trial_place, state.place),
        unknowns=taken(state.trial, state.unknowns),
        cost=taken(cost, state.cost),
        optimality=taken(2 * optimality(gradient, state.trial_place), state.optimality),
        sign=taken(sign, state.sign),
        normal=taken(normal, state.normal),
        gradient=taken(gradient, state.gradient),
        motion=taken(motion, state.motion),
        damping=damping,
        # decreases that are next to nothing, one after the other
        stalled=torch.where(
            better & (state.cost - cost < gain * cost), state.stalled + 1, torch.where(better, 0.0, state.stalled)
        ),
    )
    step = box_step(base.normal, base.gradient, base.place, base.damping)
    model = (base.gradient * step).sum(-1) * 2 + (step * (base.normal @ step.unsqueeze(-1)).squeeze(-1)).sum(-1)
    dz = (base.motion * step[:, None, None, :]).sum(-1)
    # Too far along the tangent to come back from: shorter
    scale = (0.7 * LARGEST_MOVE / _move(problem, dz).clamp(min=1e-12)).clamp(max=1.0)
    step, dz = scale[:, None] * step, scale[:, None, None] * dz
    promise = -model * scale
    after = base._replace(
        promise=torch.where(on, state.promise, promise),
        trial_place=torch.where(on[:, None], state.trial_place, (base.place + step).clamp(0, 1)),
        trial=torch.where(on[:, None, None], state.trial + newton, base.unknowns + dz),
        turn=torch.where(on, state.turn + 1, torch.zeros_like(state.turn)),
        first=first,
    )
    hopeless = base.cost.isinf() | (base.damping >= NARROWEST)
    done = (promise <= gain * base.cost + FLOOR) | (base.stalled >= 5)
    return after, on | ~(hopeless | done)
