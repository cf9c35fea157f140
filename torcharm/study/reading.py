"""From the text of a study file to designs and tasks, and how they fit together."""

import tomllib
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import resources
from os import PathLike
from pathlib import Path
from typing import Any

import torch
from pydantic import ValidationError

from torcharm.actuators import SHIPPED, Actuator, Bending, ConstantBending, LinearBending, PolynomialActuator
from torcharm.actuators.model_file import load_actuator
from torcharm.arm import ArmDesign, antagonistic_arm, bellows_arm, mckibben_arm
from torcharm.attainability import CHOICES, PoseTolerance, check_measure
from torcharm.attainability.questions import question_about_arm, question_about_shape
from torcharm.design.objective import Objective
from torcharm.design.shape_planning import Smoothness
from torcharm.design.space import DesignSpace
from torcharm.files import read_file
from torcharm.shapes import affine_curvature, cubic_curvature
from torcharm.study.arm_tables import (
    BendingTable,
    FileActuator,
    FreeArm,
    PaperArm,
    PolynomialTable,
    ShippedActuator,
)
from torcharm.study.data import NamedArm, NamedPlan, NamedTask, Optimisation, Settings, Study
from torcharm.study.fields import field_path, first_mistake, one_line, shown_value, within
from torcharm.study.tables import (
    CubicShape,
    DrawnLoads,
    EvaluateTable,
    OptimiseTable,
    PlanTable,
    ShapedTask,
    StudyTable,
    TwistTask,
)
from torcharm.task import Task, sample_loads
from torcharm.wrench_sets.vertex_sets import CURVE_SAMPLES, EDGE_SAMPLES

MOST_VALUES = 50_000_000
"""Numbers that one tensor of a study may hold (400 MB); past it, a key was struck once too often."""
HIGHEST_DEGREE = 20
"""Of strain or pressure in a polynomial force model."""


def load_study(path: str | PathLike[str]) -> Study:
    """Read a study from a TOML file.

    Raises:
        ValueError: the file cannot be read, is not UTF-8 or TOML, or describes no study: one line that
            names the file, the field, what was given and what is allowed.
    """
    source = str(path)
    try:
        text = read_file(path).decode("utf-8-sig")  # Windows editors put a byte order mark first
    except UnicodeDecodeError as error:
        raise ValueError(one_line(f"{source}: must be UTF-8 text, got byte {error.start + 1} that is not")) from None
    except ValueError as error:
        raise ValueError(one_line(str(error))) from None
    return parse_study(text.replace("\r\n", "\n").replace("\r", "\n"), source, Path(path).parent)


def parse_study(text: str, source: str = "study", folder: str | PathLike[str] = ".") -> Study:
    """A study from the text of a TOML file.

    Args:
        text: of the file.
        source: what error messages call the file.
        folder: where relative paths of force models start.

    Raises:
        ValueError: as for `load_study`.
    """
    try:
        raw = tomllib.loads(text)
    except RecursionError:
        raise ValueError(one_line(f"{source}: is not valid TOML: nested too deeply")) from None
    except tomllib.TOMLDecodeError as error:
        raise ValueError(one_line(f"{source}: is not valid TOML: {error}")) from None
    except ValueError:  # from Python, which reads no integer of more than 4300 digits
        raise ValueError(one_line(f"{source}: holds a number of too many digits")) from None
    try:
        table = StudyTable.model_validate(raw)
    except ValidationError as error:
        raise ValueError(one_line(f"{source}: {first_mistake(error, raw)}")) from None
    try:
        return _study(table, Path(folder))
    except ValueError as error:
        raise ValueError(one_line(f"{source}: {error}")) from None


def paper_study() -> Study:
    """The paper's validation: two arms, one shape, 100 loads, absolute and relative unattainability."""
    return parse_study(_shipped("validation.toml"), "torcharm/studies/validation.toml")


def example_study() -> Study:
    """The study that `example_text` shows: arms of both kinds, and tasks that some of them hold."""
    return parse_study(example_text(), "torcharm/studies/example.toml")


def example_text() -> str:
    """The text of a commented study to start from; `torcharm init` writes it."""
    return _shipped("example.toml")


def _shipped(name: str) -> str:
    return resources.files("torcharm").joinpath("studies", name).read_text(encoding="utf-8")


_PAPER_ARMS: dict[str, Callable[..., ArmDesign]] = {
    "antagonistic": antagonistic_arm,
    "bellows": bellows_arm,
    "mckibben": mckibben_arm,
}


def _study(table: StudyTable, folder: Path) -> Study:
    _check_unique("arm", table.arm)
    _check_unique("task", table.task)
    arms, tasks = [], []
    for index, entry in enumerate(table.arm):
        with within(field_path(["arm", index]), entry.name):
            arms.append(NamedArm(entry.name, _sensible(_design(entry, folder)), _files(entry)))
    for index, job in enumerate(table.task):
        with within(field_path(["task", index]), job.name):
            tasks.append(NamedTask(job.name, _task(job)))
    with within("evaluate", ""):
        settings = _settings(table.evaluate)
    for arm in arms:
        for task in tasks:
            with within("evaluate", arm.name):
                _check_size(arm, task, settings)
    with within("optimise", ""):
        optimisation = _optimisation(table.optimise)
    plans = []
    for index, wanted in enumerate(table.plan):
        with within(field_path(["plan", index]), wanted.name):
            plans.append(_plan(wanted))
    return Study(table.name, table.description, tuple(arms), tuple(tasks), settings, optimisation, tuple(plans))


def _check_unique(section: str, tables: Sequence[PaperArm | FreeArm | ShapedTask | TwistTask]) -> None:
    seen: dict[str, int] = {}
    for index, table in enumerate(tables):
        if table.name in seen:
            here, first = field_path([section, index, "name"]), field_path([section, seen[table.name]])
            raise ValueError(f"{here}: must be a name of its own, got {shown_value(table.name)}, the name of {first}")
        seen[table.name] = index


def _design(table: PaperArm | FreeArm, folder: Path) -> ArmDesign:
    limit = table.max_pressure
    if isinstance(table, FreeArm):
        actuators = tuple(make_actuator(entry, index, folder) for index, entry in enumerate(table.actuators))
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
    return ArmDesign(radii, table.length, actuators, limit)


def _files(table: PaperArm | FreeArm) -> tuple[str | None, ...]:
    """Of each actuator the path of its force model's file, or None."""
    if isinstance(table, PaperArm):
        return ()
    return tuple(entry.path if isinstance(entry, FileActuator) else None for entry in table.actuators)


def _sensible(arm: ArmDesign) -> ArmDesign:
    """The arm, unless its numbers are in other units."""
    question = question_about_arm((arm,))
    if question is not None:
        raise ValueError(f'{question} A text with a unit, such as "50 mm", is understood')
    return arm


def make_actuator(table: ShippedActuator | FileActuator | PolynomialTable, index: int, folder: Path) -> Actuator:
    """The force model of an arm's table, which is the one at this index; files' paths start at the folder."""
    options = table.model_dump(exclude={"kind", "path", "bending"}, exclude_none=True)
    with within(field_path(["actuators", index])):
        if table.bending is not None:
            options["bending_stiffness"] = _bending(table, table.bending)
        if isinstance(table, FileActuator):
            model: Any = load_actuator(folder / table.path)
            return replace(model, **options)
        if isinstance(table, ShippedActuator):
            return SHIPPED[table.kind](**options)
        for name in ("strain_range", "pressure_range"):
            low, high = options[name] = tuple(options[name])
            if not low < high:
                raise ValueError(f"{name}: must be [lowest, highest], got {shown_value([low, high])}")
        options["coefficients"] = tuple(_term(row, place) for place, row in enumerate(table.coefficients))
        return PolynomialActuator(**options)


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


def _task(table: ShapedTask | TwistTask) -> Task:
    if isinstance(table, TwistTask):
        twists = torch.tensor(table.twists, dtype=torch.float64)
    else:
        curvature = cubic_curvature if isinstance(table.shape, CubicShape) else affine_curvature
        twists = curvature(**table.shape.model_dump(exclude={"kind"}))
    question = question_about_shape(twists)
    if question is not None:
        field = "twists" if isinstance(table, TwistTask) else "shape"
        raise ValueError(f'{field}: {question} A text with a unit, such as "48 cm" or "30 deg", is understood')
    if isinstance(table.loads, DrawnLoads):
        _check_values("loads.count", table.loads.count * len(twists), f"{table.loads.count} loads, {len(twists)} nodes")
        loads = sample_loads(table.loads.count, table.loads.scale, table.loads.seed)
    else:
        loads = torch.tensor(table.loads, dtype=torch.float64)
    return Task(twists, loads, table.base_pose, wrench_at=table.wrench_at)


def _settings(table: EvaluateTable) -> Settings:
    force, moment = table.weights
    options = table.model_dump(exclude={"metrics", "weights", "tolerance", "rotation_tolerance"})
    return Settings(
        metrics=tuple(name for name in CHOICES if name in table.metrics),
        tolerance=PoseTolerance(table.tolerance, table.rotation_tolerance),
        weights=(force, moment),
        **options,
    )


def _optimisation(table: OptimiseTable) -> Optimisation:
    bounds = {name: (ends[0], ends[1]) for name, ends in table.bounds.model_dump(exclude_none=True).items()}
    space = DesignSpace(tuple(table.free), table.tied, bounds, table.spacing, table.in_range)
    objective = Objective(table.metric, table.over, relative_weight=table.relative_weight)
    return Optimisation(space, objective, table.starts, table.seed, table.iterations)


def _plan(table: PlanTable) -> NamedPlan:
    weight, reference = table.length_weight, table.reference_length
    if (weight is None) != (reference is None):
        missing = "length_weight" if weight is None else "reference_length"
        raise ValueError(f"{missing}: must be given too, as the other is; without both, unattainability is minimised")
    smoothness = None if weight is None or reference is None else Smoothness(weight, reference)
    poses = tuple(table.tip_pose), tuple(table.tip_load)
    return NamedPlan(table.name, *poses, smoothness, table.nodes, tuple(table.base_pose), table.in_range)


def _check_size(arm: NamedArm, task: NamedTask, settings: Settings) -> None:
    """Refuse options that do not go together, hulls of too many actuators, and those that no memory holds."""
    check_measure(arm.design, settings.hull, settings.samples, settings.distance, settings.signed)
    actuators, nodes = arm.design.actuator_count, task.task.nodes
    if settings.hull == "edges":
        count = settings.samples or EDGE_SAMPLES
        vertices = 2**actuators + actuators * 2 ** (actuators - 1) * (count - 2)
    elif settings.distance != "gjk":
        count = settings.samples or CURVE_SAMPLES
        vertices = actuators * count
    else:
        return
    _check_values("samples", vertices * nodes, f"{count} samples, {actuators} actuators, {nodes} nodes")


def _check_values(name: str, count: int, given: str) -> None:
    if count > MOST_VALUES:
        raise ValueError(f"{name}: must make at most {MOST_VALUES:.0e} numbers at once, got {count:.0e} from {given}")
