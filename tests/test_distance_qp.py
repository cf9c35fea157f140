import importlib.util
import math
import sys

import numpy as np
import pytest
import torch
from hull_cases import VERTEX_SETS, double, points_about
from torcharm.distance.qp import FORMS, GRADIENTS, qp_distance
from torcharm.distance.result import kkt_residuals
from torcharm.distance.scipy_solvers import nnls_distance

from torcharm import distance_to_hull
from torcharm.distance import qp

needs_qpth = pytest.mark.skipif(importlib.util.find_spec("qpth") is None, reason="qpth is not installed")
each_form = pytest.mark.parametrize("form", FORMS)
each_gradient = pytest.mark.parametrize("gradient", GRADIENTS)

SQUARE = double([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
DEGENERATE = ["duplicates", "near duplicates", "nearly collinear", "one point", "far from the origin"]


@pytest.fixture(autouse=True)
def _one_thread():
    """The matrices are small: several threads would mostly wait for one another."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def problems(name, scale=1.0):
    """Some 40 points about, inside, on vertices and on edges (a few for the set of many vertices)."""
    vertices = VERTEX_SETS[name]
    points = np.concatenate((points_about(vertices, 24)[:36], vertices[:4], (vertices[:3] + vertices[-3:][::-1]) / 2))
    points = points[::8] if len(vertices) > 50 else points
    return double(points * scale), double(vertices * scale)


def random_problems(count, vertices=8, seed=0, *, grad=False):
    rng = np.random.default_rng(seed)
    return double(rng.normal(size=(count, 2)) * 1.5, grad=grad), double(
        rng.normal(size=(count, vertices, 2)), grad=grad
    )


def scale_of(points, vertices):
    return (vertices - points.unsqueeze(-2)).abs().amax((-1, -2)).detach()


def derivatives(value, *inputs):
    return torch.autograd.grad(value.sum(), inputs)


def assert_agrees(points, vertices, form):
    found, expected = qp_distance(points, vertices, form=form), distance_to_hull(points, vertices)
    np.testing.assert_array_less((found.value - expected).abs(), 1e-6 * scale_of(points, vertices) + 1e-300)
    assert torch.equal(found.value == 0, expected == 0)
    assert found.converged.all()
    np.testing.assert_allclose(found.weights.sum(-1), 1.0, rtol=1e-12)
    assert found.weights.min() >= 0


# --- agreement ---


@needs_qpth
@each_form
@pytest.mark.parametrize("name", VERTEX_SETS)
def test_agrees_with_the_closed_form(name, form):
    assert_agrees(*problems(name), form)


@needs_qpth
@each_form
@pytest.mark.parametrize("scale", [1e-6, 1e6])
@pytest.mark.parametrize("name", DEGENERATE)
def test_agrees_in_other_units(name, scale, form):
    assert_agrees(*problems(name, scale), form)


@needs_qpth
@each_form
def test_most_answers_are_the_solver_s_own(form):
    points, vertices = random_problems(200)
    found = qp_distance(points, vertices, form=form)
    assert found.resolved.double().mean() < 0.05
    own = kkt_residuals(points, vertices, found.weights)
    np.testing.assert_allclose(own.gap, found.gap, atol=1e-15)


@needs_qpth
@each_form
def test_a_batch_of_one_equals_a_batch_of_thousands(form):
    points, vertices = random_problems(2000, 5)
    together = qp_distance(points, vertices, form=form)
    for index in range(0, 2000, 100):
        alone = qp_distance(points[index], vertices[index], form=form)
        assert alone.value.item() == pytest.approx(together.value[index].item(), abs=1e-7)
        assert alone.resolved == together.resolved[index]


@needs_qpth
def test_chunks_change_nothing():
    points, vertices = random_problems(50)
    whole, parts = qp_distance(points, vertices), qp_distance(points, vertices, chunk_size=7)
    np.testing.assert_allclose(parts.value, whole.value, rtol=0, atol=1e-7)


@needs_qpth
@pytest.mark.parametrize("dimension", [1, 3])
def test_any_dimension(dimension):
    rng = np.random.default_rng(3)
    points, vertices = double(rng.normal(size=(40, dimension))), double(rng.normal(size=(40, 9, dimension)))
    points[-2:], vertices[-2:] = 0.0, double(np.eye(9, dimension))
    points.requires_grad_()
    found, expected = qp_distance(points, vertices), nnls_distance(points, vertices)
    np.testing.assert_allclose(found.value.detach(), expected.value.detach(), rtol=0, atol=1e-6)
    assert torch.equal(found.value == 0, expected.value == 0)
    assert (found.value == 0).sum() > 5
    (own,), (exact,) = derivatives(found.value, points), derivatives(expected.value, points)
    np.testing.assert_allclose(own, exact, rtol=0, atol=1e-3)


@needs_qpth
def test_batches_broadcast_and_gradients_of_what_is_shared_add_up():
    points, vertices = random_problems(3, grad=True)
    shared = vertices[0].detach().requires_grad_()
    found = qp_distance(points, shared)
    assert found.value.shape == (3,)
    assert found.weights.shape == (3, 8)
    (own,), (exact,) = derivatives(found.value, shared), derivatives(distance_to_hull(points, shared), shared)
    np.testing.assert_allclose(own, exact, rtol=0, atol=1e-4)
    assert qp_distance(points[:0], vertices[:0]).nearest.shape == (0, 2)


# --- bad elements ---

BAD = {
    "nan": [[math.nan, 0], [1, 0], [0, 1], [1, 1], [2, 2]],
    "infinite": [[math.inf, 0], [1, 0], [0, 1], [1, 1], [2, 2]],
    "huge": np.array([[1, 0], [2, 0], [2, 1], [1, 1], [1.5, 2]]) * 1e300,
    "tiny": np.array([[1, 0], [2, 0], [2, 1], [1, 1], [1.5, 2]]) * 1e-300,
    "one huge": [[1e300, 0], [1, 0], [0, 1], [1, 1], [2, 2]],
    "identical": [[0.7, 0.1]] * 5,
    "all at the point": [[0.0, 0.0]] * 5,
    "flat": [[1, 0], [1, 1e-13], [1, 2e-13], [1, 1], [1, 2]],
}


@needs_qpth
@each_form
@each_gradient
@pytest.mark.parametrize("name", BAD)
def test_a_bad_element_leaves_the_others_alone(name, gradient, form):
    points, vertices = random_problems(12, 5)
    points[4], vertices[4] = 0.0, double(BAD[name])
    others = torch.arange(12) != 4
    mixed = [value.clone().requires_grad_() for value in (points, vertices)]
    alone = [value[others].requires_grad_() for value in (points, vertices)]
    found = qp_distance(*mixed, form=form, gradient=gradient)
    expected = qp_distance(*alone, form=form, gradient=gradient)
    np.testing.assert_allclose(found.value[others].detach(), expected.value.detach(), rtol=0, atol=1e-9)
    assert torch.equal(found.resolved[others], expected.resolved)
    assert found.converged[others].all()
    for own, other in zip(derivatives(found.value, *mixed), derivatives(expected.value, *alone), strict=True):
        np.testing.assert_allclose(own[others], other, rtol=0, atol=1e-4)
        assert own.isfinite().all()
    if name in ("nan", "infinite"):
        assert found.value[4].isnan()
        assert not found.converged[4]
    else:
        size = vertices[4].abs().max() + (vertices[4].abs().max() == 0)
        exact = distance_to_hull(points[4] / size, vertices[4] / size)
        assert (found.value[4] / size).item() == pytest.approx(exact.item(), abs=1e-6)
        assert found.converged[4]


def raise_error(terms):
    raise torch.linalg.LinAlgError("singular")


@needs_qpth
@pytest.mark.parametrize(
    "failure",
    [raise_error, lambda terms: None, lambda terms: torch.full_like(terms[1], 0.2)],
    ids=["raises", "None", "junk"],
)
def test_an_element_that_ends_the_batch_is_found_and_answered_exactly(monkeypatch, failure):
    layer = qp.require_qpth()
    calls = []

    def fragile(*terms):
        calls.append(len(terms[0]))
        marked = (terms[0].diagonal(dim1=-2, dim2=-1)[:, :4] > 1.99).all(-1)  # four offsets of (±1, ±1)
        return failure(terms) if marked.any() else layer(*terms)

    monkeypatch.setattr(qp, "require_qpth", lambda: fragile)
    points, vertices = random_problems(40, 5)
    points[7], vertices[7] = double([0.0, 0.0]), double([[1, 1], [1, 1], [1, -1], [1, -1], [1, 0.2]])
    points.requires_grad_()
    found = qp_distance(points, vertices)
    assert found.resolved.nonzero().flatten().tolist() == [7]
    assert sum(calls) < 6 * 40
    exact = distance_to_hull(points, vertices)
    np.testing.assert_allclose(found.value.detach(), exact.detach(), rtol=0, atol=1e-6)
    np.testing.assert_allclose(*derivatives(found.value, points), *derivatives(exact, points), rtol=0, atol=1e-3)


@needs_qpth
def test_a_solver_that_always_lies_is_not_believed(monkeypatch):
    monkeypatch.setattr(qp, "require_qpth", lambda: lambda *terms: torch.full_like(terms[1], 0.125))
    points, vertices = random_problems(30, grad=True)
    found, exact = qp_distance(points, vertices), distance_to_hull(points, vertices)
    assert found.resolved.all()
    assert found.converged.all()
    np.testing.assert_allclose(found.value.detach(), exact.detach(), rtol=0, atol=1e-14)
    for own, other in zip(
        derivatives(found.value, points, vertices), derivatives(exact, points, vertices), strict=True
    ):
        np.testing.assert_allclose(own, other, rtol=0, atol=1e-12)


@needs_qpth
def test_where_the_second_solve_fails_the_gradient_is_the_envelope_s(monkeypatch):
    layer = qp.require_qpth()

    def failing(*terms):
        second = terms[1].any(-1, keepdim=True)  # only the proximal step has a linear term
        return torch.where(second & (torch.arange(len(second)) % 3 == 0).unsqueeze(-1), math.nan, 1.0) * layer(*terms)

    monkeypatch.setattr(qp, "require_qpth", lambda: failing)
    points, vertices = random_problems(12, 5, grad=True)
    found, exact = qp_distance(points, vertices), distance_to_hull(points, vertices)
    assert not found.resolved.any()
    for own, other in zip(
        derivatives(found.value, points, vertices), derivatives(exact, points, vertices), strict=True
    ):
        np.testing.assert_allclose(own, other, rtol=0, atol=1e-3)


@needs_qpth
@each_form
def test_nothing_is_printed(capfd, form):
    for name in ("one point", "duplicates", "nearly collinear"):
        qp_distance(*problems(name), form=form)
    assert capfd.readouterr() == ("", "")


# --- gradients ---


@needs_qpth
@each_form
@pytest.mark.parametrize(("gradient", "tolerance"), [("kkt", 1e-3), ("envelope", 1e-5)])
def test_gradient_is_the_closed_form_s(gradient, tolerance, form):
    points, vertices = random_problems(60, grad=True)
    found = qp_distance(points, vertices, form=form, gradient=gradient)
    expected = derivatives(distance_to_hull(points, vertices), points, vertices)
    for own, other in zip(derivatives(found.value, points, vertices), expected, strict=True):
        np.testing.assert_allclose(own, other, rtol=0, atol=tolerance)
        assert (own - other).abs().median() < 1e-6


@needs_qpth
@each_form
@each_gradient
def test_gradient_agrees_with_differences(gradient, form):
    points, vertices = random_problems(20, grad=True)
    found = qp_distance(points, vertices, form=form, gradient=gradient)
    in_points, in_vertices = derivatives(found.value, points, vertices)
    with torch.no_grad():
        for step_point, step_vertices in (random_problems(20, seed=seed) for seed in (1, 2)):
            ahead, behind = (
                qp_distance(points + h * step_point, vertices + h * step_vertices, form=form).value
                for h in (1e-5, -1e-5)
            )
            slope = (in_points * step_point).sum(-1) + (in_vertices * step_vertices).sum((1, 2))
            np.testing.assert_allclose(slope, (ahead - behind) / 2e-5, rtol=0, atol=2e-3)


@needs_qpth
@each_gradient
def test_gradients_of_duplicates_add_up_to_the_closed_form_s(gradient):
    points, vertices = random_problems(30, 5, grad=True)
    repeated = vertices.detach().repeat(1, 3, 1).requires_grad_()
    (own,) = derivatives(qp_distance(points, repeated, gradient=gradient).value, repeated)
    (exact,) = derivatives(distance_to_hull(points, vertices), vertices)
    np.testing.assert_allclose(own.unflatten(1, (3, 5)).sum(1), exact, rtol=0, atol=1e-3)


@needs_qpth
@each_form
@each_gradient
def test_value_and_gradient_are_zero_inside_and_on_the_boundary(gradient, form):
    points = [[0.5, 0.2], [1.0, 0.3], [0.0, 1.0], [0.5, 1e-12], [0.3, 1e-8], [0.6, 0.6]]
    points, vertices = double(points, grad=True), SQUARE.clone().requires_grad_()
    found = qp_distance(points, vertices, form=form, gradient=gradient)
    assert torch.equal(found.value, torch.zeros_like(found.value))
    assert torch.equal(found.nearest, points.detach())
    np.testing.assert_allclose(found.weights @ SQUARE, points.detach(), rtol=0, atol=1e-6)
    for own in derivatives(found.value, points, vertices):
        assert torch.equal(own, torch.zeros_like(own))


@needs_qpth
@each_form
@each_gradient
@pytest.mark.parametrize("depth", [1e-12, 1e-9, 1e-6])
def test_a_point_just_outside_has_its_distance_and_its_normal(depth, gradient, form):
    point = double([[0.4, -depth]], grad=True)
    found = qp_distance(point, SQUARE, form=form, gradient=gradient)
    assert found.value.item() == pytest.approx(depth, rel=1e-3)
    np.testing.assert_allclose(*derivatives(found.value, point), [[0.0, -1.0]], rtol=0, atol=1e-3)


@needs_qpth
@each_gradient
def test_second_derivatives_are_refused(gradient):
    point = double([[2.0, 0.5]], grad=True)
    found = qp_distance(point, SQUARE, gradient=gradient)
    (first,) = torch.autograd.grad(found.value.sum(), point, create_graph=True)
    with pytest.raises(RuntimeError, match="second derivatives"):
        torch.autograd.grad(first.sum(), point)


@needs_qpth
def test_only_the_value_has_a_gradient():
    points, vertices = random_problems(5, grad=True)
    found = qp_distance(points, vertices)
    assert [name for name, value in vars(found).items() if value.requires_grad] == ["value"]


@needs_qpth
@each_form
def test_float32_is_solved_in_float64(form):
    points, vertices = (value.detach().float().requires_grad_() for value in random_problems(30))
    found = qp_distance(points, vertices, form=form)
    exact = distance_to_hull(points.detach().double(), vertices.detach().double())
    assert found.value.dtype == found.weights.dtype == torch.float32
    np.testing.assert_allclose(found.value.detach(), exact, rtol=1e-5, atol=1e-6)
    assert {own.dtype for own in derivatives(found.value, points, vertices)} == {torch.float32}
    on_edge = torch.lerp(vertices[:, 0], vertices[:, 1], 0.3)
    assert (qp_distance(on_edge, vertices[:, :2], form=form).value == 0).all()


# --- arguments ---


def test_without_qpth_one_line_says_so(monkeypatch):
    monkeypatch.setitem(sys.modules, "qpth.qp", None)
    message = (
        "^distance: 'qpth' needs the package qpth, which has no release for Python 3.13 and later; use 'closed_form'$"
    )
    with pytest.raises(ValueError, match=message):
        qp_distance(double([2.0, 0.5]), SQUARE)


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"form": "edges"}, "form"),
        ({"gradient": "exact"}, "gradient"),
        ({"regularisation": 0.0}, "regularisation"),
        ({"regularisation": math.nan}, "regularisation"),
        ({"chunk_size": 0}, "chunk_size"),
    ],
)
def test_arguments_that_are_not_allowed(options, field):
    with pytest.raises(ValueError, match=field):
        qp_distance(double([2.0, 0.5]), SQUARE, **options)


def test_half_spaces_are_for_the_plane():
    with pytest.raises(ValueError, match="form: 'halfspaces' is for the plane"):
        qp_distance(torch.zeros(3), torch.zeros(4, 3), form="halfspaces")
