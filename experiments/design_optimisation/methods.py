"""Quality against time: every method from the paper's arms, on all shapes and loads together, by one thread.

Methods are compared in sessions: the gradient method several times, then its rivals, one after the other. Times are
compared within a session, so that neither another load on the machine nor its caches tell for one of them.
"""

import statistics
import time
from collections.abc import Iterator, Sequence
from itertools import groupby

import torcharm as ta
from experiments.design_optimisation.rows import Row, Trace
from experiments.design_optimisation.scenes import FEW, LOADS, joint

PART = "methods"
NEAR = 1e-3
"""Within this share of the best value found by any method counts as there."""
TIMES = 55.0
"""Evolution goes on until so many times the gradient method's time have passed."""
LEAST_SECONDS = 6.0
OURS, STARTS, REPEATS = "bfgs", 16, 3
PLAIN, BATCHED = "differential_evolution", "batched_differential_evolution"
SESSIONS = {"local": ("adam", "slsqp", "nelder_mead"), "evolution": (PLAIN,), "evolution in batches": (BATCHED,)}
SEEDS = 3
LIMITS = {"nelder_mead": 600, "adam": 200, PLAIN: 100_000, BATCHED: 100_000}


def session(name: str, arm: str, design: ta.ArmDesign, quick: bool) -> tuple[list[Trace], list[Row]]:
    """The gradient method several times, each of one seed (they differ in time alone), then its rivals."""
    task = joint(FEW if quick else LOADS)
    for method in (OURS, *SESSIONS[name]):
        ta.optimise_design(design, task, method=method, starts=2, iterations=1, seconds=0.2)  # imports, warm caches
    traces: list[Trace] = []
    rows: list[Row] = []
    for repeat in range(1 if quick else REPEATS):
        found = ta.optimise_design(design, task, method=OURS, starts=STARTS, iterations=4 if quick else None)
        traces += traced(name, arm, OURS, repeat, found)
    rows += about(arm, OURS, found)
    ours = medians(traces, arm, OURS, found.value * (1 + NEAR))[0]
    for method in SESSIONS[name]:
        evolves = method in (PLAIN, BATCHED)
        for seed in range(SEEDS if evolves and not quick else 1):
            found = ta.optimise_design(
                design,
                task,
                method=method,
                starts=1,
                seed=seed,
                iterations=4 if quick else LIMITS.get(method),
                seconds=max(LEAST_SECONDS, TIMES * ours) if evolves else None,
            )
            traces += traced(name, arm, method, seed, found)
        rows += about(arm, method, found)
    rows.append(Row(PART, arm, "one design", "seconds of evaluate", one_evaluation(design, task), "s"))
    return traces, rows


def traced(name: str, arm: str, method: str, seed: int, found: ta.OptimisedDesign) -> Iterator[Trace]:
    """A run's history: all its improvements, and its end."""
    history, last = found.history, float("inf")
    columns = (history.seconds, history.evaluations, history.best)
    moments = list(zip(*(column.tolist() for column in columns), strict=True))
    for index, moment in enumerate(moments):
        if moment[-1] < last or index == len(moments) - 1:
            yield Trace(name, arm, method, seed, *moment)
        last = min(last, moment[-1])


def about(arm: str, method: str, found: ta.OptimisedDesign) -> Iterator[Row]:
    """What the traces do not tell of a run."""
    yield Row(PART, arm, method, "given", found.given_value, "N")
    yield Row(PART, arm, method, "start, in range", float(found.start_values[0]), "N")
    yield Row(PART, arm, method, "stationarity", found.stationarity, "share")
    yield Row(PART, arm, method, "projected gradient", float(found.projected_gradients.min()), "N")


def reached(run: Sequence[Trace], goal: float) -> tuple[float, float]:
    """Seconds and evaluations until a run was there; infinite if it never was."""
    there = [trace for trace in run if trace.value <= goal]
    return (there[0].seconds, there[0].evaluations) if there else (float("inf"), float("inf"))


def runs_of(traces: Sequence[Trace], arm: str, method: str) -> list[list[Trace]]:
    """The runs of a method."""
    own = [trace for trace in traces if trace.arm == arm and trace.method == method]
    return [list(run) for _, run in groupby(own, key=lambda trace: (trace.session, trace.seed))]


def medians(traces: Sequence[Trace], arm: str, method: str, goal: float) -> tuple[float, float]:
    """Over the runs of a method, of the seconds and evaluations until they were there."""
    times, counts = zip(*(reached(run, goal) for run in runs_of(traces, arm, method)), strict=True)
    return statistics.median(times), statistics.median(counts)


def summary(traces: Sequence[Trace]) -> Iterator[Row]:
    """How soon each method is within 0.1 % of the best value that any found, compared within its session."""
    for arm in dict.fromkeys(trace.arm for trace in traces):
        goal = min(trace.value for trace in traces if trace.arm == arm) * (1 + NEAR)
        for name in dict.fromkeys(trace.session for trace in traces if trace.arm == arm):
            own = [trace for trace in traces if trace.arm == arm and trace.session == name]
            ours = medians(own, arm, OURS, goal)
            for method in dict.fromkeys(trace.method for trace in own):
                label = f"{method}, session of {name}" if method == OURS else method
                yield from compared(own, arm, method, label, goal, ours)


def compared(
    own: Sequence[Trace], arm: str, method: str, label: str, goal: float, ours: tuple[float, float]
) -> Iterator[Row]:
    """One method in one session."""
    runs = runs_of(own, arm, method)
    seconds, evaluations = medians(own, arm, method, goal)
    best = goal / (1 + NEAR)
    yield Row(PART, arm, label, "runs", len(runs), "runs")
    yield Row(PART, arm, label, "runs that got there", sum(run[-1].value <= goal for run in runs), "runs")
    yield Row(PART, arm, label, "best value, median", statistics.median(run[-1].value for run in runs), "N")
    excess = statistics.median(run[-1].value / best - 1 for run in runs)
    yield Row(PART, arm, label, "above the best of all, median", excess, "share")
    yield Row(PART, arm, label, "seconds, median", statistics.median(run[-1].seconds for run in runs), "s")
    yield Row(
        PART, arm, label, "evaluations, median", statistics.median(run[-1].evaluations for run in runs), "designs"
    )
    yield Row(PART, arm, label, "seconds to 0.1 %, median", seconds, "s")
    yield Row(PART, arm, label, "evaluations to 0.1 %, median", evaluations, "designs")
    # A run that does not get there takes longer than it was given.
    least = [min(reached(run, goal)[0], run[-1].seconds) / ours[0] for run in runs]
    yield Row(PART, arm, label, "time to 0.1 % (or to the end), median multiple", statistics.median(least), "times")
    yield Row(PART, arm, label, "time to 0.1 % (or to the end), least multiple", min(least), "times")
    yield Row(PART, arm, label, "evaluations to 0.1 %, median multiple", evaluations / ours[1], "times")


def one_evaluation(design: ta.ArmDesign, task: ta.Task) -> float:
    """Seconds of `evaluate` for one design by itself."""
    times = []
    for _ in range(20):
        begun = time.perf_counter()
        ta.evaluate(design, task, "absolute")
        times.append(time.perf_counter() - begun)
    return statistics.median(times)
