"""One page that compares arms on a task: how far off they are first, then the arms, then why."""

import textwrap
from collections.abc import Mapping, Sequence
from math import prod
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries
from torcharm.attainability import VERDICTS, Attainability
from torcharm.plot._common import (
    ARM_COLOURS,
    ATTAINABLE,
    UNATTAINABLE,
    VERDICT_STYLES,
    Array,
    Mask,
    array,
    first_shape,
    mark_inks,
    median_place,
    one_design,
)
from torcharm.plot.arms import draw_arm, draw_loads, draw_reached
from torcharm.plot.hulls import draw_node, limit_node_axes, make_scene
from torcharm.plot.space import arm_in_space, one_task
from torcharm.task import Task

LEAST = 0.01
"""What is off by less [tolerances or N] is drawn there: a logarithmic axis has no zero."""


def study_figure(
    results: Sequence[tuple[str, ArmDesign | ArmSeries]],
    task_name: str,
    task: Task,
    evaluated: Sequence[Attainability],
    *,
    hull: str = "exact",
    samples: int | None = None,
) -> Figure:
    """One page that compares arms on one task, for `figure.savefig(path)`.

    On top how far off each arm is: the largest of the errors of tip, turn and shape, each over its tolerance, with a
    mark for each task by its verdict; where no error was predicted, what the nodes lack in sum. Below a column for each
    arm: the arm at the shape with the loads on it, and where it is predicted to be under the load with the median
    error; and the attainable sets of the base and of the node that lacks most, with what the loads require. Of several
    shapes the first is drawn. In space the column shows the arm under the load with the median error, and what its
    nodes lack.

    Args:
        results: names and designs.
        task_name: for the title.
        task, evaluated: tasks of any batch shape, and what `evaluate` found on them for each arm.
        hull, samples: as they were given to `evaluate`.

    Raises:
        ValueError: results, task and evaluated do not fit each other, or a name comes twice.
    """
    if task.dimension == 3:
        return _figure_in_space(results, task_name, task, evaluated)
    first, drawn, shapes = first_shape(task)
    arms = {name: one_design(f"results[{index}]", arm) for index, (name, arm) in enumerate(results)}
    _check(results, arms, evaluated, len(drawn))
    columns = len(arms)
    figure = Figure(figsize=(max(9.0, 5.0 * columns), 10.0 + 0.3 * columns), layout="constrained")
    rows: Any = figure.subfigures(3, 1, height_ratios=(1.2 + 0.4 * columns, 5.0, 3.2))
    note = f"; drawn: the first of {shapes} shapes, {drawn.sum()} of {len(drawn)} tasks" if shapes > 1 else ""
    figure.suptitle(f"{task_name}{note}", fontsize="large", fontweight="bold")
    _draw_errors(rows[0].add_subplot(), list(arms), evaluated)
    scenes = [make_scene(arm, first, False, hull, samples) for arm in arms.values()]
    pairs = [_two_nodes(found, first.nodes) for found in evaluated]
    panels = list(rows[2].subplots(1, 2 * columns, squeeze=False)[0])
    for column, (name, arm) in enumerate(arms.items()):
        found, axes = evaluated[column], rows[1].add_subplot(1, columns, column + 1)
        axes.set_title(textwrap.fill(f"{name}: {_counts(found)}", 60), fontsize="medium")
        draw_arm(axes, arm, first)
        draw_loads(axes, first, np.ones(len(first.tip_load), bool), ATTAINABLE, width=0.003)
        _draw_predicted(axes, first, found, drawn)
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=2, fontsize="small", frameon=False)
        for place, node in enumerate(pairs[column]):
            panel = panels[2 * column + place]
            draw_node(panel, scenes[column], node, ARM_COLOURS[column % len(ARM_COLOURS)])
            inside = scenes[column].inside[:, node]
            counted = f"{inside.sum()} of {len(inside)} inside"
            which = textwrap.fill(name, 26)
            panel.set_title(f"{which}\nnode {node + 1} of {first.nodes}\n{counted}", fontsize="small")
    limit_node_axes(panels, scenes)
    handles, labels = panels[0].get_legend_handles_labels()
    labels = [label.split(":")[0] for label in labels]  # how many is in the titles
    rows[2].legend(handles, labels, loc="outside lower center", ncols=3, fontsize="small", frameon=False)
    return figure


def _figure_in_space(
    results: Sequence[tuple[str, ArmDesign | ArmSeries]],
    task_name: str,
    task: Task,
    evaluated: Sequence[Attainability],
) -> Figure:
    """The page of a task in space."""
    arms, columns = dict(results), len(results)
    _check(results, arms, evaluated, prod(task.batch_shape))
    figure = Figure(figsize=(max(9.0, 5.5 * columns), 11.0 + 0.3 * columns), layout="constrained")
    rows: Any = figure.subfigures(3, 1, height_ratios=(1.2 + 0.4 * columns, 6.5, 2.8))
    figure.suptitle(task_name, fontsize="large", fontweight="bold")
    _draw_errors(rows[0].add_subplot(), list(arms), evaluated)
    for column, ((name, arm), found) in enumerate(zip(arms.items(), evaluated, strict=True), 1):
        axes: Any = rows[1].add_subplot(1, columns, column, projection="3d")
        error = np.zeros(found.strain_excess.numel()) if found.prediction is None else _off(found)
        load = median_place(error) or 0
        twists = None if found.prediction is None else found.prediction.twists.detach().flatten(0, -3)[load]
        known = twists is not None and bool(twists.isfinite().all())
        arm_in_space(arm, one_task(task, load), reached=twists if known else None, ax=axes)
        axes.set_title(f"{name}: {_counts(found)}\ndrawn: load {load + 1} of {len(error)}", fontsize="medium")
        panel = rows[2].add_subplot(1, columns, column)
        _draw_lacking(panel, found, task)
        panel.set_title(f"{name}: what nodes lack", fontsize="small")
    return figure


def _draw_lacking(axes: Any, found: Attainability, task: Task) -> None:
    """What each node lacks of the wrench that it needs: the mean over the loads, and the largest."""
    if found.node_miss is not None:
        miss, nodes = array(found.node_miss).reshape(-1, task.nodes), np.arange(1, task.nodes + 1)
        axes.bar(nodes, miss.mean(0), color=UNATTAINABLE, label="mean of the loads")
        axes.plot(nodes, miss.max(0), "_", color=ATTAINABLE, markersize=9, label="largest")
        axes.legend(fontsize="small", frameon=False)
    for end in np.cumsum(task.segment_nodes or ())[:-1]:
        axes.axvline(end + 0.5, color="0.6", linestyle=":")
    axes.set(xlabel="node, 1 at the base", ylabel="lacking [N]", ylim=(0, max(axes.get_ylim()[1], LEAST)))


def _check(
    results: Sequence[tuple[str, Any]], arms: Mapping[str, Any], evaluated: Sequence[Attainability], tasks: int
) -> None:
    """Raise a ValueError unless arms have names of their own and results of all tasks."""
    if not arms or len(arms) < len(results):
        raise ValueError(f"results: must be one or more arms of different names, got {[name for name, _ in results]}")
    if len(evaluated) != len(arms):
        raise ValueError(f"evaluated: must hold one entry for each of the {len(arms)} results, got {len(evaluated)}")
    for index, found in enumerate(evaluated):
        if found.strain_excess.numel() != tasks:
            given = f"got shape {tuple(found.strain_excess.shape)}"
            raise ValueError(f"evaluated[{index}]: must hold one value for each of {tasks} tasks, {given}")


def _draw_errors(axes: Any, names: Sequence[str], evaluated: Sequence[Attainability]) -> None:
    """A row of marks for each arm, one for each task, with its median and how many are held."""
    predicted = all(found.prediction is not None for found in evaluated)
    values = [_over(found) if predicted else _lacking(found) for found in evaluated]
    finite = np.concatenate([value[np.isfinite(value)] for value in values])
    most = 2 * max(finite.max(initial=LEAST), 1.0 if predicted else 10 * LEAST)  # the tolerance is 1
    drawn: set[str] = set()
    for row, (value, found) in enumerate(zip(values, evaluated, strict=True)):
        words = _words(found)
        spread = row + 0.22 * np.sin(2.4 * np.arange(len(value)))  # apart, so that marks of equal errors are seen
        place = np.clip(np.where(np.isfinite(value), value, most), LEAST, most)
        for word, (colour, marker, filled) in VERDICT_STYLES.items():
            chosen = words == word
            if chosen.any():
                label = word if word not in drawn else None
                inks = mark_inks(colour, filled, marker)
                axes.scatter(place[chosen], spread[chosen], 28, label=label, gid=word, **inks)
                drawn.add(word)
        middle = float(np.clip(np.median(place), LEAST, most))
        axes.plot([middle] * 2, [row - 0.38, row + 0.38], color="black", linewidth=2)
        tip = f" (tip: {np.median(_off(found)):.3g} mm)" if predicted else ""
        axes.annotate(f" {middle:.3g}{tip}", (middle, row - 0.4), fontsize="small", va="bottom", ha="left")
    if predicted:
        axes.axvline(1.0, color="black", linestyle=":", linewidth=1, label=_tolerances(evaluated))
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    least = max(LEAST, finite[finite > 0].min(initial=1.0 if predicted else most))
    axes.set(xlim=(least / 1.5, 1.3 * most), ylim=(len(names) - 0.45, -0.75), yticks=range(len(names)))
    axes.set_yticklabels(names)
    errors = "predicted error over its tolerance, the largest of tip, turn and shape"
    what = errors if predicted else "absolute unattainability [N]"
    axes.set_xlabel(f"{what}\nbars are medians; at the right edge, none was found")
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize="small", frameon=False)


def _tolerances(evaluated: Sequence[Attainability]) -> str:
    """What the arms are allowed, in words; tolerances that follow their lengths may differ."""
    allowed = evaluated[0].tolerance
    tip, shape = (
        sorted({f"{1e3 * float(found.tolerance.lengths(found.arm)[end].max()):.3g}" for found in evaluated}, key=float)
        for end in (0, 1)
    )
    spans = [" to ".join((span[0], span[-1])[: len(span)]) for span in (tip, shape)]
    lengths = f"tip, shape {spans[0]} mm" if tip == shape else f"tip {spans[0]} mm, shape {spans[1]} mm"
    return f"tolerance:\n{lengths},\nturn {np.degrees(allowed.rotation):.3g}°"


def _over(found: Attainability) -> Array:
    """The largest error of each task over its tolerance."""
    assert found.over_tolerance is not None
    return array(found.over_tolerance).ravel()


def _off(found: Attainability) -> Array:
    """The tip's error of each task [mm]."""
    assert found.tip_error is not None
    return 1e3 * array(found.tip_error).ravel()


def _lacking(found: Attainability) -> Array:
    """What the nodes lack of each task [N], in sum; by the first metric that there is."""
    value = found.relative if found.absolute is None else found.absolute
    return np.full(found.strain_excess.numel(), np.nan) if value is None else array(value).ravel()


def _words(found: Attainability) -> Any:
    """The verdict on each task; of sets alone, whether it is excluded."""
    if found.verdict is not None:
        return np.ravel(np.asarray(found.verdict))
    assert found.not_excluded is not None
    return np.where(found.not_excluded.numpy(force=True).ravel(), "not excluded", "excluded")


def _counts(found: Attainability) -> str:
    words = list(_words(found))
    order = (*VERDICTS, "not excluded", "excluded")
    return ", ".join(f"{words.count(word)} {word}" for word in order if word in words)


def _two_nodes(found: Attainability, nodes: int) -> tuple[int, int]:
    """The base, and the node that lacks most on average, or the last one where that is the base or none."""
    miss = found.node_miss
    mean = np.zeros(nodes) if miss is None else array(miss).reshape(-1, nodes).mean(0)
    worst = int(np.where(np.isfinite(mean), mean, -1.0).argmax())
    return 0, worst or nodes - 1


def _draw_predicted(axes: Any, first: Task, found: Attainability, drawn: Mask) -> None:
    """The predicted centreline under the load of the median of the errors found, of the shape that is drawn."""
    if found.prediction is None:
        return
    index = median_place(np.where(drawn, _over(found), np.inf))
    if index is None:
        return
    twists = found.prediction.twists.detach().reshape(-1, *found.prediction.twists.shape[-2:])[index]
    turned = float(np.degrees(array(found.prediction.tip_rotation_error).ravel()[index]))
    label = f"predicted under load {index + 1}:\ntip off by {_off(found)[index]:.3g} mm, turned by {turned:.3g}°"
    draw_reached(axes, twists, first.base_pose, label)
