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
    from torcharm.study.results import ERRORS

    found = [summary for _, summary in rows]
    predicted, with_sets = found[0].verdicts is not None, found[0].not_excluded is not None
    scales = {name: (f"{name}_{unit}", scale) for _, name, unit, scale in ERRORS}
    medians = []
    for summary in found:
        named = [(*scales.get(name, (f"{name}_N", 1.0)), value) for name, value in summary.median.items()]
        medians.append({name: scale * value for name, scale, value in named})
    yield Column("arm", [result.arm.name for result, _ in rows], LONGEST_WORD)
    if predicted or with_sets:
        yield Column("held" if predicted else "not\nexcluded", [f"{one.held} of {one.loads}" for one in found])
    yield from error_columns(medians)
    if with_sets:
        nodes = ["-" if one.worst_node is None else f"{one.worst_node}: {one.worst_miss:.2g}" for one in found]
        yield Column("worst node:\nlacks [N]", nodes)
    others = [
        ",\n".join(f"{many} {word}" for word, many in (one.verdicts or {}).items() if word != "held") for one in found
    ]
    if any(others):
        yield Column("not held", [cell or "-" for cell in others], LONGEST_WORD)
    if sums or not predicted:
        yield from _sum_columns(medians)


def error_columns(rows: Sequence[Mapping[str, Any]], sums: bool = False) -> Iterator[Column]:
    """The verdict, if there is one, and the errors in rows as of files; with the paper's sums on request."""
    from torcharm.study.results import ERRORS

    if any(row.get("verdict") is not None for row in rows):
        yield Column("verdict", [str(row.get("verdict") or "-") for row in rows], LONGEST_WORD)
    for title, name, unit, _ in ERRORS:
        yield from number_column(rows, f"{name}_{unit}", f"{title}\n[{unit.replace('deg', '°')}]")
    if sums:
        yield from _sum_columns(rows)


def _sum_columns(rows: Sequence[Mapping[str, Any]]) -> Iterator[Column]:
    from torcharm.wrench_sets.node_distances import METRICS

    for name in METRICS:
        yield from number_column(rows, f"{name}_N", f"{name}\nsum [N]")


def number_column(rows: Sequence[Mapping[str, Any]], name: str, title: str) -> Iterator[Column]:
    """The numbers in a column of a file, if any row has one."""
    from torcharm.inputs import three_digits

    values = [row.get(name) for row in rows]
    if any(value is not None for value in values):
        yield Column(title, ["-" if value is None else three_digits(value) for value in values])
