"""Compare the library's distances from attainable sets with another algorithm's, on random and degenerate problems.

Writes results.csv (one row a dimension and family of sets) beside this file.
"""

import argparse
import math
import os
import time
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.progress import track
from rich.table import Table
from torch import Tensor

from experiments.exactness.models import PAIRS
from experiments.exactness.problems import FAMILIES, Problems, make
from experiments.exactness.reference import Array, distances, largest_numbers, margin
from experiments.rows import write_rows
from torcharm.wrench_sets.distance import NearestPoints, evaluate_distance, find_nearest

HERE = Path(__file__).parent
PROBLEMS, QUICK_PROBLEMS = 100_000, 12
"""In each dimension."""
TOGETHER, QUICK_TOGETHER = 500, 6
"""Problems with the same force models, which are made and solved at once."""
MOST_ACTUATORS = 12
MARGINS = 3
"""Of so many problems together, those inside, margins are compared too."""
PROMISE = 1e-6
"""The error, as a part of max|H - w|, up to which an answer that is not flagged is right."""
ROUNDINGS = 64 * float(np.finfo(float).eps)
"""The error, as a part of the numbers that are added, that rounding excuses."""


@dataclass(frozen=True)
class Row:
    """What became of the problems of one family in one dimension; errors are parts of max|H - w|.

    Of problems with an actuator that has no length the distances are compared, but count as neither flagged nor wrong:
    `evaluate` calls them impossible.
    """

    dimension: int
    family: str
    problems: int
    outside: int
    impossible: int
    flagged: int
    wrong: int
    worst: float
    bounds_apart: float
    gradients_not_finite: int
    margins: int
    worst_margin: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke run: few problems, no file written")
    parser.add_argument("--problems", type=int, help=f"in each dimension; {PROBLEMS}")
    parser.add_argument("--minutes", type=float, default=math.inf, help="after so many no further problems are begun")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="processes; one a core")
    options = parser.parse_args()
    count = options.problems or (QUICK_PROBLEMS if options.quick else PROBLEMS)
    together = QUICK_TOGETHER if options.quick else TOGETHER
    jobs = [(dimension, seed, together) for seed in range(-(-count // together)) for dimension in (2, 3)]
    until = time.time() + 60 * options.minutes
    rows = joined(results(jobs, until, workers=0 if options.quick else options.workers))
    console = Console(width=140)
    console.print(table(rows))
    if not options.quick:
        write_rows(HERE / "results.csv", rows)
    if any(row.wrong or row.gradients_not_finite for row in rows):
        raise SystemExit("an answer that was not flagged is wrong, or has no gradient")


def results(jobs: list[tuple[int, int, int]], until: float, *, workers: int) -> Iterable[Row]:
    """Rows of the jobs that begin before `until` [s since the epoch]; without workers they run in this process."""
    if not workers:
        return [compare(job) for job in jobs]
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        found = track(pool.map(partial(compare_until, until), jobs), total=len(jobs))
        return [row for row in found if row is not None]


def compare_until(until: float, job: tuple[int, int, int]) -> Row | None:
    return compare(job) if time.time() < until else None


def compare(job: tuple[int, int, int]) -> Row:
    """Make problems of one kind, and let both answer."""
    torch.set_num_threads(1)
    dimension, seed, count = job
    generator = np.random.default_rng((dimension, seed))
    family = family_of(seed)
    names = tuple(generator.choice(list(PAIRS), size=generator.integers(1, MOST_ACTUATORS + 1)).tolist())
    problems = make(family, dimension, count, generator, names)
    found, value, lost = answers(problems)
    with np.errstate(all="ignore"):
        low, high, size = distances(problems.sets)
        excused = ROUNDINGS / PROMISE * largest_numbers(problems.sets)
    certified = found.known(torch.from_numpy(value).view(-1, 1, 1, 1))[:, 0, 0, -1].numpy()
    scale = np.maximum(size, excused) + np.finfo(float).tiny
    error = np.where(certified, np.maximum(np.maximum(low - value, value - high), 0.0) / scale, 0.0)
    possible = (problems.sections.strain > -1.0).flatten(1).all(1).numpy()
    depth = margins(problems, certified & (high <= 1e-9 * size), size)
    return Row(
        dimension,
        family,
        count,
        int((low > 0).sum()),
        int((~possible).sum()),
        int((possible & ~certified).sum()),
        int((possible & ~(error <= PROMISE)).sum()),
        float(np.nanmax(error)),
        float(((high - low) / scale).max()),
        int((lost & certified).sum()),
        len(depth),
        max(depth, default=0.0),
    )


def family_of(seed: int) -> str:
    """Half of all are ordinary; every family has its turn."""
    return FAMILIES[0] if seed % 2 else FAMILIES[1 + seed // 2 % (len(FAMILIES) - 1)]


def answers(problems: Problems) -> tuple[NearestPoints, Array, Array]:
    """What the library finds; the distances (B,), by torch, and whether a gradient is not finite (B,)."""
    sections, relative = problems.sections, problems.relative
    found = find_nearest(sections, problems.required, (1.0, 1.0), relative=relative, signed=False, points=True)
    inputs = [value.requires_grad_() for value in (sections.strain, sections.lever, sections.bending, sections.limit)]
    value = evaluate_distance(sections, problems.required, (1.0, 1.0), found, relative=relative)[:, 0, 0, -1]
    gradients = torch.autograd.grad(value.sum(), inputs)
    for tensor in inputs:
        tensor.requires_grad_(False)
    lost = torch.stack([~gradient.flatten(1).isfinite().all(1) for gradient in gradients]).any(0)
    return found, value.detach().numpy(), lost.numpy()


def margins(problems: Problems, inside: Array, size: Array) -> list[float]:
    """Errors of some margins, as parts of max|H - w|."""
    chosen = np.flatnonzero(inside)[:MARGINS]
    if not len(chosen):
        return []
    found = find_nearest(
        problems.sections, problems.required, (1.0, 1.0), relative=problems.relative, signed=True, points=True
    )
    value: Tensor = evaluate_distance(
        problems.sections, problems.required, (1.0, 1.0), found, relative=problems.relative
    )[:, 0, 0, -1]
    errors = []
    for b in chosen:
        if found.certified[b, 0, 0, -1] and size[b] > 0:
            low, high = margin(problems.sets.those(np.array([b])), float(size[b]))
            errors.append(max(low + float(value[b]), -float(value[b]) - high, 0.0) / float(size[b]))
    return errors


def joined(rows: Iterable[Row]) -> list[Row]:
    """One row a dimension and family."""
    groups: dict[tuple[int, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.dimension, row.family), []).append(row)
    found = []
    for (dimension, family), group in sorted(groups.items(), key=lambda pair: (pair[0][0], FAMILIES.index(pair[0][1]))):
        total = {
            name: sum(getattr(row, name) for row in group)
            for name in ("problems", "outside", "impossible", "flagged", "wrong", "gradients_not_finite", "margins")
        }
        most = {name: max(getattr(row, name) for row in group) for name in ("worst", "bounds_apart", "worst_margin")}
        found.append(Row(dimension, family, **total, **most))
    return found


def table(rows: list[Row]) -> Table:
    headings = ("dimension", "sets", "problems", "outside", "impossible", "flagged", "wrong")
    shown = Table(box=None, title="Distances, errors as parts of max|H - w|", title_justify="left")
    for heading in (*headings, "worst error", "reference's gap", "lost gradients", "margins", "worst"):
        shown.add_column(heading, justify="left" if heading == "sets" else "right")
    for r in rows:
        numbers = (r.problems, r.outside, r.impossible, r.flagged, r.wrong, f"{r.worst:.1e}", f"{r.bounds_apart:.1e}")
        more = (r.gradients_not_finite, r.margins, f"{r.worst_margin:.1e}")
        shown.add_row(*map(str, (r.dimension, r.family, *numbers, *more)))
    return shown
