"""Elements of constant twist: where their ends lie, and how motions depend on their twists.

Motions are twists about the world's origin along its axes (spatial twists), in which a motion of the base is the same
for the whole arm: no transport from node to node is needed. With W the cross product by the turn w of an element,
its rotation is `1 + a W + b W²`, its displacement `(1 + b W + c W²) v`, its centroid `(1/2 + c W + d W²) v`, with the
smooth functions a to d of `t = w·w` as in `geometry.turn_ratios`, and

    ∂(β W v + γ W² v)/∂w_k = β e_k×v + γ (w v_k + e_k (w·v) - 2 v w_k) + 2 w_k (β' w×v + γ' w×(w×v)).
"""

import math

import numpy as np

from torcharm.engine.compilation import part

_SERIES_END = 4.0
"""Squared angle [rad²] above which closed forms lose no more than the last digits."""
_SHORT_SERIES_END = 0.25
"""Squared angle below which the few terms of the short series are exact to rounding: an element's turn is rarely
more than half a radian."""
_TERMS, _SHORT_TERMS = 16, 7
"""Terms of both: the first one left out is below 1e-19 of the sum, with its derivative."""
_C = np.array([(-1) ** k / math.factorial(2 * k + 3) for k in range(_TERMS)])
_D = np.array([(-1) ** k / math.factorial(2 * k + 4) for k in range(_TERMS)])


@part
def turn_ratios(t):  # type: ignore[no-untyped-def]
    """a, b, c, d of a squared angle, and the derivatives of b, c and d by it."""
    if t < _SERIES_END:
        c = d = c_slope = d_slope = 0.0
        if t < _SHORT_SERIES_END:
            for k in range(_SHORT_TERMS - 1, -1, -1):
                c_slope = c_slope * t + c
                d_slope = d_slope * t + d
                c = c * t + _C[k]
                d = d * t + _D[k]
        else:
            for k in range(_TERMS - 1, -1, -1):
                c_slope = c_slope * t + c
                d_slope = d_slope * t + d
                c = c * t + _C[k]
                d = d * t + _D[k]
        return 1.0 - t * c, 0.5 - t * d, c, d, -(d + t * d_slope), c_slope, d_slope
    angle = math.sqrt(t)
    half = math.sin(0.5 * angle)
    a, b = math.sin(angle) / angle, 2.0 * half * half / t
    c, d = (1.0 - a) / t, (0.5 - b) / t
    return a, b, c, d, (a - 2.0 * b) / (2.0 * t), (b - 3.0 * c) / (2.0 * t), (c - 4.0 * d) / (2.0 * t)


@part
def write_motion(arms, start, i, end, j, move, m, twist, share):  # type: ignore[no-untyped-def]
    """Write the pose at the end of a share of an element, and its motion by the unknowns.

    Args:
        start: (., P) poses, of which row i is where it begins and takes its twist from.
        end: (., P) poses, of which row j is written.
        move: (., K, C) motions, of which m is written.
        twist: (N, K).
        share: of the segment's arc.
    """
    if arms.size == 3:
        _planar_motion(arms, start, i, end, j, move, m, twist, share)
    else:
        _spatial_motion(arms, start, i, end, j, move, m, twist, share)


@part
def _planar_motion(arms, start, i, end, j, move, m, twist, share):  # type: ignore[no-untyped-def]
    turn, last = twist[i, 2] * share, len(arms.unknown) - 1
    length, shear = twist[i, 0] * share, twist[i, 1] * share
    t = turn * turn
    a, b, c, _, b_slope, c_slope, _ = turn_ratios(t)
    cos, sin, across = 1.0 - b * t, a * turn, b * turn
    by_turn, across_by_turn = -2.0 * turn * (c + c_slope * t), b + 2.0 * t * b_slope
    c0, s0, x0, y0 = start[i, 0], start[i, 1], start[i, 2], start[i, 3]
    # The displacement is a + b w J, J a quarter turn, of the linear part; turned into the world
    u_x, u_y = a * c0 - across * s0, a * s0 + across * c0
    x, y = x0 + u_x * length - u_y * shear, y0 + u_y * length + u_x * shear
    end[j, 0], end[j, 1] = c0 * cos - s0 * sin, s0 * cos + c0 * sin
    end[j, 2], end[j, 3] = x, y
    d_x, d_y = by_turn * c0 - across_by_turn * s0, by_turn * s0 + across_by_turn * c0
    move[m, 0, 0], move[m, 1, 0], move[m, 2, 0] = u_x * share, u_y * share, 0.0
    move[m, 0, last] = (d_x * length - d_y * shear + y) * share
    move[m, 1, last] = (d_y * length + d_x * shear - x) * share
    move[m, 2, last] = share
    if last == 2:
        move[m, 0, 1], move[m, 1, 1], move[m, 2, 1] = -u_y * share, u_x * share, 0.0


@part
def _turned(pose, i, x, y, z):  # type: ignore[no-untyped-def]
    """A vector of the frame at a pose in space, along the world's axes."""
    return (
        pose[i, 0] * x + pose[i, 1] * y + pose[i, 2] * z,
        pose[i, 3] * x + pose[i, 4] * y + pose[i, 5] * z,
        pose[i, 6] * x + pose[i, 7] * y + pose[i, 8] * z,
    )


@part
def _power_column(k, diagonal, once, twice, x, y, z):  # type: ignore[no-untyped-def]
    """Column k of `diagonal + once W + twice w wᵀ`."""
    if k == 0:
        return diagonal + twice * x * x, once * z + twice * x * y, -once * y + twice * x * z
    if k == 1:
        return -once * z + twice * x * y, diagonal + twice * y * y, once * x + twice * y * z
    return once * y + twice * x * z, -once * x + twice * y * z, diagonal + twice * z * z


@part
def _turn_column(k, beta, gamma, v, w, dot, by_beta, by_gamma):  # type: ignore[no-untyped-def]
    """∂(β W v + γ W² v)/∂w_k; `by_beta` and `by_gamma` are the slopes of both, on `w×v` and `w×(w×v)`, together."""
    once_x, once_y, once_z = by_beta
    twice_x, twice_y, twice_z = by_gamma
    w_k = w[0] if k == 0 else (w[1] if k == 1 else w[2])
    v_k = v[0] if k == 0 else (v[1] if k == 1 else v[2])
    x = gamma * (w[0] * v_k - 2.0 * v[0] * w_k) + 2.0 * w_k * (once_x + twice_x)
    y = gamma * (w[1] * v_k - 2.0 * v[1] * w_k) + 2.0 * w_k * (once_y + twice_y)
    z = gamma * (w[2] * v_k - 2.0 * v[2] * w_k) + 2.0 * w_k * (once_z + twice_z)
    if k == 0:
        return x + gamma * dot, y - beta * v[2], z + beta * v[1]
    if k == 1:
        return x + beta * v[2], y + gamma * dot, z - beta * v[0]
    return x - beta * v[1], y + beta * v[0], z + gamma * dot


@part
def _spatial_motion(arms, start, i, end, j, move, m, twist, share):  # type: ignore[no-untyped-def]
    v = (twist[i, 0] * share, twist[i, 1] * share, twist[i, 2] * share)
    w = (twist[i, 3] * share, twist[i, 4] * share, twist[i, 5] * share)
    t, dot = w[0] * w[0] + w[1] * w[1] + w[2] * w[2], w[0] * v[0] + w[1] * v[1] + w[2] * v[2]
    a, b, c, _, b_slope, c_slope, _ = turn_ratios(t)
    o_x, o_y, o_z = w[1] * v[2] - w[2] * v[1], w[2] * v[0] - w[0] * v[2], w[0] * v[1] - w[1] * v[0]
    s_x, s_y, s_z = w[1] * o_z - w[2] * o_y, w[2] * o_x - w[0] * o_z, w[0] * o_y - w[1] * o_x
    x, y, z = _turned(start, i, v[0] + b * o_x + c * s_x, v[1] + b * o_y + c * s_y, v[2] + b * o_z + c * s_z)
    x, y, z = x + start[i, 9], y + start[i, 10], z + start[i, 11]
    for k in range(3):
        r_x, r_y, r_z = _power_column(k, 1.0 - b * t, a, b, w[0], w[1], w[2])
        e_x, e_y, e_z = _turned(start, i, r_x, r_y, r_z)
        end[j, k], end[j, 3 + k], end[j, 6 + k] = e_x, e_y, e_z
    end[j, 9], end[j, 10], end[j, 11] = x, y, z
    by_b = (b_slope * o_x, b_slope * o_y, b_slope * o_z)
    by_c = (c_slope * s_x, c_slope * s_y, c_slope * s_z)
    for n in range(len(arms.unknown)):
        k = arms.unknown[n] % 3
        l_x, l_y, l_z = _power_column(k, 1.0 - c * t, b, c, w[0], w[1], w[2])
        l_x, l_y, l_z = _turned(start, i, l_x * share, l_y * share, l_z * share)
        if arms.unknown[n] < 3:
            move[m, 0, n], move[m, 1, n], move[m, 2, n] = l_x, l_y, l_z
            move[m, 3, n] = move[m, 4, n] = move[m, 5, n] = 0.0
        else:
            d_x, d_y, d_z = _turn_column(k, b, c, v, w, dot, by_b, by_c)
            d_x, d_y, d_z = _turned(start, i, d_x * share, d_y * share, d_z * share)
            move[m, 0, n] = d_x - (l_y * z - l_z * y)
            move[m, 1, n] = d_y - (l_z * x - l_x * z)
            move[m, 2, n] = d_z - (l_x * y - l_y * x)
            move[m, 3, n], move[m, 4, n], move[m, 5, n] = l_x, l_y, l_z


@part
def write_centroid(arms, start, i, place, slide, twist, share):  # type: ignore[no-untyped-def]
    """Write the centroid of a share of an element, and how it slides by the unknowns while its start is held.

    Args:
        start: (., P) poses, of which row i is where it begins.
        place: (D,) is written [m].
        slide: (D, C) is written.
        twist, share: as of `write_motion`.
    """
    if arms.size == 3:
        turn, last = twist[i, 2] * share, len(arms.unknown) - 1
        length, shear = twist[i, 0] * share, twist[i, 1] * share
        t = turn * turn
        _, _, c, d, _, c_slope, d_slope = turn_ratios(t)
        along, across = 0.5 - d * t, c * turn
        by_turn, across_by_turn = -2.0 * turn * (d + d_slope * t), c + 2.0 * t * c_slope
        c0, s0 = start[i, 0], start[i, 1]
        u_x, u_y = along * c0 - across * s0, along * s0 + across * c0
        d_x, d_y = by_turn * c0 - across_by_turn * s0, by_turn * s0 + across_by_turn * c0
        place[0] = start[i, 2] + u_x * length - u_y * shear
        place[1] = start[i, 3] + u_y * length + u_x * shear
        slide[0, 0], slide[1, 0] = u_x * share, u_y * share
        slide[0, last] = (d_x * length - d_y * shear) * share
        slide[1, last] = (d_y * length + d_x * shear) * share
        if last == 2:
            slide[0, 1], slide[1, 1] = -u_y * share, u_x * share
    else:
        _spatial_centroid(arms, start, i, place, slide, twist, share)


@part
def _spatial_centroid(arms, start, i, place, slide, twist, share):  # type: ignore[no-untyped-def]
    v = (twist[i, 0] * share, twist[i, 1] * share, twist[i, 2] * share)
    w = (twist[i, 3] * share, twist[i, 4] * share, twist[i, 5] * share)
    t, dot = w[0] * w[0] + w[1] * w[1] + w[2] * w[2], w[0] * v[0] + w[1] * v[1] + w[2] * v[2]
    _, _, c, d, _, c_slope, d_slope = turn_ratios(t)
    o_x, o_y, o_z = w[1] * v[2] - w[2] * v[1], w[2] * v[0] - w[0] * v[2], w[0] * v[1] - w[1] * v[0]
    s_x, s_y, s_z = w[1] * o_z - w[2] * o_y, w[2] * o_x - w[0] * o_z, w[0] * o_y - w[1] * o_x
    half = (0.5 * v[0] + c * o_x + d * s_x, 0.5 * v[1] + c * o_y + d * s_y, 0.5 * v[2] + c * o_z + d * s_z)
    x, y, z = _turned(start, i, half[0], half[1], half[2])
    place[0], place[1], place[2] = x + start[i, 9], y + start[i, 10], z + start[i, 11]
    by_c = (c_slope * o_x, c_slope * o_y, c_slope * o_z)
    by_d = (d_slope * s_x, d_slope * s_y, d_slope * s_z)
    for n in range(len(arms.unknown)):
        k = arms.unknown[n] % 3
        if arms.unknown[n] < 3:
            x, y, z = _power_column(k, 0.5 - d * t, c, d, w[0], w[1], w[2])
        else:
            x, y, z = _turn_column(k, c, d, v, w, dot, by_c, by_d)
        slide[0, n], slide[1, n], slide[2, n] = _turned(start, i, x * share, y * share, z * share)


@part
def write_link(arms, pose, i, b, segment):  # type: ignore[no-untyped-def]
    """Move a pose to the end of the link behind a segment."""
    link = arms.link
    if arms.size == 3:
        c0, s0, x, y = pose[i, 0], pose[i, 1], link[b, segment, 2], link[b, segment, 3]
        c1, s1 = link[b, segment, 0], link[b, segment, 1]
        pose[i, 2] += c0 * x - s0 * y
        pose[i, 3] += s0 * x + c0 * y
        pose[i, 0], pose[i, 1] = c0 * c1 - s0 * s1, s0 * c1 + c0 * s1
    else:
        x, y, z = _turned(pose, i, link[b, segment, 9], link[b, segment, 10], link[b, segment, 11])
        pose[i, 9] += x
        pose[i, 10] += y
        pose[i, 11] += z
        for row in range(0, 9, 3):
            r_x, r_y, r_z = pose[i, row], pose[i, row + 1], pose[i, row + 2]
            for k in range(3):
                pose[i, row + k] = (
                    r_x * link[b, segment, k] + r_y * link[b, segment, 3 + k] + r_z * link[b, segment, 6 + k]
                )


@part
def write_lever(arms, pose, i, lever, m):  # type: ignore[no-untyped-def]
    """Write the motions (., K, C) of a body at a pose by unit twists of its own, in the unknown columns.

    Its transpose takes a wrench about the world's origin to the body's components.
    """
    if arms.size == 3:
        last = len(arms.unknown) - 1
        c0, s0, x, y = pose[i, 0], pose[i, 1], pose[i, 2], pose[i, 3]
        lever[m, 0, 0], lever[m, 1, 0], lever[m, 2, 0] = c0, s0, 0.0
        lever[m, 0, last], lever[m, 1, last], lever[m, 2, last] = y, -x, 1.0
        if last == 2:
            lever[m, 0, 1], lever[m, 1, 1], lever[m, 2, 1] = -s0, c0, 0.0
        return
    x, y, z = pose[i, 9], pose[i, 10], pose[i, 11]
    for n in range(len(arms.unknown)):
        k = arms.unknown[n] % 3
        e_x, e_y, e_z = pose[i, k], pose[i, 3 + k], pose[i, 6 + k]
        if arms.unknown[n] < 3:
            lever[m, 0, n], lever[m, 1, n], lever[m, 2, n] = e_x, e_y, e_z
            lever[m, 3, n] = lever[m, 4, n] = lever[m, 5, n] = 0.0
        else:
            lever[m, 0, n], lever[m, 1, n], lever[m, 2, n] = y * e_z - z * e_y, z * e_x - x * e_z, x * e_y - y * e_x
            lever[m, 3, n], lever[m, 4, n], lever[m, 5, n] = e_x, e_y, e_z
