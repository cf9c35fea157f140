"""`torcharm tolerance`: how far off the arms of a study will be once they are built, and what decides that."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from torcharm.cli.summaries import heading
from torcharm.cli.tables import LONGEST_WORD, Column, print_table
from torcharm.cli.terminal import (
    FIGURE_FORMATS,
    as_given,
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
    from torcharm.design.scatter import Scatter
    from torcharm.design.tolerance_result import BuiltArms
    from torcharm.study import NamedTask, Study
    from torcharm.study.built import BuiltStudy
    from torcharm.study.data import Manufacture


def tolerance(
    study: Annotated[
        Path | None,
        typer.Argument(help="A study, as TOML; its table [tolerance] says what is scattered, unless options do."),
    ] = None,
    radii: Annotated[str | None, typer.Option("--radii", help="Of offsets: '1 mm'.")] = None,
    length: Annotated[str | None, typer.Option("--length", help="Of neutral lengths: '2 mm'.")] = None,
    limits: Annotated[str | None, typer.Option("--limits", help="Of pressure limits: '1 kPa'.")] = None,
    force: Annotated[str | None, typer.Option("--force", help="Of the forces' scale: '5 %'.")] = None,
    force_offset: Annotated[str | None, typer.Option("--force-offset", help="Added to forces: '0.2 N'.")] = None,
    bending: Annotated[str | None, typer.Option("--bending", help="Of the bending moments' scale: '10 %'.")] = None,
    model_covariance: Annotated[
        bool, typer.Option("--model-covariance", help="Scatter fitted models by the covariance of their fit.")
    ] = False,
    uniform: Annotated[
        bool, typer.Option("--uniform", help="Values are half widths that nothing exceeds, not standard deviations.")
    ] = False,
    correlated: Annotated[
        list[str] | None,
        typer.Option(
            "--correlated",
            help="How alike actuators are scattered, 0 to 1, as 'force=1' of one pressure supply; may be repeated.",
        ),
    ] = None,
    compensated: Annotated[
        bool,
        typer.Option("--compensated", help="Find each built arm's own best pressures, not the drawn arm's."),
    ] = False,
    margin: Annotated[
        bool, typer.Option("--margin", help="Measure capacity margins, too, which takes longer than all else.")
    ] = False,
    sobol: Annotated[
        bool, typer.Option("--sobol", help="Find Sobol' indices of what is scattered, by several times the built arms.")
    ] = False,
    samples: Annotated[int | None, typer.Option("--samples", help="Built arms.", show_default="1000")] = None,
    seed: Annotated[int | None, typer.Option("--seed", help="Of the samples.", show_default="0")] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Write a row for every arm, task and load, to a file .csv or .json.")
    ] = None,
    figure: Annotated[
        Path | None,
        typer.Option("--figure", help=f"Draw percentiles and shares, to a file ending in {', '.join(FIGURE_FORMATS)}."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the rows of --out as JSON, and no tables.")] = False,
) -> None:
    """Predict the tip errors of built arms: percentiles, yields, and which tolerance decides them.

    Options of what is scattered replace the table [tolerance] of the study as a whole. Ctrl-C ends the work and shows
    what was found until then, of the arm at work from those built by then.
    """
    with mistakes():
        check_outputs(study, out, figure)
        from torcharm.inputs import check_count
        from torcharm.study import RESULT_FORMATS, example_study, load_study
        from torcharm.study.built import built_rows

        check_ending("--out", out, RESULT_FORMATS)
        plan = example_study() if study is None else load_study(study)
        sizes = {"radii": radii, "length": length, "limits": limits, "force": force}
        sizes |= {"force_offset": force_offset, "bending": bending}
        how = replace(plan.manufacture, scatter=_scatter(plan, sizes, correlated or [], model_covariance, uniform))
        how = replace(how, compensated=compensated or how.compensated)
        how = replace(how, samples=how.samples if samples is None else check_count("--samples", samples, 2))
        how = replace(how, seed=how.seed if seed is None else check_count("--seed", seed, 0))
        for path in numbered(figure, len(plan.tasks)):
            check_writable(path, "--figure")
        plan = plan if study is None else asked_about(plan)
        found: list[BuiltStudy] = []
        refused: dict[str, list[str]] = {}
        interrupted = find_built(plan, how, found, refused, margin, sobol)
        if found:
            if as_json:
                typer.echo(json.dumps(list(built_rows(found)), indent=1))
            else:
                _tell(plan, found)
            save_all(open_console(), _outputs(plan, found, out, figure))
        finish(interrupted, found, refused)


def _scatter(
    plan: "Study",
    sizes: Mapping[str, str | None],
    correlated: Sequence[str],
    model_covariance: bool,
    uniform: bool,
) -> "Scatter":
    """How arms are built: by options where there are any, else by the study."""
    from torcharm.design.scatter import Scatter

    given = {name: _size(name, text) for name, text in sizes.items() if text is not None}
    alike = dict(map(_correlation, correlated))
    if given or model_covariance:
        kind = "uniform" if uniform else "normal"
        return Scatter(**given, model_covariance=model_covariance, distribution=kind, correlated=alike)
    scatter = plan.manufacture.scatter
    if scatter is None:
        raise ValueError(
            "tolerance: must say what is scattered: by options such as --radii '1 mm' --force '5 %', "
            "or by a table [tolerance] of the study"
        )
    scatter = replace(scatter, distribution="uniform") if uniform else scatter
    return replace(scatter, correlated={**scatter.correlated, **alike})


def _size(name: str, text: str) -> float:
    """How far something is scattered, of an option's text."""
    from torcharm.design.scatter import UNITS, check_size
    from torcharm.study.units import numbers_in
    from torcharm.units import FORCE, LENGTH, PRESSURE, SHARE

    units = {"m": LENGTH, "kPa": PRESSURE, "1": SHARE, "N": FORCE}
    with as_given(f"--{name.replace('_', '-')}", text):
        (value,) = numbers_in(text, [units[UNITS[name]]])
        return check_size(name, value)


def _correlation(text: str) -> tuple[str, float]:
    """What is scattered alike, and how much, of a text such as `force=0.5`."""
    from torcharm.design.scatter import check_correlation
    from torcharm.study.units import numbers_in
    from torcharm.units import SHARE

    name, equals, number = text.partition("=")
    name = name.strip().replace("-", "_")
    with as_given("--correlated", text):
        if not equals:
            raise ValueError("must be a name and a number such as force=0.5, got none")
        (value,) = numbers_in(number, [SHARE])
        return name, check_correlation(name, value)


def find_built(
    plan: "Study",
    how: "Manufacture",
    found: list["BuiltStudy"],
    refused: dict[str, list[str]],
    margin: bool = False,
    sobol: bool = False,
) -> bool:
    """Append to `found` what is found, task by task, arms that are refused by why they are; whether Ctrl-C came."""
    from torcharm.design.tolerance import built_as
    from torcharm.study.built import BuiltStudy

    assert how.scatter is not None
    pairs = [(arm, task) for task in plan.tasks for arm in plan.arms_of(task)]
    with progress("building", len(pairs) * how.samples) as move:
        for index, (arm, task) in enumerate(pairs):
            before, name = index * how.samples, arm.name

            def told(done: int, of: int, before: int = before, name: str = name) -> None:
                move(to=before + done * how.samples // of, words=name)

            try:
                built = built_as(
                    arm.design,
                    task.task,
                    how.scatter,
                    how.compensated,
                    how.samples,
                    how.seed,
                    tolerance=plan.settings.tolerance,
                    margin=margin,
                    sobol=sobol,
                    callback=told,
                )
            except ValueError as error:  # costs this arm alone
                refused.setdefault(str(error), []).append(arm.name)
                continue
            except KeyboardInterrupt:  # before one arm was built
                return True
            found.append(BuiltStudy(arm, task, built))
            if built.stopped == "interrupted":
                return True
    return False


def _tell(plan: "Study", found: Sequence["BuiltStudy"]) -> None:
    from torcharm.study.built import sobol_words

    console = open_console()
    for task in plan.tasks:
        own = [one for one in found if one.task is task]
        if not own:
            continue
        console.print(heading(task, own[0].built.tip_error.shape[-1]))
        console.print()
        print_table(list(_columns(own)))
        for one in own:
            for words in filter(None, (one.built.interruption, one.built.agreement, sobol_words(one.built))):
                say(console, f"{one.arm.name}: {words}.")
        console.print()
    for line in _legend(plan, found[0].built):
        say(console, line)


def _columns(found: Sequence["BuiltStudy"]) -> Iterator[Column]:
    """A row for each arm."""
    from torcharm.study.built import built_columns

    yield Column("arm", [one.arm.name for one in found], LONGEST_WORD)
    for title, unit, cells in built_columns(found):
        if unit:
            yield Column(f"{title}\n[{unit}]", cells)
        else:
            yield Column(title, [cell.replace(", ", ",\n") for cell in cells], LONGEST_WORD, whole=True)


def _legend(plan: "Study", built: "BuiltArms") -> Iterator[str]:
    """What the columns mean, in a line each."""
    import math

    kept = "found anew for each built arm" if built.compensated else "the drawn arm's, kept"
    size = "half widths" if built.scatter.distribution == "uniform" else "standard deviations"
    yield f"{count(built.wanted, 'built arm')}; tolerances are {size}; pressures are {kept}."
    tip = plan.settings.tolerance.tip
    near = "2 % of the drawn arm's length" if tip is None else f"{1e3 * tip:g} mm"
    yield f"yield: tip and shape within {near}, turned within {math.degrees(built.tolerance.rotation):.3g}°;"
    yield "in brackets its bounds with 95 % confidence. drawn: where loading from rest leads, median over loads."
    yield "what fails: pairs of a built arm and a load, by the tip's place, its turn or the shape's mean distance; some"
    yield "fail by several. Neither range nor margin counts against the yield."
    if built.margin is not None:
        yield "margin: of capacity at the tightest node; 5 % of built arms and loads have less."
    yield "beyond range: strains or limits that were not characterised, where force models guess."
    yield "what scatters the tip: shares in its variance, by gradients at the drawn arm."


def _outputs(
    plan: "Study", found: Sequence["BuiltStudy"], out: Path | None, figure: Path | None
) -> Iterator[tuple[Path, Callable[[Path], object], str]]:
    from torcharm.study import check_format, write_rows
    from torcharm.study.built import built_rows

    if out is not None:
        rows, ending = list(built_rows(found)), f".{check_format(out)}"
        yield out, lambda path: write_rows(path, rows, ending), f" ({count(len(rows), 'row')})."
    for place, task in zip(numbered(figure, len(plan.tasks)), plan.tasks, strict=False):
        own = [one for one in found if one.task is task]
        if own:
            yield place, partial(_draw, task=task, found=own), f" ({task.name})."


def _draw(path: Path, task: "NamedTask", found: Sequence["BuiltStudy"]) -> None:
    from torcharm.plot import tolerance_figure

    tolerance_figure([(one.arm.name, one.built) for one in found], task.name).savefig(path, dpi=150)
