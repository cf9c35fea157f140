"""Optimise random arms by their predicted errors, and count the predictions that a pressure search does not confirm.

A prediction holds if the search agrees with it within 20 % + 1 cm, or if the result's status says why not.
Prints a line for each and a table; writes optimisations.csv beside this file.
"""

import argparse
import math
import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from rich.console import Console
from rich.table import Table

import torcharm as ta
from experiments.paper import paper_task
from experiments.rows import write_rows
from torcharm.design import optimise_design

HERE = Path(__file__).parent
COUNT, QUICK = 60, 4
ITERATIONS, NODES = 10, 6
SHARE, LENGTH = 0.2, 0.01
CONFIRMED, LOST = "better, as a pressure search confirms", "no stable equilibrium is predicted"
"""Of a status that vouches for the prediction, and of one that says that there is none."""


@dataclass(frozen=True)
class Row:
    """One optimisation.

    Attributes:
        seed: of the arm and the task.
        actuators: of the arm, B for bellows and M for muscles.
        given, best: shape errors predicted with the given and with the best design [m], without what strains beyond
            the range cost; NaN where no equilibrium is stable.
        given_searched, searched: what the pressure search reaches with the two [m].
        agrees: whether prediction and search agree on the best.
        told: whether the status says that they may not, or that the given design was kept.
        status: of the result.
    """

    seed: int
    actuators: str
    given: float
    given_searched: float
    best: float
    searched: float
    agrees: bool
    told: bool
    status: str


def draw(seed: int) -> tuple[ta.ArmDesign, ta.Task]:
    """An arm of 1 to 4 actuators, and a task near what such arms can do."""
    drawn = random.Random(seed)
    count = drawn.randint(1, 4)
    radii = sorted(drawn.uniform(-0.08, 0.08) for _ in range(count))
    models = [drawn.choice((ta.Bellows(), ta.McKibben())) for _ in range(count)]
    slope, intercept, length = drawn.uniform(-1.5, 1.5), drawn.uniform(-1.5, 1.5), drawn.uniform(0.45, 0.56)
    load = [drawn.uniform(-most, most) for most in (6.0, 6.0, 0.6)]
    return ta.ArmDesign(radii, 0.5, models), paper_task(ta.affine_curvature(slope, intercept, length, NODES), load)


def rows(seeds: Sequence[int]) -> Iterator[Row]:
    """Optimise each and search its best design.

    Args:
        seeds: of `draw`.
    """
    for seed in seeds:
        arm, task = draw(seed)
        found = optimise_design(arm, task, starts=1, iterations=ITERATIONS)
        before, searched = (float(ta.search_pressure(one, task).shape_error) for one in (found.given, found.best))
        given, best = (1e-3 * side.shape_mm() for side in (found.before, found.after))
        agrees = abs(best - searched) <= SHARE * searched + LENGTH
        told = not found.status.startswith(CONFIRMED) or LOST in found.status
        letters = "".join(type(model).__name__[0] for model in arm.actuators)
        yield Row(seed, letters, given, before, best, searched, agrees, told, found.status)


def table(found: Sequence[Row]) -> Table:
    """The counts."""
    shown = Table(title="Optimised by predicted errors")
    for name in ("", "count"):
        shown.add_column(name, justify="left" if not name else "right")
    apart = [row for row in found if not row.agrees]
    lost = [row for row in found if math.isnan(row.best)]
    for name, number in (
        ("optimisations", len(found)),
        ("prediction and search agree within 20 % + 1 cm", len(found) - len(apart)),
        ("... and the status says that it is better, and confirmed", sum(row.agrees and not row.told for row in found)),
        ("do not agree, and the status says why", sum(row.told for row in apart)),
        ("  of these no equilibrium is stable", len(lost)),
        ("do not agree, and nothing is said", sum(not row.told for row in apart)),
        ("best searched worse than given", sum(row.searched > row.given_searched * 1.001 + 1e-6 for row in found)),
    ):
        shown.add_row(name, str(number))
    return shown


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke run: fewer draws, no file written")
    options = parser.parse_args()
    torch.set_num_threads(1)
    console = Console(width=120)
    found = []
    for row in rows(range(QUICK if options.quick else COUNT)):
        found.append(row)
        console.print(
            f"{row.seed:3d} {row.actuators:4s} given {row.given:.4f} (searched {row.given_searched:.4f}) "
            f"best {row.best:.4f} (searched {row.searched:.4f}) {row.status}",
            soft_wrap=True,
        )
    console.print(table(found))
    if not options.quick:
        write_rows(HERE / "optimisations.csv", found)


if __name__ == "__main__":
    main()
