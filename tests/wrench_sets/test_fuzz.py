"""Random scenes by the hundred thousand: a finite distance and gradient, or a flag."""

import pytest
import torch

import torcharm as ta

DESIGNS, TASKS, ACTUATORS, NODES = 500, 20, 4, 2
ROUNDS = 5
"""With designs, tasks and two metrics: 100,000 distances of arms in each dimension."""


def scattered(*shape, generator):
    """Numbers of all sizes from 1e-4 to 1, of both signs, some of them 0."""
    size = 10.0 ** (-4 * torch.rand(*shape, generator=generator, dtype=torch.float64))
    sign = torch.randint(-1, 2, shape, generator=generator)
    return size * sign


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("signed", [False, True])
def test_a_finite_number_and_gradient_or_a_flag(dimension, signed):
    flagged, total = count_flagged(dimension, signed, ROUNDS)
    assert total > 0.2 * ROUNDS * (DESIGNS // 10 if signed else DESIGNS) * TASKS
    assert flagged <= (0.2 if signed and dimension == 3 else 1e-3) * total


def count_flagged(dimension, signed, rounds):
    """How many possible scenes are flagged, and how many there are; asserts that all numbers are what they may be."""
    generator, flagged, total = torch.Generator().manual_seed(dimension), 0, 0
    designs = DESIGNS // 10 if signed else DESIGNS
    for k in range(rounds):
        columns = 3 if dimension == 2 else 6
        offsets = 0.2 * scattered(designs, ACTUATORS, 2, generator=generator)
        length = 0.1 + torch.rand(designs, ACTUATORS, generator=generator, dtype=torch.float64)
        limit = 120 * scattered(designs, ACTUATORS, generator=generator).abs()
        twists = 10 * scattered(TASKS, NODES, columns, generator=generator)
        twists[..., 0] = twists[..., 0].abs() / 5 + 0.05
        tip = 100 * scattered(TASKS, columns, generator=generator)
        leaves = [offsets, length, limit, twists, tip]
        for leaf in leaves:
            leaf.requires_grad_()
        across = {"radii": offsets[..., 0]} if dimension == 2 else {"offsets": offsets}
        kinds = [ta.Bellows(), ta.McKibben(), ta.McKibben(), ta.Bellows()][k % 2 :][:ACTUATORS]
        kinds += [ta.McKibben(force_scale=2.0)] * (ACTUATORS - len(kinds))
        arm = ta.ArmDesign(**across, length=length, actuators=kinds, max_pressure=limit, mass=0.2)
        found = ta.evaluate(
            arm, ta.Task(twists, load=ta.ExternalLoad(tip, gravity=True)), ("absolute", "relative"), signed=signed
        )
        for name in ("absolute", "relative"):
            value = getattr(found, name)
            assert not value.isnan().any()
            assert (value.isfinite() | found.impossible | ~found.distances_converged).all()
            assert (value[found.impossible] == torch.inf).all()
            assert signed or (value >= 0).all()
            kept = torch.where(found.distances_converged, value, 0.0)
            gradients = torch.autograd.grad(kept.sum(), leaves, retain_graph=True)
            for gradient in gradients:
                assert gradient.isfinite().all()
        possible = ~found.impossible
        flagged += int((~found.distances_converged & possible).sum())
        total += int(possible.sum())
    return flagged, total
