"""`torcharm evaluate`: a study evaluated, as tables, a file and pictures."""

import json
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from torcharm.cli import options, outputs
from torcharm.cli.summaries import heading, summary_columns
from torcharm.cli.tables import print_table
from torcharm.cli.terminal import count, open_console, say
from torcharm.cli.work import Told, Work, read_study

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

    from torcharm.study import NamedArm, NamedTask, Study, StudyResult


def evaluate(
    study: options.Study = None,
    out: options.Rows = None,
    figure: Annotated[Path | None, options.figure("Draw the tasks")] = None,
    sums: options.Sums = False,
    paper: Annotated[bool, typer.Option("--paper", help="Evaluate the paper's validation.")] = False,
    as_json: options.Json = False,
) -> None:
    """Evaluate every arm of a study on each of its tasks: how far off, held or not, and why not."""
    if paper and study is not None:
        raise ValueError(f"--paper: stands alone, got the study {study} too")
    from torcharm.study import RESULT_FORMATS, example_study, paper_study, result_rows

    outputs.check(study, out, figure, RESULT_FORMATS)
    plan = paper_study() if paper else example_study() if study is None else read_study(study)
    figures = outputs.numbered("--figure", figure, len(plan.tasks))
    work, started = Work(), time.perf_counter()
    results = evaluate_all(plan, work)
    if results:  # nothing is worth a file that may be there
        rows = [row for result in results for row in result_rows(result)]
        if as_json:
            typer.echo(json.dumps(rows, indent=1))
        else:
            _report(open_console(), plan, results, time.perf_counter() - started, sums or paper)
            for line in [] if paper else _next_steps(study, results):
                say(line)
        drawn = outputs.figures(figures, outputs.by_task(plan.tasks, results), _drawn)
        outputs.save([*outputs.rows(out, rows), *drawn])
    work.finish(results)


def evaluate_all(plan: "Study", work: Work) -> "list[StudyResult]":
    """What is found of all arms on their tasks."""
    from torcharm.study import evaluate_arm

    def evaluated(arm: "NamedArm", task: "NamedTask", _: Told) -> "Iterator[StudyResult]":
        yield evaluate_arm(arm, task, plan.settings)

    return work.each("evaluating", plan.pairs, evaluated)


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


def _drawn(task: "NamedTask", results: Sequence["StudyResult"]) -> "Figure":
    from torcharm.plot import study_figure

    arms = [(result.arm.name, result.arm.design) for result in results]
    return study_figure(arms, task.name, task.task, [result.attainability for result in results])


def _report(console: "Console", plan: "Study", results: Sequence["StudyResult"], seconds: float, sums: bool) -> None:
    from rich.text import Text

    from torcharm.study import summarise
    from torcharm.study.words import why_not

    console.print(Text(plan.name, style="bold").append(plan.description and f"  {plan.description}", style="not bold"))
    for task, own in outputs.by_task(plan.tasks, results):
        chosen = [(result, summarise(result)) for result in own]
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
    from torcharm.study.words import NOT_EXCLUDED, verdict_legend, worst_node_legend
    from torcharm.wrench_sets.node_distances import counted

    found = results[0].attainability
    if found.prediction is not None:
        yield from verdict_legend(plan.settings, results)
        yield "tip off, turned, shape: medians over loads."
    else:
        yield NOT_EXCLUDED
    if found.node_miss is not None:
        yield worst_node_legend(plan.settings)
    if sums or found.prediction is None:
        what = "squared distances" if plan.settings.power == 2 else "distances"
        yield f"sums over nodes: {what} from attainable wrenches, {counted(plan.settings.weights)}."
