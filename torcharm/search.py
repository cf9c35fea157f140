"""Pressure search: the pressure that brings an arm closest to a task, through its forward mechanics."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import prod
from typing import NamedTuple

import torch
from torch import Tensor

from torcharm import mechanics, rod
from torcharm._box import spread_points
from torcharm._continuation import LOOKS, Problem, loaded, unloaded
from torcharm._descent import Descended, Goal, descend
from torcharm._inputs import check_choice, check_count, shown
from torcharm._outer import OuterProduct, check_arm_and_task, outer_product
from torcharm.arm import ArmDesign
from torcharm.equilibrium import TOLERANCES, NotConvergedError, default_chunk, solved
from torcharm.pose_cost import PoseCost
from torcharm.task import Task

METHODS = ("batched", "scipy")
STARTS = {"batched": 8, "scipy": 1}
CANDIDATES = 16
"""Pressures that compete for each start."""
ROUGH_GAIN, ROUGH_LOOKS = 1e-3, 30
"""Of the descents from all starts: relative decrease at which they end, and evaluations of the balance."""
START_LOOKS = 40
"""Evaluations of the balance on the way to a start."""
FINE_GAIN, FINE_LOOKS = 1e-12, 80
"""The same, of the descent from the best of them."""
REPAIRS = 2
"""Times that a descent which left the branch is begun anew from the branch."""
SAME_SHAPE = 1e-6
"""Twists [m, rad] that differ by less are of one branch."""


@dataclass(frozen=True, eq=False)
class PressureSearch:
    """What `search_pressure` found; `batch` is (*design batch, *task batch).

    Attributes:
        pressure: (*batch, M) the best [kPa].
        cost: (*batch) `Σ ω_i e_iᵀ K e_i` there [m²]; infinite where no equilibrium was found.
        twists: (*batch, N, 3) the equilibrium at this pressure [m, m, rad].
        residual: (*batch) its imbalance, as of `solve_equilibrium`.
        continued: (*batch) whether continuation from zero load reaches it.
        converged: (*batch) whether it is an equilibrium, and the descent to it came to its end.
        optimality: (*batch) first-order optimality [m²]: the largest entry of the projected gradient, by pressures as
            shares of their limits. At a kink of a force model it does not vanish.
        start_cost: (*batch, S) what each start came to; infinite where it failed.
        in_range: (*batch) as of `solve_equilibrium`.
        tip_error: (*batch) distance of the tip from the task's [m].
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

    @property
    def spread(self) -> Tensor:
        """(*batch) median cost of the starts that succeeded, less the best: 0 if most starts agree."""
        known = torch.where(self.start_cost.isfinite(), self.start_cost, self.start_cost.new_tensor(float("nan")))
        return known.nanmedian(-1).values - self.cost


def search_pressure(
    arm: ArmDesign,
    task: Task,
    method: str = "batched",
    *,
    starts: int | None = None,
    hops: int = 2,
    node_weights: str | Tensor | Sequence[float] = "ramp",
    error_weights: Sequence[float] = (1.0, 1.0, 0.05),
    shear_stiffness: float | None = None,
    seed: int = 0,
    scipy_method: str = "L-BFGS-B",
    progress: bool | None = None,
    raise_on_failure: bool = False,
    chunk_size: int | None = None,
) -> PressureSearch:
    """The pressure within the limits that brings each design closest to each task.

    Minimises `Σ_i ω_i e_iᵀ K e_i` over `p ∈ [0, p̄]`, with `e_i = (x, y, θ)` of `ĝ_i(p)⁻¹ g_i*` and ĝ(p) the
    equilibrium under the task's load. The cost is not convex: both methods find local minima, the best of several
    starts. The shape returned is the one that continuation from zero load reaches (see `solve_equilibrium`).

    "batched" descends from all starts of all tasks at once, by projected Levenberg-Marquardt with implicit
    derivatives along warm-started equilibria. Half of its starts are the best of many pressures by the error to first
    order at the task shape, the others are spread over the box. "scipy" is the paper's baseline, one pressure at a
    time: `scipy.optimize.minimize` with finite differences, from the middle of the box and, for more starts, from
    points spread over it.

    Args:
        arm: designs, of any batch shape.
        task: tasks, of any batch shape; the search is an outer product.
        method: "batched" or "scipy".
        starts: S; None takes 8 (batched) or 1 (scipy).
        hops: times that as many more descents start around the best so far (batched).
        node_weights: ω. "ramp" is `linspace(0, 1, N)` on nodes 1 to N (the paper's validation), "uniform" ones on these
            (its shape study), "tip" the tip alone; or N or N+1 numbers, the last of N+1 for the tip.
        error_weights: K's diagonal, on x², y² [1] and θ² [m²/rad²]; (1, 1, 0) counts positions only.
        shear_stiffness: as for `solve_equilibrium`.
        seed: of the spread starts.
        scipy_method: a bounded method of `scipy.optimize.minimize`.
        progress: whether to show a bar; None shows one for "scipy", on a terminal.
        raise_on_failure: makes it an error if any search does not converge.
        chunk_size: searches worked on at once (batched); None chooses. Bounds memory.

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
    if shear_stiffness is not None and not (
        isinstance(shear_stiffness, (int, float)) and 0 < shear_stiffness < float("inf")
    ):
        raise ValueError(f"shear_stiffness: must be a finite number above 0, or None, got {shown(shear_stiffness)}")
    problem, shape = flat_problem(outer, shear_stiffness)
    target = outer_poses(outer)
    goal = Goal(target, weight.expand(len(target), *weight.shape))
    total = len(problem.pressure)
    if method == "scipy":
        from torcharm._search_scipy import search_one_by_one

        found = search_one_by_one(problem, goal, outer.nodes, count, seed, scipy_method, progress)
    else:
        chunk = max(1, default_chunk(outer.nodes, problem.components) // count)
        chunk = chunk if chunk_size is None else check_count("chunk_size", chunk_size, 1)
        index = torch.arange(total, device=weight.device).split(chunk)
        with torch.no_grad():
            parts = [_search_block(problem[at], goal[at], shape[at], count, hops, seed) for at in index if total]
        found = tuple(torch.cat(column) for column in zip(*parts, strict=True))
        found = found or empty_result(problem, outer.nodes, count * (1 + hops))
    tip = rod.poses(found[2], problem.base_pose)[:, -1, :2]
    found = (*found, (tip - goal.target[:, -1, :2]).norm(dim=-1))
    result = PressureSearch(*(outer.unflatten(value.reshape(*outer.sizes, *value.shape[1:])) for value in found))
    failed = total - int(result.converged.sum())
    if raise_on_failure and failed:
        raise NotConvergedError(f"{failed} of {total} searches did not converge")
    return result


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


# The batched search


def _search_block(problem: Problem, goal: Goal, shape: Tensor, starts: int, hops: int, seed: int) -> tuple[Tensor, ...]:
    nodes = shape.shape[-1]
    places = _starts(problem, goal, shape, starts, seed)  # (B, S, M)
    found = _from_starts(problem, goal, nodes, places)
    for hop in range(hops):
        around = _around_best(found, starts, seed + 1 + hop)
        more = _from_starts(problem, goal, nodes, around)
        found = Descended(*(torch.cat(pair, 1) for pair in zip(found, more, strict=True)))
    return _best(problem, goal, found)


def _from_starts(problem: Problem, goal: Goal, nodes: int, places: Tensor) -> Descended:
    """Where the descents from (B, S, M) shares of the limits end, all tensors (B, S, ...)."""
    total, starts = places.shape[:2]
    every = torch.arange(total, device=places.device).repeat_interleave(starts)
    many, aims, place = problem[every], goal[every], places.flatten(0, 1)
    many = replace(many, pressure=place * many.arm.max_pressure)
    begun = loaded(many, unloaded(many, START_LOOKS).unknowns.expand(-1, -1, nodes).contiguous(), START_LOOKS)
    end = descend(
        many, aims, place, begun.unknowns, gain=ROUGH_GAIN, looks=ROUGH_LOOKS
    )  # what is no equilibrium yet becomes one, or fails
    return Descended(*(value.unflatten(0, (total, starts)) for value in end))


def _around_best(found: Descended, starts: int, seed: int) -> Tensor:
    """(B, S, M) places around the best so far: near it, where a descent was held up by the end of its branch."""
    best = found.cost.argmin(-1)
    middle = found.place[torch.arange(len(best), device=best.device), best].unsqueeze(1)
    generator = torch.Generator().manual_seed(seed)
    noise = torch.randn(starts, middle.shape[-1], generator=generator).to(middle)
    reach = torch.logspace(-1.5, -0.3, starts).to(middle).unsqueeze(-1)
    return (middle + reach * noise).clamp(0, 1)


def _starts(problem: Problem, goal: Goal, shape: Tensor, starts: int, seed: int) -> Tensor:
    """(B, S, M) shares of the limits: the best by the error to first order, one of each lot, and points spread out."""
    size = problem.pressure.shape[-1]
    guided = (starts + 1) // 2
    spread = spread_points(starts - guided + 1, size, shape, seed)[: starts - guided]
    pool = torch.rand(guided * CANDIDATES, size, generator=torch.Generator().manual_seed(seed)).to(shape)
    pool = (1.2 * pool - 0.1).clamp(0, 1)  # the bounds are where optima like to be
    expected = _expected_cost(problem, goal, shape, pool).unflatten(1, (guided, CANDIDATES))
    chosen = expected.nan_to_num(nan=float("inf")).argmin(-1)  # (B, G)
    lots = pool.unflatten(0, (guided, CANDIDATES))
    best = lots[torch.arange(guided, device=pool.device), chosen]
    return torch.cat((best, spread.expand(len(best), -1, -1)), 1)


def _expected_cost(problem: Problem, goal: Goal, shape: Tensor, places: Tensor) -> Tensor:
    """(B, Q) the cost of Q pressures to first order at the task shape: twists move by `-J⁻¹R`."""
    motion = mechanics.kinematics(shape, problem.base_pose)
    load = mechanics.load_part(motion, problem.tip_load, shear=problem.components == 3)
    columns = []
    for place in places:
        own = mechanics.actuator_part(
            problem.arm, shape, place * problem.arm.max_pressure, problem.shear_stiffness, pressure_slope=False
        )
        right = (own.wrench + load.wrench).unsqueeze(-1)
        change = -mechanics.solve(mechanics.assemble(load.stiffness, own.stiffness), right)
        moved = mechanics.pose_change(motion, change).squeeze(-1).mT  # (B, N+1, 3)
        columns.append((goal.weight * moved).square().sum((-1, -2)))
    return torch.stack(columns, 1)


def _best(problem: Problem, goal: Goal, found: Descended) -> tuple[Tensor, ...]:
    """The best start of each, descended to the end, and confirmed by continuation from zero load.

    Where continuation leads elsewhere, all starts of that search take the equilibria it leads to, and the best of
    them descends anew; what was confirmed before is kept if it is better.
    """
    total, starts = found.cost.shape
    row = torch.arange(total, device=found.cost.device)
    _refine(problem, goal, found, row)
    kept = _check(problem, goal, found, row, found.cost.argmin(-1))
    lost = row[~kept.same]
    for turn in range(REPAIRS):
        if not len(lost):
            break
        if turn == 0:
            rows, each = lost.repeat_interleave(starts), torch.arange(starts, device=row.device).repeat(len(lost))
            true = _check(problem, goal, found, rows, each, START_LOOKS)
            found.unknowns[rows, each], found.cost[rows, each] = true.unknowns, true.cost
            found.ended[rows, each] &= true.same
            best = found.cost[lost].argmin(-1)
            picked = _Checked(*(x.unflatten(0, (len(lost), starts))[torch.arange(len(lost)), best] for x in true))
            _keep(kept, lost, picked)
        _refine(problem, goal, found, lost)
        best = found.cost[lost].argmin(-1)
        again = _check(problem, goal, found, lost, best)
        _keep(kept, lost, again)
        found.unknowns[lost, best], found.cost[lost, best] = again.unknowns, again.cost
        lost = lost[~again.same]
    return (
        kept.place * problem.arm.max_pressure,
        kept.cost,
        mechanics.to_twists(kept.unknowns),
        kept.residual,
        kept.continued,
        kept.same & kept.ended,
        kept.optimality,
        found.cost,
        kept.in_range,
    )


def _refine(problem: Problem, goal: Goal, found: Descended, row: Tensor) -> None:
    """Descend to the end from the best start of some of the searches."""
    at = (row, found.cost[row].argmin(-1))
    end = descend(problem[row], goal[row], found.place[at], found.unknowns[at], gain=FINE_GAIN, looks=FINE_LOOKS)
    better = end.cost <= found.cost[at]
    place = (at[0][better], at[1][better])
    for old, new in zip(found, end, strict=True):
        old[place] = new[better]


def _keep(kept: "_Checked", row: Tensor, new: "_Checked") -> None:
    """Replace what was kept where the new is cheaper, or where the kept is none of a descent's ends."""
    better = (new.cost < kept.cost[row]) | ((new.cost <= kept.cost[row] * (1 + 1e-12)) & new.same)
    for old, fresh in zip(kept, new, strict=True):
        old[row[better]] = fresh[better]


class _Checked(NamedTuple):
    """Points (A,) of searches, with the equilibria that continuation from zero load reaches there.

    Attributes:
        place, unknowns, cost: as of `Descended`, at this equilibrium.
        residual, continued, in_range: of it.
        same: whether it is that of the descent.
        ended, optimality: of the descent.
    """

    place: Tensor
    unknowns: Tensor
    cost: Tensor
    residual: Tensor
    continued: Tensor
    in_range: Tensor
    same: Tensor
    ended: Tensor
    optimality: Tensor


def _check(problem: Problem, goal: Goal, found: Descended, row: Tensor, start: Tensor, looks: int = LOOKS) -> _Checked:
    """Solve for the equilibria at some of the pressures, from zero load."""
    at = (row, start)
    part = problem[row]
    place, unknowns = found.place[at], found.unknowns[at]
    part = replace(part, pressure=place * part.arm.max_pressure)
    settled = solved(part, unknowns.shape[-1], looks=looks)
    same = settled.converged & ((settled.unknowns - unknowns).abs().flatten(1).amax(-1) < SAME_SHAPE)
    pose = mechanics.kinematics(settled.unknowns, part.base_pose).pose
    cost = torch.where(settled.converged, goal[row].cost(pose), float("inf"))
    return _Checked(
        place,
        settled.unknowns,
        cost,
        settled.residual,
        settled.continued,
        settled.in_range,
        same,
        found.ended[at],
        found.optimality[at],
    )
