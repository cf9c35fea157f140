"""The picture: an S with one segment and with two, and errors by the number of segments."""

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure

import torcharm as ta
from experiments.segments import scenes
from torcharm import plot

if TYPE_CHECKING:
    from experiments.segments.rows import Row

COLOURS = dict(zip(("arc", "S of two arcs", "smooth S", "cubic", "helix"), plot.ARM_COLOURS, strict=False))
MARKERS = dict(zip(COLOURS, "osv^D", strict=True))
PICTURED = "S of two arcs"
AIMS = {
    "shape": "Asked for the shape: joints help, most where it changes",
    "tip pose": "Asked for the tip's place and heading: two or three do",
    "tip place": "Asked for the tip's place: one mostly does",
}
LINES = {"antagonistic": "-", "bellows": ":"}
FLOOR = 0.01
"""Errors below this are drawn there [mm]."""


def draw(rows: "Sequence[Row]", path: Path | BytesIO) -> None:
    figure = Figure(figsize=(15, 11))
    for count, left in ((1, -0.125), (2, 0.13)):  # arms are slim, and their axes square: these overlap
        _arm(figure.add_axes((left, 0.16, 0.5, 0.7), projection="3d"), rows, count)
    room = {"left": 0.58, "right": 0.98, "bottom": 0.07, "hspace": 0.15}
    panels = figure.subplots(3, 1, sharex=True, sharey=True, gridspec_kw=room)
    for axes, (aim, title) in zip(panels, AIMS.items(), strict=True):
        _errors(axes, [row for row in rows if row.aim == aim], title)
    panels[1].set_ylabel("error that a search reaches [mm]")
    panels[2].set_xlabel("segments in the same length")
    panels[2].legend(fontsize="small", loc="upper right", ncols=2)
    figure.suptitle(
        "One segment brings its tip to the place, two or three bring it there with the right heading;\n"
        "a shape asks for more segments, with joints where it changes",
        fontsize="x-large",
        fontweight="bold",
    )
    figure.savefig(path, dpi=75)


def _arm(axes: Any, rows: "Sequence[Row]", count: int) -> None:
    """The arm at what a search reaches."""
    twists, aim = scenes.shapes("antagonistic")[PICTURED], scenes.aims()["shape"]
    arm, task = scenes.arm("antagonistic", count), scenes.task(twists, count)
    plot.arm_shape(arm, task, reached=ta.search_pressure(arm, task, pose_cost=aim).twists, ax=axes)
    error = next(
        row.searched_mm
        for row in rows
        if (row.kind, row.shape, row.segments, row.aim) == ("antagonistic", PICTURED, count, "shape")
    )
    words = "one segment misses" if count == 1 else "two segments hold"
    axes.set_title(f"{words} the S:\nshape error {error:.1f} mm", fontweight="bold", y=1.03)
    axes.view_init(elev=14, azim=-70)
    axes.patch.set_alpha(0.0)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.04), fontsize="small", ncols=2)
    axes.locator_params(axis="x", nbins=4)
    axes.locator_params(axis="y", nbins=3)


def _errors(axes: Any, rows: "Sequence[Row]", title: str) -> None:
    for kind in dict.fromkeys(row.kind for row in rows):
        for shape in dict.fromkeys(row.shape for row in rows):
            own = [row for row in rows if (row.kind, row.shape) == (kind, shape)]
            axes.plot(
                [row.segments for row in own],
                [max(row.searched_mm, FLOOR) for row in own],
                color=COLOURS[shape],
                marker=MARKERS[shape],
                linestyle=LINES[kind],
                fillstyle="full" if kind == "antagonistic" else "none",
                label=f"{shape}, {kind}",
            )
    axes.set_xticks(scenes.SEGMENTS)
    axes.set(title=title, yscale="log", ylim=(0.7 * FLOOR, 400))
    axes.axhline(FLOOR, color="0.7", linewidth=0.8)
    axes.text(1.0, 1.15 * FLOOR, f"{FLOOR} or less", color="0.4", fontsize="small")
