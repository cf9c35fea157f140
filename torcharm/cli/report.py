"""`torcharm report`: a study's designs compared in one file, to be mailed."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from torcharm.cli.evaluate import evaluate_all
from torcharm.cli.terminal import (
    asked_about,
    check_ending,
    check_outputs,
    count,
    finish,
    mistakes,
    open_console,
    progress,
    save_all,
)
from torcharm.cli.tolerance import find_built
from torcharm.cli.workspace import find_workspaces

if TYPE_CHECKING:
    from torcharm.report import Evaluated
    from torcharm.study import NamedArm, Study
    from torcharm.study.built import BuiltStudy
    from torcharm.workspaces import Workspace

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
    with mistakes():
        check_outputs(study, out, None)
        check_ending("--out", out, ("html", "htm"))
        from torcharm.report import Evaluated, with_margins
        from torcharm.study import load_study

        plan = with_margins(asked_about(load_study(study)))
        results, refused, interrupted = evaluate_all(plan)
        if results:
            more: dict[str, Any] = {}
            if not interrupted:
                more, interrupted = _more(plan, reach, refused)
            html = _drawn(Evaluated(plan, results, refused, study.name, **more))
            told = f" ({count(len(plan.arms), 'arm')}, {len(html.encode()) / 1e6:.1f} MB)."
            save_all(open_console(), [(out, lambda path: path.write_text(html, encoding="utf-8"), told)])
        finish(interrupted, results, refused)


def _more(plan: "Study", reach: bool, refused: dict[str, list[str]]) -> tuple[dict[str, Any], bool]:
    """Arms as they are built, where the study says how, and where they can reach, if that is asked for; and whether
    Ctrl-C came."""
    built: list[BuiltStudy] = []
    workspaces: list[tuple[NamedArm, Workspace]] = []
    stopped = plan.manufacture.scatter is not None and find_built(plan, plan.manufacture, built, refused)
    if reach and not stopped:
        stopped = find_workspaces(plan.arms, None, STATES, {}, workspaces, refused)
    return {"built": built, "workspaces": workspaces}, stopped


def _drawn(evaluated: "Evaluated") -> str:
    """The report, a step of the bar for each of its sections."""
    from torcharm.report import SECTIONS, study_report

    with progress("drawing", len(SECTIONS)) as advance:
        return study_report(evaluated, advance)
