"""What the pictures share: styles, axes, and the choice of one design and one shape."""

from collections.abc import Sequence
from math import prod
from typing import Any

import numpy as np
import torch
from matplotlib.axes import Axes
from numpy.typing import NDArray
from torch import Tensor

from torcharm.actuators import Actuator, Bellows, McKibben, model_name
from torcharm.arm import ArmDesign, check_planar
from torcharm.geometry import rod
from torcharm.inputs import check_count
from torcharm.task import Task

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ARM_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#F0E442")
ARM_LINES = ("-", "--", ":", "-.")
ATTAINABLE, UNATTAINABLE = "#000000", "#D55E00"
VERDICT_STYLES = {  # colour, marker, and whether that is filled
    "held": (ATTAINABLE, "o", True),
    "not excluded": (ATTAINABLE, "o", True),
    "missed": (UNATTAINABLE, "x", True),
    "excluded": (UNATTAINABLE, "x", True),
    "excluded by range": ("#999999", "s", False),
    "undecided": ("#0072B2", "^", False),
    "impossible": ("#882255", "*", True),
}
KIND_STYLES = {  # colour, width
    "bellows": ("#56B4E9", 4.5),
    "muscle": ("#882255", 2.5),
    "chamber": ("#009E73", 3.5),
    "elastic core": ("#E69F00", 5.5),
    "other": ("#999999", 3.5),
}
SMOOTHING = 8  # points drawn on each segment, so that a segment of constant curvature is seen to be an arc
LONGEST_ARROW = 0.3  # of the largest force, as a share of the centreline's length


def array(value: Tensor) -> Array:
    """A tensor as numpy, without its gradients."""
    return np.asarray(value.detach().double().cpu())


def kind_of(model: Actuator) -> str:
    """What a legend calls a force model; `style_of` is how it is drawn."""
    return "bellows" if isinstance(model, Bellows) else "muscle" if isinstance(model, McKibben) else model_name(model)


def style_of(kind: str) -> tuple[str, float]:
    """Colour and width of a kind of force model."""
    return KIND_STYLES.get(kind, KIND_STYLES["other"])


def fine_poses(task: Task) -> Array:
    """Poses (SMOOTHING·N + 1, 3) along one shape; every SMOOTHING-th is a node's."""
    return array(rod.poses(task.twists.repeat_interleave(SMOOTHING, 0), task.base_pose))


def one_design(field: str, arm: Any) -> ArmDesign:
    """The only design of a batch, which must be planar."""
    check_planar(arm)
    if prod(arm.batch_shape) != 1:
        raise ValueError(f"{field}: must be one design, as arm[0] of a batch, got batch shape {tuple(arm.batch_shape)}")
    design: ArmDesign = arm.flatten()[0]
    return design


def first_shape(task: Task) -> tuple[Task, Mask, int]:
    """The task's first shape with the loads on it, which of the flattened tasks these are, and how many shapes."""
    _check_drawable(task)
    if 0 in task.batch_shape:
        raise ValueError(f"task: must hold at least one shape and load, got batch shape {tuple(task.batch_shape)}")
    twists = task.twists.detach().expand(*task.batch_shape, -1, -1).reshape(-1, task.nodes, 3)
    tip_load = task.tip_load.detach().expand(*task.batch_shape, 3).reshape(-1, 3)
    same = (twists == twists[0]).flatten(1).all(1)
    shapes = 1 if bool(same.all()) else len(torch.unique(twists, dim=0))
    first = Task(twists[0], tip_load[same], task.base_pose, wrench_at=task.wrench_at)
    return first, same.cpu().numpy(), shapes


def _check_drawable(task: Task) -> None:
    """Raise unless a task is planar, of one segment, with a tip load alone: nothing else is drawn yet."""
    if task.dimension == 3:
        raise ValueError(f"task: must be planar, twists (..., N, 3), got {tuple(task.twists.shape)}")
    if task.load.gravity or task.load.points:
        raise ValueError("load: must be a tip load alone here, got gravity or point loads")
    if task.segment_nodes is not None and len(task.segment_nodes) > 1:
        raise ValueError(f"segment_nodes: must be one segment here, got {task.segment_nodes}")


def one_shape(task: Task) -> Task:
    """A task of one shape, with its loads along one dimension."""
    first, _, shapes = first_shape(task)
    if shapes > 1:
        raise ValueError(f"task: must hold one shape, got {shapes}; give the twists of one, (N, 3)")
    return first


def choose(task: Task, loads: Sequence[int] | None) -> Task:
    """The loads of these numbers."""
    count = len(task.tip_load)
    chosen = list(range(count) if loads is None else loads)
    if not chosen or not set(chosen) <= set(range(count)):
        raise ValueError(f"loads: must be one or more integers from 0 to {count - 1}, got {chosen!r:.60}")
    return Task(task.twists, task.tip_load[chosen], task.base_pose, wrench_at=task.wrench_at)


def node_index(task: Task, node: int | Tensor) -> int:
    """The index of a node, from 0, once it is known to be one of the task's."""
    index = check_count("node", node, 0)
    if index >= task.nodes:
        raise ValueError(f"node: must be below {task.nodes}, the number of nodes, got {index}")
    return index


def mark_inks(colour: str, filled: bool, marker: str = "o") -> dict[str, Any]:
    """Of a scatter's marks, the marker, and the colours of face and edge; a cross has no face."""
    inks = {"color": colour} if marker == "x" else {"edgecolors": colour, "facecolors": colour if filled else "none"}
    return {"marker": marker} | inks


def tip_errors(name: str, found: Tensor, tasks: int) -> Array:
    """The tip's errors [m] of the tasks that were searched; an interruption leaves fewer than all."""
    error = array(found).ravel()
    if len(error) > tasks:
        raise ValueError(f"results: {name}: must be of at most {tasks} tasks, got {len(error)}")
    return error


def ranked_places(error: Array) -> NDArray[np.intp]:
    """The places of what is finite, from the least on."""
    known = np.flatnonzero(np.isfinite(error))
    return known[np.argsort(error[known], kind="stable")]


def median_place(error: Array) -> int | None:
    """The place of the median of what is finite, or None."""
    ranked = ranked_places(error)
    return int(ranked[(len(ranked) - 1) // 2]) if len(ranked) else None


def legend_below(axes: Axes, below: float) -> None:
    """The legend where it covers nothing: so far below the axes, as a share of their height."""
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, below), ncols=3, fontsize="small", frameon=False)


def axes_or_new(ax: Axes | None, projection: str = "rectilinear") -> Any:
    """The axes given, if they have the projection, or new ones."""
    if ax is None:
        from matplotlib import pyplot  # here alone: what pyplot makes, it also keeps

        return pyplot.subplots(figsize=(8.0, 6.0), layout="constrained", subplot_kw={"projection": projection})[1]
    if ax.name != projection:
        raise ValueError(f"ax: must have the projection {projection!r}, got {ax.name!r}")
    return ax
