import math

import numpy as np
import oracle
import pytest
import torch
from hull_cases import VERTEX_SETS, double, points_about, size_of
from torch.autograd import gradcheck, gradgradcheck

from torcharm import distance_to_hull
from torcharm.distance.closed_form import face_distance, nearest_faces, signed_length
from torcharm.polygon import Polygons, convex_hull, face_square

RNG = np.random.default_rng(12)
SQUARE = np.array([[0, 0], [2, 0], [2, 2], [0, 2.0]])
PENTAGON = np.array([[math.cos(a), math.sin(a)] for a in 2 * math.pi * np.arange(5) / 5 + 0.1])


def expected_distances(points, vertices, *, signed):
    corners = oracle.hull(vertices)
    return np.array([oracle.distance(point, corners, signed=signed) for point in points])


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("scale", [1.0, 1e-6, 1e6])
@pytest.mark.parametrize("name", VERTEX_SETS)
def test_distance_agrees_with_the_oracle(name, scale, signed):
    vertices = VERTEX_SETS[name] * scale
    points = points_about(VERTEX_SETS[name]) * scale
    found = distance_to_hull(double(points), double(vertices), signed=signed)
    expected = expected_distances(points, vertices, signed=signed)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-14 * size_of(points, vertices))


@pytest.mark.parametrize(
    "name", ["two points", "near-duplicate pair", "collinear", "vertical", "horizontal", "one point", "the same point"]
)
def test_point_sets_without_area_have_no_inside(name):
    points = np.concatenate((points_about(VERTEX_SETS[name]), VERTEX_SETS[name]))
    assert distance_to_hull(double(points), double(VERTEX_SETS[name]), signed=True).min() >= 0


def test_unsigned_distance_is_zero_exactly_where_signed_is_at_most_zero():
    points = double(points_about(VERTEX_SETS["random"], 300))
    vertices = double(VERTEX_SETS["random"])
    signed = distance_to_hull(points, vertices, signed=True)
    assert (signed < 0).sum() > 20
    assert torch.equal(distance_to_hull(points, vertices), signed.clamp(min=0))


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("scale", [1.0, 1e-6, 1e6])
def test_distance_is_zero_on_edges_and_vertices(scale, signed):
    vertices = PENTAGON * scale
    ends = np.roll(vertices, -1, axis=0)
    shares = np.linspace(0, 1, 7)[:, None, None]
    points = ((1 - shares) * vertices + shares * ends).reshape(-1, 2)
    found = distance_to_hull(double(points), double(vertices), signed=signed)
    assert torch.equal(found, torch.zeros_like(found))


@pytest.mark.parametrize("depth", [1e-12, 1e-9, 1e-3])
def test_a_point_just_inside_is_inside(depth):
    ends = np.roll(PENTAGON, -1, axis=0)
    edges = ends - PENTAGON
    inward = np.stack((-edges[:, 1], edges[:, 0]), 1) / np.linalg.norm(edges, axis=1, keepdims=True)
    points = double((PENTAGON + ends) / 2 + depth * inward, grad=True)
    signed = distance_to_hull(points, double(PENTAGON), signed=True)
    np.testing.assert_allclose(signed.detach(), np.full(5, -depth), rtol=0, atol=1e-15)
    unsigned = distance_to_hull(points, double(PENTAGON))
    assert torch.equal(unsigned, torch.zeros(5, dtype=torch.float64))
    (gradient,) = torch.autograd.grad(unsigned.sum(), points)
    assert torch.equal(gradient, torch.zeros_like(gradient))


@pytest.mark.parametrize("depth", [-1e-12, -1e-9, -1e-3])
def test_a_point_just_outside_is_outside(depth):
    point = double([1.0, depth], grad=True)
    found = distance_to_hull(point, double(SQUARE))
    assert found.item() == pytest.approx(-depth, rel=1e-9)
    (gradient,) = torch.autograd.grad(found, point)
    np.testing.assert_allclose(gradient, [0.0, -1.0], atol=1e-12)


def test_the_order_of_the_vertices_is_free():
    vertices = VERTEX_SETS["many"]
    points = double(points_about(vertices))
    expected = distance_to_hull(points, double(vertices), signed=True)
    shuffled = np.random.default_rng(0).permutation(vertices)
    torch.testing.assert_close(distance_to_hull(points, double(shuffled), signed=True), expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("point_batch", "vertex_batch", "result"),
    [
        ((), (), ()),
        ((5,), (), (5,)),
        ((), (4,), (4,)),
        ((3, 1), (4,), (3, 4)),
        ((2, 1, 4), (3, 1), (2, 3, 4)),
        ((1, 3), (2, 3), (2, 3)),
        ((0,), (1,), (0,)),
        ((2, 0), (1, 1), (2, 0)),
    ],
)
def test_batches_broadcast(point_batch, vertex_batch, result):
    rng = np.random.default_rng(2)
    points, vertices = double(rng.normal(size=(*point_batch, 2))), double(rng.normal(size=(*vertex_batch, 6, 2)))
    found = distance_to_hull(points, vertices, signed=True)
    assert found.shape == result
    points, vertices = points.expand(*result, 2), vertices.expand(*result, 6, 2)
    for index in np.ndindex(*result):
        expected = oracle.distance(points[index], oracle.hull(vertices[index]))
        assert found[index].item() == pytest.approx(expected, rel=1e-12)


def test_a_batch_of_degenerate_and_proper_sets_keeps_them_apart():
    chosen = [vertices[:3] for vertices in VERTEX_SETS.values() if len(vertices) >= 3]
    points = RNG.normal(size=(len(chosen), 2))
    found = distance_to_hull(double(points), double(chosen), signed=True)
    expected = [oracle.distance(point, oracle.hull(vertices)) for point, vertices in zip(points, chosen, strict=True)]
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_no_vertices_are_an_error():
    with pytest.raises(ValueError, match="vertices"):
        distance_to_hull(torch.zeros(2), torch.zeros(0, 2))


def test_nan_is_not_turned_into_a_distance():
    vertices = double(SQUARE)
    assert distance_to_hull(double([math.nan, 1.0]), vertices).isnan()
    assert distance_to_hull(double([5.0, 1.0]), vertices.index_fill(0, torch.tensor([1]), math.nan)).isnan()


# --- gradients ---


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_gradient_in_point_and_vertices(seed, signed):
    rng = np.random.default_rng(seed)
    points, vertices = double(rng.normal(size=(6, 2)) * 1.5, grad=True), double(rng.normal(size=(6, 7, 2)), grad=True)
    assert gradcheck(lambda p, v: distance_to_hull(p, v, signed=signed), (points, vertices))


@pytest.mark.parametrize("signed", [False, True])
def test_second_derivatives(signed):
    rng = np.random.default_rng(1)
    points, vertices = double(rng.normal(size=(6, 2)) * 1.5, grad=True), double(rng.normal(size=(6, 5, 2)), grad=True)
    assert gradgradcheck(lambda p, v: distance_to_hull(p, v, signed=signed), (points, vertices))


def test_gradient_in_the_point_is_the_unit_normal():
    points = double(RNG.normal(size=(50, 2)) * 5, grad=True)
    found = distance_to_hull(points, double(VERTEX_SETS["triangle"]))
    (gradient,) = torch.autograd.grad(found.sum(), points)
    outside = found > 0
    assert outside.sum() > 25
    np.testing.assert_allclose(gradient.norm(dim=-1), outside.double(), rtol=1e-12)


def test_gradient_inside_is_zero_unless_signed():
    vertices, point = double(SQUARE, grad=True), double([1.0, 0.5], grad=True)
    for gradient in torch.autograd.grad(distance_to_hull(point, vertices), (point, vertices)):
        assert torch.equal(gradient, torch.zeros_like(gradient))
    in_point, in_vertices = torch.autograd.grad(distance_to_hull(point, vertices, signed=True), (point, vertices))
    np.testing.assert_allclose(in_point, [0.0, -1.0])
    np.testing.assert_allclose(in_vertices, [[0.0, 0.5], [0.0, 0.5], [0.0, 0.0], [0.0, 0.0]])


@pytest.mark.parametrize("signed", [False, True])
def test_gradient_on_the_boundary_is_zero(signed):
    points, vertices = double([[1.0, 0.0], [2.0, 2.0], [0.0, 1.5]], grad=True), double(SQUARE, grad=True)
    for gradient in torch.autograd.grad(distance_to_hull(points, vertices, signed=signed).sum(), (points, vertices)):
        assert torch.equal(gradient, torch.zeros_like(gradient))


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("name", VERTEX_SETS)
def test_gradients_are_finite_and_at_most_one_everywhere(name, signed):
    vertices = double(VERTEX_SETS[name], grad=True)
    points = double(np.concatenate((points_about(VERTEX_SETS[name]), VERTEX_SETS[name])), grad=True)
    found = distance_to_hull(points, vertices, signed=signed)
    in_points, in_vertices = torch.autograd.grad(found.sum(), (points, vertices))
    assert in_points.norm(dim=-1).max() <= 1 + 1e-9
    assert in_vertices.isfinite().all()


@pytest.mark.parametrize("name", VERTEX_SETS)
def test_moving_point_and_vertices_together_changes_nothing(name):
    vertices, points = double(VERTEX_SETS[name], grad=True), double(points_about(VERTEX_SETS[name]), grad=True)
    in_points, in_vertices = torch.autograd.grad(distance_to_hull(points, vertices).sum(), (points, vertices))
    np.testing.assert_allclose(in_points.sum(0) + in_vertices.sum(0), 0.0, atol=1e-9)


# --- float32 ---


@pytest.mark.parametrize("scale", [1.0, 1e-6, 1e6])
@pytest.mark.parametrize("name", VERTEX_SETS)
def test_float32_stays_float32_and_near_float64(name, scale):
    vertices = double(VERTEX_SETS[name] * scale)
    points = double(points_about(VERTEX_SETS[name]) * scale)
    found = distance_to_hull(points.float(), vertices.float())
    expected = distance_to_hull(points, vertices)
    assert found.dtype == torch.float32
    size = size_of(points.numpy(), vertices.numpy())
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6 * size)


@pytest.mark.parametrize("signed", [False, True])
def test_the_written_out_derivatives_are_those_of_autograd(signed):
    vertices = double(np.stack([PENTAGON, 1.3 * PENTAGON + 0.2]))
    points = double(np.random.default_rng(0).normal(size=(2, 8, 2)) * 1.5)
    polygons, source, target = convex_hull(*(vertices[..., axis].T.contiguous() for axis in (0, 1)))
    faces = nearest_faces(polygons, points[..., 0], points[..., 1], slots=True)
    assert (faces.inside.sum() > 2) & ((~faces.inside).sum() > 2)

    def rebuilt(corners, at):
        x, y = corners[..., 0].T, corners[..., 1].T
        start_x, start_y = x.gather(0, source), y.gather(0, source)
        return Polygons(start_x, start_y, x.gather(0, target) - start_x, y.gather(0, target) - start_y), at

    def ours(corners, at):
        sides, at = rebuilt(corners, at)
        return face_distance(sides, faces, at[..., 0], at[..., 1], signed=signed)

    def plain(corners, at):
        sides, at = rebuilt(corners, at)
        index = faces.slot.T
        start = tuple(value.gather(0, index).T for value in (sides.x, sides.y))
        edge = tuple(value.gather(0, index).T for value in (sides.edge_x, sides.edge_y))
        end = start[0] + edge[0], start[1] + edge[1]
        square = face_square((at[..., 0], at[..., 1]), start, end)
        return signed_length(square, faces.inside, faces.blur, signed=signed)

    leaves = vertices.clone().requires_grad_(), points.clone().requires_grad_()
    torch.testing.assert_close(ours(*leaves), plain(*leaves), rtol=1e-12, atol=1e-12)
    firsts = [torch.autograd.grad(work(*leaves).square().sum(), leaves, create_graph=True) for work in (ours, plain)]
    seconds = [torch.autograd.grad(sum(one.square().sum() for one in first), leaves) for first in firsts]
    for mine, theirs in (firsts, seconds):
        for own, other in zip(mine, theirs, strict=True):
            torch.testing.assert_close(own, other, rtol=1e-9, atol=1e-10)
