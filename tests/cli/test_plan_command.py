"""`torcharm plan`: verdicts with their reasons, and shapes as tasks of a study."""

import pytest
import torch
from commands import invoke, one_start

import torcharm as ta
from torcharm.cli.plan import NONE_FOUND
from torcharm.study import NamedTask, evaluate_study, load_study, parse_study, task_to_toml

STUDY = """
name = "try"
[[arm]]
name = "mine"
radii = [-0.03, 0.03]
length = 0.22
actuators = "bellows"
mass = "200 g"
[[task]]
name = "held"
shape = { kind = "constant", curvature = 0.1, length = 0.22, nodes = 3 }
[[plan]]
name = "drawer"
tip_pose = [0.1, -0.2, "-45 deg"]
tip_load = [1.0, 0, 0]
gravity = true
payloads = [{ mass = "10 g", at = 0.5 }]
nodes = 4
"""
FAR = STUDY.replace("[0.1, -0.2,", "[1.0, -0.2,")


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    one_start(monkeypatch)


def planned(tmp_path, *options, text=STUDY, code=0):
    """What the command prints for a study."""
    path = tmp_path / "study.toml"
    path.write_text(text)
    return invoke("plan", path, *options, code=code)


def evaluated(text):
    """Results by the names of tasks."""
    return {result.task.name: result for result in evaluate_study(parse_study(text))}


def test_plans_are_written_as_tasks_of_the_same_verdict(tmp_path):
    out = tmp_path / "shapes.toml"
    said = planned(tmp_path, "--out", out)
    assert f"Wrote {out} (1 task)." in said
    assert f"Next: paste {out} into {tmp_path / 'study.toml'}: torcharm evaluate" in said
    result = evaluated(STUDY + out.read_text())["drawer"]
    assert result.task.arms == ("mine",)
    assert result.verdicts[0] in said
    assert f"\nmine: {result.reasons[0]}." in said
    assert f"{1e3 * result.attainability.shape_error.item():.3g}" in said
    assert load_study(tmp_path / "study.toml").plans[0].tip_pose == pytest.approx(
        ta.poses(result.task.task.twists)[-1].tolist(), abs=1e-7
    )


def test_names_of_written_tasks_are_new_to_the_study(tmp_path):
    text = STUDY.replace('name = "held"', 'name = "drawer"')
    planned(tmp_path, "--out", tmp_path / "shapes.toml", text=text)
    assert list(evaluated(text + (tmp_path / "shapes.toml").read_text())) == ["drawer", "drawer 2"]


def test_verdicts_have_a_reason_a_tolerance_and_a_legend(tmp_path):
    said = planned(tmp_path, text=STUDY + "[evaluate]\ntolerance = '7 mm'\n")
    assert "held: tip and shape within 7 mm, turned within 5°." in said
    assert "missed: the least error" in said
    assert "--out shapes.toml writes the shapes as tasks" in said
    assert "turned" in said
    assert all(len(line) <= 80 for line in said.splitlines() if "─" in line)
    assert "absolute" not in said
    assert "absolute" in planned(tmp_path, "--sums")


def test_the_study_s_tolerance_decides_a_plan(tmp_path):
    loose = "[evaluate]\ntolerance = '100 mm'\nrotation_tolerance = '90 deg'\n"
    row = next(line for line in planned(tmp_path, text=STUDY + loose).splitlines() if line.startswith("mine "))
    assert row.split()[1] == "held"
    row = next(line for line in planned(tmp_path).splitlines() if line.startswith("mine "))
    assert row.split()[1] == "missed"


def test_only_plans_that_all_fail_are_an_error(tmp_path):
    said = planned(tmp_path, text=FAR, code=NONE_FOUND)
    assert "mine: no shape: none of 4 elements" in said
    assert "Next:" not in said
    near = STUDY[STUDY.index("[[plan]]") :].replace("drawer", "near")
    planned(tmp_path, text=FAR + near)
    said = planned(tmp_path, "--out", tmp_path / "p.csv", text=FAR.replace("[1.0, -0.2,", "[5.0, 5.0,") + near)
    assert "mine: no shape: none of 4 elements" in said
    assert (tmp_path / "p.csv").read_text().count("\nnear,mine,") == 4


def test_tasks_read_back_as_they_were():
    """In the plane and in space, in series, with all kinds of loads and bases."""
    twist = [0.3, 0.0, 0.0, 0.0, 0.1, 1 / 3]
    points = [
        ta.PointLoad([0.1, 0, 0, 0, 0, 0.2], segment=0, at=0.3, frame="body", mass=0.2),
        ta.PointLoad(mass=0.1),
    ]
    space = ta.Task(
        torch.tensor([twist] * 3, dtype=torch.float64),
        [[1.0, 2, 3, 4, 5, 6], [0.0] * 6],
        "upright",
        load=ta.ExternalLoad(gravity=True, points=points),
        wrench_at="start",
        segment_nodes=[1, 2],
    )
    place = torch.tensor([0.1, 0.2, 0.3], dtype=torch.float64)
    plane = ta.Task(ta.constant_curvature(1.0, 0.5, 3), [1 / 3, 0.0, 0.0], place)
    rest = 'name = "s"\n[[arm]]\nname = "a"\n'
    flat = f'{rest}kind = "bellows"\n'
    ring = "ring = { radius = 0.03, count = 3 }\nlength = 0.3\nactuators = 'bellows'\n"
    deep = f"{rest}[[arm.segment]]\n{ring}[[arm.segment]]\n{ring}"
    for arm, task in ((flat, plane), (deep, space)):
        (read,) = parse_study(arm + task_to_toml(NamedTask("one", task, ("a",)))).tasks
        assert (read.name, read.arms) == ("one", ("a",))
        again = read.task
        assert (again.wrench_at, again.segment_nodes) == (task.wrench_at, task.segment_nodes)
        assert torch.equal(again.twists, task.twists)
        assert torch.equal(again.base_pose, task.base_pose)
        assert torch.equal(again.tip_load, task.tip_load.reshape(-1, task.tip_load.shape[-1]))
        assert again.load.gravity == task.load.gravity
        assert sum(point.mass.item() for point in again.load.points) == pytest.approx(
            sum(point.mass.item() for point in task.load.points)
        )
        arms = parse_study(arm + task_to_toml(NamedTask("one", task))).arms
        one, other = (ta.evaluate(arms[0].design, each, ("absolute",)).absolute for each in (task, again))
        torch.testing.assert_close(other.flatten(), one.flatten())


def test_what_no_table_holds_is_refused():
    task = ta.Task(ta.constant_curvature(torch.tensor([1.0, 2.0]).double(), 0.5, 3), [0.0] * 3)
    with pytest.raises(ValueError, match="task: must have one shape, one base"):
        task_to_toml(NamedTask("a", task))
