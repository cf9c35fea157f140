"""`torcharm fit`: from test-bench recordings, or a data sheet's table, to a model file."""

import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
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
    from torcharm.characterise.delimited import Sheet
    from torcharm.characterise.recordings import PressureRecord, TesterRecord

OTHER_PRESSURE = 0.2
"""By which share the highest pressures of a run's two files may differ."""
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

    given = _Given(
        testers=instron or [],
        logs=pressure or [],
        table=table,
        offsets=offset or [],
        search=find_offset,
        columns=columns,
        log_columns=pressure_columns,
        gauge_length=gauge_length,
        positive=positive,
        unit=unit,
        truncated=truncated,
    )
    given.check(out)
    sheets = given.sheets()
    of_runs = {"--actuators": actuators, "--smoothing": smoothing, "--offset": offset, "--find-offset": find_offset}
    of_runs |= {"--max-gap": max_gap, "--truncated": truncated or None}
    _check_needed(of_runs if table else {}, "a --table")
    _check_needed({} if pressure else {"--pressure-columns": pressure_columns}, "no --pressure")
    without = model in ("mckibben", "gridded") and find_offset is None
    _check_needed({"--degree": degree} if without else {}, f"--model {model}")
    degree = 3 if degree is None else degree
    alignment = {"actuators": 1 if actuators is None else actuators, "smoothing": smoothing, "max_gap": max_gap}
    recording = given.recording(sheets, degree, alignment)
    recording = by_depth(recording) if vacuum else recording
    how = {"loss": loss, "monotonic": monotonic, "max_pressure": max_pressure, "bending_stiffness": bending}
    compared, found = _fitted(recording, model or ("best" if table else "polynomial"), degree, how)
    warn_of_doubts(found, recording, compared)
    report(found, recording, compared)
    outputs.save(_outputs(found, recording, out, figure))
    _paste(out)


def _check_needed(options: Mapping[str, object], where: str) -> None:
    """Raise a ValueError that names an option which is given and stands for nothing there."""
    for name, value in options.items():
        if value is not None:
            raise ValueError(f"{name}: must be left out with {where}, for which it means nothing, got {shown(value)}")


@dataclass(frozen=True)
class _Given:
    """Files of runs or a table, and what is said of their clocks and of their layout."""

    testers: Sequence[Path]
    logs: Sequence[Path]
    table: Path | None
    offsets: Sequence[float]
    search: float | None
    columns: str | None
    log_columns: str | None
    gauge_length: str | None
    positive: str | None
    unit: str | None
    truncated: bool

    def check(self, out: Path) -> None:
        """Raise a ValueError unless the options fit each other, and what is to be written costs no other file."""
        from torcharm.characterise.model_file import load_actuator

        if self.table is not None and (self.testers or self.logs):
            raise ValueError("--table: must stand without --instron and --pressure, got both")
        if self.table is None and not self.testers:
            raise ValueError("--instron: is missing, must name a tester's file; or --table a table of forces")
        if self.logs and len(self.testers) != len(self.logs):
            raise ValueError(
                f"--pressure: must be given once for each --instron, got {count(len(self.logs), 'log')} for "
                f"{count(len(self.testers), 'run')}"
            )
        for path in (*self.testers, *self.logs, self.table or out.parent):
            if path.resolve() == out.resolve():
                raise ValueError(f"--out: {out}: is one of the recordings, must be another file")
        if out.is_file() and out.stat().st_size:
            try:
                load_actuator(out)
            except ValueError:  # a study, say, is not to be lost
                raise ValueError(f"--out: {out}: is there and is no force model, must be another file") from None
        if self.search is not None and self.offsets:
            raise ValueError("--find-offset: must not stand beside --offset, got both")
        if len(self.offsets) > 1 and len(self.offsets) != len(self.testers):
            raise ValueError(
                f"--offset: must be given once, or once for each of {len(self.testers)} runs, got {len(self.offsets)}"
            )

    def sheets(self) -> "list[Sheet]":
        """All files as they are, the testers' before the logs': damage is told before all else."""
        from torcharm.characterise.delimited import check_damage, read_sheet

        found = [read_sheet(path) for path in (*self.testers, *self.logs, *([self.table] if self.table else []))]
        for sheet in found:
            check_damage(sheet, truncated=self.truncated)
        return found

    def recording(self, sheets: "Sequence[Sheet]", degree: int, options: dict[str, Any]) -> "Recording":
        """The samples of the table, or of all runs, pressures on the tester's clock."""
        from torcharm.characterise.alignment import align, pool
        from torcharm.characterise.force_table import read_table
        from torcharm.characterise.offset import estimate_offset
        from torcharm.units import LENGTH

        given = self.gauge_length
        length = None if given is None else numbers("--gauge-length", given, [LENGTH])[0]
        if self.table is not None:
            how: dict[str, Any] = {"columns": self.columns, "gauge_length": length}
            return read_table(self.table, self.unit, positive=self.positive, **how)
        runs, number = [], len(self.testers)
        logs: Sequence[Sheet | None] = sheets[number:] or [None] * number
        offsets = self.offsets if len(self.offsets) > 1 else [*self.offsets, None][:1] * number
        for sheet, log_sheet, shift in zip(sheets[:number], logs, offsets, strict=True):
            tester, log = self.run(sheet, log_sheet, length)
            if self.search is None:
                runs.append(align(tester, log, offset=shift, **options))
                continue
            search: dict[str, Any] = {"degree": degree, "search": 1e3 * self.search}
            search |= {} if options["smoothing"] is None else {"smoothing": options["smoothing"]}
            found = estimate_offset(tester, log, **search)
            run = align(tester, log, offset=found.offset, **options)
            runs.append(replace(run, settings=(*run.settings, ("certainty of the offset", found.words))))
        return pool(runs)

    def run(self, sheet: "Sheet", log: "Sheet | None", length: float | None) -> tuple["TesterRecord", "PressureRecord"]:
        """What the tester and the logger wrote."""
        from torcharm.characterise.columns import example, has_column
        from torcharm.characterise.recordings import as_pressure_record, as_tester_record

        tester = as_tester_record(sheet, self.columns, length, positive=self.positive, truncated=self.truncated)
        if log is not None:
            own = self.log(log)
            _compare_pressures(sheet, own)
        elif has_column(sheet, "pressure", self.columns):
            own = as_pressure_record(sheet, self.unit, self.columns, truncated=self.truncated, alone=False)
        else:
            raise ValueError(
                f"--pressure: is missing, as {sheet.source} names no column of pressure; must be its log, or --columns "
                f'names one, as in "{example(sheet, ("pressure",), self.columns)}"'
            )
        return tester, own

    def log(self, sheet: "Sheet") -> "PressureRecord":
        """What the logger wrote; errors about columns name its own option."""
        from torcharm.characterise.recordings import as_pressure_record

        option = "--pressure-columns"
        try:
            return as_pressure_record(sheet, self.unit, self.log_columns, truncated=self.truncated, option=option)
        except ValueError as error:
            raise ValueError(re.sub("^columns:", f"{option}:", str(error))) from None


def _compare_pressures(sheet: "Sheet", log: "PressureRecord") -> None:
    """Warn where the tester's file has pressures, too, whose highest is another than the log's."""
    from torcharm.characterise.recordings import as_pressure_record

    try:
        with warnings.catch_warnings(action="ignore"):  # what is doubtful about it does not count
            own = as_pressure_record(sheet, None, None, truncated=True, alone=False)
    except ValueError:  # it has none, or not as surely
        return
    highest, logged = float(own.pressure.max()), float(log.pressure.max())
    if abs(highest - logged) > OTHER_PRESSURE * max(highest, logged):
        warnings.warn(
            f"{sheet.source}: its own pressures reach {highest:.4g} kPa, those of {log.source} {logged:.4g} kPa, which "
            "are taken: are their units right, and are they of one run?",
            stacklevel=2,
        )


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
