"""Evaluate two arms under 100 loads, search each task's best pressure, and test the paper's claim about the two.

Writes results.csv (one row an arm and load), summary.csv, hulls.png, shapes.png and claim.png beside this file.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from rich.console import Console
from rich.table import Table
from scipy.stats import spearmanr

import torcharm as ta
from experiments.paper import paper_task
from experiments.rows import write_rows
from experiments.validation import figure
from experiments.validation.rows import Answers, Row

HERE = Path(__file__).parent
ARMS: dict[str, Callable[[], ta.ArmDesign]] = {"antagonistic": ta.antagonistic_arm, "bellows-only": ta.bellows_arm}
SHAPE = ta.affine_curvature(-3.0, 3.0, length=0.5, nodes=10)
LOADS, QUICK_LOADS = 100, 4
BASELINE_LOADS, QUICK_BASELINE_LOADS = 10, 1
"""Loads an arm of which scipy's search, one pressure at a time, is timed."""
PAPER_SECONDS = {"hulls": 108.0, "search": 8766.0}
"""Of the published MATLAB, for two arms and 100 loads; on another machine."""
METRICS = ("absolute", "relative", "predicted error")


@dataclass(frozen=True)
class Figure:
    """One number of the summary."""

    arm: str
    quantity: str
    value: float
    unit: str


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke run: few loads, no file written")
    options = parser.parse_args()
    torch.set_num_threads(1)
    console = Console()
    task = paper_task(SHAPE, ta.sample_loads(QUICK_LOADS if options.quick else LOADS))
    answers, summary = measure(task, QUICK_BASELINE_LOADS if options.quick else BASELINE_LOADS)
    for one in answers:
        summary += claim(one)
    console.print(as_table(summary))
    pictures = figure.draw_all(task, answers)
    if options.quick:
        return
    write_rows(HERE / "results.csv", [row for one in answers for row in rows(task, one)])
    write_rows(HERE / "summary.csv", summary)
    for name, picture in pictures.items():
        picture.savefig(HERE / f"{name}.png", dpi=110)
    console.print(f"wrote results.csv, summary.csv and {', '.join(f'{name}.png' for name in pictures)}")


def measure(task: ta.Task, baseline_loads: int) -> tuple[list[Answers], list[Figure]]:
    """All answers, and the processor time of each: hulls, prediction and search side by side in one run."""
    arms = {name: make() for name, make in ARMS.items()}
    ta.evaluate(arms["antagonistic"], task)  # loads and warms what is loaded late
    ta.search_pressure(arms["antagonistic"], paper_task(SHAPE, task.tip_load[:1]))
    spent: dict[str, float] = {}
    count = len(arms) * len(task.tip_load)

    def timed(what: str, work: Callable[[ta.ArmDesign], Any]) -> list[Any]:
        start = time.process_time()
        found = [work(arm) for arm in arms.values()]
        spent[what] = time.process_time() - start
        return found

    hulls = timed("hulls, absolute and relative", lambda arm: ta.evaluate(arm, task, ("absolute", "relative")))
    predicted = timed("predicted error", lambda arm: ta.evaluate(arm, task, metrics=("predicted_error",)))
    searched = timed("search, multistart", lambda arm: ta.search_pressure(arm, task))
    few = paper_task(SHAPE, task.tip_load[:baseline_loads])
    baseline = timed("search, scipy", lambda arm: ta.search_pressure(arm, few, method="scipy", progress=True))
    spent["search, scipy"] *= count / (len(arms) * baseline_loads)
    answers = [
        Answers(name, arm, hull, prediction.shape_error, found)
        for (name, arm), hull, prediction, found in zip(arms.items(), hulls, predicted, searched, strict=True)
    ]
    summary = [Figure("both", f"time: {what}, {count} tasks", value, "s") for what, value in spent.items()]
    hull_time = spent["hulls, absolute and relative"]
    for what in ("search, multistart", "search, scipy"):
        summary.append(Figure("both", f"time: {what} / hulls", spent[what] / hull_time, "times"))
    summary.append(
        Figure("both", "time: published search / hulls", PAPER_SECONDS["search"] / PAPER_SECONDS["hulls"], "times")
    )
    for one, slow in zip(answers, baseline, strict=True):
        gap = one.search.shape_error[:baseline_loads] - slow.shape_error
        summary.append(Figure(one.name, "reached, multistart - scipy, largest", gap.max().item(), "m"))
    return answers, summary


def claim(one: Answers) -> list[Figure]:
    """Is every task of below-median unattainability closer to being accomplished than every one above?"""
    reached = one.reached
    known = reached.isfinite()
    found = [
        Figure(one.name, "searches that did not converge", float((~known).sum()), ""),
        Figure(one.name, "median reached error", reached[known].median().item(), "m"),
    ]
    for name in METRICS:
        value = one.metric(name)[known]
        low = value <= value.median()
        pairs = reached[known][low].unsqueeze(-1) <= reached[known][~low]
        share = 100 * pairs.double().mean().item()
        rank = spearmanr(value.numpy(), reached[known].numpy()).statistic
        found += [
            Figure(one.name, f"{name}: rank correlation with the reached error", float(rank), ""),
            Figure(one.name, f"{name}: pairs of below and above median as claimed", share, "%"),
        ]
    return found


def rows(task: ta.Task, one: Answers) -> list[Row]:
    columns = (
        one.metric("absolute"),
        one.metric("relative"),
        one.predicted,
        one.reached,
        one.search.converged,
        one.search.in_range & one.hulls.in_range,
        one.search.spread <= 0.02 * one.search.cost,
    )
    values = zip(*(column.tolist() for column in columns), strict=True)
    return [
        Row(one.name, index, *load, *value)
        for index, (load, value) in enumerate(zip(task.tip_load.tolist(), values, strict=True), start=1)
    ]


def as_table(summary: Sequence[Figure]) -> Table:
    table = Table(title="validation", title_justify="left")
    for heading in ("arm", "quantity", "value", "unit"):
        table.add_column(heading, justify="right" if heading == "value" else "left")
    for row in summary:
        table.add_row(row.arm, row.quantity, f"{row.value:,.4g}", row.unit)
    return table
