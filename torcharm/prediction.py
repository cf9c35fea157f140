"""How far off the task an arm will really be, in metres: predicted from where it comes to rest near the task's shape.

Let go at the task's shape z* with pressures p, the arm moves to where its balance `R(z, p) = a(z, p) + q(z) = 0` holds.
The predicted error is the least cost of the poses there, over the pressures within their limits and the balances that
are stable. No load is raised from zero, as in the forward solver: Newton's method starts from z*, and at each further
pressure from the shape at the last one, so that a task costs a few dozen small linear solves. In return a shape that is
predicted need not be the one that the arm reaches when it is loaded: under compression there are several.
"""

from dataclasses import dataclass
from math import prod

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from torcharm import mechanics, rod
from torcharm._inputs import check_count, shown
from torcharm._outer import Block, OuterProduct, check_arm_and_task, map_blocks, outer_product
from torcharm._predicted_minimum import FLOORS, SCREENED, Found, Tasks, minimum_over_pressures
from torcharm.actuators import want_gradients
from torcharm.arm import ArmDesign
from torcharm.pose_cost import PoseCost
from torcharm.task import Task
from torcharm.wrenches import along

BLOCK_ELEMENTS = 4_000_000
"""Entries of the stiffness matrices of one block (32 MB)."""


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
        converged: whether the optimality is within tolerance and the balance was solved. A minimum at a kink of a
            force model, or where stability ends, does not count as converged.
        stable: whether the balance was solved and -J, of `J = ∂R/∂z`, is positive definite there. Only such balances
            are believed: false means that none was found, and that the error is no more than a hint.
        small: whether the arm moves little (by a radian, or a third of its length) from where the load was last made
            linear: the task's shape, unless there are several steps.
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
    arm: ArmDesign,
    task: Task,
    pose_cost: PoseCost | None = None,
    *,
    steps: int | None = None,
    chunk_size: int | None = None,
) -> PredictedError:
    """The least pose error that each design can be expected to reach on each task, without a forward solve.

    Errors, per-node errors and pose errors are differentiable once in radii, lengths, limits, twists, loads, the base
    pose and whatever force models hold: by the envelope theorem the pressures found are held, but for those at a limit,
    which move with it, and the shape follows its balance. With several steps the shape from which the last one carries
    the load is held too.
    At a kink of a force model they are those of one side.

    Args:
        arm: designs, of any batch shape.
        task: shapes and loads, of any batch shape; every design meets every task.
        pose_cost: what is minimised; None is the paper's `PoseCost()`.
        steps: None solves the balance itself. A number carries the load to first order (actuators obey their full
            law): 1 from the task's shape, each further step from the shape that the last one predicted, with new
            pressures. In the limit it is the balance itself.
        chunk_size: (design, shape, load) triples worked on at once; None chooses. Bounds memory.

    Raises:
        ValueError: an argument is none of those allowed, or arm and task differ in dtype or device.
    """
    check_arm_and_task(arm, task)
    return predict_outer(outer_product(arm, task), pose_cost, steps, chunk_size)


def predict_outer(
    outer: OuterProduct, cost: PoseCost | None, steps: int | None, chunk_size: int | None
) -> PredictedError:
    """`predict_error` of checked designs and tasks."""
    cost = PoseCost() if cost is None else cost
    if not isinstance(cost, PoseCost):
        raise ValueError(f"pose_cost: must be a PoseCost, got {shown(cost)}")
    if steps is not None:
        check_count("steps", steps, 1)
    weights, diagonal = cost.weights(outer.nodes, outer.twists), cost.diagonal(outer.twists)
    if chunk_size is None:
        chunk_size = max(1, BLOCK_ELEMENTS // (SCREENED[0] * (2 * outer.nodes) ** 2))
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


def _predict_block(
    block: Block, weights: Tensor, diagonal: Tensor, steps: int | None, recompute: bool
) -> tuple[Tensor, ...]:
    """The fields of `PredictedError` for a block, each (d, p, l, ...)."""
    tasks = Tasks.of(block)
    with torch.no_grad():
        found = minimum_over_pressures(tasks.detached(), weights, steps)
    again = _Replay(tasks, weights, diagonal, found, steps is None)
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


def _strain_excess(tasks: Tasks, twists: Tensor) -> Tensor:
    """(T,) the largest strain out of its range at twists (T, N, 3)."""
    with torch.no_grad():
        length, _, curvature = twists.unsqueeze(-2).unbind(-1)
        own = rod.offset_length(length, curvature, tasks.arm.radii.unsqueeze(-2))
        strain = rod.strain(own, tasks.arm.length.unsqueeze(-2))
        low, high = (along([m.strain_range[end] for m in tasks.arm.actuators], strain, -1) for end in (0, 1))
        return torch.maximum(low - strain, strain - high).clamp(min=0).amax((-1, -2))


# The value at the minimum, with gradients


def _wants_gradient(tasks: Tasks) -> bool:
    if not torch.is_grad_enabled():
        return False
    arm = tasks.arm
    inputs = (arm.radii, arm.length, arm.max_pressure, tasks.twists, tasks.tip_load, tasks.base_pose)
    return any(value.requires_grad for value in inputs) or want_gradients(arm.actuators, arm.radii)


@dataclass(frozen=True)
class _Replay:
    """Error, per-node and pose errors, pressure and shape of T tasks at the pressures found, as functions of designs
    and tasks: what holds at a minimum by the envelope theorem."""

    tasks: Tasks
    weights: Tensor
    diagonal: Tensor
    found: Found
    exact: bool

    def __call__(self) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        tasks, share = self.tasks, self.found.share
        limit = tasks.arm.max_pressure
        pressure = torch.where(share >= 1, limit, share * limit.detach())  # what is at a limit moves with it
        shape = mechanics.to_unknowns(tasks.twists)
        reached = shape + self.found.rest_at
        if torch.is_grad_enabled():
            reached = reached + self._followed(shape + self.found.linear_at, reached, pressure)
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

    def _followed(self, linear_at: Tensor, reached: Tensor, pressure: Tensor) -> Tensor:
        """Nothing in value; its gradient makes `reached` follow its balance: `-J⁻¹ (R - R°)`, with R° held."""
        tasks, end = self.tasks, reached.detach()
        wrench = mechanics.actuator_wrench(tasks.arm, reached, pressure)
        if self.exact:
            load = mechanics.load_part(mechanics.kinematics(reached, tasks.base_pose), tasks.tip_load)
            residual = wrench + load.wrench
        else:
            load = mechanics.load_part(mechanics.kinematics(linear_at, tasks.base_pose), tasks.tip_load)
            moved = (reached - linear_at).flatten(1).unsqueeze(-1)
            residual = wrench + load.wrench + (load.stiffness.flatten(3).flatten(1, 2) @ moved).view_as(wrench)
        own = mechanics.actuator_part(tasks.arm._map(Tensor.detach), end, pressure.detach(), pressure_slope=False)
        stiffness = mechanics.assemble(load.stiffness.detach(), own.stiffness)
        return -mechanics.solve(stiffness, (residual - residual.detach()).unsqueeze(-1)).squeeze(-1)


def _root(square: Tensor, floor: Tensor) -> Tensor:
    """The square root; of what is no more than rounding, without a gradient: it would be one of size 1 of nothing."""
    none = square.detach() <= floor.square()
    root = torch.where(none, torch.ones_like(square), square).sqrt()
    return torch.where(none, square.detach().sqrt(), root)
