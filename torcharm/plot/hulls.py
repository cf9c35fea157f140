"""Attainable sets, and what loads require, in the plane and in space."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]
from scipy.spatial import ConvexHull
from torch import Tensor

from torcharm.attainability import evaluate
from torcharm.design.space import Arm
from torcharm.plot._common import (
    ARM_COLOURS,
    ATTAINABLE,
    UNATTAINABLE,
    Array,
    Mask,
    array,
    axes_or_new,
    limits_around,
    node_index,
    one_design,
    one_shape,
    projection_of,
)
from torcharm.statics.external_load import HULL, task_wrench
from torcharm.task import Task
from torcharm.wrench_sets.wrench_set import hull_faces, wrench_hulls

LABELS = {
    (2, False): (r"force $f_x$ [N]", r"moment $m$ [N·m]"),
    (2, True): (r"force $f_x - f_{x,1}$ [N]", r"moment $m - m_1$ [N·m]"),
    (3, False): (r"force $f_x$ [N]", r"moment $m_y$ [N·m]", r"moment $m_z$ [N·m]"),
    (3, True): (r"force $f_x - f_{x,1}$ [N]", r"moment $m_y - m_{y,1}$ [N·m]", r"moment $m_z - m_{z,1}$ [N·m]"),
}
"""Of the axes, by the dimension and whether differences from the first node are meant."""
SIDES = ((0, 1), (0, 2), (1, 2))
"""Of the components of wrenches in space, the pairs that projections show."""


def hulls_along_arm(
    arm: Arm,
    task: Task,
    *,
    relative: bool = False,
    loads: Sequence[int] | None = None,
    ax: Axes | None = None,
    colour: str = ARM_COLOURS[0],
) -> Axes:
    """What every node can provide, as polygons along the arm, and what the loads require, as lines through them.

    Args:
        arm: one planar design, or segments in series.
        task: one shape, with any number of loads.
        relative: differences from the first node of the segment, instead of wrenches.
        loads: which of the task's loads to draw, counted from 0; None draws all.
        ax: 3-D axes to draw in; None makes some.
        colour: of the polygons.

    Raises:
        ValueError: arm or task are several or in space, a load is out of range, or the axes are not 3-D.
    """
    if task.dimension != 2:
        raise ValueError(f"task: must be planar, twists (..., N, 3), got {tuple(task.twists.shape)}")
    scene = make_scene(arm, one_shape(task, loads), relative)
    axes = axes_or_new(ax, "3d")
    _draw_hulls(axes, scene, colour)
    points = np.concatenate((scene.corners.reshape(-1, 2), scene.required.reshape(-1, 2)))
    force, moment = limits_around(points, 0.04)
    axes.set(xlim=(0.5, len(scene.corners) + 0.5), ylim=force, zlim=moment)  # matplotlib's own do not see polygons
    for axis, ticks in ((axes.xaxis, 10), (axes.yaxis, 4), (axes.zaxis, 6)):
        axis.set_major_locator(MaxNLocator(ticks, integer=axis is axes.xaxis))
    axes.set_box_aspect((1.5, 1.0, 1.0), zoom=0.95)
    axes.view_init(elev=20, azim=-55)
    return axes


def node_hull(
    arm: Arm,
    task: Task,
    node: int | Tensor,
    *,
    relative: bool = False,
    ax: Axes | None = None,
    colour: str = ARM_COLOURS[0],
) -> Axes:
    """What one node can provide, as a polygon or, in space, a body, and what each load requires of it, as a point.

    Args:
        arm: one design, or segments in series.
        task: one shape, with any number of loads.
        node: its index, from 0 at the base, such as `worst_node` of an evaluation; the title counts from 1.
        relative: differences from the first node of the segment, instead of wrenches.
        ax: 2-D axes to draw in, of an arm in space 3-D ones; None makes some.
        colour: of the set.

    Raises:
        ValueError: arm or task are several, the node is out of range, or the axes are others.
    """
    index, scene = node_index(task, node), make_scene(arm, one_shape(task), relative)
    axes = axes_or_new(ax, projection_of(task))
    corners, points = scene.corners[index], scene.required[:, index]
    if task.dimension == 2:
        draw_node(axes, scene, index, (0, 1), colour)
    else:
        sides = {"facecolor": colour, "edgecolor": colour, "linewidth": 0.1, "alpha": 0.2}
        axes.add_collection3d(Poly3DCollection(corners[hull_faces(corners)], **sides))
        axes.plot(*corners.T, ".", color=colour, markersize=1.5, label="pressures provide")  # all of a flat set
        _draw_required(axes, points, scene.inside[:, index])
        limits = limits_around(np.concatenate((corners, points)), 0.05)
        for side, ends, label in zip("xyz", limits, scene.labels, strict=True):
            axes.set(**{f"{side}lim": ends, f"{side}label": label})
        axes.set_box_aspect(None, zoom=0.82)
    axes.set_title(f"node {index + 1} of {task.nodes}")
    axes.legend(loc="best" if task.dimension == 2 else "upper left", fontsize="small")
    return axes


def hull_projections(
    arm: Arm,
    task: Task,
    node: int | Tensor,
    *,
    relative: bool = False,
    axes: Sequence[Axes] | None = None,
    colour: str = ARM_COLOURS[0],
) -> Sequence[Axes]:
    """The body of `node_hull` in space and its requirements, seen along each of the three axes.

    A point within all three outlines may still be outside; its colour says so.

    Args:
        arm, task, node, relative, colour: as there, in space.
        axes: three 2-D axes to draw in; None makes some.

    Raises:
        ValueError: as there, the task is planar, or there are not three axes.
    """
    if task.dimension != 3:
        raise ValueError(f"task: must be in space, twists (..., N, 6), got {tuple(task.twists.shape)}")
    if axes is None:
        from matplotlib import pyplot  # here alone: what pyplot makes, it also keeps

        axes = list(pyplot.subplots(1, 3, figsize=(13, 4), layout="constrained")[1])
    if len(axes) != 3:
        raise ValueError(f"axes: must be three, got {len(axes)}")
    index, scene = node_index(task, node), make_scene(arm, one_shape(task), relative)
    for panel, sides in zip(axes, SIDES, strict=True):
        draw_node(panel, scene, index, sides, colour)
    axes[0].legend(loc="best", fontsize="small")
    return axes


@dataclass(frozen=True)
class Scene:
    """Hull wrenches of one arm at one shape, of D components: `(f_x, m)`, or `(f_x, m_y, m_z)` in space [N, N·m].

    Attributes:
        corners: (N, V, D) of what each node can provide; in the plane in order.
        required: (L, N, D) what each load requires.
        inside: (L, N) whether the one holds the other.
        labels: of the components.
    """

    corners: Array
    required: Array
    inside: Mask
    labels: tuple[str, ...]


@torch.no_grad()
def make_scene(arm: Arm, task: Task, relative: bool = False) -> Scene:
    """What pictures of hulls show of one arm on a task of one shape."""
    arm, metric = one_design("arm", arm, task), "relative" if relative else "absolute"
    distance = getattr(evaluate(arm, task, (metric,)), f"{metric}_per_node")
    corners = wrench_hulls(arm, task.twists, relative=relative, segment_nodes=task.segment_nodes).vertices
    required = task_wrench(arm, task)[..., HULL[task.twists.shape[-1]]].reshape(-1, task.nodes, task.dimension)
    if relative:
        parts = required.split(task.nodes_of_segments, 1)
        required = torch.cat([part - part[:, :1] for part in parts], 1)
    inside = array(distance).reshape(-1, task.nodes) <= 0
    return Scene(array(corners), array(required), inside, LABELS[task.dimension, relative])


def draw_node(axes: Axes, scene: Scene, index: int, sides: tuple[int, int], colour: str) -> None:
    """The set of one node, counted from 0, and what the loads require of it, by two components."""
    corners = scene.corners[index][:, sides]
    if len(scene.labels) == 3:
        flat = np.linalg.matrix_rank(corners - corners[0]) < 2
        corners = corners if flat else corners[ConvexHull(corners).vertices]
    ring = np.concatenate((corners, corners[:1]))
    axes.fill(*ring.T, facecolor=colour, alpha=0.25, label="pressures provide")
    axes.plot(*ring.T, color=colour, marker=".", markersize=3)
    _draw_required(axes, scene.required[:, index][:, sides], scene.inside[:, index])
    axes.set(xlabel=scene.labels[sides[0]], ylabel=scene.labels[sides[1]])


def _draw_required(axes: Axes, points: Array, inside: Mask) -> None:
    """Wrenches (L, 2 or 3) that loads require, as dots inside a set and as crosses outside, counted."""
    for kept, name, ink, marker in ((inside, "inside", ATTAINABLE, "o"), (~inside, "outside", UNATTAINABLE, "x")):
        label = f"required, {name}: {kept.sum()} of {len(kept)}"
        axes.plot(*points[kept].T, color=ink, marker=marker, markersize=4, linestyle="", label=label)


def _draw_hulls(axes: Any, scene: Scene, colour: str) -> None:
    """Hulls along the arm, and the sequences that loads require."""
    nodes = np.arange(1.0, len(scene.corners) + 1)
    for node, corners in zip(nodes, scene.corners, strict=True):
        ring = np.insert(np.concatenate((corners, corners[:1])), 0, node, axis=1)
        axes.add_collection3d(Poly3DCollection([ring], facecolor=colour, edgecolor="none", alpha=0.15))
        # the outline is all there is to see of a hull without area
        axes.plot(*ring.T, color=colour, linewidth=0.9, marker=".", markersize=1.5, gid=f"hull {node:.0f}")
    # All sequences (L, N) are one line of points (i, f_x, m), broken by NaNs: one artist, however many loads.
    index, attainable = np.broadcast_to(nodes[:, None], (*scene.required.shape[:-1], 1)), scene.inside.all(-1)
    points = np.concatenate((index, scene.required), -1)
    broken = np.pad(points, ((0, 0), (0, 1), (0, 0)), constant_values=np.nan)
    keys = [Patch(facecolor=colour, alpha=0.4, label="pressures provide")]
    for chosen, name, ink, dashes, width in (
        (~attainable, "not attainable", UNATTAINABLE, (0, (4, 2)), 0.6),
        (attainable, "attainable", ATTAINABLE, "-", 0.9),
    ):
        label, path = f"required, {name}: {chosen.sum()} of {len(chosen)}", broken[chosen].reshape(-1, 3)
        keys += axes.plot(*path.T, color=ink, linestyle=dashes, linewidth=width, label=label, gid=name)
    dots, label = points[scene.inside].T, "required, inside at that node"
    keys += axes.plot(*dots, ".", color=ATTAINABLE, markersize=3, label=label, gid="inside")
    axes.set(xlabel="node i (base to tip)", ylabel=scene.labels[0], zlabel=scene.labels[1])
    axes.legend(handles=keys, loc="lower center", bbox_to_anchor=(0.5, 0.97), ncols=2, fontsize="small", frameon=False)
