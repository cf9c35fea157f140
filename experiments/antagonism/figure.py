"""Hulls with requirements and histograms, and where the hulls lie."""

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure
from torch import Tensor

from experiments.antagonism.rows import ARMS, SHAPES, Hull, Result, chosen, twists_of
from experiments.paper import paper_task, paper_wrench
from torcharm import plot

HATCHES = dict(zip(ARMS, ("", "//", ".."), strict=True))
COLOURS = dict(zip(ARMS, plot.ARM_COLOURS, strict=False))


def draw_hulls(results: Sequence[Result], loads: Tensor, path: Path | BytesIO) -> None:
    """A row for each shape: the arms' hulls with all requirements, at one scale, and histograms."""
    figure = Figure(figsize=(21, 15.5), layout="constrained")
    for place, shape in enumerate(SHAPES):
        task = paper_task(twists_of(shape), loads)
        panels: list[Any] = []
        for column, (name, build) in enumerate(ARMS.items()):
            axes: Any = figure.add_subplot(3, 4, 4 * place + column + 1, projection="3d")
            plot.hulls_along_arm(build(), task, ax=axes, colour=COLOURS[name])
            axes.text2D(0.02, 0.86, name, transform=axes.transAxes, fontweight="bold", fontsize="large")
            panels.append(axes)
        for which in ("ylim", "zlim"):
            limits = np.array([getattr(axes, f"get_{which}")() for axes in panels])
            for axes in panels:
                getattr(axes, f"set_{which}")(limits[:, 0].min(), limits[:, 1].max())
        values = {name: torch.tensor([row.absolute for row in chosen(results, name, shape)]) for name in ARMS}
        axes = plot.unattainability_histogram(values, ax=figure.add_subplot(3, 4, 4 * place + 4))
        axes.set_title(f"shape ({shape[0]:g}, {shape[1]:g})", fontweight="bold")
    figure.suptitle(
        "The antagonistic arm misses by least on the first two shapes, the bellows-only arm on the third",
        fontsize="x-large",
        fontweight="bold",
    )
    figure.savefig(path, dpi=65)


def draw_why(hulls: Sequence[Hull], loads: Tensor, path: Path | BytesIO) -> None:
    """The hulls' extent in force and moment along the arm against what loads require, and the origin's distance."""
    figure = Figure(figsize=(16, 11.5), layout="constrained")
    panels = figure.subplots(3, 3, sharex=True)
    for column, shape in enumerate(SHAPES):
        required = paper_wrench(twists_of(shape), loads)[..., (0, 2)].numpy()
        nodes = np.arange(1, required.shape[1] + 1)
        for row, quantity in enumerate(("force", "moment")):
            axes = panels[row, column]
            low, high = np.quantile(required[..., row], (0.05, 0.95), axis=0)
            axes.axhline(0, color="black", lw=0.8)
            for name in ARMS:
                own = chosen(hulls, name, shape)
                bottom, top = ([getattr(hull, f"{quantity}_{end}") for hull in own] for end in ("min", "max"))
                axes.fill_between(
                    nodes,
                    bottom,
                    top,
                    facecolor=COLOURS[name],
                    edgecolor=COLOURS[name],
                    alpha=0.3,
                    hatch=HATCHES[name],
                    label=f"{name} provides",
                )
            axes.plot(nodes, low, "k--", lw=1.8, label="loads require (5 % to 95 %)")
            axes.plot(nodes, high, "k--", lw=1.8)
            axes.set_ylabel(r"force $f_x$ [N]" if row == 0 else r"moment $m$ [N·m]")
        axes = panels[2, column]
        axes.axhline(0, color="black", lw=0.8)
        for name, line in zip(ARMS, plot.ARM_LINES, strict=False):
            own = chosen(hulls, name, shape)
            axes.plot(nodes, [hull.origin for hull in own], line, color=COLOURS[name], lw=2.5, label=name)
        axes.set(xlabel="node i (base to tip)", ylabel="origin to hull [N], below 0 inside")
        axes.set_yscale("symlog", linthresh=1.0)
        axes.set_xticks(nodes)
        panels[0, column].set_title(f"shape ({shape[0]:g}, {shape[1]:g})", fontweight="bold")
    for axes in panels[1]:
        axes.set_yscale("symlog", linthresh=1.0)
    for axes in panels[0]:
        axes.set_yscale("symlog", linthresh=10.0)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    figure.suptitle(
        "Requirements lie about the origin. Bellows alone only push, muscles alone only pull;\n"
        "the antagonistic arm does both, but where shape (6, -1.5) stretches its muscles far beyond their range",
        fontsize="x-large",
        fontweight="bold",
    )
    figure.savefig(path, dpi=75)
