"""What is known of searches before they begin."""

import numpy as np

from torcharm.engine.arms import sizes_of
from torcharm.engine.arrays import make
from torcharm.engine.continuation import FAILED
from torcharm.engine.searches import Searches
from torcharm.pressure.prepared import Prepared


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
