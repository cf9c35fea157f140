"""Tasks: the shape an arm is to hold and the load it is to hold it under."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor

from torcharm.geometry.rod import as_base, check_base_shape, check_rigid, check_segment_nodes, goes_by_name
from torcharm.inputs import (
    HoldsTensors,
    TensorLike,
    as_floating,
    broadcast_shapes,
    check_choice,
    check_count,
    check_finite,
    shown,
)
from torcharm.load import ExternalLoad, check_tip

T = TypeVar("T")

WRENCH_AT = "middle"
"""Where an element's wrench is taken unless a task says otherwise. At the middle errors fall with 1/N²; at the start,
the paper's place, with 1/N: a tip force bends an arm of ten elements 7 % too far, and its own weight 13 %."""

WRENCH_PLACES = ("start", "middle")


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Task(HoldsTensors):
    """Centreline shapes and the loads to hold them under; their batch dimensions broadcast.

    Attributes:
        twists: (..., N, 3) rows `(l, γ, κ)` in the plane, (..., N, 6) rows `(l, γ_y, γ_z, κ_x, κ_y, κ_z)` in space,
            per unit of normalised arc of the own segment [m, rad], segment after segment.
        base_pose: pose of node 1, (3,) [m, m, rad] or (4, 4).
        load: all that loads the arm; its tip is the `tip_load`.
        wrench_at: "middle" or "start", where on its element a node's wrench is taken.
        segment_nodes: number of elements of each segment in series, or None for an arm of one segment.

    Example:
        >>> ta.Task(ta.affine_curvature(0.5, 0.5), ta.sample_loads(100)).batch_shape  # one shape, under 100 loads
        torch.Size([100])
    """

    twists: Tensor
    base_pose: Tensor
    load: ExternalLoad
    wrench_at: str
    segment_nodes: tuple[int, ...] | None

    def __init__(
        self,
        twists: TensorLike,
        tip_load: TensorLike | None = None,
        base_pose: TensorLike | str | None = None,
        load: ExternalLoad | None = None,
        wrench_at: str = WRENCH_AT,
        segment_nodes: Sequence[int] | None = None,
    ) -> None:
        """Check, without expanding: a shape shared by many loads stays shared.

        Args:
            twists: (..., N, 3 or 6); the number of columns says whether the task is planar or spatial.
            tip_load: (..., 3) or (..., 6) in the world frame [N, N·m]; None is no load. Beside a load it is its tip.
            base_pose: (3,) or (4, 4), or "hanging" (None), "upright" or "horizontal", from the origin.
            load: point loads and gravity, with or without a tip load.
            wrench_at: "middle" (second order in 1/N) or "start" (first order; the paper, and all that it publishes).
            segment_nodes: for arms in series, how many of the N rows belong to each segment.

        Raises:
            ValueError: shapes do not fit, a value is not finite, or the base pose is no rotation and position.
        """
        if load is not None and not isinstance(load, ExternalLoad):
            raise ValueError(f"load: must be an ExternalLoad, got {shown(load)}")
        check_choice("wrench_at", wrench_at, WRENCH_PLACES)
        given: dict[str, Any] = {"twists": twists}
        if tip_load is not None:
            given["tip_load"] = tip_load
        if not goes_by_name(base_pose):
            given["base_pose"] = base_pose
        others = {} if load is None else {f"load.{name}": value for name, value in load.tensors().items()}
        values = dict(zip((*given, *others), as_floating(**given, **others), strict=True))
        twists_ = values["twists"]
        if twists_.ndim < 2 or twists_.shape[-1] not in (3, 6) or twists_.shape[-2] < 1:
            raise ValueError(
                "twists: must have shape (..., N, 3) in the plane or (..., N, 6) in space with N at least 1, "
                f"got {tuple(twists_.shape)}"
            )
        columns = twists_.shape[-1]
        base = as_base(values.get("base_pose", base_pose), twists_, columns)
        check_base_shape(base, columns)
        for name, value in (("twists", twists_), ("base_pose", base)):
            check_finite(name, value)
        check_rigid("base_pose", base)
        whole = (load or ExternalLoad()).to(twists_)
        if whole.columns not in (None, columns):
            raise ValueError(f"load: must be of {columns} components as the twists are, got {whole.columns}")
        tip = values.get("tip_load", whole.tip)
        if tip is not None:
            check_tip("tip_load", tip, (columns,))
            broadcast_shapes(twists=twists_.shape[:-2], tip_load=tip.shape[:-1])
        whole = whole.with_tip(tip)
        broadcast_shapes(twists=twists_.shape[:-2], load=whole.batch_shape)
        counts = None if segment_nodes is None else check_segment_nodes(segment_nodes, twists_.shape[-2])
        check_segments(whole, 1 if counts is None else len(counts))
        object.__setattr__(self, "twists", twists_)
        object.__setattr__(self, "base_pose", base)
        object.__setattr__(self, "load", whole)
        object.__setattr__(self, "wrench_at", wrench_at)
        object.__setattr__(self, "segment_nodes", counts)

    @property
    def tip_load(self) -> Tensor:
        """(..., 3) or (..., 6) wrench at the tip in the world frame [N, N·m]; zero where there is none."""
        return self.twists.new_zeros(self.twists.shape[-1]) if self.load.tip is None else self.load.tip

    @property
    def batch_shape(self) -> torch.Size:
        """Shape of the batch of tasks; empty for one task."""
        return torch.broadcast_shapes(self.twists.shape[:-2], self.load.batch_shape)

    @property
    def nodes(self) -> int:
        """N, the number of elements; node i is the start of element i."""
        return self.twists.shape[-2]

    @property
    def nodes_of_segments(self) -> tuple[int, ...]:
        """Number of elements of each segment."""
        return self.segment_nodes or (self.nodes,)

    @property
    def dimension(self) -> int:
        """2 for a planar task, 3 for a spatial one."""
        return 2 if self.twists.shape[-1] == 3 else 3

    def part(self, index: int | slice | Sequence[int]) -> "Task":
        """One task of the flattened batch, or some of them along one dimension.

        Raises:
            IndexError: there is no such task.
        """

        def own(value: Tensor, dims: int) -> Tensor:
            shape = value.shape[value.ndim - dims :]
            return value.expand((*self.batch_shape, *shape)).reshape((-1, *shape))[index]

        tip, points = self.load.tip, []
        for point in self.load.points:
            wrench = None if point.wrench is None else own(point.wrench, 1)
            points.append(replace(point, wrench=wrench, mass=own(point.mass, 0)))
        load = replace(self.load, tip=None if tip is None else own(tip, 1), points=tuple(points))
        return replace(self, twists=own(self.twists, 2), load=load)

    def __repr__(self) -> str:
        """Shapes, no numbers."""
        extra = "" if self.segment_nodes is None else f", segment_nodes={self.segment_nodes}"
        return (
            f"Task(twists {tuple(self.twists.shape)}, {self.load!r}, wrench_at={self.wrench_at!r}{extra}, "
            f"{self.twists.dtype})"
        )

    def _map(self, change: Callable[[Tensor], Tensor]) -> "Task":
        task = object.__new__(type(self))
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, Tensor):
                value = change(value)
            elif isinstance(value, ExternalLoad):
                value = value._map(change)
            object.__setattr__(task, field.name, value)
        return task


def task_list(task: object) -> tuple[Task, ...]:
    """The tasks of one task or of a list of them.

    Raises:
        ValueError: there is none, or one is no task.
    """
    if isinstance(task, Task):
        return (task,)
    if not isinstance(task, (list, tuple)):
        raise ValueError(f"task: must be a Task or a list of them, got {shown(task)}")
    if not task:
        raise ValueError("task: must hold at least one task, got none")
    for index, one in enumerate(task):
        if not isinstance(one, Task):
            raise ValueError(f"task[{index}]: must be a Task, got {shown(one)}")
    return tuple(task)


def for_each_task(task: object, work: Callable[[Task], T]) -> T | tuple[T, ...]:
    """What some work makes of a task, or of each in a list of tasks; an error that names the task says which it is.

    Raises:
        ValueError: as for `task_list`, and by the work.
    """
    if not isinstance(task, (list, tuple)):
        return work(task)  # type: ignore[arg-type]  # which says if it is none
    found = []
    for index, one in enumerate(task_list(task)):
        try:
            found.append(work(one))
        except ValueError as error:
            message = str(error)
            if not message.startswith("task: "):
                raise
            raise ValueError(f"task[{index}]: {message.removeprefix('task: ')}") from None
    return tuple(found)


def check_segments(load: ExternalLoad, count: int) -> None:
    """Raise unless every point load sits on a segment that is there."""
    for index, point in enumerate(load.points):
        if point.segment >= count:
            raise ValueError(
                f"points[{index}].segment: must be below {count}, the number of segments (see segment_nodes), "
                f"got {point.segment}"
            )


def sample_loads(count: int, scale: Sequence[float] = (20.0, 20.0, 2.0), seed: int = 100) -> Tensor:
    """Tip loads (count, 3) or, of six scales, (count, 6), uniform within ± scale/2: `diag(scale) (U - ½)` [N, N·m].

    The defaults draw the paper's loads: numpy's legacy generator, one load a row.

    Raises:
        ValueError: the count is negative or no integer, the scale neither three nor six finite numbers, or the seed
            outside [0, 2³²).

    Example:
        >>> ta.sample_loads(2, scale=(4.0, 4.0, 0.4)).round(decimals=2).tolist()  # within ±2 N and ±0.2 N·m
        [[0.17, -0.89, -0.03], [1.38, -1.98, -0.15]]
    """
    check_count("count", count, 0)
    if check_count("seed", seed, 0) >= 2**32:
        raise ValueError(f"seed: must be below 2**32, got {seed}")
    (spread,) = as_floating(scale=scale)
    if spread.shape not in ((3,), (6,)):
        raise ValueError(
            f"scale: must be three numbers (f_x, f_y, m), or six in space, got shape {tuple(spread.shape)}"
        )
    check_finite("scale", spread)
    uniform = np.random.RandomState(seed).rand(count, len(spread))
    return spread * (torch.as_tensor(uniform, dtype=spread.dtype, device=spread.device) - 0.5)
