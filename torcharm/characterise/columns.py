"""Which column of a file holds what, and in which unit: told from its header, or said by a person."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from torcharm.characterise.cells import is_number, number
from torcharm.characterise.delimited import Sheet, short, values_of
from torcharm.characterise.headers import NAMES, STRESS, Header, base, candidates, header_of, named_units, plain
from torcharm.inputs import check_choice, shown
from torcharm.units import MEASURED, PRESSURE, TIME, is_absolute, unit_named

Columns = str | Mapping[str, str | int]
"""`"time=Time:s, force=4"` or `{"time": "Time:s", "force": 4}`: names or numbers from 1, perhaps with a unit."""

_ELECTRICAL = re.compile(r"[mµ]?v(?:olts?|dc)?|mv/v|m?a|counts?|adc|digits?|ticks|raw", re.IGNORECASE)
"""What sensors give, and no unit of what they measure."""
_LIKELY = {"time": (2.0, "s", "ms"), "pressure": (12.0, "bar", "kPa"), "force": (math.inf, "N", "")}
_LIKELY |= {"strain": (1.0, "mm/mm", "%"), "contraction": (1.0, "mm/mm", "%")}
"""The units that examples in messages name: the first up to so large a number, or step of times; of lengths mm."""
EPOCH = (1e9, 2.5e9)
"""Seconds since 1970 of the years 2001 to 2049: no run is as long, so that such times name their own unit."""
_OPTION = re.compile(r"(?:^|,)\s*([A-Za-z_]+)\s*=")
_ABSOLUTE = re.compile(r"(?<![a-z])abs(?![a-z])|absolut")
COMPRESSIVE = re.compile(r"compressi|stauchung|druckkraft")
"""What a tester names so is positive where it squeezes: such strains and extensions shorten, such forces push."""
_LENGTHENING = re.compile(r"extension|elongation|verlängerung|tensile|tension|dehnung")
"""What is positive where longer; strokes and positions count either way."""


@dataclass(frozen=True)
class Column:
    """A column that holds a quantity.

    Attributes:
        index: counted from 0.
        unit: canonical.
        named: whether the file or a person named it; else it is a default.
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
    def notes(self) -> tuple[str, ...]:
        """What may surprise of its unit: a force in g is the weight of so many."""
        mass = {"gf": "g", "kgf": "kg"}.get(self.unit)
        return (f"reads forces in {self.unit}, the weight of so many {mass}",) if mass else ()

    @property
    def factor(self) -> float:
        """One of its unit in torcharm's."""
        return MEASURED[self.quantity][self.unit]

    def check_unit(self, said: str | None, source: str) -> None:
        """Raise a ValueError if a person says another unit of pressures than was named."""
        if said is not None and self.named and self.factor != PRESSURE[said]:
            raise ValueError(f"unit: must be left out or be {self.unit}, which {source} or --columns names, got {said}")


@dataclass(frozen=True)
class Choice:
    """What a person says of a column: its name or number, "" for none, and its unit, None for none."""

    column: str = ""
    unit: str | None = None
    absolute: bool = False


def find_columns(
    sheet: Sheet, quantities: Sequence[str], columns: Columns | None, defaults: Mapping[str, str] | None = None
) -> dict[str, Column]:
    """The column of each quantity, and its unit.

    Args:
        sheet: of a file.
        quantities: of `units.MEASURED`.
        columns: what a person says of them.
        defaults: units where nobody names one.

    Raises:
        ValueError: a column is not found, or more than one; its unit is not known; or the file and a person differ.
    """
    header, said = header_of(sheet), choices(columns)
    last = max((i for i, name in enumerate(header.names) if name), default=sheet.width)
    by_number = all(own.column.isdigit() for own in said.values()) and len(said) >= len(quantities)
    if any(sheet.numeric[last + 1 :]) and not by_number:
        raise ValueError(
            f"{sheet.source}: line {header.line}: must name all {sheet.width} columns, got {last + 1} names, "
            f"{header.shown}: are there decimal commas between commas? If not, --columns tells them by numbers"
        )
    found: dict[str, Column] = {}
    for quantity in quantities:
        try:
            own = _column(sheet, header, quantity, said.get(quantity, Choice()), (defaults or {}).get(quantity, ""))
        except _UnclearError as error:
            hint, of_unit = example(sheet, quantities, columns, defaults or {}), "unit of pressure" in str(error)
            raise ValueError(f'{error}; --columns says it, as in "{hint}"{", or --unit" * of_unit}') from None
        other = next((name for name, column in found.items() if column.index == own.index), None)
        if other:
            raise ValueError(
                f"{sheet.source}: line {header.line}: {quantity} must be in another column than {other}, got "
                f"{own.index + 1} for both; --columns says which"
            )
        found[quantity] = own
    return found


def check_one_header(sheet: Sheet, *, least: int = 2) -> None:
    """Raise a ValueError about a line of words among the numbers that names columns, so many at least, otherwise."""
    header, known = header_of(sheet), [_words(row) for _, row in sheet.above]
    for place, row in zip(sheet.places, sheet.rows, strict=True):
        if not row or not row[0][:1].isalpha() or any(map(is_number, row)) or _words(row) in known:
            continue
        if sum(any(re.search(pattern, base(cell)) for pattern in NAMES.values()) for cell in row) >= least:
            raise ValueError(
                f"{sheet.source}: line {place}: must not name columns otherwise than line {header.line}, "
                f"{header.shown}, got {short(','.join(row))}: are two recordings or tables in one file?"
            )


def _words(cells: Sequence[str]) -> list[str]:
    """What cells hold, without those that are empty."""
    return [word for cell in cells if (word := plain(cell))]


def has_column(sheet: Sheet, quantity: str, columns: Columns | None) -> bool:
    """Whether a quantity is said to have a column, or the header names one or more."""
    return quantity in choices(columns) or bool(candidates(sheet, header_of(sheet), quantity))


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
    return Choice(text)


def _column(sheet: Sheet, header: Header, quantity: str, choice: Choice, default: str) -> Column:
    where = f"{sheet.source}: line {header.line}"
    index = _chosen(sheet, header, quantity, choice.column) if choice.column else _only(sheet, header, quantity)
    named = named_units(header, index, quantity)
    if len(named) > 1:
        raise ValueError(f"{where}: must name one unit of {quantity}, got {' and '.join(named)}")
    said = choice.unit
    if said is not None and named and MEASURED[quantity][said] != MEASURED[quantity][named[0]]:
        raise ValueError(
            f"columns: {quantity}: must be left without a unit or be in {named[0]}, which {sheet.source} names in line "
            f"{header.line}, {header.shown}, got {said}"
        )
    default = (quantity == "time" and _epoch_unit(sheet, index)) or default
    unit, unknown = said or "".join(named), "" if named else "".join(header.units[index][:1])
    if not unit and (unknown or not default):
        if _ELECTRICAL.fullmatch(unknown):
            raise ValueError(
                f"{where}: column {index + 1}, {header.names[index]!r}, must hold {quantity}s, got a sensor's reading "
                f"in {unknown}: convert it in the file"
            )
        got = repr(unknown) if unknown else "none"
        raise _UnclearError(f"{where}: {_allowed(quantity)}, got {got} in {header.shown}")
    name = header.names[index].lower()
    words = [*header.units[index], *re.split(r"[_,;/\s]", name)]
    absolute = bool(_ABSOLUTE.search(name)) or any(map(is_absolute, words)) or choice.absolute
    compressive = COMPRESSIVE.search(name) is not None
    lengthening = _LENGTHENING.search(name) is not None or (quantity == "extension" and choice != Choice())
    return Column(
        quantity,
        index,
        unit or default,
        bool(unit),
        compressive=compressive,
        sure=compressive or lengthening or quantity in ("contraction", "length"),
        absolute=quantity == "pressure" and absolute,
    )


def _epoch_unit(sheet: Sheet, index: int) -> str:
    """The unit of times that count from 1970, which their size tells; "" of others."""
    cells = (row[index] for row in sheet.rows if len(row) > index)
    first = next(filter(math.isfinite, (number(cell, sheet.decimal) for cell in cells)), 0.0)
    seconds = {unit: first * TIME[unit] / TIME["s"] for unit in ("s", "ms", "µs", "ns")}
    return next((unit for unit, since in seconds.items() if EPOCH[0] <= since <= EPOCH[1]), "")


def _allowed(quantity: str) -> str:
    return f"the unit of {quantity} must be one of {', '.join(MEASURED[quantity])}"


def _chosen(sheet: Sheet, header: Header, quantity: str, text: str) -> int:
    """The place of a column by its number, or by its name with or without unit."""
    if text.isdigit() and text not in header.names:
        if not 1 <= int(text) <= sheet.width:
            raise ValueError(
                f"columns: {quantity}: must be from 1 to {sheet.width}, as many as {sheet.source} has, got {text}"
            )
        return int(text) - 1
    for form in (plain, base):
        found = [i for i, name in enumerate(header.names) if name and form(name) == plain(text)]
        if len(found) == 1:
            return found[0]
    raise ValueError(
        f"columns: {quantity}: must be the number or the name of one column of {sheet.source}, line {header.line}: "
        f"{header.shown}, got {shown(text)}"
    )


def _only(sheet: Sheet, header: Header, quantity: str) -> int:
    """The place of the one column that the header names for a quantity."""
    found = candidates(sheet, header, quantity)
    if len(found) != 1:
        which = " and ".join(repr(header.names[i]) for i in found) or f"none in {header.shown}"
        raise _UnclearError(
            f"{sheet.source}: line {header.line}: must name one column of {quantity}, whose cells are numbers, got "
            f"{which}"
        )
    return found[0]


class _UnclearError(ValueError):
    """What a file leaves open, and a person may tell."""


def example(sheet: Sheet, quantities: Sequence[str], columns: Columns | None, defaults: Mapping[str, str]) -> str:
    """What a person may say of columns to have all of these quantities: what is said, and what else is lacking.

    That is a column, where the header does not name one, and a likely unit, where nothing tells it.
    """
    header, said, found = header_of(sheet), choices(columns), dict[int, str]()
    for quantity in {**said, **dict.fromkeys(quantities)}:
        own, known = said.get(quantity, Choice()), candidates(sheet, header, quantity)
        others = {i for q in MEASURED if q not in (quantity, *said) for i in candidates(sheet, header, q)}
        others |= {i for i, name in enumerate(header.names) if re.search(STRESS, base(name))} | set(found)
        free = [i for i in range(sheet.width) if sheet.numeric[i] and i not in others]
        index = _chosen(sheet, header, quantity, own.column) if own.column else next(iter([*known, *free]), None)
        if index is None:
            return f"{quantity}=?"
        unit = f"{own.unit}{' abs' * own.absolute}" if own.unit else ""
        if not unit and not named_units(header, index, quantity) and quantity not in defaults:
            values = values_of([row[index] for row in sheet.rows if len(row) > index], sheet.decimal)
            size = np.nanmedian(np.diff(values)) if quantity == "time" else np.nanmax(np.abs(values))
            most, small, large = _LIKELY.get(quantity, (math.inf, "mm", ""))
            unit = "?" if header.units[index] else large if size > most else small
        if unit or own.column or len(known) != 1:
            found[index] = f"{quantity}={index + 1}{f':{unit}' if unit else ''}"
    return ",".join(found.values())
