"""What commands say of arms on tasks: a heading, and the columns of tables of verdicts and errors."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from torcharm.cli.tables import LONGEST_WORD, Column
from torcharm.cli.terminal import count

if TYPE_CHECKING:
    from rich.text import Text

    from torcharm.study import NamedTask, StudyResult, Summary


def heading(task: "NamedTask", loads: int) -> "Text":
    """Above the tables of a task."""
    from rich.text import Text

    what = f", {count(task.task.nodes, 'node')}, {count(loads, 'load')}"
    return Text("Task ").append(task.name, style="bold").append(what)


def summary_columns(rows: Sequence[tuple["StudyResult", "Summary"]], sums: bool = False) -> Iterator[Column]:
    """A row for each arm: how many loads are held, and medians over the loads; with the paper's sums on request."""
    yield Column("arm", [result.arm.name for result, _ in rows], LONGEST_WORD)
    found = [_cells(summary, sums) for _, summary in rows]
    for title in found[0]:
        if title == "not held" and all(cells[title] == "-" for cells in found):
            continue
        yield Column(title, [cells[title] for cells in found], LONGEST_WORD if title == "not held" else 0)


def _cells(summary: "Summary", sums: bool) -> dict[str, str]:
    """The cells of a row by their titles; medians over loads."""
    from torcharm.inputs import three_digits

    median, cells = summary.median, {}
    if summary.verdicts is not None:
        cells["held"] = f"{summary.held} of {summary.loads}"
        cells["tip off\n[mm]"] = three_digits(1e3 * median["tip_error"])
        cells["turned\n[°]"] = three_digits(math.degrees(median["tip_rotation_error"]))
        cells["shape\n[mm]"] = three_digits(1e3 * median["shape_error"])
    elif summary.not_excluded is not None:
        cells["not\nexcluded"] = f"{summary.not_excluded} of {summary.loads}"
    if summary.not_excluded is not None:
        worst = "-" if summary.worst_node is None else f"{summary.worst_node}: {summary.worst_miss:.2g}"
        cells["worst node:\nlacks [N]"] = worst
    if summary.verdicts is not None:
        cells["not held"] = _not_held(summary.verdicts)
    if sums or summary.verdicts is None:
        cells |= {f"{name}\nsum [N]": three_digits(median[name]) for name in ("absolute", "relative") if name in median}
    return cells


def _not_held(verdicts: Mapping[str, int]) -> str:
    return ",\n".join(f"{many} {word}" for word, many in verdicts.items() if word != "held") or "-"


def error_columns(rows: Sequence[Mapping[str, Any]], sums: bool = False) -> Iterator[Column]:
    """The verdict and the errors of one load in each row, rows as of files; with the paper's sums on request."""
    from torcharm.inputs import three_digits

    if any(row.get("verdict") is not None for row in rows):
        yield Column("verdict", [str(row.get("verdict") or "-") for row in rows], LONGEST_WORD)
    shown = {"tip off\n[mm]": "tip_error_mm", "turned\n[°]": "tip_rotation_error_deg", "shape\n[mm]": "shape_error_mm"}
    for title, name in shown.items():
        if not any(name in row for row in rows):
            continue
        yield Column(title, _numbers(rows, name, three_digits))
    for name in ("absolute", "relative") if sums else ():
        if any(f"{name}_N" in row for row in rows):
            yield Column(f"{name}\nsum [N]", _numbers(rows, f"{name}_N", three_digits))


def _numbers(rows: Sequence[Mapping[str, Any]], name: str, words: Callable[[float], str]) -> list[str]:
    values = [row.get(name) for row in rows]
    return ["-" if value is None else words(value) for value in values]
