"""From designs to the text of a study file."""

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from torcharm.actuators import SHIPPED, Actuator, ConstantBending, LinearBending, PolynomialActuator
from torcharm.actuators.toml_text import toml_entry
from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries, RigidLink
from torcharm.inputs import plain_number, shown
from torcharm.statics.balance import segments_of
from torcharm.study.arm_reading import make_actuator
from torcharm.study.arm_tables import NamedTable, SegmentTable
from torcharm.study.fields import Table, field_path, first_mistake, one_line, within

Read = TypeVar("Read", bound=Table)
KINDS: dict[Any, str] = {model: name for name, model in SHIPPED.items()} | {PolynomialActuator: "polynomial"}
"""Of force models that a study can name or write out."""
ALLOWED = (
    "a study holds Bellows() and McKibben() of any max_pressure, bending_stiffness and force_scale, a "
    "PolynomialActuator, and a model from a file whose path is given, each with a number, LinearBending or "
    "ConstantBending as bending_stiffness"
)
_OPTIONS = ("max_pressure", "bending_stiffness", "force_scale")


def arm_to_toml(arm: ArmDesign | ArmSeries, name: str, files: Sequence[str | None] = ()) -> str:
    """An arm as an `[[arm]]` table to paste into a study, from which the very same arm is read.

    Args:
        arm: one design, in the plane or in space, or segments in series.
        name: what the study is to call it.
        files: for each actuator the path of its force model's file, from the study's folder, or None; empty if none
            comes from a file.

    Raises:
        ValueError: the arm is a batch, or has a link that is not straight; a force model is none that a study can
            express; or the name is none. Actuators are counted from 1.
    """
    if not isinstance(arm, ArmDesign | ArmSeries):
        raise ValueError(f"arm: must be an ArmDesign or an ArmSeries, got {shown(arm)}")
    if arm.batch_shape:
        raise ValueError(f"arm: must be a single design, got a batch of {tuple(arm.batch_shape)}")
    paths = list(files) or [None] * arm.actuator_count
    if len(paths) != arm.actuator_count:
        raise ValueError(
            f"files: must be a path or None for each of {arm.actuator_count} actuators, got {shown(files)}"
        )
    _validated(NamedTable, {"name": name})
    parts = list(zip(*segments_of(arm), strict=True))
    if len(parts) == 1:
        return _text("[[arm]]", {"name": name} | _segment(*parts[0], paths))
    texts = [_text("[[arm]]", {"name": name})]
    for index, (segment, link) in enumerate(parts):
        own, paths = paths[: segment.actuator_count], paths[segment.actuator_count :]
        with within(field_path(["segment", index])):
            texts.append(_text("[[arm.segment]]", _segment(segment, link, own)))
    return "\n".join(texts)


def _text(heading: str, table: dict[str, Any]) -> str:
    return "\n".join([heading, *(toml_entry(key, value) for key, value in table.items()), ""])


def _segment(arm: ArmDesign, link: RigidLink | None, paths: Sequence[str | None]) -> dict[str, Any]:
    """A segment's table, once it is known that the same force models are read from it; those of files are not read."""
    place = "radii" if arm.dimension == 2 else "offsets"
    keys = (place, "length", "max_pressure", "diameter", "torsion_stiffness")
    table = {key: value.tolist() for key in keys if (value := getattr(arm, key)) is not None}
    if bool(arm.mass):
        table["mass"] = arm.mass.item()
    if link is not None:
        if link.length is None:
            raise ValueError(
                f"link.pose: must be left out of an arm for a study, which holds straight links, got {link}"
            )
        table["link"] = {"length": link.length.item(), "mass": link.mass.item()}
    table["actuators"] = [_table(*pair, index) for index, pair in enumerate(zip(arm.actuators, paths, strict=True))]
    read = _validated(SegmentTable, table).actuators
    assert isinstance(read, list)
    for index, (model, path) in enumerate(zip(arm.actuators, paths, strict=True)):
        if path is None and make_actuator(read[index], ["actuators", index], Path()) != model:
            raise _refusal(index, model)
    return table


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


def _validated(model: type[Read], table: dict[str, Any]) -> Read:
    """What a study that holds the table reads."""
    try:
        return model.model_validate(table)
    except ValidationError as error:
        raise ValueError(one_line(first_mistake(error, table))) from None


def _refusal(index: int, model: Actuator) -> ValueError:
    return ValueError(f"{field_path(['actuators', index])}: {ALLOWED}, got {shown(model)}")
