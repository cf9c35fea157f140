"""`torcharm search`: for every arm and task of a study, the pressure that comes closest."""

import csv
import math
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from torcharm.cli.terminal import check_outputs, count, mistakes, open_console, save_all, say
from torcharm.files import atomic_write, is_stream, plain_cell

if TYPE_CHECKING:
    from rich.table import Table

    from torcharm.pressure.search import PressureSearch
    from torcharm.study import NamedArm, NamedTask

BLOCKS = {"multistart": 100, "scipy": 1}
"""Loads searched at once: what an interruption may lose."""
PAUSE = 2.0
"""Seconds, at least, between two savings of what was found until then."""


def search(
    study: Annotated[
        Path | None, typer.Argument(help="A study, as TOML. Without one, the paper's validation.", show_default=False)
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Write a CSV file: a row for every arm, task and load, as it is found.")
    ] = None,
    method: Annotated[str, typer.Option(help="multistart, or scipy (the paper's, slow).")] = "multistart",
    starts: Annotated[
        int | None, typer.Option(help="Places to start from, for each load.", show_default="8, scipy 1")
    ] = None,
    weights: Annotated[str, typer.Option(help="Of the nodes: ramp, uniform, tip.")] = "ramp",
) -> None:
    """Search the pressure that brings every arm closest to every task, through its forward mechanics."""
    with mistakes():
        check_outputs(study, out, None)
        from torcharm.inputs import check_choice
        from torcharm.pressure.pose_cost import NODE_WEIGHTS
        from torcharm.pressure.search import METHODS
        from torcharm.study import load_study, paper_study

        check_choice("--method", method, METHODS)
        check_choice("--weights", weights, NODE_WEIGHTS)
        if starts is not None and starts < 1:
            raise ValueError(f"--starts: must be at least 1, got {starts}")
        plan = paper_study() if study is None else load_study(study)
        console = open_console()
        kept = _Rows(out, _header(max(arm.design.actuator_count for arm in plan.arms)))
        with kept:
            for task in plan.tasks:
                rows = []
                for arm in plan.arms:
                    found = []
                    for first, block in _blocks(arm, task, method, starts, weights):
                        found.append(block)
                        kept.add(_rows(arm, task, first, block))
                    rows.append((arm.name, found))
                loads = count(sum(len(block.cost) for block in rows[0][1]), "load")
                say(console, f"Task {task.name}, {count(task.task.nodes, 'node')}, {loads}")
                console.print()
                console.print(_table(rows))
                console.print()
                for name, found in rows:
                    failed = sum(int(block.cost.isinf().sum()) for block in found)
                    if failed:
                        loads = count(failed, "load")
                        say(
                            console, f"{name}: no equilibrium was found under {loads}, left out of all but `converged`."
                        )
        for line in LEGEND:
            say(console, line)
        if out is not None:
            save_all(console, [(out, kept.write, f" ({count(len(kept.rows), 'row')}).")])


class _Rows:
    """The rows of a CSV file, which is written whole again as they are found; an interruption leaves those found.

    A failure to write on the way is passed over: the rows are kept, and written once more at the end.
    """

    def __init__(self, path: Path | None, header: list[str]) -> None:
        self.path, self.header = path, header
        self.rows: list[list[Any]] = []
        self._grows = path is not None and not is_stream(path)  # a terminal gets all at the end
        self._next = -math.inf

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is not None and self.rows:
            self._save()

    def add(self, rows: Iterator[list[Any]]) -> None:
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
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(self.header)
            writer.writerows(self.rows)


LEGEND = (
    "cost [m²]: Σ ω (x² + y² + 0.05 θ²) of the pose errors along the arm, at the best pressure found",
    "tip [mm]: how far the tip is then from the task's",
    "converged: equilibria to which the descent came to its end; snapped: not along the branch from zero load",
)


def _blocks(
    arm: "NamedArm", task: "NamedTask", method: str, starts: int | None, weights: str
) -> "Iterator[tuple[int, PressureSearch]]":
    """The searches of one arm on one task, some loads at a time, with the number of the first load."""
    from rich.console import Console
    from rich.progress import track

    from torcharm.pressure.pose_cost import PoseCost
    from torcharm.pressure.search import search_pressure
    from torcharm.task import Task

    whole = task.task
    loads = whole.tip_load.expand(*whole.batch_shape, 3).reshape(-1, 3)
    shapes = whole.twists.expand(*whole.batch_shape, *whole.twists.shape[-2:]).reshape(-1, *whole.twists.shape[-2:])
    size = BLOCKS[method]
    places = range(0, len(loads), size)
    errors = Console(stderr=True)
    for first in track(places, f"{arm.name}, {task.name}", console=errors, transient=True, disable=not _seen()):
        here = slice(first, first + size)
        part = Task(
            shapes[here],
            loads[here],
            whole.base_pose,
            load=whole.load.with_tip(None),
            wrench_at=whole.wrench_at,
            segment_nodes=whole.segment_nodes,
        )
        yield (
            first + 1,
            search_pressure(arm.design, part, method, starts=starts, pose_cost=PoseCost(weights), progress=False),
        )


def _seen() -> bool:
    return sys.stderr.isatty()


def _header(actuators: int) -> list[str]:
    pressures = [f"pressure_{index}_kPa" for index in range(1, actuators + 1)]
    return [
        *("arm", "task", "load", "force_x_N", "force_y_N", "moment_Nm", "cost_m2"),
        *("tip_error_m", "tip_rotation_error_rad", "shape_error_m", *pressures),
        *("converged", "continued", "in_range", "optimality", "spread_m2"),
    ]


def _rows(arm: "NamedArm", task: "NamedTask", first: int, found: "PressureSearch") -> Iterator[list[Any]]:
    whole = task.task
    loads = whole.tip_load.expand(*whole.batch_shape, 3).reshape(-1, 3).tolist()
    errors = (found.cost, found.tip_error, found.tip_rotation_error, found.shape_error)
    flags = (found.converged, found.continued, found.in_range)
    columns = (*errors, found.pressure, *flags, found.optimality, found.spread)
    values = zip(*(column.tolist() for column in columns), strict=True)
    for index, (*sizes, pressure, sure, along, within, optimality, spread) in enumerate(values, start=first):
        truths = [str(flag).lower() for flag in (sure, along, within)]
        yield [
            plain_cell(arm.name),
            plain_cell(task.name),
            index,
            *loads[index - 1],
            *sizes,
            *pressure,
            *truths,
            optimality,
            spread,
        ]


def _table(rows: "Sequence[tuple[str, list[PressureSearch]]]") -> "Table":
    import torch
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False)
    table.add_column("arm", overflow="fold")
    for heading in ("cost\nmedian", "cost\nlargest", "tip [mm]\nmedian", "converged", "snapped", "out of\nrange"):
        table.add_column(heading, justify="right")
    for name, blocks in rows:
        cost, tip, converged, continued, within = (
            torch.cat([getattr(block, field) for block in blocks])
            for field in ("cost", "tip_error", "converged", "continued", "in_range")
        )
        found = cost.isfinite()
        best, near = cost[found], tip[found]
        measured = (best.quantile(0.5), best.max(), 1e3 * near.quantile(0.5)) if len(best) else ()
        cells = (
            *([f"{value:.4g}" for value in measured] or ["-"] * 3),
            f"{int(converged.sum())} of {len(cost)}",
            str(int((found & ~continued).sum())),
            str(int((found & ~within).sum())),
        )
        table.add_row(Text(name), *cells)
    return table
