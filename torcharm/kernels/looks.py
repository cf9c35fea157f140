"""Single looks at many arms: costs with their models, and what gives way."""

import numpy as np

from torcharm._arrays import Array
from torcharm.engine.compilation import jit
from torcharm.kernels.arms import Arms
from torcharm.kernels.copies import put_all
from torcharm.kernels.goal import Goal, cost_of, model
from torcharm.kernels.march import BY_FILLING, NONE, follow_rod, look, moves, new_march, solve


@jit
def costs(arms: Arms, goal: Goal, rows: Array, unknowns: Array, out: Array) -> None:
    """(B,) of shapes (B, 2, N) of arms `rows` (B,)."""
    march = new_march(arms, unknowns.shape[2])
    for at in range(unknowns.shape[0]):
        row = rows[at]
        follow_rod(arms.base[row], unknowns[at], march)
        out[at] = cost_of(goal, row, march.pose)


@jit
def models(arms: Arms, goal: Goal, rows: Array, shapes: Array, places: Array, unknowns: Array, out: Array) -> None:
    """`CᵀC` (B, 1 + M, 1 + M) of `_descent.Goal.model` at places (B, M), of arms `rows` and shapes (B,)."""
    size, nodes = places.shape[1], unknowns.shape[2]
    march = new_march(arms, nodes)
    columns, products, acting = np.empty((1 + size, 3, nodes)), np.empty((1 + size, 1 + size)), np.empty(size)
    for at in range(places.shape[0]):
        row, z = rows[at], unknowns[shapes[at]]
        for m in range(size):
            acting[m] = places[at, m] * arms.limits[row, m]
        look(arms, row, z, acting, 1.0, True, march)
        solve(arms, row, z, acting, 1.0, NONE, True, True, 0.0, 0.0, march)
        model(goal, row, march, 2, columns, products)
        put_all(out[at], products)


@jit
def gains(arms: Arms, rows: Array, measure: Array, places: Array, unknowns: Array, shares: Array, out: Array) -> None:
    """(B, M) changes by the places (B, M) of what is measured, (B, 2, N), under shares (B,) of the load."""
    size, nodes = places.shape[1], unknowns.shape[2]
    march, acting = new_march(arms, nodes), np.empty(size)
    for at in range(places.shape[0]):
        row = rows[at]
        for m in range(size):
            acting[m] = places[at, m] * arms.limits[row, m]
        look(arms, row, unknowns[at], acting, shares[at], True, march)
        solve(arms, row, unknowns[at], acting, shares[at], NONE, True, False, 0.0, 0.0, march)
        for m in range(size):
            total = 0.0
            for c in range(2):
                for i in range(nodes):
                    total += march.change[2 + m, c, i] * measure[at, c, i]
            out[at, m] = total


@jit
def relax(arms: Arms, rows: Array, places: Array, steps: int, unknowns: Array, sizes: Array) -> None:
    """Newton steps to unloaded arms (B, 2, 1) at places (B, M), of arms `rows`; takes the sizes (B,) of the last."""
    march, acting = new_march(arms, unknowns.shape[2]), np.empty(places.shape[1])
    for at in range(places.shape[0]):
        row, z = rows[at], unknowns[at]
        for m in range(places.shape[1]):
            acting[m] = places[at, m] * arms.limits[row, m]
        for _ in range(steps):
            look(arms, row, z, acting, 0.0, True, march)
            solve(arms, row, z, acting, 0.0, BY_FILLING, False, False, 0.0, 0.0, march)
            sizes[at] = moves(arms, row, march.change[1], march.turned[1])
            for c in range(2):
                for i in range(z.shape[1]):
                    z[c, i] += march.change[1, c, i]
