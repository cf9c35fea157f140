"""Arms at their shapes, with the loads on them, in the plane and in space."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.attainability import Attainability
from torcharm.design.space import Arm
from torcharm.geometry import rod
from torcharm.load import GRAVITY, ExternalLoad
from torcharm.plot._common import (
    ATTAINABLE,
    LONGEST_ARROW,
    SMOOTHING,
    UNATTAINABLE,
    Array,
    array,
    axes_or_new,
    kind_of,
    legend_below,
    median_place,
    one_design,
    one_shape,
    projection_of,
    style_of,
)
from torcharm.statics.balance import segments_of
from torcharm.task import Task

AROUND = 12
"""Sides of a tube."""
SLIM = 0.35
"""A tube's radius over the least distance of two actuators, where no diameter is known."""
TIP_WANTED = "tip pose wanted"
LINK = "#555555"
"""Colour of rigid links and of the base."""


def arm_shape(arm: Arm, task: Task, *, reached: Tensor | None = None, ax: Axes | None = None) -> Axes:
    """One arm at a shape: base plate, each actuator where it lies, rigid links, and loads and weights as arrows.

    Actuators are lines in the plane, and tubes in space, where y points up.

    Args:
        arm: one design, or segments in series.
        task: one shape, under any number of loads.
        reached: (N, 3 or 6) twists of another shape, as of `found.prediction.twists`: the arm is drawn there, around a
            dashed centreline, and the task's is solid.
        ax: 2-D axes to draw in, of an arm in space 3-D ones; None makes some.

    Raises:
        ValueError: there are several designs or shapes, arm and task do not fit, or the axes are others.
    """
    task = one_shape(task)
    arm = one_design("arm", arm, task)
    if reached is not None and reached.numel() != task.twists.numel():
        shape = tuple(task.twists.shape)
        raise ValueError(f"reached: must have shape {shape}, as the task's twists, got {tuple(reached.shape)}")
    axes = axes_or_new(ax, projection_of(task))
    draw_arm(axes, arm, task, reached)
    legend_below(axes)
    return axes


@dataclass(frozen=True)
class Centreline:
    """Poses (P, 4, 4) along each segment, SMOOTHING to an element, and that of the tip."""

    segments: list[Array]
    tip: Array

    @property
    def points(self) -> Array:
        """(Q, 3) places from the base to the tip, links included."""
        return np.concatenate((*self.segments, self.tip[None]))[:, :3, 3]

    @property
    def gaps(self) -> list[Array]:
        """(2, 3) where what follows each segment begins and ends."""
        ends = [*(line[0] for line in self.segments[1:]), self.tip]
        return [np.stack((line[-1], end))[:, :3, 3] for line, end in zip(self.segments, ends, strict=True)]


def centreline(arm: Arm, twists: Tensor, task: Task) -> Centreline:
    """Where an arm's centreline lies at twists, from a task's base."""
    found, start = [], task.base_pose
    parts = twists.detach().to(start).split(task.segment_nodes or (task.nodes,))
    for own, link in zip(parts, segments_of(arm)[1], strict=True):
        poses = rod.poses(own.repeat_interleave(SMOOTHING, 0), start)
        found.append(in_space(array(poses)))
        group, start = rod.group_of(twists.shape[-1]), poses[-1]
        if link is not None:
            start = group.compose(start, link.end(arm.dimension).detach().reshape(start.shape).to(start))
    return Centreline(found, in_space(array(start)))


def in_space(poses: Array) -> Array:
    """Poses as homogeneous matrices (..., 4, 4), those of the plane (..., 3) at z = 0."""
    if poses.shape[-2:] == (4, 4):
        return poses
    x, y, heading = np.moveaxis(poses, -1, 0)
    none, one, cos, sin = 0 * x, 1 + 0 * x, np.cos(heading), np.sin(heading)
    rows = ((cos, -sin, none, x), (sin, cos, none, y), (none, none, one, none), (none, none, none, one))
    return np.stack([np.stack(row, -1) for row in rows], -2)


def seen(axes: Any, points: Array) -> tuple[Array, ...]:
    """Points or vectors (P, 3) of the world as axes take them: x and y, or of space x, z and, upwards, y."""
    x, y, z = np.moveaxis(points, -1, 0)
    return (x, z, y) if axes.name == "3d" else (x, y)


def draw_arm(axes: Any, arm: Arm, task: Task, reached: Tensor | None = None, scale: float = 0.0) -> None:
    """One arm at the shape of a task or at one that it reaches, with the loads on it.

    Args:
        axes: 2-D or, in space, 3-D ones.
        arm: one design.
        task: one shape under any number of loads.
        reached: twists; None draws the task's shape.
        scale: of arrows [N/m]; 0 takes that of `arrow_scale`.
    """
    wanted, segments = centreline(arm, task.twists, task), segments_of(arm)[0]
    at = wanted if reached is None else centreline(arm, reached.reshape(task.twists.shape), task)
    if axes.name == "3d":
        axes.computed_zorder = False  # else what lies within an arm would be hidden
    wide = max(float(np.linalg.norm(array(segment.offsets), axis=-1).max()) for segment in segments)
    draw_plate(axes, at.segments[0][0], 1.25 * max(wide, 0.01), "base")
    kinds = [kind_of(model) for model in arm.actuators]
    for segment, line in zip(segments, at.segments, strict=True):
        _draw_actuators(axes, segment, line, 0.8 if reached is None else 0.3)
    for kind in dict.fromkeys(kinds):
        colour, width = style_of(kind)
        axes.plot([], [], color=colour, linewidth=1.3 * width, label=f"{kind} ({kinds.count(kind)})")
    _draw_links(axes, arm, at)
    if reached is None:
        axes.plot(*seen(axes, at.points), color=ATTAINABLE, linewidth=1, linestyle="-.", zorder=4, label="centreline")
    else:
        _draw_line(axes, wanted.points, ATTAINABLE, "-", "full", ("task", "its tip"))
        off = f"tip reached, {1e3 * float(np.linalg.norm((wanted.tip - at.tip)[:3, 3])):.3g} mm off"
        _draw_line(axes, at.points, UNATTAINABLE, "--", "none", ("reached", off))
    ends = _draw_loads(axes, arm, task.load, at, scale or arrow_scale(arm, task))
    _limit(axes, np.concatenate((at.points, wanted.points, ends)))


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


def _draw_actuators(axes: Any, segment: ArmDesign, line: Array, alpha: float) -> None:
    """Every actuator of one segment, in the colour of its kind: a line in the plane, a tube in space."""
    offsets, turn = array(segment.offsets), np.linspace(0, 2 * np.pi, AROUND + 1)
    apart = [np.linalg.norm(a - b) for i, a in enumerate(offsets) for b in offsets[:i]]
    slim = SLIM * min([float(one) for one in apart if one > 0] or [0.03])
    radii = [slim] * len(offsets) if segment.diameter is None else (0.5 * array(segment.diameter)).tolist()
    for (y, z), model, radius in zip(offsets, segment.actuators, radii, strict=True):
        kind = kind_of(model)
        colour, width = style_of(kind)
        if axes.name == "3d":
            own = np.stack((0 * turn, y + radius * np.cos(turn), z + radius * np.sin(turn), 1 + 0 * turn))
            skin = np.moveaxis((line @ own)[:, :3], 1, -1)
            axes.plot_surface(*seen(axes, skin), color=colour, alpha=alpha, linewidth=0, shade=True)
        else:
            points = (line @ np.array((0.0, y, z, 1.0)))[:, :3]
            axes.plot(*seen(axes, points), color=colour, linewidth=width, solid_capstyle="butt", gid=kind)


def _draw_links(axes: Any, arm: Arm, at: Centreline) -> None:
    label: str | None = "rigid link"
    for link, gap in zip(segments_of(arm)[1], at.gaps, strict=True):
        if link is not None:
            axes.plot(*seen(axes, gap), color=LINK, linewidth=5, solid_capstyle="butt", label=label, gid="link")
            label = None


def _draw_loads(axes: Any, arm: Arm, load: ExternalLoad, at: Centreline, scale: float) -> Array:
    """Loads and weights as arrows, their sizes in the legend; returns where the arrows end (A, 3)."""
    ends = [at.points[-1:]]
    for name, place, force, moment in _loads(arm, load, at):
        size = np.linalg.norm(force, axis=-1)
        start = seen(axes, np.broadcast_to(place, force.shape))
        if axes.name == "3d":
            axes.quiver(*start, *seen(axes, force / scale), color=ATTAINABLE, arrow_length_ratio=0.2, zorder=4.5)
        else:
            how: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": scale, "zorder": 4.5}
            axes.quiver(*start, *seen(axes, force), color=ATTAINABLE, width=0.006 if len(size) == 1 else 0.003, **how)
        words = f"{name}," if len(size) == 1 else f"{len(size)} {name}s, up to"
        turn = np.linalg.norm(moment, axis=-1).max()
        words += f" {size.max():.3g} N" + (f", {turn:.3g} N·m" if turn > 0 else "")
        axes.plot([], [], color=ATTAINABLE, marker=">", label=words)
        ends.append(place + force / scale)
    return np.concatenate(ends)


def _loads(arm: Arm, load: ExternalLoad, at: Centreline) -> Any:
    """Of each load its name, its place (3,), and its forces and moments (L, 3) in the world frame."""
    if load.tip is not None and bool((load.tip != 0).any()):
        yield "tip load", at.tip[:3, 3], *_in_world(load.tip, np.eye(3))
    for point in load.points:
        line = at.segments[point.segment]
        pose = line[round(point.at * (len(line) - 1))]
        turn = pose[:3, :3] if point.frame == "body" else np.eye(3)
        mass = array(point.mass).reshape(-1, 1) * load.gravity
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
    rows = array(wrench).reshape(-1, wrench.shape[-1])
    if rows.shape[-1] == 3:
        rows = np.insert(rows, [2, 2, 2], 0.0, axis=-1)
    return rows[:, :3] @ turn.T, rows[:, 3:] @ turn.T


def arrow_scale(arm: Arm, task: Task) -> float:
    """By which the largest force of a task of one shape is an arrow of LONGEST_ARROW of its centreline [N/m]."""
    at = centreline(arm, task.twists, task)
    sizes = [float(np.linalg.norm(force, axis=-1).max()) for _, _, force, _ in _loads(arm, task.load, at)]
    reach = sum(float(np.linalg.norm(np.diff(line[:, :3, 3], axis=0), axis=-1).sum()) for line in at.segments)
    return (max(sizes, default=0.0) or 1.0) / (LONGEST_ARROW * reach)  # a moment alone has no length


def median_case(found: Attainability) -> tuple[int, Tensor | None]:
    """The task of the median of the errors over their tolerances, and where the arm is predicted to be under it."""
    over = found.over_tolerance
    index = None if over is None else median_place(array(over).ravel())
    if index is None or found.prediction is None:
        return 0, None
    twists = found.prediction.twists.detach()
    twists = twists.reshape(-1, *twists.shape[-2:])[index]
    return index, twists if bool(twists.isfinite().all()) else None


def draw_poses(axes: Any, base: Array, tip: Array, half: float) -> None:
    """Where an arm begins and is to end, by poses (4, 4)."""
    draw_plate(axes, base, half, "base")
    draw_plate(axes, tip, half, TIP_WANTED)
    _limit(axes, np.concatenate([pose[:3, 3] + half * np.array([[-1.0] * 3, [1.0] * 3]) for pose in (base, tip)]))


def _limit(axes: Any, points: Array) -> None:
    """One scale along all axes; of space, z towards the viewer."""
    if axes.name != "3d":
        axes.update_datalim(points[:, :2])
        axes.set(xlabel="x [m]", ylabel="y [m]")
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.08)
        axes.autoscale_view()
        return
    low, high = points.min(0) - 0.06, points.max(0) + 0.06
    axes.set(xlim=(low[0], high[0]), ylim=(high[2], low[2]), zlim=(low[1], high[1]))
    axes.set(xlabel="x [m]", ylabel="z [m]", zlabel="y [m]")
    spans: Sequence[float] = (high - low)[[0, 2, 1]]
    axes.set_box_aspect(spans, zoom=0.82)
    for axis, span in zip((axes.xaxis, axes.yaxis, axes.zaxis), spans, strict=True):
        # A short axis has no room for as many numbers as a long one, and its name lies beyond them.
        axis.set_major_locator(MaxNLocator(max(1, round(5 * span / max(spans)) - 1), steps=(1, 2, 5, 10)))
        axis.labelpad = 8
