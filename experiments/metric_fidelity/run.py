"""Compare metrics with the shape error that the pressure search finds, over arms, shapes and loads.

Searches that results.csv holds are not made again.
"""

import argparse

import torch
from rich.console import Console
from rich.progress import track
from rich.table import Table

from experiments.metric_fidelity import figure, measure
from experiments.metric_fidelity.cases import cases


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke run: two cases of few loads, nothing written")
    parser.add_argument("--fresh", action="store_true", help="search again, instead of taking what results.csv holds")
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    console = Console(width=170)
    plan = cases(100)
    if options.quick:
        small = cases(4)
        plan = [small[0], small[-1]]
    known = {} if options.fresh or options.quick else measure.read()
    found = []
    try:
        for case in track(plan, "measuring", console=console):
            found.append(measure.measure(case, known.get(case.name)))
            if not options.quick and len(found) >= len(known):  # never fewer than were there
                measure.write(found)
    except KeyboardInterrupt:
        console.print("interrupted; the cases so far are kept")
        return
    console.print(as_table(found))
    console.print(trust_table(found))
    times = measure.timings(20 if options.quick else 1000, 2 if options.quick else 50)
    console.print(time_table(times, options.threads))
    if not options.quick:
        figure.draw(found, times)


def as_table(found: list[measure.Found]) -> Table:
    table = Table(title="Spearman rank correlation with the search's error", title_justify="left")
    for heading in ("case", *measure.METRICS):
        table.add_column(heading, justify="left" if heading == "case" else "right")
    for one in found:
        table.add_row(one.case.name, *(f"{one.spearman(metric):.3f}" for metric in measure.METRICS))
    return table


def trust_table(found: list[measure.Found]) -> Table:
    title = "median |predicted - true| / true, of true errors below 0.1 m and of all; and what flags say"
    table = Table(title=title, title_justify="left")
    headings = ["case", "true median [m]", "starts agree", "n < 0.1 m"]
    headings += ["predicted: < 0.1 m", "all"]
    for heading in (*headings, "converged", "stable", "held", "reached", "ρ of reached"):
        table.add_column(heading, justify="left" if heading == "case" else "right")
    for one in found:
        moderate = int((one.true < measure.MODERATE).sum())
        row = [one.case.name, f"{sorted(one.true)[len(one.true) // 2]:.3f}", f"{one.agree.mean():.0%}", str(moderate)]
        row += [f"{one.relative_error('predicted', moderate):.1%}" for moderate in (True, False)]
        flags = (one.columns[flag].mean() for flag in ("converged", "stable"))
        ends = (one.columns[end].mean() for end in ("held", "reached"))
        reached = one.columns["reached"] > 0
        table.add_row(*row, *(f"{share:.0%}" for share in (*flags, *ends)), f"{one.spearman('predicted', reached):.3f}")
    return table


def time_table(times: list[measure.Timing], threads: int) -> Table:
    table = Table(title=f"time of a task, {threads} thread(s)", title_justify="left")
    for heading in ("what", "batch", "ms"):
        table.add_column(heading, justify="left" if heading == "what" else "right")
    for one in times:
        table.add_row(one.what, str(one.tasks), f"{one.milliseconds:.3g}")
    return table
