"""What a study may hold as a pose, and the pose that comes of it."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import torch
from pydantic import Field

from torcharm.attainability.questions import question_about_pose
from torcharm.geometry import se3
from torcharm.geometry.rod import HEADINGS, as_base
from torcharm.study.data import Pose
from torcharm.study.fields import Table, checked, chosen, either, entries, one_of, shown_value
from torcharm.study.units import Angle, PlanarPose, Position

STRAIGHT_BACK = 1e-6
"""Sine of the angle from straight back below which a direction leaves the plane of bending to rounding."""


class PoseTable(Table):
    """A pose in space in words: where it is, where it points, and how far it is turned about that."""

    stands_alone: ClassVar[bool] = False
    position: Position = Field(examples=[["100 mm", "-300 mm", "50 mm"]])
    """Its place in the world."""
    direction: Annotated[list[float], entries("xyz")] = Field(examples=[[0.5, -1.0, 0.2]])
    """Where the arm's centreline points there, in the world: a vector of any length."""
    turn: Angle = Field(default=0.0, examples=["30 deg"])
    """Angle about that direction. At 0 a tip is turned as an arm has it that bends in one plane from its base, and a
    base as one that hangs and is tilted to the direction."""


def _form(value: Any) -> str:
    if isinstance(value, dict | str):
        return "table" if isinstance(value, dict) else "name"
    return "matrix" if isinstance(value, list) and any(isinstance(row, list) for row in value) else "pose"


_Matrix = Annotated[
    list[Annotated[list[float], entries(("x axis", "y axis", "z axis", "position"))]],
    entries(("row 1", "row 2", "row 3", "row 4")),
    checked(lambda rows: question_about_pose([row[3] for row in rows[:3]])),
]

IN_SPACE = "a table of position, direction and turn, or the four rows of a homogeneous matrix [m]"
_POSE = f"a list [x, y, θ], or in space {IN_SPACE}"
_FORMS: dict[str, Any] = {"table": PoseTable, "matrix": _Matrix, "pose": PlanarPose}
TipPose: Any = Annotated[chosen(_form, _FORMS), either(_POSE, list, dict)]
BasePose: Any = Annotated[
    chosen(_form, {"name": Annotated[str, one_of(tuple(HEADINGS))]} | _FORMS),
    either(f"{', '.join(HEADINGS)}, {_POSE}", str, list, dict),
]


def check_columns(field: str, given: int, columns: int, why: Mapping[int, str]) -> None:
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
        ValueError: the direction is none, or straight back, so that no plane is known in which to bend.
    """
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
