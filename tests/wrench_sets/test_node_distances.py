"""Distances of all nodes against the oracle: arms, shapes and loads at random, sound and degenerate."""

from dataclasses import dataclass

import numpy as np
import oracle
import pytest
import torch
from hull_cases import double, unchecked

import torcharm as ta

METRICS = ("absolute", "relative")

DEGENERATE = ("identical", "no radii", "no pressure", "K = 0", "straight", "twins", "one segment")


@dataclass
class Case:
    """One arm and shape for torcharm and for the oracle, two loads, and how to evaluate."""

    arm: ta.ArmDesign
    twin: oracle.Arm
    twists: np.ndarray
    loads: np.ndarray
    samples: int
    weights: tuple[float, float]
    base_pose: tuple[float, float, float]

    def evaluate(self, **options):
        task = ta.Task(double(self.twists), double(self.loads), double(self.base_pose), wrench_at="start")
        return ta.evaluate(self.arm, task, METRICS, weights=self.weights, **options)

    def expect(self, kind):
        options = {"kind": kind, "samples": self.samples, "weights": self.weights, "base_pose": self.base_pose}
        return [oracle.node_distances(self.twin, self.twists, load, **options) for load in self.loads]


def random_actuator(rng, stiffness=None):
    """A force model and its twin in the oracle."""
    fields = {} if stiffness is None else {"bending_stiffness": stiffness}
    stiffness = oracle.PAPER_STIFFNESS if stiffness is None else stiffness
    kind = rng.choice(["bellows", "muscle", "double muscle", "polynomial"])
    if kind == "bellows":
        return ta.Bellows(**fields), oracle.Actuator(oracle.bellows_force, stiffness, 50.0)
    if kind == "muscle":
        return ta.McKibben(**fields), oracle.Actuator(oracle.mckibben_force, stiffness, 100.0)
    if kind == "double muscle":
        doubled = oracle.scaled(oracle.mckibben_force, 2.0)
        return ta.McKibben(force_scale=2.0, **fields), oracle.Actuator(doubled, stiffness, 100.0)
    limit = float(rng.uniform(1.0, 80.0))
    terms = tuple(  # waves of several inflections, unless the degree is low
        (i, j, float(rng.normal() * 40 * 2**j / limit**j))
        for j in range(rng.integers(1, 7))
        for i in range(rng.integers(1, 4))
    )
    model = ta.PolynomialActuator(terms, (-0.5, 0.5), (0.0, limit), limit, **fields)
    return model, oracle.Actuator(oracle.polynomial_force(terms), stiffness, limit)


def random_case(seed):
    rng = np.random.default_rng(seed)
    count, nodes = int(rng.integers(1, 9)), int(rng.integers(1, 7))
    flaw = str(rng.choice(DEGENERATE)) if seed % 2 else ""
    stiffness = {"K = 0": 0.0}.get(flaw, rng.choice([None, -0.3, -1.0]))
    models, twins = zip(*(random_actuator(rng, stiffness) for _ in range(count)), strict=True)
    radii = rng.uniform(-0.08, 0.08, count)
    lengths = np.array(
        [rng.uniform(0.55, 0.7) if isinstance(m, ta.McKibben) else rng.uniform(0.4, 0.6) for m in models]
    )
    limits = np.array([model.max_pressure for model in models]) * rng.uniform(0.3, 1.2, count)
    twists = rng.uniform([0.42, -0.05, -1.5], [0.55, 0.05, 1.5], size=(nodes, 3))
    if flaw == "identical":
        models, twins = models[:1] * count, twins[:1] * count
        radii[:], lengths[:], limits[:] = radii[0], lengths[0], limits[0]
    elif flaw == "twins":
        half = -(-count // 2)
        models, twins = (models[:half] * 2)[:count], (twins[:half] * 2)[:count]
        for values in (radii, lengths, limits):
            values[:] = np.tile(values[:half], 2)[:count]
    elif flaw == "no radii":
        radii[:] = 0.0
    elif flaw == "no pressure":
        limits[rng.random(count) < 0.7] = 0.0
    elif flaw == "straight":
        twists[:, 1:] = 0.0
    elif flaw == "one segment":
        twists = twists[:1]
    return Case(
        ta.ArmDesign(double(radii), double(lengths), models, double(limits)),
        oracle.Arm(tuple(radii), tuple(lengths), tuple(limits), twins),
        twists,
        rng.uniform(-1, 1, size=(2, 3)) * [40.0, 40.0, 4.0] * rng.choice([0.02, 0.2, 1.0, 5.0], size=(2, 1)),
        samples=int(rng.integers(2, 10 if count < 5 else 6 if count < 7 else 4)),
        weights=(1.0, 1.0) if seed % 3 == 0 else (float(rng.uniform(0.1, 3)), float(rng.uniform(0.1, 500))),
        base_pose=oracle.HANGING if seed % 5 else tuple(rng.uniform(-2, 2, 3)),
    )


@pytest.mark.parametrize("seed", range(100))
@unchecked()
def test_distances_are_the_oracles(seed):
    case, power = random_case(seed), 1 + (seed % 16 < 8)
    exact = case.evaluate(power=power)
    assert exact.converged.all()
    for kind in ("exact", "edges") if seed % 4 < 2 else ("exact",):
        expected = case.expect(kind)
        size = max(each.size for each in expected)
        options = {"hull": "edges"} if kind == "edges" else {"distance": "scipy"}
        result = case.evaluate(power=power, samples=case.samples, **options)
        assert result.converged.all()
        for metric in METRICS:
            per_node = np.array([getattr(each, metric) for each in expected]).clip(min=0)
            totals = [oracle.total(nodes, metric, power=power, signed=False) for nodes in per_node]
            close = {"rtol": 1e-9, "atol": 2e-12 * size}
            np.testing.assert_allclose(getattr(result, metric + "_per_node"), per_node, **close)
            np.testing.assert_allclose(getattr(result, metric), totals, rtol=1e-9, atol=1e-10 * size**power)
            # The oracle's sets lie within the sets themselves.
            assert (getattr(exact, metric + "_per_node").numpy() <= per_node + 2e-12 * size).all()


@unchecked()
def test_the_random_cases_cover_what_they_are_meant_to():
    cases = [random_case(seed) for seed in range(100)]
    assert {case.arm.actuator_count for case in cases} == set(range(1, 9))
    assert {len(case.twists) for case in cases} == set(range(1, 7))
    assert {case.samples for case in cases} == set(range(2, 10))
    results = [case.evaluate(signed=True) for case in cases]
    assert sum((result.absolute < 0).sum() for result in results) > 5
    assert sum((result.absolute_per_node < 0).sum() for result in results) > 50
    assert sum((result.relative_per_node < 0).sum() for result in results) > 20


# --- sampling ---


@pytest.mark.parametrize("seed", range(0, 60, 2))
@unchecked()
def test_edges_lie_within_the_sets_themselves(seed):
    case = random_case(seed)
    exact, edges = case.evaluate(), case.evaluate(hull="edges", samples=case.samples)
    for metric in ("absolute_per_node", "relative_per_node"):
        slack = getattr(edges, metric) - getattr(exact, metric)
        assert slack.min() >= -1e-12 * max(each.size for each in case.expect("exact"))


def test_edges_are_a_true_inner_approximation():
    # Identical curves bulge together, but on an edge of the pressure box only one is between its ends.
    arched = ta.PolynomialActuator(((0, 1, 4.0), (0, 2, -0.08)), (-0.5, 0.5), (0.0, 40.0), 40.0)
    arm = ta.ArmDesign([0.02] * 3, 0.5, [arched] * 3)
    task = ta.Task(ta.affine_curvature(0.0, 0.5, nodes=2), [[0.0, 200.0, 0.0]])
    exact = ta.evaluate(arm, task, ("absolute",))
    edges = ta.evaluate(arm, task, ("absolute",), hull="edges", samples=9)
    assert edges.absolute > 1.1 * exact.absolute > 0


@pytest.mark.parametrize("samples", [3, 5, 9])
@pytest.mark.parametrize("relative", [False, True])
@unchecked()
def test_any_pressure_reacts_within_the_exact_hull_grown_by_the_sampling_error(samples, relative):
    arm, twists = ta.bellows_arm(), ta.affine_curvature(-1.0, 1.2, nodes=4)
    hulls = ta.wrench_hulls(arm, twists, samples=samples, relative=relative)
    pressure = torch.rand(300, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) * arm.max_pressure
    reaction = ta.reaction_wrench(arm, twists, pressure)
    if relative:
        reaction = reaction - reaction[:, :1]
    gap = ta.distance_to_hull(reaction, hulls.vertices)

    # A chord of a curve c over a step h of pressure misses it by at most h²/8 max|c''|, where c'' = f'' (1, -r).
    strain = (twists[:, None, 0] - arm.radii * twists[:, None, 2]) / 0.5 - 1
    bend = torch.stack([-0.0041 + 0.012588 * strain - 6 * 3.081e-5 * p for p in (0.0, 50.0)])
    if relative:
        bend = bend - bend[:, :1]
    step = 50.0 / (samples - 1)
    bound = (step**2 / 8 * bend.abs().amax(0) * (1 + arm.radii**2).sqrt()).sum(-1)
    assert torch.all(gap <= bound + 1e-12)
    assert torch.all(bound < 5.2 * (2 / (samples - 1)) ** 2)


def test_edges_have_the_papers_three_points():
    task = ta.Task(ta.affine_curvature(-3.0, 3.0), ta.sample_loads(5))
    chosen = ta.evaluate(ta.antagonistic_arm(), task, METRICS, hull="edges", samples=3)
    assert torch.equal(ta.evaluate(ta.antagonistic_arm(), task, METRICS, hull="edges").absolute, chosen.absolute)


# --- many actuators, degenerate designs ---


def test_sixty_four_actuators():
    rng = np.random.default_rng(0)
    radii = rng.uniform(-0.1, 0.1, 64)
    models = [ta.Bellows(), ta.McKibben()] * 32
    twins = (oracle.Actuator(oracle.bellows_force), oracle.Actuator(oracle.mckibben_force, reference=100.0)) * 32
    twists = double(rng.uniform([0.46, -0.02, -1.0], [0.52, 0.02, 1.0], (3, 3)))
    load = double([[-330.0, 125.0, 25.0]])
    arm = ta.ArmDesign(double(radii), 0.5, models)
    task = ta.Task(twists, load, wrench_at="start")
    exact, result = (
        ta.evaluate(arm, task, METRICS),
        ta.evaluate(arm, task, METRICS, distance="scipy", samples=4),
    )
    expected = oracle.node_distances(
        oracle.Arm(tuple(radii), (0.5,) * 64, (50.0, 100.0) * 32, twins), twists, load[0], kind="exact", samples=4
    )
    assert exact.converged.all()
    assert 0.9 * result.absolute < exact.absolute < result.absolute
    assert (exact.relative_per_node <= result.relative_per_node + 1e-9).all()
    np.testing.assert_allclose(result.absolute_per_node[0], expected.absolute.clip(min=0), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(result.relative_per_node[0], expected.relative.clip(min=0), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("seed", range(1, 60, 2))
@pytest.mark.parametrize("kind", ["exact", "edges"])
@unchecked()
def test_gradients_are_finite_on_degenerate_designs(seed, kind):
    case = random_case(seed)
    leaves = [value.clone().requires_grad_() for value in (case.arm.radii, case.arm.length, case.arm.max_pressure)]
    arm = ta.ArmDesign(leaves[0], leaves[1], case.arm.actuators, leaves[2])
    twists, loads = double(case.twists, grad=True), double(case.loads, grad=True)
    result = ta.evaluate(arm, ta.Task(twists, loads), METRICS, hull=kind)
    total = (result.absolute + result.relative).sum()
    for gradient in torch.autograd.grad(total, (*leaves, twists, loads)):
        assert gradient.isfinite().all()
