import matplotlib as mpl
import numpy as np
import pytest
import torch

import torcharm as ta
from torcharm.inputs import three_digits

mpl.use("Agg")
from matplotlib import pyplot as plt

from torcharm import plot


@pytest.fixture(autouse=True)
def _close():
    yield
    plt.close("all")


@pytest.fixture(scope="module")
def flat():
    return ta.workspace(ta.mckibben_arm(length=0.4), [0.0, 1.0, 0.0], states=800, nodes=4)


@pytest.fixture(scope="module")
def spatial():
    return ta.workspace(ta.antagonistic_ring(), 0.1, states=800, nodes=4)


def labels(axes):
    return [text.get_text() for text in axes.get_legend().get_texts()]


def coloured(axes, show):
    (found,) = [one for one in axes.collections if one.get_gid() == show]
    return found


class TestWorkspace:
    def test_what_is_apart_is_told(self, flat):
        said = " | ".join(labels(plot.workspace(flat)))
        share = 100 * flat.shares["snapped"]
        assert f"snapped: {share:.2g} % of states" in said
        assert "unstable: " in said
        assert "reached" in said

    def test_colours_are_the_best_factors_of_cells(self, flat):
        shades = coloured(plot.workspace(flat), "payload factor")
        cells = flat.cells()
        finite = cells.payload_factor[cells.payload_factor.isfinite()]
        assert shades.get_array().max() == pytest.approx(float(finite.max()))
        assert len(shades.get_array()) == int(flat.region.kept.sum())

    def test_angles(self, flat):
        shades = coloured(plot.workspace(flat, "angle range"), "angle range").get_array()
        cells = flat.cells()
        ranges = (cells.angle_max - cells.angle_min).rad2deg()
        assert np.isclose(shades[:, None], ranges.numpy()[None], rtol=0, atol=1e-9).any(1).all()
        assert shades.max() > 1.0

    def test_without_payload_only_the_region_is_shown(self):
        found = ta.workspace(ta.antagonistic_arm(), states=300, nodes=3)
        axes = plot.workspace(found)
        assert {"reached", "excluded by range", "base"} <= set(labels(axes))
        assert len(axes.figure.axes) == 1
        with pytest.raises(ValueError, match="show: must not be payload factor"):
            plot.workspace(found, "payload factor")

    @pytest.mark.parametrize(("plane", "sides"), [("xy", (0, 1)), ("zy", (2, 1)), ("xz", (0, 2))])
    def test_planes_of_space(self, spatial, plane, sides):
        axes = plot.workspace(spatial, plane=plane)
        assert (axes.get_xlabel()[0], axes.get_ylabel()[0]) == tuple(plane)
        assert axes.yaxis.get_inverted() == (plane == "xz")
        line = next(one for one in axes.lines if one.get_label() == "reached")
        place = spatial.position[spatial.reached][:, list(sides)]
        assert line.get_xdata().max() == pytest.approx(float(place[:, 0].max()), abs=spatial.resolution)
        assert line.get_ydata().min() == pytest.approx(float(place[:, 1].min()), abs=spatial.resolution)

    def test_mistakes(self, flat, spatial):
        with pytest.raises(ValueError, match="show: must be one of"):
            plot.workspace(flat, "area")
        with pytest.raises(ValueError, match="plane: must be left out"):
            plot.workspace(flat, plane="xy")
        with pytest.raises(ValueError, match="plane: must be one of"):
            plot.workspace(spatial, plane="yx")

    def test_nothing_reached(self):
        spring = ta.PolynomialActuator(((0, 1, 2.0), (1, 0, -100.0)), (0.5, 0.6), (0, 50), 5.0, 0.0)
        found = ta.workspace(ta.ArmDesign([-0.03, 0.03], 0.2, [spring] * 2), [0.0, -1.0, 0.0], states=200, nodes=2)
        figure = plot.workspace_figure([("stiff", found)])
        assert "nothing reached in range" in figure.axes[0].get_title()


class TestFigure:
    def test_one_scale(self, flat):
        other = ta.workspace(ta.bellows_arm(), [0.0, -1.0, 0.0], states=400, nodes=4)
        figure = plot.workspace_figure([("muscles", flat), ("bellows", other)])
        first, second, bar = figure.axes
        assert first.get_xlim() == second.get_xlim()
        assert first.get_ylim() == second.get_ylim()
        norms = [coloured(axes, "payload factor").norm for axes in (first, second)]
        assert norms[0].vmax == norms[1].vmax
        assert first.get_title().startswith("muscles\n")
        assert f"{three_digits(1e4 * other.size)} cm² reached" in second.get_title()
        assert "payload" in bar.get_ylabel()

    def test_a_region_without_an_area_is_drawn_as_points(self, recwarn):
        line = ta.workspace(
            ta.ArmDesign(radii=[0.0], length=0.4, actuators=["mckibben"]),
            0.1,
            states=100,
            nodes=3,
            callback=lambda *_: True,
        )
        figure = plot.workspace_figure([("line", line)])
        (axes,) = (own for own in figure.axes if own.get_xlabel().startswith("x"))
        points = axes.collections[0].get_offsets()
        np.testing.assert_allclose(points, line.position[line.reached])
        (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
        assert right - left == pytest.approx(plot._common.NARROWEST * (top - bottom))
        assert f"interrupted: {len(line.code)} of 100 states" in axes.get_title()
        assert not recwarn.list

    def test_space_has_two_views_and_rows_wrap(self, flat, spatial):
        assert len(plot.workspace_figure([("ring", spatial)]).axes) == 3
        wrapped = plot.workspace_figure([("a", flat), ("b", flat), ("c", flat)], columns=2)
        assert [axes.axison for axes in wrapped.axes[:4]] == [True, True, True, False]

    def test_mistakes(self, flat, spatial):
        with pytest.raises(ValueError, match="results: must hold at least one workspace"):
            plot.workspace_figure([])
        with pytest.raises(ValueError, match="results: must be all of the plane or all of space"):
            plot.workspace_figure([("a", flat), ("b", spatial)])


class TestLoadFigure:
    ARMS = (("antagonistic", ta.antagonistic_arm()), ("bellows", ta.bellows_arm()))
    TASK = ta.Task(ta.affine_curvature(0.0, 0.5, nodes=4))

    def test_errors_in_millimetres_at_one_scale(self):
        loads = plot.load_grid(4.0, 3)
        figure = plot.load_figure(self.ARMS, self.TASK, loads=loads)
        first, second, bar = figure.axes
        shades = [axes.collections[0] for axes in (first, second)]
        np.testing.assert_array_equal(shades[0].levels, shades[1].levels)
        assert shades[0].levels[0] == 0
        error = 1e3 * ta.evaluate(self.ARMS[1][1], ta.Task(self.TASK.twists, loads), ("predicted_error",)).tip_error
        verdict = ta.evaluate(self.ARMS[1][1], ta.Task(self.TASK.twists, loads), ("predicted_error",)).verdict
        assert f"held: {(verdict == 'held').sum()} of 9 forces" in second.get_title()
        assert f"{(verdict == 'missed').sum()} missed" in second.get_title()
        assert f"{float(error.max()):.3g} mm (most)" in second.get_title()
        assert bar.get_ylabel() == "tip error [mm]"
        norm, ticks = shades[1].norm, bar.get_yticks()
        assert (norm.vmin, norm.vcenter, norm.vmax) == (0.0, 10.0, 40.0)  # the tolerance is seen, whatever the errors
        assert {0.0, 10.0, 40.0} <= set(ticks)
        assert error.max() > 40
        assert bar.get_ylim()[1] == 40
        assert shades[1].extend == "max"

    def test_what_is_within_the_tip_s_tolerance_and_not_held_is_hatched(self):
        loads = plot.load_grid(4.0, 3)
        figure = plot.load_figure(self.ARMS[:1], self.TASK, loads=loads)
        found = ta.evaluate(self.ARMS[0][1], ta.Task(self.TASK.twists, loads), ("predicted_error",))
        odd = (found.tip_error <= 0.01).numpy() & (found.verdict != "held")
        assert odd.any()
        words = [text.get_text() for text in figure.legends[0].get_texts()]
        assert "tip within tolerance, yet not held: turn, shape, range or stability" in words
        assert any(shades.hatches == ["///"] for shades in figure.axes[0].collections if hasattr(shades, "hatches"))

    def test_factors(self):
        loads = plot.load_grid(4.0, 3)
        arm = self.ARMS[0][1]
        held = ta.solve_equilibrium(arm, [30.0, 40.0, 40.0, 10.0], torch.zeros(3).double(), 4).twists
        figure = plot.load_figure([("one", arm)], ta.Task(held), "payload factor", loads=loads)
        factor = ta.load_capacity(arm, ta.Task(held, loads)).factor
        borne = int((factor >= 1).sum())
        assert borne > 0
        assert f"not excluded at this shape: {borne} of 9 forces" in figure.axes[0].get_title()
        assert not any("no multiple" in text.get_text() for text in figure.legends[0].get_texts())
        assert bool(factor[1, 1].isinf())  # what weighs nothing could grow without end: no gap in the map

    def test_where_no_force_is_possible_the_panel_says_so(self):
        loads = plot.load_grid(1.0, 3)
        figure = plot.load_figure(self.ARMS, ta.Task(ta.affine_curvature(0.5, 0.5)), "payload factor", loads=loads)
        none = figure.axes[1]
        assert "0 of 9 forces" in none.get_title()
        assert none.axison
        assert not none.collections
        assert "no multiple of the force possible at this shape" in [
            text.get_text() for text in figure.legends[0].get_texts()
        ]

    def test_mistakes(self):
        with pytest.raises(ValueError, match="quantity: must be one of tip error, payload factor"):
            plot.load_figure(self.ARMS, self.TASK, "error")
        with pytest.raises(ValueError, match="arms: must hold at least one arm"):
            plot.load_figure([], self.TASK)
