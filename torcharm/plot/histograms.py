"""How far arms miss their tasks."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from torch import Tensor

from torcharm.plot._common import ARM_COLOURS, ARM_LINES, Array, array, axes_or_new


def unattainability_histogram(values: Mapping[str, Tensor], *, ax: Axes | None = None, unit: str = "N") -> Axes:
    """How far each arm misses its tasks: histograms over shared bins, with lines at the medians.

    Args:
        values: for each arm's name its unattainability on every task, of any shape; zero or less is attainable.
            What is not finite is counted in the legend.
        ax: 2-D axes to draw in; None makes some.
        unit: of the values; with weights of one, newtons stand for newtons and newton-metres alike.

    Raises:
        ValueError: there is no finite value, or the axes are not 2-D.
    """
    arrays = {name: array(value).ravel() for name, value in values.items()}
    if not any(np.isfinite(array).any() for array in arrays.values()):
        raise ValueError(f"values: must hold at least one finite value, got none for {list(arrays)}")
    return draw_histogram(axes_or_new(ax), arrays, list(arrays), "unattainability", unit)


def summary(values: Array, unit: str, counted: bool = True) -> str:
    """Median and, if counted, number attainable, in words."""
    lost = int((~np.isfinite(values)).sum())
    count = f", {(values <= 0).sum()} of {len(values)} attainable" if counted else ""
    return f"median {median(values):.3g} {unit}{count}" + (f", {lost} not finite" if lost else "")


def median(values: Array) -> float:
    """Of what is finite; NaN of nothing."""
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if len(finite) else float("nan")


def draw_histogram(
    axes: Axes, values: dict[str, Array], names: list[str], quantity: str, unit: str, counted: bool = True
) -> Axes:
    """Histograms of arms, styled by their place among the names; counted if 0 is attainable."""
    finite = {name: value[np.isfinite(value)] for name, value in values.items()}
    edges = np.histogram_bin_edges(np.concatenate(list(finite.values())), bins=30)
    headroom = 0.12 + 0.09 * len(values)  # for the legend, above bars and lines
    for name, value in finite.items():
        index = names.index(name)
        colour, line = ARM_COLOURS[index % len(ARM_COLOURS)], ARM_LINES[index % len(ARM_LINES)]
        axes.hist(value, edges.tolist(), color=colour, alpha=0.35)
        axes.hist(value, edges.tolist(), color=colour, histtype="step", linewidth=1.2, linestyle=line)
        label = f"{name}: {summary(values[name], unit, counted)}"
        axes.axvline(median(value), ymax=1 - headroom, color=colour, linewidth=2.5, linestyle=line, label=label)
    highest = max(1, *(np.histogram(value, edges)[0].max() for value in finite.values()))
    axes.set(xlabel=f"{quantity} [{unit}]", ylabel="number of tasks", ylim=(0, highest / (1 - headroom)))
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.legend(loc="upper right", fontsize="small", frameon=False, handlelength=3.5)
    return axes
