"""Measure error and run time of every method into results.csv beside this file; then draw and tabulate them."""

import argparse
import csv
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.console import Console

import torcharm as ta
from experiments.error_vs_runtime import figure
from experiments.error_vs_runtime.problems import DESIGNS, METRICS, NODES, SPACES, TASKS, problems, reference
from experiments.error_vs_runtime.rows import Row

HERE = Path(__file__).parent
START, END = "<!-- table: written by the script -->", "<!-- end of table -->"
BUDGET = 1.0
"""Seconds after which a call is not repeated again; the first, which loads and compiles, does not count."""


@dataclass(frozen=True)
class Method:
    """A way to distances: its name, options of `evaluate`, and of how many designs and tasks it can be asked."""

    name: str
    options: dict[str, Any]
    designs: int = DESIGNS
    tasks: int = TASKS
    differentiable: bool = True


def methods() -> list[Method]:
    """All methods; qpth's if it is installed."""

    def edges(samples: int, **more: Any) -> dict[str, Any]:
        return {"hull": "edges", "samples": samples, **more}

    found = [Method("exact", {})]
    found += [Method("edges", edges(samples)) for samples in (2, 3, 5, 9)]
    found += [Method("nnls", {"distance": "scipy", "samples": samples}, 5, 10) for samples in (3, 9, 17)]
    if find_spec("qpth") is not None:
        found += [Method("qpth", {"distance": "qpth", "samples": samples}, 5, 6) for samples in (3, 9)]
        found.append(Method("qpth on edges", edges(3, distance="qpth"), 5, 6))
    found.append(Method("nnls on edges", edges(3, distance="scipy"), 5, 10))
    found.append(Method("SLSQP on edges", edges(3, distance=ta.slsqp_distance), 2, 3, differentiable=False))
    return found


def measured(space: str, metric: str, method: Method, budget: float = BUDGET) -> Row:
    """Time and errors of a method; calls are repeated until they took the budget [s]."""
    given = problems(space).first(method.designs, method.tasks)

    def ask(radii: torch.Tensor) -> ta.Attainability:
        return ta.evaluate(given.arm(radii), given.task, (metric,), **method.options)

    radii = given.radii
    with torch.no_grad():
        found = ask(radii)
        forward = timed(lambda: ask(radii), budget)

    def differentiate() -> None:
        leaf = radii.clone().requires_grad_()
        torch.autograd.grad(getattr(ask(leaf), metric).sum(), leaf)

    count = method.designs * method.tasks * NODES
    gradient = timed(differentiate, budget) if method.differentiable else float("nan")
    distance, scale = reference(space, metric, method.designs, method.tasks)
    value = getattr(found, metric + "_per_node").numpy()
    own = slice(1, None) if metric == "relative" else slice(None)  # node 1 differs from itself by nothing
    error = (np.abs(value - distance)[..., own] / scale[..., own]).ravel()
    p50, p99 = np.quantile(error, (0.5, 0.99))
    converged = float(found.converged.double().mean())
    return Row(
        space=space,
        metric=metric,
        method=method.name,
        samples=method.options.get("samples", 0),
        problems=count,
        forward_us=forward / count * 1e6,
        gradient_us=gradient / count * 1e6,
        error_p50=float(p50),
        error_p99=float(p99),
        error_max=float(error.max()),
        converged=converged,
    )


def timed(work: Callable[[], object], budget: float) -> float:
    """Least processor time [s] of calls after the first."""
    work()
    spent: list[float] = []
    while not spent or (sum(spent) < budget and len(spent) < 15):
        start = time.process_time()
        work()
        spent.append(time.process_time() - start)
    return min(spent)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke run: few rows, nothing written")
    parser.add_argument("--figure", action="store_true", help="only draw and tabulate what results.csv holds")
    options = parser.parse_args()
    torch.set_num_threads(1)
    console = Console(width=140)
    if options.figure:
        publish(read())
        return
    plan = [
        (space, metric, method)
        for space in SPACES
        for metric in METRICS
        for method in methods()
        if not options.quick or (metric == "absolute" and method.name in ("exact", "nnls"))
    ]
    rows = []
    for space, metric, method in plan:
        if options.quick:
            method = replace(method, designs=2, tasks=2)
        rows.append(measured(space, metric, method, 0.0 if options.quick else BUDGET))
        console.print(shown(rows[-1]))
    if not options.quick:
        with open(HERE / "results.csv", "w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, [one.name for one in fields(Row)])
            writer.writeheader()
            for row in rows:
                writer.writerow({k: f"{v:.4g}" if isinstance(v, float) else v for k, v in asdict(row).items()})
        publish(rows)


def read() -> list[Row]:
    """The rows of results.csv."""
    with open(HERE / "results.csv", newline="", encoding="utf-8") as file:
        return [Row(**{one.name: one.type(line[one.name]) for one in fields(Row)}) for line in csv.DictReader(file)]  # type: ignore[operator]


def publish(rows: list[Row]) -> None:
    """Draw the figure, and replace the README's table."""
    figure.draw(rows)
    readme = HERE / "README.md"
    before, rest = readme.read_text(encoding="utf-8").split(START)
    _, after = rest.split(END)
    names = ("", "sets", "method", "points", "µs a node", "with gradient", "error p50", "p99", "max")
    lines = [f"| {' | '.join(names)} |", "|---" * len(names) + "|", *map(shown, rows)]
    readme.write_text(f"{before}{START}\n\n" + "\n".join(lines) + f"\n\n{END}{after}", encoding="utf-8")


def shown(row: Row) -> str:
    """A line of the table."""

    def time_of(value: float) -> str:
        return "" if np.isnan(value) else f"{value:.3g}" if value < 1000 else f"{value:,.0f}"

    errors = [f"{value:.0e}" for value in (row.error_p50, row.error_p99, row.error_max)]
    names = [row.space, row.metric, row.method, str(row.samples or "")]
    return "| " + " | ".join([*names, time_of(row.forward_us), time_of(row.gradient_us), *errors]) + " |"
