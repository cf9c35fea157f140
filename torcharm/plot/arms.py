"""Arms at their shapes, with the loads on them."""

from math import prod

import numpy as np
import torch
from jaxtyping import Float
from matplotlib.axes import Axes
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.geometry import se2
from torcharm.inputs import TensorLike
from torcharm.plot._common import (
    ATTAINABLE,
    LONGEST_ARROW,
    UNATTAINABLE,
    Mask,
    array,
    axes_or_new,
    fine_poses,
    first_shape,
    kind_of,
    legend_below,
    one_design,
    one_shape,
    style_of,
)
from torcharm.task import Task


def arm_shape(
    arm: ArmDesign,
    twists: Float[Tensor, "*batch N 3"],
    *,
    tip_load: TensorLike | None = None,
    base_pose: TensorLike | str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """One arm at one shape: base plate, centreline, each actuator where it lies, and the load on the tip.

    Args:
        arm: one design.
        twists: (N, 3) one shape [m, m, rad].
        tip_load: (3,) `(f_x, f_y, m)` in the world frame [N, N, N·m]; its force is an arrow, its size in the legend.
        base_pose: of node 1, as of `Task`.
        ax: 2-D axes to draw in; None makes some.

    Raises:
        ValueError: there are several designs, shapes or loads, or the axes are not 2-D.
    """
    arm, task = one_design("arm", arm), Task(twists, (0.0, 0.0, 0.0) if tip_load is None else tip_load, base_pose)
    for name, value, dims in (("twists", task.twists, 2), ("tip_load", task.tip_load, 1)):
        if prod(value.shape[:-dims]) != 1:
            raise ValueError(f"{name}: must hold one, of shape {tuple(value.shape[-dims:])}, got {tuple(value.shape)}")
    task, axes = first_shape(task)[0], axes_or_new(ax)
    draw_arm(axes, arm, task)
    draw_loads(axes, task, np.full(1, tip_load is not None), ATTAINABLE, width=0.008)
    legend_below(axes, -0.12)
    return axes


def task_shape(task: Task, *, ax: Axes | None = None) -> Axes:
    """One shape's centreline, and the forces of all loads on its tip as arrows.

    Args:
        task: one shape, with any number of loads.
        ax: 2-D axes to draw in; None makes some.

    Raises:
        ValueError: the task holds several shapes or nothing, or the axes are not 2-D.
    """
    task, axes = one_shape(task), axes_or_new(ax)
    line = fine_poses(task)[:, :2]
    axes.plot(*line.T, color="black", linewidth=3, marker="s", markevery=[0], markersize=10, label="centreline, base")
    draw_loads(axes, task, np.ones(len(task.tip_load), bool), "#E69F00", width=0.003)
    legend_below(axes, -0.12)
    return axes


def draw_arm(axes: Axes, arm: ArmDesign, task: Task, *, reached: bool = False) -> None:
    """Base plate, actuators and centreline, at a task's shape or at one that is reached."""
    line, radii = fine_poses(task), array(arm.radii)
    offset = torch.as_tensor(np.stack((0 * radii, radii, 0 * radii), -1))  # poses in the centreline's frame
    own = se2.compose(torch.as_tensor(line).unsqueeze(1), offset.expand(len(line), -1, -1)).numpy()
    kinds = [kind_of(model) for model in arm.actuators]
    for index, kind in enumerate(kinds):
        colour, width = style_of(kind)
        label = f"{kind} ({kinds.count(kind)})" if index == kinds.index(kind) else None
        axes.plot(*own[:, index, :2].T, color=colour, linewidth=width, solid_capstyle="butt", label=label, gid=kind)
    if reached:
        draw_reached(axes, task.twists, task.base_pose, "reached")
    else:
        axes.plot(*line[:, :2].T, color="black", linewidth=1, linestyle="-.", label="centreline")
    half = 1.25 * max(np.abs(radii).max(), 0.01)
    plate = line[0, :2] + half * np.array([[-1], [1]]) * (-np.sin(line[0, 2]), np.cos(line[0, 2]))
    axes.plot(*plate.T, color="black", linewidth=7, solid_capstyle="butt", label="base")


def draw_task(axes: Axes, task: Task) -> None:
    """The centreline that an arm should have, thin, with its tip, where the arm itself is drawn elsewhere."""
    line = fine_poses(task)[:, :2]
    axes.plot(*line.T, color=ATTAINABLE, linewidth=1, linestyle="-.", label="shape of the task", gid="task")
    axes.plot(*line[-1], "o", color=ATTAINABLE, label="its tip", zorder=4)


def draw_reached(axes: Axes, twists: Tensor, base_pose: TensorLike | str, label: str) -> None:
    """The centreline at which an arm is, or is predicted to be, beside the shape that it should have."""
    task = Task(twists, (0.0, 0.0, 0.0), base_pose)
    axes.plot(*fine_poses(task)[:, :2].T, color=UNATTAINABLE, linewidth=2, linestyle="--", label=label, gid="reached")


def draw_loads(axes: Axes, task: Task, chosen: Mask, colour: str, *, width: float, prefix: str = "") -> None:
    """The chosen loads' forces as arrows from the tip, behind the arm, at one scale for all of the task; axes in m."""
    loads, tip = array(task.tip_load), fine_poses(task)[-1, :2]
    size = np.hypot(loads[:, 0], loads[:, 1])
    length = float(task.twists[:, :2].norm(dim=-1).mean()) or 1.0
    scale = (size.max() or 1.0) / (LONGEST_ARROW * length)  # N/m
    if chosen.any():
        force = loads[chosen, :2]
        start, how = np.broadcast_to(tip, force.shape), {"color": colour, "width": width, "zorder": 1.5}
        axes.quiver(*start.T, *force.T, angles="xy", scale_units="xy", scale=scale, **how)  # type: ignore[arg-type]
        axes.update_datalim(tip + force / scale)
        moment = f", {loads[chosen][0, 2]:.3g} N·m" if len(force) == 1 else ""
        lead = "tip load," if len(force) == 1 else f"{len(force)} tip loads, up to"
        label = f"{prefix}{lead} {size[chosen].max():.3g} N{moment}"
        axes.plot([], [], color=colour, marker=">", linewidth=250 * width, label=label)
    axes.set(xlabel="x [m]", ylabel="y [m]")
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.08)
    axes.autoscale_view()
