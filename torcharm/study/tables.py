"""What the tables of a study file may hold, each value by itself."""

import json
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag

from torcharm.actuators import SHIPPED
from torcharm.attainability import CHOICES
from torcharm.attainability.verdict import ROTATION
from torcharm.design.objective import AGGREGATES, Objective
from torcharm.design.objective import METRICS as OBJECTIVES
from torcharm.design.optimise import ITERATIONS
from torcharm.design.space import FIELDS, TIES
from torcharm.geometry.rod import BASE_POSE
from torcharm.study.data import Settings
from torcharm.study.fields import (
    Name,
    NotNegative,
    Positive,
    Range,
    Table,
    alternatives,
    by_key,
    by_kind,
    by_list,
    either,
    entries,
    filled,
    kind_among,
    one_of,
    refuse,
    shown_value,
)
from torcharm.study.units import (
    Angle,
    Length,
    LengthRange,
    Lengths,
    Limits,
    Load,
    NotNegativeLength,
    Pose,
    PositiveAngle,
    PositiveLength,
    PositivePressure,
    PressureRange,
    Twist,
)
from torcharm.task import WRENCH_PLACES
from torcharm.wrench_sets.vertex_sets import DISTANCES, HULLS


class BendingTable(Table):
    """A bending model in place of a number K."""

    kind: Annotated[str, one_of(("linear", "constant")), Field(description="one of linear, constant")]
    stiffness: Annotated[float, Field(description="K, a number [N·m²]")]
    reference_pressure: PositivePressure | None = None


class ShippedActuator(Table):
    """One of the force models that torcharm ships, perhaps changed."""

    kind: str
    bending_stiffness: float | None = None
    bending: BendingTable | None = None
    max_pressure: PositivePressure | None = None
    force_scale: float | None = None


class FileActuator(ShippedActuator):
    """A force model from a file of its own, perhaps changed."""

    path: Annotated[str, Field(description="the path of a force model's file, from the study's folder")]


class PolynomialTable(Table):
    """A polynomial force model."""

    kind: str
    coefficients: Annotated[
        list[Annotated[list[float], entries("power of strain", "power of pressure", "coefficient")]],
        filled("a list of [power of strain, power of pressure, coefficient]"),
        Field(description="a list of [power of strain, power of pressure, coefficient]"),
    ]
    strain_range: Annotated[Range, Field(description="[lowest, highest], the strains that were characterised")]
    pressure_range: Annotated[PressureRange, Field(description="[lowest, highest], the pressures characterised [kPa]")]
    max_pressure: Annotated[PositivePressure, Field(description="the highest pressure in use [kPa]")]
    bending_stiffness: float | None = None
    bending: BendingTable | None = None
    force_scale: float | None = None


def _named_kind(value: Any) -> Any:
    return {"kind": value} if isinstance(value, str) else value


def _by_model(value: Any) -> str:
    return "<shipped>" if value["kind"] in SHIPPED else by_kind(value)


ActuatorTable = Annotated[
    Annotated[ShippedActuator, Tag("<shipped>")]
    | Annotated[PolynomialTable, Tag("<polynomial>")]
    | Annotated[FileActuator, Tag("<file>")],
    Discriminator(_by_model),
    kind_among(*SHIPPED, "polynomial", "file"),
    BeforeValidator(_named_kind),
]


class PaperArm(Table):
    """One of the paper's arms."""

    name: Name
    kind: Annotated[str, one_of(("antagonistic", "bellows", "mckibben"))]
    outer_radius: NotNegativeLength | None = None
    inner_radius: NotNegativeLength | None = None
    length: Lengths = 0.5
    max_pressure: Limits | None = None


class FreeArm(Table):
    """Any actuators side by side."""

    name: Name
    radii: Annotated[
        list[Length], filled("a list of numbers [m]"), Field(description="a list of offsets, one for each actuator [m]")
    ]
    length: Annotated[Lengths, Field(description="a number, or a list of one for each actuator [m]")]
    actuators: Annotated[
        list[ActuatorTable],
        filled("a list of force models such as bellows"),
        Field(description="a list of force models, one for each radius"),
    ]
    max_pressure: Limits | None = None


ArmTable = Annotated[
    Annotated[PaperArm, Tag("<with>")] | Annotated[FreeArm, Tag("<without>")],
    by_key("kind"),
    alternatives("kind", "radii", "actuators"),
]


class AffineShape(Table):
    """A shape of affine curvature."""

    kind: str
    slope: Annotated[Angle, Field(description="a number [rad]")]
    intercept: Annotated[Angle, Field(description="a number [rad]")]
    length: PositiveLength = 0.5
    nodes: Annotated[int, Field(ge=1, le=10_000)] = 10


class CubicShape(AffineShape):
    """A shape of cubic curvature."""

    cubic: Annotated[Angle, Field(description="a number [rad]")]
    quadratic: Annotated[Angle, Field(description="a number [rad]")]


ShapeTable = Annotated[
    Annotated[AffineShape, Tag("<affine>")] | Annotated[CubicShape, Tag("<cubic>")],
    Discriminator(by_kind),
    kind_among("affine", "cubic"),
]


def _check_not_negative(value: list[float]) -> list[float]:
    if min(value) < 0:
        raise refuse(f"must be numbers of at least 0, got {shown_value(value)}")
    return value


class DrawnLoads(Table):
    """Random loads."""

    count: Annotated[int, Field(ge=1, le=1_000_000, description="a whole number of loads")]
    scale: Annotated[Load, AfterValidator(_check_not_negative)] = [20.0, 20.0, 2.0]
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 100


LoadsTable = Annotated[
    Annotated[
        list[Load],
        filled("at least one load [f_x, f_y, m]"),
        Tag("<list>"),
    ]
    | Annotated[DrawnLoads, Tag("<other>")],
    Discriminator(by_list),
    either("a list of [f_x, f_y, m], or a table with count, scale and seed", list, dict),
]
_loads_field = Field(description="a list of [f_x, f_y, m] [N, N, N·m], or a table with count, scale and seed")


class ShapedTask(Table):
    """A task with a shape by name."""

    name: Name
    shape: ShapeTable
    loads: Annotated[LoadsTable, _loads_field]
    base_pose: Pose = list(BASE_POSE)
    wrench_at: Annotated[str, one_of(WRENCH_PLACES)] = "middle"


class TwistTask(Table):
    """A task with a shape by its twists."""

    name: Name
    twists: Annotated[list[Twist], filled("a list of [l, γ, κ], one for each node")]
    loads: Annotated[LoadsTable, _loads_field]
    base_pose: Pose = list(BASE_POSE)
    wrench_at: Annotated[str, one_of(WRENCH_PLACES)] = "middle"


TaskTable = Annotated[
    Annotated[ShapedTask, Tag("<with>")] | Annotated[TwistTask, Tag("<without>")],
    by_key("shape"),
    alternatives("shape", "twists"),
]


def _no_closed_form(value: Any) -> Any:
    if value == "closed_form":
        raise refuse('must be left out instead of "closed_form": distances are exact by "gjk", the default')
    return value


class EvaluateTable(Table):
    """How to evaluate."""

    metrics: Annotated[
        list[Annotated[str, one_of(CHOICES)]], filled(f"a list of metrics, such as {json.dumps(CHOICES)}")
    ] = list(CHOICES)
    tolerance: PositiveLength | None = None
    rotation_tolerance: PositiveAngle = ROTATION
    hull: Annotated[str, one_of(HULLS)] = Settings.hull
    samples: Annotated[int, Field(ge=2, le=1_000_000)] | None = Settings.samples
    distance: Annotated[str, one_of(DISTANCES), BeforeValidator(_no_closed_form)] = Settings.distance
    weights: Annotated[list[Positive], entries("k_f", "k_m")] = list(Settings.weights)
    power: Annotated[int, Field(ge=1, le=2)] = Settings.power
    signed: bool = Settings.signed


class BoundsTable(Table):
    """How far an optimiser may go."""

    radii: LengthRange | None = None
    length: LengthRange | None = None
    max_pressure: PressureRange | None = None


class OptimiseTable(Table):
    """How to optimise."""

    free: Annotated[list[Annotated[str, one_of(FIELDS)]], filled(f"a list of fields, such as {json.dumps(FIELDS)}")] = [
        "radii",
        "length",
    ]
    tied: Annotated[str, one_of(TIES)] | None = None
    bounds: BoundsTable = BoundsTable()
    spacing: PositiveLength | None = None
    in_range: bool = True
    metric: Annotated[str, one_of(OBJECTIVES)] = Objective.metric
    relative_weight: NotNegative = Objective.relative_weight
    over: Annotated[str, one_of(AGGREGATES)] = Objective.over
    starts: Annotated[int, Field(ge=1, le=100_000)] = 8
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    iterations: Annotated[int, Field(ge=1)] = ITERATIONS


class PlanTable(Table):
    """A tip pose for which shapes are to be found."""

    name: Name
    tip_pose: Annotated[Pose, Field(description="[x, y, θ] [m, m, rad]")]
    tip_load: Annotated[Load, Field(description="[f_x, f_y, m] [N, N, N·m]")]
    length_weight: NotNegative | None = None
    reference_length: PositiveLength | None = None
    nodes: Annotated[int, Field(ge=2, le=200)] = 10
    in_range: bool | None = None
    base_pose: Pose = list(BASE_POSE)


class StudyTable(Table):
    """The whole file."""

    name: Name
    description: str = ""
    arm: Annotated[list[ArmTable], filled("tables that begin with [[arm]]"), Field(description="at least one [[arm]]")]
    task: Annotated[
        list[TaskTable], filled("tables that begin with [[task]]"), Field(description="at least one [[task]]")
    ]
    evaluate: EvaluateTable = EvaluateTable()
    optimise: OptimiseTable = OptimiseTable()
    plan: list[PlanTable] = []
