"""Which column of a file holds what, and in which unit: told from its header, or said by a person."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from torcharm.characterise.cells import is_number, number
from torcharm.characterise.delimited import Array, Sheet, short
from torcharm.characterise.headers import BRACKETS, Header, base, header_of, plain
from torcharm.inputs import check_choice, shown
from torcharm.units import LENGTH, MEASURED, PRESSURE, is_absolute, unit_named

Columns = str | Mapping[str, str | int]
"""`"time=Time:s, force=4"` or `{"time": "Time:s", "force": 4}`: names or numbers from 1, perhaps with a unit."""

_NAMED = {
    "time": r"timestamp|\btime|elapsed(?! cycle)|millis|micros|zeit|\bx value",
    "strain": r"strain|dehnung|stauchung",
    "contraction": r"contraction|shortening|kontraktion|verkürzung",
    "extension": r"extension|displacement|elongation|crosshead|stroke|position|travel|weg\b|traverse|verlängerung",
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
_ELECTRICAL = re.compile(r"[mµ]?v(?:olts?|dc)?|mv/v|m?a|counts?|adc|digits?|ticks|raw", re.IGNORECASE)
"""What sensors give, and no unit of what they measure."""
_COMPRESSIVE = re.compile(r"compressi|stauchung|druckkraft")
"""What a tester names so is positive where it squeezes: such strains and extensions shorten, such forces push."""
_LENGTHENING = re.compile(r"extension|elongation|verlängerung|tensile|tension|dehnung")
"""What is positive where longer; strokes and positions count either way."""
_ABSOLUTE = re.compile(r"(?<![a-z])abs(?![a-z])|absolut")
_PREFERRED_ALONE = ("time", "extension", "force")
"""Of which the column of that name alone is taken among several: others, such as a cycle's time, follow it."""
_AMBIGUOUS = ("min", "h", "1", "-", "in")
"""What names a unit in brackets, or in a row of units, but may mean something else as a word of a name."""
_LIKELY: dict[str, tuple[tuple[float, str], ...]] = {
    "strain": ((1.0, "mm/mm"), (math.inf, "%")),
    "contraction": ((1.0, "mm/mm"), (math.inf, "%")),
    "extension": ((1e3, "mm"), (math.inf, "µm")),
    "pressure": ((12.0, "bar"), (1.2e3, "kPa"), (1.2e4, "mbar"), (math.inf, "Pa")),
    "force": ((math.inf, "N"),),
}
"""The units that examples in messages name, each up to the largest number that it is likely for."""
_PASTED = re.compile(r"[^\"$`\\!]+")
"""Names that any shell takes as they are between double quotes."""
LONGEST_STEP = 2.0
"""Steps of times [s], above which they are rather in ms: benches sample more often."""
_OPTION = re.compile(r"(?:^|,)\s*([A-Za-z_]+)\s*=")


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
    def as_absolute(self) -> str:
        """How a person says that it holds absolute pressures."""
        return f'"pressure={self.index + 1}:{self.unit} abs"'

    @property
    def notes(self) -> tuple[str, ...]:
        """What may surprise of its unit: a force in g is the weight of so many."""
        mass = {"gf": "g", "kgf": "kg"}.get(self.unit)
        return (f"reads forces in {self.unit}, the weight of so many {mass}",) if mass else ()

    @property
    def factor(self) -> float:
        """One of its unit in torcharm's."""
        return MEASURED[self.quantity][self.unit]

    def check_unit(self, said: str | None, source: str, option: str) -> None:
        """Raise a ValueError if a person says another unit of pressures than was named."""
        if said is not None and self.named and self.factor != PRESSURE[said]:
            raise ValueError(f"unit: must be left out or be {self.unit}, which {source} or {option} names, got {said}")


@dataclass(frozen=True)
class Choice:
    """What a person says of a column: its name or number, "" for none, and its unit, None for none."""

    column: str
    unit: str | None
    absolute: bool = False


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
    header, said = header_of(sheet), choices(columns)
    _check_one_header(sheet, header)
    hint = partial(example, sheet, quantities, columns, defaults)
    found = {q: _column(sheet, header, q, said.get(q), (defaults or {}).get(q, ""), option, hint) for q in quantities}
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
    return quantity in choices(columns) or bool(_candidates(sheet, header_of(sheet), quantity))


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
    return list(choices(columns))


def choices(columns: Columns | None) -> dict[str, Choice]:
    """What a person says of each quantity."""
    if columns is None:
        return {}
    if isinstance(columns, str):
        start, *rest = _OPTION.split(columns)
        if start.strip() or not rest:
            raise ValueError(f"columns: must be as in 'time=Time:s, force=4', got {shown(columns)}")
        pairs = list(zip(rest[::2], rest[1::2], strict=True))
    else:
        pairs = [(key, str(value)) for key, value in columns.items()]
    found: dict[str, Choice] = {}
    for key, value in pairs:
        quantity = key.strip().lower()
        check_choice("columns", quantity, MEASURED)
        if quantity in found:
            raise ValueError(f"columns: must name {quantity} once, got it twice in {shown(columns)}")
        found[quantity] = _choice(quantity, value.strip())
    return found


def _choice(quantity: str, text: str) -> Choice:
    column, colon, last = text.rpartition(":")
    unit = unit_named(last, quantity) if colon else None
    if unit is not None:
        return Choice(column.strip(), unit, is_absolute(last))
    if colon and (column.strip().isdigit() or not column.strip()):
        raise ValueError(f"columns: {quantity}: {_allowed(quantity)}, got {shown(last)}")
    if not text:
        raise ValueError(f"columns: {quantity}: must be a column's name or number, got none")
    return Choice(text, None)


def _column(
    sheet: Sheet,
    header: Header,
    quantity: str,
    choice: Choice | None,
    default: str,
    option: str,
    hint: Callable[[], str],
) -> Column:
    if choice is not None and choice.column:
        index = _chosen(sheet, header, quantity, choice.column)
    else:
        found = _candidates(sheet, header, quantity)
        if len(found) != 1:
            raise ValueError(_not_one(sheet, header, quantity, found, option, hint))
        (index,) = found
    named, unknown = _units(header, index, quantity)
    if _ELECTRICAL.fullmatch(unknown):
        raise ValueError(
            f"{sheet.source}: line {header.line}: column {index + 1}, {header.names[index]!r}, must hold {quantity}s, "
            f"got a sensor's reading in {unknown}: convert it in the file"
        )
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
            f"{where}: {_allowed(quantity)}, got {got}; {option} says it, by the numbers perhaps "
            f'"{hint()}"{", or --unit" if quantity == "pressure" else ""}'
        )
    name = header.names[index].lower()
    texts = [*header.unit_texts(index), *re.split(r"[_,;/\s]", name)]
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
    names = {"name": [plain(name) for name in header.names], "short": [base(name) for name in header.names]}
    for own in names.values():
        found = [i for i, name in enumerate(own) if name and name == plain(text)]
        if len(found) == 1:
            return found[0]
    raise ValueError(
        f"columns: {quantity}: must be the number or the name of one column of {sheet.source}, line {header.line}: "
        f"{header.shown}, got {shown(text)}"
    )


def _not_one(
    sheet: Sheet, header: Header, quantity: str, found: Sequence[int], option: str, hint: Callable[[], str]
) -> str:
    which = " and ".join(repr(header.names[i]) for i in found) or header.none
    words = next((i for i, name in enumerate(header.names) if re.search(_NAMED[quantity], base(name))), None)
    if not found and words is not None and not sheet.form.numeric[words]:
        place, row = next((p, r) for p, r in zip(sheet.places, sheet.rows, strict=True) if len(r) > words)
        return (
            f"{sheet.source}: line {place}: must hold numbers, or times as 12:00:01.5, in column {words + 1}, "
            f"{header.names[words]!r}, got {short(row[words])}; {option} names another column of {quantity}"
        )
    return (
        f"{sheet.source}: line {header.line}: must name one column of {quantity}, got {which}; {option} "
        f'says which, by name or number, as in "{hint()}"'
    )


def example(
    sheet: Sheet, quantities: Sequence[str], columns: Columns | None, defaults: Mapping[str, str] | None = None
) -> str:
    """What a person may say of columns to have all of these quantities: what is said, and what is lacking.

    That is columns, where a header does not name one, and likely units, where neither it nor a default does.
    """
    header, said = header_of(sheet), choices(columns)
    found: dict[int, str] = {}
    for quantity in {**said, **dict.fromkeys(quantities)}:
        own, named = said.get(quantity, Choice("", None)), _candidates(sheet, header, quantity)
        known = [_chosen(sheet, header, quantity, own.column)] if own.column else named
        others = {i for q in MEASURED if q != quantity for i in _candidates(sheet, header, q)} | set(found)
        free = [i for i, numeric in enumerate(sheet.form.numeric) if numeric and i not in others]
        index = (known or sorted(free, key=lambda i: not _units(header, i, quantity)[0]) or [sheet.form.width - 1])[0]
        unit = own.unit and f"{own.unit}{' abs' * own.absolute}"
        if not unit and not _units(header, index, quantity)[0] and quantity not in (defaults or {}):
            unit = likely_unit(quantity, _values(sheet, index))
        if unit or own.column or len(named) != 1:
            found[index] = f"{quantity}={_pasted(header, index)}{f':{unit}' if unit else ''}"
    return ",".join(found.values())


def _pasted(header: Header, index: int) -> str | int:
    """The name of a column, or its number where a name is none, or none alone, or no shell takes it as it is."""
    name = header.names[index]
    return name if _PASTED.fullmatch(name) and header.names.count(name) == 1 else index + 1


def _values(sheet: Sheet, index: int) -> Array:
    """The numbers of a column, NaN where there is none."""
    return np.array([number(row[index], sheet.form.decimal) for row in sheet.rows if len(row) > index])


def likely_unit(quantity: str, values: Array) -> str:
    """The unit that numbers are likely to be in; times by the steps between them."""
    if quantity == "time":
        return "ms" if np.nanmedian(np.abs(np.diff(values))) > LONGEST_STEP else "s"
    return next(unit for most, unit in _LIKELY[quantity] if not np.nanmax(np.abs(values)) > most)


def _candidates(sheet: Sheet, header: Header, quantity: str) -> list[int]:
    """Columns of numbers that may hold a quantity: by name, those named so alone first; or else by unit."""
    numeric = [i for i in range(sheet.form.width) if sheet.form.numeric[i] and not _is_foreign(header, i, quantity)]
    bases = {i: base(header.names[i]) for i in numeric}
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
    texts = header.unit_texts(index)
    found = [unit for text in texts if (unit := unit_named(text, quantity))]
    if not found:
        found = units_among_words(header.names[index], quantity)
    return list(dict.fromkeys(found)), "" if found or not texts else texts[0]


def units_among_words(name: str, quantity: str) -> list[str]:
    """The units of a quantity among a name's words that stand in no brackets."""
    words = re.sub(f"(?:{_NAMED[quantity]})(?:s(?![a-z]))?", _own_unit, name.lower())
    words = re.sub(r"[_,;/]", " ", BRACKETS.sub(" ", words))
    return [unit for w in words.split() if w not in _AMBIGUOUS and (unit := unit_named(w, quantity))]


def _own_unit(name: re.Match[str]) -> str:
    """The name of a quantity if it is a unit, too, as a microcontroller's `millis` is; else a blank."""
    return name[0] if name[0] in ("millis", "micros") else " "


def _is_foreign(header: Header, index: int, quantity: str) -> bool:
    """Whether a column's header names a unit of another quantity, and none of this."""
    texts = header.unit_texts(index)
    return not any(unit_named(t, quantity) for t in texts) and any(unit_named(t, q) for t in texts for q in MEASURED)


def _check_one_header(sheet: Sheet, header: Header) -> None:
    """Raise a ValueError about a line among the numbers that names columns otherwise than the header."""
    known = [_words(header.names), _words(header.units)]
    for place, row in zip(sheet.places, sheet.rows, strict=True):
        if row and row[0][:1].isalpha() and _words(row) not in known:
            named = sum(1 for cell in row if any(re.search(pattern, base(cell)) for pattern in _NAMED.values()))
            if named >= 2 and not any(map(is_number, row)):
                raise ValueError(
                    f"{sheet.source}: line {place}: must not name columns otherwise than line {header.line}, "
                    f"{header.shown}, got {short(','.join(row))}: are two recordings in one file?"
                )


def _words(cells: Sequence[str]) -> list[str]:
    """What cells hold, without those that are empty."""
    return [word for cell in cells if (word := plain(cell))]
