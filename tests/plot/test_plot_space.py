"""Pictures in space: what is drawn is what was found."""

import math

import matplotlib
import numpy as np
import pytest
import torch
from matplotlib.patches import FancyArrowPatch

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


def test_tubes_have_their_kinds_diameters_and_places(axes, monkeypatch):
    arm, task, tubes, draw = ring_arm(diameter=0.03), one_task(), [], axes.plot_surface

    def kept(*corners, **style):
        tubes.append(np.stack(corners, -1).reshape(-1, 3))
        return draw(*corners, **style)

    monkeypatch.setattr(axes, "plot_surface", kept)
    plot.arm_shape(arm, task, ax=axes)
    assert len(tubes) == 6
    assert {"bellows (3)", "mckibben (3)", "centreline", "tip load, 2.69 N"} <= set(labels(axes))
    for tube, (y, z) in zip(tubes, arm.offsets.tolist(), strict=True):
        rim = tube[np.abs(tube[:, 2]) < 1e-12]  # in the base's plane, whose x is the body's y, and z the body's z
        assert len(rim) > 3
        assert np.allclose(np.hypot(rim[:, 0] - y, rim[:, 1] - z), 0.015)


@pytest.mark.parametrize("force", [3.0, 0.003])
def test_arrows_have_heads_however_short_they_are(axes, force):
    """Beside a weight that sets the scale."""
    arm = ring_arm(mass=0.5)
    load = ta.ExternalLoad([force, 0.0, 0.0, 0.0, 0.0, 0.0], gravity=True)
    plot.arm_shape(arm, ta.Task(one_task().twists, load=load), ax=axes)
    axes.figure.canvas.draw()
    arrows = [one for one in axes.patches + axes.artists if isinstance(one, FancyArrowPatch)]
    assert len(arrows) == 2
    heads = []
    for arrow in arrows:
        head = arrow._get_path_in_displaycoord()[0][-1]
        heads.append(np.ptp(head.vertices, axis=0).max())
    assert min(heads) > 0.6 * max(heads)
    tip, size = ta.poses(one_task().twists)[-1, :3, 3].numpy(), force / (9.81 * 0.5) * plot.LONGEST_ARROW * 0.42
    (short,) = (one for one in arrows if np.allclose(one.ends[0], tip[[0, 2, 1]]))
    np.testing.assert_allclose(np.linalg.norm(short.ends[1] - short.ends[0]), size, rtol=0.05)


def test_the_shape_that_is_reached_says_how_far_off_it_is(axes):
    arm, task = ring_arm(), one_task()
    found = ta.evaluate(arm, task)
    plot.arm_shape(arm, task, reached=found.prediction.twists, ax=axes)
    assert f"tip reached, {1e3 * float(found.tip_error):.3g} mm off" in labels(axes)


def test_point_loads_masses_and_segments_are_drawn(axes):
    lower = ta.ArmDesign(offsets=ta.ring(0.05, 3), length=0.2, actuators=ta.Bellows(), mass=0.1)
    arm = ta.series([lower, ta.RigidLink(length=0.04, mass=0.05), lower, ta.RigidLink(length=0.02)])
    points = [ta.PointLoad([2.0, 0, 0, 0, 0, 0], segment=1, at=0.5, frame="body"), ta.PointLoad(mass=0.1)]
    shape = ta.constant_curvature(0.5, 0.22, 10, direction=1.0)
    task = ta.Task(shape, load=ta.ExternalLoad(gravity=True, points=points), segment_nodes=(5, 5))
    plot.arm_shape(arm, task, ax=axes)
    assert {"point load, 2 N", "payload, 0.981 N", "weight of the arm, 2.45 N", "rigid link"} <= set(labels(axes))
    centreline = next(line for line in axes.lines if line.get_label() == "centreline")
    x, z, y = (np.asarray(part) for part in centreline.get_data_3d())
    links = [link if link is None else link.end(3) for link in arm.links]
    tip = ta.poses(shape, task.base_pose, segment_nodes=(5, 5), links=links)[-1, :3, 3]
    assert np.allclose((x[-1], y[-1], z[-1]), tip)


def test_hulls_count_what_evaluate_counts(axes):
    arm = ring_arm()
    task = ta.Task(one_task().twists, ta.sample_loads(40, (8.0, 8.0, 8.0, 1.0, 1.0, 1.0)))
    inside = int((ta.evaluate(arm, task, ("absolute",)).absolute_per_node[:, 2] == 0).sum())
    plot.node_hull(arm, task, 2, ax=axes)
    assert f"required, inside: {inside} of 40" in labels(axes)
    panels = plot.hull_projections(arm, task, 2)
    assert all(f"required, inside: {inside} of 40" in labels(panel) for panel in panels)
    assert panels[0].get_xlabel() == panels[1].get_xlabel() != panels[2].get_xlabel()
    matplotlib.pyplot.close(panels[0].figure)


def heavy(dimension):
    """Two segments with a crooked link, under weight, a payload, and pulls in the world's frame and the body's."""
    if dimension == 2:
        parts = [ta.ArmDesign([-r, r], 0.2, ta.Bellows(), mass=m) for r, m in ((0.05, 0.3), (0.04, 0.1))]
        link, pull, body = ta.RigidLink(pose=[0.04, 0.01, 0.3], mass=0.05), [1.0, -2.0, 0.2], [0.5, 2.0, 0.0]
        shape = torch.tensor([[0.22, 0.0, 0.9]] * 4 + [[0.2, 0.0, -0.4]] * 4).double()
    else:
        places = ([[-r, 0.0], [r, 0.0]] for r in (0.05, 0.04))
        parts = [
            ta.ArmDesign(offsets=one, length=0.2, actuators=ta.Bellows(), mass=m)
            for one, m in zip(places, (0.3, 0.1), strict=True)
        ]
        crooked = torch.tensor([[math.cos(0.3), -math.sin(0.3)], [math.sin(0.3), math.cos(0.3)]])
        pose = torch.eye(4).double()
        pose[:2, :2], pose[:2, 3] = crooked, torch.tensor([0.04, 0.01])
        link, pull, body = ta.RigidLink(pose=pose, mass=0.05), [1.0, -2.0, 0, 0, 0, 0.2], [0.5, 2.0, 0, 0, 0, 0]
        shape = torch.tensor([[0.22, 0, 0, 0, 0, 0.9]] * 4 + [[0.2, 0, 0, 0, 0, -0.4]] * 4).double()
    points = [ta.PointLoad(body, segment=1, at=0.5, frame="body"), ta.PointLoad(mass=0.2, segment=0)]
    load = ta.ExternalLoad(pull, gravity=True, points=points)
    return ta.series([parts[0], link, parts[1]]), ta.Task(shape, load=load, segment_nodes=(4, 4), wrench_at="start")


def test_what_is_drawn_in_the_plane_is_what_the_base_bears():
    """Arrows, by force and place, ask of the base what the statics say; their words are those of the arm in space."""
    arm, task = heavy(2)
    plane = plot.arm_shape(arm, task)
    arrows = [one for one in plane.collections if type(one).__name__ == "Quiver"]
    place = np.concatenate([np.asarray(one.get_offsets()) for one in arrows])
    force = np.concatenate([np.stack((one.U, one.V), -1) for one in arrows])
    masses = [segment.mass for segment in arm.segments]
    asked = ta.required_wrench(
        task.twists, task.load, task.base_pose, wrench_at="start", segment_nodes=(4, 4), mass=masses, links=arm.links
    )[0]
    x, y, moment = (-asked).tolist()  # in the base's frame, which points down
    np.testing.assert_allclose(force.sum(0), (y, -x), atol=1e-9)
    turn = (place[:, 0] * force[:, 1] - place[:, 1] * force[:, 0]).sum()
    assert turn + 0.2 == pytest.approx(moment, abs=1e-3)
    words = {"point load, 2.06 N", "payload, 1.96 N", "weight of the arm, 4.41 N", "tip load, 2.24 N, 0.2 N·m"}
    assert words | {"rigid link", "base", "bellows (4)"} <= set(labels(plane))
    space = plot.arm_shape(*heavy(3))
    assert set(labels(space)) | {"base"} == set(labels(plane))
    bent = next(line for line in plane.lines if line.get_label() == "centreline").get_xydata()
    x, z, y = next(line for line in space.lines if line.get_label() == "centreline").get_data_3d()
    np.testing.assert_allclose(np.stack((x, y, 0 * z), -1), np.pad(bent, ((0, 0), (0, 1))), atol=1e-12)
    matplotlib.pyplot.close("all")


@pytest.mark.parametrize("dimension", [2, 3])
def test_sets_of_segments_in_series_count_what_evaluate_counts(dimension):
    arm, task = heavy(dimension)
    loads = ta.sample_loads(20, (6.0, 6.0, 0.5) if dimension == 2 else (6.0, 6.0, 0.1, 0.1, 0.1, 0.5))
    task = ta.Task(task.twists, loads, load=task.load, segment_nodes=(4, 4))
    for relative, name in ((False, "absolute"), (True, "relative")):
        inside = getattr(ta.evaluate(arm, task, (name,)), f"{name}_per_node") == 0
        axes = plot.node_hull(arm, task, 5, relative=relative)
        assert f"required, inside: {int(inside[:, 5].sum())} of 20" in labels(axes)
        if dimension == 2:
            along = plot.hulls_along_arm(arm, task, relative=relative)
            words = [text.get_text() for text in along.get_legend().get_texts()]
            assert f"required, attainable: {int(inside.all(-1).sum())} of 20" in words
    matplotlib.pyplot.close("all")


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_study_of_heavy_segments_shows_the_node_that_lacks_most(dimension, tmp_path):
    arm, task = heavy(dimension)
    results = ta.evaluate(arm, task)
    figure = plot.study_figure([("heavy", arm)], "a task", task, [results])
    panels = [axes for axes in figure.axes if axes.get_xlabel().startswith(("force", "moment"))]
    worst = int(results.node_miss.argmax())
    assert len(panels) == dimension
    for panel in panels[3 - dimension :]:
        assert f"node {worst + 1 if worst or dimension == 3 else 8} of 8" in panel.get_title()
        (needed,) = (line for line in panel.lines if line.get_label().startswith("required") and len(line.get_xdata()))
        assert needed.get_color() == (plot.UNATTAINABLE if results.node_miss[worst] > 0 else plot.ATTAINABLE)
    figure.savefig(tmp_path / "study.png", dpi=30)


@pytest.mark.parametrize(
    ("call", "field"),
    [
        (lambda: plot.arm_shape(ta.antagonistic_arm(), one_task()), "arm"),
        (lambda: plot.arm_shape(ring_arm(), ta.Task(ta.constant_curvature(1.0), [0.0] * 3)), "arm"),
        (lambda: plot.node_hull(ring_arm(), one_task(), 6), "node"),
        (lambda: plot.hull_projections(ring_arm(), one_task(), 1, axes=[]), "axes"),
        (lambda: plot.hull_projections(*heavy(2), 1), "task"),
    ],
)
def test_bad_input_names_the_field(call, field):
    with pytest.raises(ValueError, match=f"^{field}:"):
        call()
