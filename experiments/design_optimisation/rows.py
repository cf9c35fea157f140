"""Rows of results, and the files that keep them: written after each piece of work, and read again to go on."""

import csv
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

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


Record = TypeVar("Record", Row, Trace, TaskRow)


def write(path: Path, rows: Sequence[Record]) -> None:
    """Rows as a CSV file, which appears whole."""
    if not rows:
        return
    partial = path.with_suffix(".part")
    with partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(rows[0])], lineterminator="\n")
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)
    partial.replace(path)


def read(path: Path, kind: type[Record]) -> list[Record]:
    """What `write` wrote; nothing if there is no such file, or it is of other columns."""
    if not path.is_file():
        return []
    convert: dict[Any, Any] = {str: str, int: int, float: float, bool: lambda word: word == "True"}
    columns = {field.name: convert[field.type] for field in fields(kind)}
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        if list(reader.fieldnames or ()) != list(columns):
            return []
        return [kind(**{name: columns[name](word) for name, word in line.items()}) for line in reader]


def without(rows: Iterable[Row], *parts: str) -> list[Row]:
    """Rows of other parts."""
    return [row for row in rows if row.part not in parts]
