import numpy as np
import pytest

from torcharm.geometry.alpha_shape import alpha_shape


def grid(*counts, step=0.01):
    return step * np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), -1).reshape(-1, len(counts))


def enclosed(loop):
    """The signed area of a closed line, by Gauss's formula."""
    x, y = loop.T
    return 0.5 * float((x[:-1] * y[1:] - x[1:] * y[:-1]).sum())


def test_dents_stay():
    points = grid(21, 21)
    points = points[(points[:, 0] < 0.105) | (points[:, 1] < 0.105)]  # an L
    shape = alpha_shape(points, 0.008)
    assert shape.size == pytest.approx(0.2 * 0.2 - 0.1 * 0.1, rel=0.01)
    assert shape.contains(np.array([[0.05, 0.15], [0.15, 0.15], [0.3, 0.05]])).tolist() == [True, False, False]
    assert len(shape.loops()) == 1
    assert enclosed(shape.loops()[0]) == pytest.approx(shape.size)


def test_holes_stay_and_are_gone_round_the_other_way():
    points = grid(41, 41) - 0.2
    radius = np.linalg.norm(points, axis=1)
    shape = alpha_shape(points[(radius < 0.2) & (radius > 0.08)], 0.01)
    areas = sorted(map(enclosed, shape.loops()))
    assert len(areas) == 2
    assert areas[0] < 0 < areas[1]
    assert sum(areas) == pytest.approx(shape.size)
    assert not shape.contains(np.zeros((1, 2)))[0]


def test_a_block_of_space():
    points = np.random.default_rng(0).random((4000, 3)) * (0.05, 0.07, 0.04)
    shape = alpha_shape(points, 0.008)
    assert 0.85 * 0.05 * 0.07 * 0.04 < shape.size < 0.05 * 0.07 * 0.04
    centre = points[shape.facets].mean(1)
    assert shape.contains(centre - 1e-7 * shape.normals).all()
    assert not shape.contains(centre + 1e-7 * shape.normals).any()


@pytest.mark.parametrize("points", [np.zeros((0, 2)), np.zeros((2, 2)), grid(9, 1), grid(9, 1, 1)])
def test_points_without_extent_make_no_region(points):
    shape = alpha_shape(points, 1.0)
    assert shape.size == 0
    assert shape.facets.shape == (0, points.shape[1])
    assert not shape.contains(np.zeros((3, points.shape[1]))).any()


def test_gaps_wider_than_twice_alpha_part():
    points = np.concatenate((grid(5, 5), grid(5, 5) + np.array([0.1, 0.0])))
    assert alpha_shape(points, 0.02).size == pytest.approx(2 * 0.04**2)
    assert alpha_shape(points, 0.2).size == pytest.approx(0.14 * 0.04)


@pytest.mark.parametrize("size", [2, 3])
def test_a_grid_of_points_has_no_holes_where_its_simplices_are_flat(size):
    shape = alpha_shape(grid(*[5] * size, step=0.1), 0.1)
    assert shape.size == pytest.approx(0.4**size)
    corners = shape.points[shape.facets]
    within_a_side = np.ptp(corners, axis=1) < 1e-12
    assert (within_a_side & (np.isclose(corners[:, 0], 0.0) | np.isclose(corners[:, 0], 0.4))).any(1).all()
