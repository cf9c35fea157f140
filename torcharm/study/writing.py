"""From designs and tasks to the text of a study file."""

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torcharm.actuators import (
    SHIPPED,
    Actuator,
    Chamber,
    ConstantBending,
    ElasticCore,
    LinearBending,
    PolynomialActuator,
)
from torcharm.actuators.ready import USUAL_STRAINS
from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries, RigidLink, segments_of, with_slices
from torcharm.characterise.toml_text import toml_entry
from torcharm.files import is_stream
from torcharm.geometry.rod import HEADINGS, as_base
from torcharm.inputs import plain_number, shown
from torcharm.load import PointLoad
from torcharm.study.actuator_tables import ActuatorTable
from torcharm.study.arm_tables import NamedTable, SegmentTable
from torcharm.study.data import NamedArm, NamedTask, Study
from torcharm.study.fields import field_path, validated, within
from torcharm.study.task_tables import TwistTask
from torcharm.task import Task

DIGITS = 10
"""Of numbers, as many as read back to 1e-9 of themselves: nothing is built or measured as well."""
NOWHERE = 1e-12
"""An offset that is rounding of 0 [m]: what sines leave of actuators on an axis."""
ALLOWED = (
    "a study holds Bellows() and McKibben() of any max_pressure, bending_stiffness and force_scale, chambers, elastic "
    "cores, a PolynomialActuator, and a model from a file whose path is given, each with a number, LinearBending or "
    "ConstantBending as bending_stiffness"
)


def arm_to_toml(arm: ArmDesign | ArmSeries, name: str, files: Sequence[str | None] = ()) -> str:
    """An arm as an `[[arm]]` table to paste into a study, from which the same arm is read, to 1e-9 of each number.

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
    validated(NamedTable, {"name": name})
    segments, links = segments_of(arm)
    if len(segments) == 1:
        return _text("[[arm]]", {"name": name} | _rounded(_segment(segments[0], links[0], paths)))
    texts = [_text("[[arm]]", {"name": name})]
    for index, ((segment, own), link) in enumerate(zip(with_slices(segments), links, strict=True)):
        with within(field_path(["segment", index])):
            texts.append(_text("[[arm.segment]]", _rounded(_segment(segment, link, paths[own]))))
    return "\n".join(texts)


def task_to_toml(named: NamedTask) -> str:
    """A task as a `[[task]]` table to paste into a study, from which the same task is read, number by number.

    Args:
        named: one shape under any number of tip loads, and the names of the task and of its arms.

    Raises:
        ValueError: the task has several shapes or bases, or point loads in a batch.
    """
    task = named.task
    many = [
        point for point in task.load.points if point.mass.ndim or (point.wrench is not None and point.wrench.ndim > 1)
    ]
    if task.twists.ndim > 2 or task.base_pose.ndim > task.dimension - 1 or many:
        raise ValueError(f"task: must have one shape, one base and one of each point load, got {shown(task)}")
    load = task.load
    payloads = [{"mass": point.mass.item(), **_place(point)} for point in load.points if bool(point.mass)]
    points = [
        {"wrench": point.wrench.tolist(), **_place(point), "frame": point.frame}
        for point in load.points
        if point.wrench is not None
    ]
    table = {
        "name": named.name,
        "arms": list(named.arms) or None,
        "twists": task.twists.tolist(),
        "segment_nodes": task.segment_nodes,
        "loads": None if load.tip is None else load.tip.reshape(-1, load.tip.shape[-1]).tolist(),
        "gravity": load.gravity,
        "payloads": payloads or None,
        "points": points or None,
        "base_pose": _base(task),
        "wrench_at": task.wrench_at,
    }
    fields = TwistTask.model_fields
    return _text("[[task]]", {key: value for key, value in table.items() if value != fields[key].default})


def _place(point: PointLoad) -> dict[str, Any]:
    """Where a point load sits; of segments, that are counted from 1 here, the last is left out."""
    return {"at": point.at} | ({"segment": point.segment + 1} if point.segment >= 0 else {})


def _base(task: Task) -> str | list[Any]:
    """The base pose, by name if it has one."""
    for name in HEADINGS:
        if torch.equal(as_base(name, task.twists, task.twists.shape[-1]), task.base_pose):
            return name
    numbers: list[Any] = task.base_pose.tolist()
    return numbers


KEPT = ("evaluate", "optimise", "tolerance")
"""Tables of how arms are evaluated, optimised and built, which are the same for others."""


def study_to_toml(study: Study, name: str, arms: Mapping[str, NamedArm], notes: Mapping[str, str] | None = None) -> str:
    """A study of other arms on the tasks of one that was read from a file, with its tables in `KEPT`.

    Args:
        study: with the tables of its file.
        name: of the new study.
        arms: what takes the place of each arm, by that arm's name. Arms that are left out are not in the study, nor
            are tasks for these alone; plans are none.
        notes: comments of one line above arms, by the same names.

    Raises:
        ValueError: the study is from no file; or as for `arm_to_toml`.
    """
    if not study.tables:
        raise ValueError("study: must be one that was read from a file, got none of its tables")
    texts = [_text("", {"name": name} | {key: study.tables[key] for key in ("description",) if key in study.tables})]
    for old, arm in arms.items():
        note = f"# {notes[old]}\n" if notes and old in notes else ""
        texts.append(note + arm_to_toml(arm.design, arm.name, arm.files))
    for table in study.tables["task"]:
        named = [arms[old].name for old in table.get("arms", arms) if old in arms]
        if named:
            texts.append(_text("[[task]]", {**table, "arms": named} if "arms" in table else table))
    texts += [_text(f"[{key}]", study.tables[key]) for key in KEPT if study.tables.get(key)]
    return "\n".join(texts).lstrip()


def moved_files(files: Sequence[str | None], study: Path, out: Path) -> tuple[str | None, ...]:
    """Paths of force models, which start at the study's folder, from the folder of the file of --out."""
    if study.parent.resolve() == out.parent.resolve() or is_stream(out):
        return tuple(files)

    def moved(name: str) -> str:
        try:
            return Path(os.path.relpath(study.parent / name, out.parent)).as_posix()
        except ValueError:  # on another drive
            return (study.parent / name).resolve().as_posix()

    return tuple(name if name is None or Path(name).is_absolute() else moved(name) for name in files)


def _text(heading: str, table: Mapping[str, Any]) -> str:
    return "\n".join([heading, *(toml_entry(key, value) for key, value in table.items()), ""])


def _rounded(value: Any) -> Any:
    """A value of a table with its numbers in `DIGITS`."""
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(item) for item in value]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value


def _segment(arm: ArmDesign, link: RigidLink | None, paths: Sequence[str | None]) -> dict[str, Any]:
    """A segment's table; it is known that the same force models are read from it, but for those of files."""
    place = "radii" if arm.dimension == 2 else "offsets"
    keys = (place, "length", "max_pressure", "diameter", "torsion_stiffness")
    table = {key: value.tolist() for key in keys if (value := getattr(arm, key)) is not None}
    table[place] = torch.where(getattr(arm, place).abs() < NOWHERE, 0.0, getattr(arm, place)).tolist()
    if bool(arm.mass):
        table["mass"] = arm.mass.item()
    if link is not None:
        if link.length is None:
            raise ValueError(
                f"link.pose: must be left out of an arm for a study, which holds straight links, got {link}"
            )
        table["link"] = {"length": link.length.item(), "mass": link.mass.item()}
    table["actuators"] = [_table(*pair, index) for index, pair in enumerate(zip(arm.actuators, paths, strict=True))]
    validated(SegmentTable, table)
    return table


def _table(model: Actuator, path: str | None, index: int) -> str | dict[str, Any]:
    """A force model as a study has it: by the first of some forms from which the same is read."""
    if path is not None:
        return {"kind": "file", "path": path} | _options(model, index)
    for table in _forms(model, index):
        if _alike(validated(ActuatorTable, table, ["actuators", index]).build(Path()), model):
            return table if len(table) > 1 else str(table["kind"])
    raise _refusal(index, model)


def _forms(model: Actuator, index: int) -> Iterator[dict[str, Any]]:
    """Tables of a force model, the shortest first; what is as the kind's default is left out."""
    if isinstance(model, PolynomialActuator):
        strains = {} if model.strain_range == USUAL_STRAINS else {"strain_range": list(model.strain_range)}
        size, limit = plain_number(model.force_scale), plain_number(model.max_pressure)
        if type(model) is Chamber:
            yield {"kind": "chamber", "area": size, "max_pressure": limit} | strains
        elif type(model) is ElasticCore and isinstance(model.bending_stiffness, ConstantBending):
            bending = -plain_number(model.bending_stiffness.stiffness)
            yield {"kind": "elastic_core", "axial_stiffness": size, "bending_stiffness": bending} | strains
    if type(model) in SHIPPED.values():
        yield {"kind": model.name} | _options(model, index)  # type: ignore[attr-defined]
    elif type(model) in (PolynomialActuator, Chamber, ElasticCore):
        own = {"coefficients": [list(row) for row in model.coefficients]}  # type: ignore[attr-defined]
        ranges = {key: list(getattr(model, key)) for key in ("strain_range", "pressure_range")}
        yield {"kind": "polynomial"} | own | ranges | _options(model, index)


def _options(model: Actuator, index: int) -> dict[str, Any]:
    """What a force model has of the keys that most kinds have, but for what is as its class's default."""
    table: dict[str, Any] = {}
    for key in ("max_pressure", "bending_stiffness", "force_scale"):
        value, default = getattr(model, key, None), getattr(type(model), key, None)
        own = type(value) is type(default) and value == default
        if value is None or own or (isinstance(value, LinearBending) and value.assumed):  # its file says so, too
            continue
        if isinstance(value, LinearBending | ConstantBending):
            table["bending"] = _bending(value)
        elif hasattr(value, "active"):
            raise _refusal(index, model)
        else:
            table[key] = plain_number(value)
    return table


def _alike(one: Any, other: Any) -> bool:
    """Whether force models, or what they hold, are equal to `DIGITS`; a polynomial may stand for a ready model."""
    if isinstance(one, tuple | list):
        return len(one) == len(other) and all(map(_alike, one, other))
    if is_dataclass(one):
        fitting = type(one) is type(other) or (type(one) is PolynomialActuator and isinstance(other, type(one)))
        return fitting and all(_alike(getattr(one, f.name), getattr(other, f.name)) for f in fields(one))
    if isinstance(one, float | int | Tensor):
        return math.isclose(plain_number(one), plain_number(other), rel_tol=10.0**-DIGITS)
    return bool(one == other)


def _bending(model: LinearBending | ConstantBending) -> dict[str, Any]:
    table: dict[str, Any] = {"kind": "linear" if isinstance(model, LinearBending) else "constant"}
    table["stiffness"] = plain_number(model.stiffness)
    if model.reference_pressure is not None:
        table["reference_pressure"] = plain_number(model.reference_pressure)
    return table


def _refusal(index: int, model: Actuator) -> ValueError:
    return ValueError(f"{field_path(['actuators', index])}: {ALLOWED}, got {shown(model)}")
