"""Does a converged search depend on its seed, on the arms and tasks of `agreement`?

Writes seeds.csv (one row a number of actuators) beside this file.
"""

import argparse
from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path

import torch
from rich.console import Console
from rich.progress import track
from rich.table import Table

import torcharm as ta
from experiments.rows import write_rows
from experiments.trust.agreement import ARMS, FIRST_SEED, QUICK_ARMS, SIZES
from experiments.trust.run import draw_arm, draw_tasks
from torcharm.attainability.verdict import over_tolerance

HERE = Path(__file__).parent
SEEDS, QUICK_SEEDS = 8, 2
APART = 1e-3
"""Errors are another [m]."""


@dataclass
class Row:
    """Searches of one number of actuators; tasks of which at least two converged; and of these, how many differ by over
    1 mm, or in whether they are within the default tolerance."""

    actuators: int
    searches: int = 0
    converged: int = 0
    tasks_compared: int = 0
    shape_error_apart: int = 0
    tip_error_apart: int = 0
    either_apart_below_10_mm: int = 0
    held_or_not: int = 0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke run: few arms, no file written")
    options = parser.parse_args()
    torch.set_num_threads(1)
    console = Console(width=140)
    arms = track(range(QUICK_ARMS if options.quick else ARMS), "arms", console=console, transient=True)
    rows = counted(arms, QUICK_SEEDS if options.quick else SEEDS)
    console.print(table(rows))
    if not options.quick:
        write_rows(HERE / "seeds.csv", rows)


def counted(arms: Iterable[int], seeds: int) -> list[Row]:
    """Search from each seed for each arm."""
    rows = {size: Row(size) for size in SIZES}
    for index in arms:
        generator, size = torch.Generator().manual_seed(FIRST_SEED + index), SIZES[index % len(SIZES)]
        arm, _ = draw_arm(generator, size)
        task, _ = draw_tasks(generator, arm)
        found = [ta.search_pressure(arm, task, seed=seed) for seed in range(seeds)]
        converged = torch.stack([one.converged for one in found])
        compared = converged.sum(0) > 1
        shape, tip = (
            _spread(torch.stack([getattr(one, name) for one in found]), converged) > APART
            for name in ("shape_error", "tip_error")
        )
        nearest = torch.stack([one.shape_error for one in found]).amin(0)
        row = rows[size]
        row.searches += converged.numel()
        row.converged += int(converged.sum())
        row.tasks_compared += int(compared.sum())
        row.shape_error_apart += int((shape & compared).sum())
        row.tip_error_apart += int((tip & compared).sum())
        held = torch.stack([over_tolerance(arm, one, ta.PoseTolerance()).amax(0) <= 1 for one in found])
        row.held_or_not += int(((held & converged).any(0) & (~held & converged).any(0)).sum())
        row.either_apart_below_10_mm += int(((shape | tip) & compared & (nearest < 0.01)).sum())
    return list(rows.values())


def _spread(errors: torch.Tensor, converged: torch.Tensor) -> torch.Tensor:
    """(tasks) the largest of the converged (seeds, tasks) less the least."""
    return errors.where(converged, -torch.inf).amax(0) - errors.where(converged, torch.inf).amin(0)


def table(rows: list[Row]) -> Table:
    """Of each number of actuators, and of all."""
    shown = Table(
        box=None, title=f"Seeds of a search; errors are apart by over {1e3 * APART:g} mm", title_justify="left"
    )
    names = [field.name for field in fields(Row)]
    for name in names:
        shown.add_column(name.replace("_", " "), justify="right")
    for row in rows:
        shown.add_row(*(str(getattr(row, name)) for name in names))
    shown.add_row("all", *(str(sum(getattr(row, name) for row in rows)) for name in names[1:]))
    return shown


if __name__ == "__main__":
    main()
