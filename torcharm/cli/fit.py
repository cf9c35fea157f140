"""`torcharm fit`: from test-bench recordings, or a data sheet's table, to a model file."""

import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from torcharm.cli import options, outputs
from torcharm.cli.fit_report import report
from torcharm.cli.terminal import count, numbers, say, tell
from torcharm.inputs import shown

if TYPE_CHECKING:
    from torcharm.actuators import Actuator
    from torcharm.characterise.alignment import Recording
    from torcharm.characterise.choice import Candidate
    from torcharm.characterise.recordings import PressureRecord, TesterRecord

KINDS = ("best", "polynomial", "mckibben", "gridded")


@contextmanager
def warnings_told() -> Iterator[None]:
    """What is doubtful but no mistake: a line each on the standard error."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always", UserWarning)
        yield
    for message in dict.fromkeys(" ".join(str(warning.message).split()) for warning in found):
        tell(f"warning: {message}")


@warnings_told()
def fit(
    out: Annotated[Path, typer.Option("--out", help="Write the force model, as TOML, for studies and ArmDesign.")],
    instron: Annotated[
        list[Path] | None, typer.Option("--instron", "--tester", help="A tensile tester's file; once for each run.")
    ] = None,
    pressure: Annotated[
        list[Path] | None,
        typer.Option(
            "--pressure",
            help="The pressure log of the same run; in order.",
            show_default="the tester's file holds it",
        ),
    ] = None,
    table: Annotated[
        Path | None,
        typer.Option("--table", help="A table of forces by strain or contraction and pressure, in place of runs."),
    ] = None,
    columns: Annotated[
        str | None,
        typer.Option(
            help="Columns by name or number, with units that the file lacks: "
            '"time=Time:s,extension=5:mm,force=Load"; also strain, contraction, length, pressure.',
            show_default="as the header names them",
        ),
    ] = None,
    pressure_columns: Annotated[
        str | None,
        typer.Option(help='The same of pressure logs: "time=1:s,pressure=3:kPa".', show_default="as the header does"),
    ] = None,
    gauge_length: Annotated[
        str | None,
        typer.Option(
            help='Of the actuators, where files hold lengths, or those of extension or contraction: "80 mm".',
            show_default="strains are read",
        ),
    ] = None,
    positive: Annotated[
        str | None,
        typer.Option(help="Whether positive forces pull or push.", show_default="what samples tell, or assumed"),
    ] = None,
    actuators: Annotated[
        int | None, typer.Option(help="How many actuators were pulled in parallel.", show_default="1")
    ] = None,
    unit: Annotated[
        str | None,
        typer.Option(
            help="Of pressures that the file names none for: psi, kPa, bar, MPa, Pa, mbar.",
            show_default="the file's; psi for logs of Time,Pressure",
        ),
    ] = None,
    vacuum: Annotated[
        bool, typer.Option("--vacuum", help="Take pressures below zero by their depth, which is positive.")
    ] = False,
    smoothing: Annotated[
        float | None,
        typer.Option(
            help="σ of the pressures' Gaussian smoothing, in ms; 0 for none.",
            show_default="440, the paper's, if forces fit better so",
        ),
    ] = None,
    offset: Annotated[
        list[float] | None,
        typer.Option(
            "--offset", help="Added to a log's clock, in ms; once for all runs or for each.", show_default="0"
        ),
    ] = None,
    find_offset: Annotated[
        float | None,
        typer.Option(
            "--find-offset",
            help="Take the offsets that fit best, of up to so many seconds; 10 where none is said.",
            show_default="0",
        ),
    ] = None,
    max_gap: Annotated[
        float | None,
        typer.Option(help="Drop samples in pauses of the log longer than this, in ms.", show_default="keep"),
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(
            help=f"{', '.join(KINDS)}: best predicts samples left out best.",
            show_default="polynomial; best for tables",
        ),
    ] = None,
    degree: Annotated[int | None, typer.Option(help="Of the polynomial.", show_default="3, the paper's")] = None,
    loss: Annotated[str, typer.Option(help="linear (least squares), or against outliers huber, soft_l1, cauchy.")] = (
        "linear"
    ),
    monotonic: Annotated[bool, typer.Option("--monotonic", help="Hold the force monotonic in pressure.")] = False,
    max_pressure: Annotated[
        float | None,
        typer.Option(help="Highest pressure in use, in kPa.", show_default="that to which the fit is monotonic"),
    ] = None,
    bending: Annotated[
        float | None,
        typer.Option(help="K [N·m²] at that pressure; no tensile test tells.", show_default="the paper's, assumed"),
    ] = None,
    truncated: Annotated[bool, typer.Option("--truncated", help="Accept recordings that end within a line.")] = False,
    figure: Annotated[Path | None, options.figure("Draw the fit")] = None,
) -> None:
    """Fit a force model to recordings of a tensile tester and a pressure log, or to a data sheet's table."""
    outputs.check(None, out, figure)
    from torcharm.characterise.alignment import by_depth
    from torcharm.characterise.doubts import warn_of_doubts

    testers, logs, offsets = instron or [], pressure or [], offset or []
    of_runs = {"--actuators": actuators, "--smoothing": smoothing, "--offset": offset, "--find-offset": find_offset}
    of_runs |= {"--max-gap": max_gap, "--truncated": truncated or None}
    _check_needed(of_runs if table else {}, "a --table")
    _check_needed({} if pressure else {"--pressure-columns": pressure_columns}, "no --pressure")
    without = model in ("mckibben", "gridded") and find_offset is None
    _check_needed({"--degree": degree} if without else {}, f"--model {model}")
    _check_files(testers, logs, table, out)
    _check_offsets(offsets, find_offset, len(testers))
    layout: dict[str, Any] = {"columns": columns, "positive": positive, "gauge_length": _length(gauge_length)}
    alignment = {"actuators": 1 if actuators is None else actuators, "smoothing": smoothing, "max_gap": max_gap}
    degree = 3 if degree is None else degree
    if table is not None:
        from torcharm.characterise.force_table import read_table

        found, recording = [], read_table(table, unit, **layout)
    else:
        layout |= {"truncated": truncated}
        of_logs = {"unit": unit, "columns": pressure_columns if logs else columns, "truncated": truncated}
        pairs = zip(testers, logs or testers, strict=True)
        found = [_records(*files, layout, of_logs) for files in pairs]
        recording = _aligned(found, offsets, find_offset, degree, alignment)
    recording = by_depth(recording) if vacuum else recording
    how = {"loss": loss, "monotonic": monotonic, "max_pressure": max_pressure, "bending_stiffness": bending}
    compared, fitted = _fitted(recording, model or ("best" if table else "polynomial"), degree, how)
    warn_of_doubts(fitted, recording, found)
    report(fitted, recording, compared)
    outputs.save(_outputs(fitted, recording, out, figure))
    _paste(out)


def _check_needed(options: Mapping[str, object], where: str) -> None:
    """Raise a ValueError that names an option which is given and stands for nothing there."""
    for name, value in options.items():
        if value is not None:
            raise ValueError(f"{name}: must be left out with {where}, for which it means nothing, got {shown(value)}")


def _check_files(testers: Sequence[Path], logs: Sequence[Path], table: Path | None, out: Path) -> None:
    """Raise a ValueError unless the files fit each other, and what is to be written costs no other file."""
    from torcharm.characterise.model_file import load_actuator

    if table is not None and (testers or logs):
        raise ValueError("--table: must stand without --instron and --pressure, got both")
    if table is None and not testers:
        raise ValueError("--instron: is missing, must name a tester's file; or --table a table of forces")
    if logs and len(testers) != len(logs):
        raise ValueError(
            f"--pressure: must be given once for each --instron, got {count(len(logs), 'log')} for "
            f"{count(len(testers), 'run')}"
        )
    if out.resolve() in [path.resolve() for path in (*testers, *logs, *([table] if table else []))]:
        raise ValueError(f"--out: {out}: is one of the recordings, must be another file")
    if out.is_file() and out.stat().st_size:
        try:
            load_actuator(out)
        except ValueError:  # a study, say, is not to be lost
            raise ValueError(f"--out: {out}: is there and is no force model, must be another file") from None


def _check_offsets(offsets: Sequence[float], search: float | None, runs: int) -> None:
    """Raise a ValueError unless offsets are given or looked for, and are as many as runs, or one for all."""
    if search is not None and offsets:
        raise ValueError("--find-offset: must not stand beside --offset, got both")
    if len(offsets) not in (0, 1, runs):
        raise ValueError(f"--offset: must be given once, or once for each of {runs} runs, got {len(offsets)}")


def _length(given: str | None) -> float | None:
    """The gauge length [m]."""
    from torcharm.units import LENGTH

    return None if given is None else numbers("--gauge-length", given, [LENGTH])[0]


def _records(
    tester: Path, log: Path, of_testers: dict[str, Any], of_logs: dict[str, Any]
) -> tuple["TesterRecord", "PressureRecord"]:
    """What the tester and the logger of a run wrote, or the tester both; errors about columns name the log's option."""
    from torcharm.characterise.recordings import read_pressure, read_tester

    record = read_tester(tester, **of_testers)
    try:
        return record, read_pressure(log, **of_logs)
    except ValueError as error:
        if log == tester:
            raise ValueError(f"{error}; or --pressure names its log") from None
        raise ValueError(re.sub("^columns(?=:)|--columns", "--pressure-columns", str(error))) from None


def _aligned(
    found: Sequence[tuple["TesterRecord", "PressureRecord"]],
    offsets: Sequence[float],
    search: float | None,
    degree: int,
    options: dict[str, Any],
) -> "Recording":
    """The samples of all runs, pressures on the testers' clocks, by offsets that are given or looked for."""
    from torcharm.characterise.alignment import align, pool
    from torcharm.characterise.offset import estimate_offset

    runs = []
    shifts = offsets if len(offsets) > 1 else [*offsets, None][:1] * len(found)
    for records, shift in zip(found, shifts, strict=True):
        if search is None:
            runs.append(align(*records, offset=shift, **options))
            continue
        smoothed = {} if options["smoothing"] is None else {"smoothing": options["smoothing"]}
        best = estimate_offset(*records, degree=degree, search=1e3 * search, **smoothed)
        run = align(*records, offset=best.offset, **options)
        runs.append(replace(run, settings=(*run.settings, ("certainty of the offset", best.words))))
    return pool(runs)


def _fitted(
    recording: "Recording", kind: str, degree: int, options: dict[str, Any]
) -> tuple[list["Candidate"], "Actuator"]:
    """The model of a kind, or of the best; and how all of them did, if they were compared."""
    from torcharm.characterise.choice import best_fit, fit_kind
    from torcharm.inputs import check_choice

    check_choice("model", kind, KINDS)
    try:
        if kind == "best":
            return best_fit(recording, degree, **options)
        return [], fit_kind(recording, kind, degree, **options)
    except ValueError as error:
        if str(error).startswith(("strain", "pressure", "force")):  # of the files' samples, and not of an option
            raise ValueError(f"{'; '.join(recording.sources)}: {error}") from None
        raise


def _outputs(model: "Actuator", recording: "Recording", out: Path, figure: Path | None) -> Iterator[outputs.Output]:
    from torcharm.characterise.model_file import save_actuator

    yield out, lambda path: save_actuator(path, model), "."
    if figure is not None:
        from torcharm.plot.characterisation import characterisation_figure

        yield figure, lambda path: characterisation_figure(model, recording).savefig(path), "."


def _paste(out: Path) -> None:
    """A line for a study, of which a path that is no whole one starts at the study's folder."""
    from torcharm.characterise.toml_text import toml_entry

    where = "" if out.is_absolute() else " in this folder"
    say(f"In a study{where}, for all actuators of an arm, or in a list with others:")
    say(toml_entry("actuators", {"kind": "file", "path": str(out)}))
