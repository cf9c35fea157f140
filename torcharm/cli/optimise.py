"""`torcharm optimise`: every arm of a study made better on all its tasks together."""

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
from torcharm.files import check_writable

PLAIN = ("converged", "confirmed by a pressure search")
"""States of a result that need no word."""

if TYPE_CHECKING:
    from rich.table import Table

    from torcharm.optimise import OptimisedDesign


def optimise(
    study: Annotated[Path, typer.Argument(help="A study, as TOML; its table [optimise] says what may change.")],
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Save the results, to a file ending in .npz; numbered for several arms."),
    ] = None,
    figure: Annotated[
        Path | None,
        typer.Option("--figure", help=f"Draw designs and history, to a file ending in {', '.join(FIGURE_FORMATS)}."),
    ] = None,
    checkpoint: Annotated[
        Path | None, typer.Option("--checkpoint", help="Keep what is done in this file, and go on from it.")
    ] = None,
) -> None:
    """Find better radii, lengths and limits for every arm of a study, on all its tasks together.

    Ctrl-C ends the search and shows what was found until then.
    """
    with mistakes():
        check_outputs(study, out, figure)
        _check_checkpoint(study, out, figure, checkpoint)
        if out is not None and out.suffix != ".npz":
            raise ValueError(f"--out: {out}: must end in .npz")
        from torcharm.optimise import optimise_design
        from torcharm.study import load_study

        plan = load_study(study)
        how = plan.optimisation
        tasks = [named.task for named in plan.tasks]
        console = open_console()
        total = len(plan.arms)
        for option, path in (("--out", out), ("--figure", figure), ("--checkpoint", checkpoint)):
            for index in range(total):
                place = _numbered(path, index, total)
                if place is not None:
                    check_writable(place, option)
        results: list[tuple[str, OptimisedDesign]] = []
        failed = []
        for index, arm in enumerate(plan.arms):
            with _warnings_in_a_line():
                result = optimise_design(
                    arm.design,
                    tasks,
                    how.space,
                    how.objective,
                    method=how.method,
                    starts=how.starts,
                    seed=how.seed,
                    iterations=how.iterations,
                    checkpoint=_numbered(checkpoint, index, total),
                    progress=True,
                )
            results.append((arm.name, result))
            try:
                save_all(
                    console, _outputs(arm.name, result, *(_numbered(path, index, total) for path in (out, figure)))
                )
            except ValueError as error:  # the results are shown all the same
                failed.append(str(error))
            if result.stopped == "interrupted":
                break
        console.print(_table(results))
        console.print()
        loads = count(len(results[0][1].after["absolute"]), "task")
        say(console, f"Value: {_value_words(results[0][1])}, of {loads}. Designs are in m and kPa.")
        for name, result in results:
            if result.status not in PLAIN:
                say(console, f"{name}: {result.status}.")
        if failed:
            raise ValueError("; ".join(failed))
        if results[-1][1].stopped == "interrupted":
            fail("interrupted", INTERRUPTED)


def _check_checkpoint(study: Path, out: Path | None, figure: Path | None, checkpoint: Path | None) -> None:
    for what, other in (("the study itself", study), ("the file of --out", out), ("the file of --figure", figure)):
        if checkpoint is not None and other is not None and checkpoint.resolve() == other.resolve():
            raise ValueError(f"--checkpoint: {checkpoint}: is {what}, must be another file")


def _outputs(
    name: str, result: "OptimisedDesign", out: Path | None, figure: Path | None
) -> Iterator[tuple[Path, Callable[[Path], object], str]]:
    if out is not None:
        yield out, result.save, f" ({name})."
    if figure is not None:
        from torcharm.optimise.figure import optimisation_figure

        yield figure, lambda path: optimisation_figure(result, name).savefig(path), f" ({name})."


@contextmanager
def _warnings_in_a_line() -> Iterator[None]:
    """Warnings of a search as one line each on the standard error, as mistakes are told."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", RuntimeWarning)
        warnings.showwarning = lambda message, *_, **__: print("torcharm:", message, file=sys.stderr)
        yield


def _numbered(path: Path | None, index: int, total: int) -> Path | None:
    if path is None or total == 1:
        return path
    return path.with_stem(f"{path.stem}-{index + 1}")


def _value_words(result: "OptimisedDesign") -> str:
    objective = result.objective
    over = {"mean": "mean", "worst": "largest", "cvar": f"mean of the worst {objective.tail:.0%}", "count": "count"}
    if objective.metric == "predicted_error":
        return f"{over[objective.over]} predicted shape error [m]"
    relative = f" + {objective.relative_weight:g} relative" if objective.relative_weight else ""
    return f"{over[objective.over]} absolute{relative} unattainability"


def _table(results: Sequence[tuple[str, "OptimisedDesign"]]) -> "Table":
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False)
    table.add_column("arm", overflow="fold")
    for name in ("value\ngiven", "value\nbest"):
        table.add_column(name, justify="right")
    for name in ("radii", "lengths", "limits", "strain\nin range", "ended"):
        table.add_column(name, overflow="fold")
    for name, result in results:
        best = result.best
        columns = [" ".join(f"{value:.4g}" for value in field.tolist()) for field in (best.radii, best.length)]
        limits = " ".join(f"{value:.3g}" for value in best.max_pressure.tolist())
        ended = result.reasons[int(result.end_values.argmin())]
        table.add_row(
            Text(name),
            f"{result.given_value:.5g}",
            f"{result.value:.5g}",
            *columns,
            limits,
            "yes" if result.in_range else "no",
            ended,
        )
    return table
