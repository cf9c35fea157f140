"""`torcharm evaluate`: a study evaluated, as tables, a file and pictures."""

import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from torcharm.cli.terminal import (
    FIGURE_FORMATS,
    check_outputs,
    count,
    figure_paths,
    mistakes,
    open_console,
    save_all,
)
from torcharm.files import check_writable

_PREDICTED = "predicted_error"  # torcharm.attainability, which loads torch, must wait

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from torcharm.study import NamedTask, Settings, Study, StudyResult, Summary


def evaluate(
    study: Annotated[
        Path | None, typer.Argument(help="A study, as TOML. Without one, the paper's validation.", show_default=False)
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Write a CSV file: a row for every arm, task and load.")
    ] = None,
    figure: Annotated[
        Path | None,
        typer.Option("--figure", help=f"Draw the tasks, to a file ending in {', '.join(FIGURE_FORMATS)}."),
    ] = None,
) -> None:
    """Evaluate every arm of a study on every task and show a table for each task."""
    with mistakes():
        check_outputs(study, out, figure)
        from torcharm.study import evaluate_study, load_study, paper_study

        plan = paper_study() if study is None else load_study(study)
        for path in [] if figure is None else figure_paths(figure, plan.tasks):
            check_writable(path, "--figure")
        started = time.perf_counter()
        results = evaluate_study(plan)
        seconds = time.perf_counter() - started

        console = open_console()
        _report(console, plan, results, seconds)
        save_all(console, _outputs(plan, results, out, figure))


def _outputs(
    plan: "Study", results: Sequence["StudyResult"], out: Path | None, figure: Path | None
) -> Iterator[tuple[Path, Callable[[Path], object], str]]:
    from torcharm.study import write_results

    if out is not None:
        rows = sum(result.attainable.numel() for result in results)
        yield out, lambda path: write_results(path, results), f" ({count(rows, 'row')})."
    if figure is not None:
        for place, task in zip(figure_paths(figure, plan.tasks), plan.tasks, strict=True):
            shown = [result for result in results if result.task is task]
            yield place, partial(_draw, task=task, results=shown), f" ({task.name})."


def _draw(path: Path, task: "NamedTask", results: Sequence["StudyResult"]) -> None:
    from torcharm.plot import study_figure

    arms = [(result.arm.name, result.arm.design) for result in results]
    study_figure(arms, task.name, task.task, [result.attainability for result in results]).savefig(path)


def _report(console: "Console", plan: "Study", results: Sequence["StudyResult"], seconds: float) -> None:
    from rich.text import Text

    from torcharm.study import summarise

    summaries = [summarise(result) for result in results]
    console.print(Text(plan.name, style="bold").append(plan.description and f"  {plan.description}", style="not bold"))
    for task in plan.tasks:
        chosen = [(r, s) for r, s in zip(results, summaries, strict=True) if r.task is task]
        nodes, loads = count(task.task.nodes, "node"), count(chosen[0][1].loads, "load")
        console.print()
        console.print(Text("Task ").append(task.name, style="bold").append(f", {nodes}, {loads}"))
        console.print()
        console.print(_table(chosen, plan.settings))
    console.print()
    console.print(_legend(plan.settings, results[0].node_metric))
    console.print()
    for note in _notes(results, summaries):
        console.print(note)
    arms, tasks = count(len(plan.arms), "arm"), count(len(plan.tasks), "task")
    evaluations = count(sum(summary.loads for summary in summaries), "evaluation")
    console.print(f"{arms} on {tasks}: {evaluations} in {seconds:.2g} s.")


def _table(rows: Sequence[tuple["StudyResult", "Summary"]], settings: "Settings") -> "Table":
    from rich import box
    from rich.table import Table
    from rich.text import Text

    zero = "≤ 0" if settings.signed else "= 0"
    metrics = settings.metrics
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False)
    table.add_column("arm", overflow="fold")
    for metric in metrics:
        table.add_column("predicted\n[mm]" if metric == _PREDICTED else f"{metric}\nmedian", justify="right")
    first = metrics[0]
    tolerable = first == _PREDICTED  # nothing else was asked for
    table.add_column("predicted\n≤ 1 mm" if tolerable else f"{first}\n{zero}", justify="right")
    if len(set(metrics) - {_PREDICTED}) > 1:
        table.add_column(f"both\n{zero}", justify="right")
    table.add_column("worst\nnode", justify="right")
    table.add_column("strain\nout of range", no_wrap=True)
    for result, summary in rows:
        table.add_row(Text(result.arm.name), *_cells(summary, metrics))
    return table


def _cells(summary: "Summary", metrics: Sequence[str]) -> Iterator[str]:
    for metric in metrics:
        yield f"{summary.median[metric] * (1000 if metric == _PREDICTED else 1):.4g}"
    yield str(summary.attainable[metrics[0]])
    if len(set(metrics) - {_PREDICTED}) > 1:
        yield str(summary.all_attainable)
    yield "-" if summary.worst_node is None else str(summary.worst_node)
    yield f"yes, by {summary.strain_excess:.2g}" if _strained(summary) else "no"


def _strained(summary: "Summary") -> bool:
    """Whether strains are out of range by more than rounding."""
    return summary.strain_excess > 1e-9


def _legend(settings: "Settings", node_metric: str | None) -> "Table":
    from rich.table import Table

    metrics, power = settings.metrics, "squared distance" if settings.power == 2 else "distance"
    legend = Table.grid(padding=(0, 2))
    basis = "wrenches" if "absolute" in metrics else "differences from the wrench at node 1"
    if metrics[0] != _PREDICTED:
        legend.add_row(metrics[0], f"{power} of the required {basis} from the attainable ones, summed over the nodes")
        if metrics[:2] == ("absolute", "relative"):
            legend.add_row("relative", "the same for differences from the wrench at node 1, the base")
        legend.add_row("unit", _unit(settings))
        below = "; below, minus the smallest margin" if settings.signed else ""
        legend.add_row(f"{'≤' if settings.signed else '='} 0", f"number of loads that are attainable{below}")
    if _PREDICTED in metrics:
        legend.add_row("predicted", "shape error to expect, the square root of its cost Σ ω (x² + y² + 0.05 θ²)")
    if node_metric is not None:
        legend.add_row("worst node", f"has the largest mean {node_metric} distance; node 1 is the base")
    return legend


def _unit(settings: "Settings") -> str:
    squared = settings.power == 2
    if settings.weights == (1.0, 1.0):
        return f"{'N²' if squared else 'N'}, with 1 N·m counted as 1 N"
    force, moment = settings.weights
    square = f"{force:g} f² + {moment:g} m²"
    return f"that of {square if squared else f'sqrt({square})'}, with f in N and m in N·m"


def _notes(results: Sequence["StudyResult"], summaries: Sequence["Summary"]) -> Iterator[str]:
    where = dict.fromkeys(
        f"{result.arm.name} on {result.task.name}"
        for result, summary in zip(results, summaries, strict=True)
        if summary.impossible
    )
    if where:
        yield (
            f"Impossible: an actuator of {', '.join(where)} would have no length. "
            "Are curvatures in radians (not degrees), and lengths and radii in metres (not millimetres)?"
        )
    unpredicted = sum(summary.unpredicted for summary in summaries)
    if unpredicted:
        yield f"No stable equilibrium was found for {count(unpredicted, 'load')}: their predicted error is infinite."
    if any(_strained(summary) for summary in summaries):
        excess = max(summary.strain_excess for summary in summaries)
        yield f"Strains are up to {excess:.2g} out of range: there the force models are extrapolated."
    if not all(summary.limits_in_range for summary in summaries):
        yield "Pressure limits are out of range: there the force models are extrapolated."
