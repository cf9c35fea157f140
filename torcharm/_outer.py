"""Every design against every task, laid out for work in blocks of bounded memory."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import chain, product
from math import prod

import torch
from torch import Tensor

from torcharm._inputs import refuse_transforms, shown
from torcharm.arm import ArmDesign, check_planar
from torcharm.task import Task, check_plain


@dataclass(frozen=True)
class OuterProduct:
    """D designs × P shapes × L loads a shape.

    Task dimensions along which only the load varies are load dimensions; all others make shapes,
    so that what depends on the shape alone is worked out once for all loads on it.

    Attributes:
        arm: D designs.
        twists: (P, N, 3).
        tip_load: (P, L, 3).
        base_pose: (3,).
        design_batch, shape_batch, load_batch: what was flattened.
        task_axes: for each task dimension, its place among shape and load dimensions.
    """

    arm: ArmDesign
    twists: Tensor
    tip_load: Tensor
    base_pose: Tensor
    design_batch: tuple[int, ...]
    shape_batch: tuple[int, ...]
    load_batch: tuple[int, ...]
    task_axes: tuple[int, ...]

    @property
    def sizes(self) -> tuple[int, int, int]:
        """(D, P, L)."""
        return prod(self.design_batch), prod(self.shape_batch), prod(self.load_batch)

    @property
    def nodes(self) -> int:
        """N."""
        return self.twists.shape[-2]

    def unflatten(self, value: Tensor) -> Tensor:
        """(D, P, L, ...) as (*design batch, *task batch, ...)."""
        value = value.reshape((*self.design_batch, *self.shape_batch, *self.load_batch, *value.shape[3:]))
        lead, tasks = len(self.design_batch), len(self.task_axes)
        order = [*range(lead), *(lead + axis for axis in self.task_axes), *range(lead + tasks, value.ndim)]
        return value.permute(order)


def check_arm_and_task(arm: ArmDesign, task: Task) -> None:
    """Raise unless they are a design and a task, of one dtype and on one device, and under no transform."""
    refuse_transforms("arm, task")
    for name, value, kind in (("arm", arm, ArmDesign), ("task", task, Task)):
        if not isinstance(value, kind):
            raise ValueError(f"{name}: must be of type {kind.__name__}, got {shown(value)}")
    check_planar(arm)
    check_plain(task)
    ours, theirs = arm.radii, task.twists
    if ours.dtype != theirs.dtype or ours.device != theirs.device:
        raise ValueError(
            f"task: must have the arm's dtype and device, {ours.dtype} on {ours.device}, "
            f"got {theirs.dtype} on {theirs.device}; use task.to(...)"
        )


def outer_product(arm: ArmDesign, task: Task) -> OuterProduct:
    """Flatten designs and tasks, telling the dimensions of shapes from those of loads."""
    batch = task.batch_shape
    missing = len(batch) - (task.twists.ndim - 2)
    sizes = (*(1,) * missing, *task.twists.shape[:-2])
    strides = (*(0,) * missing, *task.twists.stride()[:-2])
    shared = [size == 1 or stride == 0 for size, stride in zip(sizes, strides, strict=True)]
    shape_axes = [axis for axis, alike in enumerate(shared) if not alike]
    load_axes = [axis for axis, alike in enumerate(shared) if alike]
    order = [*shape_axes, *load_axes]

    twists = task.twists.reshape(*sizes, *task.twists.shape[-2:])
    for axis in load_axes:
        twists = twists.narrow(axis, 0, min(1, twists.shape[axis]))
    shapes = [batch[axis] for axis in shape_axes]
    loads = [batch[axis] for axis in load_axes]
    tip_load = task.tip_load.expand(*batch, 3).permute(*order, len(batch))
    return OuterProduct(
        arm.flatten(),
        twists.permute(*order, len(batch), len(batch) + 1).reshape(-1, *task.twists.shape[-2:]),
        tip_load.reshape(prod(shapes), prod(loads), 3),
        task.base_pose,
        tuple(arm.batch_shape),
        tuple(shapes),
        tuple(loads),
        tuple(order.index(axis) for axis in range(len(batch))),
    )


@dataclass(frozen=True)
class Block:
    """A part of an outer product: d designs × p shapes × l loads a shape, and where they lie in it."""

    arm: ArmDesign
    twists: Tensor
    tip_load: Tensor
    base_pose: Tensor
    place: tuple[slice, slice, slice]


def map_blocks(outer: OuterProduct, chunk_size: int, work: Callable[[Block], tuple[Tensor, ...]]) -> tuple[Tensor, ...]:
    """Work on blocks of at most `chunk_size` triples and join what they return.

    Args:
        outer: of which no size is 0.
        chunk_size: (design, shape, load) triples in a block.
        work: from a block to tensors (d, p, l, ...).

    Returns:
        Tensors (D, P, L, ...).
    """
    _keep_freed_memory()
    designs, shapes, loads = outer.sizes
    per_load = min(loads, chunk_size)
    per_shape = min(shapes, max(1, chunk_size // per_load))
    per_design = min(designs, max(1, chunk_size // (per_load * per_shape)))

    limits = (per_design, per_shape, per_load)
    steps = [list(_slices(size, step)) for size, step in zip(outer.sizes, limits, strict=True)]
    places = [(d, p, l) for d, p, l in product(*steps)]
    if len(places) == 1:
        return work(Block(outer.arm, outer.twists, outer.tip_load, outer.base_pose, places[0]))
    blocks = (
        Block(outer.arm[d], outer.twists[p], outer.tip_load[p, l], outer.base_pose, (d, p, l)) for d, p, l in places
    )
    first = work(next(blocks))
    if any(column.requires_grad for column in first):
        return _joined([first, *map(work, blocks)], [len(step) for step in steps])
    # Copied to their place at once: results kept until the end would lie scattered among the freed
    # memory of the work, and keep much of it from being used again.
    whole = tuple(column.new_empty(*outer.sizes, *column.shape[3:]) for column in first)
    for place, part in zip(places, chain([first], map(work, blocks)), strict=True):
        for column, own in zip(whole, part, strict=True):
            column[place] = own
    return whole


def _joined(parts: list[tuple[Tensor, ...]], counts: list[int]) -> tuple[Tensor, ...]:
    """Blocks joined along loads, then shapes, then designs, of each of which there are so many."""
    for dim in (2, 1, 0):
        groups = [parts[start : start + counts[dim]] for start in range(0, len(parts), counts[dim])]
        parts = [tuple(torch.cat(column, dim) for column in zip(*group, strict=True)) for group in groups]
    return parts[0]


def _keep_freed_memory() -> None:
    """Let the C library keep freed blocks of a few megabytes for the next tensor.

    glibc maps large blocks afresh every time until it has seen one of their size freed; each map
    costs a page fault for every 4 kB, which doubles the time of a block of work. Freeing one
    of 30 MB, never touched, settles it.
    """
    torch.empty(30_000_000, dtype=torch.uint8)


def _slices(size: int, step: int) -> Iterator[slice]:
    return (slice(start, start + step) for start in range(0, size, step))
