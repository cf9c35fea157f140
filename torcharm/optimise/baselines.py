"""scipy's optimisers on the same objective and constraints, to measure ours against.

SLSQP has torch's gradients; differential evolution and Nelder-Mead have none. What leaves the polytope is
judged at its projection: the constraints cost these methods nothing.
"""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torcharm.optimise import qp
from torcharm.optimise.descent import COOLING
from torcharm.optimise.objective import SMOOTHED, Problem
from torcharm.optimise.running import Callback, Log, Report, bar

SCIPY_METHODS = ("slsqp", "differential_evolution", "batched_differential_evolution", "nelder_mead")
POPULATIONS = ("differential_evolution", "batched_differential_evolution")
"""Methods that have a population of their own."""
LARGE = 1e30
"""Stands for a value that is no number: scipy's methods take it better than infinity."""
Array = npt.NDArray[np.float64]


class _StopError(Exception):
    """The callback asked for it, or time is up: the message says which."""


class _Recorder:
    """Judges points, and remembers the best of each start and when it was found."""

    def __init__(
        self,
        problem: Problem,
        points: Tensor,
        starts: int,
        callback: Callback | None,
        show: Callable[..., None] | None,
        begun: float,
        seconds: float | None,
    ) -> None:
        self.problem, self.callback, self.show = problem, callback, show
        self.begun = begun
        self.limit = float("inf") if seconds is None else seconds
        self.log = Log()
        self.evaluations = 0
        self.start = 0
        self.best_value = torch.full((starts,), torch.inf, dtype=torch.float64)
        self.best_point = points[:starts].clone()

    def judge(self, point: Tensor, temperature: float, *, gradient: bool) -> tuple[Array, Array]:
        """Values (S,) and gradients (S, F) of points (S, F), which are first projected if outside.

        With gradients the values are those of the smooth stand-in, else of the objective itself.
        """
        rows, bound = self.problem.polytopes[0].rows, self.problem.polytopes[0].bound
        if bool((point @ rows.T > bound + 1e-9).any()):
            point = point + qp.project(point, rows[None], bound[None]).step
        owner = torch.zeros(len(point), dtype=torch.long)
        heat = torch.full((len(point),), temperature, dtype=torch.float64)
        judged = self.problem.judge(point, owner, heat, gradient=gradient)
        self.evaluations += len(point)
        least = int(judged.value.argmin())
        if judged.value[least] < self.best_value[self.start]:
            self.best_value[self.start], self.best_point[self.start] = judged.value[least], point[least]
            self.log.add(self.evaluations, time.perf_counter() - self.begun, self.best_value)
        self._tell()
        slope = judged.gradient if judged.gradient is not None else torch.zeros_like(point)
        value = judged.smooth if gradient else judged.value
        return value.clamp(max=LARGE).numpy(), slope.numpy()

    def _tell(self) -> None:
        if time.perf_counter() - self.begun >= self.limit:
            raise _StopError("time")
        if self.show is None and self.callback is None:
            return
        best = int(self.best_value.argmin())
        value = float(self.best_value[best])
        if self.show is not None:
            self.show(self.start, value, f"{self.evaluations} designs evaluated")
        if self.callback is None:
            return
        design = self.problem.polytopes[0].design(self.best_point[best])
        seconds = time.perf_counter() - self.begun
        report = Report(len(self.log.seconds), self.evaluations, seconds, value, design, len(self.best_value))
        if self.callback(report) is True:
            raise _StopError("callback")


def run_scipy(
    problem: Problem,
    points: Tensor,
    *,
    method: str,
    iterations: int,
    tolerance: float,
    seed: int,
    callback: Callback | None,
    progress: bool,
    begun: float,
    seconds: float | None,
) -> tuple[Tensor, Tensor, list[str], Log, str]:
    """Best points and values of the starts, why each ended, what was logged, and why the run stopped.

    Args:
        begun: when the call began, by `time.perf_counter`.
        seconds: after which to stop, counted from there.
    """
    runs = {
        "slsqp": _slsqp,
        "nelder_mead": _nelder_mead,
        "differential_evolution": _evolution,
        "batched_differential_evolution": _batched_evolution,
    }
    starts = 1 if method in POPULATIONS else len(points)
    reasons = ["iterations"] * starts
    stopped = "finished"
    with bar(progress, starts) as show:
        recorder = _Recorder(problem, points, starts, callback, show if progress else None, begun, seconds)
        try:
            for index in range(starts):
                recorder.start = index
                reasons[index] = runs[method](recorder, points[index], iterations, tolerance, seed)
        except (KeyboardInterrupt, _StopError) as stop:
            stopped = str(stop) if isinstance(stop, _StopError) else "interrupted"
    recorder.log.add(recorder.evaluations, time.perf_counter() - recorder.begun, recorder.best_value)
    return recorder.best_point, recorder.best_value, reasons, recorder.log, stopped


def _slsqp(recorder: _Recorder, point: Tensor, iterations: int, tolerance: float, seed: int) -> str:
    from scipy.optimize import minimize

    polytope = recorder.problem.polytopes[0]
    rows, bound = polytope.rows.numpy(), polytope.bound.numpy()
    within = {"type": "ineq", "fun": lambda u: bound - rows @ u, "jac": lambda u: -rows}
    smooth = recorder.problem.objective.over not in SMOOTHED
    one = torch.ones(1, dtype=torch.float64)
    spread = float(recorder.problem.judge(point[None], one.long() * 0, one, gradient=False).spread)
    at, reason = point.numpy(), "failed"
    for cooled in (1.0,) if smooth else COOLING:
        # f is scaled to about 1, which SLSQP's stopping test needs.
        scale = max(abs(float(recorder.judge(torch.from_numpy(at)[None], cooled * spread, gradient=False)[0][0])), 1e-9)

        def fun(u: Array, scale: float = scale, heat: float = cooled * spread) -> tuple[float, Array]:
            value, slope = recorder.judge(torch.from_numpy(u)[None], heat, gradient=True)
            return value[0] / scale, slope[0] / scale

        answer = minimize(
            fun, at, jac=True, method="SLSQP", constraints=within, options={"maxiter": iterations, "ftol": tolerance}
        )
        at = answer.x
        reason = {0: "optimal", 9: "iterations"}.get(answer.status, "stalled")
    return reason


def _nelder_mead(recorder: _Recorder, point: Tensor, iterations: int, tolerance: float, seed: int) -> str:
    from scipy.optimize import minimize

    def fun(u: Array) -> float:
        return float(recorder.judge(torch.from_numpy(u)[None], 1.0, gradient=False)[0][0])

    free = len(point)
    start = point.numpy()
    # The default simplex is a few thousandths wide for coordinates near 0; this one is a tenth of the bounds.
    simplex = np.vstack((start, start + np.where(start > 0.5, -0.1, 0.1) * np.eye(free)))
    options: dict[str, Any] = {"maxiter": iterations, "xatol": 1e-6, "fatol": tolerance, "adaptive": True}
    answer = minimize(
        fun, start, method="Nelder-Mead", bounds=[(0, 1)] * free, options=options | {"initial_simplex": simplex}
    )
    return "stalled" if answer.success else "iterations"


def _evolution(recorder: _Recorder, point: Tensor, iterations: int, tolerance: float, seed: int) -> str:
    """scipy's defaults: one design at a time, each of which is a parent at once."""
    from scipy.optimize import differential_evolution

    def fun(u: Array) -> float:
        return float(recorder.judge(torch.from_numpy(u.copy())[None], 1.0, gradient=False)[0][0])

    bounds = [(0, 1)] * len(point)
    answer = differential_evolution(fun, bounds, x0=point.numpy(), maxiter=iterations, tol=tolerance, seed=seed)
    return "stalled" if answer.success else "iterations"


def _batched_evolution(recorder: _Recorder, point: Tensor, iterations: int, tolerance: float, seed: int) -> str:
    """A whole population in one call, which becomes the next generation together."""
    from scipy.optimize import differential_evolution

    def fun(u: Array) -> Array:
        points = torch.from_numpy(np.ascontiguousarray(u.reshape(len(point), -1).T))
        return recorder.judge(points, 1.0, gradient=False)[0]

    answer = differential_evolution(
        fun,
        [(0, 1)] * len(point),
        x0=point.numpy(),
        maxiter=iterations,
        tol=tolerance,
        seed=seed,
        polish=False,
        vectorized=True,
        updating="deferred",
    )
    return "stalled" if answer.success else "iterations"
