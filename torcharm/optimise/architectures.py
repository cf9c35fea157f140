"""Which architecture? Every choice of a force model for every position, each with its best design."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from os import PathLike

import torch

from torcharm._inputs import check_choice, check_count, check_number
from torcharm.actuators import Actuator, Bellows, McKibben
from torcharm.arm import ArmDesign
from torcharm.optimise.checkpoint import Checkpoint, Identity
from torcharm.optimise.design import (
    BATCHED_METHODS,
    ITERATIONS,
    candidate_starts,
    check_tasks,
    end_reasons,
    outcome,
    starting_points,
)
from torcharm.optimise.feasible import Polytope, feasible_designs
from torcharm.optimise.mirror import is_mirror_symmetric
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
            because the tasks, the arm given, bounds, ties and models are their own mirror image.
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
    the other way round) are equivalent if the tasks, the radii and lengths given, the bounds, the ties and each model's
    bending moments are all their own mirror image, and only then one of the two is tried; else both are.

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
    steps = ITERATIONS[method] if iterations is None else check_count("iterations", iterations, 1)
    keeper = None
    if checkpoint is not None:
        # Of the arm only radii and lengths count.
        own = ArmDesign(arm.radii, arm.length, [kinds[0]] * count)
        options = {"search": "architectures", "method": method, "starts": starts, "seed": seed, "iterations": steps}
        keeper = Checkpoint(
            checkpoint, Identity.of(own, kinds, tasks, space, objective, options | {"tolerance": tolerance})
        )
    mirrored = is_mirror_symmetric(arm, kinds, tasks, space)
    choices = [choice for choice in product(range(len(kinds)), repeat=count) if not mirrored or choice <= choice[::-1]]
    arms, polytopes, names, infeasible = _feasible(arm, kinds, choices, space, tasks)
    problem = Problem(tuple(polytopes), tasks, objective)
    points = torch.cat(
        [starting_points(polytope, one, starts, seed) for polytope, one in zip(polytopes, arms, strict=True)]
    )
    each = len(points) // len(polytopes)
    owner = torch.arange(len(polytopes)).repeat_interleave(each)
    points = candidate_starts(problem, points, owner, space, seed)
    state, log, stopped = descend(
        problem,
        points,
        owner,
        method=method,
        iterations=steps,
        tolerance=tolerance,
        checkpoint=keeper,
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
