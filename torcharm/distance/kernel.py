"""Nearest points of sums of curves that are written out, one problem at a time: machine code.

With the support function h of a convex set, `p(n) = n·w - h(n)` over unit vectors n is, where it is above 0, a
concave function of the normal's angle, and its maximum the distance of w. Its derivative is `t·(w - y)`, with t to
the left of n and y the point that a line with normal n touches. If w is outside, and n less than a right angle from
the normal sought, the sign of that says on which side of n to look; the vector from any point of the set to w is such
an n. So normals are bracketed, and Newton's steps close in: by the radii of curvature, and over faces by the chords of
what moves. If w lies behind the chord of what two normals around the sought one touch, it is inside.

From inside, minus the distance is the least `h(n) - n·w`, which may have many minima. From one normal to another
the boundary is no nearer than the chord between the points that they touch: normals are added where chords are nearest,
until none is nearer than what was found.
"""

import math

import numpy as np

from torcharm.distance.closed_form import BOUNDARY_ULPS
from torcharm.distance.problems import GAP
from torcharm.distance.shapes import FLAT, FLOOR
from torcharm.engine.compilation import jit, jit_part
from torcharm.laws import LEAST, STRAIGHT

EPS = float(np.finfo(np.float64).eps)
BLUR = BOUNDARY_ULPS * EPS
FLAT_SLOPE = FLAT * EPS
LINE, CUBIC, POWER, TWINS = 0, 1, 2, 3
"""Kinds of curves: lines between kinks, beside these a cubic, a power, or two."""
PORTALS, ROUNDS, NEWTONS = 60, 60, 40
"""So many normals at most tell whether a point is inside, and find its nearest one; so many steps a maximum."""
NEAR = 1e-8
"""A step of such a logarithm after which the next would be none."""
FINE = 1e-10
"""Nearest points lie straight ahead to within this share of their distance, if numbers are that fine."""
CLOSING = 0.3
"""By this factor, at least, a step must bring the touched point nearer to straight ahead."""
SEEDS, NORMALS = 8, 400
"""Normals to start from inside, and at most."""
LO, HI, NOW, BEGIN, END, ROWS = 0, 1, 2, 3, 4, 5
"""What was touched: clockwise and counter-clockwise of the answer, last, and at the face's two ends; more if inside."""
EDGE, FORCE, BASE, RATE, RISE, HEAD, PAIR, FIELDS = 0, 1, 2, 3, 4, 5, 6, 7
"""Of a curve: corners' fractions, forces, and slopes of powers there; pieces' lines; the rest; and powers."""
LEVER, OFFSET, KIND, PIECES, BEND, TWIST, LATEST = 0, 1, 2, 3, 4, 5, 6
"""The rest: bending moment and radius, scaled; kind and number of pieces; cubic's coefficients; latest maximum."""
GAIN, POWER_OF, SECOND, SECOND_OF, TURN, AT_TURN, PAIRS = 0, 1, 2, 3, 4, 5, 8
"""Of two powers: gains and exponents; the logarithm of the turning point (1: none), and their slope there."""
NORMAL, POINT, MARGIN, LINK, MORE = 0, 1, 2, 3, 4
"""Of what was touched, after M actuators' fractions and forces: normal; point; margins there and on; neighbours."""


# ---- curves: data (M, FIELDS, S) ----------------------------------------------------------------


@jit_part
def _describe(table, kinks, limit, row, section, first, data, work):  # type: ignore[no-untyped-def]
    """Write out one curve, or its difference from that of another section, as pieces between corners.

    Args:
        table, kinks, limit: as of `nearest`.
        row, section: which curve.
        first: the other section; negative: none.
        data: where to.
        work: (2K + 5, 4) room for coefficients, the other's, two powers, and corners in order.

    Returns:
        Its least and largest force, roughly.
    """
    work[2:4] = 0.0
    work[4:] = 2.0
    for part in range(2 if first >= 0 else 1):
        source, sign = first if part else section, -1.0 if part else 1.0
        most = limit[row, source]
        least = max(most, LEAST)
        factor = 1.0
        for j in range(4):
            work[part, j] = factor * table[j, row, source]
            factor *= most
        for k in range(kinks):
            slope, at = table[4 + kinks + k, row, source] * most, table[4 + k, row, source] / least
            if slope == 0.0 or at >= 1.0:
                continue
            if not at > 0.0:
                work[part, 0] -= slope * at
                work[part, 1] += slope
                continue
            place = 4
            while work[place, 0] < at:
                place += 1
            if work[place, 0] == at:
                work[place, 1] += sign * slope
                continue
            for other in range(len(work) - 1, place, -1):
                work[other, 0], work[other, 1] = work[other - 1, 0], work[other - 1, 1]
            work[place, 0], work[place, 1] = at, sign * slope
        gain, exponent = table[4 + 2 * kinks, row, source], table[5 + 2 * kinks, row, source]
        if gain != 0.0:
            gain *= least**exponent
            if exponent - 1.0 <= STRAIGHT:
                work[part, 1] += gain
            else:
                place = 3 if part and work[2, 1] != exponent else 2
                work[place, 0] += sign * gain
                work[place, 1] = exponent
    if first >= 0:
        for j in range(4):
            work[0, j] -= work[1, j]
    c, power = work[0], work[2:4]
    if power[0, 0] == 0.0:
        power[0, 0], power[0, 1], power[1, 0] = power[1, 0], power[1, 1], 0.0
    powers = 0
    for j in range(2):
        powers += power[j, 0] != 0.0
    own = data[row]
    own[HEAD, BEND], own[HEAD, TWIST] = c[2], c[3]
    kind = LINE
    if powers > 0:
        kind = TWINS if powers == 2 else POWER
    elif c[2] != 0.0 or c[3] != 0.0:
        kind = CUBIC
    own[HEAD, KIND] = kind
    swap = powers == 2 and power[0, 1] > power[1, 1]
    for j in range(powers):
        own[PAIR, 2 * j], own[PAIR, 2 * j + 1] = power[1 - j if swap else j, 0], power[1 - j if swap else j, 1]
    own[PAIR, TURN] = 1.0
    if powers == 2:
        g, p, h, q = own[PAIR, GAIN], own[PAIR, POWER_OF], own[PAIR, SECOND], own[PAIR, SECOND_OF]
        ratio = -(g * p * (p - 1.0)) / (h * q * (q - 1.0))
        turn = math.log(ratio) / (q - p) if ratio > 0.0 else 1.0  # else both bend the same way
        if turn < 0.0:
            own[PAIR, TURN] = turn
            own[PAIR, AT_TURN] = g * p * math.exp((p - 1.0) * turn) + h * q * math.exp((q - 1.0) * turn)
    pieces = 1
    own[EDGE, 0], own[BASE, 0], own[RATE, 0] = 0.0, c[0], c[1]
    for k in range(4, len(work)):
        at, slope = work[k, 0], work[k, 1]
        if at < 1.0 and slope != 0.0:
            own[EDGE, pieces] = at
            own[BASE, pieces] = own[BASE, pieces - 1] - slope * at
            own[RATE, pieces] = own[RATE, pieces - 1] + slope
            pieces += 1
    own[EDGE, pieces] = 1.0
    own[HEAD, PIECES] = pieces
    low = high = c[0]
    for k in range(pieces + 1):
        u, piece = own[EDGE, k], max(k - 1, 0)
        value = own[BASE, piece] + u * (own[RATE, piece] + u * (c[2] + u * c[3]))
        slopes = 0.0
        for j in range(powers):
            lift = own[PAIR, 2 * j] * u ** (own[PAIR, 2 * j + 1] - 1.0)
            value += lift * u
            slopes += lift * own[PAIR, 2 * j + 1]
        own[FORCE, k], own[RISE, k] = value, slopes
        low, high = min(low, value), max(high, value)
    if kind == CUBIC and pieces == 1:
        middle = c[0] + 0.5 * (c[1] + 0.5 * (c[2] + 0.5 * c[3]))
        low, high = min(low, middle), max(high, middle)
    return low, high


@jit_part
def _twin_peak(own, piece, along, slope):  # type: ignore[no-untyped-def]
    """The fraction of the local maximum of two powers and a slope in a piece, and minus the second derivative; or 0.

    Newton's method on the logarithm of the fraction, in the power that keeps it on one side, between bounds.
    """
    p, q, turn = own[PAIR, POWER_OF], own[PAIR, SECOND_OF], own[PAIR, TURN]
    a, b = along * own[PAIR, GAIN] * p, along * own[PAIR, SECOND] * q
    p -= 1.0
    q -= 1.0
    begin, end = own[EDGE, piece], own[EDGE, piece + 1]
    low = FLOOR if begin == 0.0 else math.log(begin)
    high = 0.0 if end == 1.0 else math.log(end)
    at_low, at_high = slope + along * own[RISE, piece], slope + along * own[RISE, piece + 1]
    less = p if a < 0.0 else q
    if a < 0.0:  # it falls, up to the turning point if there is one
        if turn < high:
            high, at_high = turn, slope + along * own[PAIR, AT_TURN]
    elif turn > 0.0:
        return 0.0, 0.0
    elif turn > low:
        low, at_low = turn, slope + along * own[PAIR, AT_TURN]
    elif begin == 0.0:  # powers that hardly bend are not small there
        at_low = slope + a * math.exp(p * low) + b * math.exp(q * low)
    if not (low < high and at_low > 0.0 and at_high < 0.0):
        return 0.0, 0.0
    t = own[HEAD, LATEST]
    if not low < t < high:
        t = high
        if a < 0.0 and slope > 0.0:
            t = min(math.log(slope / -a) / p, high)
            if not t > low:
                t = 0.5 * (low + high)
    fall, settled = 0.0, False
    for _ in range(NEWTONS):
        first, second = a * math.exp(p * t), b * math.exp(q * t)
        miss, fall = slope + first + second, p * first + q * second
        if settled:
            break
        if miss > 0.0:
            low = t
        else:
            high = t
        inner = 1.0 - less * miss / fall
        step = math.log(inner) / less if inner > 1e-6 else -math.inf
        settled = abs(step) <= NEAR
        to = t + step
        if not low < to < high and not settled:
            to = 0.5 * (low + high)
        t = to
    own[HEAD, LATEST] = t
    u = math.exp(t)
    return u, -fall / u


@jit_part
def _highest(own, along, per):  # type: ignore[no-untyped-def]
    """Where a curve is highest along a normal, of reaches a newton and a fraction: fraction, force, and drop.

    The drop is minus the second derivative of the reach; 0 at corners.
    """
    best_u, best_force, drop = 0.0, own[FORCE, 0], 0.0
    best = along * best_force
    pieces, kind = int(own[HEAD, PIECES]), int(own[HEAD, KIND])
    for k in range(1, pieces + 1):
        reach = along * own[FORCE, k] + per * own[EDGE, k]
        if reach > best:
            best, best_u, best_force = reach, own[EDGE, k], own[FORCE, k]
    if kind == LINE:
        return best_u, best_force, drop
    for j in range(pieces):
        slope = per + along * own[RATE, j]
        u = steep = lift = 0.0
        if kind == CUBIC:
            b, c = own[HEAD, BEND], own[HEAD, TWIST]
            fall, third = -2.0 * along * b, 3.0 * along * c
            square = fall * fall - 4.0 * third * slope
            if square > 0.0:
                steep = math.sqrt(square)
                if fall > 0.0:
                    u = 2.0 * slope / (fall + steep)
                elif third != 0.0:
                    u = (fall - steep) / (2.0 * third)
                if not steep > FLAT_SLOPE * (abs(slope) + abs(fall)):
                    u = 0.0
                lift = u * u * (b + u * c)
        elif kind == POWER:
            fall, less = -along * own[PAIR, GAIN] * own[PAIR, POWER_OF], own[PAIR, POWER_OF] - 1.0
            share = slope / fall if fall > 0.0 else 0.0
            if 0.0 < share < 1.0:
                u = math.exp(math.log(share) / less)
                lift = own[PAIR, GAIN] * share * u
                steep = less * slope / u
        else:
            u, steep = _twin_peak(own, j, along, slope)
            if u > 0.0:
                lift = own[PAIR, GAIN] * u ** own[PAIR, POWER_OF] + own[PAIR, SECOND] * u ** own[PAIR, SECOND_OF]
        if own[EDGE, j] < u < own[EDGE, j + 1]:
            value = own[BASE, j] + own[RATE, j] * u + lift
            reach = along * value + per * u
            if reach > best:
                best, best_u, best_force, drop = reach, u, value, steep
    return best_u, best_force, drop


# ---- what lines touch: held (ROWS + normals, M + MORE, 2) -----------------------------------------


@jit_part
def _touch(nx, ny, scale, data, held):  # type: ignore[no-untyped-def]
    """Note, as NOW, where a line with a unit normal touches; the boundary's radius there, 0 at corners."""
    x = y = radius = 0.0
    actuators = len(data)
    for row in range(actuators):
        lever, offset = data[row, HEAD, LEVER], data[row, HEAD, OFFSET]
        along = scale * nx - offset * ny
        u, force, drop = _highest(data[row], along, lever * ny)
        held[NOW, row, 0], held[NOW, row, 1] = u, force
        x += scale * force
        y += lever * u - offset * force
        if drop > 0.0:
            arm = scale * lever / along
            radius += arm * arm / drop
    held[NOW, actuators + NORMAL, 0], held[NOW, actuators + NORMAL, 1] = nx, ny
    held[NOW, actuators + POINT, 0], held[NOW, actuators + POINT, 1] = x, y
    return radius


@jit_part
def _ties(scale, data, held, chosen, to, slack):  # type: ignore[no-untyped-def]
    """Note, of what was touched before (chosen), that which is as far along the normal as what is now; else this."""
    x = y = 0.0
    actuators = len(data)
    nx, ny = held[NOW, actuators + NORMAL, 0], held[NOW, actuators + NORMAL, 1]
    for row in range(actuators):
        lever, offset = data[row, HEAD, LEVER], data[row, HEAD, OFFSET]
        u, force = held[NOW, row, 0], held[NOW, row, 1]
        other, pull = held[chosen, row, 0], held[chosen, row, 1]
        if (scale * nx - offset * ny) * (pull - force) + lever * ny * (other - u) >= -slack:
            u, force = other, pull
        held[to, row, 0], held[to, row, 1] = u, force
        x += scale * force
        y += lever * u - offset * force
    held[to, actuators + NORMAL, 0], held[to, actuators + NORMAL, 1] = nx, ny
    held[to, actuators + POINT, 0], held[to, actuators + POINT, 1] = x, y


@jit_part
def _copy(held, source, target):  # type: ignore[no-untyped-def]
    for row in range(held.shape[1]):
        held[target, row, 0], held[target, row, 1] = held[source, row, 0], held[source, row, 1]


@jit_part
def _seen(x, y, held, place):  # type: ignore[no-untyped-def]
    """How far a point is over a line that touches, and to the left of where."""
    at = held.shape[1] - MORE
    nx, ny = held[place, at + NORMAL, 0], held[place, at + NORMAL, 1]
    from_x, from_y = x - held[place, at + POINT, 0], y - held[place, at + POINT, 1]
    return nx * from_x + ny * from_y, nx * from_y - ny * from_x


@jit_part
def _edge(held, begin, end):  # type: ignore[no-untyped-def]
    """The chord between two points: its components, and length."""
    at = held.shape[1] - MORE + POINT
    x, y = held[end, at, 0] - held[begin, at, 0], held[end, at, 1] - held[begin, at, 1]
    return x, y, math.sqrt(x * x + y * y)


@jit_part
def _between(x, y, held, begin, end):  # type: ignore[no-untyped-def]
    """Whether a direction lies between two normals, counter-clockwise of the first."""
    at = held.shape[1] - MORE + NORMAL
    return held[begin, at, 0] * y - held[begin, at, 1] * x > 0.0 and x * held[end, at, 1] - y * held[end, at, 0] > 0.0


@jit_part
def _known(held, place):  # type: ignore[no-untyped-def]
    """Whether there is a normal."""
    at = held.shape[1] - MORE + NORMAL
    return held[place, at, 0] != 0.0 or held[place, at, 1] != 0.0


@jit_part
def _halfway(held, begin, end):  # type: ignore[no-untyped-def]
    at = held.shape[1] - MORE + NORMAL
    return held[begin, at, 0] + held[end, at, 0], held[begin, at, 1] + held[end, at, 1]


# ---- searches --------------------------------------------------------------------------------


@jit_part
def _approach(x, y, nx, ny, tolerance, scale, data, held):  # type: ignore[no-untyped-def]
    """The nearest face, from a normal on, between LO's and HI's if any: found or not; how far outside the point is.

    Args:
        x, y: the point.
        nx, ny: the normal to start from.
        tolerance: what counts as nothing, as a length.
        scale: factor on force.
        data, held: the curves; what was touched. The face's ends are BEGIN and END.
    """
    slack = tolerance / len(data)
    before, near, tried = math.inf, False, 0
    for _ in range(ROUNDS):
        radius = _touch(nx, ny, scale, data, held)
        over, aside = _seen(x, y, held, NOW)
        if not (abs(over) < math.inf and abs(aside) < math.inf):
            return False, over
        distance = math.sqrt(over * over + aside * aside)
        close = aside * aside <= tolerance * (distance + abs(over))
        if close and (near or abs(aside) <= FINE * abs(over)):
            _copy(held, NOW, BEGIN)
            _copy(held, NOW, END)
            return True, distance if over > 0.0 else over
        if _known(held, LO) and _known(held, HI):
            # Along a face go to the end that is nearer, or stay.
            _ties(scale, data, held, LO, BEGIN, slack)
            _ties(scale, data, held, HI, END, slack)
            first, last = _seen(x, y, held, BEGIN)[1], _seen(x, y, held, END)[1]
            if first >= 0.0 >= last:
                return True, over
            if 0.0 < last < aside:
                _copy(held, END, NOW)
                aside, radius = last, 0.0
            elif aside < first < 0.0:
                _copy(held, BEGIN, NOW)
                aside, radius = first, 0.0
        near = close
        _copy(held, NOW, LO if aside > 0.0 else HI)
        # Newton's step: away from the centre of the arc that is touched.
        ahead = over + radius
        to_x, to_y = ahead * nx - aside * ny, ahead * ny + aside * nx
        fits = ahead > 0.0
        if _known(held, LO) and _known(held, HI):
            fits = fits and (abs(aside) <= CLOSING * before or near) and _between(to_x, to_y, held, LO, HI)
            if not fits:
                to_x, to_y = _chord(x, y, over > 0.0, tried, scale, data, held)
                if not _between(to_x, to_y, held, LO, HI):
                    to_x, to_y = _halfway(held, LO, HI)
                tried += 1
        elif not fits:
            return False, over
        before = abs(aside) if fits else math.inf
        size = math.sqrt(to_x * to_x + to_y * to_y)
        to_x, to_y = to_x / size, to_y / size
        near = near or (to_x == nx and to_y == ny)
        nx, ny = to_x, to_y
    return False, 0.0


@jit_part
def _chord(x, y, outside, tried, scale, data, held):  # type: ignore[no-untyped-def]
    """A normal between LO and HI: that of the chord of the curve that moves most, of the points' chord, or halfway."""
    if tried % 3 == 0:
        most = to_x = to_y = 0.0
        for row in range(len(data)):
            rise = held[HI, row, 1] - held[LO, row, 1]
            up = data[row, HEAD, LEVER] * (held[HI, row, 0] - held[LO, row, 0]) - data[row, HEAD, OFFSET] * rise
            if abs(scale * rise) + abs(up) > most:
                most, to_x, to_y = abs(scale * rise) + abs(up), up, -scale * rise
        return to_x, to_y
    if tried % 3 == 2:
        return _halfway(held, LO, HI)
    edge_x, edge_y, _ = _edge(held, LO, HI)
    at = len(data) + POINT
    from_x, from_y = x - held[LO, at, 0], y - held[LO, at, 1]
    foot = from_x * edge_x + from_y * edge_y
    if outside and foot <= 0.0:
        return from_x, from_y
    if outside and foot >= edge_x * edge_x + edge_y * edge_y:
        return from_x - edge_x, from_y - edge_y
    return edge_y, -edge_x


@jit_part
def _side(x, y, middle_x, middle_y, blur, scale, data, held):  # type: ignore[no-untyped-def]
    """Whether a point is inside (-1), on the boundary to within rounding (0), outside (1), or that is not known (2).

    Also a normal to search on from, outside, between LO's and HI's if these are known.
    """
    from_x, from_y = x - middle_x, y - middle_y
    size = math.sqrt(from_x * from_x + from_y * from_y)
    if size <= blur:
        return -1, 1.0, 0.0
    start_x, start_y = from_x / size, from_y / size
    nx, ny, turns = start_x, start_y, 0
    at = len(data) + POINT
    for place in (LO, HI):
        held[place, len(data) + NORMAL, 0] = held[place, len(data) + NORMAL, 1] = 0.0
    for _ in range(PORTALS):
        _touch(nx, ny, scale, data, held)
        over, aside = _seen(x, y, held, NOW)
        if over > 0.0:
            if math.sqrt(over * over + aside * aside) <= blur:
                return 0, nx, ny
            return 1, nx, ny
        if over <= 0.0 and aside == 0.0:
            return -1, nx, ny
        if not abs(aside) > 0.0:  # not a number
            return 2, nx, ny
        _copy(held, NOW, LO if aside > 0.0 else HI)
        if _known(held, LO) and _known(held, HI):
            edge_x, edge_y, length = _edge(held, LO, HI)
            nx, ny = edge_y / length, -edge_x / length
            beyond = nx * (x - held[LO, at, 0]) + ny * (y - held[LO, at, 1])
            if length == 0.0 or beyond <= 0.0:
                return -1, nx, ny
            if not _between(nx, ny, held, LO, HI):
                if beyond <= blur:
                    return 0, nx, ny
                nx, ny = _halfway(held, LO, HI)
        else:
            # One side only: square to what leads to the touched point, then as far as the normal sought may be.
            left = 1.0 if aside > 0.0 else -1.0
            if turns == 2:
                return -1, nx, ny
            turns += 1
            nx, ny = left * (middle_y - held[NOW, at, 1]), left * (held[NOW, at, 0] - middle_x)
            if turns == 2 or not start_x * nx + start_y * ny > 0.0:
                nx, ny, turns = -left * start_y, left * start_x, 2
        length = math.sqrt(nx * nx + ny * ny)
        nx, ny = nx / length, ny / length
    return 2, nx, ny


@jit_part
def _margin(x, y, held, place):  # type: ignore[no-untyped-def]
    """Note how far the boundary from one normal to the next is at least from a point inside: as far as the chord."""
    at = held.shape[1] - MORE
    edge_x, edge_y, length = _edge(held, place, int(held[place, at + LINK, 0]))
    far = math.inf  # a corner is nearest at its ends
    if length > 0.0:
        far = (edge_y * (held[place, at + POINT, 0] - x) - edge_x * (held[place, at + POINT, 1] - y)) / length
    held[place, at + MARGIN, 1] = far


@jit_part
def _nearest_chord(tolerance, held, best, count):  # type: ignore[no-untyped-def]
    """The normal behind which a chord is nearer than the best of normals is to its line; -1 if there is none."""
    at = held.shape[1] - MORE
    while True:
        place = ROWS
        for other in range(ROWS + 1, count):
            if held[other, at + MARGIN, 1] < held[place, at + MARGIN, 1]:
                place = other
        if not held[place, at + MARGIN, 1] < held[best, at + MARGIN, 0] - tolerance:
            return -1
        after = int(held[place, at + LINK, 0])
        edge_x, edge_y, _ = _edge(held, place, after)
        if _between(edge_y, -edge_x, held, place, after):
            return place
        held[place, at + MARGIN, 1] = math.inf  # too short a chord to say more than its ends do


@jit_part
def _inside(x, y, tolerance, scale, data, held):  # type: ignore[no-untyped-def]
    """The normal of the nearest face from inside, and how near that is: infinity, if it was not found."""
    at, best, count, place = len(data), ROWS, ROWS, -1
    while count < len(held):
        # Normals all round at first, then those of the nearest chords.
        if count < ROWS + SEEDS:
            angle = 2.0 * math.pi * (count - ROWS) / SEEDS
            nx, ny = math.cos(angle), math.sin(angle)
            before, after = ROWS + (count - ROWS - 1) % SEEDS, ROWS + (count - ROWS + 1) % SEEDS
        else:
            place = _nearest_chord(tolerance, held, best, count)
            if place < 0:
                break
            before, after = place, int(held[place, at + LINK, 0])
            edge_x, edge_y, length = _edge(held, before, after)
            nx, ny = edge_y / length, -edge_x / length
        _touch(nx, ny, scale, data, held)
        _copy(held, NOW, count)
        margin = -_seen(x, y, held, count)[0]
        if not margin < math.inf:
            return math.inf, nx, ny
        held[count, at + MARGIN, 0] = margin
        if margin < held[best, at + MARGIN, 0]:
            best = count
        held[count, at + LINK, 0], held[count, at + LINK, 1] = after, before
        count += 1
        if place >= 0:
            held[before, at + LINK, 0] = held[after, at + LINK, 1] = count - 1
            _margin(x, y, held, before)
            _margin(x, y, held, count - 1)
        elif count == ROWS + SEEDS:
            for seed in range(ROWS, count):
                _margin(x, y, held, seed)
    _copy(held, int(held[best, at + LINK, 1]), LO)
    _copy(held, int(held[best, at + LINK, 0]), HI)
    margin = held[best, at + MARGIN, 0] if count < len(held) else math.inf
    return margin, held[best, at + NORMAL, 0], held[best, at + NORMAL, 1]


@jit
def nearest(  # type: ignore[no-untyped-def]
    table, kinks, limit, bending, radii, scale, first, x, y, signed, square, inside, blur, converged, fraction, kinked
):
    """Where points stand to sums of M curves at B sections, with L points a section.

    Args:
        table: (6 + 2K, M, B) the laws, over pressures: four coefficients, K kinks, K slopes, a gain and an exponent.
        kinks: K.
        limit, bending, radii: (M, B) pressure limits, bending moments at these, and radii.
        scale: (2) factors on force and moment.
        first: (B) sections whose curves are subtracted; empty: none.
        x, y: (B, L) points, scaled.
        signed: whether margins are asked for.
        square, inside, blur, converged: (B, L), as of `NearestFaces`, and whether that is so: written.
        fraction: (2, M, B, L) pressure fractions at the nearest faces' ends, or nothing (0, M, B, L): written.
        kinked: (2, M, B, L) whether these are at a kink: written.
    """
    actuators = len(limit)
    data = np.zeros((actuators, FIELDS, max(2 * kinks + 2, PAIRS)))
    work = np.zeros((2 * kinks + 5, 4))
    held = np.zeros((ROWS + (NORMALS if signed else 0), actuators + MORE, 2))
    relative, wanted, factor = len(first) > 0, len(fraction) > 0, scale[0]
    for section in range(limit.shape[1]):
        other = first[section] if relative else -1
        middle_x = middle_y = width = 0.0
        for row in range(actuators):
            low, high = _describe(table, kinks, limit, row, section, other, data, work)
            lever = bending[row, section]
            if relative:
                lever -= bending[row, other]
            lever, offset = scale[1] * lever, scale[1] * radii[row, section]
            data[row, HEAD, LEVER], data[row, HEAD, OFFSET], data[row, HEAD, LATEST] = lever, offset, 1.0
            total = 0.5 * (data[row, FORCE, 0] + data[row, FORCE, int(data[row, HEAD, PIECES])])
            middle_x += factor * total
            middle_y += 0.5 * lever - offset * total
            width += 2.0 * ((factor + abs(offset)) * (high - low) + abs(lever))
        for load in range(x.shape[1]):
            px, py = x[section, load], y[section, load]
            size = width + abs(middle_x) + abs(middle_y) + abs(px) + abs(py)
            rounding, tolerance = BLUR * size, GAP * size
            side, nx, ny, margin, distance = 2, 1.0, 0.0, 0.0, 0.0
            if size < math.inf:
                side, nx, ny = _side(px, py, middle_x, middle_y, rounding, factor, data, held)
            if signed and side == -1:
                margin, nx, ny = _inside(px, py, tolerance, factor, data, held)
            if side == 1 or (signed and side == -1):
                done, distance = _approach(px, py, nx, ny, tolerance, factor, data, held)
                if not (done and (distance > 0.0 if side == 1 else abs(distance + margin) <= 2.0 * tolerance)):
                    side, distance = 2, math.nan
            elif side == 2:
                distance = math.nan
            blur[section, load] = rounding
            square[section, load] = distance * distance
            inside[section, load], converged[section, load] = side == -1, side != 2
            if wanted and (side == 1 or (signed and side == -1)):
                for end in range(2):
                    for row in range(actuators):
                        u = held[BEGIN + end, row, 0]
                        fraction[end, row, section, load] = u
                        for k in range(1, int(data[row, HEAD, PIECES])):
                            if u == data[row, EDGE, k]:
                                kinked[end, row, section, load] = True
