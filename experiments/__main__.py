"""List the experiments, or run them: `python -m experiments run [NAMES] [--quick] [--fresh]`.

`python -m experiments --quick` is a smoke run of all. A mistake ends in one line and exit code 2, a failed
experiment in exit code 1 once the others have run.
"""

import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from experiments import runner

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, help="The experiments, to list and to run.")
Quick = Annotated[bool, typer.Option("--quick", help="Smoke runs: seconds each, nothing written into the checkout.")]
Fresh = Annotated[bool, typer.Option("--fresh", help="Run what is finished, too.")]
State = Annotated[
    Path | None, typer.Option("--state", help="Folder for logs and records of what is finished; the user's cache.")
]


@app.callback(invoke_without_command=True)
def root(context: typer.Context, quick: Quick = False, fresh: Fresh = False, state: State = None) -> None:
    """List the experiments; with --quick, run them all quickly."""
    if context.invoked_subcommand is not None:
        return
    if quick:
        run_all([], quick, fresh, state)
    else:
        show()


@app.command()
def run(
    names: Annotated[list[str] | None, typer.Argument(help="Which; all without one.", show_default=False)] = None,
    quick: Quick = False,
    fresh: Fresh = False,
    state: State = None,
) -> None:
    """Run experiments one after another; what is finished is skipped, and a failure does not stop the others."""
    run_all(names or [], quick, fresh, state)


def show() -> None:
    """Names and summaries."""
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    for experiment in runner.discover():
        table.add_row(experiment.name, experiment.summary)
    console = Console(highlight=False)
    console.print(table)
    console.print("\nRun one: python -m experiments.NAME. Run all: python -m experiments run [--quick]")


def run_all(names: list[str], quick: bool, fresh: bool, state: Path | None) -> None:
    """Run, with a progress bar, and exit with 1 if one failed."""
    console = Console(highlight=False)
    try:
        chosen = runner.choose(runner.discover(), names)
    except ValueError as error:
        print(f"experiments: {error}", file=sys.stderr)
        raise typer.Exit(2) from None
    place = state or runner.default_state(quick)
    outcomes: list[tuple[runner.Outcome, bool]] = []
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    try:
        with Progress(*columns, console=console, transient=True) as progress:
            bar = progress.add_task("", total=len(chosen))
            for experiment in chosen:
                progress.update(bar, description=experiment.name)
                kept = None if fresh else runner.finished(experiment, place)
                outcome = kept or runner.run(experiment, place, ["--quick"] if quick else [])
                outcomes.append((outcome, kept is not None))
                if outcome.code:
                    console.print(f"{experiment.name} failed with exit code {outcome.code}:", style="bold")
                    for line in runner.last_lines(outcome):
                        console.print(f"  {line}", markup=False)
                progress.advance(bar)
    except KeyboardInterrupt:
        console.print(_report(outcomes))
        console.print(f"interrupted; {len(outcomes)} of {len(chosen)} are done and will be skipped")
        raise typer.Exit(130) from None
    console.print(_report(outcomes))
    console.print(f"Logs: {place}", soft_wrap=True)
    if any(outcome.code for outcome, _ in outcomes):
        raise typer.Exit(1)


def _report(outcomes: list[tuple[runner.Outcome, bool]]) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0))
    for heading in ("experiment", "", "time", "most memory"):
        table.add_column(heading, justify="right" if heading in ("time", "most memory") else "left")
    for outcome, kept in outcomes:
        how = f"failed ({outcome.code})" if outcome.code else "finished before" if kept else "finished"
        memory = "" if outcome.memory_mib is None else f"{outcome.memory_mib:.0f} MiB"
        table.add_row(outcome.name, how, f"{outcome.seconds:.1f} s", memory)
    return table


if __name__ == "__main__":
    app()
