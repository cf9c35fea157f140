"""The pressures at which arms that are let go at a shape come closest to it: a minimum over the box of pressures.

From half the limits, or the most promising of other pressures where the arm does not come to rest there, the cost is
followed to a minimum, through stable balances wherever there are any. The balances are solved along with it: each is
guessed from the last, and solved more closely as the pressures change less. Where the error may vanish, pressures that
hold the task's very shape are looked for as well. Further steps make the load linear again where the arm went.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from torcharm import mechanics
from torcharm._box import optimality
from torcharm._box_least_squares import Model, minimise
from torcharm._outer import Block
from torcharm._response import LARGE_MOVE, Points, Rest, is_stable, look, pose_errors, settle, size
from torcharm._wrench_fit import fit_wrenches
from torcharm.arm import ArmDesign
from torcharm.geometry import rod

SCREENED = (3, 8, 64)
"""Pressures at which each task is looked at where the arm does not stay at half the limits; and again, of more."""
RETREATS = (1.0, 0.5, 0.2, 0.0)
"""Parts of a move after which to make the balance linear again, each tried where the last one left nothing stable."""
CLOSE, CLOSEST, SHARP = 3e-2, 1e-6, 0.1
"""Sizes of the last Newton step to a balance: at first, at last, and over the change of pressures in between."""


class Chance(NamedTuple):
    """A search for pressures that hold the shape.

    Attributes:
        error: it is made for smaller ones, over the arm's length.
        first, starts: which of the points that are spread over the box it starts from.
        steps: of each.
        gain: share of the squared distance that a step must promise: all of it where the shape can be held.
    """

    error: float
    first: int
    starts: int
    steps: int
    gain: float


CHANCES = (Chance(5e-2, 1, 2, 15, 1e-2), Chance(5e-3, 3, 24, 40, 1e-4))
TOLERANCES = {torch.float64: 1e-7, torch.float32: 1e-3}
"""Of the error's slope by a pressure, as a share of its limit, over the arm's length."""
FLOORS = {torch.float64: 1e-10, torch.float32: 1e-5}
"""Of an error over the arm's length: below, rounding decides, and it counts as none."""
FIRST_LOOKS = 12
"""At a balance without one nearby, before it is given up."""


class Effort(NamedTuple):
    """Of a minimisation over pressures.

    Attributes:
        steps: at most so many.
        looks: at a balance from one nearby, before it is given up.
        worth: share of the value that a few steps must save to go on.
    """

    steps: int
    looks: int
    worth: float


QUICK, THOROUGH = Effort(25, 3, 1e-3), Effort(60, 6, 1e-5)
POLISHED = 1e-2
"""Errors over the arm's length below which a minimisation that did not converge goes on thoroughly."""


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

    def chosen(self, index: Tensor) -> "Tasks":
        """Some of them."""
        return Tasks(self.arm[index], self.twists[index], self.tip_load[index], self.base_pose)

    def detached(self) -> "Tasks":
        return Tasks(
            self.arm._map(Tensor.detach), self.twists.detach(), self.tip_load.detach(), self.base_pose.detach()
        )


class Found(NamedTuple):
    """The best pressure of each of T tasks, in shares of its limit (T, M); how far from the task's shape the load
    was made linear, and where the arm came to rest (T, 2, N); and fields of `PredictedError`."""

    share: Tensor
    linear_at: Tensor
    rest_at: Tensor
    optimality: Tensor
    converged: Tensor
    stable: Tensor
    small: Tensor


def minimum_over_pressures(tasks: Tasks, weights: Tensor, steps: int | None) -> Found:
    """Look at some pressures, follow the most promising to a minimum; and again from where that leads. Without a
    number of steps, loads are exact."""
    shape = mechanics.to_unknowns(tasks.twists)
    target = rod.poses(tasks.twists, tasks.base_pose)
    points = Points.of(tasks.arm, shape, target, tasks.base_pose, tasks.tip_load, exact=steps is None)
    problem = _Problem(points, weights, shape)
    end = _second_chance(problem, problem.minimise(_start(problem)))
    for _ in range(0 if steps is None else steps - 1):
        problem, start = _restart(problem, end)
        end = _second_chance(problem, problem.minimise(start))
    offset = problem.points.unknowns - shape
    return Found(
        end.share,
        offset,
        end.unknowns - shape,
        end.optimality,
        end.converged,
        end.stable,
        end.small,
    )


class _Start(NamedTuple):
    """Pressures (B, M) in shares of their limits, shapes and rates there as a hint (B, 2N, 1 + M), and whether to go
    through unstable balances (B,), as there are no others."""

    share: Tensor
    hint: Tensor
    free: Tensor


def _start(problem: "_Problem") -> _Start:
    """The middle of the box of pressures; where the arm does not come to rest there, the most promising of others."""
    middle = torch.full_like(problem.points.arm.max_pressure, 0.5)
    found = problem.rest(middle, problem.points.unknowns, FIRST_LOOKS)
    start = _Start(middle, _hint(found), ~found.stable)
    for screened in SCREENED:
        lost = start.free.nonzero().squeeze(-1)
        for part in lost.split(max(1, len(middle) * SCREENED[0] // screened)):  # no more at once than at first
            for column, new in zip(start, _screen(problem[part], screened), strict=True):
                column[part] = new
    return start


def _screen(problem: "_Problem", screened: int) -> _Start:
    """Of pressures spread evenly over the box, those at which the arm comes to rest nearest to the task."""
    count, actuators = problem.points.arm.max_pressure.shape
    draws = torch.quasirandom.SobolEngine(actuators).draw(1 + screened, dtype=torch.float64)[1:].to(problem.weights)
    every = torch.arange(count, device=draws.device)
    many, share = problem[every.repeat_interleave(screened)], draws.repeat(count, 1)
    found = many.rest(share, many.points.unknowns, FIRST_LOOKS)
    value = 0.5 * many.miss(found.unknowns).square().sum(-1)
    one = every * screened + _rank(value, found.stable).view(count, screened).argmin(-1)
    return _Start(share[one], _hint(found)[one], ~found.stable[one])


def _restart(problem: "_Problem", end: "_End") -> tuple["_Problem", _Start]:
    """The loads made linear where the arms went, with pressures from which to go on: as `_start`, but with those
    that led there wherever they are stable. Where nothing is stable there, the arm goes less far."""
    part = torch.ones_like(problem.points.length)
    lost = torch.arange(len(part), device=part.device)
    hint = end.unknowns.new_zeros(*end.hint.shape)
    start = _Start(end.share.clone(), hint, torch.ones_like(end.stable))
    for factor in RETREATS:
        part[lost] = factor
        there = problem[lost].moved(end.move[lost], part[lost])
        found = there.rest(start.share[lost], end.unknowns[lost], FIRST_LOOKS)
        good = found.stable
        start.hint[lost], start.free[lost] = _hint(found), ~good
        lost, there = lost[~good], there[(~good).nonzero().squeeze(-1)]
        if not len(lost):
            break
        tried = _start(there)
        better = ~tried.free
        for column, new in zip(start, tried, strict=True):
            column[lost[better]] = new[better]
        lost = lost[~better]
        if not len(lost):
            break
    return problem.moved(end.move, part), start


def _hint(rest: Rest) -> Tensor:
    """(B, 2, N, 1 + M)"""
    return torch.cat((rest.unknowns.unsqueeze(-1), rest.rate), -1)


def _second_chance(problem: "_Problem", end: "_End") -> "_End":
    """Where errors may vanish: whether some pressure holds the task's very shape, and what is best near it."""
    columns = [column.clone() for column in end]
    stuck = problem.near(end.value, POLISHED)
    stuck = stuck[~end.converged[stuck]]
    if len(stuck):
        again = problem[stuck].minimise(_Start(end.share[stuck], end.hint[stuck], ~end.stable[stuck]), THOROUGH)
        better = _rank(again.value, again.stable) < _rank(end.value[stuck], end.stable[stuck])
        for column, new in zip(columns, again, strict=True):
            column[stuck[better]] = new[better]
    for chance in CHANCES:
        end = _End(*columns)
        near = problem.near(end.value, chance.error)
        if not len(near):
            continue
        some = problem[near]
        share, value = _holding(some, end.share[near], chance)
        hopeful = value < end.value[near]
        near, share = near[hopeful], share[hopeful]
        if not len(near):
            continue
        some = problem[near]
        again = some.minimise(_Start(share, _hint(some.rest(share, some.shape, FIRST_LOOKS)), ~end.stable[near]))
        better = _rank(again.value, again.stable) < _rank(end.value[near], end.stable[near])
        for column, new in zip(columns, again, strict=True):
            column[near[better]] = new[better]
    return _End(*columns)


def _holding(problem: "_Problem", share: Tensor, chance: Chance) -> tuple[Tensor, Tensor]:
    """Pressures (B, M) whose reactions along the task's shape come closest to what it requires, from the given ones
    (B, M) and others: the best of them, and half its cost (B,), by the tangent stiffness."""
    points, shape = problem.points, problem.shape
    load = mechanics.load_wrench(mechanics.kinematics(shape, points.base_pose), points.tip_load)
    reach = points.arm.radii.abs().amax(-1).clamp(min=1e-3)
    scale = torch.stack((torch.ones_like(reach), 1 / reach), -1).unsqueeze(-1)
    draws = torch.quasirandom.SobolEngine(share.shape[-1]).draw(chance.first + chance.starts, dtype=torch.float64)
    fresh = draws[chance.first :].to(share).expand(len(share), -1, -1)
    starts = torch.cat((share.unsqueeze(1), fresh), 1)
    every = torch.arange(len(share), device=share.device)
    index = every.repeat_interleave(starts.shape[1])
    many = problem[index]
    found = fit_wrenches(
        many.points.arm, many.shape, load[index], scale[index], starts.flatten(0, 1), chance.steps, chance.gain
    )
    seen = look(many.points, many.shape, found.share * many.points.arm.max_pressure, rates=False)
    value = 0.5 * many.miss(many.shape + seen.step).square().sum(-1)
    stable = is_stable(seen.stiffness)
    best = _rank(value, stable).view(starts.shape[:2]).argmin(-1)
    value = torch.where(stable, value, float("inf")).view(starts.shape[:2])
    return found.share.view_as(starts)[every, best], value[every, best]


def _rank(value: Tensor, stable: Tensor) -> Tensor:
    """(B,) The smaller the better: stable ones, of any value, before all others; no NaN."""
    bounded = torch.where(value.isfinite(), value / (1 + value), torch.ones_like(value))
    return torch.where(stable, bounded, 2 + bounded)


class _End(NamedTuple):
    """Where B minimisations ended."""

    share: Tensor
    hint: Tensor
    unknowns: Tensor
    value: Tensor
    move: Tensor
    optimality: Tensor
    converged: Tensor
    stable: Tensor
    small: Tensor
    settled: Tensor


@dataclass(frozen=True)
class _Problem:
    """B arms whose loads were made linear, the weights of the cost of their poses (N+1, 3), and the shapes wanted
    (B, 2, N)."""

    points: Points
    weights: Tensor
    shape: Tensor

    def __getitem__(self, index: Tensor) -> "_Problem":
        return _Problem(self.points[index], self.weights, self.shape[index])

    def near(self, value: Tensor, near: float) -> Tensor:
        """Indices of those whose error all but vanishes, by half the cost (B,)."""
        error = (2 * value).sqrt()
        floor = FLOORS.get(value.dtype, 1e-3)
        length = self.points.length
        return ((error > floor * length) & (error < near * length)).nonzero().squeeze(-1)

    def moved(self, move: Tensor, part: Tensor) -> "_Problem":
        """With loads made linear after a part (B,) of moves (B, 2, N), or of as much of them as is not too far."""
        points = self.points
        part = part * (LARGE_MOVE / size(move, points.length).clamp(min=1e-30)).clamp(max=1.0)
        unknowns = points.unknowns + part[:, None, None] * move
        again = Points.of(points.arm, unknowns, points.target, points.base_pose, points.tip_load, points.exact)
        return _Problem(again, self.weights, self.shape)

    def rest(self, share: Tensor, guess: Tensor, looks: int, close: Tensor | float = CLOSE) -> Rest:
        """Where the arms come to rest at shares of the pressure limits (B, M)."""
        close = close if isinstance(close, Tensor) else torch.full_like(self.points.length, close)
        return settle(self.points, share * self.points.arm.max_pressure, guess, looks, close)

    def miss(self, unknowns: Tensor) -> Tensor:
        """(B, K) what is squared and summed of shapes (B, 2, N)."""
        motion = mechanics.kinematics(unknowns, self.points.base_pose)
        return (self.weights.sqrt() * mechanics.pose_error(motion.pose, self.points.target)[0]).flatten(1)

    def model(self, rest: Rest) -> Model:
        """Of the cost where arms come to rest, by shares."""
        root = self.weights.sqrt()
        found = pose_errors(self.points, rest.unknowns, rest.rate)
        miss = (root * found.error).flatten(1)
        slope = (root.unsqueeze(-1) * found.slope).flatten(1, 2) * self.points.arm.max_pressure.unsqueeze(1)
        gradient = (slope.mT @ miss.unsqueeze(-1)).squeeze(-1)
        return Model(0.5 * miss.square().sum(-1), gradient, slope.mT @ slope, _hint(rest))

    def look(self, share: Tensor, near: Tensor, hint: Tensor, free: Tensor, looks: int) -> Model:
        """The cost's Gauss-Newton model at shares (B, M), from the rest at others nearby."""
        limit = self.points.arm.max_pressure
        ahead = ((share - near) * limit)[:, None, None]
        guess = hint[..., 0] + (hint[..., 1:] * ahead).sum(-1)
        guess = torch.where(guess.isfinite().flatten(1).all(-1)[:, None, None], guess, hint[..., 0])
        change = (share - near).abs().amax(-1)
        close = torch.where(change == 0, CLOSE, (SHARP * change).clamp(CLOSEST, CLOSE))
        found = self.rest(share, guess, FIRST_LOOKS if bool((change == 0).all()) else looks, close)
        model = self.model(found)
        good = found.settled & (found.stable | free)
        return model._replace(value=torch.where(good, model.value, float("inf")))

    def minimise(self, start: _Start, effort: Effort = QUICK) -> _End:
        """Follow starts to minima; through unstable balances only where that is free."""

        def look(index: Tensor, share: Tensor, near: Tensor, hint: Tensor) -> Model:
            return self[index].look(share, near, hint, start.free[index], effort.looks)

        def judge(index: Tensor, model: Model, share: Tensor) -> Tensor:
            return _optimality(model, share, floor[index]) <= tolerance[index]

        points = self.points
        floor = FLOORS.get(start.share.dtype, 1e-3) * points.length
        tolerance = TOLERANCES.get(start.share.dtype, 1e-2) * points.length
        place, hint = minimise(look, start.share, start.hint, judge, effort.steps, effort.worth)
        found = self.rest(place, hint[..., 0], FIRST_LOOKS, CLOSEST)
        model = self.model(found)
        optimality = _optimality(model, place, floor)
        move = found.unknowns - points.unknowns
        return _End(
            place,
            _hint(found),
            found.unknowns,
            model.value,
            move,
            optimality,
            (optimality <= tolerance) & found.settled,
            found.stable & found.settled,
            size(move, points.length) <= LARGE_MOVE,
            found.settled,
        )


def _optimality(model: Model, share: Tensor, floor: Tensor) -> Tensor:
    """(B,) the largest slope of the error by a share, of those that the box leaves free; 0 of no error."""
    error = (2 * model.value).sqrt()
    steepest = optimality(model.gradient, share)
    return torch.where(error <= floor, torch.zeros_like(error), steepest / error.clamp(min=1e-30))
