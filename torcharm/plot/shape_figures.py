"""Pages of shapes: what a pressure search reaches of a task, and what is planned through a tip pose."""

import re
from collections.abc import Sequence
from math import prod
from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure

from torcharm.attainability.verdict import PoseTolerance, over_tolerance
from torcharm.design.shape_planning import PlannedShape
from torcharm.design.space import Arm
from torcharm.inputs import TensorLike, three_digits
from torcharm.load import ExternalLoad
from torcharm.plot._common import (
    PLAIN,
    Array,
    array,
    merged_legend,
    one_design,
    projection_of,
    ranked_places,
    same_limits,
)
from torcharm.plot._shapes import in_space, why_impossible
from torcharm.plot.arms import (
    PLATE,
    TIP_WANTED,
    arrow_scale,
    draw_arm,
    draw_plate,
    draw_poses,
    draw_wanted,
)
from torcharm.plot.median_case import median_case
from torcharm.pressure.search import PressureSearch
from torcharm.task import Task

PANEL = 4.4
"""Width of a panel [inch],"""
MARGIN = 0.9
"""of which so much is for the labels of its axis."""


def search_figure(
    results: Sequence[tuple[str, Arm, PressureSearch]],
    task_name: str,
    task: Task,
    *,
    tolerance: PoseTolerance | None = None,
) -> Figure:
    """One page that shows how near a pressure search brings arms to a task, for `figure.savefig(path)`.

    A row for each arm; in it the arm where it gets to, and the task's centreline, under the loads of least, median and
    largest error, of tip, turn or shape, over its tolerance. Loads under which no equilibrium was found are left out,
    and counted; of an arm for which none was found, or an impossible task, the centreline wanted is drawn, and why.

    Args:
        results: names, designs, and what `search_pressure` found of each for all of the task.
        task_name: for the title.
        task: tasks of any batch shape; the last may be left out of a result, as an interruption does.
        tolerance: of the errors; None takes the default.

    Raises:
        ValueError: there is no result, a design is a batch, or a result is of more tasks than there are.
    """
    if not results:
        raise ValueError("results: must hold at least one arm, got none")
    arms = [one_design(name, arm, task) for name, arm, _ in results]
    near = PoseTolerance() if tolerance is None else tolerance
    errors = [_errors(name, arm, found, near, prod(task.batch_shape)) for name, arm, found in results]
    drawn = [_ranked_loads(error) for error in errors]
    pairs = [(arm, load) for arm, row in zip(arms, drawn, strict=True) for load in row.values()]
    scale = max((arrow_scale(arm, task.part(load)) for arm, load in pairs), default=0.0)
    figure = Figure(layout="constrained", dpi=130)
    figure.suptitle(f"{task_name}: how near the best pressures bring the tip", fontweight="bold", **PLAIN)
    grid = _panels(figure, len(results), max(1, *map(len, drawn)), task)
    for (name, _, found), arm, error, chosen, row in zip(results, arms, errors, drawn, grid, strict=True):
        twists = found.twists.detach().reshape(-1, *found.twists.shape[-2:])
        off_by = array(found.tip_error).ravel()
        turned, lost = np.degrees(array(found.tip_rotation_error).ravel()), int((~np.isfinite(error)).sum())
        for axes in row[len(chosen) :]:
            axes.set_axis_off()
        for axes, (rank, load) in zip(row, chosen.items(), strict=False):
            at = task.part(load)
            draw_arm(axes, arm, at, twists[load], scale)
            off = f"tip off by {three_digits(1e3 * off_by[load])} mm, turned by {three_digits(turned[load])}°"
            count = len(error) - lost
            which = "only load" if count == 1 else f"{rank} error of {count} loads"
            which += f", {lost} not found" if lost else ""
            axes.set_title(f"{name}: {which}\n{off}\n{_load(at, load)}", fontsize="medium", **PLAIN)
        if not chosen:
            row[0].set_axis_on()
            possible, wanted = bool(found.possible.any()), task.part(0)
            words = "no equilibrium was found" if possible else "impossible"
            draw_wanted(row[0], arm, wanted, words if possible else f"impossible: {why_impossible(arm, wanted)}")
            row[0].set_title(f"{name}: {words}", fontsize="medium", **PLAIN)
    _share(figure, grid)
    return figure


def _errors(name: str, arm: Arm, found: PressureSearch, tolerance: PoseTolerance, tasks: int) -> Array:
    """The largest error over its tolerance of the tasks that were searched; an interruption leaves fewer than all."""
    error = array(over_tolerance(arm, found, tolerance).amax(0)).ravel()
    if len(error) > tasks:
        raise ValueError(f"results: {name}: must be of at most {tasks} tasks, got {len(error)}")
    return error


def _ranked_loads(error: Array) -> dict[str, int]:
    """The tasks of least, median and largest error, or so many of these as there are."""
    ranked = ranked_places(error)
    last = len(ranked) - 1
    names = {last // 2: "median", last: "largest", 0: "least"}  # of few errors the later name counts
    return {names[place]: int(ranked[place]) for place in sorted(names) if last >= 0}


def _load(task: Task, load: int) -> str:
    force, moment = np.split(array(task.tip_load), [task.dimension])
    turn = float(moment[0] if len(moment) == 1 else np.linalg.norm(moment))
    return f"load {load + 1}: {np.linalg.norm(force):.3g} N, {turn:.3g} N·m"


def plan_figure(
    shapes: Sequence[tuple[str, Arm, PlannedShape]],
    plan_name: str,
    tip_pose: TensorLike,
    *,
    base_pose: TensorLike | str | None = None,
) -> Figure:
    """One page that shows planned shapes through a tip pose, for `figure.savefig(path)`.

    A panel for each arm: the shape planned, the tip pose, the loads, and the arm where it is predicted to be; of
    several loads under that of the median error. Without a shape, the base and the tip pose alone.

    Args:
        shapes: names, designs, and what `plan_shape` found for each.
        plan_name: for the title.
        tip_pose: (3,) or (4, 4) as it was given to `plan_shape` [m, m, rad].
        base_pose: the same; None hangs the arm.

    Raises:
        ValueError: there is no shape, or a design is a batch.
    """
    if not shapes:
        raise ValueError("shapes: must hold at least one arm, got none")
    line = torch.eye(3 * shapes[0][1].dimension - 3)[:1]
    goal, start = (Task(line, None, pose, ExternalLoad()) for pose in (tip_pose, base_pose))
    figure = Figure(layout="constrained", dpi=130)
    figure.suptitle(f"{plan_name}: shapes through the tip pose", fontweight="bold", **PLAIN)
    grid = _panels(figure, 1, len(shapes), start)
    tip, base = (in_space(one.base_pose) for one in (goal, start))
    half = max(PLATE, 0.08 * float(np.linalg.norm((tip - base)[:3, 3])))  # seen from afar
    for axes, (name, arm, shape) in zip(grid[0], shapes, strict=True):
        result = shape.attainability
        if result is None:
            draw_poses(axes, base, tip, half)
            axes.set_title(f"{name}: {shape.status.split(':')[0]}", fontsize="medium", **PLAIN)
            continue
        index, reached = median_case(result)
        draw_arm(axes, one_design(name, arm, start), result.task.part(index), reached)
        draw_plate(axes, tip, half, TIP_WANTED)
        words = "planned" if result.verdict is None else str(np.ravel(result.verdict)[index])
        if reached is not None and result.tip_error is not None:
            words += f"\npredicted tip off by {three_digits(1e3 * float(result.tip_error.reshape(-1)[index]))} mm"
        axes.set_title(f"{name}: {words}", fontsize="medium", **PLAIN)
    _share(figure, grid)
    return figure


def _panels(figure: Figure, rows: int, columns: int, task: Task) -> Any:
    return figure.subplots(rows, columns, squeeze=False, subplot_kw={"projection": projection_of(task)})


def _share(figure: Figure, grid: Any) -> None:
    """The same limits in all panels of the plane, and one legend below; what differs stands in their titles."""
    shown = [axes for axes in grid.ravel() if axes.get_legend_handles_labels()[0]]
    rows, columns = grid.shape
    height = PANEL
    if shown and shown[0].name != "3d":
        for axes in shown:
            axes.set_aspect("equal", adjustable="box")
        height = (PANEL - MARGIN) * min(same_limits(shown), 1.6)
    figure.set_size_inches(max(2, columns) * PANEL, rows * (height + 1.3) + 0.9)
    where: dict[str, Any] = {"loc": "outside lower center", "ncols": 4 if columns < 3 else 7}
    # how many and how large differs
    merged_legend(figure, shown, lambda label: re.sub(r" \(\d+\)$|,.*", "", label), **where)
