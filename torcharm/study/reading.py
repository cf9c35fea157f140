"""From the text of a study file to designs and tasks, and how they fit together."""

from collections.abc import Sequence
from dataclasses import replace
from importlib import resources
from os import PathLike
from pathlib import Path

from torcharm.attainability import check_measure
from torcharm.characterise.toml_text import read_toml
from torcharm.files import read_file
from torcharm.study.arm_tables import NamedTable, make_arm
from torcharm.study.data import NamedArm, NamedTask, Settings, Study
from torcharm.study.fields import field_path, one_line, shown_value, validated, within
from torcharm.study.tables import StudyTable, arms_named
from torcharm.study.task_tables import check_values
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
            its_arms = arms_named(job.arms or (), arms)
            tasks.append(job.build(in_space=all(arm.design.dimension == 3 for arm in its_arms)))
            for arm in its_arms:
                job.check_fit(tasks[-1].task, arm)
    with within("evaluate"):
        settings = table.evaluate.build()
    plain = Study(table.name, table.description, tuple(arms), tuple(tasks), settings)
    for index, arm in enumerate(arms):
        if not plain.tasks_of(arm):
            raise ValueError(
                f"{field_path(['arm', index])}: must have a task, but all are for other arms: "
                f"add {shown_value(arm.name)} to the list {field_path(['task', 0, 'arms'])}, or to another task's"
            )
        with within("evaluate", arm.name):
            check_measure(arm.design, settings.hull, settings.samples, settings.distance, settings.signed)
            for its_task in plain.tasks_of(arm):
                _check_size(arm, its_task, settings)
    with within("tolerance"):
        manufacture = table.tolerance.build()
    with within("optimise"):
        optimisation = table.optimise.build(manufacture)
    plans = []
    for index, wanted in enumerate(table.plan):
        with within(field_path(["plan", index]), wanted.name):
            plans.append(wanted.build(arms))
    return replace(plain, optimisation=optimisation, manufacture=manufacture, plans=tuple(plans))


def _check_size(arm: NamedArm, task: NamedTask, settings: Settings) -> None:
    """Refuse samples of sets that no memory holds."""
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


def _check_unique(section: str, tables: Sequence[NamedTable]) -> None:
    seen: dict[str, int] = {}
    for index, table in enumerate(tables):
        if table.name in seen:
            here, first = field_path([section, index, "name"]), field_path([section, seen[table.name]])
            raise ValueError(f"{here}: must be a name of its own, got {shown_value(table.name)}, the name of {first}")
        seen[table.name] = index
