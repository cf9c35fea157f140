"""Draw the paper's gallery of attainable sets, and search for counterexamples to what it says of them.

Writes gallery.csv, gallery.png, results.csv (one row an arm, shape, metric and node) and violations.png beside this
file. Interrupted, it goes on where it was.
"""

import argparse
from collections.abc import Iterator, Sequence
from io import BytesIO
from itertools import product
from pathlib import Path

import torch
from rich.console import Console
from rich.progress import track
from rich.table import Table

import torcharm as ta
from experiments.hull_gallery import scenes
from experiments.hull_gallery.rows import GalleryRow, Row, worst
from experiments.hull_gallery.search import curve_sums, examine
from experiments.rows import read_rows, write_rows

HERE = Path(__file__).parent
PARTIAL = HERE / "results.partial.csv"
QUICK_CASES = ("M = 1: muscle", "M = 2: bellows, muscle", "M = 4: muscle-only (paper)")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke run: few sets, no file written")
    parser.add_argument("--fresh", action="store_true", help="begin again instead of going on")
    parser.add_argument("--figure", action="store_true", help="only draw and tabulate what results.csv holds")
    options = parser.parse_args()
    torch.set_num_threads(1)
    console = Console(width=130)
    from experiments.hull_gallery import figure

    gallery = list(gallery_rows())
    console.print(gallery_table(gallery))
    if options.quick:
        plan = [(case, scenes.SHAPES[2], 5) for case in scenes.CASES if case.name in QUICK_CASES]
        rows = [row for job in track(plan, "searching", console=console) for row in search(*job)]
        figure.draw_gallery(BytesIO())
        console.print(as_table(rows))
        return
    if not options.figure:
        run_all(console, options.fresh)
        write_rows(HERE / "gallery.csv", gallery)
    rows = read_rows(HERE / "results.csv", Row)
    console.print(as_table(rows))
    figure.draw_gallery(HERE / "gallery.png")
    figure.draw_violations(rows, HERE / "violations.png")


def run_all(console: Console, fresh: bool) -> None:
    """Every case, shape and node; results are kept as they come."""
    rows = [] if fresh or not PARTIAL.is_file() else read_rows(PARTIAL, Row)
    done = {(row.case, (row.slope, row.intercept), row.node) for row in rows}
    plan = list(product(scenes.CASES, scenes.SHAPES, range(1, scenes.NODES + 1)))
    todo = [job for job in plan if (job[0].name, *job[1:]) not in done]
    try:
        for job in track(todo, f"{len(plan) - len(todo)} sets kept, searching", console=console):
            rows += search(*job)
            write_rows(PARTIAL, rows)
    except KeyboardInterrupt:
        console.print("interrupted; what was found is kept")
        raise SystemExit(130) from None
    write_rows(HERE / "results.csv", rows)
    PARTIAL.unlink(missing_ok=True)


def search(case: scenes.Case, shape: tuple[float, float], node: int) -> Iterator[Row]:
    """Absolute and relative set of one node; the relative one of node 1 is a point."""
    arm, twists = case.build(), scenes.twists(shape).numpy()
    for metric in ("absolute", "relative") if node > 1 else ("absolute",):
        sums = curve_sums(arm, twists, relative=metric == "relative")[node - 1]
        found = examine(sums)
        sizes = (found.convex.size, found.boundary.size, found.edges.size)
        yield Row(case.name, *shape, metric, node, *sizes, found.free, found.diameter, sums.monotonic, sums.in_range)


def gallery_rows() -> Iterator[GalleryRow]:
    """How the 150 interior pressures' reactions lie to the hulls of the antagonistic arm."""
    arm = ta.antagonistic_arm()
    pressures = scenes.interior_pressures(arm)
    for shape, metric in product(scenes.SHAPES, ("absolute", "relative")):
        relative = metric == "relative"
        twists = scenes.twists(shape)
        reaction = ta.reaction_wrench(arm, twists, pressures)
        reaction = reaction - reaction[:, :1] if relative else reaction
        paper = ta.wrench_hulls(arm, twists, relative=relative, hull="edges", samples=scenes.EDGE_POINTS).vertices
        exact = ta.wrench_hulls(arm, twists, relative=relative, samples=257).vertices
        for node in range(1 if relative else 0, scenes.NODES):
            out = ta.distance_to_hull(reaction[:, node], paper[node])
            short = ta.distance_to_hull(exact[node], paper[node]).max().item()
            yield GalleryRow(*shape, metric, node + 1, int((out > 0).sum()), out.max().item(), short)


# ---- tables ----------------------------------------------------------------------------------


def as_table(rows: Sequence[Row]) -> Table:
    """The worst of each case, and in brackets of those that keep the paper's assumptions and the models' ranges."""
    table = Table(title="worst violation [N] (all strains characterised, all forces monotonic)", title_justify="left")
    for heading in ("case", "metric", "not convex", "beyond the box's boundary", "beyond its edges", "of a diameter"):
        table.add_column(heading, justify="left" if heading in ("case", "metric") else "right")
    for name, metric in product(dict.fromkeys(row.case for row in rows), ("absolute", "relative")):
        own = [row for row in rows if (row.case, row.metric) == (name, metric)]
        fair = [row for row in own if row.monotonic and row.in_range]
        cells = []
        for claim in ("convex", "boundary", "edges"):
            bracket = f"{getattr(worst(fair, claim), claim):.3f}" if fair else "none"
            cells.append(f"{getattr(worst(own, claim), claim):.3f} ({bracket})")
        table.add_row(name, metric, *cells, f"{worst(own, 'convex').diameter:.0f}")
    return table


def gallery_table(rows: Sequence[GalleryRow]) -> Table:
    table = Table(title="antagonistic arm, 150 interior pressures, 4 points an edge", title_justify="left")
    for heading in ("shape", "metric", "reactions outside the paper's hull", "by at most [N]", "hull short by [N]"):
        table.add_column(heading, justify="left" if heading in ("shape", "metric") else "right")
    for shape, metric in product(scenes.SHAPES, ("absolute", "relative")):
        own = [row for row in rows if (row.slope, row.intercept, row.metric) == (*shape, metric)]
        by, short = max(row.outside_by for row in own), max(row.hull_short_by for row in own)
        count = f"{sum(row.outside for row in own)} of {scenes.DRAWS * len(own)}"
        table.add_row(f"({shape[0]:g}, {shape[1]:g})", metric, count, f"{by:.3f}", f"{short:.3f}")
    return table
