"""Text files of numbers in columns, as testers, loggers and spreadsheets write them: found out, not configured.

Encoding, line ends, separator, decimal sign, thousands, quotes, a preamble, a header with or without a row of units,
and a footer are told from the file itself. The csv module splits lines and `float` reads cells: both are written in C,
so that 10 MB take less than a second, and no data frame library is needed for what is a list of columns.
"""

import csv
import re
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torcharm.characterise.cells import NUMBER, Row, decimal_sign, dress, has_value, is_number, number
from torcharm.characterise.text_lines import text_lines
from torcharm.files import StrPath, read_file, without_collection

Array = NDArray[np.float64]

SEPARATORS = ("\t", ";", ",", " ")
"""A blank stands for any run of blanks and tabs."""
SAMPLED = 400
"""Lines from which separator, decimal sign and width are told, spread over the file."""
LONGEST_LINE = 100_000
"""Characters beyond which a line is damaged, and left out unread: the csv module refuses cells of more than 131,072."""
MOST_DAMAGED, FEW = 0.01, 3
"""Of a file's lines of numbers, which share may be damaged and left out; or, of no fewer than ten times as many, how
many. With more the file is another one than it is taken for, or was damaged as a whole."""
LACKING = "lacking"
"""What stands for a cell that a line is too short to have; no number."""
_SHOWN = 60

_WIDE_GAP, _LETTER = re.compile(r"\s{2,}|\t"), re.compile(r"[^\W\d_]{2}")
_GLUED = re.compile(rf"(?P<name>.*?[^\d.,+-])(?P<number>{NUMBER})\"?")


@dataclass(frozen=True)
class Form:
    """Of a line of numbers.

    Attributes:
        separator: of cells.
        width: cells of a line.
        decimal: the decimal sign, "." or ",".
        sure: whether numbers tell it; not so where each comma may stand between thousands.
        numeric: of each cell, whether it mostly holds numbers.
        dress: of each cell, what stands before and behind most of its numbers, as in `p: 12.5 kPa`; "" for nothing.
    """

    separator: str
    width: int
    decimal: str
    sure: bool
    numeric: tuple[bool, ...]
    dress: tuple[tuple[str, str], ...]


@dataclass(frozen=True, eq=False)
class Sheet:
    """The lines of a file, split into cells.

    Attributes:
        source: the file.
        above: lines before the first of numbers, with their numbers in the file.
        rows: lines from the first to the last of numbers; others may stand among them.
        places: the number of each row's line, counted from 1.
        form: of a line of numbers.
        closing: the first line behind the numbers that is none; "" without one.
        damaged: numbers of lines that could not be split.
        cut: whether the file ends within a line of numbers: True, False, or None where that cannot be told.
    """

    source: str
    above: tuple[tuple[int, Row], ...]
    rows: list[Row]
    places: list[int]
    form: Form
    closing: str
    damaged: tuple[int, ...]
    cut: bool | None


@without_collection()
def read_sheet(path: StrPath) -> Sheet:
    """Read a file of numbers in columns.

    Raises:
        ValueError: it cannot be read, is empty or no text, or holds no lines of numbers.
    """
    source = str(path)
    lines, ended = text_lines(source, read_file(path))
    if not any(line.strip() for line in lines):
        raise ValueError(f"{source}: is empty, must hold lines of numbers")
    whole = [n for n, line in enumerate(lines, 1) if len(line) <= LONGEST_LINE]
    damaged = tuple(n for n, line in enumerate(lines, 1) if len(line) > LONGEST_LINE)
    kept = [line for line in lines if len(line) <= LONGEST_LINE] if damaged else lines
    form = _form(kept)
    if sum(form.numeric) < 2:
        first = next(n for n, line in enumerate(lines, 1) if line.strip())
        raise ValueError(
            f"{source}: line {first}: must be followed by lines of two or more numbers each, got "
            f"{short(lines[first - 1])} and none"
        )
    split = _undressed(_split(kept, form.separator), form.dress)
    pairs = [(n, row) for n, row in zip(whole, split, strict=True) if any(row)]
    first, last = _extent([row for _, row in pairs], form)
    closing = lines[pairs[last][0] - 1] if last < len(pairs) else ""
    places, rows = [n for n, _ in pairs[first:last]], [row for _, row in pairs[first:last]]
    sheet = Sheet(source, tuple(pairs[:first]), rows, places, form, closing, damaged, cut=False)
    sheet = _unglued(sheet)
    if ended or closing:
        return sheet
    if sheet.places[-1] < len(lines):  # a quote, or nothing else that a cell holds
        sheet = replace(sheet, rows=[*sheet.rows, []], places=[*sheet.places, len(lines)])
    return replace(sheet, cut=_is_cut(sheet, lines[-1]))


def check_damage(sheet: Sheet, *, truncated: bool = False) -> None:
    """Raise a ValueError about a file that is damaged whatever its columns hold: cut short, or with cells lost.

    Args:
        sheet: of a file.
        truncated: whether to accept a file that ends within a line.
    """
    if sheet.cut and not truncated:
        raise ValueError(
            f"{sheet.source}: line {sheet.places[-1]}: must be a whole line of {sheet.form.width} cells, got "
            f"{short(' '.join(sheet.rows[-1]))}, where the file ends: it is cut short (--truncated leaves the line out)"
        )
    width, whole = sheet.form.width, sheet.rows if sheet.cut is False else sheet.rows[:-1]
    rows = zip(sheet.places, whole, strict=False)
    lost = [place for place, row in rows if not _is_whole(row, width) and any(map(is_number, row))]
    _check_few(sheet, [*sheet.damaged, *lost], [k for k, own in enumerate(sheet.form.numeric) if own])


def numbers(sheet: Sheet, columns: Sequence[int], *, sparse: bool = False) -> tuple[Array, list[int], tuple[str, ...]]:
    """The numbers (n, k) of some columns, the number of each one's line, and what was left out, in words.

    Lines that are left out are a warning, too: those that are damaged, and the last if it has no end.

    Args:
        sheet: of a file.
        columns: which, counted from 0.
        sparse: whether cells may be empty, which become NaN.

    Raises:
        ValueError: more lines are damaged than may be left out, or none is left.
    """
    rows, places = sheet.rows, sheet.places
    said = ["commas are read as decimal signs"] if sheet.form.decimal == "," else []
    if not sheet.form.sure:
        read, other = ("decimal signs", "thousands") if said else ("thousands", "decimal signs")
        warnings.warn(
            f"{sheet.source}: commas read as {read}, as in 1,234, but no number tells them from {other}: are they?",
            stacklevel=4,
        )
    left_out = []
    if sheet.cut is not False:
        left_out.append(f"line {places[-1]} has no end and may be cut, left out")
        rows, places = rows[:-1], places[:-1]
    fits = [_is_whole(row, sheet.form.width) for row in rows]
    whole = rows if all(fits) else [row if fit else [] for row, fit in zip(rows, fits, strict=True)]
    cells = ([row[k] if k < len(row) else LACKING for row in whole] for k in columns)
    table = np.stack([_values(own, sheet.form.decimal, sparse=sparse) for own in cells], -1)
    good = np.isfinite(table).all(-1) if not sparse else ~np.isposinf(table).any(-1)
    off = np.flatnonzero(~good).tolist()
    void = {k for k in off if _is_void(rows[k], columns if fits[k] else ())}
    bad = sorted([*sheet.damaged, *(places[k] for k in off if k not in void)])
    if not len(good):
        raise ValueError(
            f"{sheet.source}: line {sheet.places[-1]}: is the last line, must be followed by whole lines of numbers"
        )
    _check_few(sheet, bad, columns, none_left=not good.any())
    if void:
        words = Counter(c.strip() for k in void if fits[k] for c in _void_cells(rows[k], columns) if c.strip())
        held = "".join(f" ({count} with {short(word)})" for word, count in words.most_common(1))
        left_out.append(f"{_lines([places[k] for k in sorted(void)])} of words or with empty cells passed over{held}")
    if bad:
        left_out.append(f"{_lines(bad)} damaged, left out")
    for what in left_out:
        warnings.warn(f"{sheet.source}: {what}", stacklevel=4)
    said += left_out
    return table[good], [place for place, fine in zip(places, good.tolist(), strict=True) if fine], tuple(said)


def _values(cells: Row, decimal: str, *, sparse: bool) -> Array:
    """The numbers (n) of a column, NaN where there is none; where cells may be empty inf for what is none."""
    if decimal == "." or not any("." in cell for cell in cells):
        try:
            plain = cells if decimal == "." else [cell.replace(",", ".") for cell in cells]
            found = np.array(list(map(float, plain)))
        except ValueError:
            pass
        else:
            if np.isfinite(found).all():
                return found
    return np.array([number(cell, decimal, sparse=sparse) for cell in cells])


def _is_void(row: Row, columns: Sequence[int]) -> bool:
    """Whether a line means to hold no sample: it is words alone, or a cell that would hold a number has no value."""
    return (not any(map(is_number, row)) and _is_words(row)) or bool(_void_cells(row, columns))


def _void_cells(row: Row, columns: Sequence[int]) -> Row:
    """The cells of some columns that have no value."""
    return [row[k] for k in columns if not has_value(row[k])]


def _check_few(sheet: Sheet, bad: Sequence[int], columns: Sequence[int], *, none_left: bool = False) -> None:
    """Raise a ValueError about the first of the lines that hold no numbers where they should, if they are many."""
    if len(bad) <= max(min(FEW, len(sheet.rows) / 10), MOST_DAMAGED * len(sheet.rows)) and not none_left:
        return
    bad = bad or sheet.places[:1]
    row = dict(zip(sheet.places, sheet.rows, strict=True)).get(bad[0])
    got = f"more than {LONGEST_LINE} characters" if row is None else short(" ".join(row))
    more = f"; {len(bad)} of {len(sheet.rows)} lines are damaged, too many to leave out" if len(bad) > 1 else ""
    if sheet.form.decimal == "." and any("," in cell and is_number(cell) for cell in row or ()):
        more += "; are there decimal commas beside decimal points?"
    raise ValueError(
        f"{sheet.source}: line {bad[0]}: must be {sheet.form.width} cells with finite numbers in columns "
        f"{_listed(sorted(column + 1 for column in columns))}, got {got}{more}"
    )


def short(line: str) -> str:
    """What stands in a line, in quotes, cut to a readable length."""
    text = " ".join(line.split())
    return repr(text if len(text) <= _SHOWN else f"{text[: _SHOWN - 3]}...")


# From bytes to rows


def _split(lines: Sequence[str], separator: str) -> list[Row]:
    """Cells of each line; a quote that is not closed ends with its line."""
    if separator != " ":
        options: dict[str, Any] = {"delimiter": separator, "skipinitialspace": True}
        try:
            rows = list(csv.reader(lines, **options))
        except csv.Error:  # a cell that goes on over lines has become too long
            rows = []
        return rows if len(rows) == len(lines) else [next(csv.reader([line], **options), []) for line in lines]
    if any('"' in line for line in lines):
        lines = [line.replace('"', "") for line in lines]
    # Names and units of several words stand further apart than words do.
    return [
        _WIDE_GAP.split(line.strip()) if _WIDE_GAP.search(line.strip()) and _LETTER.search(line) else line.split()
        for line in lines
    ]


def _form(lines: Sequence[str]) -> Form:
    """How lines of numbers are written, from lines spread over the file and its first ones."""
    spread = lines[:: max(1, len(lines) // SAMPLED)]
    sample = [line for line in (*lines[:20], *spread) if line.strip()]
    separator = max(SEPARATORS, key=lambda one: sum(map(_worth, _split(sample, one))))
    rows = [row for row in _split(sample, separator) if _worth(row) > 0]
    width = Counter(map(len, rows)).most_common(1)[0][0] if rows else 0
    own = _dress(rows, width)
    rows = _undressed(rows, own)
    return Form(separator, width, *decimal_sign(rows, separator), _numeric(rows, width), own)


def _extent(rows: Sequence[Row], form: Form) -> tuple[int, int]:
    """Which of the rows is the first of numbers, and which the first behind them."""
    looks = [_is_data(row, form) for row in rows[:SAMPLED]]
    # Another line of numbers soon behind it says that the first is no part of a preamble.
    near = [any(looks[i + 1 : i + 3]) or i >= len(rows) - 2 for i in range(len(looks))]
    first = next((i for i in range(len(looks)) if looks[i] and near[i]), 0)
    while first > 0 and _is_damaged_data(rows[first - 1], form.width):
        first -= 1
    last = len(rows)
    while last > first and not _is_data(rows[last - 1], form) and _is_words(rows[last - 1]):
        last -= 1
    return first, last


def _worth(row: Row) -> int:
    """How well a separator splits a line: numbers count, words cost; a line of a single number is none."""
    count = sum(1 for cell in row if is_number(cell) or any(dress(cell)))
    return 0 if count < 2 else max(1, 2 * count - sum(1 for cell in row if cell.strip()))


def _numeric(rows: Sequence[Row], width: int) -> tuple[bool, ...]:
    """Of each of so many cells, whether more than half of those filled hold numbers."""
    return tuple(2 * sum(map(is_number, column)) > len(column) for column in _columns(rows, width))


def _dress(rows: Sequence[Row], width: int) -> tuple[tuple[str, str], ...]:
    """Of each of so many cells, what stands before and behind the numbers of more than half of those filled."""
    found = []
    for column in _columns(rows, width):
        own, times = Counter(map(dress, column)).most_common(1)[0] if column else (("", ""), 0)
        found.append(own if 2 * times > len(column) else ("", ""))
    return tuple(found)


def _columns(rows: Sequence[Row], width: int) -> list[Row]:
    """Of each of so many cells, those that have a value."""
    own = [row for row in rows if len(row) >= width]
    return [[row[c] for row in own if has_value(row[c])] for c in range(width)]


def _undressed(rows: list[Row], dresses: Sequence[tuple[str, str]]) -> list[Row]:
    """The rows, numbers without what stands before and behind them."""
    for place, (label, unit) in enumerate(dresses):
        for row in rows if label or unit else ():
            if len(row) > place and row[place].startswith(label) and row[place].endswith(unit):
                bare = row[place].removeprefix(label).removesuffix(unit)
                row[place] = bare if is_number(bare) else row[place]
    return rows


def _is_data(row: Row, form: Form) -> bool:
    """Whether all cells that should do hold numbers, or nothing, and two at least a number."""
    if not _is_whole(row, form.width):
        return False
    cells = [cell for cell, own in zip(row, form.numeric, strict=False) if own]
    filled = [cell for cell in cells if has_value(cell)]
    return len(filled) >= min(2, len(cells)) and all(map(is_number, filled))


def _is_damaged_data(row: Row, width: int) -> bool:
    """Whether a line above the numbers is one of them, and no header of numbers, which begins with a word."""
    filled = [cell for cell in row if cell.strip()]
    return len(row) == width and 2 * sum(map(is_number, filled)) >= len(filled) and not _is_words(filled[:1])


def _is_whole(row: Row, width: int) -> bool:
    """Whether a line has all cells, and beyond them words alone: an event's name, but not the next line's numbers."""
    return len(row) == width or (len(row) > width and not any(map(is_number, row[width:])))


def _is_words(row: Row) -> bool:
    """Whether a line is a closing one: begins with a word, and not with a number or what may be part of one."""
    text = "".join(row).strip()
    return bool(text.strip("+-.,")) and not text[:1].isdigit() and not re.match(r"[+-]?[.,]?\d", text)


def _unglued(sheet: Sheet) -> Sheet:
    """The sheet, the first sample of which may stand in the last line above it, whose end of line was lost."""
    if not sheet.above:
        return sheet
    place, row = sheet.above[-1]
    width, found = sheet.form.width, None
    if len(row) == 2 * width - 1 and all(map(is_number, row[width:])):
        found = _GLUED.fullmatch(row[width - 1])
    if found is None or any(map(is_number, row[: width - 1])):
        return sheet
    names = [*row[: width - 1], found["name"].strip('"')]
    return replace(
        sheet,
        above=(*sheet.above[:-1], (place, names)),
        rows=[[found["number"], *row[width:]], *sheet.rows],
        places=[place, *sheet.places],
    )


def _is_cut(sheet: Sheet, line: str) -> bool | None:
    """Whether the last line, which has no end, lacks something; None where its last number may lack digits."""
    row = sheet.rows[-1]
    if not _is_data(row, sheet.form) or line.count('"') % 2:
        return True
    if line.rstrip().endswith('"'):
        return False
    last = max(c for c in range(sheet.form.width) if sheet.form.numeric[c])
    *before, own = [len(r[last].strip().partition(sheet.form.decimal)[2]) for r in sheet.rows[-50:] if len(r) > last]
    decimals = set(before)
    if len(decimals) == 1:
        return own not in decimals
    return None if decimals else False


def _lines(places: Sequence[int]) -> str:
    """`line 3`, `lines 3, 5, 9`."""
    return f"line{'s' * (len(places) > 1)} {_listed(places)}"


def _listed(values: Sequence[int]) -> str:
    """`3, 5, 9`, the first few and how many there are of more."""
    shown = ", ".join(map(str, values[:5]))
    return shown if len(values) <= 5 else f"{shown} and {len(values) - 5} more"
