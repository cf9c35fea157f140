"""What is advised is so: a higher limit, or an actuator that acts the other way, lowers the error."""

from dataclasses import replace

import pytest

import torcharm as ta
from torcharm.study import NamedArm, NamedTask, Settings, StudyResult
from torcharm.study.advice import advice
from torcharm.study.words import next_commands


def result(arm, task, settings=Settings()):  # noqa: B008
    found = ta.evaluate(arm, task, **vars(settings))
    return StudyResult(NamedArm("arm", arm), NamedTask("task", task), settings, found)


def bend(intercept=1.0, loads=None, nodes=6):
    return ta.Task(ta.affine_curvature(0.0, intercept, length=0.5, nodes=nodes), loads)


def test_a_limit_that_is_reached_is_told_and_a_higher_one_helps():
    actuators = [ta.Bellows(), ta.McKibben(), ta.Bellows()]
    arm = ta.ArmDesign(radii=[-0.05, 0.0, 0.05], length=0.5, actuators=actuators, max_pressure=[1.0, 40.0, 1.0])
    one = result(arm, bend())
    assert one.verdicts == ["missed"]
    (said,) = [words for words in advice(one) if "at the limit" in words]
    assert said.startswith("Under 1 of 1 missed loads actuator 1 is at the limit")
    higher = replace(arm, max_pressure=arm.max_pressure + arm.max_pressure.new_tensor([1.0, 0.0, 0.0]))
    assert float(result(higher, bend()).attainability.shape_error) < float(one.attainability.shape_error)


def test_an_actuator_without_pressure_is_told_and_one_that_acts_the_other_way_there_helps():
    arm, task = ta.bellows_arm(outer_radius=0.05, inner_radius=0.015, length=0.5), bend(loads=[0.0, -2.0, 0.0])
    one = result(arm, task)
    assert one.verdicts == ["missed"]
    words = (
        "Under 1 of 1 missed loads actuators 2, 3, 4 are without pressure: one there that acts the other way may help."
    )
    assert words in list(advice(one))
    before, errors = float(one.attainability.shape_error), []
    for radius in arm.radii.tolist():
        actuators = [*arm.actuators, ta.McKibben()]
        both = ta.ArmDesign(radii=[*arm.radii.tolist(), radius], length=0.5, actuators=actuators)
        errors.append(float(result(both, task).attainability.shape_error))
    assert max(errors[1:]) < before < errors[0]


def test_what_is_held_has_its_margin():
    arm = ta.antagonistic_arm(outer_radius=0.05, inner_radius=0.015, length=0.5)
    one = result(arm, bend(), Settings(signed=True))
    margin = float(one.attainability.capacity_margin)
    assert margin > 0
    assert list(advice(one)) == [f"All are held. At the tightest, {margin:.2g} N more were to be had."]
    assert list(advice(result(arm, bend()))) == ["All are held."]
    assert list(next_commands("study.toml", [one])) == []


@pytest.mark.parametrize(
    ("intercept", "start"),
    [(57.0, "Look at units and the shape, which leaves no length: "), (6.0, "Characterise the actuators further")],
)
def test_shapes_that_cannot_be_say_why(intercept, start):
    arm = ta.antagonistic_arm(outer_radius=0.05, inner_radius=0.015, length=0.5)
    one = result(arm, bend(intercept))
    said = next(iter(advice(one)))
    assert said.startswith(start)
    assert said.endswith(f"{one.reasons[0].rstrip('.')}.")


def test_sets_alone_say_how_many_they_exclude():
    arm = ta.bellows_arm(outer_radius=0.05, inner_radius=0.015, length=0.5)
    one = result(arm, bend(loads=[[0.0, -9.0, 1.0], [0.0, -9.0, 1.0]]), Settings(metrics=("absolute",)))
    assert list(advice(one)) == [f"2 of 2 loads are excluded, most often as {one.reasons[0]}."]
