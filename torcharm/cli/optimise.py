"""`torcharm optimise`: every arm of a study made better on all its tasks together."""

import csv
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from torcharm.cli.terminal import (
    FIGURE_FORMATS,
    INTERRUPTED,
    check_outputs,
    count,
    fail,
    mistakes,
    open_console,
    save_all,
    say,
)
from torcharm.files import check_writable, plain_cell

if TYPE_CHECKING:
    from rich.table import Table

    from torcharm.design import OptimisedDesign, Progress

Found = Sequence[tuple[str, "OptimisedDesign"]]


def optimise(
    study: Annotated[Path, typer.Argument(help="A study, as TOML; its table [optimise] says what may change.")],
    out: Annotated[
        Path | None, typer.Option("--out", help="Write a CSV file: a row for every arm and actuator, given and best.")
    ] = None,
    figure: Annotated[
        Path | None,
        typer.Option("--figure", help=f"Draw errors and designs, to a file ending in {', '.join(FIGURE_FORMATS)}."),
    ] = None,
    checkpoint: Annotated[
        Path | None, typer.Option("--checkpoint", help="Keep finished starts in this file, and go on from it.")
    ] = None,
) -> None:
    """Find better radii, lengths and limits for every arm of a study, on all its tasks together.

    Ctrl-C ends the optimisation and shows what was found until then.
    """
    with mistakes():
        check_outputs(study, out, figure)
        _check_checkpoint(study, out, figure, checkpoint)
        from torcharm.design import optimise_design
        from torcharm.study import load_study

        plan = load_study(study)
        how, total = plan.optimisation, len(plan.arms)
        for option, path in (("--figure", figure), ("--checkpoint", checkpoint)):
            for index in range(total if path is not None else 0):
                check_writable(_numbered(path, index, total) or "", option)
        tasks = [named.task for named in plan.tasks]
        console = open_console()
        results: list[tuple[str, OptimisedDesign]] = []
        for index, arm in enumerate(plan.arms):
            with _warnings_in_a_line(), _shown_progress(arm.name) as told:
                result = optimise_design(
                    arm.design,
                    tasks,
                    how.space,
                    how.objective,
                    starts=how.starts,
                    seed=how.seed,
                    iterations=how.iterations,
                    checkpoint=_numbered(checkpoint, index, total),
                    callback=told,
                )
            results.append((arm.name, result))
            if result.stopped == "interrupted":
                break
        _tell(results)
        save_all(console, _outputs(results, out, figure, total))
        if results[-1][1].stopped == "interrupted":
            fail("interrupted", INTERRUPTED)


def _check_checkpoint(study: Path, out: Path | None, figure: Path | None, checkpoint: Path | None) -> None:
    for what, other in (("the study itself", study), ("the file of --out", out), ("the file of --figure", figure)):
        if checkpoint is not None and other is not None and checkpoint.resolve() == other.resolve():
            raise ValueError(f"--checkpoint: {checkpoint}: is {what}, must be another file")


def _tell(results: Found) -> None:
    from torcharm.design.result import objective_words

    console = open_console()
    console.print(_table(results))
    console.print()
    first = results[0][1]
    words, tasks = objective_words(first.objective), count(len(first.after.stable), "task")
    unit = "mm" if first.objective.unit == "m" else "N"
    say(console, f"Value: {words} [{unit}], of {tasks}. Tip: mean predicted error [mm]. Designs are in mm and kPa.")
    for name, result in results:
        say(console, f"{name}: {result.status}.")
        if result.violated and result.best is not result.given:
            say(console, f"{name}: the given arm breaks: {'; '.join(result.violated)}.")
        if result.active:
            say(console, f"{name}: the best arm is held back by: {'; '.join(result.active)}.")


def _outputs(
    results: Found, out: Path | None, figure: Path | None, total: int
) -> Iterator[tuple[Path, Callable[[Path], object], str]]:
    if out is not None:
        yield out, lambda path: _write(path, results), "."
    for index, (name, result) in enumerate(results if figure is not None else ()):
        from torcharm.plot import optimisation_figure

        drawn = optimisation_figure(result, name)
        yield _numbered(figure, index, total) or Path(), drawn.savefig, f" ({name})."


@contextmanager
def _warnings_in_a_line() -> Iterator[None]:
    """Warnings as one line each on the standard error, as mistakes are told."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", RuntimeWarning)
        warnings.showwarning = lambda message, *_, **__: print("torcharm:", message, file=sys.stderr)
        yield


@contextmanager
def _shown_progress(name: str) -> "Iterator[Callable[[Progress], None]]":
    """A progress bar on the standard error, if it is a terminal; yields what updates it."""
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("best {task.fields[value]}"),
        TimeElapsedColumn(),
    )
    with Bar(*columns, console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task(name, total=None, value="-")

        def told(progress: "Progress") -> None:
            bar.update(task, completed=progress.start, total=progress.starts, value=f"{progress.value:.4g}")

        yield told


def _numbered(path: Path | None, index: int, total: int) -> Path | None:
    if path is None or total == 1:
        return path
    return path.with_stem(f"{path.stem}-{index + 1}")


def _write(path: Path, results: Found) -> None:
    from torcharm.arm import ArmDesign

    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        fields = ("radius_m", "length_m", "max_pressure_kPa")
        writer.writerow(("arm", "actuator", "model", *(f"given_{name}" for name in fields), *fields))
        for name, result in results:
            columns = []
            for arm in (result.given, result.best):
                assert isinstance(arm, ArmDesign)  # studies hold no others
                columns += [value.tolist() for value in (arm.radii, arm.length, arm.max_pressure)]
            for index, values in enumerate(zip(*columns, strict=True)):
                model = type(result.best.actuators[index]).__name__
                writer.writerow((plain_cell(name), index + 1, plain_cell(model), *values))


def _table(results: Found) -> "Table":
    from rich import box
    from rich.table import Table
    from rich.text import Text

    from torcharm.arm import ArmDesign

    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False)
    table.add_column("arm", overflow="fold")
    for name in ("value\ngiven", "value\nbest", "tip\ngiven", "tip\nbest"):
        table.add_column(name, justify="right")
    for name in ("radii", "lengths", "limits"):
        table.add_column(name, overflow="fold")
    for name, result in results:
        best, scale = result.best, 1e3 if result.objective.unit == "m" else 1.0
        assert isinstance(best, ArmDesign)
        table.add_row(
            Text(name),
            *(f"{scale * value:.4g}" for value in (result.given_value, result.value)),
            *(f"{side.tip_mm:.4g}" for side in (result.before, result.after)),
            *(" ".join(f"{1e3 * value:.1f}" for value in field.tolist()) for field in (best.radii, best.length)),
            " ".join(f"{value:.3g}" for value in best.max_pressure.tolist()),
        )
    return table
