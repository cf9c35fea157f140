"""`torcharm search`: for every arm of a study and each of its tasks, the pressure that comes closest."""

import csv
import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

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
from torcharm.files import atomic_write, check_writable, is_stream, plain_cell

if TYPE_CHECKING:
    from torcharm.pressure.search import PressureSearch
    from torcharm.study import NamedArm, NamedTask

Found = Sequence[tuple["NamedArm", "PressureSearch"]]
BLOCKS = {"multistart": 100, "scipy": 1}
"""Loads searched at once: what an interruption may lose."""
PAUSE = 2.0
"""Seconds, at least, between two savings of what was found until then."""


def search(
    study: Annotated[
        Path | None, typer.Argument(help="A study, as TOML. Without one, the paper's validation.", show_default=False)
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Write a row for every arm, task and load, as it is found, to a file .csv."),
    ] = None,
    figure: Annotated[
        Path | None,
        typer.Option(
            "--figure",
            help="Draw the shapes reached under the loads of least, median and largest tip error, to a file ending "
            f"in {', '.join(FIGURE_FORMATS)}.",
        ),
    ] = None,
    method: Annotated[str, typer.Option(help="multistart, or scipy (the paper's, slow).")] = "multistart",
    starts: Annotated[
        int | None, typer.Option(help="Places to start from, for each load.", show_default="8, scipy 1")
    ] = None,
    weights: Annotated[str, typer.Option(help="Of the nodes: ramp, uniform, tip.")] = "ramp",
) -> None:
    """Search the pressure that brings every arm closest to each of its tasks, through its forward mechanics.

    Ctrl-C ends the search and shows what was found until then.
    """
    with mistakes():
        check_outputs(study, out, figure)
        check_ending("--out", out, ("csv",))
        from torcharm.inputs import check_choice
        from torcharm.pressure.pose_cost import NODE_WEIGHTS
        from torcharm.pressure.search import METHODS
        from torcharm.study import load_study, paper_study

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
                found, interrupted = _search(plan.arms_of(task), task, kept, method, starts, weights, refused)
                if found:
                    results.append((task, found))
                    _report(task, found)
                if interrupted:
                    break
        console = open_console()
        for line in LEGEND if results else ():
            say(console, line)
        save_all(console, _outputs(kept, results, numbered(figure, len(plan.tasks))))
        finish(interrupted, results, refused)


def _search(
    arms: "Sequence[NamedArm]",
    task: "NamedTask",
    kept: "_Rows",
    method: str,
    starts: int | None,
    weights: str,
    refused: dict[str, list[str]],
) -> "tuple[Found, bool]":
    """What is found of all arms on one task, and whether Ctrl-C came between; arms are refused by why they are."""
    import torch

    from torcharm.pressure.search import PressureSearch

    blocks: dict[str, list[PressureSearch]] = {arm.name: [] for arm in arms}
    interrupted = False
    with progress(task.name, len(arms) * len(_starts_of_blocks(task, method))) as advance:
        try:
            for arm in arms:
                try:
                    for first, block in _blocks(arm, task, method, starts, weights):
                        blocks[arm.name].append(block)
                        kept.add(_rows(arm, task, first, block))
                        advance()
                except ValueError as error:  # costs this arm alone
                    refused.setdefault(str(error), []).append(arm.name)
        except KeyboardInterrupt:  # what is finished is shown and written all the same
            interrupted = True
    names = [field.name for field in fields(PressureSearch)]
    found = []
    for arm in arms:
        if own := blocks[arm.name]:
            columns = (torch.cat([getattr(block, name) for block in own]) for name in names)
            found.append((arm, PressureSearch(*columns)))
    return found, interrupted


def _report(task: "NamedTask", found: "Found") -> None:
    console = open_console()
    loads = count(math.prod(task.task.batch_shape), "load")
    say(console, f"Task {task.name}, {count(task.task.nodes, 'node')}, {loads}")
    console.print()
    print_table(_columns(found))
    console.print()
    for arm, result in found:
        failed = int(result.cost.isinf().sum())
        if failed:
            loads = count(failed, "load")
            say(console, f"{arm.name}: no equilibrium was found under {loads}, left out of all but `converged`.")


def _outputs(
    kept: "_Rows", results: "Sequence[tuple[NamedTask, Found]]", figures: Sequence[Path]
) -> Iterator[tuple[Path, Callable[[Path], object], str]]:
    if kept.path is not None and results:
        yield kept.path, kept.write, f" ({count(len(kept.rows), 'row')})."
    for place, (task, found) in zip(figures, results, strict=False):
        yield place, partial(_draw, task=task, found=found), f" ({task.name})."


def _draw(path: Path, task: "NamedTask", found: "Found") -> None:
    from torcharm.plot import search_figure

    shown = [(arm.name, arm.design, result) for arm, result in found]
    search_figure(shown, task.name, task.task).savefig(path)


class _Rows:
    """The rows of a CSV file, which is written whole again as they are found; an interruption leaves those found.

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

    def add(self, rows: Iterator[dict[str, Any]]) -> None:
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
        with path.open("w", encoding="utf-8", newline="") as file:
            # Tasks in the plane and in space have other loads, and arms other numbers of actuators.
            header = dict.fromkeys(name for row in self.rows for name in row)
            writer = csv.DictWriter(file, header, lineterminator="\n")
            writer.writeheader()
            writer.writerows(self.rows)


LEGEND = (
    "cost [m²]: Σ ω (x² + y² + 0.05 θ²) of the pose errors along the arm, at the best pressure found",
    "tip [mm]: how far the tip is then from the task's",
    "converged: equilibria to which the descent came to its end; snapped: not along the branch from zero load",
)


def _starts_of_blocks(task: "NamedTask", method: str) -> range:
    """The first load of each block, from 0."""
    return range(0, math.prod(task.task.batch_shape), BLOCKS[method])


def _blocks(
    arm: "NamedArm", task: "NamedTask", method: str, starts: int | None, weights: str
) -> "Iterator[tuple[int, PressureSearch]]":
    """The searches of one arm on one task, some loads at a time, with the number of the first load."""
    from torcharm.pressure.pose_cost import PoseCost
    from torcharm.pressure.search import search_pressure
    from torcharm.task import Task

    whole = task.task
    loads = whole.tip_load.expand(*whole.batch_shape, -1).reshape(-1, whole.twists.shape[-1])
    shapes = whole.twists.expand(*whole.batch_shape, *whole.twists.shape[-2:]).reshape(-1, *whole.twists.shape[-2:])
    for first in _starts_of_blocks(task, method):
        here = slice(first, first + BLOCKS[method])
        part = Task(
            shapes[here],
            loads[here],
            whole.base_pose,
            load=whole.load.with_tip(None),
            wrench_at=whole.wrench_at,
            segment_nodes=whole.segment_nodes,
        )
        found = search_pressure(arm.design, part, method, starts=starts, pose_cost=PoseCost(weights), progress=False)
        yield first + 1, found


def _rows(arm: "NamedArm", task: "NamedTask", first: int, found: "PressureSearch") -> Iterator[dict[str, Any]]:
    """A row for each load."""
    from torcharm.study.results import LOADS, pressure_columns

    whole = task.task
    loads = whole.tip_load.expand(*whole.batch_shape, -1).reshape(-1, whole.twists.shape[-1])[first - 1 :]
    columns = dict(zip(LOADS[loads.shape[-1]], loads[: len(found.cost)].mT, strict=True))
    columns |= {"cost_m2": found.cost, "tip_error_m": found.tip_error}
    columns |= {"tip_rotation_error_rad": found.tip_rotation_error, "shape_error_m": found.shape_error}
    columns |= {"converged": found.converged, "continued": found.continued, "in_range": found.in_range}
    columns |= {"optimality": found.optimality, "spread_m2": found.spread}
    columns |= pressure_columns(arm, found.pressure)
    names = {"arm": plain_cell(arm.name), "task": plain_cell(task.name)}
    for load, values in enumerate(zip(*(column.tolist() for column in columns.values()), strict=True), start=first):
        cells = (str(value).lower() if isinstance(value, bool) else value for value in values)
        yield names | {"load": load} | dict(zip(columns, cells, strict=True))


def _columns(found: "Found") -> list[Column]:
    titles = ("cost\nmedian", "cost\nlargest", "tip [mm]\nmedian", "converged", "snapped", "out of\nrange")
    rows = []
    for _, result in found:
        cost, known = result.cost, result.cost.isfinite()
        best, near = cost[known], result.tip_error[known]
        measured = (best.quantile(0.5), best.max(), 1e3 * near.quantile(0.5)) if len(best) else ()
        cells = (
            *([f"{value:.4g}" for value in measured] or ["-"] * 3),
            f"{int(result.converged.sum())} of {len(cost)}",
            str(int((known & ~result.continued).sum())),
            str(int((known & ~result.in_range).sum())),
        )
        rows.append(cells)
    names = Column("arm", [arm.name for arm, _ in found], LONGEST_WORD)
    return [names, *map(Column, titles, zip(*rows, strict=True))]
