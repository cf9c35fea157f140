"""Quality against time: how far above the best design known each method still is."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt

STYLES = {
    "bfgs": ("#0072B2", "-", "projected BFGS (gradients)"),
    "bfgs, 8 starts": ("#0072B2", ":", "projected BFGS, 8 starts"),
    "adam": ("#56B4E9", "-", "projected Adam (gradients)"),
    "slsqp": ("#009E73", "-", "SLSQP (gradients)"),
    "nelder_mead": ("#E69F00", "--", "Nelder–Mead"),
    "differential_evolution": ("#D55E00", "--", "differential evolution"),
}
FLOOR = 1e-6


def draw(traces: Sequence[Any], path: Path) -> None:
    """One panel an arm, one line a method."""
    arms = list(dict.fromkeys(trace.arm for trace in traces))
    figure, axes = plt.subplots(1, len(arms), figsize=(4.2 * len(arms), 4.0), sharey=True, squeeze=False)
    for axis, arm in zip(axes[0], arms, strict=True):
        own = [trace for trace in traces if trace.arm == arm]
        best = min(trace.value for trace in own)
        for method, (colour, dash, label) in STYLES.items():
            line = [trace for trace in own if trace.method == method]
            seconds = [max(trace.seconds, 1e-3) for trace in line]
            excess = [max(100 * (trace.value / best - 1), FLOOR * 100) for trace in line]
            axis.step(seconds, excess, where="post", color=colour, linestyle=dash, label=label, linewidth=1.8)
        axis.axhline(0.1, color="0.6", linewidth=0.8)
        axis.set(xscale="log", yscale="log", xlabel="time [s]", title=f"{arm} arm")
        axis.grid(alpha=0.25)
    axes[0][0].annotate("0.1 %", (1, 0.1), xycoords=("axes fraction", "data"), ha="right", va="bottom", color="0.4")
    axes[0][0].set_ylabel("above the best design found [%]")
    figure.legend(*axes[0][0].get_legend_handles_labels(), loc="lower center", ncols=3, frameon=False)
    figure.suptitle("Gradients find the best design; methods without are slow, or stop short")
    figure.tight_layout(rect=(0, 0.13, 1, 1))
    figure.savefig(path, dpi=150)
    plt.close(figure)
