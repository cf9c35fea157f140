"""Distances of the eight spatial scenes, with their series, links and weights, against an independent oracle."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from oracle import spatial as scenes

import torcharm as ta
from experiments.exactness.reference import distances
from torcharm.statics.external_load import HULL, task_wrench

NEAR = 2e-7
"""Of max|H - w|, what the oracle, which samples curves, is good to."""


@pytest.mark.parametrize("scene", scenes.SCENES, ids=lambda scene: scene.name)
@pytest.mark.parametrize("metric", ["absolute", "relative"])
def test_distances_are_the_oracles(scene, metric):
    arm, task = scenes.arm_and_task(scene)
    found = ta.evaluate(arm, task, metric)
    assert found.converged
    low, high, size = (
        np.concatenate(part) for part in zip(*map(distances, scenes.node_sets(scene, metric)), strict=True)
    )
    value = getattr(found, f"{metric}_per_node").numpy()
    assert (high - low <= NEAR * size).all()
    assert (value >= low - NEAR * size).all()
    assert (value <= high + NEAR * size).all()
    assert (value > 0).any()


@pytest.mark.parametrize("metric", ["absolute", "relative"])
def test_a_series_is_its_segments_each_with_what_the_rest_asks_of_it(metric):
    """By hand: the lower segment alone, under the wrench that the upper one hands on at its base."""
    arm, task = scenes.arm_and_task(scenes.SCENES[5])
    found = getattr(ta.evaluate(arm, task, metric), f"{metric}_per_node")
    required = task_wrench(arm, task)[..., list(HULL[6])]
    first = 0
    for segment, count in zip(arm.segments, task.segment_nodes, strict=True):
        part = slice(first, first + count)
        alone = distances_of(segment, task.twists[part], required[part], metric)
        assert found[part].numpy() == pytest.approx(alone.numpy(), abs=1e-11)
        first += count


def distances_of(arm, twists, required, metric):
    """Distances (N,) of wrenches that are given, by one load a node that asks it of that node and the first."""
    from torcharm.statics.cross_section import cross_sections
    from torcharm.wrench_sets.distance import find_nearest

    sections = cross_sections(arm.flatten()[:, None], twists[None])
    wanted = required[None, None, None]
    found = find_nearest(sections, wanted, (1.0, 1.0), relative=metric == "relative", signed=False, points=False)
    return found.distance[0, 0, 0]


def test_relative_sets_refer_to_the_first_node_of_the_own_segment():
    arm, task = scenes.arm_and_task(scenes.SCENES[6])
    found = ta.evaluate(arm, task, "relative").relative_per_node
    firsts = [0, task.segment_nodes[0]]
    assert (found[firsts] == 0).all()
    assert (found[[firsts[1] - 1, firsts[1] + 1]] > 0).all()


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_own_weight_is_that_of_many_points_along_the_arm(dimension):
    nodes, mass, parts = 6, 0.5, 3
    twists = torch.zeros(nodes, 3 if dimension == 2 else 6, dtype=torch.float64)
    twists[:, 0], twists[:, -1] = 0.4, torch.linspace(-0.8, 1.4, nodes, dtype=torch.float64)
    offsets = ta.ring(0.04, 3)
    across = {"offsets": offsets} if dimension == 3 else {"radii": offsets[:, 0]}
    arm = ta.ArmDesign(**across, length=0.38, actuators=ta.Bellows())
    heavy = arm.with_values(arm.radii, arm.length, arm.max_pressure)
    heavy = ta.ArmDesign(**across, length=0.38, actuators=ta.Bellows(), mass=mass)
    places, weights = np.polynomial.legendre.leggauss(parts)
    points = [
        ta.PointLoad(mass=mass / nodes * weight / 2, at=(element + (1 + place) / 2) / nodes)
        for element in range(nodes)
        for place, weight in zip(places, weights, strict=True)
    ]
    for at in ("start", "middle"):
        own = ta.evaluate(
            heavy, ta.Task(twists, load=ta.ExternalLoad(gravity=True), wrench_at=at), ("absolute", "relative")
        )
        load = ta.ExternalLoad(gravity=True, points=points)
        by_points = ta.evaluate(arm, ta.Task(twists, load=load, wrench_at=at), ("absolute", "relative"))
        assert float(own.absolute) > 0
        # at "middle" an element's points count by the share that lies before them, its weight by its outer half
        near = 1e-9 if at == "start" else 2e-3
        assert own.absolute_per_node.numpy() == pytest.approx(by_points.absolute_per_node.numpy(), abs=near)
        assert own.relative_per_node.numpy() == pytest.approx(by_points.relative_per_node.numpy(), abs=near)


def planar():
    twists = torch.zeros(8, 3, dtype=torch.float64)
    twists[:, 0], twists[:, 2] = 0.49, torch.linspace(-1.5, 0.8, 8, dtype=torch.float64)
    twists[:, 1] = 0.02
    loads = torch.tensor([[3.0, -2.0, 0.3], [-6.0, 1.0, -0.5], [0.0, 0.0, 0.0]], dtype=torch.float64)
    return ta.antagonistic_arm(), twists, loads


@pytest.mark.parametrize("wrench_at", ["start", "middle"])
@pytest.mark.parametrize("angle", [0.0, 0.7, math.pi / 2, -2.4])
def test_a_planar_arm_turned_into_any_plane_of_space_gives_the_planar_values(angle, wrench_at):
    """Offsets, curvatures and shears turn about the backbone, and the base turns back: the shape stays where it was."""
    arm, twists, loads = planar()
    arm = ta.ArmDesign(arm.radii, arm.length, arm.actuators, mass=0.4)
    cos, sin = math.cos(angle), math.sin(angle)
    space = twists.new_zeros(8, 6)
    space[:, 0] = twists[:, 0]
    space[:, 1], space[:, 2] = cos * twists[:, 1], sin * twists[:, 1]
    space[:, 4], space[:, 5] = -sin * twists[:, 2], cos * twists[:, 2]
    turned = ta.ArmDesign(
        offsets=torch.stack((cos * arm.radii, sin * arm.radii), -1),
        length=arm.length,
        actuators=arm.actuators,
        mass=0.4,
    )
    tip = loads.new_zeros(3, 6)
    tip[:, :2], tip[:, 5] = loads[:, :2], loads[:, 2]
    body, body_space = (0.5, 1.0, 0.1), (0.5, cos, sin, 0.0, -0.1 * sin, 0.1 * cos)
    base = torch.from_numpy(scenes.hanging(roll=-angle))
    values = []
    for design, shape, load, point, pose in (
        (arm, twists, loads, body, None),
        (turned, space, tip, body_space, base),
    ):
        every = ta.ExternalLoad(load, gravity=True, points=[ta.PointLoad(point, at=0.6, frame="body")])
        task = ta.Task(shape, load=every, base_pose=pose, wrench_at=wrench_at)
        values.append(ta.evaluate(design, task, ("absolute", "relative")))
    flat, found = values
    assert (flat.absolute_per_node > 0).any()
    for name in ("absolute_per_node", "relative_per_node"):
        assert getattr(found, name).numpy() == pytest.approx(getattr(flat, name).numpy(), abs=1e-9)


def test_the_scene_of_a_turned_plane_is_planar_but_for_its_load():
    scene = scenes.SCENES[7]
    load = scenes.Load((3.0, -2.0, 0.0, 0.0, 0.0, 0.3))
    arm, task = scenes.arm_and_task(replace(scene, loads=(load,)))
    twists = torch.zeros(10, 3, dtype=torch.float64)
    twists[:, 0], twists[:, 2] = 0.49, torch.linspace(1.2, 0.2, 10, dtype=torch.float64)
    flat = ta.evaluate(
        ta.antagonistic_arm(),
        ta.Task(twists, torch.tensor([3.0, -2.0, 0.3], dtype=torch.float64), wrench_at="start"),
        ("absolute", "relative"),
    )
    found = ta.evaluate(arm, task, ("absolute", "relative"))
    assert found.absolute_per_node.numpy() == pytest.approx(flat.absolute_per_node.numpy(), abs=1e-9)
    assert found.relative_per_node.numpy() == pytest.approx(flat.relative_per_node.numpy(), abs=1e-9)
