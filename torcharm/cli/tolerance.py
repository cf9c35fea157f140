"""`torcharm tolerance`: how far off the arms of a study will be once they are built, and what decides that."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from torcharm.cli import options, outputs
from torcharm.cli.summaries import heading
from torcharm.cli.tables import LONGEST_WORD, Column, print_table
from torcharm.cli.terminal import bare, count, open_console, say
from torcharm.cli.work import Told, Work, asked_about

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
    from torcharm.study import RESULT_FORMATS, example_study, load_study
    from torcharm.study.built import built_rows

    outputs.check(study, out, figure, RESULT_FORMATS)
    plan = example_study() if study is None else load_study(study)
    given: dict[str, Any] = {
        "radii": radii,
        "length": length,
        "limits": limits,
        "force": force,
        "force_offset": force_offset,
        "bending": bending,
        "model_covariance": model_covariance or None,
        "distribution": "uniform" if uniform else None,
        "compensated": compensated or None,
        "samples": samples,
        "seed": seed,
    }
    how = _manufacture(plan, {key: value for key, value in given.items() if value is not None}, correlated or [])
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


KEPT = {"compensated", "samples", "seed"}
"""Keys of a study's table [tolerance] that hold beside options of what is scattered."""


def _manufacture(plan: "Study", given: dict[str, Any], correlated: Sequence[str]) -> "Manufacture":
    """How arms are built, by the study's table [tolerance] and by options, which have the same keys."""
    from torcharm.study.fields import validated
    from torcharm.study.tables import ToleranceTable

    table = dict(plan.tables.get("tolerance", {}))
    if given.keys() - KEPT - {"distribution"}:
        table = {key: table[key] for key in KEPT & table.keys()}
    table |= {key: bare(value) if isinstance(value, str) else value for key, value in given.items()}
    for text in correlated:
        if "=" not in text:
            raise ValueError(f"--correlated: must be what is scattered and a number, such as force=1, got {text}")
    alike = (text.partition("=") for text in correlated)
    own = {name.strip().replace("-", "_"): bare(number) for name, _, number in alike}
    table["correlated"] = {**table.get("correlated", {}), **own}
    try:
        how: Manufacture = validated(ToleranceTable, table).build()
    except ValueError as error:
        field, words = str(error).split(":", 1)
        raise ValueError(f"--{field.replace('_', '-').replace('.', ' ')}:{words}") from None
    if how.scatter is None:
        raise ValueError(
            "tolerance: must say what is scattered: by options such as --radii '1 mm' --force '5 %', "
            "or by a table [tolerance] of the study"
        )
    return how


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
