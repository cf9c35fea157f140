"""Which tolerance decides the tips of the paper's arms, how good yields are, and what a robust design gains.

Prints tables; writes results.csv and shares.png beside this file. Parts that results.csv holds are not run again.
"""

import argparse
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from rich.console import Console

import torcharm as ta
from experiments.design_optimisation.scenes import ARMS, SHAPES, tasks_of
from experiments.rows import Measurement, measurements_table, read_rows, write_rows
from torcharm.design.scatter import normal_numbers
from torcharm.design.tolerance import Evaluation, joined, nominal_tolerance
from torcharm.design.tolerance_result import Yield
from torcharm.plot import tolerance_figure

HERE = Path(__file__).parent
SCATTER = ta.Scatter(radii=1e-3, length=2e-3, force=0.05, force_offset=0.2, bending=0.1)
"""Standard deviations: what a workshop, a tape measure and a force model are good to."""
PLAIN = ta.Scatter(radii=1e-3, length=2e-3, force=0.05)
LOOSE = ta.PoseTolerance(tip=0.01, rotation=math.radians(10), shape=0.015)
BEND = (0.5, 0.5)
"""Slope and intercept of a mild bend, which is in the range of all models."""


@dataclass(frozen=True)
class Size:
    """Of a run: loads a shape, built arms, plain samples with kept and with own pressures, and of the descents."""

    loads: int
    samples: int
    plain: int
    plain_compensated: int
    starts: int
    iterations: int


FULL, QUICK = Size(20, 1000, 1_000_000, 1_000_000, 4, 60), Size(2, 64, 400, 64, 1, 3)


def main() -> None:
    """Run the parts that are not known yet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke run: small sizes, no file written")
    parser.add_argument("--fresh", action="store_true", help="measure again what results.csv holds")
    options = parser.parse_args()
    torch.set_num_threads(1)
    size = QUICK if options.quick else FULL
    known: list[Measurement] = [] if options.quick or options.fresh else read_rows(HERE / "results.csv", Measurement)
    parts: dict[str, Callable[[Size], Iterator[Measurement]]] = {
        "shares": shares,
        "yields": yields,
        "robust": robust,
        "seconds": seconds,
    }
    console = Console(width=140)
    for name, part in parts.items():
        own = [row for row in known if row.part == name]
        if not own:
            own = list(part(size))
            known += own
            if not options.quick:
                write_rows(HERE / "results.csv", known)
        console.print(measurements_table(own))
    if not options.quick:
        picture(size)


def bend(loads: int) -> ta.Task:
    """The mild bend under loads of up to 2 N and 0.2 N·m."""
    return ta.Task(ta.affine_curvature(*BEND, length=0.5), ta.sample_loads(loads, (2.0, 2.0, 0.2)))


def shares(size: Size) -> Iterator[Measurement]:
    """What scatters the tip of each of the paper's arms, on the mild bend and on its shapes."""
    shapes = {str(BEND): bend(size.loads)} | {name: tasks_of(name, size.loads) for name in SHAPES}
    for shape, task in shapes.items():
        for arm, design in ARMS.items():
            for compensated in (False, True):
                if compensated and shape != str(BEND):
                    continue
                found = ta.tolerance(design, task, **vars(SCATTER), compensated=compensated, samples=size.samples)
                case = f"{arm}, {shape}, {'own' if compensated else 'kept'} pressures"
                yield Measurement(
                    "shares", case, "drawn arm's tip error, median", mm(found.nominal_tip_error.quantile(0.5)), "mm"
                )
                yield Measurement("shares", case, "tip error, 50 %", mm(found.pooled_percentile(50)), "mm")
                yield Measurement("shares", case, "tip error, 95 %", mm(found.pooled_percentile(95)), "mm")
                yield Measurement("shares", case, "rms by gradients", mm(found.deviation_by_gradient.nanmedian()), "mm")
                yield Measurement("shares", case, "rms by samples", mm(found.deviation_by_samples.nanmedian()), "mm")
                yield Measurement("shares", case, "linear", round(100 * float(found.explained.nanmedian()), 1), "%")
                for source, share in found.shares.items():
                    yield Measurement("shares", case, f"share of {source}", round(100 * share, 1), "%")


def mm(value: torch.Tensor) -> float:
    """Metres as millimetres, rounded."""
    return round(1e3 * float(value), 3)


def yields(size: Size) -> Iterator[Measurement]:
    """Yields of 1,000 Sobol' samples beside those of many independent ones."""
    arm, task = ARMS["antagonistic"], bend(1)
    for compensated, plain in ((False, size.plain), (True, size.plain_compensated)):
        case = f"{'own' if compensated else 'kept'} pressures"
        drawn = ta.predict_error(arm, task)
        close = 1.05 * float(drawn.tip_error.max()) if compensated else 0.01
        tolerance = ta.PoseTolerance(tip=close, rotation=1.0, shape=1.0)
        how_built: dict[str, Any] = {"compensated": compensated, "samples": size.samples}
        found = ta.tolerance(arm, task, **vars(PLAIN), **how_built, tolerance=tolerance)
        sources = PLAIN.sources(arm)
        how = Evaluation((task,), nominal_tolerance(arm, tolerance), None, False)
        begun = time.process_time()
        with torch.no_grad():
            numbers = normal_numbers(sources, plain, 1, quasi=False)
            many = joined(list(how.chunks(arm, sources, numbers, None if compensated else [drawn.pressure])))
        taken = time.process_time() - begun
        for name, own in (
            (f"{size.samples} Sobol'", found.yields[0]),
            (f"{plain} plain", Yield.of(~many["failed"][:, 0].any(-1))),
        ):
            for quantity, value in (("yield", own.value), ("at least", own.low), ("at most", own.high)):
                yield Measurement("yields", f"{case}, {name}", quantity, round(100 * value, 2), "%")
        for percent in (50, 95):
            sobol, plain_error = found.pooled_percentile(percent), many["tip_error"].flatten().quantile(percent / 100)
            yield Measurement("yields", case, f"tip error, {percent} %, Sobol'", mm(sobol), "mm")
            yield Measurement("yields", case, f"tip error, {percent} %, plain", mm(plain_error), "mm")
        yield Measurement("yields", case, "plain samples took", round(taken, 1), "s")


def robust(size: Size) -> Iterator[Measurement]:
    """The nominal optimum and a robust design, on samples that neither has seen."""
    arm, task = ARMS["antagonistic"], bend(min(size.loads, 8))
    space = ta.DesignSpace(bounds={"radii": (-0.1, 0.1), "length": (0.25, 0.75)})
    options: dict[str, Any] = {"starts": size.starts, "iterations": size.iterations, "tolerance": LOOSE}
    nominal = ta.optimise_design(arm, task, space, **options)
    designs = {"given": arm, "nominal optimum": nominal.best}
    for quantile in (0.9, None):
        name = "robust, mean" if quantile is None else f"robust, {100 * quantile:g} %"
        objective = ta.Objective(robust=ta.Robust(PLAIN, quantile))
        designs[name] = ta.optimise_design(nominal.best, task, space, objective, **options).best
    fresh: dict[str, Any] = {"samples": size.samples * 2, "seed": 1000, "tolerance": LOOSE}
    for name, design in designs.items():
        for compensated in (False, True):
            built = ta.tolerance(design, task, **vars(PLAIN), **fresh, compensated=compensated)
            case, whole = f"{name}: {'own' if compensated else 'kept'} pressures", built.yield_of_all
            each = 100 * float(built.within.double().mean())
            yield Measurement("robust", case, "yield, each load", round(each, 2), "%")
            yield Measurement("robust", case, "yield, all loads", round(100 * whole.value, 2), "%")
            yield Measurement("robust", case, "at least", round(100 * whole.low, 2), "%")
            yield Measurement("robust", case, "at most", round(100 * whole.high, 2), "%")
            yield Measurement("robust", case, "tip error, 90 %", mm(built.pooled_percentile(90)), "mm")
            yield Measurement(
                "robust", case, "drawn shape error", mm(ta.predict_error(design, task).shape_error.mean()), "mm"
            )


def seconds(size: Size) -> Iterator[Measurement]:
    """What 1,000 built arms on 20 loads take in one thread, whatever else the machine does."""
    arm, task = ARMS["antagonistic"], bend(size.loads)
    for compensated in (False, True):
        best = math.inf
        for _ in range(3):
            begun = time.process_time()
            ta.tolerance(arm, task, **vars(PLAIN), compensated=compensated, samples=size.samples)
            best = min(best, time.process_time() - begun)
        case = f"{size.samples} arms on {size.loads} loads, {'own' if compensated else 'kept'} pressures"
        yield Measurement("seconds", case, "CPU time, best of 3", round(best, 2), "s")


def picture(size: Size) -> None:
    """The three arms on the mild bend."""
    task = bend(size.loads)
    found = [(name, ta.tolerance(arm, task, **vars(SCATTER), samples=size.samples)) for name, arm in ARMS.items()]
    tolerance_figure(found, "a mild bend under 20 loads, pressures kept").savefig(HERE / "shares.png", dpi=110)
