"""How far a file says that actuators are stretched: as strains, or as lengths over a gauge length; and its signs."""

import warnings
from dataclasses import replace

import numpy as np

from torcharm.characterise.columns import Column, Columns, example, find_columns, has_column, told, values_of
from torcharm.characterise.delimited import Array, Sheet
from torcharm.characterise.headers import header_of
from torcharm.characterise.signs import ASSUMED, NAMED, SAID, Signs
from torcharm.inputs import check_number
from torcharm.units import LENGTH

PLAUSIBLE_STRAIN, LEAST_STRAIN, NEAR_REST = (-0.6, 1.0), 0.02, 0.3
"""Between the first lie the strains of soft actuators; the largest is more than the second, the least no more than the
third: else percents were taken for parts of 1 or these for percents, positions for extensions, forces for strains."""
FAR_FROM_REST = 3.0
"""In widths of their range, how far from 0 lengths all lie that are positions, if further than the gauge length."""
LONGEST_GAUGE = 3.0
"""A gauge length [m] beyond which metres were hardly meant."""
SAME_GAUGE = 0.01
"""By which part two gauge lengths may differ and count as one: files round their strains."""
MOST_ROWS = 2000
"""Of a file, evenly spread, tell as much of its columns as all."""
ALIKE = 0.9
"""The squared correlation of strains and extensions of one actuator, at least: clamps and grips slip."""


def stretch_quantity(sheet: Sheet, columns: Columns | None, gauge_length: float | None) -> str:
    """Which of strain, contraction, extension and length a file is read by.

    Raises:
        ValueError: a gauge length is no such length; two of them are named by a person, or none by the file.
    """
    stretches = ("strain", "contraction", "extension", "length")
    said = [quantity for quantity in told(columns) if quantity in stretches]
    if len(said) > 1:
        raise ValueError(f"columns: must name one of strain, contraction, extension, length, got {' and '.join(said)}")
    if gauge_length is not None:
        check_number("gauge_length", gauge_length, 0.0, strict=True, unit="m")
        if gauge_length > LONGEST_GAUGE:
            raise ValueError(
                f"gauge_length: must be at most {LONGEST_GAUGE:g} m, got {gauge_length:g} m: is it in millimetres? "
                f"Write '{gauge_length:g} mm' then"
            )
        stretches = ("contraction", "extension", "length", "strain")  # with lengths the former go
    found = said or [quantity for quantity in stretches if has_column(sheet, quantity, None)]
    if not found:
        header = header_of(sheet)
        is_log = [has_column(sheet, own, None) for own in ("time", "pressure", "force")] == [True, True, False]
        raise ValueError(
            f"{sheet.source}: line {header.line}: must name one column of strain, contraction, extension or length, "
            f'got {header.none}; --columns says which, as in "{example(sheet, ("extension",), columns)}" or '
            f'"{example(sheet, ("contraction",), columns)}"{"; or is it a log, for --pressure?" * is_log}'
        )
    return found[0]


def strains_of(sheet: Sheet, stretch: Column, gauge_length: float | None, values: Array) -> Array:
    """Strains, positive where longer, of the numbers of a column in torcharm's unit.

    Raises:
        ValueError: they are lengths and there is no gauge length; or the other way round.
    """
    sign = -1.0 if stretch.quantity == "contraction" or stretch.compressive else 1.0
    if stretch.unit not in LENGTH:
        if gauge_length is not None:
            raise ValueError(
                "gauge_length: must stand with extensions or contractions that are lengths, or with lengths, got one "
                f"and {stretch.quantity} in {stretch.unit} in column {stretch.index + 1} of {sheet.source}"
            )
        return sign * values
    if gauge_length is None:
        raise ValueError(
            f"gauge_length: is missing, must be the actuators' length, to which {sheet.source} gives "
            f"{stretch.quantity}s in {stretch.unit} and no strains: --gauge-length '80 mm'"
        )
    return values / gauge_length - 1.0 if stretch.quantity == "length" else sign * values / gauge_length


def check_other_stretch(sheet: Sheet, stretch: Column, columns: Columns | None, gauge_length: float | None) -> None:
    """Warn where strains and lengths of one file do not go together, or mean another gauge length [m] than is given.

    Args:
        sheet: the file.
        stretch: the column that is read.
        columns: what a person says of columns; if so, others do not count.
        gauge_length: of the actuators; None: strains are read.
    """
    quantity = "extension" if stretch.quantity == "strain" else "strain"
    try:
        other = {} if told(columns) else find_columns(sheet, (quantity,), None)
    except ValueError:  # none that is one without doubt
        return
    if not other or (quantity == "strain") == (other[quantity].unit in LENGTH):
        return
    both = stretch, other[quantity]
    rows = [row for row in sheet.rows[:: 1 + len(sheet.rows) // MOST_ROWS] if len(row) > max(c.index for c in both)]
    few = replace(sheet, rows=rows)
    read, rest = (column.factor * values_of(few, column.index) for column in both)
    finite = np.isfinite(read) & np.isfinite(rest)
    read, rest = (values[finite] - values[finite].mean() if finite.any() else values for values in (read, rest))
    together = float(read @ rest)
    if not read.any() or not rest.any():
        return
    if together**2 < ALIKE * float(read @ read) * float(rest @ rest):
        warnings.warn(
            f"{sheet.source}: its strains and its lengths do not go together: is the header right, or are columns "
            "swapped? --columns says which is which",
            stacklevel=4,
        )
        return
    meant = abs(together / float(rest @ rest))
    if gauge_length is not None and abs(meant / gauge_length - 1.0) > SAME_GAUGE:
        warnings.warn(
            f"{sheet.source}: its own strains mean a gauge length of {1e3 * meant:.4g} mm, got "
            f"{1e3 * gauge_length:.4g} mm, which is taken",
            stacklevel=4,
        )


def check_strains(source: str, strain: Array, stretch: Column) -> None:
    """Raise a ValueError about strains that no actuator can have; warn about those implausible for soft ones."""
    if strain.min() <= -1.0:
        raise ValueError(
            f"{source}: strains must be above -1, at which no length is left, got {strain.min():.3g} from "
            f"{stretch.quantity} in {stretch.unit}: are unit and gauge length right, or is this a position?"
        )
    size = np.abs(strain)
    if stretch.unit in LENGTH and size.min() > max(1.0, FAR_FROM_REST * float(np.ptp(strain))):
        raise ValueError(
            f"{source}: strains must count from the actuators' own length, got {strain.min():.3g} to "
            f"{strain.max():.3g}, never near 0: is this a position or a whole length (length=), or is the gauge "
            "length wrong?"
        )
    (low, high), least = PLAUSIBLE_STRAIN, LEAST_STRAIN
    if not low <= strain.min() <= strain.max() <= high or size.max() < least or size.min() > NEAR_REST:
        cells = ", are the cells parts of 1" if size.max() < least and stretch.unit == "%" else ""
        warnings.warn(
            f"{source}: strains are {strain.min():.3g} to {strain.max():.3g}, those of soft actuators near 0 at rest, "
            f"over {least:g} at most and from {low:g} to {high:g}: is this the column of {stretch.quantity}, is its "
            f"unit {stretch.unit}{cells}, is the gauge length right, or are these whole lengths (length=)?",
            stacklevel=4,
        )


def known_signs(stretch: Column, *, squeezes: bool, positive: str | None, usual: str) -> Signs:
    """What a person and the names of columns tell of signs, squeezing forces' among them; else forces do the usual."""
    shortening = f"contraction={stretch.index + 1}:{stretch.unit}"
    if positive is None and not squeezes:
        return Signs(usual, ASSUMED, stretch.sure, shortening)
    return Signs(positive or "push", SAID if positive else NAMED, stretch.sure, shortening)
