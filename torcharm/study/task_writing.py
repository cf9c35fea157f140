"""From tasks to the text of a study file."""

from collections.abc import Iterator
from typing import Any

import torch

from torcharm.characterise.toml_text import toml_entry
from torcharm.geometry.rod import HANGING, HEADINGS, as_base
from torcharm.inputs import shown
from torcharm.load import PointLoad
from torcharm.study.data import NamedTask
from torcharm.task import Task


def task_to_toml(named: NamedTask) -> str:
    """A task as a `[[task]]` table to paste into a study, from which the same task is read, number by number.

    Args:
        named: one shape under any number of tip loads, and the names of the task and of its arms.

    Raises:
        ValueError: the task has several shapes or bases, or point loads in a batch.
    """
    task = named.task
    many = [
        point for point in task.load.points if point.mass.ndim or (point.wrench is not None and point.wrench.ndim > 1)
    ]
    if task.twists.ndim > 2 or task.base_pose.ndim > task.dimension - 1 or many:
        raise ValueError(f"task: must have one shape, one base and one of each point load, got {shown(task)}")
    table: dict[str, Any] = {"name": named.name}
    if named.arms:
        table["arms"] = list(named.arms)
    table["twists"] = task.twists.tolist()
    if task.segment_nodes is not None:
        table["segment_nodes"] = list(task.segment_nodes)
    table |= _loads(task)
    base = _base(task)
    if base != HANGING:
        table["base_pose"] = base
    if task.wrench_at != "middle":
        table["wrench_at"] = task.wrench_at
    return "\n".join(["[[task]]", *(toml_entry(key, value) for key, value in table.items()), ""])


def _loads(task: Task) -> Iterator[tuple[str, Any]]:
    """The keys of all that loads the arm."""
    load = task.load
    if load.tip is not None:
        yield "loads", load.tip.reshape(-1, load.tip.shape[-1]).tolist()
    if load.gravity:
        yield "gravity", True
    payloads = [{"mass": point.mass.item(), **_place(point)} for point in load.points if bool(point.mass)]
    if payloads:
        yield "payloads", payloads
    points = [
        {"wrench": point.wrench.tolist(), **_place(point), "frame": point.frame}
        for point in load.points
        if point.wrench is not None
    ]
    if points:
        yield "points", points


def _place(point: PointLoad) -> dict[str, Any]:
    """Where a point load sits; of segments, that are counted from 1 here, the last is left out."""
    return {"at": point.at} | ({"segment": point.segment + 1} if point.segment >= 0 else {})


def _base(task: Task) -> str | list[Any]:
    """The base pose, by name if it has one."""
    for name in HEADINGS:
        if torch.equal(as_base(name, task.twists, task.twists.shape[-1]), task.base_pose):
            return name
    numbers: list[Any] = task.base_pose.tolist()
    return numbers
