"""Attainable sets, and what loads require."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.attainability import evaluate
from torcharm.plot._common import (
    ARM_COLOURS,
    ATTAINABLE,
    UNATTAINABLE,
    Array,
    Mask,
    array,
    axes_or_new,
    choose,
    node_index,
    one_design,
    one_shape,
)
from torcharm.statics.external_load import HULL, required_wrench
from torcharm.task import Task
from torcharm.wrench_sets.wrench_set import wrench_hulls


def hulls_along_arm(
    arm: ArmDesign,
    task: Task,
    *,
    relative: bool = False,
    hull: str = "exact",
    samples: int | None = None,
    loads: Sequence[int] | None = None,
    ax: Axes | None = None,
    colour: str = ARM_COLOURS[0],
) -> Axes:
    """What every node can provide, as polygons along the arm, and what the loads require, as lines through them.

    Args:
        arm: one design.
        task: one shape, with any number of loads.
        relative: differences from node 1, instead of wrenches.
        hull, samples: as for `evaluate`, errors included.
        loads: which of the task's loads to draw, counted from 0; None draws all.
        ax: 3-D axes to draw in; None makes some.
        colour: of the polygons.

    Raises:
        ValueError: there are several designs or shapes, a load is out of range, or the axes are not 3-D.
    """
    scene = make_scene(one_design("arm", arm), choose(one_shape(task), loads), relative, hull, samples)
    axes = axes_or_new(ax, "3d")
    draw_hulls(axes, scene, scene.inside.all(-1), colour)
    limit_axes(axes, [scene])
    return axes


def node_hull(
    arm: ArmDesign,
    task: Task,
    node: int | Tensor,
    *,
    relative: bool = False,
    hull: str = "exact",
    samples: int | None = None,
    ax: Axes | None = None,
    colour: str = ARM_COLOURS[0],
) -> Axes:
    """What one node can provide, as a polygon, and what each load requires of it, as a point.

    Args:
        arm, task, relative, hull, samples, colour: as for `hulls_along_arm`.
        node: its index, from 0 at the base, such as `worst_node` of an evaluation; the title counts from 1.
        ax: 2-D axes to draw in; None makes some.

    Raises:
        ValueError: the node is out of range, the axes are not 2-D, or as for `hulls_along_arm`.
    """
    index = node_index(task, node)
    scene = make_scene(one_design("arm", arm), one_shape(task), relative, hull, samples)
    axes = axes_or_new(ax)
    draw_node(axes, scene, index, colour)
    axes.set_title(f"node {index + 1} of {task.nodes}")
    axes.legend(loc="best")
    return axes


@dataclass(frozen=True)
class Scene:
    """Planar wrenches `(f_x, m)` [N, N·m] of one arm at one shape."""

    hulls: Array  # (N, V + 1, 2) closed rings: what each node can provide
    required: Array  # (L, N, 2) what each load requires
    inside: Mask  # (L, N) whether the one holds the other
    labels: tuple[str, str]


@torch.no_grad()
def make_scene(arm: ArmDesign, task: Task, relative: bool, hull: str, samples: int | None) -> Scene:
    """What a picture of hulls shows."""
    metric = "relative" if relative else "absolute"
    distance = getattr(evaluate(arm, task, (metric,), hull=hull, samples=samples), f"{metric}_per_node")
    vertices = wrench_hulls(arm, task.twists, relative=relative, hull=hull, samples=samples).vertices
    required = required_wrench(task.twists, task.tip_load, task.base_pose, wrench_at=task.wrench_at)[..., HULL[3]]
    labels = (r"force $f_x$ [N]", r"moment $m$ [N·m]")
    if relative:
        required = required - required[..., :1, :]
        labels = (r"force $f_x - f_{x,1}$ [N]", r"moment $m - m_1$ [N·m]")
    closed = torch.cat((vertices, vertices[:, :1]), 1)
    return Scene(array(closed), array(required), array(distance) <= 0, labels)


def draw_node(axes: Axes, scene: Scene, index: int, colour: str) -> None:
    """The set of one node, counted from 0, and what the loads require of it."""
    ring, point, inside = scene.hulls[index], scene.required[:, index], scene.inside[:, index]
    axes.fill(*ring.T, facecolor=colour, alpha=0.25, label="pressures provide")
    axes.plot(*ring.T, color=colour, marker=".", markersize=3)
    draw_required(axes, point, inside)
    axes.set(xlabel=scene.labels[0], ylabel=scene.labels[1])


def draw_required(axes: Axes, points: Array, inside: Mask) -> None:
    """Wrenches (L, 2 or 3) that loads require, as dots inside a set and as crosses outside, counted."""
    for kept, name, ink, marker in ((inside, "inside", ATTAINABLE, "o"), (~inside, "outside", UNATTAINABLE, "x")):
        label = f"required, {name}: {kept.sum()} of {len(kept)}"
        axes.plot(*points[kept].T, color=ink, marker=marker, markersize=4, linestyle="", label=label)


def limit_node_axes(panels: Sequence[Axes], scenes: Sequence[Scene]) -> None:
    """The same limits for all panels, around the sets and most of what is required: some loads ask for far more."""
    sets = np.concatenate([scene.hulls.reshape(-1, 2) for scene in scenes])
    required = np.concatenate([scene.required.reshape(-1, 2) for scene in scenes])
    ends = np.stack([*np.percentile(required, (2, 98), 0), sets.min(0), sets.max(0)])
    room = np.maximum(0.06 * np.ptp(ends, 0), 1e-3)
    force, moment = np.stack((ends.min(0) - room, ends.max(0) + room)).T
    for panel in panels:
        panel.set(xlim=tuple(force), ylim=tuple(moment))


def draw_hulls(axes: Any, scene: Scene, attainable: Mask, colour: str) -> None:
    """Hulls along the arm, and the sequences that loads require."""
    nodes = np.arange(1.0, len(scene.hulls) + 1)
    for node, ring in zip(nodes, scene.hulls, strict=True):
        corners = np.insert(ring, 0, node, axis=1)
        axes.add_collection3d(Poly3DCollection([corners], facecolor=colour, edgecolor="none", alpha=0.15))
        # the outline is all there is to see of a hull without area
        axes.plot(*corners.T, color=colour, linewidth=0.9, marker=".", markersize=1.5, gid=f"hull {node:.0f}")
    # All sequences (L, N) are one line of points (i, f_x, m), broken by NaNs: one artist, however many loads.
    index = np.broadcast_to(nodes[:, None], (*scene.required.shape[:-1], 1))
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


def limit_axes(axes: Any, scenes: Sequence[Scene]) -> None:
    """View and limits around all that is drawn; matplotlib's own limits do not see polygons in space."""
    points = np.concatenate([part.reshape(-1, 2) for scene in scenes for part in (scene.hulls, scene.required)])
    room = np.where(np.ptp(points, 0) > 0, 0.04 * np.ptp(points, 0), 1.0)
    force, moment = np.stack((points.min(0) - room, points.max(0) + room)).T
    axes.set(xlim=(0.5, len(scenes[0].hulls) + 0.5), ylim=force, zlim=moment)
    for axis, ticks in ((axes.xaxis, 10), (axes.yaxis, 4), (axes.zaxis, 6)):
        axis.set_major_locator(MaxNLocator(ticks, integer=axis is axes.xaxis))
    axes.set_box_aspect((1.5, 1.0, 1.0), zoom=0.95)
    axes.view_init(elev=20, azim=-55)
