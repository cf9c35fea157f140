import math

import numpy as np
import pytest
import torch
from hull_cases import VERTEX_SETS, double, points_about, size_of
from torcharm.distance.result import kkt_residuals
from torcharm.distance.scipy_solvers import nnls_distance, slsqp_distance

from torcharm import distance_to_hull

SQUARE = double([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def problems(name, scale=1.0):
    vertices = VERTEX_SETS[name]
    points = np.concatenate((points_about(vertices, 30), vertices[:8], (vertices[:4] + vertices[-4:][::-1]) / 2))
    return double(points * scale), double(vertices * scale)


# --- agreement ---


@pytest.mark.parametrize("scale", [1.0, 1e-6, 1e6])
@pytest.mark.parametrize("name", VERTEX_SETS)
def test_nnls_agrees_with_the_closed_form(name, scale):
    points, vertices = problems(name, scale)
    found, expected = nnls_distance(points, vertices), distance_to_hull(points, vertices)
    np.testing.assert_allclose(found.value, expected, rtol=0, atol=1e-12 * size_of(points.numpy(), vertices.numpy()))
    assert found.converged.all()
    assert not found.resolved.any()
    assert torch.stack((found.primal, found.dual, found.gap.abs())).max() < 1e-12


@pytest.mark.parametrize("name", VERTEX_SETS)
def test_weights_are_convex_and_mix_to_the_nearest_point(name):
    points, vertices = problems(name)
    found = nnls_distance(points, vertices)
    np.testing.assert_allclose(found.weights.sum(-1), 1.0, rtol=1e-14)
    assert found.weights.min() >= 0
    size = size_of(points.numpy(), vertices.numpy())
    np.testing.assert_allclose(found.weights @ vertices, found.nearest, rtol=0, atol=1e-14 * size)
    np.testing.assert_allclose((found.nearest - points).norm(dim=-1), found.value, rtol=0, atol=1e-14 * size)


def test_slsqp_comes_close():
    points, vertices = problems("random")
    found = slsqp_distance(points[:20], vertices)
    np.testing.assert_allclose(found.value, distance_to_hull(points[:20], vertices), rtol=0, atol=1e-5)
    assert not slsqp_distance(points[:1].requires_grad_(), vertices).value.requires_grad


@pytest.mark.parametrize("dimension", [1, 3, 6])
def test_any_dimension(dimension):
    corners = double(np.array(np.meshgrid(*[[-1.0, 1.0]] * dimension)).reshape(dimension, -1).T)
    points = double(np.random.default_rng(3).normal(size=(20, dimension)) * 1.5)
    found = nnls_distance(points, corners)
    nearest = points.clamp(-1, 1)
    np.testing.assert_allclose(found.nearest, nearest, rtol=0, atol=1e-13)
    np.testing.assert_allclose(found.value, (points - nearest).norm(dim=-1), rtol=0, atol=1e-13)


def test_batches_broadcast():
    rng = np.random.default_rng(2)
    points, vertices = double(rng.normal(size=(2, 1, 4, 2))), double(rng.normal(size=(3, 1, 6, 2)))
    found = nnls_distance(points, vertices)
    assert found.value.shape == (2, 3, 4)
    assert found.nearest.shape == (2, 3, 4, 2)
    assert found.weights.shape == (2, 3, 4, 6)
    np.testing.assert_allclose(found.value, distance_to_hull(points, vertices), atol=1e-13)
    assert nnls_distance(points[:0], vertices[:1]).weights.shape == (0, 1, 4, 6)


def test_what_does_not_fit_is_an_error():
    with pytest.raises(ValueError, match="vertices: must hold at least one point"):
        nnls_distance(torch.zeros(2), torch.zeros(0, 2))


def test_what_is_not_finite_stays_nan_and_alone():
    points, vertices = double([[2.0, 0.5]]).repeat(4, 1), SQUARE.repeat(4, 1, 1)
    points[0, 0], vertices[1, 2, 1], vertices[2, 0, 0] = math.nan, math.inf, -math.inf
    points.requires_grad_()
    found = nnls_distance(points, vertices)
    assert found.converged.tolist() == [False, False, False, True]
    for field in (found.value, found.nearest[:, 0], found.weights[:, 0], found.gap):
        assert field.isnan().tolist() == [True, True, True, False]
    (gradient,) = torch.autograd.grad(found.value[3], points)
    np.testing.assert_allclose(gradient, [[0.0, 0.0]] * 3 + [[1.0, 0.0]], atol=1e-12)


@pytest.mark.parametrize("size", [1e-300, 1e300])
def test_numbers_whose_squares_are_no_numbers(size):
    found = nnls_distance(double([2.0, 0.5]) * size, SQUARE * size)
    assert found.value.item() / size == pytest.approx(1.0, rel=1e-14)
    assert found.nearest.numpy() / size == pytest.approx([1.0, 0.5], rel=1e-14)


# --- gradients ---


def test_gradient_is_the_closed_form_s():
    rng = np.random.default_rng(4)
    points, vertices = double(rng.normal(size=(30, 2)) * 1.5, grad=True), double(rng.normal(size=(30, 8, 2)), grad=True)
    expected = torch.autograd.grad(distance_to_hull(points, vertices).sum(), (points, vertices))
    found = torch.autograd.grad(nnls_distance(points, vertices).value.sum(), (points, vertices))
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-11)


def test_gradient_agrees_with_differences():
    rng = np.random.default_rng(4)
    points, vertices = double(rng.normal(size=(3, 2)) * 3, grad=True), double(rng.normal(size=(3, 5, 2)), grad=True)
    assert torch.autograd.gradcheck(lambda p, v: nnls_distance(p, v).value, (points, vertices))


def test_gradient_is_zero_inside_and_on_the_boundary():
    points = double([[0.5, 0.2], [1.0, 0.3], [0.0, 1.0], [0.5, 1e-12]], grad=True)
    found = nnls_distance(points, SQUARE.clone().requires_grad_()).value
    assert torch.equal(found, torch.zeros_like(found))
    (gradient,) = torch.autograd.grad(found.sum(), points)
    assert torch.equal(gradient, torch.zeros_like(gradient))


def test_second_derivatives_are_refused():
    point = double([2.0, 0.5], grad=True)
    (gradient,) = torch.autograd.grad(nnls_distance(point, SQUARE).value, point, create_graph=True)
    with pytest.raises(RuntimeError, match="second derivatives"):
        torch.autograd.grad(gradient.sum(), point)


def test_float32_is_solved_in_float64():
    points, vertices = problems("random")
    found = nnls_distance(points.float(), vertices.float())
    assert {found.value.dtype, found.nearest.dtype, found.weights.dtype, found.gap.dtype} == {torch.float32}
    exact = distance_to_hull(points.float().double(), vertices.float().double())
    np.testing.assert_allclose(found.value, exact, rtol=1e-6, atol=1e-5)
    on_edge = torch.lerp(vertices[0], vertices[1], double(0.3)).float()
    assert nnls_distance(on_edge, vertices[:2].float()).value == 0


# --- residuals ---


def test_residuals_of_the_solution_are_zero():
    found = kkt_residuals(double([3.0, 0.5]), SQUARE, double([0.0, 0.5, 0.5, 0.0]))
    assert torch.stack((found.primal, found.dual, found.gap, found.error)).tolist() == [0.0] * 4
    assert found.length.item() == pytest.approx(2 / 3)


def test_residuals_of_other_weights_by_hand():
    # y = (1/2, 1/2), r = (-5/2, 0), g = (H - w) r = (15/2, 5, 5, 15/2), ‖r‖² = 25/4, scale 3.
    found = kkt_residuals(double([3.0, 0.5]), SQUARE, double([0.25] * 4))
    assert found.gap.item() == pytest.approx((6.25 - 5) / 9)
    assert found.dual.item() == pytest.approx((6.25 - 5) / 9)
    assert found.error.item() == pytest.approx(0.5 / 3)
    assert found.primal.item() == 0


@pytest.mark.parametrize(
    ("weights", "primal"), [([0.0, 0.5, 0.6, 0.0], 0.1), ([0.0, 0.5, 0.3, 0.0], 0.2), ([-0.3, 0.8, 0.5, 0.0], 0.3)]
)
def test_primal_residual(weights, primal):
    assert kkt_residuals(double([3.0, 0.5]), SQUARE, double(weights)).primal.item() == pytest.approx(primal)


@pytest.mark.parametrize("scale", [1e-290, 1e-6, 1e6, 1e290])
def test_residuals_have_no_unit(scale):
    rng = np.random.default_rng(0)
    points, vertices = double(rng.normal(size=(20, 3))), double(rng.normal(size=(20, 7, 3)))
    weights = double(rng.dirichlet(np.ones(7), size=20))
    expected, found = (kkt_residuals(factor * points, factor * vertices, weights) for factor in (1.0, scale))
    for name, value in vars(expected).items():
        np.testing.assert_allclose(getattr(found, name), value, rtol=1e-10, atol=1e-15)


def test_residuals_bound_the_error_of_any_weights():
    rng = np.random.default_rng(1)
    points, vertices = double(rng.normal(size=(300, 2)) * 2), double(rng.normal(size=(300, 7, 2)))
    weights = double(rng.dirichlet(np.full(7, 0.3), size=300))
    found = kkt_residuals(points, vertices, weights)
    scale = (vertices - points.unsqueeze(-2)).abs().amax((1, 2))
    too_long = (found.length * scale - distance_to_hull(points, vertices)) / scale
    assert (found.gap > 1e-3).all()
    assert (too_long <= found.error + 1e-14).all()
    away = ((weights.unsqueeze(-1) * vertices).sum(-2) - nnls_distance(points, vertices).nearest).norm(dim=-1) / scale
    assert (away.square() <= found.gap + 1e-14).all()


def test_moved_weights_show():
    points, vertices = problems("random")
    weights = nnls_distance(points, vertices).weights
    assert kkt_residuals(points, vertices, weights).gap.abs().max() < 1e-14
    moved = 0.99 * weights + 0.01 / weights.shape[-1]
    outside = distance_to_hull(points, vertices) > 0
    assert (kkt_residuals(points, vertices, moved).gap[outside] > 1e-6).all()
