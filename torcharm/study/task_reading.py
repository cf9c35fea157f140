"""From the tables of tasks to tasks, and whether they fit the arms."""

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from torcharm.attainability.questions import question_about_mass, question_about_pose, question_about_shape
from torcharm.geometry import se3
from torcharm.geometry.rod import HEADINGS, as_base
from torcharm.load import ExternalLoad, PointLoad
from torcharm.statics.balance import segments_of
from torcharm.study.data import NamedArm, NamedTask, Pose
from torcharm.study.fields import ask, field_path, shown_value, within
from torcharm.study.task_tables import (
    IN_SPACE,
    AffineShape,
    ConstantShape,
    DrawnLoads,
    HelixShape,
    PayloadTable,
    PointTable,
    PoseTable,
    ShapedTask,
    TwistTask,
    WeighedTable,
)
from torcharm.task import Task, sample_loads

MOST_VALUES = 50_000_000
"""Numbers that one tensor of a study may hold (400 MB); past it, a key was struck once too often."""
STRAIGHT_BACK = 1e-6
"""Sine of the angle from straight back below which a direction leaves the plane of bending to rounding."""
SHAPE_IS = {3: "in the plane, as the shape is (a direction makes it one in space)", 6: "in space, as the shape is"}
"""By the number of columns of a shape, why what stands beside it must be in the plane or in space."""


def make_task(table: ShapedTask | TwistTask, dimension: int = 2) -> NamedTask:
    """The task of a table, for arms of a dimension, so that a straight shape needs no direction in space."""
    segments, field = _segments(table, dimension), shape_field(table)
    for twists in segments:
        ask(field, question_about_shape(twists), ' A text with a unit, such as "48 cm" or "30 deg", is understood')
    columns, nodes = segments[0].shape[-1], [len(twists) for twists in segments]
    loads = _loads(table, columns, sum(nodes))
    base = read_base(table.base_pose, columns, SHAPE_IS)
    task = Task(
        torch.cat(segments),
        loads,
        base if isinstance(base, str) else torch.tensor(base, dtype=torch.float64),
        ExternalLoad(gravity=table.gravity, points=read_points(table, columns, len(nodes))),
        table.wrench_at,
        nodes if len(nodes) > 1 else None,
    )
    return NamedTask(table.name, task, tuple(table.arms or ()))


def _segments(table: ShapedTask | TwistTask, dimension: int) -> list[Tensor]:
    """Twists of each segment."""
    if isinstance(table, ShapedTask):
        shapes = table.shape if isinstance(table.shape, list) else [table.shape]
        in_space = dimension == 3 or any(one.direction is not None for one in shapes)
        segments = [_twists(one, in_space) for one in shapes]
        for index, twists in enumerate(segments):
            if twists.shape[-1] != segments[0].shape[-1]:
                raise ValueError(
                    f"{field_path(['shape', index])}.direction: must be given for all segments that bend, or for none"
                )
        return segments
    for index, row in enumerate(table.twists):
        check_columns(field_path(["twists", index]), len(row), len(table.twists[0]))
    twists = torch.tensor(table.twists, dtype=torch.float64)
    counts = table.segment_nodes or [len(twists)]
    if sum(counts) != len(twists):
        raise ValueError(f"segment_nodes: must sum to the {len(twists)} rows of twists, got {shown_value(counts)}")
    return list(twists.split(counts))


def _twists(shape: AffineShape | ConstantShape | HelixShape, in_space: bool) -> Tensor:
    """Of one segment; what is straight bends to no direction, and needs none to be in space."""
    given = shape.model_dump(exclude={"kind"})
    twists: Tensor = shape.twists(**given)
    straight = twists.shape[-1] == 3 and not bool(twists[:, 2].any())
    return shape.twists(**given | {"direction": 0.0}) if in_space and straight else twists


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
                if isinstance(one, PayloadTable):
                    ask("mass", question_about_mass(one.mass))
                else:
                    check_columns("wrench", len(one.wrench), columns)
                segment = -1 if one.segment is None else one.segment - 1
                points.append(PointLoad(**one.model_dump(exclude={"segment"}), segment=segment))
    return points


def check_columns(field: str, given: int, columns: int, why: Mapping[int, str] = SHAPE_IS) -> None:
    """Raise a ValueError unless a load has the components that it must have, for a reason of that number of them."""
    if given != columns:
        raise ValueError(f"{field}: must have {columns} numbers {why[columns]}, got {given}")


def columns_of(pose: Pose | PoseTable) -> int:
    """Columns of twists in the plane, or in space, where a pose is."""
    return 6 if isinstance(pose, PoseTable) or len(pose) == 4 else 3


def read_base(base_pose: Pose | PoseTable | str, columns: int, why: Mapping[int, str]) -> Pose | str:
    """A base pose, which must be in the plane or in space for a reason of either; a table as the rows of its matrix."""
    if isinstance(base_pose, str):
        return base_pose
    if columns_of(base_pose) != columns:
        form = "a list [x, y, θ]" if columns == 3 else IN_SPACE
        given = "a table" if isinstance(base_pose, PoseTable) else shown_value(base_pose)
        names = ", ".join(HEADINGS)
        raise ValueError(f"base_pose: must be {names} or {form} {why[columns]}, got {given}")
    return read_pose("base_pose", base_pose, None)


def read_pose(field: str, pose: Pose | PoseTable, start: Pose | str | None) -> Pose:
    """A pose as numbers; a table as the rows of a homogeneous matrix.

    Args:
        field: that holds the pose.
        pose: as the study has it.
        start: from which a direction is reached by bending in one plane, which a turn of 0 stands for; None hangs.

    Raises:
        ValueError: the direction is none, or straight back, so that no plane is known in which to bend; or
            the place is in other units.
    """
    place: Sequence[float] = ()
    if isinstance(pose, PoseTable):
        place = pose.position
    elif len(pose) == 4:
        place = [row[3] for row in pose[:3]]  # type: ignore[index]
    ask(field, question_about_pose(place))
    if not isinstance(pose, PoseTable):
        return pose
    base = torch.as_tensor(as_base(start, torch.zeros((), dtype=torch.float64), 6), dtype=torch.float64)
    towards, ahead = torch.tensor(pose.direction, dtype=torch.float64), base[:3, 0]
    if not bool(towards.any()):
        raise ValueError(f"{field}.direction: must be a vector that is not 0, got {shown_value(pose.direction)}")
    towards = towards / torch.linalg.vector_norm(towards)
    across = torch.linalg.cross(ahead, towards)
    sine, cosine = torch.linalg.vector_norm(across), ahead @ towards
    if float(cosine) < 0 and float(sine) < STRAIGHT_BACK:
        raise ValueError(
            f"{field}.direction: must not be straight back, as no plane is known then in which to bend, "
            f"got {shown_value(pose.direction)}; the four rows of a homogeneous matrix say it"
        )
    bend = across * (torch.atan2(sine, cosine) / sine if float(sine) > 0 else 0.0)
    turn = torch.tensor([pose.turn, 0.0, 0.0], dtype=torch.float64)
    found = se3.exp(torch.cat((torch.zeros(3).double(), bend))) @ base @ se3.exp(torch.cat((0 * turn, turn)))
    found[:3, 3] = torch.tensor(pose.position, dtype=torch.float64)
    rows: list[list[float]] = found.tolist()
    return rows


def shape_field(table: ShapedTask | TwistTask) -> str:
    """The key that holds the shape."""
    return "twists" if isinstance(table, TwistTask) else "shape"


def check_fit(field: str, task: Task, arm: NamedArm) -> None:
    """Raise a ValueError that names the field unless a task's shape has the dimension and the segments of an arm."""
    name, segments = shown_value(arm.name), len(segments_of(arm.design)[0])
    if task.dimension != arm.design.dimension:
        where = "the plane" if arm.design.dimension == 2 else "space (with a direction, or twists of six columns)"
        raise ValueError(f"{field}: must be in {where}, as the arm {name} is, or name its own arms")
    own = len(task.nodes_of_segments)
    if own != segments:
        form = "a list of shapes" if field == "shape" else "rows of which segment_nodes says the number"
        raise ValueError(f"{field}: must be {form} for each of the {segments} segments of the arm {name}, got {own}")


def check_values(name: str, count: int, given: str) -> None:
    """Raise unless a tensor of so many values can be held."""
    if count > MOST_VALUES:
        raise ValueError(f"{name}: must make at most {MOST_VALUES:.0e} numbers at once, got {count:.0e} from {given}")
