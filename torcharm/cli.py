"""The `torcharm` command: evaluate a study, or write one to start from.

A mistake that a person can make ends in one line on the standard error and exit code 2.
"""

import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from torcharm.study import NamedTask, Settings, Study, StudyResult, Summary

FIGURE_FORMATS = ("png", "pdf", "svg", "jpg", "eps")
MISTAKE, INTERRUPTED = 2, 130

_UsageError: type[Exception] = typer.BadParameter.__bases__[0]  # click's own, which newer typers hold inside

app = typer.Typer(
    name="torcharm",
    help="Can a soft continuum arm hold these shapes under these loads, and if not, by how much does it miss?",
    epilog="Example: torcharm init writes study.toml, torcharm evaluate study.toml evaluates it.",
    rich_markup_mode="rich",
    add_completion=False,
    pretty_exceptions_enable=False,
)


def main() -> None:
    """Run the command and exit: 0, or 2 after a mistake, or 130 after Ctrl-C."""
    # What the terminal's encoding lacks becomes a question mark, rather than the end of the work.
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    try:
        code = app(sys.argv[1:] or ["--help"], prog_name="torcharm", standalone_mode=False)
    except _UsageError as error:
        _fail(error.format_message() if hasattr(error, "format_message") else str(error))
    except (typer.Abort, KeyboardInterrupt):
        code = INTERRUPTED
    sys.exit(code if isinstance(code, int) else 0)


def _fail(message: str, code: int = MISTAKE) -> NoReturn:
    print("torcharm:", " ".join(message.split()), file=sys.stderr)
    sys.exit(code)


@contextmanager
def _mistakes() -> Iterator[None]:
    """Report in one line what a person can cause."""
    try:
        yield
    except KeyboardInterrupt:
        _fail("interrupted", INTERRUPTED)
    except BrokenPipeError:
        raise  # whoever read the output has left: no mistake
    except MemoryError:
        _fail("not enough memory for this study")
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        _fail(f"{where}{error.strerror or error}")
    except ValueError as error:
        _fail(str(error))


def _show_version(wanted: bool) -> bool:
    if wanted:
        from torcharm import __version__

        typer.echo(f"torcharm {__version__}")
        raise typer.Exit
    return wanted


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    pass  # holds the options of torcharm itself; `main` shows the help if there are none


@app.command(epilog="Example: torcharm init arms.toml")
def init(
    path: Annotated[Path, typer.Argument(help="Where to write it.")] = Path("study.toml"),
    force: Annotated[bool, typer.Option("--force", help="Overwrite the file if there is one.")] = False,
) -> None:
    """Write a commented study to start from."""
    with _mistakes():
        from torcharm.study import example_text

        try:
            with path.open("w" if force else "x", encoding="utf-8", newline="\n") as file:
                file.write(example_text())
        except FileExistsError:
            raise ValueError(f"{path}: is there already; --force overwrites it") from None
        _say(_console(), f"Wrote {path}. Evaluate it with: torcharm evaluate {path}")


@app.command(epilog="Example: torcharm evaluate study.toml --out results.csv --figure picture.png")
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
    with _mistakes():
        _check_outputs(study, out, figure)
        from torcharm.study import evaluate_study, load_study, paper_study, write_results

        plan = paper_study() if study is None else load_study(study)
        started = time.perf_counter()
        results = evaluate_study(plan)
        seconds = time.perf_counter() - started

        console = _console()
        _report(console, plan, results, seconds)
        if out is not None:
            rows = write_results(out, results)
            _say(console, f"Wrote {out} ({_count(rows, 'row')}).")
        if figure is not None:
            for path, task in zip(_figure_paths(figure, plan.tasks), plan.tasks, strict=True):
                _draw(path, task, [result for result in results if result.task is task])
                _say(console, f"Wrote {path} ({task.name}).")


# Outputs


def _check_outputs(study: Path | None, out: Path | None, figure: Path | None) -> None:
    """Raise a ValueError about an output that cannot be written, before the work is done."""
    for option, path in (("--out", out), ("--figure", figure)):
        if path is None:
            continue
        if path.is_dir():
            raise ValueError(f"{option}: {path}: is a directory, must be a file")
        if not path.parent.is_dir():
            raise ValueError(f"{option}: {path}: the directory {path.parent} does not exist")
        try:
            _try_writing(path)
        except OSError as error:
            raise ValueError(f"{option}: {path}: cannot be written, {error.strerror}") from None
        if study is not None and path.resolve() == study.resolve():
            raise ValueError(f"{option}: {path}: is the study itself, must be another file")
    if figure is None:
        return
    if figure.suffix.lower().removeprefix(".") not in FIGURE_FORMATS:
        raise ValueError(
            f"--figure: {figure}: must end in one of .{', .'.join(FIGURE_FORMATS)}, got {figure.suffix or 'no ending'}"
        )
    if out is not None and out.resolve() == figure.resolve():
        raise ValueError(f"--figure: {figure}: is the file of --out, must be another")


def _try_writing(path: Path) -> None:
    """Open the file, or one beside it, as permissions alone do not tell; leaves no trace."""
    if path.is_file():
        path.open("ab").close()
    elif not path.exists():
        tempfile.TemporaryFile(dir=path.parent).close()


def _figure_paths(path: Path, tasks: Sequence["NamedTask"]) -> list[Path]:
    """The path itself for one task; with the task's number for each of several."""
    if len(tasks) == 1:
        return [path]
    return [path.with_stem(f"{path.stem}-{index}") for index in range(1, len(tasks) + 1)]


def _draw(path: Path, task: "NamedTask", results: Sequence["StudyResult"]) -> None:
    from torcharm.plot import study_figure

    arms = [(result.arm.name, result.arm.design) for result in results]
    study_figure(arms, task.name, task.task, [result.attainability for result in results]).savefig(path)


# The report


def _console() -> "Console":
    from rich.console import Console

    return Console(highlight=False, markup=False, emoji=False)


def _say(console: "Console", text: str) -> None:
    """A line that a pipe gets whole; a terminal wraps it."""
    console.print(text, soft_wrap=True)


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


def _report(console: "Console", plan: "Study", results: Sequence["StudyResult"], seconds: float) -> None:
    from rich.text import Text

    from torcharm.study import summarise

    summaries = [summarise(result) for result in results]
    console.print(Text(plan.name, style="bold").append(plan.description and f"  {plan.description}", style="not bold"))
    for task in plan.tasks:
        chosen = [(r, s) for r, s in zip(results, summaries, strict=True) if r.task is task]
        nodes, loads = _count(task.task.nodes, "node"), _count(chosen[0][1].loads, "load")
        console.print()
        console.print(Text("Task ").append(task.name, style="bold").append(f", {nodes}, {loads}"))
        console.print()
        console.print(_table(chosen, plan.settings))
    console.print()
    console.print(_legend(plan.settings, results[0].node_metric))
    console.print()
    for note in _notes(summaries):
        console.print(note)
    arms, tasks = _count(len(plan.arms), "arm"), _count(len(plan.tasks), "task")
    evaluations = _count(sum(summary.loads for summary in summaries), "evaluation")
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
        table.add_column(f"{metric}\nmedian", justify="right")
    table.add_column(f"{metrics[0]}\n{zero}", justify="right")
    if len(metrics) > 1:
        table.add_column(f"{'both' if len(metrics) == 2 else 'all'}\n{zero}", justify="right")
    table.add_column("worst\nnode", justify="right")
    table.add_column("strain\nout of range", no_wrap=True)
    for result, summary in rows:
        table.add_row(Text(result.arm.name), *_cells(summary, metrics))
    return table


def _cells(summary: "Summary", metrics: Sequence[str]) -> Iterator[str]:
    for metric in metrics:
        yield f"{summary.median[metric]:.4g}"
    yield str(summary.attainable[metrics[0]])
    if len(metrics) > 1:
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
    legend.add_row(metrics[0], f"{power} of the required {basis} from the attainable ones, summed over the nodes")
    if metrics[:2] == ("absolute", "relative"):
        legend.add_row("relative", "the same for differences from the wrench at node 1, the base")
    legend.add_row("unit", _unit(settings))
    below = "; below, minus the smallest margin" if settings.signed else ""
    legend.add_row(f"{'≤' if settings.signed else '='} 0", f"number of loads that are attainable{below}")
    legend.add_row("worst node", f"has the largest mean {node_metric} distance; node 1 is the base")
    return legend


def _unit(settings: "Settings") -> str:
    squared = settings.power == 2
    if settings.weights == (1.0, 1.0):
        return f"{'N²' if squared else 'N'}, with 1 N·m counted as 1 N"
    force, moment = settings.weights
    square = f"{force:g} f² + {moment:g} m²"
    return f"that of {square if squared else f'sqrt({square})'}, with f in N and m in N·m"


def _notes(summaries: Sequence["Summary"]) -> Iterator[str]:
    if any(_strained(summary) for summary in summaries):
        excess = max(summary.strain_excess for summary in summaries)
        yield f"Strains are up to {excess:.2g} out of range: there the force models are extrapolated."
    if not all(summary.limits_in_range for summary in summaries):
        yield "Pressure limits are out of range: there the force models are extrapolated."


if __name__ == "__main__":
    main()
