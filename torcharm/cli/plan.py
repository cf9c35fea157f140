"""`torcharm plan`: shapes through the tip poses of a study."""

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from torcharm.cli.tables import Column, print_table
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
    from torcharm.attainability import Attainability
    from torcharm.design.shape_planning import PlannedShape
    from torcharm.study import NamedArm, Study
    from torcharm.study.data import NamedPlan

Found = tuple["NamedPlan", "NamedArm", "PlannedShape"]


def plan(
    study: Annotated[Path, typer.Argument(help="A study, as TOML, with tables that begin with [[plan]].")],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="Write a row for every plan, arm and node, to a file .csv or .json: the twists of a task of a study.",
        ),
    ] = None,
    figure: Annotated[
        Path | None,
        typer.Option("--figure", help=f"Draw the shapes, to a file ending in {', '.join(FIGURE_FORMATS)}."),
    ] = None,
) -> None:
    """Find shapes through the tip poses of a study, for each arm that they name or fit.

    Each element's wrench is taken at its middle. Ctrl-C ends the work and shows what was found until then.
    """
    with mistakes():
        check_outputs(study, out, figure)
        from torcharm.study import RESULT_FORMATS, load_study

        check_ending("--out", out, RESULT_FORMATS)

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
        _tell(found)
        save_all(open_console(), _outputs(read, found, out, figure))
        finish(interrupted, found, {})
        refused = [f"{_whose(one)}: {one[-1].status}" for one in found if one[-1].status.startswith(REFUSED)]
        if refused:
            raise ValueError(f"{study}: {'; '.join(refused)}")


REFUSED = "refused: "
"""How the status begins of a plan that is none, as `plan_shape` says by an error."""


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
                found.append((wanted, arm, shape))
                advance()


TWISTS = {
    3: ("twist_length_mm", "twist_shear_mm", "twist_curvature_deg"),
    6: (
        *("twist_length_mm", "twist_shear_y_mm", "twist_shear_z_mm"),
        *("twist_torsion_deg", "twist_curvature_y_deg", "twist_curvature_z_deg"),
    ),
}
"""Columns of a shape, by its number of components: each element's as if its segment were like it, as in a study."""
LENGTHS = ("length [mm]\nin all", "length [mm]\nof each element")
BENDS = ("bend [°]\nin all", "bend [°]\nof each element")
"""Titles of what stands in the table of a shape, its sum first."""


def _whose(one: Found) -> str:
    return f"{one[0].name}, {one[1].name}"


def _tell(found: Sequence[Found]) -> None:
    console = open_console()
    if not found:
        return
    print_table(_columns(found))
    console.print()
    for one in found:
        if not one[-1].found:
            say(console, f"{_whose(one)}: {one[-1].status}.")
    for line in LEGEND:
        console.print(line)


LEGEND = (
    "cost: what was minimised; tip off: how far from the planned tip the arm is predicted to be",
    "absolute, relative: what nodes lack in sum",
    "of each element: its own length and bend, the least and the largest; in all: the sum over the elements",
)


def _outputs(
    read: "Study", found: Sequence[Found], out: Path | None, figure: Path | None
) -> Iterator[tuple[Path, Callable[[Path], object], str]]:
    if out is not None and found:
        rows = sum(len(shape.twists) for *_, shape in found if shape.found)
        from torcharm.study import check_format, write_rows

        ending = f".{check_format(out)}"
        yield out, lambda path: write_rows(path, list(_rows(found)), ending), f" ({count(rows, 'row')})."
    for place, wanted in zip(numbered(figure, len(read.plans)), read.plans, strict=False):
        shown = [one for one in found if one[0] is wanted and not one[-1].status.startswith(REFUSED)]
        if shown:
            yield place, partial(_draw, found=shown), f" ({wanted.name})."


def _draw(path: Path, found: Sequence[Found]) -> None:
    from torcharm.plot import plan_figure

    wanted = found[0][0]
    shapes = [(arm.name, arm.design, shape) for _, arm, shape in found]
    drawn = plan_figure(shapes, wanted.name, wanted.tip_pose, base_pose=wanted.base_pose)
    drawn.savefig(path)


def _columns(found: Sequence[Found]) -> list[Column]:
    from torcharm.inputs import three_digits
    from torcharm.study.results import MM

    titles = ("cost", "tip off\n[mm]", "absolute\nrelative", *LENGTHS, *BENDS)
    rows = []
    for *_, shape in found:
        result = shape.attainability
        if result is None:
            rows.append((*["-"] * 7, "no shape" if shape.status.startswith("no") else "refused"))
            continue
        sums = ["-" if value is None else f"{float(value):.4g}" for value in (result.absolute, result.relative)]
        off = "-" if result.tip_error is None else three_digits(MM * float(result.tip_error))
        spans = [cell for values in _elements(result) for cell in (f"{sum(values):.4g}", _span(values))]
        rows.append((f"{shape.cost:.4g}", off, "\n".join(sums), *spans, str(result.verdict)))
    *numbers, verdicts = zip(*rows, strict=True)
    names = Column("plan,\narm", [f"{wanted.name},\n{arm.name}" for wanted, arm, _ in found], 30)
    return [names, *map(Column, titles, numbers), Column("verdict", verdicts, 12)]


def _elements(result: "Attainability") -> tuple[list[float], list[float]]:
    """The length [mm] and the bend [°] of each element itself; bends in space are amounts."""
    import torch

    from torcharm.study.results import MM

    task = result.task
    counts = torch.tensor(task.segment_nodes or (task.nodes,))
    own = task.twists / counts.repeat_interleave(counts).unsqueeze(-1)  # twists are those of a segment of such elements
    bends = own[:, 2] if own.shape[-1] == 3 else own[:, 4:].norm(dim=-1)
    return (MM * own[:, 0]).tolist(), bends.rad2deg().tolist()


def _span(values: Sequence[float]) -> str:
    """The least and the largest, in two lines."""
    return f"{min(values):.4g} to\n{max(values):.4g}"


def _rows(found: Sequence[Found]) -> Iterator[dict[str, Any]]:
    """A row for each plan, arm and node, of the shapes that were found."""
    from torcharm.study.results import DEG, MM

    for wanted, arm, shape in found:
        for node, twist in enumerate(shape.twists.tolist() if shape.found else (), 1):
            columns = TWISTS[len(twist)]
            cells = [(MM if name.endswith("mm") else DEG) * one for name, one in zip(columns, twist, strict=True)]
            yield {"plan": wanted.name, "arm": arm.name, "node": node, **dict(zip(columns, cells, strict=True))}
