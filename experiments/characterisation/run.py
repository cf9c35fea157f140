"""Characterise a bellows: on synthetic recordings whose truth is known, and on the paper's where they are.

Prints tables. With the paper's recordings, in the folder bellows_characterisation of $TORCHARM_DATA, it also writes
results.csv, held_strains.png, fit.png and sensitivity.png beside this file.
"""

import argparse
import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.console import Console
from rich.progress import track

import torcharm as ta
from experiments.characterisation import figure
from experiments.characterisation.sensitivity import MILD, SHAPE, drawn_deviation, uncertain_validation, validation
from experiments.characterisation.synthetic import TRUTH, Noise, read_runs, write_run
from experiments.rows import Measurement, measurements_table, write_rows
from torcharm.characterise.least_squares import exponents

HERE = Path(__file__).parent
LIMIT = 50.0
"""The paper's pressure limit [kPa], at which its K holds."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke run: few repetitions, no file written")
    quick = parser.parse_args().quick
    torch.set_num_threads(1)
    console = Console()
    rows: list[Measurement] = []
    parts = [synthetic(quick), speed(quick)]
    folder = Path(os.environ["TORCHARM_DATA"]) / "bellows_characterisation" if "TORCHARM_DATA" in os.environ else None
    if folder is not None and folder.is_dir():
        parts.append(real(folder, quick))
    else:
        console.print("TORCHARM_DATA names no folder with bellows_characterisation: synthetic recordings only.")
    for part in parts:
        for found in part:
            console.print(measurements_table(found))
            rows += found
    if not quick and len(parts) > 2:
        write_rows(HERE / "results.csv", rows)
        console.print(f"wrote {len(rows)} rows to results.csv")


def coefficients(model: ta.PolynomialActuator) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.array([c for *_, c in model.coefficients])


# ---- synthetic recordings ---------------------------------------------------------------------------


def synthetic(quick: bool) -> Iterator[list[Measurement]]:
    """Is the truth missed by as many standard errors as a Gaussian misses its mean?"""
    cases: dict[str, tuple[Noise, float, dict[str, Any]]] = {
        "white noise": (Noise(memory=0.0), 55.0, {}),
        "noise that lasts 1 s": (Noise(), 55.0, {}),
        "the same, errors as if it were white": (Noise(), 55.0, {"correlated": 1}),
        "the same, the paper's smoothing": (Noise(), 440.0, {}),
    }
    repeats = 1 if quick else 60
    missed: dict[str, list[Any]] = {name: [] for name in cases}
    with tempfile.TemporaryDirectory() as folder:
        for seed in track(range(repeats), "synthetic recordings", transient=True):
            for noise in {case[0] for case in cases.values()}:
                files = [write_run(Path(folder), 2 * seed + run, noise, step=40.0, log_step=21.4) for run in (0, 1)]
                for name, (own, smoothing, options) in cases.items():
                    if own == noise:
                        model = ta.fit_recording(read_runs(files, smoothing), max_pressure=LIMIT, **options)
                        assert model.quality is not None
                        errors = np.array(model.quality.standard_errors)
                        missed[name].append((coefficients(model) - coefficients(TRUTH)) / errors)
    part = f"synthetic recordings: {repeats} × 2 runs, known truth"
    rows = []
    for name, values in missed.items():
        z = np.array(values)
        rows += [
            Measurement(
                part, name, "RMS of (fit - truth) / standard error", float(np.sqrt((z**2).mean())), "1 expected"
            ),
            Measurement(part, name, "share within 2 standard errors", float((np.abs(z) < 2).mean()), "0.954 expected"),
            Measurement(
                part, name, "largest mean of any coefficient", float(np.abs(z.mean(0)).max()), "standard errors"
            ),
        ]
    yield rows


def speed(quick: bool) -> Iterator[list[Measurement]]:
    """Reading 10 MB of recordings and fitting them."""
    part = "time to read, align and fit, one thread, imports apart"
    with tempfile.TemporaryDirectory() as folder:
        step = (20.0, 10.7) if quick else (8.2, 4.4)
        files = [write_run(Path(folder), seed, Noise(), step=step[0], log_step=step[1]) for seed in (0, 1)]
        size = sum(path.stat().st_size for pair in files for path in pair)
        read_runs(files)
        times = []
        for _ in range(5):
            start = time.perf_counter(), time.process_time()
            ta.fit_recording(read_runs(files))
            times.append((time.perf_counter() - start[0], time.process_time() - start[1]))
        wall, processor = np.median(times, 0)
    yield [
        Measurement(part, "synthetic recordings", "size", size / 1e6, "MB"),
        Measurement(part, "synthetic recordings", "time, median of 5", float(wall), "s"),
        Measurement(part, "synthetic recordings", "time of the processor, median of 5", float(processor), "s"),
    ]


# ---- the paper's recordings -----------------------------------------------------------------------


def real(folder: Path, quick: bool) -> Iterator[list[Measurement]]:
    testers = [ta.read_tester(folder / f"instron_run_{run}.csv") for run in (1, 2)]
    logs = [ta.read_pressure(folder / f"pressure_run_{run}.txt") for run in (1, 2)]

    def recording(
        runs: tuple[int, ...] = (0, 1), offsets: tuple[float, float] = (0.0, 0.0), **options: Any
    ) -> ta.Recording:
        return ta.pool([ta.align(testers[k], logs[k], actuators=4, offset=offsets[k], **options) for k in runs])

    paper = recording()
    model = ta.fit_recording(paper, max_pressure=LIMIT)
    yield published(model)
    yield quality(model, paper)
    found = [ta.estimate_offset(tester, log).offset for tester, log in zip(testers, logs, strict=True)]
    offsets = (found[0], found[1])
    part = "offset of the pressure log that fits best"
    yield [Measurement(part, f"run {run + 1}", "offset", offsets[run], "ms") for run in (0, 1)]
    holds = [float(np.median(paper.strain[hold])) for hold in _holds(paper)]
    variants: dict[str, ta.Actuator] = {
        "refitted as published": model,
        "held monotonic to 92 kPa": ta.fit_recording(paper, monotonic=True, max_pressure=92.0),
        "Huber's loss": ta.fit_recording(paper, loss="huber", max_pressure=LIMIT),
        "without pauses of the log": ta.fit_recording(recording(max_gap=100.0), max_pressure=LIMIT),
        "smoothing over 10 samples": ta.fit_recording(recording(smoothing=110.0), max_pressure=LIMIT),
        "no smoothing": ta.fit_recording(recording(smoothing=0.0), max_pressure=LIMIT),
        "offsets that fit best": ta.fit_recording(recording(offsets=offsets), max_pressure=LIMIT),
        "run 1 alone": ta.fit_recording(recording((0,)), max_pressure=LIMIT),
        "run 2 alone": ta.fit_recording(recording((1,)), max_pressure=LIMIT),
        "degree 4": ta.fit_recording(paper, 4, max_pressure=LIMIT),
        "bicubic grid": ta.fit_gridded_model(
            paper.strain, paper.pressure, paper.force, holds, np.linspace(0, 91, 8), max_pressure=LIMIT
        ),
    }
    variants["held monotonic to 92 kPa"] = _limited(variants["held monotonic to 92 kPa"])
    yield fits(variants)
    loads = 5 if quick else 100
    base = validation(ta.Bellows(), loads)
    yield moves("the validation study, shape (-3, 3), out of range", base, variants, loads, SHAPE)
    mild = validation(ta.Bellows(), loads, MILD)
    yield moves("the same arms and loads on shape (-1, 1), in range", mild, variants, loads, MILD)
    spread = uncertain_validation(model, loads)
    yield uncertainty(spread)
    yield check_gradient(model, spread, quick)
    if not quick:
        figure.held_strains(model, paper, HERE / "held_strains.png")
        figure.whole_fit(model, paper, HERE / "fit.png")
        figure.sensitivity(
            base, spread, {name: validation(v) for name, v in variants.items()}, HERE / "sensitivity.png"
        )


def _holds(recording: ta.Recording) -> Any:
    from torcharm.characterise.alignment import held_strains

    return held_strains(recording)


def _limited(model: ta.Actuator) -> ta.Actuator:
    """The model with the paper's limit, at which K holds."""
    from dataclasses import replace

    return replace(model, max_pressure=LIMIT)  # type: ignore[type-var]


def published(model: ta.FittedActuator) -> list[Measurement]:
    part = "the published coefficients, term by term (smoothing over 40 samples, reach 2.5 σ)"
    assert model.quality is not None
    rows = []
    off = coefficients(model) / coefficients(ta.Bellows()) - 1
    for (i, j), ours, error, share in zip(
        exponents(3), coefficients(model), model.quality.standard_errors, off, strict=True
    ):
        term = f"ε^{i} p^{j}"
        rows += [
            Measurement(part, term, "coefficient", float(ours), f"N/kPa^{j}" if j else "N"),
            Measurement(part, term, "standard error", error, f"N/kPa^{j}" if j else "N"),
            Measurement(part, term, "difference from published", 100 * float(share), "%"),
        ]
    rows.append(Measurement(part, "all", "largest difference from published", 100 * float(np.abs(off).max()), "%"))
    return rows


def quality(model: ta.FittedActuator, recording: ta.Recording) -> list[Measurement]:
    part, found = "quality of the fit", model.quality
    assert found is not None
    naive = ta.fit_recording(recording, max_pressure=LIMIT, correlated=1).quality
    assert naive is not None
    ratio = np.array(found.standard_errors) / naive.standard_errors
    rows = [
        Measurement(part, "both runs", "R²", found.r_squared, ""),
        Measurement(part, "both runs", "RMSE", found.rmse, "N"),
        Measurement(part, "both runs", "samples over which noise is correlated", found.correlation_length, ""),
        Measurement(part, "both runs", "standard errors / those for white noise, least", float(ratio.min()), "times"),
        Measurement(part, "both runs", "standard errors / those for white noise, most", float(ratio.max()), "times"),
        Measurement(part, "both runs", "monotonic in pressure up to", found.monotonicity.up_to, "kPa"),
        Measurement(part, "both runs", "share of the box where it is not", found.monotonicity.failing_share, ""),
    ]
    for held in found.hold_out:
        rows += [
            Measurement(part, f"run {held.run + 1} from the other", "R²", held.r_squared, ""),
            Measurement(part, f"run {held.run + 1} from the other", "RMSE", held.rmse, "N"),
        ]
    return rows


def fits(variants: dict[str, ta.Actuator]) -> list[Measurement]:
    part, rows = "other ways to fit the same recordings", []
    for name, model in variants.items():
        if isinstance(model, ta.FittedActuator) and model.quality is not None:
            rows += [
                Measurement(part, name, "R² on its own samples", model.quality.r_squared, ""),
                Measurement(part, name, "RMSE on its own samples", model.quality.rmse, "N"),
            ]
        rows.append(
            Measurement(part, name, "monotonic up to", ta.monotonicity(model, pressure_range=(0, 92)).up_to, "kPa")
        )
    return rows


def moves(
    study: str,
    base: dict[tuple[str, str], torch.Tensor],
    variants: dict[str, ta.Actuator],
    loads: int,
    shape: torch.Tensor,
) -> list[Measurement]:
    part, rows = f"{study}: moves from the published bellows' answers", []
    for (arm, metric), value in base.items():
        rows.append(Measurement(part, f"published, {arm}, {metric}", "median", float(value.median()), "N"))
    for name, model in variants.items():
        for (arm, metric), value in validation(model, loads, shape).items():
            move = (value - base[arm, metric]).abs()
            case = f"{name}, {arm}, {metric}"
            rows += [
                Measurement(part, case, "median", float(value.median()), "N"),
                Measurement(part, case, "median move", float(move.median()), "N"),
                Measurement(part, case, "largest move", float(move.max()), "N"),
            ]
    return rows


def uncertainty(spread: Any) -> list[Measurement]:
    part, rows = "the validation study: standard deviation from the fit's covariance, by the gradient", []
    for (arm, metric), found in spread.items():
        share = found.deviation / found.values.clamp(min=1e-9)
        rows += [
            Measurement(part, f"{arm}, {metric}", "median standard deviation", float(found.deviation.median()), "N"),
            Measurement(part, f"{arm}, {metric}", "largest standard deviation", float(found.deviation.max()), "N"),
            Measurement(part, f"{arm}, {metric}", "median share of the value", 100 * float(share.median()), "%"),
        ]
    return rows


def check_gradient(model: ta.FittedActuator, spread: Any, quick: bool) -> list[Measurement]:
    part, rows = "the same deviations by drawing coefficients", []
    loads, draws = (3, 4) if quick else (20, 200)
    drawn = drawn_deviation(model, loads, draws)
    for key, found in spread.items():
        ratio = found.deviation[:loads] / drawn[key]
        rows.append(
            Measurement(part, ", ".join(key), "gradient / drawn, median over loads", float(ratio.median()), "times")
        )
    return rows
