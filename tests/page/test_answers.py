"""Answers of a page, against what the library says of the same arm and task."""

import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from page_cases import PLANE, plane, space

import torcharm as ta
from torcharm.arm_series import ArmSeries
from torcharm.geometry import se3
from torcharm.page import state as page
from torcharm.page.answers import (
    _buckles,
    _tip_of,
    answer,
    followed,
    place_of_node,
    planned,
    same_reach,
    settled,
    swept,
)
from torcharm.page.scene import draw
from torcharm.page.state import BY_HAND, opened
from torcharm.study import parse_study


def tip_in_space(arm, task):
    """(4, 4) where a task's shape ends."""
    tip = _tip_of(arm, task)
    return (se3.from_plane(tip) if task.dimension == 2 else tip).numpy()


@pytest.mark.parametrize("make", [plane, space])
def test_the_best_for_the_task_is_what_evaluate_finds(make):
    state = replace(make(), node=3)
    found = answer(state)
    expected = ta.evaluate(page.design_of(state), page.task_of(state), signed=True)
    assert (found.verdict, found.reason) == (expected.verdict, expected.reason)
    assert found.pressure == pytest.approx(expected.pressure.tolist())
    assert found.margins.min() == pytest.approx(expected.capacity_margin.item())
    sets = ta.wrench_hulls(found.arm, found.task.twists, segment_nodes=found.task.segment_nodes).vertices[3]
    low, high = found.node_set.corners.min(0), found.node_set.corners.max(0)
    np.testing.assert_allclose(low, sets.min(0).values.numpy(), atol=1e-9)
    np.testing.assert_allclose(high, sets.max(0).values.numpy(), atol=1e-9)
    assert found.node_set.inside == (found.margins[3] >= 0)


@pytest.mark.parametrize("make", [plane, space])
def test_by_hand_at_the_best_pressures_it_is_as_good(make):
    best = answer(make())
    by_hand = answer(replace(settled(best), mode=BY_HAND))
    assert by_hand.found.tip_error.item() == pytest.approx(best.found.tip_error.item(), abs=1e-7)
    assert by_hand.found.shape_error.item() == pytest.approx(best.found.shape_error.item(), abs=1e-7)
    assert by_hand.verdict == best.verdict
    assert by_hand.twists == pytest.approx(best.twists, abs=1e-6)


def test_by_hand_nothing_is_said_of_pressures_that_were_not_tried():
    found = answer(replace(plane(), mode=BY_HAND))
    assert found.pressure == (0.0,) * 4
    equilibrium = ta.solve_equilibrium(
        found.arm, found.pressure, found.task.load, found.task.nodes, base_pose=found.task.base_pose
    )
    wanted = ta.poses(found.task.twists)[-1]
    off = (equilibrium.poses[-1] - wanted)[:2].norm().item()
    assert found.found.tip_error.item() == pytest.approx(off, rel=1e-9)
    if found.verdict == "missed":
        assert "at these pressures" in found.reason
    assert "no pressure" not in found.reason


def test_what_leaves_the_characterised_range_is_warned_of():
    found = answer(page.with_value(plane(), 0, "length", 0.75))
    assert found.verdict == "excluded by range"
    assert any("Out of range" in warning for warning in found.warnings)
    assert answer(plane()).warnings == ()


def test_torsion_that_pushing_actuators_take_away_is_warned_of():
    found = answer(space())
    soft = tuple(replace_torsion(one, 1e-4) for one in found.arm.segments)
    weak = ArmSeries(soft, found.arm.links)
    assert _buckles(weak, found.task, torch.full((6,), 40.0), found.twists)
    assert not _buckles(found.arm, found.task, torch.full((6,), 1.0), found.twists)


def replace_torsion(segment, stiffness):
    return ta.ArmDesign(
        offsets=segment.offsets, length=segment.length, actuators=segment.actuators, torsion_stiffness=stiffness
    )


@pytest.mark.parametrize("make", [plane, space])
def test_a_dragged_tip_is_followed_by_the_nearest_shape(make):
    state = make()
    task = page.task_of(state)
    arm = page.design_of(state)
    pose = tip_in_space(arm, task)
    assert followed(state, pose) == pytest.approx(task.twists, abs=1e-9)
    pose = pose.copy()
    pose[:3, 3] += [0.01, 0.02, 0.0]
    twists = followed(state, pose)
    moved = page.with_shape(state, twists)
    np.testing.assert_allclose(tip_in_space(arm, page.task_of(moved)), pose, atol=1e-7)
    assert page.changed_task(moved)
    pose[:3, 3] = 1e3
    assert followed(state, pose) is None


def test_a_plan_has_the_tip_and_lacks_less_than_the_shape_that_was_dragged():
    state = opened(parse_study(PLANE.replace("nodes = 6", "nodes = 3")))
    arm, pose = page.design_of(state), tip_in_space(page.design_of(state), page.task_of(state))
    turned = pose @ se3.from_plane(torch.tensor([0.0, 0.0, -0.5], dtype=torch.float64)).numpy()
    dragged = page.with_shape(state, followed(state, turned))
    twists, words = planned(dragged)
    assert words.startswith("Planned")
    moved = page.with_shape(dragged, twists)
    np.testing.assert_allclose(tip_in_space(arm, page.task_of(moved)), turned, atol=1e-6)
    before, after = (ta.evaluate(arm, page.task_of(one), ("absolute", "relative"), power=2) for one in (dragged, moved))
    assert before.absolute + before.relative > 0.01
    assert after.absolute + after.relative < before.absolute + before.relative


def test_nodes_count_over_segments():
    task = page.task_of(space())
    assert [place_of_node(task, node) for node in (0, 2, 3, 6)] == [(0, 0), (0, 2), (1, 0), (1, 3)]


@pytest.mark.parametrize("make", [plane, space])
def test_the_workspace_holds_the_tip_and_is_of_arm_and_load(make, monkeypatch):
    monkeypatch.setattr("torcharm.page.answers.STATES", 400)
    state = make()
    region, words = swept(state)
    assert re.search(r"reaches [\d.]+ (cm²|dm³) under this load", words)
    found = draw(replace(answer(state), region=region))
    assert "reach" in found
    assert found["reach"].properties["faces"].max() < len(found["reach"].points)
    assert ("reach_line_0" in found) == (region.points.shape[1] == 2)
    assert same_reach(state, replace(state, node=0))
    assert not same_reach(state, page.with_tip(state, 0, 0.123))
    assert not same_reach(state, page.with_value(state, 0, "length", 0.42))


def test_faces_of_a_workspace_in_space_are_seen_from_outside(monkeypatch):
    monkeypatch.setattr("torcharm.page.answers.STATES", 400)
    region, _ = swept(space())
    mesh = draw(replace(answer(space()), region=region))["reach"]
    corners = mesh.points[mesh.properties["faces"]]
    volume = np.linalg.det(corners - mesh.points.mean(0)).sum() / 6
    assert volume == pytest.approx(region.size)
