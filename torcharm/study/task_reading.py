"""From the tables of tasks to tasks, and whether they fit the arms."""

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from torcharm.attainability.questions import question_about_shape
from torcharm.geometry.rod import HEADINGS
from torcharm.load import ExternalLoad, PointLoad
from torcharm.statics.balance import segments_of
from torcharm.study.data import NamedArm, NamedTask, Pose
from torcharm.study.fields import field_path, shown_value, within
from torcharm.study.task_tables import DrawnLoads, PayloadTable, PointTable, ShapedTask, TwistTask, WeighedTable
from torcharm.task import Task, sample_loads

MOST_VALUES = 50_000_000
"""Numbers that one tensor of a study may hold (400 MB); past it, a key was struck once too often."""
SHAPE_IS = {3: "in the plane, as the shape is (a direction makes it one in space)", 6: "in space, as the shape is"}
"""By the number of columns of a shape, why what stands beside it must be in the plane or in space."""


def make_task(table: ShapedTask | TwistTask) -> NamedTask:
    """The task of a table.

    Raises:
        ValueError: values do not fit each other, make no sense, or are in other units.
    """
    segments, field = _segments(table), shape_field(table)
    for twists in segments:
        question = question_about_shape(twists)
        if question is not None:
            raise ValueError(f'{field}: {question} A text with a unit, such as "48 cm" or "30 deg", is understood')
    columns, nodes = segments[0].shape[-1], [len(twists) for twists in segments]
    loads = _loads(table, columns, sum(nodes))
    check_base(table.base_pose, columns, SHAPE_IS)
    task = Task(
        torch.cat(segments),
        loads,
        table.base_pose if isinstance(table.base_pose, str) else torch.tensor(table.base_pose, dtype=torch.float64),
        ExternalLoad(gravity=table.gravity, points=read_points(table, columns, len(nodes))),
        table.wrench_at,
        nodes if len(nodes) > 1 else None,
    )
    return NamedTask(table.name, task, tuple(table.arms or ()))


def _segments(table: ShapedTask | TwistTask) -> list[Tensor]:
    """Twists of each segment."""
    if isinstance(table, ShapedTask):
        shapes = table.shape if isinstance(table.shape, list) else [table.shape]
        segments = [one.twists(**one.model_dump(exclude={"kind"})) for one in shapes]
        for index, twists in enumerate(segments):
            if twists.shape[-1] != segments[0].shape[-1]:
                raise ValueError(
                    f"{field_path(['shape', index])}.direction: must be given for all segments, or for none"
                )
        return segments
    for index, row in enumerate(table.twists):
        check_columns(field_path(["twists", index]), len(row), len(table.twists[0]))
    twists = torch.tensor(table.twists, dtype=torch.float64)
    counts = table.segment_nodes or [len(twists)]
    if sum(counts) != len(twists):
        raise ValueError(f"segment_nodes: must sum to the {len(twists)} rows of twists, got {shown_value(counts)}")
    return list(twists.split(counts))


def _loads(table: ShapedTask | TwistTask, columns: int, nodes: int) -> Tensor:
    """Tip loads (L, columns)."""
    if table.loads is None:
        return torch.zeros(1, columns, dtype=torch.float64)
    if isinstance(table.loads, DrawnLoads):
        check_columns("loads.scale", len(table.loads.scale), columns)
        check_values("loads.count", table.loads.count * nodes, f"{table.loads.count} loads, {nodes} nodes")
        return sample_loads(table.loads.count, table.loads.scale, table.loads.seed)
    for index, load in enumerate(table.loads):
        check_columns(field_path(["loads", index]), len(load), columns)
    return torch.tensor(table.loads, dtype=torch.float64)


def read_points(table: WeighedTable, columns: int, segments: int) -> list[PointLoad]:
    """Payloads, then other loads along an arm of so many segments."""
    if table.payloads and not table.gravity:
        raise ValueError("gravity: must be true where there are payloads, which it gives their weight, got false")
    points = []
    named: dict[str, Sequence[PayloadTable | PointTable] | None] = {"payloads": table.payloads, "points": table.points}
    for name, listed in named.items():
        for index, one in enumerate(listed or ()):
            with within(field_path([name, index])):
                if one.segment is not None and one.segment > segments:
                    raise ValueError(f"segment: must be at most {segments}, the number of them, got {one.segment}")
                if isinstance(one, PointTable):
                    check_columns("wrench", len(one.wrench), columns)
                segment = -1 if one.segment is None else one.segment - 1
                points.append(PointLoad(**one.model_dump(exclude={"segment"}), segment=segment))
    return points


def check_columns(field: str, given: int, columns: int, why: Mapping[int, str] = SHAPE_IS) -> None:
    """Raise a ValueError unless a load has the components that it must have, for a reason of that number of them."""
    if given != columns:
        raise ValueError(f"{field}: must have {columns} numbers {why[columns]}, got {given}")


def check_base(base_pose: Pose | str, columns: int, why: Mapping[int, str]) -> None:
    """Raise a ValueError unless a base pose is in the plane or in space as it must be, for a reason of either."""
    if not isinstance(base_pose, str) and len(base_pose) != columns // 3 + 2:
        form = "a list [x, y, θ]" if columns == 3 else "four rows of a homogeneous matrix"
        names = ", ".join(HEADINGS)
        raise ValueError(f"base_pose: must be {names} or {form} {why[columns]}, got {shown_value(base_pose)}")


def shape_field(table: ShapedTask | TwistTask) -> str:
    """The key that holds the shape."""
    return "twists" if isinstance(table, TwistTask) else "shape"


def check_fit(field: str, task: Task, arm: NamedArm) -> None:
    """Raise a ValueError that names the field unless a task's shape has the dimension and the segments of an arm."""
    name, segments = shown_value(arm.name), len(segments_of(arm.design)[0])
    if task.dimension != arm.design.dimension:
        where = "the plane" if arm.design.dimension == 2 else "space (with a direction, or twists of six columns)"
        raise ValueError(f"{field}: must be in {where}, as the arm {name} is, or name its own arms")
    own = len(task.segment_nodes or (0,))
    if own != segments:
        form = "a list of shapes" if field == "shape" else "rows of which segment_nodes says the number"
        raise ValueError(f"{field}: must be {form} for each of the {segments} segments of the arm {name}, got {own}")


def check_values(name: str, count: int, given: str) -> None:
    """Raise unless a tensor of so many values can be held."""
    if count > MOST_VALUES:
        raise ValueError(f"{name}: must make at most {MOST_VALUES:.0e} numbers at once, got {count:.0e} from {given}")
