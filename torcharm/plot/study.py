"""One page that compares arms on a task: how far off they are first, then the arms, then why."""

import textwrap
from collections.abc import Sequence
from math import prod
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from torcharm.attainability import Attainability
from torcharm.design.space import Arm
from torcharm.inputs import three_digits
from torcharm.plot._common import (
    ARM_COLOURS,
    PLAIN,
    Array,
    array,
    counted,
    label_powers,
    legend_below,
    limits_around,
    merged_legend,
    one_design,
    projection_of,
    verdict_marks,
    verdict_words,
    worst_node,
)
from torcharm.plot.hulls import SIDES, Scene, draw_node, make_scene
from torcharm.plot.median_case import draw_median_case, is_lost, median_shape
from torcharm.task import Task

LEAST = 0.01
"""What is off by less [tolerances or N] is drawn there: a logarithmic axis has no zero."""


def study_figure(
    results: Sequence[tuple[str, Arm]], task_name: str, task: Task, evaluated: Sequence[Attainability]
) -> Figure:
    """One page that compares arms on one task, for `figure.savefig(path)`.

    On top how far off each arm is: the largest of the errors of tip, turn and shape, each over its tolerance, with a
    mark for each task by its verdict; where no error was predicted, what the nodes lack in sum. Below a column for each
    arm: the arm where it is predicted to be under the load of the median error, beside the shape of that task, or at
    that shape under all loads where nothing is predicted; and what pressures provide and all loads on that shape
    require: in the plane at the base and at the node that lacks most, in space at the latter, seen along each axis. Of
    an impossible task the centreline alone is drawn, with the reason: there are no forces of actuators without length.

    Args:
        results: names and designs.
        task_name: for the title.
        task, evaluated: tasks of any batch shape, and what `evaluate` found on them for each arm.

    Raises:
        ValueError: results, task and evaluated do not fit each other, or a name comes twice.
    """
    _check(results, evaluated, prod(task.batch_shape))
    results = [(name, one_design(f"results[{place}]", arm, task)) for place, (name, arm) in enumerate(results)]
    columns, flat = len(results), task.dimension == 2
    figure = Figure(figsize=(max(9.0, 5.5 * columns), 11.0 + 0.3 * columns), layout="constrained")
    lost = list(map(is_lost, evaluated))
    heights = (1.2 + 0.4 * columns, 5.0 if flat else 6.0, *([] if all(lost) else [3.2]))
    rows: Any = figure.subfigures(len(heights), 1, height_ratios=heights)
    figure.suptitle(task_name, fontsize="large", fontweight="bold", **PLAIN)
    _draw_errors(rows[0].add_subplot(), [name for name, _ in results], evaluated)
    panels = columns * (2 if flat else 3)
    cells = None if all(lost) else rows[2].subplots(1, panels, squeeze=False)[0].reshape(columns, -1)
    scenes, views = [], []
    for column, ((name, arm), found) in enumerate(zip(results, evaluated, strict=True)):
        axes = rows[1].add_subplot(1, columns, column + 1, projection=projection_of(task))
        shown = draw_median_case(axes, arm, found)
        drawn = "" if shown is None else f"\ndrawn: load {shown + 1} of {prod(task.batch_shape)}"
        if not lost[column]:
            scenes.append(make_scene(arm, median_shape(found)))
        title = textwrap.fill(f"{name}: {counted(verdict_words(found))}", 60)
        axes.set_title(f"{title}{drawn}", fontsize="medium", **PLAIN)
        legend_below(axes, 2)
        for panel, (node, sides) in zip([] if cells is None else cells[column], _views(found), strict=False):
            if lost[column]:
                panel.set_axis_off()
                continue
            draw_node(panel, scenes[-1], node, sides, ARM_COLOURS[column % len(ARM_COLOURS)])
            inside = scenes[-1].inside[:, node]
            which = f"node {node + 1} of {task.nodes}\n{inside.sum()} of {len(inside)} inside"
            panel.set_title(f"{textwrap.fill(name, 26)}\n{which}", fontsize="small", **PLAIN)
            views.append((panel, sides))
    if views:
        limit_views(views, scenes)
        # how many is in the titles
        merged_legend(rows[2], [views[0][0]], lambda label: label.split(":")[0], loc="outside lower center", ncols=3)
    return figure


def limit_views(views: Sequence[tuple[Axes, tuple[int, int]]], scenes: Sequence[Scene]) -> None:
    """The same limits for all panels, around the sets and most of what is required: some loads ask for far more."""
    size = len(scenes[0].labels)
    sets = np.concatenate([scene.corners.reshape(-1, size) for scene in scenes])
    required = np.concatenate([scene.required.reshape(-1, size) for scene in scenes])
    limits = limits_around(np.stack([*np.percentile(required, (2, 98), 0), sets.min(0), sets.max(0)]), 0.06)
    for panel, (x, y) in views:
        panel.set(xlim=limits[x], ylim=limits[y])
        panel.xaxis.set_major_locator(MaxNLocator(4 if size == 2 else 2))  # three panels are small


def _check(results: Sequence[tuple[str, Arm]], evaluated: Sequence[Attainability], tasks: int) -> None:
    """Raise a ValueError unless arms have names of their own and results of all tasks."""
    names = [name for name, _ in results]
    if not names or len(set(names)) < len(names):
        raise ValueError(f"results: must be one or more arms of different names, got {names}")
    if len(evaluated) != len(names):
        raise ValueError(f"evaluated: must hold one entry for each of the {len(names)} results, got {len(evaluated)}")
    for index, found in enumerate(evaluated):
        if found.strain_excess.numel() != tasks:
            given = f"got shape {tuple(found.strain_excess.shape)}"
            raise ValueError(f"evaluated[{index}]: must hold one value for each of {tasks} tasks, {given}")


def _draw_errors(axes: Any, names: Sequence[str], evaluated: Sequence[Attainability]) -> None:
    """A row of marks for each arm, one for each task, with its median and how many are held."""
    predicted = all(found.prediction is not None for found in evaluated)
    values = [_value(found, predicted=predicted) for found in evaluated]
    finite = np.concatenate([value[np.isfinite(value)] for value in values])
    most = 2 * max(finite.max(initial=LEAST), 1.0 if predicted else 10 * LEAST)  # the tolerance is 1
    drawn: set[str] = set()
    for row, (value, found) in enumerate(zip(values, evaluated, strict=True)):
        words = verdict_words(found)
        spread = row + 0.22 * np.sin(2.4 * np.arange(len(value)))  # apart, so that marks of equal errors are seen
        place = np.clip(np.where(np.isfinite(value), value, most), LEAST, most)
        for word, chosen, inks in verdict_marks(words):
            label = word if word not in drawn else None
            axes.scatter(place[chosen], spread[chosen], 28, label=label, gid=word, **inks)
            drawn.add(word)
        middle = float(np.median(np.where(np.isnan(value), np.inf, value)))
        if not np.isfinite(middle):
            note = {"fontsize": "small", "va": "bottom", "ha": "left", "transform": axes.get_yaxis_transform()}
            axes.text(0.01, row - 0.1, _why_none(found, value, words), **note)
            continue
        middle = max(middle, LEAST)
        axes.plot([middle] * 2, [row - 0.38, row + 0.38], color="black", linewidth=2)
        tip = f" (tip: {_tip_off(found)} mm)" if predicted else ""
        side = "left" if middle < most / 4 else "right"
        axes.annotate(f" {middle:.3g}{tip} ", (middle, row - 0.4), fontsize="small", va="bottom", ha=side)
    if predicted:
        axes.axvline(1.0, color="black", linestyle=":", linewidth=1, label=_tolerances(evaluated))
    axes.set_xscale("log")
    label_powers(axes.xaxis)
    least = max(LEAST, finite[finite > 0].min(initial=1.0 if predicted else most))
    axes.set(xlim=(least / 1.5, 1.3 * most), ylim=(len(names) - 0.45, -0.75), yticks=range(len(names)))
    axes.set_yticklabels(names, **PLAIN)
    errors = "predicted error over its tolerance, the largest of tip, turn and shape"
    what = errors if predicted else "absolute unattainability [N]"
    edge = "" if len(finite) == sum(map(len, values)) else "; at the right edge, none was found"
    axes.set_xlabel(f"{what}\nbars are medians{edge}")
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize="small", frameon=False)


def _why_none(found: Attainability, value: Array, words: Any) -> str:
    """Why there is no median: the verdict on most of the tasks without an error, and of impossible ones why."""
    lost = np.flatnonzero(~np.isfinite(value))
    if found.prediction is None:
        return "no median: most have no number"
    if (words[lost] == "impossible").all():
        return f"impossible: {textwrap.shorten(str(np.ravel(np.asarray(found.reason))[lost[0]]), 90)}"
    return f"no median: of {len(lost)} of {len(words)} no stable shape was found"


def _tolerances(evaluated: Sequence[Attainability]) -> str:
    """What the arms are allowed, in words; tolerances that follow their lengths may differ."""
    ends = 1e3 * np.array([[float(end.max()) for end in found.tolerance.lengths(found.arm)] for found in evaluated])
    tip, shape = (" to ".join(dict.fromkeys(f"{end:.3g}" for end in (own.min(), own.max()))) for own in ends.T)
    lengths = f"tip, shape {tip} mm" if tip == shape else f"tip {tip} mm, shape {shape} mm"
    return f"tolerance:\n{lengths},\nturn {np.degrees(evaluated[0].tolerance.rotation):.3g}°"


def _tip_off(found: Attainability) -> str:
    """The median of the tip's errors [mm]."""
    assert found.tip_error is not None
    return three_digits(1e3 * float(np.median(array(found.tip_error))))


def _value(found: Attainability, *, predicted: bool) -> Array:
    """Of each task the largest error over its tolerance, or what nodes lack in sum, by the first metric there is."""
    lack = found.relative if found.absolute is None else found.absolute
    value = found.over_tolerance if predicted else lack
    return np.full(found.strain_excess.numel(), np.nan) if value is None else array(value).ravel()


def _views(found: Attainability) -> list[tuple[int, tuple[int, int]]]:
    """The nodes to draw, and by which components: the one that lacks most on average, in the plane behind the base."""
    worst = worst_node(found)
    if found.task.dimension == 3:
        return [(worst, sides) for sides in SIDES]
    return [(0, SIDES[0]), (worst or found.task.nodes - 1, SIDES[0])]
