"""What commands say of arms on tasks: a heading, and the columns of tables of verdicts and errors."""

from collections.abc import Iterator, Mapping, Sequence
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
    from torcharm.study.results import ERRORS
    from torcharm.wrench_sets.node_distances import METRICS

    median, cells = summary.median, {}
    if summary.verdicts is not None:
        cells["held"] = f"{summary.held} of {summary.loads}"
        for title, name, unit, scale in ERRORS:
            cells[_title(title, unit)] = three_digits(scale * median[name])
    elif summary.not_excluded is not None:
        cells["not\nexcluded"] = f"{summary.not_excluded} of {summary.loads}"
    if summary.not_excluded is not None:
        worst = "-" if summary.worst_node is None else f"{summary.worst_node}: {summary.worst_miss:.2g}"
        cells["worst node:\nlacks [N]"] = worst
    if summary.verdicts is not None:
        others = [f"{many} {word}" for word, many in summary.verdicts.items() if word != "held"]
        cells["not held"] = ",\n".join(others) or "-"
    if sums or summary.verdicts is None:
        cells |= {_title(f"{name}\nsum", "N"): three_digits(median[name]) for name in METRICS if name in median}
    return cells


def _title(words: str, unit: str) -> str:
    gap = " " if "\n" in words else "\n"
    return f"{words}{gap}[{unit.replace('deg', '°')}]"


def error_columns(rows: Sequence[Mapping[str, Any]], sums: bool = False) -> Iterator[Column]:
    """The verdict and the errors of one load in each row, rows as of files; with the paper's sums on request."""
    from torcharm.study.results import ERRORS
    from torcharm.wrench_sets.node_distances import METRICS

    if any(row.get("verdict") is not None for row in rows):
        yield Column("verdict", [str(row.get("verdict") or "-") for row in rows], LONGEST_WORD)
    for title, name, unit, _ in ERRORS:
        yield from number_column(rows, f"{name}_{unit}", _title(title, unit))
    for name in METRICS if sums else ():
        yield from number_column(rows, f"{name}_N", _title(f"{name}\nsum", "N"))


def number_column(rows: Sequence[Mapping[str, Any]], name: str, title: str) -> Iterator[Column]:
    """The numbers in a column of a file, if any row has one."""
    from torcharm.inputs import three_digits

    values = [row.get(name) for row in rows]
    if any(value is not None for value in values):
        yield Column(title, ["-" if value is None else three_digits(value) for value in values])
