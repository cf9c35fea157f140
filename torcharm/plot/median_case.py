"""The load that stands for all of a task: that of the median error; and the arm where it is predicted to be then."""

from typing import Any

import numpy as np
from torch import Tensor

from torcharm.attainability import Attainability
from torcharm.design.space import Arm
from torcharm.plot._common import array, like_shape, median_place, one_design, under_loads
from torcharm.plot._shapes import why_impossible
from torcharm.plot.arms import draw_arm, draw_wanted
from torcharm.task import Task


def median_case(found: Attainability) -> tuple[int, Tensor | None]:
    """The task of the median of the errors over their tolerances, and where the arm is predicted to be under it."""
    over = found.over_tolerance
    index = None if over is None else median_place(array(over).ravel())
    if index is None or found.prediction is None:
        return 0, None
    twists = found.prediction.twists.detach()
    twists = twists.reshape(-1, *twists.shape[-2:])[index]
    return index, twists if bool(twists.isfinite().all()) else None


def median_shape(task: Task, found: Attainability) -> Task:
    """The shape of that task, under all loads that it is to be held under."""
    return under_loads(task, np.flatnonzero(like_shape(task, median_case(found)[0])).tolist())


def is_lost(found: Attainability) -> bool:
    """Whether that task leaves the arm's centreline or an actuator no length: there are no forces to draw."""
    index = median_case(found)[0]
    impossible = found.verdict is not None and np.ravel(np.asarray(found.verdict))[index] == "impossible"
    return bool(impossible or found.impossible.reshape(-1)[index])


def draw_median_case(axes: Any, field: str, arm: Arm, task: Task, found: Attainability) -> int | None:
    """Draw one arm at that task; returns which load is drawn, or None where the task's shape is, under all its loads.

    Of an impossible task the centreline is drawn, and why. An error calls the arm by the field.
    """
    arm, (index, reached) = one_design(field, arm, task), median_case(found)
    if is_lost(found):
        draw_wanted(axes, arm, task.part(index), f"impossible: {why_impossible(arm, task.part(index))}")
    else:
        draw_arm(axes, arm, median_shape(task, found) if reached is None else task.part(index), reached)
    return None if reached is None else index
