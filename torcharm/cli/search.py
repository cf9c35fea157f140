"""`torcharm search`: for every arm of a study and each of its tasks, the pressure that comes closest."""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from torcharm.cli.summaries import error_columns, heading, summary_columns
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
from torcharm.files import atomic_write, check_writable, is_stream

if TYPE_CHECKING:
    from torcharm.pressure.search import PressureSearch
    from torcharm.study import NamedArm, NamedTask, Settings, StudyResult

Found = Sequence["StudyResult"]
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
        typer.Option(
            "--figure",
            help="Draw the shapes reached under the loads of least, median and largest error over its tolerance, "
            f"to a file ending in {', '.join(FIGURE_FORMATS)}.",
        ),
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
    with mistakes():
        check_outputs(study, out, figure)
        from torcharm.inputs import check_choice
        from torcharm.pressure.pose_cost import NODE_WEIGHTS
        from torcharm.pressure.search import METHODS
        from torcharm.study import RESULT_FORMATS, load_study, paper_study

        check_ending("--out", out, RESULT_FORMATS)
        check_choice("--method", method, METHODS)
        check_choice("--weights", weights, NODE_WEIGHTS)
        if starts is not None and starts < 1:
            raise ValueError(f"--starts: must be at least 1, got {starts}")
        plan = paper_study() if study is None else asked_about(load_study(study))
        for path in numbered(figure, len(plan.tasks)):
            check_writable(path, "--figure")
        kept = _Rows(out)
        results: list[tuple[NamedTask, Found]] = []
        refused: dict[str, list[str]] = {}
        interrupted = False
        with kept:
            for task in plan.tasks:
                how = partial(_blocks, settings=plan.settings, method=method, starts=starts, weights=weights)
                found, interrupted = _search(
                    plan.arms_of(task), task, kept, how, _starts_of_blocks(task, method), refused
                )
                if found:
                    results.append((task, found))
                    _report(task, found)
                if interrupted:
                    break
        console = open_console()
        for line in _legend(plan.settings, results):
            console.print(line)
        save_all(console, _outputs(kept, results, numbered(figure, len(plan.tasks))))
        finish(interrupted, results, refused)


def _search(
    arms: "Sequence[NamedArm]",
    task: "NamedTask",
    kept: "_Rows",
    blocks: "Callable[[NamedArm, NamedTask], Iterator[tuple[int, StudyResult]]]",
    starts: Sequence[int],
    refused: dict[str, list[str]],
) -> "tuple[Found, bool]":
    """What is found of all arms on one task, and whether Ctrl-C came between; arms are refused by why they are."""
    from torcharm.study.results import result_rows

    parts: dict[str, list[StudyResult]] = {arm.name: [] for arm in arms}
    interrupted = False
    with progress(task.name, len(arms) * len(starts)) as advance:
        try:
            for arm in arms:
                try:
                    for first, part in blocks(arm, task):
                        parts[arm.name].append(part)
                        kept.add(result_rows(part, first))
                        advance()
                except ValueError as error:  # costs this arm alone
                    refused.setdefault(str(error), []).append(arm.name)
        except KeyboardInterrupt:  # what is finished is shown and written all the same
            interrupted = True
    return [_whole(task, own) for own in parts.values() if own], interrupted


def _whole(task: "NamedTask", parts: "Sequence[StudyResult]") -> "StudyResult":
    """What was found of one arm under all loads, or under the first if the search was interrupted."""
    import torch

    from torcharm.pressure.search import PressureSearch

    searches = [part.attainability.prediction for part in parts]
    columns = (torch.cat([getattr(one, field.name) for one in searches]) for field in fields(PressureSearch))
    found = PressureSearch(*columns)
    return _judged(parts[0].arm, task, 0, found, parts[0].settings)


def _judged(
    arm: "NamedArm", task: "NamedTask", first: int, found: "PressureSearch", settings: "Settings"
) -> "StudyResult":
    """A search under the loads from the first on, in the words of `torcharm evaluate`."""
    from torcharm.attainability import evaluate
    from torcharm.study import StudyResult

    part = replace(task, task=task.task.part(slice(first, first + found.tip_error.numel())))
    return StudyResult(arm, part, settings, evaluate(arm.design, part.task, found=found, **vars(settings)))


def _report(task: "NamedTask", found: "Found") -> None:
    from torcharm.study import summarise
    from torcharm.study.results import result_rows

    console, loads = open_console(), math.prod(task.task.batch_shape)
    console.print(heading(task, loads))
    console.print()
    if loads > MOST:
        print_table(list(summary_columns([(result, summarise(result)) for result in found])))
        console.print()
        say(console, "Loads of least, median and largest error over its tolerance:")
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
    shared: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        if row["reason"]:
            shared.setdefault((row["arm"], row["reason"]), []).append(str(row["load"]))
    for (arm, reason), own in shared.items():
        which = f", load{'s' * (len(own) > 1)} {', '.join(own)}" if loads > 1 else ""
        yield f"{arm}{which}: {reason}{'' if reason.endswith('?') else '.'}"


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
    from torcharm.inputs import three_digits

    columns = [
        Column("arm", [str(row["arm"]) for row in told], LONGEST_WORD),
        Column("load", [str(row["load"]) for row in told]),
        *error_columns(told),
    ]
    pressures = sorted({name for row in told for name in row if name.startswith("pressure_")}, key=_actuator)
    for name in pressures:
        values = [row.get(name) for row in told]
        if any(value is not None for value in values):
            cells = ["-" if value is None else three_digits(value) for value in values]
            columns.append(Column(f"actuator {_actuator(name)}\n[kPa]", cells))
    return columns


def _actuator(column: str) -> int:
    """The number of the actuator whose pressures are in a column."""
    return int(column.split("_")[1])


def _legend(settings: "Settings", results: "Sequence[tuple[NamedTask, Found]]") -> Iterator[str]:
    """What the tables mean, in a line each."""
    from torcharm.study.words import verdict_legend

    found = [result for _, one in results for result in one]
    if not found:
        return
    yield from verdict_legend(settings, found)
    yield "tip off, turned: from the task's tip, at the best pressure found; shape: the mean along the arm."
    yield "actuator: its pressure; numbers count all actuators of the arm, passive ones too, from 1."


def _outputs(
    kept: "_Rows", results: "Sequence[tuple[NamedTask, Found]]", figures: Sequence[Path]
) -> Iterator[tuple[Path, Callable[[Path], object], str]]:
    if kept.path is not None and results:
        yield kept.path, kept.write, f" ({count(len(kept.rows), 'row')})."
    for place, (task, found) in zip(figures, results, strict=False):
        yield place, partial(_draw, task=task, found=found), f" ({task.name})."


def _draw(path: Path, task: "NamedTask", found: "Found") -> None:
    from torcharm.plot import search_figure
    from torcharm.pressure.search import PressureSearch

    searches = [(result, result.attainability.prediction) for result in found]
    shown = [(one.arm.name, one.arm.design, search) for one, search in searches if isinstance(search, PressureSearch)]
    search_figure(shown, task.name, task.task, tolerance=found[0].settings.tolerance).savefig(path)


class _Rows:
    """The rows of a file, which is written whole again as they are found; an interruption leaves those found.

    A failure to write on the way is passed over: the rows are kept, and written once more at the end.
    """

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self.rows: list[dict[str, Any]] = []
        self._grows = path is not None and not is_stream(path)  # a terminal gets all at the end
        self._next = -math.inf

    def __enter__(self) -> None:
        pass

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
        if self.path is not None and self._grows:
            with suppress(OSError), atomic_write(self.path) as partial:
                self.write(partial)

    def write(self, path: Path) -> None:
        from torcharm.study.results import check_format, write_rows

        assert self.path is not None
        write_rows(path, self.rows, f".{check_format(self.path)}")


def _starts_of_blocks(task: "NamedTask", method: str) -> range:
    """The first load of each block, from 0."""
    return range(0, math.prod(task.task.batch_shape), BLOCKS[method])


def _blocks(
    arm: "NamedArm", task: "NamedTask", settings: "Settings", method: str, starts: int | None, weights: str
) -> "Iterator[tuple[int, StudyResult]]":
    """The searches of one arm on one task, some loads at a time, with the number of the first load."""
    from torcharm.pressure.pose_cost import PoseCost
    from torcharm.pressure.search import search_pressure

    for first in _starts_of_blocks(task, method):
        part = task.task.part(slice(first, first + BLOCKS[method]))
        found = search_pressure(arm.design, part, method, starts=starts, pose_cost=PoseCost(weights), progress=False)
        yield first + 1, _judged(arm, task, first, found, settings)
