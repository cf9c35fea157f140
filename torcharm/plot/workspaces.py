"""Where arms can reach, and with what payload: one, or several side by side at the same scale."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from torch import Tensor

from torcharm.geometry.alpha_shape import AlphaShape, alpha_shape
from torcharm.inputs import check_choice, check_count, shown
from torcharm.plot._common import (
    ATTAINABLE,
    PLAIN,
    UNATTAINABLE,
    Array,
    array,
    axes_or_new,
    label_powers,
    merged_legend,
    same_limits,
)
from torcharm.study.words import region_size
from torcharm.workspaces import STATES, Workspace
from torcharm.workspaces.states import position_of

SHOWN = {
    "payload factor": "largest factor by which the payload could grow,\nif each node had pressures of its own",
    "angle range": "range of the tip's angle [°]",
    "reached": "",
}
"""What may be shown of places that are reached, and how colour bars call it."""
PLANES = ("xy", "zy", "xz")
"""In which arms in space are seen: from before, from the left and from above; the coordinate to the right first."""
AXES = {"x": "x, right [m]", "y": "y, up [m]", "z": "z, to the viewer [m]"}
COLOURS, FLAT, BEYOND = "cividis", "#E0C872", "#DDDDDD"
APART = {"snapped": ("#0072B2", "^"), "unstable": (UNATTAINABLE, "x")}
"""States that are marked, each for itself."""
MOST_MARKS = 300
"""Of a kind, of many states those that are evenly spaced among them."""
HIGHEST = 0.95
"""Of the places whose factor the colours tell apart; those of more get the last colour. A payload that hardly loads
the arm could grow by any factor."""
PANEL = 4.6
"""Width of a panel [inch]."""


def workspace(
    found: Workspace,
    show: str | None = None,
    *,
    plane: str | None = None,
    highest: float | None = None,
    bar: bool = True,
    ax: Axes | None = None,
) -> Axes:
    """Where an arm's tip can be: in colours what is known of each place, around it in grey where models extrapolate.

    A place's colour is that of the best state in its cell. Places that are reached are within the black line, those
    that are only if force models may be extrapolated within the dashed one. Of an arm in space the region is seen
    through: of all states in a line of sight the best counts.

    Args:
        found: of `torcharm.workspace`.
        show: "payload factor", by what the payload could grow there; "angle range", how far the tip's angle can be
            chosen there (of an arm in space, its elevation); or "reached", no more than where it is. None shows the
            factor if there is a payload.
        plane: of an arm in space, "xy" (from before; None), "zy" (from the left) or "xz" (from above).
        highest: end of the colours; None takes that of 95 % of the places.
        bar: whether to draw a colour bar.
        ax: 2-D axes to draw in; None makes some.

    Raises:
        ValueError: `show` or `plane` is none of those, a factor is asked for without a payload, or the axes are not
            2-D.
    """
    axes, seen, show = axes_or_new(ax), _plane(found, plane), _what(found, show)
    region, beyond = (_seen_shape(found, seen, which) for which in (found.reached, found.extrapolated))
    values, how = _values(found, seen, show), _one_colour(FLAT if region.kept.any() else ATTAINABLE)
    if show != "reached":
        norm = _scale(show, _top(values) if highest is None else highest)
        values[np.isposinf(values)] = norm.vmax
        how = {"cmap": COLOURS, "norm": norm, "gid": show}
    _paint(axes, region, values, how, "-", "reached")
    below = _one_colour(BEYOND) | {"zorder": 0.5}
    _paint(axes, beyond, np.zeros(len(beyond.points)), below, "--", "excluded by range")
    coloured = [one for one in axes.collections if one.get_gid() == show]
    if bar and coloured:
        _bar(axes.figure, coloured[0], axes, show)
    _mark_apart(axes, found, seen)
    base = array(position_of(found.base_pose))[list(seen)]
    axes.plot(*base, "s", color="#555555", markersize=8, label="base", zorder=5)
    names = plane or PLANES[0]
    axes.set(xlabel=AXES[names[0]], ylabel=AXES[names[1]])
    axes.set_aspect("equal")
    if plane == "xz":  # z points to the viewer of the other planes, who is below here
        axes.yaxis.set_inverted(True)
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, fontsize="small", frameon=False)
    return axes


def workspace_figure(
    results: Sequence[tuple[str, Workspace]],
    show: str | None = None,
    *,
    columns: int | None = None,
    highest: float | None = None,
) -> Figure:
    """Workspaces of several arms side by side, at the same scale and in the same colours, for `figure.savefig(path)`.

    Arms in space are seen from before and, below that, from above.

    Args:
        results: names, and what `torcharm.workspace` found.
        show, highest: as of `workspace`.
        columns: how many stand beside each other; None is all.

    Raises:
        ValueError: there is no result, arms of the plane and of space are mixed, or as of `workspace`.
    """
    if not results:
        raise ValueError("results: must hold at least one workspace, got none")
    if len({found.dimension for _, found in results}) > 1:
        raise ValueError("results: must be all of the plane or all of space, got both")
    across = len(results) if columns is None else check_count("columns", columns, 1)
    planes = ("xy", "xz") if results[0][1].dimension == 3 else (None,)
    what = _what(results[0][1], show)
    tops = [_top(_values(found, _plane(found, plane), what)) for _, found in results for plane in planes]
    top = max(tops) if highest is None else highest
    lines = [results[first : first + across] for first in range(0, len(results), across)]
    figure = Figure(layout="constrained", dpi=130)
    grid: Any = figure.subplots(len(lines) * len(planes), across, squeeze=False)
    for place, row in enumerate(grid):
        plane, line = planes[place % len(planes)], lines[place // len(planes)]
        for axes in row[len(line) :]:
            axes.set_axis_off()
        for axes, (name, found) in zip(row, line, strict=False):
            workspace(found, what, plane=plane, highest=top, bar=False, ax=axes)
            axes.get_legend().remove()
            axes.set_title("" if plane == "xz" else f"{name}\n{_words(found)}", fontsize="medium", **PLAIN)
    views = [grid[first :: len(planes)] for first in range(len(planes))]
    heights = [same_limits([axes for axes in view.ravel() if axes.axison]) for view in views]
    figure.set_size_inches(PANEL * across + 1.4, PANEL * sum(heights) * len(lines) + 1.2 * len(grid))
    if what != "reached":
        _bar(figure, ScalarMappable(_scale(what, top), COLOURS), grid.ravel().tolist(), what)
    merged_legend(figure, grid.ravel(), lambda label: label.split(":")[0], loc="outside lower center", ncols=5)
    return figure


def _plane(found: Workspace, plane: str | None) -> tuple[int, int]:
    """The coordinates that are seen, to the right and up."""
    if plane is not None:
        if found.dimension == 2:
            raise ValueError(f"plane: must be left out of an arm of the plane, got {shown(plane)}")
        check_choice("plane", plane, PLANES)
    right, up = tuple(plane or PLANES[0])
    return "xyz".index(right), "xyz".index(up)


def _what(found: Workspace, show: str | None) -> str:
    """What to show."""
    if show is None:
        return "payload factor" if found.has_payload else "reached"
    check_choice("show", show, tuple(SHOWN))
    if show == "payload factor" and not found.has_payload:
        raise ValueError("show: must not be payload factor of a workspace without a payload")
    return show


def _seen_shape(found: Workspace, seen: tuple[int, int], which: Tensor) -> AlphaShape:
    """The region of some states, in space as it is seen."""
    if found.dimension == 2:
        return found.region if which.equal(found.reached) else found.extrapolated_region
    resolution = found.resolution if which.equal(found.reached) else found.extrapolated_resolution
    return alpha_shape(array(found.position[which])[:, list(seen)], resolution)


def _values(found: Workspace, seen: tuple[int, int], show: str) -> Array:
    """(R,) of states reached, in their order, what is known of their cells."""
    reached, place = found.reached, found.position[found.reached][:, list(seen)].double()
    if show == "reached":
        return np.zeros(len(place))
    size = found.resolution * (2 if found.dimension == 2 else 1)  # in space many states are in one line of sight
    cell = (place / size).floor().unique(dim=0, return_inverse=True)[1]
    value = (found.payload_factor if show == "payload factor" else found.angle.rad2deg())[reached].double()

    def over(how: str) -> Tensor:
        nothing = value.new_zeros(int(cell.max()) + 1 if len(cell) else 0)
        return nothing.scatter_reduce(0, cell, value, how, include_self=False)[cell]

    return array(over("amax") if show == "payload factor" else over("amax") - over("amin"))


def _top(values: Array) -> float:
    """The end of the colours for values."""
    finite = values[np.isfinite(values)]
    return float(np.quantile(finite, HIGHEST)) if len(finite) else 1.0


def _one_colour(colour: str) -> dict[str, Any]:
    return {"cmap": ListedColormap([colour])}


def _paint(axes: Any, region: AlphaShape, values: Array, how: dict[str, Any], dashes: str, label: str) -> None:
    """A region in the colours of values at its points, and its outline; without an area its points alone."""
    if region.triangulation is None or not region.kept.any():  # as of an arm that moves along a line
        if len(region.points):
            axes.scatter(*region.points.T, 9, values, label=label, **how)
        return
    triangles = region.triangulation.simplices[region.kept]
    shades = np.fmax.reduce(values[triangles], axis=1)
    axes.tripcolor(*region.points.T, triangles, facecolors=shades, rasterized=True, **how)
    for number, loop in enumerate(region.loops()):
        look = {"color": ATTAINABLE, "linestyle": dashes, "linewidth": 1.3 if dashes == "-" else 0.9}
        axes.plot(*loop.T, label=None if number else label, **look)


def _scale(show: str, top: float | None) -> Normalize:
    """Of colours, up to a value: of factors by their logarithms, from 1 on."""
    if show == "payload factor":
        return LogNorm(1.0, max(top or 1.0, 1.1))
    return Normalize(0.0, max(top or 0.0, 1e-6))


def _bar(figure: Any, colours: Any, axes: Any, show: str) -> None:
    """A colour bar with round numbers."""
    bar = figure.colorbar(colours, ax=axes, label=SHOWN[show], shrink=0.8, extend="max")
    if show == "payload factor":
        label_powers(bar.ax.yaxis)
        bar.minorticks_off()


def _mark_apart(axes: Any, found: Workspace, seen: tuple[int, int]) -> None:
    """Snapped and unstable states, each by a mark."""
    for word, (colour, marker) in APART.items():
        place = array(found.position[found.code == STATES.index(word)])[:, list(seen)]
        if len(place):
            few = place[np.unique(np.linspace(0, len(place) - 1, MOST_MARKS).round().astype(int))]
            label = f"{word}: {100 * len(place) / len(found.code):.2g} % of states"
            axes.plot(*few.T, marker, color=colour, markersize=3, linestyle="none", label=label, zorder=4)


def _words(found: Workspace) -> str:
    """How large a region is."""
    words = f"{region_size(found)} reached" if bool(found.reached.any()) else "nothing reached in range"
    return f"{words}\n{found.interruption}" if found.interruption else words
