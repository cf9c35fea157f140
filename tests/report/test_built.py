"""What tolerances and workspaces add to a report."""

import csv
import io
from dataclasses import replace

import pytest
from report_cases import SCRIPT, TEMPLATE, Page

import torcharm as ta
from torcharm.design.tolerance import tolerance
from torcharm.report import Evaluated, study_report
from torcharm.study import evaluate_study, parse_study
from torcharm.study.built import BuiltStudy

STUDY = f"""
name = "built"
[[arm]]
name = '''{SCRIPT}'''
kind = "antagonistic"
[[arm]]
name = '''{TEMPLATE}'''
kind = "bellows"
[[task]]
name = '''$\\frac{{$'''
shape = {{ kind = "affine", slope = 0.0, intercept = 1.0, length = 0.5, nodes = 4 }}
loads = {{ count = 2, scale = [1, 1, 0.1] }}
[evaluate]
metrics = ["predicted_error"]
[tolerance]
radii = "1 mm"
force = "5 %"
samples = 64
"""


@pytest.fixture(scope="module")
def evaluated():
    study = parse_study(STUDY)
    how, task = study.manufacture, study.tasks[0]
    built = [
        BuiltStudy(
            arm,
            task,
            tolerance(arm.design, task.task, **vars(how.scatter), compensated=how.compensated, samples=how.samples),
        )
        for arm in study.arms
    ]
    reach = [(arm, ta.workspace(arm.design, states=200, nodes=4)) for arm in study.arms]
    return Evaluated(study, list(evaluate_study(study)), built=built, workspaces=reach)


def test_built_arms_and_workspaces_have_sections_of_their_own(evaluated):
    page = Page(study_report(evaluated))
    words = " ".join(page.words)
    assert "As built" in words
    assert "Workspace" in words
    assert "64 arms built within the study's tolerances" in words
    labels = [value for tag, name, value in page.attributes if tag == "svg" and name == "aria-label"]
    assert "tip errors of built arms: $\\frac{$" in labels
    assert f"workspaces of {SCRIPT}, {TEMPLATE}" in labels
    assert page.tags["script"] == 1
    for one in evaluated.built:
        assert f"{1e3 * float(one.built.pooled_percentile(95)):.3g}" in words


def test_numbers_of_built_arms_can_be_copied(evaluated):
    page = Page(study_report(evaluated))
    (text,) = [text for text in page.textareas if "slope" in text.splitlines()[0] or "nominal" in text.splitlines()[0]]
    rows = list(csv.DictReader(io.StringIO(text)))
    assert [row["load"] for row in rows] == ["1", "2", "1", "2"]


def test_without_them_there_are_none(evaluated):
    words = " ".join(Page(study_report(replace(evaluated, built=(), workspaces=()))).words)
    assert "As built" not in words
    assert "Workspace" not in words
