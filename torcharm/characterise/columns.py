"""Which column of a file holds what, and in which unit: told from its header, or said by a person."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from torcharm.characterise.cells import Row, has_value, is_moment, is_number
from torcharm.characterise.delimited import Sheet, short
from torcharm.inputs import check_choice, shown
from torcharm.units import LENGTH, MEASURED, PRESSURE, is_absolute, unit_named

Columns = str | Mapping[str, str | int]
"""`"time=Time:s, force=4"` or `{"time": "Time:s", "force": 4}`: names or numbers from 1, perhaps with a unit."""

_NAMED = {
    "time": r"timestamp|\btime|elapsed(?! cycle)|millis|zeit|\bx value",
    "strain": r"strain|dehnung|stauchung",
    "contraction": r"contraction|shortening|kontraktion|verkürzung",
    "extension": r"extension|displacement|elongation|crosshead|stroke|position|weg\b|traverse|verlängerung",
    "force": r"force|load|kraft",
    "pressure": r"pressure|druck(?!kraft)",
}
"""What the names of columns hold, in lower case and without units."""
_SYMBOLS = {"time": ("t",), "strain": ("ε", "eps", "epsilon"), "force": ("f",), "pressure": ("p",)}
"""What they are called alone."""
_SET_POINT = re.compile(r"set ?point|target|command|demand|desired|reference|\bref\b|\bset\b|\bsp\b|soll")
"""What was asked for is no measurement."""
_TOLD_BY_UNIT = ("time", "force", "pressure")
"""Quantities whose units are those of nothing else that a bench records."""
_COMPRESSIVE = re.compile(r"compressi|stauchung|druckkraft")
"""What a tester names so is positive where it squeezes: such strains and extensions shorten, such forces push."""
_LENGTHENING = re.compile(r"extension|elongation|verlängerung|tensile|tension|dehnung")
"""What is positive where longer; strokes and positions count either way."""
_ABSOLUTE = re.compile(r"(?<![a-z])abs(?![a-z])|absolut")
_GAUGE_OR_NOT = re.compile(r"(?<=[A-Za-z²])\s?\((g|gauge|rel\.?|ü|a|abs\.?|absolute?)\)", re.IGNORECASE)
"""What follows a unit of pressure in brackets of its own, as in `bar(g)`."""
_PREFERRED_ALONE = ("time", "extension", "force")
"""Of which the column of that name alone is taken among several: others, such as a cycle's time, follow it."""
_AMBIGUOUS = ("min", "h", "1", "-", "in", "g")
"""What names a unit in brackets, or in a row of units, but may mean something else as a word of a name."""
_BRACKETS = re.compile(r"\(([^()]*)\)|\[([^\[\]]*)\]")
USUAL_UNIT = {"time": "s", "strain": "%", "contraction": "%", "extension": "mm", "force": "N", "pressure": "kPa"}
"""What examples in messages name."""
_OPTION = re.compile(r"(?:^|,)\s*([A-Za-z_]+)\s*=")


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


@dataclass(frozen=True)
class Column:
    """A column that holds a quantity.

    Attributes:
        index: counted from 0.
        unit: canonical; "" if neither the file nor a person named it, and no default holds.
        named: whether the file or a person named it.
        compressive: whether it is named so: positive where it squeezes.
        sure: whether its name tells which way a stretch counts.
        absolute: whether its pressures are named so: counted from none, and not from that of the surroundings.
    """

    quantity: str
    index: int
    unit: str
    named: bool
    compressive: bool = False
    sure: bool = False
    absolute: bool = False

    @property
    def factor(self) -> float:
        """One of its unit in torcharm's."""
        return MEASURED[self.quantity][self.unit]

    def check_unit(self, said: str | None, source: str, option: str) -> None:
        """Raise a ValueError if a person says another unit of pressures than was named."""
        if said is not None and self.named and self.factor != PRESSURE[said]:
            raise ValueError(f"unit: must be left out or be {self.unit}, which {source} or {option} names, got {said}")


@dataclass(frozen=True)
class _Choice:
    """What a person says of a column: its name or number, "" for none, and its unit, None for none."""

    column: str
    unit: str | None
    absolute: bool = False


def header_of(sheet: Sheet) -> Header:
    """The names and units above the numbers; the former may hold the latter."""
    rows = list(reversed(sheet.above[-4:]))
    units: Row = []
    line = rows[0][0] if rows else 1
    if rows and _is_unit_row(rows[0][1]):
        units = rows.pop(0)[1]
    names: Row = []
    if rows and sum(1 for cell in rows[0][1] if cell.strip() and not is_number(cell)) >= 2:
        line, names = rows[0]
    width, (labels, units_behind) = sheet.form.width, zip(*sheet.form.dress, strict=True)
    if not names:
        names = [label.strip(" :=\t") for label in labels]
    filled = [tuple(map(_joined, (row + [""] * width)[:width])) for row in (names, units)]
    first = [[row[c] for row in sheet.rows[:20] if len(row) > c and has_value(row[c])] for c in range(width)]
    moments = tuple(bool(cells) and any(map(is_moment, cells)) for cells in first)
    behind = tuple("s" if moment else unit for unit, moment in zip(units_behind, moments, strict=True))
    return Header(line, filled[0], filled[1], behind, moments)


def find_columns(
    sheet: Sheet,
    quantities: Sequence[str],
    columns: Columns | None,
    defaults: Mapping[str, str] | None = None,
    option: str = "--columns",
) -> dict[str, Column]:
    """The column of each quantity, and its unit.

    Args:
        sheet: of a file.
        quantities: of `units.MEASURED`.
        columns: what a person says of them.
        defaults: units where nobody names one.
        option: of the command that says it, for messages.

    Raises:
        ValueError: a column is not found, or more than one; its unit is not known; or the file and a person differ.
    """
    header, choices = header_of(sheet), _choices(columns)
    _check_one_header(sheet, header)
    found = {q: _column(sheet, header, q, choices.get(q), (defaults or {}).get(q, ""), option) for q in quantities}
    taken: dict[int, str] = {}
    for quantity, column in found.items():
        if taken.setdefault(column.index, quantity) != quantity:
            raise ValueError(
                f"{sheet.source}: line {header.line}: {quantity} must be in another column than "
                f"{taken[column.index]}, got {column.index + 1} for both; {option} says which"
            )
    return found


def has_column(sheet: Sheet, quantity: str, columns: Columns | None) -> bool:
    """Whether a quantity is said to have a column, or the header names one or more."""
    return quantity in _choices(columns) or bool(_candidates(sheet, header_of(sheet), quantity))


def named_by(quantity: str) -> str:
    """A regular expression that finds the name of a quantity in lower case."""
    return _NAMED[quantity]


def is_compressive(name: str) -> bool:
    """Whether a name says that what is positive squeezes."""
    return _COMPRESSIVE.search(name.lower()) is not None


def is_sure(quantity: str, name: str) -> bool:
    """Whether a quantity or a name says which way a stretch counts: contraction, compressive, extension, tensile."""
    return quantity == "contraction" or is_compressive(name) or _LENGTHENING.search(name.lower()) is not None


def told(columns: Columns | None) -> list[str]:
    """The quantities of which a person says something."""
    return list(_choices(columns))


def _choices(columns: Columns | None) -> dict[str, _Choice]:
    if columns is None:
        return {}
    if isinstance(columns, str):
        start, *rest = _OPTION.split(columns)
        if start.strip() or not rest:
            raise ValueError(f"columns: must be as in 'time=Time:s, force=4', got {shown(columns)}")
        pairs = list(zip(rest[::2], rest[1::2], strict=True))
    else:
        pairs = [(key, str(value)) for key, value in columns.items()]
    found: dict[str, _Choice] = {}
    for key, value in pairs:
        quantity = key.strip().lower()
        check_choice("columns", quantity, MEASURED)
        if quantity in found:
            raise ValueError(f"columns: must name {quantity} once, got it twice in {shown(columns)}")
        found[quantity] = _choice(quantity, value.strip())
    return found


def _choice(quantity: str, text: str) -> _Choice:
    column, colon, last = text.rpartition(":")
    unit = unit_named(last, quantity) if colon else None
    if unit is not None:
        return _Choice(column.strip(), unit, is_absolute(last))
    if colon and (column.strip().isdigit() or not column.strip()):
        raise ValueError(f"columns: {quantity}: {_allowed(quantity)}, got {shown(last)}")
    if not text:
        raise ValueError(f"columns: {quantity}: must be a column's name or number, got none")
    return _Choice(text, None)


def _column(sheet: Sheet, header: Header, quantity: str, choice: _Choice | None, default: str, option: str) -> Column:
    if choice is not None and choice.column:
        index = _chosen(sheet, header, quantity, choice.column)
    else:
        found = _candidates(sheet, header, quantity)
        if len(found) != 1:
            raise ValueError(_not_one(sheet, header, quantity, found, option))
        (index,) = found
    named, unknown = _units(header, index, quantity)
    where = f"{sheet.source}: line {header.line}"
    if len(named) > 1:
        raise ValueError(f"{where}: must name one unit of {quantity}, got {' and '.join(named)}")
    said = choice.unit if choice is not None else None
    if said is not None and named and MEASURED[quantity][said] != MEASURED[quantity][named[0]]:
        raise ValueError(
            f"columns: {quantity}: must be left without a unit or be in {named[0]}, which {sheet.source} names in line "
            f"{header.line}, {header.shown}, got {said}"
        )
    unit = said or (named[0] if named else "")
    if not unit and (unknown or not default):
        got = f"{unknown!r} in {header.shown}" if unknown else f"none in {header.shown}"
        raise ValueError(
            f"{where}: {_allowed(quantity)}, got {got}; {option} says it, "
            f'as in "{quantity}={header.names[index] or index + 1}:{USUAL_UNIT[quantity]}"'
            f"{', or --unit' if quantity == 'pressure' else ''}"
        )
    name = header.names[index].lower()
    texts = [*_unit_texts(header, index), *re.split(r"[_,;/\s]", name)]
    absolute = bool(_ABSOLUTE.search(name)) or any(map(is_absolute, texts)) or (choice is not None and choice.absolute)
    return Column(
        quantity,
        index,
        unit or default,
        bool(unit),
        compressive=is_compressive(name),
        sure=is_sure(quantity, name) or (quantity == "extension" and choice is not None),
        absolute=quantity == "pressure" and absolute,
    )


def _allowed(quantity: str) -> str:
    return f"the unit of {quantity} must be one of {', '.join(MEASURED[quantity])}"


def _chosen(sheet: Sheet, header: Header, quantity: str, text: str) -> int:
    """The place of a column by its number, or by its name with or without unit."""
    if text.isdigit() and text not in header.names:
        if not 1 <= int(text) <= sheet.form.width:
            raise ValueError(
                f"columns: {quantity}: must be from 1 to {sheet.form.width}, as many as {sheet.source} has, got {text}"
            )
        return int(text) - 1
    names = {"name": [_plain(name) for name in header.names], "short": [_base(name) for name in header.names]}
    for own in names.values():
        found = [i for i, name in enumerate(own) if name and name == _plain(text)]
        if len(found) == 1:
            return found[0]
    raise ValueError(
        f"columns: {quantity}: must be the number or the name of one column of {sheet.source}, line {header.line}: "
        f"{header.shown}, got {shown(text)}"
    )


def _not_one(sheet: Sheet, header: Header, quantity: str, found: Sequence[int], option: str) -> str:
    which = " and ".join(repr(header.names[i]) for i in found) or header.none
    words = next((i for i, name in enumerate(header.names) if re.search(_NAMED[quantity], _base(name))), None)
    if not found and words is not None and not sheet.form.numeric[words]:
        place, row = next((p, r) for p, r in zip(sheet.places, sheet.rows, strict=True) if len(r) > words)
        return (
            f"{sheet.source}: line {place}: must hold numbers, or times as 12:00:01.5, in column {words + 1}, "
            f"{header.names[words]!r}, got {short(row[words])}; {option} names another column of {quantity}"
        )
    example = f"{quantity}={header.names[found[0]] if found else 2}"
    return (
        f"{sheet.source}: line {header.line}: must name one column of {quantity}, got {which}; {option} "
        f'says which, by name or number, as in "{example}"'
    )


def _candidates(sheet: Sheet, header: Header, quantity: str) -> list[int]:
    """Columns of numbers that may hold a quantity: by name, those named so alone first; or else by unit."""
    numeric = [i for i in range(sheet.form.width) if sheet.form.numeric[i] and not _is_foreign(header, i, quantity)]
    bases = {i: _base(header.names[i]) for i in numeric}
    own = {i: name for i, name in bases.items() if not _SET_POINT.search(name)}
    symbols = _SYMBOLS.get(quantity, ())
    found = [i for i, name in own.items() if re.search(_NAMED[quantity], name) or name in symbols]
    if len(found) > 1 and quantity in _PREFERRED_ALONE:
        alone = [i for i in found if re.fullmatch(f"(?:{_NAMED[quantity]})s?", own[i])]
        return alone if len(alone) == 1 else found
    if quantity == "strain":  # those that are lengths of the gauge go last
        found = [i for i in found if not any(unit in LENGTH for unit in _units(header, i, quantity)[0])] or found
    if found or quantity not in _TOLD_BY_UNIT:
        return found
    others = [pattern for other, pattern in _NAMED.items() if other != quantity]
    return [i for i in own if _units(header, i, quantity)[0] and not any(re.search(p, own[i]) for p in others)]


def _units(header: Header, index: int, quantity: str) -> tuple[list[str], str]:
    """The units of a quantity that a column's header names, and what stands in a unit's place but is none."""
    texts = _unit_texts(header, index)
    found = [unit for text in texts if (unit := unit_named(text, quantity))]
    if not found:
        found = units_among_words(header.names[index], quantity)
    return list(dict.fromkeys(found)), "" if found or not texts else texts[0]


def units_among_words(name: str, quantity: str) -> list[str]:
    """The units of a quantity among a name's words that stand in no brackets."""
    words = re.sub(f"(?:{_NAMED[quantity]})(?:s(?![a-z]))?", " ", name.lower())
    words = re.sub(r"[_,;/]", " ", _BRACKETS.sub(" ", words))
    return [unit for w in words.split() if w not in _AMBIGUOUS and (unit := unit_named(w, quantity))]


def _unit_texts(header: Header, index: int) -> list[str]:
    """What stands behind each number, in the row of units, or in brackets; of moments seconds alone."""
    if header.moments[index]:
        return [header.behind[index]]
    inside = [(a or b).strip() for a, b in _BRACKETS.findall(header.names[index])]
    return [text for text in (header.behind[index].strip(), header.units[index].strip("()[] "), *inside) if text]


def _is_foreign(header: Header, index: int, quantity: str) -> bool:
    """Whether a column's header names a unit of another quantity, and none of this."""
    texts = _unit_texts(header, index)
    return not any(unit_named(t, quantity) for t in texts) and any(unit_named(t, q) for t in texts for q in MEASURED)


def _check_one_header(sheet: Sheet, header: Header) -> None:
    """Raise a ValueError about a line among the numbers that names columns otherwise than the header."""
    known = [_words(header.names), _words(header.units)]
    for place, row in zip(sheet.places, sheet.rows, strict=True):
        if row and row[0][:1].isalpha() and _words(row) not in known:
            named = sum(1 for cell in row if any(re.search(pattern, _base(cell)) for pattern in _NAMED.values()))
            if named >= 2 and not any(map(is_number, row)):
                raise ValueError(
                    f"{sheet.source}: line {place}: must not name columns otherwise than line {header.line}, "
                    f"{header.shown}, got {short(','.join(row))}: are two recordings in one file?"
                )


def _words(cells: Sequence[str]) -> list[str]:
    """What cells hold, without those that are empty."""
    return [word for cell in cells if (word := _plain(cell))]


def _is_unit_row(row: Row) -> bool:
    filled = [cell.strip() for cell in row if cell.strip()]
    return bool(filled) and all(_is_unit(cell) for cell in filled)


def _is_unit(cell: str) -> bool:
    return _BRACKETS.fullmatch(cell) is not None or any(unit_named(cell, quantity) for quantity in MEASURED)


def _plain(name: str) -> str:
    return " ".join(_joined(name).lower().replace("_", " ").split())


def _joined(name: str) -> str:
    """A name or unit, stripped, with `bar(g)` and `kPa (abs)` as one word each."""
    return _GAUGE_OR_NOT.sub(r"\1", name.strip())


def _base(name: str) -> str:
    """A name without what stands in brackets, in lower case."""
    return _plain(_BRACKETS.sub(" ", name))
