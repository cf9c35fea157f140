"""Tables of forces by strain and pressure, as data sheets print them: a line for each, or a line for each strain."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from torcharm.characterise.alignment import Recording, noted
from torcharm.characterise.cells import number
from torcharm.characterise.columns import Columns, find_columns, has_column, named_by, told
from torcharm.characterise.delimited import Array, Sheet, numbers, read_sheet
from torcharm.characterise.recordings import PLAUSIBLE_STRAIN, POSITIVE, stretch_quantity
from torcharm.files import StrPath
from torcharm.inputs import check_choice
from torcharm.units import FORCE, MEASURED, PRESSURE, unit_named

LEADS = ("contraction", "strain", "pressure")
"""What the first column of a table of forces alone may hold."""
_HEAD = re.compile(r"\s*([-+]?[\d.,]+(?:[eE][-+]?\d+)?)\s*[(\[]?\s*([^\d\s()\[\]]*[^()\[\]]*?)\s*[)\]]?\s*")
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
        columns: as of `read_tester`, of tables with a column of forces.
        gauge_length: of the actuator [m], where the table gives extensions.
        positive: whether positive forces "pull" or "push"; None: those of contractions pull, others push.

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
    sheet = read_sheet(path)
    wide = None if "force" in told(columns) else _columns_of_header(sheet)
    if wide is None:
        strain, pressure, force, contracts, notes = _long(sheet, unit, columns, gauge_length)
    else:
        strain, pressure, force, contracts, notes = _wide(sheet, wide, unit)
    pull = contracts if positive is None else positive == "pull"
    settings = (("positive forces", "pull" if pull else "push"), *noted(sheet.source, notes))
    own = np.isfinite(force)
    force = -force[own] if pull else force[own]
    # 0 is added to turn -0.0, of contractions turned, into 0.
    return Recording(
        strain[own] + 0.0,
        pressure[own],
        force + 0.0,
        np.zeros(int(own.sum()), np.int64),
        (Path(sheet.source).name,),
        settings,
    )


MOST_WITHOUT_UNIT = {"contraction": 1.0, "strain": PLAUSIBLE_STRAIN}
"""What parts of 1 may reach: nothing contracts to less than no length; larger numbers are percents."""
Samples = tuple[Array, Array, Array, bool, tuple[str, ...]]
"""Strain, pressure and force, whether they are of contractions, and notes."""


def _long(sheet: Sheet, unit: str | None, columns: Columns | None, gauge_length: float | None) -> Samples:
    stretch = stretch_quantity(sheet, columns, gauge_length)
    defaults = {} if unit is None else {"pressure": unit}
    defaults |= {"strain": "mm/mm", "contraction": "mm/mm"}
    found = find_columns(sheet, (stretch, "pressure", "force"), columns, defaults)
    if unit is not None and found["pressure"].named and found["pressure"].factor != PRESSURE[unit]:
        raise ValueError(
            f"unit: must be left out or be {found['pressure'].unit}, which {sheet.source} names, got {unit}"
        )
    table, _, notes = numbers(sheet, [column.index for column in found.values()])
    strain, pressure, force = (table * [column.factor for column in found.values()]).T
    if not found[stretch].named and np.abs(strain).max() > MOST_WITHOUT_UNIT.get(stretch, np.inf):
        raise ValueError(
            f"{sheet.source}: {stretch} reaches {np.abs(strain).max():g} and names no unit, must be a part of 1 or "
            f'name one: is it in %? --columns "{stretch}={found[stretch].index + 1}:%" says so'
        )
    factor = {"contraction": -1.0, "extension": 1 / (gauge_length or 1.0)}.get(stretch, 1.0)
    return factor * strain, pressure, force, stretch == "contraction", notes


def _columns_of_header(sheet: Sheet) -> list[tuple[float, str]] | None:
    """The number and the unit of each column but the first; None: some have none, or words are about forces."""
    if not sheet.above or has_column(sheet, "force", None):
        return None
    cells = (sheet.above[-1][1] + [""] * sheet.form.width)[1 : sheet.form.width]
    if len(cells) < 2:
        return None
    found = []
    for cell in cells:
        match = _HEAD.fullmatch(cell)
        if match is None or not np.isfinite(value := number(match[1], sheet.form.decimal)):
            return None
        found.append((value, match[2]))
    return found


def _wide(sheet: Sheet, columns: list[tuple[float, str]], unit: str | None) -> Samples:
    line, row = sheet.above[-1]
    where, corner = f"{sheet.source}: line {line}", row[0]
    found = sorted((match.start(), q) for q in LEADS if (match := re.search(named_by(q), corner.lower())))
    said = [quantity for _, quantity in found]
    if not said or (said[0] == "pressure" and len(said) < 2):
        raise ValueError(
            f"{where}: must begin with what the first column holds, and its unit, as in 'contraction [%]' or, with "
            f"pressures there, 'pressure [bar] / contraction [%]', got {corner!r}"
        )
    lead, other = said[0], said[1] if len(said) > 1 else "pressure"
    units = {text for _, text in columns if text}
    if len(units) > 1:
        raise ValueError(f"{where}: must name one unit of {other}, got {' and '.join(sorted(units))}")
    inside = _BRACKETS.findall(corner)
    table, _, notes = numbers(sheet, range(sheet.form.width), sparse=True)
    across = np.array([value for value, _ in columns])
    axes = {
        lead: table[:, 0] * _factor(where, lead, inside, unit, table[:, 0]),
        other: across * _factor(where, other, [*units, *inside], unit, across),
    }
    title = [text for _, cells in sheet.above[:-1] for cell in cells for text in _BRACKETS.findall(cell)]
    named = next((own for text in title if (own := unit_named(text, "force"))), None)
    notes = notes if named else (*notes, "names no unit of forces: read in N")
    grid = dict(zip((lead, other), np.meshgrid(axes[lead], axes[other], indexing="ij"), strict=True))
    stretch = lead if lead != "pressure" else other
    strain = -grid["contraction"] if stretch == "contraction" else grid["strain"]
    force = table[:, 1:] * FORCE[named or "N"]
    return strain.ravel(), grid["pressure"].ravel(), force.ravel(), stretch == "contraction", notes


def _factor(where: str, quantity: str, texts: Sequence[str], unit: str | None, values: Array) -> float:
    """One of the unit that texts name for a quantity, in torcharm's; 1 for strains that name none and can be such."""
    named = next((own for text in texts if (own := unit_named(text, quantity))), None)
    if quantity == "pressure" and unit is not None:
        if named is not None and PRESSURE[unit] != MEASURED[quantity][named]:
            raise ValueError(f"unit: must be left out or be {named}, which {where} names, got {unit}")
        named = unit
    if named is None and quantity != "pressure" and np.abs(values).max() <= 1:
        return 1.0
    if named is None:
        option = "; --unit says it" if quantity == "pressure" else ""
        raise ValueError(
            f"{where}: must name the unit of {quantity}, one of {', '.join(MEASURED[quantity])}, in brackets behind "
            f"its name or behind each number, got none{option}"
        )
    return MEASURED[quantity][named]
