"""`torcharm optimise`: every arm of a study made better on all its tasks together."""

import math
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from torcharm.cli.tables import LONGEST_WORD, Column, print_table
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
    from torcharm.design import Objective, OptimisedDesign, Progress
    from torcharm.study import NamedArm, Study

Found = Sequence[tuple["NamedArm", "OptimisedDesign"]]


def optimise(
    study: Annotated[Path, typer.Argument(help="A study, as TOML; its table [optimise] says what may change.")],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="Write the best arms: to a file .toml as tables [[arm]] to paste into a study, or to a file .csv or "
            ".json as a row for every arm and actuator, given and best.",
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
        _check_checkpoint(study, out, figure, checkpoint)
        from torcharm.study import RESULT_FORMATS, load_study

        check_ending("--out", out, (*RESULT_FORMATS, "toml"))

        plan = asked_about(load_study(study))
        for option, path in (("--figure", figure), ("--checkpoint", checkpoint)):
            for one in numbered(path, len(plan.arms)):
                check_writable(one, option)
        results: list[tuple[NamedArm, OptimisedDesign]] = []
        refused: dict[str, list[str]] = {}
        try:
            _optimise(plan, numbered(checkpoint, len(plan.arms)), results, refused)
        except KeyboardInterrupt:  # what is finished is shown and written all the same
            interrupted = True
        else:
            interrupted = any(result.stopped == "interrupted" for _, result in results)
        if results:
            _tell(results)
        save_all(open_console(), _outputs(plan, results, out, numbered(figure, len(plan.arms))))
        finish(interrupted, results, refused)


def _optimise(
    plan: "Study",
    checkpoints: Sequence[Path],
    results: list[tuple["NamedArm", "OptimisedDesign"]],
    refused: dict[str, list[str]],
) -> None:
    """Append to `results` what is found of the arms, in their order; arms that are refused by why they are."""
    from torcharm.design import optimise_design

    how = plan.optimisation
    with progress("optimising", how.starts * len(plan.arms)) as move, _warnings_in_a_line():
        for index, arm in enumerate(plan.arms):
            options: dict[str, Any] = {"starts": how.starts, "seed": how.seed, "iterations": how.iterations}
            options["tolerance"] = plan.settings.tolerance
            options["checkpoint"] = checkpoints[index] if checkpoints else None
            options["callback"] = partial(_move, move, arm.name, index * how.starts, how.objective)
            try:
                tasks = [named.task for named in plan.tasks_of(arm)]
                result = optimise_design(arm.design, tasks, how.space, how.objective, **options)
            except ValueError as error:  # costs this arm alone
                refused.setdefault(str(error), []).append(arm.name)
                continue
            results.append((arm, result))
            if result.stopped == "interrupted":
                return
            move(to=(index + 1) * how.starts)


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
    from torcharm.design.space import LEAST_SPACING
    from torcharm.statics.balance import segments_of

    console = open_console()
    print_table(_errors(results))
    console.print()
    print_table(_designs(results), lead=2)
    console.print()
    first = results[0][1]
    words, tasks = objective_words(first.objective), count(len(first.after.stable), "task")
    unit = "mm" if first.objective.unit == "m" else "N"
    say(console, f"Value: {words} [{unit}], of {tasks}. Tip: mean predicted tip error [mm]. Held: by verdict.")
    if first.objective.metric == "predicted_error":
        if first.space.in_range and not all(bool(result.before.in_range.all()) for _, result in results):
            say(console, "In the value, errors beyond the characterised range count the more, the farther beyond it.")
        if not all(bool(side.stable.all()) for _, result in results for side in (result.before, result.after)):
            say(console, "A task without a stable equilibrium counts as its length in the value, and not in the tip's.")
        over = words.split()[0]
        say(console, f"Where a pressure search is named, its numbers are the {over} value that it reaches [mm].")
    space = first.space
    segments = [segment for _, result in results for segment in segments_of(result.best)[0]]
    if space.spacing is None and "radii" in space.free and any(segment.diameter is None for segment in segments):
        near = f"as close as {1e3 * LEAST_SPACING:g} mm, axis to axis"
        say(console, f"Actuators without a diameter may come {near}: give them one, or set optimise.spacing.")
    for arm, result in results:
        say(console, f"{arm.name}: {result.status}.")
        if result.violated and result.best is not result.given:
            say(console, f"{arm.name}: the given arm breaks: {'; '.join(result.violated)}.")
        if result.active:
            say(console, f"{arm.name}: the best arm is held back by: {'; '.join(result.active)}.")


def _outputs(
    plan: "Study", results: Found, out: Path | None, figures: Sequence[Path]
) -> Iterator[tuple[Path, Callable[[Path], object], str]]:
    if out is not None and results:
        from torcharm.study import check_format

        ending = ".toml" if out.suffix.lower() == ".toml" else f".{check_format(out)}"
        yield out, lambda path: _write(path, results, ending), "."
    places = dict(zip((arm.name for arm in plan.arms), figures, strict=False))
    for arm, result in results if figures else ():
        from torcharm.plot import optimisation_figure

        place = places[arm.name]
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
        from torcharm.study import write_rows

        write_rows(path, list(_rows(results)), ending)


def _toml(results: Found) -> str:
    from torcharm.study import arm_to_toml

    tables = ["# To append to a study.\n"]
    for arm, result in results:
        tables.append(f"# {result.status}\n" + arm_to_toml(result.best, f"{arm.name}, optimised", arm.files))
    return "\n".join(tables)


def _rows(results: Found) -> Iterator[dict[str, Any]]:
    """A row for each arm and actuator, given and best."""
    from torcharm.actuators import model_name

    fields = _fields(results)
    for arm, result in results:
        for index, (given, best) in enumerate(_values(result, results)):
            row = {"arm": arm.name, "actuator": index + 1, "model": model_name(result.best.actuators[index])}
            for prefix, values in (("given_", given), ("", best)):
                row |= {f"{prefix}{name}_{unit}": one for (name, unit, _), one in zip(fields, values, strict=True)}
            yield row


def _fields(results: Found) -> list[tuple[str, str, int]]:
    """Of each field that is told its name, its unit and its row of `given_values`; angles if an arm is in space."""
    fields = [("radius", "mm", 0), ("angle", "deg", 1), ("length", "mm", 2), ("max_pressure", "kPa", 3)]
    return fields if any(result.best.dimension == 3 for _, result in results) else [fields[0], *fields[2:]]


def _values(result: "OptimisedDesign", results: Found) -> Iterator[tuple[list[float | None], list[float | None]]]:
    """For each actuator the fields that are told, given and best; in the plane the angle is None."""
    from torcharm.design.space import given_values
    from torcharm.study.results import DEG, MM

    flat, scales = result.best.dimension == 2, {"mm": MM, "deg": DEG, "kPa": 1.0}
    rows = [(row, scales[unit]) for _, unit, row in _fields(results)]

    def told(values: list[float]) -> list[float | None]:
        return [None if flat and row == 1 else scale * values[row] for row, scale in rows]

    for given, best in zip(*(given_values(arm)[0].T.tolist() for arm in (result.given, result.best)), strict=True):
        yield told(given), told(best)


def _errors(results: Found) -> list[Column]:
    columns = [Column("arm", [arm.name for arm, _ in results], LONGEST_WORD)]
    for name in ("given", "best"):
        values = [
            (1e3 if result.objective.unit == "m" else 1.0) * (result.value if name == "best" else result.given_value)
            for _, result in results
        ]
        columns.append(Column(f"value\n{name}", [f"{value:.4g}" for value in values]))
    for name in ("given", "best"):
        sides = [result.after if name == "best" else result.before for _, result in results]
        columns.append(Column(f"tip\n{name}", [f"{side.tip_mm:.4g}" for side in sides]))
    for name in ("given", "best"):
        held = [result.held if name == "best" else result.given_held for _, result in results]
        tasks = [len(result.after.stable) for _, result in results]
        columns.append(Column(f"held\n{name}", [f"{one}/{every}" for one, every in zip(held, tasks, strict=True)]))
    return columns


def _designs(results: Found) -> list[Column]:
    """A row for each actuator: what it was and is."""
    from torcharm.actuators import model_name

    fields = _fields(results)
    in_space = len(fields) > 3
    rows = []
    for arm, result in results:
        for index, pair in enumerate(_values(result, results)):
            cells = []
            for old, new in zip(*pair, strict=True):
                ends = [f"{one:.{1 - in_space}f}" for one in (old, new) if one is not None]
                cells.append(" → ".join(ends) or "-")
            model = model_name(result.best.actuators[index])
            rows.append(("" if index else arm.name, f"{index + 1} {model}", *cells))
    names, models, *numbers = zip(*rows, strict=True)
    gap = "\n" if in_space else " "  # so that four columns fit
    titles = [f"{name.replace('max_pressure', 'limit')}{gap}[{unit.replace('deg', '°')}]" for name, unit, _ in fields]
    return [Column("arm", names, 20), Column("actuator", models, 16), *map(Column, titles, numbers)]
