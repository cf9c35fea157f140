"""Reading what a test bench wrote: a tensile tester's file and a pressure log, or one file that holds both.

The tester pulls a number of actuators in parallel and writes time, force and strain, or an extension; a logger writes
the pressure in them. Neither is trusted: what is wrong with a file is a ValueError that names the file and the line,
and whatever was left out, averaged or assumed is told in the record's notes.
"""

import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from torcharm.characterise.columns import Column, Columns, check_one_header, choices, find_columns
from torcharm.characterise.delimited import Sheet, numbers, read_sheet, values_of
from torcharm.characterise.headers import header_of
from torcharm.characterise.signs import OTHER, Signs, known_signs
from torcharm.characterise.stretch import STRETCHES, strains_of, stretch_quantity
from torcharm.files import StrPath
from torcharm.inputs import check_choice
from torcharm.units import LENGTH, PRESSURE

Array = NDArray[np.float64]
if TYPE_CHECKING:
    Floats = NDArray[np.float64]
else:
    Floats = np.ndarray

PLAUSIBLE_PRESSURE = (20.0, 1000.0)
"""Between these [kPa] lies the highest pressure of a recording, or its unit is doubted."""
BACKWARD_STEPS = 3.0
"""By how many usual steps a clock may go back and still be averaged; beyond, samples are out of order."""
MOST_BACKWARD = 0.05
"""Of all samples, how many may do so; three always may."""
SURROUNDINGS = 101.325
"""The standard atmosphere [kPa], which is taken off absolute pressures."""
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
        gauge_length: [m] that strains were read by; None: they are the file's own.
        beside: what columns of the file tell of strain, extension [m] and pressure [kPa], whether read or not.
    """

    time: Float[Floats, " n"]
    strain: Float[Floats, " n"]
    force: Float[Floats, " n"]
    source: str
    notes: tuple[str, ...] = ()
    signs: Signs = Signs()  # noqa: RUF009
    gauge_length: float | None = None
    beside: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class PressureRecord:
    """What a pressure logger wrote.

    Attributes:
        time: (n) strictly increasing [ms].
        pressure: (n) gauge pressure [kPa].
        source: the file.
        notes: what was left out, averaged or assumed.
    """

    time: Float[Floats, " n"]
    pressure: Float[Floats, " n"]
    source: str
    notes: tuple[str, ...] = ()


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
    if positive is not None:
        check_choice("positive", positive, OTHER)
    sheet = read_sheet(path, truncated=truncated)
    stretch = stretch_quantity(sheet, columns, gauge_length, ("time", "force"))
    found = find_columns(sheet, ("time", "force", stretch), columns)
    table, notes = _in_time(sheet, found)
    strain = strains_of(sheet, found[stretch], gauge_length, table[stretch])
    signs = known_signs(found["force"], found[stretch], positive, "pull")
    tension = 1.0 if signs.positive == "pull" else -1.0
    force, beside = tension * table["force"], _beside(sheet, columns)
    return TesterRecord(table["time"], strain, force, sheet.source, notes, signs, gauge_length, beside)


def read_pressure(
    path: StrPath, unit: str | None = None, *, columns: Columns | None = None, truncated: bool = False
) -> PressureRecord:
    """Read time and pressure of a log, or of a file with more columns.

    Units are those that the file names, else ms and `unit`; a header of Time and Pressure alone, as the paper's
    recordings have it, means psi. Without a header, the first of two columns is the time. A highest pressure that is
    implausible for a soft actuator (outside 20 to 1000 kPa) is a warning: it tells of a wrong unit. A log without a
    closing line, such as "Logging end", is read and noted.

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
    sheet = read_sheet(path, truncated=truncated)
    numeric = [place for place, own in enumerate(sheet.numeric, 1) if own]
    if not choices(columns) and not sheet.above and len(numeric) == 2:
        columns = {"time": numeric[0], "pressure": numeric[1]}
    usual = unit or ("psi" if header_of(sheet).names == PSI_LOG else None)
    defaults = {"time": "ms"} | ({"pressure": usual} if usual else {})
    found = find_columns(sheet, ("time", "pressure"), columns, defaults)
    found["pressure"].check_unit(unit, sheet.source)
    table, notes = _in_time(sheet, found)
    pressure, taken_off = gauge_pressure(table["pressure"], sheet.source, found["pressure"])
    whole = sheet.closing or len(found) < sheet.width
    notes = (*notes, *taken_off, *(() if whole else ("has no closing line, taken as whole",)))
    low, high = PLAUSIBLE_PRESSURE
    if not low <= pressure.max() <= high and pressure.min() > -low:
        warnings.warn(
            f"{sheet.source}: pressures reach {pressure.max():.3g} kPa when read as {found['pressure'].unit}, soft "
            f"actuators are driven to {low:g} to {high:g} kPa: is the unit right?",
            stacklevel=2,
        )
    return PressureRecord(table["time"], pressure, sheet.source, notes)


def gauge_pressure(pressure: Array, source: str, column: Column) -> tuple[Array, tuple[str, ...]]:
    """Pressures above that of the surroundings [kPa], and what was assumed for it; a warning, too."""
    if not column.absolute:
        return pressure, ()
    note = f"pressures are absolute: {SURROUNDINGS:g} kPa of the surroundings taken off, assumed"
    warnings.warn(f"{source}: {note}", stacklevel=3)
    return pressure - SURROUNDINGS, (note,)


def _beside(sheet: Sheet, columns: Columns | None) -> dict[str, Array]:
    """Strains, extensions [m] and pressures [kPa] that a header names, read or not; no stretch if a person does."""
    rows = [row for row in sheet.rows if len(row) >= sheet.width]
    found = {}
    for quantity in ("pressure",) if set(STRETCHES) & set(choices(columns)) else ("strain", "extension", "pressure"):
        with suppress(ValueError):  # none that is one without doubt
            own = find_columns(sheet, (quantity,), None)[quantity]
            values = own.factor * values_of([row[own.index] for row in rows], sheet.decimal)
            if (own.unit in LENGTH) == (quantity == "extension"):
                found[quantity] = values - SURROUNDINGS * own.absolute
    return found


def _in_time(sheet: Sheet, columns: Mapping[str, Column]) -> tuple[dict[str, Array], tuple[str, ...]]:
    """Columns in torcharm's units, time in ms strictly increasing, and what was done to get there."""
    check_one_header(sheet)
    table, places, left_out = numbers(sheet, [column.index for column in columns.values()])
    table = table * [column.factor for column in columns.values()]
    guessed = [f"{c.quantity} in {c.unit}" for c in columns.values() if not c.named]
    notes = [*left_out, *([f"names no unit: read {' and '.join(guessed)}"] if guessed else [])]
    notes += [note for column in columns.values() for note in column.notes]
    order, count = list(columns).index("time"), len(table)
    if (np.diff(table[:, order]) <= 0).any():
        _check_clock(sheet.source, table[:, order], places)
        table = _averaged(table, order)
        notes.append(f"{count - len(table)} of {count} stamps repeat or step back, averaged with those before them")
    return dict(zip(columns, table.T, strict=True)), tuple(notes)


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
