"""How far pressure curves of actuators reach along a direction.

Where a force that the engine knows is no cubic, pieces tell where to look, and Newton's method finds the place on the
force itself.
"""

import math

from torcharm.engine.compilation import part
from torcharm.engine.curves import NO_PRESSURE
from torcharm.engine.forces import force_by_pressure

NEWTON_STEPS = 40
"""Steps to the place on a force itself at most: 2 or 3 are usual."""
SETTLED = 1e-10
"""By this part of the limit a last step may still move a pressure: its square counts."""
ABOVE, BELOW, ARCHED, HOLLOW = 1, 2, 4, 8
"""Control points lie above a curve's chord, or below; its slopes fall from each to the next, or rise."""
ROUNDED = 1e-9
"""By this part of themselves slopes may differ that count as equal: g at its top is then off by the square of it."""


@part
def sides(curves, a):  # type: ignore[no-untyped-def]
    """What is known of a curve's shape: ABOVE and BELOW its chord there are control points; it is HOLLOW or ARCHED.

    Where no control point is on the side that a direction points to, the curve reaches furthest at one of its ends.
    """
    last = curves.pieces[a]
    if curves.power[a, 0] > 0.0:
        return ABOVE if curves.power[a, 1] < 0.0 else BELOW
    bend = _bend(curves, a) if last > 1 and curves.off[a] == 0.0 else 0
    if bend != 0:
        return ABOVE + ARCHED if bend < 0 else BELOW + HOLLOW
    start, first = curves.edge[a, 0], curves.control[a, 0, 0]
    span = curves.edge[a, last] - start
    slope = (curves.control[a, last - 1, 3] - first) / span if span > 0.0 else 0.0
    above = below = 0
    for k in range(last):
        third = (curves.edge[a, k + 1] - curves.edge[a, k]) / 3.0
        for j in range(4):
            off = curves.control[a, k, j] - first - slope * (curves.edge[a, k] + j * third - start)
            if off > 0.0:
                above = ABOVE
            elif off < 0.0:
                below = BELOW
    return above + below


@part
def _bend(curves, a):  # type: ignore[no-untyped-def]
    """-1 if slopes fall from each control point to the next, 1 if they rise, 0 if neither, or if the force jumps."""
    falling = rising = False
    before, slack = math.nan, 0.0  # no slope compares with it
    for k in range(curves.pieces[a]):
        begin, end = curves.control[a, k, 0], curves.control[a, max(k - 1, 0), 3]
        if k > 0 and abs(begin - end) > ROUNDED * abs(begin):
            return 0
        span = curves.edge[a, k + 1] - curves.edge[a, k]
        if not span > 0.0:  # of a piece without length bisection would not know to which side of the top it belongs
            return 0
        for j in range(1, 4):
            now = (curves.control[a, k, j] - curves.control[a, k, j - 1]) * (3.0 / span)
            slack = ROUNDED * abs(now)
            falling, rising = falling or now < before - slack, rising or now > before + slack
            before = now
        if falling and rising:
            return 0
    return int(rising) - int(falling)


@part
def exact_force(curves, a, p):  # type: ignore[no-untyped-def]
    """The force of a curve at a pressure, and its two derivatives, by the model itself."""
    force, slope, bend = force_by_pressure(curves.models, a, curves.strain[a, 0], p, curves.row)
    if curves.terms[0] == 2:
        less, less_slope, less_bend = force_by_pressure(curves.models, a, curves.strain[a, 1], p, curves.row)
        force, slope, bend = force - less, slope - less_slope, bend - less_bend
    return force, slope, bend


@part
def settle(curves, a, by_force, by_pressure, k, p):  # type: ignore[no-untyped-def]
    """From a pressure within piece k go to where g is largest by the force itself; also the force and -g'' there.

    Newton's method, and half of what is left where that would leave the place at which the slope of g falls through 0.
    """
    low, high = curves.edge[a, k], curves.edge[a, k + 1]
    close = SETTLED * high
    force, slope, bend = exact_force(curves, a, p)
    for _ in range(NEWTON_STEPS):
        rise, fall, last = by_force * slope + by_pressure, -by_force * bend, p
        low, high = (p, high) if rise > 0.0 else (low, p)
        p += rise / fall if fall > 0.0 else 0.0
        p = p if low < p < high else 0.5 * (low + high)
        force, slope, bend = exact_force(curves, a, p)
        if abs(p - last) <= close:
            break
    return p, force, max(-by_force * bend, 0.0)


@part
def _piece_at_top(curves, a, by_force, by_pressure):  # type: ignore[no-untyped-def]
    """The piece on which g, whose slopes fall, is largest: the first that ends with g falling."""
    first, last = 0, curves.pieces[a] - 1
    while first < last:
        k = (first + last) // 2
        third = (curves.edge[a, k + 1] - curves.edge[a, k]) / 3.0
        if by_force * (curves.control[a, k, 3] - curves.control[a, k, 2]) + by_pressure * third > 0.0:
            first = k + 1
        else:
            last = k
    return first


@part
def _top_of_power(curves, a, by_force, by_pressure):  # type: ignore[no-untyped-def]
    """The same as of `furthest` for a curve `f(0) + c p^(1 + k)` that bends away from the direction.

    There `by_force f'(p) + by_pressure = 0`, and with the slope f'(P) at the limit P it is `f'(P) (p/P)^k = f'(p)`.
    """
    limit, power, steepest = curves.edge[a, 1], curves.power[a, 0], curves.power[a, 1]
    if by_pressure <= 0.0:
        return 0.0, curves.control[a, 0, 0], 0.0
    ratio = by_pressure / (-by_force * steepest)
    if not 0.0 < ratio < 1.0:
        return limit, curves.control[a, 0, 3], 0.0
    p = limit * math.exp(math.log(ratio) / power)
    if p <= NO_PRESSURE:
        return 0.0, curves.control[a, 0, 0], 0.0
    return p, curves.control[a, 0, 0] - p * by_pressure / (by_force * (1.0 + power)), by_pressure * power / p


@part
def furthest(curves, a, by_force, by_pressure):  # type: ignore[no-untyped-def]
    """The pressure p and force f of a curve that make `g = by_force f + by_pressure p` largest, and -g'' there.

    At an end of a piece, where a small turn of the direction does not move the maximum, the last is 0.
    """
    last = curves.pieces[a]
    if curves.side[a] & (ABOVE if by_force > 0.0 else BELOW) == 0:
        start, end = curves.control[a, 0, 0], curves.control[a, last - 1, 3]
        if by_force * start + by_pressure * curves.edge[a, 0] >= by_force * end + by_pressure * curves.edge[a, last]:
            return curves.edge[a, 0], start, 0.0
        return curves.edge[a, last], end, 0.0
    if curves.power[a, 0] > 0.0:
        return _top_of_power(curves, a, by_force, by_pressure)
    begin = 0
    if curves.side[a] & (ARCHED if by_force > 0.0 else HOLLOW):
        begin = _piece_at_top(curves, a, by_force, by_pressure)
        last = begin + 1
    low = curves.edge[a, begin]
    at, force, fall = low, curves.control[a, begin, 0], 0.0
    best, slack = by_force * force + by_pressure * low, abs(by_force) * curves.off[a]
    for k in range(begin, last):
        high = curves.edge[a, k + 1]
        third = (high - low) / 3.0
        f0, f1, f2, f3 = (
            curves.control[a, k, 0],
            curves.control[a, k, 1],
            curves.control[a, k, 2],
            curves.control[a, k, 3],
        )
        g0, g1 = by_force * f0 + by_pressure * low, by_force * f1 + by_pressure * (low + third)
        g2, g3 = by_force * f2 + by_pressure * (high - third), by_force * f3 + by_pressure * high
        if g0 > best:
            best, at, force, fall = g0, low, f0, 0.0
        if g3 > best:
            best, at, force, fall = g3, high, f3, 0.0
        if g1 > best - slack or g2 > best - slack:
            # Of the slope `q t² + 2 b t + c`, a quadratic over t from 0 to 1, the root at which it falls through 0.
            c = g1 - g0
            b = g2 - g1 - c
            q = g3 - g2 - (g2 - g1) - b
            square = b * b - q * c
            if square > 0.0:
                root, t = math.sqrt(square), -1.0
                if b <= 0.0:
                    t = c / (root - b)
                elif q < 0.0:
                    t = -(b + root) / q
                if 0.0 < t < 1.0:
                    s, p = 1.0 - t, low + t * (high - low)
                    f = s * s * (s * f0 + 3.0 * t * f1) + t * t * (3.0 * s * f2 + t * f3)
                    down = 6.0 * root / ((high - low) * (high - low))
                    if slack > 0.0:
                        p, f, down = settle(curves, a, by_force, by_pressure, k, p)
                    g = by_force * f + by_pressure * p
                    if g > best:
                        best, at, force, fall = g, p, f, down
        low = high
    return at, force, fall


@part
def step_nearby(curves, a, by_force, by_pressure, p):  # type: ignore[no-untyped-def]
    """From a pressure one Newton step to where `g = by_force f + by_pressure p` is largest nearby; f and -g'' there.

    Pressures at ends of pieces stay, and their -g'' is 0.
    """
    last = curves.pieces[a]
    k = 0
    while k < last - 1 and p > curves.edge[a, k + 1]:
        k += 1
    low, high = curves.edge[a, k], curves.edge[a, k + 1]
    if not low < p < high:
        return p, curves.control[a, k, 3 if p >= high and high > low else 0], 0.0
    if curves.power[a, 0] > 0.0 and by_force * curves.power[a, 1] < 0.0:
        return _top_of_power(curves, a, by_force, by_pressure)
    force, slope, bend = smooth_force(curves, a, k, p)
    fall = -by_force * bend
    if not fall > 0.0:
        return p, force, 0.0
    there = p + (by_force * slope + by_pressure) / fall
    if not low < there < high:
        return p, force, fall
    force, _, bend = smooth_force(curves, a, k, there)
    return there, force, max(-by_force * bend, 0.0)


@part
def smooth_force(curves, a, k, p):  # type: ignore[no-untyped-def]
    """The force of a curve at a pressure within piece k, and its two derivatives."""
    if curves.off[a] > 0.0:
        return exact_force(curves, a, p)
    low, width = curves.edge[a, k], curves.edge[a, k + 1] - curves.edge[a, k]
    t = (p - low) / width
    s = 1.0 - t
    f0, f1, f2, f3 = curves.control[a, k, 0], curves.control[a, k, 1], curves.control[a, k, 2], curves.control[a, k, 3]
    force = s * s * (s * f0 + 3.0 * t * f1) + t * t * (3.0 * s * f2 + t * f3)
    slope = 3.0 * (s * s * (f1 - f0) + 2.0 * s * t * (f2 - f1) + t * t * (f3 - f2)) / width
    bend = 6.0 * (s * (f2 - 2.0 * f1 + f0) + t * (f3 - 2.0 * f2 + f1)) / (width * width)
    return force, slope, bend
