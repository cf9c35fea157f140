"""Reading what a test bench wrote: a tensile tester's file and a pressure log, or one file that holds both.

The tester pulls a number of actuators in parallel and writes time, force and strain, or an extension; a logger writes
the pressure in them. Neither is trusted: what is wrong with a file is a ValueError that names the file and the line,
and whatever was left out, averaged or assumed is told in the record's notes.
"""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from torcharm.characterise.columns import Column, Columns, find_columns, told, values_of
from torcharm.characterise.delimited import Sheet, check_damage, numbers, read_sheet
from torcharm.characterise.headers import header_of
from torcharm.characterise.signs import PLAIN, Signs
from torcharm.characterise.stretch import (
    check_other_stretch,
    check_strains,
    known_signs,
    strains_of,
    stretch_quantity,
)
from torcharm.files import StrPath
from torcharm.inputs import check_choice
from torcharm.units import PRESSURE

Array = NDArray[np.float64]
if TYPE_CHECKING:
    Floats = NDArray[np.float64]
else:
    Floats = np.ndarray
Lines = NDArray[np.int64] | None

PLAUSIBLE_PRESSURE = (20.0, 1000.0)
"""Between these [kPa] lies the highest pressure of a recording, or its unit is doubted."""
ATMOSPHERE = (80.0, 108.0)
"""Between these [kPa] lies the pressure of the surroundings: a log that is never below is perhaps absolute."""
NEAR_REST, NO_FORCE = 0.02, 0.1
"""Strains, and shares of pressures' range, that are those at rest; of the largest force, what share is none."""
BACKWARD_STEPS = 3.0
"""By how many usual steps a clock may go back and still be averaged; beyond, samples are out of order."""
MOST_BACKWARD = 0.05
"""Of all samples, how many may do so; three always may."""
EPOCH = (1e9, 2.5e9)
"""Seconds since 1970 of the years 2001 to 2049: no run is as long, so that such times name their own unit."""
POSITIVE = ("pull", "push")
"""What positive forces of a file may do."""
SURROUNDINGS = 101.325
"""The standard atmosphere [kPa], which is taken off absolute pressures."""
CLOCK = {"time": "ms"}
"""The unit of a pressure log's times that name none."""
PSI_LOG = ("Time", "Pressure")
"""The whole header of the logs published with the paper, whose pressures are in psi; others have to name their unit."""


@dataclass(frozen=True, eq=False)
class TesterRecord:
    """What a tensile tester wrote.

    Attributes:
        time: (n) strictly increasing [ms].
        strain: (n) of the actuators, from their neutral length.
        force: (n) on all actuators together [N], positive in tension.
        source: the file.
        notes: what was left out, averaged or assumed.
        signs: of the file's forces and strains, and how they are known.
        line: (n) the number of each sample's line in the file; None for records that come from none.
    """

    time: Float[Floats, " n"]
    strain: Float[Floats, " n"]
    force: Float[Floats, " n"]
    source: str
    notes: tuple[str, ...] = ()
    signs: Signs = PLAIN
    line: Lines = None


@dataclass(frozen=True, eq=False)
class PressureRecord:
    """What a pressure logger wrote.

    Attributes:
        time: (n) strictly increasing [ms].
        pressure: (n) gauge pressure [kPa].
        source: the file.
        notes: what was left out, averaged or assumed.
        as_absolute: the option that says that the file's pressures count from none; "" where that is known.
    """

    time: Float[Floats, " n"]
    pressure: Float[Floats, " n"]
    source: str
    notes: tuple[str, ...] = ()
    as_absolute: str = ""


def read_tester(
    path: StrPath,
    *,
    columns: Columns | None = None,
    gauge_length: float | None = None,
    positive: str | None = None,
    truncated: bool = False,
) -> TesterRecord:
    """Read time, force and strain of a tensile tester's file of columns; units are those that the file names.

    Columns are known by their names (Force or Load, Strain, Extension or Displacement, Length, ...) unless said; others
    are passed over. Stamps that repeat or go back a little are averaged, and damaged lines left out, a few of them.

    Args:
        path: the file.
        columns: which columns hold what, by name or number, and in which unit, where the file does not tell:
            "time=1:ms, extension=5:mm, force=Load:N".
        gauge_length: of the actuators [m]; strain is then the extension over it, or the length over it less 1.
        positive: whether positive forces of the file "pull" or "push". None: those of compressive forces push, others
            are assumed to pull until `align` sees by the samples that they push.
        truncated: whether to accept a file that ends within a line, and drop that line.

    Returns:
        `time` (n) [ms], `strain` (n), and `force` (n) of all actuators together [N], positive in tension.

    Raises:
        ValueError: the file cannot be read, lacks a column or a unit, ends within a line, is damaged in many lines, or
            time goes back. It names file and line.

    Example:
        >>> _ = (path := folder / "run.csv").write_text("Time (s),Stroke (mm),Force (N)\\n0,0,0\\n1,4,2.5\\n2,8,5\\n")
        >>> ta.read_tester(path, gauge_length=0.08).strain.tolist()
        [0.0, 0.05, 0.1]
    """
    return as_tester_record(read_sheet(path), columns, gauge_length, positive=positive, truncated=truncated)


def read_pressure(
    path: StrPath, unit: str | None = None, *, columns: Columns | None = None, truncated: bool = False
) -> PressureRecord:
    """Read time and pressure of a log, or of a file with more columns.

    Units are those that the file names, else ms and `unit`; a header of Time and Pressure alone, as the paper's
    recordings have it, means psi. Times like seconds since 1970 are such. Without a
    header, the first of two columns is the time. A highest pressure that is implausible for a soft actuator (outside 20
    to 1000 kPa) is a warning: it tells of a wrong unit. A log without a closing line, such as "Logging end", is read
    and noted.

    Args:
        path: the file.
        unit: of its pressures, where the file names none.
        columns: as for `read_tester`, of time and pressure.
        truncated: as for `read_tester`.

    Returns:
        `time` (n) [ms] and gauge `pressure` (n) [kPa].

    Raises:
        ValueError: no or unknown unit, or another one than the file names; or as for `read_tester`.

    Example:
        >>> _ = (path := folder / "log.txt").write_text("Time,Pressure\\n0,0\\n10,5\\n20,10\\nLogging end\\n")
        >>> ta.read_pressure(path, unit="psi").pressure.round(1).tolist()  # in kPa
        [0.0, 34.5, 68.9]
    """
    if unit is not None:
        check_choice("unit", unit, PRESSURE)
    return as_pressure_record(read_sheet(path), unit, columns, truncated=truncated)


def as_tester_record(
    sheet: Sheet,
    columns: Columns | None,
    gauge_length: float | None,
    *,
    positive: str | None = None,
    truncated: bool = False,
) -> TesterRecord:
    """`read_tester` of a file that is read."""
    if positive is not None:
        check_choice("positive", positive, POSITIVE)
    check_damage(sheet, truncated=truncated)
    stretch = stretch_quantity(sheet, columns, gauge_length)
    found = find_columns(sheet, ("time", "force", stretch), columns, _clock_unit(sheet, columns))
    table, line, notes = _in_time(sheet, found)
    strain = strains_of(sheet, found[stretch], gauge_length, table[stretch])
    check_other_stretch(sheet, found[stretch], columns, gauge_length)
    check_strains(sheet.source, strain, found[stretch])
    signs = known_signs(found[stretch], squeezes=found["force"].compressive, positive=positive, usual="pull")
    tension = 1.0 if signs.positive == "pull" else -1.0
    return TesterRecord(table["time"], strain, tension * table["force"], sheet.source, notes, signs, line)


def as_pressure_record(
    sheet: Sheet,
    unit: str | None,
    columns: Columns | None,
    *,
    truncated: bool = False,
    alone: bool = True,
    option: str = "--columns",
) -> PressureRecord:
    """`read_pressure` of a file that is read.

    Args:
        sheet, unit, columns, truncated: as there.
        alone: whether it is a logger's own, which may leave units to be known; a tester's file names them.
        option: of the command that names columns, for messages.
    """
    if unit is not None:
        check_choice("unit", unit, PRESSURE)
    check_damage(sheet, truncated=truncated)
    numeric = [place for place, own in enumerate(sheet.form.numeric, 1) if own]
    if not told(columns) and not sheet.above and len(numeric) == 2:
        columns = {"time": numeric[0], "pressure": numeric[1]}
    usual = unit or ("psi" if alone and header_of(sheet).names == PSI_LOG else None)
    defaults = (CLOCK if alone else {}) | ({"pressure": usual} if usual else {}) | _clock_unit(sheet, columns)
    found = find_columns(sheet, ("time", "pressure"), columns, defaults, option)
    pressure = found["pressure"]
    pressure.check_unit(unit, sheet.source, option)
    table, _, notes = _in_time(sheet, found)
    table["pressure"], taken_off = gauge_pressure(table["pressure"], sheet.source, pressure)
    notes = (*notes, *taken_off)
    if not sheet.closing and len(found) == sheet.form.width:
        notes = (*notes, "has no closing line, taken as whole")
    low, high = PLAUSIBLE_PRESSURE
    most = float(table["pressure"].max())
    if not low <= most <= high and table["pressure"].min() > -low:
        warnings.warn(
            f"{sheet.source}: pressures reach {most:.3g} kPa when read as {pressure.unit}, soft actuators are driven "
            f"to {low:g} to {high:g} kPa: is the unit right?",
            stacklevel=3,
        )
    as_absolute = "" if pressure.absolute else f"{option} {pressure.as_absolute}"
    return PressureRecord(table["time"], table["pressure"], sheet.source, notes, as_absolute)


def gauge_pressure(pressure: Array, source: str, column: Column) -> tuple[Array, tuple[str, ...]]:
    """Pressures above that of the surroundings [kPa], and what was assumed for it; a warning, too."""
    if not column.absolute:
        return pressure, ()
    note = f"pressures are absolute: {SURROUNDINGS:g} kPa of the surroundings taken off, assumed"
    warnings.warn(f"{source}: {note}", stacklevel=4)
    return pressure - SURROUNDINGS, (note,)


def ask_if_absolute(
    source: str, option: str, strain: Array, pressure: Array, force: Array, *, rests: bool = True
) -> None:
    """Warn where pressures are never below that of the surroundings, or never above it and never near 0, unless forces
    tell that this is a pressure.

    At its own length an actuator has a force if it is under pressure, and none at that of the surroundings.

    Args:
        source: the file.
        option: what says that its pressures are absolute; "" where that is known.
        strain, pressure [kPa], force: (n).
        rests: whether it is asked where forces tell nothing: runs rest at some time, tables may begin at any pressure.
    """
    low, high = float(pressure.min()), float(pressure.max())
    ends = [end for end in (low, high) if ATMOSPHERE[0] <= end <= ATMOSPHERE[1]]
    if not option or not ends or low < NEAR_REST * high:
        return
    evacuated = ends[0] != low
    at_rest = (np.abs(strain) <= NEAR_REST) & (np.abs(pressure - ends[0]) <= NEAR_REST * np.ptp(pressure))
    none = bool(at_rest.any()) and float(np.abs(force[at_rest]).mean()) < NO_FORCE * float(np.abs(force).max())
    if none or (rests and not evacuated and not at_rest.any()):
        why = ", where the actuator has no force" if none else ""
        warnings.warn(
            f"{source}: pressures are never {'above' if evacuated else 'below'} {ends[0]:.4g} kPa{why}: are they "
            f"absolute? {option} says so{', beside --vacuum' if evacuated else ''}",
            stacklevel=4,
        )


def _clock_unit(sheet: Sheet, columns: Columns | None) -> dict[str, str]:
    """The unit of times that count from 1970, whose size names it; nothing of others."""
    try:
        found = find_columns(sheet, ("time",), columns, CLOCK)
    except ValueError:  # is told when all columns are looked for
        return {}
    first = next(filter(np.isfinite, values_of(sheet, found["time"].index, 50)), np.nan)
    sizes = {"s": 1.0, "ms": 1e3, "µs": 1e6, "ns": 1e9}
    return next(({"time": unit} for unit, size in sizes.items() if EPOCH[0] <= first / size <= EPOCH[1]), {})


def _in_time(
    sheet: Sheet, columns: Mapping[str, Column]
) -> tuple[dict[str, Array], NDArray[np.int64], tuple[str, ...]]:
    """Columns in torcharm's units, time in ms strictly increasing, their lines, and what was done to get there."""
    table, places, notes = numbers(sheet, [column.index for column in columns.values()])
    table = table * [column.factor for column in columns.values()]
    guessed = [f"{c.quantity} in {c.unit}" for c in columns.values() if not c.named]
    notes = (*notes, *([f"names no unit: read {' and '.join(guessed)}"] if guessed else []))
    notes = (*notes, *(note for column in columns.values() for note in column.notes))
    order = list(columns).index("time")
    steps = np.diff(table[:, order])
    if not (steps <= 0).any():
        return dict(zip(columns, table.T, strict=True)), np.array(places), notes
    _check_clock(sheet.source, table[:, order], places)
    averaged = _averaged(np.column_stack((table, places)), order)
    notes = (
        *notes,
        f"{len(table) - len(averaged)} of {len(table)} stamps repeat or step back, averaged with those before them",
    )
    return dict(zip(columns, averaged[:, :-1].T, strict=True)), averaged[:, -1].astype(np.int64), notes


def _check_clock(source: str, time: Array, places: list[int]) -> None:
    """Raise if the clock goes back further, or more often, than jitter does."""
    steps = np.diff(time)
    forward = steps[steps > 0]
    usual = float(np.median(forward)) if len(forward) else 0.0
    behind = np.maximum.accumulate(time) - time
    far = np.flatnonzero(behind > BACKWARD_STEPS * usual)
    often = np.flatnonzero(steps < 0) + 1
    if len(often) <= max(3, MOST_BACKWARD * len(time)):
        often = often[:0]
    late = np.concatenate((far, often))
    if len(late) or not len(forward):
        row = int(late[0]) if len(late) else 1
        raise ValueError(
            f"{source}: line {places[row]}: time must increase, got {time[row]:g} ms, which comes after "
            f"{time[:row].max():g} ms: are lines out of order, or two runs in one file?"
        )


def _averaged(table: Array, order: int) -> Array:
    """Rows (n, k) whose time, in one column, does not increase, averaged with those before them until it does."""
    while True:
        time = table[:, order]
        # A row joins the ones before it unless it is later than all of them.
        later = np.concatenate(([True], time[1:] > np.maximum.accumulate(time)[:-1]))
        if later.all():
            return table
        starts = np.flatnonzero(later)
        count = np.diff(np.append(starts, len(table)))
        table = np.add.reduceat(table, starts, axis=0) / count[:, None]
