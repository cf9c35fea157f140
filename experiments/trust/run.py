"""Draw tasks and snapped arms at random, and count what is claimed and does not hold.

Prints tables; writes results.csv, one row for each claim that was looked at, beside this file.
"""

import argparse
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import torch
from rich.console import Console
from rich.progress import track
from rich.table import Table
from torch import Tensor

import torcharm as ta
from experiments.paper import paper_equilibrium, paper_task, paper_wrench
from experiments.rows import read_rows, write_rows

HERE = Path(__file__).parent
TASKS, SNAPPED, QUICK = 5000, 1000, 50
EACH, LOADED = 25, 500
"""Tasks of a design; and pressures and loads at which a design is solved in search of snaps."""
NODES = 6
BELOW, WITHIN = 1e-3, 1e-2
"""Predictions below the first [m] are searched; the search confirms them if it comes within the second."""
KINDS = ta.Bellows, ta.McKibben


@dataclass(frozen=True)
class Row:
    """One claim that was looked at.

    Attributes:
        part: "prediction" or "snapped".
        seed: of the design.
        actuators: of the arm, B for bellows and M for muscles.
        source: of a task, whether its shape is "drawn", or an "equilibrium" of the arm; of a snapped arm,
            "engine".
        claimed: the predicted error [m]; of snapped arms, their imbalance.
        found: the searched error [m], NaN where nothing was searched; of snapped arms, the largest real part of an
            eigenvalue of J.
        flag: what says not to believe it; empty if nothing does.
        holds: whether the claim holds, or a flag says that it may not.
    """

    part: str
    seed: int
    actuators: str
    source: str
    claimed: float
    found: float
    flag: str
    holds: bool


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke run: fewer draws, no file written")
    parser.add_argument("--kept", action="store_true", help="tables of results.csv, nothing drawn again or written")
    options = parser.parse_args()
    torch.set_num_threads(1)
    console = Console(width=120)
    if options.kept:
        rows = read_rows(HERE / "results.csv", Row)
    else:
        rows = [*predictions(QUICK if options.quick else TASKS, console)]
        rows += snapped(QUICK if options.quick else SNAPPED)
    for table in (prediction_table(rows), unconfirmed_table(rows), snapped_table(rows)):
        console.print(table)
    if not (options.quick or options.kept):
        write_rows(HERE / "results.csv", rows)
        console.print(f"wrote {len(rows)} rows to results.csv")


# ---- draws --------------------------------------------------------------------------------


def uniform(generator: torch.Generator, low: float, high: float, *shape: int) -> Tensor:
    return low + (high - low) * torch.rand(shape, generator=generator, dtype=torch.float64)


def draw_arm(generator: torch.Generator, size: int) -> tuple[ta.ArmDesign, str]:
    """An arm of so many bellows and muscles."""
    kinds = torch.randint(2, (size,), generator=generator).tolist()
    radii, length = uniform(generator, -0.08, 0.08, size), uniform(generator, 0.45, 0.55, size)
    return ta.ArmDesign(radii, length, [KINDS[kind]() for kind in kinds]), "".join("BM"[kind] for kind in kinds)


def draw_loads(generator: torch.Generator, size: int) -> Tensor:
    """Loads at the tip (size, 3): forces within 15 N, moments within 3 N·m."""
    return uniform(generator, -1.0, 1.0, size, 3) * torch.tensor([15.0, 15.0, 3.0], dtype=torch.float64)


def draw_tasks(generator: torch.Generator, arm: ta.ArmDesign) -> tuple[ta.Task, list[str]]:
    """Half of the shapes are drawn. The others are equilibria of the arm under their loads, as solved: stable or not,
    snapped or not, whatever is at rest."""
    loads = draw_loads(generator, EACH)
    slope, intercept, length = (uniform(generator, *ends, EACH) for ends in ((-3.0, 3.0), (-3.0, 3.0), (0.4, 0.6)))
    drawn = [
        ta.affine_curvature(float(a), float(b), float(c), NODES)
        for a, b, c in zip(slope, intercept, length, strict=True)
    ]
    pressure = arm.max_pressure * uniform(generator, 0.0, 1.0, EACH, arm.actuator_count)
    made = paper_equilibrium(arm, pressure, loads, NODES)
    kept = made.converged & (torch.arange(EACH) % 2 == 1)
    twists = torch.where(kept[:, None, None], made.twists, torch.stack(drawn))
    return paper_task(twists, loads), ["equilibrium" if one else "drawn" for one in kept.tolist()]


# ---- predictions --------------------------------------------------------------------------


def predictions(total: int, console: Console) -> Iterator[Row]:
    """What is predicted for so many tasks; where that is below `BELOW` and no flag is set, what the search finds."""
    for seed in track(range(total // EACH), "predictions", console=console, transient=True):
        generator = torch.Generator().manual_seed(seed)
        arm, kinds = draw_arm(generator, 1 + seed % 4)
        task, sources = draw_tasks(generator, arm)
        found = ta.evaluate(arm, task, metrics=("predicted_error",))
        assert found.shape_error is not None
        claimed, flags = found.shape_error, prediction_flags(found)
        wanted = [index for index in range(EACH) if float(claimed[index]) < BELOW and not flags[index]]
        searched = torch.full_like(claimed, math.nan)
        if wanted:
            again = paper_task(task.twists[wanted], task.tip_load[wanted])
            searched[wanted] = ta.search_pressure(arm, again).shape_error
        for index, values in enumerate(zip(claimed.tolist(), searched.tolist(), strict=True)):
            confirmed = index not in wanted or abs(values[0] - values[1]) <= WITHIN
            yield Row("prediction", seed, kinds, sources[index], *values, flags[index], confirmed)


def prediction_flags(found: ta.Attainability) -> list[str]:
    """What says not to believe a prediction."""
    prediction = found.prediction
    assert prediction is not None
    flags = [""] * found.impossible.numel()
    for flag, raised in (
        ("not reached", ~prediction.reached),
        ("not converged", ~prediction.converged),
        ("no stable equilibrium", ~prediction.stable),
        ("impossible", found.impossible),
    ):
        flags = [flag if one else old for one, old in zip(raised.tolist(), flags, strict=True)]
    return flags


# ---- snapped arms -------------------------------------------------------------------------


def snapped(total: int) -> Iterator[Row]:
    """So many equilibria at which arms came to rest after a snap, and how stable they are."""
    left = total
    for seed in count():
        if left <= 0:
            return
        generator = torch.Generator().manual_seed(10_000 + seed)
        arm, kinds = draw_arm(generator, 1 + seed % 4)
        pressure = arm.max_pressure * uniform(generator, 0.0, 1.0, LOADED, arm.actuator_count)
        loads = draw_loads(generator, LOADED)
        found = paper_equilibrium(arm, pressure, loads, NODES)
        at_rest = (found.residual <= 1e-10) & ~found.continued
        for index in at_rest.nonzero().flatten().tolist()[:left]:
            flag = "" if bool(found.stable[index]) else "not stable"
            flag = flag if bool(found.converged[index]) else "folded"
            largest = largest_real_part(arm, found.twists[index], pressure[index], loads[index])
            source, holds = "engine", bool(flag) or largest <= 0
            yield Row("snapped", seed, kinds, source, float(found.residual[index]), largest, flag, holds)
        left -= int(at_rest.sum())


def largest_real_part(arm: ta.ArmDesign, twists: Tensor, pressure: Tensor, load: Tensor) -> float:
    """The largest real part of an eigenvalue of J, by lengths and curvatures: of differences of wrenches."""

    def balance(unknowns: Tensor) -> Tensor:
        length, curvature = unknowns.view(-1, 2).unbind(-1)
        shape = torch.stack((length, torch.zeros_like(length), curvature), -1)
        return (ta.reaction_wrench(arm, shape, pressure) - paper_wrench(shape, load)[..., [0, 2]]).flatten()

    jacobian = torch.autograd.functional.jacobian(balance, twists[:, [0, 2]].flatten())
    return float(torch.linalg.eigvals(jacobian).real.max()) if bool(jacobian.isfinite().all()) else math.nan


# ---- tables -------------------------------------------------------------------------------


def prediction_table(rows: list[Row]) -> Table:
    chosen = [row for row in rows if row.part == "prediction"]
    table = Table(title=f"{len(chosen)} tasks: predictions", title_justify="left")
    names = ("actuators", "shapes", "no stable\nequilibrium", "not\nconverged", "not\nreached")
    for name in (*names, "unflagged", "of these\n< 1 mm", "confirmed\nby search", "not\nconfirmed"):
        table.add_column(name, justify="right")
    for size, source in sorted({(len(row.actuators), row.source) for row in chosen}):
        own = [row for row in chosen if (len(row.actuators), row.source) == (size, source)]
        flags = Counter(row.flag for row in own)
        searched = [row for row in own if not row.flag and row.claimed < BELOW]
        held = sum(row.holds for row in searched)
        cells = (
            *(flags[name] for name in ("no stable equilibrium", "not converged", "not reached", "")),
            len(searched),
        )
        table.add_row(str(size), source, *map(str, (*cells, held, len(searched) - held)))
    return table


def unconfirmed_table(rows: list[Row]) -> Table:
    """Predictions that the search did not confirm: what it says of itself, and where loading leads."""
    table = Table(title="not confirmed by the search", title_justify="left")
    for name in ("seed", "task", "actuators", "predicted\n[m]", "searched\n[m]", "search\nconverged", "in range"):
        table.add_column(name, justify="right")
    table.add_column("poses reached by loading\noff the task by [m]", justify="right")
    chosen = [row for row in rows if row.part == "prediction"]
    for place, row in enumerate(chosen):
        if row.holds:
            continue
        index, generator = place % EACH, torch.Generator().manual_seed(row.seed)
        arm, _ = draw_arm(generator, 1 + row.seed % 4)
        task, _ = draw_tasks(generator, arm)
        task = paper_task(task.twists[index], task.tip_load[index])
        found = ta.predict_error(arm, task)
        search = ta.search_pressure(arm, task)
        loaded = paper_equilibrium(arm, found.pressure, task.tip_load, NODES)
        gap = (loaded.poses - ta.poses(task.twists))[:, :2].norm(dim=-1).max()
        gap = gap if bool(loaded.continued & loaded.stable) else gap * math.nan
        flags = (str(bool(search.converged)), str(bool(found.in_range)))
        names = (str(row.seed), str(index), row.actuators, f"{row.claimed:.1g}", f"{row.found:.3g}")
        table.add_row(*names, *flags, f"{float(gap):.1g}")
    return table


def snapped_table(rows: list[Row]) -> Table:
    chosen = [row for row in rows if row.part == "snapped"]
    table = Table(title=f"{len(chosen)} snapped arms", title_justify="left")
    names = ("actuators", "solved", "folded", "not\nstable", "converged\nand stable")
    for name in (*names, "of these with an\neigenvalue > 0", "called unstable with\nnone > 0"):
        table.add_column(name, justify="right")
    for size, source in sorted({(len(row.actuators), row.source) for row in chosen}):
        own = [row for row in chosen if (len(row.actuators), row.source) == (size, source)]
        flags = Counter(row.flag for row in own)
        wrong = sum(not row.holds for row in own)
        careful = sum(row.flag == "not stable" and row.found <= 0 for row in own)
        cells = (flags["folded"], flags["not stable"], flags[""], wrong, careful)
        table.add_row(str(size), source, *map(str, cells))
    return table
