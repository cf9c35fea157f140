"""What a study file may hold, table by table, and how its arms are evaluated, optimised, built and planned for."""

import json
from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import Field

from torcharm.arm_series import segments_of
from torcharm.attainability import CHOICES, PoseTolerance
from torcharm.attainability.questions import LONGEST, WIDEST, question_about_lengths
from torcharm.attainability.verdict import ROTATION
from torcharm.design.objective import AGGREGATES, METRICS as OBJECTIVES, Objective
from torcharm.design.optimise import ITERATIONS
from torcharm.design.robust import Robust
from torcharm.design.scatter import DISTRIBUTIONS, FIELDS as SCATTERED, Scatter
from torcharm.design.shape_planning import Smoothness
from torcharm.design.space import FIELDS, TIES, DesignSpace
from torcharm.design.tolerance import SAMPLES
from torcharm.inputs import hint
from torcharm.study.arm_tables import ArmTable
from torcharm.study.data import Manufacture, NamedArm, NamedPlan, Optimisation, Settings
from torcharm.study.fields import (
    ENDS,
    Name,
    NotNegative,
    Positive,
    Seed,
    Table,
    checked,
    entries,
    filled,
    listed,
    one_of,
    shown_value,
)
from torcharm.study.pose_tables import TipPose, check_columns, columns_of, read_base, read_pose
from torcharm.study.task_tables import TaskTable, WeighedTable
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
    Pressure,
    in_unit,
)
from torcharm.units import SHARE
from torcharm.wrench_sets.vertex_sets import DISTANCES, HULLS

Correlation = Annotated[float, Field(ge=0, le=1), in_unit(SHARE)]
POSE_IS = {3: "in the plane, as tip_pose is", 6: "in space, as tip_pose is"}
"""By the number of components of a load, why it must have them."""


def _lengths_up_to(most: float) -> Any:
    """Of a length, or several, none that makes sense in millimetres only."""
    return checked(lambda value: question_about_lengths(value if isinstance(value, list) else [value], most))


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
    distance: Annotated[str, one_of(DISTANCES)] = Field(default=Settings.distance, examples=["scipy"])
    """How distances are solved: "gjk" is exact, "qpth" a differentiable QP layer, "scipy" slow."""
    weights: Annotated[list[Positive], entries(("k_f", "k_m"))] = Field(
        default=list(Settings.weights), examples=[[1.0, 100.0]]
    )
    """Weights k_f [1/N²] and k_m [1/(N·m)²] of a distance, sqrt(k_f f² + k_m m²)."""
    power: Annotated[int, Field(ge=1, le=2)] = Field(default=Settings.power, examples=[2])
    """1 sums distances over the nodes, 2 their squares."""
    signed: bool = Field(default=Settings.signed, examples=[True])
    """Whether tasks that are attainable count minus their margin, not 0."""

    def build(self) -> Settings:
        """How arms are evaluated."""
        force, moment = self.weights
        options = self.model_dump(exclude={"metrics", "weights", "tolerance", "rotation_tolerance"})
        return Settings(
            metrics=tuple(name for name in CHOICES if name in self.metrics),
            tolerance=PoseTolerance(self.tolerance, self.rotation_tolerance),
            weights=(force, moment),
            **options,
        )


class BoundsTable(Table):
    """How far torcharm optimise may go, in what is free."""

    radii: Annotated[LengthRange, _lengths_up_to(WIDEST)] | None = Field(default=None, examples=[[-0.1, 0.1]])
    """Of each actuator. Without it, 0.1 m to either side; in space from 0 to 0.1 m."""
    angles: Annotated[list[Angle], ENDS] | None = Field(default=None, examples=[["-60 deg", "60 deg"]])
    """Of each actuator, from the arm's left (y) towards z, where angles are free. Without it, half a turn to either
    side."""
    length: Annotated[LengthRange, _lengths_up_to(LONGEST)] | None = Field(default=None, examples=[[0.3, 0.7]])
    """Of each actuator. Without it, from half to one and a half times the given."""
    max_pressure: Annotated[list[Pressure], ENDS] | None = Field(default=None, examples=[[0.0, 50.0]])
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
    spacing: Annotated[PositiveLength, _lengths_up_to(WIDEST)] | None = Field(default=None, examples=["20 mm"])
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

    def build(self, manufacture: Manufacture) -> Optimisation:
        """How arms are optimised, which may be built as told."""
        robust = None
        if self.robust is not None:
            if manufacture.scatter is None:
                raise ValueError("robust: must stand beside a table [tolerance] that says what is scattered, got none")
            robust = Robust(manufacture.scatter, self.robust, compensated=manufacture.compensated)
        bounds = {name: (ends[0], ends[1]) for name, ends in self.bounds.model_dump(exclude_none=True).items()}
        space = DesignSpace(tuple(self.free), self.tied, bounds, self.spacing, self.in_range)
        objective = Objective(self.metric, self.over, relative_weight=self.relative_weight, robust=robust)
        return Optimisation(space, objective, self.starts, self.seed, self.iterations)


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

    def build(self) -> Manufacture:
        """How arms are built."""
        sizes = {name: getattr(self, name) for name in SCATTERED}
        alike = {name: value for name, value in self.correlated.model_dump().items() if value > 0}
        scatter = None
        if self.model_covariance or any(sizes.values()):
            scatter = Scatter(
                **sizes, model_covariance=self.model_covariance, distribution=self.distribution, correlated=alike
            )
        return Manufacture(scatter, self.compensated, self.samples, self.seed)


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

    def build(self, arms: Sequence[NamedArm]) -> NamedPlan:
        """The plan, for those of the arms that it names or fits."""
        weight, reference = self.length_weight, self.reference_length
        if (weight is None) != (reference is None):
            missing = "length_weight" if weight is None else "reference_length"
            raise ValueError(
                f"{missing}: must be given too, as the other is; without both, unattainability is minimised"
            )
        smoothness = None if weight is None or reference is None else Smoothness(weight, reference)
        columns = columns_of(self.tip_pose)
        tip_load = [0.0] * columns if self.tip_load is None else self.tip_load
        check_columns("tip_load", len(tip_load), columns, POSE_IS)
        base = read_base(self.base_pose, columns, POSE_IS)
        tip = read_pose("tip_pose", self.tip_pose, base)
        chosen = self._arms(arms, columns)
        load = self.load(tip_load, columns, min(len(segments_of(arm.design)[0]) for arm in chosen), POSE_IS)
        names = tuple(arm.name for arm in chosen)
        return NamedPlan(self.name, tip, load, smoothness, self.nodes, base, self.in_range, names)

    def _arms(self, arms: Sequence[NamedArm], columns: int) -> list[NamedArm]:
        """The arms to plan for: those named, which must fit, or all that fit."""
        named = arms_named(self.arms or (), arms)
        fit = [arm for arm in named if arm.design.dimension == columns // 3 + 1]
        kind = POSE_IS[columns]
        if self.arms and len(fit) < len(named):
            other = next(arm.name for arm in named if arm not in fit)
            raise ValueError(f"arms: must be {kind}, got {shown_value(other)}, which is not")
        if not fit:
            raise ValueError(
                f"tip_pose: must fit an arm {kind.removesuffix(', as tip_pose is')}, of which there is none"
            )
        return fit


def arms_named(given: Sequence[str], arms: Sequence[NamedArm]) -> list[NamedArm]:
    """The arms of these names, or all if none is given."""
    names = [arm.name for arm in arms]
    for path, name in listed("arms", list(given)):
        if name not in names:
            raise ValueError(f"{path}: must be one of {', '.join(names)}, got {shown_value(name)}{hint(name, names)}")
    return [arm for arm in arms if arm.name in (given or names)]


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
