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

import numpy as np
from numpy.typing import NDArray

from torcharm.characterise.cells import NUMBER, Row, decimal_sign, dress, has_value, is_number, number, text_lines
from torcharm.files import StrPath, read_file, without_collection

Array = NDArray[np.float64]

SEPARATORS = ("\t", ";", ",", " ")
"""A blank stands for any run of blanks and tabs."""
SAMPLED = 400
"""Lines from which separator, decimal sign and width are told, spread over the file."""
LONGEST_LINE = 100_000
"""Characters beyond which a line is damaged and cut: the csv module refuses cells of more than 131,072."""
MOST_DAMAGED, FEW = 0.01, 3
"""Of a file's lines of numbers, which share may be damaged and left out; or, of no fewer than ten times as many, how
many. With more the file is another one than it is taken for, or was damaged as a whole."""
LACKING = "lacking"
"""What stands for a cell that a line is too short to have; no number."""
SHOWN = 60
"""Characters of a line that messages show."""

_WIDE_GAP, _LETTER = re.compile(r"\s{2,}|\t"), re.compile(r"[^\W\d_]{2}")
_LABEL = re.compile(r"\s+(?=[^\W\d_]\w*\s*[:=]\s*[-+.\d])")
_GLUED = re.compile(rf"(?P<name>.*?[^\d.,+-])(?P<number>{NUMBER})\"?")


@dataclass(frozen=True, eq=False)
class Sheet:
    """The lines of a file, split into cells.

    Attributes:
        source: the file.
        above: lines before the first of numbers, with their numbers in the file.
        rows: lines from the first to the last of numbers; others may stand among them.
        places: the number of each row's line, counted from 1.
        width: cells of a line of numbers.
        numeric: of each of these, whether it mostly holds numbers.
        dress: of each, what stands before and behind most of its numbers, as in `p: 12.5 kPa`; "" for nothing.
        decimal: the decimal sign, "." or ",".
        sure: whether numbers tell it; not so where each comma may stand between thousands.
        closing: the first line behind the numbers that is none; "" without one.
        cut: whether the file ends within a line of numbers: True, False, or None where that cannot be told.
    """

    source: str
    above: tuple[tuple[int, Row], ...]
    rows: list[Row]
    places: list[int]
    width: int
    numeric: tuple[bool, ...]
    dress: tuple[tuple[str, str], ...]
    decimal: str
    sure: bool = True
    closing: str = ""
    cut: bool | None = False


@without_collection()
def read_sheet(path: StrPath, *, truncated: bool = False) -> Sheet:
    """Read a file of numbers in columns.

    Args:
        path: the file.
        truncated: whether to accept a file that ends within a line.

    Raises:
        ValueError: it cannot be read, is empty or no text, holds no lines of numbers, or is cut short.
    """
    source = str(path)
    lines, ended = text_lines(source, read_file(path))
    lines = [line if len(line) <= LONGEST_LINE else f"{line[:SHOWN]}…" for line in lines]
    if not any(line.strip() for line in lines):
        raise ValueError(f"{source}: is empty, must hold lines of numbers")
    sample = [line for line in (*lines[:20], *lines[:: max(1, len(lines) // SAMPLED)]) if line.strip()]
    separator = max(SEPARATORS, key=lambda one: sum(map(_worth, _split(sample, one))))
    sampled = [row for row in _split(sample, separator) if _worth(row) > 0]
    width = Counter(map(len, sampled)).most_common(1)[0][0] if sampled else 0
    own = tuple(_dress([row[c] for row in sampled if len(row) >= width]) for c in range(width))
    sampled = _undressed(sampled, own)
    numeric = tuple(_is_numeric([row[c] for row in sampled if len(row) >= width]) for c in range(width))
    if sum(numeric) < 2:
        first = next(n for n, line in enumerate(lines, 1) if line.strip())
        raise ValueError(
            f"{source}: line {first}: must be followed by lines of two or more numbers each, got "
            f"{short(lines[first - 1])} and none"
        )
    pairs = [(n, row) for n, row in enumerate(_undressed(_split(lines, separator), own), 1) if any(row)]
    sheet = Sheet(source, (), [], [], width, numeric, own, *decimal_sign(sampled, separator))
    first, last = _extent([row for _, row in pairs], sheet)
    sheet = replace(
        sheet,
        above=tuple(pairs[:first]),
        rows=[row for _, row in pairs[first:last]],
        places=[n for n, _ in pairs[first:last]],
        closing=lines[pairs[last][0] - 1] if last < len(pairs) else "",
    )
    sheet = _unglued(sheet)
    return sheet if ended or sheet.closing else _ending(sheet, lines, truncated)


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
    rows, places, left_out = sheet.rows, np.array(sheet.places), []
    said = ["commas are read as decimal signs"] if sheet.decimal == "," else []
    if not sheet.sure:
        read, other = ("decimal signs", "thousands") if said else ("thousands", "decimal signs")
        warnings.warn(
            f"{sheet.source}: commas read as {read}, as in 1,234, but no number tells them from {other}: are they?",
            stacklevel=4,
        )
    if sheet.cut is not False:
        left_out.append(f"line {places[-1]} has no end and may be cut, left out")
        rows, places = rows[:-1], places[:-1]
    if not rows:
        raise ValueError(
            f"{sheet.source}: line {sheet.places[-1]}: is the last line, must be followed by whole lines of numbers"
        )
    whole = [row if _is_whole(row, sheet.width) else [LACKING] * sheet.width for row in rows]
    table = np.stack([values_of([row[k] for row in whole], sheet.decimal) for k in columns], -1)
    words = np.zeros(len(rows), bool)
    words[[k for k in np.flatnonzero(np.isinf(table).any(-1)) if _is_words(rows[k], alone=True)]] = True
    void = words | (np.isnan(table).any(-1) & (not sparse) & ~np.isinf(table).any(-1))
    bad = np.isinf(table).any(-1) & ~words
    _check_few(sheet, places[bad].tolist(), columns, none_left=bool((bad | void).all()))
    if void.any():
        left_out.append(f"{_lines(places[void].tolist())} of words or with empty cells passed over")
    if bad.any():
        left_out.append(f"{_lines(places[bad].tolist())} damaged, left out")
    for what in left_out:
        warnings.warn(f"{sheet.source}: {what}", stacklevel=4)
    return table[~bad & ~void], places[~bad & ~void].tolist(), (*said, *left_out)


def values_of(cells: Row, decimal: str) -> Array:
    """The numbers (n) of a column, as of `cells.number`."""
    if decimal == "." or not any("." in cell for cell in cells):
        try:
            plain = cells if decimal == "." else [cell.replace(",", ".") for cell in cells]
            found = np.array(list(map(float, plain)))
        except ValueError:
            pass
        else:
            if np.isfinite(found).all():
                return found
    return np.array([number(cell, decimal) for cell in cells])


def _check_few(sheet: Sheet, bad: list[int], columns: Sequence[int], *, none_left: bool) -> None:
    """Raise a ValueError about the first of the lines that hold no numbers where they should, if they are many."""
    if len(bad) <= max(min(FEW, len(sheet.rows) / 10), MOST_DAMAGED * len(sheet.rows)) and not none_left:
        return
    bad = bad or sheet.places[:1]
    row = sheet.rows[sheet.places.index(bad[0])]
    more = f"; {len(bad)} of {len(sheet.rows)} lines are damaged, too many to leave out" if len(bad) > 1 else ""
    if sheet.decimal == "." and any("," in cell and is_number(cell) for cell in row):
        more += "; are there decimal commas beside decimal points?"
    raise ValueError(
        f"{sheet.source}: line {bad[0]}: must be {sheet.width} cells with finite numbers in columns "
        f"{_listed(sorted(column + 1 for column in columns))}, got {short(' '.join(row))}{more}"
    )


def short(line: str) -> str:
    """What stands in a line, in quotes, cut to a readable length."""
    text = " ".join(line.split())
    return repr(text if len(text) <= SHOWN else f"{text[: SHOWN - 3]}...")


# From lines to rows


def _split(lines: Sequence[str], separator: str) -> list[Row]:
    """Cells of each line; a quote that is not closed ends with its line."""
    if separator != " ":
        try:
            rows = list(csv.reader(lines, delimiter=separator, skipinitialspace=True))
        except csv.Error:  # a cell that goes on over lines has become too long
            rows = []
        if len(rows) == len(lines):
            return rows
        return [next(csv.reader([line], delimiter=separator, skipinitialspace=True), []) for line in lines]
    if any('"' in line for line in lines):
        lines = [line.replace('"', "") for line in lines]
    return [_words(line.strip()) for line in lines]


def _words(line: str) -> Row:
    """Cells between blanks: before names as `p: 12.5 kPa` has one; of several words, which stand further apart."""
    if _LABEL.search(line):
        return _LABEL.split(line)
    return _WIDE_GAP.split(line) if _WIDE_GAP.search(line) and _LETTER.search(line) else line.split()


def _worth(row: Row) -> int:
    """How well a separator splits a line: numbers count, words cost; a line of a single number is none."""
    count = sum(1 for cell in row if is_number(cell) or any(dress(cell)))
    return 0 if count < 2 else max(1, 2 * count - sum(1 for cell in row if cell.strip()))


def _is_numeric(column: Row) -> bool:
    """Whether more than half of the cells that have a value hold numbers."""
    filled = [cell for cell in column if has_value(cell)]
    return 2 * sum(map(is_number, filled)) > len(filled)


def _dress(column: Row) -> tuple[str, str]:
    """What stands before and behind the numbers of more than half of the cells that have a value."""
    filled = [cell for cell in column if has_value(cell)]
    own, times = Counter(map(dress, filled)).most_common(1)[0] if filled else (("", ""), 0)
    return own if 2 * times > len(filled) else ("", "")


def _undressed(rows: list[Row], dresses: Sequence[tuple[str, str]]) -> list[Row]:
    """The rows, numbers without what stands before and behind them."""
    for place, (label, unit) in enumerate(dresses):
        for row in rows if label or unit else ():
            if len(row) > place and row[place].startswith(label) and row[place].endswith(unit):
                bare = row[place].removeprefix(label).removesuffix(unit)
                row[place] = bare if is_number(bare) else row[place]
    return rows


def _extent(rows: Sequence[Row], sheet: Sheet) -> tuple[int, int]:
    """Which of the rows is the first of numbers, and which the first behind them."""
    looks = [_is_data(row, sheet) for row in rows[:SAMPLED]]
    # Another line of numbers soon behind it says that the first is no part of a preamble.
    near = [any(looks[i + 1 : i + 3]) or i >= len(rows) - 2 for i in range(len(looks))]
    first = next((i for i in range(len(looks)) if looks[i] and near[i]), 0)
    while first > 0 and _is_damaged_data(rows[first - 1], sheet.width):
        first -= 1
    last = len(rows)
    while last > first and not _is_data(rows[last - 1], sheet) and _is_words(rows[last - 1]):
        last -= 1
    return first, last


def _is_data(row: Row, sheet: Sheet) -> bool:
    """Whether all cells that should do hold numbers, or nothing, and two at least a number."""
    if not _is_whole(row, sheet.width):
        return False
    cells = [cell for cell, own in zip(row, sheet.numeric, strict=False) if own]
    filled = [cell for cell in cells if has_value(cell)]
    return len(filled) >= min(2, len(cells)) and all(map(is_number, filled))


def _is_damaged_data(row: Row, width: int) -> bool:
    """Whether a line above the numbers is one of them, and no header of numbers, which begins with a word."""
    filled = [cell for cell in row if cell.strip()]
    return len(row) == width and 2 * sum(map(is_number, filled)) >= len(filled) and not _is_words(filled[:1])


def _is_whole(row: Row, width: int) -> bool:
    """Whether a line has all cells, and beyond them words alone: an event's name, but not the next line's numbers."""
    return len(row) == width or (len(row) > width and not any(map(is_number, row[width:])))


def _is_words(row: Row, *, alone: bool = False) -> bool:
    """Whether a line begins with a word, not with a number or what may be part of one; and alone, holds no number."""
    text = "".join(row).strip()
    begins = bool(text.strip("+-.,")) and not re.match(r"[+-]?[.,]?\d", text)
    return begins and not (alone and any(map(is_number, row)))


def _unglued(sheet: Sheet) -> Sheet:
    """The sheet, the first sample of which may stand in the last line above it, whose end of line was lost."""
    place, row = sheet.above[-1] if sheet.above else (0, [])
    width = sheet.width
    found = _GLUED.fullmatch(row[width - 1]) if len(row) == 2 * width - 1 else None
    if found is None or any(map(is_number, row[: width - 1])) or not all(map(is_number, row[width:])):
        return sheet
    names = [*row[: width - 1], found["name"].strip('"')]
    return replace(
        sheet,
        above=(*sheet.above[:-1], (place, names)),
        rows=[[found["number"], *row[width:]], *sheet.rows],
        places=[place, *sheet.places],
    )


def _ending(sheet: Sheet, lines: Sequence[str], truncated: bool) -> Sheet:
    """The sheet of a file whose last line has no end, which may be cut."""
    if sheet.places[-1] < len(lines):  # a quote, or nothing else that a cell holds
        sheet = replace(sheet, rows=[*sheet.rows, []], places=[*sheet.places, len(lines)])
    cut = _is_cut(sheet, lines[-1])
    if cut and not truncated:
        raise ValueError(
            f"{sheet.source}: line {sheet.places[-1]}: must be a whole line of {sheet.width} cells, got "
            f"{short(' '.join(sheet.rows[-1]))}, where the file ends: it is cut short (--truncated leaves the line out)"
        )
    return replace(sheet, cut=cut)


def _is_cut(sheet: Sheet, line: str) -> bool | None:
    """Whether the last line, which has no end, lacks something; None where its last number may lack digits."""
    if not _is_data(sheet.rows[-1], sheet) or line.count('"') % 2:
        return True
    if line.rstrip().endswith('"'):
        return False
    last = max(c for c in range(sheet.width) if sheet.numeric[c])
    *before, own = [len(r[last].strip().partition(sheet.decimal)[2]) for r in sheet.rows[-50:] if len(r) > last]
    decimals = set(before)
    if len(decimals) == 1:
        return own not in decimals
    return None if decimals else False


def _lines(places: list[int]) -> str:
    """`line 3`, `lines 3, 5, 9`."""
    return f"line{'s' * (len(places) > 1)} {_listed(places)}"


def _listed(values: list[int]) -> str:
    """`3, 5, 9`, the first few and how many there are of more."""
    shown = ", ".join(map(str, values[:5]))
    return shown if len(values) <= 5 else f"{shown} and {len(values) - 5} more"
