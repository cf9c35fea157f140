"""How far off built arms are, and which tolerance decides that."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from torcharm.design.scatter import SOURCE_WORDS
from torcharm.design.tolerance_result import BuiltArms
from torcharm.inputs import three_digits
from torcharm.plot._common import ARM_COLOURS, ARM_LINES, PLAIN, array, label_powers, legend_below

UNITS = {"radii": (1e3, "mm"), "length": (1e3, "mm"), "limits": (1.0, "kPa"), "force_offset": (1.0, "N")}
"""In which its size is shown; others in percent."""
FARTHEST = 99.5
"""Percentile of the tip errors at which the picture ends, and as far from the least at which it begins."""
HIGHER = 4.0
"""By so much [%] stand marks of drawn arms above each other, which else would hide each other."""
LEGEND = -0.16
"""Where it is, below the axes, over their height."""
THICKEST = 0.15
"""Of the height of a source's row: no bar is thicker."""
LEAST = 0.1
"""Of a tip error [mm]: what is nearer is drawn no nearer, as a logarithmic axis has no zero."""


def tolerance_figure(results: Sequence[tuple[str, BuiltArms]], title: str = "") -> Figure:
    """Which part of built arms stays within which tip error, and what share each tolerance has in the tip's scatter.

    On the left a curve for each arm, over all built arms and tasks, with a mark where the drawn arm's median is, each
    arm's a little higher, and a line at the tolerance of the tip; below it yields, and what fails most where arms fail.
    On the right bars for each source of scatter: filled by gradients at the drawn arm, and open by a fit to the
    samples; a share that is not known has words in place of a bar.

    Args:
        results: names and what `torcharm.tolerance` found.
        title: of the picture.

    Raises:
        ValueError: there is no result, or nothing has a finite tip error.
    """
    if not results or not any(bool(found.tip_error.isfinite().any()) for _, found in results):
        raise ValueError("results: must hold at least one arm with a finite tip error, got none")
    bars = 2 * sum(len(found.shares) for _, found in results)
    figure = Figure(figsize=(11, max(4.6 + 0.25 * len(results), 2.2 + 0.18 * bars)), layout="constrained", dpi=150)
    left, right = figure.subplots(1, 2, width_ratios=(1.1, 1.0))
    if title:
        figure.suptitle(title, fontsize="large", fontweight="bold", **PLAIN)
    _draw_curves(left, results)
    _draw_shares(right, results)
    return figure


def _draw_curves(axes: Axes, results: Sequence[tuple[str, BuiltArms]]) -> None:
    """The share of built arms, over all tasks, whose tip is off by no more."""
    ends, lines, lowest = list[Any](), dict[float, None](), math.inf
    for index, (name, found) in enumerate(results):
        colour, line = ARM_COLOURS[index % len(ARM_COLOURS)], ARM_LINES[index % len(ARM_LINES)]
        error = np.sort(1e3 * array(found.tip_error).ravel())
        known = error[np.isfinite(error)]
        share = 100 * np.arange(1, len(known) + 1) / len(error)
        middle, high = (float(np.quantile(error, share, method="higher")) for share in (0.5, 0.95))
        label = f"{name}: half within {_number(middle)} mm, 95 % within {_number(high)} mm\n{_yield_words(found)}"
        axes.step(known, share, where="post", color=colour, linestyle=line, linewidth=2, label=label)
        drawn = float(np.median(1e3 * array(found.nominal_tip_error)))
        if np.isfinite(drawn):
            lowest = min(lowest, drawn)
            mark: Any = {"marker": "^", "color": colour, "markersize": 9, "clip_on": False, "linestyle": "none"}
            axes.plot([max(drawn, LEAST)], [HIGHER * index], **mark)
        if len(known):
            ends.append(np.percentile(known, (100 - FARTHEST, FARTHEST)))
        assert found.tolerance.tip is not None
        lines[round(1e3 * found.tolerance.tip, 6)] = None
    for limit in lines:
        axes.axvline(limit, color="#000000", linewidth=1.2, linestyle=(0, (1, 1)))
        place: Any = {"xytext": (0, 3), "textcoords": "offset points", "ha": "center", "va": "bottom"}
        axes.annotate(f"tolerance: {limit:g} mm", (limit, 100), fontsize="small", **place)
    low, high = min(lowest, *(one[0] for one in ends)), max(one[1] for one in ends)
    axes.set(xscale="log", xlim=(max(LEAST, min(low, *lines)) / 1.3, 1.3 * max(high, LEAST, *lines)), ylim=(0, 100))
    label_powers(axes.xaxis)
    axes.set(xlabel="tip off by at most [mm]   (triangles: drawn arm, median)", ylabel="share of built arms [%]")
    legend_below(axes, 1, LEGEND)


def _number(value: float) -> str:
    return three_digits(value) if math.isfinite(value) else "∞"


def _yield_words(found: BuiltArms) -> str:
    """Of all that counts, beside the tip's place that the curve tells of."""
    words = f"yield on all loads {100 * found.yield_of_all.value:.1f} %"
    if not bool(found.nominal_tip_error.median().isfinite()):
        words += "; drawn arm: no stable shape"
    if found.failing:
        words += f"; fails most: {found.failing.split(', ')[0]}"
    return words if found.stopped == "finished" else f"{words}; {found.interruption}"


def _draw_shares(axes: Axes, results: Sequence[tuple[str, BuiltArms]]) -> None:
    """Bars of the sources' shares in the variance of the tip's place."""
    names = list(dict.fromkeys(name for _, found in results for name in found.shares))
    height = min(0.8 / (2 * len(results)), THICKEST)
    for index, (name, found) in enumerate(results):
        colour = ARM_COLOURS[index % len(ARM_COLOURS)]
        own = [place for place, one in enumerate(names) if one in found.shares]
        for offset, shares, filled in ((0, found.shares, True), (1, found.shares_by_samples, False)):
            places = np.array(own) + (2 * index + offset + 0.5 - len(results)) * height
            widths = np.array([100 * shares[names[place]] for place in own])
            style: Any = {"facecolor": colour if filled else "none", "edgecolor": colour}
            label = f"{name}, {'by gradients' if filled else 'by samples'}"
            axes.barh(places, widths, 0.9 * height, label=label, linewidth=1.4, **style)  # NaN draws no bar
            text: Any = {"xytext": (3, 0), "textcoords": "offset points", "va": "center", "fontsize": 8}
            for place, width in zip(places, widths, strict=True):
                if np.isfinite(width):
                    axes.annotate(f"{width:.0f}", (width, place), **text)
                else:
                    why = "no stable shape" if filled or not found.decisive else "too few samples"
                    axes.annotate(f"not known: {why}", (0, place), color=colour, **text)
    axes.set_yticks(range(len(names)), [_with_size(name, results) for name in names])
    axes.set(ylim=(len(names) - 0.5, -0.5), xlim=(0, 108), xlabel="share in the variance of the tip's place [%]")
    legend_below(axes, 2, LEGEND)


def _with_size(name: str, results: Sequence[tuple[str, BuiltArms]]) -> str:
    """A source with its size, if that is one number in all results."""
    words = SOURCE_WORDS[name]
    sizes = {tuple(np.ravel(getattr(found.scatter, name, ()))) for _, found in results if name in found.shares}
    (size,) = sizes if len(sizes) == 1 else ((),)
    if len(size) != 1:
        return words
    scale, unit = UNITS.get(name, (100.0, "%"))
    return f"{words}\n{'±' if results[0][1].scatter.distribution == 'uniform' else 'σ '}{scale * size[0]:g} {unit}"
