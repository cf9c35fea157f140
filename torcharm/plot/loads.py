"""Maps over tip forces: which of them an arm bears at a shape, and by what margin."""

import math

import numpy as np
import torch
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import CenteredNorm, Normalize, TwoSlopeNorm
from matplotlib.ticker import MaxNLocator
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.attainability import evaluate
from torcharm.inputs import TensorLike, as_floating, check_count
from torcharm.plot._common import Array, array, axes_or_new, one_design
from torcharm.task import WRENCH_AT, Task

BANDS = 24
"""Shades of a map."""
SIGNED_COLOURS, POSITIVE_COLOURS, LOST_COLOUR = "PuOr_r", "cividis", "#BBBBBB"


def load_grid(
    limit: float | tuple[float, float] = 10.0, count: int = 41, moment: float = 0.0
) -> Float[Tensor, "rows columns 3"]:
    """Tip loads on a Cartesian grid of forces, for `load_map` and as a Task's `tip_load`.

    Args:
        limit: largest `|f_x|` and `|f_y|` [N]; one for both, or two.
        count: forces a side; an odd number has the unloaded arm in the middle.
        moment: of every load [N·m].

    Raises:
        ValueError: a limit is not positive, fewer than 2 forces a side, or a moment is not finite.
    """
    check_count("count", count, 2)
    wide, high = _limits(limit)
    _check_moment(moment)
    right = torch.linspace(-wide, wide, count, dtype=torch.float64)
    up = torch.linspace(-high, high, count, dtype=torch.float64)
    force_y, force_x = torch.meshgrid(up, right, indexing="ij")
    return torch.stack((force_x, force_y, torch.full_like(force_x, moment)), -1)


def polar_load_grid(
    limit: float = 10.0, rings: int = 21, directions: int = 72, moment: float = 0.0
) -> Float[Tensor, "rows columns 3"]:
    """Tip loads on rings of equal force, from none to `limit` [N]; the first direction comes again at the end.

    Raises:
        ValueError: the limit is not positive, fewer than 2 rings or 3 directions, or a moment is not finite.
    """
    check_count("rings", rings, 2)
    check_count("directions", directions, 3)
    size, _ = _limits(limit)
    _check_moment(moment)
    radius = torch.linspace(0.0, size, rings, dtype=torch.float64).unsqueeze(-1)
    angle = torch.linspace(0.0, 2 * math.pi, directions + 1, dtype=torch.float64)
    force_x, force_y = radius * angle.cos(), radius * angle.sin()
    return torch.stack((force_x, force_y, torch.full_like(force_x, moment)), -1)


def load_map(
    loads: TensorLike,
    values: TensorLike,
    *,
    quantity: str = "signed unattainability",
    unit: str = "N",
    contour: float | None = 0.0,
    contour_label: str | None = None,
    highest: float | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Any quantity that depends on the tip load, over a grid of tip forces: shades, and a contour where it matters.

    A quantity of both signs gets two hues that meet at 0; one of a single sign gets one scale.

    Args:
        loads: (R, C, 3) of `load_grid` or `polar_load_grid`, or any grid with four neighbours to a load [N, N, N·m].
        values: (R, C) one for each load; what is not finite is grey, and counted in the legend.
        quantity, unit: of the values, for the colour bar.
        contour: the value at which to draw a line; None draws none.
        contour_label: of the line, in the legend; None takes the value.
        highest: end of the colour scale; larger values get its last shade. None takes the largest value.
        ax: 2-D axes to draw in; None makes some.

    Raises:
        ValueError: shapes do not fit, no value is finite, or the axes are not 2-D.
    """
    places, field = as_floating(loads=loads, values=values)
    if places.ndim != 3 or places.shape[-1] != 3 or min(places.shape[:2]) < 2:
        raise ValueError(f"loads: must have shape (R, C, 3) with R and C at least 2, got {tuple(places.shape)}")
    if field.shape != places.shape[:2]:
        raise ValueError(f"values: must have shape {tuple(places.shape[:2])}, got {tuple(field.shape)}")
    grid, value = array(places), array(field)
    finite = np.isfinite(value)
    if not finite.any():
        raise ValueError("values: must hold at least one finite value, got none")
    axes = axes_or_new(ax)
    x, y, shown = grid[..., 0], grid[..., 1], np.ma.masked_where(~finite, value)
    norm, levels, colours = _scale(value[finite], highest)
    extend = "max" if value[finite].max() > levels[-1] else "neither"
    shades = axes.contourf(x, y, shown, levels=levels, norm=norm, cmap=colours, extend=extend)
    bar = axes.figure.colorbar(shades, ax=axes, label=f"{quantity} [{unit}]", shrink=0.8)
    bar.set_ticks(_ticks(float(levels[0]), float(levels[-1])))
    if contour is not None and value[finite].min() < contour < value[finite].max():
        axes.contour(x, y, shown, levels=[contour], colors="black", linewidths=2.2)
        axes.plot([], [], color="black", linewidth=2.2, label=contour_label or f"{quantity} = {contour:g} {unit}")
        bar.ax.axhline(contour, color="black", linewidth=2.2)
    axes.plot(0, 0, "+", color="black", markersize=9, label="no load")
    if not finite.all():
        axes.set_facecolor(LOST_COLOUR)
        axes.plot([], [], "s", color=LOST_COLOUR, label=f"not known: {(~finite).sum()} of {finite.size}")
    axes.set(xlabel=r"tip force $f_x$ (right) [N]", ylabel=r"tip force $f_y$ (up) [N]")
    axes.set_aspect("equal")
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, fontsize="small", frameon=False)
    return axes


def attainable_load_map(
    arm: ArmDesign,
    twists: Float[Tensor, "*batch N 3"],
    *,
    loads: Float[Tensor, "rows columns 3"] | None = None,
    metric: str = "absolute",
    base_pose: TensorLike | str | None = None,
    wrench_at: str = WRENCH_AT,
    weights: tuple[float, float] = (1.0, 1.0),
    ax: Axes | None = None,
) -> Axes:
    """Which tip forces one design bears at one shape: its signed unattainability, and the line where that is 0.

    Within the line minus the smallest margin of any node, outside the distances to the hulls summed over the nodes.

    Args:
        arm: one design.
        twists: (N, 3) one shape [m, m, rad].
        loads: (R, C, 3) as for `load_map`; None takes `load_grid()`.
        metric, weights: as for `evaluate`.
        base_pose: of node 1, as of `Task`.
        wrench_at: as of `Task`.
        ax: 2-D axes to draw in; None makes some.

    Raises:
        ValueError: there are several designs or shapes, or as for `load_map` and `evaluate`.
    """
    design = one_design("arm", arm)
    places = (load_grid() if loads is None else loads).to(design.radii)
    shape = twists.detach().reshape(-1, *twists.shape[-2:])
    if len(shape) != 1:
        raise ValueError(f"twists: must hold one shape, (N, 3), got {tuple(twists.shape)}")
    task = Task(shape[0].to(design.radii), places, base_pose, wrench_at=wrench_at)
    with torch.no_grad():
        found = evaluate(design, task, (metric,), signed=True, weights=weights)
    value = getattr(found, metric)
    unit = "N" if tuple(weights) == (1.0, 1.0) else "weighted"
    label = f"limit of what it bears: {int((value <= 0).sum())} of {value.numel()} within"
    axes = load_map(
        places, value, quantity=f"{metric} unattainability, below 0 margin", unit=unit, contour_label=label, ax=ax
    )
    if not bool(found.in_range.all()):
        axes.annotate(
            f"strain {float(found.strain_excess.max()):.2g} beyond range", (0.02, 0.02), xycoords="axes fraction"
        )
    return axes


def _scale(values: Array, highest: float | None) -> tuple[Normalize, Array, str]:
    """A norm, the bounds of the shades, and the colours' name."""
    low, high = float(values.min()), float(values.max()) if highest is None else float(highest)
    if high - low <= 1e-9 * max(abs(low), 1e-9):  # one value everywhere, or a scale that ends below them all
        high = low + max(abs(low), 1.0) * 1e-3
    if low < 0 < high:
        # Margins are small beside sums of misses: each side has half of the shades.
        levels = np.concatenate((np.linspace(low, 0, BANDS // 2 + 1), np.linspace(0, high, BANDS // 2 + 1)[1:]))
        return TwoSlopeNorm(0.0, low, high), levels, SIGNED_COLOURS
    if high < 0 or (low < 0 and high <= 0):
        return CenteredNorm(0.0, -low), np.linspace(low, high, BANDS + 1), SIGNED_COLOURS
    return Normalize(low, high), np.linspace(low, high, BANDS + 1), POSITIVE_COLOURS


def _ticks(low: float, high: float) -> list[float]:
    """Round numbers between the two; with both signs, each sign has its own scale."""
    sides = [(low, 0.0), (0.0, high)] if low < 0 < high else [(low, high)]
    ticks = {float(tick) for side in sides for tick in MaxNLocator(4).tick_values(*side)}
    return sorted(tick for tick in ticks if low <= tick <= high)


def _limits(limit: float | tuple[float, float]) -> tuple[float, float]:
    wide, high = limit if isinstance(limit, tuple) else (limit, limit)
    for value in (wide, high):
        if not 0 < value < math.inf:
            raise ValueError(f"limit: must be finite and above 0 N, got {value:g}")
    return wide, high


def _check_moment(moment: float) -> None:
    if not math.isfinite(moment):
        raise ValueError(f"moment: must be finite, got {moment}")
