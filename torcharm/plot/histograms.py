"""How far arms miss their tasks."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from torch import Tensor

from torcharm.attainability import Attainability
from torcharm.inputs import three_digits
from torcharm.plot._common import (
    ARM_COLOURS,
    ARM_LINES,
    VERDICT_STYLES,
    Array,
    array,
    axes_or_new,
    label_powers,
    plain_legend,
)

BINS = 24
"""Of the histograms of several arms, which share them."""
NEAR = "missed by turn or shape"
"""Of loads whose tip's place is within the tolerance, and yet they are missed."""
BARS = {word: (colour, 1.0, filled) for word, (colour, _, filled) in VERDICT_STYLES.items()}
BARS |= {NEAR: (VERDICT_STYLES["missed"][0], 0.35, True)}
"""Of verdicts colour, how opaque they are, and whether they are filled."""
LEAST = 0.01
"""What the tip is off by less [mm] is counted there: a logarithmic axis has no zero."""


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
    plain_legend(axes, loc="upper right", handlelength=3.5)
    return axes


def tip_error_edges(evaluated: Sequence[Attainability]) -> Array:
    """Edges of bins [mm] for tip errors of several arms, on a logarithmic axis, with their tolerances among them."""
    errors = np.concatenate([_tip_errors(found) for found in evaluated])
    known = np.concatenate([errors[np.isfinite(errors)], [_tolerance(found) for found in evaluated]])
    return np.asarray(np.geomspace(known.min() / 1.1, known.max() * 1.1, BINS + 1))


def draw_tip_errors(axes: Axes, found: Attainability, edges: Array) -> int:
    """How far off the tip is predicted over the loads: bars by verdict, the median and the tolerance as lines.

    Of those missed, where the tip is within the tolerance, but turned too far or the shape too far off, bars are faint.
    Returns how many loads have no error, as no shape was found: they are in no bar. Edges of bars are in mm.
    """
    errors, words, tolerance = _tip_errors(found), np.ravel(np.asarray(found.verdict)), _tolerance(found)
    words = np.where((words == "missed") & (errors <= tolerance), NEAR, words)
    known = np.isfinite(errors)
    below = np.zeros(len(edges) - 1)
    for word, (colour, alpha, filled) in BARS.items():
        counts = np.histogram(errors[known & (words == word)], edges)[0]
        if counts.any():
            inks: dict[str, Any] = {"facecolor": (colour, alpha)} if filled else {"facecolor": "none", "hatch": "////"}
            full = counts > 0
            left, wide = edges[:-1][full], np.diff(edges)[full]
            axes.bar(left, counts[full], wide, below[full], align="edge", edgecolor=colour, label=word, **inks)
        below = below + counts
    if known.any():
        middle = float(np.median(np.where(known, errors, np.inf)))
        if np.isfinite(middle):
            name = "median, " if len(errors) > 1 else "tip off, "
            name += "at most " if middle <= LEAST else ""
            axes.axvline(middle, color="#0072B2", linewidth=2, label=f"{name}{three_digits(middle)} mm")
    axes.axvline(tolerance, color="black", linestyle=":", label=f"tolerance, {three_digits(tolerance)} mm")
    axes.set(xscale="log", xlim=(edges[0], edges[-1]), xlabel="tip off by [mm]", ylabel="number of loads")
    close = edges[-1] < 100 * edges[0]  # few powers of ten to be named
    label_powers(axes.xaxis, (1.0, 2.0, 5.0) if close else (1.0,))
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    return int((~known).sum())


def _tip_errors(found: Attainability) -> Array:
    """[mm], none below LEAST; what is not finite, no shape was found for."""
    if found.tip_error is None:
        raise ValueError("found: must hold predicted errors, got none")
    return np.maximum(1e3 * array(found.tip_error).ravel(), LEAST)


def _tolerance(found: Attainability) -> float:
    """Of the tip [mm]."""
    return 1e3 * float(found.tolerance.lengths(found.arm)[0].max())
