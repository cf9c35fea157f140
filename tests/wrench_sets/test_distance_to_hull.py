"""The engine's distance to hulls of vertices: margins inside, and what it refuses."""

import numpy as np
import pytest
import torch
from oracle.vertex_sets import (
    NAMES,
    SETS,
    WITHOUT_INSIDE,
    coordinates_of,
    depth,
    derivatives,
    double,
    points_about,
    problems,
    random_problems,
    size_of,
)

import torcharm as ta

each_dimension = pytest.mark.parametrize("dimension", [2, 3])
SQUARE = double([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]])
EPS = np.finfo(float).eps
CUBE = double(np.stack(np.meshgrid(*[[0.0, 1.0]] * 3), -1).reshape(-1, 3))


@each_dimension
@pytest.mark.parametrize("name", NAMES)
def test_margins_are_those_to_the_nearest_facet(name, dimension):
    vertices, points, expected = problems(name, dimension)
    signed = ta.distance_to_hull(double(points), double(vertices), signed=True).numpy()
    allowed = 1e-12 * size_of(points, vertices) + 16 * EPS * coordinates_of(points, vertices)
    assert (np.abs(np.maximum(signed, 0) - expected) <= allowed).all()
    if name in WITHOUT_INSIDE:
        assert (signed >= -allowed).all()
        return
    inside = np.array([depth(point, vertices) for point in points])
    size = size_of(points, vertices).max()
    deep = inside > 1e-9 * size
    np.testing.assert_allclose(signed[deep], -inside[deep], rtol=0, atol=1e-9 * size)
    assert deep.sum() >= 3


def test_points_on_chords_of_symmetric_sets_have_their_margin():
    middle = ta.distance_to_hull(double([[1.0, 0.5], [0.5, 0.25], [1.0, 0.25]]), SQUARE, signed=True)
    np.testing.assert_allclose(middle, [-0.5, -0.25, -0.25], rtol=0, atol=1e-9)
    points = double([[0.5, 0.5, 0.5], [0.5, 0.5, 0.4], [0.3, 0.3, 0.3], [0.25, 0.5, 0.5], [0.25, 0.25, 0.5]])
    inner = ta.distance_to_hull(points, CUBE, signed=True)
    np.testing.assert_allclose(inner, [-0.5, -0.4, -0.3, -0.25, -0.25], rtol=0, atol=1e-9)
    faces = double([[0.5, 0.5, 0.0], [0.0, 0.25, 0.5], [0.0, 0.0, 0.5], [1.0, 1.0, 1.0], [0.5, 0.5, 1.0]])
    assert torch.equal(ta.distance_to_hull(faces, CUBE, signed=True), torch.zeros(5, dtype=torch.float64))


@each_dimension
def test_signed_gradients_are_those_of_differences(dimension):
    points, vertices = random_problems(16, 9, dimension, seed=3, grad=True)
    points = (0.2 * points.detach()).requires_grad_()
    assert (ta.distance_to_hull(points, vertices, signed=True) < 0).sum() > 2
    assert torch.autograd.gradcheck(
        lambda p, v: ta.distance_to_hull(p, v, signed=True), (points, vertices), rtol=1e-5, atol=1e-6
    )


def test_the_gradient_in_the_point_is_the_unit_normal():
    for vertices in (SETS[2]["simplex"], SETS[3]["simplex"]):
        points = double(points_about(vertices), grad=True)
        found = ta.distance_to_hull(points, double(vertices))
        (gradient,) = derivatives(found, points)
        np.testing.assert_allclose(gradient.norm(dim=-1), (found > 0).double(), rtol=1e-12)


def test_the_gradient_inside_is_zero_unless_signed():
    vertices, point = SQUARE.clone().requires_grad_(), double([1.0, 0.4], grad=True)
    for gradient in derivatives(ta.distance_to_hull(point, vertices), point, vertices):
        assert torch.equal(gradient, torch.zeros_like(gradient))
    in_point, in_vertices = derivatives(ta.distance_to_hull(point, vertices, signed=True), point, vertices)
    np.testing.assert_allclose(in_point, [0.0, -1.0], atol=1e-12)
    np.testing.assert_allclose(in_vertices, [[0.0, 0.5], [0.0, 0.5], [0.0, 0.0], [0.0, 0.0]], atol=1e-9)


def test_other_dimensions_are_refused():
    with pytest.raises(ValueError, match=r"^point: must have 2 or 3 coordinates"):
        ta.distance_to_hull(torch.zeros(4), torch.zeros(3, 4))
