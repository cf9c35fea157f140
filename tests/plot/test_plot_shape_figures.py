"""Pages of what a search reaches and of planned shapes."""

import dataclasses
import io

import numpy as np
import pytest
import torch
from matplotlib.quiver import Quiver

import torcharm as ta
from torcharm import plot
from torcharm.attainability.verdict import over_tolerance
from torcharm.design.shape_planning import PlannedShape
from torcharm.geometry import se2

TASK = ta.Task(ta.affine_curvature(-1.0, 1.0, nodes=4), ta.sample_loads(5, (4, 4, 0.4)))


@pytest.fixture(scope="module")
def found():
    return ta.search_pressure(ta.antagonistic_arm(), TASK, starts=2)


def lines(axes, name):
    return [line for line in axes.lines if name in (line.get_gid(), line.get_label())]


def test_search_shows_the_least_the_median_and_the_largest_error(found):
    figure = plot.search_figure([("soft", ta.antagonistic_arm(), found)], "bent", TASK)
    order = over_tolerance(ta.antagonistic_arm(), found, ta.PoseTolerance()).amax(0).argsort()
    for axes, rank, load in zip(figure.axes, ("least", "median", "largest"), order[[0, 2, 4]], strict=True):
        which, off, load_shown = axes.get_title().splitlines()
        assert which == f"soft: {rank} error of 5 loads"
        assert off.startswith(f"tip off by {1e3 * float(found.tip_error[load]):.3g} mm, turned by")
        assert load_shown.startswith(f"load {int(load) + 1}: ")
        (reached,) = lines(axes, "reached")
        np.testing.assert_allclose(reached.get_xydata()[:: plot.SMOOTHING], ta.poses(found.twists[load])[:, :2])
        assert (reached.get_color(), reached.get_linestyle()) == (plot.UNATTAINABLE, "--")
        outer = max(lines(axes, "bellows"), key=lambda line: line.get_xydata()[-1, 0])
        offset = torch.tensor([[0.0, -0.08, 0.0], [0.0, 0.08, 0.0]], dtype=torch.float64)
        tips = [se2.compose(ta.poses(found.twists[load])[-1], one)[:2].numpy() for one in offset]
        assert min(np.linalg.norm(outer.get_xydata()[-1] - tip) for tip in tips) < 1e-9, (
            "actuators are where it gets to"
        )
        (target,) = lines(axes, "task")
        np.testing.assert_allclose(target.get_xydata()[:: plot.SMOOTHING], ta.poses(TASK.twists)[:, :2])
        (arrow,) = [one for one in axes.collections if isinstance(one, Quiver)]
        np.testing.assert_allclose((arrow.U[0], arrow.V[0]), TASK.tip_load[load, :2])
        assert axes.get_xlabel() == "x [m]"
        assert axes.get_ylabel() == "y [m]"
    assert len({axes.get_xlim() for axes in figure.axes}) == 1
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [
        *("base", "bellows", "mckibben", "task", "its tip", "reached", "tip reached", "tip load")
    ]
    figure.savefig(io.BytesIO())


@pytest.mark.parametrize(("lost", "titles"), [(3, ["least", "largest"]), (4, ["only"]), (5, ["no"])])
def test_search_leaves_out_what_was_not_found(found, lost, titles):
    error = found.tip_error.clone()
    error[:lost] = torch.inf
    some = dataclasses.replace(found, tip_error=error)
    figure = plot.search_figure([("soft", ta.antagonistic_arm(), some)], "bent", TASK)
    assert [axes.get_title().split()[1] for axes in figure.axes] == titles
    whole = figure.axes[0].get_title()
    assert f"{lost} not found" in whole or whole == "soft: no equilibrium was found"
    figure.savefig(io.BytesIO())


@pytest.mark.parametrize(("possible", "words"), [(True, "no equilibrium was found"), (False, "impossible")])
def test_a_search_that_found_nothing_shows_the_task_and_says_why(found, possible, words):
    task = TASK if possible else ta.Task(ta.constant_curvature(7.0, 0.5, 4), TASK.tip_load)
    nothing = torch.full((5,), torch.inf)
    some = dataclasses.replace(found, tip_error=nothing, possible=torch.full((5,), possible))
    figure = plot.search_figure([("soft", ta.antagonistic_arm(), some)], "bent", task)
    (axes,) = figure.axes
    assert axes.get_title() == f"soft: {words}"
    assert axes.texts[0].get_text().startswith(words)
    assert possible or "actuator 4 would have no length at node 1" in " ".join(axes.texts[0].get_text().split())
    (target,) = lines(axes, "task")
    np.testing.assert_allclose(target.get_xydata()[:: plot.SMOOTHING], ta.poses(task.twists)[:, :2], atol=1e-12)
    figure.savefig(io.BytesIO())
    assert axes.texts[0].get_window_extent().y0 > target.get_window_extent().y1


def test_arms_with_fewer_equilibria_show_their_ends(found):
    error = found.tip_error.clone()
    error[:3] = torch.inf
    some = dataclasses.replace(found, tip_error=error)
    figure = plot.search_figure(
        [(name, ta.antagonistic_arm(), one) for name, one in (("a", found), ("b", some))], "", TASK
    )
    shown = [axes.get_title().partition(" error")[0] for axes in figure.axes]
    assert shown == ["a: least", "a: median", "a: largest", "b: least", "b: largest", ""]


def test_search_of_one_load(found):
    task = ta.Task(TASK.twists, (1.0, -2.0, 0.1))
    one = ta.search_pressure(ta.bellows_arm(), task, starts=1)
    figure = plot.search_figure([("soft", ta.bellows_arm(), one)], "one", task)
    assert [axes.get_title().splitlines()[0] for axes in figure.axes] == ["soft: only load"]
    with pytest.raises(ValueError, match="results: must hold at least one arm"):
        plot.search_figure([], "none", TASK)
    with pytest.raises(ValueError, match="must be of at most 1 tasks, got 5"):
        plot.search_figure([("soft", ta.antagonistic_arm(), found)], "one", task)


def test_loads_and_shapes_are_those_of_the_task_that_is_drawn(found):
    """Of a batch (loads, shapes), where those of the second shape are less off."""
    shapes = torch.stack((TASK.twists, ta.affine_curvature(1.0, 1.0, nodes=4)))
    task = ta.Task(shapes, TASK.tip_load[:, None])
    assert task.batch_shape == (5, 2)
    columns = {
        name: value.repeat_interleave(2, 0) for name, value in vars(found).items() if isinstance(value, torch.Tensor)
    }
    for name in ("tip_error", "tip_rotation_error", "shape_error"):
        columns[name] = columns[name] * torch.tensor([1.0, 0.5] * 5)
    both = dataclasses.replace(found, **columns)
    figure = plot.search_figure([("soft", ta.antagonistic_arm(), both)], "two", task)
    order = over_tolerance(ta.antagonistic_arm(), both, ta.PoseTolerance()).amax(0).argsort()
    for axes, load in zip(figure.axes, order[[0, 4, 9]].tolist(), strict=True):
        x, y, moment = TASK.tip_load[load // 2].tolist()
        words = f"load {load + 1}: {np.hypot(x, y):.3g} N, {moment:.3g} N·m"
        assert axes.get_title().splitlines()[-1] == words
        (arrow,) = [one for one in axes.collections if isinstance(one, Quiver)]
        np.testing.assert_allclose((arrow.U[0], arrow.V[0]), (x, y))
        (target,) = lines(axes, "task")
        np.testing.assert_allclose(target.get_xydata()[-1], ta.poses(shapes[load % 2])[-1, :2])


@pytest.mark.parametrize("dimension", [2, 3])
def test_searches_of_heavy_segments_are_drawn_at_one_scale_and_plans_end_at_their_pose(dimension, tmp_path):
    """In the plane and in space: links, weights and payloads; arrows of all panels are as long for as many newtons."""
    arm, columns = ta.antagonistic_arm(0.05, 0.015, 0.2), 3 * dimension - 3
    if dimension == 3:
        arm = ta.antagonistic_ring(0.05, 0.015, 0.2)
    arm = ta.series([ta.ArmDesign(**_parts(arm), mass=0.1), ta.RigidLink(length=0.03, mass=0.05), arm])
    load = ta.ExternalLoad(gravity=True, points=ta.PointLoad(mass=0.1, segment=1))
    tips = torch.zeros(2, columns).double()
    tips[1, 0] = 0.5
    shape = torch.zeros(6, columns).double()
    shape[:, 0], shape[:, -1] = 0.2, 0.2
    task = ta.Task(shape, tips, load=load, segment_nodes=(3, 3))
    pressure = ta.search_pressure(arm, task, starts=1)
    figure = plot.search_figure([("heavy", arm, pressure)], "t", task)
    figure.savefig(tmp_path / "search.png", dpi=40)
    words = {"rigid link", "payload", "weight of the arm", "tip load"}
    assert words <= {text.get_text() for text in figure.legends[0].get_texts()}
    if dimension == 2:
        assert len({one.scale for axes in figure.axes for one in axes.collections if isinstance(one, Quiver)}) == 1
    tip = ta.poses(shape, segment_nodes=(3, 3), links=[link and link.end(dimension) for link in arm.links])[-1]
    plan = ta.plan_shape(arm, tip, load, nodes=1, starts=1, iterations=20)
    figure = plot.plan_figure([("heavy", arm, plan)], "p", tip)
    (axes,) = figure.axes
    assert plan.found, plan.status
    shown = lines(axes, "task") or lines(axes, "centreline")  # the latter where nothing is predicted
    ends = [line.get_data_3d() if dimension == 3 else line.get_data() for line in shown]
    x, *_, y = (float(part[-1]) for part in ends[0])
    place = tip[:2] if dimension == 2 else tip[:2, 3]
    np.testing.assert_allclose((x, y), place, atol=1e-6)
    figure.savefig(tmp_path / "plan.png", dpi=40)


def _parts(arm):
    across = {"offsets": arm.offsets} if arm.dimension == 3 else {"radii": arm.radii}
    return {**across, "length": arm.length, "actuators": arm.actuators}


def test_plans_in_space_show_the_pose_wanted_and_no_empty_axes():
    arm = ta.ArmDesign(offsets=ta.ring(0.05, 3), length=0.3, actuators="bellows")
    twists = ta.constant_curvature(0.26, 0.35, 4, direction=0.5)
    pose = ta.poses(twists)[-1]
    found = ta.evaluate(arm, ta.Task(twists, [0.0] * 6))
    shape = PlannedShape("found", twists, 0.0, 0.0, found)
    none = PlannedShape("no shape: none of 4", torch.full((4, 6), torch.nan), np.nan, np.nan, None)
    figure = plot.plan_figure([("a", arm, shape), ("b", arm, none)], "p", pose)
    assert [axes.get_title().split("\n")[0] for axes in figure.axes] == [f"a: {found.verdict}", "b: no shape"]
    for axes in figure.axes:
        (rim,) = lines(axes, "tip pose wanted")
        x, z, y = (np.asarray(part) for part in rim.get_data_3d())
        apart = np.stack((x, y, z), -1) - pose[:3, 3].numpy()
        np.testing.assert_allclose(apart @ pose[:3, 0].numpy(), 0.0, atol=1e-9)
        np.testing.assert_allclose(apart[:-1].mean(0), 0.0, atol=1e-3)
        low, high = axes.get_zlim()
        assert low < float(pose[1, 3]) < 0 < high, "tip and base are in sight"
    figure.savefig(io.BytesIO())


def test_searches_in_space_of_too_many_tasks_are_refused(found):
    arm = ta.ArmDesign(offsets=ta.ring(0.05, 3), length=0.3, actuators="bellows")
    task = ta.Task(ta.constant_curvature(0.26, 0.35, 4, direction=0.5), [0.0] * 6)
    with pytest.raises(ValueError, match="results: a: must be of at most 1 tasks, got 5"):
        plot.search_figure([("a", arm, found)], "one", task)


def test_plan_shows_the_shape_the_pose_and_where_the_arm_is_predicted():
    pose, load = (0.15, -0.43, -0.6), (0.0, -1.0, 0.0)
    arm = ta.antagonistic_arm(0.04, 0.01, 0.48)
    shape = ta.plan_shape(arm, pose, load, nodes=4, starts=1)
    none = PlannedShape("no shape: none of 4", torch.full((4, 3), torch.nan), np.nan, np.nan, None)
    figure = plot.plan_figure([("soft", arm, shape), ("other", arm, none)], "drawer", pose)
    first, second = figure.axes
    assert f"predicted tip off by {1e3 * float(shape.attainability.tip_error):.3g} mm" in first.get_title()
    assert second.get_title() == "other: no shape"
    (planned,) = lines(first, "task")
    np.testing.assert_allclose(planned.get_xydata()[-1], pose[:2], atol=1e-7)
    (predicted,) = lines(first, "reached")
    np.testing.assert_allclose(
        predicted.get_xydata()[:: plot.SMOOTHING], ta.poses(shape.attainability.prediction.twists)[:, :2]
    )
    for axes in figure.axes:
        (plate,) = lines(axes, "tip pose wanted")
        rim = plate.get_xydata() - pose[:2]
        np.testing.assert_allclose(rim.max(0), -rim.min(0), atol=1e-7)
        np.testing.assert_allclose(rim @ (np.cos(pose[2]), np.sin(pose[2])), 0, atol=1e-7)
        assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [m]", "y [m]")
        assert lines(axes, "base")
    figure.savefig(io.BytesIO())
    with pytest.raises(ValueError, match="shapes: must hold at least one arm"):
        plot.plan_figure([], "none", pose)
