"""`torcharm optimise`: every arm of a study made better on all its tasks together."""

import csv
import math
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from torcharm.cli.terminal import (
    FIGURE_FORMATS,
    check_ending,
    check_outputs,
    count,
    mistakes,
    numbered,
    open_console,
    progress,
    save_all,
    say,
)
from torcharm.files import check_writable, plain_cell

if TYPE_CHECKING:
    from rich.table import Table

    from torcharm.design import Objective, OptimisedDesign, Progress
    from torcharm.study import NamedArm, Study

Found = Sequence[tuple["NamedArm", "OptimisedDesign"]]


def optimise(
    study: Annotated[Path, typer.Argument(help="A study, as TOML; its table [optimise] says what may change.")],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="Write the best arms: to a file .toml as tables [[arm]] to paste into a study, or to a file .csv as "
            "a row for every arm and actuator, given and best.",
        ),
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
        check_ending("--out", out, ("csv", "toml"))
        _check_checkpoint(study, out, figure, checkpoint)
        from torcharm.study import load_study

        plan = load_study(study)
        for option, path in (("--figure", figure), ("--checkpoint", checkpoint)):
            for one in numbered(path, len(plan.arms)):
                check_writable(one, option)
        results, interrupted = _optimise(plan, numbered(checkpoint, len(plan.arms)))
        if results:
            _tell(results)
        save_all(open_console(), _outputs(results, out, numbered(figure, len(plan.arms))))
        if interrupted:
            raise KeyboardInterrupt


def _optimise(plan: "Study", checkpoints: Sequence[Path]) -> "tuple[Found, bool]":
    """The arms in their order, up to the one at which Ctrl-C came, and whether it did."""
    from torcharm.design import optimise_design

    how = plan.optimisation
    results: list[tuple[NamedArm, OptimisedDesign]] = []
    with progress("optimising", how.starts * len(plan.arms)) as move, _warnings_in_a_line():
        for index, arm in enumerate(plan.arms):
            options: dict[str, Any] = {"starts": how.starts, "seed": how.seed, "iterations": how.iterations}
            options["checkpoint"] = checkpoints[index] if checkpoints else None
            options["callback"] = partial(_move, move, arm.name, index * how.starts, how.objective)
            try:
                tasks = [named.task for named in plan.tasks_of(arm)]
                result = optimise_design(arm.design, tasks, how.space, how.objective, **options)
            except KeyboardInterrupt:  # before or after its descents
                return results, True
            results.append((arm, result))
            if result.stopped == "interrupted":
                return results, True
            move(to=(index + 1) * how.starts)
    return results, False


def _move(move: Callable[..., None], name: str, before: int, objective: "Objective", done: "Progress") -> None:
    """Move the bar on to the starts that have ended, with the best value until then."""
    scale, unit = (1e3, "mm") if objective.unit == "m" else (1.0, objective.unit)
    best = f"{scale * done.value:.4g} {unit}" if math.isfinite(done.value) else "-"
    move(to=before + done.start, words=f"{name}, best {best}")


def _check_checkpoint(study: Path, out: Path | None, figure: Path | None, checkpoint: Path | None) -> None:
    for what, other in (("the study itself", study), ("the file of --out", out), ("the file of --figure", figure)):
        if checkpoint is not None and other is not None and checkpoint.resolve() == other.resolve():
            raise ValueError(f"--checkpoint: {checkpoint}: is {what}, must be another file")


def _tell(results: Found) -> None:
    from torcharm.design.result import objective_words

    console = open_console()
    console.print(_errors_table(results))
    console.print()
    console.print(_designs_table(results))
    console.print()
    first = results[0][1]
    words, tasks = objective_words(first.objective), count(len(first.after.stable), "task")
    unit = "mm" if first.objective.unit == "m" else "N"
    say(console, f"Value: {words} [{unit}], of {tasks}. Tip: mean predicted error [mm].")
    for arm, result in results:
        say(console, f"{arm.name}: {result.status}.")
        if result.violated and result.best is not result.given:
            say(console, f"{arm.name}: the given arm breaks: {'; '.join(result.violated)}.")
        if result.active:
            say(console, f"{arm.name}: the best arm is held back by: {'; '.join(result.active)}.")


def _outputs(
    results: Found, out: Path | None, figures: Sequence[Path]
) -> Iterator[tuple[Path, Callable[[Path], object], str]]:
    if out is not None and results:
        yield out, lambda path: _write(path, results, out.suffix.lower()), "."
    for place, (arm, result) in zip(figures, results, strict=False):
        from torcharm.plot import optimisation_figure

        yield place, optimisation_figure(result, arm.name).savefig, f" ({arm.name})."


@contextmanager
def _warnings_in_a_line() -> Iterator[None]:
    """Warnings as one line each on the standard error, as mistakes are told."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", RuntimeWarning)
        warnings.showwarning = lambda message, *_, **__: print("torcharm:", message, file=sys.stderr)
        yield


def _write(path: Path, results: Found, ending: str) -> None:
    if ending == ".toml":
        path.write_text(_toml(results), encoding="utf-8", newline="\n")
    else:
        _write_rows(path, results)


def _toml(results: Found) -> str:
    from torcharm.study import arm_to_toml

    tables = ["# To append to a study.\n"]
    for arm, result in results:
        tables.append(f"# {result.status}\n" + arm_to_toml(result.best, f"{arm.name}, optimised", arm.files))
    return "\n".join(tables)


def _write_rows(path: Path, results: Found) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        columns = [f"{name}_{unit}" for name, unit, _ in _fields(results)]
        writer.writerow(("arm", "actuator", "model", *(f"given_{name}" for name in columns), *columns))
        for arm, result in results:
            for index, (given, best) in enumerate(_values(result, results)):
                model = type(result.best.actuators[index]).__name__
                writer.writerow((plain_cell(arm.name), index + 1, plain_cell(model), *given, *best))


def _fields(results: Found) -> list[tuple[str, str, int]]:
    """Of each field that is told its name, its unit and its row of `given_values`; angles are of arms in space."""
    fields = [("radius", "m", 0), ("angle", "rad", 1), ("length", "m", 2), ("max_pressure", "kPa", 3)]
    return fields if results[0][1].best.dimension == 3 else [fields[0], *fields[2:]]


def _values(result: "OptimisedDesign", results: Found) -> Iterator[tuple[list[float], list[float]]]:
    """For each actuator the fields that are told, given and best."""
    from torcharm.design.space import given_values

    rows = [row for *_, row in _fields(results)]
    given, best = (given_values(arm)[0][rows].T.tolist() for arm in (result.given, result.best))
    return zip(given, best, strict=True)


def _errors_table(results: Found) -> "Table":
    from rich.text import Text

    table = _new_table("arm")
    for name in ("value\ngiven", "value\nbest", "tip\ngiven", "tip\nbest"):
        table.add_column(name, justify="right", no_wrap=True)
    for arm, result in results:
        scale = 1e3 if result.objective.unit == "m" else 1.0
        table.add_row(
            Text(arm.name),
            *(f"{scale * value:.4g}" for value in (result.given_value, result.value)),
            *(f"{side.tip_mm:.4g}" for side in (result.before, result.after)),
        )
    return table


def _designs_table(results: Found) -> "Table":
    """A row for each actuator: what it was and is."""
    from rich.text import Text

    shown = {"m": (1e3, "mm"), "rad": (180 / math.pi, "°"), "kPa": (1.0, "kPa")}
    table, fields = _new_table("arm"), _fields(results)
    table.add_column("actuator", overflow="fold", max_width=16)
    in_space = len(fields) > 3
    for name, unit, _ in fields:
        heading = name.replace("max_pressure", "limit")
        gap = "\n" if in_space else " "  # so that four columns fit
        table.add_column(f"{heading}{gap}[{shown[unit][1]}]", justify="right", no_wrap=True)
    for arm, result in results:
        for index, pair in enumerate(_values(result, results)):
            cells = []
            for old, new, (_, unit, _) in zip(*pair, fields, strict=True):
                scale = shown[unit][0]
                cells.append(f"{scale * old:.{1 - in_space}f} → {scale * new:.{1 - in_space}f}")
            model = f"{index + 1} {type(result.best.actuators[index]).__name__}"
            table.add_row(Text("" if index else arm.name), Text(model), *cells)
    return table


def _new_table(first: str) -> "Table":
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False)
    table.add_column(first, overflow="fold", max_width=20)
    return table
