"""`optimise_design`: from a design and tasks to a better design."""

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torcharm.attainability import PoseTolerance
from torcharm.design.checkpoint import Checkpoint, describe
from torcharm.design.descent import Callback, End, Progress, descend_all
from torcharm.design.feasible import feasible_designs
from torcharm.design.objective import Objective, Problem, counted, shape_lengths
from torcharm.design.result import OptimisedDesign, compared_words, reached_words, yield_words
from torcharm.design.space import Arm, Array, DesignSpace, fitting_tasks, given_values, one_of_batch
from torcharm.design.task_errors import TaskErrors, predicted, searched
from torcharm.design.tolerance import tolerance as tolerance_of
from torcharm.design.tolerance_result import BuiltArms
from torcharm.inputs import check_count, check_number, shown
from torcharm.task import Task

ITERATIONS = 60
TOLERANCE = 1e-5
"""A gain not worth a step, as a share of the value at the start."""
CANDIDATES = 3
"""Ends that are compared with the given design by a pressure search, the best first, until one is better."""
AGREEMENT = (0.2, 0.01)
"""Share of the searched error, and length [m], within which the predicted one counts as confirmed."""
COMPARABLE = 0.1
"""Share by which the value of a design that holds more tasks may be larger, and it is preferred all the same."""
NOISE = 1e-6
"""By which share a value must be below another to be better: searches end at their tolerance."""


def optimise_design(
    arm: Arm,
    task: Task | Sequence[Task],
    space: DesignSpace | None = None,
    objective: Objective | None = None,
    *,
    starts: int = 8,
    seed: int = 0,
    iterations: int = ITERATIONS,
    seconds: float | None = None,
    tolerance: PoseTolerance | float | None = None,
    checkpoint: str | PathLike[str] | None = None,
    callback: Callback | None = None,
) -> OptimisedDesign:
    """The best design found from a given one, within constraints, on all tasks.

    Sequential least squares (SLSQP) descend with exact gradients from several feasible designs: the nearest to the
    given, then random ones. By default they minimise the mean shape error that is predicted, in which a task counts
    ever more like one that cannot be held the farther its strains leave their characterised range; every other descent
    is led first by the unattainability. Ends count that are better by that value and hold no fewer tasks than the
    given design; of those within 10 % of the least value, the one that holds most tasks is best. It is compared with
    the given design by a pressure search, which the prediction is an approximation of; where the search does better
    with the given one, so with the next two. If none is better, the given design is kept, within the constraints or
    not, and `status` says why.

    With `Objective(robust=Robust(Scatter(...)))` built arms count in place of the drawn one; their yields before and
    after, on fresh samples, take the place of the search.

    Ctrl-C ends the optimisation and returns what was found until then.

    Args:
        arm: a design, or a batch of designs to start from; in the plane or in space, or segments in series.
        task: tasks of any batch shape, or several such.
        space: what may change, and how far; None frees radii and lengths.
        objective: by which designs are compared; None is the mean predicted shape error.
        starts: at least as many as designs are given.
        seed: of the random starts.
        iterations: of a start, at most.
        seconds: after which to stop, counted from the call; None sets no limit.
        tolerance: how far off a pose may be and still counts as held, as for `torcharm.evaluate`.
        checkpoint: a file in which finished starts are kept, and taken up if it is there. It must be of this very
            problem: arm, tasks, space, objective, seed, iterations, and force models, of which classes, forces and
            moments on a grid are compared.
        callback: is told the `Progress` after each evaluation; returning True stops the optimisation.

    Raises:
        ValueError: an argument is none of those allowed, no design satisfies the constraints, or the checkpoint is of
            another problem (the message says what differs) or cannot be written.

    Example:
        >>> arm, task = ta.bellows_arm(), ta.Task(ta.constant_curvature(1.0, nodes=3), tip_load=[1.0, -1.0, 0.0])
        >>> found = ta.optimise_design(arm, task, ta.DesignSpace(free=("radii", "length")), starts=1, iterations=4)
        >>> found.given_held, found.held  # of how many tasks
        (0, 1)
    """
    progress = Progress(callback, starts, seconds)
    space, objective = space or DesignSpace(), objective or Objective()
    tasks = check_arguments(arm, task, space, objective, starts, seed, iterations, seconds)
    keeper = None
    if checkpoint is not None:
        asked = {"space": space, "objective": objective, "seed": seed, "iterations": iterations}
        keeper = Checkpoint(checkpoint, describe(arm, arm.actuators, tasks, **asked))
    problem = Problem(feasible_designs(space, arm, tasks), tasks, objective)
    points = starting_points(problem, arm, starts, seed)
    ends, stopped = descend_all(problem, points, iterations, TOLERANCE, progress, keeper)
    return outcome(problem, arm, space, points, ends, progress, stopped, tolerance)


def check_arguments(
    arm: Arm,
    task: Task | Sequence[Task],
    space: DesignSpace,
    objective: Objective,
    starts: int,
    seed: int,
    iterations: int,
    seconds: float | None,
) -> tuple[Task, ...]:
    """The tasks as a tuple, everything checked."""
    _check_type("objective", objective, Objective)
    _check_type("space", space, DesignSpace)
    tasks = fitting_tasks(arm, task)
    check_count("starts", starts, 1)
    check_count("seed", seed, 0)
    check_count("iterations", iterations, 1)
    if seconds is not None:
        check_number("seconds", seconds, 0.0, strict=True, unit="s")
    return tasks


def _check_type(name: str, value: object, kind: type) -> None:
    if not isinstance(value, kind):
        raise ValueError(f"{name}: must be of type {kind.__name__}, got {shown(value)}")


def starting_points(problem: Problem, arm: Arm, starts: int, seed: int) -> list[Array]:
    """Feasible points: those nearest to the given designs, then random ones."""
    designs = problem.designs
    nearest = [designs.project(point) for point in designs.free.inverse(given_values(arm))]
    return nearest + designs.random(max(0, starts - len(nearest)), seed)


def outcome(
    problem: Problem,
    arm: Arm,
    space: DesignSpace,
    points: Sequence[Array],
    ends: Sequence[End],
    progress: Progress,
    stopped: str,
    tolerance: PoseTolerance | float | None,
) -> OptimisedDesign:
    """Put together what is known of the starts of one architecture."""
    designs, objective = problem.designs, problem.objective
    given = _predicted(problem, *_best_given(arm, problem), tolerance)
    ranked = _ranked(problem, given, ends, tolerance)
    better = [one for one in ranked if one.held >= given.held][:CANDIDATES]
    violated = designs.violated_by(given.arm)
    best, status = (better[0] if better else given), "better"
    if better and objective.metric == "predicted_error" and objective.robust is None:
        try:
            best, status = _confirmed(problem, given, better)
        except KeyboardInterrupt:
            status, stopped = "better as predicted, not compared by a pressure search: interrupted", "interrupted"
    elif not better:
        early = " before it was interrupted" if stopped == "interrupted" else ""
        status = f"given design kept: no better one was found within the constraints{early}"
        if ranked:
            tasks, most = f"{given.held} task{'s' * (given.held != 1)}", max(one.held for one in ranked)
            status = f"given design kept: it holds {tasks}, and those of less value hold {most} at most{early}"
    built, before, after = _built(problem, given.arm, best.arm, tolerance), given.errors, best.errors
    if best is not given and built is not None:
        status = f"better: {yield_words(*built)}"
    if best is given and violated:
        status += f", which it is outside of ({'; '.join(violated)})"
    if not bool(after.stable.all()):
        status += f"; no stable equilibrium is predicted {_on_tasks(~after.stable)}"
    elif not bool(after.converged.all()):
        status += f"; predictions did not converge {_on_tasks(~after.converged)}"
    if best is not given and space.in_range and int(after.in_range.sum()) < int(before.in_range.sum()):
        status += f"; the shapes reached leave the characterised range {_on_tasks(~after.in_range)}, where models guess"
    reached = np.array([end.point for end in ends]).reshape(len(ends), designs.dimension)
    return OptimisedDesign(
        given=given.arm,
        best=best.arm,
        given_value=given.value,
        value=best.value,
        given_held=given.held,
        held=best.held,
        before=before,
        after=after,
        status=status,
        active=() if best.point is None else designs.active(best.point),
        violated=violated,
        starts=designs.design(np.array(points)),
        ends=designs.design(reached),
        end_values=torch.tensor([end.value for end in ends], dtype=torch.float64),
        reasons=tuple(end.reason for end in ends),
        evaluations=progress.evaluations,
        seconds=progress.seconds,
        stopped=stopped,
        space=space,
        objective=objective,
        built_before=None if built is None else built[0],
        built_after=None if built is None else built[1],
    )


def _built(
    problem: Problem, given: Arm, best: Arm, tolerance: PoseTolerance | float | None
) -> tuple[BuiltArms, BuiltArms] | None:
    """Of a robust objective what is found of both designs once built, on samples that no descent has seen."""
    robust, cost = problem.objective.robust, problem.objective.pose_cost
    if robust is None:
        return None
    options: dict[str, Any] = {"seed": robust.seed + 1, "tolerance": tolerance, "pose_cost": cost}
    options |= vars(robust.scatter) | {"compensated": robust.compensated}
    return tolerance_of(given, problem.tasks, **options), tolerance_of(best, problem.tasks, **options)


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A design, its objective's value, what is predicted on all tasks, and how many it holds.

    Attributes:
        point: (F,) the free values at which a descent ended; None of the given design.
    """

    arm: Arm
    value: float
    point: Array | None
    errors: TaskErrors
    held: int


def _predicted(
    problem: Problem, arm: Arm, value: float, tolerance: PoseTolerance | float | None, point: Array | None = None
) -> _Candidate:
    """A design with what is predicted."""
    return _Candidate(arm, value, point, *predicted(arm, problem.tasks, problem.objective.pose_cost, tolerance))


def _ranked(
    problem: Problem, given: _Candidate, ends: Sequence[End], tolerance: PoseTolerance | float | None
) -> list[_Candidate]:
    """Designs at the ends of less value than the given design's, the best first."""
    lower = [end for end in ends if end.value < given.value * (1 - NOISE) or given.value == np.inf > end.value]
    found = [_predicted(problem, problem.designs.design(end.point), end.value, tolerance, end.point) for end in lower]
    return [found[index] for index in best_first([one.value for one in found], [one.held for one in found])]


def best_first(values: Sequence[float], held: Sequence[int]) -> list[int]:
    """Indices of designs by their values and how many tasks they hold: again and again, of those whose value is
    comparable with the least that is left, the one that holds most."""
    left, order = sorted(range(len(values)), key=lambda index: values[index]), list[int]()
    while left:
        near = [index for index in left if not values[index] > values[left[0]] + COMPARABLE * abs(values[left[0]])]
        order.append(max(near, key=lambda index: held[index]))
        left.remove(order[-1])
    return order


def _on_tasks(marked: Tensor) -> str:
    count = marked.numel()
    return f"on {int(marked.sum())} of {count} tasks" if count > 1 else "on the task"


def _confirmed(problem: Problem, given: _Candidate, better: Sequence[_Candidate]) -> tuple[_Candidate, str]:
    """The first of some designs with which a pressure search does better than with the given one, or that."""
    over = problem.objective.over
    (before, old), found = _by_search(problem, given.arm), list[tuple[float, TaskErrors]]()
    for one in better:
        value, new = _by_search(problem, one.arm)
        found.append((value, new))
        if value < before * (1 - NOISE):
            words = compared_words(old, new, over)
            if abs(one.value - value) <= AGREEMENT[0] * value + AGREEMENT[1]:
                return one, f"better, as a pressure search confirms ({words})"
            expected = reached_words(one.errors, over)
            return one, f"better, but a pressure search finds the {words}, where {expected} is predicted"
    least = min(found, key=lambda pair: pair[0])[1]
    return given, (
        f"given design kept: a pressure search reaches {reached_words(old, over)} with it, and "
        f"{reached_words(least, over)} with the best found within the constraints"
    )


def _by_search(problem: Problem, arm: Arm) -> tuple[float, TaskErrors]:
    """The objective of a design by what a pressure search reaches, and that."""
    objective = problem.objective
    found = searched(arm, problem.tasks, objective.pose_cost)
    with torch.no_grad():
        lengths = torch.cat([shape_lengths(task) for task in problem.tasks])
        beyond = found.beyond if problem.designs.in_range else None
        return float(objective.total(counted(found.shape_error, found.stable, beyond, lengths))), found


def _best_given(arm: Arm, problem: Problem) -> tuple[Arm, float]:
    """Of the given designs the best, without a batch, and its value."""
    values = problem.value(arm).reshape(-1)
    best = int(values.argmin())
    return one_of_batch(arm, best), float(values[best])
