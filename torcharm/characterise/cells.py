"""Cells that hold numbers: told from words, and read with the decimal sign of their file."""

import math
import re
from collections.abc import Sequence
from datetime import date

from torcharm.units import MEASURED, unit_named

Row = list[str]

NUMBER = r"[+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][+-]?\d+)?"
_IS_NUMBER = re.compile(rf"\s*(?:{NUMBER}|[+-]?\d{{1,3}}(?:[.,'\u00a0\u202f]\d{{3}})+(?:[.,]\d+)?)\s*")
_GROUPED = {
    ",": re.compile(r"\s*[+-]?[1-9]\d{0,2}(?:,\d{3})+(?:\.\d*)?\s*"),
    ".": re.compile(r"\s*[+-]?[1-9]\d{0,2}(?:\.\d{3})+(?:,\d*)?\s*"),
}
"""Numbers with a sign between thousands, none of which begins with 0: `0,515` has a decimal comma."""
_BETWEEN_THOUSANDS = re.compile(r"(?<=\d)['\u00a0\u202f](?=\d{3})")
_DRESSED = re.compile(
    rf"(?P<label>\s*[^\W\d_][^:=,;]{{0,30}}?\s*[:=]\s*)?{NUMBER}(?P<unit>\s*[^\d\s.,;:+-][^\d,;:]{{0,11}}?)?\s*"
)
_NO_VALUE = re.compile(
    r"[-–—*?.]*|#?n/?a[!?]?|#num!|#value!|nan|null|none|ol|o\.l\.?|ovld|ovrfl?|over|overload|overflow|over ?range|open",
    re.IGNORECASE,
)
"""What loggers and spreadsheets write where there was no value."""
_DAY = r"(?P<a>\d{1,4})(?P<sign>[-/.])(?P<b>\d{1,2})(?P=sign)(?P<c>\d{1,4})"
_MOMENT = re.compile(
    rf"\s*(?:{_DAY}[T\s]\s*)?(?:(?P<h>\d{{1,2}}):(?=\d+:)|(?=\d+:\d+[.,]))(?P<min>\d{{1,2}}):(?P<s>\d{{1,2}}(?:[.,]\d+)?)\s*(?P<half>[AaPp])?[Mm]?"
    r"(?P<zone>Z|[+-]\d\d:?\d\d)?\s*"
)
EPOCH_DAY = date(1970, 1, 1).toordinal()


def is_number(cell: str) -> bool:
    """Whether a cell holds a number, by any decimal sign, or a moment."""
    return _IS_NUMBER.fullmatch(cell) is not None or is_moment(cell)


def is_moment(cell: str) -> bool:
    """Whether a cell holds a time: `2024-05-01T12:00:01`, `12:00:01`, or minutes and seconds as `00:01.5`."""
    return ":" in cell and _MOMENT.fullmatch(cell) is not None


def has_value(cell: str) -> bool:
    """Whether a cell holds anything but blanks, or what stands for no value, as `NaN`, `N/A`, `OVLD` or `---`."""
    return cell[:1].isdigit() or _NO_VALUE.fullmatch(cell.strip()) is None


def dress(cell: str) -> tuple[str, str]:
    """What stands before a cell's number, a name, and what behind it, a unit, as in `p: 12.5 kPa`; "" for nothing."""
    found = None if cell[:1].isdigit() and cell[-1:].isdigit() else _DRESSED.fullmatch(cell)
    if found is None:
        return "", ""
    label, unit = found["label"] or "", found["unit"] or ""
    return (label, unit) if not unit or any(unit_named(unit, quantity) for quantity in MEASURED) else ("", "")


def decimal_sign(rows: Sequence[Row], separator: str) -> tuple[str, bool]:
    """The decimal sign of numbers, and whether it is sure: it is not where each comma may stand between thousands.

    A comma is one where it is told from a comma between thousands, by its digits or as the only sign in files that
    commas do not separate; in comma-separated files `"1,234"` is a thousand and some.
    """
    cells = [cell for row in rows for cell in row if _IS_NUMBER.fullmatch(cell) and ("," in cell or "." in cell)]
    commas, points = [c for c in cells if "," in c], [c for c in cells if "." in c]
    if not commas:
        return "," if any(c.count(".") > 1 for c in points) else ".", True
    both = [c for c in commas if "." in c]
    if both:
        return "," if both[0].rindex(",") > both[0].rindex(".") else ".", True
    if any(c.count(",") > 1 for c in commas):
        return ".", True
    grouped = all(_GROUPED[","].fullmatch(c) for c in commas)
    decimal_points = any(not _GROUPED["."].fullmatch(c) for c in points)
    return "." if decimal_points or (separator == "," and grouped) else ",", not grouped


def number(cell: str, decimal: str, *, sparse: bool = False) -> float:
    """A cell's number, in seconds for a moment: NaN for none that is finite.

    Where cells may be empty NaN is for those, and for what stands for no value, and inf for what is no number.
    """
    cell = cell.strip()
    other = "," if decimal == "." else "."
    none = math.inf if sparse else math.nan
    if sparse and not has_value(cell):
        return math.nan
    if ":" in cell:
        return _seconds(cell, none)
    if other in cell:
        if not _GROUPED[other].fullmatch(cell):
            return none
        cell = cell.replace(other, "")
    try:
        found = float(_BETWEEN_THOUSANDS.sub("", cell).replace(",", "."))
    except ValueError:
        return none
    return found if math.isfinite(found) else none


def _seconds(cell: str, none: float) -> float:
    """Seconds since 1970 of a moment; since midnight without a date, or with one that may be read in two ways."""
    found = _MOMENT.fullmatch(cell)
    if found is None:
        return none
    hour, minute, second = int(found["h"] or 0), int(found["min"]), float(found["s"].replace(",", "."))
    if found["half"]:
        hour = hour % 12 + (12 if found["half"] in "Pp" else 0)
    days = 0
    if found["sign"] and (len(found["a"]) == 4 or found["sign"] == "."):
        year, month, day = (int(found[part]) for part in ("abc" if len(found["a"]) == 4 else "cba"))
        try:
            days = date(year + (2000 if year < 100 else 0), month, day).toordinal() - EPOCH_DAY
        except ValueError:
            return none
    zone = found["zone"] or "Z"
    ahead = 0 if zone == "Z" else int(zone[0] + "1") * (60 * int(zone[1:3]) + int(zone[-2:]))
    return 60.0 * (60 * (24 * days + hour) + minute - ahead) + second
