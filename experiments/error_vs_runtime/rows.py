"""Rows of results, and the file that keeps them."""

import csv
import os
import platform
import subprocess
from dataclasses import dataclass, field, fields
from functools import cache
from pathlib import Path

import numpy as np
import scipy
import torch

import torcharm as ta

HERE = Path(__file__).parent
RESULTS = HERE / "results.csv"

Key = tuple[str, ...]


@cache
def commit() -> str:
    """The commit at work; empty outside a repository."""
    found = subprocess.run(["git", "rev-parse", "HEAD"], cwd=HERE, capture_output=True, text=True, check=False)
    return found.stdout.strip()


@dataclass(frozen=True)
class Row:
    """One case × method × setting × dtype × batch. Times are of a call, in seconds; NaN where nothing was measured.

    Attributes:
        batch: problems in a timed call.
        problems: problems over which errors are taken.
        forward, gradient: quartiles of the time of a call: the values, or values and gradients.
        memory: largest memory [MiB] that torch held in a call, above what it held before.
        error: quantiles over problems, of |distance - reference| / max|H - w|; 1 for a failure.
        success: share of problems with an error within.
        primal, dual, gap: largest residuals, as of `kkt_residuals`.
        converged, resolved: share of problems that the library flags so.
        slope_error: quantiles of |∇ - reference|, in the point, whose gradient has length 1.
    """

    family: str
    case: str
    method: str
    setting: str
    dtype: str
    batch: int
    problems: int
    repeats: int
    forward_q25_s: float
    forward_median_s: float
    forward_q75_s: float
    forward_us_a_problem: float
    gradient_q25_s: float
    gradient_median_s: float
    gradient_q75_s: float
    gradient_us_a_problem: float
    memory_mib: float
    error_p50: float
    error_p99: float
    error_max: float
    success_1e6: float
    success_1e9: float
    primal_max: float
    dual_max: float
    gap_max: float
    converged: float
    resolved: float
    in_range: float
    slope_error_p50: float
    slope_error_p99: float
    slope_error_max: float
    threads: int = field(default_factory=torch.get_num_threads)
    torcharm: str = ta.__version__
    torch: str = torch.__version__
    numpy: str = np.__version__
    scipy: str = scipy.__version__
    machine: str = field(default_factory=lambda: f"{platform.system()} {platform.machine()}, {os.cpu_count()} CPUs")
    commit: str = field(default_factory=commit)

    @property
    def key(self) -> Key:
        """What tells rows apart."""
        return (self.family, self.case, self.method, self.setting, self.dtype, str(self.batch))


def read(path: Path = RESULTS) -> dict[Key, Row]:
    """The rows in a file; none if there is no file, or if its columns are others."""
    if not path.exists():
        return {}
    with open(path, newline="") as file:
        reader = csv.DictReader(file)
        if reader.fieldnames != [one.name for one in fields(Row)]:
            return {}
        rows = [Row(**{one.name: one.type(line[one.name]) for one in fields(Row)}) for line in reader]  # type: ignore[operator]
    return {row.key: row for row in rows}


def write(rows: dict[Key, Row], path: Path = RESULTS) -> None:
    """Replace the file at once, so that whatever interrupts finds the old rows or the new."""
    names = [one.name for one in fields(Row)]
    beside = path.with_suffix(".part")
    with open(beside, "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        writer.writerows([_shown(getattr(row, name)) for name in names] for row in rows.values())
    os.replace(beside, path)


def _shown(value: object) -> object:
    return f"{value:.4g}" if isinstance(value, float) else value
