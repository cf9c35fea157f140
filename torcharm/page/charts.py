"""Two charts of an answer: a node's set in the plane, and the margins of all nodes."""

import math
from typing import Any

import numpy as np

from torcharm.page.answers import Answer, NodeSet
from torcharm.page.state import round_up
from torcharm.plot._common import Array

HEIGHT = 230
"""Of a chart [pixels]."""
WIDTH = 64
"""Of the numbers beside a chart [pixels]."""
TICKS = 10
"""Steps of an axis, by which its ends move."""
INK, BAND, OUTSIDE = "#0072B2", "rgba(0, 114, 178, 0.25)", "#D55E00"
"""As in the figures: a set is blue, a requirement vermillion."""


class Charts:
    """The charts of one browser, by viser's words for them; a set in space is no chart, but in the scene."""

    def __init__(self, gui: Any, uplot: Any, dimension: int) -> None:
        none = np.zeros(1)
        how: dict[str, Any] = {"height": HEIGHT, "legend": uplot.Legend(show=True, live=False)}
        how["scales"] = {"x": uplot.Scale(time=False)}
        self._set = None
        self._ends: tuple[tuple[float, float], ...] = ()
        if dimension == 2:
            lines: Any = (
                uplot.Series(label="force"),
                uplot.Series(label="pressures give from", stroke=INK, width=1.5, points={"show": False}),
                uplot.Series(label="to", stroke=INK, width=1.5, points={"show": False}),
                uplot.Series(label="required", stroke=OUTSIDE, points={"show": True, "size": 10, "fill": OUTSIDE}),
            )
            axes = (uplot.Axis(label="force [N]"), uplot.Axis(label="moment [N·m]", size=WIDTH))
            bands = (uplot.Band(series=(2, 1), fill=BAND),)
            self._set = gui.add_uplot((none,) * 4, lines, bands=bands, axes=axes, **how)
        series = (
            uplot.Series(label="node"),
            uplot.Series(label="margin", stroke=INK, width=2, points={"show": True, "size": 6}),
            uplot.Series(
                label="0: below it a node lacks", stroke=OUTSIDE, width=1, dash=(6, 4), points={"show": False}
            ),
        )
        below: Any = (uplot.Axis(label="node, base to tip"), uplot.Axis(label="margin [N]", size=WIDTH))
        self._margins = gui.add_uplot((none,) * 3, series, axes=below, **how)

    def show(self, found: Answer) -> None:
        """Draw them anew."""
        if self._set is not None:
            ends = tuple(axis_ends(found.node_set, component) for component in (0, 1))
            if ends != self._ends:  # for other ends a browser makes the chart anew
                self._ends = ends
                self._set.scales = {"x": {"time": False, "range": ends[0]}, "y": {"range": ends[1]}}
            self._set.data = outline(found.node_set)
        self._margins.data = margins(found)


def axis_ends(shown: NodeSet, component: int) -> tuple[float, float]:
    """From where to where an axis goes, round numbers: the chart's own would not see past what is missing."""
    values = np.append(shown.corners[:, component], shown.required[component])
    low, high = float(values.min()), float(values.max())
    step = round_up((high - low) or 1.0) / TICKS
    return step * (math.floor(low / step) - 0.5), step * (math.ceil(high / step) + 0.5)


def outline(shown: NodeSet) -> tuple[Array, Array, Array, Array]:
    """A set in the plane over forces in ascending order: its least and its largest moment, and the moment required.

    Returns:
        Forces, least, largest and required (P,); NaN where there is none.
    """
    corners, (force, moment) = shown.corners, shown.required
    forces, way = np.unique(np.append(corners[:, 0], force)), np.roll(corners, -1, 0) - corners
    upright = way[:, 0] == 0  # of such a side its start alone counts
    share = (forces[:, None] - corners[:, 0]) / np.where(upright, 1.0, way[:, 0])
    moments = corners[:, 1] + share * way[:, 1]
    crossed = np.where(upright, share == 0, (share >= 0) & (share <= 1))
    least, largest = (
        np.where(crossed.any(1), further(np.where(crossed, moments, beyond), axis=1), np.nan)
        for further, beyond in ((np.min, np.inf), (np.max, -np.inf))
    )
    return forces, least, largest, np.where(forces == force, moment, np.nan)


def margins(found: Answer) -> tuple[Array, Array, Array]:
    """Nodes, counted from 1, their margins, and the line below which a node lacks something (N,)."""
    known = np.where(np.isfinite(found.margins), found.margins, np.nan)
    return np.arange(1.0, len(known) + 1), known, np.zeros_like(known)
