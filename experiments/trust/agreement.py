"""Do predictions that say they may be trusted agree with the search, on arms of 2 to 8 actuators?

Writes agreement.csv (one row a number of actuators and status) beside this file.
"""

import argparse
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import torch
from rich.console import Console
from rich.progress import track
from rich.table import Table

import torcharm as ta
from experiments.rows import write_rows
from experiments.trust.run import draw_arm, draw_tasks

HERE = Path(__file__).parent
SIZES = 2, 3, 4, 5, 6, 8
ARMS, QUICK_ARMS = 120, 6
FIRST_SEED = 5000
"""Arms are others than those of the predictions below 1 mm."""
FAR, LEAST = 0.2, 1e-3
"""Errors differ that are further apart than this part of the searched one, and than this part of a metre."""


@dataclass(frozen=True)
class Row:
    """Tasks of one status: how many there are, and of how many the searched shape error is another one."""

    actuators: int
    status: str
    tasks: int
    search_converged: int
    prediction_larger: int
    search_larger: int


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke run: few arms, no file written")
    options = parser.parse_args()
    torch.set_num_threads(1)
    console = Console(width=120)
    arms = QUICK_ARMS if options.quick else ARMS
    rows = counted(track(range(arms), "arms", console=console, transient=True))
    console.print(table(rows))
    if not options.quick:
        write_rows(HERE / "agreement.csv", rows)


def counted(seeds: Iterable[int]) -> list[Row]:
    """Predict and search for arms of these seeds."""
    counts: Counter[tuple[int, str, str]] = Counter()
    for seed in seeds:
        generator, size = torch.Generator().manual_seed(FIRST_SEED + seed), SIZES[seed % len(SIZES)]
        arm, _ = draw_arm(generator, size)
        task, _ = draw_tasks(generator, arm)
        found, searched = ta.predict_error(arm, task), ta.search_pressure(arm, task)
        apart = found.shape_error - searched.shape_error
        far = apart.abs() > FAR * searched.shape_error.clamp(min=LEAST)
        for index, status in enumerate(found.status):
            counts[size, status, "tasks"] += 1
            counts[size, status, "search_converged"] += bool(searched.converged[index])
            counts[size, status, "prediction_larger"] += bool(far[index] & (apart[index] > 0))
            counts[size, status, "search_larger"] += bool(far[index] & (apart[index] < 0))
    names = ("tasks", "search_converged", "prediction_larger", "search_larger")
    kinds = sorted({(size, status) for size, status, _ in counts})
    return [Row(*kind, *(counts[*kind, name] for name in names)) for kind in kinds]


def table(rows: list[Row]) -> Table:
    """Of each status, over all numbers of actuators."""
    shown = Table(box=None, title=f"Predicted and searched errors over {100 * FAR:g} % apart", title_justify="left")
    for heading in ("status", "tasks", "search converged", "prediction larger", "search larger"):
        shown.add_column(heading, justify="left" if heading == "status" else "right")
    for status in sorted({row.status for row in rows}):
        own = [row for row in rows if row.status == status]
        names = ("tasks", "search_converged", "prediction_larger", "search_larger")
        shown.add_row(status, *(str(sum(getattr(row, name) for row in own)) for name in names))
    return shown


if __name__ == "__main__":
    main()
