"""What stands above a file's numbers: the names of columns, and their units."""

import re
from dataclasses import dataclass

from torcharm.characterise.cells import Row, has_value, is_moment, is_number
from torcharm.characterise.delimited import Sheet, short
from torcharm.units import MEASURED, unit_named

_GAUGE_OR_NOT = re.compile(r"((?:pa|bar|psi|atm|²))\s?\((g|gauge|rel\.?|ü|a|abs\.?|absolute?)\)", re.IGNORECASE)
"""A unit of pressure, and behind it in brackets of its own from where it counts, as in `bar(g)`."""
_UNIT_LABEL = re.compile(r"(?:y[ _])?(?:units?|einheit(?:en)?)(?:[ _]label)?\s*:?", re.IGNORECASE)
"""What stands before a row of units, as in `Unit:` and LabVIEW's `Y_Unit_Label`."""
BRACKETS = re.compile(r"\(([^()]*)\)|\[([^\[\]]*)\]")


@dataclass(frozen=True)
class Header:
    """The names of columns and the texts that stand for their units; "" where there is none.

    Attributes:
        line: of the names.
        names, units: of each column, above the numbers.
        behind: the unit that stands behind each number of a column; seconds for moments.
        moments: whether a column holds times of day.
    """

    line: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    behind: tuple[str, ...]
    moments: tuple[bool, ...]

    @property
    def shown(self) -> str:
        """The names as they stand, shortened."""
        return short(",".join(self.names)) if any(self.names) else "no header"

    @property
    def none(self) -> str:
        """That none of the names is one that is looked for."""
        return f"none in {self.shown}" if any(self.names) else "no names"

    def unit_texts(self, index: int) -> list[str]:
        """What stands behind each number, in the row of units, or in brackets; of moments seconds alone."""
        if self.moments[index]:
            return [self.behind[index]]
        inside = [(a or b).strip() for a, b in BRACKETS.findall(self.names[index])]
        return [text for text in (self.behind[index].strip(), self.units[index].strip("()[] "), *inside) if text]


def header_of(sheet: Sheet) -> Header:
    """The names and units above the numbers; the former may hold the latter."""
    rows = [(place, row) for place, row in reversed(sheet.above[-4:]) if not _UNIT_LABEL.fullmatch(row[0].strip())]
    rows = [(place, row) for place, row in rows if _is_unit_row(row) or sum(bool(cell.strip()) for cell in row) > 1]
    units = _labelled_units(sheet)
    line = rows[0][0] if rows else 1
    if rows and _is_unit_row(rows[0][1]):
        units = rows.pop(0)[1]
    names: Row = []
    words = [sum(1 for cell in row if cell.strip() and not is_number(cell)) for _, row in rows]
    if rows and words[0] >= 2:
        # A line about the file may stand between names and numbers: it fills fewer cells.
        enough = sum(sheet.form.numeric) - 1
        line, names = next((own for own, count in zip(rows, words, strict=True) if count >= enough), rows[0])
        names = _without_comment(names, sheet.form.width)
    width, (labels, units_behind) = sheet.form.width, zip(*sheet.form.dress, strict=True)
    if not names:
        names = [label.strip(" :=\t") for label in labels]
    filled = [tuple(map(_joined, (row + [""] * width)[:width])) for row in (names, units)]
    first = [[row[c] for row in sheet.rows[:20] if len(row) > c and has_value(row[c])] for c in range(width)]
    moments = tuple(bool(cells) and any(map(is_moment, cells)) for cells in first)
    behind = tuple("s" if moment else unit for unit, moment in zip(units_behind, moments, strict=True))
    return Header(line, filled[0], filled[1], behind, moments)


def _without_comment(names: Row, width: int) -> Row:
    """The names without a sign of comment before them; where blanks split them, with their units in brackets."""
    names = names[1:] if names[0].strip() in ("#", "%", "//") else names
    while len(names) > width and (unit := next((k for k, own in enumerate(names) if BRACKETS.fullmatch(own)), 0)):
        names = [*names[: unit - 1], f"{names[unit - 1]} {names[unit]}", *names[unit + 1 :]]
    return names


def _labelled_units(sheet: Sheet) -> Row:
    """The last row that names itself one of units; LabVIEW has seconds before it, where its `X_Dimension` is time."""
    row = next((row for _, row in reversed(sheet.above) if _UNIT_LABEL.fullmatch(row[0].strip())), [])
    timed = any(own[0].strip() == "X_Dimension" and "Time" in own for _, own in sheet.above)
    return ["s" if timed else "", *row[1:]] if row or timed else []


def _is_unit_row(row: Row) -> bool:
    filled = [cell.strip() for cell in row if cell.strip()]
    return bool(filled) and all(_is_unit(cell) for cell in filled)


def _is_unit(cell: str) -> bool:
    return BRACKETS.fullmatch(cell) is not None or any(unit_named(cell, quantity) for quantity in MEASURED)


def plain(name: str) -> str:
    """A name in lower case with a blank between words."""
    return " ".join(_joined(name).lower().replace("_", " ").split())


def base(name: str) -> str:
    """A name without what stands in brackets, in lower case."""
    return plain(BRACKETS.sub(" ", name))


def _joined(name: str) -> str:
    """A name or unit, stripped, with `bar(g)` and `kPa (abs)` as one word each."""
    return _GAUGE_OR_NOT.sub(r"\1\2", name.strip())
