"""Optimise the paper's three arms on its three shapes, singly and jointly: does the arm come nearer, and how soon?

Every scene by the default objective and by unattainability, compared by the pressure search. Prints a table and writes
results.csv and design_optimisation.png beside this file; goes on where it was interrupted.
"""

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import torch
from rich.console import Console
from rich.table import Table

import torcharm as ta
from experiments.design_optimisation.figure import draw
from experiments.design_optimisation.scenes import ARMS, JOINTLY, SHAPES, tasks_of
from experiments.rows import read_rows, write_rows
from torcharm.design.objective import METRICS

HERE = Path(__file__).parent
LOADS, QUICK = 20, 2
"""Loads a shape."""
STARTS = 8


@dataclass(frozen=True)
class Scene:
    """One arm on one shape, or jointly on all, optimised by one objective.

    Attributes:
        given, best: mean shape errors that the search reaches [mm], of tasks that come to rest before and after.
        tasks, rest: how many there are, and of how many that is the mean.
        fell: share of these on which the error fell.
        tip_given, tip_best: mean tip errors predicted [mm].
        newtons_given, newtons_best: mean absolute unattainability [N].
        converged_given, converged_best: searches that converged.
        seconds: of one core, search included.
    """

    arm: str
    shape: str
    objective: str
    given: float
    best: float
    tasks: int
    rest: int
    fell: float
    tip_given: float
    tip_best: float
    newtons_given: float
    newtons_best: float
    converged_given: int
    converged_best: int
    seconds: float
    status: str


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke run: small sizes, no file written")
    parser.add_argument("--fresh", action="store_true", help="measure again what results.csv holds")
    options = parser.parse_args()
    torch.set_num_threads(1)
    console = Console(width=160)
    known: list[Scene] = [] if options.quick or options.fresh else read_rows(HERE / "results.csv", Scene)
    ta.optimise_design(ARMS["antagonistic"], tasks_of("(1, 1.5)", 1), starts=1, iterations=1)  # compiles
    for scene in scenes(options.quick, {(row.arm, row.shape, row.objective) for row in known}):
        known.append(scene)
        if not options.quick:
            write_rows(HERE / "results.csv", known)
    console.print(as_table("searched mean shape error", known))
    if not options.quick:
        draw(known, HERE / "design_optimisation.png")


def scenes(quick: bool, known: set[tuple[str, str, str]]) -> Iterator[Scene]:
    """All that are not known yet."""
    for arm in list(ARMS)[: 1 if quick else None]:
        for shape in [*SHAPES, JOINTLY][: 1 if quick else None]:
            for metric in METRICS:
                if (arm, shape, metric) not in known:
                    yield optimised(arm, shape, metric, quick)


def optimised(arm: str, shape: str, metric: str, quick: bool) -> Scene:
    """One scene by one objective."""
    task = tasks_of(shape, QUICK if quick else LOADS)
    begun = time.process_time()
    out = ta.optimise_design(ARMS[arm], task, objective=ta.Objective(metric), starts=1 if quick else STARTS)
    seconds = time.process_time() - begun
    checked = ta.verify_design(out, task)
    before, after = (ta.evaluate(one, task, "absolute").absolute for one in (out.given, out.best))
    assert before is not None
    assert after is not None
    return Scene(
        arm,
        shape,
        metric,
        1e3 * checked.mean_before,
        1e3 * checked.mean_after,
        len(checked.both),
        int(checked.both.sum()),
        checked.improved,
        out.before.tip_mm,
        out.after.tip_mm,
        float(before.mean()),
        float(after.mean()),
        int(checked.before.converged.sum()),
        int(checked.after.converged.sum()),
        seconds,
        out.status,
    )


def as_table(title: str, rows: Sequence[Any]) -> Table:
    """All columns but the last words."""
    table = Table(title=title, title_justify="left")
    names = [field.name for field in fields(rows[0]) if field.name != "status"]
    for name in names:
        table.add_column(name.replace("_", " "), justify="right")
    for row in rows:
        values = [getattr(row, name) for name in names]
        table.add_row(*(f"{value:.4g}" if isinstance(value, float) else str(value) for value in values))
    return table
