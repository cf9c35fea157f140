"""The load that stands for all of a task: that of the median error; and the arm where it is predicted to be then."""

from typing import Any

import numpy as np
from torch import Tensor

from torcharm.attainability import Attainability
from torcharm.design.space import Arm
from torcharm.plot._common import array, like_shape, median_place, under_loads
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


def median_shape(found: Attainability) -> Task:
    """The shape of that task, under all loads that it is to be held under."""
    return under_loads(found.task, np.flatnonzero(like_shape(found.task, median_case(found)[0])).tolist())


def is_lost(found: Attainability) -> bool:
    """Whether that task leaves the arm's centreline or an actuator no length: there are no forces to draw."""
    index = median_case(found)[0]
    impossible = found.verdict is not None and np.ravel(np.asarray(found.verdict))[index] == "impossible"
    return bool(impossible or found.impossible.reshape(-1)[index])


def draw_median_case(axes: Any, arm: Arm, found: Attainability) -> int | None:
    """Draw an arm at that task; returns which load is drawn, or None where the task's shape is, under all its loads.

    Of an impossible task the centreline is drawn, and why.
    """
    index, reached = median_case(found)
    task = found.task.part(index)
    if is_lost(found):
        draw_wanted(axes, arm, task, f"impossible: {why_impossible(arm, task)}")
    else:
        draw_arm(axes, arm, median_shape(found) if reached is None else task, reached)
    return None if reached is None else index
