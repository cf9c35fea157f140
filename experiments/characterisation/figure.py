"""The figures of the characterisation."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from torch import Tensor

import torcharm as ta
from torcharm import plot_characterisation

BLACK, BLUE, ORANGE, GREY = "#000000", "#0072B2", "#D55E00", "#999999"
Answers = dict[tuple[str, str], Tensor]


def held_strains(model: ta.FittedActuator, recording: ta.Recording, path: Path) -> None:
    """The SI's figure: force against pressure at the strains that were held."""
    figure = Figure(figsize=(8.0, 5.6), layout="constrained")
    axes = plot_characterisation.force_at_held_strains(model, recording, ax=figure.add_subplot())
    assert model.quality is not None
    axes.set_title(f"One cubic describes the bellows at all strains: R² {model.quality.r_squared:.4f}")
    figure.savefig(path, dpi=130)


def whole_fit(model: ta.FittedActuator, recording: ta.Recording, path: Path) -> None:
    plot_characterisation.characterisation_figure(model, recording).savefig(path, dpi=100)


def sensitivity(base: Answers, spread: Any, variants: dict[str, Answers], path: Path) -> None:
    """For each arm and metric: by how much each way to fit moves the answers, beside their standard deviation."""
    figure = Figure(figsize=(13.0, 7.0), layout="constrained")
    panels = figure.subplots(1, len(base), sharey=True)
    names = list(variants)
    place = np.arange(len(names))[::-1]
    for axes, (key, published) in zip(panels, base.items(), strict=True):
        deviation = float(spread[key].deviation.median())
        axes.axvspan(-2 * deviation, 2 * deviation, color=GREY, alpha=0.3, linewidth=0, label="±2 standard deviations")
        for height, name in zip(place, names, strict=True):
            move = (variants[name][key] - published).numpy()
            low, middle, high = np.percentile(move, (5, 50, 95))
            axes.plot([low, high], [height, height], color=BLUE, linewidth=3, solid_capstyle="butt")
            axes.plot(middle, height, "o", color=ORANGE, markersize=7)
        axes.axvline(0, color=BLACK, linewidth=0.8)
        axes.set_title(f"{key[0]}, {key[1]}\npublished median {float(published.median()):.3g} N", fontsize="medium")
        axes.set_xlabel("move from published [N]")
    panels[0].set_yticks(place, names)
    panels[0].plot([], [], color=BLUE, linewidth=3, label="5 to 95 % of loads")
    panels[0].plot([], [], "o", color=ORANGE, label="median load")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    figure.suptitle(
        "Other ways to fit the cubic move the validation study by about two standard deviations at most,\n"
        "another kind of model by far more: the study's strains lie outside the recordings",
        fontweight="bold",
    )
    figure.savefig(path, dpi=110)
