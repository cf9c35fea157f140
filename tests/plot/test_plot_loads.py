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
            (lambda: plot.load_grid(0.0), "limit: must be a finite number and above 0 N, got 0"),
            (lambda: plot.polar_load_grid(math.inf), "limit: must be a finite number and above 0 N, got inf"),
            (lambda: plot.load_grid(count=1), "count: must be an integer of at least 2"),
            (lambda: plot.polar_load_grid(directions=2), "directions: must be an integer of at least 3"),
            (lambda: plot.load_grid(moment=math.nan), "moment: must be a finite number, got nan"),
            (lambda: plot.load_grid(plane="yx"), "plane: must be one of xy, xz, zy"),
            (lambda: plot.force_directions(rows=2), "rows: must be an integer of at least 3"),
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
        axes = plot.load_map(self.GRID, torch.full((21, 21), torch.nan))
        assert "not known: 441 of 441" in legend_text(axes)
        assert axes.get_xlim() == (-10.0, 10.0)

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
            ({"loads": torch.rand(21, 21, 6)}, "loads: must differ in two force components, or be of one size"),
            ({"values": torch.zeros(3, 3)}, r"values: must have shape \(21, 21\), got \(3, 3\)"),
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
        with pytest.raises(ValueError, match="task: must hold one shape, got 2"):
            plot.attainable_load_map(ta.antagonistic_arm(), torch.stack((SHAPE, 2 * SHAPE)))


RING = ta.ArmDesign(
    offsets=torch.cat((ta.ring(0.06, 3), ta.ring(0.03, 6, phase=0.5))),
    length=0.4,
    actuators=[ta.Bellows()] * 3 + [ta.McKibben()] * 6,
    mass=0.4,
)
BENT = ta.constant_curvature(0.4, 0.39, 5, direction=0.6)
WEIGHT = ta.ExternalLoad(gravity=True)


class TestSpace:
    def test_grids_of_each_plane_and_directions(self):
        for plane, (first, second) in {"xy": (0, 1), "xz": (0, 2), "zy": (2, 1)}.items():
            grid = plot.load_grid((4.0, 2.0), 5, plane=plane)
            assert grid[0, :, first].tolist() == [-4.0, -2.0, 0.0, 2.0, 4.0]
            assert grid[:, 0, second].tolist() == [-2.0, -1.0, 0.0, 1.0, 2.0]
            axes = plot.load_map(grid, grid.norm(dim=-1), contour=1.0, ax=Figure().add_subplot())
            assert (axes.get_xlabel()[13], axes.get_ylabel()[13]) == tuple(plane)
            (line,) = contour_lines(axes)
            np.testing.assert_allclose(np.hypot(*line.T), 1.0, atol=0.25)
        ways = plot.force_directions(3.0, 7, 9)
        torch.testing.assert_close(ways.norm(dim=-1), torch.full((7, 9), 3.0).double())
        torch.testing.assert_close(ways[0, :, 1], torch.full((9,), -3.0).double())

    def test_directions_are_drawn_by_azimuth_and_elevation(self):
        ways = plot.force_directions(2.0)
        axes = plot.load_map(ways, ways[..., 1], contour=1.0)  # half of the force is up: 30 degrees
        (line,) = contour_lines(axes)
        np.testing.assert_allclose(line[:, 1], 30.0, atol=0.1)
        assert line[:, 0].min() == pytest.approx(-180)
        axes = plot.load_map(ways, ways[..., 2], contour=1.9, ax=Figure().add_subplot())
        (line,) = contour_lines(axes)
        np.testing.assert_allclose(line.mean(0), [90.0, 0.0], atol=2.0)  # to the viewer
        assert "azimuth" in axes.get_xlabel()

    @pytest.mark.parametrize("plane", ["xz", "xy"])
    def test_the_line_is_where_load_capacity_ends(self, plane):
        """Of a hanging arm under its own weight."""
        loads = plot.load_grid(16.0, 31, plane=plane)
        axes = plot.attainable_load_map(RING, ta.Task(BENT, load=WEIGHT), loads=loads)
        points = np.concatenate(contour_lines(axes))
        points = points[(np.hypot(*points.T) > 1.0) & (np.abs(points).max(-1) < 15.9)]
        tips = torch.zeros(len(points), 6).double()
        tips[:, [0, "xyz".index(plane[1])]] = torch.from_numpy(points)
        found = ta.load_capacity(RING, ta.Task(BENT, tips, load=WEIGHT))
        miss = ((found.t_max - 1).abs() * torch.from_numpy(np.hypot(*points.T))).nan_to_num(9.0)
        assert len(points) > 30
        assert miss.median() < 0.1
        assert (miss < 0.5).double().mean() > 0.9

    def test_segments_in_series(self):
        arm = ta.series([RING, ta.RigidLink(length=0.02, mass=0.05), RING])
        task = ta.Task(BENT.repeat(2, 1), load=WEIGHT, segment_nodes=(5, 5))
        loads = plot.load_grid(5.0, 5, plane="zy")
        axes = plot.attainable_load_map(arm, task, loads=loads)
        whole = ta.Task(task.twists, loads, load=WEIGHT, segment_nodes=(5, 5))
        found = ta.evaluate(arm, whole, ("absolute",), signed=True).absolute
        assert "f_z" in axes.get_xlabel()
        assert 0 < int((found <= 0).sum()) < 25
        assert f"{int((found <= 0).sum())} of 25 within" in legend_text(axes)
