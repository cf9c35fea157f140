"""Arms cut into segments are the same arms, and relative sets refer to the first node of the own segment."""

import math
from dataclasses import dataclass

import pytest
import torch

import torcharm as ta
from experiments.segments import scenes
from experiments.segments.run import by_aim


@pytest.mark.parametrize("kind", list(scenes.KINDS))
@pytest.mark.parametrize("count", scenes.SEGMENTS)
def test_cut_into_segments_it_is_the_same_curve_in_the_characterised_range(kind, count):
    arm = scenes.arm(kind, count)
    for twists in scenes.shapes(kind).values():
        task = scenes.task(twists, count)
        whole = ta.poses(twists)
        torch.testing.assert_close(ta.poses(task.twists, segment_nodes=task.segment_nodes), whole, rtol=0, atol=1e-12)
        assert bool(ta.evaluate(arm, task, ("absolute",)).shape_in_range)


def test_what_nodes_lack_by_themselves_does_not_depend_on_the_segments():
    twists = scenes.shapes("antagonistic")["helix"]
    found = [
        ta.evaluate(scenes.arm("antagonistic", count), scenes.task(twists, count), ("absolute", "relative"))
        for count in scenes.SEGMENTS
    ]
    for one in found[1:]:
        torch.testing.assert_close(one.absolute_per_node, found[0].absolute_per_node, rtol=0, atol=1e-9)
        assert one.relative < found[0].relative


def test_one_segment_misses_the_s_and_two_hold_it():
    twists = scenes.shapes("antagonistic")["S of two arcs"]
    one, two = (next(by_aim("antagonistic", "S of two arcs", twists, count)) for count in (1, 2))
    assert one.searched_mm > 40
    assert two.searched_mm < 2
    for row in (one, two):
        assert row.predicted_mm == pytest.approx(row.searched_mm, abs=0.01)
        assert row.shape_mm == pytest.approx(row.searched_mm, abs=1e-3)


@dataclass(frozen=True)
class Softening:
    """A push that strain takes away: `f = p (1 - 2 ε)` [N, kPa]."""

    bending_stiffness: float = 0.0
    max_pressure: float = 10.0
    strain_range: tuple[float, float] = (-0.5, 0.5)
    pressure_range: tuple[float, float] = (0.0, 10.0)

    def force(self, strain, pressure):
        return pressure * (1 - 2 * strain)


def test_relative_wrenches_of_two_segments_by_hand():
    """A straight arm of two segments with two nodes each, under 1 N sideways at its tip; wrenches at elements' starts.

    Elements are 0.1 m, but the last, which is stretched by a tenth to 0.11 m: moments of 0.41, 0.31, 0.21 and 0.11 N·m.
    Less that of the own segment's first node, all ask for a change of 0, 0.1, 0, 0.1 N·m in size, and no force.

    The second segment's actuator, at 0.05 m, is stretched by 0.1 at its second node: what it can add there to the first
    node is `Δf (1, -r) = p (-0.2, 0.01)`, p from 0 to 10 kPa. The first segment's adds nothing.
    """
    arm = ta.series([ta.ArmDesign(radii=[0.05], length=0.2, actuators=[Softening()])] * 2)
    twists = [[0.2, 0.0, 0.0]] * 3 + [[0.22, 0.0, 0.0]]
    lacks = []
    for side in (1.0, -1.0):
        task = ta.Task(twists, [side, 0.0, 0.0], wrench_at="start", segment_nodes=(2, 2))
        found = ta.evaluate(arm, task, ("relative",)).relative_per_node.tolist()
        assert found[:3] == pytest.approx([0.0, 0.1, 0.0], abs=1e-12)
        lacks.append(found[3])
    # From w = (0, m) the nearest p a, a = (-0.2, 0.01), is at p = w·a / a·a = m/4.01 where that is above 0. A load to
    # the right (+x) asks for a moment of the other sign than one to the left: the actuator helps with one of them.
    along = 0.1 * 0.01 / math.hypot(0.2, 0.01)
    assert sorted(lacks) == pytest.approx([math.sqrt(0.1**2 - along**2), 0.1], rel=1e-9)
    # A force to the right turns a hanging arm by +F d about z, so that nodes have to provide -0.21 and -0.11 N·m:
    # the difference is +0.1, and the actuator's +0.01 p helps.
    assert lacks[0] < lacks[1]


def test_a_load_on_the_first_segment_asks_nothing_of_the_second():
    """1 N sideways at the middle of the first segment's second element, by hand: 0.15, 0.05 N·m, then nothing."""
    arm = ta.series([ta.ArmDesign(radii=[0.05], length=0.2, actuators=[Softening()])] * 2)
    load = ta.ExternalLoad(points=[ta.PointLoad([1.0, 0.0, 0.0], segment=0, at=0.75)])
    task = ta.Task([[0.2, 0.0, 0.0]] * 4, load=load, wrench_at="start", segment_nodes=(2, 2))
    found = ta.evaluate(arm, task, ("relative",)).relative_per_node
    assert found.tolist() == pytest.approx([0.0, 0.1, 0.0, 0.0], abs=1e-12)
    single = ta.ArmDesign(radii=[0.05], length=0.4, actuators=[Softening()])
    load = ta.ExternalLoad(points=[ta.PointLoad([1.0, 0.0, 0.0], at=0.375)])
    whole = ta.evaluate(single, ta.Task([[0.4, 0.0, 0.0]] * 4, load=load, wrench_at="start"), ("relative",))
    assert whole.relative_per_node.tolist() == pytest.approx([0.0, 0.1, 0.15, 0.15], abs=1e-12)
