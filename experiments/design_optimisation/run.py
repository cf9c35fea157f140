"""Optimise the paper's three arms on its three shapes: how much better, how sure, how fast.

Prints tables and writes results.csv, histories.csv and design_optimisation.png beside this file.
"""

import argparse
import csv
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import torch

import torcharm as ta
from experiments.design_optimisation.figure import draw

HERE = Path(__file__).parent
ARMS = {"antagonistic": ta.antagonistic_arm(), "bellows-only": ta.bellows_arm(), "muscle-only": ta.mckibben_arm()}
SHAPES = {"(-3, 3)": (-3.0, 3.0), "(1, 1.5)": (1.0, 1.5), "(6, -1.5)": (6.0, -1.5)}
SCALE = (20.0, 20.0, 5.0)
RUNS = (("bfgs", 1), ("bfgs", 8), ("adam", 1), ("slsqp", 1), ("nelder_mead", 1), ("differential_evolution", 1))
NEAR = 1e-3
"""Within this share of the best value found by any method counts as there."""


@dataclass(frozen=True)
class Row:
    """One measurement; `value` is in `unit`."""

    part: str
    arm: str
    case: str
    quantity: str
    value: float
    unit: str


@dataclass(frozen=True)
class Trace:
    """When a method had found what."""

    arm: str
    method: str
    seconds: float
    evaluations: int
    value: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke run: small sizes, no file written")
    parser.add_argument("--starts", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    torch.set_num_threads(1)
    if options.starts is not None:
        print(*scaled(options.starts, 1 if options.quick else 3))
        return
    rows: list[Row] = []
    traces: list[Trace] = []
    for part in (
        methods(options.quick, traces),
        growth(options.quick),
        shapes(options.quick),
        predicted(options.quick),
    ):
        for row in part:
            rows.append(row)
            print(
                f"{row.part:10} {row.arm:13} {row.case:28} {row.quantity:34} {row.value:12.6g} {row.unit}", flush=True
            )
        if not options.quick:
            write(HERE / "results.csv", rows)
            write(HERE / "histories.csv", traces)
            draw(traces, HERE / "design_optimisation.png")


def write(path: Path, rows: list[Row] | list[Trace]) -> None:
    """Rows as a CSV file."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(rows[0])])
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)


def joint(loads: int) -> ta.Task:
    """All shapes under so many of the paper's loads."""
    slope, intercept = zip(*SHAPES.values(), strict=True)
    twists = ta.affine_curvature([[a] for a in slope], [[b] for b in intercept])
    return ta.Task(twists, ta.sample_loads(loads, SCALE))


def methods(quick: bool, traces: list[Trace]) -> Iterator[Row]:
    """Every method from the paper's arms, on all shapes and loads together: quality against time."""
    task = joint(3 if quick else 100)
    limits = {"differential_evolution": 3 if quick else 100, "nelder_mead": 10 if quick else 600, "adam": 200}
    for arm, design in list(ARMS.items())[: 1 if quick else 3]:
        found = {}
        for method, starts in RUNS:
            iterations = 4 if quick and method not in limits else limits.get(method)
            result = ta.optimise_design(design, task, method=method, starts=starts, iterations=iterations)
            name = f"{method}, {starts} starts" if starts > 1 else method
            found[name] = result
            for moment, count, value in zip(
                result.history.seconds.tolist(),
                result.history.evaluations.tolist(),
                result.history.best.tolist(),
                strict=True,
            ):
                traces.append(Trace(arm, name, moment, count, value))
        best = min(result.value for result in found.values())
        for name, result in found.items():
            reached = result.history.best <= best * (1 + NEAR)
            there = int(reached.int().argmax()) if bool(reached.any()) else None
            yield Row("methods", arm, name, "given", result.given_value, "N")
            yield Row("methods", arm, name, "start, in range", float(result.start_values[0]), "N")
            yield Row("methods", arm, name, "best value", result.value, "N")
            yield Row("methods", arm, name, "above the best of all", result.value / best - 1, "share")
            yield Row("methods", arm, name, "seconds", result.seconds, "s")
            yield Row("methods", arm, name, "evaluations", result.evaluations, "designs")
            yield Row("methods", arm, name, "seconds to 0.1 %", result.history.seconds_to(best * (1 + NEAR)), "s")
            if there is not None:
                count = float(result.history.evaluations[there])
                yield Row("methods", arm, name, "evaluations to 0.1 %", count, "designs")
            yield Row("methods", arm, name, "stationarity", result.stationarity, "share")
            yield Row("methods", arm, name, "projected gradient", float(result.projected_gradients.min()), "N")
        yield Row("methods", arm, "one design", "seconds an evaluation", one_evaluation(design, task), "s")


def one_evaluation(design: ta.ArmDesign, task: ta.Task) -> float:
    """Seconds of evaluating one design by itself, as scipy's optimisers ask for one by default."""
    times = []
    for _ in range(20):
        begun = time.perf_counter()
        ta.evaluate(design, task, "absolute")
        times.append(time.perf_counter() - begun)
    return sorted(times)[len(times) // 2]


def shapes(quick: bool) -> Iterator[Row]:
    """Each shape by itself, 100 loads, from each arm."""
    loads = ta.sample_loads(3 if quick else 100, SCALE)
    for arm, design in list(ARMS.items())[: 1 if quick else 3]:
        for name, (slope, intercept) in SHAPES.items():
            task = ta.Task(ta.affine_curvature(slope, intercept), loads)
            result = ta.optimise_design(design, task, starts=1 if quick else 4, iterations=4 if quick else 60)
            yield Row("shapes", arm, name, "absolute before", float(result.before["absolute"].mean()), "N")
            yield Row("shapes", arm, name, "absolute, nearest in range", float(result.start_values[0]), "N")
            yield Row("shapes", arm, name, "absolute after", float(result.after["absolute"].mean()), "N")
            attainable = float((result.after["absolute"] <= 0).double().mean())
            yield Row("shapes", arm, name, "attainable after", attainable, "share")
            yield Row("shapes", arm, name, "seconds", result.seconds, "s")
            few = ta.Task(task.twists, loads[: 1 if quick else 4])
            yield from checked("shapes", arm, name, result, few)


def predicted(quick: bool) -> Iterator[Row]:
    """What the two objectives do to each other, few loads: unattainability and predicted error [m]."""
    task = joint(1 if quick else 4)
    for arm, design in list(ARMS.items())[: 1 if quick else 3]:
        results = {
            "by unattainability": ta.optimise_design(design, task, starts=1, iterations=3 if quick else 100),
            "by predicted error": ta.optimise_design(
                design,
                task,
                objective=ta.Objective(metric="predicted_error"),
                starts=1,
                iterations=2 if quick else 40,
                tolerance=1e-5,
            ),
        }
        for name, result in results.items():
            for moment, one in (("before", result.given), ("in range", result.starts[0]), ("after", result.best)):
                found = ta.evaluate(one, task, ("absolute", "predicted_error"))
                assert found.absolute is not None
                assert found.predicted_error is not None
                yield Row("predicted", arm, name, f"absolute {moment}", float(found.absolute.mean()), "N")
                yield Row("predicted", arm, name, f"predicted error {moment}", float(found.predicted_error.mean()), "m")
            yield Row("predicted", arm, name, "seconds", result.seconds, "s")
            if not quick:
                yield from checked("predicted", arm, name, result, task)


def checked(part: str, arm: str, case: str, result: ta.OptimisedDesign, task: ta.Task) -> Iterator[Row]:
    """Predicted and searched shape errors, before and after, on a few of the tasks."""
    for moment, design in (("before", result.given), ("after", result.best)):
        error = ta.evaluate(design, task, ("predicted_error",)).predicted_error
        assert error is not None
        yield Row(part, arm, case, f"predicted error {moment}, few loads", float(error.mean()), "m")
    found = ta.verify_design(result, task)
    both = found.converged_before & found.converged_after
    yield Row(part, arm, case, "searched error before", float(found.before[both].mean()), "m")
    yield Row(part, arm, case, "searched error after", float(found.after[both].mean()), "m")
    yield Row(part, arm, case, "searched error fell", found.improved, "share")
    yield Row(part, arm, case, "search converged", float(both.double().mean()), "share")


def growth(quick: bool) -> Iterator[Row]:
    """Time and memory of a few iterations of many starts, each number in a process of its own."""
    for starts in (1, 4) if quick else (1, 64, 1024):
        command = [sys.executable, "-m", "experiments.design_optimisation", "--starts", str(starts)]
        answer = subprocess.run(
            command + ["--quick"] * quick, capture_output=True, text=True, check=True, cwd=HERE.parents[1]
        )
        seconds, evaluations, megabytes = map(float, answer.stdout.split())
        yield Row("growth", "antagonistic", f"{starts} starts", "seconds an evaluation", seconds / evaluations, "s")
        yield Row("growth", "antagonistic", f"{starts} starts", "seconds", seconds, "s")
        yield Row("growth", "antagonistic", f"{starts} starts", "peak memory over one start's", megabytes, "MB")


def scaled(starts: int, iterations: int) -> tuple[float, int, float]:
    """Seconds, evaluations, and megabytes beyond what a single start needs."""
    task = joint(10)
    ta.optimise_design(ARMS["antagonistic"], task, starts=1, iterations=1)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    result = ta.optimise_design(ARMS["antagonistic"], task, starts=starts, iterations=iterations)
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return result.seconds, result.evaluations, (after - before) / 1024
