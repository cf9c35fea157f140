import csv
import json
import math
import re
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from commands import invoke, mistake

import torcharm as ta

STUDY = """
name = "search"
[[arm]]
name = "soft"
kind = "bellows"
[[arm]]
name = "antagonist"
kind = "antagonistic"
[[task]]
name = "bent"
shape = { kind = "affine", slope = -1, intercept = 1, nodes = 4 }
loads = { count = 3 }
"""


@pytest.fixture
def study_file(tmp_path: Path) -> Path:
    path = tmp_path / "study.toml"
    path.write_text(STUDY, encoding="utf-8")
    return path


def test_search_writes_the_pressures_that_reach_the_costs_it_names(study_file, tmp_path):
    out = tmp_path / "found.csv"
    output = invoke("search", study_file, "--out", out, "--starts", 2, "--weights", "uniform")
    invoke("search", study_file, "--out", out.with_suffix(".json"), "--starts", 2, "--weights", "uniform")
    rows = list(csv.DictReader(out.open(encoding="utf-8")))
    assert [(row["arm"], row["load"]) for row in rows] == [(a, n) for a in ("soft", "antagonist") for n in "123"]
    assert "6 rows" in output
    target = ta.poses(ta.affine_curvature(-1.0, 1.0, nodes=4))
    arms = {"soft": ta.bellows_arm(), "antagonist": ta.antagonistic_arm()}
    for row in rows:
        load = [float(row[name]) for name in ("force_x_N", "force_y_N", "moment_Nm")]
        pressure = [float(row[f"pressure_{index}_kPa"]) for index in range(1, 5)]
        reached = ta.solve_equilibrium(arms[row["arm"]], pressure, load, 4).poses
        gap = (target - reached).square() @ torch.tensor([1.0, 1.0, 0.05], dtype=torch.float64)
        assert float(row["shape_error_mm"]) == pytest.approx(1e3 * float(gap[:4].mean().sqrt()), rel=1e-6, abs=1e-3)
        assert float(row["tip_error_mm"]) == pytest.approx(1e3 * float((target - reached)[-1, :2].norm()), rel=1e-6)
    told = [line.split() for line in output.splitlines() if line.startswith(tuple(arms)) and "," not in line]
    for row, line, more in zip(rows, told[:6], told[6:], strict=True):
        assert line[:2] == more[:2] == [row["arm"], row["load"]]
        assert " ".join(line[2:-4]) == row["verdict"]
        numbers = [row[f"{name}_{unit}"] for name, unit in ERRORS] + [row[f"pressure_{k}_kPa"] for k in range(1, 5)]
        assert [float(one) for one in line[-4:] + more[2:]] == pytest.approx([float(one) for one in numbers], rel=6e-3)
    same = json.loads(out.with_suffix(".json").read_text(encoding="utf-8"))
    assert [row["pressure_4_kPa"] for row in same] == [float(row["pressure_4_kPa"]) for row in rows]


ERRORS = (("tip_error", "mm"), ("tip_rotation_error", "deg"), ("shape_error", "mm"))


def test_search_and_evaluate_name_the_same_columns(study_file, tmp_path):
    """Of the same units; both give a verdict, and a reason unless it is held."""
    columns = {}
    for command in ("evaluate", "search"):
        out = tmp_path / f"{command}.json"
        invoke(command, study_file, "--out", out)
        rows = json.loads(out.read_text(encoding="utf-8"))
        columns[command] = [list(row) for row in rows]
        assert all((row["verdict"] == "held") == (row["reason"] == "") for row in rows)
    assert columns["search"] == columns["evaluate"]


def test_what_is_impossible_is_called_so_by_evaluate_and_search(tmp_path):
    study = tmp_path / "coiled.toml"
    study.write_text(STUDY.replace("slope = -1, intercept = 1", "slope = 0, intercept = 7"), encoding="utf-8")
    for command in ("evaluate", "search"):
        output = invoke(command, study, "--out", tmp_path / "out.csv")
        rows = list(csv.DictReader((tmp_path / "out.csv").open(encoding="utf-8")))
        assert {(row["verdict"], row["status"]) for row in rows} == {("impossible", "impossible")}
        assert {row["tip_error_mm"] for row in rows} == {row["pressure_1_kPa"] for row in rows} == {""}
        for row in rows:
            assert "actuator 4 would have no length at node 1" in row["reason"]
        assert "impossible: an actuator would have no length." in output
        assert "inf" not in output


def test_a_search_of_many_loads_tells_three_of_them(study_file, tmp_path):
    """Those of least, median and largest error over its tolerance of each arm, as in the picture."""
    study_file.write_text(STUDY.replace("count = 3", "count = 7"), encoding="utf-8")
    output = invoke("search", study_file, "--starts", 2, "--out", tmp_path / "out.csv")
    assert "Loads of least, median and largest error over its tolerance:" in output
    rows = [row for row in csv.DictReader((tmp_path / "out.csv").open(encoding="utf-8")) if row["arm"] == "antagonist"]
    tolerances = {"tip_error_mm": 10.0, "tip_rotation_error_deg": 5.0, "shape_error_mm": 10.0}
    over = [max(float(row[name]) / most for name, most in tolerances.items()) for row in rows]
    order = sorted(range(7), key=lambda load: over[load])
    told = [line.split() for line in output.splitlines() if re.match(r"antagonist +\d+ +[a-z]", line)]
    assert [int(line[1]) - 1 for line in told if line[2] != "of"] == [order[0], order[3], order[6]]


def test_the_reason_of_a_snap_says_what_to_try(study_file, tmp_path):
    """A word for every status that leaves a task undecided."""
    task = ta.Task(ta.affine_curvature(-1.0, 1.0, nodes=4), ta.sample_loads(3))
    found = ta.search_pressure(ta.bellows_arm(), task, starts=2)
    lost = torch.zeros(3, dtype=torch.bool)
    far = found.tip_error + 1.0
    for status, change in (
        ("snapped", {"continued": lost}),
        ("not converged", {"converged": lost, "tip_error": far}),
        ("not found", {"stable": lost, "tip_error": far}),
    ):
        other = replace(found, **{"continued": ~lost, "stable": ~lost, "in_range": ~lost, **change})
        judged = ta.evaluate(ta.bellows_arm(), task, found=other)
        assert set(other.status) == {status}
        assert set(judged.verdict) == {"undecided"}
        for reason in judged.reason:
            assert "try" in reason
            assert "a lower load, a stiffer arm, or antagonists" in reason
    beyond = ta.Task(ta.affine_curvature(-3.0, 3.0, nodes=4), ta.sample_loads(3))
    snapped = replace(ta.search_pressure(ta.bellows_arm(), beyond, starts=2), continued=lost, stable=~lost)
    for reason in ta.evaluate(ta.bellows_arm(), beyond, found=snapped).reason:
        assert reason.startswith("actuator 4 is strained to -0.4")
        assert "the arm gets there by a snap" in reason
    with pytest.raises(ValueError, match=r"^found: must have the batch shape \(2,\), got \(3,\)"):
        ta.evaluate(ta.bellows_arm(), ta.Task(task.twists, ta.sample_loads(2)), found=found)
    with pytest.raises(ValueError, match=r"^found: must be left out for a list of tasks"):
        ta.evaluate(ta.bellows_arm(), [task], found=found)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--method", "guess"), "--method: must be one of multistart, scipy, got 'guess'"),
        (("--starts", "0"), "--starts: must be at least 1, got 0"),
        (("--weights", "middle"), "--weights: must be one of ramp, uniform, tip"),
    ],
)
def test_search_mistakes(study_file, options, message, monkeypatch, capsys):
    assert mistake(monkeypatch, capsys, "search", study_file, *options).startswith(message)


def test_shape_prints_the_tip_and_draws_the_arm(tmp_path):
    figure = tmp_path / "arm.png"
    output = invoke("shape", "--pressure", "20,30,20,25", "--load", "2,-3,0.1", "--figure", figure, "--nodes", 5)
    found = ta.solve_equilibrium(ta.antagonistic_arm(), [20.0, 30.0, 20.0, 25.0], [2.0, -3.0, 0.1], 5)
    words = output.replace(",", "").split()
    values = [float(words[words.index(name) + 1].rstrip("°")) for name in ("x", "y", "heading")]
    x, y, heading = found.poses[-1].tolist()
    assert values == pytest.approx([1e3 * x, 1e3 * y, math.degrees(heading)], rel=1e-5)
    assert words.count("mm") == 2
    assert figure.read_bytes().startswith(b"\x89PNG")


def test_shape_takes_pressures_and_loads_with_units(tmp_path):
    plain, units = (
        invoke("shape", "--pressure", pressure, "--load", load, "--nodes", 5, "--figure", tmp_path / "arm.png")
        for pressure, load in (
            ("20,30,34.47378646584,25", "1.96133,-3,0.1"),
            ("0.2 bar, 30 kPa,5 psi,250 mbar", "200 gf,-3 N,100 N mm"),
        )
    )
    assert plain.splitlines()[0] == units.splitlines()[0]


def test_shape_takes_an_arm_of_a_study(study_file, tmp_path):
    output = invoke(
        *("shape", "--study", study_file, "--arm", "soft", "--pressure", "60,60,60,60"),
        *("--figure", tmp_path / "arm.svg"),
    )
    assert output.startswith("soft: tip at x")
    assert "out of range" in output
    assert "Pressures are above the arm's limits: 60 of 50, 60 of 50, 60 of 50, 60 of 50 kPa." in " ".join(
        output.split()
    )


BODY = """
name = "body"
[[arm]]
name = "finger"
ring = [{ radius = 0 }, { radius = "9 mm", count = 3 }]
actuators = [
    { kind = "elastic_core", axial_stiffness = 45.0, bending_stiffness = 3.6e-3 },
    { kind = "chamber", area = "110 mm²" },
]
length = "100 mm"
[[task]]
name = "bend"
shape = { kind = "constant", curvature = "20 deg", direction = 0, length = "102 mm", nodes = 3 }
"""


def test_passive_actuators_have_no_pressure(tmp_path, monkeypatch, capsys):
    """They may be left out where pressures are given, and are where they are told."""
    path = tmp_path / "body.toml"
    path.write_text(BODY, encoding="utf-8")
    options = ("--study", path, "--nodes", 3, "--figure", tmp_path / "arm.png", "--pressure")
    short, long = (invoke("shape", *options, given) for given in ("30,0,10", "0,30,0,10"))
    assert short == long
    message = mistake(monkeypatch, capsys, "shape", *options, "30,10")
    assert message == "--pressure: must be 4 numbers with commas between them, or 3 without the 1 passive, got 30,10"
    for command in ("evaluate", "search"):
        invoke(command, path, "--out", tmp_path / "out.csv")
        with (tmp_path / "out.csv").open(encoding="utf-8") as file:
            (row,) = csv.DictReader(file)
        assert [name for name in row if name.startswith("pressure")] == [f"pressure_{k}_kPa" for k in (2, 3, 4)]


def test_searches_that_find_no_equilibrium_count_as_failed(tmp_path):
    study = tmp_path / "heavy.toml"
    study.write_text(
        """
        name = "heavy"
        [[arm]]
        name = "antagonist"
        kind = "antagonistic"
        [[task]]
        name = "heavy"
        shape = { kind = "affine", slope = -1, intercept = 1, nodes = 4 }
        loads = [[0.0, 10000.0, 0.0], [0.0, 1.0, 0.0]]
        """,
        encoding="utf-8",
    )
    output = invoke("search", study, "--starts", 2, "--out", tmp_path / "found.csv")
    heavy, light = csv.DictReader((tmp_path / "found.csv").open(encoding="utf-8"))
    assert (heavy["verdict"], heavy["status"], heavy["tip_error_mm"]) == ("undecided", "not found", "")
    assert "antagonist, load 1: no start led to a stable equilibrium: try more starts" in output
    lost, found = (line.split() for line in output.splitlines() if re.match(r"antagonist +\d +[a-z]", line))
    assert lost[1:6] == ["1", "undecided", "-", "-", "-"]
    assert float(found[-4]) == pytest.approx(float(light["tip_error_mm"]), rel=6e-3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--pressure", "1,2"), "--pressure: must be 4 numbers with commas between them, got 1,2"),
        (("--pressure", "1,2,3,x"), "--pressure: must be a number [kPa] or a text of one and a unit (kPa, Pa, "),
        (("--pressure", "1,2,3,4 N"), "--pressure: must be a number [kPa] or a text of one and a unit (kPa, Pa, "),
        (("--pressure", "1,2,3,4", "--load", "1,2,3 N"), "--load: must be a number [N·m] or a text of one and a unit"),
        (("--pressure", "1,2,3,-4"), "pressure: must be at least 0 kPa, as vacuum is not supported, got -4"),
        (("--pressure", "1,2,3,4", "--load", "1"), "--load: must be 3 numbers"),
        (("--pressure", "1,2,3,4", "--arm", "left"), "--arm: must be one of antagonistic, bellows-only, got 'left'"),
        (("--pressure", "1,2,3,4", "--figure", "a.txt"), "--figure: a.txt: must end in one of"),
        (("--pressure", "0,0,0,0", "--nodes", "0"), "nodes: must be an integer of at least 1"),
    ],
)
def test_shape_mistakes(options, message, monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert mistake(monkeypatch, capsys, "shape", *options).startswith(message)
    assert not list(tmp_path.iterdir())
