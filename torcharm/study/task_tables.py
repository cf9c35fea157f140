"""What the tables of a study's tasks may hold, and the tasks that come of them."""

from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar

import torch
from pydantic import Field
from torch import Tensor

from torcharm.arm_series import segments_of
from torcharm.attainability.questions import question_about_shape
from torcharm.geometry.rod import HANGING
from torcharm.load import FRAMES, ExternalLoad, PointLoad
from torcharm.shapes import affine_curvature, constant_curvature, cubic_curvature, helix
from torcharm.study.arm_tables import NamedTable, Names, name_as
from torcharm.study.data import NamedArm, NamedTask
from torcharm.study.fields import (
    Name,
    Seed,
    Table,
    by_key,
    by_kinds,
    checked,
    either,
    field_path,
    filled,
    listed,
    must_be,
    one_of,
    one_or_list,
    shown_value,
    within,
)
from torcharm.study.pose_tables import BasePose, check_columns, read_base
from torcharm.study.units import Angle, Load, Mass, PositiveLength, Twist
from torcharm.task import WRENCH_PLACES, Task, sample_loads

MOST_VALUES = 50_000_000
"""Numbers that one tensor of a study may hold (400 MB); past it, a key was struck once too often."""
SHAPE_IS = {3: "in the plane, as the shape is (a direction makes it one in space)", 6: "in space, as the shape is"}
"""By the number of columns of a shape, why what stands beside it must be in the plane or in space."""


class ShapeTable(Table):
    """The centreline of an arm, or of one of its segments.

    Class attributes:
        make: what makes the shape of the other keys.
    """

    make: ClassVar[Callable[..., Tensor]]
    kind: str
    length: PositiveLength = Field(default=0.5, examples=["490 mm"])
    """Length of the centreline."""
    nodes: Annotated[int, Field(ge=1, le=10_000)] = 10
    """Elements into which the arm, or its segment, is divided."""
    direction: Angle | None = Field(default=None, examples=["90 deg"])
    """Direction across the arm to which it bends, from its left (y) towards z; for a shape in space that is not
    straight."""

    def twists(self, in_space: bool) -> Tensor:
        """Of one segment; what is straight bends to no direction, and needs none to be in space."""
        given = self.model_dump(exclude={"kind"})
        twists = self.make(**given)
        straight = twists.shape[-1] == 3 and not bool(twists[:, 2].any())
        return self.make(**given | {"direction": 0.0}) if in_space and straight else twists


class AffineShape(ShapeTable):
    """A shape whose curvature is affine in the arc s, from 0 at the base to 1 at the tip."""

    make: ClassVar[Callable[..., Tensor]] = staticmethod(affine_curvature)
    kind: Annotated[str, one_of(("affine",))] = Field(examples=["affine"])
    """That it is such a shape."""
    slope: Angle = Field(examples=[0.0])
    """Change of the curvature from base to tip."""
    intercept: Angle = Field(examples=[1.0, "60 deg"])
    """Curvature at the base."""


class CubicShape(AffineShape):
    """A shape of curvature cubic s³ + quadratic s² + slope s + intercept."""

    make: ClassVar[Callable[..., Tensor]] = staticmethod(cubic_curvature)
    kind: Annotated[str, one_of(("cubic",))] = Field(examples=["cubic"])
    """That it is such a shape."""
    cubic: Angle = Field(examples=[4.0])
    """Factor of s³."""
    quadratic: Angle = Field(examples=[-6.0])
    """Factor of s²."""


class ConstantShape(ShapeTable):
    """An arc of a circle."""

    make: ClassVar[Callable[..., Tensor]] = staticmethod(constant_curvature)
    kind: Annotated[str, one_of(("constant",))] = Field(examples=["constant"])
    """That it is such a shape."""
    curvature: Angle = Field(examples=["60 deg"])
    """Angle by which it turns from base to tip."""


class HelixShape(ShapeTable):
    """A helix in space: its bend goes round the backbone, which does not twist."""

    make: ClassVar[Callable[..., Tensor]] = staticmethod(helix)
    kind: Annotated[str, one_of(("helix",))] = Field(examples=["helix"])
    """That it is such a shape."""
    curvature: Angle = Field(examples=["90 deg"])
    """Of the centreline, times its length."""
    torsion: Angle = Field(examples=["180 deg"])
    """Angle by which the bend goes round."""
    direction: Angle = 0.0
    """Direction to which it bends at the base, from the arm's left (y) towards z."""


AnyShape: Any = by_kinds(AffineShape, CubicShape, ConstantShape, HelixShape)
ShapesTable: Any = one_or_list(AnyShape, Annotated[list[AnyShape], filled("a list of shapes, one for each segment")])


def _negative(value: list[float]) -> str | None:
    return f"must be numbers of at least 0, got {shown_value(value)}" if min(value) < 0 else None


class DrawnLoads(Table):
    """Random loads at the tip, each component even between minus and plus half its scale."""

    count: Annotated[int, Field(ge=1, le=1_000_000)] = Field(examples=[40])
    """How many."""
    scale: Annotated[Load, checked(_negative)] = Field(default=[20.0, 20.0, 2.0], examples=[[4.0, 4.0, 0.4]])
    """The width in which each component lies, at least 0; in space six."""
    seed: Seed = 100
    """Of the draw: the same gives the same loads."""


LoadsTable: Any = Annotated[
    one_or_list(DrawnLoads, Annotated[list[Load], filled("at least one load [f_x, f_y, m]")]),
    either("a list of [f_x, f_y, m], in space of six, or a table with count, scale and seed", list, dict),
]
_Count = Annotated[int, Field(ge=1)]
_Share = Annotated[
    float,
    must_be(
        "a share of its segment, a number from 0 (start) to 1 (end)",
        lambda value: isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value <= 1,
    ),
]


class PlacedTable(Table):
    """What sits at a place of the arm."""

    at: _Share = Field(default=1.0, examples=[0.5])
    """Place on its segment, as a share of its length."""
    segment: _Count | None = Field(default=None, examples=[1])
    """Number of the segment on which it sits, from the base on; without it the last."""

    def build(self, segments: int) -> PointLoad:
        """The load, on an arm of so many segments."""
        if self.segment is not None and self.segment > segments:
            raise ValueError(f"segment: must be at most {segments}, the number of them, got {self.segment}")
        segment = -1 if self.segment is None else self.segment - 1
        return PointLoad(**self.model_dump(exclude={"segment"}), segment=segment)


class PayloadTable(PlacedTable):
    """A mass on the arm, which weighs."""

    mass: Mass = Field(examples=["100 g"])
    """How much."""


class PointTable(PlacedTable):
    """A force and a moment at a place of the arm."""

    wrench: Load = Field(examples=[[1.0, 0.0, 0.0]])
    """Force and moment, as of loads."""
    frame: Annotated[str, one_of(FRAMES)] = Field(default="world", examples=["body"])
    """Whether the directions are the world's, or turn with the arm."""


class WeighedTable(NamedTable):
    """What has a base, and is loaded along the arm."""

    gravity: bool = Field(default=False, examples=[True])
    """Whether arm, links and payloads weigh: 9.81 m/s² down (-y)."""
    payloads: list[PayloadTable] | None = Field(default=None, examples=[[{"mass": "100 g", "at": 0.5}]])
    """Masses on the arm; they need gravity."""
    points: list[PointTable] | None = Field(
        default=None, examples=[[{"wrench": [1.0, 0.0, 0.0], "at": 0.5, "frame": "body"}]]
    )
    """Further forces and moments, along the arm."""
    base_pose: BasePose = Field(
        default=HANGING,
        examples=[
            "upright",
            [0.0, 0.0, "-90 deg"],
            {"position": [0.0, "20 mm", 0.0], "direction": [1.0, -1.0, 0.0]},
            [[0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]],
        ],
    )
    """Where the arm's base is: hanging, upright or horizontal at the origin; in the plane a list [x, y, θ] of its place
    and heading, in space a table, or the four rows of a homogeneous matrix."""
    arms: Names | None = Field(default=None, examples=[["paper", "own"]])
    """The arms that it is for. Without it, all; of a plan, all in the plane or in space as tip_pose is."""

    def load(self, tip: Any, columns: int, segments: int, why: Mapping[int, str]) -> ExternalLoad:
        """What loads an arm of so many segments, by wrenches of so many components for a reason of their number."""
        if self.payloads and not self.gravity:
            raise ValueError("gravity: must be true where there are payloads, which it gives their weight, got false")
        points = []
        for path, one in (*listed("payloads", self.payloads or []), *listed("points", self.points or [])):
            with within(path):
                if isinstance(one, PointTable):
                    check_columns("wrench", len(one.wrench), columns, why)
                points.append(one.build(segments))
        return ExternalLoad(tip, self.gravity, points)


class LoadedTable(WeighedTable):
    """What tasks have beside a shape.

    Class attributes:
        shape_key: the key that holds the shape.
    """

    shape_key: ClassVar[str]
    loads: LoadsTable | None = Field(default=None, examples=[[[0.0, 0.0, 0.0], [1.0, "-200 gf", 0.1]]])
    """Loads at the tip in the world frame, x right, y up and z to the viewer: forces, and the moment; in space six
    numbers. Without it, none."""
    wrench_at: Annotated[str, one_of(WRENCH_PLACES)] = Field(default="middle", examples=["start"])
    """Where on its element a node's wrench is taken; the start is the paper's, and less exact."""

    @abstractmethod
    def segments(self, in_space: bool) -> list[Tensor]:
        """Twists of each segment; what is straight may be in space or in the plane."""

    def build(self, in_space: bool = False) -> NamedTask:
        """The task, for arms in space or in the plane."""
        segments = self.segments(in_space)
        for twists in segments:
            if question := question_about_shape(twists):
                units = 'A text with a unit, such as "48 cm" or "30 deg", is understood'
                raise ValueError(f"{self.shape_key}: {question} {units}")
        columns, nodes = segments[0].shape[-1], [len(twists) for twists in segments]
        task = Task(
            torch.cat(segments),
            self._tip_loads(columns, sum(nodes)),
            read_base(self.base_pose, columns, SHAPE_IS),
            self.load(None, columns, len(nodes), SHAPE_IS),
            self.wrench_at,
            nodes if len(nodes) > 1 else None,
        )
        return NamedTask(self.name, task, tuple(self.arms or ()))

    def _tip_loads(self, columns: int, nodes: int) -> Tensor:
        """(L, columns)"""
        if self.loads is None:
            return torch.zeros(1, columns, dtype=torch.float64)
        if isinstance(self.loads, DrawnLoads):
            check_columns("loads.scale", len(self.loads.scale), columns, SHAPE_IS)
            check_values("loads.count", self.loads.count * nodes, f"{self.loads.count} loads, {nodes} nodes")
            return sample_loads(self.loads.count, self.loads.scale, self.loads.seed)
        for path, load in listed("loads", self.loads):
            check_columns(path, len(load), columns, SHAPE_IS)
        return torch.tensor(self.loads, dtype=torch.float64)

    def check_fit(self, task: Task, arm: NamedArm) -> None:
        """Raise a ValueError unless the task's shape has the dimension and the segments of an arm."""
        name, segments = shown_value(arm.name), len(segments_of(arm.design)[0])
        if task.dimension != arm.design.dimension:
            where = "the plane" if arm.design.dimension == 2 else "space (with a direction, or twists of six columns)"
            raise ValueError(f"{self.shape_key}: must be in {where}, as the arm {name} is, or name its own arms")
        own = len(task.nodes_of_segments)
        if own != segments:
            rows = "rows of which segment_nodes says the number"
            form = "a list of shapes" if self.shape_key == "shape" else rows
            raise ValueError(
                f"{self.shape_key}: must be {form} for each of the {segments} segments of the arm {name}, got {own}"
            )


class ShapedTask(LoadedTable):
    """A task: a shape by name, and the loads to hold it under."""

    shape_key: ClassVar[str] = "shape"
    name: Name = name_as("bend")
    shape: ShapesTable
    """The centreline to hold; of an arm of segments a list, one for each."""

    def segments(self, in_space: bool) -> list[Tensor]:
        """Twists of each segment."""
        shapes = self.shape if isinstance(self.shape, list) else [self.shape]
        in_space = in_space or any(one.direction is not None for one in shapes)
        segments = [one.twists(in_space) for one in shapes]
        for index, twists in enumerate(segments):
            if twists.shape[-1] != segments[0].shape[-1]:
                path = field_path(["shape", index])
                raise ValueError(f"{path}.direction: must be given for all segments that bend, or for none")
        return segments


class TwistTask(LoadedTable):
    """A task whose shape is given element by element."""

    shape_key: ClassVar[str] = "twists"
    name: Name = name_as("twists")
    twists: Annotated[list[Twist], filled("a list of [l, γ, κ], one for each node")] = Field(
        examples=[[[0.48, 0.0, 1.0], [0.48, 0.0, "30 deg"], [0.48, 0.0, 0.0]]]
    )
    """Length, shear and curvature of each element from the base on, as if all the arm, or its segment, were like it; in
    space six numbers [l, γ_y, γ_z, κ_x, κ_y, κ_z]."""
    segment_nodes: Annotated[list[_Count], filled("a list of numbers")] | None = Field(default=None, examples=[[3]])
    """How many of these each segment has; without it, the arm is one."""

    def segments(self, in_space: bool) -> list[Tensor]:
        """Twists of each segment."""
        for path, row in listed("twists", self.twists):
            check_columns(path, len(row), len(self.twists[0]), SHAPE_IS)
        twists = torch.tensor(self.twists, dtype=torch.float64)
        counts = self.segment_nodes or [len(twists)]
        if sum(counts) != len(twists):
            given = shown_value(counts)
            raise ValueError(f"segment_nodes: must sum to the {len(twists)} rows of twists, got {given}")
        return list(twists.split(counts))


TaskTable: Any = by_key({"shape": ShapedTask, "twists": TwistTask})


def check_values(name: str, count: int, given: str) -> None:
    """Raise unless a tensor of so many values can be held."""
    if count > MOST_VALUES:
        raise ValueError(f"{name}: must make at most {MOST_VALUES:.0e} numbers at once, got {count:.0e} from {given}")
