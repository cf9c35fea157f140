"""`torcharm tolerance`: how far off the arms of a study will be once they are built, and what decides that."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from torcharm.cli import options, outputs
from torcharm.cli.summaries import heading
from torcharm.cli.tables import LONGEST_WORD, Column, print_table
from torcharm.cli.terminal import as_given, count, open_console, say
from torcharm.cli.work import Told, Work, asked_about

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from torcharm.design.scatter import Scatter
    from torcharm.design.tolerance_result import BuiltArms
    from torcharm.study import NamedArm, NamedTask, Study
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
    samples: Annotated[int | None, typer.Option("--samples", help="Built arms.", show_default="1000")] = None,
    seed: Annotated[int | None, typer.Option("--seed", help="Of the samples.", show_default="0")] = None,
    out: options.Rows = None,
    figure: Annotated[Path | None, options.figure("Draw percentiles and shares")] = None,
    as_json: options.Json = False,
) -> None:
    """Predict the tip errors of built arms: percentiles, yields, and which tolerance decides them.

    Options of what is scattered replace the table [tolerance] of the study as a whole. Ctrl-C ends the work and shows
    what was found until then, of the arm at work from those built by then.
    """
    from torcharm.inputs import check_count
    from torcharm.study import RESULT_FORMATS, example_study, load_study
    from torcharm.study.built import built_rows

    outputs.check(study, out, figure, RESULT_FORMATS)
    plan = example_study() if study is None else load_study(study)
    sizes = {"radii": radii, "length": length, "limits": limits, "force": force}
    sizes |= {"force_offset": force_offset, "bending": bending}
    how = plan.manufacture
    how = replace(
        how,
        scatter=_scatter(how.scatter, sizes, correlated or [], model_covariance, uniform),
        compensated=compensated or how.compensated,
        samples=how.samples if samples is None else check_count("--samples", samples, 2),
        seed=how.seed if seed is None else check_count("--seed", seed, 0),
    )
    figures, work = outputs.numbered("--figure", figure, len(plan.tasks)), Work()
    plan = plan if study is None else asked_about(plan)
    found = find_built(plan, how, work, margin)
    if found:
        rows = list(built_rows(found))
        if as_json:
            typer.echo(json.dumps(rows, indent=1))
        else:
            _tell(plan, found)
        drawn = outputs.figures(figures, outputs.by_task(plan.tasks, found), _drawn)
        outputs.save([*outputs.rows(out, rows), *drawn])
    work.finish(found)


def _scatter(
    scatter: "Scatter | None",
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


def find_built(plan: "Study", how: "Manufacture", work: Work, margin: bool = False) -> "list[BuiltStudy]":
    """What is found of all arms on their tasks as they are built, or as many of them as there are by Ctrl-C."""
    from torcharm.design.tolerance import tolerance
    from torcharm.study.built import BuiltStudy

    assert how.scatter is not None
    further: dict[str, Any] = {"tolerance": plan.settings.tolerance, "margin": margin, "seed": how.seed}
    further |= vars(how.scatter) | {"compensated": how.compensated, "samples": how.samples}

    def built(arm: "NamedArm", task: "NamedTask", told: Told) -> Iterator[BuiltStudy]:
        def callback(done: int, of: int) -> None:
            told(done * how.samples // of, arm.name)

        found = tolerance(arm.design, task.task, callback=callback, **further)
        yield BuiltStudy(arm, task, found)
        if found.stopped == "interrupted":
            raise KeyboardInterrupt

    return work.each("building", plan.pairs, built, how.samples)


def _tell(plan: "Study", found: Sequence["BuiltStudy"]) -> None:
    for task, own in outputs.by_task(plan.tasks, found):
        if not own:
            continue
        open_console().print(heading(task, own[0].built.tip_error.shape[-1]))
        say()
        print_table(list(_columns(own)))
        for one in own:
            for words in filter(None, (one.built.interruption, one.built.agreement)):
                say(f"{one.arm.name}: {words}.")
        say()
    for line in _legend(plan, found[0].built):
        say(line)


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
    from torcharm.study.words import allowed

    kept = "found anew for each built arm" if built.compensated else "the drawn arm's, kept"
    size = "half widths" if built.scatter.distribution == "uniform" else "standard deviations"
    yield f"{count(built.wanted, 'built arm')}; tolerances are {size}; pressures are {kept}."
    length = "the drawn arm's length"
    yield f"yield: {allowed(plan.settings.tolerance, length)};"
    yield "in brackets its bounds with 95 % confidence. drawn: where loading from rest leads, median over loads."
    yield "what fails: pairs of a built arm and a load, by the tip's place, its turn or the shape's mean distance; some"
    yield "fail by several. Neither range nor margin counts against the yield."
    if built.margin is not None:
        yield "margin: of capacity at the tightest node; 5 % of built arms and loads have less."
    yield "beyond range: strains or limits that were not characterised, where force models guess."
    yield "what scatters the tip: shares in its variance, by gradients at the drawn arm."


def _drawn(task: "NamedTask", found: Sequence["BuiltStudy"]) -> "Figure":
    from torcharm.plot import tolerance_figure

    return tolerance_figure([(one.arm.name, one.built) for one in found], task.name)
