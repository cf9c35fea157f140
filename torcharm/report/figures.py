"""The report's figures: small ones beside each other, a design in each, alike in their scales."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from torcharm.attainability.verdict import over_tolerance
from torcharm.plot import ARM_COLOURS
from torcharm.plot._common import array, merged_legend, projection_of, same_limits, worst_node
from torcharm.plot.histograms import draw_tip_errors, tip_error_edges
from torcharm.plot.hulls import SIDES, draw_node, make_scene
from torcharm.plot.median_case import draw_median_case, is_lost, median_shape
from torcharm.plot.study import limit_views
from torcharm.report.content import Evaluated, Panel
from torcharm.report.svg import inline_svg
from torcharm.study import StudyResult

PANEL = 3.7
"""Width of a figure [inch]: three of them stand beside each other on a page of paper laid wide."""
IN_SPACE = 4.8
"""Width of one with axes in space, whose numbers need more room; it is shown as wide as the others."""
WIDE = 9.5
"""Width of one that stands alone."""
LEGEND = 7.5
"""Size of its text [pt]: two entries beside each other."""
MISSED_BY = ("the tip's place", "the tip's turn", "the shape")
"""The errors that verdicts are by, in their order."""


def new_axes(height: float, projection: str = "rectilinear") -> Any:
    """Axes in a figure of their own, whose height is given over its width."""
    width = IN_SPACE if projection == "3d" else PANEL
    axes: Any = Figure(figsize=(width, height * width), layout="constrained").add_subplot(projection=projection)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis) if projection == "3d" else ():
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))  # a grey that would be in the way in the dark
    return axes


def to_panel(figure: Any, result: StudyResult, evaluated: Evaluated, what: str, caption: str) -> Panel:
    """A finished figure of one design on one task; what it shows is one word."""
    places = evaluated.study.arms.index(result.arm), evaluated.study.tasks.index(result.task)
    name, words = f"{what}-{places[0]}-{places[1]}", f"{what}: {result.arm.name}, {result.task.name}"
    return Panel(result.arm.name, caption, inline_svg(figure, name, words))


def arm_panels(results: Sequence[StudyResult], evaluated: Evaluated) -> Iterator[Panel]:
    """Each design on one task, under its load of the median error, where it is predicted to be; in the plane alike."""
    drawn: list[tuple[StudyResult, Any, int | None]] = []
    for result in results:
        task = result.task.task
        axes = new_axes(1.15, projection_of(task))
        shown = draw_median_case(axes, result.arm.design, result.attainability)
        put_legend_below(axes)
        drawn.append((result, axes, shown))
    if results[0].task.task.dimension == 2:
        for _, axes, _ in drawn:
            axes.set_aspect("equal", adjustable="box")
        same_limits([axes for _, axes, _ in drawn])
    for result, axes, shown in drawn:
        caption = f"under load {shown + 1} of {result.loads}" if shown is not None and result.loads > 1 else ""
        yield to_panel(axes.figure, result, evaluated, "arm", caption)


def error_panels(results: Sequence[StudyResult], evaluated: Evaluated) -> Iterator[Panel]:
    """How far off each design's tip is over the loads of one task, over the same bins."""
    errors = [(one, one.attainability.tip_error) for one in results]
    known = [one for one, error in errors if error is not None and bool(error.isfinite().any())]
    edges = tip_error_edges([one.attainability for one in known]) if known else None
    drawn = []
    for result in known:
        axes = new_axes(0.85)
        assert edges is not None
        drawn.append((result, axes, draw_tip_errors(axes, result.attainability, edges)))
        put_legend_below(axes)
    highest = max((axes.get_ylim()[1] for _, axes, _ in drawn), default=1.0)
    for result, axes, lost in drawn:
        axes.set_ylim(0, highest)
        said = [f"without a number, as no shape was found: {lost} of {result.loads}"] if lost else []
        yield to_panel(axes.figure, result, evaluated, "errors", "; ".join((*_missed_by(result), *said)))


def _missed_by(result: StudyResult) -> Iterator[str]:
    """By which error, the largest over its tolerance, loads are missed; of several, counted."""
    found, words = result.attainability, np.asarray(result.verdicts)
    assert found.prediction is not None
    over = array(over_tolerance(result.arm.design, found.prediction, found.tolerance)).reshape(len(MISSED_BY), -1)
    worst = over[:, words == "missed"].argmax(0).tolist()
    if worst:
        counts = [(name, f" {worst.count(i)}") for i, name in enumerate(MISSED_BY) if i in worst]
        yield f"missed by {', '.join(name + count * (result.loads > 1) for name, count in counts)}"


def hull_panels(results: Sequence[StudyResult], evaluated: Evaluated) -> Iterator[Panel]:
    """What pressures provide and the loads require at the node that lacks most on average, or has the least margin."""
    drawn, views, scenes = [], list[tuple[Axes, tuple[int, int]]](), []
    for result in results:
        task, found = result.task.task, result.attainability
        if is_lost(found) or found.node_miss is None:
            continue
        relative, node = found.absolute is None, worst_node(found)
        scene = make_scene(result.arm.design, median_shape(found), relative)
        if task.dimension == 2:
            panels = [new_axes(1.0)]
        else:
            panels = list(Figure(figsize=(WIDE, PANEL), layout="constrained").subplots(1, len(SIDES)))
        colour = ARM_COLOURS[evaluated.study.arms.index(result.arm) % len(ARM_COLOURS)]
        for axes, pair in zip(panels, SIDES, strict=False):
            draw_node(axes, scene, node, pair, colour)
            views.append((axes, pair))
        scenes.append(scene)
        drawn.append((result, panels, node, scene.inside[:, node]))
    if views:
        limit_views(views, scenes)
    for result, panels, node, inside in drawn:
        put_legend_below(panels[0], ncols=1 if len(panels) == 1 else 3)
        caption = f"node {node + 1} of {result.task.task.nodes}: {inside.sum()} of {len(inside)} loads inside"
        yield to_panel(panels[0].figure, result, evaluated, "hull", caption)


def put_legend_below(axes: Any, ncols: int = 2) -> None:
    """The legend of axes below their figure, in place of one that they may have."""
    if axes.get_legend() is not None:
        axes.get_legend().remove()
    merged_legend(axes.figure, [axes], loc="outside lower center", fontsize=LEGEND, ncols=ncols)
