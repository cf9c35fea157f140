"""States of a page: what events make of them, and that they stand for the study's own arms and tasks."""

import math
from dataclasses import replace

import pytest
import torch
from page_cases import plane, space

from torcharm.page import state as page
from torcharm.page.controls import controls, same_controls
from torcharm.page.state import BEST, BY_HAND


@pytest.mark.parametrize("make", [plane, space])
def test_a_page_begins_with_the_study_as_it_is(make):
    state = make()
    task, given = page.task_of(state), state.given
    assert torch.equal(task.twists, given.twists)
    assert torch.equal(task.tip_load, given.tip_load)
    assert (task.load.gravity, len(task.load.points)) == (given.load.gravity, len(given.load.points))
    assert (task.wrench_at, task.segment_nodes) == (given.wrench_at, given.segment_nodes)
    assert not page.changed_task(state)


def test_actuators_that_are_alike_are_changed_together():
    state = plane()
    assert [(group.kind, group.members) for group in page.groups(state.named_arm.design)] == [
        ("bellows", (0, 3)),
        ("mckibben", (1, 2)),
    ]
    wider = page.with_value(page.with_value(state, 0, "distance", 0.06), 1, "limit", 80.0)
    arm = page.design_of(wider)
    assert arm.radii.abs().tolist() == pytest.approx([0.06, 0.015, 0.015, 0.06])
    assert torch.equal(arm.radii.sign(), state.named_arm.design.radii.sign())
    assert arm.max_pressure.tolist() == [50.0, 80.0, 80.0, 50.0]
    assert arm.mass.item() == 0.2


def test_of_segments_each_has_its_own():
    state = page.with_value(space(), 1, "distance", 0.06)
    first, second = page.design_of(state).segments
    given = state.named_arm.design
    assert torch.equal(first.offsets, given.segments[0].offsets)
    torch.testing.assert_close(second.offsets, 1.5 * given.segments[1].offsets)
    assert page.design_of(state).links == given.links


def test_values_end_where_their_range_ends_and_what_a_control_cannot_have_changes_nothing():
    state = plane()
    known = {control.key: control for control in controls(state)}
    assert known["length 0"].moved(state, 9e3).designs[0][0].length == pytest.approx(0.75)
    assert known["distance 0"].moved(state, -1.0).designs[0][0].distance == pytest.approx(0.01)
    assert known["tip 0"].moved(state, 1e9).tip[0] == page.tip_range(state)[0] == 2.0
    assert page.with_force(state, (1e9, -1e9, 1.0)).tip[:2] == (2.0, -2.0)
    for control in known.values():
        if not isinstance(control.value(state), bool):
            for bad in (math.nan, math.inf, -math.inf, "?", [1, {}], None):
                assert control.moved(state, bad) == state


def test_without_gravity_masses_are_left_out_and_wrenches_stay():
    state = plane()
    light = page.task_of(replace(state, gravity=False)).load
    assert [point.wrench is not None for point in light.points] == [True]
    heavy = page.task_of(page.with_payload(state, 0.1)).load
    assert len(heavy.points) == len(state.given.load.points) + 1
    assert heavy.points[-1].mass.item() == pytest.approx(0.1)


def test_pressures_are_moved_by_hand_alone_and_end_at_their_limit():
    state = plane()
    first = next(control for control in controls(state) if control.key == "pressure 0")
    assert first.moved(state, 20.0) == state
    by_hand = first.moved(replace(state, mode=BY_HAND, pressure=(1.0, 2.0, 3.0, 4.0)), 50.0)
    assert by_hand.pressure == (50.0, 2.0, 3.0, 4.0)
    assert page.pressure_of(page.with_value(by_hand, 0, "limit", 30.0))[0] == 30.0


def test_another_task_or_arm_begins_as_the_study_has_it_and_designs_stay():
    start = plane()
    state = page.with_payload(page.with_tip(page.with_value(start, 0, "length", 0.6), 0, 1.0), 0.1)
    other = page.with_arm(state, 1)
    assert (other.payload, other.tip, other.mode, other.twists) == (0.0, (0.0, -1.0, 0.0), BEST, None)
    assert page.with_arm(other, 0).designs[0][0].length == 0.6
    assert page.with_load(state, 1).tip == (1.0, 0.0, 0.05)
    assert not same_controls(state, other)
    both = page.with_value(other, 0, "length", 0.4)
    assert page.as_given(both).designs == (state.designs[0], start.designs[1])
    assert page.as_given(replace(state, mode=BY_HAND)) == replace(start, node=state.node)


def test_another_arm_has_the_same_task_and_load_where_it_can():
    start = plane()
    for task in range(len(start.study.tasks_of(start.named_arm))):
        state = page.with_task(start, task)
        name, other = state.named_task.name, page.with_arm(state, 1)
        own = [one.name for one in other.study.tasks_of(other.named_arm)]
        assert other.named_task.name == (name if name in own else own[0])
    under = page.with_load(start, 1)
    assert page.with_arm(under, 1).load == 1


def test_a_payload_weighs():
    state = page.with_payload(replace(plane(), gravity=False), 0.1)
    assert state.gravity
    assert state.payload == 0.1
    assert not page.with_payload(replace(plane(), gravity=False), 0.0).gravity


def test_numbers_of_another_study_are_not_the_same():
    one = plane()
    assert one != plane()
    assert one == replace(one)


@pytest.mark.parametrize("make", [plane, space])
def test_controls_read_what_they_write(make):
    state = replace(make(), mode=BY_HAND)
    for control in controls(state):
        if control.ends is not None and control.enabled(state):
            low, high = control.ends
            for value in (low, high, low + 0.375 * (high - low)):
                moved = control.write(state, value)
                own = control.key.split()
                reach = (
                    min(value, page.design_of(state).max_pressure[int(own[1])].item())
                    if own[0] == "pressure"
                    else value
                )
                near = 0.51 if control.key in ("node", "load") else control.step
                assert control.value(moved) == pytest.approx(reach, abs=near)
        for option in control.options:
            assert control.value(control.write(state, option)) == option
    assert len({control.key for control in controls(state)}) == len(controls(state))


@pytest.mark.parametrize(("value", "rounded"), [(0.5, 0.5), (0.51, 1.0), (3.0, 5.0), (12.0, 20.0), (1e-3, 1e-3)])
def test_ranges_end_at_round_numbers(value, rounded):
    assert page.round_up(value) == pytest.approx(rounded)
