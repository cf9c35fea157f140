"""`torcharm fit`: from test-bench recordings to a model file."""

import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from torcharm.cli.tables import Column, print_table
from torcharm.cli.terminal import FIGURE_FORMATS, check_outputs, count, mistakes, open_console, save_all, say

if TYPE_CHECKING:
    from rich.console import Console

    from torcharm.characterise.alignment import Recording
    from torcharm.characterise.fit import FittedActuator


def fit(
    instron: Annotated[list[Path], typer.Option("--instron", help="A tensile tester's CSV; once for each run.")],
    pressure: Annotated[list[Path], typer.Option("--pressure", help="The pressure log of the same run; in order.")],
    out: Annotated[Path, typer.Option("--out", help="Write the force model, as TOML, for studies and ArmDesign.")],
    actuators: Annotated[int, typer.Option(help="How many actuators were pulled in parallel.")] = 1,
    unit: Annotated[
        str | None,
        typer.Option(
            help="Of logs whose header names none: psi, kPa, bar, MPa, Pa, mbar.", show_default="the header's, or psi"
        ),
    ] = None,
    smoothing: Annotated[float, typer.Option(help="σ of the log's Gaussian smoothing, in samples; 0 for none.")] = 40.0,
    offset: Annotated[
        list[float] | None,
        typer.Option(
            "--offset", help="Added to a log's clock, in ms; once for all runs or for each.", show_default="0"
        ),
    ] = None,
    find_offset: Annotated[bool, typer.Option("--find-offset", help="Take the offsets that fit best.")] = False,
    max_gap: Annotated[
        float | None,
        typer.Option(help="Drop samples in pauses of the log longer than this, in ms.", show_default="keep"),
    ] = None,
    degree: Annotated[int, typer.Option(help="Of the polynomial; the paper's is 3.")] = 3,
    loss: Annotated[str, typer.Option(help="linear (least squares), or against outliers huber, soft_l1, cauchy.")] = (
        "linear"
    ),
    monotonic: Annotated[bool, typer.Option("--monotonic", help="Hold the force monotonic in pressure.")] = False,
    max_pressure: Annotated[
        float | None,
        typer.Option(help="Highest pressure in use, in kPa.", show_default="that to which the fit is monotonic"),
    ] = None,
    bending_stiffness: Annotated[
        float | None, typer.Option(help="K [N·m²] at that pressure; no tensile test tells.", show_default="the paper's")
    ] = None,
    truncated: Annotated[bool, typer.Option("--truncated", help="Accept recordings that are cut short.")] = False,
    figure: Annotated[
        Path | None, typer.Option("--figure", help=f"Draw the fit, to a file ending in {', '.join(FIGURE_FORMATS)}.")
    ] = None,
) -> None:
    """Fit a force model to recordings of a tensile tester and a pressure log, and say how good it is."""
    with mistakes(), _warnings_on_stderr():
        check_outputs(None, out, figure)
        offsets = _check_runs(instron, pressure, out, offset, find_offset)
        from torcharm.characterise.alignment import align, estimate_offset, pool
        from torcharm.characterise.fit import fit_recording
        from torcharm.characterise.recordings import read_pressure, read_tester

        runs = []
        for csv, log, shift in zip(instron, pressure, offsets, strict=True):
            tester = read_tester(csv, truncated=truncated)
            logged = read_pressure(log, unit, truncated=truncated)
            if find_offset:
                shift = estimate_offset(tester, logged, degree=degree, smoothing=smoothing)
            options: dict[str, Any] = {"actuators": actuators, "smoothing": smoothing, "max_gap": max_gap}
            runs.append(align(tester, logged, offset=shift, **options))
        recording = pool(runs)
        options = {"loss": loss, "monotonic": monotonic, "max_pressure": max_pressure}
        if bending_stiffness is not None:
            options["bending_stiffness"] = bending_stiffness
        model = fit_recording(recording, degree, **options)
        console = open_console()
        _report(console, model, recording)
        save_all(console, _outputs(model, recording, out, figure))


def _outputs(
    model: "FittedActuator", recording: "Recording", out: Path, figure: Path | None
) -> Iterator[tuple[Path, Callable[[Path], object], str]]:
    from torcharm.characterise.model_file import save_actuator
    from torcharm.characterise.toml_text import toml_value

    study = f". In a study: actuators = [{toml_value({'kind': 'file', 'path': str(out)})}, ...]"
    yield out, lambda path: save_actuator(path, model), study
    if figure is not None:
        from torcharm.plot.characterisation import characterisation_figure

        yield figure, lambda path: characterisation_figure(model, recording).savefig(path), "."


def _check_runs(
    instron: Sequence[Path], pressure: Sequence[Path], out: Path, offset: Sequence[float] | None, find_offset: bool
) -> list[float]:
    """An offset for each run [ms], once options are known to fit each other."""
    if len(instron) != len(pressure):
        raise ValueError(
            f"--pressure: must be given once for each --instron, got {count(len(pressure), 'log')} for "
            f"{count(len(instron), 'run')}"
        )
    for path in (*instron, *pressure):
        if path.resolve() == out.resolve():
            raise ValueError(f"--out: {out}: is one of the recordings, must be another file")
    given = list(offset or [0.0])
    if find_offset and offset:
        raise ValueError("--find-offset: must not stand beside --offset, got both")
    if len(given) not in (1, len(instron)):
        raise ValueError(f"--offset: must be given once, or once for each of {len(instron)} runs, got {len(given)}")
    return given * len(instron) if len(given) == 1 else given


@contextmanager
def _warnings_on_stderr() -> Iterator[None]:
    """What is doubtful but no mistake: a line each on the standard error."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always", UserWarning)
        yield
    for warning in found:
        print("torcharm: warning:", " ".join(str(warning.message).split()), file=sys.stderr)


def _report(console: "Console", model: "FittedActuator", recording: "Recording") -> None:
    quality = model.quality
    assert quality is not None
    print_table(_coefficients(model))
    console.print()
    lines = [f"R² {quality.r_squared:.5f}, RMSE {quality.rmse:.3g} N, {count(quality.samples, 'sample')}"]
    lines += [
        f"Run {held.run + 1} from the others: R² {held.r_squared:.5f}, RMSE {held.rmse:.3g} N"
        for held in quality.hold_out
    ]
    (low, high), (first, last) = model.strain_range, model.pressure_range
    lines.append(
        f"Characterised for strains from {low:.3f} to {high:.3f}, pressures from {first:.3g} to {last:.3g} kPa"
    )
    shape = quality.monotonicity
    if shape.failing_strain is None:
        lines.append("Monotonic in pressure all over that range")
    else:
        where = "at strains from {:.3f} to {:.3f}".format(*shape.failing_strain)
        lines.append(f"Monotonic in pressure up to {shape.up_to:.1f} kPa; beyond, not everywhere {where}")
    lines.append(f"Highest pressure in use: {model.max_pressure:.1f} kPa")
    lines += [f"O{name[1:]}: {value:.1f}" for name, value in recording.settings if name.startswith("offset")]
    for line in lines:
        say(console, line)


def _coefficients(model: "FittedActuator") -> list[Column]:
    assert model.quality is not None
    terms, values, errors = [], [], [f"{error:.2g}" for error in model.quality.standard_errors]
    for i, j, value in model.coefficients:
        powers = (("ε", i), ("p", j))
        terms.append(" ".join(f"{name}{'' if power == 1 else f'^{power}'}" for name, power in powers if power))
        values.append(f"{value:.5g}")
    return [Column("term", terms, 24), Column("coefficient", values), Column("standard error", errors)]
