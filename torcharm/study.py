"""Studies: a TOML file that names arms, tasks and how to evaluate them, and the tables that come of it.

    study = load_study("study.toml")
    results = evaluate_study(study)
    write_results("results.csv", results)

`example_text()` is a commented study that shows every section. Lengths are in metres, angles in
radians, forces in newtons, moments in newton-metres, pressures in kilopascals. Entries of lists
(arms, tasks, loads, nodes) are counted from 1, in tables and in error messages.
"""

import csv
import difflib
import json
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib import resources
from os import PathLike
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from pydantic import BaseModel, BeforeValidator, ConfigDict, Discriminator, Field, Tag, ValidationError, model_validator
from pydantic_core import ErrorDetails, PydanticCustomError
from torch import Tensor

from torcharm.actuators import Actuator, Bellows, McKibben, PolynomialActuator
from torcharm.arm import ArmDesign, antagonistic_arm, bellows_arm, mckibben_arm
from torcharm.attainability import METRICS, Attainability, evaluate
from torcharm.distance import DISTANCES
from torcharm.hulls import KINDS, sample_count, slot_count
from torcharm.rod import BASE_POSE
from torcharm.task import Task, affine_curvature, cubic_curvature, sample_loads

MOST_VALUES = 50_000_000
"""Numbers that one tensor of a study may hold (400 MB); past it, a key was struck once too often."""
HIGHEST_DEGREE = 20
"""Of strain or pressure in a polynomial force model."""


# Studies and their results


@dataclass(frozen=True)
class NamedArm:
    """One design, and what the study calls it.

    Raises:
        ValueError: the design is a batch.
    """

    name: str
    design: ArmDesign

    def __post_init__(self) -> None:
        if self.design.batch_shape:
            raise ValueError(f"design: must be a single design, got a batch of {tuple(self.design.batch_shape)}")


@dataclass(frozen=True)
class NamedTask:
    """A shape under any number of loads, and what the study calls it."""

    name: str
    task: Task


@dataclass(frozen=True)
class Settings:
    """How a study is evaluated: arguments of `torcharm.evaluate`, with its defaults."""

    metrics: tuple[str, ...] = METRICS
    hull: str = "exact"
    samples: int | None = None
    distance: str = "closed_form"
    weights: tuple[float, float] = (1.0, 1.0)
    power: int = 1
    signed: bool = False


@dataclass(frozen=True)
class Study:
    """Arms, tasks, and how every arm is to be evaluated on every task."""

    name: str
    description: str
    arms: tuple[NamedArm, ...]
    tasks: tuple[NamedTask, ...]
    settings: Settings


@dataclass(frozen=True)
class StudyResult:
    """What `torcharm.evaluate` found for one arm on one task; a load has the task's batch shape.

    Attributes:
        arm, task: what was evaluated.
        settings: how.
        attainability: what was found.
    """

    arm: NamedArm
    task: NamedTask
    settings: Settings
    attainability: Attainability

    def metric(self, name: str) -> Tensor:
        """A metric that was asked for, (*task batch)."""
        found: Tensor = getattr(self.attainability, name)
        return found

    @property
    def attainable(self) -> Tensor:
        """Whether no metric that was asked for is above 0, (*task batch); a NaN is not attainable."""
        return torch.stack([self.metric(name) <= 0 for name in self.settings.metrics]).all(0)

    @property
    def node_metric(self) -> str | None:
        """The metric by which nodes are compared: the first of those asked for that is known per node."""
        known = (name for name in METRICS if getattr(self.attainability, f"{name}_per_node", None) is not None)
        return next(known, None)

    @property
    def node_distance(self) -> Tensor | None:
        """Distance of each node to its hull, (*task batch, N), by the node metric; 0 inside."""
        if self.node_metric is None:
            return None
        distance: Tensor = getattr(self.attainability, f"{self.node_metric}_per_node")
        return distance.clamp(min=0)


@dataclass(frozen=True)
class Summary:
    """A result over all loads.

    Attributes:
        loads: how many.
        median: of each metric.
        attainable: how many loads have each metric at 0 (signed: or below).
        all_attainable: how many loads have all metrics there.
        worst_node: from 1, the node with the largest mean distance by the node metric; None if none misses.
        strain_excess: largest strain beyond its actuator's characterised range, 0 if none is.
        limits_in_range: whether the pressure limits lie in the characterised range.
    """

    loads: int
    median: Mapping[str, float]
    attainable: Mapping[str, int]
    all_attainable: int
    worst_node: int | None
    strain_excess: float
    limits_in_range: bool


def load_study(path: str | PathLike[str]) -> Study:
    """Read a study from a TOML file.

    Raises:
        ValueError: the file cannot be read, is not UTF-8 or TOML, or describes no study: one line that
            names the file, the field, what was given and what is allowed.
    """
    source = str(path)
    try:
        text = Path(path).read_text(encoding="utf-8-sig")  # Windows editors put a byte order mark first
    except UnicodeDecodeError as error:
        raise ValueError(_one_line(f"{source}: must be UTF-8 text, got byte {error.start + 1} that is not")) from None
    except OSError as error:
        raise ValueError(_one_line(f"{source}: cannot be read: {error.strerror or error}")) from None
    return parse_study(text, source)


def parse_study(text: str, source: str = "study") -> Study:
    """A study from the text of a TOML file; `source` is what error messages call the file.

    Raises:
        ValueError: as for `load_study`.
    """
    try:
        raw = tomllib.loads(text)
    except RecursionError:
        raise ValueError(_one_line(f"{source}: is not valid TOML: nested too deeply")) from None
    except tomllib.TOMLDecodeError as error:
        raise ValueError(_one_line(f"{source}: is not valid TOML: {error}")) from None
    except ValueError:  # from Python, which reads no integer of more than 4300 digits
        raise ValueError(_one_line(f"{source}: holds a number of too many digits")) from None
    try:
        table = _StudyTable.model_validate(raw)
    except ValidationError as error:
        raise ValueError(_one_line(f"{source}: {_first_mistake(error, raw)}")) from None
    try:
        return _study(table)
    except ValueError as error:
        raise ValueError(_one_line(f"{source}: {error}")) from None


def paper_study() -> Study:
    """The paper's validation: two arms, one shape, 100 loads, absolute and relative unattainability."""
    return parse_study(_shipped("validation.toml"), "torcharm/studies/validation.toml")


def example_text() -> str:
    """The text of a commented study to start from; `torcharm init` writes it."""
    return _shipped("example.toml")


def _shipped(name: str) -> str:
    return resources.files("torcharm").joinpath("studies", name).read_text(encoding="utf-8")


def evaluate_study(study: Study) -> list[StudyResult]:
    """Evaluate every arm on every task: task by task, in the study's order of arms."""
    options = asdict(study.settings)
    return [
        StudyResult(arm, task, study.settings, evaluate(arm.design, task.task, **options))
        for task in study.tasks
        for arm in study.arms
    ]


def summarise(result: StudyResult) -> Summary:
    """Medians and counts over the loads of one result."""
    values = {name: result.metric(name) for name in result.settings.metrics}
    design = result.arm.design
    characterised = design.max_pressure.new_tensor([model.pressure_range[1] for model in design.actuators])
    distance = result.node_distance
    return Summary(
        loads=result.attainable.numel(),
        median={name: float(np.median(value.detach().cpu().numpy())) for name, value in values.items()},
        attainable={name: int((value <= 0).sum()) for name, value in values.items()},
        all_attainable=int(result.attainable.sum()),
        worst_node=None if distance is None else int(_worst_node(_mean_over_loads(distance))) or None,
        strain_excess=float(result.attainability.strain_excess.max()),
        limits_in_range=bool((design.max_pressure <= characterised).all()),
    )


def write_results(path: str | PathLike[str], results: Sequence[StudyResult]) -> int:
    """Write a CSV file with a row for every arm, task and load; returns the number of rows.

    Columns: arm; task; load, counted from 1; force_x_N, force_y_N and moment_Nm at the tip; each
    metric that was asked for; worst_node, counted from 1, with the largest distance by the first of
    the metrics (empty if no node misses); attainable, if all metrics are 0; in_range and strain_excess
    as in `Attainability`. Numbers are written in full, truths as true and false.

    Raises:
        ValueError: the results were not evaluated with the same metrics.
        OSError: the file cannot be written.
    """
    metrics = {result.settings.metrics for result in results}
    if len(metrics) > 1:
        raise ValueError(f"results: must have the same metrics, got {' and '.join(map(str, sorted(metrics)))}")
    asked = next(iter(metrics), METRICS)
    header = ["arm", "task", "load", "force_x_N", "force_y_N", "moment_Nm", *asked]
    rows = [row for result in results for row in _rows(result)]
    with Path(path).open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*header, "worst_node", "attainable", "in_range", "strain_excess"])
        writer.writerows(rows)
    return len(rows)


def _rows(result: StudyResult) -> Iterator[list[object]]:
    found, task = result.attainability, result.task.task
    loads = task.tip_load.expand(*task.batch_shape, 3).reshape(-1, 3).tolist()
    distance = result.node_distance
    worst = [0] * len(loads) if distance is None else _worst_node(distance).flatten().tolist()
    columns = [
        *(result.metric(name) for name in result.settings.metrics),
        *(result.attainable, found.in_range, found.strain_excess),
    ]
    values = zip(*(column.flatten().tolist() for column in columns), strict=True)
    for index, (load, node, (*metrics, attainable, in_range, excess)) in enumerate(
        zip(loads, worst, values, strict=True), start=1
    ):
        truths = (str(attainable).lower(), str(in_range).lower())
        yield [result.arm.name, result.task.name, index, *load, *metrics, node or "", *truths, excess]


def _mean_over_loads(distance: Tensor) -> Tensor:
    """(N,) from (*task batch, N)."""
    return distance.reshape(-1, distance.shape[-1]).mean(0)


def _worst_node(distance: Tensor) -> Tensor:
    """(...) From 1, the node with the largest of the distances (..., N) or the first NaN; 0 if all are 0."""
    largest, index = distance.max(-1)
    return torch.where(largest == 0, 0, index + 1)


# What a study file may hold. The models check one value at a time; `_study` checks how they fit together.


def _refuse(text: str, key: str = "") -> PydanticCustomError:
    """An error about the value in hand, or about one of its keys."""
    return PydanticCustomError("study", "{text}", {"text": text, "key": key})


def _shown(value: object) -> str:
    """A value much as it stands in the file, cut to a readable length."""
    try:
        if isinstance(value, dict):
            text = f"a table with {', '.join(value)}" if value else "an empty table"
        elif isinstance(value, str | bool | list):
            text = json.dumps(value, ensure_ascii=False, default=str)
        else:
            text = str(value)
    except ValueError:  # Python writes out no integer of more than 4300 digits
        text = "a very large number"
    return text if len(text) <= 60 else f"{text[:57]}..."


def _hint(word: object, allowed: Sequence[str]) -> str:
    near = difflib.get_close_matches(word, allowed, 1) if isinstance(word, str) else []
    return f"; did you mean {near[0]}?" if near else ""


def _one_of(allowed: Sequence[str]) -> BeforeValidator:
    def check(value: Any) -> Any:
        if not isinstance(value, str) or value not in allowed:
            raise _refuse(f"must be one of {', '.join(allowed)}, got {_shown(value)}{_hint(value, allowed)}")
        return value

    return BeforeValidator(check)


def _entries(*names: str) -> BeforeValidator:
    """A list with an entry for each name."""

    def check(value: Any) -> Any:
        if not isinstance(value, list) or len(value) != len(names):
            raise _refuse(f"must be a list of {len(names)}, [{', '.join(names)}], got {_shown(value)}")
        return value

    return BeforeValidator(check)


def _filled(what: str) -> BeforeValidator:
    """A list with at least one entry."""

    def check(value: Any) -> Any:
        if not isinstance(value, list) or not value:
            raise _refuse(f"must be {what}, got {_shown(value)}")
        return value

    return BeforeValidator(check)


def _check_name(value: Any) -> Any:
    if not isinstance(value, str) or not value.strip() or not value.isprintable():
        raise _refuse(f"must be a text of one line that is not blank, got {_shown(value)}")
    return value


def _either(what: str, *kinds: type) -> BeforeValidator:
    def check(value: Any) -> Any:
        if not isinstance(value, kinds) or isinstance(value, bool):
            raise _refuse(f"must be {what}, got {_shown(value)}")
        return value

    return BeforeValidator(check)


def _alternatives(first: str, *second: str) -> BeforeValidator:
    """A table with one key, or with any of some others, and not with both or neither."""

    def check(value: Any) -> Any:
        if isinstance(value, dict):
            others = [key for key in second if key in value]
            if (first in value) == bool(others):
                got = f"both {first} and {', '.join(others)}" if others else f"neither in {_shown(value)}"
                raise _refuse(f"must have either {first}, or {' and '.join(second)}, got {got}")
        return value

    return BeforeValidator(check)


def _kind_among(*kinds: str) -> BeforeValidator:
    """A table whose kind is one of those given, so that the kind can choose the model."""

    def check(value: Any) -> Any:
        if not isinstance(value, dict):
            raise _refuse(f"must be a table with a kind ({', '.join(kinds)}), got {_shown(value)}")
        if "kind" not in value:
            raise _refuse(f"missing; must be one of {', '.join(kinds)}; got {_shown(value)}", "kind")
        kind = value["kind"]
        if not isinstance(kind, str) or kind not in kinds:
            raise _refuse(f"must be one of {', '.join(kinds)}, got {_shown(kind)}{_hint(kind, kinds)}", "kind")
        return value

    return BeforeValidator(check)


# Tags say which of several models is meant. pydantic puts them into the path of an error, and the
# brackets tell them from keys there.
def _by_kind(value: Any) -> str:
    return f"<{value['kind']}>"


def _by_list(value: Any) -> str:
    return "<list>" if isinstance(value, list) else "<other>"


def _by_key(key: str) -> Discriminator:
    return Discriminator(lambda value: "<with>" if isinstance(value, dict) and key in value else "<without>")


class _Table(BaseModel):
    """A table of the file: unknown and missing keys are found before any value is looked at."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _check_keys(cls, value: Any) -> Any:
        if not isinstance(value, dict):
            raise _refuse(f"must be a table, got {_shown(value)}")
        allowed = list(cls.model_fields)
        for key in value:
            if key not in allowed:
                raise _refuse(f"unknown key{_hint(key, allowed) or ';'} allowed: {', '.join(allowed)}", key)
        for key, field in cls.model_fields.items():
            if field.is_required() and key not in value:
                raise _refuse(f"missing; must be {field.description}", key)
        return value


_Positive = Annotated[float, Field(gt=0)]
_NotNegative = Annotated[float, Field(ge=0)]
_Name = Annotated[str, BeforeValidator(_check_name), Field(description="a text of one line")]
_Range = Annotated[list[float], _entries("lowest", "highest")]
_Lengths = Annotated[
    Annotated[_Positive, Tag("<other>")] | Annotated[list[_Positive], Tag("<list>")],
    Discriminator(_by_list),
    _either("a number or a list of numbers [m]", int, float, list),
]
_Limits = Annotated[
    Annotated[_NotNegative, Tag("<other>")] | Annotated[list[_NotNegative], Tag("<list>")],
    Discriminator(_by_list),
    _either("a number or a list of numbers [kPa]", int, float, list),
]


class _PaperActuator(_Table):
    kind: str
    bending_stiffness: float | None = None
    max_pressure: _Positive | None = None
    force_scale: float | None = None


class _PolynomialTable(_Table):
    kind: str
    coefficients: Annotated[
        list[Annotated[list[float], _entries("power of strain", "power of pressure", "coefficient")]],
        _filled("a list of [power of strain, power of pressure, coefficient]"),
        Field(description="a list of [power of strain, power of pressure, coefficient]"),
    ]
    strain_range: Annotated[_Range, Field(description="[lowest, highest], the strains that were characterised")]
    pressure_range: Annotated[_Range, Field(description="[lowest, highest], the pressures characterised [kPa]")]
    max_pressure: Annotated[_Positive, Field(description="the highest pressure in use [kPa]")]
    bending_stiffness: float | None = None
    force_scale: float | None = None


def _named_kind(value: Any) -> Any:
    return {"kind": value} if isinstance(value, str) else value


_ActuatorTable = Annotated[
    Annotated[_PaperActuator, Tag("<bellows>")]
    | Annotated[_PaperActuator, Tag("<mckibben>")]
    | Annotated[_PolynomialTable, Tag("<polynomial>")],
    Discriminator(_by_kind),
    _kind_among("bellows", "mckibben", "polynomial"),
    BeforeValidator(_named_kind),
]


class _PaperArm(_Table):
    name: _Name
    kind: Annotated[str, _one_of(("antagonistic", "bellows", "mckibben"))]
    outer_radius: _NotNegative | None = None
    inner_radius: _NotNegative | None = None
    length: _Lengths = 0.5
    max_pressure: _Limits | None = None


class _FreeArm(_Table):
    name: _Name
    radii: Annotated[
        list[float], _filled("a list of numbers [m]"), Field(description="a list of offsets, one for each actuator [m]")
    ]
    length: Annotated[_Lengths, Field(description="a number, or a list of one for each actuator [m]")]
    actuators: Annotated[
        list[_ActuatorTable],
        _filled("a list of force models such as bellows"),
        Field(description="a list of force models, one for each radius"),
    ]
    max_pressure: _Limits | None = None


_ArmTable = Annotated[
    Annotated[_PaperArm, Tag("<with>")] | Annotated[_FreeArm, Tag("<without>")],
    _by_key("kind"),
    _alternatives("kind", "radii", "actuators"),
]


class _AffineShape(_Table):
    kind: str
    slope: Annotated[float, Field(description="a number [rad]")]
    intercept: Annotated[float, Field(description="a number [rad]")]
    length: _Positive = 0.5
    nodes: Annotated[int, Field(ge=1, le=10_000)] = 10


class _CubicShape(_AffineShape):
    cubic: Annotated[float, Field(description="a number [rad]")]
    quadratic: Annotated[float, Field(description="a number [rad]")]


_ShapeTable = Annotated[
    Annotated[_AffineShape, Tag("<affine>")] | Annotated[_CubicShape, Tag("<cubic>")],
    Discriminator(_by_kind),
    _kind_among("affine", "cubic"),
]


class _DrawnLoads(_Table):
    count: Annotated[int, Field(ge=1, le=1_000_000, description="a whole number of loads")]
    scale: Annotated[list[_NotNegative], _entries("f_x", "f_y", "m")] = [20.0, 20.0, 2.0]
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 100


_LoadsTable = Annotated[
    Annotated[
        list[Annotated[list[float], _entries("f_x", "f_y", "m")]],
        _filled("at least one load [f_x, f_y, m]"),
        Tag("<list>"),
    ]
    | Annotated[_DrawnLoads, Tag("<other>")],
    Discriminator(_by_list),
    _either("a list of [f_x, f_y, m], or a table with count, scale and seed", list, dict),
]
_loads_field = Field(description="a list of [f_x, f_y, m] [N, N, N·m], or a table with count, scale and seed")
_BasePose = Annotated[list[float], _entries("x", "y", "θ")]


class _ShapedTask(_Table):
    name: _Name
    shape: _ShapeTable
    loads: Annotated[_LoadsTable, _loads_field]
    base_pose: _BasePose = list(BASE_POSE)


class _TwistTask(_Table):
    name: _Name
    twists: Annotated[
        list[Annotated[list[float], _entries("l", "γ", "κ")]], _filled("a list of [l, γ, κ], one for each node")
    ]
    loads: Annotated[_LoadsTable, _loads_field]
    base_pose: _BasePose = list(BASE_POSE)


_TaskTable = Annotated[
    Annotated[_ShapedTask, Tag("<with>")] | Annotated[_TwistTask, Tag("<without>")],
    _by_key("shape"),
    _alternatives("shape", "twists"),
]


class _EvaluateTable(_Table):
    metrics: Annotated[
        list[Annotated[str, _one_of(METRICS)]], _filled(f"a list of metrics, such as {json.dumps(METRICS)}")
    ] = list(METRICS)
    hull: Annotated[str, _one_of(KINDS)] = Settings.hull
    samples: Annotated[int, Field(ge=2, le=1_000_000)] | None = Settings.samples
    distance: Annotated[str, _one_of(DISTANCES)] = Settings.distance
    weights: Annotated[list[_Positive], _entries("k_f", "k_m")] = list(Settings.weights)
    power: Annotated[int, Field(ge=1, le=2)] = Settings.power
    signed: bool = Settings.signed


class _StudyTable(_Table):
    name: _Name
    description: str = ""
    arm: Annotated[
        list[_ArmTable], _filled("tables that begin with [[arm]]"), Field(description="at least one [[arm]]")
    ]
    task: Annotated[
        list[_TaskTable], _filled("tables that begin with [[task]]"), Field(description="at least one [[task]]")
    ]
    evaluate: _EvaluateTable = _EvaluateTable()


# Messages

_ALLOWED = {
    "float_type": "a number",
    "finite_number": "a finite number",
    "int_type": "a whole number",
    "string_type": "a text in quotes",
    "bool_type": "true or false",
    "list_type": "a list",
    "greater_than": "above {gt:g}",
    "greater_than_equal": "at least {ge:g}",
    "less_than": "below {lt}",
    "less_than_equal": "at most {le}",
}


def _first_mistake(error: ValidationError, raw: Mapping[str, Any]) -> str:
    """`path: what is allowed, what was given` of the first of pydantic's errors."""
    mistake = error.errors(include_url=False)[0]
    context = mistake.get("ctx", {})
    keys = [part for part in mistake["loc"] if not str(part).startswith("<")]
    path = [*keys, context["key"]] if context.get("key") else keys
    return f"{_path(path)}: {_what_is_wrong(mistake, context)}{_whose(keys, raw)}"


def _what_is_wrong(mistake: ErrorDetails, context: Mapping[str, Any]) -> str:
    if mistake["type"] == "study":
        return str(context["text"])
    if mistake["type"] not in _ALLOWED:
        return f"{mistake['msg']}, got {_shown(mistake['input'])}"
    return f"must be {_ALLOWED[mistake['type']].format(**context)}, got {_shown(mistake['input'])}"


def _path(keys: Sequence[int | str]) -> str:
    """`arm[1].length[2]` from ("arm", 0, "length", 1)."""
    parts = [f"[{key + 1}]" if isinstance(key, int) else f".{_bare(key)}" for key in keys]
    return "".join(parts).removeprefix(".")


def _bare(key: str) -> str:
    return key if re.fullmatch(r"[\w-]+", key) else json.dumps(key, ensure_ascii=False)


def _whose(keys: Sequence[int | str], raw: Mapping[str, Any]) -> str:
    """The name of the arm or task that a path leads into, so that nobody has to count."""
    if len(keys) < 2 or not isinstance(keys[1], int) or keys[-1] == "name":
        return ""
    entry = raw[str(keys[0])][keys[1]]
    name = entry.get("name") if isinstance(entry, dict) else None
    return f" (in {_shown(name)})" if isinstance(name, str) else ""


def _one_line(text: str) -> str:
    return " ".join(text.split())


@contextmanager
def _within(path: str, name: str = "") -> Iterator[None]:
    """Put a path before the field that a ValueError names."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{path}.{error}{name and f' (in {_shown(name)})'}") from None


# From checked tables to designs and tasks

_PAPER_ARMS: dict[str, Callable[..., ArmDesign]] = {
    "antagonistic": antagonistic_arm,
    "bellows": bellows_arm,
    "mckibben": mckibben_arm,
}


def _study(table: _StudyTable) -> Study:
    _check_unique("arm", table.arm)
    _check_unique("task", table.task)
    arms, tasks = [], []
    for index, entry in enumerate(table.arm):
        with _within(_path(["arm", index]), entry.name):
            arms.append(NamedArm(entry.name, _design(entry)))
    for index, job in enumerate(table.task):
        with _within(_path(["task", index]), job.name):
            tasks.append(NamedTask(job.name, _task(job)))
    settings = _settings(table.evaluate)
    for arm in arms:
        for task in tasks:
            with _within("evaluate", arm.name):
                _check_size(arm, task, settings)
    return Study(table.name, table.description, tuple(arms), tuple(tasks), settings)


def _check_unique(section: str, tables: Sequence[_PaperArm | _FreeArm | _ShapedTask | _TwistTask]) -> None:
    seen: dict[str, int] = {}
    for index, table in enumerate(tables):
        if table.name in seen:
            here, first = _path([section, index, "name"]), _path([section, seen[table.name]])
            raise ValueError(f"{here}: must be a name of its own, got {_shown(table.name)}, the name of {first}")
        seen[table.name] = index


def _design(table: _PaperArm | _FreeArm) -> ArmDesign:
    limit = table.max_pressure
    if isinstance(table, _FreeArm):
        actuators = tuple(_actuator(entry, index) for index, entry in enumerate(table.actuators))
        radii = torch.tensor(table.radii, dtype=torch.float64)
    else:
        given = table.model_dump(include={"outer_radius", "inner_radius"}, exclude_none=True)
        paper = _PAPER_ARMS[table.kind](**given)
        actuators, radii = paper.actuators, paper.radii
    for name, value in (("radii", radii.tolist()), ("length", table.length), ("max_pressure", limit)):
        if isinstance(value, list) and len(value) != len(actuators):
            raise ValueError(
                f"{name}: must hold one number for each of the {len(actuators)} actuators, got {len(value)}"
            )
    return ArmDesign(radii, table.length, actuators, [limit] if isinstance(limit, float) else limit)


def _actuator(table: _PaperActuator | _PolynomialTable, index: int) -> Actuator:
    options = table.model_dump(exclude={"kind"}, exclude_none=True)
    if isinstance(table, _PaperActuator):
        return Bellows(**options) if table.kind == "bellows" else McKibben(**options)
    with _within(_path(["actuators", index])):
        for name in ("strain_range", "pressure_range"):
            low, high = options[name] = tuple(options[name])
            if not low < high:
                raise ValueError(f"{name}: must be [lowest, highest], got {_shown([low, high])}")
        options["coefficients"] = tuple(_term(row, place) for place, row in enumerate(table.coefficients))
        return PolynomialActuator(**options)


def _term(row: Sequence[float], index: int) -> tuple[int, int, float]:
    i, j, coefficient = row
    for power in (i, j):
        if power not in range(HIGHEST_DEGREE + 1):
            path = _path(["coefficients", index])
            raise ValueError(f"{path}: powers must be whole numbers from 0 to {HIGHEST_DEGREE}, got {power:g}")
    return int(i), int(j), coefficient


def _task(table: _ShapedTask | _TwistTask) -> Task:
    if isinstance(table, _TwistTask):
        twists = torch.tensor(table.twists, dtype=torch.float64)
    else:
        curvature = cubic_curvature if isinstance(table.shape, _CubicShape) else affine_curvature
        twists = curvature(**table.shape.model_dump(exclude={"kind"}))
    if isinstance(table.loads, _DrawnLoads):
        _check_values("loads.count", table.loads.count * len(twists), f"{table.loads.count} loads, {len(twists)} nodes")
        loads = sample_loads(table.loads.count, table.loads.scale, table.loads.seed)
    else:
        loads = torch.tensor(table.loads, dtype=torch.float64)
    return Task(twists, loads, table.base_pose)


def _settings(table: _EvaluateTable) -> Settings:
    force, moment = table.weights
    options = table.model_dump(exclude={"metrics", "weights"})
    return Settings(
        metrics=tuple(name for name in METRICS if name in table.metrics), weights=(force, moment), **options
    )


def _check_size(arm: NamedArm, task: NamedTask, settings: Settings) -> None:
    """Refuse hulls that cannot be made of this many actuators, or that no memory holds."""
    actuators, nodes = arm.design.actuator_count, task.task.nodes
    count = sample_count(arm.design, settings.hull, settings.samples)
    slots = slot_count(actuators, settings.hull, count)
    if settings.hull == "exact":
        slots = max(slots, actuators * count**2)  # every pair of samples of a curve with inflections
    _check_values("samples", slots * nodes, f"{count} samples, {actuators} actuators, {nodes} nodes")


def _check_values(name: str, count: int, given: str) -> None:
    if count > MOST_VALUES:
        raise ValueError(f"{name}: must make at most {MOST_VALUES:.0e} numbers at once, got {count:.0e} from {given}")
