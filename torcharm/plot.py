"""Pictures of arms, tasks, attainable sets and results.

`import torcharm` loads no matplotlib; `from torcharm import plot` does. Except for `study_figure`, every function
draws into the axes it is given, or makes some, and returns them. Nothing is shown, and no setting is changed.
Colour is never the only cue: the attainable is black and solid or a dot, the rest vermillion and dashed or a cross.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import prod
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]
from numpy.typing import NDArray
from torch import Tensor

from torcharm import rod, se2
from torcharm._inputs import TensorLike
from torcharm.actuators import Actuator, Bellows, McKibben
from torcharm.arm import ArmDesign
from torcharm.attainability import CHOICES, PREDICTED, Attainability, evaluate
from torcharm.hulls import wrench_hulls
from torcharm.task import Task
from torcharm.wrenches import PLANAR, required_wrench

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ARM_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#F0E442")
ARM_LINES = ("-", "--", ":", "-.")
ATTAINABLE, UNATTAINABLE = "#000000", "#D55E00"
KIND_STYLES = {"bellows": ("#56B4E9", 4.5), "muscle": ("#882255", 2.5), "other": ("#999999", 3.5)}  # colour, width
SMOOTHING = 8  # points drawn on each segment, so that a segment of constant curvature is seen to be an arc
LONGEST_ARROW = 0.3  # of the largest force, as a share of the centreline's length


def arm_shape(
    arm: ArmDesign,
    twists: Float[Tensor, "*batch N 3"],
    *,
    tip_load: TensorLike | None = None,
    base_pose: TensorLike | None = None,
    ax: Axes | None = None,
) -> Axes:
    """One arm at one shape: base plate, centreline, each actuator where it lies, and the load on the tip.

    Args:
        arm: one design.
        twists: (N, 3) one shape [m, m, rad].
        tip_load: (3,) `(f_x, f_y, m)` in the world frame [N, N, N·m]; its force is an arrow, its size in the legend.
        base_pose: (3,) pose of node 1 [m, m, rad]; None hangs the arm.
        ax: 2-D axes to draw in; None makes some.

    Raises:
        ValueError: there are several designs, shapes or loads, or the axes are not 2-D.
    """
    arm, base = _one_design("arm", arm), rod.BASE_POSE if base_pose is None else base_pose
    task = Task(twists, (0.0, 0.0, 0.0) if tip_load is None else tip_load, base)
    for name, value, dims in (("twists", task.twists, 2), ("tip_load", task.tip_load, 1)):
        if prod(value.shape[:-dims]) != 1:
            raise ValueError(f"{name}: must hold one, of shape {tuple(value.shape[-dims:])}, got {tuple(value.shape)}")
    task, axes = _first_shape(task)[0], _axes(ax)
    _draw_arm(axes, arm, task)
    _draw_loads(axes, task, np.full(1, tip_load is not None), ATTAINABLE, width=0.008)
    axes.legend(loc="best")
    return axes


def task_shape(task: Task, *, ax: Axes | None = None) -> Axes:
    """One shape's centreline, and the forces of all loads on its tip as arrows.

    Args:
        task: one shape, with any number of loads.
        ax: 2-D axes to draw in; None makes some.

    Raises:
        ValueError: the task holds several shapes or nothing, or the axes are not 2-D.
    """
    task, axes = _one_shape(task), _axes(ax)
    line = _fine_poses(task)[:, :2]
    axes.plot(*line.T, color="black", linewidth=3, marker="s", markevery=[0], markersize=10, label="centreline, base")
    _draw_loads(axes, task, np.ones(len(task.tip_load), bool), "#E69F00", width=0.003)
    axes.legend(loc="best")
    return axes


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
    scene = _scene(_one_design("arm", arm), _choose(_one_shape(task), loads), relative, hull, samples)
    axes = _axes(ax, "3d")
    _draw_hulls(axes, scene, scene.inside.all(-1), colour)
    _limit(axes, [scene])
    return axes


def node_hull(
    arm: ArmDesign,
    task: Task,
    node: int,
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
        node: 1 (the base) to N.
        ax: 2-D axes to draw in; None makes some.

    Raises:
        ValueError: the node is out of range, the axes are not 2-D, or as for `hulls_along_arm`.
    """
    if isinstance(node, bool) or not isinstance(node, int) or not 1 <= node <= task.nodes:
        raise ValueError(f"node: must be an integer from 1 (base) to {task.nodes}, got {node!r}")
    scene = _scene(_one_design("arm", arm), _one_shape(task), relative, hull, samples)
    ring, point, inside = scene.hulls[node - 1], scene.required[:, node - 1], scene.inside[:, node - 1]
    axes = _axes(ax)
    axes.fill(*ring.T, facecolor=colour, alpha=0.25, label="pressures provide")
    axes.plot(*ring.T, color=colour, marker=".", markersize=3)
    for kept, name, ink, marker in ((inside, "inside", ATTAINABLE, "o"), (~inside, "outside", UNATTAINABLE, "x")):
        label = f"required, {name}: {kept.sum()} of {len(kept)}"
        axes.plot(*point[kept].T, color=ink, marker=marker, markersize=5, linestyle="", label=label)
    axes.set(xlabel=scene.labels[0], ylabel=scene.labels[1], title=f"node {node} of {task.nodes}")
    axes.legend(loc="best")
    return axes


def unattainability_histogram(values: Mapping[str, Tensor], *, ax: Axes | None = None, unit: str = "N") -> Axes:
    """How far each arm misses its tasks: histograms over shared bins, with lines at the medians.

    Args:
        values: for each arm's name its unattainability on every task, of any shape; zero or less is attainable.
            What is not finite is counted in the legend.
        ax: 2-D axes to draw in; None makes some.
        unit: of the values; with weights of one, newtons stand for newtons and newton-metres alike.

    Raises:
        ValueError: there is no finite value, or the axes are not 2-D.
    """
    arrays = {name: _array(value).ravel() for name, value in values.items()}
    if not any(np.isfinite(array).any() for array in arrays.values()):
        raise ValueError(f"values: must hold at least one finite value, got none for {list(arrays)}")
    return _draw_histogram(_axes(ax), arrays, list(arrays), "unattainability", unit)


def study_figure(
    results: Sequence[tuple[str, ArmDesign]],
    task_name: str,
    task: Task,
    evaluated: Sequence[Attainability],
    *,
    hull: str = "exact",
    samples: int | None = None,
    unit: str = "N",
) -> Figure:
    """One page that compares arms on one task, for `figure.savefig(path)`.

    A column for each arm: the arm at the shape with the loads on it, and its absolute hulls along the arm with
    the requirements, at one scale for all arms. Below, histograms of the metrics that were evaluated. Of several
    shapes the first is drawn; titles and histograms are about all tasks.

    Args:
        results: names and designs.
        task_name: for the title.
        task, evaluated: tasks of any batch shape, and what `evaluate` found on them for each arm.
        hull, samples: as they were given to `evaluate`.
        unit: of the metrics.

    Raises:
        ValueError: results, task and evaluated do not fit each other, or a name comes twice.
    """
    first, drawn, shapes = _first_shape(task)
    arms = {name: _one_design(f"results[{index}]", arm) for index, (name, arm) in enumerate(results)}
    if not arms or len(arms) < len(results):
        raise ValueError(f"results: must be one or more arms of different names, got {[name for name, _ in results]}")
    if len(evaluated) != len(arms):
        raise ValueError(f"evaluated: must hold one entry for each of the {len(arms)} results, got {len(evaluated)}")
    metrics = _metrics(list(arms), evaluated, len(drawn))
    figure = Figure(
        figsize=(max(10.0, 5.2 * len(arms), 4.8 * len(metrics)), 14.0 if metrics else 10.5), layout="constrained"
    )
    rows = 2 if metrics else 1
    panels: Any = figure.subfigures(rows, 1, squeeze=False, height_ratios=(3, 1)[:rows])[:, 0]
    title = [task_name, *_ranking(metrics, unit)]
    if shapes > 1:
        title.append(f"drawn: the first of {shapes} shapes, {drawn.sum()} of {len(drawn)} tasks; numbers: all tasks")
    figure.suptitle("\n".join(title), fontsize="large", fontweight="bold")
    scenes = [_scene(arm, first, False, hull, samples) for arm in arms.values()]
    for column, ((name, arm), scene) in enumerate(zip(arms.items(), scenes, strict=True)):
        values = metrics.get("absolute", {}).get(name)
        attainable = scene.inside.all(-1) if values is None else values[drawn] <= 0
        axes = panels[0].add_subplot(2, len(arms), column + 1)
        axes.set_title("\n".join(_findings(name, metrics, evaluated[column], unit)), fontsize="medium")
        _draw_arm(axes, arm, first)
        _draw_loads(axes, first, ~attainable, UNATTAINABLE, width=0.003, prefix="not attainable: ")
        _draw_loads(axes, first, attainable, ATTAINABLE, width=0.006, prefix="attainable: ")
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2, fontsize="small", frameon=False)
        deep = panels[0].add_subplot(2, len(arms), len(arms) + column + 1, projection="3d")
        _draw_hulls(deep, scene, attainable, ARM_COLOURS[column % len(ARM_COLOURS)])
        _limit(deep, scenes)
    for place, (metric, found) in enumerate(metrics.items()):
        axes = panels[1].add_subplot(1, len(metrics), place + 1)
        quantity, own, scale = _quantity(metric, unit)
        scaled = {name: scale * value for name, value in found.items()}
        _draw_histogram(axes, scaled, list(arms), quantity, own, metric != PREDICTED)
    return figure


def _metrics(names: list[str], evaluated: Sequence[Attainability], tasks: int) -> dict[str, dict[str, Array]]:
    """For each metric that any arm has, those arms' values (tasks)."""
    metrics: dict[str, dict[str, Array]] = {}
    for metric, index in product(CHOICES, range(len(names))):
        value = getattr(evaluated[index], metric)
        if value is not None:
            if value.numel() != tasks:
                given = f"got shape {tuple(value.shape)}"
                raise ValueError(f"evaluated[{index}].{metric}: must hold one value for each of {tasks} tasks, {given}")
            metrics.setdefault(metric, {})[names[index]] = _array(value).ravel()
    return metrics


def _ranking(metrics: dict[str, dict[str, Array]], unit: str) -> list[str]:
    """Which arm misses least, so that the message needs no caption."""
    for metric, found in metrics.items():
        quantity, own, scale = _quantity(metric, unit)
        ranked = sorted(found, key=lambda name: (np.isnan(_median(found[name])), _median(found[name])))
        medians = (f"{name} {_median(found[name]) * scale:.3g} {own}" for name in ranked)
        return [f"median {quantity}: " + ", ".join(medians)]
    return []


def _findings(name: str, metrics: dict[str, dict[str, Array]], result: Attainability, unit: str) -> list[str]:
    found = []
    for metric, values in metrics.items():
        if name in values:
            _, own, scale = _quantity(metric, unit)
            found.append(f"{metric.replace('_', ' ')} {_summary(scale * values[name], own, metric != PREDICTED)}")
    lines = [f"{name}: {found[0] if found else 'no metric evaluated'}", *found[1:]]
    if not bool(result.in_range.all()):
        excess = float(result.strain_excess.max())
        lines.append("extrapolates: " + (f"strain {excess:.2g} beyond range" if excess > 0 else "pressure limits"))
    return lines


def _summary(values: Array, unit: str, counted: bool = True) -> str:
    lost = int((~np.isfinite(values)).sum())
    count = f", {(values <= 0).sum()} of {len(values)} attainable" if counted else ""
    return f"median {_median(values):.3g} {unit}{count}" + (f", {lost} not finite" if lost else "")


def _quantity(metric: str, unit: str) -> tuple[str, str, float]:
    """What a metric is called and shown in, and the factor to that unit."""
    return ("predicted shape error", "mm", 1000.0) if metric == PREDICTED else (f"{metric} unattainability", unit, 1.0)


def _median(values: Array) -> float:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if len(finite) else float("nan")


def _draw_arm(axes: Axes, arm: ArmDesign, task: Task) -> None:
    """Base plate, actuators and centreline."""
    line, radii = _fine_poses(task), _array(arm.radii)
    offset = torch.as_tensor(np.stack((0 * radii, radii, 0 * radii), -1))  # poses in the centreline's frame
    own = se2.compose(torch.as_tensor(line).unsqueeze(1), offset.expand(len(line), -1, -1)).numpy()
    kinds = [_kind(model) for model in arm.actuators]
    for index, kind in enumerate(kinds):
        colour, width = KIND_STYLES[kind]
        label = f"{kind} ({kinds.count(kind)})" if index == kinds.index(kind) else None
        axes.plot(*own[:, index, :2].T, color=colour, linewidth=width, solid_capstyle="butt", label=label, gid=kind)
    axes.plot(*line[:, :2].T, color="black", linewidth=1, linestyle="-.", label="centreline")
    half = 1.25 * max(np.abs(radii).max(), 0.01)
    plate = line[0, :2] + half * np.array([[-1], [1]]) * (-np.sin(line[0, 2]), np.cos(line[0, 2]))
    axes.plot(*plate.T, color="black", linewidth=7, solid_capstyle="butt", label="base")


def _kind(model: Actuator) -> str:
    return "bellows" if isinstance(model, Bellows) else "muscle" if isinstance(model, McKibben) else "other"


def _draw_loads(axes: Axes, task: Task, chosen: Mask, colour: str, *, width: float, prefix: str = "") -> None:
    """The chosen loads' forces as arrows from the tip, behind the arm, at one scale for all of the task; axes in m."""
    loads, tip = _array(task.tip_load), _fine_poses(task)[-1, :2]
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


@dataclass(frozen=True)
class _Scene:
    """Planar wrenches `(f_x, m)` [N, N·m] of one arm at one shape."""

    hulls: Array  # (N, V + 1, 2) closed rings: what each node can provide
    required: Array  # (L, N, 2) what each load requires
    inside: Mask  # (L, N) whether the one holds the other
    labels: tuple[str, str]


@torch.no_grad()
def _scene(arm: ArmDesign, task: Task, relative: bool, hull: str, samples: int | None) -> _Scene:
    metric = "relative" if relative else "absolute"
    distance = getattr(evaluate(arm, task, (metric,), hull=hull, samples=samples), f"{metric}_per_node")
    vertices = wrench_hulls(arm, task.twists, relative=relative, hull=hull, samples=samples).vertices
    required = required_wrench(task.twists, task.tip_load, task.base_pose)[..., PLANAR]
    labels = (r"force $f_x$ [N]", r"moment $m$ [N·m]")
    if relative:
        required = required - required[..., :1, :]
        labels = (r"force $f_x - f_{x,1}$ [N]", r"moment $m - m_1$ [N·m]")
    closed = torch.cat((vertices, vertices[:, :1]), 1)
    return _Scene(_array(closed), _array(required), _array(distance) <= 0, labels)


def _draw_hulls(axes: Any, scene: _Scene, attainable: Mask, colour: str) -> None:
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


def _limit(axes: Any, scenes: Sequence[_Scene]) -> None:
    """View and limits around all that is drawn; matplotlib's own limits do not see polygons in space."""
    points = np.concatenate([part.reshape(-1, 2) for scene in scenes for part in (scene.hulls, scene.required)])
    room = np.where(np.ptp(points, 0) > 0, 0.04 * np.ptp(points, 0), 1.0)
    force, moment = np.stack((points.min(0) - room, points.max(0) + room)).T
    axes.set(xlim=(0.5, len(scenes[0].hulls) + 0.5), ylim=force, zlim=moment)
    for axis, ticks in ((axes.xaxis, 10), (axes.yaxis, 4), (axes.zaxis, 6)):
        axis.set_major_locator(MaxNLocator(ticks, integer=axis is axes.xaxis))
    axes.set_box_aspect((1.5, 1.0, 1.0), zoom=0.95)
    axes.view_init(elev=20, azim=-55)


def _draw_histogram(
    axes: Axes, values: dict[str, Array], names: list[str], quantity: str, unit: str, counted: bool = True
) -> Axes:
    """Histograms of arms, styled by their place among the names; counted if 0 is attainable."""
    finite = {name: value[np.isfinite(value)] for name, value in values.items()}
    edges = np.histogram_bin_edges(np.concatenate(list(finite.values())), bins=30)
    headroom = 0.12 + 0.09 * len(values)  # for the legend, above bars and lines
    for name, value in finite.items():
        index = names.index(name)
        colour, line = ARM_COLOURS[index % len(ARM_COLOURS)], ARM_LINES[index % len(ARM_LINES)]
        axes.hist(value, edges.tolist(), color=colour, alpha=0.35)
        axes.hist(value, edges.tolist(), color=colour, histtype="step", linewidth=1.2, linestyle=line)
        label = f"{name}: {_summary(values[name], unit, counted)}"
        axes.axvline(_median(value), ymax=1 - headroom, color=colour, linewidth=2.5, linestyle=line, label=label)
    highest = max(1, *(np.histogram(value, edges)[0].max() for value in finite.values()))
    axes.set(xlabel=f"{quantity} [{unit}]", ylabel="number of tasks", ylim=(0, highest / (1 - headroom)))
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.legend(loc="upper right", fontsize="small", frameon=False, handlelength=3.5)
    return axes


def _array(value: Tensor) -> Array:
    return np.asarray(value.detach().double().cpu())


def _fine_poses(task: Task) -> Array:
    """Poses (SMOOTHING·N + 1, 3) along one shape; every SMOOTHING-th is a node's."""
    return _array(rod.poses(task.twists.repeat_interleave(SMOOTHING, 0), task.base_pose))


def _one_design(field: str, arm: ArmDesign) -> ArmDesign:
    if prod(arm.batch_shape) != 1:
        raise ValueError(f"{field}: must be one design, as arm[0] of a batch, got batch shape {tuple(arm.batch_shape)}")
    return arm.flatten()[0]


def _first_shape(task: Task) -> tuple[Task, Mask, int]:
    """The task's first shape with the loads on it, which of the flattened tasks these are, and how many shapes."""
    if 0 in task.batch_shape:
        raise ValueError(f"task: must hold at least one shape and load, got batch shape {tuple(task.batch_shape)}")
    twists = task.twists.detach().expand(*task.batch_shape, -1, -1).reshape(-1, task.nodes, 3)
    tip_load = task.tip_load.detach().expand(*task.batch_shape, 3).reshape(-1, 3)
    same = (twists == twists[0]).flatten(1).all(1)
    shapes = 1 if bool(same.all()) else len(torch.unique(twists, dim=0))
    return Task(twists[0], tip_load[same], task.base_pose), same.cpu().numpy(), shapes


def _one_shape(task: Task) -> Task:
    first, _, shapes = _first_shape(task)
    if shapes > 1:
        raise ValueError(f"task: must hold one shape, got {shapes}; give the twists of one, (N, 3)")
    return first


def _choose(task: Task, loads: Sequence[int] | None) -> Task:
    count = len(task.tip_load)
    chosen = list(range(count) if loads is None else loads)
    if not chosen or not set(chosen) <= set(range(count)):
        raise ValueError(f"loads: must be one or more integers from 0 to {count - 1}, got {chosen!r:.60}")
    return Task(task.twists, task.tip_load[chosen], task.base_pose)


def _axes(ax: Axes | None, projection: str = "rectilinear") -> Any:
    if ax is None:
        from matplotlib import pyplot  # here alone: what pyplot makes, it also keeps

        return pyplot.subplots(figsize=(8.0, 6.0), layout="constrained", subplot_kw={"projection": projection})[1]
    if ax.name != projection:
        raise ValueError(f"ax: must have the projection {projection!r}, got {ax.name!r}")
    return ax
