"""What a study is asked about: numbers that make sense in other units only, and actuators at one place."""

import re

import pytest
import torch
from commands import invoke
from typer.testing import CliRunner

import torcharm as ta
from torcharm.attainability.questions import question_about_places
from torcharm.cli.app import app
from torcharm.study import parse_study

ARM = 'radii = [-0.03, 0.03]\nlength = 0.3\nactuators = "bellows"\nmass = 0.2\n'
TASK = "shape = { kind = 'constant', curvature = 0.3, length = 0.3, nodes = 2 }\ngravity = true\n"


def study(arm=ARM, task=TASK, rest=""):
    return f'name = "s"\n[[arm]]\nname = "a"\n{arm}[[task]]\nname = "t"\n{task}{rest}'


def plan(pose):
    return study(rest=f'[[plan]]\nname = "p"\ntip_pose = {pose}\n')


SPACE = study(
    'ring = { radius = "30 mm", count = 3 }\nlength = 0.3\nactuators = "bellows"\n',
    TASK.replace("length = 0.3,", "length = 0.3, direction = 0.0,"),
    '[[plan]]\nname = "p"\ntip_pose = { position = [100, -240, 0], direction = [0, -1, 0] }\n',
)
ASKED = {
    "a pose in millimetres and degrees": (
        plan("[100, -240, -45]"),
        "plan[1].tip_pose: 260 m from the origin and a heading of -45 rad: are they in millimetres and degrees? "
        "Write '100 mm' and '-45 deg' then.",
    ),
    "a pose in millimetres": (plan('[100, -240, "-45 deg"]'), "260 m from the origin: is it in millimetres?"),
    "a heading in degrees": (plan("[0.1, -0.2, -45]"), "a heading of -45 rad: is it in degrees? Write '-45 deg' then."),
    "a pose in space": (
        SPACE,
        "plan[1].tip_pose.position: 260 m from the origin: is it in millimetres? Write '100 mm' then.",
    ),
    "a base": (study(task=f"{TASK}base_pose = [0, 0, -90]\n"), "task[1].base_pose: a heading of -90 rad: is it in"),
    "bounds": (
        study(rest="[optimise]\nbounds = { radii = [-60, 60] }\n"),
        "optimise.bounds.radii: -60 m, beyond 1 m: is it in millimetres? -60 mm is written '-60 mm'.",
    ),
    "bounds of lengths": (study(rest="[optimise]\nbounds = { length = [0.2, 400] }\n"), "bounds.length: 400 m, beyond"),
    "spacing": (study(rest="[optimise]\nspacing = 25\n"), "optimise.spacing: 25 m, beyond 1 m: is it in millimetres?"),
    "a payload": (
        study(task=f"{TASK}payloads = [{{ mass = 50 }}]\n"),
        "task[1].payloads[1].mass: 50 kg: the unit is kilogram, 50 g is written '50 g'; is it in grams?",
    ),
    "an arm": (study(ARM.replace("mass = 0.2", "mass = 120")), "arm[1].mass: 120 kg: the unit is kilogram, 120 g is"),
    "a link": (study(f"{ARM}link = {{ length = 0.01, mass = 30 }}\n"), "arm[1].link.mass: 30 kg: the unit is"),
    "a unit in capitals": (study(f'{ARM}max_pressure = "12 PSI"\n'), 'got "12 PSI"; did you mean psi?'),
    "a unit in the plural": (study(f'{ARM}max_pressure = "0.8 bars"\n'), 'got "0.8 bars"; did you mean bar?'),
}


@pytest.mark.parametrize(("text", "words"), ASKED.values(), ids=ASKED)
def test_what_makes_sense_in_other_units_only_is_asked_about(text, words):
    with pytest.raises(ValueError, match=re.escape(words)):
        parse_study(text)


def test_what_makes_sense_is_not_asked_about():
    text = study(
        task=f'{TASK}payloads = [{{ mass = "50 g" }}]\n',
        rest='[optimise]\nspacing = "25 mm"\nbounds = { radii = ["-60 mm", "60 mm"], length = [0.2, 4.0] }\n'
        '[[plan]]\nname = "p"\ntip_pose = ["100 mm", -0.2, "450 deg"]\n',
    )
    assert parse_study(text).plans[0].tip_pose[2] == pytest.approx(7.854, abs=1e-3)


def test_actuators_at_one_place_are_asked_about(tmp_path):
    (tmp_path / "s.toml").write_text(study(ARM.replace("-0.03", "0.03")))
    result = CliRunner().invoke(app, ["evaluate", str(tmp_path / "s.toml")])
    assert result.exit_code == 0
    assert "torcharm: a: actuators 1 and 2 are both at 30 mm from the centreline" in result.output
    (tmp_path / "s.toml").write_text(study())
    assert "are both at" not in invoke("evaluate", tmp_path / "s.toml")


def test_a_core_may_be_where_a_chamber_is():
    """It is passive; and places of segments are counted over the arm."""
    core = ta.ArmDesign([0.0, 0.0], 0.3, [ta.chamber(8e-5), ta.elastic_core(40.0, 1e-3)])
    assert question_about_places([core]) is None
    twice = ta.ArmDesign(offsets=[[0.0, 0.01]] * 2, length=0.3, actuators="bellows")
    assert question_about_places([core, twice]).startswith("actuators 3 and 4 are both at (0, 10) mm")


@pytest.mark.parametrize("make", [lambda: ta.ArmDesign(["-30 mm", 0.03], 0.3, "bellows"), lambda: ta.Task("5 m")])
def test_texts_with_units_are_for_studies(make):
    with pytest.raises(ValueError, match=r"must be numbers in metres, .*; texts with units are for study files only"):
        make()


def test_a_single_capacity_shows_its_factor():
    task = ta.Task(ta.constant_curvature(0.0, 0.5, 4), [1.0, 0.0, 0.0])
    found = ta.load_capacity(ta.antagonistic_arm(), task)
    node = int(found.limiting_node) + 1
    assert repr(found) == f"LoadCapacity(factor {float(found.factor):.4g}, limited by node {node} from the base)"
    several = ta.load_capacity(ta.antagonistic_arm(), ta.Task(task.twists, torch.eye(3, dtype=torch.float64)))
    assert repr(several).startswith("LoadCapacity(factor (3,)")
