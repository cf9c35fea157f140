"""Text files of numbers in columns, as testers, loggers and spreadsheets write them: found out, not configured.

Encoding, line ends, separator, decimal sign, thousands, quotes, a preamble, a header with or without a row of units,
and a footer are told from the file itself. The csv module splits lines and `float` reads cells: both are written in C,
so that 10 MB take less than a second, and no data frame library is needed for what is a list of columns.
"""

import csv
import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from torcharm.files import StrPath, read_file

Array = NDArray[np.float64]
Row = list[str]

SEPARATORS = ("\t", ";", ",", " ")
"""A blank stands for any run of blanks and tabs."""
SAMPLED = 400
"""Lines from which separator, decimal sign and width are told, spread over the file."""
LONGEST_LINE = 100_000
"""Characters beyond which a line is damaged, and left out unread: the csv module refuses cells of more than 131,072."""
MOST_DAMAGED, FEW = 0.01, 3
"""Of a file's lines of numbers, which share may be damaged and left out; or, of no fewer than ten times as many, how
many. With more the file is another one than it is taken for, or was damaged as a whole."""
_SHOWN = 60

_NUMBER = r"[+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][+-]?\d+)?"
_IS_NUMBER = re.compile(rf"\s*(?:{_NUMBER}|[+-]?\d{{1,3}}(?:[.,'\u00a0\u202f]\d{{3}})+(?:[.,]\d+)?)\s*")
_GROUPED = {
    ",": re.compile(r"\s*[+-]?\d{1,3}(?:,\d{3})+(?:\.\d*)?\s*"),
    ".": re.compile(r"\s*[+-]?\d{1,3}(?:\.\d{3})+(?:,\d*)?\s*"),
}
_WIDE_GAP, _LETTER = re.compile(r"\s{2,}|\t"), re.compile(r"[^\W\d_]{2}")
_BETWEEN_THOUSANDS = re.compile(r"(?<=\d)['\u00a0\u202f](?=\d{3})")
_GLUED = re.compile(rf"(?P<name>.*?[^\d.,+-])(?P<number>{_NUMBER})\"?")


@dataclass(frozen=True, eq=False)
class Sheet:
    """The lines of a file, split into cells.

    Attributes:
        source: the file.
        above: lines before the first of numbers, with their numbers in the file.
        rows: lines from the first to the last of numbers; others may stand among them.
        places: the number of each row's line, counted from 1.
        width: cells of a line of numbers.
        decimal: the decimal sign, "." or ",".
        numeric: of each cell, whether it mostly holds numbers.
        closing: the first line behind the numbers that is none; "" without one.
        damaged: numbers of lines that could not be split.
        cut: whether the file ends within a line of numbers: True, False, or None where that cannot be told.
    """

    source: str
    above: tuple[tuple[int, Row], ...]
    rows: list[Row]
    places: list[int]
    width: int
    decimal: str
    numeric: tuple[bool, ...]
    closing: str
    damaged: tuple[int, ...]
    cut: bool | None


def read_sheet(path: StrPath) -> Sheet:
    """Read a file of numbers in columns.

    Raises:
        ValueError: it cannot be read, is empty or no text, or holds no lines of numbers.
    """
    source = str(path)
    lines, ended = _lines(source, read_file(path))
    if not any(line.strip() for line in lines):
        raise ValueError(f"{source}: is empty, must hold lines of numbers")
    whole = [number for number, line in enumerate(lines, 1) if len(line) <= LONGEST_LINE]
    damaged = tuple(number for number, line in enumerate(lines, 1) if len(line) > LONGEST_LINE)
    kept = [line for line in lines if len(line) <= LONGEST_LINE] if damaged else lines
    sample = [line for line in kept[:: max(1, len(kept) // SAMPLED)] if line.strip()] + [x for x in kept[:20] if x]
    separator = max(SEPARATORS, key=lambda one: sum(map(_worth, _split(sample, one))))
    sampled = [row for row in _split(sample, separator) if _worth(row) > 0]
    if not sampled:
        first = next(number for number, line in enumerate(lines, 1) if line.strip())
        raise ValueError(
            f"{source}: line {first}: must be followed by lines of two or more numbers each, got "
            f"{short(lines[first - 1])} and none"
        )
    decimal = _decimal(sampled, separator)
    width, _ = Counter(map(len, sampled)).most_common(1)[0]
    numeric = _numeric(sampled, width)
    pairs = [(n, row) for n, row in zip(whole, _split(kept, separator), strict=True) if any(row)]
    looks = [_is_data(row, width, numeric) for _, row in pairs[:SAMPLED]]
    # Another line of numbers soon behind it says that the first is no part of a preamble.
    near = [any(looks[i + 1 : i + 3]) or i >= len(pairs) - 2 for i in range(len(looks))]
    first = next((i for i in range(len(looks)) if looks[i] and near[i]), 0)
    while first > 0 and _is_damaged_data(pairs[first - 1][1], width):
        first -= 1
    last = len(pairs)
    while last > first and not _is_data(pairs[last - 1][1], width, numeric) and _is_words(pairs[last - 1][1]):
        last -= 1
    closing = lines[pairs[last][0] - 1] if last < len(pairs) else ""
    sheet = Sheet(
        source,
        tuple(pairs[:first]),
        [row for _, row in pairs[first:last]],
        [number for number, _ in pairs[first:last]],
        width,
        decimal,
        numeric,
        closing,
        damaged,
        cut=False,
    )
    sheet = _unglued(sheet)
    if ended or closing:
        return sheet
    if sheet.places[-1] < len(lines):  # a quote, or nothing else that a cell holds
        sheet = replace(sheet, rows=[*sheet.rows, []], places=[*sheet.places, len(lines)])
    return replace(sheet, cut=_is_cut(sheet, lines[-1]))


def numbers(
    sheet: Sheet, columns: Sequence[int], *, truncated: bool = False, sparse: bool = False
) -> tuple[Array, list[int], tuple[str, ...]]:
    """The numbers (n, k) of some columns, the number of each one's line, and what was left out, in words.

    Args:
        sheet: of a file.
        columns: which, counted from 0.
        truncated: whether to accept a file that ends within a line; that line is left out.
        sparse: whether cells may be empty, which become NaN.

    Raises:
        ValueError: the file ends within a line, more lines are damaged than may be left out, or none is left.
    """
    rows, places, said = sheet.rows, sheet.places, list[str]()
    if sheet.cut and not truncated:
        raise ValueError(
            f"{sheet.source}: line {places[-1]}: must be a whole line of {sheet.width} cells, got "
            f"{short(' '.join(rows[-1]))}, where the file ends: it is cut short (--truncated leaves the line out)"
        )
    if sheet.cut is not False:
        said.append(f"line {places[-1]} has no end and may be cut, left out")
        rows, places = rows[:-1], places[:-1]
    fits = [len(row) == sheet.width or _fits(row, sheet.width) for row in rows]
    if not all(fits):
        rows = [row if fit else [] for row, fit in zip(rows, fits, strict=True)]
    table = _fast(sheet, rows, columns)
    if table is None:
        table = np.array([[_value(row, column, sheet.decimal, sparse=sparse) for column in columns] for row in rows])
        table = table.reshape(len(rows), len(columns))
    good = np.isfinite(table).all(-1) if not sparse else ~np.isposinf(table).any(-1)
    bad = sorted([*sheet.damaged, *(places[i] for i in np.flatnonzero(~good))])
    if not len(good):
        raise ValueError(
            f"{sheet.source}: line {sheet.places[-1]}: is the last line, must be followed by whole lines of numbers"
        )
    if len(bad) > max(min(FEW, len(rows) / 10), MOST_DAMAGED * len(rows)) or not good.any():
        raise _too_damaged(sheet, bad, columns)
    if bad:
        said.append(f"line{'s' * (len(bad) > 1)} {_listed(bad)} damaged, left out")
    return table[good], [place for place, fine in zip(places, good.tolist(), strict=True) if fine], tuple(said)


def _too_damaged(sheet: Sheet, bad: Sequence[int], columns: Sequence[int]) -> ValueError:
    """What is wrong with the first of the lines that hold no numbers where they should."""
    row = dict(zip(sheet.places, sheet.rows, strict=True)).get(bad[0])
    got = f"more than {LONGEST_LINE} characters" if row is None else short(" ".join(row))
    more = f"; {len(bad)} of {len(sheet.rows)} lines are damaged, too many to leave out" if len(bad) > 1 else ""
    return ValueError(
        f"{sheet.source}: line {bad[0]}: must be {sheet.width} cells with finite numbers in columns "
        f"{_listed(sorted(column + 1 for column in columns))}, got {got}{more}"
    )


def short(line: str) -> str:
    """What stands in a line, in quotes, cut to a readable length."""
    text = " ".join(line.split())
    return repr(text if len(text) <= _SHOWN else f"{text[: _SHOWN - 3]}...")


def is_number(cell: str) -> bool:
    """Whether a cell holds a number, by any decimal sign."""
    return _IS_NUMBER.fullmatch(cell) is not None


def number(cell: str, decimal: str) -> float:
    """The number in a cell; NaN if it holds none that is finite."""
    return _value([cell], 0, decimal)


# From bytes to rows


def _lines(source: str, data: bytes) -> tuple[list[str], bool]:
    """A file's lines by any ending, and whether the last one is ended."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        text = data.decode("utf-16", errors="replace")
    elif b"\0" in data:
        line = data[: data.index(b"\0")].count(b"\n") + 1
        raise ValueError(f"{source}: line {line}: must be text, got a byte 0, as of a program's own format")
    else:
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = data.decode("cp1252", errors="replace")
    # CR, CR LF and the loggers' CR CR LF end one line each.
    text = re.sub("\r+\n?", "\n", text) if "\r" in text else text
    lines = text.split("\n")
    ended = not lines[-1].strip()
    return lines[:-1] if lines[-1] == "" else lines, ended


def _split(lines: Sequence[str], separator: str) -> list[Row]:
    """Cells of each line. A quote that is not closed is taken for a mark, or it would swallow the lines behind it."""
    if any('"' in line for line in lines):
        lines = [line.replace('"', "") if line.count('"') % 2 else line for line in lines]
    if separator != " ":
        return list(csv.reader(lines, delimiter=separator, skipinitialspace=True))
    # Names and units of several words stand further apart than words do.
    return [
        _WIDE_GAP.split(line.strip()) if _WIDE_GAP.search(line.strip()) and _LETTER.search(line) else line.split()
        for line in lines
    ]


def _worth(row: Row) -> int:
    """How well a separator splits a line: numbers count, words cost; a line of a single number is none."""
    count = sum(map(is_number, row))
    return 0 if count < 2 else max(1, 2 * count - sum(1 for cell in row if cell.strip()))


def _decimal(rows: Sequence[Row], separator: str) -> str:
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


def _numeric(rows: Sequence[Row], width: int) -> tuple[bool, ...]:
    """Of each of so many cells, whether more than half of those filled hold numbers."""
    own = [row for row in rows if len(row) >= width]
    columns = [[row[c] for row in own if row[c].strip()] for c in range(width)]
    return tuple(2 * sum(map(is_number, column)) > len(column) for column in columns)


def _is_data(row: Row, width: int, numeric: Sequence[bool]) -> bool:
    """Whether all cells that should do hold numbers, or nothing, and two at least a number."""
    if len(row) != width and not _fits(row, width):
        return False
    cells = [cell for cell, own in zip(row, numeric, strict=False) if own]
    filled = [cell for cell in cells if cell.strip()]
    return len(filled) >= min(2, len(cells)) and all(map(is_number, filled))


def _is_damaged_data(row: Row, width: int) -> bool:
    """Whether a line above the numbers is one of them, and no header of numbers, which begins with a word."""
    filled = [cell for cell in row if cell.strip()]
    return len(row) == width and 2 * sum(map(is_number, filled)) >= len(filled) and not _is_words(filled[:1])


def _fits(row: Row, width: int) -> bool:
    """Whether what a line holds beyond its width is words: an event's name, say, but not the next line's numbers."""
    return len(row) > width and not any(map(is_number, row[width:]))


def _is_words(row: Row) -> bool:
    """Whether a line is a closing one: begins with a word, and not with a number or what may be part of one."""
    text = "".join(row).strip()
    return bool(text.strip("+-.,")) and not text[:1].isdigit() and not re.match(r"[+-]?[.,]?\d", text)


def _unglued(sheet: Sheet) -> Sheet:
    """The sheet, the first sample of which may stand in the last line above it, whose end of line was lost."""
    if not sheet.above:
        return sheet
    place, row = sheet.above[-1]
    width, found = sheet.width, None
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
    if not _is_data(row, sheet.width, sheet.numeric) or line.count('"') % 2:
        return True
    if line.rstrip().endswith('"'):
        return False
    last = max(c for c in range(sheet.width) if sheet.numeric[c])
    decimals = {len(row[last].strip().partition(sheet.decimal)[2]) for row in sheet.rows[-50:-1] if len(row) > last}
    own = len(row[last].strip().partition(sheet.decimal)[2])
    if len(decimals) == 1:
        return own not in decimals
    return None if decimals else False


# From cells to numbers


def _fast(sheet: Sheet, rows: Sequence[Row], columns: Sequence[int]) -> Array | None:
    """The numbers if every cell is one as Python writes it; None: look at each."""
    table = np.empty((len(rows), len(columns)))
    try:
        for place, column in enumerate(columns):
            cells = [row[column] for row in rows]
            if sheet.decimal == ",":
                if any("." in cell for cell in cells):
                    return None
                cells = [cell.replace(",", ".") for cell in cells]
            table[:, place] = list(map(float, cells))
    except (ValueError, IndexError):
        return None
    return table if np.isfinite(table).all() else None


def _value(row: Row, column: int, decimal: str, *, sparse: bool = False) -> float:
    """A cell's number: NaN if it holds none; or where cells may be empty NaN for those, and inf for what is none."""
    cell = row[column].strip() if column < len(row) else "lacking"
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


def _listed(values: Sequence[int]) -> str:
    """`3, 5, 9`, the first few and how many there are of more."""
    shown = ", ".join(map(str, values[:5]))
    return shown if len(values) <= 5 else f"{shown} and {len(values) - 5} more"
