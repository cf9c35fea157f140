"""Rows of results: dataclasses to and from CSV files, and measurements as tables."""

import csv
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

from rich.table import Table

Kind = TypeVar("Kind")


@dataclass(frozen=True)
class Measurement:
    """One measurement; `value` is in `unit`."""

    part: str
    case: str
    quantity: str
    value: float
    unit: str = ""


def write_rows(path: Path, rows: Sequence[Any]) -> None:
    """Replace the file at once by one line a row, so that whatever interrupts finds the old rows or the new.

    Args:
        path: of the CSV file.
        rows: all of one dataclass, whose fields are the columns; of none, nothing is written.
    """
    if not rows:
        return
    partial = path.with_name(path.name + ".part")
    with partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(rows[0])], lineterminator="\n")
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)
    partial.replace(path)


def read_rows(path: Path, kind: type[Kind]) -> list[Kind]:
    """What `write_rows` wrote of this dataclass, whose fields are numbers, flags and texts; nothing if there is no such
    file, or its columns are others."""
    if not path.is_file():
        return []
    convert: dict[Any, Any] = {str: str, int: int, float: float, bool: lambda word: word == "True"}
    columns = {field.name: convert[field.type] for field in fields(kind)}  # type: ignore[arg-type]
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        if list(reader.fieldnames or ()) != list(columns):
            return []
        return [kind(**{name: columns[name](word) for name, word in line.items()}) for line in reader]


def measurements_table(rows: Sequence[Measurement], digits: int = 5) -> Table:
    """The measurements of one part."""
    table = Table(title=rows[0].part, title_justify="left")
    for heading in ("case", "quantity", "value", "unit"):
        table.add_column(heading, justify="right" if heading == "value" else "left")
    for row in rows:
        table.add_row(row.case, row.quantity, f"{row.value:,.{digits}g}", row.unit)
    return table
