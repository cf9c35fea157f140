"""Quality against time: how far above the best design known each method still is."""

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt

STYLES = {
    "bfgs": ("#0072B2", "-", "projected BFGS, 16 starts (gradients)"),
    "slsqp": ("#009E73", "-", "SLSQP, 1 start (gradients)"),
    "adam": ("#56B4E9", "-", "projected Adam, 1 start (gradients)"),
    "nelder_mead": ("#000000", ":", "Nelder–Mead"),
    "batched_differential_evolution": ("#E69F00", "--", "differential evolution, whole populations at once"),
    "differential_evolution": ("#D55E00", "--", "differential evolution, scipy's default"),
}
FLOOR = 1e-3
"""Lowest excess shown [%]."""
NEAR = 0.1


def draw(traces: Sequence[Any], path: Path) -> None:
    """One panel an arm; a line a run, of methods with several seeds one for each."""
    arms = list(dict.fromkeys(trace.arm for trace in traces))
    figure, axes = plt.subplots(1, len(arms), figsize=(4.2 * len(arms), 4.4), sharey=True, squeeze=False)
    for axis, arm in zip(axes[0], arms, strict=True):
        own = [trace for trace in traces if trace.arm == arm]
        best = min(trace.value for trace in own)
        for method, (colour, dash, label) in STYLES.items():
            runs = [
                list(run)
                for _, run in groupby(
                    (trace for trace in own if trace.method == method), key=lambda trace: (trace.session, trace.seed)
                )
            ]
            for index, line in enumerate(runs[:1] if method == "bfgs" else runs):
                excess = [max(100 * (trace.value / best - 1), FLOOR) for trace in line]
                shown = None if index else label
                width = 2.4 if method == "bfgs" else 1.4
                seconds = [trace.seconds for trace in line]
                axis.step(seconds, excess, where="post", color=colour, linestyle=dash, label=shown, linewidth=width)
                axis.plot(seconds[-1], excess[-1], "o", color=colour, markersize=3.5)
        axis.axhline(NEAR, color="0.55", linewidth=0.8)
        axis.set(xscale="log", yscale="log", xlabel="time from the call [s]", title=f"{arm} arm")
        axis.grid(alpha=0.25)
    axes[0][0].set_ylim(bottom=FLOOR * 0.8)
    axes[0][0].annotate("0.1 %", (0.01, NEAR), xycoords=("axes fraction", "data"), va="bottom", color="0.4")
    axes[0][0].set_ylabel("above the best design found [%]")
    handles, labels = axes[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=3, frameon=False)
    figure.suptitle(
        "Gradients find the best design in 0.03 to 0.8 s; differential evolution takes over 50 times as long"
    )
    figure.tight_layout(rect=(0, 0.13, 1, 1))
    figure.savefig(path, dpi=150)
    plt.close(figure)
