import math
from dataclasses import dataclass, replace

import numpy as np
import oracle
import pytest
import torch
from hull_cases import double, unchecked
from hypothesis import given, strategies as st
from torch.autograd import gradcheck

import torcharm as ta

every_kind = pytest.mark.parametrize("kind", ["exact", "edges"])
every_metric = pytest.mark.parametrize("metric", ["absolute", "relative"])


@pytest.fixture(autouse=True, scope="module")
def _one_thread():
    """Tensors this small are slower on several threads."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


# --- published values ---


@pytest.mark.parametrize(
    ("moment_scale", "published"),
    [
        (2.0, [44.4031, 116.7625, 16.6250, 9.2688, 47.7773]),
        (5.0, [45.3737, 120.3011, 12.8572, 4.3175, 55.0741]),
    ],
)
def test_published_validation_of_the_bellows_arm(moment_scale, published):
    task = ta.Task(
        ta.affine_curvature(-3.0, 3.0), ta.sample_loads(5, scale=(20.0, 20.0, moment_scale)), wrench_at="start"
    )
    result = ta.evaluate(ta.bellows_arm(), task, ("absolute",), hull="edges", samples=3)
    np.testing.assert_allclose(result.absolute, published, rtol=0, atol=1e-3)


# --- the oracle, at random ---

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
        return ta.evaluate(self.arm, task, ("absolute", "relative"), weights=self.weights, **options)

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
def test_evaluate_agrees_with_the_oracle(seed):
    case, power = random_case(seed), 1 + (seed % 16 < 8)
    exact = case.evaluate(power=power)
    assert exact.converged.all()
    for kind in ("exact", "edges") if seed % 4 < 2 else ("exact",):
        expected = case.expect(kind)
        size = max(each.size for each in expected)
        options = {"hull": "edges"} if kind == "edges" else {"distance": "scipy"}
        result = case.evaluate(power=power, samples=case.samples, **options)
        assert result.converged.all()
        for metric in ("absolute", "relative"):
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


@pytest.mark.parametrize("seed", range(20))
def test_required_wrench_is_both_plain_statics_and_the_adjoints(seed):
    case = random_case(seed)
    for load in case.loads:
        found = ta.required_wrench(double(case.twists), double(load), double(case.base_pose), wrench_at="start")
        size = np.abs(load).max()
        for way in (oracle.required_wrenches, oracle.required_wrenches_by_adjoint):
            np.testing.assert_allclose(found, way(case.twists, load, case.base_pose), rtol=0, atol=1e-13 * size)


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
    chosen = ta.evaluate(ta.antagonistic_arm(), task, ("absolute", "relative"), hull="edges", samples=3)
    assert torch.equal(
        ta.evaluate(ta.antagonistic_arm(), task, ("absolute", "relative"), hull="edges").absolute, chosen.absolute
    )


# --- batches ---

MODELS = (ta.Bellows(), ta.McKibben(), ta.Bellows())


def random_arms(*batch, dtype=torch.float64, grad=False):
    rng = np.random.default_rng(1)
    radii, lengths = rng.uniform(-0.06, 0.06, (*batch, 3)), rng.uniform(0.48, 0.55, (*batch, 3))
    limits = rng.uniform(0.5, 1.0, (*batch, 3)) * [50.0, 100.0, 50.0]
    tensors = [torch.tensor(value, dtype=dtype, requires_grad=grad) for value in (radii, lengths, limits)]
    return ta.ArmDesign(tensors[0], tensors[1], MODELS, tensors[2]), tensors


def random_twists(*batch, nodes=4):
    return double(np.random.default_rng(2).uniform([0.46, -0.02, -1.0], [0.52, 0.02, 1.0], (*batch, nodes, 3)))


def random_loads(*batch):
    return double(np.random.default_rng(3).uniform(-1, 1, (*batch, 3)) * [10.0, 10.0, 1.5])


# design batch, twists, loads, task batch
BATCHES = {
    "nothing": ((), random_twists(), random_loads(), ()),
    "one of each": ((1,), random_twists(1), random_loads(1), (1,)),
    "designs": ((5,), random_twists(), random_loads(), (5,)[:0]),
    "loads on one shape": ((2,), random_twists(), random_loads(4), (4,)),
    "shapes under one load": ((2,), random_twists(4), random_loads(), (4,)),
    "pairs": ((2,), random_twists(4), random_loads(4), (4,)),
    "shapes by loads": ((2, 3), random_twists(3, 1), random_loads(4), (3, 4)),
    "loads by shapes": ((2,), random_twists(4), random_loads(3, 1), (3, 4)),
    "loads by shapes, pairwise": ((2,), random_twists(4), random_loads(3, 4), (3, 4)),
    "interleaved": ((2,), random_twists(2, 1, 3), random_loads(4, 1), (2, 4, 3)),
    "interleaved, loads of their own": ((2, 1), random_twists(2, 1, 3), random_loads(2, 4, 3), (2, 4, 3)),
    "loads first": ((3,), random_twists(2), random_loads(4, 1, 1), (4, 1, 2)),
    "shared by stride": ((2,), random_twists(3, 1).expand(3, 4, -1, -1), random_loads(3, 4), (3, 4)),
    "all shared by stride": ((2,), random_twists().expand(3, 4, -1, -1), random_loads(3, 4), (3, 4)),
    "transposed": ((2,), random_twists(4, 3).transpose(0, 1), random_loads(3, 4), (3, 4)),
    "strided": ((2,), random_twists(6)[::2], random_loads(3, 2)[:, 0], (3,)),
}
every_batch = pytest.mark.parametrize(("designs", "twists", "loads", "batch"), BATCHES.values(), ids=BATCHES)


def looped(arm, twists, loads, batch, **options):
    """Every design on every task, one at a time."""
    twists, loads = twists.expand(*batch, *twists.shape[-2:]), loads.expand(*batch, 3)
    results = {}
    for design in np.ndindex(*arm.batch_shape):
        for task in np.ndindex(*batch):
            one = arm[design] if design else arm
            # a batch of one, so that this does not hinge on the case without any batch
            with unchecked():
                results[(*design, *task)] = ta.evaluate(
                    one, ta.Task(twists[task], loads[task][None]), ("absolute", "relative"), **options
                )
    return results


def assert_same(one, other, atol=1e-12):
    assert one.shape == other.shape
    torch.testing.assert_close(one, other, rtol=1e-11, atol=atol)


PROMISED = 5e-10
"""Distances are known to 1e-12 of their largest wrench, of these arms some 500 N: so far may two ways to one differ."""


FIELDS = ("absolute", "relative", "absolute_per_node", "relative_per_node", "strain_excess", "in_range")


@every_batch
def test_batched_equals_looped(designs, twists, loads, batch):
    arm, _ = random_arms(*designs)
    result = ta.evaluate(arm, ta.Task(twists, loads), ("absolute", "relative"), signed=True)
    singles = looped(arm, twists, loads, batch, signed=True)
    assert len(singles) == math.prod((*designs, *batch))
    for field in FIELDS:
        nodes = (4,) if "node" in field else ()
        value = getattr(result, field)
        assert value.shape == (*designs, *batch, *nodes)
        for index, single in singles.items():
            assert_same(value[index], getattr(single, field)[0])


def test_a_single_design_on_a_single_task_gives_scalars():
    arm, _ = random_arms()
    result = ta.evaluate(arm, ta.Task(random_twists(), random_loads()), ("absolute", "relative"))
    for field in ("absolute", "relative", "strain_excess", "in_range"):
        assert getattr(result, field).shape == ()
    assert result.absolute_per_node.shape == (4,)


@every_batch
@pytest.mark.parametrize("chunk_size", [1, 7])
@unchecked()
def test_results_do_not_depend_on_the_chunk_size(designs, twists, loads, batch, chunk_size):
    arm, _ = random_arms(*designs)
    whole = ta.evaluate(arm, ta.Task(twists, loads), ("absolute", "relative"), signed=True)
    parts = ta.evaluate(arm, ta.Task(twists, loads), ("absolute", "relative"), signed=True, chunk_size=chunk_size)
    for field in FIELDS:
        assert_same(getattr(parts, field), getattr(whole, field))


@every_batch
@pytest.mark.parametrize(("kind", "chunk_size"), [("exact", None), ("exact", 3), ("edges", None)])
@unchecked()
def test_asking_for_gradients_leaves_the_values(designs, twists, loads, batch, kind, chunk_size):
    arm, _ = random_arms(*designs)
    tracked, _ = random_arms(*designs, grad=True)
    signed = kind == "exact"
    plain = ta.evaluate(arm, ta.Task(twists, loads), ("absolute", "relative"), hull=kind, signed=signed)
    result = ta.evaluate(
        tracked, ta.Task(twists, loads), ("absolute", "relative"), hull=kind, signed=signed, chunk_size=chunk_size
    )
    assert result.absolute.requires_grad
    for field in FIELDS:
        assert_same(getattr(result, field).detach(), getattr(plain, field), PROMISED)


@pytest.mark.parametrize("name", ["nothing", "pairs", "loads by shapes", "interleaved", "shared by stride"])
@pytest.mark.parametrize("chunk_size", [1, 7])
@unchecked()
def test_gradients_do_not_depend_on_the_chunk_size(name, chunk_size):
    designs, twists, loads, _ = BATCHES[name]

    def gradients(chunk_size):
        arm, tensors = random_arms(*designs, grad=True)
        shape, load = twists.detach().requires_grad_(), loads.detach().requires_grad_()
        result = ta.evaluate(arm, ta.Task(shape, load), ("absolute", "relative"), chunk_size=chunk_size)
        return torch.autograd.grad(result.absolute.sum() + result.relative.square().sum(), (*tensors, shape, load))

    for part, whole in zip(gradients(chunk_size), gradients(None), strict=True):
        torch.testing.assert_close(part, whole, rtol=1e-9, atol=1e-9 * whole.abs().max().item())


@pytest.mark.parametrize("grad", [False, True])
@pytest.mark.parametrize(
    ("designs", "shapes", "loads", "result"),
    [
        ((0,), (), (4,), (0, 4)),
        ((0,), (), (), (0,)),
        ((2,), (), (0,), (2, 0)),
        ((2,), (0,), (), (2, 0)),
        ((2,), (0, 1), (4,), (2, 0, 4)),
        ((2,), (3, 1), (0,), (2, 3, 0)),
        ((), (0,), (0,), (0,)),
        ((3, 0), (2,), (2,), (3, 0, 2)),
    ],
)
def test_empty_batches_give_empty_results(designs, shapes, loads, result, grad):
    arm, _ = random_arms(*designs, grad=grad)
    found = ta.evaluate(arm, ta.Task(random_twists(*shapes), random_loads(*loads)), ("absolute", "relative"))
    for field in FIELDS:
        assert getattr(found, field).shape == ((*result, 4) if "node" in field else result)
    assert found.in_range.dtype == torch.bool
    assert found.absolute.dtype == torch.float64


def test_a_metric_that_was_not_asked_for_is_none():
    arm, _ = random_arms(2)
    task = ta.Task(random_twists(), random_loads(3))
    both, one = ta.evaluate(arm, task, ("absolute", "relative")), ta.evaluate(arm, task, "relative")
    assert one.absolute is None
    assert one.absolute_per_node is None
    assert_same(one.relative, both.relative)
    assert_same(ta.evaluate(arm, task, ("relative", "absolute")).absolute, both.absolute)


# --- symmetries ---


def numbers(low, high):
    return st.floats(low, high, allow_subnormal=False)


@st.composite
def scenes(draw):
    """An arm of up to five actuators, a shape of up to four segments, and a load."""
    count = draw(st.integers(1, 5))
    kinds = draw(st.lists(st.sampled_from(["bellows", "muscle", "wave"]), min_size=count, max_size=count))
    twists = st.tuples(numbers(0.45, 0.52), numbers(-0.05, 0.05), numbers(-1.0, 1.0))
    return Scene(
        radii=double(draw(st.lists(numbers(-0.06, 0.06), min_size=count, max_size=count))),
        lengths=double(draw(st.lists(numbers(0.48, 0.55), min_size=count, max_size=count))),
        models=tuple(KINDS[kind] for kind in kinds),
        twists=double(draw(st.lists(twists, min_size=1, max_size=4))),
        load=double(draw(st.tuples(numbers(-20, 20), numbers(-20, 20), numbers(-3, 3)))),
    )


WAVE = ta.PolynomialActuator(((0, 1, 6.0), (0, 2, -0.5), (0, 3, 0.008), (1, 1, -3.0)), (-0.5, 0.5), (0.0, 40.0), 40.0)
KINDS = {"bellows": ta.Bellows(), "muscle": ta.McKibben(), "wave": WAVE}


@dataclass
class Scene:
    radii: torch.Tensor
    lengths: torch.Tensor
    models: tuple
    twists: torch.Tensor
    load: torch.Tensor
    base_pose: tuple = oracle.HANGING

    def distances(self, **options):
        """Signed distances of all nodes, both metrics."""
        arm = ta.ArmDesign(self.radii, self.lengths[None, :], self.models)
        result = ta.evaluate(
            arm, ta.Task(self.twists, self.load, self.base_pose), ("absolute", "relative"), signed=True, **options
        )
        return torch.stack((result.absolute_per_node, result.relative_per_node))

    def assert_same_distances(self, other, **options):
        torch.testing.assert_close(other.distances(**options), self.distances(), rtol=1e-9, atol=1e-10)


@given(scenes(), numbers(-7, 7), numbers(-9, 9), numbers(-9, 9))
@unchecked()
def test_rotating_and_moving_the_world_leaves_the_result(scene, angle, x, y):
    cos, sin = math.cos(angle), math.sin(angle)
    turn = double([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    scene.assert_same_distances(
        replace(scene, load=turn @ scene.load, base_pose=(x, y, oracle.HANGING[2] + angle)),
    )


@given(scenes())
@unchecked()
def test_the_mirror_image_has_the_same_result(scene):
    # Mirrored about the vertical through the hanging base: x, θ and shear change sign, and so do f_x and m.
    scene.assert_same_distances(
        replace(
            scene,
            radii=-scene.radii,
            twists=scene.twists * double([1, -1, -1]),
            load=scene.load * double([-1, 1, -1]),
        ),
    )


@given(scenes(), st.randoms(use_true_random=False))
@unchecked()
def test_the_order_of_the_actuators_is_free(scene, random):
    order = random.sample(range(len(scene.models)), len(scene.models))
    scene.assert_same_distances(
        replace(
            scene,
            radii=scene.radii[order],
            lengths=scene.lengths[order],
            models=tuple(scene.models[index] for index in order),
        ),
    )


@given(scenes(), numbers(0.1, 10.0))
@unchecked()
def test_another_unit_of_length_is_undone_by_the_weights(scene, factor):
    # Forces stay, moments grow with lengths; so does K/length if K grows with their square.
    scaled = replace(
        scene,
        radii=scene.radii * factor,
        lengths=scene.lengths * factor,
        models=tuple(replace(m, bending_stiffness=m.bending_stiffness * factor**2) for m in scene.models),
        twists=scene.twists * double([factor, factor, 1]),
        load=scene.load * double([1, 1, factor]),
    )
    scene.assert_same_distances(scaled, weights=(1.0, factor**-2))


@given(scenes(), numbers(0.1, 10.0))
@unchecked()
def test_scaling_both_weights_scales_distances_by_the_root(scene, factor):
    torch.testing.assert_close(
        scene.distances(weights=(factor, factor)), scene.distances() * factor**0.5, rtol=1e-9, atol=1e-10
    )


@given(scenes())
@unchecked()
def test_an_actuator_without_pressure_or_force_changes_nothing(scene):
    idle = ta.PolynomialActuator((), (-1.0, 1.0), (0.0, 1.0), 1.0, bending_stiffness=0.0)
    scene.assert_same_distances(
        replace(
            scene,
            radii=torch.cat((scene.radii, double([0.02]))),
            lengths=torch.cat((scene.lengths, double([0.5]))),
            models=(*scene.models, idle),
        ),
    )


@given(scenes(), numbers(1.0, 2.0))
@unchecked()
def test_more_pressure_never_makes_a_distance_grow(scene, factor):
    linear = tuple(
        ta.PolynomialActuator(((0, 1, 1.0 + index), (1, 0, -30.0)), (-1.0, 1.0), (0.0, 99.0), 30.0)
        for index in range(len(scene.models))
    )
    arm = ta.ArmDesign(scene.radii, scene.lengths[None, :], linear)
    more = ta.ArmDesign(scene.radii, scene.lengths[None, :], linear, arm.max_pressure * factor)
    task = ta.Task(scene.twists, scene.load)
    before, after = ta.evaluate(arm, task, ("absolute", "relative")), ta.evaluate(more, task, ("absolute", "relative"))
    assert (after.absolute_per_node - before.absolute_per_node).max() <= 1e-10
    assert (after.relative_per_node - before.relative_per_node).max() <= 1e-10


# --- margins ---


def attainable_scene():
    """A bellows arm, and a two-segment shape and load that it holds well inside its limits in both metrics."""
    twists = double([[0.57, 0.0, 1.25], [0.58, 0.0, -1.2]])
    return ta.bellows_arm(), twists, double([-11.0, 50.0, -1.0])


@pytest.mark.parametrize("power", [1, 2])
def test_an_attainable_task_has_minus_its_smallest_margin(power):
    arm, twists, load = attainable_scene()
    result = ta.evaluate(arm, ta.Task(twists, load[None]), ("absolute", "relative"), signed=True, power=power)
    assert result.absolute_per_node.max() < 0
    assert result.absolute == -(result.absolute_per_node.abs().amin(-1) ** power)
    assert result.relative_per_node[0, 0] == 0
    assert result.relative_per_node[0, 1] < 0
    assert result.relative == -(result.relative_per_node[:, 1].abs() ** power)
    unsigned = ta.evaluate(arm, ta.Task(twists, load[None]), ("absolute", "relative"), power=power)
    assert unsigned.absolute == 0
    assert unsigned.relative == 0


@every_metric
def test_signed_is_negative_if_and_only_if_every_node_is_inside(metric):
    arm, twists, load = attainable_scene()
    loads = load + random_loads(400) * double([1.0, 1.0, 0.3])
    result = ta.evaluate(arm, ta.Task(twists, loads), ("absolute", "relative"), signed=True)
    total, per_node = getattr(result, metric), getattr(result, metric + "_per_node")
    free = per_node if metric == "absolute" else per_node[..., 1:]
    inside = (free < 0).all(-1)
    assert 20 < inside.sum() < 380
    assert torch.equal(total < 0, inside)
    torch.testing.assert_close(total[inside], free[inside].amax(-1))
    torch.testing.assert_close(total[~inside], per_node[~inside].clamp(min=0).sum(-1))


@every_metric
def test_signed_is_continuous_across_the_boundary(metric):
    arm, twists, load = attainable_scene()
    shares = torch.linspace(0, 1, 2001, dtype=torch.float64)[:, None]
    loads = load + shares * double([30.0, 40.0, 5.0])
    total = getattr(ta.evaluate(arm, ta.Task(twists, loads), ("absolute", "relative"), signed=True), metric)
    assert total[0] < 0 < total[-1]
    required = ta.required_wrench(twists, loads)[..., [0, 2]]
    if metric == "relative":
        required = required - required[:, :1]
    steps = required.diff(dim=0).norm(dim=-1).sum(-1)  # no distance changes by more than its wrench moves
    assert torch.all(total.diff().abs() <= steps + 1e-12)


def test_one_segment_has_no_relative_margin():
    arm, _ = random_arms()
    result = ta.evaluate(arm, ta.Task(random_twists(nodes=1), random_loads(5)), ("absolute", "relative"), signed=True)
    assert torch.equal(result.relative, torch.zeros(5, dtype=torch.float64))


# --- what to trust ---


@pytest.mark.parametrize("arm", [ta.bellows_arm(), ta.antagonistic_arm(), ta.mckibben_arm()])
def test_the_papers_validation_is_out_of_range(arm):
    result = ta.evaluate(arm, ta.Task(ta.affine_curvature(-3.0, 3.0), ta.sample_loads(2)), ("absolute", "relative"))
    assert not result.in_range.any()


def test_the_papers_inner_muscle_is_strained_four_per_cent_too_far():
    arm = ta.ArmDesign([-0.015, 0.015], 0.5, [ta.McKibben(), ta.McKibben()])
    result = ta.evaluate(arm, ta.Task(ta.affine_curvature(-3.0, 3.0), [[0.0, 0.0, 0.0]]), ("absolute", "relative"))
    np.testing.assert_allclose(result.strain_excess, [0.09 - 0.05], rtol=1e-12)
    assert not result.in_range.any()


@pytest.mark.parametrize(
    ("length", "excess"),
    [(0.5, 0.0), (0.5 * 1.668, 0.0), (0.5 * (1 - 0.167), 0.0), (0.5 * 1.768, 0.1), (0.5 * 0.733, 0.1)],
)
def test_strain_excess_is_the_largest_strain_beyond_the_range(length, excess):
    arm = ta.ArmDesign([-0.01, 0.01], 0.5, [ta.Bellows(), ta.Bellows()])
    twists = double([[0.5, 0.0, 0.0], [length, 0.0, 0.0]])
    result = ta.evaluate(arm, ta.Task(twists, [[0.0, 1.0, 0.0]]), ("absolute", "relative"))
    np.testing.assert_allclose(result.strain_excess, [excess], atol=1e-15)
    assert result.in_range.tolist() == [excess == 0.0]


def test_range_is_judged_for_every_design_and_shape():
    arm = ta.ArmDesign(double([[-0.01, 0.01], [-0.1, 0.1]]), 0.5, [ta.Bellows(), ta.Bellows()])
    twists = torch.stack([ta.affine_curvature(0.0, turn, nodes=3) for turn in (0.0, 1.0, 9.0)])[:, None]
    result = ta.evaluate(arm, ta.Task(twists, random_loads(2)), ("absolute", "relative"))
    expected = [[True, True, False], [True, False, False]]  # strains of r κ / l̂ against -0.167
    assert result.in_range.tolist() == [[[each] * 2 for each in row] for row in expected]
    np.testing.assert_allclose(result.strain_excess[1, 1], 0.2 - 0.167)


@pytest.mark.parametrize(("limit", "in_range"), [(92.0, True), (92.5, False)])
def test_a_pressure_limit_beyond_the_characterisation_is_out_of_range(limit, in_range):
    arm = ta.ArmDesign([-0.01, 0.01], 0.5, [ta.Bellows(), ta.Bellows()], [limit, 10.0])
    result = ta.evaluate(arm, ta.Task(ta.affine_curvature(0.0, 0.0), [[0.0, 1.0, 0.0]]), ("absolute", "relative"))
    assert result.in_range.tolist() == [in_range]
    assert result.strain_excess.tolist() == [0.0]


# --- gradients ---


def gradient_scene(seed, kind):
    """Leaves, and a metric summed over loads as a function of them; muscles are bent away from their kinks."""
    rng = np.random.default_rng(seed)
    models = [ta.Bellows(), ta.McKibben(), ta.McKibben(), ta.Bellows()] if kind == "mixed" else [ta.Bellows()] * 4
    leaves = {
        "radii": double(rng.normal([-0.07, -0.02, 0.015, 0.06], 0.003), grad=True),
        "length": double(rng.uniform(0.5, 0.53, (1, 4)), grad=True),
        "max_pressure": double([40.0, 80.0, 90.0, 45.0], grad=True),
        "twists": double(rng.uniform([0.47, -0.02, -1.2], [0.5, 0.02, 1.2], (1, 5, 3)), grad=True),
        "tip_load": double(rng.uniform(-1, 1, (3, 3)) * [15.0, 15.0, 3.0], grad=True),
    }

    def total(metric, power, **changed):
        values = {**leaves, **changed}
        arm = ta.ArmDesign(values["radii"], values["length"], models, values["max_pressure"])
        result = ta.evaluate(arm, ta.Task(values["twists"], values["tip_load"]), (metric,), power=power)
        return getattr(result, metric).sum(-1).squeeze()

    return leaves, total


STEPS = {"radii": 1e-6, "length": 1e-6, "max_pressure": 1e-3, "twists": 1e-6, "tip_load": 1e-4}


@pytest.mark.parametrize("kind", ["bellows", "mixed"])
@every_metric
@pytest.mark.parametrize("power", [1, 2])
@pytest.mark.parametrize("name", STEPS)
@unchecked()
def test_gradients_are_those_of_central_differences(kind, metric, power, name):
    for seed in range(3):
        leaves, total = gradient_scene(seed, kind)
        value = total(metric, power)
        (gradient,) = torch.autograd.grad(value, leaves[name])
        leaf, step = leaves[name].detach(), STEPS[name]
        shifts = step * torch.eye(leaf.numel(), dtype=leaf.dtype).view(-1, *leaf.shape)
        found = total(metric, power, **{name: leaf + shifts}) - total(metric, power, **{name: leaf - shifts})
        found = (found.detach() / (2 * step)).view_as(gradient)
        rounding = 20 * np.finfo(float).eps * value.item() / step
        assert gradient.norm() > 0
        assert (gradient - found).norm() < 1e-6 * gradient.norm() + rounding


def smooth_scene():
    """A small arm far from its required wrenches, whose distance is smooth in everything."""
    models = [ta.Bellows(), ta.PolynomialActuator(((0, 1, -2.0), (1, 1, 1.5), (2, 0, -30.0)), (-1, 1), (0, 50), 50.0)]
    inputs = (
        double([-0.05, 0.04], grad=True),
        double([[0.5, 0.52]], grad=True),
        double([40.0, 30.0], grad=True),
        double([[0.48, 0.01, 0.4], [0.53, 0.0, -0.3]], grad=True),
        double([[30.0, -60.0, 2.0], [-25.0, 9.0, 6.0]], grad=True),
    )

    def totals(radii, lengths, limits, twists, loads, **options):
        result = ta.evaluate(
            ta.ArmDesign(radii, lengths, models, limits), ta.Task(twists, loads), ("absolute", "relative"), **options
        )
        return result.absolute, result.relative

    return inputs, totals


@pytest.mark.parametrize(("kind", "chunk_size"), [("exact", None), ("exact", 1), ("edges", None)])
@unchecked()
def test_gradcheck(kind, chunk_size):
    inputs, totals = smooth_scene()
    assert gradcheck(lambda *values: totals(*values, hull=kind, chunk_size=chunk_size), inputs)


def test_gradients_inside_are_zero_unless_signed():
    arm, twists, load = attainable_scene()
    radii, load = arm.radii.clone().requires_grad_(), load[None].requires_grad_()
    arm = ta.ArmDesign(radii, arm.length, arm.actuators)
    plain = ta.evaluate(arm, ta.Task(twists, load), ("absolute", "relative"))
    for gradient in torch.autograd.grad((plain.absolute + plain.relative).sum(), (radii, load)):
        assert torch.equal(gradient, torch.zeros_like(gradient))
    signed = ta.evaluate(arm, ta.Task(twists, load), ("absolute", "relative"), signed=True)
    for gradient in torch.autograd.grad(signed.absolute.sum(), (radii, load)):
        assert gradient.isfinite().all()
        assert gradient.norm() > 0


@unchecked()
def test_gradient_of_the_margin_is_that_of_central_differences():
    arm, twists, load = attainable_scene()

    def margins(load):
        result = ta.evaluate(arm, ta.Task(twists, load), ("absolute", "relative"), signed=True)
        return result.absolute, result.relative

    assert gradcheck(margins, (load[None].requires_grad_(),))


@pytest.mark.parametrize("turn", [0.0, 1e-13, 1e-9])
@every_kind
def test_values_with_gradients_are_those_without_on_a_straight_arm(turn, kind):
    arm = ta.antagonistic_arm()
    tracked = ta.ArmDesign(arm.radii.clone().requires_grad_(), arm.length, arm.actuators)
    for length in (0.37, 0.45, 0.5, 0.6):
        task = ta.Task(ta.affine_curvature(turn, turn, length=length), ta.sample_loads(60))
        plain, result = (
            ta.evaluate(arm, task, ("absolute", "relative"), hull=kind),
            ta.evaluate(tracked, task, ("absolute", "relative"), hull=kind),
        )
        torch.testing.assert_close(result.absolute.detach(), plain.absolute, rtol=1e-9, atol=1e-9)
        torch.testing.assert_close(result.relative.detach(), plain.relative, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("turn", [0.0, 1e-9, 0.3])
def test_values_with_gradients_are_those_without_beside_the_joint_of_parallel_faces(turn):
    # Equal actuators make parallel faces, end to end; the points stand beside the joints, to within rounding or not.
    linear = ta.PolynomialActuator(((0, 1, 0.937),), (-1.0, 1.0), (0.0, 10.0), 10.0)
    arm = ta.ArmDesign([0.0513, 0.0513, 0.0513], 0.5, [linear] * 3)
    twists = double([[0.5, 0.0, turn]])
    joints = ta.reaction_wrench(arm, twists, double([[10.0, 0.0, 0.0], [10.0, 10.0, 0.0]]))  # (2, 1, 2)
    along = (joints[1] - joints[0]) / (joints[1] - joints[0]).norm()
    across = along.flip(-1) * double([1.0, -1.0])
    aside = double([sign * 10.0**power for power in np.linspace(-14, -4, 101) for sign in (-1, 1)])[:, None, None, None]
    away = double([-7.0, -0.3, 0.3, 7.0])[:, None, None, None, None]
    required = (joints + aside * along + away * across).squeeze(-2).reshape(-1, 2)
    # which load asks for it? one segment: the wrench is linear in the load
    unit = double(np.array([oracle.required_wrenches(twists, load)[0, [0, 2]] for load in np.eye(3)]))
    loads = required @ torch.linalg.pinv(unit)
    plain = ta.evaluate(arm, ta.Task(twists, loads, wrench_at="start"), ("absolute",))
    tracked = ta.evaluate(arm, ta.Task(twists, loads.clone().requires_grad_(), wrench_at="start"), ("absolute",))
    assert (plain.absolute > 0).all()
    torch.testing.assert_close(tracked.absolute.detach(), plain.absolute, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("length", [0.37, 0.45, 0.49])
@unchecked()
def test_gradients_on_a_straight_arm_are_those_of_central_differences(length):
    models = [ta.Bellows(), ta.McKibben(), ta.McKibben(), ta.Bellows()]
    radii = double([-0.07, -0.02, 0.015, 0.06])
    task = ta.Task(ta.affine_curvature(0.0, 0.0, length=length, nodes=4), ta.sample_loads(20))

    def total(limits):
        return ta.evaluate(ta.ArmDesign(radii, 0.5, models, limits), task, ("absolute",)).absolute

    limits, step = double([40.0, 80.0, 90.0, 45.0], grad=True), 1e-3
    total(limits).sum().backward()
    for index, shift in enumerate(step * torch.eye(4, dtype=torch.float64)):
        found = (total(limits.detach() + shift) - total(limits.detach() - shift)).sum() / (2 * step)
        assert limits.grad[index].item() == pytest.approx(found.item(), rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("seed", range(1, 60, 2))
@every_kind
@unchecked()
def test_gradients_are_finite_on_degenerate_designs(seed, kind):
    case = random_case(seed)
    leaves = [value.clone().requires_grad_() for value in (case.arm.radii, case.arm.length, case.arm.max_pressure)]
    arm = ta.ArmDesign(leaves[0], leaves[1], case.arm.actuators, leaves[2])
    twists, loads = double(case.twists, grad=True), double(case.loads, grad=True)
    result = ta.evaluate(arm, ta.Task(twists, loads), ("absolute", "relative"), hull=kind)
    total = (result.absolute + result.relative).sum()
    for gradient in torch.autograd.grad(total, (*leaves, twists, loads)):
        assert gradient.isfinite().all()


@unchecked()
def test_moving_identical_actuators_together_has_the_sum_of_their_gradients():
    task = ta.Task(ta.affine_curvature(-0.5, 0.4, nodes=3), ta.sample_loads(6))

    def total(left, right):
        radii = torch.stack((left, left, right, right), -1)
        return ta.evaluate(ta.ArmDesign(radii, 0.5, [ta.Bellows()] * 4), task, ("absolute", "relative")).absolute

    assert gradcheck(total, (double(-0.05, grad=True), double(0.03, grad=True)))


# --- dtype ---


@every_kind
def test_float32_stays_float32_and_near_float64(kind):
    results = []
    for dtype in (torch.float32, torch.float64):
        arm, _ = random_arms(6, dtype=dtype, grad=True)
        task = ta.Task(random_twists(5, 1), random_loads(40)).to(dtype)
        results.append(ta.evaluate(arm, task, ("absolute", "relative"), hull=kind, signed=kind == "exact"))
    single, exact = results
    for field in ("absolute", "relative", "absolute_per_node", "relative_per_node", "strain_excess"):
        value = getattr(single, field)
        assert value.dtype == torch.float32
        error = (value.double() - getattr(exact, field)).abs()
        assert error.max() < 1e-3  # of some 100 N; measured: 2e-4
    assert torch.equal(single.in_range, exact.in_range)


def test_float32_gradients_are_near_those_of_float64():
    gradients = []
    for dtype in (torch.float32, torch.float64):
        arm, leaves = random_arms(6, dtype=dtype, grad=True)
        task = ta.Task(random_twists(5, 1), random_loads(8)).to(dtype)
        result = ta.evaluate(arm, task, ("absolute", "relative"))
        gradients.append(torch.autograd.grad((result.absolute + result.relative).sum(), leaves))
    for single, exact in zip(*gradients, strict=True):
        assert single.dtype == torch.float32
        assert (single.double() - exact).norm() < 5e-3 * exact.norm()  # measured: 7e-4


# --- force models of one's own ---


@dataclass(frozen=True)
class Piston:
    """An actuator that shares nothing with torcharm's own."""

    area: float = 0.8
    bending_stiffness: float = -0.1
    max_pressure: float = 60.0
    strain_range: tuple[float, float] = (-0.3, 0.3)
    pressure_range: tuple[float, float] = (0.0, 60.0)

    def force(self, strain, pressure):
        return self.area * pressure * torch.exp(-strain) - 20 * strain


@every_kind
def test_a_force_model_of_ones_own_mixes_with_the_librarys(kind):
    twin = oracle.Actuator(lambda e, p: 0.8 * p * math.exp(-e) - 20 * e, -0.1, 60.0)
    bellows = oracle.Actuator(oracle.bellows_force)
    arm = ta.ArmDesign([-0.05, 0.01, 0.04], 0.5, [Piston(), ta.Bellows(), Piston()])
    limits = (60.0, 50.0, 60.0)
    expected_arm = oracle.Arm((-0.05, 0.01, 0.04), (0.5,) * 3, limits, (twin, bellows, twin))
    twists, load = random_twists(nodes=3), random_loads(1)
    options = {"hull": "edges"} if kind == "edges" else {"distance": "scipy"}
    task = ta.Task(twists, load, wrench_at="start")
    result = ta.evaluate(arm, task, ("absolute", "relative"), samples=5, **options)
    exact = ta.evaluate(arm, task, ("absolute", "relative"))
    assert (exact.absolute_per_node <= result.absolute_per_node + 1e-10).all()
    assert (exact.relative_per_node <= result.relative_per_node + 1e-10).all()
    expected = oracle.node_distances(expected_arm, twists, load[0], kind=kind, samples=5)
    np.testing.assert_allclose(result.absolute_per_node[0], expected.absolute.clip(min=0), rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(result.relative_per_node[0], expected.relative.clip(min=0), rtol=1e-9, atol=1e-10)
    assert arm.max_pressure.tolist() == list(limits)


@pytest.mark.parametrize("chunk_size", [None, 1])
@unchecked()
def test_gradients_reach_a_force_models_own_parameters(chunk_size):
    def total(area):
        arm = ta.ArmDesign([-0.05, 0.01, 0.04], 0.5, [Piston(area), ta.Bellows(), ta.Bellows()])
        task = ta.Task(random_twists(nodes=3), random_loads(4) * 5)
        result = ta.evaluate(arm, task, ("absolute", "relative"), chunk_size=chunk_size)
        return result.absolute, result.relative

    assert gradcheck(total, (double(0.8, grad=True),))


def test_a_force_that_is_one_number_counts_everywhere():
    class Constant(ta.Bellows):
        def force(self, strain, pressure):
            return torch.tensor(3.0)

    spread = ta.PolynomialActuator(((0, 0, 3.0),), (-1.0, 1.0), (0.0, 50.0), 50.0, ta.Bellows().bending_stiffness)
    task = ta.Task(ta.affine_curvature(0.0, 1.0, length=0.4, nodes=5), [1.0, -2.0, 0.1])
    one, other = (
        ta.evaluate(ta.ArmDesign([-0.05, 0.05], 0.42, [model] * 2), task, ("absolute", "relative"))
        for model in (Constant(), spread)
    )
    assert one.absolute.item() == pytest.approx(other.absolute.item(), rel=1e-12)
    assert one.relative.item() == pytest.approx(other.relative.item(), rel=1e-12)


def test_nan_from_a_force_model_stays_nan():
    arm = ta.ArmDesign([-0.05, 0.04], 0.5, [ta.Bellows(), Piston(area=math.nan)])
    result = ta.evaluate(arm, ta.Task(random_twists(), random_loads(3)), ("absolute", "relative"))
    assert result.absolute.isnan().all()
    assert result.relative.isnan().all()


def test_sixty_four_actuators():
    rng = np.random.default_rng(0)
    radii = rng.uniform(-0.1, 0.1, 64)
    models = [ta.Bellows(), ta.McKibben()] * 32
    twins = (oracle.Actuator(oracle.bellows_force), oracle.Actuator(oracle.mckibben_force, reference=100.0)) * 32
    twists, load = random_twists(nodes=3), random_loads(1) * 40
    arm = ta.ArmDesign(double(radii), 0.5, models)
    task = ta.Task(twists, load, wrench_at="start")
    exact, result = (
        ta.evaluate(arm, task, ("absolute", "relative")),
        ta.evaluate(arm, task, ("absolute", "relative"), distance="scipy", samples=4),
    )
    expected = oracle.node_distances(
        oracle.Arm(tuple(radii), (0.5,) * 64, (50.0, 100.0) * 32, twins), twists, load[0], kind="exact", samples=4
    )
    assert exact.converged.all()
    assert 0.9 * result.absolute < exact.absolute < result.absolute
    assert (exact.relative_per_node <= result.relative_per_node + 1e-9).all()
    np.testing.assert_allclose(result.absolute_per_node[0], expected.absolute.clip(min=0), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(result.relative_per_node[0], expected.relative.clip(min=0), rtol=1e-9, atol=1e-9)
