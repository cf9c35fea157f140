"""What is known of searches before they begin."""

import numpy as np

from torcharm.engine.continuation import FAILED
from torcharm.engine.searches import Searches
from torcharm.pressure.prepared import Prepared


def nothing_found(prepared: Prepared, starts: int) -> Searches:
    """Searches of which nothing is known yet."""
    count, actuators = prepared.engine.limit.shape
    return Searches(
        np.zeros((count, actuators)),
        prepared.start.copy(),
        np.full(count, np.inf),
        np.full(count, FAILED),
        np.zeros(count, dtype=np.bool_),
        np.full(count, np.nan),
        np.full((count, starts), np.inf),
    )
