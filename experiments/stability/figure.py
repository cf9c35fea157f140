"""The figure: errors by class of scenes and backend."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.stability.rows import Row

LEAST = 1e-20
"""Where errors of nothing are drawn."""
STYLES = {
    "exact": ("#000000", "o"),
    "scipy": ("#0072B2", "s"),
    "qpth": ("#D55E00", "^"),
    "exact, in space": ("#CC79A7", "P"),
    "exact, float32": ("#009E73", "D"),
}


def draw(rows: list[Row], path: Path) -> None:
    """Two panels that share the classes: errors of distances and of derivatives."""
    figure = Figure(figsize=(12, 8.5), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    groups = list(dict.fromkeys(row.group for row in rows))
    panel(left, rows, groups, "error")
    panel(right, rows, groups, "gradient_error")
    left.set_yticks(range(len(groups)), groups)
    left.invert_yaxis()
    left.set_xlabel("error of a distance / max|H − w|  (left is better; 1 is a failure)")
    right.set_xlabel("error of a derivative / max|H − w|")
    worst = max(row.error for row in rows if row.backend in ("exact", "exact, in space"))
    figure.suptitle(
        f"Exact distances are right to {worst:.0e} on stiff and extreme scenes, in the plane and in space\n"
        "small marks: scenes; large marks: the worst of a class; lines: from its median; dashed: 1e-9 and 1e-6"
    )
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    figure.savefig(path, dpi=130)


def panel(axes: Axes, rows: list[Row], groups: list[str], column: str) -> None:
    """A small mark a scene, a line from a class's median to its largest, and a large mark on the largest."""
    spread = np.linspace(-0.32, 0.32, len(STYLES))
    for (backend, (colour, marker)), offset in zip(STYLES.items(), spread, strict=True):
        places: list[float] = []
        worst: list[float] = []
        for place, group in enumerate(groups):
            own = [row for row in rows if row.backend == backend and row.group == group]
            found = [getattr(row, column) for row in own if getattr(row, column) is not None]
            if not found:
                continue
            values = np.maximum(found, LEAST)
            height = place + offset
            axes.plot(values, np.full(len(values), height), marker, ms=3, mew=0, color=colour, alpha=0.35)
            axes.plot([np.median(values), values.max()], [height, height], "-", lw=1.2, color=colour)
            places.append(height)
            worst.append(float(values.max()))
        axes.plot(worst, places, marker, ms=6, color=colour, ls="none", label=backend)
    for place in range(1, len(groups)):
        axes.axhline(place - 0.5, color="0.85", lw=0.6)
    for bound in (1e-9, 1e-6):
        axes.axvline(bound, color="0.5", lw=0.8, ls="--")
    axes.set_xscale("log")
    axes.set_xlim(LEAST / 3, 3.0)
    axes.set_ylim(-0.6, len(groups) - 0.4)
    axes.set_xticks([LEAST, 1e-16, 1e-12, 1e-9, 1e-6, 1e-3, 1.0], ["0", "1e-16", "1e-12", "1e-9", "1e-6", "1e-3", "1"])
    axes.minorticks_off()
