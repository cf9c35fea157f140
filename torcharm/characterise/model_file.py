"""Force models as TOML files: written once after a fit, loaded by path wherever an arm is built.

A file holds a kind, what that kind is made of, the units (always strain, kPa, N and N·m²), and for fits their
quality and provenance. Floats are written so that they read back exactly: a round trip changes nothing.
"""

import re
from collections.abc import Mapping
from dataclasses import MISSING, asdict, fields, is_dataclass
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

from torch import Tensor

from torcharm.actuators.bending import Bending, ConstantBending, LinearBending
from torcharm.actuators.gridded import GriddedActuator
from torcharm.actuators.measured import Measured
from torcharm.actuators.polynomial import PolynomialActuator
from torcharm.actuators.protocol import Actuator
from torcharm.actuators.ready import Chamber, ElasticCore
from torcharm.actuators.shipped import SHIPPED, model_of
from torcharm.characterise.fit import FittedActuator
from torcharm.characterise.toml_text import read_toml, toml_entry, toml_value
from torcharm.files import StrPath, atomic_write, read_file
from torcharm.inputs import check_choice, plain_number, shown

_HEAD, _END = "# A torcharm force model. Its last line is: # end", "# end"
_OPEN_END = re.compile(r"=\s*[\w.+-]*\d$")
"""A last line that ends within what may be a longer number."""

KINDS: dict[str, Any] = {
    kind.name: kind
    for kind in (PolynomialActuator, FittedActuator, GriddedActuator, Chamber, ElasticCore, *SHIPPED.values())
}
BENDINGS: dict[str, type[Any]] = {"linear": LinearBending, "constant": ConstantBending}
ASSUMED = (
    "# The paper's estimate for its own bellows and muscles, assumed: neither a tensile test nor a data sheet's table\n"
    "# tells that of this actuator. torcharm fit --bending sets it."
)
"""What a file says above a bending stiffness that was assumed."""
UNITS = {"strain": "1", "pressure": "kPa", "force": "N", "bending_stiffness": "N·m²"}
"""Units of every model file. A coefficient of ε^i p^j is in N/kPa^j."""


def save_actuator(path: StrPath, model: Actuator | str) -> None:
    """Write a force model, or the shipped one of a name, to a TOML file.

    The file appears whole, and what was there stays if it cannot be written.

    Raises:
        ValueError: the model is of a kind that no file can hold: of one's own, or with a bending function.
        OSError: the file cannot be written.

    Example:
        >>> ta.save_actuator(folder / "mine.toml", ta.Bellows(max_pressure=40.0))
        >>> ta.ArmDesign([-0.05, 0.05], 0.4, folder / "mine.toml").max_pressure.tolist()
        [40.0, 40.0]
    """
    text = actuator_text(model_of("model", model))
    with atomic_write(path) as partial:
        partial.write_text(text, encoding="utf-8", newline="\n")


def actuator_text(model: Actuator) -> str:
    """The text of a force model's file; errors as for `save_actuator`."""
    kind = type(model)
    if kind not in KINDS.values():
        raise ValueError(f"model: must be one of {', '.join(k.__name__ for k in KINDS.values())}, got {shown(model)}")
    values = {f.name: getattr(model, f.name) for f in fields(kind) if f.init}  # type: ignore[arg-type]
    tables: dict[str, Any] = {"units": UNITS}
    bending = values["bending_stiffness"]
    if isinstance(bending, Bending):
        name = next((name for name, kind in BENDINGS.items() if type(bending) is kind), None)
        if name is None:
            allowed = ", ".join(BENDINGS)
            raise ValueError(f"bending_stiffness: a file holds a number or a {allowed}, got {shown(bending)}")
        tables["bending"] = {"kind": name, **vars(bending)}
        del values["bending_stiffness"]
    if isinstance(model, Measured):
        provenance, quality = values.pop("provenance"), values.pop("quality", None)
        if len(dict(provenance)) < len(provenance):
            raise ValueError(f"provenance: must name each thing once, got {shown(provenance)}")
        if provenance or isinstance(model, FittedActuator):
            tables["provenance"] = dict(provenance)
        if not model.region:
            del values["region"]
        if quality is not None:
            tables["quality"] = asdict(quality)
    head = [_HEAD, f"kind = {toml_value(model.name)}", *_entries(values)]  # type: ignore[attr-defined]
    rest = [line for name, table in tables.items() for line in _section(name, table)]
    if isinstance(bending, LinearBending) and bending.assumed:
        rest.insert(rest.index("[bending]"), ASSUMED)
    return "\n".join([*head, *rest, "", _END]) + "\n"


def load_actuator(path: StrPath) -> Actuator:
    """Read a force model from a TOML file.

    Raises:
        ValueError: the file cannot be read, is no TOML, holds no force model, or ends with a number and no end of line,
            as where it was cut short: one line that names file and field.

    Example:
        >>> ta.save_actuator(folder / "mine.toml", ta.Bellows(max_pressure=40.0))
        >>> ta.load_actuator(folder / "mine.toml").max_pressure
        40.0
    """
    source = str(path)
    try:
        text = read_file(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{source}: must be UTF-8 text, got byte {error.start + 1} that is not") from None
    raw = read_toml(text, source)
    lines = text.splitlines()
    if lines and lines[0] == _HEAD and _END not in lines:
        raise ValueError(
            f"{source}: line {len(lines)}: must be followed by '{_END}', is the last line: it is cut short"
        )
    try:
        model = _model(raw)
    except ValueError as error:
        raise ValueError(f"{source}: {' '.join(str(error).split())}") from None
    if lines and not text.endswith("\n") and "#" not in lines[-1] and _OPEN_END.search(lines[-1]):
        raise ValueError(
            f"{source}: line {len(lines)}: must end with an end of line, got {shown(lines[-1])}, whose number may be "
            "incomplete: it is cut short"
        )
    return model


def _model(raw: dict[str, Any]) -> Actuator:
    name = raw.pop("kind", None)
    check_choice("kind", name, KINDS)
    units = raw.pop("units", UNITS)
    for quantity, unit in units.items() if isinstance(units, dict) else [("", units)]:
        if unit != UNITS.get(quantity):
            raise ValueError(f"units.{quantity}: must be among {UNITS}, got {shown(unit)}")
    if "bending" in raw:
        if "bending_stiffness" in raw:
            raise ValueError("bending: must not stand beside bending_stiffness, got both")
        raw["bending_stiffness"] = _bending(raw.pop("bending"))
    if issubclass(KINDS[name], Measured):
        provenance = raw.pop("provenance", {})
        if not isinstance(provenance, dict) or not all(isinstance(v, str | int | float) for v in provenance.values()):
            raise ValueError(f"provenance: must be a table of texts and numbers, got {shown(provenance)}")
        raw["provenance"] = tuple(provenance.items())
    model: Actuator = _build(KINDS[name], raw, "")
    return model


def _bending(raw: Any) -> Bending:
    if not isinstance(raw, dict):
        raise ValueError(f"bending: must be a table, got {shown(raw)}")
    name = raw.pop("kind", None)
    check_choice("bending.kind", name, BENDINGS)
    model: Bending = _build(BENDINGS[name], raw, "bending.")
    return model


# Dataclasses from plain tables, by their annotations; and tables to lines.


def _build(kind: type[Any], raw: dict[str, Any], prefix: str) -> Any:
    """A dataclass from a table; ValueErrors of its own constructor pass."""
    own, hints = {f.name: f for f in fields(kind) if f.init}, get_type_hints(kind)
    for name in raw:
        if name not in own:
            raise ValueError(f"{prefix}{name}: unknown, allowed: {', '.join(own)}")
    values = {name: None for name, f in own.items() if f.default is MISSING and NoneType in get_args(hints[name])}
    for name, f in own.items():
        if name in raw:
            values[name] = _value(raw[name], hints[name], f"{prefix}{name}")
        elif name not in values and f.default is MISSING:
            raise ValueError(f"{prefix}{name}: missing")
    try:
        return kind(**values)
    except ValueError as error:
        raise ValueError(f"{prefix}{error}") from None


def _value(raw: Any, hint: Any, field: str) -> Any:
    """A plain value as its annotation asks for it."""
    origin = get_origin(hint)
    if origin in (Union, UnionType):
        kinds = [kind for kind in get_args(hint) if kind is not NoneType]
        if any(kind in (str, Bending) and isinstance(raw, kind) for kind in kinds):
            return raw
        return _value(raw, float if float in kinds else kinds[0], field)
    if origin is tuple:
        parts = get_args(hint)
        if not isinstance(raw, list | tuple) or (parts[-1] is not ... and len(raw) != len(parts)):
            size = "" if parts[-1] is ... else f" of {len(parts)}"
            raise ValueError(f"{field}: must be a list{size}, got {shown(raw)}")
        each = [parts[0]] * len(raw) if parts[-1] is ... else parts
        return tuple(_value(item, kind, field) for item, kind in zip(raw, each, strict=True))
    if is_dataclass(hint):
        if not isinstance(raw, dict):
            raise ValueError(f"{field}: must be a table, got {shown(raw)}")
        return _build(hint, raw, f"{field}.")  # type: ignore[arg-type]
    if hint is float and isinstance(raw, int) and not isinstance(raw, bool):
        return float(raw)
    if not isinstance(raw, hint) or (isinstance(raw, bool) and hint is not bool):
        raise ValueError(f"{field}: must be of type {hint.__name__}, got {shown(raw)}")
    return raw


def _section(name: str, table: Mapping[str, Any]) -> list[str]:
    """A table, with the tables in it after it."""
    flat = {key: value for key, value in table.items() if not isinstance(value, dict)}
    inner = {key: value for key, value in table.items() if isinstance(value, dict)}
    lines = ["", f"[{name}]", *_entries(flat)]
    return lines + [line for key, value in inner.items() for line in _section(f"{name}.{key}", value)]


def _entries(values: Mapping[str, Any]) -> list[str]:
    plain = {key: plain_number(value) if isinstance(value, Tensor) else value for key, value in values.items()}
    return [toml_entry(key, value) for key, value in plain.items() if value is not None]
