"""Pictures of the validation: hulls and histograms, closest shapes, and the claim against what is reached."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy.stats import spearmanr

import torcharm as ta
from torcharm import plot

if TYPE_CHECKING:
    from experiments.validation.rows import Answers

BELOW, ABOVE = "#0072B2", "#D55E00"
QUANTITIES = {"absolute": ("N", 1.0), "relative": ("N", 1.0), "predicted error": ("mm", 1e3)}


def draw_all(task: ta.Task, answers: Sequence["Answers"]) -> dict[str, Figure]:
    return {"hulls": hulls(task, answers), "shapes": shapes(task, answers), "claim": claim(answers)}


def hulls(task: ta.Task, answers: Sequence["Answers"]) -> Figure:
    arms = [(one.name, one.arm) for one in answers]
    return plot.study_figure(
        arms,
        "Validation, shape (-3, 3): the antagonistic arm lacks less, and holds no load either",
        task,
        [one.hulls for one in answers],
    )


def shapes(task: ta.Task, answers: Sequence["Answers"]) -> Figure:
    """Each arm's closest shapes, coloured by whether its absolute unattainability is below the median."""
    figure = Figure(figsize=(5.5 * len(answers), 6.9), layout="constrained")
    wanted = ta.poses(task.twists)
    for one, axes in zip(answers, figure.subplots(1, len(answers), sharey=True), strict=True):
        below = one.metric("absolute") <= one.metric("absolute").median()
        poses = ta.poses(one.search.twists)
        for index in torch.argsort(below.int()).tolist():
            if one.search.converged[index]:
                low = bool(below[index])
                line = {"color": BELOW, "linestyle": "-"} if low else {"color": ABOVE, "linestyle": "--"}
                axes.plot(*poses[index, :, :2].T, linewidth=0.9, alpha=0.8, **line)
        axes.plot(*wanted[:, :2].T, color="black", linewidth=3.5)
        near, far = (1e3 * one.reached[side].nanmedian().item() for side in (below, ~below))
        handles = [
            Line2D([], [], color="black", linewidth=3.5, label="task shape"),
            Line2D([], [], color=BELOW, label=f"below median: median error {near:.0f} mm"),
            Line2D([], [], color=ABOVE, linestyle="--", label=f"above median: median error {far:.0f} mm"),
        ]
        axes.legend(
            handles=handles,
            title="absolute unattainability",
            loc="upper center",
            bbox_to_anchor=(0.5, -0.13),
            fontsize=8,
        )
        axes.set(title=one.name, xlabel="x [m]", aspect="equal", anchor="N", xlim=(-0.4, 0.65), ylim=(-0.9, 0.06))
    figure.axes[0].set_ylabel("y [m]")
    figure.suptitle(
        "The closest shapes that pressures reach: less absolute unattainability brings one arm alone nearer"
    )
    return figure


def claim(answers: Sequence["Answers"]) -> Figure:
    """Each metric against the error that the search reaches."""
    figure = Figure(figsize=(12, 3.6 * len(answers)), layout="constrained")
    panels = figure.subplots(len(answers), len(QUANTITIES), sharey="row", squeeze=False)
    for row, one in zip(panels, answers, strict=True):
        for axes, name in zip(row, QUANTITIES, strict=True):
            _scatter(axes, one, name)
        row[0].set_ylabel(f"{one.name}\nerror reached by search [mm]")
    figure.suptitle("The predicted error orders both arms' tasks as the search does; the other metrics one arm's each")
    return figure


def _scatter(axes: Axes, one: "Answers", name: str) -> None:
    unit, factor = QUANTITIES[name]
    value, reached = factor * one.metric(name).numpy(), 1e3 * one.reached.numpy()
    known = np.isfinite(value) & np.isfinite(reached)
    value, reached = value[known], reached[known]
    low = value <= np.median(value)
    axes.plot(value[low], reached[low], "o", color=BELOW, markersize=4, label="below median")
    axes.plot(value[~low], reached[~low], "x", color=ABOVE, markersize=5, label="above median")
    if name == "predicted error":
        top = max(value.max(), reached.max())
        axes.plot([0, top], [0, top], color="grey", linewidth=0.8, zorder=0, label="as predicted")
    axes.axhline(np.median(reached), color="grey", linewidth=0.8, linestyle=":")
    axes.set(xlabel=f"{name}{' unattainability' if unit == 'N' else ''} [{unit}]")
    axes.set_title(f"rank correlation {spearmanr(value, reached).statistic:.2f}", fontsize=10)
    axes.legend(fontsize=8, loc="best")
