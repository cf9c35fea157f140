"""Pages of shapes: what a pressure search reaches of a task, and what is planned through a tip pose."""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries
from torcharm.design.shape_planning import PlannedShape
from torcharm.geometry import rod
from torcharm.inputs import TensorLike
from torcharm.plot._common import (
    ATTAINABLE,
    Array,
    Mask,
    array,
    first_shape,
    legend_below,
    median_place,
    one_design,
    ranked_places,
    tip_errors,
)
from torcharm.plot.arms import draw_arm, draw_loads, draw_reached, draw_task
from torcharm.plot.space import arm_in_space, draw_tip_pose, poses_in_space, search_figure_in_space
from torcharm.pressure.search import PressureSearch
from torcharm.task import Task

RANKS = ("least", "largest", "median")
"""Of the tip errors under all loads, those whose shapes are drawn; of fewer loads the first."""
ORDER = ("least", "median", "largest")
"""From left to right."""
PANEL = 4.4
"""Width of a panel [inch],"""
MARGIN = 0.9
"""of which so much is for the labels of its axis."""
PLATE = 0.04
"""Half the width, at least, of the plate that stands for a pose, and how long the stem is on which it sits [m]."""


def search_figure(
    results: Sequence[tuple[str, ArmDesign | ArmSeries, PressureSearch]], task_name: str, task: Task
) -> Figure:
    """One page that shows how near a pressure search brings arms to a task, for `figure.savefig(path)`.

    A row for each arm; in it the arm where it gets to, and the task's centreline, under the loads of least, median and
    largest tip error. Loads under which no equilibrium was found are left out, and counted. Of several shapes the first
    is drawn. In space each arm is drawn under the load of median error.

    Args:
        results: names, designs, and what `search_pressure` found of each for all of the task.
        task_name: for the title.
        task: tasks of any batch shape; the last may be left out of a result, as an interruption does.

    Raises:
        ValueError: there is no result, a design is a batch, or a result is of more tasks than there are.
    """
    if not results:
        raise ValueError("results: must hold at least one arm, got none")
    if task.dimension == 3:
        return search_figure_in_space(results, task_name, task)
    first, drawn, shapes = first_shape(task)
    errors = [tip_errors(name, found.tip_error, len(drawn)) for name, _, found in results]
    errors = [np.where(drawn[: len(error)], error, np.nan) for error in errors]
    ranks = RANKS[: max(1, *(int(np.isfinite(error).sum()) for error in errors))]
    figure = Figure(layout="constrained", dpi=130)
    note = f"; drawn: the first of {shapes} shapes" if shapes > 1 else ""
    figure.suptitle(f"{task_name}: how near the best pressures bring the tip{note}", fontweight="bold")
    grid: Any = figure.subplots(len(results), len(ranks), squeeze=False)
    for row, (name, arm, found), error in zip(grid, results, errors, strict=True):
        _draw_row(row, name, one_design(name, arm), (first, drawn), found, error)
    _share(figure, grid)
    return figure


def _draw_row(
    row: Any, name: str, arm: ArmDesign, shown: tuple[Task, Mask], found: PressureSearch, error: Array
) -> None:
    """An arm under the loads of its least, median and largest error; NaN are those of shapes that are not drawn."""
    first, drawn = shown
    ranked = ranked_places(error)
    chosen = dict(zip(RANKS, (ranked[0], ranked[-1], median_place(error)), strict=True)) if len(ranked) else {}
    twists = found.twists.detach().reshape(-1, *found.twists.shape[-2:])
    turned = np.degrees(array(found.tip_rotation_error).ravel())
    lost = int(np.isinf(error).sum())
    ranks = sorted(RANKS[: min(len(row), len(ranked))], key=ORDER.index)
    for axes in row[len(ranks) :]:
        axes.set_axis_off()
    for axes, rank in zip(row, ranks, strict=False):
        load = int(chosen[rank])
        place = int(drawn[:load].sum())  # among the loads on the shape that is drawn
        at = Task(twists[load], first.tip_load, first.base_pose)
        draw_arm(axes, arm, at, reached=True)
        draw_task(axes, first)
        _draw_load(axes, at, place)
        off = f"tip off by {1e3 * error[load]:.3g} mm, turned by {turned[load]:.3g}°"
        axes.set_title(
            f"{name}: {_which(rank, len(ranked), lost)}\n{off}\n{_load(first, place, load)}", fontsize="medium"
        )
    if not len(ranked):
        row[0].set_title(f"{name}: no equilibrium was found", fontsize="medium")


def _which(rank: str, count: int, lost: int) -> str:
    whole = "only load" if count == 1 else f"{rank} error of {count} loads"
    return f"{whole}{f', {lost} not found' if lost else ''}"


def _load(first: Task, place: int, load: int) -> str:
    x, y, moment = array(first.tip_load)[place]
    return f"load {load + 1}: {np.hypot(x, y):.3g} N, {moment:.3g} N·m"


def plan_figure(
    shapes: Sequence[tuple[str, ArmDesign | ArmSeries, PlannedShape]],
    plan_name: str,
    tip_pose: TensorLike,
    tip_load: TensorLike,
    *,
    base_pose: TensorLike | str | None = None,
) -> Figure:
    """One page that shows planned shapes through a tip pose, for `figure.savefig(path)`.

    A panel for each arm: the arm at the shape planned, the tip pose, the load, and where the arm is predicted to be
    (in space the arm itself is drawn there, where that is known). Without a shape, the base and the tip pose alone.

    Args:
        shapes: names, designs, and what `plan_shape` found for each.
        plan_name: for the title.
        tip_pose: (3,) or (4, 4) as it was given to `plan_shape` [m, m, rad].
        tip_load: (3,) or (6,) the same [N, N·m].
        base_pose: the same; None hangs the arm.

    Raises:
        ValueError: there is no shape, or a design is a batch.
    """
    if not shapes:
        raise ValueError("shapes: must hold at least one arm, got none")
    if shapes[0][1].dimension == 3:
        return _plan_in_space(shapes, plan_name, tip_pose, tip_load, base_pose)
    figure = Figure(layout="constrained", dpi=130)
    figure.suptitle(f"{plan_name}: shapes through the tip pose", fontweight="bold")
    grid: Any = figure.subplots(1, len(shapes), squeeze=False)
    base = rod.BASE_POSE if base_pose is None else base_pose
    for axes, (name, arm, shape) in zip(grid[0], shapes, strict=True):
        design = one_design(name, arm)
        if shape.found:
            task = first_shape(Task(shape.twists, tip_load, base))[0]
            draw_arm(axes, design, task)
            _draw_load(axes, task, 0)
            axes.set_title(f"{name}: {_outcome(axes, shape, base)}", fontsize="medium")
        else:
            _draw_plate(axes, base, 7, "base")
            axes.set_title(f"{name}: {shape.status.split(':')[0]}", fontsize="medium")
        _draw_plate(axes, tip_pose, 3, "tip pose wanted")
        axes.set(xlabel="x [m]", ylabel="y [m]")
    _share(figure, grid, "shape planned")
    return figure


def _plan_in_space(
    shapes: Sequence[tuple[str, ArmDesign | ArmSeries, PlannedShape]],
    plan_name: str,
    tip_pose: TensorLike,
    tip_load: TensorLike,
    base_pose: TensorLike | str | None,
) -> Figure:
    goal, start = (array(Task(torch.eye(6)[:1], torch.zeros(6), pose).base_pose) for pose in (tip_pose, base_pose))
    figure = Figure(figsize=(max(9.0, 5.5 * len(shapes)), 6.5), layout="constrained")
    figure.suptitle(f"{plan_name}: shapes through the tip pose", fontweight="bold")
    for column, (name, arm, shape) in enumerate(shapes, 1):
        axes: Any = figure.add_subplot(1, len(shapes), column, projection="3d")
        result, verdict = shape.attainability, shape.status.split(":")[0]
        if shape.found:
            task, reached = Task(shape.twists, tip_load, base_pose), None
            if result is not None and result.prediction is not None:
                verdict = str(result.verdict)
                twists = result.prediction.twists.detach().reshape(shape.twists.shape)
                reached = twists if bool(twists.isfinite().all()) else None
            arm_in_space(arm, task, reached=reached, ax=axes)
            draw_tip_pose(axes, goal, PLATE)
            legend_below(axes, 0.0)
        else:
            poses_in_space(axes, start, goal, PLATE)
        axes.set_title(f"{name}: {verdict}", fontsize="medium")
    return figure


def _outcome(axes: Axes, shape: PlannedShape, base: TensorLike | str) -> str:
    """Draw where the arm is predicted to be, and say what is thought of that."""
    result = shape.attainability
    if result is None or result.prediction is None or result.tip_error is None:
        return "planned"
    off = 1e3 * float(result.tip_error)
    if not np.isfinite(off):
        return f"{result.verdict}"
    draw_reached(axes, result.prediction.twists.detach().reshape(shape.twists.shape), base, "predicted")
    return f"{result.verdict}\npredicted tip off by {off:.3g} mm"


def _draw_load(axes: Axes, task: Task, load: int) -> None:
    """The force of one load, or no arrow where there is none, at the scale of all of the task."""
    chosen = np.arange(len(task.tip_load)) == load
    draw_loads(axes, task, chosen & (array(task.tip_load)[:, :2] != 0).any(1), ATTAINABLE, width=0.006)


def _draw_plate(axes: Axes, pose: TensorLike | str, width: float, label: str) -> None:
    """A plate square to a pose's heading, for a tip with the stem on which it sits."""
    x, y, heading = array(Task([[1.0, 0.0, 0.0]], (0.0, 0.0, 0.0), pose).base_pose)
    along = np.array([np.cos(heading), np.sin(heading)])
    across = np.array([-along[1], along[0]])
    middle = np.array([x, y])
    half = max(PLATE, 0.08 * float(np.hypot(x, y)))  # seen from afar
    ends = [middle - half * across, middle + half * across]
    line = [*ends, middle, middle - half * along] if label != "base" else ends
    axes.plot(*np.transpose(line), color="black", linewidth=width, solid_capstyle="butt", zorder=4, label=label)


def _share(figure: Figure, grid: Any, centreline: str = "centreline") -> None:
    """The same limits in all panels, and one legend below; what differs stands in their titles."""
    shown = [axes for axes in grid.ravel() if axes.axison]
    whole = Bbox.union([axes.dataLim for axes in shown] or [Bbox.unit()])
    room = 0.06 * max(whole.width, whole.height)
    labels: dict[str, Any] = {}
    for axes in shown:
        axes.set_aspect("equal", adjustable="box")
        axes.set(xlim=(whole.x0 - room, whole.x1 + room), ylim=(whole.y0 - room, whole.y1 + room))
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            word = re.sub(r" \(\d+\)$|,.*", "", label)  # how many and how large differs
            labels.setdefault(centreline if word == "centreline" else word, handle)
    rows, columns = grid.shape
    height = (PANEL - MARGIN) * np.clip((whole.height + 2 * room) / (whole.width + 2 * room), 0.5, 1.6)
    figure.set_size_inches(max(2, columns) * PANEL, rows * (height + 1.3) + 0.9)
    figure.legend(
        labels.values(),
        labels.keys(),
        loc="outside lower center",
        ncols=4 if columns < 3 else 7,
        fontsize="small",
        frameon=False,
    )
