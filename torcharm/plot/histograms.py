"""How far arms miss their tasks."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from torch import Tensor

from torcharm.plot._common import ARM_COLOURS, ARM_LINES, array, axes_or_new


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
    finite = {name: value[np.isfinite(value)] for name, value in arrays.items()}
    if not any(map(len, finite.values())):
        raise ValueError(f"values: must hold at least one finite value, got none for {list(arrays)}")
    axes = axes_or_new(ax)
    edges = np.histogram_bin_edges(np.concatenate(list(finite.values())), bins=30)
    headroom = 0.12 + 0.09 * len(values)  # for the legend, above bars and lines
    for index, (name, value) in enumerate(finite.items()):
        colour, line = ARM_COLOURS[index % len(ARM_COLOURS)], ARM_LINES[index % len(ARM_LINES)]
        axes.hist(value, edges.tolist(), color=colour, alpha=0.35)
        axes.hist(value, edges.tolist(), color=colour, histtype="step", linewidth=1.2, linestyle=line)
        middle = float(np.median(value)) if len(value) else float("nan")
        count, lost = len(arrays[name]), len(arrays[name]) - len(value)
        label = f"{name}: median {middle:.3g} {unit}, {(arrays[name] <= 0).sum()} of {count} attainable"
        label += f", {lost} not finite" if lost else ""
        axes.axvline(middle, ymax=1 - headroom, color=colour, linewidth=2.5, linestyle=line, label=label)
    highest = max(1, *(np.histogram(value, edges)[0].max() for value in finite.values()))
    axes.set(xlabel=f"unattainability [{unit}]", ylabel="number of tasks", ylim=(0, highest / (1 - headroom)))
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.legend(loc="upper right", fontsize="small", frameon=False, handlelength=3.5)
    return axes
