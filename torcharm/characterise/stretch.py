"""How far a file says that actuators are stretched: as strains, or as lengths over a gauge length; and its signs."""

import warnings

import numpy as np

from torcharm.characterise.columns import Column, Columns, example, find_columns, has_column, told
from torcharm.characterise.delimited import Array, Sheet
from torcharm.characterise.headers import header_of
from torcharm.characterise.signs import ASSUMED, NAMED, SAID, Signs
from torcharm.inputs import check_number
from torcharm.units import LENGTH

PLAUSIBLE_STRAIN = (0.01, 5.0)
"""Between these lies the largest strain, or percents were taken for parts of 1, or these for percents."""
FAR_FROM_REST = 3.0
"""In widths of their range, how far from 0 lengths all lie that are positions, if further than the gauge length."""
LONGEST_GAUGE = 3.0
"""A gauge length [m] beyond which metres were hardly meant."""
SAME_GAUGE = 0.01
"""By which part two gauge lengths may differ and count as one: files round their strains."""


def stretch_quantity(sheet: Sheet, columns: Columns | None, gauge_length: float | None) -> str:
    """Which of strain, contraction and extension a file is read by.

    Raises:
        ValueError: a gauge length is no such length; two of the three are named by a person, or none by the file.
    """
    stretches = ("strain", "contraction", "extension")
    said = [quantity for quantity in told(columns) if quantity in stretches]
    if len(said) > 1:
        raise ValueError(f"columns: must name one of strain, contraction and extension, got {' and '.join(said)}")
    if gauge_length is not None:
        check_number("gauge_length", gauge_length, 0.0, strict=True, unit="m")
        if gauge_length > LONGEST_GAUGE:
            raise ValueError(
                f"gauge_length: must be at most {LONGEST_GAUGE:g} m, got {gauge_length:g} m: is it in millimetres? "
                f"Write '{gauge_length:g} mm' then"
            )
        stretches = ("contraction", "extension", "strain")  # with lengths the former two go
    found = said or [quantity for quantity in stretches if has_column(sheet, quantity, None)]
    if not found:
        header = header_of(sheet)
        raise ValueError(
            f"{sheet.source}: line {header.line}: must name one column of strain, contraction or extension, got "
            f'{header.none}; --columns says which, as in "{example(sheet, ("extension",), columns)}" or '
            f'"{example(sheet, ("contraction",), columns)}"'
        )
    return found[0]


def strain_scale(sheet: Sheet, stretch: Column, gauge_length: float | None) -> float:
    """What the numbers of a column, in torcharm's unit, are multiplied with to be strains, positive where longer.

    Raises:
        ValueError: they are lengths and there is no gauge length; or the other way round.
    """
    sign = -1.0 if stretch.quantity == "contraction" or stretch.compressive else 1.0
    if stretch.unit not in LENGTH:
        if gauge_length is not None:
            raise ValueError(
                "gauge_length: must stand with extensions or contractions that are lengths, got one and "
                f"{stretch.quantity} in {stretch.unit} in column {stretch.index + 1} of {sheet.source}"
            )
        return sign
    if gauge_length is None:
        raise ValueError(
            f"gauge_length: is missing, must be the actuators' length, to which {sheet.source} gives "
            f"{stretch.quantity}s in {stretch.unit} and no strains: --gauge-length '80 mm'"
        )
    return sign / gauge_length


def own_strains(sheet: Sheet, quantity: str, columns: Columns | None, gauge_length: float | None) -> dict[str, Column]:
    """The column of strains beside lengths that are read by a gauge length; nothing where there is none, or where a
    person says which columns count."""
    if gauge_length is None or quantity == "strain" or told(columns):
        return {}
    try:
        return find_columns(sheet, ("strain",), None)
    except ValueError:  # none that is one without doubt
        return {}


def check_gauge_length(source: str, length: Array, strain: Array, gauge_length: float) -> None:
    """Warn where a file's own strains are not its lengths [m] over the gauge length [m]."""
    spread = strain - strain.mean()
    if not spread.any():
        return
    meant = abs(float(spread @ length) / float(spread @ spread))
    if abs(meant / gauge_length - 1.0) > SAME_GAUGE:
        warnings.warn(
            f"{source}: its own strains mean a gauge length of {1e3 * meant:.4g} mm, got {1e3 * gauge_length:.4g} mm, "
            "which is taken",
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
            f"{strain.max():.3g}, never near 0: is this a position, or is the gauge length wrong?"
        )
    low, high = PLAUSIBLE_STRAIN
    most = float(size.max())
    if not low <= most <= high:
        how = f"more than {high:g}" if most > high else f"less than {low:g}"
        cells = ", or are the cells parts of 1" if most < low and stretch.unit == "%" else ""
        warnings.warn(
            f"{source}: strains reach {most:.3g}, {how}: is the unit of {stretch.quantity}, {stretch.unit}, right"
            f"{cells}?",
            stacklevel=4,
        )


def known_signs(stretch: Column, *, squeezes: bool, positive: str | None, usual: str) -> Signs:
    """What a person and the names of columns tell of signs, squeezing forces' among them; else forces do the usual."""
    shortening = f"contraction={stretch.index + 1}:{stretch.unit}"
    if positive is None and not squeezes:
        return Signs(usual, ASSUMED, stretch.sure, shortening)
    return Signs(positive or "push", SAID if positive else NAMED, stretch.sure, shortening)
