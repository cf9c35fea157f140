"""Distances from attainable sets by other means, which share no code with the library.

A set is known by its curves alone: published branches for forces, dense samples for what is furthest along a
direction, numpy's longdouble (19 digits on x86, float64 elsewhere) for the sums. From inside a distance is that from
the hull of finitely many points of the set (scipy's NNLS), from outside that from a supporting plane; points are added
until the two meet. Margins are those of the facets that Qhull finds of such points.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.spatial import ConvexHull, QhullError

Real = np.longdouble
Array = NDArray[Any]
SAMPLES = 65
"""Pressures of a curve that are tried first, evenly spaced, and as many more that crowd towards no pressure."""
ZOOMS, ZOOM_SAMPLES = 8, 17
"""So often the neighbourhood of the best is sampled again: to `(2 / 16) ** 8` of a sample's distance."""
PATIENCE = 80
"""Points of a set that are added at most."""
MET = 1e-9
"""By this part of max|H - w| bounds from inside and outside may differ when they are said to meet."""

Force = Callable[[Array, Array], Array]
Kinks = Callable[[Array], Sequence[Array]]


@dataclass(frozen=True)
class Model:
    """A force [N] of strain and pressure [kPa] in numpy, and the pressures at which it has kinks."""

    force: Force
    kinks: Kinks


@dataclass(frozen=True)
class Sets:
    """Sums of M curves in D components, and the wrenches to be compared with them, for B problems.

    Attributes:
        models: M of them.
        strain: (B, M).
        first: (B, M) strains of which the forces are subtracted, or None.
        lever: (B, M, D) the wrench of 1 N.
        bending: (B, M, D) the wrench of 1 kPa.
        limit: (B, M) [kPa].
        target: (B, D).
    """

    models: tuple[Model, ...]
    strain: Array
    first: Array | None
    lever: Array
    bending: Array
    limit: Array
    target: Array

    def those(self, which: Array) -> "Sets":
        """Some of the problems."""
        first = None if self.first is None else self.first[which]
        rest = (self.lever[which], self.bending[which], self.limit[which], self.target[which])
        return Sets(self.models, self.strain[which], first, *rest)

    def force(self, a: int, pressure: Array) -> Array:
        """(B, S) forces of actuator a at pressures (B, S), less those at the first strain."""
        kind = pressure.dtype.type
        force = self.models[a].force(self.strain[:, a, None].astype(kind), pressure)
        if self.first is not None:
            force = force - self.models[a].force(self.first[:, a, None].astype(kind), pressure)
        return force

    def kinks(self, a: int) -> list[Array]:
        """Pressures (B,) within the limits at which the curve of actuator a may have a kink."""
        strains = [self.strain[:, a]] + ([] if self.first is None else [self.first[:, a]])
        return [np.clip(knot, 0.0, self.limit[:, a]) for x in strains for knot in self.models[a].kinks(x)]

    def wrench(self, pressure: Array) -> Array:
        """(B, D) in longdouble, at pressures (B, M), seen from the target."""
        total = -self.target.astype(Real)
        for a in range(len(self.models)):
            p = pressure[:, a, None].astype(Real)
            total = total + self.force(a, p) * self.lever[:, a] + p * self.bending[:, a]
        return cast(Array, total)


def furthest(sets: Sets, normal: Array) -> Array:
    """(B, M) the pressures at which the curves reach furthest along normals (B, D)."""
    found = np.zeros(sets.strain.shape)
    for a in range(len(sets.models)):
        by_force = (normal * sets.lever[:, a]).sum(-1)[:, None]
        by_pressure = (normal * sets.bending[:, a]).sum(-1)[:, None]
        limit = sets.limit[:, a, None]
        even = np.linspace(0, 1, SAMPLES)
        grid = np.concatenate((limit * even, limit * even**4, *(k[:, None] for k in sets.kinks(a))), -1)
        best = _best(sets, a, grid, by_force, by_pressure)
        width = limit / (SAMPLES - 1)
        for _ in range(ZOOMS):
            around = np.clip(best + width * np.linspace(-1, 1, ZOOM_SAMPLES), 0.0, limit)
            best = _best(sets, a, np.concatenate((best, around), -1), by_force, by_pressure)
            width = width * (2.0 / (ZOOM_SAMPLES - 1))
        found[:, a] = best[:, 0]
    return found


def _best(sets: Sets, a: int, grid: Array, by_force: Array, by_pressure: Array) -> Array:
    """(B, 1) of pressures (B, S) the one that reaches furthest."""
    reach = by_force * sets.force(a, grid) + by_pressure * grid
    return np.take_along_axis(grid, reach.argmax(-1)[:, None], -1)


def support(sets: Sets, normal: Array) -> tuple[Array, Array]:
    """How far the sets reach beyond the target along normals (B, D), (B,), and where, (B, D); in longdouble."""
    point = sets.wrench(furthest(sets, normal))
    return (normal * point).sum(-1), point


def distances(sets: Sets) -> tuple[Array, Array, Array]:
    """Lower and upper bounds (B,) of the distances, found without the library, and max|H - w| (B,).

    The nearest point of a hull of points V, seen from w, is `V s / Σ s` of the least squares `V s = 0, Σ s = 1, s ≥ 0`.
    The last is taken along the axes, both ways, and is low by a factor of at most the root of D.
    """
    dimension, count = sets.target.shape[-1], len(sets.target)
    axes = [np.broadcast_to(axis, sets.target.shape) for axis in (*np.eye(dimension), *-np.eye(dimension))]
    reach, first = (np.stack(part, 1) for part in zip(*(support(sets, axis) for axis in axes), strict=True))
    size = np.abs(reach).max(1).astype(float)
    unit = np.where(size > 0, size, 1.0)
    points = [list(own) for own in first / unit[:, None, None]]
    low, high, active = np.zeros(count), np.full(count, np.inf), np.arange(count)
    for _ in range(PATIENCE):
        normal, going = np.zeros((len(active), dimension)), np.ones(len(active), bool)
        for k, b in enumerate(active):
            nearest, points[b] = _nearest(points[b])
            length = float(np.sqrt((nearest**2).sum()))
            high[b] = min(high[b], length)
            going[k] = high[b] > MET and high[b] - low[b] > MET
            normal[k] = -nearest / length if length > 0 else 0.0
        active, normal = active[going], normal[going]
        if not len(active):
            break
        reach, point = support(sets.those(active), normal)
        point, known = point / unit[active, None], np.zeros(len(active), bool)
        for k, b in enumerate(active):
            low[b] = max(low[b], -float(reach[k]) / unit[b])
            known[k] = any((point[k] == old).all() for old in points[b])
            points[b].append(point[k])
        active = active[~known]
    return low * unit, high * unit, size


def largest_numbers(sets: Sets) -> Array:
    """(B,) what forces and wrenches add up to before they cancel: rounding is a part of this."""
    total = np.abs(sets.target).sum(-1)
    for a, model in enumerate(sets.models):
        grid = sets.limit[:, a, None] * np.linspace(0, 1, 5)
        strains = [sets.strain[:, a, None]] + ([] if sets.first is None else [sets.first[:, a, None]])
        total = total + sum(np.abs(model.force(x, grid)).max(-1) for x in strains)
    return cast(Array, total)


def _nearest(points: list[Array]) -> tuple[Array, list[Array]]:
    """The point of a hull that is nearest to 0, and those of its points (D,) that are needed for it."""
    matrix = np.vstack((np.stack(points, -1).astype(float), np.ones(len(points))))
    share = nnls(matrix, np.append(np.zeros(len(matrix) - 1), 1.0))[0].astype(Real)
    kept = [point for s, point in zip(share, points, strict=True) if s > 0]
    weights = share[share > 0] / share.sum()
    return (weights[:, None] * np.stack(kept)).sum(0), kept


def _reached(sets: Sets, directions: Array, size: float) -> list[Array]:
    """Points of the one set furthest along directions (K, D), seen from the target, as parts of a size."""
    unit = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    return list(support(sets.those(np.zeros(len(unit), int)), unit)[1].astype(float) / size)


def margin(sets: Sets, size: float, gap: float = 1e-8) -> tuple[float, float]:
    """Lower and upper bound of how deep the target of one problem lies inside its set; negative where it is outside.

    Qhull's facets of points of the set bound it from below, the set's reach along the nearest facet's normal from
    above; then that point is added. Sets without volume have no depth: 0.
    """
    directions = np.random.default_rng(0).normal(size=(24, sets.target.shape[-1]))
    points = _reached(sets, directions, size)
    for _ in range(3):  # along all random directions a thin set may reach no further than its few far ends
        axes = np.linalg.svd(np.array(points) - np.mean(points, 0), full_matrices=False)[2]
        points += _reached(sets, np.concatenate((axes, -axes)), size)
    low, high = 0.0, np.inf
    for _ in range(5 * PATIENCE):
        try:
            facets = ConvexHull(np.array(points)).equations
        except QhullError:
            return 0.0, 0.0
        nearest = int(np.argmax(facets[:, -1]))
        low, normal = -facets[nearest, -1], facets[nearest, :-1]
        reach, point = support(sets, normal[None])
        high = min(high, float(reach[0]) / size)
        if high - low <= gap or high <= 0:
            break
        points.append(point[0].astype(float) / size)
    return min(low, high) * size, high * size
