"""Single looks at many arms: costs with their models, and what gives way."""

import numpy as np

from torcharm._arrays import Array
from torcharm._compiled import jit
from torcharm.kernels.arms import Arms
from torcharm.kernels.goal import Goal, cost_of, model
from torcharm.kernels.march import BY_FILLING, NONE, follow_rod, look, moves, new_march, solve


@jit
def costs(arms: Arms, goal: Goal, unknowns: Array, out: Array) -> None:
    """Of B shapes (B, 2, N)."""
    march = new_march(arms, unknowns.shape[2])
    for at in range(unknowns.shape[0]):
        follow_rod(arms.base[at], unknowns[at], march)
        out[at] = cost_of(goal, at, march.pose)


@jit
def models(arms: Arms, goal: Goal, rows: Array, places: Array, unknowns: Array, out: Array) -> None:
    """`CᵀC` (1 + M, 1 + M, B) of `_descent.Goal.model` at B places (B, M), of arms and shapes `rows` (B,)."""
    size, nodes = places.shape[1], unknowns.shape[2]
    march = new_march(arms, nodes)
    columns, products, acting = np.empty((1 + size, 3, nodes)), np.empty((1 + size, 1 + size)), np.empty(size)
    for b in range(places.shape[0]):
        at = rows[b]
        for m in range(size):
            acting[m] = places[b, m] * arms.limits[at, m]
        look(arms, at, unknowns[at], acting, 1.0, True, march)
        solve(arms, at, unknowns[at], acting, 1.0, NONE, True, True, 0.0, 0.0, march)
        model(goal, at, march, 2, columns, products)
        out[:, :, b] = products


@jit
def gains(arms: Arms, measure: Array, places: Array, unknowns: Array, shares: Array, out: Array) -> None:
    """(B, M) changes by the places (B, M) of what is measured, (B, 2, N), under shares of the load (B,)."""
    size, nodes = places.shape[1], unknowns.shape[2]
    march, acting = new_march(arms, nodes), np.empty(size)
    for at in range(places.shape[0]):
        for m in range(size):
            acting[m] = places[at, m] * arms.limits[at, m]
        look(arms, at, unknowns[at], acting, shares[at], True, march)
        solve(arms, at, unknowns[at], acting, shares[at], NONE, True, False, 0.0, 0.0, march)
        for m in range(size):
            total = 0.0
            for c in range(2):
                for i in range(nodes):
                    total += march.change[2 + m, c, i] * measure[at, c, i]
            out[at, m] = total


@jit
def relax(arms: Arms, pressure: Array, steps: int, unknowns: Array, sizes: Array) -> None:
    """Newton steps to unloaded arms (B, 2, 1) at pressures (B, M); takes the sizes (B,) of the last."""
    march = new_march(arms, unknowns.shape[2])
    for at in range(pressure.shape[0]):
        z = unknowns[at]
        for _ in range(steps):
            look(arms, at, z, pressure[at], 0.0, True, march)
            solve(arms, at, z, pressure[at], 0.0, BY_FILLING, False, False, 0.0, 0.0, march)
            sizes[at] = moves(arms, at, march.change[1], march.turned[1])
            for c in range(2):
                for i in range(z.shape[1]):
                    z[c, i] += march.change[1, c, i]
