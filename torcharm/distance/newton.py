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
CLOSING = 0.25
"""Factor by which a step must bring the touched point nearer to straight ahead."""
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
    rest = p.point.new_zeros(2, HEAD - 2 + 3 * len(curves.radii), count)
    ends = torch.cat((p.ends, rest), 1)
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
    x, y, side, tolerance = s.given
    nx, ny = s.normal
    chords = bool(s.chord.any())
    touch = s.curves.touch(s.normal, tolerance if chords else None)
    entry = torch.cat((touch.point, s.normal, touch.radius[None], touch.parts.flatten(0, 1), touch.u))
    aside, other = nx * (y - entry[1]) - ny * (x - entry[0]), touch.u
    if touch.face is not None:
        entry, aside, other = _along_face(s, touch, touch.face, entry, aside)
    over = nx * (x - entry[0]) + ny * (y - entry[1])
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
    end = torch.where(aside > 0, p.ends[1], p.ends[0])
    dx, dy = end - entry[:2]
    along, drop = nx * dy - ny * dx, -(nx * dx + ny * dy)
    held = (along * aside > 0) & (drop > s.given[3])
    length = torch.hypot(along, drop) + 1 - held.to(along.dtype)
    cos, sin = along.abs() / length, drop * along.sign() / length
    arc = entry[4] > 0
    cos, sin = (
        held * torch.where(arc, 4 * cos**3 - 3 * cos, cos * cos - sin * sin),
        held * torch.where(arc, 3 * sin - 4 * sin**3, 2 * sin * cos),
    )
    normal = torch.stack((cos * nx - sin * ny, cos * ny + sin * nx))
    return torch.cat(
        (
            s.ends[:, :2],
            normal.expand(2, 2, -1),
            torch.zeros_like(s.ends[:, 4:HEAD]),
            torch.full_like(s.ends[:, HEAD:], torch.nan),
        ),
        1,
    )


def _turned(s: _Search, hit: _Hit) -> _Search:
    """Where to look next.

    By Newton's step, as long as it stays between the ends and closes in. Else along the normal of the face between the
    ends, or straight away from one if the point, outside, is past it. Newton's step sees the boundary as an arc, and
    makes no sense from inside it beyond its centre.
    """
    over, aside = hit.over, hit.aside
    before, turn = s.pace
    steep = over + hit.touch.radius
    newton = (over > 0) | (steep > aside.abs())
    step = s.curves.turn(hit.touch, aside / steep, steep)
    step = torch.where(over < 0, step.clamp(-MOST_INSIDE, MOST_INSIDE), step)
    across = torch.where(newton, step, turn * aside.sign())
    nx, ny = s.normal
    following = torch.stack((nx - across * ny, ny + across * nx))

    a, b = s.ends
    both = (a[2:4] != 0).any(0) & (b[2:4] != 0).any(0)
    chord = both
    if bool(both.any()):
        dx, dy = b[:2] - a[:2]
        from_x, from_y = s.given[:2] - a[:2]
        foot, span = from_x * dx + from_y * dy, dx * dx + dy * dy
        face, straight = _face_normal(a, b, over)
        past = (face[0] * following[1] - face[1] * following[0]) * aside > 0
        closing = _between(a, following, b) & (aside.abs() < CLOSING * before)
        stuck = both & ~(closing & ~(straight & past))
        corner = stuck & (over > 0) & (dy * from_x >= dx * from_y) & ((foot <= 0) | (foot >= span))
        chord = stuck & ~corner & (span > 0)
        end = torch.where(foot <= 0, a, b)
        away = s.given[:2] - end[:2] + end[4] * end[2:4]
        following = torch.where(corner, away, torch.where(chord, face, following))
    pace = torch.stack((torch.where(chord, torch.inf, aside.abs()), torch.where(newton, FIRST_TURN, turn * WIDEN)))
    return replace(s, normal=following / torch.hypot(following[0], following[1]), chord=chord, pace=pace)


def _face_normal(a: Tensor, b: Tensor, over: Tensor) -> tuple[Tensor, Tensor]:
    """The normals (2, q) of faces that may lie between ends, and whether one is to be expected.

    They are those of the chords of the actuator that is moved most, or else of the whole chords. A face is expected
    where the boundary bends less on the way than it would as the arc of the rounder end.
    """
    chord = b[:2] - a[:2]
    end = torch.where(a[4] >= b[4], a, b)
    drop, square = (end[2] * chord[0] + end[3] * chord[1]).abs(), chord[0] * chord[0] + chord[1] * chord[1]
    straight = drop * (end[4] + over.clamp(min=0)) < STRAIGHTER / 2 * square
    jumps = (b[HEAD:] - a[HEAD:]).unflatten(0, (3, -1))[:2]
    x, y = jumps.gather(1, jumps.abs().sum(0).max(0).indices.expand(2, 1, -1))[:, 0]
    face = torch.stack((y, -x))
    return torch.where(_between(a, face, b), face, torch.stack((chord[1], -chord[0]))), straight


def _between(a: Tensor, normal: Tensor, b: Tensor) -> Tensor:
    """Whether (q) normals (2, q) lie between those of ends, not at them."""
    x, y = normal
    return (a[2] * y - a[3] * x > 0) & (x * b[3] - y * b[2] > 0)
