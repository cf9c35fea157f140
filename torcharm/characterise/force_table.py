"""Tables of forces by strain and pressure, as data sheets print them: a line for each, or a line for each strain."""

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from torcharm.characterise.alignment import Recording, noted
from torcharm.characterise.cells import is_number, number
from torcharm.characterise.columns import (
    Choice,
    Column,
    Columns,
    choices,
    find_columns,
    has_column,
    is_compressive,
    is_sure,
    likely_unit,
    named_by,
    told,
    units_among_words,
)
from torcharm.characterise.delimited import Array, Sheet, check_damage, numbers, read_sheet, short
from torcharm.characterise.recordings import POSITIVE, ask_if_absolute, gauge_pressure
from torcharm.characterise.signs import settled
from torcharm.characterise.stretch import PLAUSIBLE_STRAIN, check_strains, known_signs, strain_scale, stretch_quantity
from torcharm.files import StrPath
from torcharm.inputs import check_choice
from torcharm.units import FORCE, MEASURED, PRESSURE, STRAIN, is_absolute, unit_named

LEADS = ("contraction", "extension", "strain", "pressure")
"""What the first column of a table of forces alone may hold."""
_HEAD = re.compile(r"\s*([-+]?[\d.,]+(?:[eE][-+]?\d+)?)\s*[(\[]?\s*([^\d\s()\[\]]*[^()\[\]]*?)\s*[)\]]?\s*")
_INSIDE = re.compile(r"([-+]?\d[\d.,]*)\s*([^\W\d_]+)")
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
    sheet = _headed(read_sheet(path))
    check_damage(sheet)
    wide = None if "force" in told(columns) else _columns_of_header(sheet)
    if wide is None:
        samples = _long(sheet, unit, columns, gauge_length)
    else:
        samples = _wide(sheet, wide, columns, unit, gauge_length)
    own = np.isfinite(samples.force)
    strain, pressure, force = (x[own] for x in (samples.strain, samples.pressure, samples.force))
    check_strains(sheet.source, strain, samples.stretch)
    usual = "pull" if samples.stretch.quantity == "contraction" else "push"
    signs = known_signs(samples.stretch, squeezes=samples.squeezes, positive=positive, usual=usual)
    strain, force, words = settled(signs, strain, pressure, force, sheet.source)
    option = "" if samples.pressures.absolute else f"--columns {samples.pressures.as_absolute}"
    ask_if_absolute(sheet.source, option, strain, pressure, force, rests=False)
    lacking = int((~own).sum())
    notes = (*samples.notes, *([f"{lacking} cell{'s' * (lacking > 1)} without a value left out"] if lacking else []))
    found = Recording(
        strain,
        pressure,
        force,
        np.zeros(len(force), np.int64),
        (Path(sheet.source).name,),
        (*words, *noted(sheet.source, notes)),
        samples.line[own],
    )
    _ask_about_contradictions(found)
    return found


MOST_WITHOUT_UNIT = {"contraction": 1.0, "strain": PLAUSIBLE_STRAIN[1]}
"""What parts of 1 may reach: nothing contracts to less than no length; larger numbers are percents."""
ROUNDING = 2e-3
"""Of the largest force, by how much columns of one heading may differ."""
CONTRADICTING = 0.02
"""Of the largest force, by how much forces at one strain and pressure may differ: presses and hysteresis do as much."""


@dataclass(frozen=True, eq=False)
class _Samples:
    """Of a table: n strains, pressures [kPa], forces [N] as it has them, NaN where it has none, and their lines.

    Attributes:
        stretch: which quantity the strains come from.
        squeezes: whether forces are named compressive.
        notes: what was left out or assumed.
        pressures: the column or columns that name them.
    """

    strain: Array
    pressure: Array
    force: Array
    line: NDArray[np.int64]
    stretch: Column
    squeezes: bool
    notes: Sequence[str]
    pressures: Column


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


def _long(sheet: Sheet, unit: str | None, columns: Columns | None, gauge_length: float | None) -> _Samples:
    quantity = stretch_quantity(sheet, columns, gauge_length)
    defaults = {} if unit is None else {"pressure": unit}
    defaults |= {"strain": "mm/mm", "contraction": "mm/mm"}
    found = find_columns(sheet, (quantity, "pressure", "force"), columns, defaults)
    stretch = found[quantity]
    found["pressure"].check_unit(unit, sheet.source, "--columns")
    table, line, notes = numbers(sheet, [column.index for column in found.values()])
    strain, pressure, force = (table * [column.factor for column in found.values()]).T
    if not stretch.named and np.abs(strain).max() > MOST_WITHOUT_UNIT.get(quantity, np.inf):
        raise ValueError(
            f"{sheet.source}: {quantity} reaches {np.abs(strain).max():g} and names no unit, must be a part of 1 or "
            f'name one: is it in %? --columns "{quantity}={stretch.index + 1}:%" says so'
        )
    pressure, taken_off = gauge_pressure(pressure, sheet.source, found["pressure"])
    strain = strain_scale(sheet, stretch, gauge_length) * strain
    notes = notes if stretch.named else (*notes, f"names no unit of {quantity}: read as parts of 1")
    squeezes = found["force"].compressive
    notes = (*notes, *found["force"].notes, *taken_off)
    return _Samples(strain, pressure, force, np.array(line), stretch, squeezes, notes, found["pressure"])


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
    match = _HEAD.fullmatch(cell)
    if match is None:
        inside = [m for m in _INSIDE.finditer(cell) if unit_named(m[2], "pressure")]
        match = inside[0] if len(inside) == 1 else None
    return (np.nan, "") if match is None else (number(match[1], decimal), match[2])


def _wide(
    sheet: Sheet, heads: list[tuple[float, str]], columns: Columns | None, unit: str | None, gauge_length: float | None
) -> _Samples:
    line, row = sheet.above[-1]
    where = f"{sheet.source}: line {line}"
    corner = row[0] if _leads(row[0]) else " ".join(cells[0] for _, cells in sheet.above if cells)
    units = {text for _, text in heads if text}
    said = {quantity: choice for quantity, choice in choices(columns).items() if quantity in LEADS}
    lead, other = _axes(sheet, where, corner, said, units)
    if len(units) > 1:
        raise ValueError(f"{where}: must name one unit of {other}, got {' and '.join(sorted(units))}")
    again = next((k for k, own in enumerate(sheet.rows) if own and _leads(own[0]) and own != row), None)
    if again is not None:
        raise ValueError(
            f"{sheet.source}: line {sheet.places[again]}: must be forces, got another header than that of line {line}, "
            f"{short(' '.join(sheet.rows[again]))}: are two tables in one file?"
        )
    title = [text for _, cells in sheet.above for cell in cells[cells is row :] for text in _BRACKETS.findall(cell)]
    inside = [*_BRACKETS.findall(corner), *units_among_words(corner, lead), sheet.form.dress[0][1]]
    title = [*title, sheet.form.dress[1][1]]
    table, lines, notes = numbers(sheet, range(sheet.form.width), sparse=True)
    values = {lead: table[:, 0], other: np.array([value for value, _ in heads])}
    texts = {lead: inside, other: [*units, *inside, *title]}
    axes = {q: _column(where, q, corner, texts[q], said.get(q), unit, values[q], k) for k, q in enumerate(values)}
    named = next((own for text in title if (own := unit_named(text, "force"))), None)
    notes = notes if named else (*notes, "names no unit of forces: read in N")
    scaled = [axes[quantity].factor * values[quantity] for quantity in values]
    grid = dict(zip(values, np.meshgrid(*scaled, indexing="ij"), strict=True))
    stretch = axes[lead if lead != "pressure" else other]
    pressure, taken_off = gauge_pressure(grid["pressure"].ravel(), sheet.source, axes["pressure"])
    return _Samples(
        strain_scale(sheet, stretch, gauge_length) * grid[stretch.quantity].ravel(),
        pressure,
        FORCE[named or "N"] * table[:, 1:].ravel(),
        np.repeat(lines, len(heads)),
        stretch,
        any(is_compressive(cell) for _, cells in sheet.above for cell in cells),
        (*notes, *taken_off),
        axes["pressure"],
    )


def _axes(sheet: Sheet, where: str, corner: str, said: Mapping[str, Choice], units: set[str]) -> tuple[str, str]:
    """What the lines and the columns of a table are of: as said, by its corner, or by the units of columns."""
    named = _leads(corner)
    lead = next((quantity for quantity, one in said.items() if one.column != "2"), named[0] if named else "")
    other = next((quantity for quantity, one in said.items() if one.column == "2"), named[1] if named[1:] else "")
    if lead and not other:
        other = "pressure" if lead != "pressure" else ""
        if not other and units and all(unit_named(text, "contraction") in STRAIN for text in units):
            other = "contraction"
            warnings.warn(
                f"{where}: names nothing that its columns are of: taken for contractions, as of data sheets of "
                'muscles; --columns "extension=2:%" takes them for extensions',
                stacklevel=4,
            )
    if not lead or not other:
        raise ValueError(
            f"{where}: must begin with what the first column holds, and its unit, as in 'contraction [%]' or, with "
            f"pressures there, 'pressure [bar] / contraction [%]', got {corner!r}; or --columns says it, as in "
            '"contraction=1:%"'
        )
    return lead, other


def _leads(corner: str) -> list[str]:
    """The quantities that a table's corner names, as they stand."""
    found = sorted((match.start(), q) for q in LEADS if (match := re.search(named_by(q), corner.lower())))
    return [quantity for _, quantity in found]


def _column(
    where: str,
    quantity: str,
    corner: str,
    texts: Sequence[str],
    said: Choice | None,
    unit: str | None,
    values: Array,
    index: int,
) -> Column:
    """The unit that is said or that texts name for a quantity; parts of 1 for strains that can be such."""
    text, named = next(((t, one) for t in texts if (one := unit_named(t, quantity))), ("", None))
    option, own = "unit", unit if quantity == "pressure" else None
    if said is not None and said.unit is not None:
        option, own = f"columns: {quantity}", said.unit
    if own is not None and named is not None and MEASURED[quantity][own] != MEASURED[quantity][named]:
        raise ValueError(f"{option}: must be left out or be {named}, which {where} names, got {own}")
    named = own or named
    if named is None and quantity in MOST_WITHOUT_UNIT and np.nanmax(np.abs(values)) <= 1:
        named = "mm/mm"
    if named is None:
        likely = likely_unit(quantity, values)
        or_unit = ", or --unit" if quantity == "pressure" else ""
        raise ValueError(
            f"{where}: must name the unit of {quantity}, one of {', '.join(MEASURED[quantity])}, in brackets behind "
            f"its name or behind each number, got none; --columns says it, by the numbers perhaps "
            f'"{quantity}={index + 1}:{likely}"{or_unit}'
        )
    absolute = quantity == "pressure" and (is_absolute(text) or (said is not None and said.absolute))
    sure = is_sure(quantity, corner) or (quantity == "extension" and said is not None)
    return Column(quantity, index, named, True, is_compressive(corner), sure, absolute)
