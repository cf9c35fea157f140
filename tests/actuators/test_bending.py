"""Bending models against the oracle of plain sums, and against each other; hulls against sampled pressures."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from hypothesis import given, strategies as st
from scipy.spatial import ConvexHull

import torcharm as ta
from torcharm.actuators.bending import Bending

SHAPE = ta.affine_curvature(-1.5, 2.5, length=0.5, nodes=6)
LOADS = ta.sample_loads(12, scale=(20.0, 20.0, 2.0))


def stiffening(curvature, pressure):
    """Curls at rest, stiffens with curvature, and stiffens further with pressure."""
    return 0.05 - 0.1 * curvature - (0.15 * curvature + 0.01 * curvature**3) * pressure / 40.0


CURLED = ta.BendingFunction(stiffening, 40.0)


def arm(*bending):
    models = [ta.Bellows(), ta.McKibben(), ta.Bellows()]
    models = [replace(model, bending_stiffness=k) for model, k in zip(models, bending, strict=True)]
    return ta.ArmDesign([-0.05, 0.01, 0.06], 0.5, models)


MIXED = arm(ta.LinearBending(-0.2, 30.0), ta.ConstantBending(-0.15), CURLED)


def moment_by_hand(design, twists, pressure):
    """The reaction (N, 2) summed actuator by actuator."""
    forces, moments = 0.0, 0.0
    taus = (
        lambda k, p: -0.2 * k * p / 30.0,
        lambda k, p: -0.15 * k,
        lambda k, p: 0.05 - 0.1 * k - (0.15 * k + 0.01 * k**3) * p / 40.0,
    )
    for model, tau, r, neutral, p in zip(
        design.actuators, taus, design.radii.tolist(), design.length.tolist(), pressure.tolist(), strict=True
    ):
        own = twists[:, 0] - r * twists[:, 2]
        force = model.force((own - neutral) / neutral, torch.tensor(p, dtype=torch.float64))
        forces, moments = forces + force, moments - r * force + tau(twists[:, 2] / own, p)
    return torch.stack((forces, moments), -1)


@pytest.mark.parametrize("pressure", [[0.0, 0.0, 0.0], [50.0, 100.0, 50.0], [11.0, 70.0, 33.0]])
def test_the_reaction_is_the_sum_by_hand(pressure):
    pressure = torch.tensor(pressure, dtype=torch.float64)
    expected = moment_by_hand(MIXED, SHAPE, pressure)
    torch.testing.assert_close(ta.reaction_wrench(MIXED, SHAPE, pressure), expected, rtol=1e-12, atol=1e-12)


def test_a_number_is_linear_bending_at_the_models_own_limit():
    plain, named = arm(-0.2, -0.1, -0.3), arm(*(ta.LinearBending(k) for k in (-0.2, -0.1, -0.3)))
    task = ta.Task(SHAPE, LOADS)
    assert torch.equal(
        ta.evaluate(plain, task, ("absolute", "relative")).absolute,
        ta.evaluate(named, task, ("absolute", "relative")).absolute,
    )


def test_the_reference_pressure_scales_the_stiffness():
    task = ta.Task(SHAPE, LOADS)
    at_half = arm(ta.LinearBending(-0.1, 25.0), -0.1, ta.LinearBending(-0.15, 25.0))
    torch.testing.assert_close(
        ta.evaluate(at_half, task, ("absolute", "relative")).relative,
        ta.evaluate(arm(-0.2, -0.1, -0.3), task, ("absolute", "relative")).relative,
        rtol=1e-10,
        atol=1e-10,
    )


@pytest.mark.parametrize("relative", [False, True])
@pytest.mark.parametrize(("hull", "samples"), [("exact", 9), ("edges", 9)])
def test_no_pressure_leaves_the_hull_and_its_vertices_are_reactions(relative, hull, samples):
    found = ta.wrench_hulls(MIXED, SHAPE, relative=relative, hull=hull, samples=samples)
    random = torch.rand(200, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    grid = (random * (samples - 1)).round() / (samples - 1) * MIXED.max_pressure
    reached = ta.reaction_wrench(MIXED, SHAPE, grid)  # (200, N, 2)
    at_vertices = torch.stack([ta.reaction_wrench(MIXED, SHAPE, p)[:, i] for i, p in enumerate(found.pressure)])
    if relative:
        first = torch.stack([ta.reaction_wrench(MIXED, SHAPE, p)[:, 0] for p in found.pressure])
        reached, at_vertices = reached - reached[:, :1], at_vertices - first
    torch.testing.assert_close(found.vertices, at_vertices, rtol=1e-10, atol=1e-10)
    if hull == "exact":
        for node in range(int(relative), len(SHAPE)):
            planes = ConvexHull(found.vertices[node].numpy()).equations
            assert (reached[:, node].numpy() @ planes[:, :2].T + planes[:, 2]).max() < 1e-9


@pytest.mark.parametrize("options", [{}, {"hull": "edges", "samples": 65}, {"distance": "scipy"}], ids=str)
@pytest.mark.parametrize("metric", ["absolute", "relative"])
def test_what_rests_moves_the_requirement_the_other_way(options, metric):
    """Constant bending is no part of what pressures provide: the load may as well be asked to bear it."""
    constant = arm(ta.ConstantBending(-0.3), ta.ConstantBending(-0.1), ta.ConstantBending(-0.2))
    without = arm(0.0, 0.0, 0.0)
    task = ta.Task(SHAPE, LOADS)
    own = SHAPE[:, :1] - constant.radii * SHAPE[:, 2:]
    resting = (torch.tensor([-0.3, -0.1, -0.2], dtype=torch.float64) * SHAPE[:, 2:] / own).sum(-1)
    required = ta.required_wrench(SHAPE, LOADS)[..., (0, 2)] - torch.stack((0 * resting, resting), -1)
    hulls = ta.wrench_hulls(without, SHAPE, relative=metric == "relative", samples=129)
    if metric == "relative":
        required = required - required[:, :1]
    expected = ta.distance_to_hull(required, hulls.vertices)
    found = ta.evaluate(constant, task, (metric,), **options)
    assert bool(found.converged.all())
    torch.testing.assert_close(getattr(found, f"{metric}_per_node"), expected, rtol=0, atol=4e-3)


@pytest.mark.parametrize("options", [{}, {"hull": "edges", "samples": 5}, {"distance": "scipy"}], ids=str)
def test_gradients_are_those_of_differences(options):
    task = ta.Task(SHAPE, LOADS[:3])

    def total(radii):
        design = ta.ArmDesign(radii, 0.5, MIXED.actuators)
        found = ta.evaluate(design, task, ("absolute", "relative"), **options)
        return found.absolute.sum() + found.relative.sum()

    radii = MIXED.radii.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(total(radii), radii)
    with torch.no_grad():
        steps = 1e-6 * torch.eye(3, dtype=torch.float64)
        differences = torch.stack([(total(radii + s) - total(radii - s)) / 2e-6 for s in steps])
    torch.testing.assert_close(gradient, differences, rtol=1e-5, atol=1e-4)


@given(st.permutations(range(3)))
def test_the_order_of_actuators_does_not_matter(order):
    task = ta.Task(SHAPE, LOADS[:4])
    permuted = ta.ArmDesign(MIXED.radii[list(order)], 0.5, [MIXED.actuators[i] for i in order])
    for metric in ("absolute", "relative"):
        one, other = (
            getattr(ta.evaluate(design, task, ("absolute", "relative")), metric) for design in (MIXED, permuted)
        )
        torch.testing.assert_close(one, other, rtol=1e-9, atol=1e-9)


def test_batched_is_looped_and_float32_is_near():
    radii = torch.stack((MIXED.radii, 1.1 * MIXED.radii))
    batch, task = ta.ArmDesign(radii, 0.5, MIXED.actuators), ta.Task(SHAPE, LOADS)
    looped = torch.stack([ta.evaluate(batch[i], task, ("absolute", "relative")).relative for i in range(2)])
    torch.testing.assert_close(
        ta.evaluate(batch, task, ("absolute", "relative")).relative, looped, rtol=1e-12, atol=1e-12
    )
    single = ta.ArmDesign(radii.float(), torch.tensor(0.5), MIXED.actuators)
    near = ta.evaluate(single, ta.Task(SHAPE.float(), LOADS.float()), ("absolute", "relative")).relative
    assert near.dtype == torch.float32
    torch.testing.assert_close(near.double(), looped, rtol=1e-4, atol=2e-3)


def test_models_are_told_apart_and_their_copies_are_equal():
    assert isinstance(CURLED, Bending)
    assert ta.Bellows(bending_stiffness=ta.ConstantBending(-0.1)) == ta.Bellows(
        bending_stiffness=ta.ConstantBending(-0.1)
    )
    assert hash(ta.BendingFunction(stiffening, 40.0)) == hash(CURLED)
    assert ta.ConstantBending(-0.1) != ta.LinearBending(-0.1)


def test_a_function_of_curvature_alone_is_allowed():
    model = ta.BendingFunction(lambda k, p: -0.2 * torch.tanh(k), 50.0)
    assert torch.equal(model.active(torch.ones(2)), torch.zeros(2))


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (
            lambda k, p: -0.2 * k * p**2,
            "^function: must be affine in pressure, got a moment .* at 12.5 kPa and -30 rad",
        ),
        (lambda k, p: -0.2 * k * p.sqrt(), "^function: must be affine in pressure"),
        (lambda k, p: -0.2 * k / p, "^function: must be finite"),
        (lambda k: -0.2 * k, "^function: must take tensors of curvature and pressure"),
        (lambda k, p: None, "^function: must take tensors"),
    ],
)
def test_functions_that_are_refused(function, message):
    with pytest.raises(ValueError, match=message):
        ta.BendingFunction(function, 50.0)


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: ta.Bellows(bending_stiffness=0.05), "bending_stiffness"),
        (lambda: ta.McKibben(bending_stiffness=torch.tensor(0.05)), "bending_stiffness"),
        (lambda: ta.PolynomialActuator(((0, 1, 0.9),), (-0.1, 0.4), (0.0, 60.0), 60.0, 0.05), "bending_stiffness"),
        (lambda: ta.ArmDesign([0.0], 0.5, Driven(0.05)), r"actuators\.bending_stiffness"),
        (lambda: ta.LinearBending(0.05), "stiffness"),
        (lambda: ta.ConstantBending(0.05), "stiffness"),
    ],
)
def test_a_stiffness_that_drives_an_arm_on_is_refused_with_the_likely_mistake(make, field):
    message = rf"^{field}: must be at most 0 N·m², .* got 0\.05, which drives an arm on .* was -0\.05 meant\?$"
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize("function", [lambda k, p: 0.1 * k, lambda k, p: -0.1 * k + 0.3 * k * p / 50])
def test_a_moment_that_drives_an_arm_on_is_refused(function):
    with pytest.raises(
        ValueError, match=r"^function: must resist bending, .* got a moment that grows by [36] N·m at 30"
    ):
        ta.BendingFunction(function, 50.0)

    class Own:
        reference_pressure = 50.0

        def passive(self, curvature):
            return function(curvature, torch.zeros_like(curvature))

        def active(self, curvature):
            return function(curvature, torch.full_like(curvature, 50.0)) - self.passive(curvature)

    with pytest.raises(ValueError, match=r"^bending_stiffness: must resist bending"):
        ta.Bellows(bending_stiffness=Own())


def test_what_is_curled_or_snaps_over_is_not_refused():
    """A moment at rest turns the straight body one way; one that grows at first and then turns is a snap."""
    ta.BendingFunction(lambda k, p: 0.3 - 0.1 * k, 50.0)
    ta.BendingFunction(lambda k, p: 0.1 * k - 0.001 * k**3 + 0 * p, 50.0)
    ta.Bellows(bending_stiffness=0.0)


@dataclass(frozen=True)
class Driven:
    """A force model of one's own."""

    bending_stiffness: float
    max_pressure: float = 60.0
    strain_range: tuple = (-0.2, 0.4)
    pressure_range: tuple = (0.0, 60.0)

    def force(self, strain, pressure):
        return 0.8 * pressure - 40.0 * strain


def test_bad_numbers_are_refused():
    with pytest.raises(ValueError, match=r"^stiffness: must be a finite number, got nan"):
        ta.LinearBending(np.nan)
    with pytest.raises(ValueError, match=r"^reference_pressure: must be a finite number and above 0 kPa, got 0"):
        ta.LinearBending(-0.1, 0.0)
    with pytest.raises(ValueError, match=r"^bending_stiffness: must be a finite number or a bending model"):
        ta.Bellows(bending_stiffness=np.inf)
