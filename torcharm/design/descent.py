"""Descents from many starts, which can be watched, stopped and taken up again."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from torcharm.design.checkpoint import Checkpoint
from torcharm.design.feasible import FEASIBLE
from torcharm.design.objective import Objective, Problem
from torcharm.design.space import Array

REASONS = {0: "optimal", 8: "stalled", 9: "iterations"}
"""What SciPy's SLSQP says when it ends: no step promises a gain; none gives the gain that was promised, as at a kink;
or so many were made."""
PATIENCE = 12
"""Evaluations without a gain of the tolerance after which a descent ends: two vain searches along a line."""
HIGH = 10.0
"""Times the value at the start, which stands for a value that is no number, so that the descent turns back."""


class Stopped(Exception):
    """A descent is to end; its message is why."""


@dataclass
class Progress:
    """What is done of an optimisation, and when it is enough.

    Attributes:
        callback: is told this after each evaluation; returns True to stop.
        starts: in all.
        limit: seconds after which to stop; None sets no limit.
        start: of these, how many have ended.
        evaluations: designs evaluated on all tasks.
        value: the best so far.
        begun: when the call began, by `time.perf_counter`.
    """

    callback: "Callback | None"
    starts: int
    limit: float | None = None
    start: int = 0
    evaluations: int = 0
    value: float = np.inf
    begun: float = field(default_factory=time.perf_counter)

    @property
    def seconds(self) -> float:
        """Since the call."""
        return time.perf_counter() - self.begun

    def evaluated(self, value: float) -> None:
        """Another design was evaluated; the value is that of the best feasible one of this start, or infinite.

        Raises:
            Stopped: that is enough.
        """
        self.evaluations += 1
        self.value = min(self.value, value)
        if self.callback is not None and self.callback(self) is True:
            raise Stopped("callback")
        if self.limit is not None and self.seconds >= self.limit:
            raise Stopped("time")


Callback = Callable[[Progress], object]


@dataclass(frozen=True, eq=False)
class End:
    """Where a descent ended: its best feasible point (F,), the value there, and why in a word."""

    point: Array
    value: float
    reason: str


def descend(
    problem: Problem, start: Array, iterations: int, tolerance: float, progress: Progress | None
) -> tuple[End, str]:
    """The best design of a descent from a feasible point (F,), and why it was stopped, if it was.

    A gain below the tolerance, as a share of the value at the start, is not worth a step. Without progress, which is
    told of every evaluation, values are those of a guide.
    """
    best, lowest, scale, vain = start, np.inf, 0.0, 0

    def function(point: Array) -> tuple[float, Array]:
        nonlocal best, lowest, scale, vain
        point = np.clip(point, 0, 1)
        value, followed, gradient = problem.slope(point)
        sound = bool(np.isfinite(followed) and np.isfinite(gradient).all())
        vain += 1
        if sound and value < lowest and problem.designs.violation(point) <= FEASIBLE:
            vain = 0 if value < lowest - tolerance * scale else vain
            best, lowest = point, value
        if progress is not None:
            progress.evaluated(lowest)
        if vain > PATIENCE:
            raise Stopped("stalled")
        scale = scale or (max(abs(followed), 1e-12) if sound else 0.0)
        return (followed / scale, gradient / scale) if sound else (HIGH, np.zeros_like(point))

    reason, stopped = "stopped", "finished"
    try:
        answer = problem.designs.minimise(function, start, iterations, tolerance)
        reason = REASONS.get(answer.status, str(answer.message).lower())
    except Stopped as stop:
        reason, stopped = ("stalled", stopped) if str(stop) == "stalled" else (reason, str(stop))
    except KeyboardInterrupt:
        stopped = "interrupted"
    return End(best, lowest, reason if np.isfinite(lowest) else "no candidate"), stopped


def descend_all(
    problem: Problem,
    starts: Sequence[Array],
    iterations: int,
    tolerance: float,
    progress: Progress,
    checkpoint: Checkpoint | None,
    name: str = "",
) -> tuple[list[End], str]:
    """Descents from all starts, those that a checkpoint holds excepted, until one is stopped; and why it was.

    By predicted errors every other start, the first one included, is led by unattainability first. That has a slope
    even where no equilibrium is stable, and fewer local minima; the lowest of them are found without it at times.
    """
    ends: list[End] = []
    guide = replace(problem, objective=Objective("unattainability"))
    for index, start in enumerate(starts):
        key = f"{name} start {index}".strip()
        known = None if checkpoint is None else checkpoint.finished.get(key)
        if known is not None:
            ends.append(End(np.array(known["point"]), known["value"], known["reason"]))
        else:
            stopped = "finished"
            if problem.objective.metric == "predicted_error" and index % 2 == 0:
                led, stopped = descend(guide, start, iterations, tolerance, None)
                start = led.point
            if stopped == "finished":
                end, stopped = descend(problem, start, iterations, tolerance, progress)
                ends.append(end)
            if stopped != "finished":
                return ends, stopped
            if checkpoint is not None:
                checkpoint.add(key, {"point": end.point.tolist(), "value": end.value, "reason": end.reason})
        progress.start += 1
    return ends, "finished"
