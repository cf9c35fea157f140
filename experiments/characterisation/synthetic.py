"""Recordings as the test bench would write them, of a bellows whose coefficients are known."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.signal import lfilter

import torcharm as ta

Array = NDArray[np.float64]

TRUTH = ta.Bellows()
HOLDS = np.linspace(-0.167, 0.668, 11)
HOLD, RAMP, START = 45_000.0, 15_000.0, 40_000.0
"""Durations [ms]: of a hold, of the ramp to the next, of the ramp to the first."""
ACTUATORS = 4
PSI = 6.894757293168361


@dataclass(frozen=True)
class Noise:
    """Standard deviations, and how long force noise lasts.

    Attributes:
        force: of one actuator [N].
        memory: of the force noise [ms]; 0 is white.
        pressure: of the log [kPa], white.
    """

    force: float = 1.0
    memory: float = 1000.0
    pressure: float = 0.1


def write_run(
    folder: Path, seed: int, noise: Noise, *, step: float = 20.0, log_step: float = 10.7
) -> tuple[Path, Path]:
    """A tester's CSV and a pressure log: the strain held at eleven levels, pressure swept up and down at each."""
    random = np.random.default_rng(seed)
    end = START + len(HOLDS) * (HOLD + RAMP)
    time = np.arange(0.0, end, step).round()
    strain = _strain(time)
    peaks = random.uniform(55.0, 90.0, len(HOLDS))
    pressure = _pressure(time, peaks)
    force = TRUTH.force(torch.from_numpy(strain), torch.from_numpy(pressure)).numpy()
    force = force + noise.force * _noise(random, len(time), noise.memory / step)
    tester = folder / f"tester_{seed}.csv"
    header = "Time,Displacement,Tensile strain (Displacement),Force\r\n(ms),(mm),(%),(N)"
    table = np.stack((time, 60 * strain, 100 * strain, -ACTUATORS * force), -1)
    np.savetxt(tester, table, ",".join(['"%.4f"'] * 4), newline="\r\n", header=header, comments="", encoding="utf-8")
    clock = np.unique(np.arange(START, end, log_step).round())
    logged = _pressure(clock, peaks) + noise.pressure * random.normal(size=len(clock))
    log = folder / f"pressure_{seed}.txt"
    lines = [f"{t:.0f},{p:.3f}" for t, p in zip(clock, logged / PSI, strict=True)]
    log.write_bytes("\r\r".join(["Time,Pressure", *lines, "Logging end", ""]).encode())
    return tester, log


def _strain(time: Array) -> Array:
    corners, levels = [0.0, START], [0.0, HOLDS[0]]
    for index, level in enumerate(HOLDS):
        begin = START + index * (HOLD + RAMP)
        corners += [begin, begin + HOLD]
        levels += [level, level]
    return np.interp(time, corners, levels)


def _pressure(time: Array, peaks: Array) -> Array:
    """During each hold once up and down, as half a period of a squared sine."""
    since = time - START
    hold = np.clip((since // (HOLD + RAMP)).astype(int), 0, len(peaks) - 1)
    share = np.clip((since - hold * (HOLD + RAMP)) / HOLD, 0, 1) * (since >= 0)
    swept: Array = peaks[hold] * np.sin(np.pi * share) ** 2
    return swept


def _noise(random: np.random.Generator, count: int, memory: float) -> Array:
    rho = float(np.exp(-1 / memory)) if memory > 0 else 0.0
    made: Array = lfilter([np.sqrt(1 - rho**2)], [1, -rho], random.normal(size=count))
    return made


def read_runs(files: list[tuple[Path, Path]], smoothing: float | None = None) -> ta.Recording:
    """The runs pooled, as a user would read them."""
    return ta.pool(
        [
            ta.align(ta.read_tester(csv), ta.read_pressure(log), actuators=ACTUATORS, smoothing=smoothing)
            for csv, log in files
        ]
    )
