"""Sweep the antagonistic arm's design space on the paper's shapes, and compare the best designs with those of descents.

Prints a table and writes results.csv beside this file; goes on where it was interrupted.
"""

import argparse
import os
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.table import Table

import torcharm as ta
from experiments.design_optimisation.scenes import ARMS, JOINTLY, SHAPES, tasks_of
from experiments.rows import read_rows, write_rows
from experiments.sweep.memory import bytes_of, most_memory
from torcharm.design.objective import shape_lengths
from torcharm.design.space import Arm

HERE = Path(__file__).parent
SPACE = ta.DesignSpace(bounds={"radii": (-0.1, 0.1), "length": (0.25, 0.75)})


@dataclass(frozen=True)
class Size:
    """Of a run: designs, loads a shape, the designs of the sweep that measures one process, and starts of descents."""

    designs: int
    loads: int
    alone: int
    starts: int


FULL, QUICK = Size(10_000_000, 20, 100_000, 8), Size(1000, 1, 300, 1)


@dataclass(frozen=True)
class Scene:
    """The arm's design space on one shape, or jointly on all.

    Attributes:
        designs, feasible: how many were drawn, and how many of them the space allows.
        tasks: on which each of these is evaluated.
        processes: of the sweep.
        seconds, cpu_seconds: it took, by the clock and of all cores.
        bytes_a_design: on disk.
        worker_mib: most memory that a process held.
        given, best: mean predicted shape errors [mm], of the given arm and of the sweep's best design.
        excluded: tasks on which that design's strains leave the characterised range.
        descended: the error of what `optimise_design` makes of the given arm, and
        descent_excluded, descent_seconds: the tasks on which that leaves the range, and what it took.
        both: the error of what `optimise_design` makes of the sweep's best.
    """

    shape: str
    designs: int
    feasible: int
    tasks: int
    processes: int
    seconds: float
    cpu_seconds: float
    bytes_a_design: float
    worker_mib: float
    given: float
    best: float
    excluded: int
    descended: float
    descent_excluded: int
    descent_seconds: float
    both: float


def main() -> None:
    """Run the scenes that are not known yet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke run: small sizes, no file written")
    parser.add_argument("--fresh", action="store_true", help="measure again what results.csv holds")
    options = parser.parse_args()
    torch.set_num_threads(1)
    known: list[Scene] = [] if options.quick or options.fresh else read_rows(HERE / "results.csv", Scene)
    for scene in scenes(options.quick, {(row.shape, row.processes) for row in known}):
        known.append(scene)
        if not options.quick:
            write_rows(HERE / "results.csv", known)
    Console(width=160).print(as_table(known))


def scenes(quick: bool, known: set[tuple[str, int]]) -> Iterator[Scene]:
    """All that are not known yet; the first shape also by one process."""
    size = QUICK if quick else FULL
    compiled = ta.optimise_design(ARMS["antagonistic"], tasks_of("(1, 1.5)", 1), SPACE, starts=1, iterations=1)
    assert compiled.evaluations
    for shape in ["(1, 1.5)"] if quick else [*SHAPES, JOINTLY]:
        for processes in (1,) if quick else (1, 2) if shape == "(1, 1.5)" else (2,):
            if (shape, processes) not in known:
                yield measured(shape, processes, size, size.alone if processes == 1 else size.designs)


def measured(shape: str, processes: int, size: Size, designs: int) -> Scene:
    """One scene."""
    arm, task = ARMS["antagonistic"], tasks_of(shape, size.loads)
    with tempfile.TemporaryDirectory() as folder:
        begun, cpu, held = time.perf_counter(), cpu_seconds(), [0.0]
        found = ta.sweep(
            *(arm, SPACE, task, designs),
            out=folder,
            metrics="predicted_error",
            workers=processes,
            callback=lambda _: held.append(most_memory()),
        )
        seconds, cpu = time.perf_counter() - begun, cpu_seconds() - cpu
        best = found.best(size.starts, "shape_error")
        begun = time.perf_counter()
        descent = ta.optimise_design(arm, task, SPACE, starts=size.starts)
        descent_seconds = time.perf_counter() - begun
        both = ta.optimise_design(found.designs(best), task, SPACE, starts=size.starts)
        errors, excluded = zip(*(error_of(one, task) for one in (arm, descent.best, both.best)), strict=True)
        return Scene(
            *(shape, designs, found.feasible, task.batch_shape.numel(), processes),
            *(round(seconds, 1), round(cpu, 1), round(bytes_of(found) / designs, 2)),
            round(max(held), 0),
            *(errors[0], round(float(best["shape_error_mm"][0]), 2), int(best["excluded_by_range"][0])),
            *(errors[1], excluded[1], round(descent_seconds, 1), errors[2]),
        )


def error_of(arm: Arm, task: ta.Task) -> tuple[float, int]:
    """A design's mean predicted shape error [mm], as sweeps measure it, and the tasks on which it leaves the range."""
    found = ta.evaluate(arm, task, ("predicted_error",))
    assert found.prediction is not None
    known = found.prediction.stable & found.prediction.shape_error.isfinite()
    error = torch.where(known, found.prediction.shape_error, shape_lengths(task).reshape(task.batch_shape))
    return round(1e3 * float(error.mean()), 2), int((np.asarray(found.verdict) == "excluded by range").sum())


def cpu_seconds() -> float:
    """Of this process and those that it has waited for."""
    return sum(os.times()[:4])


def as_table(rows: list[Scene]) -> Table:
    """A row a scene."""
    table = Table(title=r"mean predicted shape error \[mm]", title_justify="left")
    for heading in (
        *("shape", "designs", "feasible", "tasks", "processes", "s", "CPU s", "bytes a design", "MiB a worker"),
        *("given", "sweep", "out of range", "descents", "out of range", "s", "descents from the sweep"),
    ):
        table.add_column(heading, justify="right")
    for row in rows:
        table.add_row(*(str(value) for value in vars(row).values()))
    return table
