"""Recordings from a test bench: a tensile tester's CSV and a pressure log, read, aligned and pooled.

The tester pulls a number of actuators in parallel and writes time, displacement, strain and force (positive in
tension); a logger with a clock of the same zero writes the pressure in them. Neither is trusted: what is
wrong with a file is a ValueError that names the file and the line.
"""

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from torcharm._inputs import check_choice, check_count, check_number

Array = NDArray[np.float64]
if TYPE_CHECKING:
    Floats = NDArray[np.float64]
else:
    Floats = np.ndarray
StrPath = str | PathLike[str]

KILOPASCALS = {"psi": 6.894757293168361, "kPa": 1.0, "bar": 100.0, "MPa": 1000.0, "Pa": 0.001, "mbar": 0.1}
"""One of each pressure unit, in kPa."""
PLAUSIBLE_PRESSURE = (20.0, 1000.0)
"""Between these [kPa] lies the highest pressure of a recording, or its unit is doubted."""
PLAUSIBLE_STRAIN = 5.0
"""Above it, percents were probably taken for strains."""
PAPER_SMOOTHING = 40.0
"""σ of the paper's Gaussian smoothing of pressure, in samples of the log."""
SMOOTHING_REACH = 2.5
"""The Gaussian ends at so many σ: with the paper's σ it spans 201 samples."""

TESTER_COLUMNS = ("time", "strain", "force")
TESTER_UNITS = {
    "time": {"ms": 1.0, "s": 1000.0},
    "strain": {"%": 0.01, "mm/mm": 1.0, "1": 1.0},
    "force": {"N": 1.0, "kN": 1000.0, "lbf": 4.4482216152605},
}
_SHORT = 60


@dataclass(frozen=True, eq=False)
class TesterRecord:
    """What a tensile tester wrote.

    Attributes:
        time: (n) strictly increasing [ms].
        strain: (n) of the actuators, from their neutral length.
        force: (n) on all actuators together [N], positive in tension.
        source: the file.
    """

    time: Float[Floats, " n"]
    strain: Float[Floats, " n"]
    force: Float[Floats, " n"]
    source: str


@dataclass(frozen=True, eq=False)
class PressureRecord:
    """What a pressure logger wrote.

    Attributes:
        time: (n) strictly increasing [ms].
        pressure: (n) gauge pressure [kPa].
        source: the file.
    """

    time: Float[Floats, " n"]
    pressure: Float[Floats, " n"]
    source: str


@dataclass(frozen=True, eq=False)
class Recording:
    """One run on the test bench, or several, for one actuator, on the tester's time stamps.

    Attributes:
        strain: (n).
        pressure: (n) [kPa].
        force: (n) of one actuator [N], in torcharm's sign: positive pushes outward.
        run: (n) which run each sample comes from, counted from 0; within a run samples are in order of time.
        sources: each run's files.
        settings: how they were read, for the record: names and values.
    """

    strain: Float[Floats, " n"]
    pressure: Float[Floats, " n"]
    force: Float[Floats, " n"]
    run: NDArray[np.int64]
    sources: tuple[str, ...]
    settings: tuple[tuple[str, str | float], ...] = ()


def read_tester(path: StrPath, *, truncated: bool = False) -> TesterRecord:
    """Read a tensile tester's CSV file: two header lines (names and units), then numbers, quoted or not.

    Columns are known by their names (time, strain, force; others are passed over), units by the second line:
    ms or s, % or mm/mm, N, kN or lbf.

    Args:
        path: the file.
        truncated: whether to accept a file that ends within a line, and drop that line.

    Raises:
        ValueError: the file cannot be read, is empty, lacks a column, ends within a line, or a line holds
            what is no number, not finite, or not later than the line before. It names file and line.
    """
    source, lines, whole = _lines(path)
    if not lines:
        raise ValueError(f"{source}: is empty, must be a tester's CSV with two header lines")
    if len(lines) < 2:
        raise ValueError(f"{source}: line 1: is the only line, must be followed by units and numbers")
    names = [name.strip().strip('"').lower() for name in lines[0].split(",")]
    units = [unit.strip().strip('"').strip("()[] ") for unit in lines[1].split(",")]
    chosen: list[int] = []
    factors: list[float] = []
    for column in TESTER_COLUMNS:
        found = [index for index, name in enumerate(names) if column in name]
        if len(found) != 1:
            raise ValueError(
                f"{source}: line 1: must name one column of each of {', '.join(TESTER_COLUMNS)}, "
                f"got {len(found)} of {column} in {_short(lines[0])}"
            )
        unit = units[found[0]] if found[0] < len(units) else ""
        if unit not in TESTER_UNITS[column]:
            allowed = ", ".join(TESTER_UNITS[column])
            raise ValueError(f"{source}: line 2: the unit of {column} must be one of {allowed}, got {_short(lines[1])}")
        chosen.append(found[0])
        factors.append(TESTER_UNITS[column][unit])
    table = _table(source, lines, 2, len(names), whole or truncated, truncated)
    _check_time(source, table[:, chosen[0]], 2)
    time, strain, force = (table[:, index] * factor for index, factor in zip(chosen, factors, strict=True))
    if np.abs(strain).max() > PLAUSIBLE_STRAIN:
        warnings.warn(
            f"{source}: strains reach {np.abs(strain).max():.3g}, more than {PLAUSIBLE_STRAIN:g}: "
            "is the unit in line 2 right?",
            stacklevel=2,
        )
    return TesterRecord(time, strain, force, source)


def read_pressure(path: StrPath, unit: str = "psi", *, truncated: bool = False) -> PressureRecord:
    """Read a pressure log: a header line, lines `time,pressure` with time in ms, and a closing line that is no number.

    Lines may end in CR, LF or both; blank ones are passed over. A highest pressure that is implausible for a
    soft actuator (outside 20 to 1000 kPa) is a warning: it tells of a wrong unit.

    Args:
        path: the file.
        unit: of its pressures: psi, kPa, bar, MPa, Pa or mbar.
        truncated: whether to accept a log without its closing line.

    Raises:
        ValueError: unknown unit, or as for `read_tester`; the closing line is missing.
    """
    check_choice("unit", unit, KILOPASCALS)
    source, lines, whole = _lines(path)
    if not lines:
        raise ValueError(f"{source}: is empty, must be a pressure log")
    first = 0 if _is_numbers(lines[0]) else 1
    last = len(lines)
    while last > first and not lines[last - 1].strip():
        last -= 1
    closing = last > first and not any(character.isdigit() for character in lines[last - 1])
    if last - closing <= first:
        raise ValueError(f"{source}: line {last or 1}: is the last line, must be followed by lines time,pressure")
    if not closing and not truncated:
        raise ValueError(
            f"{source}: line {last}: the log ends with {_short(lines[last - 1])}, must end with a line that is no "
            "number such as 'Logging end': it is cut short"
        )
    table = _table(source, lines[: last - closing], first, 2, closing or whole or truncated, truncated)
    _check_time(source, table[:, 0], first, lines)
    pressure = table[:, 1] * KILOPASCALS[unit]
    low, high = PLAUSIBLE_PRESSURE
    if not low <= pressure.max() <= high:
        warnings.warn(
            f"{source}: pressures reach {pressure.max():.3g} kPa when read as {unit}, soft actuators are driven to "
            f"{low:g} to {high:g} kPa: is the unit right?",
            stacklevel=2,
        )
    return PressureRecord(table[:, 0], pressure, source)


def _lines(path: StrPath) -> tuple[str, list[str], bool]:
    """A file's name, its lines by any ending, and whether the last one is ended."""
    source = str(path)
    try:
        text = Path(path).read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{source}: must be UTF-8 text, got byte {error.start + 1} that is not") from None
    except OSError as error:
        raise ValueError(f"{source}: cannot be read: {error.strerror or error}") from None
    # CR, CR LF and the loggers' CR CR LF end one line each.
    text = re.sub("\r+\n?", "\n", text) if "\r" in text else text
    lines = text.split("\n")
    return source, lines[:-1] if lines[-1] == "" else lines, text.endswith("\n")


def _is_numbers(line: str) -> bool:
    try:
        [float(value) for value in line.replace('"', "").split(",")]
    except ValueError:
        return False
    return True


def _table(source: str, lines: Sequence[str], skip: int, columns: int, whole: bool, drop: bool) -> Array:
    """Numbers (n, columns) from the lines after the header, blank ones passed over.

    Args:
        source: for errors.
        lines: of the file.
        skip: header lines.
        columns: numbers a line.
        whole: whether the last line is ended.
        drop: whether to drop a last line that is no good.
    """
    rows = [line for line in lines[skip:] if line and not line.isspace()]
    if drop and rows and not _is_row(rows[-1], columns):
        rows.pop()
    if not rows:
        raise ValueError(f"{source}: line {len(lines)}: is the last line, must be followed by numbers")
    commas = columns - 1
    if all(row.count(",") == commas for row in rows) and (whole or _is_row(rows[-1], columns, quoted='"' in rows[0])):
        try:
            table = np.loadtxt(rows, delimiter=",", quotechar='"', comments=None, ndmin=2)
        except ValueError:
            pass
        else:
            if sum(row.count('"') for row in rows) in (0, 2 * table.size) and np.isfinite(table).all():
                return table
    quoted = '"' in rows[0]
    for number, line in enumerate(lines[skip:], start=skip + 1):
        if line and not line.isspace() and not _is_row(line, columns, quoted=quoted):
            end = "" if number < len(lines) else ", where the file ends: it is cut short"
            raise ValueError(f"{source}: line {number}: must be {columns} finite numbers, got {_short(line)}{end}")
    raise ValueError(f"{source}: line {len(lines)}: ends without an end of line: the file is cut short")


def _is_row(line: str, columns: int, *, quoted: bool = False) -> bool:
    values = line.strip().split(",")
    if len(values) != columns or line.count('"') not in ((2 * columns,) if quoted else (0, 2 * columns)):
        return False
    try:
        return all(np.isfinite(float(value.strip().strip('"'))) for value in values)
    except ValueError:
        return False


def _check_time(source: str, time: Array, skip: int, lines: Sequence[str] = ()) -> None:
    """Raise unless time increases from row to row."""
    late = np.flatnonzero(np.diff(time) <= 0)
    if not len(late):
        return
    row = int(late[0]) + 1
    filled = [number for number, line in enumerate(lines, start=1) if number > skip and line and not line.isspace()]
    number = filled[row] if filled else skip + row + 1
    what = "repeats the time before it" if time[row] == time[row - 1] else f"comes after {time[row - 1]:g}"
    raise ValueError(f"{source}: line {number}: time must increase, got {time[row]:g}, which {what}")


def _short(line: str) -> str:
    text = line.strip()
    return repr(text if len(text) <= _SHORT else f"{text[: _SHORT - 3]}...")


def smooth(values: Float[Floats, " n"], deviation: float) -> Float[Floats, " n"]:
    """A Gaussian-weighted mean over the samples within 2.5 deviations, and at the ends over those there are.

    Args:
        values: evenly spaced.
        deviation: σ in samples; 0 leaves the values as they are.
    """
    if deviation == 0:
        return values
    from scipy.ndimage import gaussian_filter1d

    options = {"sigma": deviation, "mode": "constant", "truncate": SMOOTHING_REACH}
    return gaussian_filter1d(values, **options) / gaussian_filter1d(np.ones_like(values), **options)


def align(
    tester: TesterRecord,
    log: PressureRecord,
    *,
    actuators: int = 1,
    smoothing: float = PAPER_SMOOTHING,
    offset: float = 0.0,
    max_gap: float | None = None,
) -> Recording:
    """One run: the pressure smoothed and interpolated to the tester's time stamps, the force of one actuator.

    Stamps before the log's start or after its end are dropped.

    Args:
        tester, log: of the same run.
        actuators: how many were pulled in parallel and shared the pressure.
        smoothing: σ of the Gaussian in samples of the log; 0 for none.
        offset: what is added to the log's time to give the tester's [ms]; see `estimate_offset`.
        max_gap: drop stamps within pauses of the log longer than this [ms]; None bridges all of them, as the
            paper does.

    Raises:
        ValueError: the two do not overlap in time, or a setting is out of range.
    """
    count = check_count("actuators", actuators, 1)
    for name, value in (("smoothing", smoothing), ("max_gap", max_gap)):
        if value is not None:
            check_number(name, value, 0.0)
    check_number("offset", offset)
    return _aligned(tester, log, smooth(log.pressure, smoothing), count, smoothing, offset, max_gap)


def _aligned(
    tester: TesterRecord,
    log: PressureRecord,
    smoothed: Array,
    actuators: int,
    smoothing: float,
    offset: float,
    max_gap: float | None,
) -> Recording:
    clock = log.time + offset
    kept = (tester.time >= clock[0]) & (tester.time <= clock[-1])
    if not kept.any():
        raise ValueError(
            f"{tester.source} and {log.source}: do not overlap in time: the tester ran from "
            f"{tester.time[0]:g} to {tester.time[-1]:g} ms, the log from {clock[0]:g} to {clock[-1]:g} ms"
        )
    if max_gap is not None:
        after = np.searchsorted(clock, tester.time).clip(1, len(clock) - 1)
        kept &= clock[after] - clock[after - 1] <= max_gap
        if not kept.any():
            raise ValueError(f"max_gap: leaves no sample of {tester.source} and {log.source}, got {max_gap:g} ms")
    settings: tuple[tuple[str, str | float], ...] = (
        ("actuators in parallel", float(actuators)),
        ("smoothing of pressure, samples", float(smoothing)),
        ("offset of the log, ms", float(offset)),
        *(() if max_gap is None else (("longest pause of the log, ms", float(max_gap)),)),
    )
    return Recording(
        tester.strain[kept],
        np.interp(tester.time[kept], clock, smoothed),
        -tester.force[kept] / actuators,
        np.zeros(int(kept.sum()), np.int64),
        (f"{Path(tester.source).name}, {Path(log.source).name}",),
        settings,
    )


def pool(recordings: Sequence[Recording]) -> Recording:
    """Several runs as one; settings that differ are kept run by run.

    Raises:
        ValueError: there is none.
    """
    if not recordings:
        raise ValueError("recordings: must hold at least one run, got none")
    counts = [int(one.run.max()) + 1 for one in recordings]
    starts = np.cumsum([0, *counts[:-1]])
    shared = [pair for pair in recordings[0].settings if all(pair in one.settings for one in recordings)]
    own = [
        (f"{name}, run {index + 1}", value)
        for index, one in enumerate(recordings)
        for name, value in one.settings
        if (name, value) not in shared
    ]
    return Recording(
        np.concatenate([one.strain for one in recordings]),
        np.concatenate([one.pressure for one in recordings]),
        np.concatenate([one.force for one in recordings]),
        np.concatenate([one.run + start for one, start in zip(recordings, starts, strict=True)]),
        tuple(source for one in recordings for source in one.sources),
        (*shared, *own),
    )


def estimate_offset(
    tester: TesterRecord,
    log: PressureRecord,
    *,
    degree: int = 3,
    smoothing: float = PAPER_SMOOTHING,
    search: float = 2000.0,
) -> float:
    """The offset of the log [ms] with which a polynomial of strain and pressure fits the run's force best.

    Looked for on a coarse grid within ±`search`, then by golden sections about the best of it.

    Args:
        tester, log, smoothing: as for `align`.
        degree: of the polynomial.
        search: how far to look [ms].

    Raises:
        ValueError: the run does not overlap in time, at the offsets in reach or at all; or a setting is out of range.
    """
    from scipy.optimize import minimize_scalar

    from torcharm.actuators.fitting import exponents, least_squares_loss

    check_count("degree", degree, 1)
    check_number("search", search, 0.0, strict=True, unit="ms")
    align(tester, log, smoothing=smoothing)  # for its errors
    smoothed, powers = smooth(log.pressure, smoothing), exponents(degree)
    # Everything is compared on the stamps that all offsets have.
    clock = log.time
    common = (tester.time >= clock[0] + search) & (tester.time <= clock[-1] - search)
    if common.sum() < 10 * len(powers):
        raise ValueError(
            f"search: {tester.source} and {log.source} overlap too little to look {search:g} ms either way, "
            f"got {int(common.sum())} samples"
        )
    time, strain, force = tester.time[common], tester.strain[common], tester.force[common]

    def loss(offset: float) -> float:
        return least_squares_loss(strain, np.interp(time, clock + offset, smoothed), force, powers)

    grid = np.linspace(-search, search, 41)
    best = int(np.argmin([loss(offset) for offset in grid]))
    if best in (0, 40):
        warnings.warn(
            f"{tester.source} and {log.source}: the best offset lies at the edge of ±{search:g} ms: look further",
            stacklevel=2,
        )
    bounds = grid[max(best - 1, 0)], grid[min(best + 1, 40)]
    return float(minimize_scalar(loss, bounds=bounds, method="bounded", options={"xatol": 0.1}).x)


def held_strains(recording: Recording, *, steady: float = 1e-4, apart: float = 0.01) -> list[NDArray[np.int64]]:
    """Samples of the strains at which the tester held still, one array of indices for each, from least to most.

    Args:
        recording: one run, or several pooled: holds at equal strains go together.
        steady: from one sample to the next, strain may move by so much.
        apart: strains further apart than this are different holds.
    """
    still = np.zeros(len(recording.strain), bool)
    still[1:] = (np.abs(np.diff(recording.strain)) <= steady) & (np.diff(recording.run) == 0)
    # A ramp is a chain of small steps: what holds stays put over the samples around it, too.
    reach = 25
    ahead, behind = np.roll(recording.strain, -reach), np.roll(recording.strain, reach)
    still &= (np.abs(ahead - recording.strain) <= steady) & (np.abs(behind - recording.strain) <= steady)
    index = np.flatnonzero(still)
    index = index[np.argsort(recording.strain[index], kind="stable")]
    cuts = np.flatnonzero(np.diff(recording.strain[index]) > apart) + 1
    return [np.sort(part) for part in np.split(index, cuts) if len(part) > 2 * reach]
