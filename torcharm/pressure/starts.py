"""Normalised pressures to start from, the same at every call, and what is known of searches before they begin."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch.quasirandom import SobolEngine

from torcharm.engine.arms import sizes_of
from torcharm.engine.arrays import make
from torcharm.engine.continuation import FAILED
from torcharm.engine.searches import Searches
from torcharm.pressure.prepared import Prepared


def spread_points(count: int, size: int, seed: int = 0) -> NDArray[np.float64]:
    """(count, size) points of the unit box, spread evenly: scrambled Sobol points behind the middle."""
    if count <= 1:
        return np.full((count, size), 0.5)
    drawn = SobolEngine(size, scramble=True, seed=seed).draw(count - 1, dtype=torch.float64)
    return np.concatenate((np.full((1, size), 0.5), drawn.numpy()))


def nothing_found(prepared: Prepared, starts: int) -> Searches:
    """Searches of which nothing is known yet."""
    count = len(prepared.engine.limit)
    return make(
        Searches,
        sizes_of(prepared.engine.arms, B=count),
        twists=prepared.start.copy(),
        half_cost=np.full(count, np.inf),
        how=np.full(count, FAILED),
        optimality=np.full(count, np.nan),
        start_cost=np.full((count, starts), np.inf),
    )
