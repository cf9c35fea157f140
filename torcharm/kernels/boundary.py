"""The boundary of what continuation reaches: `_boundary.find_boundary`, one point after the other."""

import math

import numpy as np

from torcharm import _boundary
from torcharm._arrays import Array
from torcharm.engine.compilation import jit
from torcharm.kernels.arms import Arms
from torcharm.kernels.copies import put, put_all
from torcharm.kernels.march import BY_LOAD, look, new_march, solve

_ASIDE, _LARGEST, _DONE = _boundary.ASIDE, _boundary.LARGEST, _boundary.DONE


@jit
def find_boundary(
    arms: Arms,
    rows: Array,
    measure: Array,
    direction: Array,
    steps: int,
    first_row: int,
    last_row: int,
    unknowns: Array,
    places: Array,
    shares: Array,
    shifts: Array,
    gains: Array,
    sizes: Array,
) -> None:
    """Newton's method on the saddle, of some of B points: see `_boundary._advance`.

    Args:
        arms: of `rows` (B,).
        measure, direction: (B, 2, N), (B, M) as of `_boundary.find_boundary`.
        steps: looks at most.
        first_row, last_row: which, without the last.
        unknowns, places, shares: (B, 2, N), (B, M), (B,) where to start, and take where it ends.
        shifts, gains: (B, M, 2, N), (B, M) take the changes of z and of x by the place.
        sizes: (B,) take the size of the last Newton step.
    """
    size, nodes = places.shape[1], unknowns.shape[2]
    march = new_march(arms, nodes)
    z, place, share, acting = np.empty((3, 2, nodes)), np.empty((3, size)), np.empty(3), np.empty(size)
    slope_x, slope_s, by_way = np.empty(3), np.empty(3), np.empty((2, nodes))
    along_x, along_s = np.empty((2, nodes)), np.empty((2, nodes))
    for at in range(first_row, last_row):
        row = rows[at]
        lines, way, aside = measure[at], direction[at], _ASIDE / arms.measure[row, 1]
        for j in range(3):
            put_all(z[j], unknowns[at])
            put(place[j], places[at])
            share[j] = shares[at]
        sizes[at], beside = math.inf, False
        for _ in range(steps):
            for j in range(2, -1, -1):  # the first at last: what follows is of it
                for m in range(size):
                    acting[m] = place[j, m] * arms.limits[row, m]
                look(arms, row, z[j], acting, share[j], True, march)
                solve(arms, row, z[j], acting, share[j], BY_LOAD, True, False, 0.0, 0.0, march)
                gain, fall, miss = 0.0, 0.0, 0.0
                for c in range(2):
                    for i in range(nodes):
                        total = 0.0
                        for m in range(size):
                            total += march.change[3 + m, c, i] * way[m]
                        by_way[c, i] = total
                        gain += lines[c, i] * total
                        fall += lines[c, i] * march.change[2, c, i]
                        miss += lines[c, i] * march.change[1, c, i]
                slope_x[j], slope_s[j], back = 1.0 / gain, -fall / gain, -miss / gain
                for c in range(2):
                    for i in range(nodes):
                        z[j, c, i] += march.change[1, c, i] + by_way[c, i] * back
                for m in range(size):
                    place[j, m] += way[m] * back
            x0, s0 = slope_x[0], slope_s[0]
            xx, sx = (slope_x[1] - x0) / aside, (slope_s[1] - s0) / aside
            xs, ss = (slope_x[2] - x0) / _ASIDE, (slope_s[2] - s0) / _ASIDE
            determinant = xx * ss - xs * sx
            move_x, move_s = (xs * s0 - ss * x0) / determinant, (sx * x0 - xx * s0) / determinant
            length = max(abs(move_x) * (_ASIDE / aside), abs(move_s))
            if math.isnan(move_x + move_s):
                length = math.nan
            short = min(_LARGEST / length, 1.0) if beside else 0.0
            move_x, move_s = (move_x * short, move_s * short) if beside else (0.0, 0.0)
            # Along the equilibria, and beside
            for c in range(2):
                for i in range(nodes):
                    along_x[c, i] = by_way[c, i] * x0
                    along_s[c, i] = march.change[2, c, i] + by_way[c, i] * s0
                    base = z[0, c, i] + along_x[c, i] * move_x + along_s[c, i] * move_s
                    z[0, c, i], z[1, c, i] = base, base + along_x[c, i] * aside
                    z[2, c, i] = base + along_s[c, i] * _ASIDE
                    for m in range(size):
                        shifts[at, m, c, i] = march.change[3 + m, c, i]
            for m in range(size):
                here, total = place[0, m] + way[m] * (x0 * move_x + s0 * move_s), 0.0
                place[0, m], place[1, m], place[2, m] = here, here + way[m] * x0 * aside, here + way[m] * s0 * _ASIDE
                for c in range(2):
                    for i in range(nodes):
                        total += lines[c, i] * march.change[3 + m, c, i]
                gains[at, m] = total
            share[0] += move_s
            share[1], share[2] = share[0], share[0] + _ASIDE
            if beside:
                sizes[at] = length
                if not length > _DONE:
                    break
            beside = True
        put_all(unknowns[at], z[0])
        put(places[at], place[0])
        shares[at] = share[0]
