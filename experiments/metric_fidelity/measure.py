"""What each metric says of a case, what the search finds, and how long they take."""

import csv
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from scipy.stats import spearmanr

import torcharm as ta
from experiments.metric_fidelity.cases import Case, case_name, many_actuators
from experiments.metric_fidelity.surrogate import qp_surrogate
from experiments.paper import paper_equilibrium, paper_task

Column = npt.NDArray[np.float64]
AGREE = 1.01
"""A start agrees with the best if its error is at most so many times it."""
MODERATE = 0.1
"""A true error below which relative errors are reported [m]."""
METRICS = ("absolute", "relative", "weighted", "predicted", "qp")
RESULTS = Path(__file__).with_name("results.csv")


@dataclass(frozen=True)
class Found:
    """Columns over the loads of one case.

    Attributes:
        true: the search's error, the square root of its cost [m].
        agree: share of the search's starts that agree with its best.
        columns: metrics by name, and the flags of the predictions.
    """

    case: Case
    true: Column
    agree: Column
    columns: Mapping[str, Column]

    def spearman(self, metric: str, chosen: npt.NDArray[np.bool_] | slice = slice(None)) -> float:
        return float(spearmanr(self.true[chosen], self.columns[metric][chosen])[0])

    def relative_error(self, metric: str, moderate: bool = True) -> float:
        """Median of |predicted - true| / true, over true errors below `MODERATE` or over all; NaN of none."""
        chosen = (self.true < MODERATE) if moderate else np.isfinite(self.true)
        if not chosen.any():
            return float("nan")
        return float(np.median(np.abs(self.columns[metric] / self.true - 1)[chosen]))


Searched = tuple[Column, Column]
"""The true errors of a case, and the shares of starts that agree."""


def measure(case: Case, known: Searched | None = None) -> Found:
    """All columns of a case; of the search, which takes most of the time, those known already."""
    arm, task = case.design, case.task
    true, agree = known or _searched(arm, task)
    hulls = ta.evaluate(arm, task, ("absolute", "relative"))
    weighted = ta.evaluate(arm, task, metrics=("absolute",), weights=(0.01, 1.0), power=2)
    columns = {"absolute": hulls.absolute, "relative": hulls.relative, "weighted": weighted.absolute}
    found = ta.predict_error(arm, task)
    columns |= {"predicted": found.cost.sqrt(), "converged": found.converged, "stable": found.stable}
    columns["held"], columns["reached"] = _ends(arm, task, found)
    columns["qp"] = qp_surrogate(arm, task)
    numbers = {name: _column(value) for name, value in columns.items()}
    return Found(case, true, agree, numbers)


def _ends(arm: ta.ArmDesign, task: ta.Task, found: ta.PredictedError) -> tuple[torch.Tensor, torch.Tensor]:
    """Whether the shapes predicted are equilibria, and whether continuation from zero load reaches them."""
    held = paper_equilibrium(arm, found.pressure, task.tip_load, start=found.twists)
    reached = paper_equilibrium(arm, found.pressure, task.tip_load)
    near = [(end.twists - found.twists).abs().flatten(1).amax(-1) < 1e-3 for end in (held, reached)]
    return near[0] & held.converged, near[1] & reached.converged


def _searched(arm: ta.ArmDesign, task: ta.Task) -> Searched:
    search = ta.search_pressure(arm, task, starts=16)
    true = search.cost.sqrt()
    agree = (search.start_cost.sqrt() <= AGREE * true.unsqueeze(-1) + 1e-6).double().mean(-1)
    return _column(true), _column(agree)


def _column(value: torch.Tensor | None) -> Column:
    assert value is not None
    return value.double().numpy()


def write(found: Sequence[Found]) -> None:
    """A row for every case and load."""
    with RESULTS.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        names = list(found[0].columns)
        writer.writerow(["arm", "slope", "intercept", "moment_Nm", "load", "true_m", "starts_agree", *names])
        for one in found:
            head = [one.case.arm, *one.case.shape, one.case.moment]
            for load in range(len(one.true)):
                values = [one.true[load], one.agree[load], *(one.columns[name][load] for name in names)]
                writer.writerow([*head, load + 1, *(f"{value:.6g}" for value in values)])


def read() -> dict[str, Searched]:
    """What the searches of results.csv found, by the cases' names."""
    if not RESULTS.exists():
        return {}
    found: dict[str, tuple[list[float], list[float]]] = {}
    with RESULTS.open(newline="") as file:
        for row in csv.DictReader(file):
            name = case_name(row["arm"], (float(row["slope"]), float(row["intercept"])), float(row["moment_Nm"]))
            true, agree = found.setdefault(name, ([], []))
            true.append(float(row["true_m"]))
            agree.append(float(row["starts_agree"]))
    return {name: (np.array(true), np.array(agree)) for name, (true, agree) in found.items()}


@dataclass(frozen=True)
class Timing:
    """Processor time of a task [ms] in a batch: other work on the machine counts little."""

    what: str
    tasks: int
    milliseconds: float


def timings(tasks: int, searched: int) -> list[Timing]:
    """Hull metrics, predictions and search on the antagonistic arm; then growth with N and M."""
    arm = ta.antagonistic_arm()

    def task(count: int, nodes: int = 10) -> ta.Task:
        return paper_task(ta.affine_curvature(-3.0, 3.0, nodes=nodes), ta.sample_loads(count))

    batch = task(tasks)
    found = [_timed("absolute and relative", tasks, partial(ta.evaluate, arm, batch, METRICS[:2]))]
    found.append(_timed("predicted error", tasks, partial(ta.predict_error, arm, batch)))
    found.append(_timed("QP surrogate", tasks, partial(qp_surrogate, arm, batch)))
    found.append(_timed("search", searched, partial(ta.search_pressure, arm, task(searched))))
    for nodes in (5, 20, 40):
        found.append(_timed(f"predicted error, N = {nodes}", tasks, partial(ta.predict_error, arm, task(tasks, nodes))))
    for count in (2, 6, 8, 12):
        found.append(
            _timed(f"predicted error, M = {count}", tasks, partial(ta.predict_error, many_actuators(count), batch))
        )
    return found


def _timed(what: str, tasks: int, work: Callable[[], object]) -> Timing:
    times = []
    for _ in range(2):
        started = time.process_time()
        work()
        times.append(time.process_time() - started)
    return Timing(what, tasks, 1000 * min(times) / tasks)
