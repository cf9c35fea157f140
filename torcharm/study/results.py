"""A study evaluated: every arm on each of its tasks, summed up in tables and written to files."""

import csv
import io
import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from torcharm.attainability import VERDICTS, Attainability, evaluate
from torcharm.files import atomic_write, is_stream, plain_cell
from torcharm.inputs import HoldsTensors
from torcharm.pressure.search import PressureSearch
from torcharm.study.data import NamedArm, NamedTask, Settings, Study
from torcharm.workspaces import Workspace
from torcharm.wrench_sets.node_distances import METRICS

RESULT_FORMATS = ("csv", "json")
MM, DEG = 1e3, 180.0 / np.pi
"""In a metre, and in a radian: files and tables hold lengths in millimetres, and angles in degrees."""
ERRORS = (
    ("tip off", "tip_error", "mm", MM),
    ("turned", "tip_rotation_error", "deg", DEG),
    ("shape", "shape_error", "mm", MM),
)
"""Of errors the title in tables, the name, and unit and scale in tables and files."""


@dataclass(frozen=True)
class StudyResult(HoldsTensors):
    """What `torcharm.evaluate` found for one arm on one task, or a pressure search in its words.

    A load has the task's batch shape.

    Attributes:
        arm, task: what was evaluated.
        settings: how.
        attainability: what was found.
    """

    arm: NamedArm
    task: NamedTask
    settings: Settings
    attainability: Attainability

    @property
    def loads(self) -> int:
        """How many loads there are."""
        return self.attainability.strain_excess.numel()

    @property
    def verdicts(self) -> list[str] | None:
        """One for each load; None where only sets were asked."""
        found = self.attainability.verdict
        return None if found is None else [str(word) for word in np.ravel(np.asarray(found))]

    @property
    def reasons(self) -> list[str]:
        """Why a load is not held, one for each; empty where it is."""
        return [str(word) for word in np.ravel(np.asarray(self.attainability.reason))]


@dataclass(frozen=True)
class Summary:
    """A result over all loads; medians are over loads, of what was asked for.

    Attributes:
        loads: how many.
        verdicts: how many loads have each verdict, those that none has left out; None where only sets were asked.
        not_excluded: how many loads sets do not exclude, of distances that converged; None where no set was asked.
        median: of tip_error [m], tip_rotation_error [rad], shape_error [m], absolute and relative [N].
        worst_node: from 1, the node with the largest mean distance from its set; None if none misses.
        worst_miss: that mean distance [N].
        example: the load, from 1, that is furthest beyond the tolerance (of sets alone: that lacks most) of those with
            the most frequent verdict but held; that verdict, "" of sets alone; and its reason. None if all are held.
    """

    loads: int
    verdicts: Mapping[str, int] | None
    not_excluded: int | None
    median: Mapping[str, float]
    worst_node: int | None
    worst_miss: float
    example: tuple[int, str, str] | None

    @property
    def held(self) -> int:
        """How many loads are held; where only sets were asked, how many they do not exclude."""
        return (self.not_excluded or 0) if self.verdicts is None else self.verdicts.get("held", 0)


def evaluate_arm(
    arm: NamedArm, task: NamedTask, settings: Settings, found: PressureSearch | None = None
) -> StudyResult:
    """What `torcharm.evaluate` finds for one arm on one task, or a pressure search that was made, in its words."""
    return StudyResult(arm, task, settings, evaluate(arm.design, task.task, found=found, **vars(settings)))


def evaluate_study(study: Study) -> Iterator[StudyResult]:
    """Evaluate every arm on its tasks, one after the other: task by task, in the study's order of arms."""
    for arm, task in study.pairs:
        yield evaluate_arm(arm, task, study.settings)


def summarise(result: StudyResult) -> Summary:
    """Counts and medians over the loads of one result."""
    found, words = result.attainability, result.verdicts
    columns = {name: getattr(found, name) for name in ("tip_error", "tip_rotation_error", "shape_error", *METRICS)}
    values = {name: _flat(value) for name, value in columns.items() if value is not None}
    miss = found.node_miss
    by_node = None if miss is None else _flat(miss).reshape(-1, miss.shape[-1]).mean(0)
    missing = by_node is not None and 0 < by_node.max() < np.inf
    return Summary(
        loads=result.loads,
        verdicts=None if words is None else {word: count for word in VERDICTS if (count := words.count(word))},
        not_excluded=None if found.not_excluded is None else int(found.not_excluded.sum()),
        median={name: float(np.median(value)) for name, value in values.items()},
        worst_node=int(by_node.argmax()) + 1 if by_node is not None and missing else None,
        worst_miss=float(by_node.max()) if by_node is not None and missing else 0.0,
        example=_example(result),
    )


def _example(result: StudyResult) -> tuple[int, str, str] | None:
    """The `example` of a summary."""
    found, reasons, words = result.attainability, result.reasons, result.verdicts or [""] * result.loads
    open_loads = [index for index, reason in enumerate(reasons) if reason]
    if not open_loads:
        return None
    most = Counter(words[index] for index in open_loads).most_common(1)[0][0]
    sizes = found.over_tolerance, found.absolute, found.relative
    size = next((_flat(value) for value in sizes if value is not None), np.zeros(result.loads))
    index = max((index for index in open_loads if words[index] == most), key=lambda one: size[one])
    return index + 1, most, reasons[index]


def write_results(path: str | PathLike[str], results: Sequence[StudyResult], ending: str | None = None) -> int:
    """Write a row for every arm, task and load by `write_rows`; returns their number.

    Columns: arm; task; load, counted from 1; force_x_N, force_y_N and moment_Nm at the tip (in space six); verdict and
    reason; tip_error_mm, tip_rotation_error_deg and shape_error_mm; worst_node, counted from 1, and worst_miss_N;
    absolute_N and relative_N, the paper's sums, which mix N and N·m by the weights as the miss does; capacity_margin_N,
    above 0 inside, where the settings are signed; in_range, strain_excess and status, as in `Attainability`; and the
    pressure that comes nearest, pressure_1_kPa and so on, one for each actuator that is driven: passive ones, of limit
    0, have none.

    Raises:
        ValueError: the ending is none of `RESULT_FORMATS`.
        OSError: the file cannot be written.
    """
    return write_rows(path, [row for result in results for row in result_rows(result)], ending)


def write_rows(path: str | PathLike[str], rows: Sequence[Mapping[str, Any]], ending: str | None = None) -> int:
    """Write the rows of a table, as CSV or JSON by its ending; returns their number. All commands write by it.

    The file appears whole, and what was there stays if it cannot be written. In CSV, texts that a spreadsheet would
    take for formulas, with =, +, - or @ first, get an apostrophe before them, truths are true and false, and what does
    not apply is empty; in JSON it is null, or left out of rows to which the column does not belong.

    Columns end in the unit of their numbers, the same in all commands: lengths in mm, angles in deg, pressures in kPa,
    forces in N and moments in Nm.

    Args:
        path: of the file; a stream gets CSV.
        rows: cells by the names of their columns, which need not be the same in all rows.
        ending: by which the format is chosen, such as ".csv"; None takes that of the path.

    Raises:
        ValueError: the ending is none of `RESULT_FORMATS`.
        OSError: the file cannot be written.
    """
    given = Path(path).suffix if ending is None else ending
    kind = "csv" if is_stream(path) else given.lower().removeprefix(".")
    if kind not in RESULT_FORMATS:
        raise ValueError(f"{path}: must end in .{' or .'.join(RESULT_FORMATS)}, got {kind or 'no ending'}")
    text = f"{json.dumps(list(rows), indent=1)}\n" if kind == "json" else csv_text(rows)
    with atomic_write(path) as partial:
        partial.write_text(text, encoding="utf-8", newline="")
    return len(rows)


def csv_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """The rows of a table as the text of a CSV file, as `write_rows` has it."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(dict.fromkeys(name for row in rows for name in row)), lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: _cell(value) for name, value in row.items()} for row in rows)
    return text.getvalue()


def result_rows(result: StudyResult) -> Iterator[dict[str, Any]]:
    """A row for each load, with the columns of `write_results`; None where there is no value."""
    found, task = result.attainability, result.task.task
    columns = found.to_dict()
    tip = task.tip_load.detach().expand(*task.batch_shape, -1).reshape(result.loads, -1)
    lead: dict[str, Sequence[Any]] = dict(zip(LOADS[tip.shape[-1]], tip.mT.tolist(), strict=True))
    lead |= {name: columns.pop(name) for name in ("verdict", "reason") if name in columns}
    columns = {name: values for name, values in columns.items() if name not in ("design", "task", "impossible")}
    if "worst_node" in columns:
        pairs = zip(columns["worst_node"], columns["worst_miss"], strict=True)
        columns["worst_node"] = [node + 1 if 0 < miss < math.inf else None for node, miss in pairs]
    columns = file_columns(result.arm, columns)
    stable = [] if found.prediction is None else found.prediction.stable.flatten().tolist()
    for load, values in enumerate(zip(*lead.values(), *columns.values(), strict=True)):
        row = dict(zip((*lead, *columns), values, strict=True))
        if stable and not stable[load]:
            row |= dict.fromkeys(name for name in row if name.startswith("pressure_"))
        yield {"arm": result.arm.name, "task": result.task.name, "load": load + 1} | row


NOWHERE = ("not converged", "impossible")
"""States without an equilibrium: their tips are nowhere."""


def workspace_rows(arm: NamedArm, found: Workspace) -> Iterator[dict[str, Any]]:
    """A row for each state of an arm, numbered from 1.

    Columns: arm; state; tip_x_mm, tip_y_mm and, in space, tip_z_mm; in the plane heading_deg, in space elevation_deg,
    of the tip's axis above the horizontal; status and strain_excess, as in `Workspace`; payload_factor, where there is
    a payload; pressure_1_kPa and so on, one for each actuator that is driven.
    """
    names = {"tip_angle": "heading" if found.dimension == 2 else "elevation"}
    columns = file_columns(arm, {names.get(name, name): values for name, values in found.to_dict().items()})
    places = [name for name in columns if name.endswith(("_mm", "_deg"))]
    for state, values in enumerate(zip(*columns.values(), strict=True), 1):
        row = {"arm": arm.name, "state": state, **dict(zip(columns, values, strict=True))}
        yield row | (dict.fromkeys(places) if row["status"] in NOWHERE else {})


def file_columns(arm: NamedArm, columns: Mapping[str, Sequence[Any]]) -> dict[str, list[Any]]:
    """Columns of a result's `to_dict` as files have them: each in the unit that its name ends in.

    What is not finite is None, as JSON has no other word for it. Pressures are those of driven actuators alone.
    """
    limits, found = arm.design.max_pressure.tolist(), {}
    passive = {f"pressure_{index}" for index, limit in enumerate(limits, 1) if limit <= 0}
    for name, values in columns.items():
        if name in passive:
            continue
        unit, scale = next((unit for part, unit in UNITS.items() if part in name), ("", 1.0))
        found[f"{name}_{unit}" if unit else name] = [_plain(value, scale) for value in values]
    return found


UNITS = {
    **dict.fromkeys(("rotation", "heading", "elevation"), ("deg", DEG)),
    **dict.fromkeys(("error", "tip_x", "tip_y", "tip_z"), ("mm", MM)),
    **dict.fromkeys(("absolute", "relative", "miss", "margin"), ("N", 1.0)),
    "pressure": ("kPa", 1.0),
}
"""By a part of what a result calls a column the unit of a file's, and how many there are in that of the result."""


def _plain(value: Any, scale: float) -> Any:
    if not isinstance(value, float):
        return value
    return scale * value if math.isfinite(value) else None


LOADS = {
    3: ("force_x_N", "force_y_N", "moment_Nm"),
    6: ("force_x_N", "force_y_N", "force_z_N", "moment_x_Nm", "moment_y_Nm", "moment_z_Nm"),
}
"""Columns of a tip load, by its number of components."""


def _flat(value: Tensor) -> NDArray[Any]:
    return value.detach().cpu().numpy().ravel()


def _cell(value: Any) -> Any:
    """As CSV has it, which leaves None empty."""
    if isinstance(value, bool):
        return str(value).lower()
    return plain_cell(value) if isinstance(value, str) else value
