"""`torcharm plan`: shapes through the tip poses of a study."""

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from torcharm.cli.terminal import check_outputs, count, mistakes, open_console, save_all, say
from torcharm.files import plain_cell

if TYPE_CHECKING:
    from rich.table import Table

    from torcharm.design.shape_planning import PlannedShape

Found = tuple[str, str, "PlannedShape"]


def plan(
    study: Annotated[Path, typer.Argument(help="A study, as TOML, with tables that begin with [[plan]].")],
    out: Annotated[
        Path | None, typer.Option("--out", help="Write a CSV file: a row for every plan, arm and node.")
    ] = None,
) -> None:
    """Find shapes through the tip poses of a study, for each of its arms.

    Each element's wrench is taken at its middle.
    """
    with mistakes():
        check_outputs(study, out, None)
        from torcharm.design.shape_planning import plan_shape
        from torcharm.study import load_study
        from torcharm.study.fields import within

        read = load_study(study)
        if not read.plans:
            raise ValueError(f"{study}: plan: must hold at least one table that begins with [[plan]], got none")
        console = open_console()
        found: list[Found] = []
        for wanted in read.plans:
            for arm in read.arms:
                with within(f"{study}: plan", f"{wanted.name}, {arm.name}"):
                    shape = plan_shape(
                        arm.design,
                        wanted.tip_pose,
                        wanted.tip_load,
                        wanted.smoothness,
                        nodes=wanted.nodes,
                        base_pose=wanted.base_pose,
                        in_range=wanted.in_range,
                    )
                found.append((wanted.name, arm.name, shape))
        console.print(_table(found))
        missing = [one for one in found if not one[-1].found]
        if missing:
            console.print()
        for plan_name, arm_name, shape in missing:
            say(console, f"{plan_name}, {arm_name}: {shape.status}.")
        if out is not None:
            rows = sum(len(shape.twists) for *_, shape in found if shape.found)
            save_all(console, [(out, lambda path: _write(path, found), f" ({count(rows, 'row')}).")])


def _table(found: Sequence[Found]) -> "Table":
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False)
    for name in ("plan", "arm"):
        table.add_column(name, overflow="fold")
    for name in ("cost", "absolute", "relative", "tip error", "lengths", "curvatures"):
        table.add_column(name, justify="right", overflow="fold")
    table.add_column("strain\nin range")
    for name, arm, shape in found:
        result = shape.attainability
        if result is None:
            table.add_row(Text(name), Text(arm), "no shape", *["-"] * 6)
            continue
        metrics = ["-" if value is None else f"{float(value):.4g}" for value in (result.absolute, result.relative)]
        spans = [f"{float(column.min()):.3f}\n{float(column.max()):.3f}" for column in shape.twists.unbind(-1)]
        inside = "yes" if bool(result.in_range) else "no"
        table.add_row(
            Text(name), Text(arm), f"{shape.cost:.4g}", *metrics, f"{shape.tip_error:.1e}", spans[0], spans[2], inside
        )
    return table


def _write(path: Path, found: Sequence[Found]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("plan", "arm", "node", "length_m", "shear_m", "curvature_rad"))
        for name, arm, shape in (one for one in found if one[-1].found):
            for node, twist in enumerate(shape.twists.tolist(), 1):
                writer.writerow((plain_cell(name), plain_cell(arm), node, *twist))
