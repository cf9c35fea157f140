"""qpth's traps: silent failures, batches that one element spoils, gradients that lose their digits."""

import importlib.util
import math
import sys

import numpy as np
import pytest
import torch
from oracle.vertex_sets import derivatives, double, random_problems

import torcharm as ta
from torcharm.wrench_sets import qp
from torcharm.wrench_sets.qp import GRADIENTS

needs_qpth = pytest.mark.skipif(importlib.util.find_spec("qpth") is None, reason="qpth is not installed")
each_gradient = pytest.mark.parametrize("gradient", GRADIENTS)
each_groups = pytest.mark.parametrize("groups", [1, 2])

SQUARE = double([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


@needs_qpth
@each_groups
def test_most_answers_are_the_solver_s_own(groups):
    points, vertices = random_problems(200)
    found = ta.qp_distance(points, vertices, groups=groups)
    assert found.resolved.double().mean() < 0.05


@needs_qpth
@each_groups
def test_chunks_change_nothing(groups):
    points, vertices = random_problems(50)
    whole, parts = (ta.qp_distance(points, vertices, groups=groups, chunk_size=size) for size in (None, 7))
    np.testing.assert_allclose(parts.value, whole.value, rtol=0, atol=1e-7)


@needs_qpth
def test_any_dimension():
    rng = np.random.default_rng(3)
    for dimension in (1, 5):
        points, vertices = double(rng.normal(size=(40, dimension)) / 2), double(rng.normal(size=(40, 9, dimension)))
        found, expected = ta.qp_distance(points, vertices), ta.nnls_distance(points, vertices)
        np.testing.assert_allclose(found.value, expected.value, rtol=0, atol=1e-6)
        assert torch.equal(found.value == 0, expected.value == 0)


BAD = {
    "nan": [[math.nan, 0], [1, 0], [0, 1], [1, 1], [2, 2], [1, 3]],
    "huge": np.array([[1, 0], [2, 0], [2, 1], [1, 1], [1.5, 2], [1, 3]]) * 1e300,
    "tiny": np.array([[1, 0], [2, 0], [2, 1], [1, 1], [1.5, 2], [1, 3]]) * 1e-300,
    "one huge": [[1e300, 0], [1, 0], [0, 1], [1, 1], [2, 2], [1, 3]],
    "identical": [[0.7, 0.1]] * 6,
    "all at the point": [[0.0, 0.0]] * 6,
    "flat": [[1, 0], [1, 1e-13], [1, 2e-13], [1, 1], [1, 2], [1, 3]],
}


@needs_qpth
@each_gradient
@each_groups
@pytest.mark.parametrize("name", BAD)
def test_a_bad_element_leaves_the_others_alone(name, groups, gradient):
    points, vertices = random_problems(12, 6)
    points[4], vertices[4] = 0.0, double(BAD[name])
    others = torch.arange(12) != 4
    mixed = [value.clone().requires_grad_() for value in (points, vertices)]
    alone = [value[others].requires_grad_() for value in (points, vertices)]
    found = ta.qp_distance(*mixed, gradient=gradient, groups=groups)
    expected = ta.qp_distance(*alone, gradient=gradient, groups=groups)
    np.testing.assert_allclose(found.value[others].detach(), expected.value.detach(), rtol=0, atol=1e-7)
    assert found.converged[others].all()
    for own, other in zip(derivatives(found.value, *mixed), derivatives(expected.value, *alone), strict=True):
        np.testing.assert_allclose(own[others], other, rtol=0, atol=1e-3)
        assert own.isfinite().all()
    if name == "nan":
        assert found.value[4].isnan()
        assert not found.converged[4]
    else:
        size = vertices[4].abs().max() + (vertices[4].abs().max() == 0)
        exact = ta.nnls_distance(points[4] / size, vertices[4] / size, groups=groups).value
        assert (found.value[4].detach() / size).item() == pytest.approx(exact.item(), abs=1e-6)
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
    found = ta.qp_distance(points, vertices)
    assert found.resolved.nonzero().flatten().tolist() == [7]
    assert sum(calls) < 6 * 40
    exact = ta.distance_to_hull(points, vertices)
    np.testing.assert_allclose(found.value.detach(), exact.detach(), rtol=0, atol=1e-6)
    np.testing.assert_allclose(*derivatives(found.value, points), *derivatives(exact, points), rtol=0, atol=1e-3)


@needs_qpth
def test_a_solver_that_always_lies_is_not_believed(monkeypatch):
    monkeypatch.setattr(qp, "require_qpth", lambda: lambda *terms: torch.full_like(terms[1], 0.125))
    points, vertices = random_problems(30, grad=True)
    found, exact = ta.qp_distance(points, vertices), ta.distance_to_hull(points, vertices)
    assert found.resolved.all()
    assert found.converged.all()
    np.testing.assert_allclose(found.value.detach(), exact.detach(), rtol=0, atol=1e-14)
    for own, other in zip(
        derivatives(found.value, points, vertices), derivatives(exact, points, vertices), strict=True
    ):
        np.testing.assert_allclose(own, other, rtol=0, atol=1e-10)


def test_what_no_solver_answers_is_a_value_that_says_so(monkeypatch):
    def gives_up(*_, **__):
        raise RuntimeError("Maximum number of iterations reached.")

    monkeypatch.setattr("scipy.optimize.nnls", gives_up)
    points, vertices = random_problems(4)
    found = ta.nnls_distance(points, vertices)
    assert found.value.isnan().all()
    assert not found.converged.any()


@needs_qpth
def test_where_the_second_solve_fails_the_gradient_is_the_envelope_s(monkeypatch):
    layer = qp.require_qpth()

    def failing(*terms):
        second = terms[1].any(-1, keepdim=True)  # only the proximal step has a linear term
        return torch.where(second & (torch.arange(len(second)) % 3 == 0).unsqueeze(-1), math.nan, 1.0) * layer(*terms)

    monkeypatch.setattr(qp, "require_qpth", lambda: failing)
    points, vertices = random_problems(12, 5, grad=True)
    found, exact = ta.qp_distance(points, vertices), ta.distance_to_hull(points, vertices)
    assert not found.resolved.any()
    for own, other in zip(
        derivatives(found.value, points, vertices), derivatives(exact, points, vertices), strict=True
    ):
        np.testing.assert_allclose(own, other, rtol=0, atol=1e-3)


@needs_qpth
def test_nothing_is_printed(capfd):
    points, vertices = random_problems(12, 6)
    for hull in (vertices, vertices[:, :1].expand(-1, 6, -1), vertices.round()):
        ta.qp_distance(points, hull, groups=2)
    assert capfd.readouterr() == ("", "")


# --- gradients ---


@needs_qpth
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize(("gradient", "tolerance"), [("kkt", 1e-3), ("envelope", 1e-5)])
def test_gradients_are_the_exact_ones(gradient, tolerance, dimension):
    points, vertices = random_problems(60, 8, dimension, grad=True)
    found = ta.qp_distance(points, vertices, gradient=gradient)
    expected = derivatives(ta.distance_to_hull(points, vertices), points, vertices)
    for own, other in zip(derivatives(found.value, points, vertices), expected, strict=True):
        np.testing.assert_allclose(own, other, rtol=0, atol=tolerance)
        assert (own - other).abs().median() < 1e-6


@needs_qpth
@each_gradient
def test_gradients_of_duplicates_add_up(gradient):
    points, vertices = random_problems(30, 5, grad=True)
    repeated = vertices.detach().repeat(1, 3, 1).requires_grad_()
    (own,) = derivatives(ta.qp_distance(points, repeated, gradient=gradient).value, repeated)
    (exact,) = derivatives(ta.distance_to_hull(points, vertices), vertices)
    np.testing.assert_allclose(own.unflatten(1, (3, 5)).sum(1), exact, rtol=0, atol=1e-3)


@needs_qpth
@each_gradient
def test_value_and_gradient_are_zero_inside_and_on_the_boundary(gradient):
    points = [[0.5, 0.2], [1.0, 0.3], [0.0, 1.0], [0.5, 1e-12], [0.3, 1e-8], [0.6, 0.6]]
    points, vertices = double(points, grad=True), SQUARE.clone().requires_grad_()
    found = ta.qp_distance(points, vertices, gradient=gradient)
    assert torch.equal(found.value, torch.zeros_like(found.value))
    assert torch.equal(found.nearest, points.detach())
    np.testing.assert_allclose(found.weights @ SQUARE, points.detach(), rtol=0, atol=1e-6)
    for own in derivatives(found.value, points, vertices):
        assert torch.equal(own, torch.zeros_like(own))


@needs_qpth
@each_gradient
@pytest.mark.parametrize("depth", [1e-12, 1e-9, 1e-6])
def test_a_point_just_outside_has_its_distance_and_its_normal(depth, gradient):
    point = double([[0.4, -depth]], grad=True)
    found = ta.qp_distance(point, SQUARE, gradient=gradient)
    assert found.value.item() == pytest.approx(depth, rel=1e-3)
    np.testing.assert_allclose(*derivatives(found.value, point), [[0.0, -1.0]], rtol=0, atol=1e-3)


@needs_qpth
def test_only_the_value_has_a_gradient():
    points, vertices = random_problems(5, grad=True)
    found = ta.qp_distance(points, vertices)
    assert [name for name, value in vars(found).items() if value.requires_grad] == ["value"]


# --- arguments ---


def test_without_qpth_one_line_says_so(monkeypatch):
    monkeypatch.setitem(sys.modules, "qpth.qp", None)
    message = "^distance: 'qpth' needs the package qpth, which is not installed: `pip install qpth`.*, or use 'gjk'$"
    task = ta.Task(ta.affine_curvature(0.0, 1.0, nodes=2), [0.0, 0.0, 0.0])
    for ask in (
        lambda: ta.qp_distance(double([2.0, 0.5]), SQUARE),
        lambda: ta.evaluate(ta.bellows_arm(), task, "absolute", distance="qpth"),
    ):
        with pytest.raises(ValueError, match=message):
            ask()


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"gradient": "exact"}, "gradient"),
        ({"regularisation": 0.0}, "regularisation"),
        ({"regularisation": math.nan}, "regularisation"),
        ({"chunk_size": 0}, "chunk_size"),
    ],
)
def test_arguments_that_are_not_allowed(options, field):
    with pytest.raises(ValueError, match=field):
        ta.qp_distance(double([2.0, 0.5]), SQUARE, **options)
