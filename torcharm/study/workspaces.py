"""Workspaces as rows of a file."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from torcharm.study.data import NamedArm
from torcharm.study.results import DEG, MM, pressure_columns
from torcharm.workspaces import Workspace

NOWHERE = ("not converged", "impossible")
"""States without an equilibrium: their tips are nowhere."""


def workspace_rows(arm: NamedArm, found: Workspace) -> Iterator[dict[str, Any]]:
    """A row for each state of an arm, numbered from 1.

    Columns: arm; state; tip_x_mm, tip_y_mm and, in space, tip_z_mm; in the plane heading_deg, in space elevation_deg,
    of the tip's axis above the horizontal; status and strain_excess, as in `Workspace`; payload_factor, where there is
    a payload; pressure_1_kPa and so on, one for each actuator that is driven.
    """
    columns: dict[str, Any] = {"state": range(1, len(found.code) + 1)}
    for name, value in zip("xyz", found.position.unbind(-1), strict=False):
        columns[f"tip_{name}_mm"] = (MM * value).tolist()
    columns["heading_deg" if found.dimension == 2 else "elevation_deg"] = (DEG * found.angle).tolist()
    columns |= {"status": found.status.tolist(), "strain_excess": found.strain_excess.tolist()}
    if found.has_payload:
        factors = found.payload_factor.tolist()
        columns["payload_factor"] = [factor if np.isfinite(factor) else None for factor in factors]
    columns |= {name: value.tolist() for name, value in pressure_columns(arm, found.pressure).items()}
    places = [name for name in columns if name.startswith("tip_") or name.endswith("_deg")]
    for values in zip(*columns.values(), strict=True):
        row = {"arm": arm.name, **dict(zip(columns, values, strict=True))}
        yield row | (dict.fromkeys(places) if row["status"] in NOWHERE else {})
