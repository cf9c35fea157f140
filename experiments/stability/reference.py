"""The right answers, from the equations alone, in extended precision and by another algorithm.

It reads the data of arms and tasks and shares no code with the library: numpy's longdouble (19 digits
on x86, float64 elsewhere), chords for the rod, the published branches for forces. No polygon is built: a
hull is known by how far it reaches along a direction, and a distance is the best of finitely many
separating lines.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

import torcharm as ta

Real = np.longdouble
Array = NDArray[np.longdouble]
ONE = Real(1)
ROUNDS = 24
"""Of refining the samples of a curve, at most: some muscles that are stretched far beyond their range take ten."""
STEP = Real(2) ** -15
"""Largest relative step of the differences that derivatives are taken from."""
CHUNK = 2_000_000
GAP = 1e-14
"""By this part of max|H - w| bounds of a distance from both sides may differ: derivatives are taken of it."""

BELLOWS = (
    (1, 0, 10.47),
    (0, 1, -1.068),
    (2, 0, -7.344),
    (1, 1, 0.5504),
    (0, 2, 0.00205),
    (3, 0, 19.39),
    (2, 1, -0.03461),
    (1, 2, -0.006294),
    (0, 3, 3.081e-5),
)
"""Terms (i, j, c) of the paper's `-f = Σ c ε^i p^j`."""


# ---- forces -------------------------------------------------------------------------------


def force(model: ta.Actuator, strain: Array, pressure: Array) -> Array:
    """Axial force [N], positive pushing."""
    if isinstance(model, ta.McKibben):
        return -Real(model.force_scale) * mckibben_pull(strain, pressure)
    assert isinstance(model, ta.PolynomialActuator)
    bellows = isinstance(model, ta.Bellows)
    terms, sign = (BELLOWS, -1) if bellows else (model.coefficients, 1)
    total = sum((Real(c) * strain**i * pressure**j for i, j, c in terms), np.zeros_like(strain + pressure))
    return sign * Real(model.force_scale) * total


def mckibben_pull(e: Array, p: Array) -> Array:
    """F of the published muscle model, branch by branch."""
    a1, a2 = Real(1.038555666), Real(0.511454549)
    b1, b2, b3 = Real(1.963398204), Real(-3.169979385), Real(4.231857967)
    lim, crit = Real(-0.274484489), Real(-0.303225592)

    def compression(x: Any) -> Any:
        return Real(265.2968218) * x**4 + Real(320.5906703) * x**3 + Real(126.11975) * x**2 + Real(21.92761236) * x

    def threshold(x: Any) -> Any:
        return Real(34610.2847) * x**4 + Real(5991.799518) * x**3 - Real(1032.874471) * x**2 - Real(395.9792747) * x

    def slope(x: Any) -> Any:
        return Real(0.637225654) * (Real(0.453137516) + x) ** 2

    z, c, s = threshold(e), compression(e), slope(e)
    stretch = Real(89998.04265) * e**3 + Real(836.5810641) * e**2 + Real(62.59606786) * e
    exponent = 1 + b3 * np.maximum(e, 0)
    extended = stretch + b1 * (np.sqrt(a1 * a2**2 / b1) + b2 * e) ** 2 * p**exponent
    pulling = a1 * (a2 + e) ** 2 * (p - z)
    rising = c + np.maximum(0, s * (p - z) - c)
    onset = compression(lim) / slope(lim) + threshold(lim)
    rate = np.where(e >= crit, slope(lim) / (lim - crit) ** 2, Real(-3.695687763))
    collapsed = c + rate * (e - crit) ** 2 * np.maximum(0, p - onset)
    return np.select([e >= 0, p >= z, e >= lim], [extended, pulling, rising], collapsed)


# ---- from an arm and a task to points and sets ------------------------------------------------


@dataclass(frozen=True)
class Sections:
    """The M actuators at N nodes.

    Attributes:
        models: M force models.
        strain: (N, M).
        bending: (N, M) bending moment per pressure [N·m/kPa].
        radii, limit: (M,) [m], [kPa].
        relative: whether node 1's reaction is taken off.
    """

    models: tuple[ta.Actuator, ...]
    strain: Array
    bending: Array
    radii: Array
    limit: Array
    relative: bool

    def wrench(self, pressure: Array, nodes: Any = slice(None)) -> Array:
        """(K, M, S, 2) what each actuator adds to the reaction at pressures (K, M, S) of some of the nodes."""
        own = self._wrench(self.strain[nodes], self.bending[nodes], pressure)
        return own - self._wrench(self.strain[:1], self.bending[:1], pressure) if self.relative else own

    def _wrench(self, strain: Array, bending: Array, pressure: Array) -> Array:
        columns = [force(model, strain[:, m, None], pressure[:, m]) for m, model in enumerate(self.models)]
        push = np.stack(columns, 1)
        return np.stack((push, bending[..., None] * pressure - self.radii[:, None] * push), -1)


def sections(arm: ta.ArmDesign, task: ta.Task, relative: bool, radius: Real = ONE, length: Real = ONE) -> Sections:
    """One design on one shape, radii and neutral lengths scaled by factors.

    The material curvature κ/l has a pole where an actuator's length l is zero. The library holds
    |l| at a millionth of the neutral length, and so does this: it is a convention, not an equation.
    """
    twists, radii, neutral = (real(value) for value in (task.twists, arm.radii, arm.length))
    radii, neutral = radii * radius, neutral * length
    own = twists[:, :1] - radii * twists[:, 2:]
    floor = neutral * Real(1e-6)
    held = np.where(abs(own) < floor, np.where(own < 0, -floor, floor), own)
    per_pressure = np.array(
        [Real(cast(float, model.bending_stiffness)) / Real(model.max_pressure) for model in arm.actuators]
    )
    bending = per_pressure * twists[:, 2:] / held
    return Sections(arm.actuators, own / neutral - 1, bending, radii, real(arm.max_pressure), relative)


def required(task: ta.Task) -> Array:
    """(N, 2) the wrench `(f_x, m)` the task asks of each node: plain statics about it.

    A segment's chord is its length times sin(κ/2)/(κ/2), at half its turn.
    """
    twists, load, base = (real(value) for value in (task.twists, task.tip_load, task.base_pose))
    step = twists / len(twists)
    half = step[:, 2] / 2
    shrink = np.where(half == 0, 1, np.sin(half) / np.where(half == 0, 1, half))
    heading = base[2] + np.concatenate((np.zeros(1, Real), np.cumsum(step[:, 2])))
    middle = heading[:-1] + half
    chord = shrink * (step[:, 0] + 1j * step[:, 1]) * np.exp(1j * middle)
    to_tip = np.cumsum(chord[::-1])[::-1]
    moment = load[2] + to_tip.real * load[1] - to_tip.imag * load[0]
    axial = np.cos(heading[:-1]) * load[0] + np.sin(heading[:-1]) * load[1]
    return -np.stack((axial, moment), -1)


def real(value: Any) -> Array:
    """A tensor's numbers, in extended precision."""
    return np.asarray(value.detach().double().numpy(), dtype=Real)


# ---- distances ------------------------------------------------------------------------------


def signed_distance(point: Array, sets: Array) -> Array:
    """(B,) distance from points (B, 2) to sums of M hulls of S points (B, M, S, 2); inside minus the margin."""
    return best_direction(point, sets)[0]


def best_direction(point: Array, sets: Array) -> tuple[Array, Array]:
    """The signed distance (B,), and the unit direction (B, 2) of the line that shows it.

    For a unit vector n, `n·w - Σ max n·c` is at most the signed distance, and equals it at one of
    these: a normal of two points of one set, or the direction from a corner to w. Corners are where
    the sum reaches furthest along a direction between two such normals.
    """
    batch, _, samples, _ = sets.shape
    directions = sets.shape[1] * samples * (samples - 1) + 4
    rows = max(1, CHUNK // (directions * samples))
    parts = [_best_direction(point[k : k + rows], sets[k : k + rows]) for k in range(0, batch, rows)]
    return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])


def _best_direction(point: Array, sets: Array) -> tuple[Array, Array]:
    normals = _pair_normals(sets)
    away = _unit(point[:, None] - _furthest(sets, _between(normals)))
    directions = np.concatenate((normals, away), 1)
    gap = (directions * point[:, None]).sum(-1) - _reach(sets, directions)
    best = gap.argmax(1)[:, None]
    return np.take_along_axis(gap, best, 1)[:, 0], np.take_along_axis(directions, best[..., None], 1)[:, 0]


def _pair_normals(sets: Array) -> Array:
    first, second = np.triu_indices(sets.shape[2], 1)
    edge = (sets[:, :, second] - sets[:, :, first]).reshape(len(sets), -1, 2)
    normal = _unit(np.stack((edge[..., 1], -edge[..., 0]), -1))
    axes = np.broadcast_to(np.array([[1, 0], [0, 1], [-1, 0], [0, -1]], Real), (len(sets), 4, 2))
    return np.concatenate((normal, -normal, axes), 1)


def _unit(vector: Array) -> Array:
    """Of length 1; (1, 0) for zero, which is as good a direction as any."""
    size = np.hypot(vector[..., 0], vector[..., 1])[..., None]
    return np.where(size > 0, vector / np.where(size > 0, size, 1), np.array([1, 0], Real))


def _between(normals: Array) -> Array:
    """(B, D, 2) directions half way between neighbours."""
    angle = np.sort(np.arctan2(normals[..., 1], normals[..., 0]), 1)
    following = np.concatenate((angle[:, 1:], angle[:, :1] + 2 * Real(np.pi)), 1)
    middle = (angle + following) / 2
    return np.stack((np.cos(middle), np.sin(middle)), -1)


def _along(points: Array, directions: Array) -> Array:
    """(B, D, S) how far points (B, S, 2) lie along directions (B, D, 2)."""
    x, y = points[:, None, :, 0], points[:, None, :, 1]
    total: Array = np.add(directions[..., :1] * x, directions[..., 1:] * y)
    return total


def _reach(sets: Array, directions: Array) -> Array:
    return sum(
        (_along(sets[:, m], directions).max(-1) for m in range(sets.shape[1])), np.zeros(directions.shape[:2], Real)
    )


def _furthest(sets: Array, directions: Array) -> Array:
    """(B, D, 2) the sum's points furthest along directions."""
    total = np.zeros_like(directions)
    for m in range(sets.shape[1]):
        index = _along(sets[:, m], directions).argmax(-1)
        total += np.take_along_axis(sets[:, m], index[..., None], 1)
    return total


def size(point: Array, sets: Array) -> Array:
    """(B,) max|H - w| over the hull's points H."""
    axes = np.broadcast_to(np.array([[1, 0], [0, 1], [-1, 0], [0, -1]], Real), (len(sets), 4, 2))
    apart: Array = _reach(sets, axes) - (axes * point[:, None]).sum(-1)
    return np.asarray(abs(apart).max(1))


# ---- attainability ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Distances:
    """Distances (N,) of one metric's nodes, and (N,) the scale their errors are measured on."""

    value: Array
    scale: Array

    @property
    def total(self) -> float:
        return float(self.value.sum())


def node_distances(
    arm: ta.ArmDesign,
    task: ta.Task,
    metric: str,
    samples: int | None,
    radius: Real = ONE,
    length: Real = ONE,
    gap: float = GAP,
) -> Distances:
    """Distances from what a task requires to what a design can provide.

    Args:
        arm, task: one of each.
        metric: "absolute" or "relative".
        samples: points on each curve, evenly spaced; None for the whole curve.
        radius, length: factors on radii and neutral lengths.
        gap: the part of max|H - w| by which distances from whole curves may be off.
    """
    relative = metric == "relative"
    absolute = sections(arm, task, False, radius, length)
    wanted = required(task)
    scale = size(wanted, absolute.wrench(_grid(absolute, samples or 9)))
    own, point = absolute, wanted
    if relative:  # differences of numbers that large: their rounding is the unit of the error
        own, point, scale = sections(arm, task, True, radius, length), wanted - wanted[0], scale + scale[0]
    if samples is None:
        return Distances(curve_distance(point, own, gap), scale)
    return Distances(np.maximum(signed_distance(point, own.wrench(_grid(own, samples))), 0), scale)


def _grid(own: Sections, samples: int) -> Array:
    steps = np.arange(samples, dtype=Real) / (samples - 1)
    return np.broadcast_to(own.limit[:, None] * steps, (*own.strain.shape, samples))


def curve_distance(point: Array, own: Sections, gap: float = GAP) -> Array:
    """(N,) distances to the sums of whole curves.

    Where the sampled sets are furthest from the point, every curve is sampled once more where it reaches
    furthest that way, until none reaches further: the sampled distance is an upper bound, the
    line a lower one. Nodes where these agree are left out of what follows.
    """
    pressure, nodes, found = _grid(own, 9), np.arange(len(point)), np.zeros(len(point), Real)
    for _ in range(ROUNDS):
        sets, wanted = own.wrench(pressure, nodes), point[nodes]
        upper, direction = best_direction(wanted, sets)
        found[nodes] = np.maximum(upper, 0)
        more = furthest_pressure(own, direction, nodes)
        pressure = np.concatenate((pressure, more[..., None]), -1)
        reach = _reach(own.wrench(pressure, nodes), direction[:, None])[:, 0]
        lower = (direction * wanted).sum(-1) - reach
        open_ = found[nodes] - np.maximum(lower, 0) > gap * size(wanted, sets)
        if not open_.any():
            break
        pressure, nodes = pressure[open_], nodes[open_]
    return found


def furthest_pressure(own: Sections, direction: Array, nodes: Any = slice(None)) -> Array:
    """(K, M) pressures at which each actuator of some nodes reaches furthest along directions (K, 2), by zooming in."""
    low = np.zeros_like(own.strain[nodes])
    high = np.broadcast_to(own.limit, low.shape)
    for count in (257, *(17,) * 16):
        grid = low[..., None] + (high - low)[..., None] * (np.arange(count, dtype=Real) / (count - 1))
        reach = (own.wrench(grid, nodes) * direction[:, None, None]).sum(-1)
        best = reach.argmax(-1)[..., None]
        low = np.take_along_axis(grid, np.maximum(best - 1, 0), -1)[..., 0]
        high = np.take_along_axis(grid, np.minimum(best + 1, count - 1), -1)[..., 0]
    return np.take_along_axis(grid, best, -1)[..., 0]


def polygon_distance(point: Array, vertices: Array) -> Distances:
    """As for one node: distances from points (B, 2) to hulls of vertices (B, V, 2)."""
    sets = vertices[:, None]
    return Distances(np.maximum(signed_distance(point, sets), 0), size(point, sets))


# ---- derivatives ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Derivative:
    """What a derivative may be.

    Attributes:
        low, high: the one-sided derivatives, in order; they differ at a kink.
        smooth: whether there is none.
        settled: whether the differences converged at all.
    """

    low: float
    high: float
    smooth: bool
    settled: bool


def derivative(value: Callable[[Real], Array], scale: float) -> Derivative:
    """Of `value(t).sum()` at t = 0, from differences extrapolated to a step of zero.

    Args:
        value: from t to (N,) numbers, each with kinks of its own.
        scale: below a billionth of this differences do not count.
    """
    steps = [STEP / 2**k for k in range(3)]
    start = value(Real(0))
    ahead, behind = ([value(sign * step) for step in steps] for sign in (1, -1))
    right = _extrapolated([(there - start) / step for there, step in zip(ahead, steps, strict=True)], 2)
    left = _extrapolated([(start - there) / step for there, step in zip(behind, steps, strict=True)], 2)
    central = [(a - b) / (2 * step) for a, b, step in zip(ahead, behind, steps, strict=True)]
    both = _extrapolated(central, 4)
    even = abs(right[0] - left[0]) <= 1e-8 * (scale + abs(both[0])) + 10 * (right[1] + left[1])
    low = np.where(even, both[0], np.minimum(left[0], right[0])).sum()
    high = np.where(even, both[0], np.maximum(left[0], right[0])).sum()
    doubt = np.where(even, both[1], left[1] + right[1]).sum()
    settled = bool(doubt <= 1e-8 * (scale + max(abs(low), abs(high))))
    return Derivative(float(low), float(high), bool(even.all()), settled)


def _extrapolated(table: list[Array], ratio: int) -> tuple[Array, Array]:
    """Richardson's limit of values whose step halves, and how far it is from the one before.

    Args:
        table: values at steps h, h/2, ...
        ratio: 2 if their error is a series in h, 4 if in h².
    """
    factor = ratio
    while len(table) > 1:
        previous = table[-1]
        table = [(factor * b - a) / (factor - 1) for a, b in pairwise(table)]
        factor *= ratio
    return table[0], abs(table[0] - previous)
