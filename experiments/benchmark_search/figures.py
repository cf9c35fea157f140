"""The figures of the benchmark: what more starts and rounds find in which time, and what the metrics rank."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure
from scipy.stats import spearmanr

from experiments.benchmark_search.reference import Array
from experiments.rows import Measurement
from torcharm.pressure.search import ROUNDS, STARTS

STYLES = {"antagonistic": ("#0072B2", "o"), "bellows-only": ("#E69F00", "s")}
"""Colour and marker of each arm."""
DEFAULT = (STARTS["multistart"], ROUNDS)
"""Starts and rounds that a search takes where none are asked for."""
METRICS = ("absolute", "relative", "absolute + relative")


def draw_starts(rows: Sequence[Measurement], path: Path) -> None:
    """The share of tasks whose best pressure is missed against the time of a search, beside the time of scipy's."""
    value = {(row.case, row.quantity): row.value for row in rows}
    figure = Figure(figsize=(8, 5), layout="constrained", dpi=130)
    axes = figure.subplots()
    for name, (colour, marker) in STYLES.items():
        cases = [case for case, quantity in value if case.startswith(name) and quantity == "within 1 % of the best"]
        x = [value[case, "time a search"] for case in cases]
        y = [100 - value[case, "within 1 % of the best"] for case in cases]
        axes.plot(x, y, marker + "-", color=colour, label=f"torcharm, {name}")
        for place, (case, spent, missed) in enumerate(zip(cases, x, y, strict=True)):
            plan = "/".join(re.findall(r"(\d+) (?:start|round)", case))
            # Where curves end together their labels stand apart: one arm's above, the other's below.
            side = 8 if name == next(iter(STYLES)) else -16
            shift = (0, side) if place > 1 else (-4, 8)
            axes.annotate(plan, (spent, missed), shift, textcoords="offset points", ha="center", color=colour)
        scipy = value[f"{name}, scipy SLSQP, 1 start(s), 100 tasks", "time a search"]
        axes.axvline(1e3 * scipy, color=colour, linestyle="--", label=f"scipy's SLSQP, 1 start, {name}")
    axes.set_xscale("log")
    axes.set_xticks(ticks := [0.5, 1, 2, 5, 10, 20, 50, 100], [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    axes.set(xlabel="time of a search [ms]", ylabel="tasks over 1 % above the best known cost [%]", ylim=(-6, 55))
    starts, rounds = DEFAULT
    default = [f"{name}, {starts} start(s), {rounds} round(s)" for name in STYLES]
    spent = max(value[case, "time a search"] for case in default)
    found = sum(value[case, "within 1 % of the best"] for case in default) / len(default)
    axes.set_title(
        f"The default, {starts}/{rounds}, finds the best pressure on {found:.0f} % of the tasks, in {spent:.1f} ms"
    )
    axes.grid(alpha=0.3)
    axes.legend(loc="upper center", title="labels: starts/rounds")
    figure.savefig(path)


def draw_ranks(found: Mapping[str, tuple[Array, Mapping[str, Array]]], path: Path) -> None:
    """The search's costs against the metrics, of each arm."""
    figure = Figure(figsize=(10, 6.3), layout="constrained", dpi=130)
    grid = figure.subplots(len(found), len(METRICS), squeeze=False)
    for row, (name, (cost, metrics)) in zip(grid, found.items(), strict=True):
        colour, marker = STYLES[name]
        for axes, metric in zip(row, METRICS, strict=True):
            axes.plot(metrics[metric], cost, marker, color=colour, markersize=4, alpha=0.7)
            axes.set_yscale("log")
            axes.set_title(f"{name}: {spearmanr(metrics[metric], cost).statistic:+.2f}")
            axes.set_xlabel(f"{metric} unattainability [N]")
            axes.grid(alpha=0.3)
        row[0].set_ylabel("cost of the best pressure [m²]")
    figure.suptitle("No sum of unattainabilities ranks both arms' tasks as the search does (titles: rank correlations)")
    figure.savefig(path)
