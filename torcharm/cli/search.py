"""`torcharm search`: for every arm of a study and each of its tasks, the pressure that comes closest."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from torcharm.cli import options, outputs
from torcharm.cli.summaries import error_columns, heading, number_column, summary_columns
from torcharm.cli.tables import LONGEST_WORD, Column, print_table
from torcharm.cli.terminal import open_console, say
from torcharm.cli.work import Told, Work, read_study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from torcharm.pressure.search import PressureSearch
    from torcharm.study import NamedArm, NamedTask, Settings, Study, StudyResult

BLOCKS = {"multistart": 100, "scipy": 1}
"""Loads searched at once: what an interruption may lose."""
MOST = 5
"""Loads of a task that are told one by one; of more, those of least, median and largest error over its tolerance."""


def search(
    study: Annotated[
        Path | None, typer.Argument(help="A study, as TOML. Without one, the paper's validation.", show_default=False)
    ] = None,
    out: options.Rows = None,
    figure: Annotated[
        Path | None,
        options.figure("Draw the shapes reached under the loads of least, median and largest error over its tolerance"),
    ] = None,
    method: Annotated[str, typer.Option(help="multistart, or scipy (the paper's, slow).")] = "multistart",
    starts: Annotated[
        int | None, typer.Option(help="Places to start from, for each load.", show_default="12, scipy 1")
    ] = None,
    weights: Annotated[str, typer.Option(help="Of the nodes: ramp, uniform, tip.")] = "ramp",
) -> None:
    """Search the pressure that brings every arm closest to each of its tasks, through its forward mechanics.

    Files have the columns of torcharm evaluate: verdict, reason, errors, and the pressure of every actuator.
    Ctrl-C ends the search and shows what was found until then.
    """
    from torcharm.inputs import check_choice
    from torcharm.pressure.pose_cost import NODE_WEIGHTS, PoseCost
    from torcharm.pressure.search import METHODS
    from torcharm.study import RESULT_FORMATS, paper_study, result_rows

    outputs.check(study, out, figure, RESULT_FORMATS)
    check_choice("--method", method, METHODS)
    check_choice("--weights", weights, NODE_WEIGHTS)
    if starts is not None and starts < 1:
        raise ValueError(f"--starts: must be at least 1, got {starts}")
    plan = paper_study() if study is None else read_study(study)
    figures = outputs.numbered("--figure", figure, len(plan.tasks))
    how = {"method": method, "starts": starts, "pose_cost": PoseCost(weights), "progress": False}
    work = Work()
    found: list[tuple[NamedTask, list[StudyResult]]] = []
    for task in plan.tasks:
        found.append((task, _search(plan, task, how, work)))
        if found[-1][1]:
            _report(*found[-1])
        if work.interrupted:
            break
    results = [result for _, own in found for result in own]
    for line in _legend(plan.settings, results):
        open_console().print(line)
    rows = [row for result in results for row in result_rows(result)]
    outputs.save([*(outputs.rows(out, rows) if results else ()), *outputs.figures(figures, found, _drawn)])
    work.finish(results)


def _search(plan: "Study", task: "NamedTask", how: dict[str, Any], work: Work) -> list["StudyResult"]:
    """What is found of all arms on one task, some loads at a time; `how` has arguments of `search_pressure`."""
    from torcharm.pressure.search import search_pressure

    firsts = range(0, math.prod(task.task.batch_shape), BLOCKS[how["method"]])

    def searched(arm: "NamedArm", task: "NamedTask", told: Told) -> "Iterator[StudyResult]":
        parts, ended = [], None
        try:
            for done, first in enumerate(firsts, 1):
                parts.append(search_pressure(arm.design, task.task.part(slice(first, first + firsts.step)), **how))
                told(done)
        except (KeyboardInterrupt, ValueError) as error:
            ended = error
        if parts:
            yield _judged(arm, task, parts, plan.settings)
        if ended is not None:
            raise ended

    return work.each(task.name, [(arm, task) for arm in plan.arms_of(task)], searched, len(firsts))


def _judged(
    arm: "NamedArm", task: "NamedTask", parts: Sequence["PressureSearch"], settings: "Settings"
) -> "StudyResult":
    """Searches of one arm, under all loads or the first if Ctrl-C came, in the words of `torcharm evaluate`."""
    import torch

    from torcharm.pressure.search import PressureSearch
    from torcharm.study import evaluate_arm

    columns = (torch.cat([getattr(part, field.name) for part in parts]) for field in fields(PressureSearch))
    found = PressureSearch(*columns)
    searched = task.task.part(slice(0, found.tip_error.numel()))
    return evaluate_arm(arm, replace(task, task=searched), settings, found)


def _report(task: "NamedTask", found: Sequence["StudyResult"]) -> None:
    from torcharm.study import summarise
    from torcharm.study.results import result_rows

    console, loads = open_console(), math.prod(task.task.batch_shape)
    console.print(heading(task, loads))
    console.print()
    if loads > MOST:
        print_table(list(summary_columns([(result, summarise(result)) for result in found])))
        console.print()
        say("Loads of least, median and largest error over its tolerance:")
        console.print()
    every = [list(result_rows(result)) for result in found]
    rows = [own[load] for result, own in zip(found, every, strict=True) for load in _told(result)]
    print_table(_columns(rows), lead=2)
    console.print()
    for line in _reasons(rows, loads):
        console.print(line)
    console.print()


def _reasons(rows: Sequence[dict[str, Any]], loads: int) -> Iterator[str]:
    """Why loads are not held, once for all of an arm that share a reason."""
    from torcharm.study.words import sentence

    shared: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        if row["reason"]:
            shared.setdefault((row["arm"], row["reason"]), []).append(str(row["load"]))
    for (arm, reason), own in shared.items():
        which = f", load{'s' * (len(own) > 1)} {', '.join(own)}" if loads > 1 else ""
        yield f"{arm}{which}: {sentence(reason)}"


def _told(result: "StudyResult") -> list[int]:
    """The loads, from 0, that are told one by one: as in the picture, and the first without an equilibrium."""
    if result.loads <= MOST:
        return list(range(result.loads))
    error = result.attainability.over_tolerance
    assert error is not None
    known = error.isfinite().flatten()
    order = error.flatten().argsort(stable=True)[: int(known.sum())].tolist()
    ranks = [order[0], order[(len(order) - 1) // 2], order[-1]] if order else []
    return list(dict.fromkeys([*ranks, *(~known).nonzero().flatten().tolist()[:1]]))


def _columns(told: Sequence[dict[str, Any]]) -> list[Column]:
    """A row for each arm and load that is told: the verdict, the errors and the pressure of each actuator."""
    pressures = {int(name.split("_")[1]): name for row in told for name in row if name.startswith("pressure_")}
    return [
        Column("arm", [str(row["arm"]) for row in told], LONGEST_WORD),
        Column("load", [str(row["load"]) for row in told]),
        *error_columns(told),
        *(
            column
            for actuator, name in sorted(pressures.items())
            for column in number_column(told, name, f"actuator {actuator}\n[kPa]")
        ),
    ]


def _legend(settings: "Settings", found: Sequence["StudyResult"]) -> Iterator[str]:
    """What the tables mean, in a line each."""
    from torcharm.study.words import verdict_legend

    if not found:
        return
    yield from verdict_legend(settings, found)
    yield "tip off, turned: from the task's tip, at the best pressure found; shape: the mean along the arm."
    yield "actuator: its pressure; numbers count all actuators of the arm, passive ones too, from 1."


def _drawn(task: "NamedTask", found: Sequence["StudyResult"]) -> "Figure":
    from torcharm.plot import search_figure

    shown: Any = [(one.arm.name, one.arm.design, one.attainability.prediction) for one in found]
    return search_figure(shown, task.name, task.task, tolerance=found[0].settings.tolerance)
