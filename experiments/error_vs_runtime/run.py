"""Measure error and run time, row by row into results.csv beside this file; then draw and tabulate them.

Interrupted, it goes on where it was; rows of the same commit are not measured again.
"""

import argparse

import torch
from rich.console import Console
from rich.progress import track
from rich.table import Table

from experiments.error_vs_runtime import figure, report, rows, sets, solvers, turns


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke run: few rows, nothing written")
    parser.add_argument("--fresh", action="store_true", help="measure every row again")
    parser.add_argument("--figure", action="store_true", help="only draw and tabulate what results.csv holds")
    options = parser.parse_args()
    torch.set_num_threads(1)
    console = Console(width=160)
    if options.figure:
        stored_rows = list(rows.read().values())
        figure.draw(stored_rows)
        report.update(stored_rows)
        return
    plan = dict(quick_plan() if options.quick else [*sets.jobs(), *turns.jobs(), *solvers.jobs()])
    stored = {} if options.fresh or options.quick else rows.read()
    found = {key: row for key, row in stored.items() if key in plan}
    todo = [key for key in plan if key not in found or found[key].commit != rows.commit()]
    try:
        for key in track(todo, f"{len(plan) - len(todo)} rows kept, measuring", console=console):
            found[key] = plan[key]()
            if not options.quick:
                rows.write({key: found[key] for key in plan if key in found})
    except KeyboardInterrupt:
        console.print("interrupted; the rows so far are kept")
        return
    console.print(as_table(list(found.values())))
    if not options.quick:
        in_order = [found[key] for key in plan]
        figure.draw(in_order)
        report.update(in_order)


def quick_plan() -> sets.Jobs:
    """One row of each kind, of those that are done in no time."""
    for key, job in sets.jobs():
        if key[1] == "antagonistic, absolute" and key[3] == "3 points" and key[4] == "float64":
            yield key, job
    for key, job in solvers.jobs():
        if key[-1] == "1" and key[1] == solvers.CASES[0] and key[3] in ("", "distance", "planar", "ε = 1e-10"):
            yield key, job


def as_table(found: list[rows.Row]) -> Table:
    headings = ("case", "method", "setting", "dtype", "batch", "µs", "µs with gradient", "p50", "p99", "max", "≤ 1e-6")
    table = Table(title="error and time of a problem", title_justify="left")
    for place, heading in enumerate(headings):
        table.add_column(heading, justify="right" if place > 3 else "left")
    for row in found:
        numbers = (row.forward_us_a_problem, row.gradient_us_a_problem, row.error_p50, row.error_p99, row.error_max)
        shown = [f"{number:.3g}" for number in (*numbers, row.success_1e6)]
        table.add_row(row.case, row.method, row.setting, row.dtype, str(row.batch), *shown)
    return table
