"""Every design against every task: what the two batches are flattened to, and how they are put together again."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain, product
from math import prod
from typing import Any

import torch
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries, RigidLink, segments_of
from torcharm.inputs import refuse_transforms, shown
from torcharm.load import ExternalLoad
from torcharm.statics.cross_section import RANGE_SLACK, CrossSections, cross_sections, per_actuator
from torcharm.statics.external_load import HULL, required_wrench
from torcharm.task import Task

Arm = ArmDesign | ArmSeries


@dataclass(frozen=True, eq=False)
class DesignTaskGrid:
    """B designs × P shapes × L loads a shape.

    Task dimensions along which only the load varies are load dimensions; all others make shapes, so that what
    depends on the shape alone is worked out once for all loads on it.

    Attributes:
        segments: the designs' segments, each with B designs; one of an arm that is not in series.
        nodes: of each segment, its part of the nodes.
        twists: (P, N, 3 or 6).
        external: (P, L, N, C) hull wrenches that loads ask of the nodes, in their frames [N, N·m].
        unit_weight: (S, P, N, C) the same of 1 kg of each of S segments; S is 0 without gravity or mass.
        mass: (B, S) of the designs' segments [kg].
        design_batch, shape_batch, load_batch: what was flattened.
        task_axes: for each task dimension, its place among shape and load dimensions.
    """

    segments: tuple[ArmDesign, ...]
    nodes: tuple[slice, ...]
    twists: Tensor
    external: Tensor
    unit_weight: Tensor
    mass: Tensor
    design_batch: tuple[int, ...]
    shape_batch: tuple[int, ...]
    load_batch: tuple[int, ...]
    task_axes: tuple[int, ...]

    @property
    def sizes(self) -> tuple[int, int, int]:
        """(B, P, L)."""
        return prod(self.design_batch), prod(self.shape_batch), prod(self.load_batch)

    def sections(self, segment: int, designs: slice, shapes: slice) -> CrossSections:
        """The cross-sections (B, P) of some designs of a segment on some shapes."""
        arm = self.segments[segment]
        return cross_sections(arm[designs, None], self.twists[shapes, self.nodes[segment]]).for_sets()

    def required(self, designs: slice, shapes: slice, loads: slice, nodes: slice) -> Tensor:
        """(B, P, L, N, C) what some nodes require of some designs, under loads and their own weight."""
        found, mass = self.external[shapes, loads, nodes], self.mass[designs]
        for own, unit in zip(mass.unbind(-1), self.unit_weight[:, shapes, nodes], strict=True):
            found = found + own.view(-1, 1, 1, 1, 1) * unit.unsqueeze(-3)
        return found.expand(len(mass), *found.shape[-4:])

    def unflatten(self, value: Tensor) -> Tensor:
        """(B, P, L, ...) as (*design batch, *task batch, ...)."""
        value = value.reshape((*self.design_batch, *self.shape_batch, *self.load_batch, *value.shape[3:]))
        lead, tasks = len(self.design_batch), len(self.task_axes)
        order = [*range(lead), *(lead + axis for axis in self.task_axes), *range(lead + tasks, value.ndim)]
        return value.permute(order)


def fitted(arm: object, task: object) -> tuple[Arm, Task]:
    """An arm and a task that fit: of one dimension, device and number of segments; in one dtype, as torch promotes.

    Raises:
        ValueError: they do not fit.
    """
    refuse_transforms("arm, task")
    if not isinstance(arm, (ArmDesign, ArmSeries)):
        raise ValueError(f"arm: must be an ArmDesign or an ArmSeries, got {shown(arm)}")
    if not isinstance(task, Task):
        raise ValueError(f"task: must be of type Task, got {shown(task)}")
    if arm.dimension != task.dimension:
        raise ValueError(f"task: must be of the arm's dimension, {arm.dimension}, got {task.dimension}")
    segments, links = segments_of(arm)
    if len(task.segment_nodes or (0,)) != len(segments):
        named = shown(task.segment_nodes) if task.segment_nodes else "none"
        raise ValueError(f"segment_nodes: must hold one number for each of {len(segments)} segments, got {named}")
    _check_links(links)
    ours, theirs = segments[0].radii, task.twists
    if ours.device != theirs.device:
        raise ValueError(
            f"task: must be on the arm's device, {ours.device}, got {theirs.device}; use task.to({str(ours.device)!r})"
        )
    if ours.dtype == theirs.dtype:
        return arm, task
    dtype = torch.promote_types(ours.dtype, theirs.dtype)
    return arm.to(dtype), task.to(dtype)


def design_task_grid(arm: Arm, task: Task) -> DesignTaskGrid:
    """Flatten designs and tasks, telling the dimensions of shapes from those of loads.

    Raises:
        ValueError: they do not fit.
    """
    arm, task = fitted(arm, task)
    segments = flat_segments(arm)
    counts = task.segment_nodes or (task.nodes,)
    ends = torch.tensor(counts).cumsum(0).tolist()
    nodes = tuple(slice(end - count, end) for end, count in zip(ends, counts, strict=True))

    batch = tuple(task.batch_shape)
    missing = len(batch) - (task.twists.ndim - 2)
    sizes = (*(1,) * missing, *task.twists.shape[:-2])
    strides = (*(0,) * missing, *task.twists.stride()[:-2])
    shared = [size == 1 or stride == 0 for size, stride in zip(sizes, strides, strict=True)]
    shapes = [axis for axis, alike in enumerate(shared) if not alike]
    order = shapes + [axis for axis, alike in enumerate(shared) if alike]

    twists = task.twists.reshape(*sizes, *task.twists.shape[-2:])
    for axis, alike in enumerate(shared):
        if alike:
            twists = twists.narrow(axis, 0, min(1, twists.shape[axis]))
    shape_batch = tuple(batch[axis] for axis in shapes)
    load_batch = tuple(batch[axis] for axis in order[len(shapes) :])
    count = len(batch)
    return DesignTaskGrid(
        segments,
        nodes,
        twists.permute(*order, count, count + 1).reshape(-1, *task.twists.shape[-2:]),
        *_required(arm, task, segments, batch, order, prod(shape_batch), prod(load_batch)),
        tuple(arm.batch_shape),
        shape_batch,
        load_batch,
        tuple(order.index(axis) for axis in range(count)),
    )


def _required(
    arm: Arm, task: Task, segments: tuple[ArmDesign, ...], batch: tuple[int, ...], order: list[int], P: int, L: int
) -> tuple[Tensor, Tensor, Tensor]:
    """What the task's loads ask for, what a kilogram of each segment would, and the masses (B, S) [kg]."""
    columns = HULL[task.twists.shape[-1]]
    links = arm.links if isinstance(arm, ArmSeries) else None
    options: dict[str, Any] = {"wrench_at": task.wrench_at, "segment_nodes": task.segment_nodes}

    def flat(wrench: Tensor, loads: int) -> Tensor:
        wrench = wrench[..., columns].expand(*batch, *wrench.shape[-2:-1], len(columns))
        count = len(batch)
        return wrench.permute(*order, count, count + 1).reshape(P, L, *wrench.shape[-2:])[:, :loads]

    external = flat(required_wrench(task.twists, task.load, task.base_pose, links=links, **options), L)
    mass = torch.stack([segment.mass for segment in segments], -1)
    if not task.load.gravity or not (mass.requires_grad or bool((mass != 0).any())):
        return external, external.new_zeros(0, P, *external.shape[-2:]), mass[:, :0]
    bare, units = ExternalLoad(gravity=True), []
    weightless = None if links is None else without_link_masses(arm).links  # type: ignore[union-attr]
    for index in range(len(segments)):
        own = [1.0 if index == other else 0.0 for other in range(len(segments))]
        units.append(required_wrench(task.twists, bare, task.base_pose, mass=own, links=weightless, **options))
    return external, torch.stack([flat(unit, 1)[:, 0] for unit in units]), mass


def without_link_masses(arm: Arm) -> Arm:
    """The same arm, of which the links weigh nothing."""
    if isinstance(arm, ArmDesign):
        return arm
    return ArmSeries(arm.segments, tuple(link and link.without_mass() for link in arm.links))


def _check_links(links: Sequence[RigidLink | None]) -> None:
    """Raise a ValueError if a link differs from design to design, which nothing here could tell from task to task."""
    for index, link in enumerate(links):
        if link is not None and (
            link.mass.ndim or link.end(link.dimension or 2).ndim > (2 if link.dimension == 3 else 1)
        ):
            raise ValueError(f"links[{index}]: must be one link for all designs, got a batch, {link!r}")


def flat_segments(arm: Arm) -> tuple[ArmDesign, ...]:
    """The segments, each as a flat batch of all designs."""
    batch, found = arm.batch_shape, []
    for segment in segments_of(arm)[0]:
        if segment.batch_shape != batch:
            whole = segment.radii.expand(*batch, -1)
            length, limit = segment.length.expand_as(whole), segment.max_pressure.expand_as(whole)
            segment = segment.with_values(whole, length, limit)
        found.append(segment.flatten())
    return tuple(found)


def limits_in_range(grid: DesignTaskGrid) -> Tensor:
    """Whether every pressure limit lies in its model's characterised range."""
    inside = []
    for segment in grid.segments:
        highest = per_actuator([model.pressure_range[1] for model in segment.actuators], segment.max_pressure)
        inside.append((segment.max_pressure <= highest + RANGE_SLACK * highest.abs()).all(-1))
    return grid.unflatten(torch.stack(inside).all(0).view(-1, 1, 1).expand(grid.sizes))


def map_chunks(
    grid: DesignTaskGrid, chunk_size: int, work: Callable[[slice, slice, slice], tuple[Tensor, ...]]
) -> tuple[Tensor, ...]:
    """Work on chunks of designs, shapes and loads, and join what is returned.

    Args:
        grid: of which no size is 0.
        chunk_size: (design, shape, load) triples in a chunk.
        work: from slices of designs, shapes and loads to tensors (b, p, l, ...).

    Returns:
        Tensors (B, P, L, ...).
    """
    _keep_freed_memory()
    designs, shapes, loads = grid.sizes
    per_load = min(loads, chunk_size)
    per_shape = min(shapes, max(1, chunk_size // per_load))
    per_design = min(designs, max(1, chunk_size // (per_load * per_shape)))
    steps = [
        [slice(start, min(start + step, size)) for start in range(0, size, step)]
        for size, step in zip(grid.sizes, (per_design, per_shape, per_load), strict=True)
    ]
    places = list(product(*steps))
    first = work(*places[0])
    if len(places) == 1:
        return first
    if any(column.requires_grad for column in first):
        parts = [first, *(work(*place) for place in places[1:])]
        for dim, count in zip((2, 1, 0), (len(step) for step in reversed(steps)), strict=True):
            groups = [parts[start : start + count] for start in range(0, len(parts), count)]
            parts = [tuple(torch.cat(column, dim) for column in zip(*group, strict=True)) for group in groups]
        return parts[0]
    # Copied to their place at once: kept until the end, parts would lie scattered among the freed memory of the work.
    whole = tuple(column.new_empty(*grid.sizes, *column.shape[3:]) for column in first)
    for place, part in zip(places, chain([first], (work(*place) for place in places[1:])), strict=True):
        for column, own in zip(whole, part, strict=True):
            column[place] = own
    return whole


def _keep_freed_memory() -> None:
    """Let the C library keep freed blocks of a few megabytes for the next tensor.

    glibc maps large blocks afresh every time until it has seen one of their size freed; each map costs a page fault for
    every 4 kB, which doubles the time of a chunk. Freeing one of 30 MB, never touched, settles it.
    """
    torch.empty(30_000_000, dtype=torch.uint8)
