"""Running a descent so that it can be watched, stopped and taken up again."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.optimise.descent import GOING, State, advance, blank
from torcharm.optimise.objective import Problem

if TYPE_CHECKING:
    from torcharm.optimise.checkpoint import Checkpoint

SAVE_EVERY = 10.0
"""Seconds between two writings of a checkpoint."""


@dataclass(frozen=True, eq=False)
class Report:
    """What a callback is told after each iteration.

    Attributes:
        iteration: how many are done.
        evaluations: designs evaluated on all tasks.
        seconds: so far, those before an interrupt included.
        value: the best value so far.
        design: which has it.
        going: how many starts have not ended.
    """

    iteration: int
    evaluations: int
    seconds: float
    value: float
    design: ArmDesign
    going: int


Callback = Callable[[Report], object]


@dataclass
class Log:
    """What is written down while an optimisation runs: one row an iteration.

    Attributes:
        evaluations, seconds: counted from the call, over all its runs if it was interrupted.
        values: the best value of each start.
    """

    evaluations: list[int] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    values: list[Any] = field(default_factory=list)

    def add(self, evaluations: int, seconds: float, values: Tensor) -> None:
        """Another row."""
        self.evaluations.append(evaluations)
        self.seconds.append(seconds)
        self.values.append(values.detach().numpy().copy())

    def values_array(self) -> Any:
        """(I+1, S)."""
        return np.array(self.values)


def descend(
    problem: Problem,
    points: Tensor,
    owner: Tensor,
    *,
    method: str,
    iterations: int,
    tolerance: float,
    checkpoint: "Checkpoint | None",
    callback: Callback | None,
    progress: bool,
    begun: float,
    seconds: float | None,
) -> tuple[State, Log, str]:
    """Descend from points until all have ended; also what was logged, and why the run stopped.

    Args:
        begun: when the call began, by `time.perf_counter`.
        seconds: after which to stop, counted from there and over all runs.

    Raises:
        ValueError: the checkpoint is of another problem.
    """
    state, log = (None, Log()) if checkpoint is None else checkpoint.resume()
    earlier = log.seconds[-1] if log.seconds else 0.0
    if state is None:
        state, count = advance(problem, blank(points, owner), method, tolerance, iterations)
        log.add(count, time.perf_counter() - begun, state.best_value)
    saved = time.perf_counter()
    stopped = "finished"
    with bar(progress, iterations * (1 if len(points) == len(problem.polytopes) else 2)) as show:
        try:
            while bool((state.reason == GOING).any()):
                state, count = advance(problem, state, method, tolerance, iterations)
                now = time.perf_counter()
                log.add(log.evaluations[-1] + count, earlier + now - begun, state.best_value)
                if progress or callback is not None:
                    report = _report(problem, state, log)
                    show(len(log.seconds) - 1, report.value, f"{report.going} of {len(points)} starts going")
                if checkpoint is not None and now - saved > SAVE_EVERY:
                    checkpoint.save(state, log)
                    saved = time.perf_counter()
                if callback is not None and callback(report) is True:
                    stopped = "callback"
                    break
                if seconds is not None and log.seconds[-1] >= seconds:
                    stopped = "time"
                    break
        except KeyboardInterrupt:
            stopped = "interrupted"
    if checkpoint is not None:
        checkpoint.save(state, log)
    return state, log, stopped


def _report(problem: Problem, state: State, log: Log) -> Report:
    best = int(state.best_value.argmin())
    design = problem.polytopes[int(state.owner[best])].design(state.best_point[best])
    value, going = float(state.best_value[best]), int((state.reason == GOING).sum())
    return Report(len(log.seconds) - 1, log.evaluations[-1], log.seconds[-1], value, design, going)


@contextmanager
def bar(wanted: bool, total: int) -> Iterator[Callable[[int, float, str], None]]:
    """A progress bar on the standard error, if wanted; yields what updates it."""
    if not wanted:
        yield lambda done, value, note: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("best {task.fields[value]}"), BarColumn(), TextColumn("{task.fields[note]}"))
    with Progress(*columns, TimeElapsedColumn(), console=Console(stderr=True)) as shown:
        task = shown.add_task("", total=total, value="-", note="")
        yield lambda done, value, note: shown.update(task, completed=done, value=f"{value:.6g}", note=note)
