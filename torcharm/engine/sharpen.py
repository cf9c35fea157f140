"""Newton's method on the equations of the nearest point, from where the bounds of a distance have met.

Bounds that have met to a gap know the normal to its square root only: 1e-12 leaves 1e-6, and so much of a gradient.
At the nearest point x of a set, with points y_k that mix to it,

    w - Σ λ_k y_k = ρ n,    (y_k - y_0)·n = 0,    Σ λ_k = 1,    and y_k reaches furthest along n,

whether w is outside (ρ > 0) or inside (ρ < 0). As n turns by δ each y_k moves by H_k δ along its curves, so that

    (Σ λ_k H_k + ρ) δ + Σ δλ_k (y_k - y_0) = w - Σ λ_k y_k - ρ n,    (y_k - y_0)·δ = -(y_k - y_0)·n.
"""

import math
from functools import cache
from typing import Any

from torcharm.engine.compilation import part
from torcharm.engine.distance import add_turn
from torcharm.engine.reach import step_nearby

STEPS = 5
"""Newton steps at most: two are usual, for of nearly straight curves the points are known badly at first."""
SMALL = 1e-11
"""A turn after which the points stay: along nearly straight curves they move by 1e5 times as much."""
FAR = 0.1
"""A turn that is no last improvement of a normal from within, where nothing else bounds it."""
BEYOND = 32.0
"""A turn's square is not above so many times the gap as a part of the distance: twice by how bounds meet, and room."""
SAME = 1e-6
"""Pressures as near as this part of the limit, after they have gone to where their curves reach furthest, are one."""
SINGULAR = 1e-13
"""A pivot below this part of its column's size is none."""


@cache
def sharpen_part(D: int) -> Any:
    """`sharpen` for sums of curves in D components."""

    @part
    def follow(curves, simplex, k):  # type: ignore[no-untyped-def]
        """Let corner k's pressures go to where their curves reach furthest nearby; adds its H; whether any has one."""
        n, smooth = simplex.normal, False
        for c in range(D):
            simplex.corner[k, c] = -simplex.target[c]
        for a in range(len(simplex.fresh)):
            by_force, by_pressure = n[0] * curves.lever[a, 0], 0.0
            for c in range(1, D):
                by_force += n[c] * curves.lever[a, c]
                by_pressure += n[c] * curves.bending[a, c - 1]
            p, f, fall = step_nearby(curves, a, by_force, by_pressure, simplex.pressure[k, a])
            simplex.pressure[k, a] = p
            simplex.corner[k, 0] += f * curves.lever[a, 0]
            for c in range(1, D):
                simplex.corner[k, c] += f * curves.lever[a, c] + p * curves.bending[a, c - 1]
            if fall > 0.0:
                smooth = True
                add_turn(simplex.turn, curves, a, -by_pressure / by_force, simplex.weight[k] / fall)
        return smooth

    @part
    def are_one(curves, simplex, j, k):  # type: ignore[no-untyped-def]
        for a in range(len(simplex.fresh)):
            limit = curves.edge[a, curves.pieces[a]]
            if abs(simplex.pressure[j, a] - simplex.pressure[k, a]) > SAME * limit:
                return False
        return True

    @part
    def follow_all(curves, simplex):  # type: ignore[no-untyped-def]
        """Do so with all corners, and let those that have come to one point be one; whether any curve is smooth."""
        smooth = False
        for c in range(D):
            for e in range(D):
                simplex.turn[c, e] = 0.0
        for k in range(D):
            if simplex.weight[k] > 0.0:
                smooth = follow(curves, simplex, k) or smooth
                for j in range(k):
                    if simplex.weight[j] > 0.0 and are_one(curves, simplex, j, k):
                        simplex.weight[j] += simplex.weight[k]
                        simplex.weight[k] = 0.0
        return smooth

    @part
    def write_system(simplex, rows):  # type: ignore[no-untyped-def]
        """Write the equations of the turn and of the weights' changes, (rows, rows + 1); the first corner's is left."""
        s, n, y = simplex.system, simplex.normal, simplex.corner
        first = 0
        while not simplex.weight[first] > 0.0:
            first += 1
        ahead = 0.0
        for c in range(D):
            s[c, rows] = 0.0
            for k in range(D):
                s[c, rows] -= simplex.weight[k] * y[k, c]
            ahead += s[c, rows] * n[c]
        for c in range(D):
            s[c, rows] -= ahead * n[c]
            for e in range(D):
                s[c, e] = simplex.turn[c, e]
            s[c, c] += ahead
        row = D
        for k in range(first + 1, D):
            if simplex.weight[k] > 0.0:
                s[row, rows] = 0.0
                for c in range(D):
                    s[c, row] = s[row, c] = y[k, c] - y[first, c]
                    s[row, rows] -= s[row, c] * n[c]
                for e in range(D, rows):
                    s[row, e] = 0.0
                row += 1

    @part
    def solve(s, rows):  # type: ignore[no-untyped-def]
        """Solve the equations by elimination, the solution in the last column; whether they have one."""
        for c in range(rows):
            best, size = c, 0.0
            for r in range(rows):
                size = max(size, abs(s[r, c]))
                best = r if r > c and abs(s[r, c]) > abs(s[best, c]) else best
            if not abs(s[best, c]) > SINGULAR * size:
                return False
            for e in range(rows + 1):
                s[c, e], s[best, e] = s[best, e], s[c, e]
            for r in range(rows):
                if r != c:
                    factor = s[r, c] / s[c, c]
                    for e in range(c, rows + 1):
                        s[r, e] -= factor * s[c, e]
        for c in range(rows):
            s[c, rows] /= s[c, c]
        return True

    @part
    def take_step(simplex, rows, most):  # type: ignore[no-untyped-def]
        """Turn the normal and change the weights, unless that leads to another face or turns it by more than `most`.

        Returns the turn's square.
        """
        s, square, change = simplex.system, 0.0, 0.0
        for c in range(D):
            square += s[c, rows] * s[c, rows]
        row, first = D, -1
        for k in range(D):
            if simplex.weight[k] > 0.0:
                if first < 0:
                    first = k
                    continue
                if simplex.weight[k] + s[row, rows] < 0.0:
                    return math.inf
                change += s[row, rows]
                row += 1
        if not square <= most or simplex.weight[first] - change < 0.0:
            return math.inf
        row = D
        simplex.weight[first] -= change
        for k in range(first + 1, D):
            if simplex.weight[k] > 0.0:
                simplex.weight[k] += s[row, rows]
                row += 1
        length = math.sqrt(1.0 + square)
        total = 0.0
        for c in range(D):
            simplex.normal[c] = (simplex.normal[c] + s[c, rows]) / length
            total += simplex.normal[c] * simplex.normal[c]
        for c in range(D):
            simplex.normal[c] /= math.sqrt(total)
        return square

    @part
    def sharpen(curves, simplex, most):  # type: ignore[no-untyped-def]
        """Sharpen the normal, the weights and the pressures of a simplex nearest to its target.

        Args:
            most: the largest square of a turn.
        """
        for _ in range(STEPS):
            smooth, rows = follow_all(curves, simplex), D - 1
            for k in range(D):
                rows += 1 if simplex.weight[k] > 0.0 else 0
            if not smooth and rows < 2 * D - 1:
                return  # at a corner, or an edge in space, whose points stay: the normal is where w is
            write_system(simplex, rows)
            if not solve(simplex.system, rows):
                return
            square = take_step(simplex, rows, most)
            if not square > SMALL * SMALL:
                break
        follow_all(curves, simplex)

    return sharpen


@part
def leave_as_it_is(support, simplex, most):  # type: ignore[no-untyped-def]
    """Of hulls of vertices: the normals of their faces are known to rounding."""
