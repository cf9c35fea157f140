import dataclasses
import re
import subprocess
import sys

import matplotlib as mpl
import numpy as np
import pytest
import torch

import torcharm as ta

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver

from torcharm import plot
from torcharm.geometry import se2

TWISTS = ta.affine_curvature(-0.5, 0.5, length=0.5, nodes=8)
LOADS = ta.sample_loads(30, (20, 20, 2))
TASK = ta.Task(TWISTS, LOADS)
ARM = ta.antagonistic_arm()
BARE = ta.Task(TWISTS, [0.0, 0.0, 0.0])
PLANAR = (0, 2)
VALUES = {
    "one": torch.tensor([[0.0, 1.0], [2.0, 30.0]]),
    "two": torch.tensor([5.0, 7.0, float("nan"), 9.0, float("inf")]),
}


@pytest.fixture(autouse=True)
def _close():
    yield
    plt.close("all")


def linear_actuator():
    return ta.PolynomialActuator(((0, 1, 2.0), (1, 0, -100.0)), (-0.3, 0.3), (0.0, 50.0), 50.0, bending_stiffness=0.0)


def mixed_arm():
    models = [ta.Bellows(), ta.McKibben(), linear_actuator(), ta.McKibben(), ta.Bellows()]
    return ta.ArmDesign([-0.08, -0.04, 0.0, 0.04, 0.08], 0.5, models)


def segment_arm():
    """One actuator: hulls are segments, and relative hulls points."""
    return ta.ArmDesign([0.02], 0.5, [linear_actuator()])


def point_arm():
    """No pressure: hulls are points."""
    return ta.ArmDesign([0.02, -0.02], 0.5, [linear_actuator()] * 2, [0.0, 0.0])


def deep_axes():
    return Figure().add_subplot(projection="3d")


def by_gid(axes, prefix):
    return [line for line in axes.lines if str(line.get_gid()).startswith(prefix)]


def points(line):
    return np.stack(line.get_data_3d(), -1)


def sequences(axes, gid, nodes):
    """The loads' lines (L, N, 3), without the breaks between them."""
    (line,) = by_gid(axes, gid)
    path = points(line).reshape(-1, nodes + 1, 3)
    assert np.isnan(path[:, -1]).all()
    return path[:, :-1]


def legend_text(axes):
    return " | ".join(text.get_text() for text in axes.get_legend().get_texts())


def arrows(axes):
    return [artist for artist in axes.collections if isinstance(artist, Quiver)]


def forces(axes):
    return np.concatenate([np.stack((quiver.U, quiver.V), -1) for quiver in arrows(axes)])


def over(found):
    """The largest error of each task over its tolerance, by what the tolerance's own attributes say."""
    length = float(found.arm.length.mean())
    limits = found.tolerance
    tip = limits.tip or 0.02 * length
    errors = (
        found.tip_error / tip,
        found.tip_rotation_error / limits.rotation,
        found.shape_error / (limits.shape or tip),
    )
    return torch.stack(errors).amax(0).numpy()


def rows(array):
    return sorted(map(tuple, np.round(np.asarray(array), 9)))


def test_package_loads_no_matplotlib():
    code = "import sys, torcharm; sys.exit(any(m.split('.')[0] in ('matplotlib', 'mpl_toolkits') for m in sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


class TestArmShape:
    def test_actuators_lie_at_their_offsets(self):
        arm = mixed_arm()
        axes = plot.arm_shape(arm, BARE)
        node = ta.poses(TWISTS)
        kinds = ["bellows", "mckibben", "polynomial", "mckibben", "bellows"]
        curves = [line for line in axes.lines if line.get_gid() in kinds]
        assert [line.get_gid() for line in curves] == kinds
        for line, radius in zip(curves, arm.radii, strict=True):
            offset = torch.stack((0 * radius, radius, 0 * radius)).expand(len(node), 3)
            expected = se2.compose(node, offset)[:, :2].numpy()
            np.testing.assert_allclose(line.get_xydata()[:: plot.SMOOTHING], expected, atol=1e-12)
            assert line.get_color() == plot.KIND_STYLES.get(line.get_gid(), plot.OTHER_STYLES[0])[0]

    def test_numbers_are_places_in_the_arm_and_lie_on_the_actuators(self):
        arm = mixed_arm()
        axes = plot.arm_shape(arm, BARE)
        numbers = [text for text in axes.texts if text.get_gid() == "number"]
        assert [text.get_text() for text in numbers] == ["1", "2", "3", "4", "5"]
        kinds = {"bellows", "mckibben", "polynomial"}
        for text, line in zip(numbers, (one for one in axes.lines if one.get_gid() in kinds), strict=True):
            assert np.linalg.norm(line.get_xydata() - text.get_position(), axis=1).min() < 1e-12

    @pytest.mark.parametrize("how", ["equilibrium", "search", "prediction", "evaluation", "twists"])
    def test_what_was_found_is_drawn_at_its_shape(self, how):
        task = ta.Task(TWISTS, [1.0, -2.0, 0.1])
        found = {
            "equilibrium": lambda: ta.solve_equilibrium(ARM, [20.0, 30.0, 20.0, 25.0], task.tip_load, nodes=8),
            "search": lambda: ta.search_pressure(ARM, task, starts=1),
            "prediction": lambda: ta.predict_error(ARM, task),
            "evaluation": lambda: ta.evaluate(ARM, task),
            "twists": lambda: TWISTS,
        }[how]()
        axes = plot.arm_shape(ARM, found)
        twists = {"evaluation": lambda: found.prediction.twists, "twists": lambda: found}
        shape = twists.get(how, lambda: found.twists)()
        name = "reached" if how == "evaluation" else "centreline"
        (line,) = (one for one in axes.lines if one.get_label() == name)
        np.testing.assert_allclose(line.get_xydata()[:: plot.SMOOTHING], ta.poses(shape)[:, :2], atol=1e-12)
        assert ("tip load" in legend_text(axes)) == (how in ("equilibrium", "evaluation"))
        both = plot.arm_shape(ARM, task, reached=found)
        (line,) = (one for one in both.lines if one.get_label() == "reached")
        np.testing.assert_allclose(line.get_xydata()[:: plot.SMOOTHING], ta.poses(shape)[:, :2], atol=1e-12)

    def test_the_equilibrium_of_segments_keeps_its_base_and_their_nodes(self):
        arm = ta.series([ARM, ta.RigidLink(length=0.05), ARM])
        found = ta.solve_equilibrium(arm, [10.0] * 8, [0.0, -1.0, 0.0], nodes=[3, 5], base_pose="upright")
        axes = plot.arm_shape(arm, found)
        (line,) = (one for one in axes.lines if one.get_label() == "centreline")
        np.testing.assert_allclose(line.get_xydata()[-1], found.poses[-1, :2], atol=1e-12)
        assert [text.get_text() for text in axes.texts if text.get_gid() == "number"] == [str(k) for k in range(1, 9)]

    def test_a_payload_of_nothing_has_no_arrow(self):
        load = ta.ExternalLoad(gravity=True, points=ta.PointLoad(mass=0.0))
        assert "payload" not in legend_text(plot.arm_shape(ARM, ta.Task(TWISTS, load=load)))

    def test_centreline_passes_through_the_nodes(self):
        base = (0.1, 0.2, 0.3)
        axes = plot.arm_shape(ta.bellows_arm(), ta.Task(TWISTS, [0.0] * 3, base))
        (line,) = [line for line in axes.lines if line.get_label() == "centreline"]
        expected = ta.poses(TWISTS, torch.tensor(base, dtype=torch.float64))[:, :2]
        np.testing.assert_allclose(line.get_xydata()[:: plot.SMOOTHING], expected, atol=1e-12)

    def test_base_plate_is_square_to_the_arm_and_spans_it(self):
        axes = plot.arm_shape(ta.bellows_arm(), ta.Task(TWISTS, [0.0] * 3, (0.0, 0.0, 0.0)))
        (plate,) = [line for line in axes.lines if line.get_label() == "base"]
        assert np.ptp(plate.get_xdata()) == 0.0
        assert plate.get_ydata().min() < -0.08
        assert plate.get_ydata().max() > 0.08

    def test_load_is_one_arrow_with_its_size(self):
        axes = plot.arm_shape(ta.antagonistic_arm(), ta.Task(TWISTS, [3.0, -4.0, 0.25]))
        (quiver,) = arrows(axes)
        np.testing.assert_allclose(quiver.get_offsets(), ta.poses(TWISTS)[-1:, :2], atol=1e-12)
        assert rows(forces(axes)) == [(3.0, -4.0)]
        assert "tip load, 5 N, 0.25 N·m" in legend_text(axes)
        longest = plot.LONGEST_ARROW * 0.5
        assert 5.0 / quiver.scale == pytest.approx(longest, rel=1e-4)

    def test_axes_and_legend(self):
        ax = Figure().add_subplot()
        assert plot.arm_shape(mixed_arm(), BARE, ax=ax) is ax
        assert not arrows(ax)
        assert (ax.get_xlabel(), ax.get_ylabel()) == ("x [m]", "y [m]")
        assert ax.get_aspect() == 1.0
        for text in ("bellows (2)", "mckibben (2)", "polynomial (1)", "base", "centreline"):
            assert text in legend_text(ax)

    def test_makes_axes(self):
        assert plot.arm_shape(segment_arm(), ta.Task(TWISTS[None], [0.0] * 3)).name == "rectilinear"

    def test_takes_what_requires_gradients(self):
        radius = torch.tensor(0.08, dtype=torch.float64, requires_grad=True)
        load = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64, requires_grad=True)
        plot.arm_shape(ta.antagonistic_arm(radius), ta.Task(TWISTS.clone().requires_grad_(), load))

    @pytest.mark.parametrize(
        ("field", "change"),
        [
            ("arm", {"arm": ta.antagonistic_arm(torch.tensor([0.05, 0.08]))}),
            ("arm", {"arm": ta.antagonistic_ring()}),
            ("reached", {"reached": TWISTS[:2]}),
            ("reached", {"reached": TWISTS * float("nan")}),
            ("task", {"arm": ta.series([ARM, ARM, ARM]), "task": TWISTS}),
            ("ax", {"ax": deep_axes()}),
        ],
    )
    def test_errors_name_the_field(self, field, change):
        given = {"arm": ta.antagonistic_arm(), "task": BARE, **change}
        with pytest.raises(ValueError, match=f"^{field}: must .*got"):
            plot.arm_shape(**given)

    def test_one_arrow_a_load_from_the_tip(self):
        ax = Figure().add_subplot()
        assert plot.arm_shape(ARM, TASK, ax=ax) is ax
        assert rows(forces(ax)) == rows(LOADS[:, :2])
        offsets = np.asarray(arrows(ax)[0].get_offsets())
        np.testing.assert_allclose(offsets, ta.poses(TWISTS)[-1:, :2].expand(30, 2), atol=1e-12)

    def test_legend_gives_the_scale_of_forces(self):
        axes = plot.arm_shape(ARM, TASK)
        longest = LOADS[:, :2].norm(dim=-1).max()
        assert f"30 tip loads, up to {longest:.3g} N" in legend_text(axes)
        assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [m]", "y [m]")

    def test_arrows_lie_inside_the_axes(self):
        axes = plot.arm_shape(ARM, TASK)
        (quiver,) = arrows(axes)
        ends = np.asarray(quiver.get_offsets()) + forces(axes) / quiver.scale
        (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
        assert left < ends[:, 0].min() < ends[:, 0].max() < right
        assert bottom < ends[:, 1].min() < ends[:, 1].max() < top

    def test_loads_without_force(self):
        axes = plot.arm_shape(ARM, ta.Task(TWISTS, [0.0, 0.0, 1.0]))
        axes.figure.canvas.draw()
        assert "tip load, 0 N, 1 N·m" in legend_text(axes)

    def test_same_shape_in_a_batch_is_one_shape(self):
        assert len(forces(plot.arm_shape(ARM, ta.Task(TWISTS.expand(5, 1, -1, -1), LOADS)))) == 150

    def test_several_shapes(self):
        several = ta.Task(ta.affine_curvature([0.0, 1.0], 0.5, nodes=8), LOADS[:2])
        with pytest.raises(ValueError, match=r"^task: must hold one shape, got 2;"):
            plot.arm_shape(ARM, several)

    def test_no_load(self):
        with pytest.raises(ValueError, match=r"^task: must hold at least one shape and load, got batch shape"):
            plot.arm_shape(ARM, ta.Task(TWISTS, torch.zeros(0, 3)))


class TestHullsAlongArm:
    @pytest.mark.parametrize("relative", [False, True])
    def test_polygons_are_the_hulls(self, relative):
        arm = ta.antagonistic_arm()
        axes = plot.hulls_along_arm(arm, TASK, relative=relative)
        vertices = ta.wrench_hulls(arm, TWISTS, relative=relative).vertices
        outlines = by_gid(axes, "hull")
        assert [line.get_gid() for line in outlines] == [f"hull {node}" for node in range(1, 9)]
        for node, (line, polygon) in enumerate(zip(outlines, vertices, strict=True), 1):
            ring = points(line)
            assert (ring[:, 0] == node).all()
            np.testing.assert_allclose(ring[:-1, 1:], polygon)
            np.testing.assert_allclose(ring[-1], ring[0])
        assert len(axes.collections) == 8

    @pytest.mark.parametrize("relative", [False, True])
    def test_lines_are_the_required_wrenches(self, relative):
        arm = ta.antagonistic_arm()
        axes = plot.hulls_along_arm(arm, TASK, relative=relative)
        required = ta.required_wrench(TWISTS, LOADS)[..., PLANAR]
        if relative:
            required = required - required[:, :1]
        found = ta.evaluate(arm, TASK)
        held = (found.relative if relative else found.absolute) == 0
        assert 0 < held.sum() < 30  # both kinds are seen
        for gid, chosen in (("attainable", held), ("not attainable", ~held)):
            lines = sequences(axes, gid, 8)
            assert (lines[..., 0] == np.arange(1, 9)).all()
            np.testing.assert_allclose(lines[..., 1:], required[chosen], atol=1e-12)
            assert f"required, {gid}: {chosen.sum()} of 30" in legend_text(axes)

    def test_attainable_and_not_differ_in_more_than_colour(self):
        axes = plot.hulls_along_arm(ta.antagonistic_arm(), TASK)
        (held,), (missed,) = by_gid(axes, "attainable"), by_gid(axes, "not attainable")
        assert held.get_color() != missed.get_color()
        assert held.get_linestyle() != missed.get_linestyle()

    def test_dots_are_the_wrenches_inside(self):
        arm = ta.antagonistic_arm()
        (dots,) = by_gid(plot.hulls_along_arm(arm, TASK), "inside")
        inside = ta.evaluate(arm, TASK).absolute_per_node == 0
        assert rows(points(dots)[:, 1:]) == rows(ta.required_wrench(TWISTS, LOADS)[..., PLANAR][inside])

    def test_loads_choose(self):
        axes = plot.hulls_along_arm(ta.antagonistic_arm(), TASK, loads=[7, 2])
        drawn = np.concatenate([sequences(axes, gid, 8) for gid in ("attainable", "not attainable")])
        expected = ta.required_wrench(TWISTS, LOADS[[7, 2]])[..., PLANAR]
        assert rows(drawn[..., 1:].reshape(-1, 2)) == rows(expected.reshape(-1, 2))

    def test_axes_labels_and_limits(self):
        ax = deep_axes()
        assert plot.hulls_along_arm(ta.bellows_arm(), TASK, ax=ax) is ax
        assert "node" in ax.get_xlabel()
        assert "[N]" in ax.get_ylabel()
        assert "[N·m]" in ax.get_zlabel()
        vertices = ta.wrench_hulls(ta.bellows_arm(), TWISTS).vertices
        assert ax.get_ylim()[0] < vertices[..., 0].min() < vertices[..., 0].max() < ax.get_ylim()[1]
        assert ax.get_zlim()[0] < vertices[..., 1].min() < vertices[..., 1].max() < ax.get_zlim()[1]

    def test_relative_labels_say_so(self):
        axes = plot.hulls_along_arm(ta.bellows_arm(), TASK, relative=True)
        assert "f_{x,1}" in axes.get_ylabel()
        assert "m_1" in axes.get_zlabel()

    @pytest.mark.parametrize("make", [segment_arm, point_arm, mixed_arm])
    @pytest.mark.parametrize("relative", [False, True])
    def test_any_hull_and_a_single_load(self, make, relative):
        axes = plot.hulls_along_arm(make(), ta.Task(TWISTS, LOADS[0]), relative=relative)
        axes.figure.canvas.draw()
        assert len(by_gid(axes, "hull")) == 8

    def test_one_node(self):
        twists = ta.affine_curvature(0.0, 0.5, nodes=1)
        plot.hulls_along_arm(ta.bellows_arm(), ta.Task(twists, LOADS)).figure.canvas.draw()

    @pytest.mark.parametrize(
        ("field", "change"),
        [
            ("arm", {"arm": ta.antagonistic_arm(torch.tensor([0.05, 0.08]))}),
            ("task", {"task": ta.Task(ta.affine_curvature([0.0, 1.0], 0.5, nodes=8), LOADS[:2])}),
            ("loads", {"loads": [30]}),
            ("loads", {"loads": []}),
            ("task", {"task": ta.Task(ta.helix(1.0, 1.0), [0.0] * 6)}),
            ("ax", {"ax": Figure().add_subplot()}),
        ],
    )
    def test_errors_name_the_field(self, field, change):
        given = {"arm": ta.antagonistic_arm(), "task": TASK, **change}
        with pytest.raises(ValueError, match=f"^{field}: must .*got"):
            plot.hulls_along_arm(**given)


class TestNodeHull:
    @pytest.mark.parametrize("relative", [False, True])
    @pytest.mark.parametrize("node", [0, 4, torch.tensor(7)])
    def test_polygon_and_points(self, node, relative):
        arm, ax = ta.antagonistic_arm(), Figure().add_subplot()
        assert plot.node_hull(arm, TASK, node, relative=relative, ax=ax) is ax
        polygon = ta.wrench_hulls(arm, TWISTS, relative=relative).vertices[node]
        np.testing.assert_allclose(ax.patches[0].get_xy()[: len(polygon)], polygon)
        required = ta.required_wrench(TWISTS, LOADS)[..., PLANAR]
        if relative:
            required = required - required[:, :1]
        distance = ta.distance_to_hull(required[:, node], polygon)
        _, inside, outside = ax.lines
        assert rows(inside.get_xydata()) == rows(required[distance == 0, node])
        assert rows(outside.get_xydata()) == rows(required[distance > 0, node])
        assert ax.get_title() == f"node {node + 1} of 8"
        assert inside.get_marker() != outside.get_marker()
        assert f"inside: {(distance == 0).sum()} of 30" in legend_text(ax)
        assert "[N]" in ax.get_xlabel()
        assert "[N·m]" in ax.get_ylabel()

    @pytest.mark.parametrize("node", [8, -1, True])
    def test_node_out_of_range(self, node):
        with pytest.raises(ValueError, match=r"^node: must be .*, got"):
            plot.node_hull(ta.bellows_arm(), TASK, node)


class TestHistogram:
    def test_medians_are_lines_and_in_the_legend(self):
        ax = Figure().add_subplot()
        assert plot.unattainability_histogram(VALUES, ax=ax, unit="mN") is ax
        assert [line.get_xdata()[0] for line in ax.lines] == [1.5, 7.0]
        assert "one: median 1.5 mN, 1 of 4 attainable" in legend_text(ax)
        assert "two: median 7 mN, 0 of 5 attainable, 2 not finite" in legend_text(ax)
        assert ax.get_xlabel() == "unattainability [mN]"
        assert ax.get_ylabel() == "number of tasks"

    def test_bars_count_over_shared_bins(self):
        axes = plot.unattainability_histogram(VALUES)
        first, second = axes.patches[:30], axes.patches[31:61]  # each with its outline after it
        assert sum(bar.get_height() for bar in first) == 4
        assert sum(bar.get_height() for bar in second) == 3
        assert [bar.get_x() for bar in first] == [bar.get_x() for bar in second]

    def test_arms_differ_in_more_than_colour(self):
        axes = plot.unattainability_histogram(VALUES)
        assert len({line.get_color() for line in axes.lines}) == 2
        assert len({line.get_linestyle() for line in axes.lines}) == 2

    def test_all_alike(self):
        plot.unattainability_histogram({"one": torch.zeros(3)}).figure.canvas.draw()

    @pytest.mark.parametrize("values", [{}, {"one": torch.empty(0)}, {"one": torch.tensor([float("nan")])}])
    def test_nothing_finite(self, values):
        with pytest.raises(ValueError, match=r"^values: must hold at least one finite value, got none"):
            plot.unattainability_histogram(values)


class TestStudyFigure:
    ARMS = (
        ("antagonistic", ta.antagonistic_arm()),
        ("five", mixed_arm()),
        ("single", segment_arm()),
        ("limp", point_arm()),
    )

    @staticmethod
    def draw(arms, task=TASK, **kwargs):
        results = [ta.evaluate(arm, task) for _, arm in arms]
        return plot.study_figure(arms, "a task", task, results, **kwargs), results

    @pytest.mark.parametrize("count", [1, 2, 4])
    def test_errors_on_top_a_column_an_arm_and_two_nodes_of_each(self, count, tmp_path):
        figure, _ = self.draw(self.ARMS[:count])
        assert [axes.name for axes in figure.axes] == ["rectilinear"] * (1 + 3 * count)
        figure.savefig(tmp_path / "study.png", dpi=30)
        assert not plt.get_fignums()

    def test_every_task_is_a_mark_by_its_verdict(self):
        figure, results = self.draw(self.ARMS[:2])
        marks = {}
        for found in figure.axes[0].collections:
            marks.setdefault(found.get_gid(), []).append(np.asarray(found.get_offsets()))
        for word in set(marks):
            drawn = np.sort(np.concatenate(marks[word])[:, 0])
            errors = [over(result)[result.verdict == word] for result in results]
            finite = np.sort(np.concatenate(errors))
            finite = finite[np.isfinite(finite)]
            np.testing.assert_allclose(drawn[: len(finite)], np.maximum(finite, 0.01))
        assert sum(len(part) for parts in marks.values() for part in parts) == 60
        assert figure.axes[0].get_xlabel().startswith("predicted error over its tolerance")

    @pytest.mark.parametrize("reason", ["tip", "rotation", "shape"])
    def test_what_is_missed_lies_beyond_the_tolerance_whatever_the_reason(self, reason):
        wide = ta.PoseTolerance(tip=1.0, rotation=3.0, shape=1.0)
        strict = dataclasses.replace(wide, **{reason: 1e-3})
        results = [ta.evaluate(arm, TASK, tolerance=strict) for _, arm in self.ARMS[:2]]
        figure = plot.study_figure(self.ARMS[:2], "a task", TASK, results)
        sides = {mark.get_gid(): [] for mark in figure.axes[0].collections}
        for mark in figure.axes[0].collections:
            sides[mark.get_gid()] += list(np.asarray(mark.get_offsets())[:, 0])
        assert min(sides["missed"]) > 1.0
        assert max(sides.get("held", [0.0])) <= 1.0
        (line,) = (line for line in figure.axes[0].lines if line.get_label().startswith("tolerance"))
        assert list(line.get_xdata()) == [1.0, 1.0]

    def test_arms_of_different_lengths_have_tolerances_of_their_own(self):
        arms = [("short", ta.antagonistic_arm()), ("long", ta.antagonistic_arm(length=0.75))]
        figure, results = self.draw(arms)
        (line,) = (line for line in figure.axes[0].lines if line.get_label().startswith("tolerance"))
        assert "tip, shape 10 to 15 mm" in line.get_label()
        marks = np.concatenate([np.asarray(mark.get_offsets()) for mark in figure.axes[0].collections])
        for row, result in enumerate(results):
            drawn = marks[np.abs(marks[:, 1] - row) < 0.4, 0]
            expected = over(result)
            known = np.isfinite(expected)
            np.testing.assert_allclose(np.sort(drawn)[: known.sum()], np.maximum(np.sort(expected[known]), 0.01))

    def test_titles_count_the_verdicts(self):
        figure, results = self.draw(self.ARMS[:2])
        arms = [axes for axes in figure.axes if axes.get_xlabel() == "x [m]"]
        for axes, (name, _), result in zip(arms, self.ARMS, results, strict=False):
            assert axes.get_title().startswith(f"{name}: ")
            for word in set(result.verdict):
                assert f"{(result.verdict == word).sum()} {word}" in axes.get_title()

    def test_the_predicted_shape_is_that_of_the_median_load(self):
        figure, (result,) = self.draw(self.ARMS[:1])
        (line,) = (line for axes in figure.axes for line in axes.lines if line.get_gid() == "reached")
        index = int(re.search(r"drawn: load (\d+) of 30", line.axes.get_title())[1]) - 1
        error = over(result)
        known = np.sort(error[np.isfinite(error)])
        assert error[index] == pytest.approx(known[(len(known) - 1) // 2])
        end = ta.poses(result.prediction.twists[index])[-1, :2]
        np.testing.assert_allclose(line.get_xydata()[-1], end, atol=1e-12)
        assert rows(forces(line.axes)) == rows(LOADS[[index], :2])

    def test_nodes_are_the_base_and_the_worst_at_one_scale(self):
        figure, results = self.draw(self.ARMS[:3])
        panels = [axes for axes in figure.axes if axes.get_xlabel().startswith("force")]
        assert len({(axes.get_xlim(), axes.get_ylim()) for axes in panels}) == 1
        for result, first, second in zip(results, panels[::2], panels[1::2], strict=True):
            assert "node 1 of 8" in first.get_title()
            worst = int(result.node_miss.mean(0).argmax())
            assert f"node {worst + 1 if worst else 8} of 8" in second.get_title()

    def test_sets_alone_show_newtons(self):
        arms = self.ARMS[:2]
        results = [ta.evaluate(arm, TASK, ("absolute",)) for _, arm in arms]
        figure = plot.study_figure(arms, "a task", TASK, results)
        assert figure.axes[0].get_xlabel().startswith("absolute unattainability [N]")
        held = int(results[0].not_excluded.sum())
        (arm,) = (axes for axes in figure.axes if axes.get_title().startswith("antagonistic: "))
        assert f"{held} not excluded" in arm.get_title()
        assert rows(forces(arm)) == rows(LOADS[:, :2]), "no load stands out, so all are drawn"

    def test_sets_are_those_of_the_shape_that_is_drawn(self):
        shapes = ta.affine_curvature([-0.5, 0.5], 0.5, length=0.5, nodes=8)
        figure, _ = self.draw(self.ARMS[:1], ta.Task(shapes[:, None], LOADS))
        (arm,) = (axes for axes in figure.axes if axes.get_xlabel() == "x [m]")
        index = int(re.search(r"drawn: load (\d+) of 60", arm.get_title())[1]) - 1
        (task,) = (line for line in arm.lines if line.get_gid() == "task")
        np.testing.assert_allclose(task.get_xydata()[-1], ta.poses(shapes[index // 30])[-1, :2], atol=1e-12)
        inside = ta.evaluate(ARM, ta.Task(shapes[index // 30], LOADS), ("absolute",)).absolute_per_node[:, 0] == 0
        (base,) = (axes for axes in figure.axes if "node 1 of 8" in axes.get_title())
        assert base.get_title().endswith(f"{int(inside.sum())} of 30 inside")

    def test_nothing_finite(self, tmp_path):
        result = ta.evaluate(self.ARMS[0][1], TASK, ("absolute",))
        lost = dataclasses.replace(result, absolute=torch.full_like(result.absolute, float("nan")))
        plot.study_figure(self.ARMS[:1], "a task", TASK, [lost]).savefig(tmp_path / "study.png", dpi=30)

    @pytest.mark.parametrize("dimension", [2, 3])
    def test_an_impossible_task_has_no_bar_and_says_why(self, dimension, tmp_path):
        arm, flat = (ARM if dimension == 2 else ta.antagonistic_ring()), dimension == 2
        shape = ta.constant_curvature(7.0, 0.5, 4, **({} if flat else {"direction": 0.0}))
        task = ta.Task(shape, torch.zeros(3, 3 * dimension - 3, dtype=torch.float64))
        found = ta.evaluate(arm, task)
        figure = plot.study_figure([("coiled", arm)], "a task", task, [found])
        errors, shown = figure.axes
        assert not [line for line in errors.lines if line.get_linewidth() == 2], "no bar"
        assert not errors.texts[0].get_text().startswith("2")
        for text in (errors.texts[0], shown.texts[0]):
            words = " ".join(text.get_text().split())
            assert words == f"impossible: {found.reason[0]}"
        low, high = errors.get_xlim()
        assert 0.01 < low < 1 < high < 10
        assert not [line for line in shown.lines if line.get_gid() == "bellows"]
        figure.savefig(tmp_path / "study.png", dpi=30)

    def test_an_arm_that_is_impossible_does_not_stretch_the_sets_of_others(self):
        arms = [("short", ta.antagonistic_arm(length=0.05)), ("long", ta.antagonistic_arm())]
        shape = ta.constant_curvature(3.0, 0.5, 4)
        task = ta.Task(shape, [0.0, -1.0, 0.0])
        results = [ta.evaluate(arm, task) for _, arm in arms]
        other = dataclasses.replace(results[0], impossible=torch.tensor(True))
        both = plot.study_figure(arms, "t", task, [other, results[1]])
        alone = plot.study_figure(arms[1:], "t", task, results[1:])
        limits = [
            {axes.get_xlim() for axes in page.axes if axes.get_xlabel().startswith("force")} for page in (both, alone)
        ]
        assert limits[0] == limits[1] != set()

    def test_most_tasks_without_a_stable_shape_have_no_median(self):
        result = ta.evaluate(ARM, TASK)
        lost = torch.arange(30) < 20
        prediction = dataclasses.replace(
            result.prediction,
            stable=result.prediction.stable & ~lost,
            **{
                name: torch.where(lost, torch.inf, getattr(result.prediction, name))
                for name in ("tip_error", "tip_rotation_error", "shape_error")
            },
        )
        figure = plot.study_figure([("a", ARM)], "t", TASK, [dataclasses.replace(result, prediction=prediction)])
        assert figure.axes[0].texts[0].get_text() == "no median: of 20 of 30 no stable shape was found"
        assert "inf" not in " ".join(text.get_text() for axes in figure.axes for text in axes.texts)

    def test_errors_name_the_field(self):
        arm = ta.antagonistic_arm()
        result = ta.evaluate(arm, TASK)
        with pytest.raises(ValueError, match=r"^results: must be one or more arms of different names, got"):
            plot.study_figure([("a", arm), ("a", arm)], "a task", TASK, [result] * 2)
        with pytest.raises(ValueError, match=r"^results: must be one or more arms"):
            plot.study_figure([], "a task", TASK, [])
        with pytest.raises(ValueError, match=r"^results\[0\]: must be one design"):
            plot.study_figure([("a", ta.antagonistic_arm(torch.tensor([0.05, 0.08])))], "a task", TASK, [result])
        with pytest.raises(ValueError, match=r"^evaluated: must hold one entry for each of the 1 results, got 2"):
            plot.study_figure([("a", arm)], "a task", TASK, [result] * 2)
        with pytest.raises(ValueError, match=r"^evaluated\[0\]: must hold one value for each of 5 tasks, got"):
            plot.study_figure([("a", arm)], "a task", ta.Task(TWISTS, LOADS[:5]), [result])
