"""Forces in the engine against those of torch."""

import math

import numpy as np
import torch

import torcharm as ta
from torcharm.actuators import force_slopes
from torcharm.engine.compilation import kernel
from torcharm.engine.forces import muscle


@kernel
def compiled(x, p):
    return muscle(x, p, math.log(max(p, 1e-30)))


def test_a_muscle_at_every_branch():
    strain = torch.tensor(
        [-0.6, -0.4, -0.303225592, -0.29, -0.274484489, -0.2, -0.1, -1e-3, 0.0, 1e-3, 0.05, 0.2]
    ).double()
    pressure = torch.tensor([0.0, 1e-31, 1e-3, 1.0, 20.0, 49.0, 100.0]).double()
    grid = torch.cartesian_prod(strain, pressure)
    model = ta.McKibben()
    force, slope, rate = force_slopes(model, grid[:, 0], grid[:, 1])
    for (x, p), *wanted in zip(grid.tolist(), force, slope, rate, strict=True):
        found = compiled(x, p)
        np.testing.assert_allclose(
            [-value for value in found], [float(value) for value in wanted], rtol=1e-12, atol=1e-12
        )
