"""`torcharm evaluate`: a study evaluated, as tables, a file and pictures."""

import json
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from torcharm.cli.summaries import heading, summary_columns
from torcharm.cli.tables import print_table
from torcharm.cli.terminal import (
    FIGURE_FORMATS,
    asked_about,
    check_ending,
    check_outputs,
    count,
    finish,
    mistakes,
    numbered,
    open_console,
    progress,
    save_all,
    say,
)
from torcharm.files import check_writable

if TYPE_CHECKING:
    from rich.console import Console

    from torcharm.study import NamedTask, Study, StudyResult


def evaluate(
    study: Annotated[
        Path | None, typer.Argument(help="A study, as TOML. Without one, the example of torcharm init.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Write a row for every arm, task and load, to a file .csv or .json.")
    ] = None,
    figure: Annotated[
        Path | None,
        typer.Option("--figure", help=f"Draw the tasks, to a file ending in {', '.join(FIGURE_FORMATS)}."),
    ] = None,
    sums: Annotated[bool, typer.Option("--sums", help="Show the paper's sums over the nodes, too.")] = False,
    paper: Annotated[bool, typer.Option("--paper", help="Evaluate the paper's validation.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the rows of --out as JSON, and no tables.")] = False,
) -> None:
    """Evaluate every arm of a study on each of its tasks: how far off, held or not, and why not."""
    with mistakes():
        if paper and study is not None:
            raise ValueError(f"--paper: stands alone, got the study {study} too")
        check_outputs(study, out, figure)
        from torcharm.study import RESULT_FORMATS, example_study, load_study, paper_study

        check_ending("--out", out, RESULT_FORMATS)
        plan = paper_study() if paper else example_study() if study is None else asked_about(load_study(study))
        for path in numbered(figure, len(plan.tasks)):
            check_writable(path, "--figure")
        started = time.perf_counter()
        results, refused, interrupted = evaluate_all(plan)
        if results:  # nothing is worth a file that may be there
            console = open_console()
            if as_json:
                _print_json(results)
            else:
                _report(console, plan, results, time.perf_counter() - started, sums or paper)
                for line in [] if paper else _next_steps(study, results):
                    say(console, line)
            save_all(console, _outputs(plan, results, out, figure))
        finish(interrupted, results, refused)


def evaluate_all(plan: "Study") -> "tuple[list[StudyResult], dict[str, list[str]], bool]":
    """What is found of all arms on their tasks, who was refused by why, and whether Ctrl-C came between."""
    from torcharm.study import evaluate_study

    results: list[StudyResult] = []
    refused: dict[str, list[str]] = {}
    with progress("evaluating", sum(len(plan.arms_of(task)) for task in plan.tasks)) as advance:
        try:
            for result in evaluate_study(plan, lambda arm, why: refused.setdefault(why, []).append(arm.name)):
                results.append(result)
                advance()
        except KeyboardInterrupt:  # what is finished is shown and written all the same
            return results, refused, True
    return results, refused, False


def _next_steps(study: Path | None, results: Sequence["StudyResult"]) -> Iterator[str]:
    """What a person may try now."""
    from torcharm.study.words import next_commands

    yield ""
    if study is None:
        yield "Next: torcharm init writes this example, with comments, to study.toml: put in your own"
        yield "arms and tasks. torcharm evaluate study.toml --figure picture.png draws them."
        return
    said = ",\n".join(f"{command} {does}" for command, does in next_commands(str(study), results))
    yield from f"Next: {said}.".splitlines() if said else ()


def _print_json(results: Sequence["StudyResult"]) -> None:
    from torcharm.study import result_rows

    typer.echo(json.dumps([row for result in results for row in result_rows(result)], indent=1))


def _outputs(
    plan: "Study", results: Sequence["StudyResult"], out: Path | None, figure: Path | None
) -> Iterator[tuple[Path, Callable[[Path], object], str]]:
    from torcharm.study import check_format, write_results

    if out is not None:
        rows, ending = sum(result.loads for result in results), f".{check_format(out)}"
        yield out, lambda path: write_results(path, results, ending), f" ({count(rows, 'row')})."
    for place, task in zip(numbered(figure, len(plan.tasks)), plan.tasks, strict=False):
        shown = [result for result in results if result.task is task]
        if shown:
            yield place, partial(_draw, task=task, results=shown), f" ({task.name})."


def _draw(path: Path, task: "NamedTask", results: Sequence["StudyResult"]) -> None:
    from torcharm.plot import study_figure

    arms = [(result.arm.name, result.arm.design) for result in results]
    study_figure(arms, task.name, task.task, [result.attainability for result in results]).savefig(path)


def _report(console: "Console", plan: "Study", results: Sequence["StudyResult"], seconds: float, sums: bool) -> None:
    from rich.text import Text

    from torcharm.study import summarise
    from torcharm.study.words import why_not

    console.print(Text(plan.name, style="bold").append(plan.description and f"  {plan.description}", style="not bold"))
    for task in plan.tasks:
        chosen = [(result, summarise(result)) for result in results if result.task is task]
        if not chosen:
            continue
        console.print()
        console.print(heading(task, chosen[0][1].loads))
        console.print()
        print_table(list(summary_columns(chosen, sums)))
        for result, summary in chosen:
            if summary.example is not None:
                console.print(f"{result.arm.name}{why_not(summary, *summary.example)}")
    console.print()
    for line in _legend(plan, results, sums):
        console.print(line)
    arms, tasks = count(len(plan.arms), "arm"), count(len(plan.tasks), "task")
    evaluations = count(sum(result.loads for result in results), "evaluation")
    taken = f"{seconds:.0f}" if seconds >= 10 else f"{seconds:.2g}"
    console.print(f"{arms} on {tasks}: {evaluations} in {taken} s.")


def _legend(plan: "Study", results: Sequence["StudyResult"], sums: bool) -> Iterator[str]:
    """What the columns mean, in a line each."""
    from torcharm.study.words import verdict_legend, worst_node_legend

    if not results:
        return
    found = results[0].attainability
    if found.prediction is not None:
        yield from verdict_legend(plan.settings, results)
        yield "tip off, turned, shape: medians over loads."
    else:
        yield "not excluded: no node lacks a wrench, which is necessary but not sufficient."
    if found.node_miss is not None:
        yield worst_node_legend(plan.settings)
    if sums or found.prediction is None:
        yield f"sums over nodes: {_sums(plan)}."


def _sums(plan: "Study") -> str:
    from torcharm.wrench_sets.node_distances import counted

    settings = plan.settings
    what = "squared distances" if settings.power == 2 else "distances"
    return f"{what} from attainable wrenches, {counted(plan.settings.weights)}"
