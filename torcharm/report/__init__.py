"""One self-contained HTML file that compares the designs of a study, to be mailed: `torcharm report`.

    results = list(evaluate_study(study))
    html = study_report(Evaluated(study, results))

It needs no network and lets nothing in it reach one. `SECTIONS` lists what it holds: functions from what was evaluated
to a section, or to None where there is nothing to show.
"""

from torcharm.report.content import Block, Column, Count, Evaluated, Panel, Section
from torcharm.report.page import study_report
from torcharm.report.sections import SECTIONS, with_margins

__all__ = ["SECTIONS", "Block", "Column", "Count", "Evaluated", "Panel", "Section", "study_report", "with_margins"]
