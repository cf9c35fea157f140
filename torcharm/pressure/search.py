"""Pressure search: the pressure that brings an arm closest to a task, through its forward mechanics."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, TypedDict, Unpack, overload

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries
from torcharm.engine.arms import sizes_of
from torcharm.engine.arrays import make
from torcharm.engine.continuation import CONTINUED, FAILED
from torcharm.engine.pressure_model import Work
from torcharm.engine.search_state import LOADED, Search
from torcharm.engine.searches import LOT, Searches, search_all
from torcharm.engine.threads import spread
from torcharm.engine.wrench_fit import Fit
from torcharm.equilibrium.solve import TOLERANCE, NotConvergedError
from torcharm.equilibrium.status import status_word
from torcharm.inputs import check_choice, check_count, check_flag
from torcharm.pressure.errors import Outcome, errors_at, outcome
from torcharm.pressure.pose_cost import PoseCost
from torcharm.pressure.prepared import Prepared, detached, prepare, stays_at
from torcharm.pressure.starts import nothing_found, spread_points
from torcharm.task import Task, for_each_task

METHODS = ("multistart", "scipy")
STARTS = {"multistart": 12, "scipy": 1}
ROUNDS = 4
"""Ends of descents that continuation does not reach, from which a search goes on along a boundary."""
WORDS = ("converged", "not converged", "snapped", "not found", "impossible")
"""What may be said of a search. Not converged: an equilibrium that is reached, but the descent did not come to its end,
or leads on to where continuation does not follow, so that the pressure is next to a jump; or too few others come as
close, so that more might come closer; or one that does has its tip elsewhere. Snapped: the arm gets there by a snap,
not along one branch from zero load. Not found: no start led to a stable equilibrium. Impossible: the task's shape
leaves an actuator no length."""
LESS_COMPRESSION = "a lower load, a stiffer arm, or antagonists that push and pull against each other"
"""What keeps an arm from buckling, for a person who may change it."""


@dataclass(frozen=True, eq=False, repr=False)
class PressureSearch(Outcome):
    """What `search_pressure` found; `batch` is (*design batch, *task batch).

    Attributes:
        pressure: (*batch, M) the best [kPa].
        tip_error, tip_rotation_error, shape_error, cost, per_node, pose_errors: as of `PredictedError`, there.
        twists: (*batch, N, K) the equilibrium at this pressure [m, rad].
        optimality: (*batch) the largest entry of the cost's projected gradient, by normalised pressures [m²]. At a
            kink of a force model it does not vanish.
        converged: (*batch) whether it is a stable equilibrium along one branch from zero load, the descent to it came
            to its end, three others ended nearly as close (or its mean error is below a 1000th of the arm's length),
            none of them with another error of the tip, and none led to a better one that continuation does not reach.
        continued: (*batch) whether continuation from zero load reaches it along one branch.
        stable: (*batch) whether the task is possible, and the arm stays there.
        possible, strain_excess, in_range: as of `PredictedError`.
        start_cost: (*batch, S) what each start came to by itself, before it was given up or at its end; infinite where
            it failed, NaN where it was spared as others had agreed.

    Example:
        >>> found = ta.search_pressure(ta.bellows_arm(), ta.Task(ta.constant_curvature(0.5)))
        >>> found.status, round(1e3 * float(found.tip_error))  # it grows too long, whatever the pressure [mm]
        ('converged', 22)
    """

    continued: Tensor
    start_cost: Tensor

    DOUBTS: ClassVar[Mapping[str, str]] = {
        "snapped": "the arm gets there by a snap, so that it may end elsewhere: try to raise the pressures before the "
        f"load, {LESS_COMPRESSION}",
        "not converged": "a stable shape that loading reaches, but next to a jump to another, or descents do not agree "
        f"on it: more starts may find a better pressure; else try {LESS_COMPRESSION}",
        "not found": f"no start led to a stable equilibrium: try more starts, {LESS_COMPRESSION}",
    }
    """Why a task is left undecided, by the status, and what to try."""

    @property
    def spread(self) -> Tensor:
        """(*batch) median cost of the starts that succeeded, less the best: 0 if most starts agree; NaN if none did."""
        known = torch.where(self.start_cost.isfinite(), self.start_cost, self.start_cost.new_tensor(float("nan")))
        return known.nanmedian(-1).values - self.cost

    @property
    def at_minimum(self) -> Tensor:
        """(*batch) whether it is known to be the best nearby, as a prediction says it: the same as `converged`."""
        return self.converged

    @property
    def reached(self) -> Tensor:
        """(*batch) whether loading from rest leads there, as a prediction says it: the same as `continued`."""
        return self.continued

    @property
    def status(self) -> str | NDArray[Any]:
        """What to think of it, in a word of `WORDS`: one, or an array of them."""
        return status_word(WORDS, self.converged, self.continued, self.stable, self.possible)


class Options(TypedDict, total=False):
    """The keywords of `search_pressure`."""

    starts: int | None
    rounds: int
    pose_cost: PoseCost | None
    shear_stiffness: float | None
    seed: int
    scipy_method: str
    progress: bool | None
    raise_on_failure: bool


@overload
def search_pressure(
    arm: ArmDesign | ArmSeries, task: Task, method: str = ..., **options: Unpack[Options]
) -> PressureSearch: ...


@overload
def search_pressure(
    arm: ArmDesign | ArmSeries, task: Sequence[Task], method: str = ..., **options: Unpack[Options]
) -> tuple[PressureSearch, ...]: ...


def search_pressure(
    arm: ArmDesign | ArmSeries,
    task: Task | Sequence[Task],
    method: str = "multistart",
    *,
    starts: int | None = None,
    rounds: int = ROUNDS,
    pose_cost: PoseCost | None = None,
    shear_stiffness: float | None = None,
    seed: int = 0,
    scipy_method: str = "L-BFGS-B",
    progress: bool | None = None,
    raise_on_failure: bool = False,
) -> PressureSearch | tuple[PressureSearch, ...]:
    """The pressure within the limits that brings each design closest to each task.

    Minimises `Σ_i ω_i e_iᵀ K e_i` over `p ∈ [0, p̄]`, with the errors e_i of `ĝ_i(p)⁻¹ g_i*` and ĝ(p) the equilibrium
    under the task's load. The cost is not convex: both methods find local minima, the best of several starts. The shape
    returned is the one that continuation from zero load reaches (see `solve_equilibrium`).

    "multistart" descends by Levenberg and Marquardt's steps in the box, along stable equilibria: from the task's shape,
    and from pressures that are promising to first order there or spread over the box, until four descents end in the
    same shape, seven at a kink of a force model; and then from where one pressure of the best is at its other end. One
    that will not come below the best that is known is given up. Where fewer than three others (or fewer than all, of
    fewer starts) end nearly as close as the best, the answer is not `converged`: more starts may find a better one. Nor
    is it where one does whose tip is off by more or less, by over a 500th of the arm's length: which of the two is
    found is chance. Below a mean error of a 1000th of that length it needs no other, and below a 100,000th no other is
    tried.

    Ends are confirmed by continuation. Under compression it may lead elsewhere: an arm buckles to one side or to the
    other, and the best pressures often lie where that is decided. There the cost jumps. The boundary is found by
    Newton's method, as where the equilibria on the way bifurcate, and the search goes on along it; where that stays far
    above what a descent promised, the arm is loaded at pressures around its end. It is not `converged`. "scipy" is the
    paper's baseline, one equilibrium at a time: `scipy.optimize.minimize` with finite differences, from the middle of
    the box and, for more starts, from points spread over it.

    Differentiable as `predict_error` is, by the envelope theorem; where the search is not converged, gradients are
    NaN, unless nothing depends on them.

    Args:
        arm: designs, of any batch shape; or segments in series.
        task: tasks, of any batch shape; every design meets every task. Or a list of such.
        method: "multistart" or "scipy".
        starts: S, descents at most, before those from other ends; None takes 12 (multistart) or 1 (scipy).
        rounds: searches along boundaries at most (multistart).
        pose_cost: what is minimised; None is `PoseCost()`.
        shear_stiffness: as for `solve_equilibrium`.
        seed: of the pressures that are drawn.
        scipy_method: a bounded method of `scipy.optimize.minimize`.
        progress: whether to show a bar; None shows one for "scipy", on a terminal.
        raise_on_failure: makes it an error if any search does not converge.

    Returns:
        What was found; of a list of tasks a tuple, with what was found for each, in their order.

    Raises:
        ValueError: an argument is none of those allowed, or arm and task do not fit.
        NotConvergedError: see `raise_on_failure`.

    Example:
        >>> found = ta.search_pressure(ta.antagonistic_arm(), ta.Task(ta.constant_curvature(0.5), [1.0, 0.0, 0.0]))
        >>> found.pressure.round().tolist(), round(1e3 * float(found.tip_error), 2)  # [kPa], [mm]
        ([33.0, 100.0, 100.0, 21.0], 0.58)
    """
    check_choice("method", method, METHODS)
    check_count("rounds", rounds, 0)
    count = STARTS[method] if starts is None else check_count("starts", starts, 1)
    check_count("seed", seed, 0)
    check_flag("raise_on_failure", raise_on_failure)
    if progress is not None:
        check_flag("progress", progress)

    def search_one(own: Task) -> PressureSearch:
        prepared = prepare(arm, own, pose_cost, shear_stiffness)
        plain = detached(prepared)
        if method == "scipy":
            from torcharm.pressure.scipy_baseline import search_one_by_one

            found = search_one_by_one(plain, count, seed, scipy_method, progress)
        else:
            found = _found(plain, count, rounds, seed)
        result = _result(prepared, plain, found)
        failed = result.converged.numel() - int(result.converged.sum())
        if raise_on_failure and failed:
            raise NotConvergedError(f"{failed} of {result.converged.numel()} searches did not converge")
        return result

    return for_each_task(task, search_one)


def _result(prepared: Prepared, plain: Prepared, found: Searches) -> PressureSearch:
    """What is said of what was found."""
    normalised, twists = plain.shaped(found.normalised), plain.shaped(found.twists)
    stable = plain.shaped(stays_at(plain, found.normalised, found.twists, found.how != FAILED)) & prepared.possible
    continued = plain.shaped(found.how == CONTINUED) & stable
    converged = plain.shaped(found.confirmed) & continued
    errors = errors_at(prepared, normalised, twists, converged, stable)
    return outcome(
        PressureSearch,
        prepared,
        errors,
        optimality=plain.shaped(found.optimality),
        converged=converged,
        stable=stable,
        continued=continued,
        start_cost=plain.shaped(found.start_cost),
    )


def _found(prepared: Prepared, starts: int, rounds: int, seed: int) -> Searches:
    """What the engine finds."""
    problem, shape, out = prepared.engine, prepared.start, nothing_found(prepared, starts)
    size = problem.limit.shape[1]
    few = starts // 3  # of drawn and of spread pressures; loading the arm at more finds little that descents do not
    pool = torch.rand(LOT * (few + 2), size, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    pool = (1.2 * pool - 0.1).clamp(0, 1)  # the bounds are where optima like to be
    spread_out = spread_points(max(few, 2), size, seed)
    spread_out[1:] = np.clip(1.6 * spread_out[1:] - 0.3, 0.0, 1.0)
    spread_out[1] = 0.0  # no pressure at all
    start, pressure = np.zeros((0, *shape.shape[1:])), np.zeros_like(problem.limit)
    slots = LOADED + len(pool) // LOT + len(spread_out)
    sizes = sizes_of(problem.arms, slots=slots, starts=starts, pool=len(pool))

    def search_some(first: int, last: int) -> None:
        work, search = make(Work, sizes, pressure=pressure), make(Search, sizes)
        fit, draws = make(Fit, sizes, weight=prepared.wrench_weights), pool.numpy()
        search_all(problem, shape, draws, spread_out, rounds, start, TOLERANCE, first, last, work, search, fit, out)

    spread(len(shape), search_some)
    return out
