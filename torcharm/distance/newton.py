"""From polygons to the sets they were sampled from, by Newton's method on what holds at nearest points.

At the point of a set `Σ_α c_α(u_α)` that is nearest to w, with outward normal n and t to the left of it,

    n·c_α'(u_α) = 0 for every u_α between kinks,    t·(w - Σ_α c_α(u_α)) = 0.

The polygon's nearest point is where to start: on chords of curves that bend little. On a straight face, between two
pressures of one actuator, the second equation gives way to `n·(c_α(u_α) - c_α(u'_α)) = 0`. An answer counts when the
distance to the point and that to the supporting line agree, and no sample of a curve lies beyond that line.
"""

from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from torch import Tensor

from torcharm.laws import LEAST, Laws

ROUNDS = 10
EARLY = 3
"""Rounds in which only what seems to be done is compared with all samples."""
MOST, FEWER = 0.5, 0.7
"""Above the one share of the problems all are compared with samples, to save the copy; below the other those that
are done are left out."""
LUNE = 4.0
"""Points outside a polygon can be so many times as deep inside the set as the set was seen to reach beyond it."""
MOST_TURN = 0.5
"""The largest turn of a normal in one round [rad]."""
FIRST = 1e-3
"""The first step from no pressure, where a force is a power of pressure."""


@dataclass(frozen=True)
class Problems:
    """Q searches for a nearest point.

    Attributes:
        laws, radii, bending: the curves, (..., M, Q).
        grid, force: (S, M, Q) samples of them.
        before, after: (S, M, Q) slopes on either side of these; (0, M, Q) if no maximum can hide between them.
        x, y: (Q) points.
        side: (Q) 1 outside the polygon and -1 inside.
        tolerance: (Q).
        number: (Q) of the problem.
        nx, ny: (Q) outward normals.
        u: (M, Q) pressure fractions.
        face: (Q) whether the nearest face is straight,
        own: (Q) the actuator that makes it so,
        other, other_force: (Q) and its other end.
        thickness: (Q) by how much the set was seen to reach beyond the polygon.
    """

    laws: Laws
    radii: Tensor
    bending: Tensor
    grid: Tensor
    force: Tensor
    before: Tensor
    after: Tensor
    x: Tensor
    y: Tensor
    side: Tensor
    tolerance: Tensor
    number: Tensor
    nx: Tensor
    ny: Tensor
    u: Tensor
    face: Tensor
    own: Tensor
    other: Tensor
    other_force: Tensor
    thickness: Tensor

    def of(self, index: Tensor, *, laws: bool = True) -> "Problems":
        """Those in `index`; without laws, the laws of all."""
        names = (field.name for field in fields(self) if field.name != "laws")
        parts = {name: getattr(self, name).index_select(-1, index) for name in names}
        return Problems(self.laws.of(index) if laws else self.laws, **parts)

    def changed(self, changes: dict[str, Tensor], index: Tensor | None) -> "Problems":
        """With other values, of those in `index` or of all."""
        values: dict[str, Any] = dict(changes)
        if index is not None:
            values = {name: getattr(self, name).index_copy(-1, index, value) for name, value in changes.items()}
        return replace(self, **values)


@dataclass(frozen=True)
class Found:
    """What came of Q problems.

    Attributes:
        square: (Q) squared distances; meaningless unless done.
        inside: (Q).
        fraction: (2, M, Q) pressure fractions at both ends of the nearest faces.
        done: (Q).
    """

    square: Tensor
    inside: Tensor
    fraction: Tensor
    done: Tensor

    @classmethod
    def none(cls, u: Tensor) -> "Found":
        """Nothing, of problems with fractions (M, Q)."""
        flags = torch.zeros(2, u.shape[-1], dtype=torch.bool, device=u.device)
        return cls(torch.zeros_like(u[0]), flags[0], u.new_zeros(2, *u.shape), flags[1])

    def take(self, number: Tensor, other: "Found", chosen: Tensor) -> None:
        """Take over some of other answers, as the problems of these numbers."""
        self.square[number], self.inside[number] = other.square[chosen], other.inside[chosen]
        self.fraction[:, :, number] = other.fraction[:, :, chosen]
        self.done[number] = True


def solve(problems: Problems, scale: tuple[float, float]) -> Found:
    """Newton's method on all problems at once, those that are done left out."""
    found = Found.none(problems.u)
    for count in range(ROUNDS):
        problems, answer, index = _round(problems, scale, late=count >= EARLY)
        if answer is None:
            continue
        number = problems.number[index[answer.done]]
        found.take(number, answer, answer.done)
        if bool(found.done.all()):
            break
        open_ones = (~found.done[problems.number]).nonzero().squeeze(-1)
        if len(open_ones) < FEWER * len(problems.number):
            problems = problems.of(open_ones)
    return found


@dataclass(frozen=True)
class _Lines:
    """Supporting lines with normals n, and what they meet: scaled reaches `n·c` and places `t·c` of curves.

    Attributes:
        ahead, ahead_fraction: (M, Q) reach by force and by fraction.
        across, across_fraction: (M, Q) the same for places.
    """

    ahead: Tensor
    ahead_fraction: Tensor
    across: Tensor
    across_fraction: Tensor

    @classmethod
    def of(cls, nx: Tensor, ny: Tensor, radii: Tensor, bending: Tensor, scale: tuple[float, float]) -> "_Lines":
        x, y = scale[1] * nx, scale[1] * ny
        return cls(scale[0] * nx - y * radii, y * bending, -scale[0] * ny - x * radii, x * bending)


def _round(p: Problems, scale: tuple[float, float], late: bool) -> tuple[Problems, Found | None, Tensor]:
    """Problems a step on; and an answer to some of them, those in an index (q)."""
    force, slope, bend, after, before, low, high = p.laws.around(p.u)
    nx, ny = _face_normals(p, force, scale) if bool(p.face.any()) else (p.nx, p.ny)
    lines = _Lines.of(nx, ny, p.radii, p.bending, scale)
    uphill = torch.addcmul(lines.ahead_fraction, lines.ahead, slope + after)
    downhill = torch.addcmul(lines.ahead_fraction, lines.ahead, slope + before)
    left = (downhill < 0) & (p.u > 0)
    right = (uphill > 0) & (p.u < 1) & ~left
    gain = torch.where(left, downhill, uphill)
    slope = slope + torch.where(left, before, after)
    drop = -lines.ahead * bend
    moving, curved = left | right, drop > 0
    inverse = (moving & curved).to(nx.dtype) / torch.where(curved, drop, 1.0)
    straight = (moving & ~curved).to(nx.dtype)
    moment = p.bending * p.u - p.radii * force
    from_x, from_y = p.x - scale[0] * force.sum(0), p.y - scale[1] * moment.sum(0)
    over, aside = nx * from_x + ny * from_y, nx * from_y - ny * from_x
    sideways = torch.addcmul(lines.across_fraction, lines.across, slope)
    pull = sideways * inverse
    steep = over + (pull * sideways).sum(0)
    sound = (steep > 0) & ~p.face
    turn = torch.where(sound, (aside - (pull * gain).sum(0)) / torch.where(sound, steep, 1.0), 0.0)
    turn = turn.clamp(-MOST_TURN, MOST_TURN)

    rise = 0.5 * gain * gain * inverse
    rest = rise + straight * gain.abs()
    new = p.u + (gain + sideways * turn) * inverse + straight * torch.where(right, high - p.u, low - p.u)
    if len(p.laws.gain):
        # In u^(x-1) the slope of a power is straight: the step is taken there.
        rows = p.laws.rows
        u = p.u[rows]
        some, less = u.clamp(min=LEAST), p.laws.exponent.amax(0) - 1
        stretch = torch.log1p((less * (new[rows] - u) / some).clamp(min=-1 + 1e-9)) / less.clamp(min=1e-9)
        bent = torch.where(u > 0, some * stretch.clamp(max=60).exp(), FIRST)
        new[rows] = torch.where((less > 0) & (inverse[rows] > 0), bent, new[rows])
        new = torch.minimum(torch.maximum(new, low), high)
        far = ((new > 2 * p.u) | (new < 0.5 * p.u)).to(nx.dtype)
        rest = rest + far * gain.abs() * (new - p.u).abs()
    else:
        new = torch.minimum(torch.maximum(new, low), high)

    size = torch.hypot(nx - turn * ny, ny + turn * nx)
    on = replace(p, nx=(nx - turn * ny) / size, ny=(ny + turn * nx) / size, u=new)
    distance = torch.hypot(over, aside)
    rest = rest.sum(0)
    near = (rest <= p.tolerance) & (distance - over.abs() <= p.tolerance) | p.face | (over * p.side < 0)
    index = near.nonzero().squeeze(-1)
    if late or len(index) > MOST * len(nx):
        index = torch.arange(len(nx), device=nx.device)
    if not len(index):
        return on, None, index
    every = len(index) == len(nx)

    def part(value: Tensor) -> Tensor:
        return value if every else value.index_select(-1, index)

    lines = _Lines(*(part(value) for value in vars(lines).values()))
    found = _Rows(part(force), part(rise), part(straight), part(new))
    own = p if every else p.of(index, laws=False)
    answer, changes = _check(own, lines, found, part(rest), part(over), part(aside), part(steep))
    return on.changed(changes, None if every else index), answer, index


@dataclass(frozen=True)
class _Rows:
    """What a round found for each actuator (M, q): its force, how much further its next step reaches if it is curved,
    whether (1 or 0) it goes straight to a kink, and where it goes."""

    force: Tensor
    rise: Tensor
    straight: Tensor
    new: Tensor


def at_actuator(value: Tensor, actuator: Tensor) -> Tensor:
    """Of (M, q) the entries (q) of one actuator each."""
    return value.gather(0, actuator[None])[0]


def _put(value: Tensor, actuator: Tensor, chosen: Tensor, other: Tensor) -> Tensor:
    """(M, q) with others (q) in place of one actuator's entries, where chosen (q)."""
    return value.scatter(0, actuator[None], torch.where(chosen, other, at_actuator(value, actuator))[None])


def _face_normals(p: Problems, force: Tensor, scale: tuple[float, float]) -> tuple[Tensor, Tensor]:
    """Normals (Q), of faces those at right angles to them."""
    apart = at_actuator(force, p.own) - p.other_force
    run = at_actuator(p.bending, p.own) * (at_actuator(p.u, p.own) - p.other) - at_actuator(p.radii, p.own) * apart
    tx, ty = scale[1] * run, -scale[0] * apart
    length = torch.hypot(tx, ty)
    level = p.face & (length > p.tolerance)
    length = torch.where(level, length * (tx * p.nx + ty * p.ny).sign(), 1.0)
    return torch.where(level, tx / length, p.nx), torch.where(level, ty / length, p.ny)


def _check(
    p: Problems, lines: _Lines, rows: _Rows, rest: Tensor, over: Tensor, aside: Tensor, steep: Tensor
) -> tuple[Found, dict[str, Tensor]]:
    """Which of q problems are done, seen that no curve lies beyond the supporting line; and what to change in others.

    Args:
        p: the problems; of their laws nothing is asked.
        lines, rows: (M, q).
        rest: (q) by how much curves reach further from where they are.
        over, aside: (q) the points from where the sets are touched, along the normals and to the left.
        steep: (q) slope of `aside` over the normals' turn.
    """
    u, force, new, tolerance = p.u, rows.force, rows.new, p.tolerance
    reach = torch.addcmul(lines.ahead * force, lines.ahead_fraction, u)
    sampled = (lines.ahead * p.force).addcmul_(lines.ahead_fraction, p.grid)
    top, best = sampled.max(0)
    ahead = (top - reach).clamp(min=0)
    hidden = hiding = None
    if len(p.before):
        hidden, hiding = _hidden(lines, u, reach, p.grid, sampled, p.before, p.after)
        rest = rest + hidden.sum(0)
    thickness = torch.maximum(p.thickness, (reach - top).clamp(min=0).sum(0))
    # Between polygon and set, a point is inside though it was outside.
    within = (p.side > 0) & (over < 0) & (-over <= LUNE * thickness + tolerance)
    height = torch.where(within, -over, p.side * over)
    distance = torch.hypot(over, aside)
    settled = rest + ahead.sum(0) <= tolerance
    done = settled & (distance - height <= tolerance)
    fraction, face, faces = new.expand(2, *new.shape), p.face, bool(p.face.any())
    if faces:
        low_end, high_end, ends = _face_ends(p, lines, rows, reach - tolerance)
        on_face = (aside >= low_end - tolerance) & (aside <= high_end + tolerance)
        done = torch.where(face, settled & on_face & (height >= 0), done)
        fraction = torch.where(face, ends, fraction)
        distance = torch.where(face, over.abs(), distance)
        # Past the end of a face Newton's method goes on from there.
        past = face & settled & ~on_face
        across = at_actuator(lines.across, p.own) * (p.other_force - at_actuator(force, p.own))
        across = across + at_actuator(lines.across_fraction, p.own) * (p.other - at_actuator(u, p.own))
        new = _put(new, p.own, past & ((aside > high_end) == (across > 0)), p.other)
        face = face & ~past
    if hidden is not None and hiding is not None:
        new = torch.where((hidden > tolerance) & (ahead <= tolerance) & ~done, hiding, new)
    own, other, other_force = p.own, p.other, p.other_force
    # A sample out of reach of the next step is where to go on.
    better = (ahead > 2 * rows.rise + tolerance) & (rows.straight == 0) & ~done
    if bool(better.any()):
        lead, leader = (ahead * better).max(0)
        jump = lead > 0
        best_u, best_force = p.grid.gather(0, best[None])[0], p.force.gather(0, best[None])[0]
        sample_u, sample_force = at_actuator(best_u, leader), at_actuator(best_force, leader)
        jumps = (lines.across * (best_force - force)).addcmul_(lines.across_fraction, best_u - u)
        new = _put(torch.where(better, best_u, new), own, face, at_actuator(u, own))
        # Would the normal, turned to the far side of the jump, find the near side ahead? The face between is nearest.
        across = (jumps * better).sum(0)
        begin = jump & (steep > 0) & ((ahead * better).sum(0) * steep + across * (aside - across) < 0)
        if faces:
            # Of a face that a sample divides, the half that holds the foot.
            split = jump & face & (leader == own)
            reached = at_actuator(jumps, leader)
            far_half = split & ((aside - reached) * reached > 0)
            new = _put(new, own, far_half, sample_u)
            begin = (begin | split) & ~far_half
            face = face & (~jump | split)
        new = _put(new, leader, begin, at_actuator(u, leader))
        face = face | begin
        own = torch.where(begin, leader, own)
        other = torch.where(begin, sample_u, other)
        other_force = torch.where(begin, sample_force, other_force)
    changes = {"u": new, "face": face, "own": own, "other": other, "other_force": other_force, "thickness": thickness}
    return Found(distance.square(), within | (p.side < 0), fraction, done), changes


def _hidden(
    lines: _Lines, u: Tensor, reach: Tensor, grid: Tensor, sampled: Tensor, before: Tensor, after: Tensor
) -> tuple[Tensor, Tensor]:
    """By how much (M, q) curves may reach further between samples, by their tangents there; and where."""
    rising, falling = (lines.ahead * slope + lines.ahead_fraction for slope in (after[:-1], before[1:]))
    first, last = grid[:-1], grid[1:]
    peaked = (rising > 0) & (falling < 0) & ((u < first) | (u > last))
    span = torch.where(peaked, rising - falling, 1.0)
    step = (sampled[1:] - sampled[:-1] - falling * (last - first)) / span
    most, index = torch.where(peaked, sampled[:-1] + rising * step - reach, 0.0).max(0)
    return most.clamp(min=0), (first + step).gather(0, index[None])[0].clamp(0, 1)


def _face_ends(p: Problems, lines: _Lines, rows: _Rows, level: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Where faces end, (q) to the right and to the left of where they are touched; and fractions (2, M, q) there.

    Every sample that reaches a level (M, q) belongs to the face, whichever actuator's.
    """
    index = p.face.nonzero().squeeze(-1)
    if 2 * len(index) > len(p.face):
        index = torch.arange(len(p.face), device=index.device)
    lines = _Lines(*(value.index_select(-1, index) for value in vars(lines).values()))
    u, force, grid, samples, level = (
        value.index_select(-1, index) for value in (p.u, rows.force, p.grid, p.force, level)
    )
    place = (lines.across * (samples - force)).addcmul_(lines.across_fraction, grid - u)
    sampled = (lines.ahead * samples).addcmul_(lines.ahead_fraction, grid)
    off = (sampled < level).to(place.dtype).mul_(torch.finfo(place.dtype).max / 4)
    least, first = (place + off).min(0)
    most, last = place.sub_(off).max(0)
    low_end, high_end = torch.zeros_like(p.x), torch.zeros_like(p.x)
    low_end[index], high_end[index] = least.clamp(max=0).sum(0), most.clamp(min=0).sum(0)
    ends = torch.stack((u, u))
    ends[0] = torch.where(least < 0, grid.gather(0, first[None])[0], u)
    ends[1] = torch.where(most > 0, grid.gather(0, last[None])[0], u)
    return low_end, high_end, torch.stack((rows.new, rows.new)).index_copy(-1, index, ends)
