"""What the tables of a study file may hold, each value by itself."""

import json
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from torcharm.attainability import CHOICES
from torcharm.attainability.verdict import ROTATION
from torcharm.design.objective import AGGREGATES, METRICS as OBJECTIVES, Objective
from torcharm.design.optimise import ITERATIONS
from torcharm.design.scatter import DISTRIBUTIONS
from torcharm.design.space import FIELDS, TIES
from torcharm.design.tolerance import SAMPLES
from torcharm.study.arm_tables import ArmTable, Names
from torcharm.study.data import Manufacture, Settings
from torcharm.study.fields import Name, NotNegative, Positive, Seed, Table, entries, filled, one_of, refuse
from torcharm.study.task_tables import BasePose, TaskTable, TipPose, WeighedTable, base_pose
from torcharm.study.units import (
    Angle,
    LengthRange,
    Load,
    NotNegativeForce,
    NotNegativeLength,
    NotNegativePressure,
    NotNegativeShare,
    PositiveAngle,
    PositiveLength,
    PressureRange,
)
from torcharm.wrench_sets.vertex_sets import DISTANCES, HULLS


def _no_closed_form(value: Any) -> Any:
    if value == "closed_form":
        raise refuse('must be left out instead of "closed_form": distances are exact by "gjk", the default')
    return value


Correlation = Annotated[float, Field(ge=0, le=1)]


class EvaluateTable(Table):
    """How torcharm evaluate evaluates arms on tasks."""

    metrics: Annotated[
        list[Annotated[str, one_of(CHOICES)]], filled(f"a list of metrics, such as {json.dumps(CHOICES)}")
    ] = Field(default=list(CHOICES), examples=[["predicted_error"]])
    """What is computed; fewer of them cost less."""
    tolerance: PositiveLength | None = Field(default=None, examples=["10 mm"])
    """How far tip and shape may be off for a task to be held. Without it, 2 % of the arm's length."""
    rotation_tolerance: PositiveAngle = Field(default=ROTATION, examples=["5 deg"])
    """How far the tip may be turned for a task to be held; 5 degrees."""
    hull: Annotated[str, one_of(HULLS)] = Field(default=Settings.hull, examples=["edges"])
    """Attainable sets exactly, or by points on edges as in the paper."""
    samples: Annotated[int, Field(ge=2, le=1_000_000)] | None = Field(default=Settings.samples, examples=[3])
    """Points on each edge or curve, for hull = "edges" or a distance other than "gjk"."""
    distance: Annotated[str, one_of(DISTANCES), BeforeValidator(_no_closed_form)] = Field(
        default=Settings.distance, examples=["scipy"]
    )
    """How distances are solved: "gjk" is exact, "qpth" a differentiable QP layer, "scipy" slow."""
    weights: Annotated[list[Positive], entries("k_f", "k_m")] = Field(
        default=list(Settings.weights), examples=[[1.0, 100.0]]
    )
    """Weights k_f [1/N²] and k_m [1/(N·m)²] of a distance, sqrt(k_f f² + k_m m²)."""
    power: Annotated[int, Field(ge=1, le=2)] = Field(default=Settings.power, examples=[2])
    """1 sums distances over the nodes, 2 their squares."""
    signed: bool = Field(default=Settings.signed, examples=[True])
    """Whether tasks that are attainable count minus their margin, not 0."""


class BoundsTable(Table):
    """How far torcharm optimise may go, in what is free."""

    radii: LengthRange | None = Field(default=None, examples=[[-0.1, 0.1]])
    """Of each actuator. Without it, 0.1 m to either side; in space from 0 to 0.1 m."""
    angles: Annotated[list[Angle], entries("lowest", "highest")] | None = Field(
        default=None, examples=[["-60 deg", "60 deg"]]
    )
    """Of each actuator, from the arm's left (y) towards z, where angles are free. Without it, half a turn to either
    side."""
    length: LengthRange | None = Field(default=None, examples=[[0.3, 0.7]])
    """Of each actuator. Without it, from half to one and a half times the given."""
    max_pressure: PressureRange | None = Field(default=None, examples=[[0.0, 50.0]])
    """Of each limit, where max_pressure is free. Without it, from 0 to the arm's own."""


class OptimiseTable(Table):
    """How torcharm optimise makes arms better, each on all tasks together."""

    free: Annotated[list[Annotated[str, one_of(FIELDS)]], filled(f"a list of fields, such as {json.dumps(FIELDS)}")] = (
        Field(default=["radii", "length"], examples=[["radii", "length", "max_pressure"]])
    )
    """What may change; angles are of arms in space alone. Chambers and the elastic core of one body share one
    length."""
    tied: Annotated[str, one_of(TIES)] | None = Field(default=None, examples=["mirror"])
    """Keep arms symmetric, or all actuators alike. Without it, rings in space stay rings, and in the plane each changes
    on its own."""
    bounds: BoundsTable = BoundsTable()
    """How far what is free may go."""
    spacing: PositiveLength | None = Field(default=None, examples=["20 mm"])
    """Least distance between the centres of actuators: their width. Without it, what diameters of the arm need; without
    these, 5 mm, which suits only the thinnest that can be bought. What is never under pressure and has no diameter, as
    an elastic core, takes no room."""
    in_range: bool = Field(default=True, examples=[False])
    """Whether limits, and strains on the tasks' shapes, stay in the characterised range, and strains of the shapes that
    are predicted count beyond it."""
    metric: Annotated[str, one_of(OBJECTIVES)] = Field(default=Objective.metric, examples=["unattainability"])
    """What is made small: the shape error, or what nodes lack."""
    relative_weight: NotNegative = Field(default=Objective.relative_weight, examples=[1.0])
    """Weight of relative beside absolute unattainability, for that metric."""
    over: Annotated[str, one_of(AGGREGATES)] = Field(default=Objective.over, examples=["worst"])
    """Whether the mean over the tasks counts, or the worst."""
    robust: Annotated[float, Field(gt=0, lt=1)] | None = Field(default=None, examples=[0.9])
    """Which share of built arms, as of the table [tolerance], is to stay below what is made small: the shape error of
    these. Without it, the drawn arm's counts."""
    starts: Annotated[int, Field(ge=1, le=100_000)] = 8
    """Designs from which it descends; more find better ones, and take longer."""
    seed: Seed = 0
    """Of the random starts."""
    iterations: Annotated[int, Field(ge=1)] = ITERATIONS
    """At most, of each start."""


class CorrelatedTable(Table):
    """How alike any two actuators of an arm are scattered: 0 is independent, 1 all alike, as of one batch."""

    radii: Correlation = 0.0
    """Of offsets."""
    length: Correlation = 0.0
    """Of neutral lengths."""
    limits: Correlation = 0.0
    """Of pressure limits."""
    force: Correlation = 0.0
    """Of the forces' scale."""
    force_offset: Correlation = 0.0
    """Of the forces' offsets."""
    bending: Correlation = 0.0
    """Of the bending moments' scale."""


class ToleranceTable(Table):
    """By how much built arms differ from drawn ones, for torcharm tolerance."""

    radii: NotNegativeLength = Field(default=0.0, examples=["1 mm"])
    """Of each actuator's offset."""
    length: NotNegativeLength = Field(default=0.0, examples=["2 mm"])
    """Of each neutral length."""
    limits: NotNegativePressure = Field(default=0.0, examples=["1 kPa"])
    """Of each pressure limit."""
    force: NotNegativeShare = Field(default=0.0, examples=["5 %"])
    """Of each force's scale."""
    force_offset: NotNegativeForce = Field(default=0.0, examples=["0.2 N"])
    """Added to each force at any strain and pressure."""
    bending: NotNegativeShare = Field(default=0.0, examples=["10 %"])
    """Of each bending moment's scale."""
    model_covariance: bool = Field(default=False, examples=[True])
    """Whether fitted models are scattered by the covariance of their fit."""
    distribution: Annotated[str, one_of(DISTRIBUTIONS)] = Field(default="normal", examples=["uniform"])
    """Whether values are standard deviations, or half widths that nothing exceeds."""
    correlated: CorrelatedTable = CorrelatedTable()
    """How alike actuators are scattered."""
    compensated: bool = Field(default=Manufacture.compensated, examples=[True])
    """Whether pressures are found anew for each built arm; else those of the drawn one are kept."""
    samples: Annotated[int, Field(ge=2, le=1_000_000)] = SAMPLES
    """Built arms."""
    seed: Seed = Manufacture.seed
    """Of the samples."""


class PlanTable(WeighedTable):
    """A tip pose for which torcharm plan finds a shape of each arm."""

    name: Name = Field(examples=["drawer"])
    """What tables and files call the plan."""
    tip_pose: TipPose = Field(
        examples=[
            [0.35, -0.3, 0.0],
            {"position": ["100 mm", "-400 mm", "50 mm"], "direction": [0.5, -1.0, 0.2], "turn": "0 deg"},
        ]
    )
    """Place and heading of the tip, in the plane as a list [x, y, θ], in space as a table, or as the four rows of a
    homogeneous matrix."""
    tip_load: Load | None = Field(default=None, examples=[[6.0, 0.0, 0.0]])
    """Force and moment at the tip under which the shape is to be held. Without it, none."""
    length_weight: NotNegative | None = Field(default=None, examples=[45.0])
    """Weight of lengths in the smoothest shape [rad/m], with reference_length. Without both, the shape that the arm
    holds best."""
    reference_length: PositiveLength | None = Field(default=None, examples=[0.5])
    """Length that each segment of the smoothest shape keeps to, with length_weight."""
    nodes: Annotated[int, Field(ge=2, le=200)] = 10
    """Elements into which each segment is divided."""
    in_range: bool | None = Field(default=None, examples=[False])
    """Whether strains stay in the characterised range. Without it, unless the smoothest shape is asked."""
    base_pose: BasePose = base_pose
    arms: Names | None = Field(default=None, examples=[["paper", "own"]])
    """The arms to plan for. Without it, all in the plane or in space as tip_pose is."""


class StudyTable(Table):
    """The whole file."""

    name: Name = Field(examples=["all keys"])
    """What the study is called."""
    description: str = Field(default="", examples=["Two arms, a drawer."])
    """A line that tables show beside the name."""
    arm: Annotated[list[ArmTable], filled("tables that begin with [[arm]]")]
    """The arms."""
    task: Annotated[list[TaskTable], filled("tables that begin with [[task]]")]
    """The tasks."""
    evaluate: EvaluateTable = EvaluateTable()
    """How arms are evaluated."""
    optimise: OptimiseTable = OptimiseTable()
    """How arms are optimised."""
    tolerance: ToleranceTable = ToleranceTable()
    """How built arms differ from drawn ones."""
    plan: list[PlanTable] = Field(default=[])
    """Tip poses to plan shapes for."""
