"""Times, memory, and statistics of errors."""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch.profiler import ProfilerActivity, profile

Array = NDArray[np.float64]
NAN = float("nan")


@dataclass(frozen=True)
class Timing:
    """Quartiles [s] of the time of a call, and of how many calls."""

    q25: float = NAN
    median: float = NAN
    q75: float = NAN
    repeats: int = 0


def timed(work: Callable[[int], object], budget: float, most: int = 31) -> Timing:
    """Time calls `work(0), work(1), ...` until the budget [s] is spent: three at least, or one if it is long."""
    spent: list[float] = []
    while len(spent) < most and (not spent or sum(spent) < budget or (len(spent) < 3 and spent[0] < budget)):
        start = time.perf_counter()
        work(len(spent))
        spent.append(time.perf_counter() - start)
    return timing(spent)


def timing(spent: list[float]) -> Timing:
    """Of the times [s] of calls."""
    low, middle, high = np.quantile(spent, (0.25, 0.5, 0.75))
    return Timing(float(low), float(middle), float(high), len(spent))


def timed_with_memory(work: Callable[[int], object], budget: float, most: int = 31) -> tuple[Timing, float]:
    """The time of calls, and the most memory [MiB] that torch holds during one, above what it held before.

    Memory is that of a first call, which warms up; one that takes longer than the budget is itself the
    measurement (watching memory costs microseconds an operation).
    """
    with _silent(), profile(activities=[ProfilerActivity.CPU], profile_memory=True) as found:
        start = time.perf_counter()
        work(0)
        first = time.perf_counter() - start
    trace: Any = found.profiler
    events = [event for event in trace.kineto_results.events() if event.name() == "[memory]"]
    held = np.cumsum([event.nbytes() for event in sorted(events, key=lambda event: event.start_ns())])
    peak = float(held.max(initial=0)) / 2**20
    return (Timing(first, first, first, 1) if first > budget else timed(work, budget, most)), peak


@contextmanager
def _silent() -> Iterator[None]:
    """Drop what is written to the process's standard error: the profiler says there when it starts and stops."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def errors(value: Array, reference: Array, scale: Array, converged: NDArray[np.bool_]) -> Array:
    """|value - reference| / scale; 1 where there is no value or its solver says that it failed."""
    with np.errstate(invalid="ignore"):
        found = np.abs(value - reference) / np.where(scale > 0, scale, 1.0)
    return np.where(np.isfinite(found) & converged, found, 1.0)


def error_columns(found: Array) -> dict[str, Any]:
    p50, p99 = np.quantile(found, (0.5, 0.99))
    return {
        "error_p50": float(p50),
        "error_p99": float(p99),
        "error_max": float(found.max()),
        "success_1e6": float((found <= 1e-6).mean()),
        "success_1e9": float((found <= 1e-9).mean()),
    }


def slope_columns(found: Array) -> dict[str, Any]:
    if not len(found):
        return dict.fromkeys(("slope_error_p50", "slope_error_p99", "slope_error_max"), NAN)
    p50, p99 = np.quantile(found, (0.5, 0.99))
    return {"slope_error_p50": float(p50), "slope_error_p99": float(p99), "slope_error_max": float(found.max())}


def time_columns(forward: Timing, gradient: Timing, batch: int) -> dict[str, Any]:
    return {
        "repeats": forward.repeats,
        "forward_q25_s": forward.q25,
        "forward_median_s": forward.median,
        "forward_q75_s": forward.q75,
        "forward_us_a_problem": forward.median / batch * 1e6,
        "gradient_q25_s": gradient.q25,
        "gradient_median_s": gradient.median,
        "gradient_q75_s": gradient.q75,
        "gradient_us_a_problem": gradient.median / batch * 1e6,
    }


def not_measured() -> dict[str, Any]:
    """The columns of a row that is of times or bounds alone."""
    names = ("memory_mib", "primal_max", "dual_max", "gap_max", "resolved", "in_range")
    return dict.fromkeys(names, NAN)
