"""Which architecture? Every choice of a force model for every position, each with its best design."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torcharm.actuators import SHIPPED, Actuator
from torcharm.actuators.bending import active_moment, bending_model, passive_moment
from torcharm.arm import ArmDesign, find_model
from torcharm.design.checkpoint import CURVATURES, Checkpoint, describe
from torcharm.design.descent import Callback, Progress, descend_all
from torcharm.design.feasible import feasible_designs
from torcharm.design.objective import Objective, Problem
from torcharm.design.optimise import ITERATIONS, TOLERANCE, check_arguments, outcome, starting_points
from torcharm.design.result import OptimisedDesign
from torcharm.design.space import DesignSpace
from torcharm.inputs import HoldsTensors, shown
from torcharm.task import Task

MOST_ARCHITECTURES = 4096
SAME = 1e-12
"""Radii, lengths [m] and bounds no further apart are the same: a rounding of numbers that a person typed."""


@dataclass(frozen=True, eq=False, repr=False)
class Architectures(HoldsTensors):
    """The best design of every architecture, the best architecture first.

    Attributes:
        names: a letter for each position, as "BMMB"; digits where the models' first letters are alike.
        designs: what was found for each.
        infeasible: why others have no design that satisfies the constraints, by name.
        mirrored: whether only one of two architectures that are each other's mirror image was tried.
        stopped: "finished", or what stopped it before all were tried.
    """

    names: tuple[str, ...]
    designs: tuple[OptimisedDesign, ...]
    infeasible: dict[str, str]
    mirrored: bool
    stopped: str

    def __repr__(self) -> str:
        """The best three, and counts."""
        shown_ = [f"{name} {one.value:.4g}" for name, one in zip(self.names, self.designs, strict=True)]
        more = f" and {len(shown_) - 3} more" if len(shown_) > 3 else ""
        return f"Architectures({', '.join(shown_[:3])}{more}; {len(self.infeasible)} infeasible; {self.stopped})"


def optimise_architectures(
    arm: ArmDesign,
    task: Task | Sequence[Task],
    space: DesignSpace | None = None,
    objective: Objective | None = None,
    *,
    models: Sequence[Actuator | str | Path] | None = None,
    starts: int = 4,
    seed: int = 0,
    iterations: int = ITERATIONS,
    seconds: float | None = None,
    checkpoint: str | PathLike[str] | None = None,
    callback: Callback | None = None,
) -> Architectures:
    """Optimise the geometry of every architecture.

    K models at M positions make K^M architectures. In the plane an architecture and its mirror image (the same arm
    mounted the other way round) are the same problem if the tasks, the offsets and lengths given, bounds, ties and each
    model's bending moments all are their own mirror image, and only then one of the two is tried; else both are.

    Args:
        arm: gives the positions, and geometry to start from; not a series.
        models: to choose from, given as an arm's actuators are; None takes the shipped ones, the paper's bellows and
            muscle. Limits are the models' own.
        starts: for each architecture.

    The other arguments are those of `optimise_design`.

    Raises:
        ValueError: as for `optimise_design`; no architecture is feasible; or there are too many.
    """
    begun = time.perf_counter()
    space, objective = space or DesignSpace(), objective or Objective()
    if not isinstance(arm, ArmDesign):
        raise ValueError(f"arm: must be an ArmDesign, got {shown(arm)}")
    tasks = check_arguments(arm, task, space, objective, starts, seed, iterations, seconds)
    kinds = _kinds(models)
    count = arm.actuator_count
    if not kinds or len(kinds) ** count > MOST_ARCHITECTURES:
        raise ValueError(
            f"models: {len(kinds)} at {count} positions make {len(kinds) ** count} architectures; "
            f"1 to {MOST_ARCHITECTURES} can be tried"
        )
    keeper = None
    if checkpoint is not None:
        # The arm's own models and limits have no part.
        own = _with_models(arm, [kinds[0]] * count)
        options: dict[str, Any] = {"seed": seed, "iterations": iterations, "search": "architectures"}
        keeper = Checkpoint(checkpoint, describe(own, kinds, tasks, space, objective, **options))
    mirrored = is_mirror_symmetric(arm, kinds, tasks, space)
    choices = [choice for choice in product(range(len(kinds)), repeat=count) if not mirrored or choice <= choice[::-1]]
    progress = Progress(begun, seconds, callback, starts * len(choices))
    found: dict[str, OptimisedDesign] = {}
    infeasible: dict[str, str] = {}
    stopped = "finished"
    for choice in choices:
        name, own = _name(kinds, choice), _with_models(arm, [kinds[index] for index in choice])
        try:
            problem = Problem(feasible_designs(space, own, tasks), tasks, objective)
            points = starting_points(problem, own, starts, seed)
        except ValueError as error:
            infeasible[name] = str(error)
            continue
        ends, stopped = descend_all(problem, points, iterations, TOLERANCE, progress, keeper, name)
        found[name] = outcome(problem, own, space, points, ends, progress, stopped)
        if stopped != "finished":
            break
    if not found:
        raise ValueError(f"space: no architecture has a feasible design; {next(iter(infeasible.values()))}")
    order = sorted(found, key=lambda name: found[name].value)
    return Architectures(tuple(order), tuple(found[name] for name in order), infeasible, mirrored, stopped)


def _kinds(models: Any) -> tuple[Actuator, ...]:
    """The force models to choose from."""
    given = tuple(SHIPPED) if models is None else models
    if isinstance(given, str) or not isinstance(given, Sequence):
        raise ValueError(f"models: must be a list of force models, got {shown(given)}")
    return tuple(find_model(f"models[{index}]", model) for index, model in enumerate(given))


def _with_models(arm: ArmDesign, models: Sequence[Actuator]) -> ArmDesign:
    """The same geometry with other force models, and their limits."""
    rest = {"out_of_plane": arm.out_of_plane, "torsion_stiffness": arm.torsion_stiffness, "diameter": arm.diameter}
    return ArmDesign(arm.radii, arm.length, models, mass=arm.mass, **rest)


def _name(kinds: Sequence[Actuator], choice: Sequence[int]) -> str:
    letters = [type(kind).__name__[0] for kind in kinds]
    letters = letters if len(set(letters)) == len(letters) else [str(index + 1) for index in range(len(kinds))]
    return "".join(letters[index] for index in choice)


def is_mirror_symmetric(arm: ArmDesign, models: Sequence[Actuator], tasks: Sequence[Task], space: DesignSpace) -> bool:
    """Whether the choice of models is all that is not its own mirror image, α ↔ M + 1 - α, at the opposite offset.

    Where this cannot be told at a glance, as of groups of ties, loads along the arm or in space, the answer is no: both
    of two mirror images are tried, and nothing is lost.
    """
    diameter = arm.length if arm.diameter is None else arm.diameter
    return (
        arm.dimension == 2
        and _alike(arm.radii, -arm.radii.flip(-1))
        and all(_alike(value, value.flip(-1)) for value in (arm.length, diameter))
        and all(_bounds_are_mirrored(name, space.bounds[name], arm.actuator_count) for name in space.bounds)
        and (space.tied is None or isinstance(space.tied, str))
        and all(_is_odd(model) for model in models)
        and all(not task.load.points and not task.load.gravity for task in tasks)
        and _tasks_are_mirrored(tasks)
    )


def _alike(one: Tensor, other: Tensor) -> bool:
    return bool(((one - other).abs() <= SAME).all())


def _bounds_are_mirrored(name: str, bounds: Sequence[float | Sequence[float]], count: int) -> bool:
    try:
        low, high = (np.broadcast_to(np.asarray(end, dtype=np.float64), (count,)) for end in bounds)
    except (TypeError, ValueError):
        return False  # said where the bounds are put to use
    image = (-high[::-1], -low[::-1]) if name == "radii" else (low[::-1], high[::-1])
    return bool((np.abs(low - image[0]) <= SAME).all() and (np.abs(high - image[1]) <= SAME).all())


def _is_odd(model: Actuator) -> bool:
    """Whether a model bears the opposite moment at the opposite curvature."""
    if bending_model(model.bending_stiffness) is None:
        return True
    with torch.no_grad():
        moments = [part(model.bending_stiffness, CURVATURES) for part in (active_moment, passive_moment)]
    known = [moment for moment in moments if moment is not None]
    return all(bool(((one + one.flip(-1)).abs() <= SAME * one.abs().amax()).all()) for one in known)


def _tasks_are_mirrored(tasks: Sequence[Task]) -> bool:
    """Whether tasks under tip loads, reflected about the axis of the base, are the same tasks in some order."""
    rows: list[Any] = []
    images: list[Any] = []
    for task in tasks:
        twists = task.twists.detach().double().cpu().expand(*task.batch_shape, task.nodes, 3)
        load = task.tip_load.detach().double().cpu().expand(*task.batch_shape, 3)
        heading = 2 * float(task.base_pose[2])
        x, y, moment = load.unbind(-1)
        cos, sin = math.cos(heading), math.sin(heading)
        image = torch.stack((cos * x + sin * y, sin * x - cos * y, -moment), -1)
        flip = torch.tensor((1.0, -1.0, -1.0), dtype=torch.float64)
        about = (heading, task.wrench_at, task.nodes)
        for found, shape, wrench in ((rows, twists, load), (images, twists * flip, image)):
            whole = torch.cat((shape.flatten(-2), wrench), -1).reshape(-1, 3 * task.nodes + 3)
            found += [(about, *row) for row in (whole / 1e-9).round().add(0.0).tolist()]
    return all(
        one[0] == other[0] and all(abs(a - b) <= 1 for a, b in zip(one[1:], other[1:], strict=True))
        for one, other in zip(sorted(rows), sorted(images), strict=True)
    )
