"""What a study holds: named arms and tasks, and how to evaluate them."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count
from typing import Any

from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries
from torcharm.attainability import CHOICES, PoseTolerance
from torcharm.design.objective import Objective
from torcharm.design.optimise import ITERATIONS
from torcharm.design.scatter import Scatter
from torcharm.design.shape_planning import Smoothness
from torcharm.design.space import DesignSpace
from torcharm.design.tolerance import SAMPLES
from torcharm.inputs import HoldsTensors
from torcharm.load import ExternalLoad
from torcharm.task import Task

Pose = Sequence[float] | Sequence[Sequence[float]]


def unused_name(name: str, taken: Collection[str]) -> str:
    """The name, with the first number from 2 behind it, if need be, with which nothing else has it."""
    names = (name if number == 1 else f"{name} {number}" for number in count(1))
    return next(one for one in names if one not in taken)


@dataclass(frozen=True)
class NamedArm(HoldsTensors):
    """One design, and what the study calls it.

    Attributes:
        name: of the arm.
        design: what it is.
        files: for each actuator the path of its force model's file, as the study has it, or None; empty if none has.

    Raises:
        ValueError: the design is a batch.
    """

    name: str
    design: ArmDesign | ArmSeries
    files: tuple[str | None, ...] = ()

    def __post_init__(self) -> None:
        if self.design.batch_shape:
            raise ValueError(f"design: must be a single design, got a batch of {tuple(self.design.batch_shape)}")


@dataclass(frozen=True)
class NamedTask(HoldsTensors):
    """A shape under any number of loads, and what the study calls it.

    Attributes:
        name: of the task.
        task: what it is.
        arms: names of the arms that are to hold it; empty for all.
    """

    name: str
    task: Task
    arms: tuple[str, ...] = ()


@dataclass(frozen=True)
class Settings:
    """How a study is evaluated: arguments of `torcharm.evaluate`, with its defaults."""

    metrics: tuple[str, ...] = CHOICES
    tolerance: PoseTolerance = field(default_factory=PoseTolerance)
    hull: str = "exact"
    samples: int | None = None
    distance: str = "gjk"
    weights: tuple[float, float] = (1.0, 1.0)
    power: int = 1
    signed: bool = False


@dataclass(frozen=True)
class Optimisation:
    """How arms are optimised: arguments of `torcharm.optimise_design`, with its defaults."""

    space: DesignSpace = field(default_factory=DesignSpace)
    objective: Objective = field(default_factory=Objective)
    starts: int = 8
    seed: int = 0
    iterations: int = ITERATIONS


@dataclass(frozen=True)
class Manufacture:
    """How arms are built: arguments of `torcharm.tolerance`, with its defaults; a scatter of None is not told yet."""

    scatter: Scatter | None = None
    compensated: bool = False
    samples: int = SAMPLES
    seed: int = 0


@dataclass(frozen=True)
class NamedPlan:
    """A tip pose for which arms' shapes are to be found, and what the study calls it.

    Attributes:
        name: of the plan.
        tip_pose: (x, y, θ) in the world frame [m, m, rad]; in space the rows of a homogeneous matrix.
        load: under which shapes are to be held.
        smoothness: the heuristic to follow; None: the shape that each arm holds best.
        nodes: elements of each segment.
        base_pose: of the shape.
        in_range: whether strains must stay in the characterised range; None leaves it to `plan_shape`.
        arms: names of the arms to plan for; empty for all.
    """

    name: str
    tip_pose: Pose
    load: ExternalLoad
    smoothness: Smoothness | None
    nodes: int
    base_pose: Pose | str
    in_range: bool | None = None
    arms: tuple[str, ...] = ()


@dataclass(frozen=True)
class Study(HoldsTensors):
    """Arms, tasks, how every arm is to be evaluated on its tasks, and how it may be made better.

    Attributes:
        tables: the file's, from which all else was read, as TOML has them; empty of a study that is from no file.
    """

    name: str
    description: str
    arms: tuple[NamedArm, ...]
    tasks: tuple[NamedTask, ...]
    settings: Settings
    optimisation: Optimisation = field(default_factory=Optimisation)
    manufacture: Manufacture = field(default_factory=Manufacture)
    plans: tuple[NamedPlan, ...] = ()
    tables: Mapping[str, Any] = field(default_factory=dict, repr=False, compare=False)

    def arms_of(self, task: NamedTask | NamedPlan) -> tuple[NamedArm, ...]:
        """The arms that are to hold a task, or for which to plan a shape, in the study's order."""
        return tuple(arm for arm in self.arms if not task.arms or arm.name in task.arms)

    @property
    def pairs(self) -> list[tuple[NamedArm, NamedTask]]:
        """Every arm with each task that it is to hold, task by task."""
        return [(arm, task) for task in self.tasks for arm in self.arms_of(task)]

    def tasks_of(self, arm: NamedArm) -> tuple[NamedTask, ...]:
        """The tasks that an arm is to hold."""
        return tuple(task for task in self.tasks if not task.arms or arm.name in task.arms)
