"""Pictures in space: what is drawn is what was found."""

import math

import matplotlib
import numpy as np
import pytest
import torch

import torcharm as ta
from torcharm import plot

matplotlib.use("Agg")


@pytest.fixture
def axes():
    from matplotlib import pyplot

    figure = pyplot.figure()
    yield figure.add_subplot(projection="3d")
    pyplot.close(figure)


def ring_arm(**options):
    models = [ta.Bellows()] * 3 + [ta.McKibben()] * 3
    offsets = torch.cat((ta.ring(0.06, 3), ta.ring(0.02, 3, phase=math.pi / 3)))
    return ta.ArmDesign(offsets=offsets, length=0.4, actuators=models, **options)


def one_task(**options):
    return ta.Task(ta.constant_curvature(1.2, 0.42, 6, direction=0.8), [1.0, -2.0, 1.5, 0.0, 0.0, 0.0], **options)


def labels(axes):
    return [line.get_label() for line in axes.lines if not line.get_label().startswith("_")]


def test_tubes_have_their_kinds_diameters_and_places(axes):
    arm, task = ring_arm(diameter=0.03), one_task()
    plot.arm_in_space(arm, task, ax=axes)
    tubes = [tube._faces.reshape(-1, 3) for tube in axes.collections[1:7]]  # after the base plate
    assert len(tubes) == 6
    assert {"bellows (3)", "muscle (3)", "centreline", "tip load, 2.69 N"} <= set(labels(axes))
    for tube, (y, z) in zip(tubes, arm.offsets.tolist(), strict=True):
        rim = tube[np.abs(tube[:, 2]) < 1e-12]  # in the base's plane, whose x is the body's y, and z the body's z
        assert np.allclose(np.hypot(rim[:, 0] - y, rim[:, 1] - z), 0.015)


def test_the_shape_that_is_reached_says_how_far_off_it_is(axes):
    arm, task = ring_arm(), one_task()
    found = ta.evaluate(arm, task)
    plot.arm_in_space(arm, task, reached=found.prediction.twists, ax=axes)
    assert f"tip reached, {1e3 * float(found.tip_error):.1f} mm off" in labels(axes)


def test_point_loads_masses_and_segments_are_drawn(axes):
    lower = ta.ArmDesign(offsets=ta.ring(0.05, 3), length=0.2, actuators=ta.Bellows(), mass=0.1)
    arm = ta.series([lower, ta.RigidLink(length=0.04, mass=0.05), lower, ta.RigidLink(length=0.02)])
    points = [ta.PointLoad([2.0, 0, 0, 0, 0, 0], segment=1, at=0.5, frame="body"), ta.PointLoad(mass=0.1)]
    shape = ta.constant_curvature(0.5, 0.22, 10, direction=1.0)
    task = ta.Task(shape, load=ta.ExternalLoad(gravity=True, points=points), segment_nodes=(5, 5))
    plot.arm_in_space(arm, task, ax=axes)
    assert {"point load, 2 N", "point load, 0.981 N"} <= set(labels(axes))
    centreline = next(line for line in axes.lines if line.get_label() == "centreline")
    x, z, y = (np.asarray(part) for part in centreline.get_data_3d())
    links = [link if link is None else link.end(3) for link in arm.links]
    tip = ta.poses(shape, task.base_pose, segment_nodes=(5, 5), links=links)[-1, :3, 3]
    assert np.allclose((x[-1], y[-1], z[-1]), tip)


def test_hulls_count_what_evaluate_counts(axes):
    arm = ring_arm()
    task = ta.Task(one_task().twists, ta.sample_loads(40, (8.0, 8.0, 8.0, 1.0, 1.0, 1.0)))
    inside = int((ta.evaluate(arm, task, ("absolute",)).absolute_per_node[:, 2] == 0).sum())
    plot.node_hull_in_space(arm, task, 2, ax=axes)
    assert f"required, inside: {inside} of 40" in labels(axes)
    panels = plot.hull_projections(arm, task, 2)
    assert all(f"required, inside: {inside} of 40" in labels(panel) for panel in panels)
    assert panels[0].get_xlabel() == panels[1].get_xlabel() != panels[2].get_xlabel()
    matplotlib.pyplot.close(panels[0].figure)


@pytest.mark.parametrize(
    ("call", "field"),
    [
        (lambda: plot.arm_in_space(ta.antagonistic_arm(), one_task()), "arm"),
        (lambda: plot.arm_in_space(ring_arm(), ta.Task(ta.constant_curvature(1.0), [0.0] * 3)), "task"),
        (lambda: plot.node_hull_in_space(ring_arm(), one_task(), 6), "node"),
        (lambda: plot.hull_projections(ring_arm(), one_task(), 1, axes=[]), "axes"),
    ],
)
def test_bad_input_names_the_field(call, field):
    with pytest.raises(ValueError, match=f"^{field}:"):
        call()
