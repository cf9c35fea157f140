"""What tolerances and workspaces add to a report: a table, curves and shares of built arms, and where arms reach."""

from collections.abc import Iterator, Sequence

from torcharm.plot import tolerance_figure, workspace_figure
from torcharm.report.content import Column, Evaluated, Panel
from torcharm.report.svg import inline_svg
from torcharm.study.built import BuiltStudy, built_columns

BESIDE = 3
"""Workspaces, at most."""


def built_table(found: Sequence[BuiltStudy]) -> list[Column]:
    """A row for each design on one task."""
    columns = [Column(title, unit, cells, bool(unit)) for title, unit, cells in built_columns(found)]
    return [Column("design", "", [one.arm.name for one in found], numeric=False), *columns]


def built_panel(found: Sequence[BuiltStudy], evaluated: Evaluated) -> Panel:
    """All designs on one task: how far off which part of them is, and what decides that."""
    place = evaluated.study.tasks.index(found[0].task)
    figure = tolerance_figure([(one.arm.name, one.built) for one in found])
    return Panel("", "", inline_svg(figure, f"built-{place}", f"tip errors of built arms: {found[0].task.name}"))


def workspace_panels(evaluated: Evaluated) -> Iterator[Panel]:
    """Where designs can reach, side by side: those in the plane, and those in space."""
    for dimension in (2, 3):
        own = [(arm.name, found) for arm, found in evaluated.workspaces if found.dimension == dimension]
        if own:
            figure = workspace_figure(own, columns=min(len(own), BESIDE))
            words = f"workspaces of {', '.join(name for name, _ in own)}"
            yield Panel("", "", inline_svg(figure, f"workspace-{dimension}", words))
