"""`torcharm workspace`: tables, files, and what a person may get wrong."""

import csv

import pytest
from typer.testing import CliRunner

from torcharm.cli.app import app

STUDY = """
name = "try"
[[arm]]
name = "short"
radii = [-0.03, 0.03]
length = 0.22
actuators = "bellows"
mass = "200 g"
[[arm]]
name = "with a muscle"
radii = [-0.03, 0.0, 0.03]
length = 0.22
actuators = ["bellows", "mckibben", "bellows"]
[[task]]
name = "hold"
arms = ["short", "with a muscle"]
shape = { kind = "constant", curvature = 0.1, length = 0.22, nodes = 3 }
"""
SPACE = """
[[arm]]
name = "round"
ring = { radius = 0.03, count = 3 }
length = 0.22
actuators = "bellows"
[[task]]
name = "hang"
arms = ["round"]
twists = [[0.22, 0, 0, 0, 0, 0]]
"""


def asked(tmp_path, *options, text=STUDY, code=0):
    path = tmp_path / "study.toml"
    path.write_text(text)
    given = ["workspace", path, "--nodes", 3, *([] if "--states" in options else ["--states", 200]), *options]
    result = CliRunner().invoke(app, [str(one) for one in given], env={"COLUMNS": "80"})
    assert result.exit_code == code, result.output
    return result.stdout + result.stderr


def test_a_table_a_file_and_a_picture(tmp_path):
    out, figure = tmp_path / "w.csv", tmp_path / "w.png"
    said = asked(tmp_path, "--payload", "50 g", "--out", out, "--figure", figure)
    for word in ("short", "with a muscle", "reached", "furthest", "payload", "400 states in"):
        assert word in said
    assert figure.stat().st_size > 1000
    with out.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 400
    first, last = rows[0], rows[-1]
    assert list(first)[:5] == ["arm", "state", "tip_x_mm", "tip_y_mm", "heading_deg"]
    assert (first["arm"], first["state"]) == ("short", "1")
    assert first["pressure_3_kPa"] == ""  # it has two actuators
    assert (last["arm"], last["state"]) == ("with a muscle", "200")
    assert float(last["payload_factor"]) >= 1
    assert abs(float(last["tip_y_mm"])) < 500


def test_one_arm_without_payload_in_space(tmp_path):
    out = tmp_path / "w.json"
    said = asked(tmp_path, "--arm", "round", "--out", out, text=STUDY + SPACE)
    assert "dm³" in said
    assert "cm²" not in said
    assert "short" not in said
    assert '"elevation_deg"' in out.read_text()
    assert "payload_factor" not in out.read_text()


def test_a_region_of_few_states_is_said_to_be_unsettled(tmp_path):
    few = asked(tmp_path, "--arm", "with a muscle", "--states", 100)
    assert "with a muscle: not settled: the last quarter of 100 states still counts" in few
    assert "ask for more by --states." in few
    assert "settled" not in asked(tmp_path, "--arm", "with a muscle", "--states", 3000)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--arm", "none"), "--arm: must be one of short, with a muscle, round, got 'none'"),
        (("--payload", "much"), "--payload: must be a number [kg] or a text of one and a unit"),
        (("--payload", "0 -2 0"), "numbers separated by commas, 3 in the plane and 6 in space: 0, -2, 0"),
        (("--payload", "2 N"), "numbers separated by commas, 3 in the plane and 6 in space: 0, -2, 0"),
        (("--payload=-200 g",), "torcharm: --payload: must be a finite number and at least 0 kg, got -0.2"),
        (("--payload", "nan"), "torcharm: --payload: must be a finite number and at least 0 kg, got nan"),
        (("--payload", "1", "--no-gravity"), "payload: a mass has no weight with gravity=False"),
        (("--base", "sideways"), "--base: must be one of hanging, upright, horizontal, got 'sideways'"),
        (("--nodes", 0), "--nodes: must be an integer of at least 1, got 0"),
        (("--show", "payload factor"), "--show: payload factor needs a --payload"),
        (("--figure", "w.png"), "--figure: must be of arms all in the plane or all in space; choose by --arm"),
        (("--states", 5), "--states: must be an integer of at least 100, got 5"),
        (("--out", "w.txt"), "--out: w.txt: must end in .csv or .json, got .txt"),
    ],
)
def test_mistakes(tmp_path, options, message, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert message in asked(tmp_path, *options, text=STUDY + SPACE, code=2)


def test_a_wrench_for_the_plane_costs_arms_in_space_alone(tmp_path):
    said = asked(tmp_path, "--payload", "0,-1,0", text=STUDY + SPACE, code=2)
    assert "short" in said
    assert "round: --payload: must be 6 numbers with commas between them, got 0,-1,0" in said
