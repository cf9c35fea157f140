"""What the tables of a study's tasks may hold, each value by itself."""

from typing import Annotated, Any, ClassVar

from pydantic import AfterValidator, Discriminator, Field, Tag

from torcharm.geometry.rod import HANGING, HEADINGS
from torcharm.load import FRAMES
from torcharm.shapes import affine_curvature, constant_curvature, cubic_curvature, helix
from torcharm.study.arm_tables import NamedTable, Names, name_as
from torcharm.study.fields import (
    Check,
    Name,
    Seed,
    Table,
    by_key,
    by_kinds,
    either,
    entries,
    filled,
    one_key,
    one_of,
    one_or_list,
    refuse,
    shown_value,
)
from torcharm.study.units import Angle, Load, Mass, Pose, Position, PositiveLength, Twist
from torcharm.task import WRENCH_PLACES

_length: Any = Field(default=0.5, description="Length of the centreline.", examples=["490 mm"])
_nodes: Any = Field(default=10, description="Elements into which the arm, or its segment, is divided.")
_direction: Any = Field(
    default=None,
    description="Direction across the arm to which it bends, from its left (y) towards z; for a shape in space that is "
    "not straight.",
    examples=["90 deg"],
)
Nodes = Annotated[int, Field(ge=1, le=10_000)]


class AffineShape(Table):
    """A shape whose curvature is affine in the arc s, from 0 at the base to 1 at the tip."""

    twists: ClassVar[Any] = staticmethod(affine_curvature)
    """What makes the shape of the other keys."""
    kind: Annotated[str, one_of(("affine",))] = Field(examples=["affine"])
    """That it is such a shape."""
    slope: Angle = Field(examples=[0.0])
    """Change of the curvature from base to tip."""
    intercept: Angle = Field(examples=[1.0, "60 deg"])
    """Curvature at the base."""
    length: PositiveLength = _length
    nodes: Nodes = _nodes
    direction: Angle | None = _direction


class CubicShape(AffineShape):
    """A shape of curvature cubic s³ + quadratic s² + slope s + intercept."""

    twists: ClassVar[Any] = staticmethod(cubic_curvature)
    kind: Annotated[str, one_of(("cubic",))] = Field(examples=["cubic"])
    """That it is such a shape."""
    cubic: Angle = Field(examples=[4.0])
    """Factor of s³."""
    quadratic: Angle = Field(examples=[-6.0])
    """Factor of s²."""


class ConstantShape(Table):
    """An arc of a circle."""

    twists: ClassVar[Any] = staticmethod(constant_curvature)
    kind: Annotated[str, one_of(("constant",))] = Field(examples=["constant"])
    """That it is such a shape."""
    curvature: Angle = Field(examples=["60 deg"])
    """Angle by which it turns from base to tip."""
    length: PositiveLength = _length
    nodes: Nodes = _nodes
    direction: Angle | None = _direction


class HelixShape(Table):
    """A helix in space: its bend goes round the backbone, which does not twist."""

    twists: ClassVar[Any] = staticmethod(helix)
    kind: Annotated[str, one_of(("helix",))] = Field(examples=["helix"])
    """That it is such a shape."""
    curvature: Angle = Field(examples=["90 deg"])
    """Of the centreline, times its length."""
    torsion: Angle = Field(examples=["180 deg"])
    """Angle by which the bend goes round."""
    length: PositiveLength = _length
    nodes: Nodes = _nodes
    direction: Angle = 0.0
    """Direction to which it bends at the base, from the arm's left (y) towards z."""


ShapeTable: Any = by_kinds(AffineShape, CubicShape, ConstantShape, HelixShape)
ShapesTable: Any = one_or_list(
    ShapeTable, Annotated[list[ShapeTable], filled("a list of shapes, one for each segment")]
)


def _check_not_negative(value: list[float]) -> list[float]:
    if min(value) < 0:
        raise refuse(f"must be numbers of at least 0, got {shown_value(value)}")
    return value


_SHARE = "a share of its segment, a number from 0 (start) to 1 (end)"


def _check_share(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= 1:
        raise refuse(f"must be {_SHARE}, got {shown_value(value)}")
    return value


class DrawnLoads(Table):
    """Random loads at the tip, each component even between minus and plus half its scale."""

    count: Annotated[int, Field(ge=1, le=1_000_000)] = Field(examples=[40])
    """How many."""
    scale: Annotated[Load, AfterValidator(_check_not_negative)] = Field(
        default=[20.0, 20.0, 2.0], examples=[[4.0, 4.0, 0.4]]
    )
    """The width in which each component lies, at least 0; in space six."""
    seed: Seed = 100
    """Of the draw: the same gives the same loads."""


LoadsTable: Any = one_or_list(
    DrawnLoads,
    Annotated[list[Load], filled("at least one load [f_x, f_y, m]")],
    "a list of [f_x, f_y, m], in space of six, or a table with count, scale and seed",
    *(list, dict),
)
At = Annotated[float, Check(_check_share, words=_SHARE)]
_at: Any = Field(default=1.0, description="Place on its segment, as a share of its length.", examples=[0.5])
_segment: Any = Field(
    default=None,
    description="Number of the segment on which it sits, from the base on; without it the last.",
    examples=[1],
)
_Count = Annotated[int, Field(ge=1)]


class PayloadTable(Table):
    """A mass on the arm, which weighs."""

    mass: Mass = Field(examples=["100 g"])
    """How much."""
    at: At = _at
    segment: _Count | None = _segment


class PointTable(Table):
    """A force and a moment at a place of the arm."""

    wrench: Load = Field(examples=[[1.0, 0.0, 0.0]])
    """Force and moment, as of loads."""
    at: At = _at
    segment: _Count | None = _segment
    frame: Annotated[str, one_of(FRAMES)] = Field(default="world", examples=["body"])
    """Whether the directions are the world's, or turn with the arm."""


class PoseTable(Table):
    """A pose in space in words: where it is, where it points, and how far it is turned about that."""

    stands_alone: ClassVar[bool] = False
    position: Position = Field(examples=[["100 mm", "-300 mm", "50 mm"]])
    """Its place in the world."""
    direction: Annotated[list[float], entries("x", "y", "z")] = Field(examples=[[0.5, -1.0, 0.2]])
    """Where the arm's centreline points there, in the world: a vector of any length."""
    turn: Angle = Field(default=0.0, examples=["30 deg"])
    """Angle about that direction. At 0 a tip is turned as an arm has it that bends in one plane from its base, and a
    base as one that hangs and is tilted to the direction."""


def _by_form(value: Any) -> str:
    if isinstance(value, dict | str):
        return "<table>" if isinstance(value, dict) else "<name>"
    return "<matrix>" if isinstance(value, list) and any(isinstance(row, list) for row in value) else "<pose>"


_Matrix = Annotated[
    list[Annotated[list[float], entries("x axis", "y axis", "z axis", "position")]],
    entries("row 1", "row 2", "row 3", "row 4"),
]
IN_SPACE = "a table of position, direction and turn, or the four rows of a homogeneous matrix [m]"
_POSE = f"a list [x, y, θ], or in space {IN_SPACE}"
_Forms: Any = (
    Annotated[PoseTable, Tag("<table>")] | Annotated[_Matrix, Tag("<matrix>")] | Annotated[Pose, Tag("<pose>")]
)
TipPose: Any = Annotated[_Forms, Discriminator(_by_form), either(_POSE, list, dict)]
BasePose: Any = Annotated[
    Annotated[str, one_of(tuple(HEADINGS)), Tag("<name>")] | _Forms,
    Discriminator(_by_form),
    either(f"{', '.join(HEADINGS)}, {_POSE}", str, list, dict),
]
base_pose: Any = Field(
    default=HANGING,
    description="Where the arm's base is: hanging, upright or horizontal at the origin; in the plane a list [x, y, θ] "
    "of its place and heading, in space a table, or the four rows of a homogeneous matrix.",
    examples=[
        "upright",
        [0.0, 0.0, "-90 deg"],
        {"position": [0.0, "20 mm", 0.0], "direction": [1.0, -1.0, 0.0]},
        [[0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]],
    ],
)


class WeighedTable(NamedTable):
    """What is loaded along the arm."""

    gravity: bool = Field(default=False, examples=[True])
    """Whether arm, links and payloads weigh: 9.81 m/s² down (-y)."""
    payloads: list[PayloadTable] | None = Field(default=None, examples=[[{"mass": "100 g", "at": 0.5}]])
    """Masses on the arm; they need gravity."""
    points: list[PointTable] | None = Field(
        default=None, examples=[[{"wrench": [1.0, 0.0, 0.0], "at": 0.5, "frame": "body"}]]
    )
    """Further forces and moments, along the arm."""


class LoadedTable(WeighedTable):
    """What tasks have beside a shape."""

    loads: LoadsTable | None = Field(default=None, examples=[[[0.0, 0.0, 0.0], [1.0, "-200 gf", 0.1]]])
    """Loads at the tip in the world frame, x right, y up and z to the viewer: forces, and the moment; in space six
    numbers. Without it, none."""
    base_pose: BasePose = base_pose
    wrench_at: Annotated[str, one_of(WRENCH_PLACES)] = Field(default="middle", examples=["start"])
    """Where on its element a node's wrench is taken; the start is the paper's, and less exact."""
    arms: Names | None = Field(default=None, examples=[["paper", "own"]])
    """The arms that are to hold it. Without it, all."""


class ShapedTask(LoadedTable):
    """A task: a shape by name, and the loads to hold it under."""

    name: Name = name_as("bend")
    shape: ShapesTable
    """The centreline to hold; of an arm of segments a list, one for each."""


class TwistTask(LoadedTable):
    """A task whose shape is given element by element."""

    name: Name = name_as("twists")
    twists: Annotated[list[Twist], filled("a list of [l, γ, κ], one for each node")] = Field(
        examples=[[[0.48, 0.0, 1.0], [0.48, 0.0, "30 deg"], [0.48, 0.0, 0.0]]]
    )
    """Length, shear and curvature of each element from the base on, as if all the arm, or its segment, were like it; in
    space six numbers [l, γ_y, γ_z, κ_x, κ_y, κ_z]."""
    segment_nodes: Annotated[list[_Count], filled("a list of numbers")] | None = Field(default=None, examples=[[3]])
    """How many of these each segment has; without it, the arm is one."""


TaskTable = Annotated[
    Annotated[ShapedTask, Tag("<shape>")] | Annotated[TwistTask, Tag("<without>")],
    by_key("shape"),
    one_key("shape", "twists"),
]
