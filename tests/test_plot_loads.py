import math

import matplotlib as mpl
import numpy as np
import pytest
import torch

import torcharm as ta

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

from torcharm import plot

SHAPE = ta.affine_curvature(1.0, 1.5, nodes=6)


@pytest.fixture(autouse=True)
def _close():
    yield
    plt.close("all")


def contour_lines(axes):
    """The vertices of all drawn contour lines at one level."""
    sets = [artist for artist in axes.collections if type(artist).__name__ == "QuadContourSet" and not artist.filled]
    return [path.vertices for one in sets for path in one.get_paths() if len(path.vertices)]


def legend_text(axes):
    return " | ".join(text.get_text() for text in axes.get_legend().get_texts())


def bar_of(axes):
    (bar,) = [other for other in axes.figure.axes if other is not axes]
    return bar


class TestGrids:
    def test_cartesian(self):
        grid = plot.load_grid((4.0, 2.0), 5, moment=0.5)
        assert grid.shape == (5, 5, 3)
        assert grid[0, :, 0].tolist() == [-4.0, -2.0, 0.0, 2.0, 4.0]
        assert grid[:, 0, 1].tolist() == [-2.0, -1.0, 0.0, 1.0, 2.0]
        assert (grid[..., 2] == 0.5).all()

    def test_polar(self):
        grid = plot.polar_load_grid(6.0, 4, 12)
        assert grid.shape == (4, 13, 3)
        torch.testing.assert_close(
            grid.norm(dim=-1), torch.tensor([0.0, 2.0, 4.0, 6.0]).double()[:, None].expand(4, 13)
        )
        torch.testing.assert_close(grid[:, 0], grid[:, -1])

    @pytest.mark.parametrize(
        ("make", "message"),
        [
            (lambda: plot.load_grid(0.0), "limit: must be finite and above 0 N, got 0"),
            (lambda: plot.polar_load_grid(math.inf), "limit: must be finite and above 0 N, got inf"),
            (lambda: plot.load_grid(count=1), "count: must be an integer of at least 2"),
            (lambda: plot.polar_load_grid(directions=2), "directions: must be an integer of at least 3"),
            (lambda: plot.load_grid(moment=math.nan), "moment: must be finite, got nan"),
        ],
    )
    def test_mistakes(self, make, message):
        with pytest.raises(ValueError, match=message):
            make()


class TestLoadMap:
    GRID = plot.load_grid(10.0, 21)

    def test_the_contour_is_where_the_values_say(self):
        ax = Figure().add_subplot()
        size = self.GRID.norm(dim=-1)
        axes = plot.load_map(self.GRID, size, quantity="predicted error", unit="mm", contour=5.0, ax=ax)
        assert axes is ax
        (line,) = contour_lines(axes)
        np.testing.assert_allclose(np.hypot(*line.T), 5.0, atol=0.05)
        assert "predicted error = 5 mm" in legend_text(axes)
        assert bar_of(axes).get_ylabel() == "predicted error [mm]"
        assert axes.get_xlabel().endswith("[N]")
        axes.figure.canvas.draw()

    def test_both_signs_meet_at_zero(self):
        values = torch.where(self.GRID[..., 0] > 0, 50.0 * self.GRID[..., 0], self.GRID[..., 0])
        axes = plot.load_map(self.GRID, values)
        (line,) = contour_lines(axes)
        np.testing.assert_allclose(line[:, 0], 0.0, atol=1e-9)
        (shades,) = [c for c in axes.collections if type(c).__name__ == "QuadContourSet" and c.filled]
        assert shades.norm(0.0) == 0.5
        assert (shades.norm(-10.0), shades.norm(500.0)) == (0.0, 1.0)

    def test_what_is_not_finite_is_counted(self):
        values = self.GRID.norm(dim=-1)
        values[0, 0], values[3, 4] = torch.nan, torch.inf
        axes = plot.load_map(self.GRID, values)
        assert "not known: 2 of 441" in legend_text(axes)
        axes.figure.canvas.draw()

    def test_a_level_that_is_not_reached_draws_no_line(self):
        axes = plot.load_map(self.GRID, self.GRID.norm(dim=-1) + 1.0, contour=0.5)
        assert not contour_lines(axes)

    @pytest.mark.parametrize("values", [torch.zeros(21, 21), torch.full((21, 21), -2.0), torch.full((21, 21), 3.0)])
    def test_one_value_everywhere(self, values):
        plot.load_map(self.GRID, values).figure.canvas.draw()

    @pytest.mark.parametrize(
        ("given", "message"),
        [
            ({"loads": torch.zeros(5, 3)}, r"loads: must have shape \(R, C, 3\)"),
            ({"values": torch.zeros(3, 3)}, r"values: must have shape \(21, 21\), got \(3, 3\)"),
            ({"values": torch.full((21, 21), math.nan)}, "values: must hold at least one finite value"),
        ],
    )
    def test_mistakes(self, given, message):
        with pytest.raises(ValueError, match=message):
            plot.load_map(**({"loads": self.GRID, "values": torch.zeros(21, 21)} | given))


class TestAttainableLoadMap:
    @pytest.mark.parametrize("loads", [plot.load_grid(20.0, 41), plot.polar_load_grid(20.0, 41, 90)])
    def test_the_line_is_where_load_capacity_ends(self, loads):
        arm = ta.antagonistic_arm()
        axes = plot.attainable_load_map(arm, SHAPE, loads=loads)
        points = torch.as_tensor(np.concatenate(contour_lines(axes)))
        # Off the grid's border, where the line is cut off, every point of it is the last that its direction allows.
        points = points[points.norm(dim=-1) > 2.0]
        tips = torch.cat((points, torch.zeros(len(points), 1)), -1).double()
        found = ta.load_capacity(arm, ta.Task(SHAPE, tips))
        miss = torch.minimum((found.t_max - 1).abs(), (found.t_min - 1).abs()) * points.norm(dim=-1)
        assert len(points) > 30
        assert miss.nan_to_num(9.0).median() < 0.15
        assert (miss.nan_to_num(9.0) < 0.5).double().mean() > 0.9

    def test_counts_and_range(self):
        arm, loads = ta.antagonistic_arm(), plot.load_grid(20.0, 11)
        found = ta.evaluate(arm, ta.Task(SHAPE, loads), ("absolute",), signed=True)
        axes = plot.attainable_load_map(arm, SHAPE, loads=loads)
        assert f"{int((found.absolute <= 0).sum())} of 121 within" in legend_text(axes)
        assert any("beyond range" in text.get_text() for text in axes.texts) == (not bool(found.in_range.all()))

    def test_mistakes(self):
        with pytest.raises(ValueError, match="arm: must be one design"):
            plot.attainable_load_map(ta.antagonistic_arm(torch.tensor([0.05, 0.08])), SHAPE)
        with pytest.raises(ValueError, match="twists: must hold one shape"):
            plot.attainable_load_map(ta.antagonistic_arm(), SHAPE.expand(2, -1, -1))
