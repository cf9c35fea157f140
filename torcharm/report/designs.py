"""The table with one row a design, over all of its tasks or on one: its columns are told once, here."""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from torcharm.arm_series import segments_of
from torcharm.attainability import VERDICTS
from torcharm.inputs import three_digits
from torcharm.plot import VERDICT_STYLES
from torcharm.report.content import Column, Count
from torcharm.report.svg import themed
from torcharm.study import NamedArm, StudyResult, csv_text, summarise
from torcharm.study.results import DEG, MM

MOST = 0.9
"""The share of the loads within the second of the tip's errors that are told."""


class Measure(NamedTuple):
    """One number, word or list of counts about a design.

    Attributes:
        title, unit: of its column; without a title it is in none.
        name: of its column in CSV; "" has none.
        value: None where there is none.
        text: as the table shows it; None shows the number.
    """

    title: str
    unit: str
    name: str
    value: float | str | None
    text: str | Sequence[Count] | None = None

    @property
    def shown(self) -> str | Sequence[Count]:
        """In the table."""
        if self.text is not None:
            return self.text
        if self.value is None:
            return "–"
        return self.value if isinstance(self.value, str) else three_digits(self.value + 0.0)  # which makes -0 0


def design_table(rows: Sequence[Sequence[StudyResult]], sizes: bool = True) -> list[Column]:
    """Columns with a row for each design, of its results on the tasks to be told together, and of its sizes."""
    several = len({result.task.name for results in rows for result in results}) > 1
    found = [{one[:2]: one for one in _measures(results, sizes, several) if one.title} for results in rows]
    columns = [Column("design", "", [results[0].arm.name for results in rows], numeric=False)]
    for title, unit in dict.fromkeys(key for row in found for key in row):
        own = [row.get((title, unit), Measure(title, unit, "", None)) for row in found]
        if any(one.value is not None or one.text is not None for one in own):
            cells, words = [one.shown for one in own], any(isinstance(one.value, str) for one in own)
            columns.append(Column(title, unit, cells, not words and all(isinstance(cell, str) for cell in cells)))
    return columns


def design_csv(rows: Sequence[Sequence[StudyResult]]) -> str:
    """The same as text of a CSV file, with columns in the words of other files."""
    named = [{one.name: one.value for one in _measures(results) if one.name} for results in rows]
    return csv_text([{"arm": results[0].arm.name, **row} for results, row in zip(rows, named, strict=True)])


def _measures(results: Sequence[StudyResult], sizes: bool = True, several: bool = True) -> Iterator[Measure]:
    """What the table says of one design, over all loads of its results; `several` names tasks."""
    loads = sum(result.loads for result in results)
    yield Measure("", "", "loads", loads)
    yield from _verdicts(results, loads)
    for title, name, scale in (
        ("tip off", "tip_error", MM),
        ("turned", "tip_rotation_error", DEG),
        ("shape off", "shape_error", MM),
    ):
        yield from _errors(results, title, name, scale)
    yield from _sets(results, several)
    in_range = int(sum(result.attainability.in_range.sum() for result in results))
    yield Measure("in range", "", "in_range", in_range, f"{in_range} of {loads}")
    if sizes:
        yield from _sizes(results[0].arm)


def _verdicts(results: Sequence[StudyResult], loads: int) -> Iterator[Measure]:
    """How many loads have each verdict; of sets alone, how many they do not exclude."""
    summaries = [summarise(result) for result in results]
    if any(summary.verdicts is None for summary in summaries):
        free = sum(summary.not_excluded or 0 for summary in summaries)
        yield Measure("not excluded", "", "not_excluded", free, f"{free} of {loads}")
        return
    counted = Counter[str]()
    for summary in summaries:
        counted.update(summary.verdicts or {})
    bar = [Count(word, counted[word], themed(VERDICT_STYLES[word][0])) for word in VERDICTS if counted[word]]
    yield Measure("loads by verdict", "", "", None, bar)
    for word in VERDICTS:
        yield Measure("", "", word.replace(" ", "_"), counted[word])


def _errors(results: Sequence[StudyResult], title: str, name: str, scale: float) -> Iterator[Measure]:
    """The median of an error, and of the tip's place what most loads are within and the largest."""
    errors = _pooled(results, name)
    if errors is None:
        return
    errors = scale * np.where(np.isnan(errors), math.inf, errors)
    unit, ending = ("mm", "mm") if scale == MM else ("°", "deg")
    yield Measure(f"{title}, median", unit, f"{name}_median_{ending}", _finite(np.median(errors)))
    if name == "tip_error":
        # A load's own: between an error and none there is no number.
        most, share = np.quantile(errors, MOST, method="higher"), f"{100 * MOST:.0f}"
        yield Measure(f"{title}, {share}\N{NO-BREAK SPACE}%", unit, f"{name}_{share}_percent_{ending}", _finite(most))
        yield Measure(f"{title}, largest", unit, f"{name}_largest_{ending}", _finite(errors.max()))


def _sets(results: Sequence[StudyResult], several: bool) -> Iterator[Measure]:
    """The node that lacks most on average over the loads of a task, and the least margin of all loads."""
    summaries = {result.task.name: summarise(result) for result in results}
    if any(summary.not_excluded is not None for summary in summaries.values()):
        task, worst = max(summaries.items(), key=lambda item: item[1].worst_miss)
        node = worst.worst_node
        yield Measure("worst task" if several else "", "", "worst_task", None if node is None else task)
        yield Measure("worst node", "", "worst_node", node)
        yield Measure("lacks there", "N", "worst_node_mean_miss_N", worst.worst_miss if node is not None else None)
    margin = _pooled(results, "capacity_margin")
    if margin is not None:
        yield Measure("least margin", "N", "capacity_margin_least_N", _finite(margin.min()))


def _sizes(arm: NamedArm) -> Iterator[Measure]:
    """How large a design is: neutral length, radius to the outermost axis, how many are driven, mass with links."""
    segments, links = segments_of(arm.design)
    across = max(float(segment.offsets.detach().norm(dim=-1).max()) for segment in segments)
    driven = int((arm.design.max_pressure > 0).sum())
    yield Measure("length", "mm", "length_mm", MM * float(arm.design.neutral_length.detach()))
    yield Measure("radius", "mm", "radius_mm", MM * across)
    yield Measure("actuators", "", "driven_actuators", driven, str(driven))
    mass = sum(float(part.mass.detach()) for part in (*segments, *links) if part is not None)
    yield Measure("mass", "kg", "mass_kg", mass if mass > 0 else None)


def _pooled(results: Sequence[StudyResult], name: str) -> NDArray[np.float64] | None:
    """A number of each load of all results; None where one has none."""
    values = [getattr(result.attainability, name) for result in results]
    if any(value is None for value in values):
        return None
    return np.concatenate([value.detach().double().cpu().numpy().ravel() for value in values])


def _finite(value: Any) -> float | None:
    return float(value) if math.isfinite(value) else None
