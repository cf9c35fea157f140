"""Arms that are let go: `_continuation.settle`, one after the other."""

import math

from torcharm._arrays import Array
from torcharm.engine.compilation import inlined, jit
from torcharm.kernels.arms import Arms
from torcharm.kernels.march import NONE, March, imbalance, look, moves, new_march, solve


@jit
def settle(
    arms: Arms,
    rows: Array,
    damping: float,
    steps: int,
    first_row: int,
    last_row: int,
    unknowns: Array,
    arrived: Array,
) -> None:
    """Follow some of B arms to rest.

    Args:
        arms: of `rows` (B,), at the limits of pressure.
        damping, steps: as of `_continuation.settle`.
        first_row, last_row: which, without the last.
        unknowns: (B, 2, N) where they are let go, and takes where they end.
        arrived: (B,) takes whether they came to rest.
    """
    nodes = unknowns.shape[2]
    march = new_march(arms, nodes)
    for at in range(first_row, last_row):
        row = rows[at]
        z, amount, last = unknowns[at], 2.5 * damping, math.inf
        arrived[at] = False
        for _ in range(steps):
            force, moment = look(arms, row, z, arms.limits[row], 1.0, False, march)
            miss = imbalance(arms, row, force, moment)
            if miss <= arms.tolerance:
                arrived[at] = True
                break
            if not math.isfinite(miss):
                break
            # A step that led uphill was too long; those that lead down become Newton's
            amount = min(max(amount * 4 if miss > 1.5 * last else amount * 0.4, 1e-12), 1e6)
            length, curvature = _mobility(arms, row, march)
            solve(arms, row, z, arms.limits[row], 1.0, NONE, False, False, amount * length, amount * curvature, march)
            size = moves(arms, row, march.change[1], march.turned[1])
            if not math.isfinite(size):
                break
            short = min(0.5 / max(size, 1e-12), 1.0)
            if size > 0.5:
                amount *= 2
            for c in range(2):
                for i in range(nodes):
                    z[c, i] += short * march.change[1, c, i]
            last = miss


@inlined
def _mobility(arms: Arms, at: int, march: March) -> tuple[float, float]:
    """A stiffness to measure damping by, the largest of the sections' own in each component."""
    rod, nodes = march.rod, march.rod.shape[0]
    force_x, force_y = arms.load[at, 0], arms.load[at, 1]
    length, curvature = 1e-9, 1e-9
    for i in range(nodes):
        behind_x, behind_y = march.pose[0, nodes - 1] - march.pose[0, i], march.pose[1, nodes - 1] - march.pose[1, i]
        own = rod[i, 8] * force_y - rod[i, 9] * force_x - (behind_y * force_y + behind_x * force_x) / nodes
        length = max(length, abs(march.stiffness[i, 0]))
        curvature = max(curvature, abs(march.stiffness[i, 3] + own))
    return length, curvature
