"""From curves that are written out to few points each, whose hulls are near the curves' own."""

import numpy as np

from torcharm._arrays import Array
from torcharm.distance.arcs import Arcs
from torcharm.distance.shapes import at_index, first_highest
from torcharm.distance.touch import CurveSums


@np.errstate(all="ignore")
def rings(sums: CurveSums) -> tuple[Array, Array, Array]:
    """Of each curve's hull both ends and the one or two points between that stand out most, in their order round it.

    Returns:
        Fractions and forces (S, M, Q), actuators in the groups' order, and whether (M, Q) they go round
        counter-clockwise in the plane of pressure and force, 1, or clockwise, -1.
    """
    groups = [group for group, _ in sums.groups]
    points = [_standing_out(group) for group in groups]
    rows = max(len(u) for u, _ in points)
    u, off = (
        _joined([np.concatenate((value, *[value[:1]] * (rows - len(value)))) for value in values], 1)
        for values in zip(*points, strict=True)
    )
    first, last = (_joined([group.force[end] for group in groups], 0) for end in (0, -1))
    grid, off, turn = _ring(u, off, 3 if max(group.corners for group in groups) < 2 else 4)
    return grid, first + (last - first) * grid + off, turn


def _joined(parts: list[Array], axis: int) -> Array:
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis)


def _ring(u: Array, off: Array, count: int) -> tuple[Array, Array, Array]:
    """Rings (count, M, Q) of ends and points (C, M, Q): fractions, how far above the chords; and their turns."""
    best = first_highest(np.abs(off))
    one, one_off = at_index(u, best), at_index(off, best)
    above = one_off > 0
    turn = np.where(above, -1.0, 1.0).astype(u.dtype)
    zero, unit = np.zeros_like(one), np.ones_like(one)
    if count == 3:
        return np.stack((zero, one, unit)), np.stack((zero, one_off, zero)), turn
    # What stands out from the triangle of the three, on its side or on the other.
    behind = turn * off
    depth = turn * one_off
    beyond, other = u * (depth / one), 1 - u
    other *= depth / (1 - one)
    np.maximum(beyond, other, out=beyond)  # the depth is negative
    beyond -= behind
    best = first_highest(np.maximum(beyond, behind))
    two, two_off = at_index(u, best), at_index(off, best)
    across = at_index(behind, best)
    more = (across > 0) | (at_index(beyond, best) > 0)
    two, two_off = np.where(more, two, one), np.where(more, two_off, one_off)
    opposite = more & (across > 0)
    swap = np.where(opposite, above, one > two)
    low, high = np.where(swap, two, one), np.where(swap, one, two)
    low_off, high_off = np.where(swap, two_off, one_off), np.where(swap, one_off, two_off)
    grid = np.stack((zero, low, np.where(opposite, unit, high), np.where(opposite, high, unit)))
    offs = np.stack((zero, low_off, np.where(opposite, zero, high_off), np.where(opposite, high_off, zero)))
    return grid, offs, np.where(opposite, unit, turn)


def _standing_out(curves: Arcs) -> tuple[Array, Array]:
    """Points (C, m, Q) inside the curves' hulls: fractions, and how far above the chords of the curves' ends."""
    first, rise = curves.force[0], curves.force[-1] - curves.force[0]
    u = off = None
    if curves.shape is not None:
        u, off = curves.shape.between()
        if curves.twins is not None:
            off = off + curves.twins.between()
        if curves.span is not None:
            off = np.where(curves.span[1][0] < 1, 0.0, off)  # not with kinks
    if curves.grid is None:
        return (np.full_like(first, 0.5)[None], np.zeros_like(first)[None]) if u is None or off is None else (u, off)
    corner = curves.grid[1:-1]
    away = curves.force[1:-1] - first - rise * corner
    if u is None or off is None:
        return corner, away
    return np.concatenate((u, corner)), np.concatenate((off, away))
