"""Cells that hold numbers: told from words, and read with the decimal sign of their file."""

import math
import re
from collections.abc import Sequence

Row = list[str]

NUMBER = r"[+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][+-]?\d+)?"
_IS_NUMBER = re.compile(rf"\s*(?:{NUMBER}|[+-]?\d{{1,3}}(?:[.,'\u00a0\u202f]\d{{3}})+(?:[.,]\d+)?)\s*")
_GROUPED = {
    ",": re.compile(r"\s*[+-]?\d{1,3}(?:,\d{3})+(?:\.\d*)?\s*"),
    ".": re.compile(r"\s*[+-]?\d{1,3}(?:\.\d{3})+(?:,\d*)?\s*"),
}
_BETWEEN_THOUSANDS = re.compile(r"(?<=\d)['\u00a0\u202f](?=\d{3})")


def is_number(cell: str) -> bool:
    """Whether a cell holds a number, by any decimal sign."""
    return _IS_NUMBER.fullmatch(cell) is not None


def decimal_sign(rows: Sequence[Row], separator: str) -> str:
    """The decimal sign of numbers.

    A comma is one where it is told from a comma between thousands, by its digits or as the only sign in files that
    commas do not separate; in comma-separated files `"1,234"` is a thousand and some.
    """
    cells = [cell for row in rows for cell in row if is_number(cell) and ("," in cell or "." in cell)]
    commas, points = [c for c in cells if "," in c], [c for c in cells if "." in c]
    if not commas:
        return "," if any(c.count(".") > 1 for c in points) else "."
    both = [c for c in commas if "." in c]
    if both:
        return "," if both[0].rindex(",") > both[0].rindex(".") else "."
    if any(c.count(",") > 1 for c in commas) or (points and not all(_GROUPED["."].fullmatch(c) for c in points)):
        return "."
    return "." if separator == "," and all(_GROUPED[","].fullmatch(c) for c in commas) else ","


def number(cell: str, decimal: str, *, sparse: bool = False) -> float:
    """A cell's number: NaN for none that is finite; where cells may be empty NaN for those, and inf for none."""
    cell = cell.strip()
    other = "," if decimal == "." else "."
    none = math.inf if sparse else math.nan
    if sparse and not cell:
        return math.nan
    if other in cell:
        if not _GROUPED[other].fullmatch(cell):
            return none
        cell = cell.replace(other, "")
    try:
        found = float(_BETWEEN_THOUSANDS.sub("", cell).replace(",", "."))
    except ValueError:
        return none
    return found if math.isfinite(found) else none
