"""Optimise the paper's three arms on its three shapes: how much better, how sure, how fast.

Prints tables and writes results.csv, histories.csv, verification.csv and design_optimisation.png beside this file.
Goes on where it was interrupted: what these files hold is not measured again.
"""

import argparse
import resource
import subprocess
import sys
from collections.abc import Iterator

import torch

import torcharm as ta
from experiments.design_optimisation import methods, verification
from experiments.design_optimisation.figure import draw
from experiments.design_optimisation.rows import HERE, HISTORIES, RESULTS, TASKS, Row, TaskRow, Trace
from experiments.design_optimisation.scenes import ARMS, SHAPES, chosen_arms, joint
from experiments.rows import read_rows, write_rows

ABOUT = ("given", "start, in range", "stationarity", "projected gradient", "seconds of evaluate")
"""Quantities of methods that traces do not tell."""
PARTS = ("methods", "shapes", "verification", "predicted", "growth")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke run: small sizes, no file written")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=PARTS, help="these parts alone")
    parser.add_argument("--fresh", action="store_true", help="measure them again, instead of keeping what is there")
    parser.add_argument("--starts", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    torch.set_num_threads(1)
    if options.starts is not None:
        print(*scaled(options.starts, 1 if options.quick else 3))
        return
    Run(options.quick, tuple(options.only), options.fresh).all()


class Run:
    """The rows there are, and what is still to be done."""

    def __init__(self, quick: bool, only: tuple[str, ...], fresh: bool) -> None:
        self.quick, self.only = quick, only
        self.rows: list[Row] = [] if quick else read_rows(RESULTS, Row)
        self.traces: list[Trace] = [] if quick else read_rows(HISTORIES, Trace)
        self.tasks: list[TaskRow] = [] if quick else read_rows(TASKS, TaskRow)
        if fresh:
            self.rows = [row for row in self.rows if row.part not in only]
            self.traces = [] if "methods" in only else self.traces
            self.tasks = [] if "verification" in only else self.tasks

    def all(self) -> None:
        """Everything asked for that is not there yet."""
        if "methods" in self.only:
            self.compare_methods()
        if "shapes" in self.only:
            for arm, _ in self.missing("shapes"):
                self.add(list(shapes(arm, self.quick)))
        if "verification" in self.only:
            self.tasks = verification.measure(self.quick, self.tasks, self.keep)
            self.rows = [row for row in self.rows if row.part != "verification"]
            self.add(list(verification.summary(self.tasks)))
        if "predicted" in self.only:
            for arm, design in self.missing("predicted"):
                self.add(list(predicted(arm, design, self.quick)))
        if "growth" in self.only and (self.quick or all(row.part != "growth" for row in self.rows)):
            self.add(list(growth(self.quick)))

    def compare_methods(self) -> None:
        """One session after another; what they say of times is worked out anew each time."""
        about = [row for row in self.rows if row.part == "methods" and row.quantity in ABOUT]
        for arm, design in chosen_arms(self.quick).items():
            for name in methods.SESSIONS:
                if any((trace.arm, trace.session) == (arm, name) for trace in self.traces):
                    continue
                traces, rows = methods.session(name, arm, design, self.quick)
                self.traces += traces
                about = [row for row in about if row.key not in {new.key for new in rows}] + rows
                self.rows = [row for row in self.rows if row.part != "methods"]
                self.add([*methods.summary(self.traces), *about])
                if not self.quick:
                    write_rows(HISTORIES, self.traces)
        if not self.quick and self.traces:
            draw(self.traces, HERE / "design_optimisation.png")

    def missing(self, part: str) -> Iterator[tuple[str, ta.ArmDesign]]:
        """Arms of which a part has no rows."""
        have = {row.arm for row in self.rows if row.part == part}
        for arm, design in chosen_arms(self.quick).items():
            if arm not in have:
                yield arm, design

    def add(self, rows: list[Row]) -> None:
        """Print rows, and keep them."""
        for row in rows:
            print(
                f"{row.part:12} {row.arm:13} {row.case:30} {row.quantity:44} {row.value:12.6g} {row.unit}", flush=True
            )
        self.rows += rows
        if not self.quick:
            self.rows.sort(key=lambda row: PARTS.index(row.part))
            write_rows(RESULTS, self.rows)

    def keep(self, tasks: list[TaskRow]) -> None:
        """Keep what was measured of tasks."""
        last = tasks[-1]
        print(f"verification {last.arm:13} {last.design:16} {last.shape}", flush=True)
        if not self.quick:
            write_rows(TASKS, tasks)


def shapes(arm: str, quick: bool) -> Iterator[Row]:
    """Each shape by itself: what is attainable of it, and how long it took."""
    for shape in SHAPES:
        result = verification.optimised(arm, shape, quick)
        for moment, value in (
            ("before", result.before["absolute"].mean()),
            ("nearest in range", result.start_values[0]),
            ("after", result.after["absolute"].mean()),
        ):
            yield Row("shapes", arm, shape, f"absolute, {moment}", float(value), "N")
        attainable = float((result.after["absolute"] <= 0).double().mean())
        yield Row("shapes", arm, shape, "attainable after", attainable, "share")
        yield Row("shapes", arm, shape, "seconds", result.seconds, "s")


def predicted(arm: str, design: ta.ArmDesign, quick: bool) -> Iterator[Row]:
    """What the two objectives do to each other, few loads: unattainability and predicted error [m]."""
    task = joint(1 if quick else 4)
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
            assert found.shape_error is not None
            yield Row("predicted", arm, name, f"absolute {moment}", float(found.absolute.mean()), "N")
            yield Row("predicted", arm, name, f"predicted error {moment}", float(found.shape_error.mean()), "m")
        yield Row("predicted", arm, name, "seconds", result.seconds, "s")
        if not quick:
            searched = ta.verify_design(result, task)
            both = searched.converged_before & searched.converged_after
            yield Row("predicted", arm, name, "searched error before", float(searched.before[both].mean()), "m")
            yield Row("predicted", arm, name, "searched error after", float(searched.after[both].mean()), "m")
            yield Row("predicted", arm, name, "searched error fell", searched.improved, "share")
            yield Row("predicted", arm, name, "search converged", float(both.double().mean()), "share")


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
