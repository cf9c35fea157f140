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
from torcharm.study.fields import Name, NotNegative, Positive, Table, entries, filled, one_of, refuse
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
    ] = Field(
        default=list(CHOICES), description="What is computed; fewer of them cost less.", examples=[["predicted_error"]]
    )
    tolerance: PositiveLength | None = Field(
        default=None,
        description="How far tip and shape may be off for a task to be held. Without it, 2 % of the arm's length.",
        examples=["10 mm"],
    )
    rotation_tolerance: PositiveAngle = Field(
        default=ROTATION,
        description="How far the tip may be turned for a task to be held; 5 degrees.",
        examples=["5 deg"],
    )
    hull: Annotated[str, one_of(HULLS)] = Field(
        default=Settings.hull,
        description="Attainable sets exactly, or by points on edges as in the paper.",
        examples=["edges"],
    )
    samples: Annotated[int, Field(ge=2, le=1_000_000)] | None = Field(
        default=Settings.samples,
        description='Points on each edge or curve, for hull = "edges" or a distance other than "gjk".',
        examples=[3],
    )
    distance: Annotated[str, one_of(DISTANCES), BeforeValidator(_no_closed_form)] = Field(
        default=Settings.distance,
        description='How distances are solved: "gjk" is exact, "qpth" a differentiable QP layer, "scipy" slow.',
        examples=["scipy"],
    )
    weights: Annotated[list[Positive], entries("k_f", "k_m")] = Field(
        default=list(Settings.weights),
        description="Weights k_f [1/N²] and k_m [1/(N·m)²] of a distance, sqrt(k_f f² + k_m m²).",
        examples=[[1.0, 100.0]],
    )
    power: Annotated[int, Field(ge=1, le=2)] = Field(
        default=Settings.power, description="1 sums distances over the nodes, 2 their squares.", examples=[2]
    )
    signed: bool = Field(
        default=Settings.signed,
        description="Whether tasks that are attainable count minus their margin, not 0.",
        examples=[True],
    )


class BoundsTable(Table):
    """How far torcharm optimise may go, in what is free."""

    radii: LengthRange | None = Field(
        default=None,
        description="Of each actuator. Without it, 0.1 m to either side; in space from 0 to 0.1 m.",
        examples=[[-0.1, 0.1]],
    )
    angles: Annotated[list[Angle], entries("lowest", "highest")] | None = Field(
        default=None,
        description="Of each actuator, from the arm's left (y) towards z, where angles are free. Without it, half a "
        "turn to either side.",
        examples=[["-60 deg", "60 deg"]],
    )
    length: LengthRange | None = Field(
        default=None,
        description="Of each actuator. Without it, from half to one and a half times the given.",
        examples=[[0.3, 0.7]],
    )
    max_pressure: PressureRange | None = Field(
        default=None,
        description="Of each limit, where max_pressure is free. Without it, from 0 to the arm's own.",
        examples=[[0.0, 50.0]],
    )


class OptimiseTable(Table):
    """How torcharm optimise makes arms better, each on all tasks together."""

    free: Annotated[list[Annotated[str, one_of(FIELDS)]], filled(f"a list of fields, such as {json.dumps(FIELDS)}")] = (
        Field(
            default=["radii", "length"],
            description="What may change; angles are of arms in space alone. Chambers and the elastic core of one body "
            "share one length.",
            examples=[["radii", "length", "max_pressure"]],
        )
    )
    tied: Annotated[str, one_of(TIES)] | None = Field(
        default=None,
        description="Keep arms symmetric, or all actuators alike. Without it, rings in space stay rings, and in the "
        "plane each changes on its own.",
        examples=["mirror"],
    )
    bounds: BoundsTable = Field(default=BoundsTable(), description="How far what is free may go.")
    spacing: PositiveLength | None = Field(
        default=None,
        description="Least distance between the centres of actuators: their width. Without it, what diameters of the "
        "arm need; without these, 5 mm, which suits only the thinnest that can be bought. What is never under pressure "
        "and has no diameter, as an elastic core, takes no room.",
        examples=["20 mm"],
    )
    in_range: bool = Field(
        default=True,
        description="Whether limits, and strains on the tasks' shapes, stay in the characterised range, and strains of "
        "the shapes that are predicted count beyond it.",
        examples=[False],
    )
    metric: Annotated[str, one_of(OBJECTIVES)] = Field(
        default=Objective.metric,
        description="What is made small: the shape error, or what nodes lack.",
        examples=["unattainability"],
    )
    relative_weight: NotNegative = Field(
        default=Objective.relative_weight,
        description="Weight of relative beside absolute unattainability, for that metric.",
        examples=[1.0],
    )
    over: Annotated[str, one_of(AGGREGATES)] = Field(
        default=Objective.over, description="Whether the mean over the tasks counts, or the worst.", examples=["worst"]
    )
    robust: Annotated[float, Field(gt=0, lt=1)] | None = Field(
        default=None,
        description="Which share of built arms, as of the table [tolerance], is to stay below what is made small: the "
        "shape error of these. Without it, the drawn arm's counts.",
        examples=[0.9],
    )
    starts: Annotated[int, Field(ge=1, le=100_000)] = Field(
        default=8, description="Designs from which it descends; more find better ones, and take longer."
    )
    seed: Annotated[int, Field(ge=0, lt=2**32)] = Field(default=0, description="Of the random starts.")
    iterations: Annotated[int, Field(ge=1)] = Field(default=ITERATIONS, description="At most, of each start.")


class CorrelatedTable(Table):
    """How alike any two actuators of an arm are scattered: 0 is independent, 1 all alike, as of one batch."""

    radii: Correlation = Field(default=0.0, description="Of offsets.")
    length: Correlation = Field(default=0.0, description="Of neutral lengths.")
    limits: Correlation = Field(default=0.0, description="Of pressure limits.")
    force: Correlation = Field(default=0.0, description="Of the forces' scale.")
    force_offset: Correlation = Field(default=0.0, description="Of the forces' offsets.")
    bending: Correlation = Field(default=0.0, description="Of the bending moments' scale.")


class ToleranceTable(Table):
    """By how much built arms differ from drawn ones, for torcharm tolerance."""

    radii: NotNegativeLength = Field(default=0.0, description="Of each actuator's offset.", examples=["1 mm"])
    length: NotNegativeLength = Field(default=0.0, description="Of each neutral length.", examples=["2 mm"])
    limits: NotNegativePressure = Field(default=0.0, description="Of each pressure limit.", examples=["1 kPa"])
    force: NotNegativeShare = Field(default=0.0, description="Of each force's scale.", examples=["5 %"])
    force_offset: NotNegativeForce = Field(
        default=0.0, description="Added to each force at any strain and pressure.", examples=["0.2 N"]
    )
    bending: NotNegativeShare = Field(default=0.0, description="Of each bending moment's scale.", examples=["10 %"])
    model_covariance: bool = Field(
        default=False,
        description="Whether fitted models are scattered by the covariance of their fit.",
        examples=[True],
    )
    distribution: Annotated[str, one_of(DISTRIBUTIONS)] = Field(
        default="normal",
        description="Whether values are standard deviations, or half widths that nothing exceeds.",
        examples=["uniform"],
    )
    correlated: CorrelatedTable = Field(default=CorrelatedTable(), description="How alike actuators are scattered.")
    compensated: bool = Field(
        default=Manufacture.compensated,
        description="Whether pressures are found anew for each built arm; else those of the drawn one are kept.",
        examples=[True],
    )
    samples: Annotated[int, Field(ge=2, le=1_000_000)] = Field(default=SAMPLES, description="Built arms.")
    seed: Annotated[int, Field(ge=0, lt=2**32)] = Field(default=Manufacture.seed, description="Of the samples.")


class PlanTable(WeighedTable):
    """A tip pose for which torcharm plan finds a shape of each arm."""

    name: Name = Field(description="What tables and files call the plan.", examples=["drawer"])
    tip_pose: TipPose = Field(
        description="Place and heading of the tip, in the plane as a list [x, y, θ], in space as a table, or as the "
        "four rows of a homogeneous matrix.",
        examples=[
            [0.35, -0.3, 0.0],
            {"position": ["100 mm", "-400 mm", "50 mm"], "direction": [0.5, -1.0, 0.2], "turn": "0 deg"},
        ],
    )
    tip_load: Load | None = Field(
        default=None,
        description="Force and moment at the tip under which the shape is to be held. Without it, none.",
        examples=[[6.0, 0.0, 0.0]],
    )
    length_weight: NotNegative | None = Field(
        default=None,
        description="Weight of lengths in the smoothest shape [rad/m], with reference_length. Without both, the shape "
        "that the arm holds best.",
        examples=[45.0],
    )
    reference_length: PositiveLength | None = Field(
        default=None,
        description="Length that each segment of the smoothest shape keeps to, with length_weight.",
        examples=[0.5],
    )
    nodes: Annotated[int, Field(ge=2, le=200)] = Field(
        default=10, description="Elements into which each segment is divided."
    )
    in_range: bool | None = Field(
        default=None,
        description="Whether strains stay in the characterised range. Without it, unless the smoothest shape is asked.",
        examples=[False],
    )
    base_pose: BasePose = base_pose
    arms: Names | None = Field(
        default=None,
        description="The arms to plan for. Without it, all in the plane or in space as tip_pose is.",
        examples=[["paper", "own"]],
    )


class StudyTable(Table):
    """The whole file."""

    name: Name = Field(description="What the study is called.", examples=["all keys"])
    description: str = Field(
        default="", description="A line that tables show beside the name.", examples=["Two arms, a drawer."]
    )
    arm: Annotated[list[ArmTable], filled("tables that begin with [[arm]]")] = Field(description="The arms.")
    task: Annotated[list[TaskTable], filled("tables that begin with [[task]]")] = Field(description="The tasks.")
    evaluate: EvaluateTable = Field(default=EvaluateTable(), description="How arms are evaluated.")
    optimise: OptimiseTable = Field(default=OptimiseTable(), description="How arms are optimised.")
    tolerance: ToleranceTable = Field(default=ToleranceTable(), description="How built arms differ from drawn ones.")
    plan: list[PlanTable] = Field(default=[], description="Tip poses to plan shapes for.")
