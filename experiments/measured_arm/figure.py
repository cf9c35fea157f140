"""The picture: where tips were measured and where the model puts them, and errors by hypothesis."""

from collections.abc import Sequence
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from torch import Tensor

from experiments.measured_arm.module import States

if TYPE_CHECKING:
    from experiments.measured_arm.rows import Row

MEASURED, MODEL = "#000000", "#D55E00"
GROUPS = {False: ("not pulled", "#0072B2", "o"), True: ("pulled by 0.7 to 0.8 N", "#E69F00", "^")}


def draw(states: States, modelled: Tensor, rows: "Sequence[Row]") -> Figure:
    """Tips from below, and the errors of all states by hypothesis."""
    figure = Figure(figsize=(12, 5), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.2))
    measured, model = 1e3 * states.tip.numpy(), 1e3 * modelled.numpy()
    for seen, said in zip(measured, model, strict=True):
        left.plot([seen[0], said[0]], [seen[2], said[2]], color="0.7", linewidth=1, zorder=1)
    for pulled, (name, _, marker) in GROUPS.items():
        own = states.pulled.numpy() == pulled
        style = {"linestyle": "", "marker": marker}
        left.plot(*measured[own][:, [0, 2]].T, color=MEASURED, label=f"measured, {name}", **style)
        left.plot(*model[own][:, [0, 2]].T, color=MODEL, fillstyle="none", label=f"model, {name}", **style)
    left.set(xlabel="x [mm]", ylabel="z [mm]", title="Tips from below: off by little unless somebody pulls")
    left.set_aspect("equal", adjustable="datalim")
    left.legend(fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=2, frameon=False)
    names = list(dict.fromkeys(row.hypothesis for row in rows))
    for shift, (pulled, (name, colour, marker)) in zip((-0.17, 0.17), GROUPS.items(), strict=True):
        for place, hypothesis in enumerate(names):
            errors = [row.tip_error_mm for row in rows if row.hypothesis == hypothesis and row.pulled is pulled]
            spots = np.full(len(errors), place + shift)
            right.plot(
                spots,
                errors,
                color=colour,
                marker=marker,
                linestyle="",
                markersize=5,
                alpha=0.7,
                label=name if place == 0 else None,
            )
            right.plot([place + shift - 0.12, place + shift + 0.12], [np.median(errors)] * 2, color=colour, linewidth=3)
    right.set_xticks(range(len(names)), [fill(name, 12) for name in names], fontsize="small")
    right.set(
        ylabel="tip error [mm]",
        title="Why: the pull acts short of the tip\n(fitted on half of the states, judged on the other; bars: medians)",
        ylim=(0, 25),
    )
    right.legend()
    return figure
