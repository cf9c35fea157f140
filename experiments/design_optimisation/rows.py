"""Rows of results, and the files that keep them: written after each piece of work, and read again to go on."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).parent
RESULTS, HISTORIES, TASKS = (HERE / f"{name}.csv" for name in ("results", "histories", "verification"))


@dataclass(frozen=True)
class Row:
    """One measurement; `value` is in `unit`."""

    part: str
    arm: str
    case: str
    quantity: str
    value: float
    unit: str

    @property
    def key(self) -> tuple[str, str, str]:
        """The piece of work that it is of."""
        return self.part, self.arm, self.case


@dataclass(frozen=True)
class Trace:
    """When a run of a method had found what; of all runs of one `session`, one after the other on one machine."""

    session: str
    arm: str
    method: str
    seed: int
    seconds: float
    evaluations: int
    value: float


@dataclass(frozen=True)
class TaskRow:
    """One design on one task.

    Attributes:
        arm, design: "given", or what it was optimised for.
        shape, load: the task.
        absolute: unattainability [N].
        predicted: error [m], and whether the prediction converged.
        searched: error [m] that the pressure search reached, and whether it converged.
    """

    arm: str
    design: str
    shape: str
    load: int
    absolute: float
    predicted: float
    predicted_converged: bool
    searched: float
    searched_converged: bool


def without(rows: Iterable[Row], *parts: str) -> list[Row]:
    """Rows of other parts."""
    return [row for row in rows if row.part not in parts]
