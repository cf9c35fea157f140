"""`torcharm report`: a study's designs compared in one file, to be mailed."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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

if TYPE_CHECKING:
    from torcharm.report import Evaluated


def report(
    study: Annotated[Path, typer.Argument(help="A study, as TOML.")],
    out: Annotated[Path, typer.Option("--out", help="Where to write the report, a file ending in .html.")],
) -> None:
    """Compare the arms of a study in one file: numbers, arms, errors, load maps, attainable sets, what to try next.

    The file needs no network and nothing beside it: mail it, print it, copy its numbers as CSV.
    """
    with mistakes():
        check_outputs(study, out, None)
        check_ending("--out", out, ("html", "htm"))
        from torcharm.report import Evaluated, with_margins
        from torcharm.study import load_study

        plan = with_margins(asked_about(load_study(study)))
        results, refused, interrupted = evaluate_all(plan)
        if results:
            html = _drawn(Evaluated(plan, results, refused, study.name))
            told = f" ({count(len(plan.arms), 'arm')}, {len(html.encode()) / 1e6:.1f} MB)."
            save_all(open_console(), [(out, lambda path: path.write_text(html, encoding="utf-8"), told)])
        finish(interrupted, results, refused)


def _drawn(evaluated: "Evaluated") -> str:
    """The report, a step of the bar for each of its sections."""
    from torcharm.report import SECTIONS, study_report

    with progress("drawing", len(SECTIONS)) as advance:
        return study_report(evaluated, advance)
