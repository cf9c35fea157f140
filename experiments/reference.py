"""Converged distances to attainable sets, to measure the library against.

Written from the equations in numpy; of the library only the force models are asked. No polygon is
built: the distance from a wrench w to the sum of curves c_α is, over unit directions n,

    max_n  n·w - Σ_α max_p n·c_α(p)

(positive outside; inside, minus the distance to the boundary). Directions are scanned, and the best are
refined between a lower and an upper bound. In every direction the pressures are scanned, and each local
maximum that could be the highest is refined by itself: force models may have kinks and several maxima.

How exact it is: `enclosed_distance` gives both bounds, and a finer `Scan` finds what a coarser one missed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

import torcharm as ta

Array = NDArray[np.float64]
Index = NDArray[np.intp]

HANGING = (0.0, 0.0, -math.pi / 2)
EPS = float(np.finfo(np.float64).eps)
MOST_DIRECTIONS = 8
"""Directions refined a problem: inside a set with n faces about equally near, n are of interest."""
SECTIONS_AT_ONCE = 250
ZOOM = 33
"""Pressures in an interval that is narrowed to the two cells beside the best of them."""
ROUNDS = 60
COARSE = 4
"""Every so many of the scan's pressures serve to choose directions."""
ANGLE = 1e-9
"""Directions this close to an interval [rad] count as in it."""


@dataclass(frozen=True)
class Scan:
    """How finely to look before refining.

    Attributes:
        directions: round the circle.
        pressures: from 0 to the limit, for every actuator and direction.
    """

    directions: int = 360
    pressures: int = 501

    def doubled(self) -> "Scan":
        """Twice as fine in each respect."""
        return Scan(2 * self.directions, 2 * self.pressures - 1)


SCAN = Scan()


def converged_distance(
    arm: ta.ArmDesign,
    twists: Any,
    tip_load: Any,
    *,
    relative: bool = False,
    signed: bool = False,
    weights: Sequence[float] = (1.0, 1.0),
    base_pose: Sequence[float] = HANGING,
    scan: Scan = SCAN,
) -> Array:
    """Distance (N,) of every node's required wrench to the set that its actuators can provide.

    Args:
        arm: one design.
        twists: (N, 3) one shape [m, m, rad].
        tip_load: (3,) one load in the world frame [N, N, N·m].
        relative: differences from node 1 instead.
        signed: inside minus the distance to the boundary, instead of 0.
        weights: k_f and k_m of the distance `sqrt(k_f f² + k_m m²)`.
        base_pose: pose of node 1.
        scan: how finely to look.
    """
    shape = np.asarray(twists, dtype=np.float64)
    load = np.asarray(tip_load, dtype=np.float64)
    sets = attainable_sets(arm, shape, relative=relative, weights=weights)
    points = required(shape, load, relative=relative, weights=weights, base_pose=base_pose)
    lower, _ = enclosed_distance(sets, points, scan)
    return lower if signed else lower.clip(min=0.0)


# ---- what is required, and what is attainable ------------------------------------------------


def required(
    twists: Array,
    tip_load: Array,
    *,
    relative: bool = False,
    weights: Sequence[float] = (1.0, 1.0),
    base_pose: Sequence[float] = HANGING,
) -> Array:
    """Required wrenches (N, 2) `(f_x, m)` of the nodes, weighted: the load carried there, negated."""
    steps = twists / len(twists)
    length, shear, turn = steps.T
    sine, cosine = np.sinc(turn / np.pi), np.sin(turn / 2) * np.sinc(turn / (2 * np.pi))  # sin κ/κ, (1 - cos κ)/κ
    forward, left = length * sine - shear * cosine, length * cosine + shear * sine
    heading = base_pose[2] + np.concatenate(([0.0], turn.cumsum()))
    cos, sin = np.cos(heading[:-1]), np.sin(heading[:-1])
    x = base_pose[0] + np.concatenate(([0.0], (cos * forward - sin * left).cumsum()))
    y = base_pose[1] + np.concatenate(([0.0], (sin * forward + cos * left).cumsum()))
    force_x, force_y, moment = tip_load
    along = cos * force_x + sin * force_y
    about = moment + (x[-1] - x[:-1]) * force_y - (y[-1] - y[:-1]) * force_x
    found: Array = -np.stack((along, about), -1) * np.sqrt(np.asarray(weights))
    return found - found[0] if relative else found


@dataclass(frozen=True, eq=False)
class CurveSums:
    """B sets, each the sum of one curve per actuator, `(f, -r f + τ)` at pressure fractions from 0 to 1.

    Attributes:
        models: M force models.
        strain: (B, M).
        first: (B, M) strains of the node whose curves are subtracted; None for absolute sets.
        bending: (B, M) τ at the pressure limit [N·m], of differences if relative.
        radii: (B, M) [m].
        limit: (B, M) [kPa].
        scale: (2,) factors on force and moment.
    """

    models: tuple[ta.Actuator, ...]
    strain: Array
    first: Array | None
    bending: Array
    radii: Array
    limit: Array
    scale: Array

    def __len__(self) -> int:
        return len(self.strain)

    def part(self, chosen: slice) -> "CurveSums":
        """Some of the sets."""
        first = None if self.first is None else self.first[chosen]
        bending, radii, limit = self.bending[chosen], self.radii[chosen], self.limit[chosen]
        return CurveSums(self.models, self.strain[chosen], first, bending, radii, limit, self.scale)

    def force(self, index: Index, actuator: Index, fraction: Array) -> Array:
        """Forces of actuators in sets at fractions (R, P) of their limits; `index` and `actuator` are (R,)."""
        pressure = fraction * self.limit[index, actuator][:, None]
        found = np.empty_like(pressure)
        kinds = list(dict.fromkeys(self.models))  # each is asked once
        kind = np.array([kinds.index(model) for model in self.models])[actuator]
        for place, model in enumerate(kinds):
            own = np.flatnonzero(kind == place)
            rows, columns = index[own], actuator[own]
            found[own] = _force(model, self.strain[rows, columns], pressure[own])
            if self.first is not None:
                found[own] -= _force(model, self.first[rows, columns], pressure[own])
        return found

    def reach(self, index: Index, normal: Array) -> tuple[Array, Array]:
        """How far (Q, M) along normals (Q, 2) one newton reaches, and the bending moment at the limit."""
        along, turning = self.scale[0] * normal[:, :1], self.scale[1] * normal[:, 1:]
        return along - turning * self.radii[index], turning * self.bending[index]

    def wrench(self, index: Index, fraction: Array, force: Array) -> Array:
        """Sums (Q, 2) of the curves' points at fractions (Q, M), where the forces are given."""
        moment = self.bending[index] * fraction - self.radii[index] * force
        return np.stack((force.sum(-1), moment.sum(-1)), -1) * self.scale


def _force(model: ta.Actuator, strain: Array, pressure: Array) -> Array:
    with torch.no_grad():
        found = model.force(torch.from_numpy(strain)[:, None], torch.from_numpy(pressure))
    return found.expand(pressure.shape).double().numpy()


def attainable_sets(
    arm: ta.ArmDesign, twists: Array, *, relative: bool = False, weights: Sequence[float] = (1.0, 1.0)
) -> CurveSums:
    """The sets of the N nodes of one design on one shape (N, 3)."""
    if tuple(arm.batch_shape):
        raise ValueError(f"arm: must be one design, got a batch of shape {tuple(arm.batch_shape)}")
    radii, neutral, limit = (
        np.broadcast_to(value.detach().double().numpy(), (len(twists), arm.actuator_count))
        for value in (arm.radii, arm.length, arm.max_pressure)
    )
    length = twists[:, :1] - radii * twists[:, 2:]
    stiffness = np.array([model.bending_stiffness for model in arm.actuators])
    reference = np.array([model.max_pressure for model in arm.actuators])
    strain = (length - neutral) / neutral
    bending = stiffness * twists[:, 2:] / length * (limit / reference)
    first = np.broadcast_to(strain[0], strain.shape) if relative else None
    own = bending - bending[0] if relative else bending
    return CurveSums(arm.actuators, strain, first, own, radii, limit, np.sqrt(np.asarray(weights)))


def joined(sets: Sequence[CurveSums]) -> CurveSums:
    """The sets of several designs with the same actuators as one batch."""

    def rows(name: str) -> Array:
        return np.concatenate([getattr(one, name) for one in sets])

    first = None if sets[0].first is None else rows("first")
    return CurveSums(
        sets[0].models, rows("strain"), first, rows("bending"), rows("radii"), rows("limit"), sets[0].scale
    )


# ---- distances -------------------------------------------------------------------------------


def enclosed_distance(sets: CurveSums, points: Array, scan: Scan = SCAN) -> tuple[Array, Array]:
    """Signed distances (B,) from points (B, 2) to B sets, and bounds (B,) that they do not exceed but for rounding.

    Outside, the bound is the distance to a segment between two points of the set, which holds whatever
    the scan missed. Inside, it holds among the directions between those of the segment's ends.
    """
    parts = [slice(start, start + SECTIONS_AT_ONCE) for start in range(0, len(sets), SECTIONS_AT_ONCE)]
    found = [_enclosed(Supports(sets.part(part), scan), points[part]) for part in parts]
    return np.concatenate([one for one, _ in found]), np.concatenate([one for _, one in found])


def extents(sets: CurveSums, points: Array, scan: Scan = SCAN) -> Array:
    """max|H - w| (B,): the largest component of the offsets from points (B, 2) to points of the sets."""
    found = np.zeros(len(sets))
    for start in range(0, len(sets), SECTIONS_AT_ONCE):
        part = slice(start, start + SECTIONS_AT_ONCE)
        supports = Supports(sets.part(part), scan)
        own = np.arange(len(supports.sets))
        for normal in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)):
            normals = np.broadcast_to(np.array(normal), (len(own), 2))
            offset = supports.furthest(own, normals) - points[part]
            found[part] = np.maximum(found[part], (normals * offset).sum(-1))
    return found


def _enclosed(supports: "Supports", points: Array) -> tuple[Array, Array]:
    index, centre = _directions(supports, points)
    lower, upper = _Brackets(supports, index, points[index], centre).closed()
    best = _largest_of_each(index, lower)
    return lower[best], upper[best]


def _directions(supports: "Supports", points: Array) -> tuple[Index, Array]:
    """Sets (Q,) and the scan's directions [rad] (Q,) beside which the best may lie, several for one set."""
    step = 2 * np.pi / supports.scan.directions
    angle = step * np.arange(supports.scan.directions)
    reach = points @ normals_at(angle).T - supports.scanned(angle)
    # Turning by a step, the reach changes by no more than the distance to the furthest point times the step.
    change = -step * reach.min(1, keepdims=True)
    top = reach >= reach.max(1, keepdims=True) - change
    top &= (reach >= np.roll(reach, 1, 1)) & (reach >= np.roll(reach, -1, 1))
    order = np.argsort(np.where(top, -reach, np.inf), axis=1, kind="stable")[:, :MOST_DIRECTIONS]
    row, place = np.nonzero(np.take_along_axis(top, order, 1))
    return row, angle[order[row, place]]


def normals_at(angle: Array) -> Array:
    """Unit vectors (..., 2)."""
    return np.stack((np.cos(angle), np.sin(angle)), -1)


class _Brackets:
    """Intervals of directions in which the excess `g(n) = n·(w - v(n))` over the set is maximised.

    v(n) is the set's point that lies furthest along n, so g's slope is that of `n·w - n·v` with v held.
    Between two directions the set reaches at least as far as the segment between their furthest points:
    the best excess over the segment bounds g from above, and suggests where to look next.
    """

    def __init__(self, supports: "Supports", index: Index, point: Array, centre: Array):
        self.supports, self.index, self.point = supports, index, point
        step = 2 * np.pi / supports.scan.directions
        self.lower = np.full(len(index), -np.inf)
        self.low, self.high = centre - step, centre + step
        every = np.arange(len(index))
        self.start, self.end = self._probe(every, self.low), self._probe(every, self.high)
        for _ in range(8):  # where the scan was deceived by its coarseness: walk on
            back = self._slope(every, self.low, self.start) < 0
            on = ~back & (self._slope(every, self.high, self.end) > 0)
            if not (back | on).any():
                break
            self.high, self.end = np.where(back, self.low, self.high), _choose(back, self.start, self.end)
            self.low, self.start = np.where(on, self.high, self.low), _choose(on, self.end, self.start)
            self.low, self.high = np.where(back, self.low - step, self.low), np.where(on, self.high + step, self.high)
            if back.any():
                self.start[back] = self._probe(every[back], self.low[back])
            if on.any():
                self.end[on] = self._probe(every[on], self.high[on])

    def closed(self) -> tuple[Array, Array]:
        """The largest excess found, and the bound, when they agree or directions cannot be told apart."""
        size = np.abs(self.point).sum(-1) + np.abs(self.start).sum(-1) + np.abs(self.end).sum(-1)
        upper = np.full(len(self.index), np.inf)
        active = np.arange(len(self.index))
        for count in range(ROUNDS):
            bound, angle = self._over_segment(active)
            upper[active] = np.minimum(upper[active], bound)
            open_ = (upper[active] - self.lower[active] > EPS * size[active]) & (
                self.high[active] - self.low[active] > EPS
            )
            active, angle = active[open_], angle[open_]
            if not len(active):
                break
            low, high = self.low[active], self.high[active]
            unhelpful = (angle <= low) | (angle >= high) | (count % 3 == 2)
            angle = np.where(unhelpful, (low + high) / 2, angle)
            found = self._probe(active, angle)
            rising = self._slope(active, angle, found) > 0
            self.low[active[rising]], self.start[active[rising]] = angle[rising], found[rising]
            self.high[active[~rising]], self.end[active[~rising]] = angle[~rising], found[~rising]
        return self.lower, upper

    def _probe(self, active: Index, angle: Array) -> Array:
        """The sets' furthest points (a, 2) along directions; notes the excess there."""
        normal = normals_at(angle)
        found = self.supports.furthest(self.index[active], normal)
        excess = (normal * (self.point[active] - found)).sum(-1)
        self.lower[active] = np.maximum(self.lower[active], excess)
        return found

    def _slope(self, active: Index, angle: Array, found: Array) -> Array:
        slope: Array = (normals_at(angle + np.pi / 2) * (self.point[active] - found)).sum(-1)
        return slope

    def _over_segment(self, active: Index) -> tuple[Array, Array]:
        """The best excess (a,) over the segment, and the direction where it is reached."""
        start, edge = self.start[active], self.end[active] - self.start[active]
        offset = self.point[active] - start
        span = np.linalg.norm(edge, axis=-1)
        divisor = np.where(span > 0, span, 1.0)
        normal = np.stack((edge[:, 1], -edge[:, 0]), -1) / divisor[:, None]  # the set is to the left
        share = ((offset * edge).sum(-1) / divisor**2).clip(0.0, 1.0)
        gap = offset - share[:, None] * edge
        distance = np.linalg.norm(gap, axis=-1)
        # From outside, the nearest point is seen along a direction of the interval; from inside never. Of the
        # two vectors that give the direction between the ends, the longer gives it with less rounding.
        between = (share > 0) & (share < 1) & (span > distance)
        half = (self.high[active] - self.low[active]) / 2
        middle = self.low[active] + half
        seen = _turned(gap, middle)
        outside = np.abs(seen - middle) <= half + ANGLE
        across = _turned(normal, middle)
        bound = np.where(outside, distance, (normal * offset).sum(-1))
        return bound, np.where(outside & ~between, seen, across)


def _turned(vector: Array, middle: Array) -> Array:
    """Headings (a,) of vectors (a, 2), within half a turn of those in the middle."""
    heading: Array = np.arctan2(vector[:, 1], vector[:, 0])
    return middle + np.remainder(heading - middle + np.pi, 2 * np.pi) - np.pi


def _choose(chosen: NDArray[np.bool_], yes: Array, no: Array) -> Array:
    found: Array = np.where(chosen[:, None], yes, no)
    return found


def _largest_of_each(index: Index, value: Array) -> Index:
    """Where the largest value of each index is, in the order of the indices."""
    order = np.lexsort((value, index))
    last = np.append(index[order][1:] != index[order][:-1], True)
    found: Index = order[last]
    return found


# ---- how far sums of curves reach ------------------------------------------------------------


class Supports:
    """The furthest points of sums of curves; holds a table of forces.

    Attributes:
        sets: B sets.
        scan: how finely to look.
        grid: (S,) evenly spaced fractions.
        table: (B, M, S) forces there.
        rise: (B, M) largest change of force from one to the next.
    """

    def __init__(self, sets: CurveSums, scan: Scan):
        self.sets, self.scan = sets, scan
        self.grid = np.linspace(0.0, 1.0, scan.pressures)
        count = len(sets.models)
        index, actuator = np.divmod(np.arange(len(sets) * count), count)
        forces = sets.force(index, actuator, np.broadcast_to(self.grid, (len(index), len(self.grid))))
        self.table = forces.reshape(len(sets), count, -1)
        self.rise = np.abs(np.diff(self.table)).max(-1)

    def scanned(self, angle: Array) -> Array:
        """How far (B, D) the sets reach along angles (D,) at every fourth sample: for choosing directions."""
        every = np.arange(len(self.sets))
        grid, table = self.grid[::COARSE], np.ascontiguousarray(self.table[..., ::COARSE])
        found = np.empty((len(every), len(angle)))
        reach = np.empty_like(table)
        for place, normal in enumerate(normals_at(angle)):
            force, fraction = self.sets.reach(every, np.broadcast_to(normal, (len(every), 2)))
            np.multiply(table, force[..., None], out=reach)
            reach += fraction[..., None] * grid
            found[:, place] = reach.max(-1).sum(-1)
        return found

    def furthest(self, index: Index, normal: Array) -> Array:
        """The points (Q, 2) of sets `index` (Q,) furthest along normals (Q, 2)."""
        per_force, per_fraction = self.sets.reach(index, normal)
        reach = (per_force[..., None] * self.table[index]) + per_fraction[..., None] * self.grid
        step = float(self.grid[1])
        within = np.abs(per_force) * self.rise[index] + np.abs(per_fraction) * step
        row, place = _peaks(np.reshape(reach, (-1, len(self.grid))), within.ravel())
        own, actuator = np.divmod(row, len(self.sets.models))
        curve = _Curve(self.sets, index[own], actuator, per_force.ravel()[row], per_fraction.ravel()[row])
        low, high = ((place - 1) * step).clip(min=0.0), ((place + 1) * step).clip(max=1.0)
        fraction, force, value = curve.highest(low, high)
        best = _largest_of_each(row, value)
        return self.sets.wrench(index, fraction[best].reshape(per_force.shape), force[best].reshape(per_force.shape))


def _peaks(reach: Array, within: Array) -> tuple[Index, Index]:
    """Rows and places of the samples (R, S) beside which a row's highest value may lie.

    The highest sample of every row; and all others that are local maxima and come within (R,) of it,
    unless they stand out from their neighbours by rounding alone.
    """
    highest = reach.argmax(1)
    top = reach[np.arange(len(reach)), highest]
    row, place = np.nonzero(reach >= (top - within)[:, None])
    margin = 4 * EPS * np.abs(top[row])
    own = reach[row, place]
    left, right = reach[row, (place - 1).clip(min=0)], reach[row, (place + 1).clip(max=reach.shape[1] - 1)]
    peak = (own >= left) & (own >= right) & ((own > left + margin) | (own > right + margin))
    kept = peak | (place == highest[row])
    return row[kept], place[kept]


@dataclass(frozen=True, eq=False)
class _Curve:
    """R functions of a pressure fraction: so much a newton, and so much a fraction."""

    sets: CurveSums
    index: Index
    actuator: Index
    per_force: Array
    per_fraction: Array

    def highest(self, low: Array, high: Array) -> tuple[Array, Array, Array]:
        """Fractions, forces and values (R,) at the maxima in intervals, each of which holds one.

        Of evenly spaced points the two cells beside the best are kept, until no concave function through
        the points can be higher than the best by more than rounding.
        """
        fraction, force, value = (np.empty(len(low)) for _ in range(3))
        active = np.arange(len(low))
        for _ in range(ROUNDS):
            start, width = low[active], high[active] - low[active]
            places = start[:, None] + width[:, None] * np.linspace(0.0, 1.0, ZOOM)
            forces = self.sets.force(self.index[active], self.actuator[active], places)
            values = self.per_force[active, None] * forces + self.per_fraction[active, None] * places
            best, every = values.argmax(1), np.arange(len(active))
            fraction[active], force[active] = places[every, best], forces[every, best]
            value[active] = values[every, best]
            low[active] = places[every, (best - 1).clip(min=0)]
            high[active] = places[every, (best + 1).clip(max=ZOOM - 1)]
            size = np.abs(self.per_force[active] * force[active]) + np.abs(self.per_fraction[active])
            active = active[(_could_rise(values, best) > EPS * size) & (high[active] - low[active] > EPS)]
            if not len(active):
                break
        return fraction, force, value


def _could_rise(values: Array, best: Index) -> Array:
    """By how much (R,) concave functions through evenly spaced values (R, ZOOM) may exceed the best of them.

    In the cell to the right of the best, such a function stays below the line from the left neighbour
    through the best, and below that through the next two on the right; to the left likewise.
    """
    padded = np.pad(values, ((0, 0), (2, 2)), constant_values=np.nan)
    before2, before, own, after, after2 = (padded[np.arange(len(best)), best + shift] for shift in range(5))
    right = np.fmin(own - before, 2 * after - after2 - own)
    left = np.fmin(own - after, 2 * before - before2 - own)
    return np.fmax(np.where(np.isnan(after), 0.0, right), np.where(np.isnan(before), 0.0, left))
