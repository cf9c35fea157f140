"""Shape and tip errors of arms of one to four segments, predicted and searched, on five shapes.

Writes results.csv (one row an arm, shape, number of segments and aim) and segments.png beside this file.
"""

import argparse
import math
from collections.abc import Iterator, Sequence
from io import BytesIO
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from scipy.stats import spearmanr

import torcharm as ta
from experiments.rows import write_rows
from experiments.segments import scenes
from experiments.segments.rows import Row

HERE = Path(__file__).parent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke run: one shape, few segments, no file written")
    quick = parser.parse_args().quick
    torch.set_num_threads(1)
    console = Console(width=150)
    from experiments.segments import figure

    rows = list(measured(("antagonistic",), ("S of two arcs",), (1, 2)) if quick else measured())
    for aim in scenes.aims():
        console.print(table(rows, aim))
    console.print(agreement(rows))
    console.print(ranks(rows))
    if quick:
        figure.draw(rows, BytesIO())
        return
    write_rows(HERE / "results.csv", rows)
    figure.draw(rows, HERE / "segments.png")


def measured(
    kinds: Sequence[str] = tuple(scenes.KINDS),
    shapes: Sequence[str] | None = None,
    counts: Sequence[int] = scenes.SEGMENTS,
) -> Iterator[Row]:
    """Every arm on every shape, with every aim."""
    for kind in kinds:
        for shape, twists in scenes.shapes(kind).items():
            if shapes is None or shape in shapes:
                for count in counts:
                    yield from by_aim(kind, shape, twists, count)


def by_aim(kind: str, shape: str, twists: torch.Tensor, count: int) -> Iterator[Row]:
    """One arm on one shape."""
    arm, task = scenes.arm(kind, count), scenes.task(twists, count)
    whole = scenes.aims()["shape"]
    for aim, cost in scenes.aims().items():
        found = ta.evaluate(arm, task, pose_cost=cost)
        searched = ta.search_pressure(arm, task, pose_cost=cost)
        omega = whole.omega(scenes.NODES, searched.pose_errors).sum()
        assert found.shape_error is not None
        assert found.absolute is not None
        assert found.relative is not None
        numbers = (
            1e3 * float(found.shape_error),
            1e3 * float(searched.shape_error),
            1e3 * math.sqrt(float(whole(searched.pose_errors) / omega)),
            1e3 * float(searched.tip_error),
            math.degrees(float(searched.tip_rotation_error)),
            float(found.absolute),
            float(found.relative),
        )
        predicted, reached, whole_mm, tip, turn, absolute, relative = (round(number, 4) for number in numbers)
        yield Row(
            kind,
            shape,
            count,
            aim,
            predicted,
            reached,
            whole_mm,
            tip,
            turn,
            absolute,
            relative,
            str(found.verdict),
            str(searched.status),
            bool(searched.in_range),
        )


# ---- what rows say ------------------------------------------------------------------------------


def agreement(rows: Sequence[Row]) -> str:
    """How far predictions are from what searches reach."""
    off = np.array([abs(row.predicted_mm - row.searched_mm) for row in rows])
    return (
        f"predicted within 0.1 mm of what is searched: {(off < 0.1).sum()} of {len(off)}, else {off.max():.1f} mm off"
    )


def ranks(rows: Sequence[Row]) -> str:
    """Whether unattainability knows the shape error, over shapes and numbers of segments."""
    said = []
    for kind in dict.fromkeys(row.kind for row in rows):
        own = [row for row in rows if row.kind == kind and row.aim == "shape"]
        error = [row.searched_mm for row in own]
        for metric in ("absolute", "relative", "predicted_mm"):
            value = [getattr(row, metric) for row in own]
            rank = float(spearmanr(value, error).statistic) if len(set(value)) > 1 else math.nan
            said.append(f"{kind} {metric} {rank:+.2f}")
    return f"rank correlation with the searched shape error: {', '.join(said)}"


def table(rows: Sequence[Row], aim: str) -> Table:
    shown = Table(
        title=f"aim {aim}: error searched (predicted) in mm, and relative in N, by segments", title_justify="left"
    )
    counts = sorted({row.segments for row in rows})
    for heading in ("arm", "shape", *map(str, counts), *(f"relative {count}" for count in counts)):
        shown.add_column(heading, justify="left" if heading in ("arm", "shape") else "right")
    for kind in dict.fromkeys(row.kind for row in rows):
        for shape in dict.fromkeys(row.shape for row in rows):
            own = [row for row in rows if (row.kind, row.shape, row.aim) == (kind, shape, aim)]
            cells = [f"{row.searched_mm:.1f} ({row.predicted_mm:.1f})" for row in own]
            shown.add_row(kind, shape, *cells, *(f"{row.relative:.1f}" for row in own))
    return shown
