"""How far off the task an arm will really be, in metres: predicted from its balance made linear at the task shape.

At the task shape z* the residual is `R(z*, p) = a + q` and the stiffness `J(p) = ∂R/∂z`. Let go, the arm moves by
`δz = -J⁻¹ R` to first order, and its poses with it. The predicted error is the least cost of the poses of `z* + δz`
over the pressures within their limits: one small linear solve for each pressure tried.
"""

from dataclasses import dataclass
from math import prod
from typing import NamedTuple

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from torcharm import mechanics, rod
from torcharm._box_least_squares import Model, minimise, projected
from torcharm._inputs import check_count, shown
from torcharm._outer import Block, OuterProduct, map_blocks, outer_product
from torcharm._response import Points, respond, size
from torcharm.arm import ArmDesign
from torcharm.pose_cost import PoseCost
from torcharm.task import Task
from torcharm.wrenches import actuator_force, along

BLOCK_ELEMENTS = 4_000_000
"""Entries of the stiffness matrices of one block (32 MB)."""
SCREENED = 8
"""Pressures at which each task is looked at before the most promising is followed."""
STEPS = 40
"""Of a minimisation over pressures."""
TOLERANCES = {torch.float64: 1e-7, torch.float32: 1e-3}
"""Of the error's slope by a pressure, as a share of its limit, over the arm's length."""
FLOORS = {torch.float64: 1e-10, torch.float32: 1e-5}
"""Of an error over the arm's length: below, rounding decides, and it counts as none."""
LARGE_MOVE = 1.0
"""Size of a move, as of `_response.size`, beyond which a linear balance is only a hint."""


@dataclass(frozen=True, eq=False)
class PredictedError:
    """What `predict_error` found, of shape (*design batch, *task batch).

    Attributes:
        error: square root of the cost `Σ_i ω_i e_iᵀ K e_i` [m].
        per_node: (..., N+1) `sqrt(e_iᵀ K e_i)` of each pose [m].
        pose_errors: (..., N+1, 3) `e_i = (x, y, θ)`, the target seen from the pose predicted [m, m, rad].
        pressure: (..., M) that reaches it [kPa].
        twists: (..., N, 3) of the shape predicted.
        optimality: largest slope of the error by a pressure in shares of its limit [m], of those that
            the limits leave free.
        converged: whether the optimality is within tolerance and J regular.
        stable: whether -J is positive definite at the pressure found. Stable pressures are preferred: false
            means that none was found, that the arm would leave the shape, and that the error is no more than a hint.
        small: whether the arm moves little enough (by a radian, or a third of its length) for a linear balance.
        strain_excess: largest strain beyond its actuator's characterised range at the shape predicted, 0 if none is.
        in_range: whether every strain, and every pressure found, lies in the characterised range.
    """

    error: Tensor
    per_node: Tensor
    pose_errors: Tensor
    pressure: Tensor
    twists: Tensor
    optimality: Tensor
    converged: Tensor
    stable: Tensor
    small: Tensor
    strain_excess: Tensor
    in_range: Tensor


def predict_error(
    arm: ArmDesign, task: Task, pose_cost: PoseCost | None = None, *, steps: int = 1, chunk_size: int | None = None
) -> PredictedError:
    """The least pose error that each design can be expected to reach on each task, without a forward solve.

    Errors, per-node errors and pose errors are differentiable once in radii, lengths, limits, twists, loads and the
    base pose: by the envelope theorem the pressures found are held, but for those at a limit, which move with it.
    With several steps the shape at which the last one starts is held too, which is exact in the limit.

    Args:
        arm: designs, of any batch shape.
        task: shapes and loads, of any batch shape; every design meets every task.
        pose_cost: what is minimised; None is the paper's `PoseCost()`.
        steps: 1 makes the balance linear at the task's shape. Each further step does so at the shape that the
            last one predicted, with new pressures; in the limit the arm is in equilibrium.
        chunk_size: (design, shape, load) triples worked on at once; None chooses. Bounds memory.

    Raises:
        ValueError: an argument is none of those allowed, or arm and task differ in dtype or device.
    """
    for name, value, kind in (("arm", arm, ArmDesign), ("task", task, Task)):
        if not isinstance(value, kind):
            raise ValueError(f"{name}: must be of type {kind.__name__}, got {shown(value)}")
    ours, theirs = arm.radii, task.twists
    if ours.dtype != theirs.dtype or ours.device != theirs.device:
        raise ValueError(
            f"task: must have the arm's dtype and device, {ours.dtype} on {ours.device}, "
            f"got {theirs.dtype} on {theirs.device}; use task.to(...)"
        )
    return predict_outer(outer_product(arm, task), pose_cost, steps, chunk_size)


def predict_outer(outer: OuterProduct, cost: PoseCost | None, steps: int, chunk_size: int | None) -> PredictedError:
    """`predict_error` of checked designs and tasks."""
    cost = PoseCost() if cost is None else cost
    if not isinstance(cost, PoseCost):
        raise ValueError(f"pose_cost: must be a PoseCost, got {shown(cost)}")
    check_count("steps", steps, 1)
    weights, diagonal = cost.weights(outer.nodes, outer.twists), cost.diagonal(outer.twists)
    if chunk_size is None:
        chunk_size = max(1, BLOCK_ELEMENTS // (SCREENED * (2 * outer.nodes) ** 2))
    check_count("chunk_size", chunk_size, 1)
    if 0 in outer.sizes:
        return _nothing(outer)
    recompute = prod(outer.sizes) > chunk_size
    columns = map_blocks(outer, chunk_size, lambda block: _predict_block(block, weights, diagonal, steps, recompute))
    return PredictedError(*(outer.unflatten(column) for column in columns))


def _nothing(outer: OuterProduct) -> PredictedError:
    real = outer.arm.radii.new_zeros(outer.sizes)
    poses = real.new_zeros(*outer.sizes, outer.nodes + 1, 3)
    flag = torch.ones(outer.sizes, dtype=torch.bool, device=real.device)
    pressure = real.new_zeros(*outer.sizes, outer.arm.actuator_count)
    columns = (real, poses[..., 0], poses, pressure, poses[..., 1:, :], real, flag, flag, flag, real, flag)
    return PredictedError(*(outer.unflatten(column) for column in columns))


class _Tasks(NamedTuple):
    """The T triples of a block, one after the other."""

    arm: ArmDesign
    twists: Tensor
    tip_load: Tensor
    base_pose: Tensor

    @staticmethod
    def of(block: Block) -> "_Tasks":
        shape = (len(block.arm.radii), *block.tip_load.shape[:2])

        def spread(value: Tensor, *axes: int) -> Tensor:
            return (
                value[tuple(slice(None) if axis in axes else None for axis in range(3))]
                .expand(*shape, *value.shape[len(axes) :])
                .flatten(0, 2)
            )

        arm = block.arm._map(lambda value: spread(value, 0))
        return _Tasks(arm, spread(block.twists, 1), spread(block.tip_load, 1, 2), block.base_pose)

    def detached(self) -> "_Tasks":
        return _Tasks(
            self.arm._map(Tensor.detach), self.twists.detach(), self.tip_load.detach(), self.base_pose.detach()
        )


def _predict_block(block: Block, weights: Tensor, diagonal: Tensor, steps: int, recompute: bool) -> tuple[Tensor, ...]:
    """The fields of `PredictedError` for a block, each (d, p, l, ...)."""
    tasks = _Tasks.of(block)
    found = _minimum(tasks.detached(), weights, steps)
    again = _Replay(tasks, weights, diagonal, found)
    if _wants_gradient(tasks):
        reached = checkpoint(again, use_reentrant=False) if recompute else again()
    else:
        with torch.no_grad():
            reached = again()
    *_, pressure, twists = reached
    excess = _strain_excess(tasks, twists)
    inside = excess <= 16 * torch.finfo(excess.dtype).eps
    highest = along([model.pressure_range[1] for model in tasks.arm.actuators], excess, -1)
    in_range = inside & (pressure <= highest).all(-1)
    columns = (*reached, found.optimality, found.converged, found.stable, found.small, excess, in_range)
    shape = (len(block.arm.radii), *block.tip_load.shape[:2])
    return tuple(column.unflatten(0, shape) for column in columns)


def _strain_excess(tasks: _Tasks, twists: Tensor) -> Tensor:
    """(T,) the largest strain out of its range at twists (T, N, 3)."""
    with torch.no_grad():
        length, _, curvature = twists.unsqueeze(-2).unbind(-1)
        own = rod.offset_length(length, curvature, tasks.arm.radii.unsqueeze(-2))
        strain = rod.strain(own, tasks.arm.length.unsqueeze(-2))
        low, high = (along([m.strain_range[end] for m in tasks.arm.actuators], strain, -1) for end in (0, 1))
        return torch.maximum(low - strain, strain - high).clamp(min=0).amax((-1, -2))


# The minimum over pressures


class _Found(NamedTuple):
    """The best pressure of each of T tasks, in shares of its limit (T, M); how far from the task's shape the balance
    was linear there (T, 2, N); and fields of `PredictedError`."""

    share: Tensor
    offset: Tensor
    optimality: Tensor
    converged: Tensor
    stable: Tensor
    small: Tensor


def _minimum(tasks: _Tasks, weights: Tensor, steps: int) -> _Found:
    """Look at some pressures, follow the most promising to a minimum; and again from where that leads."""
    shape = mechanics.to_unknowns(tasks.twists)
    target = rod.poses(tasks.twists, tasks.base_pose)
    problem = _Problem(Points.of(tasks.arm, shape, target, tasks.base_pose, tasks.tip_load), weights)
    end = problem.minimise(*_start(problem))
    for _ in range(steps - 1):
        problem = problem.moved(end)
        end = problem.minimise(*_restart(problem, end.share))
    return _Found(end.share, problem.points.unknowns - shape, end.optimality, end.converged, end.stable, end.small)


def _start(problem: "_Problem") -> tuple[Tensor, Tensor]:
    """The most promising of some pressures (T, M), in shares of their limits, spread evenly over the box; and whether
    none of them is stable (T,)."""
    count, actuators = problem.points.arm.max_pressure.shape
    draws = torch.quasirandom.SobolEngine(actuators).draw(SCREENED, dtype=torch.float64).to(problem.weights)
    draws[0] = 0.5  # instead of no pressure at all
    every = torch.arange(count, device=draws.device)
    seen = problem[every.repeat_interleave(SCREENED)].look(draws.repeat(count, 1))
    stable = seen.stable.view(count, SCREENED)
    best = _rank(seen.model.value.view(count, SCREENED), stable).argmin(-1)
    return draws[best], ~stable.any(-1)


def _restart(problem: "_Problem", share: Tensor) -> tuple[Tensor, Tensor]:
    """As `_start`, with the pressures that led here wherever they are stable."""
    free = ~problem.look(share).stable
    lost = free.nonzero().squeeze(-1)
    if len(lost):
        tried, still = _start(problem[lost])
        share, free = share.clone(), free.clone()
        share[lost] = torch.where(still.unsqueeze(-1), share[lost], tried)
        free[lost] = still
    return share, free


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

    def moved(self, end: _End) -> "_Problem":
        """The balances made linear where the arms went, or on the way there if that is far."""
        points = self.points
        part = (LARGE_MOVE / size(end.move, self.length).clamp(min=1e-300)).clamp(max=1.0)
        unknowns = points.unknowns + part[:, None, None] * end.move
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
        optimality = _optimality(end.model, place, floor)
        return _End(
            place,
            end.move,
            optimality,
            optimality <= tolerance,
            end.stable,
            size(end.move, self.length) <= LARGE_MOVE,
        )


def _optimality(model: Model, share: Tensor, floor: Tensor) -> Tensor:
    """(B,) the largest slope of the error by a share, of those that the box leaves free; 0 below a floor of the error."""
    error = (2 * model.value).sqrt()
    steepest = projected(model.gradient, share).abs().amax(-1)
    return torch.where(error <= floor, torch.zeros_like(error), steepest / error.clamp(min=1e-30))


# The value at the minimum, with gradients


def _wants_gradient(tasks: _Tasks) -> bool:
    if not torch.is_grad_enabled():
        return False
    arm = tasks.arm
    inputs = (arm.radii, arm.length, arm.max_pressure, tasks.twists, tasks.tip_load, tasks.base_pose)
    if any(value.requires_grad for value in inputs):
        return True
    probe = arm.radii[:1].detach()  # a force model may hold what is asked about
    return actuator_force(arm.actuators, torch.zeros_like(probe), torch.zeros_like(probe), -1).requires_grad


@dataclass(frozen=True)
class _Replay:
    """Error, per-node and pose errors, pressure and shape of T tasks at the pressures found, as functions of designs
    and tasks: what holds at a minimum by the envelope theorem."""

    tasks: _Tasks
    weights: Tensor
    diagonal: Tensor
    found: _Found

    def __call__(self) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        tasks, share = self.tasks, self.found.share
        limit = tasks.arm.max_pressure
        pressure = torch.where(share >= 1, limit, share * limit.detach())  # what is at a limit moves with it
        unknowns = mechanics.to_unknowns(tasks.twists) + self.found.offset
        balance = mechanics.balance(
            tasks.arm,
            unknowns,
            pressure,
            tasks.tip_load,
            tasks.base_pose,
            create_graph=torch.is_grad_enabled(),
        )
        move = -mechanics.solve(balance.stiffness, balance.residual.unsqueeze(-1)).squeeze(-1)
        reached = unknowns + move
        motion = mechanics.kinematics(reached, tasks.base_pose)
        error, _ = mechanics.pose_error(motion.pose, rod.poses(tasks.twists, tasks.base_pose))
        square = error.square()
        floor = FLOORS.get(share.dtype, 1e-3) * tasks.arm.length.detach().mean(-1)
        return (
            _root((self.weights * square).sum((-2, -1)), floor),
            _root((self.diagonal * square).sum(-1), floor.unsqueeze(-1)),
            error,
            pressure,
            mechanics.to_twists(reached),
        )


def _root(square: Tensor, floor: Tensor) -> Tensor:
    """The square root; of what is no more than rounding, without a gradient: it would be one of size 1 of nothing."""
    none = square.detach() <= floor.square()
    root = torch.where(none, torch.ones_like(square), square).sqrt()
    return torch.where(none, square.detach().sqrt(), root)
