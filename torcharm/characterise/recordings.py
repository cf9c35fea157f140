"""Reading what a test bench wrote: a tensile tester's CSV and a pressure log.

The tester pulls a number of actuators in parallel and writes time, displacement, strain and force (positive in
tension); a logger with a clock of the same zero writes the pressure in them. Neither is trusted: what is
wrong with a file is a ValueError that names the file and the line.
"""

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from torcharm.characterise.log_header import named_units, split_header
from torcharm.files import read_file
from torcharm.inputs import check_choice

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
TESTER_COLUMNS = ("time", "strain", "force")
TESTER_UNITS = {
    "time": {"ms": 1.0, "s": 1000.0},
    "strain": {"%": 0.01, "mm/mm": 1.0, "1": 1.0},
    "force": {"N": 1.0, "kN": 1000.0, "lbf": 4.4482216152605},
}
_SHORT, _LONGEST_HEADER = 60, 1000
_DAMAGED = re.compile(r'\s*"?[+-]?\.?\d[\d.]*"?\s*,')
_BEGUN = re.compile(r'"?[+-]?\.?')


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
    if len(units) > len(names):
        raise ValueError(
            f"{source}: line 2: must hold a unit for each of the {len(names)} names in line 1, got {_short(lines[1])}"
        )
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
    table = _table(source, lines, 2, len(names), whole, truncated)
    _check_time(source, table[:, chosen[0]], 2)
    time, strain, force = (table[:, index] * factor for index, factor in zip(chosen, factors, strict=True))
    if np.abs(strain).max() > PLAUSIBLE_STRAIN:
        warnings.warn(
            f"{source}: strains reach {np.abs(strain).max():.3g}, more than {PLAUSIBLE_STRAIN:g}: "
            "is the unit in line 2 right?",
            stacklevel=2,
        )
    return TesterRecord(time, strain, force, source)


def read_pressure(path: StrPath, unit: str | None = None, *, truncated: bool = False) -> PressureRecord:
    """Read a pressure log: a header line, lines `time,pressure`, and a closing line that is no number.

    Time is in ms and pressure in `unit` unless the header names units, as in `Time (s),Pressure (kPa)` or
    `time_ms,pressure_kPa`: then those hold. A first sample that stands in the header's line, its end of line lost, is
    read. Lines may end in CR, LF or both; blank ones are passed over. A highest pressure that is implausible for a
    soft actuator (outside 20 to 1000 kPa) is a warning: it tells of a wrong unit.

    Args:
        path: the file.
        unit: of its pressures: psi, kPa, bar, MPa, Pa or mbar; None: what the header names, psi where it names none.
        truncated: whether to accept a log without its closing line; a last line without an end is dropped then.

    Raises:
        ValueError: unknown unit, or another one than the header names; a unit in brackets that is none; or as for
            `read_tester`; the closing line is missing.
    """
    if unit is not None:
        check_choice("unit", unit, KILOPASCALS)
    source, lines, whole = _lines(path)
    if not lines:
        raise ValueError(f"{source}: is empty, must be a pressure log")
    first, milliseconds, unit, kilopascals = _header(source, lines, unit)
    last = len(lines)
    while last > first and not lines[last - 1].strip():
        last -= 1
    closing = last > first and _closes(lines[last - 1])
    if last - closing <= first:
        raise ValueError(f"{source}: line {last or 1}: is the last line, must be followed by lines time,pressure")
    if not closing and not truncated:
        raise ValueError(
            f"{source}: line {last}: the log ends with {_short(lines[last - 1])}, must end with a line that is no "
            "number such as 'Logging end': it is cut short"
        )
    table = _table(source, lines[: last - closing], first, 2, closing or whole, truncated)
    _check_time(source, table[:, 0], first, lines)
    pressure = table[:, 1] * kilopascals
    low, high = PLAUSIBLE_PRESSURE
    if not low <= pressure.max() <= high:
        warnings.warn(
            f"{source}: pressures reach {pressure.max():.3g} kPa when read as {unit}, soft actuators are driven to "
            f"{low:g} to {high:g} kPa: is the unit right?",
            stacklevel=2,
        )
    return PressureRecord(table[:, 0] * milliseconds, pressure, source)


def _header(source: str, lines: list[str], unit: str | None) -> tuple[int, float, str, float]:
    """How many lines of a log are its header, one of its times [ms], its unit of pressure, and one of that [kPa].

    A sample that is glued to the header takes its place among the lines.
    """
    if _is_numbers(lines[0]):
        unit = unit or "psi"
        return 0, 1.0, unit, KILOPASCALS[unit]
    if len(lines[0]) > _LONGEST_HEADER:
        raise ValueError(
            f"{source}: line 1: must be a header of at most {_LONGEST_HEADER} characters, got {_short(lines[0])}"
        )
    header, sample = split_header(lines[0])
    if _DAMAGED.match(header):
        raise ValueError(f"{source}: line 1: must be a header or 2 finite numbers, got {_short(lines[0])}")
    try:
        time, named = named_units(header)
    except ValueError as error:
        raise ValueError(f"{source}: line 1: {error}") from None
    if named is None:
        unit = unit or "psi"
        kilopascals = KILOPASCALS[unit]
    else:
        kilopascals = named[1]
        name = next((name for name, size in KILOPASCALS.items() if size == kilopascals), named[0])
        if unit is not None and KILOPASCALS[unit] != kilopascals:
            raise ValueError(
                f"unit: must be left out or be {name}, which {source} names in line 1, {_short(header)}, got {unit}"
            )
        unit = name
    if sample is not None:
        lines[0] = sample
    return int(sample is None), time[1] if time else 1.0, unit, kilopascals


def _closes(line: str) -> bool:
    """Whether a log's last line is no number, nor the beginning of one."""
    return not any(character.isdigit() for character in line) and not _BEGUN.fullmatch(line.strip())


def _lines(path: StrPath) -> tuple[str, list[str], bool]:
    """A file's name, its lines by any ending, and whether the last one is ended."""
    source = str(path)
    try:
        text = read_file(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{source}: must be UTF-8 text, got byte {error.start + 1} that is not") from None
    # CR, CR LF and the loggers' CR CR LF end one line each.
    text = re.sub("\r+\n?", "\n", text) if "\r" in text else text
    lines = text.split("\n")
    return source, lines[:-1] if lines[-1] == "" else lines, not lines[-1].strip()


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
        drop: whether to drop a last line that is no good, or whose last number may be incomplete.
    """
    rows = [line for line in lines[skip:] if line and not line.isspace()]
    quoted = bool(rows) and '"' in rows[0]
    cut = bool(rows) and not whole and not (quoted and _is_row(rows[-1], columns, quoted=True))
    if drop and rows and (cut or not _is_row(rows[-1], columns)):
        rows.pop()
        cut = False
    if not rows:
        raise ValueError(f"{source}: line {len(lines)}: is the last line, must be followed by numbers")
    commas = columns - 1
    if not cut and all(row.count(",") == commas for row in rows):
        try:
            table = np.loadtxt(rows, delimiter=",", quotechar='"', comments=None, ndmin=2)
        except ValueError:
            pass
        else:
            if sum(row.count('"') for row in rows) in (0, 2 * table.size) and np.isfinite(table).all():
                return table
    for number, line in enumerate(lines[skip:], start=skip + 1):
        if line and not line.isspace() and not _is_row(line, columns, quoted=quoted):
            end = "" if number < len(lines) else ", where the file ends: it is cut short"
            raise ValueError(f"{source}: line {number}: must be {columns} finite numbers, got {_short(line)}{end}")
    if not cut:
        raise ValueError(f"{source}: must hold lines of {columns} finite numbers after line {skip}")
    raise ValueError(
        f"{source}: line {len(lines)}: must end with an end of line, got {_short(lines[-1])}, whose last number may be "
        "incomplete: it is cut short"
    )


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
