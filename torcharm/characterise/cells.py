"""Lines and cells of text files: in whatever encoding, and read with the decimal sign of their file."""

import math
import re
from collections.abc import Sequence
from contextlib import suppress
from datetime import datetime

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
_NO_VALUE = re.compile(
    r"[-–—*?.]*|#?n/?a[!?]?|#num!|#value!|nan|null|none|ol|o\.l\.?|ovld|ovrfl?|over|overload|overflow|over ?range|open",
    re.IGNORECASE,
)
"""What loggers and spreadsheets write where there was no value."""
_DRESSED = re.compile(
    rf"(?P<label>\s*[^\W\d_][^:=,;]{{0,30}}?\s*[:=]\s*)?{NUMBER}(?P<unit>\s*[^\d\s.,;:+-][^\d,;:]{{0,11}}?)?\s*"
)
_MOMENT = re.compile(
    r"(?:(?P<a>\d{1,4})(?P<sign>[-/.])(?P<b>\d{1,2})(?P=sign)(?P<c>\d{1,4})[T\s]\s*)?"
    r"(?(a)|(?=\d+:\d+[:.,]))(?P<clock>\d{1,2}:\d{1,2}(?::\d{1,2})?(?:[.,]\d+)?)"
    r"\s*(?P<half>[AaPp][Mm])?(?P<zone>Z|[+-]\d\d:?\d\d)?"
)


def text_lines(source: str, data: bytes) -> tuple[list[str], bool]:
    """A file's lines by any ending, and whether the last one is ended."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        text = data.decode("utf-16", errors="replace")
    elif b"\0" in data:
        line = data[: data.index(b"\0")].count(b"\n") + 1
        raise ValueError(f"{source}: line {line}: must be text, as CSV is, got a byte 0, as of a program's own format")
    else:
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = data.decode("cp1252", errors="replace")
    # CR, CR LF and the loggers' CR CR LF end one line each.
    lines = (re.sub("\r+\n?", "\n", text) if "\r" in text else text).split("\n")
    ended = not lines[-1].strip()
    return lines[:-1] if lines[-1] == "" else lines, ended


def is_number(cell: str) -> bool:
    """Whether a cell holds a number, by any decimal sign, or a moment."""
    return _IS_NUMBER.fullmatch(cell) is not None or is_moment(cell)


def is_moment(cell: str) -> bool:
    """Whether a cell holds a time of day, minutes and seconds, or a day and a time."""
    return ":" in cell and math.isfinite(_seconds(cell))


def has_value(cell: str) -> bool:
    """Whether a cell holds anything but blanks, or what stands for no value, as `NaN`, `N/A`, `OVLD` or `---`."""
    return cell[:1].isdigit() or _NO_VALUE.fullmatch(cell.strip()) is None


def dress(cell: str) -> tuple[str, str]:
    """What stands before a cell's number, a name, and what behind it, a unit, as in `p: 12.5 kPa`; "" for nothing."""
    found = None if cell[:1].isdigit() and cell[-1:].isdigit() else _DRESSED.fullmatch(cell)
    label, unit = ("", "") if found is None else (found["label"] or "", found["unit"] or "")
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


def number(cell: str, decimal: str) -> float:
    """A cell's number, in seconds for a moment: NaN where it has no value, infinite where that is no number."""
    cell = cell.strip()
    if decimal == ".":  # what Python reads as a number is one, as nearly all cells of long files are
        with suppress(ValueError):
            return float(cell)
    if not has_value(cell):
        return math.nan
    if ":" in cell:
        return _seconds(cell)
    other = "," if decimal == "." else "."
    if _GROUPED[other].fullmatch(cell):
        cell = cell.replace(other, "")
    if other not in cell:
        with suppress(ValueError):
            return float(_BETWEEN_THOUSANDS.sub("", cell).replace(",", "."))
    return math.inf


def _seconds(cell: str) -> float:
    """Seconds since 1970 of a moment, or since midnight without a day; infinite where it is none.

    Two parts without a day are minutes and seconds with a fraction alone: nothing tells others from hours and minutes.
    Days stand as 2024-05-01, 2024/5/1 or 1.5.2024; that of 5/1/2024, which may be in May or in January, is left out.
    """
    found = _MOMENT.fullmatch(cell.strip())
    if found is None:
        return math.inf
    first, middle, last = found["a"] or "", found["b"], found["c"]
    day = (first, middle, last) if len(first) == 4 else (last, middle, first)
    year, month, date = map(int, day) if len(first) == 4 or found["sign"] == "." else (1970, 1, 1)
    year += 2000 * (year < 100)
    clock = [float(part) for part in found["clock"].replace(",", ".").split(":")]
    hour, minute, second = clock if len(clock) == 3 else (*clock, 0.0) if first else (0.0, *clock)
    if found["half"]:
        hour = hour % 12 + 12 * (found["half"][0] in "Pp")
    try:
        start = datetime.fromisoformat(f"{year:04}-{month:02}-{date:02}T00:00{found['zone'] or 'Z'}")
    except ValueError:
        return math.inf
    return start.timestamp() + 3600 * hour + 60 * minute + second
