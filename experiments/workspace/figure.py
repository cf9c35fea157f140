"""Workspaces side by side, and load maps of the paper's arms."""

from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import torcharm as ta
from torcharm import plot

SHAPE = ta.affine_curvature(0.0, 0.5, length=0.5, nodes=10)
"""Of the load maps: a bend by 29° at the arms' length at rest."""


def draw(arms: Mapping[str, ta.ArmDesign], weights: Sequence[float], states: int, path: Path | BytesIO) -> None:
    """Every arm with every weight, a row for each."""
    flat = next(iter(arms.values())).dimension == 2
    shown: list[tuple[str, Any]] = []
    for weight in [one for one in weights if one > 0]:
        for name, arm in arms.items():
            wrench = [0.0, -weight, *[0.0] * (1 if flat else 4)]
            shown.append((f"{name}, {weight:g} N", ta.workspace(arm, wrench, states=states)))
    plot.workspace_figure(shown, columns=len(arms)).savefig(path, dpi=90)


def draw_loads(arms: Mapping[str, ta.ArmDesign], path: Path | BytesIO, count: int) -> None:
    """How far off the arms' tips are at one shape, under forces from all sides."""
    figure = plot.load_figure(list(arms.items()), ta.Task(SHAPE), loads=plot.load_grid(5.0, count))
    figure.savefig(path, dpi=90)
