"""What a study holds: named arms and tasks, and how to evaluate them."""

from dataclasses import dataclass

from torcharm.arm import ArmDesign
from torcharm.attainability import METRICS
from torcharm.task import Task


@dataclass(frozen=True)
class NamedArm:
    """One design, and what the study calls it.

    Raises:
        ValueError: the design is a batch.
    """

    name: str
    design: ArmDesign

    def __post_init__(self) -> None:
        if self.design.batch_shape:
            raise ValueError(f"design: must be a single design, got a batch of {tuple(self.design.batch_shape)}")


@dataclass(frozen=True)
class NamedTask:
    """A shape under any number of loads, and what the study calls it."""

    name: str
    task: Task


@dataclass(frozen=True)
class Settings:
    """How a study is evaluated: arguments of `torcharm.evaluate`, with its defaults."""

    metrics: tuple[str, ...] = METRICS
    hull: str = "exact"
    samples: int | None = None
    distance: str = "closed_form"
    weights: tuple[float, float] = (1.0, 1.0)
    power: int = 1
    signed: bool = False


@dataclass(frozen=True)
class Study:
    """Arms, tasks, and how every arm is to be evaluated on every task."""

    name: str
    description: str
    arms: tuple[NamedArm, ...]
    tasks: tuple[NamedTask, ...]
    settings: Settings
