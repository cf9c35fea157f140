"""The pressures at which arms that are let go at a shape come closest to it: a minimum over the box of pressures.

Some pressures are looked at, the most promising is followed to a minimum, through stable ones wherever there are any;
further steps make the balance linear again where the arm went.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from torcharm import mechanics, rod
from torcharm._box_least_squares import Model, follow_valley, minimise, projected
from torcharm._outer import Block
from torcharm._response import Points, respond, size
from torcharm.arm import ArmDesign

SCREENED = 8
"""Pressures at which each task is looked at before the most promising is followed."""
SCREENED_AGAIN = 64
"""The same, where none of those was stable."""
RETREATS = (1.0, 0.5, 0.2, 0.0)
"""Parts of a move after which to make the balance linear again, each tried where the last one left nothing stable."""
STEPS = 40
"""Of a minimisation over pressures."""
NEAR, VALLEY_STEPS = 5e-3, 12
"""Errors over the arm's length that are likely to vanish, and steps to see whether they do."""
SECOND_CHANCES = 8
"""Other starts where such an error does not: pressures of little effect leave local minima of micrometres."""
TOLERANCES = {torch.float64: 1e-7, torch.float32: 1e-3}
"""Of the error's slope by a pressure, as a share of its limit, over the arm's length."""
FLOORS = {torch.float64: 1e-10, torch.float32: 1e-5}
"""Of an error over the arm's length: below, rounding decides, and it counts as none."""
LARGE_MOVE = 1.0
"""Size of a move, as of `_response.size`, beyond which a linear balance is only a hint."""


class Tasks(NamedTuple):
    """The T triples of a block, one after the other."""

    arm: ArmDesign
    twists: Tensor
    tip_load: Tensor
    base_pose: Tensor

    @staticmethod
    def of(block: Block) -> "Tasks":
        shape = (len(block.arm.radii), *block.tip_load.shape[:2])

        def spread(value: Tensor, *axes: int) -> Tensor:
            return (
                value[tuple(slice(None) if axis in axes else None for axis in range(3))]
                .expand(*shape, *value.shape[len(axes) :])
                .flatten(0, 2)
            )

        arm = block.arm._map(lambda value: spread(value, 0))
        return Tasks(arm, spread(block.twists, 1), spread(block.tip_load, 1, 2), block.base_pose)

    def detached(self) -> "Tasks":
        return Tasks(
            self.arm._map(Tensor.detach), self.twists.detach(), self.tip_load.detach(), self.base_pose.detach()
        )


class Found(NamedTuple):
    """The best pressure of each of T tasks, in shares of its limit (T, M); how far from the task's shape the balance
    was linear there (T, 2, N); and fields of `PredictedError`."""

    share: Tensor
    offset: Tensor
    optimality: Tensor
    converged: Tensor
    stable: Tensor
    small: Tensor


def minimum_over_pressures(tasks: Tasks, weights: Tensor, steps: int) -> Found:
    """Look at some pressures, follow the most promising to a minimum; and again from where that leads."""
    shape = mechanics.to_unknowns(tasks.twists)
    target = rod.poses(tasks.twists, tasks.base_pose)
    problem = _Problem(Points.of(tasks.arm, shape, target, tasks.base_pose, tasks.tip_load), weights)
    end = _second_chance(problem, problem.minimise(*_start(problem)))
    for _ in range(steps - 1):
        problem, share, free = _restart(problem, end)
        end = _second_chance(problem, problem.minimise(share, free))
    return Found(end.share, problem.points.unknowns - shape, end.optimality, end.converged, end.stable, end.small)


def _start(problem: "_Problem", screened: int = SCREENED) -> tuple[Tensor, Tensor]:
    """The most promising of some pressures (T, M), in shares of their limits, spread evenly over the box; and whether
    none of them is stable (T,). Where none is, more are tried."""
    count, actuators = problem.points.arm.max_pressure.shape
    draws = torch.quasirandom.SobolEngine(actuators).draw(screened, dtype=torch.float64).to(problem.weights)
    draws[0] = 0.5  # instead of no pressure at all
    every = torch.arange(count, device=draws.device)
    seen = problem[every.repeat_interleave(screened)].look(draws.repeat(count, 1))
    stable = seen.stable.view(count, screened)
    share = draws[_rank(seen.model.value.view(count, screened), stable).argmin(-1)]
    free = ~stable.any(-1)
    lost = free.nonzero().squeeze(-1)
    if screened < SCREENED_AGAIN:
        for part in lost.split(max(1, count * screened // SCREENED_AGAIN)):  # no more at once than above
            if len(part):
                share[part], free[part] = _start(problem[part], SCREENED_AGAIN)
    return share, free


def _restart(problem: "_Problem", end: "_End") -> tuple["_Problem", Tensor, Tensor]:
    """The balances made linear where the arms went, with pressures from which to go on: as `_start`, but with those
    that led there wherever they are stable. Where nothing is stable there, the arm goes less far."""
    share, part = end.share.clone(), torch.ones_like(problem.length)
    lost = torch.arange(len(share), device=share.device)
    free = torch.ones_like(end.stable)
    for factor in RETREATS:
        part[lost] = factor
        there = problem[lost].moved(end.move[lost], part[lost])
        stable = there.look(share[lost]).stable
        free[lost] = ~stable
        lost = lost[~stable]
        if not len(lost):
            break
        tried, still = _start(there[(~stable).nonzero().squeeze(-1)])
        share[lost] = torch.where(still.unsqueeze(-1), share[lost], tried)
        free[lost] = still
        lost = lost[still]
        if not len(lost):
            break
    return problem.moved(end.move, part), share, free


def _second_chance(problem: "_Problem", end: "_End") -> "_End":
    """Where errors all but vanish, the best of other starts too."""
    near = problem.near(end.value)
    near = near[end.stable[near]]
    if not len(near):
        return end
    draws = torch.quasirandom.SobolEngine(end.share.shape[-1]).draw(2 * SECOND_CHANCES, dtype=torch.float64)
    draws = draws[SECOND_CHANCES:].to(end.share)
    many = problem[near.repeat_interleave(SECOND_CHANCES)]
    free = torch.zeros(len(many.points), dtype=torch.bool, device=near.device)
    again = many.minimise(draws.repeat(len(near), 1), free)
    rank = _rank(again.value, again.stable).view(-1, SECOND_CHANCES)
    best = torch.arange(len(near), device=near.device) * SECOND_CHANCES + rank.argmin(-1)
    better = again.stable[best] & (again.value[best] < end.value[near])
    columns = [column.clone() for column in end]
    for column, new in zip(columns, again, strict=True):
        column[near[better]] = new[best[better]]
    return _End(*columns)


def _rank(value: Tensor, stable: Tensor) -> Tensor:
    """(B,) The smaller the better: stable ones first; no NaN."""
    value = torch.where(value.isfinite(), value, torch.finfo(value.dtype).max / 4)
    return torch.where(stable, value - torch.finfo(value.dtype).max / 2, value)


class _Look(NamedTuple):
    model: Model
    stable: Tensor
    move: Tensor


class _End(NamedTuple):
    """Where B minimisations ended."""

    share: Tensor
    value: Tensor
    move: Tensor
    optimality: Tensor
    converged: Tensor
    stable: Tensor
    small: Tensor


@dataclass(frozen=True)
class _Problem:
    """B balances made linear, and the weights of the cost of their poses (N+1, 3)."""

    points: Points
    weights: Tensor

    def __getitem__(self, index: Tensor) -> "_Problem":
        return _Problem(self.points[index], self.weights)

    @property
    def length(self) -> Tensor:
        """(B,) of the arms [m]."""
        return self.points.arm.length.mean(-1)

    def near(self, value: Tensor) -> Tensor:
        """Indices of those whose error all but vanishes, by half the cost (B,)."""
        error = (2 * value).sqrt()
        floor = FLOORS.get(value.dtype, 1e-3)
        return ((error > floor * self.length) & (error < NEAR * self.length)).nonzero().squeeze(-1)

    def moved(self, move: Tensor, part: Tensor) -> "_Problem":
        """The balances made linear after a part (B,) of moves (B, 2, N), or of as much of them as is not too far."""
        points = self.points
        part = part * (LARGE_MOVE / size(move, self.length).clamp(min=1e-30)).clamp(max=1.0)
        unknowns = points.unknowns + part[:, None, None] * move
        return _Problem(Points.of(points.arm, unknowns, points.target, points.base_pose, points.tip_load), self.weights)

    def look(self, share: Tensor) -> _Look:
        """The cost's Gauss-Newton model at shares of the pressure limits (B, M)."""
        limit = self.points.arm.max_pressure
        found = respond(self.points, share * limit)
        root = self.weights.sqrt()
        miss = (root * found.error).flatten(1)
        slope = (root.unsqueeze(-1) * found.slope).flatten(1, 2) * limit.unsqueeze(1)
        gradient = (slope.mT @ miss.unsqueeze(-1)).squeeze(-1)
        return _Look(Model(0.5 * miss.square().sum(-1), gradient, slope.mT @ slope), found.stable, found.move)

    def minimise(self, start: Tensor, free: Tensor) -> _End:
        """Follow starts (B, M) to minima; through unstable pressures only where that is free (B,)."""

        def look(index: Tensor, share: Tensor) -> Model:
            seen = self[index].look(share)
            value = torch.where(seen.stable | free[index], seen.model.value, float("inf"))
            return seen.model._replace(value=value)

        def judge(index: Tensor, model: Model, share: Tensor) -> Tensor:
            return _optimality(model, share, floor[index]) <= tolerance[index]

        floor = FLOORS.get(start.dtype, 1e-3) * self.length
        tolerance = TOLERANCES.get(start.dtype, 1e-2) * self.length
        place = minimise(look, start, judge, STEPS)
        end = self.look(place)
        near = self.near(end.model.value)
        if len(near):
            place[near] = follow_valley(lambda index, share: look(near[index], share), place[near], VALLEY_STEPS)
            end = self.look(place)
        optimality = _optimality(end.model, place, floor)
        return _End(
            place,
            end.model.value,
            end.move,
            optimality,
            optimality <= tolerance,
            end.stable,
            size(end.move, self.length) <= LARGE_MOVE,
        )


def _optimality(model: Model, share: Tensor, floor: Tensor) -> Tensor:
    """(B,) the largest slope of the error by a share, of those that the box leaves free; 0 of no error."""
    error = (2 * model.value).sqrt()
    steepest = projected(model.gradient, share).abs().amax(-1)
    return torch.where(error <= floor, torch.zeros_like(error), steepest / error.clamp(min=1e-30))
