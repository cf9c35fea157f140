"""Normalised pressures to start from, the same at every call."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch.quasirandom import SobolEngine


def spread_points(count: int, size: int, seed: int = 0) -> NDArray[np.float64]:
    """(count, size) points of the unit box, spread evenly: scrambled Sobol points behind the middle."""
    if count <= 1:
        return np.full((count, size), 0.5)
    drawn = SobolEngine(size, scramble=True, seed=seed).draw(count - 1, dtype=torch.float64)
    return np.concatenate((np.full((1, size), 0.5), drawn.numpy()))
