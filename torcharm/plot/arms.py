"""Arms at their shapes, with the loads on them, in the plane and in space."""

import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import FancyArrowPatch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, MaxNLocator
from mpl_toolkits.mplot3d import proj3d  # type: ignore[import-untyped]
from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]
from torch import Tensor

from torcharm.actuators import model_name
from torcharm.arm import ArmDesign
from torcharm.arm_series import segments_of, with_slices
from torcharm.attainability import Attainability
from torcharm.design.space import Arm
from torcharm.geometry import se3
from torcharm.inputs import three_digits
from torcharm.load import GRAVITY, ExternalLoad
from torcharm.plot._common import (
    ATTAINABLE,
    LONGEST_ARROW,
    UNATTAINABLE,
    Array,
    array,
    axes_or_new,
    kind_styles,
    legend_below,
    one_design,
    one_shape,
    projection_of,
)
from torcharm.plot._shapes import AROUND, Centreline, Shape, centreline, task_of, tubes, twists_of
from torcharm.task import Task

TIP_WANTED = "tip pose wanted"
PLATE = 0.04
"""Half the width, at least, of the plate that stands for a pose, and how long the stem is on which it sits [m]."""
NUMBERED = (0.35, 0.65)
"""Where along a segment the numbers of its first and its last actuator stand, as shares of its arc."""
NUMBER: dict[str, Any] = {"fontsize": 7, "ha": "center", "va": "center", "zorder": 6, "clip_on": True}
NUMBER["path_effects"] = [withStroke(linewidth=2, foreground="white")]
"""How they look."""
SEEN: dict[str, Any] = {
    "color": UNATTAINABLE,
    "fontsize": "small",
    "ha": "center",
    "va": "top",
    "zorder": 6,
    "bbox": {"facecolor": "white", "edgecolor": "none", "alpha": 0.8},
}
"""How words look that stand above a shape."""
WORDS = 0.4
"""Above a shape, as a share of its size, the room for words on why no arm is drawn at it."""
LEAST_SIDE = 0.5
"""Of the longest side of a box in space, the shortest that has room for its numbers."""
CORNER = 0.2
"""Of the depth of a box in space, the part that has no number: at the corner nearest to the viewer are those of x."""
LINK = "#555555"
"""Colour of rigid links and of the base."""


def arm_shape(arm: Arm, task: Task | Shape, *, reached: Shape | None = None, ax: Axes | None = None) -> Axes:
    """One arm at a shape: base plate, each actuator where it lies, rigid links, and loads and weights as arrows.

    Actuators are lines in the plane, and tubes in space, where y points up. Their numbers are those of tables and
    reasons: their places in the arm, from 1, passive ones included.

    Args:
        arm: one design, or segments in series.
        task: one shape, under any number of loads; or what `evaluate` found, which is drawn with the shape predicted;
            or what `solve_equilibrium`, `search_pressure` or `predict_error` found, or the twists (N, 3 or 6) of a
            shape. Of an equilibrium loads and base are known; the rest hangs without loads.
        reached: another shape, as twists or as what was found: the arm is drawn there, around a dashed centreline, and
            the task's is solid.
        ax: 2-D axes to draw in, of an arm in space 3-D ones; None makes some.

    Raises:
        ValueError: there are several designs or shapes, no shape was found, arm and task do not fit, or the axes are
            others.
    """
    if isinstance(task, Attainability) and reached is None:
        reached = task
    drawn = one_shape(task_of(arm, task))
    arm = one_design("arm", arm, drawn)
    twists = None if reached is None else twists_of("reached", reached)
    if twists is not None and twists.numel() != drawn.twists.numel():
        shape = tuple(drawn.twists.shape)
        raise ValueError(f"reached: must have shape {shape}, as the task's twists, got {tuple(twists.shape)}")
    axes = axes_or_new(ax, projection_of(drawn))
    draw_arm(axes, arm, drawn, twists)
    legend_below(axes)
    return axes


def seen(axes: Any, points: Array) -> tuple[Array, ...]:
    """Points or vectors (P, 3) of the world as axes take them: x and y, or of space x, z and, upwards, y."""
    x, y, z = np.moveaxis(points, -1, 0)
    return (x, z, y) if axes.name == "3d" else (x, y)


def draw_arm(axes: Any, arm: Arm, task: Task, reached: Tensor | None = None, scale: float = 0.0) -> None:
    """One arm at the shape of a task, or at twists that it reaches, with the loads on it.

    Axes are 2-D or, in space, 3-D; the task is of one shape, under any number of loads; a scale of arrows [N/m] of 0
    stands for that of `arrow_scale`.
    """
    wanted, segments = centreline(arm, task.twists, task), segments_of(arm)[0]
    at = wanted if reached is None else centreline(arm, reached.reshape(task.twists.shape), task)
    if axes.name == "3d":
        axes.computed_zorder = False  # else what lies within an arm would be hidden
    wide = max(float(np.linalg.norm(array(segment.offsets), axis=-1).max()) for segment in segments)
    half = 1.25 * max(wide, 0.01)
    draw_plate(axes, at.segments[0][0], half, "base")
    styles = kind_styles(arm.actuators)
    for (segment, own), line in zip(with_slices(segments), at.segments, strict=True):
        _draw_actuators(axes, segment, line, styles, 0.8 if reached is None else 0.3)
        _number_actuators(axes, segment, line, own.start + 1)
    kinds = list(map(model_name, arm.actuators))
    for kind, (colour, width) in styles.items():
        axes.plot([], [], color=colour, linewidth=1.3 * width, label=f"{kind} ({kinds.count(kind)})")
    _draw_links(axes, arm, at)
    if reached is None:
        axes.plot(*seen(axes, at.points), color=ATTAINABLE, linewidth=1, linestyle="-.", zorder=4, label="centreline")
    else:
        _draw_line(axes, wanted.points, ATTAINABLE, "-", "full", ("task", "its tip"))
        off = f"tip reached, {three_digits(1e3 * float(np.linalg.norm((wanted.tip - at.tip)[:3, 3])))} mm off"
        _draw_line(axes, at.points, UNATTAINABLE, "--", "none", ("reached", off))
    ends = _draw_loads(axes, arm, task.load, at, scale or arrow_scale(arm, task))
    _limit(axes, np.concatenate((at.points, wanted.points, ends)), half)


def draw_wanted(axes: Any, arm: Arm, task: Task, words: str) -> None:
    """The centreline of a task of one shape that no arm is drawn at, and why none is."""
    wanted = centreline(arm, task.twists, task)
    draw_plate(axes, wanted.segments[0][0], PLATE, "base")
    _draw_line(axes, wanted.points, ATTAINABLE, "-", "full", ("task", "its tip"))
    above = wanted.points.max(0) + WORDS * float(np.ptp(wanted.points, 0).max()) * np.array([0.0, 1.0, 0.0])
    _limit(axes, np.concatenate((wanted.points, above[None])), PLATE)
    place = axes.text2D if axes.name == "3d" else axes.text
    place(0.5, 0.97, textwrap.fill(words, 40), transform=axes.transAxes, **SEEN)


def _draw_line(axes: Any, points: Array, ink: str, dashes: str, fill: str, labels: tuple[str, str]) -> None:
    """A centreline and its tip."""
    axes.plot(*seen(axes, points), color=ink, linewidth=2, linestyle=dashes, zorder=4, label=labels[0], gid=labels[0])
    axes.plot(*seen(axes, points[-1:]), "o", color=ink, fillstyle=fill, zorder=5, label=labels[1])


def draw_plate(axes: Any, pose: Array, half: float, label: str) -> None:
    """A plate across the backbone at a pose (4, 4): the base's is filled, another has a stem on which it sits."""
    turn = np.linspace(0, 2 * np.pi, 4 * AROUND + 1)
    rim = (pose @ np.stack((0 * turn, half * np.cos(turn), half * np.sin(turn), 1 + 0 * turn)))[:3].T
    if label != "base":
        stem = pose[:3, 3] - np.outer((0.0, half), pose[:3, 0])
        for points, name in ((rim, label), (stem, None)):
            axes.plot(*seen(axes, points), color=ATTAINABLE, linewidth=2, zorder=5, label=name)
    elif axes.name == "3d":
        axes.add_collection3d(Poly3DCollection([np.stack(seen(axes, rim), -1)], facecolor=LINK, alpha=0.6))
    else:
        axes.plot(*seen(axes, rim[[0, len(rim) // 2]]), color=LINK, linewidth=7, solid_capstyle="butt", label=label)


def _draw_actuators(
    axes: Any, segment: ArmDesign, line: Array, styles: dict[str, tuple[str, float]], alpha: float
) -> None:
    """Every actuator of one segment, in the colour of its kind: a line in the plane, a tube in space."""
    kinds = list(map(model_name, segment.actuators))
    if axes.name == "3d":
        for skin, kind in zip(tubes(segment, line), kinds, strict=True):
            axes.plot_surface(*seen(axes, skin), color=styles[kind][0], alpha=alpha, linewidth=0, shade=True)
        return
    for (y, z), kind in zip(array(segment.offsets), kinds, strict=True):
        colour, width = styles[kind]
        points = (line @ np.array((0.0, y, z, 1.0)))[:, :3]
        axes.plot(*seen(axes, points), color=colour, linewidth=width, solid_capstyle="butt", gid=kind)


def _number_actuators(axes: Any, segment: ArmDesign, line: Array, first: int) -> None:
    """The number of each actuator of one segment on it, at a place of its own, so that neighbours' are apart."""
    offsets = array(segment.offsets)
    places = np.linspace(*NUMBERED, len(offsets)) if len(offsets) > 1 else [np.mean(NUMBERED)]
    for index, ((y, z), share) in enumerate(zip(offsets, places, strict=True)):
        point = (line[round(share * (len(line) - 1))] @ np.array((0.0, y, z, 1.0)))[None, :3]
        axes.text(*(float(part[0]) for part in seen(axes, point)), str(first + index), gid="number", **NUMBER)


def _draw_links(axes: Any, arm: Arm, at: Centreline) -> None:
    label: str | None = "rigid link"
    for link, gap in zip(segments_of(arm)[1], at.gaps, strict=True):
        if link is not None:
            axes.plot(*seen(axes, gap), color=LINK, linewidth=5, solid_capstyle="butt", label=label, gid="link")
            label = None


def _draw_loads(axes: Any, arm: Arm, load: ExternalLoad, at: Centreline, scale: float) -> Array:
    """Loads and weights as arrows, their sizes in the legend; returns where the arrows end (A, 3)."""
    ends = [at.points[-1:]]
    for name, place, force, moment in loads_on(arm, load, at):
        size = np.linalg.norm(force, axis=-1)
        start = seen(axes, np.broadcast_to(place, force.shape))
        if axes.name == "3d":
            for own in force[size > 0]:
                axes.add_artist(Arrow(np.stack(seen(axes, np.stack((place, place + own / scale))), -1)))
        else:
            how: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": scale, "zorder": 4.5}
            axes.quiver(*start, *seen(axes, force), color=ATTAINABLE, width=0.006 if len(size) == 1 else 0.003, **how)
        words = f"{name}," if len(size) == 1 else f"{len(size)} {name}s, up to"
        turn = np.linalg.norm(moment, axis=-1).max()
        words += f" {size.max():.3g} N" + (f", {turn:.3g} N·m" if turn > 0 else "")
        axes.plot([], [], color=ATTAINABLE, marker=">", label=words)
        ends.append(place + force / scale)
    return np.concatenate(ends)


def loads_on(arm: Arm, load: ExternalLoad, at: Centreline) -> Any:
    """Of each load its name, its place (3,), and its forces and moments (L, 3) in the world frame."""
    if load.tip is not None and bool((load.tip != 0).any()):
        yield "tip load", at.tip[:3, 3], *_in_world(load.tip, np.eye(3))
    for point in load.points:
        line = at.segments[point.segment]
        pose = line[round(point.at * (len(line) - 1))]
        turn = pose[:3, :3] if point.frame == "body" else np.eye(3)
        mass = array(point.mass).reshape(-1, 1) * load.gravity
        if point.wrench is None and not mass.any():
            continue
        force, moment = (np.zeros((1, 3)),) * 2 if point.wrench is None else _in_world(point.wrench, turn)
        force, moment = np.broadcast_arrays(force - mass * [0.0, GRAVITY, 0.0], moment)
        yield "payload" if point.wrench is None else "point load", pose[:3, 3], force, moment
    if load.gravity:
        segments, links = segments_of(arm)
        parts = [(float(array(one.mass)), line[:, :3, 3]) for one, line in zip(segments, at.segments, strict=True)]
        parts += [(float(array(link.mass)), gap) for link, gap in zip(links, at.gaps, strict=True) if link is not None]
        whole = sum(mass for mass, _ in parts)
        if whole > 0:
            middle = sum(mass * (line[1:] + line[:-1]).mean(0) / 2 for mass, line in parts) / whole
            yield "weight of the arm", middle, np.array([[0.0, -GRAVITY * whole, 0.0]]), np.zeros((1, 3))


def _in_world(wrench: Tensor, turn: Array) -> tuple[Array, Array]:
    """Forces and moments (L, 3) of wrenches of the plane or of space, whose frame is turned."""
    rows = array(wrench if wrench.shape[-1] == 6 else se3.vector_from_plane(wrench)).reshape(-1, 6)
    return rows[:, :3] @ turn.T, rows[:, 3:] @ turn.T


def arrow_scale(arm: Arm, task: Task) -> float:
    """By which the largest force of a task of one shape is an arrow of LONGEST_ARROW of its centreline [N/m]."""
    at = centreline(arm, task.twists, task)
    sizes = [float(np.linalg.norm(force, axis=-1).max()) for _, _, force, _ in loads_on(arm, task.load, at)]
    reach = sum(float(np.linalg.norm(np.diff(line[:, :3, 3], axis=0), axis=-1).sum()) for line in at.segments)
    return (max(sizes, default=0.0) or 1.0) / (LONGEST_ARROW * reach)  # a moment alone has no length


def draw_poses(axes: Any, base: Array, tip: Array, half: float) -> None:
    """Where an arm begins and is to end, by poses (4, 4)."""
    draw_plate(axes, base, half, "base")
    draw_plate(axes, tip, half, TIP_WANTED)
    _limit(axes, np.stack([pose[:3, 3] for pose in (base, tip)]), half)


class Arrow(FancyArrowPatch):
    """An arrow in space between two points (2, 3) of 3-D axes, whose head is as large however short it is."""

    def __init__(self, ends: Array) -> None:
        how: dict[str, Any] = {"arrowstyle": "-|>", "mutation_scale": 10, "shrinkA": 0, "shrinkB": 0, "linewidth": 1.5}
        super().__init__((0.0, 0.0), (1.0, 1.0), color=ATTAINABLE, zorder=4.5, **how)
        self.ends = ends

    def do_3d_projection(self, renderer: object = None) -> float:
        """Put it where its ends are seen; how deep the nearer is."""
        axes: Any = self.axes
        x, y, depth = proj3d.proj_transform(*self.ends.T, axes.M)
        self.set_positions((x[0], y[0]), (x[1], y[1]))
        return float(min(depth))


def _limit(axes: Any, points: Array, wide: float) -> None:
    """One scale along all axes, around points and, in space, what is so wide around them; z is towards the viewer."""
    if axes.name != "3d":
        axes.update_datalim(points[:, :2])
        axes.set(xlabel="x [m]", ylabel="y [m]")
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.08)
        axes.autoscale_view()
        return
    room = wide + 0.03 * float(np.ptp(points, 0).max())
    low, high = points.min(0) - room, points.max(0) + room
    lack = np.maximum(LEAST_SIDE * (high - low).max() - (high - low), 0.0) / 2
    low, high = low - lack, high + lack
    axes.set(xlim=(low[0], high[0]), ylim=(high[2], low[2]), zlim=(low[1], high[1]))
    axes.set(xlabel="x [m]", ylabel="z [m]", zlabel="y [m]")
    spans: Sequence[float] = (high - low)[[0, 2, 1]]
    axes.set_box_aspect(spans, zoom=0.82)
    for axis, span in zip((axes.xaxis, axes.yaxis, axes.zaxis), spans, strict=True):
        # A short axis has no room for as many numbers as a long one, and its name lies beyond them.
        axis.set_major_locator(MaxNLocator(max(1, round(5 * span / max(spans)) - 1), steps=(1, 2, 5, 10)))
        axis.labelpad = 12 if axis is axes.zaxis else 8  # its numbers lie beside each other
    end = high[2] - CORNER * (high[2] - low[2])
    axes.yaxis.set_major_formatter(FuncFormatter(lambda depth, _: f"{depth:g}" if depth < end else ""))
    axes.tick_params(labelsize="small")
