"""From the tables of arms to designs."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from torcharm.actuators import (
    SHIPPED,
    Actuator,
    Bending,
    ConstantBending,
    LinearBending,
    PolynomialActuator,
    chamber,
    elastic_core,
)
from torcharm.arm import ArmDesign, ring
from torcharm.arm_series import ArmSeries, RigidLink, series
from torcharm.attainability.questions import question_about_arm, question_about_mass
from torcharm.characterise.model_file import load_actuator
from torcharm.statics.balance import segments_of
from torcharm.study.arm_tables import (
    PAPER_ARMS,
    BendingTable,
    ChamberTable,
    CoreTable,
    FileActuator,
    FreeArm,
    PaperArm,
    PolynomialTable,
    SegmentTable,
    SeriesArm,
    ShippedActuator,
)
from torcharm.study.data import NamedArm
from torcharm.study.fields import ask, field_path, shown_value, within

HIGHEST_DEGREE = 20
"""Of strain or pressure in a polynomial force model."""

AnyActuator = ShippedActuator | FileActuator | PolynomialTable | ChamberTable | CoreTable


def make_arm(table: PaperArm | FreeArm | SeriesArm, folder: Path) -> NamedArm:
    """The arm of a table; paths of force models start at the folder."""
    files: list[str | None] = []
    if isinstance(table, SeriesArm):
        parts: list[ArmDesign | RigidLink] = []
        for index, one in enumerate(table.segment):
            with within(field_path(["segment", index])):
                own = _parts(one, folder, files)
            if parts and own[0].dimension != parts[0].dimension:
                raise ValueError(
                    f"{field_path(['segment', index])}: must be in the plane (radii) or in space (offsets, ring) "
                    "as the first segment is"
                )
            parts += own
        design: ArmDesign | ArmSeries = series(parts)
    elif isinstance(table, FreeArm):
        found = _parts(table, folder, files)
        design = found[0] if len(found) == 1 and isinstance(found[0], ArmDesign) else series(found)
    else:
        given = table.model_dump(include={"outer_radius", "inner_radius"}, exclude_none=True)
        paper = PAPER_ARMS[table.kind](**given)
        design = _bundle(table, {"radii": paper.radii.tolist()}, paper.actuators)
    question = question_about_arm(segments_of(design)[0])
    if question is not None:
        raise ValueError(f'{question} A text with a unit, such as "50 mm", is understood')
    return NamedArm(table.name, design, tuple(files) if any(files) else ())


def _parts(table: SegmentTable, folder: Path, files: list[str | None]) -> list[ArmDesign | RigidLink]:
    """A segment, and the link after it; paths of its force models are appended to the files."""
    counts: tuple[int, ...] = ()
    if table.ring is not None:
        rings = table.ring if isinstance(table.ring, list) else [table.ring]
        counts = tuple(one.count for one in rings)
        offsets = []
        for index, one in enumerate(rings):
            with within(field_path(["ring", index] if isinstance(table.ring, list) else ["ring"])):
                offsets.append(ring(one.radius, one.count, one.phase))
        places: dict[str, Any] = {"offsets": torch.cat(offsets)}
    else:
        places = {"radii": table.radii} if table.radii is not None else {"offsets": table.offsets}
    number = len(next(iter(places.values())))
    if isinstance(table.actuators, list):
        tables = _each("actuators", table.actuators, counts, number if counts else len(table.actuators))
        paths: list[tuple[list[int | str], AnyActuator]] = [
            (["actuators", index], one) for index, one in enumerate(tables)
        ]
    else:
        paths = [(["actuators"], table.actuators)] * number
    models = tuple(make_actuator(one, path, folder) for path, one in paths)
    files += [one.path if isinstance(one, FileActuator) else None for _, one in paths]
    parts: list[ArmDesign | RigidLink] = [_bundle(table, places, models, counts)]
    if table.link is not None:
        with within("link"):
            ask("mass", question_about_mass(table.link.mass))
            parts.append(RigidLink(table.link.length, mass=table.link.mass))
    return parts


def _bundle(
    table: SegmentTable | PaperArm, places: dict[str, Any], models: Sequence[Actuator], rings: Sequence[int] = ()
) -> ArmDesign:
    given = {name: getattr(table, name) for name in ("length", "max_pressure", "diameter")}
    each = {name: _each(name, value, rings, len(models)) for name, value in (places | given).items()}
    torsion = table.torsion_stiffness if isinstance(table, SegmentTable) else None
    return ArmDesign(actuators=models, mass=table.mass, torsion_stiffness=torsion, **each)


def _each(name: str, value: Any, rings: Sequence[int], number: int) -> Any:
    """A list as one for each actuator, of one for each ring; what is no list stays."""
    if not isinstance(value, list) or len(value) == number:
        return value
    if rings and len(value) == len(rings):
        return [one for one, count in zip(value, rings, strict=True) for _ in range(count)]
    what = "entry" if name == "actuators" else "number"
    rest = f" or {len(rings)} rings" if rings else ""
    raise ValueError(f"{name}: must hold one {what} for each of the {number} actuators{rest}, got {len(value)}")


def make_actuator(table: AnyActuator, path: Sequence[int | str], folder: Path) -> Actuator:
    """The force model of a table at a path within an arm's; files' paths start at the folder."""
    with within(field_path(path)):
        if isinstance(table, CoreTable | ChamberTable):
            numbers = table.model_dump(exclude={"kind", "strain_range"})
            build: Callable[..., Actuator] = elastic_core if isinstance(table, CoreTable) else chamber
            return build(**numbers, strain_range=_range("strain_range", table.strain_range))
        options = table.model_dump(exclude={"kind", "path", "bending"}, exclude_none=True)
        if table.bending is not None:
            options["bending_stiffness"] = _bending(table, table.bending)
        if isinstance(table, FileActuator):
            model: Any = load_actuator(folder / table.path)
            return replace(model, **options)
        if isinstance(table, ShippedActuator):
            return SHIPPED[table.kind](**options)
        options |= {name: _range(name, options[name]) for name in ("strain_range", "pressure_range")}
        options["coefficients"] = tuple(_term(row, place) for place, row in enumerate(table.coefficients))
        return PolynomialActuator(**options)


def _range(name: str, value: Sequence[float]) -> tuple[float, float]:
    low, high = value
    if not low < high:
        raise ValueError(f"{name}: must be [lowest, highest], got {shown_value([low, high])}")
    return low, high


def _bending(table: ShippedActuator | PolynomialTable, bending: BendingTable) -> Bending:
    if table.bending_stiffness is not None:
        raise ValueError("bending: must not stand beside bending_stiffness, got both")
    if bending.kind == "linear":
        return LinearBending(bending.stiffness, bending.reference_pressure)
    if bending.reference_pressure is not None:
        raise ValueError("bending.reference_pressure: must not be given for constant bending, got one")
    return ConstantBending(bending.stiffness)


def _term(row: Sequence[float], index: int) -> tuple[int, int, float]:
    i, j, coefficient = row
    for power in (i, j):
        if power not in range(HIGHEST_DEGREE + 1):
            path = field_path(["coefficients", index])
            raise ValueError(f"{path}: powers must be whole numbers from 0 to {HIGHEST_DEGREE}, got {power:g}")
    return int(i), int(j), coefficient
