"""Load maps of several arms side by side: how far off each is, or by what its load could grow, at the same scale."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure
from torch import Tensor

from torcharm.attainability import evaluate
from torcharm.design.space import Arm
from torcharm.inputs import check_choice
from torcharm.plot._common import PLAIN, Array, array, one_design, one_shape
from torcharm.plot.loads import colour_bar, load_grid, load_map
from torcharm.task import Task
from torcharm.wrench_sets.capacity import load_capacity

QUANTITIES = {"tip error": "mm", "payload factor": "times the load"}
LOST = {"tip error": "without an equilibrium", "payload factor": "borne by no factor"}
"""Of forces that have no value."""
HIGHEST_FACTOR = 4.0
"""Of the colours: by how much more a load could grow hardly matters."""
HIGHEST_ERROR = 0.9
"""Of all errors, those below the end of the colours; a few arms' few failures would leave the others no shades."""
PANEL = 5.2
"""Width of a panel [inch]."""


def load_figure(
    arms: Sequence[tuple[str, Arm]],
    task: Task,
    quantity: str = "tip error",
    *,
    loads: Tensor | None = None,
    highest: float | None = None,
) -> Figure:
    """One page of load maps of several arms at one shape, at the same scale, for `figure.savefig(path)`.

    Args:
        arms: names and designs.
        task: of one shape, beside whose weight and point loads the tip forces act.
        quantity: "tip error", the predicted distance of the tip from the task's, with a line at the tolerance; or
            "payload factor", by which each force (with the task's point loads) could grow with the shape kept, with a
            line at 1: within it a force is borne.
        loads: (R, C, 3 or 6) as for `load_map`; None takes `load_grid(count=21)`, in space of the plane "xy".
        highest: end of the colours; None takes what 90 % of the errors are below, or a factor of 4.

    Raises:
        ValueError: there is no arm, a design is a batch, the task holds several shapes, or as of `load_map`.
    """
    check_choice("quantity", quantity, tuple(QUANTITIES))
    if not arms:
        raise ValueError("arms: must hold at least one arm, got none")
    shape = one_shape(task, [0])
    grid = load_grid(count=21, plane="xy" if task.dimension == 3 else None) if loads is None else loads
    loaded = Task(shape.twists, grid, shape.base_pose, _one_load(shape), shape.wrench_at, shape.segment_nodes)
    with torch.no_grad():
        found = [_values(one_design(name, arm, task), loaded, quantity) for name, arm in arms]
    top = _top(quantity, [value for value, _ in found]) if highest is None else highest
    figure = Figure(figsize=(PANEL * len(arms) + 1.0, PANEL + 0.6), layout="constrained", dpi=130)
    panels: Any = figure.subplots(1, len(arms), squeeze=False)[0]
    labels: dict[str, Any] = {}
    for axes, (name, _), (value, line) in zip(panels, arms, found, strict=True):
        axes.set_title(f"{name}\n{_counted(quantity, value, line)}", fontsize="medium", **PLAIN)
        if not np.isfinite(value).any():
            axes.set_axis_off()
            continue
        word = f"tolerance, {line:.3g} mm" if quantity == "tip error" else "payload factor 1"
        how: dict[str, Any] = {"contour": line, "contour_label": word, "lowest": 0.0, "highest": top, "bar": False}
        load_map(grid, value, ax=axes, **how)
        labels |= {
            _label(quantity, label): handle for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
        }
        axes.get_legend().remove()
    shades = next((axes.collections[0] for axes in panels if axes.collections), None)
    if shades is not None:
        lines = {line for _, line in found}
        common = lines.pop() if len(lines) == 1 else None
        colour_bar(figure, shades, panels.tolist(), f"{quantity} [{QUANTITIES[quantity]}]", common)
        figure.legend(labels.values(), labels.keys(), loc="outside lower center", ncols=4, frameon=False)
    return figure


def _label(quantity: str, label: str) -> str:
    """Of the legend, without what differs between arms."""
    word = label.split(":")[0]
    return LOST[quantity] if word == "not known" else word


def _counted(quantity: str, value: Array, line: float) -> str:
    """How many forces are within the line, and how many are not known."""
    within = int((value <= line if quantity == "tip error" else value >= line).sum())
    lost = int(np.isnan(value).sum())
    what = f"tip within {line:.3g} mm" if quantity == "tip error" else "borne, shape kept"
    return f"{what}: {within} of {value.size} forces" + (f", {lost} {LOST[quantity]}" if lost else "")


def _top(quantity: str, values: Sequence[Array]) -> float:
    """The end of the colours."""
    known = np.concatenate([value[np.isfinite(value)] for value in values])
    if quantity == "payload factor" or not len(known):
        return HIGHEST_FACTOR
    return float(np.quantile(known, HIGHEST_ERROR))


def _one_load(task: Task) -> Any:
    """The weight and point loads of a task of one load in a batch, without its tip load."""
    load = task.load.with_tip(None)
    return load._map(lambda value: value.reshape(value.shape[1:]) if value.ndim else value)


def _values(arm: Arm, task: Task, quantity: str) -> tuple[Array, float]:
    """What is shown of each load, and where the line is."""
    if quantity == "payload factor":
        factor = array(load_capacity(arm, task).factor)
        return factor, 1.0
    found = evaluate(arm, task, ("predicted_error",))
    assert found.tip_error is not None
    error = 1e3 * array(found.tip_error)
    return np.where(np.isfinite(error), error, np.nan), 1e3 * float(found.tolerance.lengths(arm)[0].max())
