"""From designs to the text of a study file."""

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from torcharm.actuators import SHIPPED, Actuator, ConstantBending, LinearBending, PolynomialActuator
from torcharm.actuators.toml_text import toml_entry
from torcharm.arm import ArmDesign, check_planar
from torcharm.inputs import plain_number, shown
from torcharm.study.arm_tables import FreeArm
from torcharm.study.fields import field_path, first_mistake, one_line
from torcharm.study.reading import make_actuator

KINDS: dict[Any, str] = {model: name for name, model in SHIPPED.items()} | {PolynomialActuator: "polynomial"}
"""Of force models that a study can name or write out."""
ALLOWED = (
    "a study holds Bellows() and McKibben() of any max_pressure, bending_stiffness and force_scale, a "
    "PolynomialActuator, and a model from a file whose path is given, each with a number, LinearBending or "
    "ConstantBending as bending_stiffness"
)
_OPTIONS = ("max_pressure", "bending_stiffness", "force_scale")


def arm_to_toml(arm: ArmDesign, name: str, files: Sequence[str | None] = ()) -> str:
    """A planar arm as an `[[arm]]` table to paste into a study, from which the very same arm is read.

    Args:
        arm: one design.
        name: what the study is to call it.
        files: for each actuator the path of its force model's file, from the study's folder, or None; empty if none
            comes from a file.

    Raises:
        ValueError: the arm is a batch, in space, or has a mass or diameters, which studies do not hold; a force model
            is none that a study can express; or the name is none. Actuators are counted from 1.
    """
    check_planar(arm)
    if arm.batch_shape:
        raise ValueError(f"arm: must be a single design, got a batch of {tuple(arm.batch_shape)}")
    for field, value in (
        ("mass", float(arm.mass) or None),
        *((key, getattr(arm, key)) for key in ("torsion_stiffness", "diameter")),
    ):
        if value is not None:
            raise ValueError(f"{field}: must be left out of an arm for a study, which holds none, got {shown(value)}")
    paths = list(files) or [None] * arm.actuator_count
    if len(paths) != arm.actuator_count:
        raise ValueError(
            f"files: must be a path or None for each of {arm.actuator_count} actuators, got {shown(files)}"
        )
    numbers = {key: [float(one) for one in getattr(arm, key)] for key in ("radii", "length", "max_pressure")}
    table: dict[str, Any] = {"name": name, **numbers}
    table["actuators"] = [_table(*pair, index) for index, pair in enumerate(zip(arm.actuators, paths, strict=True))]
    _check(table, arm.actuators, paths)
    return "\n".join(["[[arm]]", *(toml_entry(key, value) for key, value in table.items()), ""])


def _table(model: Actuator, path: str | None, index: int) -> str | dict[str, Any]:
    """A force model as a study has it; what is as the kind's default is left out."""
    options = {key: getattr(model, key) for key in _OPTIONS if hasattr(model, key)}
    kind = "file" if path is not None else KINDS.get(type(model))
    if kind is None:
        raise _refusal(index, model)
    table: dict[str, Any] = {"kind": kind}
    if path is not None:
        table["path"] = path
    elif isinstance(model, PolynomialActuator) and kind == "polynomial":
        table["coefficients"] = [list(row) for row in model.coefficients]
        table |= {key: list(getattr(model, key)) for key in ("strain_range", "pressure_range")}
    defaults = {} if path is not None else {field.name: field.default for field in fields(model)}  # type: ignore[arg-type]
    for key, value in options.items():
        if key in defaults and type(value) is type(defaults[key]) and value == defaults[key]:
            continue
        if isinstance(value, LinearBending | ConstantBending):
            table["bending"] = _bending(value)
        elif hasattr(value, "active"):
            raise _refusal(index, model)
        else:
            table[key] = plain_number(value)
    return kind if list(table) == ["kind"] else table


def _bending(model: LinearBending | ConstantBending) -> dict[str, Any]:
    table: dict[str, Any] = {"kind": "linear" if isinstance(model, LinearBending) else "constant"}
    table["stiffness"] = plain_number(model.stiffness)
    if model.reference_pressure is not None:
        table["reference_pressure"] = plain_number(model.reference_pressure)
    return table


def _check(table: dict[str, Any], models: Sequence[Actuator], paths: Sequence[str | None]) -> None:
    """Raise unless a study that holds the table reads the same force models from it; those of files are not read."""
    try:
        read = FreeArm.model_validate(table)
    except ValidationError as error:
        raise ValueError(one_line(first_mistake(error, table))) from None
    for index, (model, path) in enumerate(zip(models, paths, strict=True)):
        if path is None and make_actuator(read.actuators[index], index, Path()) != model:
            raise _refusal(index, model)


def _refusal(index: int, model: Actuator) -> ValueError:
    return ValueError(f"{field_path(['actuators', index])}: {ALLOWED}, got {shown(model)}")
