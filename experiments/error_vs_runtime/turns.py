"""What polishing takes, next to as many samples as it is to be compared with: measured in turn.

A machine that does other work is slower for seconds at a time; of calls in turn, all are.
"""

import time
from functools import cache, partial

import numpy as np

from experiments.error_vs_runtime import measure
from experiments.error_vs_runtime.rows import Row
from experiments.error_vs_runtime.sets import ARMS, BATCH, METHODS, NODES, Calls, Jobs, Method

SAMPLES = 9
ROUNDS = {BATCH: 21, NODES: 101}
"""So many calls each."""
COMPARED = tuple(
    method for method in METHODS if method.polish or (method.hull == "exact" and method.samples == SAMPLES)
)
FAMILY = "in turn"


def jobs() -> Jobs:
    for arm in ARMS:
        for metric in ("absolute", "relative"):
            for batch in ROUNDS:
                for method in COMPARED:
                    key = (FAMILY, f"{arm}, {metric}", method.name, method.setting, "float64", str(batch))
                    yield key, partial(row, arm, metric, method, batch)


def row(arm: str, metric: str, method: Method, batch: int) -> Row:
    """Times of calls of one method, measured with all of them; no errors."""
    forward, gradient = _timings(arm, metric, batch)[method]
    return Row(
        family=FAMILY,
        case=f"{arm}, {metric}",
        method=method.name,
        setting=method.setting,
        dtype="float64",
        batch=batch,
        problems=0,
        converged=measure.NAN,
        **measure.not_measured(),
        **measure.error_columns(np.array([np.nan])),
        **measure.slope_columns(np.empty(0)),
        **measure.time_columns(forward, gradient, batch),
    )


@cache
def _timings(arm: str, metric: str, batch: int) -> dict[Method, tuple[measure.Timing, measure.Timing]]:
    """Times of calls, and of calls with gradients."""
    spent: dict[Method, tuple[list[float], list[float]]] = {method: ([], []) for method in COMPARED}
    for number in range(ROUNDS[batch] + 1):
        for method, both in spent.items():
            calls = Calls.of(arm, metric, method, "float64", batch)
            for call, times in zip((calls.forward, calls.gradient), both, strict=True):
                start = time.perf_counter()
                call(number)
                if number:  # the first loads what is loaded late
                    times.append(time.perf_counter() - start)
    return {
        method: (measure.timing(forward), measure.timing(gradient)) for method, (forward, gradient) in spent.items()
    }
