"""The distance of a wrench from an attainable set, `d(w) = max_{|n|=1} n·w - h(n)`, in D dimensions.

The set is the convex hull of a sum of pressure curves, `Conv Σ_α {f_α(p) u_α + p t_α}`. It is never built: only its
support function is asked for, `h(n) = Σ_α max_p (n·u_α) f_α(p) + (n·t_α) p`, which needs two numbers a curve. The
method is that of Gilbert, Johnson and Keerthi (1988), Frank-Wolfe's with all corrections (Montaut et al. 2022): of at
most D points of the set keep the simplex nearest to w, ask for the point of the set that lies furthest towards w, and
go on from the nearest of the simplex's faces that hold it. Where the boundary is smooth that bisects angles; so there
normals come from Newton's method instead, as long as they raise the lower bound. Every normal n gives a lower bound
n·w - h(n), the simplex an upper one: the answer comes with the gap between them.
"""

import math
from functools import cache
from typing import Any

import numpy as np

from torcharm.engine.compilation import part
from torcharm.engine.reach import furthest
from torcharm.engine.simplex import simplex_parts

GAP = 1e-13
"""The gap, as a part of the problem's size, at which the distance is known: what rounding leaves."""
ITERATIONS = 100
"""Points of the set that are asked for at most: 3 to 8 are usual, 25 the most that was seen."""
TOUCHING = 16 * float(np.finfo(np.float64).eps)
"""A distance of less than this part of the problem's size is rounding, and 0."""


@part
def add_turn(turn, curves, a, slope, by):  # type: ignore[no-untyped-def]
    """Add how an actuator's point moves as the normal turns: along its tangent v, by `v v·δn` times `by`."""
    D = len(turn)
    for c in range(D):
        v = slope * curves.lever[a, c] + (curves.bending[a, c - 1] if c > 0 else 0.0)
        for e in range(D):
            turn[c, e] += v * (slope * curves.lever[a, e] + (curves.bending[a, e - 1] if e > 0 else 0.0)) * by


@cache
def curve_support(D: int) -> Any:
    """`ask` for sums of curves in D components, 2 (plane) or 3 (space): loops of known length are unrolled."""

    @part
    def ask(curves, simplex):  # type: ignore[no-untyped-def]
        """Find the set's point furthest along the normal, seen from w, and how it moves as the normal turns.

        An actuator at a smooth place of its curve moves the point along its tangent v, by `v v·δn / -g''`. Returns how
        many there are.
        """
        n, point, turn = simplex.normal, simplex.point, simplex.turn
        for c in range(D):
            point[c] = -simplex.target[c]
            for e in range(D):
                turn[c, e] = 0.0
        smooth = 0
        for a in range(len(simplex.fresh)):
            by_force, by_pressure = n[0] * curves.lever[a, 0], 0.0
            for c in range(1, D):
                by_force += n[c] * curves.lever[a, c]
                by_pressure += n[c] * curves.bending[a, c - 1]
            p, f, fall = furthest(curves, a, by_force, by_pressure)
            simplex.fresh[a] = p
            point[0] += f * curves.lever[a, 0]
            for c in range(1, D):
                point[c] += f * curves.lever[a, c] + p * curves.bending[a, c - 1]
            if fall > 0.0:
                smooth += 1
                add_turn(turn, curves, a, -by_pressure / by_force, 1.0 / fall)
        return smooth

    return ask


@cache
def turn_part(D: int) -> Any:
    """`turn_normal` for wrenches of D components."""

    @part
    def turn_normal(simplex, ahead, smooth):  # type: ignore[no-untyped-def]
        """Turn the normal to where Newton's method expects the nearest point of a smooth boundary.

        The nearest point y has `w - y = ρ n`. As y turns with n by H, `(H + ρ) δn = w - y - ρ n`. Where one actuator
        alone moves the point, in space, H knows only its own direction, and the normal is turned in that one only.
        """
        n, H, y = simplex.normal, simplex.turn, simplex.point
        if D == 2:
            a, b, c = H[0, 0] + ahead, H[1, 0], H[1, 1] + ahead
            g, h = -y[0] - ahead * n[0], -y[1] - ahead * n[1]
            det = a * c - b * b
            n[0] += (c * g - b * h) / det
            n[1] += (a * h - b * g) / det
        elif smooth == 1:
            k = 0
            for c in range(1, D):
                k = c if H[c, c] > H[k, k] else k
            along, square, trace = 0.0, 0.0, 0.0
            for c in range(D):
                along += H[k, c] * (-y[c] - ahead * n[c])
                square += H[k, c] * H[k, c]
                trace += H[c, c]
            for c in range(D):
                n[c] += along / (square * (trace + ahead)) * H[k, c]
        else:
            a, b, c = H[0, 0] + ahead, H[1, 0], H[2, 0]
            d, e, f = H[1, 1] + ahead, H[2, 1], H[2, 2] + ahead
            g, h, k = -y[0] - ahead * n[0], -y[1] - ahead * n[1], -y[2] - ahead * n[2]
            r, s, t, u = d * f - e * e, c * e - b * f, b * e - c * d, b * c - a * e
            det = a * r + b * s + c * t
            n[0] += (r * g + s * h + t * k) / det
            n[1] += (s * g + (a * f - c * c) * h + u * k) / det
            n[2] += (t * g + u * h + (a * d - b * b) * k) / det
        length = 0.0
        for c in range(D):
            length += n[c] * n[c]
        length = math.sqrt(length)
        for c in range(D):
            n[c] /= length

    return turn_normal


@cache
def nearest_part(D: int, ask: Any) -> Any:
    """`nearest` for sets in D components whose support is asked for by `ask`."""
    turn_normal = turn_part(D)
    ahead_of, surrounded, nearest_face, take, begin, write_back = simplex_parts(D)

    @part
    def nearest(support, simplex, size):  # type: ignore[no-untyped-def]
        """The distance of the simplex's target from the set, the gap that is left, and whether it is strictly inside.

        Args:
            support: the curves or vertices that make the set.
            size: of the problem, the most that the numbers in it can add up to.
        """
        low, length, square, newton = 0.0, 0.0, 0.0, False
        for iteration in range(ITERATIONS):
            smooth = ask(support, simplex)
            ahead, better = 0.0, False
            if iteration == 0:
                square = begin(simplex)
            else:
                ahead = ahead_of(simplex)
                better = ahead > low
                low = max(low, ahead)
                if length - low <= GAP * size:
                    break
                if low <= TOUCHING * size and surrounded(simplex):  # of slivers rounding decides; a plane beyond w does
                    return 0.0, 0.0, True
                own, now = nearest_face(simplex)
                if now < square:
                    take(simplex, own)
                    square = now
                elif newton:  # a step too far: ask along the simplex's own normal before giving up
                    newton = False
                    for c in range(D):
                        simplex.normal[c] = simplex.back[c]
                    continue
                else:
                    break
            length = math.sqrt(square)
            if length <= TOUCHING * size:
                return 0.0, 0.0, False
            write_back(simplex, length)
            if low > 0.0 and length - low <= GAP * size:
                break
            newton = smooth > 0 and ahead > 0.0 and (better or not newton)
            if newton:
                turn_normal(simplex, ahead, smooth)
            else:
                for c in range(D):
                    simplex.normal[c] = simplex.back[c]
            ahead = 0.0  # of this one nothing is known yet
        if low <= 0.0 and length < math.inf:  # no plane is known to separate them
            return 0.0, length, False
        if ahead < low or ahead <= 0.0:  # another normal gave the bound: the simplex's own goes with its points
            for c in range(D):
                simplex.normal[c] = simplex.back[c]
        return length, max(length - low, 0.0), False

    return nearest
