"""Tables of forces by strain and pressure, as data sheets print them: a line for each, or a line for each strain."""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from torcharm.characterise.alignment import Recording, noted
from torcharm.characterise.cells import Row, number
from torcharm.characterise.columns import COMPRESSIVE, Choice, Columns, check_one_header, choices, find_columns
from torcharm.characterise.delimited import Sheet, numbers, read_sheet
from torcharm.characterise.headers import BRACKETS, NAMES
from torcharm.characterise.recordings import gauge_pressure
from torcharm.characterise.signs import OTHER, known_signs, settled
from torcharm.characterise.stretch import STRETCHES, strains_of, stretch_quantity
from torcharm.files import StrPath
from torcharm.inputs import check_choice
from torcharm.units import PRESSURE, unit_named

_HEAD = re.compile(r"\s*([-+]?[\d.,]+(?:[eE][-+]?\d+)?)\s*[(\[]?\s*([^\d\s()\[\]]*[^()\[\]]*?)\s*[)\]]?\s*")
"""`2`, `2 bar`, `2 [bar]`."""
_INSIDE = re.compile(r"(?<!\d_)([-+]?(?<![\d.,])\d[\d.,]*)\s*([^\W\d_]+)")
"""A number and its unit among words, as in `force at 2 bar [N]`."""


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
    for name, value, allowed in (("unit", unit, PRESSURE), ("positive", positive, OTHER)):
        if value is not None:
            check_choice(name, value, allowed)
    sheet, notes = _long(read_sheet(path), choices(columns))
    quantity = stretch_quantity(sheet, columns, gauge_length, ("pressure", "force"))
    defaults = {"strain": "mm/mm", "contraction": "mm/mm"} | ({} if unit is None else {"pressure": unit})
    found = find_columns(sheet, (quantity, "pressure", "force"), columns, defaults)
    stretch, pressures, forces = found.values()
    pressures.check_unit(unit, sheet.source)
    check_one_header(sheet)
    table, _, left_out = numbers(sheet, [column.index for column in found.values()])
    strain, pressure, force = (table * [column.factor for column in found.values()]).T
    pressure, taken_off = gauge_pressure(pressure, sheet.source, pressures)
    strain = strains_of(sheet, stretch, gauge_length, strain)
    signs = known_signs(forces, stretch, positive, "pull" if quantity == "contraction" else "push")
    strain, force, words = settled(signs, strain, pressure, force, sheet.source)
    guessed = () if stretch.named else (f"names no unit of {quantity}: read as parts of 1",)
    said = noted(sheet.source, (*notes, *left_out, *guessed, *forces.notes, *taken_off))
    run, name = np.zeros(len(force), np.int64), Path(sheet.source).name
    return Recording(strain, pressure, force, run, (name,), (*words, *said))


def _long(sheet: Sheet, said: Mapping[str, Choice]) -> tuple[Sheet, tuple[str, ...]]:
    """The table with a line for each force, in columns of what lines were of, of what columns were of, and of forces.

    A table that is one already stays what it is. Notes say what was left out and assumed.
    """
    line, heading = sheet.above[-1] if sheet.above else (0, [])
    heads = [_head(cell) for cell in (heading + [""] * sheet.width)[1 : sheet.width]]
    if "force" in said or not all(heads):
        return sheet, ()
    units = {head[2] for head in heads if head and head[2]}
    if len(units) > 1:
        raise ValueError(
            f"{sheet.source}: line {line}: must name one unit of its columns, got {' and '.join(sorted(units))}"
        )
    across = [repr(number(head[1], sheet.decimal)) for head in heads if head]
    if len(set(across)) < len(across):
        raise ValueError(f"{sheet.source}: line {line}: must name each of its columns once, got {', '.join(across)}")
    check_one_header(sheet, least=1)
    table, places, notes = numbers(sheet, range(sheet.width), sparse=True)
    cells = [
        (place, [repr(first), head, repr(force)])
        for place, (first, *forces) in zip(places, table.tolist(), strict=True)
        for head, force in zip(across, forces, strict=True)
        if np.isfinite(force)
    ]
    lacking = len(places) * len(across) - len(cells)
    notes = (*notes, *([f"{lacking} cell{'s' * (lacking > 1)} without a value left out"] if lacking else []))
    titles = [cell for _, row in sheet.above[:-1] for cell in row]
    texts = [a or b for cell in (*titles, *heading) for a, b in BRACKETS.findall(cell)]
    of_force = next((text for text in (*texts, sheet.dress[1][1]) if unit_named(text, "force")), "")
    squeezes = " (compressive)" * any(COMPRESSIVE.search(cell.lower()) for cell in (*titles, *heading))
    names = [*_names(sheet, said, "".join(units)), f"force [{of_force or 'N'}]{squeezes}"]
    long = replace(
        sheet,
        above=((line, names),),
        rows=[own for _, own in cells],
        places=[place for place, _ in cells],
        width=3,
        numeric=(True,) * 3,
        dress=(("", ""),) * 3,
        decimal=".",
        sure=True,
        cut=False,
    )
    return long, (*notes, *([] if of_force else ["names no unit of forces: read in N"]))


def _head(cell: str) -> re.Match[str] | None:
    """The number and the unit of a column's pressure or strain; a pressure may stand among words, once."""
    inside = [found for found in _INSIDE.finditer(cell) if unit_named(found[2], "pressure")]
    return _HEAD.fullmatch(cell) or (inside[0] if len(inside) == 1 else None)


def _names(sheet: Sheet, said: Mapping[str, Choice], unit: str) -> Row:
    """What the lines and the columns of a table are of, as its corner names them; one of the two is the pressure."""
    (line, (corner, *_)), quantities = sheet.above[-1], ("pressure", *STRETCHES)
    marks = sorted((found.start(), q) for q in quantities if (found := re.search(NAMES[q], corner.lower())))
    told = {choice.column or "1": quantity for quantity, choice in said.items()}
    lead = marks[0][1] if marks else told.get("1", "")
    other = next((at for at, q in marks[1:] if (q == "pressure") != (lead == "pressure")), len(corner))
    if not lead or (lead == "pressure" and other == len(corner) and "2" not in told):
        raise ValueError(
            f"{sheet.source}: line {line}: must begin with what the first column holds, and its unit, as in "
            f"'contraction [%]' or, with pressures there, 'pressure [bar] / contraction [%]', got {corner!r}; or "
            f'--columns says it, as in "contraction={2 if lead else 1}:%"'
        )
    across = corner[other:] or (told["2"] if lead == "pressure" else "pressure")
    lines = f"{corner[:other]} [{sheet.dress[0][1].strip()}]" if sheet.dress[0][1] else corner[:other]
    return [lines, f"{BRACKETS.sub('', across)} [{unit}]" if unit else across]
