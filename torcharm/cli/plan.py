"""`torcharm plan`: shapes through the tip poses of a study."""

import itertools
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from torcharm.cli.summaries import error_columns
from torcharm.cli.tables import LONGEST_WORD, Column, print_table
from torcharm.cli.terminal import (
    FIGURE_FORMATS,
    asked_about,
    check_ending,
    check_outputs,
    count,
    finish,
    mistakes,
    numbered,
    open_console,
    progress,
    save_all,
    say,
)
from torcharm.files import check_writable

if TYPE_CHECKING:
    from rich.console import Console

    from torcharm.design.shape_planning import PlannedShape
    from torcharm.study import NamedArm, NamedTask, Study, StudyResult
    from torcharm.study.data import NamedPlan
    from torcharm.task import Task


@dataclass(frozen=True)
class Found:
    """What is found of one plan by one arm; without a shape there is no result, which is as of torcharm evaluate."""

    wanted: "NamedPlan"
    arm: "NamedArm"
    shape: "PlannedShape"
    result: "StudyResult | None"

    @property
    def refused(self) -> bool:
        """Whether it cannot be planned at all."""
        return self.shape.status.startswith(REFUSED)


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
    figure: Annotated[
        Path | None,
        typer.Option("--figure", help=f"Draw the shapes, to a file ending in {', '.join(FIGURE_FORMATS)}."),
    ] = None,
    sums: Annotated[bool, typer.Option("--sums", help="Show the paper's sums over the nodes, too.")] = False,
) -> None:
    """Find shapes through the tip poses of a study, for each arm that they name or fit.

    Verdicts are those of torcharm evaluate on the shape found. Each element's wrench is taken at its middle. Where no
    shape is found for any plan, the command exits with 1. Ctrl-C ends the work and shows what was found until then.
    """
    with mistakes():
        check_outputs(study, out, figure)
        from torcharm.study import RESULT_FORMATS, load_study

        check_ending("--out", out, (*RESULT_FORMATS, "toml"))

        read = asked_about(load_study(study))
        if not read.plans:
            raise ValueError(f"{study}: plan: must hold at least one table that begins with [[plan]], got none")
        for path in numbered(figure, len(read.plans)):
            check_writable(path, "--figure")
        found: list[Found] = []
        interrupted = False
        try:
            _find(read, found)
        except KeyboardInterrupt:  # what is finished is shown and written all the same
            interrupted = True
        _tell(read, found, sums)
        for line in _next_steps(study, out, found):
            say(open_console(), line)
        save_all(open_console(), _outputs(read, found, out, figure))
        finish(interrupted, found, {})
        refused = [f"{one.wanted.name}, {one.arm.name}: {one.shape.status}" for one in found if one.refused]
        if refused:
            raise ValueError(f"{study}: {'; '.join(refused)}")
        if not any(one.result for one in found):
            sys.exit(NONE_FOUND)


REFUSED = "refused: "
"""How the status begins of a plan that is none, as `plan_shape` says by an error."""
NONE_FOUND = 1
"""How the command exits where no plan has a shape: the study is right, the arms are not."""


def _find(read: "Study", found: list[Found]) -> None:
    """Append to `found` what is found of each plan by each arm."""
    import torch

    from torcharm.design.shape_planning import PlannedShape, plan_shape

    with progress("planning", sum(len(read.arms_of(wanted)) for wanted in read.plans)) as advance:
        for wanted in read.plans:
            for arm in read.arms_of(wanted):
                pose, load, how = wanted.tip_pose, wanted.load, wanted.smoothness
                options = {"nodes": wanted.nodes, "base_pose": wanted.base_pose, "in_range": wanted.in_range}
                try:
                    shape = plan_shape(arm.design, pose, load, how, **options)  # type: ignore[arg-type]
                except ValueError as error:  # costs this plan alone
                    none = torch.full((wanted.nodes, 3 * arm.design.dimension - 3), math.nan)
                    shape = PlannedShape(f"{REFUSED}{error}", none, math.nan, math.nan, None)
                found.append(Found(wanted, arm, shape, _judged(read, wanted, arm, shape)))
                advance()


def _judged(read: "Study", wanted: "NamedPlan", arm: "NamedArm", shape: "PlannedShape") -> "StudyResult | None":
    """The shape as a task, evaluated as the study's tasks are."""
    from torcharm.attainability import evaluate
    from torcharm.study import NamedTask, StudyResult

    if shape.attainability is None:
        return None
    task = shape.attainability.task
    judged = evaluate(arm.design, task, **vars(read.settings))
    return StudyResult(arm, NamedTask(wanted.name, task, (arm.name,)), read.settings, judged)


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

    console = open_console()
    for wanted in read.plans:
        shown = [one for one in found if one.wanted is wanted]
        if shown:
            _report(console, wanted, shown, sums)
    results = [one.result for one in found if one.result is not None]
    if not results:
        return
    lines = [*verdict_legend(read.settings, results)] if results[0].verdicts is not None else []
    for line in [*lines, *LEGEND]:
        console.print(line)


def _report(console: "Console", wanted: "NamedPlan", found: Sequence[Found], sums: bool) -> None:
    """The tables of one plan, and in words what the arms do not hold."""
    from rich.text import Text

    from torcharm.study import result_rows

    console.print(Text("Plan ").append(wanted.name, style="bold").append(f", {count(wanted.nodes, 'node')} a segment"))
    console.print()
    rows = [_no_row(one) if one.result is None else next(iter(result_rows(one.result))) for one in found]
    arms = Column("arm", [one.arm.name for one in found], LONGEST_WORD)
    print_table([arms, *error_columns(rows, sums)])
    if any(one.result for one in found):
        console.print()
        print_table([arms, *_shape_columns(found)])
    console.print()
    for one, row in zip(found, rows, strict=True):
        if row["reason"]:
            say(console, f"{one.arm.name}: {row['reason']}{'' if row['reason'].endswith('?') else '.'}")
    if any(row["reason"] for row in rows):
        console.print()


def _no_row(one: Found) -> dict[str, Any]:
    """What stands in a table for a plan without a shape."""
    return {"verdict": "refused" if one.refused else "no shape", "reason": one.shape.status}


LEGEND = (
    "tip off, turned: how far from the planned tip the arm is predicted to be; shape: the mean along the arm.",
    "of each: the least and the largest of the elements; whole: their sum; cost: what was minimised.",
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


def _outputs(
    read: "Study", found: Sequence[Found], out: Path | None, figure: Path | None
) -> Iterator[tuple[Path, Callable[[Path], object], str]]:
    if out is not None and out.suffix.lower() == ".toml":
        tasks = list(_tasks(read, found))
        if tasks:
            yield out, partial(_write_tasks, tasks=tasks), f" ({count(len(tasks), 'task')})."
    elif out is not None and found:
        rows = sum(len(one.shape.twists) for one in found if one.shape.found)
        from torcharm.study import check_format, write_rows

        ending = f".{check_format(out)}"
        yield out, lambda path: write_rows(path, list(_rows(found)), ending), f" ({count(rows, 'row')})."
    for place, wanted in zip(numbered(figure, len(read.plans)), read.plans, strict=False):
        shown = [one for one in found if one.wanted is wanted and not one.refused]
        if shown:
            yield place, partial(_draw, found=shown), f" ({wanted.name})."


def _draw(path: Path, found: Sequence[Found]) -> None:
    from torcharm.plot import plan_figure

    wanted = found[0].wanted
    shapes = [(one.arm.name, one.arm.design, one.shape) for one in found]
    drawn = plan_figure(shapes, wanted.name, wanted.tip_pose, base_pose=wanted.base_pose)
    drawn.savefig(path)


def _tasks(read: "Study", found: Sequence[Found]) -> "Iterator[NamedTask]":
    """The shapes found as tasks of their arms, by names that the study does not have yet."""
    taken = {task.name for task in read.tasks}
    for one in found:
        if one.result is None:
            continue
        alone = len(read.arms_of(one.wanted)) == 1
        first = name = one.wanted.name if alone else f"{one.wanted.name}, {one.arm.name}"
        numbers = itertools.count(2)
        while name in taken:
            name = f"{first} {next(numbers)}"
        taken.add(name)
        yield replace(one.result.task, name=name)


def _write_tasks(path: Path, tasks: "Sequence[NamedTask]") -> None:
    from torcharm.study import task_to_toml

    path.write_text("\n".join(task_to_toml(task) for task in tasks), encoding="utf-8")


def _shape_columns(found: Sequence[Found]) -> Iterator[Column]:
    """How long and how bent the shapes are, and what they cost."""
    cells = [["-"] * 5 if one.result is None else _shape_cells(one.result.task.task, one.shape) for one in found]
    titles = ("length [mm]\nwhole", "length [mm]\nof each", "bend [°]\nwhole", "bend [°]\nof each", "cost")
    for title, own in zip(titles, zip(*cells, strict=True), strict=True):
        yield Column(title, own)


def _shape_cells(task: "Task", shape: "PlannedShape") -> list[str]:
    spans = [cell for values in _elements(task) for cell in (f"{sum(values):.4g}", _span(values))]
    return [*spans, f"{shape.cost:.4g}"]


def _elements(task: "Task") -> tuple[list[float], list[float]]:
    """The length [mm] and the bend [°] of each element itself; bends in space are amounts."""
    import torch

    from torcharm.study.results import MM

    counts = torch.tensor(task.segment_nodes or (task.nodes,))
    own = task.twists / counts.repeat_interleave(counts).unsqueeze(-1)  # twists are those of a segment of such elements
    bends = own[:, 2] if own.shape[-1] == 3 else own[:, 4:].norm(dim=-1)
    return (MM * own[:, 0]).tolist(), bends.rad2deg().tolist()


def _span(values: Sequence[float]) -> str:
    """The least and the largest."""
    low, high = f"{min(values):.3g}", f"{max(values):.3g}"
    return low if low == high else f"{low} to {high}"


def _rows(found: Sequence[Found]) -> Iterator[dict[str, Any]]:
    """A row for each plan, arm and node, of the shapes that were found."""
    from torcharm.study.results import DEG, MM

    for one in found:
        for node, twist in enumerate(one.shape.twists.tolist() if one.shape.found else (), 1):
            columns = TWISTS[len(twist)]
            cells = [(MM if name.endswith("mm") else DEG) * value for name, value in zip(columns, twist, strict=True)]
            yield {"plan": one.wanted.name, "arm": one.arm.name, "node": node, **dict(zip(columns, cells, strict=True))}
