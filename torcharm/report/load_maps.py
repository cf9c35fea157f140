"""Which tip forces each design holds at a task's shape, and how far beyond its tolerance it is under the others."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torcharm.attainability import PREDICTED, evaluate
from torcharm.plot._common import array, counted, verdict_marks, verdict_words
from torcharm.plot.loads import HALO, attainable_load_map, load_grid, load_map, under_forces
from torcharm.plot.median_case import is_lost, median_case
from torcharm.report.content import Evaluated, Panel
from torcharm.report.figures import new_axes, put_legend_below, to_panel
from torcharm.study import StudyResult
from torcharm.task import Task

COUNT = 17
"""Forces a side: an odd number, so that the one in the middle is none."""
ROOM = 1.25
"""By how much a map reaches beyond the study's largest force."""
USUAL = 10.0
"""How far it reaches where the study's loads have no force [N]."""
HIGHEST = 4.0
"""Tolerances at which the shades of errors end: what is further off is far off."""


def load_map_panels(results: Sequence[StudyResult], evaluated: Evaluated) -> Iterator[Panel]:
    """A map for each design on one task: of the predicted error over its tolerance, or of what nodes lack."""
    for result in results:
        found = result.attainability
        if is_lost(found):
            continue
        axes, (grid, sides) = new_axes(1.0), _grid(result.task.task)
        task = result.task.task.part(median_case(found)[0])  # its weight and point loads act beside the tip forces
        if found.prediction is None:
            metric = "relative" if found.absolute is None else "absolute"
            attainable_load_map(
                result.arm.design, task, loads=grid, metric=metric, weights=result.settings.weights, ax=axes
            )
            caption = ""
        else:
            caption = _draw_errors(axes, result, task, grid)
        _draw_loads(axes, result, sides)
        yield to_panel(axes.figure, result, evaluated, "map", caption)


def _draw_errors(axes: Any, result: StudyResult, task: Task, grid: Tensor) -> str:
    """The predicted error under a grid of tip forces, over its tolerance; returns their verdicts, counted."""
    loaded = under_forces(task, grid, COUNT)[1]
    with torch.no_grad():
        found = evaluate(result.arm.design, loaded, (PREDICTED,), tolerance=result.settings.tolerance)
    over, words = found.over_tolerance, verdict_words(found)
    assert over is not None
    shades: dict[str, Any] = {"lowest": 0.0, "highest": HIGHEST, "contour": 1.0, "contour_label": "tolerance"}
    load_map(grid, over, quantity="predicted error over tolerance", unit="", ax=axes, **shades)
    return f"of {len(words)} tip forces {counted(words)}"


def _draw_loads(axes: Any, result: StudyResult, sides: tuple[int, int]) -> None:
    """The study's own loads, a mark for each by its verdict."""
    force = array(result.task.task.tip_load)
    force = np.broadcast_to(force, (*result.task.task.batch_shape, force.shape[-1])).reshape(result.loads, -1)
    for word, own, inks in verdict_marks(verdict_words(result.attainability)):
        label = f"{own.sum()} {word}"
        axes.scatter(*force[own].T[list(sides)], 16, label=label, path_effects=HALO, **inks)
    put_legend_below(axes)


def _grid(task: Task) -> tuple[Tensor, tuple[int, int]]:
    """Tip loads around those of a task, and by which two components they are drawn."""
    force = task.tip_load.detach()[..., : task.dimension].reshape(-1, task.dimension).abs().amax(0)
    limit = ROOM * float(force.max()) or USUAL
    if task.dimension == 2:
        return load_grid(limit, COUNT), (0, 1)
    least = max(range(3), key=lambda side: (-float(force[side]), side))
    plane = ("zy", "xz", "xy")[least]  # of the two that are larger
    return load_grid(limit, COUNT, plane=plane), ("xyz".index(plane[0]), "xyz".index(plane[1]))
