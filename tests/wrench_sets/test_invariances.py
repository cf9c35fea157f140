"""What distances must not depend on, or in a known way: order, mirrors, frames, units, batches; plane and space."""

import math
from dataclasses import dataclass, replace

import numpy as np
import oracle
import pytest
import torch
from hull_cases import double, unchecked

import torcharm as ta
from torcharm.geometry import se3

MODELS = (
    ta.Bellows(),
    ta.McKibben(force_scale=1.5),
    ta.PolynomialActuator(((0, 1, 6.0), (0, 2, -0.5), (0, 3, 0.008), (1, 1, -3.0)), (-0.5, 0.5), (0.0, 40.0), 40.0),
)
METRICS = ("absolute_per_node", "relative_per_node")
PROMISED, PROMISED_INSIDE = 1e-9, 1e-7
"""Distances are known to 1e-12 and margins to 1e-10 of their largest wrench, of these arms up to 1000 N."""
HANGING = {2: double(oracle.HANGING), 3: double([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])}
SHAPES = {
    2: ([0.47, -0.02, -1.0], [0.53, 0.02, 1.0]),
    3: ([0.47, -0.02, -0.02, -0.2, -0.9, -0.9], [0.53, 0.02, 0.02, 0.2, 0.9, 0.9]),
}
LOADS = {2: [15.0, 15.0, 2.0], 3: [15.0, 15.0, 15.0, 2.0, 2.0, 2.0]}
SEEDS = range(10)
each = pytest.mark.parametrize(("dimension", "seed"), [(dimension, seed) for dimension in (2, 3) for seed in SEEDS])


@pytest.fixture(autouse=True)
def _unchecked():
    with unchecked():
        yield


@dataclass(frozen=True)
class Scene:
    """Designs and tasks under a tip load and a load at 0.7 of the arm; with a mass also under its weight."""

    offsets: torch.Tensor
    length: torch.Tensor
    models: tuple
    twists: torch.Tensor
    tip: torch.Tensor
    point: torch.Tensor
    base: torch.Tensor
    mass: float = 0.3

    @property
    def arm(self):
        across = {"radii": self.offsets[..., 0]} if self.twists.shape[-1] == 3 else {"offsets": self.offsets}
        return ta.ArmDesign(**across, length=self.length, actuators=self.models, mass=self.mass)

    @property
    def task(self):
        points = [ta.PointLoad(self.point, at=0.7)]
        load = ta.ExternalLoad(self.tip, gravity=self.mass > 0, points=points)
        return ta.Task(self.twists, load=load, base_pose=self.base)

    def distances(self, **options):
        """(2, *designs, *tasks, N) by both metrics."""
        found = ta.evaluate(self.arm, self.task, ("absolute", "relative"), **options)
        assert found.converged.all()
        return torch.stack([getattr(found, name) for name in METRICS])

    def assert_same_distances(self, other, scale=1.0, **options):
        for signed, atol in ((False, PROMISED), (True, PROMISED_INSIDE)):
            found, wanted = other.distances(signed=signed, **options), scale * self.distances(signed=signed)
            torch.testing.assert_close(found, wanted, rtol=0, atol=max(scale, 1.0) * atol)


def random_scene(dimension, seed, designs=(), tasks=(3,)):
    """Up to five actuators of any kind at places of their own, on shapes with shear and torsion; odd ones bear less."""
    rng = np.random.default_rng([dimension, seed])
    count, nodes, size = 1 + seed % 5, 2 + seed % 3, 0.1 if seed % 2 else 1.0
    load = size * np.array(LOADS[dimension])
    offsets = rng.uniform(-0.06, 0.06, (*designs, count, 2))
    if dimension == 2:
        offsets[..., 1] = 0.0
    return Scene(
        double(offsets),
        double(rng.uniform(0.48, 0.54, (*designs, count))),
        tuple(MODELS[kind] for kind in rng.integers(len(MODELS), size=count)),
        double(rng.uniform(*SHAPES[dimension], (*tasks, nodes, len(load)))),
        double(rng.uniform(-1, 1, (*tasks, len(load))) * load),
        double(rng.uniform(-0.4, 0.4, len(load)) * load),
        HANGING[dimension],
        mass=0.3 * size,
    )


def turned(vectors, turn):
    """Both three-vectors (..., 6) by a rotation (3, 3)."""
    return torch.cat((vectors[..., :3] @ turn.mT, vectors[..., 3:] @ turn.mT), -1)


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_scenes_are_in_and_out_of_reach(dimension):
    found = [random_scene(dimension, seed).distances(signed=True).flatten(1) for seed in SEEDS]
    absolute, relative = torch.cat(found, -1)
    assert (absolute > 1.0).sum() > 20
    assert (absolute < -0.1).sum() > 10
    assert (relative > 1.0).sum() > 20


@pytest.mark.parametrize("dimension", [2, 3])
def test_batches_are_loops_and_chunks_are_of_no_matter(dimension):
    scene = random_scene(dimension, 4, designs=(6,), tasks=(4,))
    whole = scene.distances()
    for chunk_size in (1, 5):
        torch.testing.assert_close(scene.distances(chunk_size=chunk_size), whole, rtol=0, atol=1e-10)
    for design in range(6):
        for task in range(4):
            own = {"offsets": scene.offsets[design], "length": scene.length[design]}
            one = replace(scene, **own, twists=scene.twists[task], tip=scene.tip[task])
            torch.testing.assert_close(whole[:, design, task], one.distances(), rtol=0, atol=1e-10)


@each
def test_the_order_of_actuators_is_of_no_matter(dimension, seed):
    scene = random_scene(dimension, seed)
    order = np.random.default_rng(seed).permutation(len(scene.models)).tolist()
    models = tuple(scene.models[index] for index in order)
    scene.assert_same_distances(replace(scene, offsets=scene.offsets[order], length=scene.length[order], models=models))


MIRRORS = [
    (2, [-1, 1], [1, -1, -1], [-1, 1, -1]),
    (3, [-1, 1], [1, -1, 1, -1, 1, -1], [-1, 1, 1, 1, -1, -1]),
    (3, [1, -1], [1, 1, -1, -1, -1, 1], [1, 1, -1, -1, -1, 1]),
]
"""The signs that offsets, twists and wrenches change: in the vertical planes across world x, again, and across z."""


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("dimension", "across", "shape", "load"), MIRRORS)
def test_mirrored_arms_hold_mirrored_shapes_under_mirrored_loads(dimension, across, shape, load, seed):
    scene = random_scene(dimension, seed)
    scene.assert_same_distances(
        replace(
            scene,
            offsets=scene.offsets * double(across),
            twists=scene.twists * double(shape),
            tip=scene.tip * double(load),
            point=scene.point * double(load),
        )
    )


@pytest.mark.parametrize("seed", SEEDS)
def test_in_space_it_is_of_no_matter_how_the_cross_section_is_turned(seed):
    scene, angle = random_scene(3, seed), 0.7 + seed
    roll = se3.exp(double([0, 0, 0, angle, 0, 0]))
    back = roll[:3, :3].mT
    scene.assert_same_distances(
        replace(
            scene,
            offsets=scene.offsets @ back[1:, 1:].mT,
            twists=turned(scene.twists, back),
            base=scene.base @ roll,
        )
    )


@pytest.mark.parametrize("seed", SEEDS)
def test_in_the_plane_the_world_may_turn_and_move_unless_the_arm_weighs(seed):
    rng = np.random.default_rng(seed)
    scene, (x, y, angle) = replace(random_scene(2, seed), mass=0.0), rng.uniform(-9, 9, 3)
    cos, sin = math.cos(angle), math.sin(angle)
    turn = double([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    base = double([x, y, oracle.HANGING[2] + angle])
    scene.assert_same_distances(replace(scene, tip=scene.tip @ turn.mT, point=scene.point @ turn.mT, base=base))


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("weighs", [False, True])
def test_in_space_the_world_may_turn_and_move_about_the_vertical_alone_if_the_arm_weighs(seed, weighs):
    rng = np.random.default_rng(seed)
    pose = se3.exp(double(rng.normal(size=6) * [1, 1, 1, 2 * (not weighs), 2, 2 * (not weighs)]))
    tilt = se3.exp(double([0, 0, 0, 0.1, -0.3, 0.4]))
    scene = replace(random_scene(3, seed), mass=0.3 * weighs, base=tilt @ HANGING[3])
    turn = pose[:3, :3]
    moved = replace(scene, tip=turned(scene.tip, turn), point=turned(scene.point, turn), base=pose @ scene.base)
    scene.assert_same_distances(moved)


@each
def test_the_unit_of_length_is_of_no_matter(dimension, seed):
    """Moments, with bending stiffness and weights of moments, follow; strains, forces and angles stay."""
    scene, unit = random_scene(dimension, seed), 10.0 ** (seed % 7 - 3)
    linear = 2 if dimension == 2 else 3
    shape, force = ([unit] * count + [1.0] * rest for count, rest in ((linear, 0), (0, linear)))
    shape += [1.0] * (scene.twists.shape[-1] - linear)
    force += [unit] * (scene.tip.shape[-1] - linear)
    models = tuple(replace(one, bending_stiffness=one.bending_stiffness * unit**2) for one in scene.models)
    scaled = replace(
        scene,
        offsets=scene.offsets * unit,
        length=scene.length * unit,
        models=models,
        twists=scene.twists * double(shape),
        tip=scene.tip * double(force),
        point=scene.point * double(force),
    )
    scene.assert_same_distances(scaled, weights=(1.0, unit**-2))


@each
def test_the_unit_of_force_scales_distances(dimension, seed):
    scene, factor = random_scene(dimension, seed), 10.0 ** (seed % 5 - 2)
    scene.assert_same_distances(scene, factor, weights=(factor**2, factor**2))


@each
def test_an_actuator_without_pressure_or_force_changes_nothing(dimension, seed):
    scene = random_scene(dimension, seed)
    idle = ta.PolynomialActuator((), (-1.0, 1.0), (0.0, 1.0), 1.0, bending_stiffness=0.0)
    offsets = torch.cat((scene.offsets, double([[0.02, 0.01 * (dimension - 2)]])))
    length = torch.cat((scene.length, double([0.5])))
    scene.assert_same_distances(replace(scene, offsets=offsets, length=length, models=(*scene.models, idle)))


@pytest.mark.parametrize("dimension", [2, 3])
def test_an_actuator_without_pressure_adds_what_it_holds_back(dimension):
    """A limit of 0 is an elastic core: one at the axis moves the required force by its own."""
    nothing, shape = torch.zeros(1, 2, dtype=torch.float64), torch.zeros(len(LOADS[dimension]), dtype=torch.float64)
    across = {"radii": nothing[:, 0]} if dimension == 2 else {"offsets": nothing}
    core = ta.ArmDesign(**across, length=0.38, actuators=ta.Bellows(), max_pressure=[0.0])
    twists = torch.stack([shape] * 5)
    twists[:, 0], twists[:, -1] = 0.4, torch.linspace(-0.5, 0.5, 5, dtype=torch.float64)
    found = ta.evaluate(core, ta.Task(twists, shape), "absolute")
    strain = torch.tensor((0.4 - 0.38) / 0.38, dtype=torch.float64)
    alone = float(ta.Bellows().force(strain, torch.zeros((), dtype=torch.float64)))
    assert found.absolute_per_node.numpy() == pytest.approx(abs(alone), abs=1e-12)


@pytest.mark.parametrize("dimension", [2, 3])
def test_more_pressure_never_makes_a_distance_grow(dimension):
    smaller = 0
    for seed in SEEDS:
        scene, found = random_scene(dimension, seed), []
        linear = tuple(
            ta.PolynomialActuator(((0, 1, 1.0 + index), (1, 0, -30.0)), (-1.0, 1.0), (0.0, 99.0), 30.0)
            for index in range(len(scene.models))
        )
        arm = replace(scene, models=linear).arm
        for share in (0.1, 0.1 + np.random.default_rng(seed).random()):
            limited = arm.with_values(arm.radii, arm.length, share * arm.max_pressure)
            evaluated = ta.evaluate(limited, scene.task, ("absolute", "relative"))
            found.append(torch.stack([getattr(evaluated, name) for name in METRICS]))
        assert (found[1] - found[0]).max() <= 1e-10
        smaller += int((found[1] < found[0] - 1e-3).any())
    assert smaller >= 6
