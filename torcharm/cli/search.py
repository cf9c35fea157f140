"""`torcharm search`: for every arm of a study and each of its tasks, the pressure that comes closest."""

import math
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from torcharm.cli import options, outputs
from torcharm.cli.summaries import error_columns, heading, number_column, summary_columns
from torcharm.cli.tables import LONGEST_WORD, Column, print_table
from torcharm.cli.terminal import open_console, say
from torcharm.cli.work import Told, Work, read_study
from torcharm.files import atomic_write, is_stream

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from torcharm.pressure.search import PressureSearch
    from torcharm.study import NamedArm, NamedTask, Settings, Study, StudyResult

BLOCKS = {"multistart": 100, "scipy": 1}
"""Loads searched at once: what an interruption may lose."""
PAUSE = 2.0
"""Seconds, at least, between two savings of what was found until then."""
MOST = 5
"""Loads of a task that are told one by one; of more, those of least, median and largest error over its tolerance."""


def search(
    study: Annotated[
        Path | None, typer.Argument(help="A study, as TOML. Without one, the paper's validation.", show_default=False)
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", help="Write a row for every arm, task and load, as it is found, to a file .csv or .json."
        ),
    ] = None,
    figure: Annotated[
        Path | None,
        options.figure("Draw the shapes reached under the loads of least, median and largest error over its tolerance"),
    ] = None,
    method: Annotated[str, typer.Option(help="multistart, or scipy (the paper's, slow).")] = "multistart",
    starts: Annotated[
        int | None, typer.Option(help="Places to start from, for each load.", show_default="8, scipy 1")
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
    from torcharm.study import RESULT_FORMATS, paper_study

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
    with _Rows(out) as kept:
        for task in plan.tasks:
            found.append((task, _search(plan, task, how, kept, work)))
            if found[-1][1]:
                _report(*found[-1])
            if work.interrupted:
                break
    results = [result for _, own in found for result in own]
    for line in _legend(plan.settings, results):
        open_console().print(line)
    outputs.save([*(outputs.rows(out, kept.rows) if results else ()), *outputs.figures(figures, found, _drawn)])
    work.finish(results)


def _search(plan: "Study", task: "NamedTask", how: dict[str, Any], kept: "_Rows", work: Work) -> list["StudyResult"]:
    """What is found of all arms on one task, some loads at a time; `how` has arguments of `search_pressure`."""
    from torcharm.pressure.search import search_pressure
    from torcharm.study.results import result_rows

    firsts = range(0, math.prod(task.task.batch_shape), BLOCKS[how["method"]])

    def searched(arm: "NamedArm", task: "NamedTask", told: Told) -> "Iterator[StudyResult]":
        for done, first in enumerate(firsts, 1):
            part = task.task.part(slice(first, first + firsts.step))
            found = _judged(arm, task, first, search_pressure(arm.design, part, **how), plan.settings)
            kept.add(result_rows(found, first + 1))
            yield found
            told(done)

    found = work.each(task.name, [(arm, task) for arm in plan.arms_of(task)], searched, len(firsts))
    parts = ([one for one in found if one.arm is arm] for arm in plan.arms_of(task))
    return [_whole(task, own) for own in parts if own]


def _whole(task: "NamedTask", parts: Sequence["StudyResult"]) -> "StudyResult":
    """What was found of one arm under all loads, or under the first if the search was interrupted."""
    import torch

    from torcharm.pressure.search import PressureSearch

    searches = [part.attainability.prediction for part in parts]
    columns = (torch.cat([getattr(one, field.name) for one in searches]) for field in fields(PressureSearch))
    return _judged(parts[0].arm, task, 0, PressureSearch(*columns), parts[0].settings)


def _judged(
    arm: "NamedArm", task: "NamedTask", first: int, found: "PressureSearch", settings: "Settings"
) -> "StudyResult":
    """A search under the loads from the first on, in the words of `torcharm evaluate`."""
    from torcharm.study import evaluate_arm

    part = task.task.part(slice(first, first + found.tip_error.numel()))
    return evaluate_arm(arm, replace(task, task=part), settings, found)


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


class _Rows:
    """The rows of a file, which is written whole again as they are found; an interruption leaves those found.

    A failure to write on the way is passed over: the rows are kept, and written once more at the end.
    """

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self.rows: list[dict[str, Any]] = []
        self._grows = path is not None and not is_stream(path)  # a terminal gets all at the end
        self._next = -math.inf

    def __enter__(self) -> "_Rows":
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is not None and self.rows:
            self._save()

    def add(self, rows: Iterable[dict[str, Any]]) -> None:
        if self.path is not None:
            self.rows += rows
            started = time.monotonic()
            if self._grows and started >= self._next:
                self._save()
                ended = time.monotonic()
                # Writing all rows again and again must not take the time of the search.
                self._next = ended + max(PAUSE, 20 * (ended - started))

    def _save(self) -> None:
        for path, write, _ in outputs.rows(self.path, self.rows) if self._grows else ():
            with suppress(OSError), atomic_write(path) as partial:
                write(partial)
