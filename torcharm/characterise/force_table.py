"""Tables of forces by strain and pressure, as data sheets print them: a line for each, or a line for each strain."""

import re
import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from torcharm.characterise.alignment import Recording, noted
from torcharm.characterise.cells import Row, is_number, number
from torcharm.characterise.column_names import NAMES, is_compressive
from torcharm.characterise.columns import (
    Choice,
    Column,
    Columns,
    check_one_header,
    choices,
    find_columns,
    has_column,
)
from torcharm.characterise.delimited import Array, Form, Sheet, check_damage, numbers, read_sheet
from torcharm.characterise.headers import header_of
from torcharm.characterise.recordings import POSITIVE, ask_if_absolute, gauge_pressure
from torcharm.characterise.signs import settled
from torcharm.characterise.stretch import check_strains, known_signs, strains_of, stretch_quantity
from torcharm.files import StrPath
from torcharm.inputs import check_choice
from torcharm.units import PRESSURE, STRAIN, unit_named

LEADS = ("contraction", "extension", "strain", "length", "pressure")
"""What the first column of a table of forces alone may hold."""
_HEAD = re.compile(r"\s*([-+]?[\d.,]+(?:[eE][-+]?\d+)?)\s*[(\[]?\s*([^\d\s()\[\]]*[^()\[\]]*?)\s*[)\]]?\s*")
_INSIDE = re.compile(r"(?<!\d_)([-+]?(?<![\d.,])\d[\d.,]*)\s*([^\W\d_]+)")
_MATLAB = re.compile(r"^x(\d+)_(\d+)")
"""How Matlab names a column of 0.1 MPa: `x0_1MPa`."""
_BRACKETS = re.compile(r"[(\[]([^()\[\]]*)[)\]]")


def read_table(
    path: StrPath,
    unit: str | None = None,
    *,
    columns: Columns | None = None,
    gauge_length: float | None = None,
    positive: str | None = None,
) -> Recording:
    """Read a table of forces: columns of strain or contraction, pressure and force; or one of forces alone.

    The latter has a line for each strain or contraction, which its first cell holds, and a column for each pressure,
    which the header names as in `0 bar;1 bar;2 bar`; or lines of pressures and columns of strains. Cells may be empty.

    Args:
        path: the file.
        unit: of pressures that the file gives without one.
        columns: as of `read_tester`; in a table of forces alone 1 is what its lines are of, 2 what its columns are.
        gauge_length: of the actuator [m], where the table gives extensions.
        positive: whether positive forces "pull" or "push"; None: what samples tell (`signs.positive_forces`), or else
            those of contractions pull and others push.

    Raises:
        ValueError: the file cannot be read, names no unit, or holds what is no number; it names file and line.

    Example:
        >>> _ = (path := folder / "sheet.csv").write_text("contraction [%];0 bar;1 bar\\n0;0;40\\n10;-5;30\\n")
        >>> ta.read_table(path).strain.tolist(), ta.read_table(path).force.tolist()  # negative forces pull
        ([0.0, 0.0, -0.1, -0.1], [0.0, -40.0, 5.0, -30.0])
    """
    for name, value, allowed in (("unit", unit, PRESSURE), ("positive", positive, POSITIVE)):
        if value is not None:
            check_choice(name, value, allowed)
    sheet, notes = _long(_headed(read_sheet(path)), choices(columns))
    quantity = stretch_quantity(sheet, columns, gauge_length)
    defaults = {"strain": "mm/mm", "contraction": "mm/mm"} | ({} if unit is None else {"pressure": unit})
    found = find_columns(sheet, (quantity, "pressure", "force"), columns, defaults)
    stretch, pressures, forces = found.values()
    pressures.check_unit(unit, sheet.source, "--columns")
    table, line, left_out = numbers(sheet, [column.index for column in found.values()])
    strain, pressure, force = (table * [column.factor for column in found.values()]).T
    _check_parts(sheet.source, stretch, strain)
    pressure, taken_off = gauge_pressure(pressure, sheet.source, pressures)
    strain = strains_of(sheet, stretch, gauge_length, strain)
    check_strains(sheet.source, strain, stretch)
    usual = "pull" if quantity == "contraction" else "push"
    signs = known_signs(stretch, squeezes=forces.compressive, positive=positive, usual=usual)
    strain, force, words = settled(signs, strain, pressure, force, sheet.source)
    option = "" if pressures.absolute else f"--columns {pressures.as_absolute}"
    ask_if_absolute(sheet.source, option, strain, pressure, force, rests=False)
    guessed = () if stretch.named else (f"names no unit of {quantity}: read as parts of 1",)
    said = noted(sheet.source, (*notes, *left_out, *guessed, *forces.notes, *taken_off))
    run, name = np.zeros(len(force), np.int64), Path(sheet.source).name
    read = Recording(strain, pressure, force, run, (name,), (*words, *said), np.array(line))
    _ask_about_contradictions(read)
    return read


MOST_WITHOUT_UNIT = {"contraction": 1.0, "strain": 5.0}
"""What parts of 1 may reach: nothing contracts to less than no length; larger numbers are percents."""
ROUNDING = 2e-3
"""Of the largest force, by how much columns of one heading may differ."""
CONTRADICTING = 0.02
"""Of the largest force, by how much forces at one strain and pressure may differ: presses and hysteresis do as much."""


def _check_parts(source: str, stretch: Column, strain: Array) -> None:
    """Raise a ValueError about strains that name no unit and are too large for parts of 1."""
    most = float(np.abs(strain).max())
    if not stretch.named and most > MOST_WITHOUT_UNIT.get(stretch.quantity, np.inf):
        raise ValueError(
            f"{source}: {stretch.quantity} reaches {most:g} and names no unit, must be a part of 1 or name one: is it "
            f'in %? --columns "{stretch.quantity}={stretch.index + 1}:%" says so'
        )


def _ask_about_contradictions(table: Recording) -> None:
    """Warn of the lines whose forces differ most at one strain and pressure; refuse columns of one heading that do."""
    _, place = np.unique(np.column_stack((table.strain, table.pressure)).round(9), axis=0, return_inverse=True)
    order = np.lexsort((table.force, place.ravel()))
    group = place.ravel()[order]
    starts = np.flatnonzero(np.diff(group, prepend=-1))
    low, high = order[starts], order[np.append(starts[1:], len(group)) - 1]
    spread = (table.force[high] - table.force[low]) / np.abs(table.force).max()
    assert table.line is not None
    in_line = spread * (table.line[low] == table.line[high])
    refused = in_line.max() > ROUNDING
    worst = int((in_line if refused else spread).argmax())
    if not refused and spread[worst] <= CONTRADICTING:
        return
    a, b = sorted((int(low[worst]), int(high[worst])))
    forces = f"{abs(table.force[a]):.4g} and {abs(table.force[b]):.4g} N"
    where = f"strain {table.strain[a]:.3g} and {table.pressure[a]:.4g} kPa"
    if refused:
        raise ValueError(
            f"{table.sources[0]}: line {table.line[a]}: must hold one force at {where}, got {forces}: is one heading "
            "wrong, or are there two tables side by side?"
        )
    warnings.warn(
        f"{table.sources[0]}: lines {table.line[a]} and {table.line[b]} contradict each other: {forces} at {where}; "
        f"{(spread > CONTRADICTING).sum()} such in all, whose mean is fitted",
        stacklevel=3,
    )


def _headed(sheet: Sheet) -> Sheet:
    """The sheet, a first line of numbers without the first of which is a header of bare numbers."""
    first = sheet.rows[0]
    if not sheet.above or first[0].strip() or not all(map(is_number, first[1:])):
        return sheet
    above = (*sheet.above, (sheet.places[0], first))
    return replace(sheet, above=above, rows=sheet.rows[1:], places=sheet.places[1:])


def _columns_of_header(sheet: Sheet) -> list[tuple[float, str]] | None:
    """The number and the unit of each column but the first; None: some have none, or words are about forces."""
    if not sheet.above:
        return None
    cells = (sheet.above[-1][1] + [""] * sheet.form.width)[1 : sheet.form.width]
    found = [_number_and_unit(cell, sheet.form.decimal) for cell in cells]
    if len(cells) < 2 or not all(np.isfinite(value) for value, _ in found):
        return None
    pressures = all(unit_named(unit, "pressure") for _, unit in found)
    return found if pressures or not has_column(sheet, "force", None) else None


def _number_and_unit(cell: str, decimal: str) -> tuple[float, str]:
    """What `2 bar`, `2` and `force at 2 bar [N]` name, with NaN for none."""
    cell = _MATLAB.sub(r"\1.\2", cell)
    match = _HEAD.fullmatch(cell)
    if match is None:
        inside = [m for m in _INSIDE.finditer(cell) if unit_named(m[2], "pressure")]
        match = inside[0] if len(inside) == 1 else None
    return (np.nan, "") if match is None else (number(match[1], decimal), match[2])


def _long(sheet: Sheet, said: Mapping[str, Choice]) -> tuple[Sheet, tuple[str, ...]]:
    """The table with a line for each force, in columns of what lines were of, of what columns were of, and of forces.

    A table that is one already stays what it is. Notes say what was left out and assumed.
    """
    check_damage(sheet)
    heads = None if "force" in said else _columns_of_header(sheet)
    if heads is None:
        return sheet, ()
    line = sheet.above[-1][0]
    check_one_header(sheet, header_of(sheet), least=1)
    table, places, notes = numbers(sheet, range(sheet.form.width), sparse=True)
    lacking = int(np.isnan(table[:, 1:]).sum())
    notes = (*notes, *([f"{lacking} cell{'s' * (lacking > 1)} without a value left out"] if lacking else []))
    names, unnamed = _names(f"{sheet.source}: line {line}", sheet, heads, said)
    cells = [
        (place, [repr(own[0]), repr(head), repr(force)])
        for place, own in zip(places, table.tolist(), strict=True)
        for (head, _), force in zip(heads, own[1:], strict=True)
        if np.isfinite(force)
    ]
    form = Form(",", 3, ".", True, (True,) * 3, (("", ""),) * 3)
    rows, lines = [own for _, own in cells], [place for place, _ in cells]
    above = ((line, names),)
    return replace(sheet, above=above, rows=rows, places=lines, form=form, cut=False), (*notes, *unnamed)


def _names(
    where: str, sheet: Sheet, heads: list[tuple[float, str]], said: Mapping[str, Choice]
) -> tuple[Row, tuple[str, ...]]:
    """What lines and columns of a table are of, and its forces, with their units; and what was assumed."""
    row, titles = sheet.above[-1][1], [cell for _, cells in sheet.above[:-1] for cell in cells]
    text = " ".join([row[0], *titles])
    marks = sorted((match.start(), q) for q in LEADS if (match := re.search(NAMES[q], text.lower())))
    told = {choice.column or "1": quantity for quantity, choice in said.items()}
    start, lead = marks[0] if marks else (0, told.get("1", ""))
    # One of the two is the pressure.
    other = next(((at, q) for at, q in marks if (q == "pressure") != (lead == "pressure")), None)
    if not lead or (lead == "pressure" and not other and "2" not in told and not _are_shares(where, heads)):
        raise ValueError(
            f"{where}: must begin with what the first column holds, and its unit, as in 'contraction [%]' or, with "
            f"pressures there, 'pressure [bar] / contraction [%]', got {row[0]!r}; or --columns says it, as in "
            f'"contraction={2 if lead else 1}:%"'
        )
    units = {unit for _, unit in heads if unit}
    if len(units) > 1:
        raise ValueError(f"{where}: must name one unit of its columns, got {' and '.join(sorted(units))}")
    in_corner = start < len(row[0])
    end = other[0] if other else len(row[0]) if in_corner else len(text)
    default = "contraction" if lead == "pressure" else "pressure"
    before = text[: start * in_corner]
    before = "" if re.search(NAMES["force"], before.lower()) else before
    along, across = (
        re.split(NAMES["force"], own, flags=re.IGNORECASE)[0] for own in (text[start:end], text[end:] * bool(other))
    )
    across = (_BRACKETS.sub(" ", across) if units else across) or default
    brackets = [unit for cell in (*titles, row[0]) for unit in _BRACKETS.findall(cell)]
    unit = next((own for own in (*brackets, sheet.form.dress[1][1]) if unit_named(own, "force")), "")
    squeezes = "compressive " * any(is_compressive(cell) for cell in (*titles, *row))
    names = [before + along, across, f"{squeezes}force"]
    behind = sheet.form.dress[0][1].strip(), *(units or {""}), unit or "N"
    names = [f"{name} [{own}]" if own else name for name, own in zip(names, behind, strict=True)]
    return names, () if unit else ("names no unit of forces: read in N",)


def _are_shares(where: str, heads: list[tuple[float, str]]) -> bool:
    """Whether columns are of shares, which are taken for contractions then; a warning says so."""
    shares = all(unit and unit_named(unit, "contraction") in STRAIN for _, unit in heads)
    if shares:
        warnings.warn(
            f"{where}: names nothing that its columns are of: taken for contractions, as of data sheets of muscles; "
            '--columns "extension=2:%" takes them for extensions',
            stacklevel=5,
        )
    return shares
