"""`torcharm tolerance`, the table [tolerance] of a study, and the picture."""

import csv
import json
import math
import re
import sys

import pytest
import torch
from test_cli import invoke, mistake

import torcharm as ta
from torcharm.plot import tolerance_figure
from torcharm.study import load_study, parse_study

STUDY = """
name = "built"
[[arm]]
name = "antagonist"
kind = "antagonistic"
[[arm]]
name = "soft"
kind = "bellows"
[[task]]
name = "bend"
shape = { kind = "affine", slope = 0.5, intercept = 0.5, length = 0.5, nodes = 4 }
loads = [[1.0, -1.0, 0.1], [0.5, 0.0, 0.0]]
"""
TABLE = """
[tolerance]
radii = "1 mm"
force = "5 %"
samples = 40
distribution = "uniform"
correlated = { force = 0.5 }
"""


@pytest.fixture
def study(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(STUDY + TABLE, encoding="utf-8")
    return path


def test_rows_are_those_of_the_library(study, tmp_path):
    out = tmp_path / "built.csv"
    output = invoke("tolerance", study, "--out", out)
    assert "4 rows" in output
    rows = list(csv.DictReader(out.open(encoding="utf-8")))
    assert [(row["arm"], row["load"]) for row in rows] == [(a, n) for a in ("antagonist", "soft") for n in "12"]
    plan = load_study(study)
    options = {"radii": 1e-3, "force": 0.05, "samples": 40, "distribution": "uniform", "correlated": {"force": 0.5}}
    for arm in plan.arms:
        found = ta.tolerance(arm.design, plan.tasks[0].task, **options)
        own = [row for row in rows if row["arm"] == arm.name]
        for row, error, share in zip(own, found.percentiles([95])[0], found.yields, strict=True):
            assert float(row["tip_error_p95_mm"]) == pytest.approx(1e3 * float(error), rel=1e-9)
            assert float(row["yield"]) == share.value
            assert float(row["share_radii"]) + float(row["share_force"]) == pytest.approx(1.0)
        assert f"{arm.name}: {found.agreement}." in output
    assert "40 built arms; tolerances are half widths; pressures are the drawn arm's, kept." in output


def test_margins_on_request(study, tmp_path):
    out = tmp_path / "built.csv"
    output = invoke("tolerance", study, "--margin", "--samples", 16, "--out", out)
    assert "margin" in output
    row = next(csv.DictReader(out.open(encoding="utf-8")))
    plan = load_study(study)
    options = {"radii": 1e-3, "force": 0.05, "samples": 16, "distribution": "uniform", "correlated": {"force": 0.5}}
    found = ta.tolerance(plan.arms[0].design, plan.tasks[0].task, **options, margin=True)
    assert float(row["capacity_margin_p5_N"]) == pytest.approx(float(found.margin[:, 0].quantile(0.05)))


def test_options_replace_the_table_of_the_study(study):
    rows = json.loads(invoke("tolerance", study, "--length", "2 mm", "--samples", 16, "--compensated", "--json"))
    plan = load_study(study)
    found = ta.tolerance(plan.arms[0].design, plan.tasks[0].task, length=2e-3, samples=16, compensated=True)
    assert rows[0]["tip_error_p50_mm"] == pytest.approx(1e3 * float(found.percentiles([50])[0, 0]), rel=1e-9)
    assert rows[0]["share_length"] == 1.0
    assert "share_radii" not in rows[0]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "tolerance: must say what is scattered"),
        (["--radii", "1 mmm"], "--radii: must be a number [m] or a text of one and a unit"),
        (["--radii", "1 mm, 2 mm"], "--radii: must be a number [m] or a text of one and a unit"),
        (["--radii", "1 mmm"], 'got "1 mmm"; did you mean mm?'),
        (["--radii", "1"], "--radii: must be at most 0.1 m (is it in millimetres?), got 1"),
        (["--force", "500 %"], "--force: must be at most 1 (is it in percent?), got 5"),
        (["--length", "-1 mm"], "--length: must be at least 0, got"),
        (["--force", "5 %", "--correlated", "force=2"], "--correlated force: must be at most 1, got 2"),
        (
            ["--force", "5 %", "--correlated", "force"],
            "--correlated: must be what is scattered and a number, such as force=1, got",
        ),
        (
            ["--force", "5 %", "--correlated", "x=1"],
            "--correlated x: unknown key; allowed: radii, length, limits, force, force_",
        ),
        (["--radii", "1 mm", "--samples", "1"], "--samples: must be at least 2, got 1"),
        (["--radii", "1 mm", "--out", "built.toml"], "--out: built.toml: must end in"),
        (["--model-covariance"], "model_covariance: must be False for arms without a fitted model"),
    ],
)
def test_mistakes_are_one_line(tmp_path, monkeypatch, capsys, arguments, words):
    path = tmp_path / "plain.toml"
    path.write_text(STUDY, encoding="utf-8")
    assert words in mistake(monkeypatch, capsys, "tolerance", path, *arguments)


def test_a_mistake_comes_before_what_is_doubtful(tmp_path, monkeypatch, capsys):
    path = tmp_path / "doubtful.toml"
    path.write_text(STUDY.replace('kind = "bellows"', 'kind = "bellows"\nmax_pressure = 0.4'), encoding="utf-8")
    assert mistake(monkeypatch, capsys, "tolerance", path).count("\n") <= 1


def test_actuators_are_scattered_alike_on_request(study, tmp_path):
    plan = load_study(study)
    arm, task = plan.arms[0].design, plan.tasks[0].task
    given = ["--force", "5 %", "--force-offset", "0.2 N", "--correlated", "force=50 %", "--correlated=force-offset=1"]
    row, *_ = json.loads(invoke("tolerance", study, *given, "--samples", 16, "--json"))
    alike = {"force": 0.5, "force_offset": 1.0}
    found = ta.tolerance(arm, task, force=0.05, force_offset=0.2, correlated=alike, samples=16)
    assert row["tip_error_p95_mm"] == pytest.approx(1e3 * float(found.percentiles([95])[0, 0]), rel=1e-9)
    row, *_ = json.loads(invoke("tolerance", study, "--correlated", "radii=1", "--json"))  # beside those of the study
    options = {"radii": 1e-3, "force": 0.05, "samples": 40, "distribution": "uniform"}
    found = ta.tolerance(arm, task, **options, correlated={"force": 0.5, "radii": 1.0})
    assert row["tip_error_p95_mm"] == pytest.approx(1e3 * float(found.percentiles([95])[0, 0]), rel=1e-9)


def test_what_fails_is_told_where_every_tip_is_within_tolerance(study):
    text = STUDY.replace("[[1.0, -1.0, 0.1], [0.5, 0.0, 0.0]]", "[[0.0, 0.0, 0.0]]")
    tight = f'{text}{TABLE}[evaluate]\ntolerance = "200 mm"\nrotation_tolerance = "0.001 deg"\n'
    study.write_text(tight, encoding="utf-8")
    output = invoke("tolerance", study)
    assert "0.0 (0.0-8.8)" in output
    assert output.count("turn 40 of 40") == 2
    assert "what fails: pairs of a built arm and a load" in output


@pytest.mark.parametrize("more", [[], ["--compensated"]])
def test_ctrl_c_keeps_the_arms_that_are_built(study, tmp_path, monkeypatch, more):
    module = sys.modules["torcharm.design.tolerance"]
    evaluated = module.Evaluation.of_found

    calls = []

    def interrupted(self, arm, found):
        calls.append(arm)
        if len(calls) == stop:
            raise KeyboardInterrupt
        return evaluated(self, arm, found)

    monkeypatch.setattr(module, "AT_ONCE", 20)
    monkeypatch.setattr(module.Evaluation, "of_found", interrupted)
    stop, out = 2, tmp_path / "built.csv"  # the drawn arm alone is known
    assert invoke("tolerance", study, "--out", out, *more, code=130) == ""
    calls, stop = [], 4  # two chunks of built ones are known, too
    output = invoke("tolerance", study, "--out", out, *more, code=130)
    assert "antagonist: interrupted: 20 of 40 built arms." in output
    rows = list(csv.DictReader(out.open(encoding="utf-8")))
    assert [(row["arm"], row["samples"], row["stopped"]) for row in rows] == [("antagonist", "20", "interrupted")] * 2
    assert float(rows[0]["yield_high"]) - float(rows[0]["yield_low"]) > 0.1


def test_a_study_is_optimised_for_its_built_arms(tmp_path):
    how = '[optimise]\nrobust = 0.8\nfree = ["radii"]\ntied = "mirror"\nstarts = 1\niterations = 2\n'
    plan = parse_study(f"{STUDY}{TABLE}{how}")
    robust = plan.optimisation.objective.robust
    assert (robust.quantile, robust.scatter.radii, robust.compensated) == (0.8, 1e-3, False)
    path = tmp_path / "robust.toml"
    path.write_text(f"{STUDY}{TABLE}{how}", encoding="utf-8")
    output = invoke("optimise", path)
    assert "what 80 % stay below" in " ".join(output.split())
    with pytest.raises(ValueError, match=r"optimise.robust: must stand beside a table \[tolerance\]"):
        parse_study(f"{STUDY}{how}")


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('radii = "1 kg"', "tolerance.radii: must be a number [m]"),
        ("force = -0.1", "tolerance.force: must be at least 0"),
        ("force = 5", "tolerance.force: must be at most 1 (is it in percent?)"),
        ("correlated = { force = 2 }", "tolerance.correlated.force: must be at most 1"),
        ('distribution = "even"', "tolerance.distribution: must be one of normal, uniform"),
        ("radius = 1", "tolerance.radius: unknown key"),
    ],
)
def test_mistakes_in_the_table_name_its_field(line, words):
    with pytest.raises(ValueError, match=re.escape(words)):
        parse_study(f"{STUDY}\n[tolerance]\n{line}\n")


def test_the_picture_shows_curves_tolerance_and_shares():
    plan = parse_study(STUDY)
    found = [
        (arm.name, ta.tolerance(arm.design, plan.tasks[0].task, radii=1e-3, force=0.05, samples=32))
        for arm in plan.arms
    ]
    left, right = tolerance_figure(found, "bend").axes
    assert len(left.get_legend().get_texts()) == 2
    curve = left.get_lines()[0]
    error = torch.from_numpy(curve.get_xdata()).double()
    torch.testing.assert_close(error, 1e3 * found[0][1].tip_error.flatten().sort().values)
    assert any(text.get_text() == "tolerance: 10 mm" for text in left.texts)
    assert [label.get_text() for label in right.get_yticklabels()] == ["offsets\nσ 1 mm", "force scale\nσ 5 %"]
    widths = [bar.get_width() for bar in right.patches[:2]]
    assert widths == pytest.approx([100 * share for share in found[0][1].shares.values()])
    assert "[mm]" in left.get_xlabel()
    words = left.get_legend().get_texts()[0].get_text()
    assert f"yield on all loads {100 * found[0][1].yield_of_all.value:.1f} %; fails most: " in words
    marks = [line for line in left.get_lines() if line.get_marker() == "^"]
    assert len({mark.get_ydata()[0] for mark in marks}) == 2  # none hides another


def test_a_share_that_is_not_known_is_no_bar_of_no_length():
    plan = parse_study(STUDY)
    few = ta.tolerance(plan.arms[0].design, plan.tasks[0].task, radii=1e-3, samples=4)
    right = tolerance_figure([("few", few)]).axes[1]
    filled, hollow = right.patches
    assert filled.get_width() == pytest.approx(100)
    assert math.isnan(hollow.get_width())
    assert [text.get_text() for text in right.texts] == ["100", "not known: too few samples"]
    assert filled.get_height() < 0.2  # of a single source, too, a bar is no block


def test_a_picture_of_nothing_is_refused():
    with pytest.raises(ValueError, match="results: must hold at least one arm"):
        tolerance_figure([])
