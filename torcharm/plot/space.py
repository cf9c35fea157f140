"""Arms and attainable sets in space."""

from collections.abc import Sequence
from math import prod
from typing import Any

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]
from scipy.spatial import ConvexHull
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries
from torcharm.geometry import rod
from torcharm.load import GRAVITY, ExternalLoad
from torcharm.plot._common import (
    ARM_COLOURS,
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
    node_index,
    style_of,
    tip_errors,
)
from torcharm.plot.hulls import draw_required
from torcharm.pressure.search import PressureSearch
from torcharm.statics.external_load import HULL, task_wrench
from torcharm.task import Task
from torcharm.wrench_sets.design_task_grid import segments_of
from torcharm.wrench_sets.wrench_set import hull_faces, wrench_hulls

AROUND = 12
"""Sides of a tube."""
SLIM = 0.35
"""A tube's radius over the least distance of two actuators, where no diameter is known."""
HULL_LABELS = (r"force $f_x$ [N]", r"moment $m_y$ [N·m]", r"moment $m_z$ [N·m]")


def arm_in_space(
    arm: ArmDesign | ArmSeries,
    task: Task,
    *,
    reached: Tensor | None = None,
    ax: Axes | None = None,
) -> Axes:
    """One arm as tubes, at the task's shape or at one that it reaches, with its loads as arrows; y points up.

    Args:
        arm: one spatial design, or segments in series.
        task: one shape under one load.
        reached: (N, 6) twists of another shape, as of `found.prediction.twists`: the tubes are drawn there, around a
            dashed centreline, and the task's is solid.
        ax: 3-D axes to draw in; None makes some.

    Raises:
        ValueError: arm or task are planar or several, or the axes are not 3-D.
    """
    segments = _spatial("arm", arm)
    if task.dimension != 3 or prod(task.batch_shape) != 1:
        raise ValueError(f"task: must be one spatial task, got {task!r}")
    axes, counts = axes_or_new(ax, "3d"), task.segment_nodes or (task.nodes,)
    wanted = task.twists.detach().reshape(-1, 6)
    if reached is not None and reached.shape[-2:] != wanted.shape:
        raise ValueError(
            f"reached: must have shape {tuple(wanted.shape)}, as the task's twists, got {tuple(reached.shape)}"
        )
    shape = wanted if reached is None else reached.detach().reshape(-1, 6).to(wanted)
    lines, tip = _lines(arm, shape, task.base_pose, counts)
    axes.computed_zorder = False  # else what lies within an arm would be hidden
    _draw_base(axes, lines[0][0], max(float(segment.offsets.norm(dim=-1).max()) for segment in segments))
    for segment, line in zip(segments, lines, strict=True):
        _draw_tubes(axes, segment, line, 0.8 if reached is None else 0.3)
    whole = np.concatenate((*lines, tip[None]))
    ink, dashes, label = (ATTAINABLE, "-.", "centreline") if reached is None else (UNATTAINABLE, "--", "reached")
    axes.plot(*_upright(whole[:, :3, 3]), color=ink, linewidth=1.5, linestyle=dashes, zorder=4, label=label)
    drawn = [whole[:, :3, 3]]
    if reached is not None:
        goals, end = _lines(arm, wanted, task.base_pose, counts)
        goal = np.concatenate((*goals, end[None]))[:, :3, 3]
        axes.plot(*_upright(goal), color=ATTAINABLE, linewidth=2, zorder=3, label="task")
        axes.plot(*_upright(goal[-1:]), "o", color=ATTAINABLE, zorder=5, label="its tip")
        label = f"tip reached, {1e3 * float(np.linalg.norm(goal[-1] - whole[-1, :3, 3])):.1f} mm off"
        axes.plot(*_upright(whole[-1:, :3, 3]), "o", color=UNATTAINABLE, fillstyle="none", zorder=5, label=label)
        drawn.append(goal)
    drawn.append(_draw_forces(axes, task.load, lines, tip))
    _limit(axes, np.concatenate(drawn), 0.06)
    legend_below(axes, 0.0)
    return axes


def search_figure_in_space(
    results: Sequence[tuple[str, ArmDesign | ArmSeries, PressureSearch]], task_name: str, task: Task
) -> Figure:
    """Of each arm in space the shape reached under the load of median tip error; arguments as for `search_figure`."""
    figure = Figure(figsize=(max(9.0, 5.5 * len(results)), 6.5), layout="constrained")
    figure.suptitle(f"{task_name}: how near the best pressures bring the tip", fontweight="bold")
    for column, (name, arm, found) in enumerate(results, 1):
        axes: Any = figure.add_subplot(1, len(results), column, projection="3d")
        error = tip_errors(name, found.tip_error, prod(task.batch_shape))
        load = median_place(error)
        if load is None:
            axes.set_axis_off()
            axes.set_title(f"{name}: no equilibrium was found")
            continue
        reached = found.twists.detach().reshape(-1, *found.twists.shape[-2:])[load]
        arm_in_space(arm, one_task(task, load), reached=reached, ax=axes)
        axes.set_title(f"{name}, load {load + 1} of {len(error)}, of median error", fontsize="medium")
    return figure


def node_hull_in_space(
    arm: ArmDesign,
    task: Task,
    node: int | Tensor,
    *,
    relative: bool = False,
    ax: Axes | None = None,
    colour: str = ARM_COLOURS[0],
) -> Axes:
    """What one node can provide, as a body of wrenches `(f_x, m_y, m_z)`, and what each load requires, as points.

    Args:
        arm: one spatial design.
        task: one shape, with any number of loads.
        node: its index, from 0 at the base, such as `worst_node` of an evaluation; the title counts from 1.
        relative: differences from the first node, instead of wrenches.
        ax: 3-D axes to draw in; None makes some.
        colour: of the body.

    Raises:
        ValueError: arm or task are planar or several, the node is out of range, or the axes are not 3-D.
    """
    corners, required, outside = _hull_of(arm, task, node, relative)
    axes = axes_or_new(ax, "3d")
    faces = Poly3DCollection(corners[hull_faces(corners)], facecolor=colour, edgecolor=colour, linewidth=0.1, alpha=0.2)
    axes.add_collection3d(faces)
    draw_required(axes, required, ~outside)
    points = np.concatenate((corners, required))
    low, high = points.min(0), points.max(0)
    room = np.maximum(0.05 * (high - low), 1e-3)
    limits = [tuple(ends) for ends in np.stack((low - room, high + room), -1)]
    axes.set(xlim=limits[0], ylim=limits[1], zlim=limits[2])
    axes.set_box_aspect(None, zoom=0.82)
    axes.set(
        xlabel=HULL_LABELS[0],
        ylabel=HULL_LABELS[1],
        zlabel=HULL_LABELS[2],
        title=f"node {int(node) + 1} of {task.nodes}",
    )
    axes.legend(loc="upper left", fontsize="small")
    return axes


def hull_projections(
    arm: ArmDesign,
    task: Task,
    node: int | Tensor,
    *,
    relative: bool = False,
    axes: Sequence[Axes] | None = None,
    colour: str = ARM_COLOURS[0],
) -> Sequence[Axes]:
    """The body of `node_hull_in_space` and its requirements, seen along each of the three axes.

    A point within all three outlines may still be outside; its colour says so.

    Args:
        arm, task, node, relative, colour: as there.
        axes: three 2-D axes to draw in; None makes some.

    Raises:
        ValueError: as there, or there are not three axes.
    """
    if axes is None:
        from matplotlib import pyplot  # here alone: what pyplot makes, it also keeps

        axes = list(pyplot.subplots(1, 3, figsize=(13, 4), layout="constrained")[1])
    if len(axes) != 3:
        raise ValueError(f"axes: must be three, got {len(axes)}")
    corners, required, outside = _hull_of(arm, task, node, relative)
    for panel, (x, y) in zip(axes, ((0, 1), (0, 2), (1, 2)), strict=True):
        flat = corners[:, [x, y]]
        ring = flat[ConvexHull(flat).vertices] if np.linalg.matrix_rank(flat - flat[0]) == 2 else flat
        panel.fill(*ring.T, facecolor=colour, edgecolor=colour, alpha=0.25, label="pressures provide")
        draw_required(panel, required[:, [x, y]], ~outside)
        panel.set(xlabel=HULL_LABELS[x], ylabel=HULL_LABELS[y])
    axes[0].legend(loc="best", fontsize="small")
    return axes


def poses_in_space(axes: Any, base: Array, tip: Array, half: float) -> None:
    """Where an arm begins and is to end: plates across the backbone, that of the tip with the stem on which it sits.

    Args:
        axes: 3-D ones.
        base, tip: (4, 4) poses.
        half: radius of the plates [m].
    """
    _draw_base(axes, base, half / 1.25)
    draw_tip_pose(axes, tip, half)
    _limit(axes, np.stack((base[:3, 3], tip[:3, 3])), 0.06 + half)
    legend_below(axes, 0.0)


def draw_tip_pose(axes: Any, pose: Array, half: float) -> None:
    """The rim of a plate square to the heading of a pose (4, 4), and its stem."""
    turn = np.linspace(0, 2 * np.pi, 4 * AROUND)
    rim = np.stack((0 * turn, half * np.cos(turn), half * np.sin(turn), 1 + 0 * turn))
    stem = np.array([[0, 0, 0, 1], [-half, 0, 0, 1]]).T
    for points, label in ((rim, "tip pose wanted"), (stem, None)):
        axes.plot(*_upright((pose @ points)[:3].T), color=ATTAINABLE, linewidth=2, zorder=5, label=label)


def one_task(task: Task, index: int) -> Task:
    """One task of a batch that differs in shapes and tip loads, by its place in the flattened batch."""
    twists = task.twists.detach().expand(*task.batch_shape, *task.twists.shape[-2:]).flatten(0, -3)[index]
    tip = task.tip_load.detach().expand(*task.batch_shape, -1).reshape(-1, task.tip_load.shape[-1])[index]
    rest = task.load.with_tip(None)
    return Task(twists, tip, task.base_pose, rest, task.wrench_at, task.segment_nodes)


def _spatial(field: str, arm: ArmDesign | ArmSeries) -> tuple[ArmDesign, ...]:
    """The segments of one spatial design."""
    if arm.dimension != 3 or prod(arm.batch_shape) != 1:
        raise ValueError(f"{field}: must be one spatial design (offsets out of the plane, no batch), got {arm!r}")
    return tuple(segment._map(lambda value: value.detach().reshape(-1)) for segment in segments_of(arm))


def _lines(
    arm: ArmDesign | ArmSeries, twists: Tensor, base: Tensor, counts: Sequence[int]
) -> tuple[list[Array], Array]:
    """Poses (SMOOTHING·N + 1, 4, 4) along each segment, without links, and that of the tip."""
    links = list(arm.links) if isinstance(arm, ArmSeries) else [None]
    found, start = [], base
    for own, link in zip(twists.split(list(counts)), links, strict=True):
        line = rod.poses(own.repeat_interleave(SMOOTHING, 0), start)
        found.append(array(line))
        start = line[-1] if link is None else line[-1] @ link.end(3).reshape(4, 4).to(line)
    return found, array(start)


def _draw_base(axes: Any, pose: Array, size: float) -> None:
    """A plate across the backbone."""
    turn = np.linspace(0, 2 * np.pi, 4 * AROUND)
    rim = np.stack((0 * turn, 1.25 * size * np.cos(turn), 1.25 * size * np.sin(turn), 1 + 0 * turn))
    plate = np.stack(_upright((pose @ rim)[:3].T), -1)
    axes.add_collection3d(Poly3DCollection([plate], facecolor="0.4", alpha=0.6))


def _draw_tubes(axes: Any, segment: ArmDesign, line: Array, alpha: float) -> None:
    """Every actuator of one segment, in the colour of its kind."""
    offsets, turn = array(segment.offsets), np.linspace(0, 2 * np.pi, AROUND + 1)
    apart = [np.linalg.norm(a - b) for i, a in enumerate(offsets) for b in offsets[:i]]
    slim = SLIM * min([float(one) for one in apart if one > 0] or [0.03])
    radii = [slim] * len(offsets) if segment.diameter is None else (0.5 * array(segment.diameter)).tolist()
    kinds = [kind_of(model) for model in segment.actuators]
    named = {text.get_label() for text in axes.lines}
    for index, (kind, radius) in enumerate(zip(kinds, radii, strict=True)):
        (y, z), colour = offsets[index], style_of(kind)[0]
        own = np.stack((0 * turn, y + radius * np.cos(turn), z + radius * np.sin(turn), 1 + 0 * turn))
        skin = (line @ own)[:, :3]
        axes.plot_surface(*(skin[:, c] for c in (0, 2, 1)), color=colour, alpha=alpha, linewidth=0, shade=True)
        label = f"{kind} ({kinds.count(kind)})"
        if index == kinds.index(kind) and label not in named:
            axes.plot([], [], color=colour, linewidth=6, label=label)


def _draw_forces(axes: Any, load: ExternalLoad, lines: Sequence[Array], tip: Array) -> Array:
    """The force at the tip, and those of point loads and masses, as arrows of one scale; returns their ends (A, 3)."""
    places, forces, names = [], [], []
    if load.tip is not None and bool((load.tip[..., :3] != 0).any()):
        places, forces, names = [tip], [array(load.tip).reshape(-1)[:3]], ["tip load"]
    for point in load.points:
        line = lines[point.segment]
        pose = line[round(point.at * (len(line) - 1))]
        force = np.zeros(3) if point.wrench is None else array(point.wrench).reshape(-1)[:3]
        if point.frame == "body":
            force = pose[:3, :3] @ force
        if load.gravity:
            force = force - np.array([0.0, GRAVITY * float(point.mass.reshape(-1)[0]), 0.0])
        places, forces, names = [*places, pose], [*forces, force], [*names, "point load"]
    most = max((np.linalg.norm(force) for force in forces), default=0.0)
    if most == 0:
        return tip[None, :3, 3]
    reach = sum(float(np.linalg.norm(np.diff(line[:, :3, 3], axis=0), axis=-1).sum()) for line in lines)
    scale = LONGEST_ARROW * reach / most
    for pose, force, name in zip(places, forces, names, strict=True):
        at, way = _upright(pose[None, :3, 3]), _upright(scale * force[None])
        axes.quiver(*at, *way, color=ATTAINABLE, linewidth=1.8, arrow_length_ratio=0.2, zorder=4)
        axes.plot([], [], color=ATTAINABLE, marker=">", label=f"{name}, {np.linalg.norm(force):.3g} N")
    return np.stack([pose[:3, 3] + scale * force for pose, force in zip(places, forces, strict=True)])


def _upright(points: Array) -> tuple[Array, Array, Array]:
    """Points (P, 3) of the world in the order of the axes: x, z and, upwards, y."""
    return points[:, 0], points[:, 2], points[:, 1]


def _limit(axes: Any, points: Array, room: float) -> None:
    """The same scale along all axes, z towards the viewer."""
    low, high = points.min(0) - room, points.max(0) + room
    axes.set(xlim=(low[0], high[0]), ylim=(high[2], low[2]), zlim=(low[1], high[1]))
    axes.set(xlabel="x [m]", ylabel="z [m]", zlabel="y [m]")
    axes.set_box_aspect((high - low)[[0, 2, 1]], zoom=0.82)
    for axis, span in zip((axes.xaxis, axes.yaxis, axes.zaxis), (high - low)[[0, 2, 1]], strict=True):
        # A short axis has no room for as many numbers as a long one, and its name lies beyond them.
        axis.set_major_locator(MaxNLocator(max(1, round(5 * span / (high - low).max()) - 1), steps=(1, 2, 5, 10)))
        axis.labelpad = 8


@torch.no_grad()
def _hull_of(arm: ArmDesign, task: Task, node: int | Tensor, relative: bool) -> tuple[Array, Array, Any]:
    """Vertices (V, 3) of one node's set, required wrenches (L, 3), and which of these lie outside."""
    from torcharm.attainability import evaluate

    _spatial("arm", arm)
    if not isinstance(arm, ArmDesign):
        raise ValueError(f"arm: must be an ArmDesign, of one segment, got {arm!r}")
    if task.dimension != 3 or prod(task.twists.shape[:-2]) != 1:
        raise ValueError(f"task: must be spatial and hold one shape, got {task!r}")
    index, name = node_index(task, node), "relative" if relative else "absolute"
    distance = getattr(evaluate(arm, task, (name,)), f"{name}_per_node").reshape(-1, task.nodes)[:, index]
    corners = wrench_hulls(arm, task.twists.reshape(-1, 6), relative=relative).vertices.reshape(task.nodes, -1, 3)
    required = task_wrench(arm, task)[..., HULL[6]].reshape(-1, task.nodes, 3)
    if relative:
        required = required - required[:, :1]
    return array(corners[index]), array(required[:, index]), array(distance) > 0
