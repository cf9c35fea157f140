"""Pictures of sweeps: how designs are distributed, counted in bins shard by shard, however many there are."""

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from torcharm.sweeps.measures import Rows
from torcharm.sweeps.ranking import label

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK = "#0072B2"
DECADES = 100.0
"""Ratio of the largest to the least value from which an axis is logarithmic."""

Edges = npt.NDArray[np.float64]
Blocks = Callable[[Sequence[str]], Iterator[Rows]]
"""Gives some columns, shard by shard."""


def histograms(blocks: Blocks, names: Sequence[str], bins: int) -> "Figure":
    """A histogram of each column beside each other."""
    from matplotlib.figure import Figure

    edges = bin_edges(blocks, names, bins)
    counts = [np.zeros(bins) for _ in names]
    for block in blocks((*names, "feasible")):
        for place, name in enumerate(names):
            counts[place] += np.histogram(block[name][block["feasible"]], edges[place])[0]
    figure = Figure(figsize=(max(6.0, 3.2 * len(names)), 3.6), layout="constrained")
    for place, axes in enumerate(np.ravel(figure.subplots(1, len(names)))):
        axes.stairs(counts[place], edges[place], fill=True, color=INK)
        axes.set(xlabel=label(names[place]), ylabel="" if place else "number of designs", ylim=(0, None))
        axes.set_xscale(_scale(edges[place]))
    return figure


def density(blocks: Blocks, x: str, y: str, bins: int) -> "Figure":
    """One column against another, with the number of designs as colour."""
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure

    edges = bin_edges(blocks, (x, y), bins)
    both: Any = (edges[0], edges[1])
    count = np.zeros((bins, bins))
    for block in blocks((x, y, "feasible")):
        known = block["feasible"]
        count += np.histogram2d(block[x][known], block[y][known], both)[0]
    figure = Figure(figsize=(7.0, 5.5), layout="constrained")
    axes = figure.subplots()
    shown = np.ma.masked_less(count.T, 1)
    mesh = axes.pcolormesh(*edges, shown, norm=LogNorm(1, max(2.0, count.max())), cmap="viridis", rasterized=True)
    figure.colorbar(mesh, label="number of designs")
    axes.set(xlabel=label(x), ylabel=label(y), xscale=_scale(edges[0]), yscale=_scale(edges[1]))
    return figure


def bin_edges(blocks: Blocks, names: Sequence[str], bins: int) -> list[Edges]:
    """Of so many bins from the least to the largest finite value of columns; by their ratio, evenly in logarithm."""
    ends = dict.fromkeys(names, (np.inf, -np.inf))
    for block in blocks((*names, "feasible")):
        for name, (low, high) in ends.items():
            known = block[name][block["feasible"] & np.isfinite(block[name])].astype(np.float64)
            ends[name] = float(known.min(initial=low)), float(known.max(initial=high))
    return [_edges(name, *ends[name], bins) for name in names]


def _edges(name: str, low: float, high: float, bins: int) -> Edges:
    if low > high:
        raise ValueError(f"column: must hold something finite to be drawn, and {name} does not")
    if low == high:
        low, high = low - 0.5, high + 0.5
    edges = np.geomspace(low, high, bins + 1) if 0 < DECADES * low < high else np.linspace(low, high, bins + 1)
    edges[[0, -1]] = low, high
    return np.asarray(edges, dtype=np.float64)


def _scale(edges: Edges) -> str:
    return "log" if 0 < DECADES * edges[0] < edges[-1] else "linear"
