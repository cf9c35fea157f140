"""Which architecture? Every choice of a force model for every position, each with its best design."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from os import PathLike
from pathlib import Path
from typing import Any

from torcharm.actuators import SHIPPED, Actuator
from torcharm.arm import find_model
from torcharm.arm_series import rebuilt, segments_of, with_slices
from torcharm.attainability import PoseTolerance
from torcharm.design.checkpoint import Checkpoint, describe
from torcharm.design.descent import Callback, Progress, descend_all
from torcharm.design.feasible import feasible_designs
from torcharm.design.objective import Objective, Problem
from torcharm.design.optimise import ITERATIONS, TOLERANCE, best_first, check_arguments, outcome, starting_points
from torcharm.design.result import OptimisedDesign
from torcharm.design.space import Arm, DesignSpace
from torcharm.design.symmetry import symmetries
from torcharm.inputs import HoldsTensors, shown
from torcharm.task import Task

MOST_ARCHITECTURES = 4096


@dataclass(frozen=True, eq=False, repr=False)
class Architectures(HoldsTensors):
    """The best design of every architecture, the best architecture first: of comparable ones, that which holds most.

    Attributes:
        names: a letter for each position, as "BMMB"; digits where the models' first letters are alike.
        designs: what was found for each.
        infeasible: why others have no design that satisfies the constraints, by name.
        merged: whether of architectures that are each other's image, mirrored or turned, only one was tried.
        stopped: "finished", or what stopped it before all were tried.

    Example:
        >>> arm, task = ta.ArmDesign([-0.05, 0.05], 0.5, "bellows"), ta.Task(ta.constant_curvature(0.5), [2, -2, 0.2])
        >>> ta.optimise_architectures(arm, task, starts=1, iterations=1).designs[0].best  # of the best architecture
        ArmDesign(planar, 2 mckibben, batch (), torch.float64)
    """

    names: tuple[str, ...]
    designs: tuple[OptimisedDesign, ...]
    infeasible: dict[str, str]
    merged: bool
    stopped: str

    def __repr__(self) -> str:
        """The best three, and counts."""
        shown_ = [f"{name} {one.value:.4g}" for name, one in zip(self.names, self.designs, strict=True)]
        more = f" and {len(shown_) - 3} more" if len(shown_) > 3 else ""
        return f"Architectures({', '.join(shown_[:3])}{more}; {len(self.infeasible)} infeasible; {self.stopped})"


def optimise_architectures(
    arm: Arm,
    task: Task | Sequence[Task],
    space: DesignSpace | None = None,
    objective: Objective | None = None,
    *,
    models: Sequence[Actuator | str | Path] | None = None,
    starts: int = 4,
    seed: int = 0,
    iterations: int = ITERATIONS,
    seconds: float | None = None,
    tolerance: PoseTolerance | float | None = None,
    checkpoint: str | PathLike[str] | None = None,
    callback: Callback | None = None,
) -> Architectures:
    """Optimise the geometry of every architecture.

    K models at M positions, segment after segment, make K^M architectures. An architecture and its image (the same arm
    mounted the other way round, in space also turned about its backbone) are the same problem if the tasks, the offsets
    and lengths given, bounds, ties and each model's bending moments all are their own image, and only then one of them
    is tried; a ring whose angles are free may turn whatever the tasks. Of segments in series all are tried.

    Args:
        arm: gives the positions, and geometry to start from; or segments in series.
        models: to choose from, given as an arm's actuators are; None takes the shipped ones, the paper's bellows and
            muscle. Limits are the models' own.
        starts: for each architecture.

    The other arguments are those of `optimise_design`.

    Raises:
        ValueError: as for `optimise_design`; no architecture is feasible; or there are too many.

    Example:
        >>> arm, task = ta.ArmDesign([-0.05, 0.05], 0.5, "bellows"), ta.Task(ta.constant_curvature(0.5), [2, -2, 0.2])
        >>> ta.optimise_architectures(arm, task, starts=1, iterations=1).names[0]  # B is for bellows, M for muscles
        'MM'
    """
    progress = Progress(callback, starts, seconds)
    space, objective = space or DesignSpace(), objective or Objective()
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
        asked = {"space": space, "objective": objective, "seed": seed, "iterations": iterations}
        keeper = Checkpoint(checkpoint, describe(own, kinds, tasks, **asked, search="architectures"))
    orders = symmetries(arm, kinds, tasks, space)
    every = product(range(len(kinds)), repeat=count)
    choices = [one for one in every if all(one <= tuple(one[index] for index in order) for order in orders)]
    progress.starts = starts * len(choices)
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
        found[name] = outcome(problem, own, space, points, ends, progress, stopped, tolerance)
        if stopped != "finished":
            break
    if not found:
        raise ValueError(f"space: no architecture has a feasible design; {next(iter(infeasible.values()))}")
    names = list(found)
    order = [names[i] for i in best_first([one.value for one in found.values()], [one.held for one in found.values()])]
    return Architectures(tuple(order), tuple(found[name] for name in order), infeasible, len(orders) > 1, stopped)


def _kinds(models: Any) -> tuple[Actuator, ...]:
    """The force models to choose from."""
    given = tuple(SHIPPED) if models is None else models
    if isinstance(given, str) or not isinstance(given, Sequence):
        raise ValueError(f"models: must be a list of force models, got {shown(given)}")
    return tuple(find_model(f"models[{index}]", model) for index, model in enumerate(given))


def _with_models(arm: Arm, models: Sequence[Actuator]) -> Arm:
    """The same geometry with other force models, and their limits."""
    own: dict[str, Any] = {"max_pressure": None, "deviation": None}  # of the models that were
    made = [replace(one, actuators=tuple(models[at]), **own) for one, at in with_slices(segments_of(arm)[0])]
    return rebuilt(arm, made)


def _name(kinds: Sequence[Actuator], choice: Sequence[int]) -> str:
    letters = [type(kind).__name__[0] for kind in kinds]
    letters = letters if len(set(letters)) == len(letters) else [str(index + 1) for index in range(len(kinds))]
    return "".join(letters[index] for index in choice)
