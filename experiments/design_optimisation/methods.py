"""Quality against time: every method from the paper's arms, on all shapes and loads together, by one thread."""

import statistics
import time
from collections.abc import Iterator

import torcharm as ta
from experiments.design_optimisation.rows import Row, Trace
from experiments.design_optimisation.scenes import FEW, LOADS, joint

PART = "methods"
NEAR = 1e-3
"""Within this share of the best value found by any method counts as there."""
TIMES = 55.0
"""Evolution goes on until so many times the gradient method's time have passed."""
LEAST_SECONDS = 5.0
OURS = "bfgs"
PLAIN, BATCHED = "differential_evolution", "batched_differential_evolution"
LIMITS = {"nelder_mead": 600, "adam": 200}


def runs(quick: bool) -> Iterator[tuple[str, int, int]]:
    """Method, starts and seed; the gradient method first, several times, for its time is short."""
    for seed in range(1 if quick else 5):
        yield OURS, 8, seed
    yield "bfgs, 1 start", 1, 0
    yield "adam", 1, 0
    yield "slsqp", 1, 0
    yield "nelder_mead", 1, 0
    for method in (PLAIN, BATCHED):
        for seed in range(1 if quick else 3):
            yield method, 1, seed


def compare(arm: str, design: ta.ArmDesign, quick: bool) -> tuple[list[Row], list[Trace]]:
    """All methods on one arm. The repeats of the gradient method are of one seed: they differ in time alone."""
    task = joint(FEW if quick else LOADS)
    for method in ("bfgs", PLAIN):
        ta.optimise_design(design, task, method=method, starts=2, iterations=1, seconds=0.2)  # imports, warm caches
    traces: list[Trace] = []
    ends: list[tuple[str, int, ta.OptimisedDesign]] = []
    budget = LEAST_SECONDS
    for name, starts, seed in runs(quick):
        method = name.split(",")[0]
        evolves = method in (PLAIN, BATCHED)
        iterations = 4 if quick and not evolves else 100_000 if evolves else LIMITS.get(method)
        result = ta.optimise_design(
            design,
            task,
            method=method,
            starts=starts,
            seed=seed if evolves else 0,
            iterations=iterations,
            seconds=(0.3 if quick else budget) if evolves else None,
        )
        ends.append((name, seed, result))
        if name == OURS:
            own = [one.history.seconds_to(one.value * (1 + NEAR)) for label, _, one in ends if label == OURS]
            budget = max(LEAST_SECONDS, TIMES * statistics.median(own))
        columns = (result.history.seconds, result.history.evaluations, result.history.best)
        for moment in zip(*(column.tolist() for column in columns), strict=True):
            traces.append(Trace(arm, name, seed, *moment))
    return list(_rows(arm, ends, design, task)), traces


def _rows(
    arm: str, ends: list[tuple[str, int, ta.OptimisedDesign]], design: ta.ArmDesign, task: ta.Task
) -> Iterator[Row]:
    best = min(result.value for _, _, result in ends)
    goal = best * (1 + NEAR)
    ours = statistics.median(one.history.seconds_to(goal) for name, _, one in ends if name == OURS)
    evaluations = statistics.median(_evaluations_to(one, goal) for name, _, one in ends if name == OURS)
    for name in dict.fromkeys(name for name, _, _ in ends):
        own = [result for label, _, result in ends if label == name]
        reached = statistics.median(result.history.seconds_to(goal) for result in own)
        judged = statistics.median(_evaluations_to(result, goal) for result in own)
        yield Row(PART, arm, name, "given", own[0].given_value, "N")
        yield Row(PART, arm, name, "start, in range", float(own[0].start_values[0]), "N")
        yield Row(PART, arm, name, "runs", len(own), "runs")
        yield Row(PART, arm, name, "runs that got there", sum(_evaluations_to(one, goal) < 1e9 for one in own), "runs")
        yield Row(PART, arm, name, "best value", min(result.value for result in own), "N")
        yield Row(PART, arm, name, "median value", statistics.median(result.value for result in own), "N")
        excess = statistics.median(result.value for result in own) / best - 1
        yield Row(PART, arm, name, "above the best of all, median", excess, "share")
        yield Row(PART, arm, name, "seconds, median", statistics.median(result.seconds for result in own), "s")
        yield Row(PART, arm, name, "evaluations, median", statistics.median(one.evaluations for one in own), "designs")
        yield Row(PART, arm, name, "seconds to 0.1 %, median", reached, "s")
        yield Row(PART, arm, name, "evaluations to 0.1 %, median", judged, "designs")
        # Where a run does not get there, the ratio is at least that of the time it was given.
        least = statistics.median(min(one.history.seconds_to(goal), one.seconds) for one in own)
        yield Row(PART, arm, name, "time to 0.1 %, as a multiple", reached / ours, "times")
        yield Row(PART, arm, name, "time to 0.1 % or to the end, as a multiple", least / ours, "times")
        yield Row(PART, arm, name, "evaluations to 0.1 %, as a multiple", judged / evaluations, "times")
        yield Row(PART, arm, name, "stationarity", own[0].stationarity, "share")
        yield Row(PART, arm, name, "projected gradient", float(own[0].projected_gradients.min()), "N")
    yield Row(PART, arm, "one design", "seconds of evaluate", one_evaluation(design, task), "s")


def _evaluations_to(result: ta.OptimisedDesign, value: float) -> float:
    reached = result.history.evaluations[result.history.best <= value]
    return float(reached[0]) if len(reached) else float("inf")


def one_evaluation(design: ta.ArmDesign, task: ta.Task) -> float:
    """Seconds of `evaluate` for one design by itself."""
    times = []
    for _ in range(20):
        begun = time.perf_counter()
        ta.evaluate(design, task, "absolute")
        times.append(time.perf_counter() - begun)
    return statistics.median(times)
