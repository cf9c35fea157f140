"""Load maps of several arms side by side: which loads each holds, and by how much, at the same scale."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from torch import Tensor

from torcharm.attainability import evaluate
from torcharm.design.space import Arm
from torcharm.inputs import check_choice, three_digits
from torcharm.plot._common import PLAIN, Array, Mask, array, counted, one_design
from torcharm.plot.loads import colour_bar, load_map, map_places, under_forces
from torcharm.task import Task
from torcharm.wrench_sets.capacity import load_capacity

QUANTITIES = {"tip error": "mm", "payload factor": "times the force"}
LOST = {"tip error": "no equilibrium found", "payload factor": "no multiple of the force possible at this shape"}
"""Of forces that have no value."""
HIGHEST = 4.0
"""End of the colours, in tolerances or in factors: by how much more a tip is off, or a load could grow, hardly
matters."""
PANEL = 5.2
"""Width of a panel [inch]."""
NOT_HELD = "tip within tolerance, yet not held: turn, shape, range or stability"


class _Map(NamedTuple):
    """What is shown of one arm: for each force (R, C) its value, NaN where it has none; the value that decides; words
    below the arm's name; and (R, C) which forces are not held, though their values are on the good side of that."""

    value: Array
    line: float
    words: str
    hatched: Mask


def load_figure(
    arms: Sequence[tuple[str, Arm]],
    task: Task,
    quantity: str = "tip error",
    *,
    loads: Tensor | None = None,
) -> Figure:
    """One page of load maps of several arms at one shape, at the same scale, for `figure.savefig(path)`.

    Two hues meet at what decides: the factor 1, or the tolerance of the tip, of arms of several the largest.

    Args:
        arms: names and designs.
        task: of one shape, beside whose weight and point loads the tip forces act.
        quantity: "tip error", the predicted distance of the tip from the task's, hatched where that is within the
            tolerance and the verdict is not "held" all the same; or "payload factor", by which each force (with the
            task's point loads) could grow at the very shape until a node's set excludes it. What weighs nothing could
            grow without end.
        loads: (R, C, 3 or 6) as for `load_map`; None takes `load_grid(count=21)`, in space of the plane "xy".

    Raises:
        ValueError: there is no arm, a design is a batch, the task holds several shapes, or as of `load_map`.
    """
    check_choice("quantity", quantity, tuple(QUANTITIES))
    if not arms:
        raise ValueError("arms: must hold at least one arm, got none")
    grid, loaded = under_forces(task, loads, 21)
    find = _errors if quantity == "tip error" else _factors
    with torch.no_grad():
        found = [find(one_design(name, arm, task), loaded) for name, arm in arms]
    middle = max(one.line for one in found)
    scale: dict[str, Any] = {"lowest": 0.0, "highest": HIGHEST * middle}
    scale |= {"middle": middle, "rising": quantity == "payload factor", "bar": False}
    figure = Figure(figsize=(PANEL * len(arms) + 1.0, PANEL + 1.1), layout="constrained", dpi=130)
    panels: Any = figure.subplots(1, len(arms), squeeze=False)[0]
    labels: dict[str, Any] = {}
    for axes, (name, _), one in zip(panels, arms, found, strict=True):
        labels |= _draw(axes, grid, one, quantity, scale)
        axes.set_title(f"{name}\n{one.words}", fontsize="medium", **PLAIN)
    every = [axes.collections[0] for axes in panels if axes.collections]
    if every:
        shades = max(every, key=lambda one: one.extend == "max")  # its bar has an end for what is beyond
        common = middle if len({one.line for one in found}) == 1 else None
        colour_bar(figure, shades, panels.tolist(), f"{quantity} [{QUANTITIES[quantity]}]", common)
    figure.legend(labels.values(), labels.keys(), loc="outside lower center", ncols=2, frameon=False)
    return figure


def _draw(axes: Axes, grid: Tensor, one: _Map, quantity: str, scale: dict[str, Any]) -> dict[str, Any]:
    """One arm's map; what its legend would hold, without what differs between arms."""
    word = f"tolerance of the tip, {one.line:.3g} mm" if quantity == "tip error" else "factor 1: the force itself"
    drawn = np.where(np.isinf(one.value), 2 * scale["highest"], one.value)  # beyond the colours, which have an end
    load_map(grid, drawn, contour=one.line, contour_label=word, ax=axes, **scale)
    if one.hatched.any():
        x, y, _ = map_places(grid)
        axes.contourf(x, y, one.hatched.astype(float), levels=[0.5, 1.5], colors="none", hatches=["///"])
        axes.add_patch(Rectangle((0, 0), 0, 0, facecolor="none", edgecolor="black", hatch="///", label=NOT_HELD))
    pairs = zip(*axes.get_legend_handles_labels(), strict=True)
    axes.legend().remove()
    return {LOST[quantity] if word.startswith("not known") else word: handle for handle, word in pairs}


def _errors(arm: Arm, task: Task) -> _Map:
    """How far off the tip is [mm], and which forces are held."""
    found = evaluate(arm, task, ("predicted_error",))
    assert found.tip_error is not None
    error, line = 1e3 * array(found.tip_error), 1e3 * float(found.tolerance.lengths(arm)[0].max())
    verdict, known = np.asarray(found.verdict), np.isfinite(error)
    held, others = verdict == "held", counted(verdict, "held")
    words = f"held: {held.sum()} of {held.size} forces\n{others or 'all within its tolerance'}"
    if known.any():
        middle, worst = (three_digits(float(value)) for value in (np.median(error[known]), error[known].max()))
        words += f"\ntip off by {middle} mm (median), {worst} mm (most)"
    return _Map(np.where(known, error, np.nan), line, words, (error <= line) & ~held)


def _factors(arm: Arm, task: Task) -> _Map:
    """By what each force could grow."""
    factor = array(load_capacity(arm, task).factor)
    words = f"not excluded at this shape: {(factor >= 1).sum()} of {factor.size} forces"
    return _Map(factor, 1.0, words, np.zeros(factor.shape, dtype=np.bool_))
