"""`torcharm optimise`: every arm of a study made better on all its tasks together."""

import math
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from torcharm.cli import options, outputs
from torcharm.cli.tables import LONGEST_WORD, Column, print_table
from torcharm.cli.terminal import say, tell
from torcharm.cli.work import Told, Work, read_study
from torcharm.files import is_stream

if TYPE_CHECKING:
    from torcharm.design import OptimisedDesign, Progress
    from torcharm.study import NamedArm, Study

OPTIMISED = ", optimised"
"""What the names of the best arms, and of their study, end in."""
Found = Sequence[tuple["NamedArm", "OptimisedDesign"]]


def optimise(
    study: Annotated[Path, typer.Argument(help="A study, as TOML; its table [optimise] says what may change.")],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="Write the best arms: to a file .toml as a study on the same tasks, or to a file .csv or .json as a "
            "row for every arm and actuator, given and best.",
        ),
    ] = None,
    figure: Annotated[Path | None, options.figure("Draw errors and designs")] = None,
    checkpoint: Annotated[
        Path | None, typer.Option("--checkpoint", help="Keep finished starts in this file, and go on from it.")
    ] = None,
) -> None:
    """Find better radii, lengths and limits for every arm of a study, on all its tasks together.

    Ctrl-C ends the optimisation and shows what was found until then.
    """
    from torcharm.study import RESULT_FORMATS

    outputs.check(study, out, figure, (*RESULT_FORMATS, "toml"), checkpoint)
    plan = read_study(study)
    figures = outputs.numbered("--figure", figure, len(plan.arms))
    checkpoints = outputs.numbered("--checkpoint", checkpoint, len(plan.arms))
    work = Work()
    results = _optimise(plan, checkpoints, work)
    if results:
        _tell(results)
    outputs.save(_outputs(study, plan, results, out, figures))
    if results:
        say(_next_step(study, out))
    work.finish(results)


def _optimise(plan: "Study", checkpoints: Sequence[Path], work: Work) -> "list[tuple[NamedArm, OptimisedDesign]]":
    """What is found of the arms, in their order."""
    from torcharm.design import optimise_design

    how = plan.optimisation
    scale, unit = (1e3, "mm") if how.objective.unit == "m" else (1.0, how.objective.unit)
    further: dict[str, Any] = {"starts": how.starts, "seed": how.seed, "iterations": how.iterations}
    further["tolerance"] = plan.settings.tolerance

    def optimised(arm: "NamedArm", checkpoint: Path | None, told: Told) -> "Iterator[tuple[NamedArm, OptimisedDesign]]":
        def callback(done: "Progress") -> None:
            best = f"{scale * done.value:.4g} {unit}" if math.isfinite(done.value) else "-"
            told(done.start, f"{arm.name}, best {best}")

        tasks = [named.task for named in plan.tasks_of(arm)]
        own = {"checkpoint": checkpoint, "callback": callback}
        result = optimise_design(arm.design, tasks, how.space, how.objective, **further | own)
        yield arm, result
        if result.stopped == "interrupted":
            raise KeyboardInterrupt

    places: Sequence[Path | None] = checkpoints or [None] * len(plan.arms)
    with _warnings_in_a_line():
        return work.each("optimising", list(zip(plan.arms, places, strict=True)), optimised, how.starts)


def _tell(results: Found) -> None:
    from torcharm.arm_series import segments_of
    from torcharm.design.rest import rest_words
    from torcharm.design.space import LEAST_SPACING

    print_table(_errors(results))
    say()
    print_table(design_columns(results), lead=2)
    say()
    for line in _legend(results):
        say(line)
    space = results[0][1].space
    segments = [segment for _, result in results for segment in segments_of(result.best)[0]]
    if space.spacing is None and "radii" in space.free and any(segment.diameter is None for segment in segments):
        near = f"as close as {1e3 * LEAST_SPACING:g} mm, axis to axis"
        say(f"Actuators without a diameter may come {near}: give them one, or set optimise.spacing.")
    for arm, result in results:
        say(f"{arm.name}: {result.status}.")
        if result.violated and result.best is not result.given:
            say(f"{arm.name}: the given arm is outside these constraints: {'; '.join(result.violated)}.")
        if rest := rest_words(result.best):
            say(f"{arm.name}: the best arm: {rest}.")
        if result.active:
            say(f"{arm.name}: the best arm is held back by: {'; '.join(result.active)}.")


def _legend(results: Found) -> Iterator[str]:
    """What the table of errors shows, and what was made small, in a line each."""
    from torcharm.design.result import objective_words

    first = results[0][1]
    words = objective_words(first.objective)
    errors = first.objective.metric == "predicted_error"
    over = "largest" if first.objective.over == "worst" else "mean"
    shape = f"Shape: {over} predicted shape error. " if errors else ""
    yield f"{shape}Tip: mean predicted tip error. Held: by verdict. Out of range: strained beyond what was measured."
    if not errors:
        yield f"Minimised is the {words} [N]."
        return
    price = ", in which a task counts the more, up to its arm's length, the farther it strains beyond the range"
    yield f"Minimised is the {words}{price if first.space.in_range else ''}."
    if any(side.lost for _, result in results for side in (result.before, result.after)):
        yield "A task without a stable equilibrium counts as its arm's length there, and not in shape and tip."


def _next_step(study: Path, out: Path | None) -> str:
    """What a person may try now."""
    if out is not None and out.suffix.lower() == ".toml" and not is_stream(out):
        return f"Next: torcharm evaluate {out} says which loads the best arms hold, and why not the others."
    best = study.with_name("best.toml")
    return f"Next: torcharm optimise {study} --out {best} writes the best arms as a study to evaluate."


def _outputs(
    study: Path, plan: "Study", results: Found, out: Path | None, figures: Sequence[Path]
) -> Iterator[outputs.Output]:
    if out is not None and out.suffix.lower() == ".toml" and results:
        yield out, lambda path: path.write_text(_toml(study, out, plan, results), "utf-8", newline="\n"), "."
    elif results:
        yield from outputs.rows(out, list(best_rows(results)))
    for arm, result in results if figures else ():
        from torcharm.plot import optimisation_figure

        yield figures[plan.arms.index(arm)], optimisation_figure(result, arm.name).savefig, f" ({arm.name})."


@contextmanager
def _warnings_in_a_line() -> Iterator[None]:
    """Warnings as one line each on the standard error, as mistakes are told."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", RuntimeWarning)
        warnings.showwarning = lambda message, *_, **__: tell(str(message))
        yield


def _toml(study: Path, out: Path, plan: "Study", results: Found) -> str:
    """The best arms as a study: rounded as one builds, on the same tasks."""
    from torcharm.study import NamedArm, moved_files, study_to_toml

    ends = "" if all(arm.name.endswith(OPTIMISED) for arm, _ in results) else OPTIMISED
    arms = {
        arm.name: NamedArm(f"{arm.name}{ends}", result.buildable, moved_files(arm.files, study, out))
        for arm, result in results
    }
    name = plan.name if plan.name.endswith(OPTIMISED) else f"{plan.name}{OPTIMISED}"
    return study_to_toml(plan, name, arms, {arm.name: result.status for arm, result in results})


VALUES = (("radius", "mm", 0), ("angle", "deg", 1), ("length", "mm", 2), ("max_pressure", "kPa", 3))
"""Of an actuator's values the name, the unit, and the row of `given_values`."""


def best_rows(results: Found) -> Iterator[dict[str, Any]]:
    """A row for each arm and actuator, given and best; with angles, which the plane has none of, if one is in space."""
    from torcharm.actuators import model_name
    from torcharm.design.space import given_values
    from torcharm.study.results import DEG, MM

    in_space = any(result.best.dimension == 3 for _, result in results)
    shown, scales = [one for one in VALUES if in_space or one[0] != "angle"], {"mm": MM, "deg": DEG, "kPa": 1.0}
    for arm, result in results:
        pairs = zip(*(given_values(one)[0].T.tolist() for one in (result.given, result.best)), strict=True)
        for index, pair in enumerate(pairs):
            row = {"arm": arm.name, "actuator": index + 1, "model": model_name(result.best.actuators[index])}
            for prefix, own in zip(("given_", ""), pair, strict=True):
                for name, unit, place in shown:
                    none = name == "angle" and result.best.dimension == 2
                    row[f"{prefix}{name}_{unit}"] = None if none else scales[unit] * own[place]
            yield row


def _errors(results: Found) -> list[Column]:
    """A row for each arm: plain errors and counts of tasks, given and best."""
    from torcharm.inputs import three_digits

    columns = [Column("arm", [arm.name for arm, _ in results], LONGEST_WORD)]
    every, over = [result for _, result in results], results[0][1].objective.over

    def add(title: str, *pairs: tuple[object, object]) -> None:
        columns.append(Column(f"{title}\ngiven → best", [f"{given} → {best}" for given, best in pairs]))

    if results[0][1].objective.unit == "m":
        add(
            "shape [mm]",
            *((three_digits(r.before.shape_mm(over)), three_digits(r.after.shape_mm(over))) for r in every),
        )
    else:
        add("value [N]", *((f"{r.given_value:.4g}", f"{r.value:.4g}") for r in every))
    add("tip [mm]", *((three_digits(r.before.tip_mm), three_digits(r.after.tip_mm)) for r in every))
    add("held", *((r.given_held, f"{r.held} of {len(r.after.stable)}") for r in every))
    add("out of range", *((r.before.out_of_range, f"{r.after.out_of_range} of {len(r.after.stable)}") for r in every))
    return columns


def design_columns(results: Found) -> list[Column]:
    """A row for each actuator: what it was and is."""
    rows = list(best_rows(results))
    in_space = "angle_deg" in rows[0]
    names = [row["arm"] if row["actuator"] == 1 else "" for row in rows]
    models = [f"{row['actuator']} {row['model']}" for row in rows]
    columns = [Column("arm", names, 20), Column("actuator", models, 16)]
    gap, digits = ("\n", 0) if in_space else (" ", 1)  # so that four columns fit
    for name, unit, _ in VALUES:
        if (own := f"{name}_{unit}") in rows[0]:
            pairs = [[row[f"given_{own}"], row[own]] for row in rows]
            cells = ["-" if None in pair else " → ".join(f"{one:.{digits}f}" for one in pair) for pair in pairs]
            title = f"{name.replace('max_pressure', 'limit')}{gap}[{unit.replace('deg', '°')}]"
            columns.append(Column(title, cells))
    return columns
