"""The figure: error against time, a panel for the plane and one for space."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from experiments.error_vs_runtime.rows import Row

HERE = Path(__file__).parent
LINES = {
    "exact": ("#009E73", "exact sets (default)", (0, "left", (11, -4))),
    "edges": ("#D55E00", "edges of the pressure box, sampled", (0, "left", (-8, 22))),
    "nnls": ("#0072B2", "NNLS on\nsampled curves", (-1, "right", (14, -36))),
    "qpth": ("#CC79A7", "qpth on\nsampled curves", (-1, "left", (-18, -36))),
    "SLSQP on edges": ("#555555", "SLSQP on edges", (0, "center", (0, 10))),
}
"""Colours of Okabe and Ito, and words beside the marks: at which of them, and by how many points off."""
FLOOR = 1e-14
"""Where the axis ends: what is smaller is rounding."""


def draw(rows: "Sequence[Row]") -> None:
    """Write error_vs_runtime.png beside this file: absolute sets, forward."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(1, 2, figsize=(11, 5), sharex=True, sharey=True, layout="constrained")
    for panel, space in zip(panels, ("plane", "space"), strict=True):
        _panel(panel, [row for row in rows if row.space == space and row.metric == "absolute"])
        panel.set_title(f"In the {space}" if space == "plane" else "In space", loc="left", fontsize=12)
    figure.suptitle("Exact sets are the fastest and the most accurate: lower left is better", fontsize=13)
    panels[0].set_ylabel("error over the largest wrench\n(99th percentile)")
    figure.supxlabel(
        "processor time for one node's distance [µs]; numbers at marks: samples of an edge or a curve", fontsize=10
    )
    figure.savefig(HERE / "error_vs_runtime.png", dpi=120)
    plt.close(figure)


def _panel(axes: Any, rows: "Sequence[Row]") -> None:
    for method, (colour, label, (place, side, off)) in LINES.items():
        own = [row for row in rows if row.method == method]
        if not own:
            continue
        x, y = [row.forward_us for row in own], [max(FLOOR, row.error_p99) for row in own]
        marker, size = ("*", 15) if method == "exact" else ("o", 6)
        axes.plot(x, y, color=colour, marker=marker, markersize=size)
        style = {"textcoords": "offset points", "color": colour}
        axes.annotate(label, (x[place], y[place]), off, ha=side, fontsize=10, **style)
        aside = {"xytext": (0, 6), "ha": "center"} if method == "edges" else {"xytext": (6, -1), "ha": "left"}
        for row, at, height in zip(own, x, y, strict=True) if len(own) > 1 else ():
            axes.annotate(str(row.samples), (at, height), fontsize=8, **aside, **style)
    axes.set(xscale="log", yscale="log", ylim=(FLOOR, 0.1), xlim=(0.5, 2e5))
    axes.set_yticks(10.0 ** np.arange(-14, 0, 2))
    axes.grid(alpha=0.25)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
