"""Gradients of unattainability: against differences of its values, and where distances and models have kinks."""

from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np
import pytest
import torch
from hull_cases import PAPER_ARMS, SIZES, Scene, attainable_scene, double, paper_scene, random_scene, unchecked
from torch.autograd import gradcheck

import torcharm as ta

METRICS = ("absolute", "relative")
needs_qpth = pytest.mark.skipif(find_spec("qpth") is None, reason="qpth is not installed")
each_arm = pytest.mark.parametrize("name", PAPER_ARMS)
each_hull = pytest.mark.parametrize("hull", ["exact", "edges"])
each_metric = pytest.mark.parametrize("metric", METRICS)


@pytest.fixture(autouse=True)
def _unchecked():
    with unchecked():
        yield


ONE_SIDED = (-25 / 12, 4.0, -3.0, 4 / 3, -1 / 4)
"""Weights of f(0), f(h) ... f(4h) in the derivative to one side; its error is of fourth order."""


def derivative(function, step):
    """To the side of the step, which may be negative."""
    return sum(weight * function(index * step) for index, weight in enumerate(ONE_SIDED)) / step


def gradients_of(values, *leaves):
    """For each leaf (*values, *leaf)."""
    rows = [torch.autograd.grad(value, leaves, retain_graph=True) for value in values.flatten()]
    return [torch.stack(own).unflatten(0, values.shape) for own in zip(*rows, strict=True)]


# --- radii and lengths of the paper's arms on its shapes ---


@each_arm
@each_metric
@pytest.mark.parametrize(("hull", "samples"), [("exact", None), ("edges", 3)])
def test_radii_and_lengths_agree_with_differences(name, metric, hull, samples):
    # At the last node of (-3, 3) the strain is exactly 0, where a muscle's model has a kink and counts
    # as extended: so lengths are shortened. Radii do not change that strain; for them, the mean of both sides.
    scene = paper_scene(name, loads=4, grad=True)
    options = {"hull": hull, "samples": samples, "metrics": metric}
    keys = ("radii", "length")
    leaves = [scene.leaves[key] for key in keys]
    gradients = gradients_of(getattr(scene.evaluate(**options), metric), *leaves)  # (3, 4, K) each
    for key, leaf, gradient in zip(keys, leaves, gradients, strict=True):
        shifts = torch.eye(len(leaf), dtype=leaf.dtype)  # all actuators' at once, as a batch of designs

        def values(distance, key=key, leaf=leaf, shifts=shifts):
            return getattr(scene.evaluate({key: leaf + distance * shifts}, **options), metric).movedim(0, -1)

        errors = []
        for step in (2e-7, 3e-8):  # rounding spoils short steps; long ones reach to where a corner follows a face
            with torch.no_grad():
                found = derivative(values, -step)
                if key == "radii":
                    found = (found + derivative(values, step)) / 2
            errors.append((gradient - found).norm(dim=-1) / gradient.norm(dim=-1))
        assert (gradient != 0).any(-1).all()
        assert torch.minimum(*errors).max() <= 1e-6  # measured: 4e-9 for radii, 9e-8 for lengths


# --- two thousand problems, away from switches ---


@each_arm
@pytest.mark.parametrize("seed", [1, 2])
def test_random_problems_agree_with_differences(name, seed):
    """Every node's distance, along a random direction in all inputs at once: 2016 problems in all."""
    scene = random_scene(name, designs=7, tasks=3, nodes=8, seed=seed)
    rng = np.random.default_rng(seed)
    keys = list(scene.leaves)
    along = [double(rng.normal(size=scene.leaves[key].shape)) * SIZES[key] * 0.1 for key in keys]
    options = {"hull": "exact"}

    def distances(*leaves):
        found = scene.evaluate(dict(zip(keys, leaves, strict=True)), **options)
        return torch.stack((found.absolute_per_node, found.relative_per_node))

    _, slope = torch.autograd.functional.jvp(distances, tuple(scene.leaves.values()), tuple(along))

    def moved(step):
        return distances(*(leaf + step * way for leaf, way in zip(scene.leaves.values(), along, strict=True)))

    step = 1e-5
    right, left = derivative(moved, step), derivative(moved, -step)
    size = torch.maximum(slope.abs(), slope.abs().median())
    # Between two faces or two models the two sides differ, and the stencil's values do not lie on one smooth curve.
    smooth = (right - left).abs() <= 2e-6 * size
    # measured: at most 1.2 % are not, and of the others the error is at most 8e-9
    assert smooth.double().mean() > 0.98
    assert (slope != 0).double().mean() > 0.7
    assert ((slope - (right + left) / 2).abs() <= 1e-6 * size)[smooth].all()


# --- gradcheck ---


def smooth_scene(name):
    """A small arm whose nodes are all out of reach, away from switches and from kinks of its models."""
    models = {
        "antagonistic": (ta.Bellows(), ta.McKibben(), ta.Bellows()),
        "bellows": (ta.Bellows(), ta.Bellows(), ta.Bellows()),
        "muscles": (ta.McKibben(), ta.McKibben(force_scale=2.0), ta.McKibben()),
    }[name]
    leaves = {
        "radii": double([-0.05, 0.013, 0.041], grad=True),
        "length": double([0.51, 0.53, 0.5], grad=True),
        "max_pressure": double([41.0, 37.0, 46.0], grad=True),
        "twists": double([[0.48, 0.01, 0.4], [0.495, 0.0, -0.3]], grad=True),
        "tip_load": double([-25.0, 190.0, -6.0], grad=True),
    }
    return Scene(models, (0, 1, 2), leaves)


def totals(scene, **options):
    """Both metrics, as a function of the leaves."""

    def function(*leaves):
        found = scene.evaluate(dict(zip(scene.leaves, leaves, strict=True)), **options)
        return found.absolute, found.relative

    return function


CASES = [
    ("antagonistic", {}),
    ("antagonistic", {"power": 2, "chunk_size": 1}),
    ("antagonistic", {"hull": "edges"}),
    ("antagonistic", {"samples": 5, "distance": "scipy"}),
    ("bellows", {}),
    ("muscles", {}),
]


@pytest.mark.parametrize(("name", "options"), CASES)
def test_gradcheck(name, options):
    scene = smooth_scene(name)
    found = scene.evaluate(**options)
    assert (found.absolute_per_node > 0).all()
    assert (found.relative_per_node[..., 1:] > 0).all()
    assert gradcheck(totals(scene, **options), tuple(scene.leaves.values()), rtol=1e-5, atol=1e-6)


# --- inside ---


@each_hull
@pytest.mark.parametrize(
    "distance",
    ["gjk", "scipy", pytest.param("qpth", marks=needs_qpth)],
)
def test_inside_value_and_gradient_are_exactly_zero(distance, hull):
    scene = attainable_scene()
    samples = None if hull == "exact" and distance == "gjk" else 3
    found = scene.evaluate(distance=distance, hull=hull, samples=samples)
    for value in (found.absolute, found.relative):
        assert torch.equal(value, torch.zeros_like(value))
    for own in torch.autograd.grad((found.absolute + found.relative).sum(), list(scene.leaves.values())):
        assert torch.equal(own, torch.zeros_like(own))


@each_hull
def test_a_node_inside_adds_nothing_to_the_gradient(hull):
    scene = paper_scene("antagonistic", loads=20, grad=True)
    samples = None if hull == "exact" else 3
    found = scene.evaluate(hull=hull, samples=samples, metrics="absolute").absolute_per_node
    inside = found == 0
    assert 20 < inside.sum() < 580
    for own in torch.autograd.grad(found[inside].sum(), list(scene.leaves.values()), retain_graph=True):
        assert torch.equal(own, torch.zeros_like(own))
    outside = torch.autograd.grad(found[~inside].sum(), list(scene.leaves.values()), retain_graph=True)
    for own, other in zip(torch.autograd.grad(found.sum(), list(scene.leaves.values())), outside, strict=True):
        torch.testing.assert_close(own, other, rtol=1e-12, atol=1e-12)


def test_the_margins_gradient_is_of_length_one_in_the_required_wrench():
    scene = attainable_scene()
    per_node = scene.evaluate(signed=True).absolute_per_node
    assert (per_node < 0).all()
    (rows,) = gradients_of(per_node, scene.leaves["tip_load"])  # (6, N, 6, 3)
    own = rows.diagonal(dim1=0, dim2=2).movedim(-1, 0).numpy()  # (6, N, 3)
    # the required wrench is linear in the load
    twists = scene.leaves["twists"].detach()
    per_load = ta.required_wrench(twists, double(np.eye(3)))[..., [0, 2]].movedim(0, -1).numpy()  # (N, 2, 3)
    normal = np.einsum("lnk,nkd->lnd", own, np.linalg.pinv(per_load))
    np.testing.assert_allclose(np.einsum("lnd,ndk->lnk", normal, per_load), own, rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=-1), 1.0, rtol=1e-11)


def test_the_margins_gradient_is_that_of_differences():
    scene = attainable_scene(loads=1)
    options = {"signed": True}
    assert (scene.evaluate(**options).relative < 0).all()
    function = totals(scene, **options)
    assert gradcheck(function, tuple(scene.leaves.values()), rtol=1e-5, atol=1e-6)


def test_along_the_margins_gradient_a_task_becomes_attainable():
    """With limits far too low, steps against the signed gradient lead inside, and on to a margin."""
    scene = attainable_scene()
    load = scene.leaves["tip_load"].detach()[:1]
    limits = (scene.leaves["max_pressure"].detach() * 0.2).requires_grad_()

    def margin(limits):
        return scene.evaluate({"tip_load": load, "max_pressure": limits}, signed=True, metrics="absolute").absolute[0]

    values = [margin(limits).item()]
    for _ in range(30):
        (slope,) = torch.autograd.grad(margin(limits), limits)
        limits = (limits - 3.0 * slope / slope.norm()).detach().requires_grad_()
        values.append(margin(limits).item())
    assert values[0] > 1.0
    assert values[-1] < -1.0


# --- kinks, and which side is taken ---


def one_muscle(load, length=0.5, limit=50.0, model=None, twist=(0.5, 0.0, 0.0)):
    """The distance of one straight actuator from a load along it and a moment that nothing provides."""
    arm = ta.ArmDesign([0.0], [length], [model or ta.McKibben()], [limit])
    return ta.evaluate(arm, ta.Task([list(twist)], load), ("absolute",)).absolute


def test_at_zero_strain_a_muscle_is_extended():
    # Against a push of the muscle the nearest wrench is that of its full pull.
    load = [0.0, -80.0, 3.0]
    length = double(0.5, grad=True)
    (gradient,) = torch.autograd.grad(one_muscle(load, length), length)
    with torch.no_grad():
        extended, contracted = (derivative(lambda h: one_muscle(load, 0.5 + h), step) for step in (-1e-5, 1e-5))
    assert abs(extended - contracted) > 0.1 * abs(contracted)
    assert gradient.item() == pytest.approx(extended.item(), rel=1e-6)


@dataclass(frozen=True)
class Valve:
    """A force with a kink at exactly 20 kPa, written two ways: as two branches, or as a ramp."""

    branches: bool
    max_pressure: float = 60.0
    bending_stiffness: float = 0.0
    strain_range: tuple[float, float] = (-1.0, 1.0)
    pressure_range: tuple[float, float] = (0.0, 60.0)

    def force(self, strain, pressure):
        if self.branches:
            return torch.where(pressure >= 20.0, 3.0 * pressure - 40.0, pressure) + 0.0 * strain
        return pressure + 2.0 * (pressure - 20.0).relu() + 0.0 * strain


@pytest.mark.parametrize(("branches", "slope", "side"), [(True, 3.0, 1e-3), (False, 1.0, -1e-3)])
def test_at_a_models_kink_the_gradient_is_of_the_side_on_which_the_model_puts_the_point(branches, slope, side):
    load, model = [0.0, 90.0, 40.0], Valve(branches)
    limit = double(20.0, grad=True)
    value = one_muscle(load, limit=limit, model=model)
    assert value.item() == pytest.approx(np.hypot(70.0, 40.0))
    (gradient,) = torch.autograd.grad(value, limit)
    with torch.no_grad():
        found = derivative(lambda h: one_muscle(load, limit=20.0 + h, model=model), side)
    assert gradient.item() == pytest.approx(-slope * 70.0 / value.item())
    assert gradient.item() == pytest.approx(found.item(), rel=1e-8)


def linear(force_per_pressure):
    """A force linear in pressure and of nothing else, without bending."""
    terms = ((0, 1, force_per_pressure),)
    return ta.PolynomialActuator(terms, (-1.0, 1.0), (0.0, 10.0), 10.0, bending_stiffness=0.0)


def box_scene():
    """One straight node and two linear actuators at ±1 m: the hull is the square of side 10 √2, on its tip.

    Its corners `(f, m)` are (0, 0), (10, -10), (20, 0) and (10, 10).
    """
    arm = ta.ArmDesign([-1.0, 1.0], 3.0, [linear(1.0), linear(1.0)])
    twists = double([[0.5, 0.0, 0.0]])
    unit = ta.required_wrench(twists, double(np.eye(3)))[:, 0, [0, 2]]
    back = torch.linalg.pinv(unit)  # from wrenches to loads

    def distance(wrench, *, radii=None, signed=False):
        design = arm if radii is None else ta.ArmDesign(radii, arm.length, arm.actuators)
        return ta.evaluate(design, ta.Task(twists, wrench @ back), ("absolute",), signed=signed).absolute

    return distance


def test_the_box_is_what_it_is_meant_to_be():
    wrenches = double([[-3.0, 0.0], [10.0, 13.0], [10.0, 0.0], [0.0, 10.0]])
    expected = [3.0, 3.0, -10.0 / np.sqrt(2), 10.0 / np.sqrt(2)]
    np.testing.assert_allclose(box_scene()(wrenches, signed=True), expected, rtol=1e-12)


def test_between_two_faces_equally_near_the_gradient_is_of_either():
    distance = box_scene()
    wrenches = double([[10.0, 4.0], [3.0, 0.0], [10.0, 0.0]], grad=True)
    (own,) = torch.autograd.grad(distance(wrenches, signed=True).sum(), wrenches)
    normals = double([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]]) / np.sqrt(2)
    nearest = [[0, 2], [2, 3], [0, 1, 2, 3]]  # outward normals of the faces that are equally near
    for gradient, faces in zip(own, nearest, strict=True):
        assert (gradient - normals[faces]).norm(dim=-1).min() < 1e-12


def test_outside_there_is_no_kink_where_a_corner_takes_over_from_a_face():
    distance = box_scene()
    # beyond the corner (10, 10), on the line along which its upper right face ends
    wrench = double([13.0, 13.0], grad=True)
    (own,) = torch.autograd.grad(distance(wrench), wrench)
    np.testing.assert_allclose(own, np.sqrt([0.5, 0.5]), rtol=1e-12)
    way = double([1.0, -1.0])
    with torch.no_grad():
        for step in (1e-4, -1e-4):
            found = derivative(lambda h: distance(wrench + h * way), step)
            assert found.item() == pytest.approx((own @ way).item(), abs=1e-9)


@pytest.mark.parametrize("signed", [False, True])
def test_on_the_boundary_the_gradient_is_zero(signed):
    distance = box_scene()
    wrenches = double([[0.0, 0.0], [5.0, 5.0], [10.0, 10.0], [12.5, -7.5], [20.0, 0.0]], grad=True)
    radii = double([-1.0, 1.0], grad=True)
    found = distance(wrenches, radii=radii, signed=signed)
    assert torch.equal(found, torch.zeros_like(found))
    for own in torch.autograd.grad(found.sum(), (wrenches, radii)):
        assert torch.equal(own, torch.zeros_like(own))


@each_metric
@each_hull
def test_where_one_of_two_equal_actuators_moves_the_gradient_lies_between_the_two_sides(metric, hull):
    # Two muscles at one radius make one long face; moved apart they make two, in an order that depends on the sign.
    scene = paper_scene("muscles", loads=4, together=False, grad=True)
    options = {"hull": hull, "samples": None if hull == "exact" else 3, "metrics": metric}
    leaf = scene.leaves["radii"]
    (gradient,) = gradients_of(getattr(scene.evaluate(**options), metric), leaf)
    with torch.no_grad():
        shifts = torch.eye(4, dtype=leaf.dtype)

        def values(step):
            return getattr(scene.evaluate({"radii": leaf + step * shifts}, **options), metric)

        right, left = (derivative(values, step).movedim(0, -1) for step in (2e-7, -2e-7))
    rounding = 1e-6 * gradient.norm(dim=-1, keepdim=True)
    assert ((right - left).abs() > 100 * rounding).any()
    assert (gradient >= torch.minimum(right, left) - rounding).all()
    assert (gradient <= torch.maximum(right, left) + rounding).all()
    # of the two together there is one derivative
    pairs = [value.unflatten(-1, (2, 2)).sum(-1) for value in (gradient, (right + left) / 2)]
    if hull == "exact":
        torch.testing.assert_close(*pairs, rtol=1e-6, atol=rounding.max().item())
