"""A study evaluated: every arm on every task, summed up in tables."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from os import PathLike

import numpy as np
import torch
from torch import Tensor

from torcharm.attainability import PREDICTED, Attainability, evaluate
from torcharm.files import atomic_write, plain_cell
from torcharm.study.data import NamedArm, NamedTask, Settings, Study
from torcharm.wrench_sets.node_distances import METRICS

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

        Where only the predicted error was asked for: whether it is at most `TOLERABLE`, converged, stable and reached
        by loading. What did not converge is not attainable.
        """
        names = [name for name in self.settings.metrics if name in METRICS] or [PREDICTED]
        return torch.stack([self.within(name) for name in names]).all(0)

    def within(self, name: str) -> Tensor:
        """Whether a metric that was asked for is at 0 (signed: or below), or the predicted error at most `TOLERABLE`,
        and is to be trusted, (*task batch)."""
        found = self.attainability
        if name == PREDICTED:
            prediction = found.prediction
            assert prediction is not None
            return (self.metric(name) <= TOLERABLE) & prediction.converged & prediction.stable & prediction.reached
        return (self.metric(name) <= 0) & found.distances_converged

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
        attainable: how many loads have each metric at 0 (signed: or below) and converged; the predicted error at
            `TOLERABLE`, converged, stable and reached by loading.
        all_attainable: how many loads are attainable, as of `StudyResult`.
        worst_node: from 1, the node with the largest mean distance by the node metric; None if none misses.
        strain_excess: largest strain beyond its actuator's characterised range, 0 if none is.
        limits_in_range: whether the pressure limits lie in the characterised range.
        impossible: how many loads are on a shape that leaves an actuator no length.
        unpredicted: for how many loads, on shapes that are possible, no stable equilibrium was found by prediction.
    """

    loads: int
    median: Mapping[str, float]
    attainable: Mapping[str, int]
    all_attainable: int
    worst_node: int | None
    strain_excess: float
    limits_in_range: bool
    impossible: int
    unpredicted: int


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
    found = result.attainability
    values = {name: result.metric(name) for name in result.settings.metrics}
    design = result.arm.design
    characterised = design.max_pressure.new_tensor([model.pressure_range[1] for model in design.actuators])
    distance, prediction, impossible = result.node_distance, found.prediction, found.impossible
    return Summary(
        loads=result.attainable.numel(),
        median={name: float(np.median(value.detach().cpu().numpy())) for name, value in values.items()},
        attainable={name: int(result.within(name).sum()) for name in values},
        all_attainable=int(result.attainable.sum()),
        worst_node=None if distance is None else int(_worst_node(_mean_over_loads(distance))) or None,
        strain_excess=float(found.strain_excess.max()),
        limits_in_range=bool((design.max_pressure <= characterised).all()),
        impossible=int(impossible.sum()),
        unpredicted=0 if prediction is None else int((~prediction.stable & ~impossible).sum()),
    )


def write_results(path: str | PathLike[str], results: Sequence[StudyResult]) -> int:
    """Write a CSV file with a row for every arm, task and load; returns the number of rows.

    The file appears whole, and what was there stays if it cannot be written. Names that a spreadsheet would take for
    formulas, with =, +, - or @ first, get an apostrophe before them.

    Columns: arm; task; load, counted from 1; force_x_N, force_y_N and moment_Nm at the tip; each
    metric that was asked for (predicted_error in metres); worst_node, counted from 1, with the largest
    distance by the first of the metrics of wrenches (empty if no node misses); attainable, as of
    `StudyResult`; in_range, strain_excess, impossible and converged as in `Attainability`; and where the predicted
    error was asked for: stable and reached, as in `PredictedError`, and the pressure that reaches it, pressure_1_kPa
    and so on, one for each actuator, left empty where the arm has fewer than others or no stable equilibrium was found.
    Numbers are written in full, truths as true and false.

    Raises:
        ValueError: the results were not evaluated with the same metrics.
        OSError: the file cannot be written.
    """
    metrics = {result.settings.metrics for result in results}
    if len(metrics) > 1:
        raise ValueError(f"results: must have the same metrics, got {' and '.join(map(str, sorted(metrics)))}")
    asked = next(iter(metrics), METRICS)
    header = ["arm", "task", "load", "force_x_N", "force_y_N", "moment_Nm", *asked]
    header += ["worst_node", "attainable", "in_range", "strain_excess", "impossible", "converged"]
    if PREDICTED in asked:
        most = max((result.arm.design.actuator_count for result in results), default=0)
        header += ["stable", "reached", *(f"pressure_{index}_kPa" for index in range(1, most + 1))]
    rows = [[*row, *[""] * (len(header) - len(row))] for result in results for row in _rows(result)]
    with atomic_write(path) as partial, partial.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)
    return len(rows)


def _rows(result: StudyResult) -> Iterator[list[object]]:
    found, task = result.attainability, result.task.task
    loads = task.tip_load.expand(*task.batch_shape, 3).reshape(-1, 3).tolist()
    distance = result.node_distance
    worst = [0] * len(loads) if distance is None else _worst_node(distance).flatten().tolist()
    metrics = [result.metric(name).flatten().tolist() for name in result.settings.metrics]
    flags = (result.attainable, found.in_range, found.impossible, found.converged)
    attainable, within, impossible, converged = (_truths(flag) for flag in flags)
    excess = found.strain_excess.flatten().tolist()
    extra: list[list[object]] = [[] for _ in loads]
    if found.prediction is not None:
        prediction = found.prediction
        stable, reached = _truths(prediction.stable), _truths(prediction.reached)
        pressures = prediction.pressure.flatten(0, -2).tolist()
        extra = [
            [stays, arrived, *(row if stays == "true" else [])]
            for stays, arrived, row in zip(stable, reached, pressures, strict=True)
        ]
    names = plain_cell(result.arm.name), plain_cell(result.task.name)
    for index, load in enumerate(loads):
        yield [
            *(*names, index + 1, *load, *(column[index] for column in metrics)),
            *(worst[index] or "", attainable[index], within[index], excess[index], impossible[index]),
            *(converged[index], *extra[index]),
        ]


def _truths(flags: Tensor) -> list[str]:
    return [str(flag).lower() for flag in flags.flatten().tolist()]


def _mean_over_loads(distance: Tensor) -> Tensor:
    """(N,) from (*task batch, N)."""
    return distance.reshape(-1, distance.shape[-1]).mean(0)


def _worst_node(distance: Tensor) -> Tensor:
    """(...) From 1, the node with the largest of the distances (..., N) or the first NaN; 0 if all are 0 or inf."""
    largest, index = distance.max(-1)
    return torch.where((largest == 0) | largest.isinf(), 0, index + 1)
