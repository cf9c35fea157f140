"""Stiff, degenerate and extreme scenes: a right number or a flag.

The scenes and the extended-precision reference are those of experiments/stability, which has every figure.
"""

import importlib.util
import math
from dataclasses import dataclass

import numpy as np
import pytest
import torch

import torcharm as ta
from experiments.stability import reference, run, scenes

HAS_QPTH = importlib.util.find_spec("qpth") is not None
needs_qpth = pytest.mark.skipif(not HAS_QPTH, reason="qpth is not installed")
BACKENDS = {backend.name: backend for backend in run.backends()}
SOLVERS = ("scipy", "qpth")


def each_scene(chosen):
    return pytest.mark.parametrize(
        "scene", [pytest.param(scene, id=f"{scene.group}: {scene.name}") for scene in chosen]
    )


def rows_of(scene, *names, derivatives=False):
    chosen = [BACKENDS[name] for name in names if name in BACKENDS]
    return list(run.scene_rows(scene, chosen, derivatives=derivatives))


# --- every scene, every backend ---

EXACT_ERROR = 1e-7
"""Of a distance over max|H - w|: curves are cubic pieces, good to this."""
SCENES = scenes.all_scenes()
SOME = [scene for scene in SCENES if scene.name != "N = 2000"][::3]  # solvers take their time


@each_scene(SCENES)
def test_exact_distances_are_right(scene):
    """In the plane and turned out of it; of impossible shapes they are infinite and not converged."""
    for row in rows_of(scene, "exact", "exact, in space"):
        assert row.converged or math.isinf(row.reference), row
        assert row.error <= EXACT_ERROR, row


@each_scene(SOME)
def test_solvers_are_right(scene):
    for row in rows_of(scene, *SOLVERS):
        assert row.converged or math.isinf(row.reference), row
        assert row.error <= (1e-12 if row.backend == "scipy" else 1e-6), row


@each_scene(SCENES[1::3])
def test_float32_is_right_to_its_rounding(scene):
    for row in rows_of(scene, "exact, float32"):
        assert row.error <= 5e-6, row


@each_scene(SCENES[::6])
def test_derivatives_of_exact_distances_are_right(scene):
    """Where they are defined; at a kink, between the one-sided ones."""
    for row in rows_of(scene, "exact", "exact, in space", derivatives=True):
        assert row.gradient_error is None or row.gradient_error <= 1e-6, row


def test_strains_out_of_range_are_flagged():
    for scene in SCENES:
        if scene.group in ("actuator length near zero", "strain beyond the range"):
            arm, task = scene.build()
            found = ta.evaluate(arm, task, ("absolute", "relative"))
            strains = [reference.sections(arm, task, False).strain[:, m] for m in range(arm.actuator_count)]
            excess = max(
                max(own.max() - model.strain_range[1], model.strain_range[0] - own.min())
                for own, model in zip(strains, arm.actuators, strict=True)
            )
            assert found.in_range.item() == (excess <= 1e-12), scene.name
            assert found.strain_excess.item() == pytest.approx(max(float(excess), 0.0), rel=1e-12)


# --- fuzz ---

FUZZED = 40_000
DESIGNS, TASKS = 25, 40
MODELS = (ta.Bellows(), ta.McKibben(), ta.McKibben(force_scale=2.0))


def log_uniform(rng, low, high, shape=()):
    return 10.0 ** rng.uniform(low, high, shape)


def signed_log_uniform(rng, low, high, shape, zeros=0.1):
    """Of either sign and every size, with some exact zeros."""
    size = log_uniform(rng, low, high, shape) * rng.choice([-1.0, 1.0], shape)
    return np.where(rng.random(shape) < zeros, 0.0, size)


def random_models(rng):
    return [MODELS[kind] for kind in rng.integers(0, len(MODELS), rng.integers(1, 9))]


def random_loads(rng):
    """From 1e-9 to 1e5 N."""
    return signed_log_uniform(rng, -9, 5, (TASKS, 3))


def wild(rng, dtype):
    """Anything: some nodes have no length, some actuators none or a negative one; few strains are in range."""
    models, nodes = random_models(rng), rng.integers(1, 21)
    limits = rng.uniform(0, 500, (DESIGNS, len(models))) * (rng.random((DESIGNS, len(models))) > 0.1)
    shape = (TASKS, nodes)
    bend = np.where(rng.random(shape) < 0.5, rng.uniform(-20, 20, shape), signed_log_uniform(rng, -12, 1.3, shape))
    along = log_uniform(rng, -3, 1, (TASKS, 1)) * (rng.random(shape) > 0.05)
    return scenes_of(
        models,
        radii=signed_log_uniform(rng, -6, 0, (DESIGNS, len(models))),
        length=log_uniform(rng, -3, 1, (DESIGNS, 1)),
        limits=limits,
        twists=np.stack((along, signed_log_uniform(rng, -6, 0, shape, zeros=0.8), bend), -1),
        loads=random_loads(rng),
        dtype=dtype,
    )


def tame(rng, dtype):
    """Arms of any size, with actuators about as long as they are: many strains are in range."""
    models, nodes, size = random_models(rng), rng.integers(1, 21), log_uniform(rng, -3, 1)
    shape = (TASKS, nodes)
    along = size * rng.uniform(0.95, 1.03, (TASKS, 1)).repeat(nodes, 1)
    bend = np.where(rng.random(shape) < 0.5, rng.uniform(-1, 1, shape), signed_log_uniform(rng, -12, 0, shape))
    return scenes_of(
        models,
        radii=size * signed_log_uniform(rng, -6, -1, (DESIGNS, len(models))),
        length=size * np.ones((DESIGNS, 1)),
        limits=rng.uniform(0, 92, (DESIGNS, len(models))),
        twists=np.stack((along, np.zeros(shape), bend), -1),
        loads=random_loads(rng) * min(size, 1e-2),
        dtype=dtype,
    )


def scenes_of(models, *, radii, length, limits, twists, loads, dtype):
    radii, length, limits, twists, loads = (
        torch.tensor(value, dtype=dtype) for value in (radii, length, limits, twists, loads)
    )
    return ta.ArmDesign(radii, length, models, limits), ta.Task(twists, loads, wrench_at="start")


def assert_finite_or_flagged(found):
    """No metric is a NaN or an infinity without a flag, and none that claims to have converged is one at all."""
    for metric in run.METRICS:
        total, per_node = getattr(found, metric), getattr(found, f"{metric}_per_node")
        assert (total.isfinite() | ~found.converged | ~found.in_range).all()
        assert (per_node.isfinite().all(-1) | ~found.converged).all()
    assert not found.strain_excess.isnan().any()


def test_fuzzed_scenes_are_finite_or_flagged():
    rng = np.random.default_rng(2026)
    seen, in_range, finite = 0, 0, 0
    for batch in range(FUZZED // (DESIGNS * TASKS)):
        arm, task = (tame if batch % 2 else wild)(rng, torch.float32 if batch % 8 >= 6 else torch.float64)
        found = ta.evaluate(arm, task, ("absolute", "relative"), signed=batch % 3 == 0, power=1 + (batch // 2) % 2)
        assert_finite_or_flagged(found)
        good = found.absolute.isfinite() & found.relative.isfinite()
        assert good[found.in_range].all()
        seen += good.numel()
        finite += good.sum().item()
        in_range += found.in_range.sum().item()
    assert seen == FUZZED
    assert in_range > FUZZED // 10  # what must be finite without a flag is no rare case
    assert finite > FUZZED // 2


def test_gradients_of_fuzzed_scenes_in_range_are_finite():
    rng = np.random.default_rng(7)
    for _ in range(3):
        arm, task = tame(rng, torch.float64)
        inputs = [value.clone().requires_grad_() for value in (arm.radii, arm.length, arm.max_pressure)]
        twists = task.twists.clone().requires_grad_()
        found = ta.evaluate(
            ta.ArmDesign(inputs[0], inputs[1], arm.actuators, inputs[2]),
            ta.Task(twists, task.tip_load),
            ("absolute", "relative"),
        )
        total = (found.absolute + found.relative)[found.in_range].sum()
        for gradient in torch.autograd.grad(total, (*inputs, twists)):
            assert gradient.isfinite().all()


def test_fuzzed_scenes_without_a_flag_are_right():
    rng = np.random.default_rng(8)
    checked = 0
    for _ in range(6):
        arm, task = tame(rng, torch.float64)
        found = ta.evaluate(arm, task, ("absolute", "relative"))
        for design, index in found.in_range.nonzero()[:3].tolist():
            own = ta.Task(task.twists[index], task.tip_load[index], wrench_at=task.wrench_at)
            for metric in run.METRICS:
                expected = reference.node_distances(arm[design], own, metric, None, gap=run.DISTANCES_GAP)
                value = getattr(found, f"{metric}_per_node")[design, index].numpy()
                np.testing.assert_array_less(abs(value - expected.value), EXACT_ERROR * expected.scale + 1e-300)
            checked += 1
    assert checked > 9


# --- one bad element in a batch for qpth ---


@dataclass(frozen=True)
class Broken:
    """A force model that has no answer below some strain."""

    bending_stiffness: float = -0.3
    max_pressure: float = 50.0
    strain_range: tuple[float, float] = (-0.2, 0.7)
    pressure_range: tuple[float, float] = (0.0, 50.0)

    def force(self, strain, pressure):
        lost = torch.where(strain < -0.3, torch.full_like(strain, torch.nan), torch.zeros_like(strain))
        return ta.Bellows().force(strain, pressure) + lost


BATCH_TASK = ta.Task(ta.affine_curvature(0.4, 0.5, length=0.505, nodes=4), ta.sample_loads(3, (100.0, 200.0, 10.0)))


def batch_of(radii, lengths, limits):
    """Designs of bellows, muscles, and bellows that break when they are squeezed too far."""
    actuators = (ta.Bellows(), ta.McKibben(), ta.McKibben(), Broken())
    return ta.ArmDesign(torch.stack(radii), torch.stack(lengths)[:, None], actuators, torch.stack(limits))


def good_designs():
    radii, _, limits = bad_designs()["no number"]
    length = torch.tensor(0.5, dtype=torch.float64)
    return [(radii * (1 + 0.05 * step), length * (1 + 0.005 * step), limits) for step in range(5)]


def bad_designs():
    """Designs that end qpth's iterations, by name: a force that is no number, a hull of one point, a huge one."""
    radii, one = torch.tensor(scenes.RADII, dtype=torch.float64), torch.tensor(1.0, dtype=torch.float64)
    limits = torch.tensor([50.0, 100.0, 100.0, 50.0], dtype=torch.float64)
    return {
        "no number": (radii, 0.9 * one, limits),
        "one point": (0 * radii, 0.5 * one, 0 * limits),
        "huge": (radii, 0.05 * one, limits),
    }


@needs_qpth
@pytest.mark.parametrize("name", bad_designs())
def test_a_bad_element_leaves_the_others_of_a_qpth_batch_unharmed(name):
    good, bad = good_designs(), bad_designs()[name]
    found = differentiated(batch_of(*zip(*good[:2], bad, *good[2:], strict=True)))
    alone = differentiated(batch_of(*zip(*good, strict=True)))
    others = [0, 1, 3, 4, 5]
    for metric in run.METRICS:
        torch.testing.assert_close(getattr(found[0], metric)[others], getattr(alone[0], metric), rtol=1e-6, atol=1e-6)
        assert getattr(found[0], metric)[others].isfinite().all()
    assert found[0].converged[others].all()
    torch.testing.assert_close(found[1][others], alone[1], rtol=1e-4, atol=1e-3)
    if name == "no number":
        assert not found[0].converged[2].any()
    else:
        closed = ta.evaluate(
            batch_of(*zip(bad, strict=True)), BATCH_TASK, ("absolute", "relative"), samples=3, distance="scipy"
        )
        assert found[0].converged[2].all()
        torch.testing.assert_close(found[0].absolute[2:3], closed.absolute, rtol=1e-9, atol=0)


def differentiated(arm):
    """What qpth finds, and its gradient in the radii for each design."""
    radii = arm.radii.clone().requires_grad_()
    scaled = ta.ArmDesign(radii, arm.length, arm.actuators, arm.max_pressure)
    found = ta.evaluate(scaled, BATCH_TASK, ("absolute", "relative"), samples=3, distance="qpth")
    total = torch.where(found.converged, found.absolute, torch.zeros_like(found.absolute)).sum()
    return found, torch.autograd.grad(total, radii)[0]


# --- float32 ---

FLOAT32_ERRORS = {
    "antagonistic": {
        "absolute": 3.9e-5,
        "relative": 7.6e-4,
        "absolute_per_node": 1.5e-5,
        "relative_per_node": 1.5e-4,
    },
    "bellows-only": {
        "absolute": 1.6e-5,
        "relative": 2.8e-5,
        "absolute_per_node": 6.6e-6,
        "relative_per_node": 1.2e-5,
    },
}
"""Largest absolute errors [N] against float64 as measured: forces of 100 N have seven digits. The stretched muscle
of the antagonistic arm (8 N per 1e-3 of strain at +9 %) takes a digit."""


def test_float32_on_the_validation_study():
    for arm, columns in run.float32_errors().items():
        for column, error in columns.items():
            assert error <= 3 * FLOAT32_ERRORS[arm][column], (arm, column, error)
