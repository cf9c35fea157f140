"""The figure: error against time, one curve a method."""

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np

from experiments.error_vs_runtime.rows import HERE, Row

FLOOR = 1e-17
"""Where errors of exactly 0 are drawn."""
STYLES = {
    "edges": ("#D55E00", "o"),
    "exact, sampled": ("#0072B2", "s"),
    "exact, polished": ("#009E73", "*"),
    "exact, polished, compiled": ("#CC79A7", "*"),
    "closed form": ("#009E73", "*"),
    "closed form, with weights": ("#56B4E9", "P"),
    "qpth vertices, alone": ("#D55E00", "v"),
    "qpth vertices, checked": ("#0072B2", "o"),
    "qpth half-spaces, alone": ("#E69F00", "<"),
    "qpth half-spaces, checked": ("#CC79A7", "D"),
    "scipy nnls": ("#000000", "s"),
    "scipy SLSQP": ("#7F7F7F", "X"),
}
"""Okabe and Ito's colours."""


def draw(rows: Sequence[Row]) -> None:
    """Write error_vs_runtime.png beside this file."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(13, 6.8), sharey=True, layout="constrained")
    _panel(left, [row for row in rows if row.family == "sets" and row.batch > 100])
    _panel(right, [row for row in rows if row.family == "solvers" and row.batch > 1])
    left.set_ylabel("99th percentile of |distance − reference| / max|H − w|")
    left.set_title("How attainable sets are sampled (batches of 2,000; numbers: points)", fontsize=10)
    right.set_title("How distances are solved (paper's edges, V = 48; numbers: ε)", fontsize=10)
    figure.savefig(HERE / "error_vs_runtime.png", dpi=120)
    plt.close(figure)


def _panel(axes: Any, rows: Sequence[Row]) -> None:
    from matplotlib.lines import Line2D

    curves: dict[tuple[str, str], dict[str, list[Row]]] = defaultdict(lambda: defaultdict(list))
    for row in rows:
        if row.family == "solvers" and not row.case.startswith("paper"):
            continue
        if "envelope" not in row.setting:
            curves[row.method, row.dtype][row.setting].append(row)
    cases = len({row.case for row in rows if row.family == "sets"}) or 1
    for (method, dtype), every in curves.items():
        settings = {name: own for name, own in every.items() if len(own) >= cases}  # else the worst case may be missing
        colour, marker = STYLES[method]
        exact = dtype == "float64"
        x = [np.exp(np.mean([np.log(row.forward_us_a_problem) for row in own])) for own in settings.values()]
        y = [max(FLOOR, *(row.error_p99 for row in own)) for own in settings.values()]
        axes.plot(
            x,
            y,
            color=colour,
            marker=marker,
            linestyle="-" if exact else ":",
            markerfacecolor=colour if exact else "white",
            markersize=11 if marker == "*" else 7,
        )
        if exact and len(settings) > 1:
            for x_at, y_at, text in _labels(x, y, list(settings)):
                axes.annotate(text, (x_at, y_at), (6, 5), textcoords="offset points", fontsize=8)
    names = dict.fromkeys(method for method, _ in curves)
    handles = [Line2D([], [], color=STYLES[name][0], marker=STYLES[name][1], label=name) for name in names]
    handles.append(Line2D([], [], color="grey", linestyle=":", marker="o", markerfacecolor="white", label="float32"))
    axes.axhline(FLOOR, color="grey", linewidth=0.8)
    axes.text(0.01, FLOOR * 1.3, "exactly 0", transform=axes.get_yaxis_transform(), fontsize=8, color="grey")
    axes.legend(handles=handles, fontsize=8, ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.1), frameon=False)
    axes.set(xscale="log", yscale="log", xlabel="time of a problem, forward [µs]", ylim=(FLOOR / 3, 5))
    axes.grid(alpha=0.3)
    axes.margins(x=0.09)


def _labels(x: Sequence[float], y: Sequence[float], settings: Sequence[str]) -> list[tuple[float, float, str]]:
    """Where to write settings: one label for points that lie on one another."""
    found: list[tuple[float, float, str]] = []
    for own_x, own_y, setting in zip(x, y, settings, strict=True):
        text = setting.removesuffix(" points").removeprefix("ε = ")
        for place, (other_x, other_y, other) in enumerate(found):
            if abs(np.log10(own_x / other_x)) < 0.1 and abs(np.log10(own_y / other_y)) < 0.3:
                found[place] = (other_x, other_y, f"{other}, {text}")
                break
        else:
            found.append((own_x, own_y, text))
    return found
