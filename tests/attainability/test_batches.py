"""Batches of designs, shapes and loads: what is found is that of each alone, in whatever order, strides and chunks."""

import math

import numpy as np
import pytest
import torch
from hull_cases import double, unchecked

import torcharm as ta

METRICS = ("absolute", "relative")
MODELS = (ta.Bellows(), ta.McKibben(), ta.Bellows())


def random_arms(*batch, grad=False):
    rng = np.random.default_rng(1)
    radii, lengths = rng.uniform(-0.06, 0.06, (*batch, 3)), rng.uniform(0.48, 0.55, (*batch, 3))
    limits = rng.uniform(0.5, 1.0, (*batch, 3)) * [50.0, 100.0, 50.0]
    tensors = [double(value, grad=grad) for value in (radii, lengths, limits)]
    return ta.ArmDesign(tensors[0], tensors[1], MODELS, tensors[2]), tensors


def random_twists(*batch):
    return double(np.random.default_rng(2).uniform([0.46, -0.02, -1.0], [0.52, 0.02, 1.0], (*batch, 4, 3)))


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
                    one, ta.Task(twists[task], loads[task][None]), METRICS, **options
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
    result = ta.evaluate(arm, ta.Task(twists, loads), METRICS, signed=True)
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
    result = ta.evaluate(arm, ta.Task(random_twists(), random_loads()), METRICS)
    for field in ("absolute", "relative", "strain_excess", "in_range"):
        assert getattr(result, field).shape == ()
    assert result.absolute_per_node.shape == (4,)


@every_batch
@pytest.mark.parametrize("chunk_size", [1, 7])
@unchecked()
def test_results_do_not_depend_on_the_chunk_size(designs, twists, loads, batch, chunk_size):
    arm, _ = random_arms(*designs)
    whole = ta.evaluate(arm, ta.Task(twists, loads), METRICS, signed=True)
    parts = ta.evaluate(arm, ta.Task(twists, loads), METRICS, signed=True, chunk_size=chunk_size)
    for field in FIELDS:
        assert_same(getattr(parts, field), getattr(whole, field))


@every_batch
@pytest.mark.parametrize(("kind", "chunk_size"), [("exact", None), ("exact", 3), ("edges", None)])
@unchecked()
def test_asking_for_gradients_leaves_the_values(designs, twists, loads, batch, kind, chunk_size):
    arm, _ = random_arms(*designs)
    tracked, _ = random_arms(*designs, grad=True)
    signed = kind == "exact"
    plain = ta.evaluate(arm, ta.Task(twists, loads), METRICS, hull=kind, signed=signed)
    result = ta.evaluate(tracked, ta.Task(twists, loads), METRICS, hull=kind, signed=signed, chunk_size=chunk_size)
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
        result = ta.evaluate(arm, ta.Task(shape, load), METRICS, chunk_size=chunk_size)
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
    found = ta.evaluate(arm, ta.Task(random_twists(*shapes), random_loads(*loads)), METRICS)
    for field in FIELDS:
        assert getattr(found, field).shape == ((*result, 4) if "node" in field else result)
    assert found.in_range.dtype == torch.bool
    assert found.absolute.dtype == torch.float64
