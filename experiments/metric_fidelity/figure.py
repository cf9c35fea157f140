"""Figures: predicted against true, and what fidelity costs."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from experiments.metric_fidelity.measure import Found, Timing

HERE = Path(__file__).parent
COLOUR = "#0072B2"
"""Okabe and Ito's blue."""


def draw(found: Sequence[Found], times: Sequence[Timing]) -> None:
    """Write scatter.png and ladder.png beside this file."""
    import matplotlib

    matplotlib.use("Agg")
    _scatter(found)
    _ladder(found, {one.what: one.milliseconds for one in times})


def _scatter(found: Sequence[Found]) -> None:
    import matplotlib.pyplot as plt

    columns = 4
    rows = -(-len(found) // columns)
    figure, axes = plt.subplots(rows, columns, figsize=(12, 3 * rows), sharex=True, sharey=True, layout="constrained")
    ends = (1e-3, 3.0)
    for panel, one in zip(axes.flat, found, strict=True):
        panel.plot(ends, ends, color="0.6", lw=1, zorder=0)
        label = f"ρ = {one.spearman('predicted'):.3f}"
        panel.scatter(one.true, one.columns["predicted"], label=label, s=16, marker="x", color=COLOUR, lw=0.9)
        panel.set(xscale="log", yscale="log", xlim=ends, ylim=ends, aspect="equal")
        panel.set_title(one.case.name, fontsize=9)
        panel.legend(fontsize=7, loc="upper left", handletextpad=0.1, borderpad=0.3)
    for panel in axes[-1]:
        panel.set_xlabel("true error, by search [m]")
    for panel in axes[:, 0]:
        panel.set_ylabel("predicted error [m]")
    figure.suptitle(
        "Predicted shape errors are those that the search reaches: 100 loads a panel, on the line they are the same\n"
        "(titles: arm, shape, scale of the loads' moments [N·m])"
    )
    figure.savefig(HERE / "scatter.png", dpi=110)
    plt.close(figure)


def _ladder(found: Sequence[Found], times: dict[str, float]) -> None:
    import matplotlib.pyplot as plt

    figure, panel = plt.subplots(figsize=(8, 4.8), layout="constrained")
    both = "absolute and relative"
    where = {"absolute": both, "relative": both, "predicted": "predicted error"}
    looks = {"absolute": ("#D55E00", "s"), "relative": ("#CC79A7", "v")}
    for metric, timed in where.items():
        values = np.array([1 - one.spearman(metric) for one in found]).clip(1e-4)
        colour, marker = looks.get(metric, (COLOUR, "o"))
        low, middle, high = np.quantile(values, (0.0, 0.5, 1.0))
        time = times[timed] * (1.12 if metric == "relative" else 1.0)
        panel.errorbar(time, middle, ((middle - low,), (high - middle,)), fmt=marker, color=colour, capsize=4, ms=8)
        side, offset = ("right", -9) if metric == "absolute" else ("left", 9)
        panel.annotate(metric, (time, middle), (offset, 4), textcoords="offset points", ha=side)
    panel.axvline(times["search"], color="0.4", ls="--", lw=1)
    panel.annotate(
        "search\n(the truth)", (times["search"], 0.5), xytext=(-8, 0), textcoords="offset points", ha="right"
    )
    panel.set(
        xscale="log",
        yscale="log",
        xlim=(times[both] / 4, 3 * times["search"]),
        xlabel="processor time of a task [ms]",
        ylabel="1 - rank correlation with the searched error\n(below is better)",
    )
    panel.set_title(
        "Predicted errors rank tasks as the search does; unattainability is faster and does not\n"
        f"(median and range over {len(found)} arms and shapes)",
        fontsize=11,
    )
    panel.grid(alpha=0.3)
    figure.savefig(HERE / "ladder.png", dpi=120)
    plt.close(figure)
