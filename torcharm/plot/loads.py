"""Maps over tip forces, in a plane or in all directions: which of them an arm bears at a shape, and how well."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import CenteredNorm, Normalize, TwoSlopeNorm
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries
from torcharm.attainability import evaluate
from torcharm.inputs import TensorLike, as_floating, check_choice, check_count, check_number
from torcharm.plot._common import Array, array, axes_or_new, one_design, one_shape
from torcharm.task import Task

FORCES = ("tip force $f_x$ (right) [N]", "tip force $f_y$ (up) [N]", "tip force $f_z$ (to the viewer) [N]")
AZIMUTH = "azimuth of the force [°] (0 right, 90 to the viewer)"
ELEVATION = "elevation of the force [°] (90 up)"
BANDS = 24
"""Shades of a map."""
NEAR = 0.1
"""Of a side of a colour bar: no tick is so near to that of its middle."""
HALO = [withStroke(linewidth=4, foreground="white")]
"""Around lines and marks, so that they are seen on any shade."""
SIGNED_COLOURS, POSITIVE_COLOURS, LOST_COLOUR = "PuOr_r", "cividis", "#BBBBBB"
RISING_COLOURS = "PuOr"
"""Of what is good where it is large; the hue of what is good is the same as of `SIGNED_COLOURS`."""


def load_grid(
    limit: float | tuple[float, float] = 10.0, count: int = 41, moment: float = 0.0, plane: str | None = None
) -> Float[Tensor, "rows columns components"]:
    """Tip loads (count, count, 3 or 6) on a Cartesian grid of forces, for `load_map` and as a Task's `tip_load`.

    Args:
        limit: largest size of the two force components [N]; one for both, or two.
        count: forces a side; an odd number has the unloaded arm in the middle.
        moment: of every load of the plane [N·m].
        plane: "xy", "xz" or "zy" of an arm in space, the component to the right first; None is an arm of the plane.

    Raises:
        ValueError: a limit is not positive, fewer than 2 forces a side, a moment is not finite, or a plane is none.
    """
    check_count("count", count, 2)
    if plane is not None:
        check_choice("plane", plane, ("xy", "xz", "zy"))
    side = torch.linspace(-1.0, 1.0, count, dtype=torch.float64)
    ends = limit if isinstance(limit, tuple) else (limit, limit)
    right, up = (check_number("limit", end, 0.0, strict=True, unit="N") * side for end in ends)
    force_y, force_x = torch.meshgrid(up, right, indexing="ij")
    if plane is not None:
        loads = torch.zeros(count, count, 6, dtype=torch.float64)
        loads[..., "xyz".index(plane[0])], loads[..., "xyz".index(plane[1])] = force_x, force_y
        return loads
    return torch.stack((force_x, force_y, torch.full_like(force_x, check_number("moment", moment))), -1)


def polar_load_grid(
    limit: float = 10.0, rings: int = 21, directions: int = 72, moment: float = 0.0
) -> Float[Tensor, "rows columns 3"]:
    """Tip loads on rings of equal force, from none to `limit` [N]; the first direction comes again at the end.

    Raises:
        ValueError: the limit is not positive, fewer than 2 rings or 3 directions, or a moment is not finite.
    """
    check_count("rings", rings, 2)
    check_count("directions", directions, 3)
    size = check_number("limit", limit, 0.0, strict=True, unit="N")
    radius = torch.linspace(0.0, size, rings, dtype=torch.float64).unsqueeze(-1)
    angle = torch.linspace(0.0, 2 * math.pi, directions + 1, dtype=torch.float64)
    force_x, force_y = radius * angle.cos(), radius * angle.sin()
    return torch.stack((force_x, force_y, torch.full_like(force_x, check_number("moment", moment))), -1)


def force_directions(size: float = 1.0, rows: int = 25, columns: int = 49) -> Float[Tensor, "rows columns 6"]:
    """Tip loads of one size [N] in all directions of space, by elevation (from straight down) and azimuth.

    `load_map(loads, size * ta.load_capacity(arm, task).factor, quantity="largest force", contour=None)` shows how hard
    an arm can be pulled which way.

    Raises:
        ValueError: the size is not positive, or fewer than 3 rows or columns.
    """
    check_count("rows", rows, 3)
    check_count("columns", columns, 3)
    check_number("size", size, 0.0, strict=True, unit="N")
    elevation = torch.linspace(-math.pi / 2, math.pi / 2, rows, dtype=torch.float64).unsqueeze(-1)
    azimuth = torch.linspace(-math.pi, math.pi, columns, dtype=torch.float64)
    flat = elevation.cos()
    across = torch.stack(torch.broadcast_tensors(flat * azimuth.cos(), elevation.sin(), flat * azimuth.sin()), -1)
    return size * torch.cat((across, 0 * across), -1)


def load_map(
    loads: TensorLike,
    values: TensorLike,
    *,
    quantity: str = "signed unattainability",
    unit: str = "N",
    contour: float | None = 0.0,
    contour_label: str | None = None,
    lowest: float | None = None,
    highest: float | None = None,
    middle: float = 0.0,
    rising: bool = False,
    bar: bool = True,
    ax: Axes | None = None,
) -> Axes:
    """Any quantity that depends on the tip load, over a grid of tip forces: shades, and a contour where it matters.

    A quantity on both sides of 0, or of another middle, gets two hues that meet there, each with half of the shades;
    one on a single side gets one scale.

    Args:
        loads: (R, C, 3) or (R, C, 6) of `load_grid`, `polar_load_grid` or `force_directions`, or any grid with four
            neighbours to a load, of which two force components differ, or forces of one size in all directions.
        values: (R, C) one for each load; what is not finite is grey, and counted in the legend.
        quantity, unit: of the values, for the colour bar; "" is no unit.
        contour: the value at which to draw a line; None draws none.
        contour_label: of the line, in the legend; None takes the value.
        lowest, highest: ends of the colour scale; values beyond get its first or last shade. None takes the least and
            the largest value.
        middle: where the two hues meet.
        rising: whether large values are good; else small ones are.
        bar: whether to draw a colour bar.
        ax: 2-D axes to draw in; None makes some.

    Raises:
        ValueError: shapes do not fit, or the axes are not 2-D.
    """
    places, field = as_floating(loads=loads, values=values)
    x, y, labels = map_places(places)
    if field.shape != places.shape[:2]:
        raise ValueError(f"values: must have shape {tuple(places.shape[:2])}, got {tuple(field.shape)}")
    value = array(field)
    finite = np.isfinite(value)
    axes = axes_or_new(ax)
    if not finite.all():
        axes.set_facecolor(LOST_COLOUR)
        axes.plot([], [], "s", color=LOST_COLOUR, label=f"not known: {(~finite).sum()} of {finite.size}")
    if not finite.any():
        axes.set(xlim=(x.min(), x.max()), ylim=(y.min(), y.max()))
        _label(axes, labels)
        return axes
    shown = np.ma.masked_where(~finite, value)
    norm, levels, colours = _scale(value[finite], lowest, highest, middle)
    colours = RISING_COLOURS if rising and colours == SIGNED_COLOURS else colours
    below, above = value[finite].min() < levels[0], value[finite].max() > levels[-1]
    extend = ("both" if above else "min") if below else ("max" if above else "neither")
    shades = axes.contourf(x, y, shown, levels=levels, norm=norm, cmap=colours, extend=extend)
    drawn = contour is not None and value[finite].min() < contour < value[finite].max()
    if bar:
        colour_bar(axes.figure, shades, axes, f"{quantity} [{unit}]" if unit else quantity, contour if drawn else None)
    if drawn:
        line = axes.contour(x, y, shown, levels=[contour], colors="black", linewidths=2.2)
        line.set_path_effects(HALO)
        axes.plot(
            [], [], color="black", linewidth=2.2, label=contour_label or f"{quantity} = {contour:g} {unit}".rstrip()
        )
    _label(axes, labels)
    return axes


def colour_bar(figure: Any, shades: Any, axes: Any, label: str, line: float | None) -> None:
    """A colour bar of the shades of a map, beside axes, with round numbers, and a line where the map has one."""
    bar = figure.colorbar(shades, ax=axes, label=label, shrink=0.8)
    middle = getattr(shades.norm, "vcenter", None)
    ticks = _ticks(float(shades.levels[0]), float(shades.levels[-1]), middle)
    bar.set_ticks(ticks, labels=[f"{tick:g}" for tick in ticks])
    if line is not None:
        bar.ax.axhline(line, color="black", linewidth=2.2)


def map_places(loads: Tensor) -> tuple[Array, Array, tuple[str, str]]:
    """Where loads (R, C, 3 or 6) are drawn, and what the axes say."""
    if loads.ndim != 3 or loads.shape[-1] not in (3, 6) or min(loads.shape[:2]) < 2:
        raise ValueError(
            f"loads: must have shape (R, C, 3) or (R, C, 6) with R and C at least 2, got {tuple(loads.shape)}"
        )
    force = array(loads)[..., : 3 if loads.shape[-1] == 6 else 2]
    size = np.linalg.norm(force, axis=-1)
    differ = [index for index in range(force.shape[-1]) if np.ptp(force[..., index]) > 1e-9 * size.max()]
    if force.shape[-1] == 2 or len(differ) == 2:
        first, second = (differ[::-1] if differ == [1, 2] else differ) if force.shape[-1] == 3 else (0, 1)
        return force[..., first], force[..., second], (FORCES[first], FORCES[second])
    if len(differ) < 3 or np.ptp(size) > 1e-6 * size.max():
        raise ValueError(
            "loads: must differ in two force components, or be of one size in all directions (see load_grid and "
            "force_directions)"
        )
    azimuth = np.unwrap(np.arctan2(force[..., 2], force[..., 0]), axis=1)
    elevation = np.arcsin((force[..., 1] / size).clip(-1, 1))
    return np.degrees(azimuth), np.degrees(elevation), (AZIMUTH, ELEVATION)


def _label(axes: Axes, labels: tuple[str, str]) -> None:
    """Axes of one scale, and a legend above them."""
    if labels[0] == AZIMUTH:
        axes.set(xticks=range(-180, 181, 45), yticks=range(-90, 91, 30))
    else:
        axes.plot(0, 0, "+", color="black", markersize=9, label="no load", path_effects=HALO)
    axes.set(xlabel=labels[0], ylabel=labels[1])
    axes.set_aspect("equal")
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, fontsize="small", frameon=False)


def under_forces(task: Task, loads: Tensor | None, count: int) -> tuple[Tensor, Task]:
    """A grid of tip forces, that given or one of so many a side, and a task of one shape under them, and under its own
    weight and point loads."""
    one_shape(task, [0])  # refuses several
    one = task.part(0)
    grid = load_grid(count=count, plane="xy" if task.dimension == 3 else None) if loads is None else loads
    return grid, replace(one, load=one.load.with_tip(grid.to(one.twists)))


@torch.no_grad()
def attainable_load_map(
    arm: ArmDesign | ArmSeries,
    task: Task | Float[Tensor, "*batch N components"],
    *,
    loads: Float[Tensor, "rows columns components"] | None = None,
    metric: str = "absolute",
    weights: tuple[float, float] = (1.0, 1.0),
    ax: Axes | None = None,
) -> Axes:
    """Which tip forces one design bears at one shape: its signed unattainability, and the line where that is 0.

    Within the line minus the smallest margin of any node, outside the distances to the sets summed over the nodes.

    Args:
        arm: one design, in the plane or in space, or segments in series.
        task: of one shape, beside whose weight and point loads the tip forces act; or twists (N, 3 or 6) [m, m, rad].
        loads: (R, C, 3 or 6) as for `load_map`; None takes `load_grid()`, in space of the plane "xy".
        metric, weights: as for `evaluate`.
        ax: 2-D axes to draw in; None makes some.

    Raises:
        ValueError: there are several designs or shapes, or as for `load_map` and `evaluate`.
    """
    grid, loaded = under_forces(task if isinstance(task, Task) else Task(task), loads, 41)
    found = evaluate(one_design("arm", arm, loaded), loaded, (metric,), signed=True, weights=weights)
    value = getattr(found, metric)
    unit = "N" if tuple(weights) == (1.0, 1.0) else "weighted"
    label = f"limit of what it bears: {int((value <= 0).sum())} of {value.numel()} within"
    axes = load_map(
        grid, value, quantity=f"{metric} unattainability, below 0 margin", unit=unit, contour_label=label, ax=ax
    )
    if not bool(found.in_range.all()):
        axes.annotate(
            f"strain {float(found.strain_excess.max()):.2g} beyond range", (0.02, 0.02), xycoords="axes fraction"
        )
    return axes


def _scale(values: Array, lowest: float | None, highest: float | None, middle: float) -> tuple[Normalize, Array, str]:
    """A norm, the bounds of the shades, and the colours' name."""
    low, high = (float(own if end is None else end) for own, end in ((values.min(), lowest), (values.max(), highest)))
    if high - low <= 1e-9 * max(abs(low), 1e-9):  # one value everywhere, or a scale that ends below them all
        high = low + max(abs(low), 1.0) * 1e-3
    if low < middle < high:
        # Margins are small beside sums of misses: each side has half of the shades.
        sides = np.linspace(low, middle, BANDS // 2 + 1), np.linspace(middle, high, BANDS // 2 + 1)[1:]
        return TwoSlopeNorm(middle, low, high), np.concatenate(sides), SIGNED_COLOURS
    levels = np.linspace(low, high, BANDS + 1)
    if low < 0 and high <= 0:
        return CenteredNorm(0.0, -low), levels, SIGNED_COLOURS
    return Normalize(low, high), levels, POSITIVE_COLOURS


def _ticks(low: float, high: float, middle: float | None) -> list[float]:
    """Round numbers between the two; on both sides of a middle, each has its own scale, and none hides the middle's."""

    def between(start: float, end: float) -> set[float]:
        return {float(tick) for tick in MaxNLocator(4).tick_values(start, end) if start <= tick <= end}

    if middle is None or not low < middle < high:
        return sorted(between(low, high))
    below, above = middle - NEAR * (middle - low), middle + NEAR * (high - middle)
    ticks = between(low, middle) | between(middle, high)
    return sorted({middle} | {tick for tick in ticks if not below < tick < above})
