"""Which architecture? Every choice of a force model for every position, each with its best design."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from os import PathLike

import torch
from torch import Tensor

from torcharm._inputs import check_choice, check_count, check_number
from torcharm.actuators import Actuator, Bellows, McKibben
from torcharm.arm import ArmDesign
from torcharm.optimise.design import (
    BATCHED_METHODS,
    ITERATIONS,
    check_tasks,
    end_reasons,
    outcome,
    problem_name,
    starting_points,
)
from torcharm.optimise.feasible import Polytope, feasible_designs
from torcharm.optimise.objective import Objective, Problem
from torcharm.optimise.result import OptimisedDesign
from torcharm.optimise.running import Callback, Log, descend
from torcharm.optimise.space import DesignSpace
from torcharm.task import Task

MOST_ARCHITECTURES = 4096


@dataclass(frozen=True, eq=False)
class Architectures:
    """The best design of every architecture, the best architecture first.

    Attributes:
        names: a letter for each position, as "BMMB"; digits where the models' first letters are alike.
        designs: what was found for each.
        infeasible: why the others have no design that satisfies the constraints.
        mirrored: whether architectures that are each other's mirror image are listed once: they are equivalent
            because the tasks are their own mirror image.
    """

    names: tuple[str, ...]
    designs: tuple[OptimisedDesign, ...]
    infeasible: dict[str, str]
    mirrored: bool


def optimise_architectures(
    arm: ArmDesign,
    task: Task | Sequence[Task],
    space: DesignSpace | None = None,
    objective: Objective | None = None,
    *,
    models: Sequence[Actuator] | None = None,
    method: str = "bfgs",
    starts: int = 4,
    seed: int = 0,
    iterations: int | None = None,
    tolerance: float = 1e-7,
    seconds: float | None = None,
    checkpoint: str | PathLike[str] | None = None,
    callback: Callback | None = None,
    progress: bool = False,
) -> Architectures:
    """Optimise the radii, lengths and limits of every architecture, all in one batch.

    K models at M positions make K^M architectures. An architecture and its mirror image (the same arm mounted
    the other way round) are equivalent if the tasks are their own mirror image, and then only one is tried.

    Args:
        arm: gives the number of actuators, and radii and lengths to start from.
        models: to choose from; None takes the paper's bellows and muscle. Limits are the models' own.
        starts: for each architecture.

    The other arguments are those of `optimise_design`.

    Raises:
        ValueError: as for `optimise_design`; no architecture is feasible; or there are too many.
    """
    begun = time.perf_counter()
    space, objective = space or DesignSpace(), objective or Objective()
    tasks = check_tasks(arm, task, space, objective)
    check_choice("method", method, BATCHED_METHODS)
    check_count("starts", starts, 1)
    if seconds is not None:
        check_number("seconds", seconds, 0.0, strict=True, unit="s")
    kinds = (Bellows(), McKibben()) if models is None else tuple(models)
    count = arm.actuator_count
    if not kinds or len(kinds) ** count > MOST_ARCHITECTURES:
        raise ValueError(
            f"models: {len(kinds)} at {count} positions make {len(kinds) ** count} architectures; "
            f"1 to {MOST_ARCHITECTURES} can be tried"
        )
    mirrored = are_mirror_symmetric(tasks)
    choices = [choice for choice in product(range(len(kinds)), repeat=count) if not mirrored or choice <= choice[::-1]]
    arms, polytopes, names, infeasible = _feasible(arm, kinds, choices, space, tasks)
    problem = Problem(tuple(polytopes), tasks, objective)
    points = torch.cat(
        [starting_points(polytope, one, starts, seed) for polytope, one in zip(polytopes, arms, strict=True)]
    )
    each = len(points) // len(polytopes)
    owner = torch.arange(len(polytopes)).repeat_interleave(each)
    steps = ITERATIONS[method] if iterations is None else check_count("iterations", iterations, 1)
    state, log, stopped = descend(
        problem,
        points,
        owner,
        method=method,
        iterations=steps,
        tolerance=tolerance,
        checkpoint=checkpoint,
        name=problem_name(
            arm, tasks, space, objective, [repr(kind) for kind in kinds], method, starts, seed, steps, tolerance
        ),
        callback=callback,
        progress=progress,
        begun=begun,
        seconds=seconds,
    )
    reasons = end_reasons(state.reason)
    found = []
    for index, own in enumerate(arms):
        mine = slice(index * each, (index + 1) * each)
        part = Log(log.evaluations, log.seconds, [row[mine] for row in log.values])
        ends, values = state.best_point[mine], state.best_value[mine]
        found.append(
            outcome(problem, index, own, space, points[mine], ends, values, reasons[mine], part, method, stopped)
        )
    order = sorted(range(len(found)), key=lambda index: found[index].value)
    return Architectures(
        tuple(names[index] for index in order), tuple(found[index] for index in order), infeasible, mirrored
    )


def _feasible(
    arm: ArmDesign,
    kinds: Sequence[Actuator],
    choices: Sequence[tuple[int, ...]],
    space: DesignSpace,
    tasks: Sequence[Task],
) -> tuple[list[ArmDesign], list[Polytope], list[str], dict[str, str]]:
    letters = [type(kind).__name__[0] for kind in kinds]
    letters = letters if len(set(letters)) == len(letters) else [str(index + 1) for index in range(len(kinds))]
    arms, polytopes, names, infeasible = [], [], [], {}
    for choice in choices:
        name = "".join(letters[index] for index in choice)
        own = ArmDesign(arm.radii, arm.length, [kinds[index] for index in choice])
        try:
            polytope = feasible_designs(space, own, tasks)
        except ValueError as error:
            infeasible[name] = str(error)
            continue
        arms.append(own)
        polytopes.append(polytope)
        names.append(name)
    if not polytopes:
        raise ValueError(f"space: no architecture has a feasible design; {next(iter(infeasible.values()))}")
    if len({polytope.dimension for polytope in polytopes}) > 1:
        raise ValueError("bounds: leave some architectures fewer free values than others; give wider ones")
    return arms, polytopes, names, infeasible


def are_mirror_symmetric(tasks: Sequence[Task]) -> bool:
    """Whether tasks, reflected about the axis of the base, are the same tasks."""
    rows, reflected = [], []
    for task in tasks:
        twists = task.twists.detach().double().cpu().expand(*task.batch_shape, task.nodes, 3)
        load = task.tip_load.detach().double().cpu().expand(*task.batch_shape, 3)
        rows.append(_rows(twists, load))
        flip = torch.tensor((1.0, -1.0, -1.0), dtype=torch.float64)
        heading = float(task.base_pose[2])
        cos, sin = math.cos(2 * heading), math.sin(2 * heading)
        x, y, moment = load.unbind(-1)
        reflected.append(_rows(twists * flip, torch.stack((cos * x + sin * y, sin * x - cos * y, -moment), -1)))
    if len({row.shape[1] for row in rows}) > 1:
        return all(_same(a, b) for a, b in zip(rows, reflected, strict=True))
    return _same(torch.cat(rows), torch.cat(reflected))


def _rows(twists: Tensor, load: Tensor) -> Tensor:
    return torch.cat((twists.flatten(-2), load), -1).reshape(-1, twists.shape[-2] * 3 + 3)


def _same(rows: Tensor, others: Tensor) -> bool:
    """Whether two sets of rows are equal, in any order, to 1e-9."""
    ordered = [sorted(map(tuple, (value / 1e-9).round().tolist())) for value in (rows, others + 0.0)]
    pairs = zip(ordered[0], ordered[1], strict=True)
    return all(abs(a - b) <= 1 for one, other in pairs for a, b in zip(one, other, strict=True))
