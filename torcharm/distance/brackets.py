"""Newton's method on the normal, bracketed, for what it does not reach alone: over faces, corners, and from inside.

The search is bracketed by what was touched clockwise and counter-clockwise of the nearest point: Newton's steps close
in where the boundary is curved; between the two lies a face where it is straight.
"""

from dataclasses import dataclass, replace

import numpy as np

from torcharm._arrays import Array, pick
from torcharm.distance.problems import Found, Problems
from torcharm.distance.touch import CurveSums, Touch

FEWER, MANY = 0.75, 200
"""Below this share of those left the ones that are done are left out, of so many that it pays."""
ROUNDS = 24
HEAD = 5
"""Rows of what is known of an end before those of its actuators."""
CLOSING, ACROSS, AFTER_CHORD = 0.25, 0.9, 4.0
"""Factors by which a step must bring the touched point nearer to straight ahead, on the same side of that or on the
other; and by how much less after a chord."""
STRAIGHTER = 0.4
"""Between its ends a boundary that bends less than by this share of its bend at one of them has a face."""
MOST_INSIDE = 0.1
"""The largest turn from inside, where there may be many faces about as near."""
FIRST_TURN, WIDEN = 1e-3, 8.0
"""The turn of a direction where Newton's step makes no sense [rad], and its growth until it does."""


@dataclass(frozen=True)
class _Search:
    """Where searches stand.

    Attributes:
        curves: theirs.
        x, y, side, tolerance: (q) as of `Problems`.
        most: (q) no point is further away, outside.
        best: (3, q) the furthest over a line that touches they were seen, and its normal.
        number: (q) which they are.
        nx, ny: (q) the normal to try next.
        ends: (2, R, q) what was last touched clockwise and counter-clockwise of the answers: x and y, the normals
            (0: nothing), the boundary's radius, and of M actuators the fractions and the forces. At first the
            polygon's.
        chord: (q) whether the normal is that of the chord between the two.
        before: (q) how far to the left of the last touched points the searched ones were.
        widest: (q) the next turn where Newton's step makes no sense [rad].
    """

    curves: CurveSums
    x: Array
    y: Array
    side: Array
    tolerance: Array
    most: Array
    best: Array
    number: Array
    nx: Array
    ny: Array
    ends: Array
    chord: Array
    before: Array
    widest: Array


@dataclass(frozen=True)
class _Hit:
    """What came of a round.

    Attributes:
        touch: with the fractions and forces at one end of the nearest face.
        other: (M, q) fractions at the other.
        over, aside: (q) the points from where sets were touched, along the normals and to the left of them.
        behind: (q) whether they were seen further over another line.
        distance: (q).
        done: (q) whether that is it.
    """

    touch: Touch
    other: Array
    over: Array
    aside: Array
    behind: Array
    distance: Array
    done: Array


def search(problems: Problems, curves: CurveSums, found: Found, numbers: Array, first: Touch) -> None:
    """Search for those that are left over, and put what is found in their places.

    Args:
        problems, curves: those.
        found: of all.
        numbers: where in it they are.
        first: what their first normals touch.
    """
    state = _begin(problems, curves, numbers, bounded=found.fraction is None)
    for count in range(ROUNDS):
        going = ~found.done[state.number]
        hit = _judged(state, first if count == 0 else state.curves.touch(state.nx, state.ny), going)
        fresh = (hit.done & going).nonzero()[0]
        if len(fresh):
            number = state.number[fresh]
            found.square[number] = np.square(hit.distance[fresh])
            found.inside[number], found.done[number] = hit.over[fresh] < 0, True
            if found.fraction is not None:
                found.fraction[0][:, number] = hit.touch.u[:, fresh]
                found.fraction[1][:, number] = hit.other[:, fresh]
            left = (~found.done[state.number]).nonzero()[0]
            if not len(left):
                break
            if len(hit.done) > MANY and len(left) < FEWER * len(hit.done):
                state, hit = pick((state, hit), left)
        state = _noted(state, hit, first=count == 0)
        state = _turned(state, hit)


def _begin(p: Problems, curves: CurveSums, number: Array, *, bounded: bool) -> _Search:
    """Nothing touched yet; the polygon's edge in place of it. Bounded: its distance is an answer, though of no face."""
    count = len(p.side)
    best = np.concatenate((np.full_like(p.side, -np.inf)[None], p.normal))
    ends = np.full((2, HEAD + 2 * len(curves.radii), count), np.nan, p.side.dtype)
    ends[:, :2], ends[:, 2:HEAD] = p.ends, 0
    before, widest = np.full_like(p.side, np.inf), np.full_like(p.side, FIRST_TURN)
    most = np.where(p.side > 0, p.distance, np.inf) if bounded else before
    x, y = p.point
    nx, ny = p.normal
    return _Search(curves, x, y, p.side, p.tolerance, most, best, number, nx, ny, ends, p.edge, before, widest)


def _judged(s: _Search, touch: Touch, going: Array) -> _Hit:
    """What was touched, as an answer: the distance is the most that points are seen over a line that touches.

    Args:
        s: the searches.
        touch: what their normals touch.
        going: (q) which are not done yet.
    """
    nx, ny = touch.nx, touch.ny
    from_x, from_y = s.x - touch.x, s.y - touch.y
    over, aside, other = nx * from_x + ny * from_y, nx * from_y - ny * from_x, touch.u
    met = np.abs(s.most - over) <= s.tolerance
    faces = (touch.margin <= s.tolerance).any(0) & ~met & going
    chords = s.chord & ~met & going
    if faces.any() or chords.any():
        other = other.copy()
        on = np.zeros_like(faces)
        _along_face(s, faces.nonzero()[0], touch, other, aside, on)
        _along_chord(s, (chords & ~on).nonzero()[0], touch, other, over, aside)
    squared = aside * aside
    distance = np.sqrt(over * over + squared)
    done = squared <= s.tolerance * (distance + np.abs(over))
    distance = np.where(done, distance, s.most)
    done |= met
    behind = over < s.best[0] - s.tolerance
    done &= ~behind
    done &= (s.side > 0) | (over <= s.tolerance)
    if touch.rest is not None:
        done &= touch.rest <= s.tolerance
    return _Hit(touch, other, over, aside, behind, distance, done)


def _along_face(s: _Search, index: Array, touch: Touch, other: Array, aside: Array, on: Array) -> None:
    """Where sets are touched along a face because curves are twice: go to its point nearest to being ahead.

    Args:
        s: the searches.
        index: which of them; of few, all are taken, as of the others nothing else is within slack.
        touch, other, aside: as of `_Hit`, to be changed.
        on: (q) whether the nearest point is on the face, to be set.
    """
    if not len(index):
        return
    few, curves = touch, s.curves
    if len(aside) > MANY:
        few, curves = pick((touch, curves), index)
    else:
        index = np.arange(len(aside))
    nx, ny, ahead = few.nx, few.ny, aside[index]
    low, high, low_u, high_u, low_force, high_force = curves.spread(few, s.tolerance[index])
    least, most = low.sum(0), high.sum(0)
    above = ahead > most
    inside = ~(above | (ahead < least))
    shift = np.where(inside, ahead, np.where(above, most, least))
    touch.x[index] -= ny * shift
    touch.y[index] += nx * shift
    touch.u[:, index] = u = np.where(above, high_u, low_u)
    touch.force[:, index] = np.where(above, high_force, low_force)
    other[:, index] = np.where(inside, high_u, u)
    aside[index] = ahead - shift
    on[index] = inside


def _along_chord(s: _Search, index: Array, touch: Touch, other: Array, over: Array, aside: Array) -> None:
    """The same where the chord between the ends has nothing beyond it."""
    if not len(index):
        return
    actuators = len(touch.u)
    a, b = s.ends[:, :, index]
    nx, ny, slack = touch.nx[index], touch.ny[index], s.tolerance[index]
    x, y = touch.x[index], touch.y[index]
    beyond = np.maximum(nx * (x - a[0]) + ny * (y - a[1]), nx * (x - b[0]) + ny * (y - b[1]))
    flat = ((beyond <= slack) & ~np.isnan(a[-1] + b[-1]) & _known(a) & _known(b)).nonzero()[0]
    if not len(flat):
        return
    index, a, b, nx, ny = index[flat], a[:, flat], b[:, flat], nx[flat], ny[flat]
    x, y = s.x[index], s.y[index]
    beside_a, beside_b = nx * (y - a[1]) - ny * (x - a[0]), nx * (y - b[1]) - ny * (x - b[0])
    last = beside_b > 0
    end = np.where(last, b, a)
    inside = (beside_a >= 0) & ~last
    touch.x[index], touch.y[index], touch.radius[index] = end[0], end[1], end[4]
    touch.u[:, index], touch.force[:, index] = end[HEAD : HEAD + actuators], end[HEAD + actuators :]
    other[:, index] = np.where(inside, b[HEAD : HEAD + actuators], end[HEAD : HEAD + actuators])
    over[index] = nx * (x - end[0]) + ny * (y - end[1])
    aside[index] = np.where(inside, 0.0, np.where(last, beside_b, beside_a))


def _closer(aside: Array, before: Array) -> Array:
    """Whether (q) touched points are enough nearer to straight ahead than those before."""
    near: Array = np.abs(aside) < np.where(aside * before < 0, ACROSS, CLOSING) * np.abs(before)
    return near


def _known(end: Array) -> Array:
    """Whether (q) an end (R, q) has a normal."""
    known: Array = (end[2] != 0) | (end[3] != 0)
    return known


def _noted(s: _Search, hit: _Hit, *, first: bool) -> _Search:
    """With what was touched as one of the ends; where points are further over another, that one's side tells which."""
    over, touch = hit.over, hit.touch
    nx, ny = touch.nx, touch.ny
    most, best_x, best_y = s.best
    ahead = np.where(hit.behind, nx * best_y - ny * best_x, hit.aside) > 0
    entry = np.concatenate((touch.x[None], touch.y[None], nx[None], ny[None], touch.radius[None], touch.u, touch.force))
    far = _polygon_ends(s, hit) if first else s.ends
    further = over > most
    if touch.rest is not None:
        further &= touch.rest <= s.tolerance
    best = np.where(further, np.stack((over, nx, ny)), s.best)
    return replace(s, best=best, ends=np.where(np.stack((ahead, ~ahead))[:, None], entry, far))


def _polygon_ends(s: _Search, hit: _Hit) -> Array:
    """The polygon's ends, as if touched where the normal has turned twice as far as to the chord's; on arcs, thrice."""
    touch = hit.touch
    nx, ny = touch.nx, touch.ny
    left = hit.aside > 0
    dx, dy = (np.where(left, s.ends[1, row], s.ends[0, row]) - value for row, value in enumerate((touch.x, touch.y)))
    along, drop = nx * dy - ny * dx, -(nx * dx + ny * dy)
    held = (along * hit.aside > 0) & (drop > s.tolerance)
    turn = np.abs(along) + 1j * (drop * np.sign(along))
    turn /= np.abs(turn)
    normal = (nx + 1j * ny) * np.where(touch.radius > 0, turn * turn * turn, turn * turn)
    ends = s.ends.copy()
    ends[:, 2], ends[:, 3] = np.where(held, normal.real, 0.0), np.where(held, normal.imag, 0.0)
    return ends


def _turned(s: _Search, hit: _Hit) -> _Search:
    """Where to look next.

    By Newton's step, as long as it stays between the ends and closes in. Else along the normal of the face between the
    ends, or straight away from one if the point, outside, is past it. Newton's step sees the boundary as an arc, and
    makes no sense from inside it beyond its centre.
    """
    nx, ny, over, aside = hit.touch.nx, hit.touch.ny, hit.over, hit.aside
    far, outside = np.abs(aside), over > 0
    steep = over + hit.touch.radius
    newton = outside | (steep > far)
    step = s.curves.turn(hit.touch, aside / steep, steep)
    if not outside.all():
        step = np.where(over < 0, step.clip(-MOST_INSIDE, MOST_INSIDE), step)
    across = np.where(newton, step, s.widest * np.sign(aside))
    next_x: Array = nx - across * ny
    next_y: Array = ny + across * nx

    (ax, ay, a_nx, a_ny, a_radius), (bx, by, b_nx, b_ny, b_radius) = s.ends[:, :HEAD]
    dx, dy = bx - ax, by - ay
    span = dx * dx + dy * dy
    face_x, face_y, straight = _face(s, dx, dy, span, over)
    past = (face_x * next_x + face_y * next_y) * aside > 0
    clockwise, counter = a_nx * next_y - a_ny * next_x, b_nx * next_y - b_ny * next_x
    closing = (clockwise > 0) & (counter < 0) & _closer(aside, s.before)
    stuck = _known(s.ends[0]) & _known(s.ends[1]) & ~(closing & ~(straight & past))
    from_ax, from_ay, from_bx, from_by = s.x - ax, s.y - ay, s.x - bx, s.y - by
    foot = from_ax * dx + from_ay * dy
    first = foot <= 0
    corner = stuck & outside & (dy * from_ax >= dx * from_ay) & (first | (foot >= span))
    chord = stuck & ~corner & (span > 0)
    # Away from the centre of an end's arc, as seen from the point.
    away_x = np.where(first, from_ax + a_radius * a_nx, from_bx + b_radius * b_nx)
    away_y = np.where(first, from_ay + a_radius * a_ny, from_by + b_radius * b_ny)
    next_x = np.where(corner, away_x, np.where(chord, face_y, next_x))
    next_y = np.where(corner, away_y, np.where(chord, -face_x, next_y))
    length = np.sqrt(next_x * next_x + next_y * next_y)
    return replace(
        s,
        nx=next_x / length,
        ny=next_y / length,
        chord=chord,
        before=np.where(chord, AFTER_CHORD * aside, aside),
        widest=np.where(newton, FIRST_TURN, s.widest * WIDEN),
    )


def _face(s: _Search, dx: Array, dy: Array, span: Array, over: Array) -> tuple[Array, Array, Array]:
    """Faces that may lie between ends, as edges, and whether (q) one is to be expected.

    They are the chords of the actuator that is moved most, or else the whole chords (dx, dy). A face is expected
    where the boundary bends less on the way than it would as the arc of the rounder end.
    """
    actuators = len(s.curves.radii)
    (_, _, a_nx, a_ny, a_radius), (_, _, b_nx, b_ny, b_radius) = s.ends[:, :HEAD]
    rounder = a_radius >= b_radius
    drop = np.where(rounder, a_nx * dx + a_ny * dy, b_nx * dx + b_ny * dy)
    straight = np.abs(drop) * (np.maximum(a_radius, b_radius) + np.maximum(over, 0)) < STRAIGHTER / 2 * span
    (first, last), force = s.ends[:, HEAD : HEAD + actuators], s.ends[:, HEAD + actuators :]
    x, y = s.curves.jumps(first, last, force[1] - force[0])
    most = (np.abs(x) + np.abs(y)).argmax(0) * x.shape[1] + np.arange(x.shape[1])
    x, y = x.reshape(-1)[most], y.reshape(-1)[most]
    # An edge turns left of the normals clockwise of its own.
    between = (a_nx * x + a_ny * y < 0) & (b_nx * x + b_ny * y > 0)
    return np.where(between, x, dx), np.where(between, y, dy), straight
