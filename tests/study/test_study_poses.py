"""Poses in space as a designer has them: a place, a direction and a turn, in a study's tip_pose and base_pose."""

import math
import re

import pytest
import torch

import torcharm as ta
from torcharm.study import parse_study

STUDY = """
name = "poses"
[[arm]]
name = "ring"
ring = {{ radius = "50 mm", count = 3 }}
actuators = "bellows"
length = "30 cm"
[[task]]
name = "t"
shape = {{ kind = "constant", curvature = {curvature}, {direction} length = "33 cm", nodes = 4 }}
{task}
{plan}
"""


def study(task="", plan="", curvature='"20 deg"', direction="direction = 0.5,"):
    table = f'[[plan]]\nname = "p"\n{plan}\n' if plan else ""
    return parse_study(STUDY.format(task=task, plan=table, curvature=curvature, direction=direction))


def pose_text(position, direction, turn='"0 deg"'):
    return f"{{ position = {position}, direction = {direction}, turn = {turn} }}"


@pytest.mark.parametrize("base", ["hanging", "upright", "horizontal"])
@pytest.mark.parametrize("towards", [0.0, 0.8, -2.0])
def test_a_turn_of_0_is_that_of_an_arm_that_bends_in_one_plane(base, towards):
    """Whose tip the place and the direction, of any length, describe."""
    twists = ta.constant_curvature(1.2, 0.33, 4, direction=towards)
    tip = ta.poses(twists, base)[-1]
    position = [f"{1e3 * one:.12g} mm" for one in tip[:3, 3].tolist()]
    text = pose_text(str(position).replace("'", '"'), (2.5 * tip[:3, 0]).tolist())
    plan = study(plan=f'base_pose = "{base}"\ntip_pose = {text}').plans[0]
    torch.testing.assert_close(torch.tensor(plan.tip_pose, dtype=torch.float64), tip, atol=1e-9, rtol=0)


def test_a_turn_is_about_the_direction():
    plain, turned = (
        torch.tensor(study(plan=f"tip_pose = {pose_text([0.1, -0.3, 0.0], [1, -1, 0.3], turn)}").plans[0].tip_pose)
        for turn in ("0", '"30 deg"')
    )
    torch.testing.assert_close(turned[:, [0, 3]], plain[:, [0, 3]])
    y, z = plain[:3, 1], plain[:3, 2]
    torch.testing.assert_close(turned[:3, 1], math.cos(math.pi / 6) * y + math.sin(math.pi / 6) * z)


def test_a_base_is_tilted_from_where_it_hangs_and_a_tip_is_told_from_it():
    """A base that hangs is the named one; and an arm on a tilted base still bends in one plane at a turn of 0."""
    down = study(task=f"base_pose = {pose_text([0, 0, 0], [0, -2, 0])}").tasks[0].task.base_pose
    torch.testing.assert_close(down, study().tasks[0].task.base_pose)
    base = f"base_pose = {pose_text(['0.1 m', 0, 0], [1, -1, 0.5])}".replace("'", '"')
    task = study(task=base).tasks[0].task
    assert task.base_pose[:3, 3].tolist() == [0.1, 0.0, 0.0]
    tip = ta.poses(task.twists, task.base_pose)[-1]
    plan = study(plan=f"{base}\ntip_pose = {pose_text(tip[:3, 3].tolist(), tip[:3, 0].tolist())}").plans[0]
    torch.testing.assert_close(torch.tensor(plan.tip_pose, dtype=torch.float64), tip, atol=1e-9, rtol=0)
    torch.testing.assert_close(torch.tensor(plan.base_pose, dtype=torch.float64), task.base_pose)


def test_the_rows_of_a_matrix_are_taken_too():
    rows = ta.poses(ta.constant_curvature(0.5, 0.33, 4, direction=0.3))[-1].tolist()
    assert study(plan=f"tip_pose = {rows}").plans[0].tip_pose == rows


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("tip_pose", "{ position = [0, 0, 0] }", "plan[1].tip_pose.direction: missing; must be a list of 3, [x, y, z]"),
        ("tip_pose", pose_text([0, 0], [0, -1, 0]), "plan[1].tip_pose.position: must be a list of 3, [x, y, z],"),
        (
            "tip_pose",
            pose_text([0, 0, '"1 kg"'], [0, -1, 0]).replace("'", ""),
            ".position: must be a num",
        ),
        (
            "tip_pose",
            pose_text([0, 0, 0], [0, 0, 0]),
            "tip_pose.direction: must be a vector that is not 0",
        ),
        ("tip_pose", pose_text([0, 0, 0], [0, 1, 0]), "plan[1].tip_pose.direction: must not be straight back, as no"),
        ("tip_pose", "{ at = [0, 0, 0] }", "plan[1].tip_pose.at: unknown key; allowed: position, direction, turn"),
        (
            "tip_pose",
            '"there"',
            "tip_pose: must be a list [x, y, θ], or in space a table of position",
        ),
        ("base_pose", pose_text([0, 0, 0], [0, 1, 0]), "task[1].base_pose.direction: must not be straight back"),
        ("base_pose", "[0, 0, 0]", "task[1].base_pose: must be hanging, upright, horizontal or a table of position,"),
    ],
)
def test_mistakes_are_told_in_a_sentence(field, value, words):
    table = f"{field} = {value}"
    with pytest.raises(ValueError, match=re.escape(words)):
        study(**{"plan" if field == "tip_pose" else "task": table})


def test_what_is_straight_needs_no_direction_in_space():
    """Of a shape alone, and of a segment beside one that bends; what bends needs one."""
    (task,) = study(curvature=0, direction="").tasks
    torch.testing.assert_close(task.task.twists, ta.constant_curvature(0.0, 0.33, 4, direction=0.0))
    with pytest.raises(ValueError, match=r"task\[1\]\.shape: must be in space \(with a direction"):
        study(direction="")
    segment = '[[arm.segment]]\nring = { radius = "50 mm", count = 3 }\nactuators = "bellows"\nlength = 0.2\n'
    text = 'name = "s"\n[[arm]]\nname = "two"\n{}{}[[task]]\nname = "t"\nshape = [{}, {}]\n'
    straight, bent = (f'{{ kind = "constant", curvature = {bend}, length = 0.2, nodes = 3 }}' for bend in (0, 0.3))
    both = parse_study(text.format(segment, segment, straight, bent.replace("nodes", "direction = 1.0, nodes"))).tasks[
        0
    ]
    assert both.task.twists.shape == (6, 6)
    with pytest.raises(ValueError, match=r"shape\[2\]\.direction: must be given for all segments that bend"):
        parse_study(text.format(segment, segment, straight, bent))
