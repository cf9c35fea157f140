"""Plan the paper's three shapes for one tip pose, and compare metrics with what the search reaches.

Writes results.csv (one row a shape and load), metrics.csv (one row a shape, load, hull and power), shapes.png and
hulls.png beside this file.
"""

import argparse
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import torch
from rich.console import Console
from rich.table import Table

import torcharm as ta
from experiments.paper import paper_task
from experiments.rows import write_rows
from experiments.shape_planning import figure
from experiments.shape_planning.rows import Answer, MetricRow, ShapeRow
from torcharm.design.shape_planning import PAPER_SHAPES

HERE = Path(__file__).parent
TIP_POSE = (0.35, -0.3, 0.0)
LOADS, QUICK_LOADS = (6.0, 7.0, 8.0), (6.0,)
"""Tip forces to the right [N]: 6 gives the published table, 7 is in the text, 8 in the caption."""
HULLS: dict[str, dict[str, Any]] = {"edges, 3 points": {"hull": "edges", "samples": 3}, "exact": {}}
PUBLISHED = {1: (0.2343, 132.85)}
"""Absolute and relative of the published table, by shape."""
PAPERS_COST = ta.PoseCost("uniform", (1.0, 1.0, 0.05))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke run: one shape and load, no file written")
    options = parser.parse_args()
    console = Console()
    arm = ta.antagonistic_arm(outer_radius=0.04, inner_radius=0.01, length=0.51)
    shapes = plan(arm, 1 if options.quick else len(PAPER_SHAPES))
    metrics, answers = [], []
    for force in QUICK_LOADS if options.quick else LOADS:
        for number, shape in shapes.items():
            task = paper_task(shape.twists, [force, 0.0, 0.0])
            metrics += hull_metrics(arm, task, number, force)
            answers.append(reach(arm, task, number, force, shape.tip_error))
    rows = [answer.row for answer in answers]
    for title, found in (("hull metrics", metrics), ("predicted and reached", rows)):
        console.print(as_table(title, found))
    shown = [answer for answer in answers if answer.row.force_x_N == QUICK_LOADS[0]]
    pictures = {"shapes": figure.shapes(arm, shown), "hulls": figure.hulls(arm, shown)}
    if options.quick:
        return
    write_rows(HERE / "metrics.csv", metrics)
    write_rows(HERE / "results.csv", rows)
    for name, picture in pictures.items():
        picture.savefig(HERE / f"{name}.png", dpi=110)
    console.print("wrote metrics.csv, results.csv, shapes.png and hulls.png")


def plan(arm: ta.ArmDesign, count: int) -> dict[int, ta.PlannedShape]:
    """The paper's shapes, counted from 1: the smoothest by its three weightings."""
    return {
        number: ta.plan_shape(arm, TIP_POSE, [0.0, 0.0, 0.0], smoothness)
        for number, smoothness in enumerate(PAPER_SHAPES[:count], start=1)
    }


def hull_metrics(arm: ta.ArmDesign, task: ta.Task, number: int, force: float) -> list[MetricRow]:
    rows = []
    for name, settings in HULLS.items():
        for power in (1, 2):
            found = ta.evaluate(arm, task, ("absolute", "relative"), power=power, **settings)
            assert found.absolute is not None
            assert found.relative is not None
            printed = (name, power, force) == ("edges, 3 points", 2, LOADS[0])
            absolute, relative = PUBLISHED.get(number, (None, None)) if printed else (None, None)
            rows.append(
                MetricRow(number, force, name, power, found.absolute.item(), found.relative.item(), absolute, relative)
            )
    return rows


def reach(arm: ta.ArmDesign, task: ta.Task, number: int, force: float, tip_error: float) -> Answer:
    """What is predicted, and the closest shape by the search with the shape study's cost."""
    predicted = ta.predict_error(arm, task, PAPERS_COST)
    search = ta.search_pressure(arm, task, pose_cost=PAPERS_COST)
    tip, wanted = (ta.poses(twists)[-1] for twists in (search.twists, task.twists))
    row = ShapeRow(
        number,
        force,
        tip_error,
        task.twists[:, 0].mean().item(),
        predicted.cost.sqrt().item(),
        search.cost.sqrt().item(),
        torch.linalg.vector_norm((tip - wanted)[:2]).item(),
        (tip - wanted)[2].abs().item(),
        bool(search.converged),
        bool(search.in_range),
        " ".join(f"{pressure:.2f}" for pressure in search.pressure.tolist()),
    )
    return Answer(number, task, search, row)


def as_table(title: str, rows: Sequence[Any]) -> Table:
    table = Table(title=title, title_justify="left")
    names = [field.name for field in fields(rows[0])]
    for name in names:
        table.add_column(name.replace("_", " "), justify="right")
    for row in rows:
        values = (getattr(row, name) for name in names)
        table.add_row(
            *(f"{value:.5g}" if isinstance(value, float) else "" if value is None else str(value) for value in values)
        )
    return table
