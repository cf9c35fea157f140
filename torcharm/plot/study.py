"""One page that compares arms on a task."""

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from torcharm.arm import ArmDesign
from torcharm.attainability import CHOICES, PREDICTED, Attainability
from torcharm.plot._common import ARM_COLOURS, ATTAINABLE, UNATTAINABLE, Array, array, first_shape, one_design
from torcharm.plot.arms import draw_arm, draw_loads
from torcharm.plot.histograms import draw_histogram, median, summary
from torcharm.plot.hulls import draw_hulls, limit_axes, make_scene
from torcharm.task import Task


def study_figure(
    results: Sequence[tuple[str, ArmDesign]],
    task_name: str,
    task: Task,
    evaluated: Sequence[Attainability],
    *,
    hull: str = "exact",
    samples: int | None = None,
    unit: str = "N",
) -> Figure:
    """One page that compares arms on one task, for `figure.savefig(path)`.

    A column for each arm: the arm at the shape with the loads on it, and its absolute hulls along the arm with
    the requirements, at one scale for all arms. Below, histograms of the metrics that were evaluated. Of several
    shapes the first is drawn; titles and histograms are about all tasks.

    Args:
        results: names and designs.
        task_name: for the title.
        task, evaluated: tasks of any batch shape, and what `evaluate` found on them for each arm.
        hull, samples: as they were given to `evaluate`.
        unit: of the metrics.

    Raises:
        ValueError: results, task and evaluated do not fit each other, or a name comes twice.
    """
    first, drawn, shapes = first_shape(task)
    arms = {name: one_design(f"results[{index}]", arm) for index, (name, arm) in enumerate(results)}
    if not arms or len(arms) < len(results):
        raise ValueError(f"results: must be one or more arms of different names, got {[name for name, _ in results]}")
    if len(evaluated) != len(arms):
        raise ValueError(f"evaluated: must hold one entry for each of the {len(arms)} results, got {len(evaluated)}")
    metrics = _metrics(list(arms), evaluated, len(drawn))
    width = max(10.0, 5.2 * len(arms), 4.8 * len(metrics))
    figure = Figure(figsize=(width, 14.0 if metrics else 10.5), layout="constrained")
    rows = 2 if metrics else 1
    panels: Any = figure.subfigures(rows, 1, squeeze=False, height_ratios=(3, 1)[:rows])[:, 0]
    title = [task_name, *_ranking(metrics, unit)]
    if shapes > 1:
        title.append(f"drawn: the first of {shapes} shapes, {drawn.sum()} of {len(drawn)} tasks; numbers: all tasks")
    figure.suptitle("\n".join(title), fontsize="large", fontweight="bold")
    scenes = [make_scene(arm, first, False, hull, samples) for arm in arms.values()]
    for column, ((name, arm), scene) in enumerate(zip(arms.items(), scenes, strict=True)):
        values = metrics.get("absolute", {}).get(name)
        attainable = scene.inside.all(-1) if values is None else values[drawn] <= 0
        axes = panels[0].add_subplot(2, len(arms), column + 1)
        axes.set_title("\n".join(_findings(name, metrics, evaluated[column], unit)), fontsize="medium")
        draw_arm(axes, arm, first)
        draw_loads(axes, first, ~attainable, UNATTAINABLE, width=0.003, prefix="not attainable: ")
        draw_loads(axes, first, attainable, ATTAINABLE, width=0.006, prefix="attainable: ")
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2, fontsize="small", frameon=False)
        deep = panels[0].add_subplot(2, len(arms), len(arms) + column + 1, projection="3d")
        draw_hulls(deep, scene, attainable, ARM_COLOURS[column % len(ARM_COLOURS)])
        limit_axes(deep, scenes)
    for place, (metric, found) in enumerate(metrics.items()):
        axes = panels[1].add_subplot(1, len(metrics), place + 1)
        quantity, own, scale = _quantity(metric, unit)
        scaled = {name: scale * value for name, value in found.items()}
        draw_histogram(axes, scaled, list(arms), quantity, own, metric != PREDICTED)
    return figure


def _metrics(names: list[str], evaluated: Sequence[Attainability], tasks: int) -> dict[str, dict[str, Array]]:
    """For each metric that any arm has, those arms' values (tasks)."""
    metrics: dict[str, dict[str, Array]] = {}
    for metric, index in product(CHOICES, range(len(names))):
        value = getattr(evaluated[index], "shape_error" if metric == PREDICTED else metric)
        if value is not None:
            if value.numel() != tasks:
                given = f"got shape {tuple(value.shape)}"
                raise ValueError(f"evaluated[{index}].{metric}: must hold one value for each of {tasks} tasks, {given}")
            metrics.setdefault(metric, {})[names[index]] = array(value).ravel()
    return metrics


def _ranking(metrics: dict[str, dict[str, Array]], unit: str) -> list[str]:
    """Which arm misses least, so that the message needs no caption."""
    for metric, found in metrics.items():
        quantity, own, scale = _quantity(metric, unit)
        ranked = sorted(found, key=lambda name: (np.isnan(median(found[name])), median(found[name])))
        medians = (f"{name} {median(found[name]) * scale:.3g} {own}" for name in ranked)
        return [f"median {quantity}: " + ", ".join(medians)]
    return []


def _findings(name: str, metrics: dict[str, dict[str, Array]], result: Attainability, unit: str) -> list[str]:
    found = []
    for metric, values in metrics.items():
        if name in values:
            _, own, scale = _quantity(metric, unit)
            found.append(f"{metric.replace('_', ' ')} {summary(scale * values[name], own, metric != PREDICTED)}")
    lines = [f"{name}: {found[0] if found else 'no metric evaluated'}", *found[1:]]
    if not bool(result.in_range.all()):
        excess = float(result.strain_excess.max())
        lines.append("extrapolates: " + (f"strain {excess:.2g} beyond range" if excess > 0 else "pressure limits"))
    return lines


def _quantity(metric: str, unit: str) -> tuple[str, str, float]:
    """What a metric is called and shown in, and the factor to that unit."""
    return ("predicted shape error", "mm", 1000.0) if metric == PREDICTED else (f"{metric} unattainability", unit, 1.0)
