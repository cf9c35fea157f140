"""How far off the task an arm will really be, in metres: predicted from where it comes to rest near the task's shape.

Let go at the task's shape z* with pressures p, the arm moves to where its balance `R(z, p) = a(z, p) + q(z) = 0` holds.
The predicted error is the least cost of the poses there, over the pressures within their limits and the balances that
are stable. No load is raised from zero, as in the forward solver: Newton's method starts from z*, and at each further
pressure from the shape at the last one, so that a task costs a few dozen small linear solves. In return a shape that is
predicted need not be the one that the arm reaches when it is loaded: under compression there are several.
"""

from dataclasses import dataclass
from math import prod
from typing import Any

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from torcharm import mechanics
from torcharm._continuation import TOLERANCES, Problem, solved
from torcharm._inputs import check_count, shown
from torcharm._outer import Block, OuterProduct, check_arm_and_task, map_blocks, outer_product
from torcharm._predicted_minimum import FLOORS, SCREENED, Found, Tasks, minimum_over_pressures
from torcharm._response import has_lengths, size
from torcharm.actuators import want_gradients
from torcharm.actuators.bending import active_moment, passive_moment
from torcharm.arm import ArmDesign
from torcharm.geometry import rod
from torcharm.pressure.pose_cost import PoseCost
from torcharm.task import Task
from torcharm.wrenches import actuator_force, along

BLOCK_ELEMENTS = 4_000_000
"""Entries of the stiffness matrices of one block (32 MB)."""

SAME, NEARLY = 1e-2, 0.1
"""Differences of shapes, as of `size`, that count as none; and where loads are carried to first order."""


@dataclass(frozen=True, eq=False)
class PredictedError:
    """What `predict_error` found, of shape (*design batch, *task batch).

    Attributes:
        error: square root of the cost `Σ_i ω_i e_iᵀ K e_i` [m]; infinite where no stable balance was found. Where one
            was found and the search over pressures did not converge, it is what that pressure reaches: others may do
            better.
        per_node: (..., N+1) `sqrt(e_iᵀ K e_i)` of each pose [m]; infinite as the error is.
        pose_errors: (..., N+1, 3) `e_i = (x, y, θ)`, the target seen from the pose predicted [m, m, rad]; NaN where
            no stable balance was found.
        pressure: (..., M) that reaches it [kPa]; where nothing was found, the last that was tried.
        twists: (..., N, 3) of the shape predicted; where nothing was found, no more than where Newton's method stopped.
        optimality: largest slope of the error by a pressure in shares of its limit [m], of those that
            the limits leave free.
        converged: whether the optimality is within tolerance and the balance was solved. A minimum at a kink of a
            force model, or where stability ends, does not count as converged.
        stable: whether the task is possible (every actuator's length is above 0), and the balance was solved with
            such lengths, and -J, of `J = ∂R/∂z`, is positive definite
            there, by more than rounding. Only such balances are believed: false means that none was found. An arm that
            resists nothing has none, nor has one whose force is not a number.
        reached: whether it is stable, and `solve_equilibrium` leads there: the pressure raised first, then the load.
            False where the arm comes to rest elsewhere, as under compression, where there are several equilibria, or
            snaps on the way: then a search that follows the arm as it is loaded need not find what is predicted.
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
    reached: Tensor
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
    the load is held too. At a kink of a force model they are those of one side.
    That holds at a minimum only: **gradients of predictions that are not converged and stable are NaN**, unless
    nothing depends on them, as where `torch.where(found.converged & found.stable, found.error, 0.0)` leaves them out.

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
    columns = (real, poses[..., 0], poses, pressure, poses[..., 1:, :], real, flag, flag, flag, flag, real, flag)
    return PredictedError(*(outer.unflatten(column) for column in columns))


def _predict_block(
    block: Block, weights: Tensor, diagonal: Tensor, steps: int | None, recompute: bool
) -> tuple[Tensor, ...]:
    """The fields of `PredictedError` for a block, each (d, p, l, ...)."""
    tasks = Tasks.of(block)
    found = minimum_over_pressures(tasks.detached(), weights, steps)
    exact = steps is None
    with torch.no_grad():
        reached: tuple[Tensor, ...] = _Replay(tasks, weights, diagonal, found, exact)()
        known = reached[0].isfinite() & has_lengths(tasks.arm, mechanics.to_unknowns(tasks.twists))
    stable, converged = found.stable & known, found.converged & known
    excess = _strain_excess(tasks, reached[-1])
    reached = _without_answer(reached, ~stable)
    if _wants_gradient(tasks):
        reached = _with_gradient(tasks, weights, diagonal, found, exact, reached, converged & stable, recompute)
    *_, pressure, twists = reached
    inside = excess <= 16 * torch.finfo(excess.dtype).eps
    highest = along([model.pressure_range[1] for model in tasks.arm.actuators], excess, -1)
    in_range = inside & (pressure <= highest).all(-1)
    arrived = _is_reached(tasks.detached(), pressure.detach(), twists.detach(), stable, exact=exact)
    columns = (*reached, found.optimality, converged, stable, arrived, found.small, excess, in_range)
    shape = (len(block.arm.radii), *block.tip_load.shape[:2])
    return tuple(column.unflatten(0, shape) for column in columns)


def _without_answer(reached: tuple[Tensor, ...], lost: Tensor) -> tuple[Tensor, ...]:
    """Errors that are infinite, and pose errors that are no numbers, where there is no equilibrium (T,)."""
    error, per_node, pose_errors, *rest = reached
    error = error.masked_fill(lost, float("inf"))
    per_node = per_node.masked_fill(lost[:, None], float("inf"))
    return error, per_node, pose_errors.masked_fill(lost[:, None, None], float("nan")), *rest


def _is_reached(tasks: Tasks, pressure: Tensor, twists: Tensor, stable: Tensor, *, exact: bool) -> Tensor:
    """(T,) whether arms that are stable (T,) at twists come there when they are loaded."""
    some = stable.nonzero().squeeze(-1)
    reached = torch.zeros_like(stable)
    if len(some):
        own, base = tasks.chosen(some), tasks.base_pose.expand(len(some), 3)
        tolerance = TOLERANCES.get(pressure.dtype, 1e-2)
        problem = Problem.of(own.arm, pressure[some], own.tip_load, base, None, tolerance)
        with torch.no_grad():
            found = solved(problem, twists.shape[-2])
        move = size(found.unknowns - mechanics.to_unknowns(twists[some]), problem.length)
        reached[some] = found.continued & found.stable & (move <= (SAME if exact else NEARLY))
    return reached


def _strain_excess(tasks: Tasks, twists: Tensor) -> Tensor:
    """(T,) the largest strain out of its range at twists (T, N, 3)."""
    with torch.no_grad():
        length, _, curvature = twists.unsqueeze(-2).unbind(-1)
        own = rod.offset_length(length, curvature, tasks.arm.radii.unsqueeze(-2))
        strain = rod.strain(own, tasks.arm.length.unsqueeze(-2))
        low, high = (along([m.strain_range[end] for m in tasks.arm.actuators], strain, -1) for end in (0, 1))
        return torch.maximum(low - strain, strain - high).clamp(min=0).amax((-1, -2))


# The value at the minimum, with gradients


def _sources(tasks: Tasks) -> tuple[Tensor, ...]:
    """All that a prediction may depend on: what force models hold shows in their forces and moments."""
    arm = tasks.arm
    probe = torch.zeros_like(arm.radii[:1].detach())
    force = actuator_force(arm.actuators, probe, probe, -1)
    stiffness = [model.bending_stiffness for model in arm.actuators]
    moments = [m for k in stiffness for m in (active_moment(k, probe), passive_moment(k, probe)) if m is not None]
    held = (force, *moments, *(model.max_pressure for model in arm.actuators if isinstance(model.max_pressure, Tensor)))
    return arm.radii, arm.length, arm.max_pressure, tasks.twists, tasks.tip_load, tasks.base_pose, *held


def _wants_gradient(tasks: Tasks) -> bool:
    arm = tasks.arm
    inputs = (arm.radii, arm.length, arm.max_pressure, tasks.twists, tasks.tip_load, tasks.base_pose)
    wanted = torch.is_grad_enabled() and any(value.requires_grad for value in inputs)
    return wanted or want_gradients(arm.actuators, arm.radii)


def _with_gradient(
    tasks: Tasks,
    weights: Tensor,
    diagonal: Tensor,
    found: Found,
    exact: bool,
    reached: tuple[Tensor, ...],
    known: Tensor,
    recompute: bool,
) -> tuple[Tensor, ...]:
    """The same numbers, with the gradients of those that are known (T,), and NaN as that of the others."""
    (yes,), (no,) = known.nonzero(as_tuple=True), (~known).nonzero(as_tuple=True)
    again = _Replay(tasks.chosen(yes), weights, diagonal, Found(*(column[yes] for column in found)), exact)
    new = checkpoint(again, use_reentrant=False) if recompute else again()
    if not len(no):
        return new
    sources = _sources(tasks.chosen(no))
    columns = []
    for old, value in zip(reached, new, strict=True):
        lost = _Unknown.apply(old[no], *sources)
        columns.append(torch.zeros_like(old).index_copy(0, yes, value).index_copy(0, no, lost))
    return tuple(columns)


class _Unknown(torch.autograd.Function):
    """Numbers (T, ...) whose gradient is not known: NaN for all that a number depends on, if it is asked about."""

    @staticmethod
    def forward(ctx: Any, value: Tensor, *sources: Tensor) -> Tensor:
        ctx.sources = [(source.shape, source.dtype, source.device) for source in sources]
        return value.clone()

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        asked = (gradient != 0).reshape(len(gradient), -1).any(-1)
        lost: list[Tensor | None] = [None]
        for needed, (shape, dtype, device) in zip(ctx.needs_input_grad[1:], ctx.sources, strict=True):
            own = asked if shape[:1] == asked.shape and len(shape) > 1 else asked.any()
            none = torch.zeros(shape, dtype=dtype, device=device)
            own = own.view(-1, *[1] * (len(shape) - 1)) if own.ndim else own
            lost.append(none.masked_fill(own, float("nan")) if needed else None)
        return tuple(lost)


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
