"""`torcharm report`: a study's designs compared in one file, to be mailed."""

import itertools
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from torcharm.cli import outputs
from torcharm.cli.evaluate import evaluate_all
from torcharm.cli.terminal import count, progress
from torcharm.cli.tolerance import find_built
from torcharm.cli.work import Work, read_study
from torcharm.cli.workspace import find_workspaces

if TYPE_CHECKING:
    from torcharm.report import Evaluated

STATES = 5000
"""Of each arm: its picture is known from fewer than its numbers to a millimetre."""


def report(
    study: Annotated[Path, typer.Argument(help="A study, as TOML.")],
    out: Annotated[Path, typer.Option("--out", help="Where to write the report, a file ending in .html.")],
    reach: Annotated[
        bool, typer.Option("--workspace", help="Say where the arms can reach, too; some seconds for each.")
    ] = False,
) -> None:
    """Compare the arms of a study in one file: numbers, arms, errors, load maps, attainable sets, what to try next.

    Where the study has a table [tolerance], also what becomes of its arms once they are built. The file needs no
    network and nothing beside it: mail it, print it, copy its numbers as CSV.
    """
    outputs.check(study, out, endings=("html", "htm"))
    from torcharm.report import Evaluated, with_margins

    plan, work, more = with_margins(read_study(study)), Work(), dict[str, Any]()
    results = evaluate_all(plan, work)
    if results and plan.manufacture.scatter is not None and not work.interrupted:
        more["built"] = find_built(plan, plan.manufacture, work)
    if results and reach and not work.interrupted:
        more["workspaces"] = find_workspaces(plan.arms, None, STATES, {}, work)
    if results:
        html = _drawn(Evaluated(plan, results, work.refused, study.name, **more))
        told = f" ({count(len(plan.arms), 'arm')}, {len(html.encode()) / 1e6:.1f} MB)."
        outputs.save([(out, lambda path: path.write_text(html, encoding="utf-8"), told)])
    work.finish(results)


def _drawn(evaluated: "Evaluated") -> str:
    """The report, a step of the bar for each of its sections."""
    from torcharm.report import SECTIONS, study_report

    drawn = itertools.count(1)
    with progress("drawing", len(SECTIONS)) as move:
        return study_report(evaluated, lambda: move(next(drawn)))
