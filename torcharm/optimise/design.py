"""`optimise_design`: from a design and tasks to a better design."""

import time
from collections.abc import Sequence
from os import PathLike
from typing import Any

import torch
from torch import Tensor

from torcharm._inputs import check_choice, check_count, check_number, shown
from torcharm.arm import ArmDesign, check_planar
from torcharm.attainability import evaluate
from torcharm.optimise.baselines import SCIPY_METHODS, run_scipy
from torcharm.optimise.checkpoint import Checkpoint, Identity
from torcharm.optimise.confirmation import compared_with_given, distance_status
from torcharm.optimise.descent import REASONS, projected_gradient
from torcharm.optimise.feasible import FEASIBLE, Polytope, feasible_designs
from torcharm.optimise.objective import Objective, Problem
from torcharm.optimise.result import History, OptimisedDesign
from torcharm.optimise.running import Callback, Log, descend
from torcharm.optimise.space import DesignSpace, given_values
from torcharm.optimise.stationarity import stationarity
from torcharm.task import Task, check_plain

BATCHED_METHODS = ("bfgs", "adam")
TRIALS = 16
"""Designs that are tried in place of a start that is no candidate."""
METHODS = (*BATCHED_METHODS, *SCIPY_METHODS)
ITERATIONS = {
    "bfgs": 200,
    "adam": 300,
    "slsqp": 200,
    "differential_evolution": 1000,
    "batched_differential_evolution": 1000,
    "nelder_mead": 5000,
}


def optimise_design(
    arm: ArmDesign,
    task: Task | Sequence[Task],
    space: DesignSpace | None = None,
    objective: Objective | None = None,
    *,
    method: str = "bfgs",
    starts: int = 8,
    seed: int = 0,
    iterations: int | None = None,
    tolerance: float = 1e-7,
    seconds: float | None = None,
    checkpoint: str | PathLike[str] | None = None,
    callback: Callback | None = None,
    progress: bool = False,
) -> OptimisedDesign:
    """The best design found from a given one, within constraints, on all tasks.

    The first starts are the feasible designs nearest to the given ones, the others lie anywhere among the feasible
    designs. The very first descends by itself, so that an answer comes soon; the others then descend in one batch.
    Ctrl-C ends the search and returns what was found until then.

    Designs on which a task is impossible, or whose predicted errors are not converged and stable, are no candidates; a
    start that is none gives way to one nearby. What is chosen by predicted errors is compared with a pressure search:
    the result's `status` says whether it confirms the value, and the given design is kept where it satisfies the
    constraints and the search does better with it.

    Args:
        arm: a design, or a batch of designs to start from.
        task: tasks of any batch shape, or several such.
        space: what may change, and how far; None frees radii and lengths.
        objective: by which designs are compared; None takes the mean absolute unattainability.
        method: "bfgs" (curvature from differences of gradients) or "adam", both batched and projected onto the
            constraints; or scipy's "slsqp", "differential_evolution" (one design at a time, as scipy does by default;
            "batched_differential_evolution" judges whole populations in one call) or "nelder_mead", for comparison.
        starts: at least as many as designs are given. Differential evolution has its own population.
        seed: of the random starts.
        iterations: of a start, at most; None chooses.
        tolerance: relative gain not worth another step.
        seconds: after which to stop, counted from the call; None sets no limit.
        checkpoint: a file from which to go on, if it is there, and in which to keep what has been done; of batched
            methods. An interrupted search that goes on ends where it would have ended. The file must be of this very
            problem: arm, tasks, space, objective, options and force models, of which class, parameters, fields,
            attributes and what functions close over are compared, and forces and moments on a grid. It appears whole
            or not at all; that it cannot be written is found before the work or, if it fails later, told by one
            warning while the result is returned.
        callback: is told about each iteration; returning True stops the search.
        progress: whether to show a bar, on the standard error.

    Raises:
        ValueError: an argument is none of those allowed, no design satisfies the constraints, or the checkpoint is of
            another problem (the message says what differs), cannot be written, or could not be told from another's,
            as where a force model holds an open file or a generator.
    """
    begun = time.perf_counter()
    space, objective = space or DesignSpace(), objective or Objective()
    tasks = check_tasks(arm, task, space, objective)
    iterations = _checked(method, starts, seed, iterations, tolerance, seconds, checkpoint)
    keeper = None
    if checkpoint is not None:
        options = {"search": "one arm", "method": method, "starts": starts, "seed": seed, "iterations": iterations}
        keeper = Checkpoint(
            checkpoint, Identity.of(arm, arm.actuators, tasks, space, objective, options | {"tolerance": tolerance})
        )
    polytope = feasible_designs(space, arm, tasks)
    problem = Problem((polytope,), tasks, objective)
    points = starting_points(polytope, arm, starts, seed)
    owner = torch.zeros(len(points), dtype=torch.long)
    points = candidate_starts(problem, points, owner, space, seed)
    if method in SCIPY_METHODS:
        ends, values, reasons, log, stopped = run_scipy(
            problem,
            points,
            method=method,
            iterations=iterations,
            tolerance=tolerance,
            seed=seed,
            callback=callback,
            progress=progress,
            begun=begun,
            seconds=seconds,
        )
    else:
        state, log, stopped = descend(
            problem,
            points,
            owner,
            method=method,
            iterations=iterations,
            tolerance=tolerance,
            checkpoint=keeper,
            callback=callback,
            progress=progress,
            begun=begun,
            seconds=seconds,
        )
        ends, values, reasons = state.best_point, state.best_value, end_reasons(state.reason)
    return outcome(problem, 0, arm, space, points, ends, values, reasons, log, method, stopped)


def check_tasks(
    arm: ArmDesign, task: Task | Sequence[Task], space: DesignSpace, objective: Objective
) -> tuple[Task, ...]:
    """The tasks as a tuple, everything of the right type."""
    tasks = (task,) if isinstance(task, Task) else tuple(task)
    kinds = [("arm", arm, ArmDesign), ("space", space, DesignSpace), ("objective", objective, Objective)]
    kinds += [("task", one, Task) for one in tasks]
    for name, value, kind in kinds:
        if not isinstance(value, kind):
            raise ValueError(f"{name}: must be of type {kind.__name__}, got {shown(value)}")
    if not tasks or any(0 in one.batch_shape for one in tasks):
        raise ValueError("task: must hold at least one task, got none")
    check_planar(arm)
    for one in tasks:
        check_plain(one)
    return tasks


def _checked(
    method: str,
    starts: int,
    seed: int,
    iterations: int | None,
    tolerance: float,
    seconds: float | None,
    checkpoint: object,
) -> int:
    check_choice("method", method, METHODS)
    check_count("starts", starts, 1)
    check_count("seed", seed, 0)
    if checkpoint is not None and method not in BATCHED_METHODS:
        raise ValueError(f"checkpoint: is kept by {', '.join(BATCHED_METHODS)} only, got method {method!r}")
    if not (isinstance(tolerance, (int, float)) and 0 < tolerance < 1):
        raise ValueError(f"tolerance: must be above 0 and below 1, got {shown(tolerance)}")
    if seconds is not None:
        check_number("seconds", seconds, 0.0, strict=True, unit="s")
    return ITERATIONS[method] if iterations is None else check_count("iterations", iterations, 1)


def starting_points(polytope: Polytope, arm: ArmDesign, starts: int, seed: int) -> Tensor:
    """Feasible points (S, F): those nearest to the given designs, then random ones."""
    nearest = polytope.nearest(arm)
    return torch.cat((nearest, polytope.sample(max(0, starts - len(nearest)), seed)))


def candidate_starts(problem: Problem, points: Tensor, owner: Tensor, space: DesignSpace, seed: int) -> Tensor:
    """Starts (S, F) that have a value, where there are any nearby.

    A descent cannot leave a design whose prediction is not converged and stable, or on which a task is impossible. Such
    a start gives way to the best of `TRIALS` designs between it and random feasible ones.
    """
    if problem.objective.metric != "predicted_error" and space.in_range:
        return points
    warm = torch.full((len(points),), 1e-6, dtype=torch.float64)
    lost = ~problem.judge(points, owner, warm, gradient=True).smooth.isfinite()
    points = points.clone()
    for index in lost.nonzero().squeeze(-1).tolist():
        polytope = problem.polytopes[int(owner[index])]
        away = polytope.sample(TRIALS, seed + 1 + index)
        trial = torch.lerp(points[index], away, torch.linspace(1 / TRIALS, 1, TRIALS, dtype=away.dtype).unsqueeze(-1))
        judged = problem.judge(trial, owner[index].expand(TRIALS), warm[:1].expand(TRIALS), gradient=True)
        best = int(judged.smooth.argmin())
        if bool(judged.smooth[best].isfinite()):
            points[index] = trial[best]
    return points


def end_reasons(reason: Tensor) -> list[str]:
    """Why each start ended, in words."""
    return [REASONS[code] for code in reason.tolist()]


def outcome(
    problem: Problem,
    architecture: int,
    arm: ArmDesign,
    space: DesignSpace,
    points: Tensor,
    ends: Tensor,
    values: Tensor,
    reasons: Sequence[str],
    log: Log,
    method: str,
    stopped: str,
) -> OptimisedDesign:
    """Put together what is known of the starts of one architecture.

    Args:
        points, ends: (S, F) where the starts began, and their best; `ends` of a population is (1, F).
        values: (S,) of the ends.
    """
    polytope, objective = problem.polytopes[architecture], problem.objective
    with torch.no_grad():
        given = _best_given(arm, problem)
        best = int(values.argmin())
        point, value = ends[best], float(values[best])
        chosen, given_value = polytope.design(point), float(_value_of(given, problem))
        owner = torch.full((len(points),), architecture)
        warm = torch.full((len(points),), 1e-6, dtype=torch.float64)
        start_values = problem.judge(points, owner, warm, gradient=False).value
        if objective.metric == "predicted_error":
            comparison = compared_with_given(objective, problem.tasks, given, chosen)
            status, own = comparison.status, polytope.nearest(given)[0]
            if comparison.given_is_better and _is_design(polytope, own, given):
                point, chosen, value = own, given, given_value
        checked = [evaluate(chosen, task, "absolute") for task in problem.tasks]
    after = metric_values(chosen, problem)
    if objective.metric != "predicted_error":
        status = distance_status(after["converged"], torch.cat([result.impossible.reshape(-1) for result in checked]))
    mine = owner[: len(ends)]
    judged = problem.judge(ends, mine, warm[: len(ends)], gradient=True)
    assert judged.gradient is not None
    slopes = projected_gradient(problem, ends, mine, judged.gradient)
    history = History(torch.tensor(log.evaluations), torch.tensor(log.seconds), torch.as_tensor(log.values_array()))
    return OptimisedDesign(
        given=given,
        best=chosen,
        value=value,
        given_value=given_value,
        before=metric_values(given, problem),
        after=after,
        in_range=all(bool(result.in_range.all()) for result in checked),
        violation=float(polytope.violation(point)),
        starts=polytope.design(points),
        start_values=start_values,
        ends=polytope.design(ends),
        end_values=values,
        reasons=tuple(reasons),
        projected_gradients=torch.where(judged.smooth.isfinite(), slopes, torch.nan),
        stationarity=stationarity(problem, point, architecture),
        history=history,
        method=method,
        evaluations=log.evaluations[-1],
        seconds=log.seconds[-1],
        stopped=stopped,
        space=space,
        objective=objective,
        status=status,
    )


def _is_design(polytope: Polytope, point: Tensor, arm: ArmDesign) -> bool:
    """Whether a feasible point is this very design, so that the design satisfies the constraints."""
    own, other = (given_values(one)[0] for one in (polytope.design(point), arm))
    return bool(abs(own - other).max() <= FEASIBLE * max(1.0, abs(other).max()))


def _value_of(arm: ArmDesign, problem: Problem) -> Tensor:
    """The objective (*design batch) of designs that need not be feasible; infinite where it is no number."""
    objective = problem.objective
    value = objective.total(objective.per_task(arm, problem.tasks)) + objective.size(arm)
    return torch.where(value.isfinite(), value, torch.inf)


def _best_given(arm: ArmDesign, problem: Problem) -> ArmDesign:
    designs = arm.flatten()
    return designs[0] if len(designs.radii) == 1 else designs[int(_value_of(designs, problem).argmin())]


def metric_values(arm: ArmDesign, problem: Problem) -> dict[str, Tensor]:
    """Unsigned metrics of one design, each (T,) over all tasks, and whether they converged."""
    objective = problem.objective
    metrics = tuple(dict.fromkeys(("absolute", "relative", *objective.metrics)))
    options: dict[str, Any] = {name: getattr(objective, name) for name in ("weights", "power", "chunk_size")}
    with torch.no_grad():
        results = [evaluate(arm, task, metrics, **options) for task in problem.tasks]
    return {
        name: torch.cat([getattr(result, name).reshape(-1) for result in results]) for name in (*metrics, "converged")
    }
