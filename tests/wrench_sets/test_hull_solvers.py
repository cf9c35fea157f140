"""One suite of problems for all solvers of distances to hulls, in the plane and in space."""

import importlib.util
import math
from functools import partial
from itertools import product

import numpy as np
import pytest
import torch
from oracle.vertex_sets import (
    NAMES,
    SETS,
    coordinates_of,
    derivatives,
    double,
    points_about,
    problems,
    random_problems,
    size_of,
)

import torcharm as ta

needs_qpth = pytest.mark.skipif(importlib.util.find_spec("qpth") is None, reason="qpth is not installed")
each_dimension = pytest.mark.parametrize("dimension", [2, 3])
each_name = pytest.mark.parametrize("name", NAMES)
EPS = np.finfo(float).eps

# Each solver, and the largest error of its distances over max|H - w|.
EXACT = {"engine": (ta.distance_to_hull, 1e-12), "nnls": (ta.nnls_distance, 1e-14)}
CHECKED = {"qpth": pytest.param(ta.qp_distance, 1e-6, marks=needs_qpth)}
SURE = EXACT | CHECKED
WITH_WEIGHTS = {
    "nnls": ta.nnls_distance,
    "qpth": pytest.param(ta.qp_distance, marks=needs_qpth),
    "SLSQP": ta.slsqp_distance,
}
each_sure = pytest.mark.parametrize(("solve", "tolerance"), SURE.values(), ids=SURE)
each_with_weights = pytest.mark.parametrize("solve", WITH_WEIGHTS.values(), ids=WITH_WEIGHTS)


def value_of(found):
    return found if isinstance(found, torch.Tensor) else found.value


def assert_right(solve, tolerance, name, dimension, scale=1.0):
    vertices, points, expected = problems(name, dimension)
    value = value_of(solve(double(points * scale), double(vertices * scale))).numpy() / scale
    rounding = EPS * coordinates_of(points, vertices)
    assert (np.abs(value - expected) <= tolerance * size_of(points, vertices) + 16 * rounding).all()
    # touching or not is a matter of rounding, never of a solver's tolerance
    touching = expected <= rounding
    if solve is ta.distance_to_hull or not name.startswith("near"):
        assert (value[touching] == 0).all()
    assert (value[touching] <= 64 * rounding[touching]).all()
    assert (value[expected >= 64 * rounding] > 0).all()


@each_sure
@each_dimension
@each_name
def test_distances_are_those_of_brute_force(name, dimension, solve, tolerance):
    assert_right(solve, tolerance, name, dimension)


@each_sure
@each_dimension
@pytest.mark.parametrize("scale", [1e-6, 1e16, 1e200, 1e-200])
@pytest.mark.parametrize("name", ["random", "duplicates", "nearly collinear", "one point", "far from the origin"])
def test_units_do_not_matter(name, scale, dimension, solve, tolerance):
    assert_right(solve, tolerance, name, dimension, scale)


@each_dimension
@each_name
def test_slsqp_is_right_where_it_says_so(name, dimension):
    vertices, points, expected = problems(name, dimension)
    found = ta.slsqp_distance(double(points), double(vertices))
    allowed = 1e-6 * size_of(points, vertices) + 16 * EPS * coordinates_of(points, vertices)
    assert (np.abs(found.value.numpy() - expected) <= allowed)[found.converged.numpy()].all()
    assert found.converged.double().mean() > 0.5


@each_with_weights
@each_dimension
@each_name
def test_weights_are_convex_and_mix_to_what_is_nearest(name, dimension, solve):
    vertices, points, _ = problems(name, dimension)
    found = solve(double(points), double(vertices))
    sure = found.converged
    assert sure.all() or solve is ta.slsqp_distance
    np.testing.assert_allclose(found.weights.sum(-1), 1.0, rtol=1e-12)
    assert found.weights.min() >= 0
    size, coordinates = (torch.from_numpy(of(points, vertices)) for of in (size_of, coordinates_of))
    mixed = (found.weights.unsqueeze(-1) * double(vertices)).sum(-2)
    assert ((mixed - found.nearest).norm(dim=-1) <= 2e-6 * size + 16 * EPS * coordinates)[sure].all()
    away = (found.nearest - double(points)).norm(dim=-1)
    assert ((away - found.value).abs() <= 1e-12 * size + 16 * EPS * coordinates)[sure].all()
    own = ta.kkt_residuals(double(points), double(vertices), found.weights)
    for field in ("primal", "dual", "gap"):
        np.testing.assert_allclose(getattr(found, field), getattr(own, field), rtol=0, atol=1e-15)
    assert own.primal[sure].max() <= 1e-6
    assert own.error[sure].max() <= 1e-6


# --- batches ---


@each_sure
@each_dimension
def test_alone_and_in_the_batch_answers_are_the_same(dimension, solve, tolerance):
    points, vertices = random_problems(500, 6, dimension)
    points = 0.5 * points
    together = value_of(solve(points, vertices))
    assert 20 < (together == 0).sum() < 400
    for index in range(0, 500, 50):
        alone = value_of(solve(points[index], vertices[index]))
        assert alone.item() == pytest.approx(together[index].item(), abs=min(tolerance, 1e-8))


@each_sure
@pytest.mark.parametrize(
    ("points", "vertices", "shape"),
    [
        ((4, 1, 2), (3, 6, 2), (4, 3)),
        ((2,), (3, 1, 6, 2), (3, 1)),
        ((4, 3, 2), (6, 2), (4, 3)),
        ((1, 4, 3, 3), (5, 1, 3, 6, 3), (5, 4, 3)),
        ((0, 3, 2), (1, 6, 2), (0, 3)),
        ((2, 1, 2), (2, 0, 6, 2), (2, 0)),
        ((2,), (6, 2), ()),
    ],
)
def test_batches_broadcast(points, vertices, shape, solve, tolerance):
    rng = np.random.default_rng(0)
    points, vertices = double(rng.normal(size=points) * 2), double(rng.normal(size=vertices))
    found = value_of(solve(points, vertices))
    assert found.shape == shape
    dimension = points.shape[-1]
    wide, corners = points.expand(*shape, dimension), vertices.expand(*shape, 6, dimension)
    for index in np.ndindex(*shape):
        alone = value_of(solve(wide[index], corners[index]))
        assert found[index].item() == pytest.approx(alone.item(), abs=1e-7)


@each_sure
@each_dimension
def test_order_duplicates_and_inner_vertices_do_not_matter(dimension, solve, tolerance):
    points, vertices = random_problems(40, 6, dimension)
    inner = vertices.mean(1, keepdim=True)
    order = torch.from_numpy(np.random.default_rng(1).permutation(13))
    more = torch.cat((vertices, vertices, inner), 1)[:, order]
    expected, found = (value_of(solve(points, hull)) for hull in (vertices, more))
    np.testing.assert_allclose(found, expected, rtol=0, atol=10 * tolerance)


@each_sure
@each_dimension
def test_rotation_and_translation_do_not_matter(dimension, solve, tolerance):
    points, vertices = random_problems(40, 6, dimension)
    turn = double(np.linalg.qr(np.random.default_rng(2).normal(size=(dimension, dimension)))[0])
    moved = value_of(solve(points @ turn + 7.0, vertices @ turn + 7.0))
    np.testing.assert_allclose(moved, value_of(solve(points, vertices)), rtol=0, atol=10 * tolerance + 1e-13)


@each_sure
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_nan_and_leaves_the_others_alone(bad, solve, tolerance):
    points, vertices = random_problems(6, 5, 3)
    clean = value_of(solve(points, vertices))
    points[1, 2], vertices[4, 3, 0] = bad, bad
    mixed = [value.clone().requires_grad_() for value in (points, vertices)]
    found = solve(*mixed)
    value, others = value_of(found), torch.tensor([0, 2, 3, 5])
    assert value[[1, 4]].isnan().all()
    np.testing.assert_allclose(value[others].detach(), clean[others], rtol=0, atol=1e-9)
    for own in derivatives(value[others], *mixed):
        assert own[others].isfinite().all()
    if value is not found:
        assert found.converged.tolist() == [True, False, True, True, False, True]


# --- gradients ---


@each_dimension
@pytest.mark.parametrize("solve", [ta.distance_to_hull, ta.nnls_distance], ids=EXACT)
def test_gradients_are_those_of_differences(dimension, solve):
    points, vertices = random_problems(12, 7, dimension, grad=True)
    assert torch.autograd.gradcheck(lambda p, v: value_of(solve(p, v)), (points, vertices), rtol=1e-6, atol=1e-7)


@each_sure
@each_dimension
@each_name
def test_gradients_are_finite_and_at_most_one(name, dimension, solve, tolerance):
    vertices, points = double(SETS[dimension][name], grad=True), double(points_about(SETS[dimension][name]), grad=True)
    value = value_of(solve(points, vertices))
    in_points, in_vertices = derivatives(value, points, vertices)
    length = in_points.norm(dim=-1)
    assert length.max() <= 1 + 1e-9 or (solve is ta.qp_distance and length.max() <= 1 + 1e-3)
    assert in_vertices.isfinite().all()
    assert (in_points[value == 0] == 0).all()
    # to move all together changes nothing
    np.testing.assert_allclose(in_points.sum(0) + in_vertices.sum(0), 0.0, atol=1e-8)


@each_sure
def test_second_derivatives_are_refused(solve, tolerance):
    point = double([[2.0, 0.5]], grad=True)
    square = double([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    (first,) = torch.autograd.grad(value_of(solve(point, square)).sum(), point, create_graph=True)
    with pytest.raises(RuntimeError, match="second derivatives"):
        torch.autograd.grad(first.sum(), point)


@each_sure
@each_dimension
def test_float32_is_solved_in_float64(dimension, solve, tolerance):
    points, vertices = (value.float().requires_grad_() for value in random_problems(30, 8, dimension))
    value = value_of(solve(points, vertices))
    exact = ta.distance_to_hull(points.detach().double(), vertices.detach().double())
    assert value.dtype == torch.float32
    np.testing.assert_allclose(value.detach(), exact, rtol=1e-6, atol=1e-6)
    assert {own.dtype for own in derivatives(value, points, vertices)} == {torch.float32}
    on_edge = torch.lerp(vertices[:, 0], vertices[:, 1], 0.3)
    assert (value_of(solve(on_edge, vertices[:, :2])) == 0).all()


# --- sums of hulls ---


def sums(vertices, groups):
    """All sums of one vertex of each group (B, S^G, D) of vertices (B, V, D)."""
    parts = vertices.unflatten(1, (groups, -1))
    every = product(range(parts.shape[2]), repeat=groups)
    return torch.stack([sum(parts[:, g, i] for g, i in enumerate(which)) for which in every], 1)


@pytest.mark.parametrize(("groups", "count"), [(2, 4), (3, 3), (4, 3)])
@each_with_weights
@each_dimension
def test_sums_of_hulls_are_the_hulls_of_sums(dimension, solve, groups, count):
    points, vertices = random_problems(40, groups * count, dimension)
    points = 0.5 * groups**0.5 * points
    expected = ta.distance_to_hull(points, sums(vertices, groups))
    found = solve(points, vertices, groups=groups)
    sure = found.converged
    assert sure.all() or (solve is ta.slsqp_distance and sure.double().mean() > 0.5)
    assert (expected == 0).any()
    tolerance = {ta.nnls_distance: 1e-12}.get(solve, 1e-6)
    np.testing.assert_allclose(found.value[sure], expected[sure], rtol=0, atol=tolerance)
    np.testing.assert_allclose(found.weights.unflatten(1, (groups, -1)).sum(-1), 1.0, rtol=1e-12)
    if solve is not ta.slsqp_distance:
        assert torch.equal(found.value == 0, expected == 0)
    if solve is ta.qp_distance:
        assert found.resolved.double().mean() <= 0.1


@pytest.mark.parametrize(
    ("solve", "tolerance"),
    [(ta.nnls_distance, 1e-9), pytest.param(ta.qp_distance, 2e-3, marks=needs_qpth)],
    ids=["nnls", "qpth"],
)
@each_dimension
def test_gradients_of_sums_are_those_through_all_sums(dimension, solve, tolerance):
    points, vertices = random_problems(30, 9, dimension, grad=True)
    expected = derivatives(ta.distance_to_hull(points, sums(vertices, 3)), points, vertices)
    found = derivatives(solve(points, vertices, groups=3).value, points, vertices)
    for own, exact in zip(found, expected, strict=True):
        np.testing.assert_allclose(own, exact, rtol=0, atol=tolerance)


@each_with_weights
def test_flat_groups_and_groups_of_one_point(solve):
    """A segment, a point and a segment in parallel to the first: a segment in all, shifted."""
    vertices = double([[0, 0, 0], [1, 0, 0], [5, 5, 0], [5, 5, 0], [0, 0, 1], [2, 0, 1.0]])
    points = double([[4.0, 5, 1], [6.5, 5, 1], [6.0, 7, 1], [10.0, 5, 1]])
    found = solve(points, vertices, groups=3)
    np.testing.assert_allclose(found.value, [1.0, 0.0, 2.0, 2.0], rtol=0, atol=1e-6)
    assert found.converged.all()
    assert found.value[1] == 0 or solve is ta.slsqp_distance


# --- what is refused ---


@each_sure
def test_sets_without_a_point_are_refused(solve, tolerance):
    with pytest.raises(ValueError, match=r"^vertices: .* none"):
        solve(torch.zeros(2), torch.zeros(0, 2))


@each_with_weights
@pytest.mark.parametrize("groups", [0, 4, True])
def test_groups_that_do_not_divide_the_vertices_are_refused(solve, groups):
    with pytest.raises(ValueError, match=r"^groups: "):
        solve(torch.zeros(2), torch.zeros(6, 2), groups=groups)


def test_a_partial_is_a_solver_too():
    solve = partial(ta.nnls_distance, groups=2)
    assert solve(double([3.0, 0.0]), double([[0, 0], [1, 0], [0, 0], [1.0, 0]])).value == 1
