"""Workspaces as rows of a file."""

from collections.abc import Iterator
from typing import Any

from torcharm.study.data import NamedArm
from torcharm.study.results import file_columns
from torcharm.workspaces import Workspace

NOWHERE = ("not converged", "impossible")
"""States without an equilibrium: their tips are nowhere."""


def workspace_rows(arm: NamedArm, found: Workspace) -> Iterator[dict[str, Any]]:
    """A row for each state of an arm, numbered from 1.

    Columns: arm; state; tip_x_mm, tip_y_mm and, in space, tip_z_mm; in the plane heading_deg, in space elevation_deg,
    of the tip's axis above the horizontal; status and strain_excess, as in `Workspace`; payload_factor, where there is
    a payload; pressure_1_kPa and so on, one for each actuator that is driven.
    """
    names = {"tip_angle": "heading" if found.dimension == 2 else "elevation"}
    columns = file_columns(arm, {names.get(name, name): values for name, values in found.to_dict().items()})
    places = [name for name in columns if name.endswith(("_mm", "_deg"))]
    for state, values in enumerate(zip(*columns.values(), strict=True), 1):
        row = {"arm": arm.name, "state": state, **dict(zip(columns, values, strict=True))}
        yield row | (dict.fromkeys(places) if row["status"] in NOWHERE else {})
