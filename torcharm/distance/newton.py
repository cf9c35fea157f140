"""From polygons to the sets they were sampled from, by Newton's method on the normal.

The distance from w to a convex set with support function h is `max_n n·w - h(n)` over unit vectors n; inside,
its negative is the least `h(n) - n·w`. Where a line with normal n touches the set, at s, the derivative in
the normal's angle is `t·(w - s)` with t to the left of n, and the second one minus the distance to s along n and the
boundary's radius of curvature there. The search is bracketed by what was touched clockwise and counter-clockwise of the
nearest point: Newton's steps close in where the boundary is curved; between the two lies a face where it is
straight. `n·(w - s)` and `|w - s|` are bounds on the distance: their gap says when it is found.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torcharm._select import pick
from torcharm.distance.touch import CurveSums, Touch

ROUNDS = 24
FEWER, FEW = 0.6, 200
"""Below this share of those left the ones that are done are left out, unless so few are left that it costs more."""
HEAD = 5
"""Rows of what is known of an end before those of its actuators."""
CLOSING, AFTER_CHORD = 0.25, 4.0
"""Factor by which a step must bring the touched point nearer to straight ahead; and by how much less after a chord."""
STRAIGHTER = 0.4
"""Between its ends a boundary that bends less than by this share of its bend at one of them has a face."""
MOST_INSIDE = 0.1
"""The largest turn from inside, where there may be many faces about as near."""
FIRST_TURN, WIDEN = 1e-3, 8.0
"""The turn of a direction where Newton's step makes no sense [rad], and its growth until it does."""


@dataclass(frozen=True)
class Problems:
    """Q searches for a nearest point.

    Attributes:
        point: (2, Q) x and y.
        normal: (2, Q) outward unit vectors to start from, those of a polygon inside the set.
        side: (Q) 1 outside the polygon and -1 inside.
        distance: (Q) to it.
        tolerance: (Q) what counts as nothing, as a length.
        edge: (Q) whether the polygon's nearest point lies inside an edge.
        ends: (2, 2, Q) ends of the nearest edge, clockwise first, and x and y.
    """

    point: Tensor
    normal: Tensor
    side: Tensor
    distance: Tensor
    tolerance: Tensor
    edge: Tensor
    ends: Tensor


@dataclass(frozen=True)
class Found:
    """What came of Q problems.

    Attributes:
        square: (Q) squared distances; meaningless unless done.
        inside: (Q).
        fraction: (2, M, Q) pressure fractions at both ends of the nearest faces, if asked for.
        done: (Q).
    """

    square: Tensor
    inside: Tensor
    fraction: Tensor | None
    done: Tensor


@dataclass(frozen=True)
class _Search:
    """Where searches stand.

    Attributes:
        curves: theirs.
        given: (4, q) the points' x and y, their side and their tolerance.
        best: (3, q) the furthest over a line that touches they were seen, and its normal.
        number: (q) which they are.
        normal: (2, q) to try next.
        ends: (2, R, q) what was last touched clockwise and counter-clockwise of the answers: x and y, the normals
            (0: nothing), the boundary's radius, and of M actuators the parts of x and of y and the fractions.
        chord: (q) whether the normal is that of the chord between the two.
        pace: (2, q) how far off to a side the last touched point was; and the next turn where Newton's step makes no
            sense [rad].
        live: (q) whether it is not done.
    """

    curves: CurveSums
    given: Tensor
    best: Tensor
    number: Tensor
    normal: Tensor
    ends: Tensor
    chord: Tensor
    pace: Tensor
    live: Tensor


def solve(problems: Problems, curves: CurveSums, *, fractions: bool) -> Found:
    """Search for all nearest points at once, those that are done left out."""
    x, actuators = problems.side, len(curves.radii)
    none, no = torch.zeros_like(x), torch.zeros_like(x, dtype=torch.bool)
    found = Found(none.clone(), no, x.new_zeros(2, actuators, len(x)) if fractions else None, no.clone())
    normals = problems.normal.clone()
    search = _begin(problems, curves)
    for count in range(ROUNDS):
        search, hit = _round(search, problems if count == 0 else None)
        fresh = (hit.done & search.live).nonzero().squeeze(-1)
        if len(fresh):
            number = search.number[fresh]
            found.square[number] = hit.distance[fresh].square()
            found.inside[number], found.done[number] = hit.over[fresh] < 0, True
            if found.fraction is not None:
                found.fraction[:, :, number] = torch.stack((hit.touch.u, hit.other)).index_select(-1, fresh)
                normals[:, number] = search.normal.index_select(-1, fresh)
            live = search.live.index_fill(0, fresh, False)
            left = live.nonzero().squeeze(-1)
            if not len(left):
                break
            search = replace(search, live=live)
            if len(live) > FEW and len(left) < FEWER * len(live):
                search, hit = pick(search, left), pick(hit, left)
        search = _turned(search, hit)
    if found.fraction is not None:
        # Where both ends are one, the fractions of the last normal are nearer still.
        again = curves.touch(normals).u
        found.fraction.copy_(torch.where((found.fraction[0] == found.fraction[1]).all(0), again, found.fraction))
    return found


def _begin(p: Problems, curves: CurveSums) -> _Search:
    """Nothing touched yet; the polygon's edge in place of it."""
    count = p.point.shape[1]
    given = torch.cat((p.point, torch.stack((p.side, p.tolerance))))
    best = torch.cat((torch.full_like(p.side, -torch.inf)[None], p.normal))
    ends = p.point.new_full((2, HEAD + 3 * len(curves.radii), count), torch.nan)
    ends[:, :2], ends[:, 2:HEAD] = p.ends, 0
    number = torch.arange(count, device=p.point.device)
    pace = p.point.new_tensor((torch.finfo(p.point.dtype).max, FIRST_TURN)).unsqueeze(-1).expand(2, count)
    return _Search(curves, given, best, number, p.normal, ends, p.edge, pace, torch.ones_like(p.edge))


@dataclass(frozen=True)
class _Hit:
    """What came of a round.

    Attributes:
        touch: with the fractions at one end of the nearest face.
        other: (M, q) those at the other.
        over, aside: (q) the points from where sets were touched, along the normals and to the left of them.
        distance: (q).
        done: (q) whether that is it.
    """

    touch: Touch
    other: Tensor
    over: Tensor
    aside: Tensor
    distance: Tensor
    done: Tensor


def _round(s: _Search, first: Problems | None) -> tuple[_Search, _Hit]:
    """Touch the sets once."""
    _, _, side, tolerance = s.given
    nx, ny = s.normal
    chords = bool(s.chord.any())
    touch = s.curves.touch(s.normal, tolerance if chords else None)
    entry = torch.cat((touch.point, s.normal, touch.radius[None], touch.parts.flatten(0, 1), touch.u))
    from_x, from_y = s.given[:2] - touch.point
    over, aside, other = _dot(nx, ny, from_x, from_y), nx * from_y - ny * from_x, touch.u
    if touch.face is not None:
        entry, aside, other = _along_face(s, touch, touch.face, entry, aside)
        from_x, from_y = s.given[:2] - entry[:2]
        over = _dot(nx, ny, from_x, from_y)
    distance, deep = torch.hypot(over, aside), over.abs()
    done = aside * aside <= tolerance * (distance + deep)
    if touch.rest is not None:
        done = done & (touch.rest <= tolerance)
    # The distance is the most that points are seen over a line that touches.
    most, best_x, best_y = s.best
    behind = over < most - tolerance
    done = done & ~behind & ((side > 0) | (over <= tolerance))
    # Where they are less over it than over another, the answer is on that one's side.
    ahead = torch.where(behind, nx * best_y - ny * best_x, aside).unsqueeze(0) > 0
    far = _polygon_end(s, entry, aside, first) if first is not None else s.ends
    further = over > most if touch.rest is None else (over > most) & (touch.rest <= tolerance)
    best = torch.where(further, torch.stack((over, nx, ny)), s.best)
    s = replace(s, best=best, ends=torch.where(torch.cat((ahead, ~ahead)).unsqueeze(1), entry, far))
    touch = replace(touch, u=entry[-len(other) :], face=None)
    return s, _Hit(touch, other, over, aside, distance, done)


def _along_face(
    s: _Search, touch: Touch, face: tuple[Tensor, ...], entry: Tensor, aside: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Of what was touched the point nearest to being ahead, how far it is aside, and fractions at the other end.

    Sets may be touched along a face: because curves are twice, or because the chord between the ends has nothing beyond
    it.
    """
    actuators = len(touch.u)
    nx, ny = s.normal
    low, high, low_u, high_u = face
    least, most = low.sum(0), high.sum(0)
    above, below = aside > most, aside < least
    own, u = torch.where(above, high, low), torch.where(above, high_u, low_u)
    on = ~(above | below)
    shift = torch.where(on, aside, own.sum(0))
    moved = torch.cat((-ny * shift, nx * shift))
    entry = torch.cat(
        (
            entry[:2] + moved.view(2, -1),
            entry[2:HEAD],
            entry[HEAD : HEAD + actuators] - ny * own,
            entry[HEAD + actuators : HEAD + 2 * actuators] + nx * own,
            u,
        )
    )
    aside, other = aside - shift, torch.where(on, high_u, u)

    (a, b), (x, y) = s.ends, s.given[:2]
    behind = nx * (entry[0] - s.ends[:, 0]) + ny * (entry[1] - s.ends[:, 1])
    touched = ~s.ends[:, -1].isnan().any(0) & (s.ends[:, 2:4] != 0).any(1).all(0)
    flat = s.chord & ~on & (behind.amax(0) <= s.given[3]) & touched
    if bool(flat.any()):
        beside_a, beside_b = nx * (y - a[1]) - ny * (x - a[0]), nx * (y - b[1]) - ny * (x - b[0])
        end = torch.where(beside_b > 0, b, a)
        entry = torch.where(flat, torch.cat((end[:2], s.normal, end[4:])), entry)
        on = flat & (beside_a >= 0) & (beside_b <= 0)
        other = torch.where(flat, torch.where(on, b[-actuators:], end[-actuators:]), other)
        aside = torch.where(flat, torch.where(on, 0.0, torch.where(beside_b > 0, beside_b, beside_a)), aside)
    return entry, aside, other


def _polygon_end(s: _Search, entry: Tensor, aside: Tensor, p: Problems) -> Tensor:
    """The polygon's ends, as if touched where the normal has turned twice as far as to the chord's; on arcs, thrice."""
    nx, ny = s.normal
    dx, dy = torch.where(aside > 0, p.ends[1], p.ends[0]) - entry[:2]
    along, drop = nx * dy - ny * dx, -_dot(nx, ny, dx, dy)
    held = (along * aside > 0) & (drop > s.given[3])
    turn = torch.complex(along.abs(), drop * along.sign()).sgn()
    twice = turn * turn
    normal = torch.complex(nx, ny) * torch.where(entry[4] > 0, twice * turn, twice)
    ends = s.ends.clone()
    ends[:, 2:4] = torch.where(held, torch.view_as_real(normal).T, 0.0)
    return ends


def _turned(s: _Search, hit: _Hit) -> _Search:
    """Where to look next.

    By Newton's step, as long as it stays between the ends and closes in. Else along the normal of the face between the
    ends, or straight away from one if the point, outside, is past it. Newton's step sees the boundary as an arc, and
    makes no sense from inside it beyond its centre.
    """
    over, aside, far = hit.over, hit.aside, hit.aside.abs()
    before, turn = s.pace
    steep = over + hit.touch.radius
    newton = (over > 0) | (steep > far)
    step = s.curves.turn(hit.touch, aside / steep, steep)
    step = torch.where(over < 0, step.clamp(-MOST_INSIDE, MOST_INSIDE), step)
    across = torch.where(newton, step, turn * aside.sign())
    nx, ny = s.normal
    next_x, next_y = torch.addcmul(nx, across, ny, value=-1), torch.addcmul(ny, across, nx)

    e = _Ends.of(s)
    (face_x, face_y), straight = _face(s, e, over)
    past = _dot(face_x, face_y, next_x, next_y) * aside > 0
    clockwise, counter = e.normal_x * next_y - e.normal_y * next_x
    closing = (clockwise > 0) & (counter < 0) & (far < CLOSING * before)
    stuck = e.known & ~(closing & ~(straight & past))
    (ax, bx), (ay, by) = e.from_x, e.from_y
    foot = _dot(ax, ay, e.dx, e.dy)
    first = foot <= 0
    corner = stuck & (over > 0) & (e.dy * ax >= e.dx * ay) & (first | (foot >= e.span))
    chord = stuck & ~corner & (e.span > 0)
    # Away from the centre of an end's arc, as seen from the point.
    (ax, bx), (ay, by) = torch.addcmul(e.from_x, e.radius, e.normal_x), torch.addcmul(e.from_y, e.radius, e.normal_y)
    next_x = torch.where(corner, torch.where(first, ax, bx), torch.where(chord, face_y, next_x))
    next_y = torch.where(corner, torch.where(first, ay, by), torch.where(chord, -face_x, next_y))
    normal = torch.stack((next_x, next_y)) / torch.hypot(next_x, next_y)
    pace = torch.stack((torch.where(chord, AFTER_CHORD * far, far), torch.where(newton, FIRST_TURN, turn * WIDEN)))
    return replace(s, normal=normal, chord=chord, pace=pace)


@dataclass(frozen=True)
class _Ends:
    """What is known of both ends, (2, q) each, and of the chord between them, (q) each.

    Attributes:
        normal_x, normal_y, radius: as of `_Search`.
        from_x, from_y: the points from the ends.
        chord: (R, q) all that changes from the first to the second.
        dx, dy, span: the chord and its square.
        known: whether both ends are.
    """

    normal_x: Tensor
    normal_y: Tensor
    radius: Tensor
    from_x: Tensor
    from_y: Tensor
    chord: Tensor
    dx: Tensor
    dy: Tensor
    span: Tensor
    known: Tensor

    @classmethod
    def of(cls, s: _Search) -> "_Ends":
        x, y, normal_x, normal_y, radius = s.ends[:, :HEAD].unbind(1)
        a, b = s.ends
        chord = b - a
        dx, dy = chord[:2]
        known = ((normal_x != 0) | (normal_y != 0)).all(0)
        span = _dot(dx, dy, dx, dy)
        return cls(normal_x, normal_y, radius, s.given[0] - x, s.given[1] - y, chord, dx, dy, span, known)


def _dot(x: Tensor, y: Tensor, other_x: Tensor, other_y: Tensor) -> Tensor:
    return torch.addcmul(x * other_x, y, other_y)


def _face(s: _Search, e: _Ends, over: Tensor) -> tuple[tuple[Tensor, Tensor], Tensor]:
    """Faces that may lie between ends, as edges, and whether (q) one is to be expected.

    They are the chords of the actuator that is moved most, or else the whole chords. A face is expected
    where the boundary bends less on the way than it would as the arc of the rounder end.
    """
    (drop_a, drop_b), (round_a, round_b) = _dot(e.normal_x, e.normal_y, e.dx, e.dy), e.radius
    drop = torch.where(round_a >= round_b, drop_a, drop_b).abs()
    straight = drop * (torch.maximum(round_a, round_b) + over.clamp(min=0)) < STRAIGHTER / 2 * e.span
    actuators = len(s.curves.radii)
    jumps = e.chord[HEAD : HEAD + 2 * actuators].view(2, actuators, -1)
    jumps = s.curves.jumps(jumps, *s.ends[:, HEAD + 2 * actuators :])
    x, y = jumps.gather(1, jumps.abs().sum(0).max(0).indices.expand(2, 1, -1)).squeeze(1)
    # An edge turns left of the normals clockwise of its own.
    rise_a, rise_b = _dot(e.normal_x, e.normal_y, x, y)
    between = (rise_a < 0) & (rise_b > 0)
    return (torch.where(between, x, e.dx), torch.where(between, y, e.dy)), straight
