"""A study evaluated: every arm on every task, summed up in tables."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from os import PathLike

import numpy as np
import torch
from torch import Tensor

from torcharm.attainability import METRICS, PREDICTED, Attainability, evaluate
from torcharm.files import atomic_write, plain_cell
from torcharm.study.data import NamedArm, NamedTask, Settings, Study

TOLERABLE = 1e-3
"""A predicted shape error [m] that counts as none."""


@dataclass(frozen=True)
class StudyResult:
    """What `torcharm.evaluate` found for one arm on one task; a load has the task's batch shape.

    Attributes:
        arm, task: what was evaluated.
        settings: how.
        attainability: what was found.
    """

    arm: NamedArm
    task: NamedTask
    settings: Settings
    attainability: Attainability

    def metric(self, name: str) -> Tensor:
        """A metric that was asked for, (*task batch)."""
        found: Tensor = getattr(self.attainability, name)
        return found

    @property
    def attainable(self) -> Tensor:
        """Whether no metric of wrenches that was asked for is above 0, (*task batch); a NaN is not attainable.

        Where only the predicted error was asked for: whether it is at most `TOLERABLE`.
        """
        limits = {name: 0.0 for name in self.settings.metrics if name in METRICS} or {PREDICTED: TOLERABLE}
        return torch.stack([self.metric(name) <= limit for name, limit in limits.items()]).all(0)

    @property
    def node_metric(self) -> str | None:
        """The metric by which nodes are compared: the first of those asked for that is known per node."""
        known = (name for name in METRICS if getattr(self.attainability, f"{name}_per_node", None) is not None)
        return next(known, None)

    @property
    def node_distance(self) -> Tensor | None:
        """Distance of each node to its hull, (*task batch, N), by the node metric; 0 inside."""
        if self.node_metric is None:
            return None
        distance: Tensor = getattr(self.attainability, f"{self.node_metric}_per_node")
        return distance.clamp(min=0)


@dataclass(frozen=True)
class Summary:
    """A result over all loads.

    Attributes:
        loads: how many.
        median: of each metric.
        attainable: how many loads have each metric at 0 (signed: or below); the predicted error at `TOLERABLE`.
        all_attainable: how many loads are attainable, as of `StudyResult`.
        worst_node: from 1, the node with the largest mean distance by the node metric; None if none misses.
        strain_excess: largest strain beyond its actuator's characterised range, 0 if none is.
        limits_in_range: whether the pressure limits lie in the characterised range.
    """

    loads: int
    median: Mapping[str, float]
    attainable: Mapping[str, int]
    all_attainable: int
    worst_node: int | None
    strain_excess: float
    limits_in_range: bool


def evaluate_study(study: Study) -> list[StudyResult]:
    """Evaluate every arm on every task: task by task, in the study's order of arms."""
    options = asdict(study.settings)
    return [
        StudyResult(arm, task, study.settings, evaluate(arm.design, task.task, **options))
        for task in study.tasks
        for arm in study.arms
    ]


def summarise(result: StudyResult) -> Summary:
    """Medians and counts over the loads of one result."""
    values = {name: result.metric(name) for name in result.settings.metrics}
    design = result.arm.design
    characterised = design.max_pressure.new_tensor([model.pressure_range[1] for model in design.actuators])
    distance = result.node_distance
    return Summary(
        loads=result.attainable.numel(),
        median={name: float(np.median(value.detach().cpu().numpy())) for name, value in values.items()},
        attainable={
            name: int((value <= (TOLERABLE if name == PREDICTED else 0)).sum()) for name, value in values.items()
        },
        all_attainable=int(result.attainable.sum()),
        worst_node=None if distance is None else int(_worst_node(_mean_over_loads(distance))) or None,
        strain_excess=float(result.attainability.strain_excess.max()),
        limits_in_range=bool((design.max_pressure <= characterised).all()),
    )


def write_results(path: str | PathLike[str], results: Sequence[StudyResult]) -> int:
    """Write a CSV file with a row for every arm, task and load; returns the number of rows.

    The file appears whole, and what was there stays if it cannot be written. Names that a spreadsheet would take for
    formulas, with =, +, - or @ first, get an apostrophe before them.

    Columns: arm; task; load, counted from 1; force_x_N, force_y_N and moment_Nm at the tip; each
    metric that was asked for (predicted_error in metres); worst_node, counted from 1, with the largest
    distance by the first of the metrics of wrenches (empty if no node misses); attainable, as of
    `StudyResult`; in_range and strain_excess as in `Attainability`. Numbers are written in full, truths as
    true and false.

    Raises:
        ValueError: the results were not evaluated with the same metrics.
        OSError: the file cannot be written.
    """
    metrics = {result.settings.metrics for result in results}
    if len(metrics) > 1:
        raise ValueError(f"results: must have the same metrics, got {' and '.join(map(str, sorted(metrics)))}")
    asked = next(iter(metrics), METRICS)
    header = ["arm", "task", "load", "force_x_N", "force_y_N", "moment_Nm", *asked]
    rows = [row for result in results for row in _rows(result)]
    with atomic_write(path) as partial, partial.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*header, "worst_node", "attainable", "in_range", "strain_excess"])
        writer.writerows(rows)
    return len(rows)


def _rows(result: StudyResult) -> Iterator[list[object]]:
    found, task = result.attainability, result.task.task
    loads = task.tip_load.expand(*task.batch_shape, 3).reshape(-1, 3).tolist()
    distance = result.node_distance
    worst = [0] * len(loads) if distance is None else _worst_node(distance).flatten().tolist()
    columns = [
        *(result.metric(name) for name in result.settings.metrics),
        *(result.attainable, found.in_range, found.strain_excess),
    ]
    values = zip(*(column.flatten().tolist() for column in columns), strict=True)
    for index, (load, node, (*metrics, attainable, in_range, excess)) in enumerate(
        zip(loads, worst, values, strict=True), start=1
    ):
        truths = (str(attainable).lower(), str(in_range).lower())
        names = plain_cell(result.arm.name), plain_cell(result.task.name)
        yield [*names, index, *load, *metrics, node or "", *truths, excess]


def _mean_over_loads(distance: Tensor) -> Tensor:
    """(N,) from (*task batch, N)."""
    return distance.reshape(-1, distance.shape[-1]).mean(0)


def _worst_node(distance: Tensor) -> Tensor:
    """(...) From 1, the node with the largest of the distances (..., N) or the first NaN; 0 if all are 0."""
    largest, index = distance.max(-1)
    return torch.where(largest == 0, 0, index + 1)
