"""The figure: error against time, a panel for the plane and one for space."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from experiments.error_vs_runtime.run import Row

HERE = Path(__file__).parent
LINES = {
    "exact": ("#009E73", "exact sets (default)", (9, -3)),
    "edges": ("#D55E00", "edges of the pressure box,\nsampled", (10, 12)),
    "nnls": ("#0072B2", "NNLS on\nsampled curves", (-10, -44)),
    "qpth": ("#CC79A7", "qpth on\nsampled curves", (-30, -40)),
    "SLSQP on edges": ("#555555", "SLSQP\n(as published)", (-34, 12)),
}
"""Colours of Okabe and Ito, words beside the marks, and where they stand: by how many points off the last mark."""
FLOOR = 1e-16
"""Smaller errors are drawn here: they are rounding."""


def draw(rows: "Sequence[Row]") -> None:
    """Write error_vs_runtime.png beside this file: absolute sets, forward."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(1, 2, figsize=(11, 5), sharex=True, sharey=True, layout="constrained")
    for panel, space in zip(panels, ("plane", "space"), strict=True):
        _panel(panel, [row for row in rows if row.space == space and row.metric == "absolute"])
        panel.set_title(f"In the {space}" if space == "plane" else "In space", loc="left", fontsize=12)
    panels[0].set_ylabel("error over the largest wrench\n(99th percentile)")
    figure.supxlabel("processor time for one node's distance [µs]", fontsize=10)
    figure.savefig(HERE / "error_vs_runtime.png", dpi=120)
    plt.close(figure)


def _panel(axes: Any, rows: "Sequence[Row]") -> None:
    for method, (colour, label, off) in LINES.items():
        own = [row for row in rows if row.method == method]
        if not own:
            continue
        x, y = [row.forward_us for row in own], [max(FLOOR, row.error_p99) for row in own]
        marker, size = ("*", 15) if method == "exact" else ("o", 6)
        axes.plot(x, y, color=colour, marker=marker, markersize=size)
        axes.annotate(label, (x[-1], y[-1]), off, textcoords="offset points", color=colour, fontsize=9)
        if len(own) > 1:
            for row, at, height in zip(own, x, y, strict=True):
                axes.annotate(
                    str(row.samples), (at, height), (0, 6), textcoords="offset points", fontsize=7.5, ha="center"
                )
    axes.set(xscale="log", yscale="log", ylim=(FLOOR, 1), xlim=(0.2, 3e5))
    axes.set_yticks(10.0 ** np.arange(-16, 1, 4))
    axes.grid(alpha=0.25)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
