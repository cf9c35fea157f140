"""Pressure search: the pressure that brings an arm closest to a task, through its forward mechanics."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import prod

import torch
from torch import Tensor

from torcharm import mechanics
from torcharm._branch_search import search_block
from torcharm._continuation import TOLERANCES, Problem, can_compile, default_chunk, stays, strain_excess
from torcharm._descent import Goal
from torcharm._inputs import check_above_zero, check_choice, check_count, check_flag
from torcharm._outer import OuterProduct, check_arm_and_task, outer_product
from torcharm._response import has_lengths
from torcharm.arm import ArmDesign
from torcharm.equilibrium import NotConvergedError
from torcharm.geometry import rod
from torcharm.pressure.pose_cost import PoseCost
from torcharm.task import Task

METHODS = ("batched", "scipy")
STARTS = {"batched": 8, "scipy": 1}
CHUNK_SHARE = 4
"""Work on a start, in equilibria at once."""


@dataclass(frozen=True, eq=False)
class PressureSearch:
    """What `search_pressure` found; `batch` is (*design batch, *task batch).

    Attributes:
        pressure: (*batch, M) the best [kPa].
        cost: (*batch) `Σ ω_i e_iᵀ K e_i` there [m²]; infinite where no equilibrium was found.
        twists: (*batch, N, 3) the equilibrium at this pressure [m, m, rad].
        residual: (*batch) its imbalance, as of `solve_equilibrium`.
        continued: (*batch) whether continuation from zero load reaches it.
        converged: (*batch) whether it is a stable equilibrium, and the descent to it came to its end. False where
            the best descent leads on to where continuation does not follow: the pressure then is next to a jump.
        optimality: (*batch) first-order optimality [m²]: the largest entry of the projected gradient, by pressures as
            shares of their limits. At a kink of a force model it does not vanish.
        start_cost: (*batch, S) what each start came to by itself, without rounds; infinite where it failed.
        in_range: (*batch) as of `solve_equilibrium`.
        tip_error: (*batch) distance of the tip from the task's [m]; infinite where no equilibrium was found.
        stable: (*batch) whether the arm stays there, as of `solve_equilibrium`.
    """

    pressure: Tensor
    cost: Tensor
    twists: Tensor
    residual: Tensor
    continued: Tensor
    converged: Tensor
    optimality: Tensor
    start_cost: Tensor
    in_range: Tensor
    tip_error: Tensor
    stable: Tensor

    @property
    def spread(self) -> Tensor:
        """(*batch) median cost of the starts that succeeded, less the best: 0 if most starts agree; NaN if none did."""
        known = torch.where(self.start_cost.isfinite(), self.start_cost, self.start_cost.new_tensor(float("nan")))
        return known.nanmedian(-1).values - self.cost


def search_pressure(
    arm: ArmDesign,
    task: Task,
    method: str = "batched",
    *,
    starts: int | None = None,
    hops: int = 5,
    node_weights: str | Tensor | Sequence[float] = "ramp",
    error_weights: Sequence[float] = (1.0, 1.0, 0.05),
    shear_stiffness: float | None = None,
    seed: int = 0,
    scipy_method: str = "L-BFGS-B",
    progress: bool | None = None,
    raise_on_failure: bool = False,
    chunk_size: int | None = None,
    compiled: bool = False,
) -> PressureSearch:
    """The pressure within the limits that brings each design closest to each task.

    Minimises `Σ_i ω_i e_iᵀ K e_i` over `p ∈ [0, p̄]`, with `e_i = (x, y, θ)` of `ĝ_i(p)⁻¹ g_i*` and ĝ(p) the
    equilibrium under the task's load. The cost is not convex: both methods find local minima, the best of several
    starts. The shape returned is the one that continuation from zero load reaches (see `solve_equilibrium`).

    Results hold no graph: they are not differentiable; `predict_error` is.

    "batched" descends from all starts of all tasks at once, by projected Levenberg-Marquardt steps in pressures and
    shapes together. Of pressures that are promising to first order at the task shape, or spread over the box, the best
    are its starts; of two or more, the last begins at the task shape itself. Ends are confirmed by continuation. Under
    compression it may lead elsewhere: an arm buckles to one side or to the other, and the best pressures often lie
    where that is decided. There the cost jumps. The boundary is found by Newton's method, as where the equilibria on
    the way bifurcate, and the search goes on along it, in rounds; it is not `converged`. Next to the boundary
    continuation may fail; pressures that it lost are tried with `solve_equilibrium` at last, and may have snapped.
    "scipy" is the paper's baseline, one pressure at a time: `scipy.optimize.minimize` with finite differences, from
    the middle of the box and, for more starts, from points spread over it.

    Args:
        arm: designs, of any batch shape.
        task: tasks, of any batch shape; the search is an outer product.
        method: "batched" or "scipy".
        starts: S, the number of descents; None takes 8 (batched) or 1 (scipy).
        hops: rounds at most, after the first descents, for what is not at its end: descents that go on, and moves to,
            across and along boundaries (batched).
        node_weights: ω. "ramp" is `linspace(0, 1, N)` on nodes 1 to N (the paper's validation), "uniform" ones on these
            (its shape study), "tip" the tip alone; or N or N+1 numbers, the last of N+1 for the tip.
        error_weights: K's diagonal, on x², y² [1] and θ² [m²/rad²]; (1, 1, 0) counts positions only.
        shear_stiffness: as for `solve_equilibrium`.
        seed: of the pressures that are drawn.
        scipy_method: a bounded method of `scipy.optimize.minimize`.
        progress: whether to show a bar; None shows one for "scipy", on a terminal.
        raise_on_failure: makes it an error if any search does not converge.
        chunk_size: searches worked on at once (batched); None chooses. Bounds memory.
        compiled: whether the work is done by machine code: the same answers, six to twelve times as fast, in as many
            threads as PyTorch takes. It is compiled for half a minute to two at the very first
            search; later ones, of other processes, too, find the code on disk. For arms of `Bellows`,
            `PolynomialActuator` and `McKibben` whose bending stiffness is a number, without shear, in double precision
            on the CPU; others are searched as without it.

    Raises:
        ValueError: an argument is none of those allowed, or arm and task differ in dtype or device.
        NotConvergedError: see `raise_on_failure`.
    """
    check_choice("method", method, METHODS)
    check_count("hops", hops, 0)
    count = STARTS[method] if starts is None else check_count("starts", starts, 1)
    check_count("seed", seed, 0)
    outer = checked_outer(arm, task)
    weight = PoseCost(node_weights, error_weights).weights(outer.nodes, outer.twists).sqrt()
    shear_stiffness = check_above_zero("shear_stiffness", shear_stiffness)
    check_flag("raise_on_failure", raise_on_failure)
    check_flag("compiled", compiled)
    if progress is not None:
        check_flag("progress", progress)
    if chunk_size is not None:
        chunk_size = check_count("chunk_size", chunk_size, 1)
    problem, shape = flat_problem(outer, shear_stiffness)
    target = outer_poses(outer)
    goal = Goal.of(target, weight)
    total = len(problem.pressure)
    problem = replace(problem, compiled=compiled and can_compile(problem))
    if method == "scipy":
        from torcharm._search_scipy import search_one_by_one

        found = search_one_by_one(problem, goal, outer.nodes, count, seed, scipy_method, progress)
    else:
        chunk = max(1, default_chunk(outer.nodes, problem.components) // (CHUNK_SHARE * count))
        chunk = chunk if chunk_size is None else chunk_size
        index = torch.arange(total, device=weight.device).split(chunk)
        with torch.no_grad():
            parts = [_block(problem[at], goal[at], shape[at], count, hops, seed) for at in index if total]
        found = tuple(torch.cat(column) for column in zip(*parts, strict=True))
        found = found or empty_result(problem, outer.nodes, count)
    tip = rod.poses(found[2], problem.base_pose)[:, -1, :2]
    distance = (tip - goal.target[:2, -1].mT).norm(dim=-1)
    stable, possible = _stability(replace(problem, pressure=found[0]), found[2])
    stable = stable & found[1].isfinite()
    found = found[0], found[1].masked_fill(~possible, float("inf")), *found[2:5], found[5] & stable, *found[6:]
    found = (*found, torch.where(found[1].isfinite(), distance, float("inf")), stable)
    result = PressureSearch(*(outer.unflatten(value.reshape(*outer.sizes, *value.shape[1:])) for value in found))
    failed = total - int(result.converged.sum())
    if raise_on_failure and failed:
        raise NotConvergedError(f"{failed} of {total} searches did not converge")
    return result


def _stability(problem: Problem, twists: Tensor) -> tuple[Tensor, Tensor]:
    """(B,) whether arms stay at equilibria, and whether all of their lengths are above 0."""
    unknowns = mechanics.to_unknowns(twists, shear=problem.components == 3)
    possible = has_lengths(problem.arm, unknowns)
    every = torch.arange(len(unknowns), device=unknowns.device).split(
        default_chunk(unknowns.shape[-1], unknowns.shape[1])
    )
    stable = [stays(problem[part], unknowns[part]) for part in every] if len(unknowns) else [possible]
    return torch.cat(stable) & possible, possible


def empty_result(problem: Problem, nodes: int, starts: int) -> tuple[Tensor, ...]:
    """The tensors of no search at all."""
    real, flag = problem.pressure.new_zeros(0), torch.zeros(0, dtype=torch.bool, device=problem.pressure.device)
    return (
        problem.pressure,
        real,
        real.view(0, 1, 1).expand(0, nodes, 3),
        real,
        flag,
        flag,
        real,
        real.view(0, 1).expand(0, starts),
        flag,
    )


def checked_outer(arm: ArmDesign, task: Task) -> OuterProduct:
    """Every design against every task, without their graphs."""
    check_arm_and_task(arm, task)
    return outer_product(arm._map(torch.Tensor.detach), task._map(torch.Tensor.detach))


def outer_poses(outer: OuterProduct) -> Tensor:
    """(B, N+1, 3) the task's poses for every design and load."""
    poses = rod.poses(outer.twists, outer.base_pose)[None, :, None]
    return poses.expand(*outer.sizes, *poses.shape[-2:]).reshape(-1, *poses.shape[-2:])


def flat_problem(outer: OuterProduct, shear_stiffness: float | None) -> tuple[Problem, Tensor]:
    """The B = D·P·L pairs of a design and a task, with the limits as pressures, and the unknowns of the task shapes."""
    sizes = outer.sizes
    total = prod(sizes)

    def spread(value: Tensor, *dims: int) -> Tensor:
        """To (B, data), from a tensor whose dimensions before the data are these of (D, P, L)."""
        shape = [size if axis in dims else 1 for axis, size in enumerate(sizes)]
        data = value.shape[len(dims) :]
        return value.reshape(*shape, *data).expand(*sizes, *data).reshape(total, *data)

    arm = outer.arm._map(lambda value: spread(value, 0))
    base = outer.base_pose.expand(total, 3)
    tolerance = TOLERANCES.get(base.dtype, 1e-2)
    problem = Problem.of(arm, arm.max_pressure, spread(outer.tip_load, 1, 2), base, shear_stiffness, tolerance)
    return problem, mechanics.to_unknowns(spread(outer.twists, 1), shear=shear_stiffness is not None)


def _block(problem: Problem, goal: Goal, shape: Tensor, starts: int, hops: int, seed: int) -> tuple[Tensor, ...]:
    """The columns of `PressureSearch`, but for the last, of some of the searches."""
    found = search_block(problem, goal, shape, starts, hops, seed)
    pressure = found.place * problem.arm.max_pressure
    there = replace(problem, pressure=pressure)
    residual = there.imbalance(there.residual(found.unknowns))
    within = strain_excess(there, found.unknowns)[1]
    sound = residual <= problem.tolerance
    return (
        pressure,
        torch.where(sound, found.cost, float("inf")),
        mechanics.to_twists(found.unknowns),
        residual,
        found.continued & sound,
        found.converged & sound,
        found.optimality,
        found.start_cost,
        within,
    )
