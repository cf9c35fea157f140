"""A picture of an optimisation: errors on every task, and the arm's section, before and after."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from torcharm.actuators import model_name
from torcharm.arm import ArmDesign
from torcharm.arm_series import segments_of, with_slices
from torcharm.design.result import OptimisedDesign
from torcharm.design.task_errors import TaskErrors
from torcharm.inputs import three_digits
from torcharm.plot._common import ATTAINABLE, PLAIN, UNATTAINABLE, array, kind_styles, legend_below, mark_inks

FEW = 12
"""Tasks that are drawn one by one; more are a line each, in ascending order."""
LEGEND = -0.14
"""Where legends are, below the axes, over their height."""


def optimisation_figure(result: OptimisedDesign, title: str = "") -> Figure:
    """Errors predicted on every task, and where actuators sit, of the given and best design.

    The errors are of the shape where these were minimised, and else of the tip: distances, without what counts more
    beyond the characterised range.

    Of few tasks the errors of each are a pair of marks, of many a line in ascending order. The section shows radii
    against lengths of an arm in the plane, and offsets in space; numbers are those of the actuators, from 1, passive
    ones included.
    """
    figure = Figure(figsize=(10, 4.4), layout="constrained")
    errors, section = figure.subplots(1, 2)
    _draw_errors(errors, result.before, result.after, "shape" if result.objective.unit == "m" else "tip")
    errors.set_title(title, **PLAIN)
    planar = result.best.dimension == 2
    names = ("radius [mm]", "neutral length [mm]") if planar else ("offset y [mm]", "offset z [mm]")
    styles = kind_styles(result.best.actuators)
    for arm, filled in ((result.given, False), (result.best, True)):
        for segment, own in with_slices(segments_of(arm)[0]):
            _draw_section(section, segment, styles, filled, own.start + 1)
    section.set(xlabel=names[0], ylabel=names[1], title="open: given; filled: best, with numbers of actuators")
    if not planar:
        section.set_aspect("equal", adjustable="datalim")
    section.margins(0.12)
    legend_below(section, 4, LEGEND)
    return figure


def _draw_errors(axes: Axes, before: TaskErrors, after: TaskErrors, what: str) -> None:
    """The errors of shape or tip of both designs on each task, or sorted of many.

    Tasks without a stable equilibrium are counted.
    """
    tasks = len(before.stable)
    for side, name, colour, dash, filled in (
        (before, "given", UNATTAINABLE, "--", False),
        (after, "best", ATTAINABLE, "-", True),
    ):
        stable = side.stable.numpy(force=True)
        lost = f", {tasks - stable.sum()} without a stable equilibrium" if not stable.all() else ""
        mean = side.tip_mm if what == "tip" else side.shape_mm()
        label = f"{name}: mean {three_digits(mean)} mm{lost}"
        error = _millimetres(side, what)
        if tasks <= FEW:
            axes.scatter(np.flatnonzero(stable) + 1, error[stable], 50, label=label, **mark_inks(colour, filled))
        else:
            values = np.sort(error[stable])
            axes.step(range(1, len(values) + 1), values, where="mid", color=colour, linestyle=dash, label=label)
    if tasks <= FEW:
        both = np.flatnonzero((before.stable & after.stable).numpy(force=True))
        old, new = (_millimetres(side, what)[both] for side in (before, after))
        axes.vlines(both + 1, old, new, color="#999999", linewidth=1, zorder=0)
        axes.set(xlim=(0.5, tasks + 0.5), xticks=range(1, tasks + 1))
    else:
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set(xlabel="task" if tasks <= FEW else "tasks, the nearest first", ylabel=f"predicted {what} error [mm]")
    axes.margins(y=0.12)
    axes.set_ylim(0, None)
    legend_below(axes, 2, LEGEND)


def _millimetres(side: TaskErrors, what: str) -> Any:
    return 1e3 * array(side.tip_error if what == "tip" else side.shape_error)


def _draw_section(
    axes: Axes, arm: ArmDesign, styles: Mapping[str, tuple[str, float]], filled: bool, first: int
) -> None:
    """Where the actuators of a segment sit; those of the best design with their numbers, from the first on."""
    names = list(map(model_name, arm.actuators))
    other = arm.length if arm.out_of_plane is None else arm.out_of_plane
    across, along = (1e3 * array(value) for value in (arm.radii, other))
    for kind, (colour, _) in styles.items():
        own = [place for place, name in enumerate(names) if name == kind]
        label = kind if filled and first == 1 else None  # once, whichever segment has any
        axes.scatter(across[own], along[own], s=80, label=label, **mark_inks(colour, filled))
    if filled:
        for index, place in enumerate(zip(across, along, strict=True)):
            shift: Any = {"xytext": (0, 7), "textcoords": "offset points", "ha": "center", "fontsize": 8}
            axes.annotate(str(first + index), place, **shift)
