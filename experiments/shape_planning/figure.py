"""Pictures of the shape study."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

import torcharm as ta
from torcharm import plot

if TYPE_CHECKING:
    from experiments.shape_planning.rows import Answer

WANTED, REACHED = "#000000", "#D55E00"


def shapes(arm: ta.ArmDesign, answers: Sequence["Answer"]) -> Figure:
    """Each task shape, and the closest that pressures reach under the load."""
    figure = Figure(figsize=(4.2 * len(answers), 4.8), layout="constrained")
    panels = figure.subplots(1, len(answers), sharex=True, sharey=True, squeeze=False)[0]
    for answer, axes in zip(answers, panels, strict=True):
        row = answer.row
        axes.plot(*ta.poses(answer.task.twists)[:, :2].T, color=WANTED, linewidth=3, marker=".", label="task shape")
        line = {"color": REACHED, "linestyle": "--", "marker": "x", "markersize": 4}
        axes.plot(*ta.poses(answer.search.twists)[:, :2].T, **line, label="closest equilibrium")
        title = f"shape {answer.number}, {row.force_x_N:g} N\nroot of the cost: predicted {1e3 * row.predicted_m:.0f}, "
        axes.set(title=title + f"reached {1e3 * row.reached_m:.0f} mm", xlabel="x [m]", aspect="equal")
        axes.legend(loc="lower left", fontsize=8)
    panels[0].set_ylabel("y [m]")
    best = min(answers, key=lambda answer: answer.row.reached_m)
    figure.suptitle(f"Of {len(answers)} shapes with one tip pose, the arm comes closest to shape {best.number}")
    return figure


def hulls(arm: ta.ArmDesign, answers: Sequence["Answer"]) -> Figure:
    """Absolute hulls above, relative below, with what the load requires."""
    figure = Figure(figsize=(4.6 * len(answers), 8.4), layout="constrained")
    for row, relative in enumerate((False, True)):
        for column, answer in enumerate(answers):
            place = row * len(answers) + column + 1
            axes = figure.add_subplot(2, len(answers), place, projection="3d")
            plot.hulls_along_arm(arm, answer.task, relative=relative, ax=axes)
            kind = "relative" if relative else "absolute"
            found = ta.evaluate(arm, answer.task, (kind,))
            axes.set_title(f"shape {answer.number}, {kind}: lacks {getattr(found, kind).item():.2f} N", y=0.97)
            for line in axes.lines:
                if line.get_gid() in ("not attainable", "inside"):  # what the one load requires, above all hulls
                    line.set(linewidth=2.0, markersize=6.0, zorder=10)
            axes.set_box_aspect((1.5, 1.0, 1.0), zoom=0.87)
            legend = axes.get_legend()
            words = [text.get_text() for text in legend.get_texts()]
            legend.remove()
    figure.legend(legend.legend_handles, words, loc="outside lower center", ncols=len(words), frameon=False)
    figure.suptitle(
        "Absolute sets leave out least of what shape 3 requires; relative sets leave out nearly all of every shape's",
        fontweight="bold",
    )
    return figure
