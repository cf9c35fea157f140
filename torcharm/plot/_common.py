"""What the pictures share: styles, axes, and the choice of one design and of tasks on one shape."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from math import prod
from typing import Any

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray
from torch import Tensor

from torcharm.actuators import Actuator, model_name
from torcharm.attainability import Attainability
from torcharm.design.space import Arm, one_of_batch
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
    "mckibben": ("#882255", 2.5),
    "chamber": ("#009E73", 3.5),
    "elastic core": ("#E69F00", 5.5),
}
"""Of the models that torcharm has, by the words that tables and studies have for them."""
OTHER_STYLES = (("#999999", 3.5), ("#CC79A7", 3.5), ("#0072B2", 3.5), ("#F0E442", 3.5))
"""Of other models, in the order in which an arm has them."""
PLAIN: dict[str, Any] = {"parse_math": False}
"""Of texts that hold names: dollar signs in them enclose no formula."""
SMOOTHING = 8  # points drawn on each element, so that one of constant curvature is seen to be an arc
ROOM = 0.06
"""What is free around what panels show, of its largest extent."""
NARROWEST = 0.5
"""Of its longer side a panel's shorter one, however narrow what it shows is."""
SMALLEST = 1e-3
"""Extent of a panel [m]: of an arm that reaches one place, or none, there is the base alone."""
LONGEST_ARROW = 0.3  # of the largest force, as a share of the centreline's length


def array(value: Tensor) -> Array:
    """A tensor as numpy, without its gradients."""
    return np.asarray(value.detach().double().cpu())


def kind_styles(models: Sequence[Actuator]) -> dict[str, tuple[str, float]]:
    """Colour and width of each kind of force model among some, by the word for it in legends, tables and studies."""
    kinds = dict.fromkeys(map(model_name, models))
    others = [kind for kind in kinds if kind not in KIND_STYLES]
    own = {kind: OTHER_STYLES[index % len(OTHER_STYLES)] for index, kind in enumerate(others)}
    return {kind: own[kind] if kind in own else KIND_STYLES[kind] for kind in kinds}


def one_design(field: str, arm: Any, task: Task) -> Arm:
    """The only design of a batch, which must have the task's dimension."""
    if arm.dimension != task.dimension:
        raise ValueError(f"{field}: must be of the task's dimension {task.dimension}, got {arm.dimension}")
    if prod(arm.batch_shape) != 1:
        raise ValueError(f"{field}: must be one design, as arm[0] of a batch, got batch shape {tuple(arm.batch_shape)}")
    return one_of_batch(arm, 0)


def under_loads(task: Task, indices: Sequence[int]) -> Task:
    """Some tasks of the flattened batch that share a shape, as that shape under several loads."""
    chosen = task.part(indices)
    return replace(chosen, twists=chosen.twists[0])


def like_shape(task: Task, index: int) -> Mask:
    """Which tasks of the flattened batch have the shape of one of them."""
    if 0 in task.batch_shape:
        raise ValueError(f"task: must hold at least one shape and load, got batch shape {tuple(task.batch_shape)}")
    count = prod(task.batch_shape)
    twists = task.twists.detach().expand(*task.batch_shape, *task.twists.shape[-2:]).reshape(count, -1)
    return np.asarray((twists == twists[index]).all(1).cpu())


def one_shape(task: Task, loads: Sequence[int] | None = None) -> Task:
    """A task of one shape, with all its loads, or those of some numbers, along one dimension."""
    same = like_shape(task, 0)
    if not same.all():
        shapes, columns = len(torch.unique(task.twists.detach().flatten(0, -3), dim=0)), task.twists.shape[-1]
        raise ValueError(f"task: must hold one shape, got {shapes}; give the twists of one, (N, {columns})")
    chosen = list(range(len(same)) if loads is None else loads)
    if not chosen or not set(chosen) <= set(range(len(same))):
        raise ValueError(f"loads: must be one or more integers from 0 to {len(same) - 1}, got {chosen!r:.60}")
    return under_loads(task, chosen)


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


def verdict_marks(words: Any) -> Iterator[tuple[str, Any, dict[str, Any]]]:
    """Of each verdict among words the word, where it is given, and how a scatter's marks of it look."""
    for word, (colour, marker, filled) in VERDICT_STYLES.items():
        if (own := words == word).any():
            yield word, own, mark_inks(colour, filled, marker)


def verdict_words(found: Attainability) -> NDArray[Any]:
    """The verdict on each task; of sets alone, whether it is excluded."""
    if found.verdict is not None:
        return np.ravel(np.asarray(found.verdict))
    assert found.not_excluded is not None
    return np.where(found.not_excluded.numpy(force=True).ravel(), "not excluded", "excluded")


def counted(words: NDArray[Any], leave: str = "") -> str:
    """How many tasks have which verdict, but for one that is left out."""
    return ", ".join(f"{(words == word).sum()} {word}" for word in VERDICT_STYLES if word != leave and word in words)


def worst_node(found: Attainability) -> int:
    """The node that lacks most on average over all tasks; where none does, that of the least margin, or the last."""
    per_node = found.relative_per_node if found.absolute_per_node is None else found.absolute_per_node
    if per_node is None:
        return found.task.nodes - 1
    rows = array(per_node).reshape(-1, per_node.shape[-1])[:, ::-1]  # of equals the last counts
    mean = np.where(np.isfinite(lack := rows.clip(min=0).mean(0)), lack, -1.0)
    return len(mean) - 1 - int((mean if mean.max() > 0 else rows.mean(0)).argmax())


def ranked_places(error: Array) -> NDArray[np.intp]:
    """The places of what is finite, from the least on."""
    known = np.flatnonzero(np.isfinite(error))
    return known[np.argsort(error[known], kind="stable")]


def median_place(error: Array) -> int | None:
    """The place of the median of what is finite, or None."""
    ranked = ranked_places(error)
    return int(ranked[(len(ranked) - 1) // 2]) if len(ranked) else None


def merged_legend(figure: Any, panels: Iterable[Any], shorten: Callable[[str], str] = str, **how: Any) -> None:
    """One legend for all panels, by labels without what differs from one to the next."""
    entries: dict[str, Any] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            entries.setdefault(shorten(label), handle)
    figure.legend(entries.values(), entries.keys(), **{"fontsize": "small", "frameon": False} | how)


def same_limits(panels: Sequence[Any]) -> float:
    """One scale for all panels; how much higher than wide they are."""
    boxes = torch.tensor([[*axes.dataLim.min, *axes.dataLim.max] for axes in panels])
    low, high = boxes[:, :2].amin(0), boxes[:, 2:].amax(0)
    longest = max((1 + 2 * ROOM) * float((high - low).max()), SMALLEST)
    extent = (high - low + 2 * ROOM * (high - low).max()).clamp(min=NARROWEST * longest)
    middle = (low + high) / 2
    (left, bottom), (right, top) = (middle - extent / 2).tolist(), (middle + extent / 2).tolist()
    for axes in panels:
        axes.set(xlim=(left, right), ylim=(top, bottom) if axes.yaxis.get_inverted() else (bottom, top))
    return float(extent[1] / extent[0])


def label_powers(axis: Any, digits: Sequence[float] = (1.0, 2.0, 5.0)) -> None:
    """Plain numbers along a logarithmic axis, at these multiples of powers of ten."""
    axis.set_major_locator(LogLocator(subs=digits))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def legend_below(axes: Any, ncols: int = 3, below: float = -0.12) -> None:
    """The legend so far below the axes that it covers nothing; names in it are as they are."""
    below = 0.0 if axes.name == "3d" else below
    plain_legend(axes, loc="upper center", bbox_to_anchor=(0.5, below), ncols=ncols)


def plain_legend(axes: Any, **how: Any) -> None:
    """A legend whose texts hold names."""
    for text in axes.legend(fontsize="small", frameon=False, **how).get_texts():
        text.set(**PLAIN)


def limits_around(points: Array, share: float, least: float = 1e-3) -> list[tuple[float, float]]:
    """Of each column of points (P, D), from where to where an axis goes that leaves some room around them."""
    room = np.maximum(share * np.ptp(points, 0), least)
    return [(float(low), float(high)) for low, high in zip(points.min(0) - room, points.max(0) + room, strict=True)]


def projection_of(task: Task) -> str:
    """Of the axes in which a task is drawn."""
    return "3d" if task.dimension == 3 else "rectilinear"


def axes_or_new(ax: Axes | None, projection: str = "rectilinear") -> Any:
    """The axes given, if they have the projection, or new ones."""
    if ax is None:
        from matplotlib import pyplot  # here alone: what pyplot makes, it also keeps

        return pyplot.subplots(figsize=(8.0, 6.0), layout="constrained", subplot_kw={"projection": projection})[1]
    if ax.name != projection:
        raise ValueError(f"ax: must have the projection {projection!r}, got {ax.name!r}")
    return ax
