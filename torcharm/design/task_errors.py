"""How far off one design is on every task: as predicted, and as the pressure search finds."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torcharm.attainability import PREDICTED, PoseTolerance, evaluate
from torcharm.design.space import Arm
from torcharm.inputs import HoldsTensors
from torcharm.pressure.followed import beyond_range
from torcharm.pressure.pose_cost import PoseCost
from torcharm.pressure.predicted_error import PredictedError
from torcharm.pressure.search import PressureSearch, search_pressure
from torcharm.task import Task


@dataclass(frozen=True, eq=False)
class TaskErrors(HoldsTensors):
    """Of one design on T tasks.

    Attributes:
        tip_error, shape_error: (T,) [m]; infinite where no stable equilibrium was found.
        pressure: (T, M) that reaches them [kPa].
        converged: (T,) whether no pressure nearby is known to do better; where not, errors are reached all the same.
        stable: (T,) whether an equilibrium was found at which the arm stays.
        in_range: (T,) whether its strains and pressures are in the characterised range.
        beyond: (T,) by which share of its range's width a strain leaves it, the largest; negative within.
    """

    tip_error: Tensor
    shape_error: Tensor
    pressure: Tensor
    converged: Tensor
    stable: Tensor
    in_range: Tensor
    beyond: Tensor

    @classmethod
    def of(cls, arm: Arm, tasks: Sequence[Task], found: Sequence[PredictedError | PressureSearch]) -> "TaskErrors":
        """From what was found of a design for each batch of tasks, all together."""

        def whole(name: str) -> Tensor:
            return torch.cat([getattr(one, name).detach().reshape(-1) for one in found])

        pressure = torch.cat([one.pressure.detach().reshape(-1, one.pressure.shape[-1]) for one in found])
        errors = whole("tip_error"), whole("shape_error")
        beyond = [beyond_range(arm, task, one.twists).reshape(-1) for task, one in zip(tasks, found, strict=True)]
        return cls(*errors, pressure, whole("at_minimum"), whole("stable"), whole("in_range"), torch.cat(beyond))

    @property
    def tip_mm(self) -> float:
        """The mean tip error [mm] of the tasks that have a stable equilibrium; NaN if none has."""
        return 1e3 * float(self.tip_error[self.stable].mean())

    def shape_mm(self, over: str = "mean") -> float:
        """The mean shape error [mm] of the tasks that have a stable equilibrium, or the "worst"; NaN if none has."""
        error = 1e3 * self.shape_error[self.stable]
        return float(error.amax() if over == "worst" and len(error) else error.mean())

    @property
    def out_of_range(self) -> int:
        """On how many tasks the stable equilibrium has strains or pressures beyond their range."""
        return int((self.stable & ~self.in_range).sum())

    @property
    def lost(self) -> int:
        """How many tasks have no stable equilibrium."""
        return int((~self.stable).sum())


def predicted(
    arm: Arm, tasks: Sequence[Task], cost: PoseCost | None, tolerance: PoseTolerance | float | None
) -> tuple[TaskErrors, int]:
    """What is predicted of one design on all tasks, and how many it holds, by the verdict of `torcharm.evaluate`."""
    with torch.no_grad():
        found = [evaluate(arm, task, PREDICTED, tolerance=tolerance, pose_cost=cost) for task in tasks]
        errors = TaskErrors.of(arm, tasks, [one.prediction for one in found if one.prediction is not None])
    return errors, sum(int(np.sum(np.array(one.verdict) == "held")) for one in found)


def searched(
    arm: Arm, tasks: Sequence[Task], cost: PoseCost | None, starts: int | None = None, seed: int = 0
) -> TaskErrors:
    """What the search, which raises the loads from zero, reaches with one design on all tasks."""
    with torch.no_grad():
        options: dict[str, Any] = {"starts": starts, "pose_cost": cost, "seed": seed}
        return TaskErrors.of(arm, tasks, [search_pressure(arm, task, **options) for task in tasks])
