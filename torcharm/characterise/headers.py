"""What stands above a file's numbers: the names of columns and their units, and which quantity each may hold."""

import re
from dataclasses import dataclass

from torcharm.characterise.cells import Row, has_value, is_moment, is_number
from torcharm.characterise.delimited import Sheet, short
from torcharm.units import LENGTH, MEASURED, unit_named

NAMES = {
    "time": r"timestamp|\btime|elapsed(?! cycle)|millis|micros|zeit|\bx value",
    "strain": r"strain|dehnung|stauchung",
    "contraction": r"contraction|shortening|kontraktion|verkürzung",
    "extension": r"extension|displacement|elongation|crosshead|stroke|position|travel|weg\b|traverse|verlängerung",
    "length": r"length|height|länge\b|höhe\b",
    "force": r"force|load|kraft",
    "pressure": r"pressure|druck(?!kraft)",
}
"""What the names of columns hold, in lower case and without units."""
_SYMBOLS = {"time": ("t",), "strain": ("ε", "eps", "epsilon"), "force": ("f",), "pressure": ("p",)}
"""What they are called alone."""
_SET_POINT = re.compile(r"set ?point|target|command|demand|desired|reference|\bref\b|\bset\b|\bsp\b|soll")
"""What was asked for is no measurement."""
STRESS = r"stress|spannung|modul"
"""What testers give in units of pressure, and is none."""
_TOLD_BY_UNIT = ("time", "force", "pressure")
"""Quantities whose units are those of nothing else that a bench records."""
_PREFERRED_ALONE = ("time", "extension", "force")
"""Of which the column of that name alone is taken among several: others, such as a cycle's time, follow it."""
_AMBIGUOUS = ("min", "h", "1", "-", "in", "strain")
"""What names a unit in brackets, or in a row of units, but may mean something else as a word of a name."""
_BETWEEN_WORDS = re.compile(r"[\s_,;/]|(?<=[a-z]{3})(?=[A-Z])")
"""Also in `TimeMs`, but not in `kPa` and `mmHg`."""
_GAUGE_OR_NOT = re.compile(r"((?:pa|bar|psi|atm|²))\s?\((g|gauge|rel\.?|ü|a|abs\.?|absolute?)\)", re.IGNORECASE)
"""A unit of pressure, and behind it in brackets of its own from where it counts, as in `bar(g)`."""
BRACKETS = re.compile(r"\(([^()]*)\)|\[([^\[\]]*)\]")


@dataclass(frozen=True)
class Header:
    """The names of columns, and what stands for their units.

    Attributes:
        line: of the names.
        names: of each column; "" where there is none.
        units: of each column, the texts behind numbers, in the row of units and in brackets; of moments seconds alone.
    """

    line: int
    names: tuple[str, ...]
    units: tuple[tuple[str, ...], ...]

    @property
    def shown(self) -> str:
        """The names as they stand, shortened."""
        return short(",".join(self.names)) if any(self.names) else "no header"


def header_of(sheet: Sheet) -> Header:
    """The names and units above the numbers; the former may hold the latter."""
    rows = [
        (n, row)
        for n, row in reversed(sheet.above[-4:])
        if _is_unit_row(row) or sum(1 for own in row if own.strip()) > 1
    ]
    line = rows[0][0] if rows else 1
    units = rows.pop(0)[1] if rows and _is_unit_row(rows[0][1]) else []
    names: Row = []
    if rows and sum(1 for cell in rows[0][1] if cell.strip() and not is_number(cell)) > 1:
        line, names = rows[0][0], _without_comment(rows[0][1], sheet.width)
    names, blank = names or [label.strip(" :=\t") for label, _ in sheet.dress], [""] * sheet.width
    named, below = (tuple(map(_joined, (row + blank)[: sheet.width])) for row in (names, units))
    texts = []
    for index, name in enumerate(named):
        first = [row[index] for row in sheet.rows[:20] if len(row) > index and has_value(row[index])]
        inside = [(a or b).strip() for a, b in BRACKETS.findall(name)]
        found = (sheet.dress[index][1].strip(), below[index].strip("()[] "), *inside)
        texts.append(("s",) if any(map(is_moment, first)) else tuple(filter(None, found)))
    return Header(line, named, tuple(texts))


def candidates(sheet: Sheet, header: Header, quantity: str) -> list[int]:
    """Columns of numbers that may hold a quantity: by name, those named so alone first; or else by unit."""
    numeric = [i for i in range(sheet.width) if sheet.numeric[i] and not _is_foreign(header.units[i], quantity)]
    own = {i: name for i in numeric if not _SET_POINT.search(name := base(header.names[i]))}
    found = [i for i, name in own.items() if re.search(NAMES[quantity], name) or name in _SYMBOLS.get(quantity, ())]
    if len(found) > 1 and quantity in _PREFERRED_ALONE:
        alone = [i for i in found if re.fullmatch(f"(?:{NAMES[quantity]})s?", own[i])]
        return alone if len(alone) == 1 else found
    if quantity == "strain":  # those that are lengths of the gauge go last
        found = [i for i in found if not any(unit in LENGTH for unit in named_units(header, i, quantity))] or found
    if found or quantity not in _TOLD_BY_UNIT:
        return found
    others = "|".join([STRESS, *(pattern for other, pattern in NAMES.items() if other != quantity)])
    return [i for i in own if named_units(header, i, quantity) and not re.search(others, own[i])]


def named_units(header: Header, index: int, quantity: str) -> list[str]:
    """The units of a quantity that a column's header names: in brackets or below, or else among the words of a name."""
    found = [unit for text in header.units[index] if (unit := unit_named(text, quantity))]
    if not found:
        words = _BETWEEN_WORDS.split(BRACKETS.sub(" ", header.names[index]))
        found = [unit for w in words if w.lower() not in _AMBIGUOUS and (unit := unit_named(w, quantity))]
    return list(dict.fromkeys(found))


def _is_foreign(texts: tuple[str, ...], quantity: str) -> bool:
    """Whether a column's header names a unit of another quantity, and none of this."""
    return not any(unit_named(t, quantity) for t in texts) and any(unit_named(t, q) for t in texts for q in MEASURED)


def _without_comment(names: Row, width: int) -> Row:
    """The names without a sign of comment before them; where blanks split them, with their units in brackets."""
    names = names[1:] if names[0].strip() in ("#", "%", "//") else names
    while len(names) > width and (unit := next((k for k, own in enumerate(names) if BRACKETS.fullmatch(own)), 0)):
        names = [*names[: unit - 1], f"{names[unit - 1]} {names[unit]}", *names[unit + 1 :]]
    return names


def _is_unit_row(row: Row) -> bool:
    """Whether all that stands in a row are units, or in brackets."""
    filled = [cell.strip() for cell in row if cell.strip()]
    return bool(filled) and all(
        BRACKETS.fullmatch(cell) or any(unit_named(cell, quantity) for quantity in MEASURED) for cell in filled
    )


def plain(name: str) -> str:
    """A name in lower case with a blank between words."""
    return " ".join(_joined(name).lower().replace("_", " ").split())


def base(name: str) -> str:
    """A name without what stands in brackets, in lower case."""
    return plain(BRACKETS.sub(" ", name))


def _joined(name: str) -> str:
    """A name or unit, stripped, with `bar(g)` and `kPa (abs)` as one word each."""
    return _GAUGE_OR_NOT.sub(r"\1\2", name.strip())
