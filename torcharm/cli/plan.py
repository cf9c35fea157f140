"""`torcharm plan`: shapes through the tip poses of a study."""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from torcharm.cli import options, outputs
from torcharm.cli.summaries import error_columns
from torcharm.cli.tables import LONGEST_WORD, Column, print_table
from torcharm.cli.terminal import count, open_console, say
from torcharm.cli.work import Told, Work, read_study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from torcharm.design.shape_planning import PlannedShape
    from torcharm.study import NamedArm, NamedTask, Study, StudyResult
    from torcharm.study.data import NamedPlan
    from torcharm.task import Task


@dataclass(frozen=True)
class Found:
    """What is found of one task, a plan, by one arm; without a shape there is no result, as of torcharm evaluate."""

    task: "NamedPlan"
    arm: "NamedArm"
    shape: "PlannedShape"
    result: "StudyResult | None"


def plan(
    study: Annotated[Path, typer.Argument(help="A study, as TOML, with tables that begin with [[plan]].")],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="Write the shapes, to a file .toml of [[task]] tables for a study, or a row for every plan, arm and "
            "node to a file .csv or .json.",
        ),
    ] = None,
    figure: Annotated[Path | None, options.figure("Draw the shapes")] = None,
    sums: options.Sums = False,
) -> None:
    """Find shapes through the tip poses of a study, for each arm that they name or fit.

    Verdicts are those of torcharm evaluate on the shape found. Each element's wrench is taken at its middle. Where no
    shape is found for any plan, the command exits with 1. Ctrl-C ends the work and shows what was found until then.
    """
    from torcharm.study import RESULT_FORMATS

    outputs.check(study, out, figure, (*RESULT_FORMATS, "toml"))
    read = read_study(study)
    if not read.plans:
        raise ValueError(
            f"{study}: plan: must hold at least one table that begins with [[plan]], got none; "
            "that of torcharm init stands there with a # before each line"
        )
    figures, work = outputs.numbered("--figure", figure, len(read.plans)), Work()
    found = _find(read, work)
    _tell(read, found, sums)
    for line in _next_steps(study, out, found):
        say(line)
    outputs.save([*_written(read, found, out), *outputs.figures(figures, outputs.by_task(read.plans, found), _drawn)])
    work.finish(found)
    if not any(one.result for one in found):
        sys.exit(NONE_FOUND)


NONE_FOUND = 1
"""How the command exits where no plan has a shape: the study is right, the arms are not."""


def _find(read: "Study", work: Work) -> list[Found]:
    """What is found of each plan by each arm."""
    from torcharm.design.shape_planning import plan_shape
    from torcharm.study import NamedTask, evaluate_arm

    def planned(arm: "NamedArm", wanted: "NamedPlan", _: Told) -> Iterator[Found]:
        how: dict[str, Any] = {name: getattr(wanted, name) for name in ("nodes", "base_pose", "in_range")}
        try:
            shape = plan_shape(arm.design, wanted.tip_pose, wanted.load, wanted.smoothness, **how)
        except ValueError as error:
            raise ValueError(f"{wanted.name}: {error}") from None
        result = None
        if shape.attainability is not None:  # evaluated as the study's tasks are
            task = NamedTask(wanted.name, shape.attainability.task, (arm.name,))
            result = evaluate_arm(arm, task, read.settings)
        yield Found(wanted, arm, shape, result)

    return work.each("planning", [(arm, wanted) for wanted in read.plans for arm in read.arms_of(wanted)], planned)


TWISTS = {
    3: ("twist_length_mm", "twist_shear_mm", "twist_curvature_deg"),
    6: (
        *("twist_length_mm", "twist_shear_y_mm", "twist_shear_z_mm"),
        *("twist_torsion_deg", "twist_curvature_y_deg", "twist_curvature_z_deg"),
    ),
}
"""Columns of a shape, by its number of components: each element's as if its segment were like it, as in a study."""


def _tell(read: "Study", found: Sequence[Found], sums: bool) -> None:
    from torcharm.study.words import verdict_legend

    for wanted, shown in outputs.by_task(read.plans, found):
        if shown:
            _report(wanted, shown, sums)
    results = [one.result for one in found if one.result is not None]
    if not results:
        return
    lines = [*verdict_legend(read.settings, results)] if results[0].verdicts is not None else []
    for line in [*lines, *LEGEND]:
        open_console().print(line)


def _report(wanted: "NamedPlan", found: Sequence[Found], sums: bool) -> None:
    """The tables of one plan, and in words what the arms do not hold."""
    from rich.text import Text

    from torcharm.study import result_rows
    from torcharm.study.words import sentence

    console = open_console()
    console.print(Text("Plan ").append(wanted.name, style="bold").append(f", {count(wanted.nodes, 'node')} a segment"))
    console.print()
    rows = [
        {"verdict": "no shape", "reason": one.shape.status} if one.result is None else next(result_rows(one.result))
        for one in found
    ]
    arms = Column("arm", [one.arm.name for one in found], LONGEST_WORD)
    print_table([arms, *error_columns(rows, sums), *_shape_columns(found)])
    console.print()
    for one, row in zip(found, rows, strict=True):
        if row["reason"]:
            say(f"{one.arm.name}: {sentence(row['reason'])}")
    if any(row["reason"] for row in rows):
        console.print()


LEGEND = (
    "tip off, turned: how far from the planned tip the arm is predicted to be; shape: the mean along the arm.",
    "length, bend: of the whole shape; cost: what was minimised.",
)


def _next_steps(study: Path, out: Path | None, found: Sequence[Found]) -> Iterator[str]:
    """What a person may do with the shapes."""
    if not any(one.result for one in found):
        return
    yield ""
    if out is not None and out.suffix.lower() == ".toml":
        yield f"Next: paste {out} into {study}: torcharm evaluate, search and optimise take the shapes as tasks."
    else:
        yield f"Next: torcharm plan {study} --out shapes.toml writes the shapes as tasks to paste into the study."


def _written(read: "Study", found: Sequence[Found], out: Path | None) -> Iterator[outputs.Output]:
    """The file of --out, if there is something to write."""
    from torcharm.study import task_to_toml

    if out is not None and out.suffix.lower() == ".toml":
        tasks = list(_tasks(read, found))
        if tasks:
            words = f" ({count(len(tasks), 'task')})."
            yield out, lambda path: path.write_text("\n".join(map(task_to_toml, tasks)), encoding="utf-8"), words
    elif found:
        yield from outputs.rows(out, list(_rows(found)))


def _drawn(wanted: "NamedPlan", found: Sequence[Found]) -> "Figure":
    from torcharm.plot import plan_figure

    shapes = [(one.arm.name, one.arm.design, one.shape) for one in found]
    return plan_figure(shapes, wanted.name, wanted.tip_pose, base_pose=wanted.base_pose)


def _tasks(read: "Study", found: Sequence[Found]) -> "Iterator[NamedTask]":
    """The shapes found as tasks of their arms, by names that the study does not have yet."""
    from torcharm.study.data import unused_name

    taken = {task.name for task in read.tasks}
    for one in found:
        if one.result is not None:
            alone = len(read.arms_of(one.task)) == 1
            name = unused_name(one.task.name if alone else f"{one.task.name}, {one.arm.name}", taken)
            taken.add(name)
            yield replace(one.result.task, name=name)


def _shape_columns(found: Sequence[Found]) -> Iterator[Column]:
    """How long and how bent the shapes are, and what they cost."""
    if not any(one.result for one in found):
        return
    cells = [("-",) * 3 if one.result is None else _sizes(one.result.task.task, one.shape.cost) for one in found]
    for title, column in zip(("length\n[mm]", "bend\n[°]", "cost"), zip(*cells, strict=True), strict=True):
        yield Column(title, column)


def _sizes(task: "Task", cost: float) -> tuple[str, ...]:
    """The length [mm] and the bend [°] of a whole shape, and its cost; bends in space are amounts."""
    import torch

    from torcharm.study.results import MM

    counts = torch.tensor(task.nodes_of_segments)
    own = task.twists / counts.repeat_interleave(counts).unsqueeze(-1)  # twists are those of a segment of such elements
    bends = own[:, 2] if own.shape[-1] == 3 else own[:, 4:].norm(dim=-1)
    return tuple(f"{float(one):.4g}" for one in (MM * own[:, 0].sum(), bends.sum().rad2deg(), cost))


def _rows(found: Sequence[Found]) -> Iterator[dict[str, Any]]:
    """A row for each plan, arm and node, of the shapes that were found."""
    from torcharm.study.results import DEG, MM

    for one in found:
        for node, twist in enumerate(one.shape.twists.tolist() if one.shape.found else (), 1):
            columns = TWISTS[len(twist)]
            cells = [(MM if name.endswith("mm") else DEG) * value for name, value in zip(columns, twist, strict=True)]
            yield {"plan": one.task.name, "arm": one.arm.name, "node": node, **dict(zip(columns, cells, strict=True))}
