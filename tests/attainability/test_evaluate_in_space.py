"""Evaluation in space: batches, weights, margins, dtypes and shapes that are impossible."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from hull_cases import double, unchecked

import torcharm as ta

MODELS = {
    "bellows": ta.Bellows(),
    "muscle": ta.McKibben(),
    "wave": ta.PolynomialActuator(
        ((0, 1, 6.0), (0, 2, -0.5), (0, 3, 0.008), (1, 1, -3.0)), (-0.5, 0.5), (0.0, 40.0), 40.0
    ),
}
PROMISED, PROMISED_INSIDE = 1e-9, 1e-7
"""Distances are known to 1e-12 and margins to 1e-10 of their largest wrench, of these arms up to 1000 N."""
SEEDS = range(12)
PER_NODE = ("absolute_per_node", "relative_per_node")
FIELDS = (*PER_NODE, "absolute", "relative", "strain_excess", "in_range")


@dataclass
class Scene:
    """Designs, shapes and loads of any batch shape."""

    offsets: torch.Tensor
    lengths: torch.Tensor
    models: tuple
    twists: torch.Tensor
    load: torch.Tensor
    base_pose: torch.Tensor

    @property
    def arm(self):
        return ta.ArmDesign(offsets=self.offsets, length=self.lengths, actuators=self.models)

    @property
    def task(self):
        return ta.Task(self.twists, self.load, self.base_pose)

    def distances(self, **options):
        found = ta.evaluate(self.arm, self.task, ("absolute", "relative"), **options)
        assert found.converged.all()
        return torch.stack([getattr(found, name) for name in PER_NODE])


HANGING = double([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


def random_scene(seed, designs=(), shapes=(), loads=(), nodes=3, kinds=("bellows", "muscle", "wave")):
    rng = np.random.default_rng(seed)
    count = 3 + seed % 3
    names = [str(rng.choice(kinds)) for _ in range(count)]
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False) + rng.uniform(0, 0.5, (*designs, count))
    radius = rng.uniform(0.02, 0.05, (*designs, count))
    low, high = [0.47, -0.02, -0.02, -0.2, -0.9, -0.9], [0.53, 0.02, 0.02, 0.2, 0.9, 0.9]
    return Scene(
        double(np.stack((radius * np.cos(angle), radius * np.sin(angle)), -1)),
        double(rng.uniform(0.48, 0.54, (*designs, count))),
        tuple(MODELS[name] for name in names),
        double(rng.uniform(low, high, (*shapes, nodes, 6))),
        double(rng.uniform(-1, 1, (*loads, 6)) * [15.0, 15.0, 15.0, 2.0, 2.0, 2.0]),
        HANGING,
    )


BATCHES = {
    "pairs": ((2,), (3,), (3,)),
    "shapes by loads": ((2,), (3, 1), (4,)),
    "loads by shapes": ((2, 2), (3,), (2, 1)),
    "loads on one shape": ((), (), (4,)),
    "shapes under one load": ((3,), (4,), ()),
}


@pytest.mark.parametrize("batch", BATCHES)
@pytest.mark.parametrize(("signed", "atol"), [(False, PROMISED), (True, PROMISED_INSIDE)])
@unchecked()
def test_batched_equals_looped_and_chunks_do_not_matter(batch, signed, atol):
    designs, shapes, loads = BATCHES[batch]
    scene, tasks = random_scene(4, designs, shapes, loads), np.broadcast_shapes(shapes, loads)
    whole = ta.evaluate(scene.arm, scene.task, ("absolute", "relative"), signed=signed)
    parts = ta.evaluate(scene.arm, scene.task, ("absolute", "relative"), signed=signed, chunk_size=5)
    twists, load = scene.twists.expand(*tasks, 3, 6), scene.load.expand(*tasks, 6)
    for name in FIELDS:
        found = getattr(whole, name)
        assert found.shape == (*designs, *tasks, *((3,) if "node" in name else ()))
        torch.testing.assert_close(getattr(parts, name), found, rtol=0, atol=atol)
    for design in np.ndindex(designs):
        for task in np.ndindex(tasks):
            arm = scene.arm[design] if design else scene.arm
            single = ta.evaluate(
                arm, ta.Task(twists[task], load[task], HANGING), ("absolute", "relative"), signed=signed
            )
            for name in FIELDS:
                own = getattr(whole, name)[(*design, *task)]
                torch.testing.assert_close(own, getattr(single, name), rtol=0, atol=atol)


@pytest.mark.parametrize(("designs", "shapes", "loads"), [((0,), (), (4,)), ((2,), (0,), ()), ((2,), (3, 1), (0,))])
def test_empty_batches_give_empty_results(designs, shapes, loads):
    scene = random_scene(0, designs, shapes, loads)
    found, batch = (
        ta.evaluate(scene.arm, scene.task, ("absolute", "relative")),
        (*designs, *np.broadcast_shapes(shapes, loads)),
    )
    assert found.absolute.shape == found.in_range.shape == batch
    assert found.relative_per_node.shape == (*batch, 3)


@pytest.mark.parametrize("seed", SEEDS)
@unchecked()
def test_weights_and_powers(seed):
    scene = random_scene(seed, loads=(4,))
    plain = scene.distances()
    torch.testing.assert_close(scene.distances(weights=(2.3, 2.3)), plain * 2.3**0.5, rtol=0, atol=2 * PROMISED)
    heavier = scene.distances(weights=(1.0, 4.0))
    assert bool(((plain - PROMISED <= heavier) & (heavier <= 2 * plain + PROMISED)).all())
    squares = ta.evaluate(scene.arm, scene.task, ("absolute", "relative"), power=2)
    torch.testing.assert_close(squares.absolute, plain[0].square().sum(-1))
    torch.testing.assert_close(squares.relative, plain[1].square().sum(-1))


def test_signed_is_negative_if_and_only_if_every_node_is_inside():
    # A ring of four bellows held where half their pressure holds it.
    arm = ta.ArmDesign(offsets=ta.ring(radius=0.04, count=4), length=0.5, actuators=ta.Bellows())
    twists = double([[0.55, 0, 0, 0, 0.1, 0.2], [0.55, 0, 0, 0, 0.1, 0.2]])
    middle = ta.reaction_wrench(arm, twists, arm.max_pressure / 2)[0]
    tip = torch.cat((middle[..., :1], double([0, 0, 0]), middle[..., 1:]), -1)
    body = ta.ExternalLoad(points=[ta.PointLoad(-tip, at=1.0, frame="body")])
    calm = ta.evaluate(arm, ta.Task(twists, load=body), ("absolute", "relative"), signed=True)
    assert calm.absolute_per_node.shape == (2,)
    shares = torch.linspace(0, 40, 81, dtype=torch.float64)[:, None]
    points = [ta.PointLoad(-tip + shares * double([1, 0.2, 0, 0, 0.05, 0]), at=1.0, frame="body")]
    found = ta.evaluate(
        arm, ta.Task(twists, load=ta.ExternalLoad(points=points)), ("absolute", "relative"), signed=True
    )
    for metric in ("absolute", "relative"):
        total, per_node = getattr(found, metric), getattr(found, metric + "_per_node")
        free = per_node if metric == "absolute" else per_node[..., 1:]
        inside = (free < 0).all(-1)
        assert torch.equal(total < 0, inside)
        torch.testing.assert_close(total[inside], free[inside].amax(-1))
        torch.testing.assert_close(total[~inside], per_node[~inside].clamp(min=0).sum(-1))
    assert 0 < int((found.absolute < 0).sum()) < 81


def test_float32_stays_float32_and_near_float64():
    scene = random_scene(5, (3,), (4, 1), (5,))
    exact = ta.evaluate(scene.arm, scene.task, ("absolute", "relative"))
    single = ta.evaluate(scene.arm.to(torch.float32), scene.task.to(torch.float32), ("absolute", "relative"))
    for name in FIELDS[:-1]:
        assert getattr(single, name).dtype == torch.float32
        assert (getattr(single, name).double() - getattr(exact, name)).abs().max() < 2e-3
    assert torch.equal(single.in_range, exact.in_range)


def test_an_impossible_shape_says_so_and_leaves_the_others_alone():
    scene = random_scene(2, nodes=3)
    wild = scene.twists.clone()
    wild[1, 4:] = math.degrees(1.0)
    both = ta.evaluate(
        scene.arm, ta.Task(torch.stack((scene.twists, wild)), scene.load, HANGING), ("absolute", "relative")
    )
    assert both.impossible.tolist() == [False, True]
    assert both.converged.tolist() == [True, False]
    assert both.absolute[1] == both.relative[1] == math.inf
    assert not bool(both.in_range[1])
    alone = ta.evaluate(scene.arm, scene.task, ("absolute", "relative"))
    assert torch.equal(both.absolute[0], alone.absolute)
