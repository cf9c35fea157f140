"""Verdicts: one word a task, and the reason why a task is not held."""

import math
import pickle
import re
from dataclasses import replace

import numpy as np
import pytest
import torch

import torcharm as ta
from torcharm.attainability.reasons import at_limits, differences, told_apart

D = torch.float64
ARM = ta.antagonistic_arm(0.05, 0.015, 0.5)
BENT = ta.affine_curvature(0.0, 1.0)
LOADS = ta.sample_loads(12, (4.0, 4.0, 0.4))


@pytest.fixture(scope="module")
def found():
    return ta.evaluate(ARM, ta.Task(BENT, LOADS))


def test_held_is_within_all_tolerances_and_sure(found):
    tip = 0.02 * 0.5
    sure = found.prediction.converged & found.prediction.stable & found.prediction.reached
    near = (found.tip_error <= tip) & (found.shape_error <= tip) & (found.tip_rotation_error <= math.radians(5))
    assert (found.verdict == "held").tolist() == (sure & near).tolist()
    assert (found.verdict == "held").sum() > 6
    assert [bool(reason) for reason in found.reason] == [word != "held" for word in found.verdict]


@pytest.mark.parametrize(
    ("field", "said"), [("tip", "tip off by"), ("rotation", "tip turned by"), ("shape", "shape off by")]
)
def test_each_tolerance_is_missed_alone(found, field, said):
    """A tolerance of nothing makes a miss of everything that was held, and says which it was."""
    strict = replace(found, tolerance=replace(ta.PoseTolerance(tip=1.0, rotation=3.0, shape=1.0), **{field: 1e-9}))
    held = replace(found, tolerance=ta.PoseTolerance(tip=1.0, rotation=3.0, shape=1.0))
    assert (strict.verdict[held.verdict == "held"] == "missed").all()
    assert all(
        reason.startswith(said) for reason, word in zip(strict.reason, strict.verdict, strict=True) if word == "missed"
    )


def test_what_is_missed_says_what_the_arm_does_wrong():
    """Of a shape of one curvature the bend is the angle from base to tip."""
    length, angle = 0.75, 1.0
    arm = ta.ArmDesign([-0.05, 0.05], 0.5, ta.Bellows(), 6.0)
    found = ta.evaluate(arm, ta.Task(ta.constant_curvature(angle, length), [0.0, 1.0, 0.0]))
    twists = found.prediction.twists
    short, little = (100 * (1 - float(part)) for part in (twists[:, 0].mean() / length, twists[:, 2].mean() / angle))
    assert min(short, little) > 1
    assert float(found.pressure[0]) == 6.0 > float(found.pressure[1]) > 0
    assert found.verdict == "missed"
    said = f": {short:.2g} % too short, bends {little:.2g} % too little; actuator 1 at its limit; "
    assert re.search(said + r"(no pressure serves all nodes: )?node \d+ lacks [\d.]+ N", found.reason)


@pytest.mark.parametrize(
    ("curvature", "direction", "reached", "said"),
    [
        (1.0, None, (1.1, None, 0.52), "4 % too long, bends 10 % too much"),
        (1.0, None, (-0.4, None, 0.5), "bends to the other side"),
        (1.0, None, (-0.02, None, 0.5), "bends 100 % too little"),
        (1.0, None, (1.004, None, 0.501), ""),
        (0.0, None, (0.3, None, 0.45), "10 % too short, bends by 34°, the task does not"),
        (0.5, 1.0, (0.25, 1.0, 0.5), "bends 50 % too little"),
        (1.0, 1.0, (1.0, 1.0 + math.pi / 6, 0.5), "bends 13 % too little, bends 57° sideways"),
    ],
)
def test_differences_of_shapes_in_words(curvature, direction, reached, said):
    """Of two segments of that shape, whose angles add up."""
    wanted = ta.constant_curvature(curvature, 0.5, 4, direction)
    assert differences(wanted, ta.constant_curvature(reached[0], reached[2], 4, reached[1]), (1, 3)) == said


def test_a_shape_of_two_bends_has_a_bend_of_its_own():
    wanted = ta.affine_curvature(-2.0, 1.0)
    half = wanted * torch.tensor([1.0, 1.0, 0.5], dtype=D)
    assert differences(wanted, half, (10,)) == "bends 50 % too little"


def test_pressures_at_limits_are_those_of_driven_actuators():
    limit = torch.tensor([50.0, 0.0, 100.0, 50.0], dtype=D)
    assert at_limits(torch.tensor([50.0, 0.0, 100.0, 0.0], dtype=D), limit) == (
        "actuators 1, 3 at their limit, actuator 4 without pressure"
    )
    assert at_limits(0.5 * limit, limit) == ""


def test_a_number_is_the_tips_tolerance():
    task = ta.Task(BENT, [0.0, 0.0, 0.0])
    assert ta.evaluate(ARM, task, tolerance=0.005).tolerance == ta.PoseTolerance(tip=0.005)
    for wrong in (0.0, -1.0, math.nan):
        with pytest.raises(ValueError, match="tolerance: must be a finite number and above 0"):
            ta.evaluate(ARM, task, tolerance=wrong)
    with pytest.raises(ValueError, match=r"tolerance\.rotation: must be a finite number and above 0"):
        ta.PoseTolerance(rotation=-1.0)


def test_the_default_tolerance_grows_with_the_arm():
    big = ta.antagonistic_arm(0.1, 0.03, 1.0)
    tip, shape = ta.PoseTolerance().lengths(big)
    assert float(tip) == float(shape) == pytest.approx(0.02)
    both = ta.series([ARM, ta.RigidLink(length=0.1), ARM])
    assert float(ta.PoseTolerance().lengths(both)[0]) == pytest.approx(0.02)


@pytest.mark.parametrize(("beyond", "within"), [(5e-5, True), (9e-4, True), (2e-3, False), (0.05, False)])
def test_a_strain_that_no_bench_tells_from_the_end_of_a_range_is_at_it(beyond, within):
    stiff = ta.PolynomialActuator(((1, 0, -2000.0), (0, 1, 0.1)), (-0.25, 0.0), (0.0, 60.0), 60.0)
    arm = ta.ArmDesign([-0.05, 0.05], 0.4, [stiff] * 2)
    found = ta.evaluate(arm, ta.Task(ta.affine_curvature(0.0, 0.0, length=0.4 * (1 + beyond)), [0.0, 0.0, 0.0]))
    assert bool(found.in_range) is within
    assert within or "characterised from -0.25 to 0" in found.reason


def test_what_was_not_characterised_is_excluded():
    squeezed = ta.evaluate(ARM, ta.Task(ta.affine_curvature(0.0, 1.0, length=0.44), [0.0, 0.0, 0.0]))
    assert squeezed.verdict == "excluded by range"
    assert squeezed.reason == "actuator 4 is strained to -0.22 at node 1, characterised from -0.17 to +0.67"
    barely = told_apart(-0.1714, -0.17, 0.67)
    assert barely == "-0.171"  # not -0.17, beyond -0.17
    strong = ta.ArmDesign(ARM.radii, ARM.length, ARM.actuators, [95.0, 100.0, 100.0, 50.0])
    driven = ta.evaluate(strong, ta.Task(BENT, [0.0, 0.0, 0.0]))
    assert driven.verdict == "excluded by range"
    assert driven.reason == "actuator 1 is driven to 95 kPa, characterised to 92 kPa"


def test_what_nodes_lack_besides_is_told_with_strains_out_of_range():
    """Where it is much: a load that no pressure holds is a larger cause than a strain."""
    squeezed = ta.affine_curvature(0.0, 1.0, length=0.44)
    found = ta.evaluate(ARM, ta.Task(squeezed, [-100.0, 0.0, 0.0]))
    assert found.verdict == "excluded by range"
    node, lacks = int(found.worst_node) + 1, float(found.worst_miss)
    assert found.reason.startswith("actuator 4 is strained to -0.22 at node 1")
    assert found.reason.endswith(f"; node {node} lacks {lacks:.3g} N of force and moment (N·m counted as N) besides")


def test_what_is_not_found_is_undecided():
    """A single muscle under compression: no stable equilibrium near the shape."""
    arm = ta.ArmDesign([-0.052], 0.5, [ta.McKibben()])
    task = ta.Task(ta.affine_curvature(0.2, -0.1, length=0.44, nodes=6), [0.0, 8.0, 0.0])
    found = ta.evaluate(arm, task)
    assert found.verdict == "undecided"
    assert found.reason.startswith("no stable equilibrium near the task's shape was found")


@pytest.mark.parametrize(
    ("twists", "question"),
    [
        (ta.affine_curvature(0.0, 60.0), "a bend of 60 rad, 9.55 turns: are curvatures in degrees?"),
        (ta.affine_curvature(0.0, 0.5, length=480.0), "lengths of up to 480 m: are they in millimetres?"),
        (
            torch.tensor([[0.05, 0.0, 0.1]] * 10, dtype=D),
            "each of 10 rows has l = 0.05 m, an element's part of 0.5 m: l and κ are those of the whole arm, "
            "were they divided by the number of nodes?",
        ),
    ],
)
def test_wrong_units_are_asked_about(twists, question):
    found = ta.evaluate(ARM, ta.Task(twists, [0.0, -1.0, 0.0]))
    assert found.verdict in ("impossible", "excluded by range")
    assert found.reason.endswith(question)


def test_arms_in_millimetres_are_asked_about():
    arm = ta.ArmDesign([-50.0, 50.0], 0.5, ta.Bellows())
    found = ta.evaluate(arm, ta.Task(BENT, [0.0, -1.0, 0.0]))
    assert found.verdict == "impossible"
    assert found.reason.endswith("radii: 50 m, more than the arm is long: are they in millimetres?")


@pytest.mark.parametrize(
    ("limit", "unit"), [(1.2, "1.2 kPa is 1.3 % of the 92 kPa that were characterised: is it in bar?"), (0.02, "MPa?")]
)
def test_limits_in_other_units_are_asked_about(limit, unit):
    found = ta.evaluate(ta.ArmDesign([-0.05, 0.05], 0.5, ta.Bellows(), [limit, 0.0]), ta.Task(BENT, [0.0, 0.0, 0.0]))
    assert found.verdict == "missed"
    assert found.reason.endswith(unit)
    passive = ta.ArmDesign([-0.01, 0.01], 0.5, [ta.elastic_core(40.0, 1e-3), ta.Bellows()], [0.5, 50.0])
    fine = ta.evaluate(passive, ta.Task(BENT, [0.0, 0.0, 0.0]), "absolute")
    assert "max_pressure" not in fine.reason


def test_a_limit_of_a_chamber_in_bar_is_asked_about():
    """It is all that is characterised of a chamber. Without pressure it is passive, and nothing is asked."""
    models = [*[ta.chamber(8e-5, max_pressure=0.8)] * 2, ta.elastic_core(40.0, 1e-3)]
    offsets, task = [[0.01, 0.0], [-0.01, 0.0], [0.0, 0.0]], ta.Task([[0.12, 0.0, 0.0, 0.0, 0.0, 1.0]] * 4)
    found = ta.evaluate(ta.ArmDesign(offsets=offsets, length=0.1, actuators=models), task)
    assert found.verdict == "missed"
    assert found.reason.endswith("max_pressure: 0.8 kPa: the unit is kilopascal, 0.8 bar is written '0.8 bar'")
    for limits in ([0.0, 0.0, 0.0], [80.0, 2.0, 0.5]):
        fine = ta.evaluate(ta.ArmDesign(offsets=offsets, length=0.1, actuators=models, max_pressure=limits), task)
        assert "kilopascal" not in fine.reason


def test_the_end_of_a_range_is_within_it():
    """In single precision a limit is not what it is in double, and an equilibrium has a residual."""
    model = ta.PolynomialActuator(((1, 0, -120.0), (0, 1, 0.9)), (-0.1, 0.1), (0.0, 70.3), 70.3, -0.05)
    arm = ta.ArmDesign([-0.05, 0.05], 0.5, [model, model]).to(torch.float32)
    for task in (ta.Task([[0.55, 0.0, 0.0]] * 4, [0.0, 0.0, 0.0]), ta.Task([[0.5, 0.0, 0.2]] * 4, [0.0, 0.0, 0.0])):
        for own in (task, task.to(torch.float32)):
            found = ta.evaluate(arm, own)
            assert bool(found.in_range)
            assert found.verdict in ("held", "missed")


def test_a_centreline_without_length_is_impossible():
    arm = ta.ArmDesign([0.03, 0.06], 0.05, ta.Bellows(strain_range=(-0.99, 5.0)))
    found = ta.evaluate(arm, ta.Task([[-0.01, 0.0, -1.0]], [0.0, 0.0, 0.0]))
    assert found.verdict == "impossible"
    assert found.reason == "the centreline of the shape would have no length"
    assert found.to_dict()["verdict"] == ["impossible"]


def test_segments_whose_batches_broadcast():
    one = ta.ArmDesign([-0.05, 0.05], 0.3, ta.Bellows())
    three = ta.ArmDesign([-0.05, 0.05], torch.tensor([0.2, 0.21, 0.22], dtype=D)[:, None], ta.Bellows())
    twists = torch.tensor([[0.3, 0.0, 0.0]] * 2 + [[0.2, 0.0, 0.0]] * 2, dtype=D)
    found = ta.evaluate(ta.series([one, three]), ta.Task(twists, [0.0, 0.0, 0.0], segment_nodes=(2, 2)))
    assert found.verdict.shape == found.reason.shape == (3,)
    assert ta.PoseTolerance().lengths(ta.series([one, three]))[0].tolist() == pytest.approx([0.01, 0.0102, 0.0104])


def test_a_prediction_without_sets_excludes_nothing():
    found = ta.evaluate(ARM, ta.Task(BENT, [0.0, 0.0, 0.0]), "predicted_error")
    assert found.not_excluded is found.worst_node is found.worst_miss is None
    assert found.verdict in ("held", "missed", "undecided")


def test_sets_alone_only_exclude():
    task = ta.Task(BENT, torch.tensor([[0.0, 0.0, 0.0], [0.0, 300.0, 0.0]], dtype=D))
    found = ta.evaluate(ARM, task, ("absolute",))
    assert found.verdict is None
    assert found.tip_error is found.shape_error is found.pressure is found.capacity_margin is None
    assert found.not_excluded.tolist() == [True, False]
    assert found.reason[0] == ""
    worst = int(found.worst_node[1])
    miss = float(found.absolute_per_node[1, worst])
    assert miss == float(found.absolute_per_node[1].max()) == float(found.worst_miss[1])
    assert found.reason[1] == f"node {worst + 1} lacks {miss:.3g} N of force and moment (N·m counted as N)"
    weighted = ta.evaluate(ARM, task, ("absolute",), weights=(1.0, 25.0))
    assert weighted.reason[1].endswith(" of force and moment (squared: 1 f² + 25 m²)")
    relative = ta.evaluate(ARM, task, ("relative",)).reason[1]
    assert "N of change from the base in force and moment (N·m counted as N)" in relative


def test_the_margin_is_positive_inside():
    task = ta.Task(BENT, torch.tensor([[0.0, 0.0, 0.0], [0.0, 300.0, 0.0]], dtype=D))
    found = ta.evaluate(ARM, task, ("absolute",), signed=True)
    torch.testing.assert_close(found.capacity_margin, -found.absolute_per_node.amax(-1))
    assert found.capacity_margin[0] > 0 > found.capacity_margin[1]


def test_batches_are_judged_one_by_one():
    arms = ta.antagonistic_arm(torch.tensor([0.05, 0.08], dtype=D), 0.015, torch.tensor([0.5, 0.45], dtype=D))
    task = ta.Task(torch.stack((BENT, ta.affine_curvature(0.0, 60.0))), LOADS[:1])
    found = ta.evaluate(arms, task)
    assert found.verdict.shape == found.reason.shape == (2, 2)
    for design in range(2):
        for shape in range(2):
            one = ta.evaluate(arms[design], ta.Task(task.twists[shape], LOADS[0]))
            assert one.verdict == found.verdict[design, shape]
            assert one.reason == found.reason[design, shape]


def test_segments_in_series_are_judged_as_one_arm():
    arm = ta.series([ta.ArmDesign([-0.05, 0.05], 0.3, ta.Bellows()), ta.ArmDesign([-0.05, 0.05], 0.2, ta.Bellows())])
    twists = torch.tensor([[0.3, 0.0, 0.0]] * 3 + [[0.15, 0.0, 0.0]] * 3, dtype=D)
    found = ta.evaluate(arm, ta.Task(twists, [0.0, 0.0, 0.0], segment_nodes=(3, 3)))
    assert found.verdict == "excluded by range"
    assert found.reason.startswith("actuator 3 is strained to -0.25 at node 4, characterised from -0.17 to +0.67; node")


def test_a_table_of_all_that_was_found(found):
    columns = found.to_dict()
    assert columns["verdict"] == found.verdict.tolist()
    assert columns["tip_error"] == found.tip_error.tolist()
    assert columns["design"] == [0] * 12
    assert columns["task"] == list(range(12))
    assert [columns[f"pressure_{index}"][3] for index in range(1, 5)] == found.pressure[3].tolist()
    assert {len(column) for column in columns.values()} == {12}
    frame = pytest.importorskip("pandas").DataFrame(columns)
    assert found.to_frame().equals(frame)


def test_a_result_is_short_and_survives_pickle(found):
    counts = dict(zip(*np.unique(found.verdict, return_counts=True), strict=True))
    said = ", ".join(f"{count} {word}" for word, count in counts.items())
    assert repr(found) == f"Attainability(batch (12,), {said})"
    again = pickle.loads(pickle.dumps(found))
    assert again.verdict.tolist() == found.verdict.tolist()
    assert torch.equal(again.tip_error, found.tip_error)


def test_errors_do_not_grow_with_the_number_of_nodes():
    """The tip's and the shape's errors are those of the arm, not of its discretisation; the paper's sum grows."""
    arm, load = ta.antagonistic_arm(), torch.tensor([0.0, 1.0, 0.2], dtype=D)
    found = [
        ta.evaluate(arm, ta.Task(ta.affine_curvature(0.0, 2.5, nodes=nodes), load), "predicted_error")
        for nodes in (10, 20, 40)
    ]
    tips = torch.stack([one.tip_error for one in found])
    shapes = torch.stack([one.shape_error for one in found])
    sums = torch.stack([one.prediction.cost for one in found])
    assert float((tips / tips[-1] - 1).abs().max()) < 0.1
    rest = (shapes[:2] / shapes[-1] - 1).abs()
    assert rest[1] < 0.5 * rest[0] < 0.1  # the weights on nodes are those of an integral, to first order
    assert float(sums[-1] / sums[0]) > 3
