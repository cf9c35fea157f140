"""How far a file says that actuators are stretched: as strains, or as lengths over a gauge length."""

import warnings
from collections.abc import Sequence

import numpy as np

from torcharm.characterise.columns import Column, Columns, choices, example, has_column
from torcharm.characterise.delimited import Array, Sheet
from torcharm.characterise.headers import header_of
from torcharm.inputs import check_number
from torcharm.units import LENGTH

STRETCHES = ("strain", "contraction", "extension", "length")
PLAUSIBLE_STRAIN, LEAST_STRAIN, NEAR_REST = (-0.6, 1.0), 0.02, 0.3
"""Between the first lie the strains of soft actuators; the largest is more than the second, the least no more than the
third: else percents were taken for parts of 1 or these for percents, positions for extensions, forces for strains."""
FAR_FROM_REST = 3.0
"""In widths of their range, how far from 0 lengths all lie that are positions, if further than the gauge length."""
MOST_STRAIN = 5.0
"""What no soft actuator reaches: larger numbers are percents."""
LONGEST_GAUGE = 3.0
"""A gauge length [m] beyond which metres were hardly meant."""


def stretch_quantity(sheet: Sheet, columns: Columns | None, gauge_length: float | None, others: Sequence[str]) -> str:
    """Which of strain, contraction, extension and length a file is read by: with a gauge length, by lengths first.

    Args:
        sheet: of a file.
        columns: what a person says of them.
        gauge_length: of the actuators [m], if it is said.
        others: quantities that are read, too, for the message.

    Raises:
        ValueError: a gauge length is no such length; two of them are named by a person, or none by the file.
    """
    said = [quantity for quantity in choices(columns) if quantity in STRETCHES]
    if len(said) > 1:
        raise ValueError(f"columns: must name one of {', '.join(STRETCHES)}, got {' and '.join(said)}")
    if gauge_length is not None:
        check_number("gauge_length", gauge_length, 0.0, strict=True, unit="m")
        if gauge_length > LONGEST_GAUGE:
            raise ValueError(
                f"gauge_length: must be at most {LONGEST_GAUGE:g} m, got {gauge_length:g} m: is it in millimetres? "
                f"Write '{gauge_length:g} mm' then"
            )
    order = STRETCHES if gauge_length is None else (*STRETCHES[1:], STRETCHES[0])
    found = said or [quantity for quantity in order if has_column(sheet, quantity, None)]
    if not found:
        header = header_of(sheet)
        raise ValueError(
            f"{sheet.source}: line {header.line}: must name one column of strain, contraction, extension or length, "
            f"got none in {header.shown}; --columns says which by name or number, as in "
            f'"{example(sheet, (*others, "extension"), columns, {})}"'
        )
    return found[0]


def strains_of(sheet: Sheet, stretch: Column, gauge_length: float | None, values: Array) -> Array:
    """Strains, positive where longer, of the numbers of a column in torcharm's unit; a warning about implausible ones.

    Raises:
        ValueError: they are lengths and there is no gauge length; or the other way round; or they leave no length.
    """
    source, sign = sheet.source, -1.0 if stretch.quantity == "contraction" or stretch.compressive else 1.0
    is_length = stretch.unit in LENGTH
    if not is_length and gauge_length is not None:
        raise ValueError(
            "gauge_length: must stand with extensions or contractions that are lengths, or with lengths, got one "
            f"and {stretch.quantity} in {stretch.unit} in column {stretch.index + 1} of {source}"
        )
    if is_length and gauge_length is None:
        raise ValueError(
            f"gauge_length: is missing, must be the actuators' length, to which {source} gives "
            f"{stretch.quantity}s in {stretch.unit} and no strains: --gauge-length '80 mm'"
        )
    strain = values / (gauge_length or 1.0)
    strain = strain - 1.0 if stretch.quantity == "length" else sign * strain + 0.0  # which turns -0.0 into 0
    if not -1.0 < strain.min() <= strain.max() <= MOST_STRAIN:
        raise ValueError(
            f"{source}: strains must be above -1, at which no length is left, and at most {MOST_STRAIN:g}, got "
            f"{strain.min():.3g} to {strain.max():.3g} from {stretch.quantity} in {stretch.unit}: is this a position, "
            "or are unit or gauge length others? --columns says the unit, as in "
            f'"{stretch.quantity}={stretch.index + 1}:%"'
        )
    (low, high), size = PLAUSIBLE_STRAIN, np.abs(strain)
    if is_length and size.min() > max(1.0, FAR_FROM_REST * float(np.ptp(strain))):
        raise ValueError(
            f"{source}: strains must count from the actuators' own length, got {strain.min():.3g} to "
            f"{strain.max():.3g}, never near 0: is this a position or a whole length (length=), or is the gauge "
            "length wrong?"
        )
    if not low <= strain.min() <= strain.max() <= high or size.max() < LEAST_STRAIN or size.min() > NEAR_REST:
        cells = ", are the cells parts of 1" if size.max() < LEAST_STRAIN and stretch.unit == "%" else ""
        warnings.warn(
            f"{source}: strains are {strain.min():.3g} to {strain.max():.3g}, those of soft actuators near 0 at rest, "
            f"over {LEAST_STRAIN:g} at most and from {low:g} to {high:g}: is this the column of {stretch.quantity}, is "
            f"its unit {stretch.unit}{cells}, is the gauge length right, or are these whole lengths (length=)?",
            stacklevel=4,
        )
    return strain
