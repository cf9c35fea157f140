"""From polygons to the sets they were sampled from, by Newton's method on the normal.

The distance from w to a convex set with support function h is `max_n n·w - h(n)` over unit vectors n; inside,
its negative is the least `h(n) - n·w`. Where a line with normal n touches the set, at s, the derivative in
the normal's angle is `t·(w - s)` with t to the left of n, and the second one minus the distance to s along n and the
boundary's radius of curvature there. The search is bracketed by what was touched clockwise and counter-clockwise of the
nearest point: Newton's steps close in where the boundary is curved, and the chord between the two is the answer where
it is straight. `n·(w - s)` and `|w - s|` are bounds on the distance: their gap says when it is found.
"""

from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from torcharm._select import pick
from torcharm.distance.touch import CurveSums

ROUNDS = 24
FEWER = 0.75
"""Below this share of those left the ones that are done are left out."""
LUNE = 4.0
"""Points outside a polygon can be so many times as deep inside the set as the set was seen to reach beyond it."""
CLOSING = 0.25
"""Factor by which a step must bring the touched point nearer to straight ahead."""
BOWS = (0.5, 2.0)
"""Bounds on the factor by which the second derivative may change Newton's step."""
FIRST_TURN, WIDEN = 1e-3, 8.0
"""The turn of a direction where Newton's step makes no sense [rad], and its growth until it does."""


@dataclass(frozen=True)
class Problems:
    """Q searches for a nearest point.

    Attributes:
        x, y: (Q) points.
        nx, ny: (Q) outward unit normals to start from, those of a polygon inside the set.
        side: (Q) 1 outside the polygon and -1 inside.
        distance: (Q) to it.
        tolerance: (Q) what counts as nothing, as a length.
        edge: (Q) whether the polygon's nearest point lies inside an edge,
        edge_x, edge_y: (2, Q) and the ends of that, clockwise first.
    """

    x: Tensor
    y: Tensor
    nx: Tensor
    ny: Tensor
    side: Tensor
    distance: Tensor
    tolerance: Tensor
    edge: Tensor
    edge_x: Tensor
    edge_y: Tensor


@dataclass(frozen=True)
class Found:
    """What came of Q problems.

    Attributes:
        square: (Q) squared distances; meaningless unless done.
        inside: (Q).
        fraction: (2, M, Q) pressure fractions at both ends of the nearest faces, if asked for and they are no polygons'.
        kept: (Q) whether the polygon's face is the set's.
        done: (Q).
    """

    square: Tensor
    inside: Tensor
    fraction: Tensor | None
    kept: Tensor
    done: Tensor


@dataclass(frozen=True)
class _End:
    """What was touched on one side of the answers.

    Attributes:
        x, y: (q) the points.
        nx, ny: (q) the normals there; 0 if nothing was touched yet.
        u: (M, q) the pressure fractions there, if asked for.
    """

    x: Tensor
    y: Tensor
    nx: Tensor
    ny: Tensor
    u: Tensor | None

    def replaced(self, where: Tensor, other: "_End") -> "_End":
        """By another, where (q) told."""
        pairs = ((getattr(self, field.name), getattr(other, field.name)) for field in fields(self))
        return _End(*(None if old is None else torch.where(where, new, old) for old, new in pairs))


@dataclass(frozen=True)
class _Search:
    """Where searches stand.

    Attributes:
        problems: those left, with the normals to try next.
        curves: theirs.
        number: (q) which they are.
        a, b: the last touched clockwise and counter-clockwise of the answers.
        chord: (q) whether the normal is that of the chord between the two.
        aside: (q) how far off to a side the last touched point was.
        turn: (q) the next turn where Newton's step makes no sense [rad].
        thickness: (q) by how much the set was seen to reach beyond the polygon.
        live: (q) whether it is not done.
    """

    problems: Problems
    curves: CurveSums
    number: Tensor
    a: _End
    b: _End
    chord: Tensor
    aside: Tensor
    turn: Tensor
    thickness: Tensor
    live: Tensor


def solve(problems: Problems, curves: CurveSums, *, fractions: bool) -> Found:
    """Search for all nearest points at once, those that are done left out."""
    x = problems.x
    none, no = torch.zeros_like(x), torch.zeros_like(x, dtype=torch.bool)
    ends = x.new_zeros(len(curves.radii), len(x)) if fractions else None
    both = None if ends is None else torch.stack((ends, ends))
    found = Found(none.clone(), no.clone(), both, no.clone(), no.clone())
    normals = torch.stack((problems.nx, problems.ny))
    a, b = (_End(problems.edge_x[i], problems.edge_y[i], none, none, ends) for i in (0, 1))
    number = torch.arange(len(x), device=x.device)
    far, turn = torch.full_like(x, torch.inf), torch.full_like(x, FIRST_TURN)
    search = _Search(problems, curves, number, a, b, problems.edge, far, turn, none, ~no)
    for count in range(ROUNDS):
        search, done, square, inside, on, ends = _round(search, first=count == 0)
        fresh = (done & search.live).nonzero().squeeze(-1)
        if len(fresh):
            number = search.number[fresh]
            found.square[number], found.inside[number], found.done[number] = square[fresh], inside[fresh], True
            if count == 0:
                found.kept[number] = on[fresh]
            if found.fraction is not None and ends is not None:
                found.fraction[:, :, number] = ends.index_select(-1, fresh)
                normals[:, number] = torch.stack((search.problems.nx, search.problems.ny))[:, fresh]
            live = search.live.index_fill(0, fresh, False)
            left = live.nonzero().squeeze(-1)
            if not len(left):
                break
            search = replace(search, live=live)
            if len(left) < FEWER * len(live):
                search = pick(search, left)
    if found.fraction is not None:
        # Where both ends are one, the fractions of the last normal are nearer still.
        again = curves.touch(normals[0], normals[1]).u
        found.fraction.copy_(torch.where((found.fraction[0] == found.fraction[1]).all(0), again, found.fraction))
    return found


def _round(s: _Search, *, first: bool) -> tuple[_Search, Tensor, Tensor, Tensor, Tensor, Tensor | None]:
    """Touch the sets once: the searches a step on; which (q) are done, their squared distances, whether
    they are inside, and the fractions (2, M, q) at the ends of their faces."""
    p, nx, ny, a, b = s.problems, s.problems.nx, s.problems.ny, s.a, s.b
    touch = s.curves.touch(nx, ny)
    hit = _End(touch.x, touch.y, nx, ny, touch.u if a.u is not None else None)
    radius, ends = touch.radius, None if hit.u is None else hit.u.expand(2, *hit.u.shape)
    on = torch.zeros_like(s.chord)
    if bool(s.chord.any()):
        # A chord beyond which nothing lies is a face. Past its end, that is what was touched.
        face = s.chord & (nx * (hit.x - a.x) + ny * (hit.y - a.y) <= p.tolerance)
        past_a = face & (nx * (p.y - a.y) - ny * (p.x - a.x) < 0)
        past_b = face & (nx * (p.y - b.y) - ny * (p.x - b.x) > 0)
        on = face & ~past_a & ~past_b
        if ends is not None and a.u is not None and b.u is not None:
            ends = torch.where(on, torch.stack((a.u, b.u)), ends)
        hit = hit.replaced(past_a, replace(a, nx=nx, ny=ny)).replaced(past_b, replace(b, nx=nx, ny=ny))
        radius = torch.where(face, 0.0, radius)
    dx, dy = p.x - hit.x, p.y - hit.y
    over, aside = nx * dx + ny * dy, nx * dy - ny * dx
    distance, deep = torch.hypot(over, aside), over.abs()
    done = (aside * aside <= p.tolerance * (distance + deep)) | on
    distance = torch.where(on, deep, distance)
    if touch.rest is not None:
        done = done & (touch.rest <= p.tolerance)
    # Between polygon and set, a point is inside though it was outside.
    thickness = p.side * p.distance - over if first else s.thickness
    inside = over < 0
    within = torch.where(p.side > 0, LUNE * thickness, torch.inf)
    done = done & torch.where(inside, -over <= within + p.tolerance, (p.side > 0) | (over <= p.tolerance))
    ahead = aside > 0
    a, b = a.replaced(ahead, hit), b.replaced(~ahead, hit)
    search = replace(s, a=a, b=b, thickness=thickness)
    return _turned(search, over, aside, radius, touch.widening), done, distance * distance, inside, on, ends


def _turned(s: _Search, over: Tensor, aside: Tensor, radius: Tensor, widening: Tensor) -> _Search:
    """Where to look next, with what was touched (q) over and aside of the points.

    By Newton's step, that of Chebyshev, as long as it stays between the ends and closes in; else along the normal of the chord between
    them or, from outside and past its end, straight away from that end. Newton's step sees the boundary as a circle, and
    makes no sense from inside it beyond its centre.
    """
    p, nx, ny, a, b = s.problems, s.problems.nx, s.problems.ny, s.a, s.b
    steep = over + radius
    newton = (over > 0) | (steep > aside.abs())
    angle = s.turn * aside.sign()
    bow = (1 - 0.5 * aside * widening / steep.square()).clamp(*BOWS)
    along, across = torch.where(newton, steep, 1.0), torch.where(newton, aside * bow, angle)
    next_x, next_y = along * nx - across * ny, along * ny + across * nx

    within = (a.nx * next_y - a.ny * next_x > 0) & (next_x * b.ny - next_y * b.nx > 0)
    both = (a.nx.abs() + a.ny.abs() > 0) & (b.nx.abs() + b.ny.abs() > 0)
    stuck = both & ~(within & (aside.abs() < CLOSING * s.aside))
    chord, turn = stuck, torch.where(newton, FIRST_TURN, s.turn * WIDEN)
    if bool(stuck.any()):
        dx, dy, from_x, from_y = b.x - a.x, b.y - a.y, p.x - a.x, p.y - a.y
        foot, span = from_x * dx + from_y * dy, dx * dx + dy * dy
        chord = stuck & (span > 0)
        outside = (over > 0) & (dy * from_x - dx * from_y >= 0)
        corner = stuck & outside & ((foot <= 0) | (foot >= span))
        chord = chord & ~corner
        first = foot <= 0
        next_x = torch.where(chord, dy, torch.where(corner, p.x - torch.where(first, a.x, b.x), next_x))
        next_y = torch.where(chord, -dx, torch.where(corner, p.y - torch.where(first, a.y, b.y), next_y))
    length = torch.hypot(next_x, next_y)
    problems = replace(p, nx=next_x / length, ny=next_y / length)
    return replace(s, problems=problems, chord=chord, aside=torch.where(chord, torch.inf, aside.abs()), turn=turn)
