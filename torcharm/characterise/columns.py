"""Which column of a file holds what, and in which unit: told from its header, or said by a person."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from torcharm.characterise.cells import is_number, number
from torcharm.characterise.column_names import NAMES, STRESS, candidates, is_compressive, is_sure, named_units
from torcharm.characterise.delimited import Array, Sheet, short
from torcharm.characterise.headers import Header, base, header_of, plain
from torcharm.inputs import check_choice, shown
from torcharm.units import MEASURED, PRESSURE, is_absolute, unit_named

Columns = str | Mapping[str, str | int]
"""`"time=Time:s, force=4"` or `{"time": "Time:s", "force": 4}`: names or numbers from 1, perhaps with a unit."""

_ELECTRICAL = re.compile(r"[mµ]?v(?:olts?|dc)?|mv/v|m?a|counts?|adc|digits?|ticks|raw", re.IGNORECASE)
"""What sensors give, and no unit of what they measure."""
_ABSOLUTE = re.compile(r"(?<![a-z])abs(?![a-z])|absolut")
_LIKELY: dict[str, tuple[tuple[float, str], ...]] = {
    "strain": ((1.0, "mm/mm"), (math.inf, "%")),
    "contraction": ((1.0, "mm/mm"), (math.inf, "%")),
    "extension": ((1e3, "mm"), (math.inf, "µm")),
    "length": ((1e3, "mm"), (math.inf, "µm")),
    "pressure": ((12.0, "bar"), (1.2e3, "kPa"), (1.2e4, "mbar"), (math.inf, "Pa")),
    "force": ((math.inf, "N"),),
}
"""The units that examples in messages name, each up to the largest number that it is likely for."""
_LIKE_A_UNIT = re.compile(r"[^\s\d]+(?:\d[^\s\d]+)?")
"""What stands in a unit's place and is no channel's name."""
_PASTED = re.compile(r"[^\"$`\\!]+")
"""Names that any shell takes as they are between double quotes."""
VARIED = 0.1
"""Of the range of a column's numbers, what that of one named alike must reach to be as likely."""
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
    check_one_header(sheet, header)
    if not all(own.column.isdigit() for own in said.values()) or len(said) < len(quantities):
        _check_names(sheet, header)
    try:
        found = {q: _column(sheet, header, q, said.get(q), (defaults or {}).get(q, "")) for q in quantities}
    except _UnclearError as error:
        hint, of_pressure = example(sheet, quantities, columns, defaults), "unit of pressure" in str(error)
        raise ValueError(f'{error}; {option} says it, perhaps as in "{hint}"{", or --unit" * of_pressure}') from None
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
    return quantity in choices(columns) or bool(candidates(sheet, header_of(sheet), quantity))


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


def _column(sheet: Sheet, header: Header, quantity: str, choice: Choice | None, default: str) -> Column:
    if choice is not None and choice.column:
        index = _chosen(sheet, header, quantity, choice.column)
    else:
        found = candidates(sheet, header, quantity)
        if len(found) != 1:
            raise _not_one(sheet, header, quantity, found)
        (index,) = found
    named, unknown = named_units(header, index, quantity)
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
        raise _UnclearError(f"{where}: {_allowed(quantity)}, got {got}")
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


class _UnclearError(ValueError):
    """What a file leaves open, and an option tells."""


def _not_one(sheet: Sheet, header: Header, quantity: str, found: Sequence[int]) -> ValueError:
    which = " and ".join(repr(header.names[i]) for i in found) or header.none
    words = next((i for i, name in enumerate(header.names) if re.search(NAMES[quantity], base(name))), None)
    if not found and words is not None and not sheet.form.numeric[words]:
        place, row = next((p, r) for p, r in zip(sheet.places, sheet.rows, strict=True) if len(r) > words)
        return ValueError(
            f"{sheet.source}: line {place}: must hold numbers, or times as 12:00:01.5, in column {words + 1}, "
            f"{header.names[words]!r}, got {short(row[words])}: is another column of {quantity}?"
        )
    return _UnclearError(f"{sheet.source}: line {header.line}: must name one column of {quantity}, got {which}")


def example(
    sheet: Sheet, quantities: Sequence[str], columns: Columns | None, defaults: Mapping[str, str] | None = None
) -> str:
    """What a person may say of columns to have all of these quantities: what is said, and what is lacking.

    That is columns, where a header does not name one, and likely units, where neither it nor a default does.
    """
    header, said = header_of(sheet), choices(columns)
    found: dict[int, str] = {}
    for quantity in {**said, **dict.fromkeys(quantities)}:
        own, named = said.get(quantity, Choice("", None)), candidates(sheet, header, quantity)
        known = [_chosen(sheet, header, quantity, own.column)] if own.column else named
        others = {i for q in MEASURED if q not in (quantity, *said) for i in candidates(sheet, header, q)} | set(found)
        others |= {i for i, name in enumerate(header.names) if re.search(STRESS, base(name))}
        free = [i for i, numeric in enumerate(sheet.form.numeric) if numeric and i not in others]
        free.sort(key=lambda i: not named_units(header, i, quantity)[0])
        if not known and not free:
            return f"{quantity}=?"
        # Of a few alike what is measured varies: a supply's pressure, and forces to the side, hardly do.
        spread = {i: float(np.ptp(values_of(sheet, i))) for i in known[: len(known) * (len(known) > 1)]}
        index = next((i for i in spread if spread[i] >= VARIED * max(spread.values())), (known or free)[0])
        unit, (units, unknown) = own.unit and f"{own.unit}{' abs' * own.absolute}", named_units(header, index, quantity)
        if not unit and not units and quantity == "time":  # minutes and hours are no units unless they end a name
            unit = unit_named(re.split(r"[_\s]", header.names[index])[-1], quantity) or ""
        if not unit and not units and quantity not in (defaults or {}):
            unit = "?" if _LIKE_A_UNIT.fullmatch(unknown) else _likely_unit(quantity, values_of(sheet, index))
        if unit or own.column or len(named) != 1:
            found[index] = f"{quantity}={_pasted(header, index)}{f':{unit}' if unit else ''}"
    return ",".join(found.values())


def _pasted(header: Header, index: int) -> str | int:
    """The name of a column, or its number where a name is none, or none alone, or no shell takes it as it is."""
    name = header.names[index]
    return name if _PASTED.fullmatch(name) and header.names.count(name) == 1 else index + 1


def values_of(sheet: Sheet, index: int, most: int | None = None) -> Array:
    """The numbers of a column, NaN where there is none; of the first lines alone, where so many do."""
    return np.array([number(row[index], sheet.form.decimal) for row in sheet.rows[:most] if len(row) > index])


def _likely_unit(quantity: str, values: Array) -> str:
    """The unit that numbers are likely to be in; times by the steps between them."""
    if quantity == "time":
        return "ms" if np.nanmedian(np.abs(np.diff(values))) > LONGEST_STEP else "s"
    return next(unit for most, unit in _LIKELY[quantity] if not np.nanmax(np.abs(values)) > most)


def _check_names(sheet: Sheet, header: Header) -> None:
    """Raise a ValueError about a header of fewer names than there are columns, as nobody knows which are named."""
    last = max((i for i, name in enumerate(header.names) if name), default=sheet.form.width)
    if any(sheet.form.numeric[last + 1 :]):
        raise ValueError(
            f"{sheet.source}: line {header.line}: must name all {sheet.form.width} columns, got {last + 1} names, "
            f"{header.shown}: are there decimal commas between commas? If not, --columns tells them by numbers"
        )


def check_one_header(sheet: Sheet, header: Header, *, least: int = 2) -> None:
    """Raise a ValueError about a line of words among the numbers that names columns, so many at least, otherwise."""
    known = [_words(header.names), _words(header.units)]
    for place, row in zip(sheet.places, sheet.rows, strict=True):
        if not row or not row[0][:1].isalpha() or _words(row) in known or any(map(is_number, row)):
            continue
        if sum(any(re.search(pattern, base(cell)) for pattern in NAMES.values()) for cell in row) >= least:
            raise ValueError(
                f"{sheet.source}: line {place}: must not name columns otherwise than line {header.line}, "
                f"{header.shown}, got {short(','.join(row))}: are two recordings or tables in one file?"
            )


def _words(cells: Sequence[str]) -> list[str]:
    """What cells hold, without those that are empty."""
    return [word for cell in cells if (word := plain(cell))]
