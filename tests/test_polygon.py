import math

import numpy as np
import oracle
import pytest
import torch

from torcharm.polygon import all_faces, convex_hull, heading_key, minkowski_sum

RNG = np.random.default_rng(7)

POINT_SETS = {
    "random": RNG.normal(size=(12, 2)),
    "one point": np.array([[2.0, -1.0]]),
    "two points": np.array([[2.0, -1.0], [0.5, 3.0]]),
    "the same point": np.full((5, 2), 0.3),
    "duplicates": np.repeat(RNG.normal(size=(5, 2)), 3, axis=0),
    "ties in x": np.array([[0, 0], [0, 3], [0, 1], [2, -1], [2, 4], [2, 2], [1, 9], [1, -9.0]]),
    "ties in x, all on the hull": np.array([[0, 0], [0, 1], [1, 0], [1, 1.0]]),
    "grid": np.array([[x, y] for x in range(4) for y in range(3)], dtype=float),
    "vertical line": np.array([[1, 4], [1, -2], [1, 0], [1, 4.0]]),
    "horizontal line": np.array([[4, 1], [-2, 1], [0, 1], [3, 1.0]]),
    "sloping line": np.outer([0.0, 1.0, -2.0, 0.5, 0.5], [1.0, 2.0]),
    "circle": np.array([[math.cos(a), math.sin(a)] for a in np.linspace(0, 6, 30)]),
    "parabola, ends first": np.array([[x, x * x] for x in (-3, 3, 0, 1, -1, 2, -2.0)]),
    "signed zeros": np.array([[0.0, -0.0], [-0.0, 0.0], [0.0, 1.0], [1.0, -0.0], [-0.0, 1.0]]),
}


def columns(points):
    return torch.tensor(points[:, 0])[:, None], torch.tensor(points[:, 1])[:, None]


def corners(polygons, column=0):
    """The distinct vertices of a polygon in the order in which its slots name them."""
    points = torch.stack((polygons.x[:, column], polygons.y[:, column]), -1).tolist()
    kept = [point for index, point in enumerate(points) if point != points[index - 1]]
    return np.array(kept or points[:1])


def ordered(points):
    """Rotated so that the least point is first; the order round the polygon stays."""
    first = min(range(len(points)), key=lambda index: tuple(points[index]))
    return np.roll(points, -first, axis=0) + 0.0


@pytest.mark.parametrize("name", POINT_SETS)
def test_convex_hull_has_the_corners_of_qhull_in_the_same_order(name):
    polygons, _, _ = convex_hull(*columns(POINT_SETS[name]))
    np.testing.assert_array_equal(ordered(corners(polygons)), ordered(oracle.hull(POINT_SETS[name])))


@pytest.mark.parametrize("name", POINT_SETS)
def test_convex_hull_does_not_depend_on_the_order_of_the_points(name):
    points = POINT_SETS[name]
    expected = ordered(corners(convex_hull(*columns(points))[0]))
    for seed in range(5):
        shuffled = np.random.default_rng(seed).permutation(points)
        np.testing.assert_array_equal(ordered(corners(convex_hull(*columns(shuffled))[0])), expected)


@pytest.mark.parametrize("name", POINT_SETS)
def test_edges_join_the_points_that_source_and_target_name(name):
    points = torch.tensor(POINT_SETS[name])
    polygons, source, target = convex_hull(*columns(POINT_SETS[name]))
    start, end = points[source[:, 0]], points[target[:, 0]]
    assert torch.equal(torch.cat((polygons.x, polygons.y), 1), start)
    assert torch.equal(torch.cat((polygons.edge_x, polygons.edge_y), 1), end - start)


@pytest.mark.parametrize("name", POINT_SETS)
def test_edges_of_a_hull_go_round_once_counter_clockwise(name):
    polygons, _, _ = convex_hull(*columns(POINT_SETS[name]))
    edges = torch.cat((polygons.edge_x, polygons.edge_y), 1)
    edges = edges[(edges != 0).any(1)].numpy()
    np.testing.assert_allclose(edges.sum(0), 0.0, atol=1e-14)
    if len(edges) == 0:
        assert len(np.unique(POINT_SETS[name], axis=0)) == 1
        return
    heading = np.arctan2(edges[:, 1], edges[:, 0])
    turns = np.mod(np.roll(heading, -1) - heading, 2 * math.pi)
    assert np.all(turns > 0)
    assert turns.sum() == pytest.approx(2 * math.pi)


@pytest.mark.parametrize("name", POINT_SETS)
def test_all_points_lie_behind_every_face(name):
    points = torch.tensor(POINT_SETS[name])
    polygons, _, _ = convex_hull(*columns(POINT_SETS[name]))
    slot, normal_x, normal_y = (value[0] for value in all_faces(polygons))
    normal = torch.stack((normal_x, normal_y), -1)
    torch.testing.assert_close(normal.norm(dim=-1), torch.ones_like(normal_x))
    corner = torch.cat((polygons.x, polygons.y), 1)[slot]
    ahead = ((points[:, None] - corner) * normal).sum(-1)
    assert ahead.max() < 1e-14 * (1 + points.abs().max())
    edges = torch.cat((polygons.edge_x, polygons.edge_y), 1)
    assert {tuple(edge) for edge in edges.tolist() if any(edge)} == {
        tuple(edge) for edge in edges[slot].tolist() if any(edge)
    }


def test_hulls_of_a_batch_equal_the_hulls_one_by_one():
    points = RNG.integers(-3, 4, size=(200, 9, 2)).astype(float)  # full of ties, duplicates and lines
    polygons, _, _ = convex_hull(torch.tensor(points[..., 0].T.copy()), torch.tensor(points[..., 1].T.copy()))
    for column, cloud in enumerate(points):
        np.testing.assert_array_equal(ordered(corners(polygons, column)), ordered(oracle.hull(cloud)))


@pytest.mark.parametrize("gap", [1e-14, 1e-12, 1e-9])
def test_near_duplicates_move_no_corner_by_more_than_their_gap(gap):
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    jitter = np.random.default_rng(3).uniform(-gap, gap, size=(40, 2))
    polygons, _, _ = convex_hull(*columns(np.repeat(square, 10, axis=0) + jitter))
    found = corners(polygons)
    nearest = np.linalg.norm(found[:, None] - square, axis=-1)
    assert np.all(nearest.min(1) <= 2 * gap)
    assert np.all(nearest.min(0) <= 2 * gap)


def test_heading_key_sorts_as_the_angle_from_straight_down_does():
    angle = np.linspace(-math.pi / 2 + 1e-6, 3 * math.pi / 2 - 1e-6, 1001)
    length = np.random.default_rng(1).uniform(1e-9, 1e9, size=angle.shape)
    key = heading_key(torch.tensor(length * np.cos(angle)), torch.tensor(length * np.sin(angle)))
    assert torch.all(key.diff() > 0)


@pytest.mark.parametrize("zero", [0.0, -0.0])
def test_heading_key_of_the_axes_ascends_from_straight_down(zero):
    x = torch.tensor([zero, 1.0, zero, -1.0], dtype=torch.float64)
    y = torch.tensor([-1.0, zero, 1.0, zero], dtype=torch.float64)
    assert torch.all(heading_key(x, y).diff() > 0)


def test_heading_key_is_the_same_for_parallel_edges_of_any_length():
    x, y = torch.tensor([0.5, -2.0, 3.0]), torch.tensor([-0.25, 1.0, 4.0])
    assert torch.equal(heading_key(x, y), heading_key(x * 1024, y * 1024))


def test_heading_key_of_a_zero_edge_is_finite():
    assert heading_key(torch.zeros(1), torch.zeros(1)).isfinite().all()


def summed(summands):
    """The Minkowski sum of point sets, as minkowski_sum makes it of their hulls, and the hulls' edges."""
    hulls = [convex_hull(*columns(np.asarray(points, dtype=float)))[0] for points in summands]
    starts = [
        max(((x, y) for x, y in corners(polygons).tolist()), key=lambda point: (-point[0], point[1]))
        for polygons in hulls
    ]
    start = torch.tensor(starts, dtype=torch.float64).sum(0)
    edge_x = torch.cat([polygons.edge_x for polygons in hulls])
    edge_y = torch.cat([polygons.edge_y for polygons in hulls])
    return minkowski_sum(start[:1], start[1:], edge_x, edge_y), edge_x, edge_y


SUMMANDS = {
    "one": ["random"],
    "two": ["random", "circle"],
    "identical": ["random", "random", "random"],
    "segments": ["two points", "sloping line", "horizontal line"],
    "parallel segments": ["sloping line", "sloping line"],
    "vertical segments": ["vertical line", "vertical line"],
    "vertical edges": ["vertical line", "ties in x", "ties in x, all on the hull"],
    "points": ["one point", "the same point"],
    "a point and a polygon": ["one point", "grid"],
    "everything": list(POINT_SETS),
}


@pytest.mark.parametrize("names", SUMMANDS.values(), ids=SUMMANDS)
def test_minkowski_sum_has_the_hull_of_all_sums_of_points(names):
    clouds = [POINT_SETS[name] for name in names]
    polygons, _, _ = summed(clouds)
    found, expected = corners(polygons), oracle.minkowski_hull(clouds)
    for point in found:
        assert abs(oracle.distance(point, expected)) < 1e-13
    for point in expected:
        assert abs(oracle.distance(point, oracle.hull(found))) < 1e-13


@pytest.mark.parametrize("names", SUMMANDS.values(), ids=SUMMANDS)
def test_minkowski_sum_takes_every_edge_once_by_heading_and_closes(names):
    polygons, edge_x, edge_y = summed([POINT_SETS[name] for name in names])
    found = torch.cat((polygons.edge_x, polygons.edge_y), 1).tolist()
    assert sorted(found) == sorted(torch.cat((edge_x, edge_y), 1).tolist())
    assert torch.all(heading_key(polygons.edge_x, polygons.edge_y).diff(dim=0) >= 0)
    torch.testing.assert_close(polygons.x + polygons.edge_x, polygons.x.roll(-1, 0), rtol=0, atol=1e-13)
    torch.testing.assert_close(polygons.y + polygons.edge_y, polygons.y.roll(-1, 0), rtol=0, atol=1e-13)
