"""From the text of a study file to designs and tasks, and how they fit together."""

from collections.abc import Sequence
from dataclasses import replace
from importlib import resources
from os import PathLike
from pathlib import Path

from torcharm.attainability import CHOICES, PoseTolerance, check_measure
from torcharm.attainability.questions import LONGEST, WIDEST, question_about_lengths
from torcharm.characterise.toml_text import read_toml
from torcharm.design.objective import Objective
from torcharm.design.robust import Robust
from torcharm.design.scatter import FIELDS, Scatter
from torcharm.design.shape_planning import Smoothness
from torcharm.design.space import DesignSpace
from torcharm.files import read_file
from torcharm.inputs import hint
from torcharm.load import ExternalLoad
from torcharm.statics.balance import segments_of
from torcharm.study.arm_reading import make_arm
from torcharm.study.arm_tables import NamedTable
from torcharm.study.data import Manufacture, NamedArm, NamedPlan, NamedTask, Optimisation, Settings, Study
from torcharm.study.fields import ask, field_path, one_line, shown_value, validated, within
from torcharm.study.tables import EvaluateTable, OptimiseTable, PlanTable, StudyTable, ToleranceTable
from torcharm.study.task_reading import (
    check_columns,
    check_fit,
    check_values,
    columns_of,
    make_task,
    read_base,
    read_points,
    read_pose,
    shape_field,
)
from torcharm.wrench_sets.vertex_sets import CURVE_SAMPLES, EDGE_SAMPLES


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
        raw = read_toml(text, source)
    except ValueError as error:
        raise ValueError(one_line(str(error))) from None
    try:
        return replace(_study(validated(StudyTable, raw), Path(folder)), tables=raw)
    except ValueError as error:
        raise ValueError(one_line(f"{source}: {error}")) from None


def paper_study() -> Study:
    """The paper's validation: two arms, one shape, 100 loads, absolute and relative unattainability."""
    return parse_study(_shipped("validation.toml"), "torcharm/studies/validation.toml")


def example_study() -> Study:
    """The study that `example_text` shows: arms of both kinds, and tasks that some of them hold."""
    return parse_study(example_text(), "torcharm/studies/example.toml")


def example_text(space: bool = False) -> str:
    """The text of a commented study to start from, in the plane or in space; `torcharm init` writes it."""
    return _shipped("space.toml" if space else "example.toml")


def _shipped(name: str) -> str:
    return resources.files("torcharm").joinpath("studies", name).read_text(encoding="utf-8")


def _study(table: StudyTable, folder: Path) -> Study:
    _check_unique("arm", table.arm)
    _check_unique("task", table.task)
    arms, tasks = [], []
    for index, entry in enumerate(table.arm):
        with within(field_path(["arm", index]), entry.name):
            arms.append(make_arm(entry, folder))
    for index, job in enumerate(table.task):
        with within(field_path(["task", index]), job.name):
            its_arms = [arm.design for arm in arms if not job.arms or arm.name in job.arms]
            tasks.append(make_task(job, 3 if its_arms and all(arm.dimension == 3 for arm in its_arms) else 2))
            for arm in _named(tasks[-1].arms, arms):
                check_fit(shape_field(job), tasks[-1].task, arm)
    with within("evaluate", ""):
        settings = _settings(table.evaluate)
    plain = Study(table.name, table.description, tuple(arms), tuple(tasks), settings)
    for index, arm in enumerate(arms):
        if not plain.tasks_of(arm):
            raise ValueError(
                f"{field_path(['arm', index])}: must have a task, but all are for other arms: "
                f"add {shown_value(arm.name)} to the list {field_path(['task', 0, 'arms'])}, or to another task's"
            )
        for task in plain.tasks_of(arm):
            with within("evaluate", arm.name):
                _check_size(arm, task, settings)
    with within("tolerance", ""):
        manufacture = _manufacture(table.tolerance)
    with within("optimise", ""):
        optimisation = _optimisation(table.optimise, manufacture)
    plans = []
    for index, wanted in enumerate(table.plan):
        with within(field_path(["plan", index]), wanted.name):
            plans.append(_plan(wanted, arms))
    return replace(plain, optimisation=optimisation, manufacture=manufacture, plans=tuple(plans))


def _named(given: Sequence[str], arms: Sequence[NamedArm]) -> list[NamedArm]:
    """The arms of these names, or all if none is given."""
    names = [arm.name for arm in arms]
    for index, name in enumerate(given):
        if name not in names:
            here = field_path(["arms", index])
            raise ValueError(f"{here}: must be one of {', '.join(names)}, got {shown_value(name)}{hint(name, names)}")
    return [arm for arm in arms if arm.name in (given or names)]


def _check_unique(section: str, tables: Sequence[NamedTable]) -> None:
    seen: dict[str, int] = {}
    for index, table in enumerate(tables):
        if table.name in seen:
            here, first = field_path([section, index, "name"]), field_path([section, seen[table.name]])
            raise ValueError(f"{here}: must be a name of its own, got {shown_value(table.name)}, the name of {first}")
        seen[table.name] = index


def _settings(table: EvaluateTable) -> Settings:
    force, moment = table.weights
    options = table.model_dump(exclude={"metrics", "weights", "tolerance", "rotation_tolerance"})
    return Settings(
        metrics=tuple(name for name in CHOICES if name in table.metrics),
        tolerance=PoseTolerance(table.tolerance, table.rotation_tolerance),
        weights=(force, moment),
        **options,
    )


def _optimisation(table: OptimiseTable, manufacture: Manufacture) -> Optimisation:
    spacing = [] if table.spacing is None else [table.spacing]
    for field, values, most in (
        ("bounds.radii", table.bounds.radii, WIDEST),
        ("bounds.length", table.bounds.length, LONGEST),
        ("spacing", spacing, WIDEST),
    ):
        ask(field, question_about_lengths(values, most) if values else None)
    bounds = {name: (ends[0], ends[1]) for name, ends in table.bounds.model_dump(exclude_none=True).items()}
    space = DesignSpace(tuple(table.free), table.tied, bounds, table.spacing, table.in_range)
    robust = None
    if table.robust is not None:
        if manufacture.scatter is None:
            raise ValueError("robust: must stand beside a table [tolerance] that says what is scattered, got none")
        robust = Robust(manufacture.scatter, table.robust, compensated=manufacture.compensated)
    objective = Objective(table.metric, table.over, relative_weight=table.relative_weight, robust=robust)
    return Optimisation(space, objective, table.starts, table.seed, table.iterations)


def _manufacture(table: ToleranceTable) -> Manufacture:
    sizes = {name: getattr(table, name) for name in FIELDS}
    alike = {name: value for name, value in table.correlated.model_dump().items() if value > 0}
    scatter = None
    if table.model_covariance or any(sizes.values()):
        scatter = Scatter(
            **sizes, model_covariance=table.model_covariance, distribution=table.distribution, correlated=alike
        )
    return Manufacture(scatter, table.compensated, table.samples, table.seed)


def _plan(table: PlanTable, arms: Sequence[NamedArm]) -> NamedPlan:
    weight, reference = table.length_weight, table.reference_length
    if (weight is None) != (reference is None):
        missing = "length_weight" if weight is None else "reference_length"
        raise ValueError(f"{missing}: must be given too, as the other is; without both, unattainability is minimised")
    smoothness = None if weight is None or reference is None else Smoothness(weight, reference)
    columns = columns_of(table.tip_pose)
    load = [0.0] * columns if table.tip_load is None else table.tip_load
    check_columns("tip_load", len(load), columns, POSE_IS)
    base = read_base(table.base_pose, columns, POSE_IS)
    tip = read_pose("tip_pose", table.tip_pose, base)
    chosen = _planned(table, arms, columns)
    points = read_points(table, columns, min(len(segments_of(arm.design)[0]) for arm in chosen))
    whole, names = ExternalLoad(load, table.gravity, points), tuple(arm.name for arm in chosen)
    return NamedPlan(table.name, tip, whole, smoothness, table.nodes, base, table.in_range, names)


POSE_IS = {3: "in the plane, as tip_pose is", 6: "in space, as tip_pose is"}
"""By the number of components of a load, why it must have them."""


def _planned(table: PlanTable, arms: Sequence[NamedArm], columns: int) -> list[NamedArm]:
    """The arms to plan for: those named, which must fit, or all that fit."""
    dimension, chosen = columns // 3 + 1, _named(table.arms or (), arms)
    fit = [arm for arm in chosen if arm.design.dimension == dimension]
    kind = POSE_IS[columns]
    if table.arms and len(fit) < len(chosen):
        other = next(arm.name for arm in chosen if arm not in fit)
        raise ValueError(f"arms: must be {kind}, got {shown_value(other)}, which is not")
    if not fit:
        raise ValueError(f"tip_pose: must fit an arm {kind.removesuffix(', as tip_pose is')}, of which there is none")
    return fit


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
    check_values("samples", vertices * nodes, f"{count} samples, {actuators} actuators, {nodes} nodes")
