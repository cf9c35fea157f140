"""How far a node's reactions are from what the paper says of them.

For one node the reactions are the sums of one curve an actuator. Three claims, three numbers [N, N·m counted as N]:

- *convex*: the largest distance from a point of the convex hull to the set. Candidates lie on the hull's boundary,
  where a curve that bends inwards leaves a gap, and inside; each candidate's distance is a minimum over pressures:
  a coarse scan and descents from its best places say which candidates are worst; those are confirmed by trying
  millions of combinations and `scipy.optimize.least_squares` from the best of these.
- *boundary*: the largest distance from a boundary point of the set to the image of the pressure box's boundary.
  Boundary points are those that lie furthest in some direction; if all their pressures are inside the box, no
  other pressure reaches them.
- *edges*: the largest distance from a boundary point to the convex hull of the image of the box's edges, along
  each of which one pressure varies.

All are found by search: a true worst may be larger, never zero where one is reported.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

import torcharm as ta
from experiments.hull_gallery.scenes import Array
from experiments.reference import attainable_sets

FINE = 1025
"""Points that stand for a curve: chords between them are off by a millionth of its bend."""
SCAN = {1: 1025, 2: 129, 3: 33, 4: 15}
"""Pressures of each actuator in a dense scan of all combinations."""
DIRECTIONS = 1440
LONGEST, ALONG, INSIDE = 40, 12, 150
"""Candidates on the hull: points on each of its longest faces (a gap is no larger than half its face), and inside."""
EDGES = 129
"""Pressures on each edge of the box."""
STARTS, STEPS = 4, 40
"""Places of the scan from which every candidate's distance is brought down, and damped Gauss–Newton steps from each."""
CONFIRMED, CONFIRMING = 40, 8
"""Candidates, the worst first, whose distance is confirmed, and places of all combinations to go on from."""
SOLVED = 2
"""Of these places, those from which scipy goes on."""
HALF = {1: 1025, 2: 193}
OTHER_HALF = {0: 1, 1: 257, 2: 65}
"""Pressures of each actuator when all combinations of one half of them meet all of the other half."""
TIE = 1e-9
"""Share of a curve's extent by which an end of it may fall short and still count as the furthest."""


@dataclass(frozen=True)
class CurveSum:
    """One node's reactions.

    Attributes:
        curves: (M, FINE, 2) `(f, m)` at evenly spaced pressures.
        monotonic: whether every force only rises, or only falls, with pressure, as the paper assumes.
        in_range: whether every strain, and if relative node 1's, is in the characterised range.
    """

    curves: Array
    monotonic: bool
    in_range: bool

    @property
    def actuators(self) -> int:
        return len(self.curves)

    def slopes(self, fraction: Array) -> Array:
        """Derivatives (P, M, 2) in the pressures, as fractions."""
        start = np.minimum((np.clip(fraction, 0.0, 1.0) * (FINE - 1)).astype(int), FINE - 2)
        each = np.arange(self.actuators)
        return (self.curves[each, start + 1] - self.curves[each, start]) * (FINE - 1)

    def at(self, fraction: Array) -> Array:
        """Reactions (P, 2) at pressures (P, M), as fractions of the limits."""
        place = np.clip(fraction, 0.0, 1.0) * (FINE - 1)
        start = np.minimum(place.astype(int), FINE - 2)
        share = (place - start)[..., None]
        each = np.arange(self.actuators)
        return ((1 - share) * self.curves[each, start] + share * self.curves[each, start + 1]).sum(1)


def curve_sums(arm: ta.ArmDesign, shape: Array, *, relative: bool) -> list[CurveSum]:
    """The sums of all nodes (N)."""
    sets, absolute = (attainable_sets(arm, shape, relative=kind) for kind in (relative, False))
    nodes, actuators = sets.strain.shape
    each, fraction = np.arange(actuators), np.linspace(0.0, 1.0, FINE)
    grid = np.broadcast_to(fraction, (actuators, FINE))
    low, high = np.array([model.strain_range for model in arm.actuators]).T
    found = []
    for node in range(nodes):
        place = np.full(actuators, node)
        force, own = sets.force(place, each, grid), absolute.force(place, each, grid)
        moment = sets.bending[node][:, None] * fraction - sets.radii[node][:, None] * force
        step, slack = np.diff(own, axis=1), 1e-9 * np.abs(own).max()
        monotonic = bool(((step >= -slack).all(1) | (step <= slack).all(1)).all())
        strain = sets.strain[[0, node] if relative else [node]]
        in_range = bool(((strain >= low - 1e-12) & (strain <= high + 1e-12)).all())
        found.append(CurveSum(np.stack((force, moment), -1), monotonic, in_range))
    return found


@dataclass(frozen=True)
class Violation:
    """The worst found of one property.

    Attributes:
        size: by how much [N].
        point: (2,) where.
        nearest: (2,) the nearest point that there should have been.
    """

    size: float
    point: Array
    nearest: Array


@dataclass(frozen=True)
class Findings:
    """One node's worst violations.

    Attributes:
        convex, boundary, edges: of the three claims.
        free: the most pressures that are inside their range at once on the hull's boundary.
        diameter: of the hull [N].
    """

    convex: Violation
    boundary: Violation
    edges: Violation
    free: int
    diameter: float


def examine(sums: CurveSum) -> Findings:
    """Search one node for violations of the three properties."""
    corner, fraction, normal = extreme_points(sums)
    ring = hull_ring(corner)
    inner = (fraction > 0) & (fraction < 1)
    free = inner.sum(1)
    diameter = float(np.linalg.norm(corner[:, None] - corner[None, ::8], axis=-1).max())
    return Findings(
        convexity(sums, ring),
        boundary(sums, corner[inner.all(1)]),
        beyond_edges(sums, corner[free > 1], normal[free > 1]),
        int(free.max()),
        diameter,
    )


def extreme_points(sums: CurveSum) -> tuple[Array, Array, Array]:
    """The furthest points (D, 2) in all directions, counter-clockwise; their pressures (D, M) as fractions; the
    directions (D, 2), of unit length.
    """
    angle = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    scale = np.ptp(sums.curves.sum(0), axis=0) + np.ptp(sums.curves, axis=1).sum(0)
    # Directions are even on a set that is as wide as it is high.
    normal = np.stack((np.cos(angle), np.sin(angle)), -1) / np.where(scale > 0, scale, 1.0)
    reach = np.einsum("dk,msk->dms", normal, sums.curves)
    best = reach.argmax(-1)
    top, slack = reach.max(-1), TIE * (np.ptp(reach, axis=-1) + 1e-30)
    best = np.where(reach[..., -1] >= top - slack, FINE - 1, best)
    best = np.where(reach[..., 0] >= top - slack, 0, best)
    point = sums.curves[np.arange(sums.actuators), best].sum(1)
    return point, best / (FINE - 1), normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def hull_ring(corner: Array) -> Array:
    """Different consecutive points (V, 2) of a ring."""
    step = np.linalg.norm(corner - np.roll(corner, 1, axis=0), axis=-1)
    kept = corner[step > 1e-9 * max(1.0, np.abs(corner).max())]
    return kept if len(kept) else corner[:1]


def convexity(sums: CurveSum, ring: Array) -> Violation:
    """The point of the hull that is furthest from the set."""
    face = np.roll(ring, -1, axis=0) - ring
    long = np.argsort(-np.hypot(*face.T))[:LONGEST]
    share = (np.arange(1, ALONG + 1) / (ALONG + 1))[:, None, None]
    mix = np.random.default_rng(0).dirichlet(np.full(min(len(ring), 12), 0.4), INSIDE)
    chosen = ring[np.linspace(0, len(ring) - 1, mix.shape[1]).astype(int)]
    candidates = [(ring[long] + share * face[long]).reshape(-1, 2), mix @ chosen]
    grid = np.linspace(0, 1, SCAN[sums.actuators])
    return furthest(sums, np.concatenate(candidates), [[grid] * sums.actuators])


def boundary(sums: CurveSum, corner: Array) -> Violation:
    """The boundary point that is furthest from the image of the pressure box's boundary."""
    if not len(corner):
        return Violation(0.0, np.full(2, np.nan), np.full(2, np.nan))
    grid, ends = np.linspace(0, 1, SCAN[sums.actuators]), (np.zeros(1), np.ones(1))
    faces = [
        [end if index == fixed else grid for index in range(sums.actuators)]
        for fixed, end in product(range(sums.actuators), ends)
    ]
    return furthest(sums, corner, faces)


def furthest(sums: CurveSum, candidates: Array, boxes: Sequence[Sequence[Array]]) -> Violation:
    """Of the candidates, the one that is furthest from the images of boxes of pressures, each given by its grids."""
    pressure = np.concatenate([np.stack(np.meshgrid(*box, indexing="ij"), -1).reshape(-1, len(box)) for box in boxes])
    owner = np.repeat(np.arange(len(boxes)), [int(np.prod([len(grid) for grid in box])) for box in boxes])
    image = sums.at(pressure)
    _, place = cKDTree(image, balanced_tree=False).query(candidates, k=min(STARTS, len(image)))
    starts = place.reshape(len(candidates), -1)
    movable = np.array([[len(grid) > 1 for grid in box] for box in boxes])
    target = np.repeat(candidates, starts.shape[1], axis=0)
    lowest = descend(sums, target, pressure[starts.ravel()], movable[owner[starts.ravel()]])
    lowest = lowest.reshape(starts.shape).min(1)
    halves = [Halves(sums, box) for box in boxes]
    worst = Violation(0.0, candidates[0], candidates[0])
    for index in np.argsort(-lowest)[:CONFIRMED]:
        if lowest[index] <= worst.size:  # a distance that was brought down from few places is never too small
            break
        near = [half.nearest(candidates[index]) for half in halves]
        start, own = np.concatenate(near), np.repeat(movable, [len(places) for places in near], axis=0)
        reached = descend(sums, np.broadcast_to(candidates[index], (len(start), 2)), start, own)
        best = np.argsort(reached)[:SOLVED]
        found = [confirm(sums, candidates[index], start[place], own[place]) for place in best]
        size, at = min(found, key=lambda pair: pair[0])
        size = min(size, float(reached[best[0]]), float(lowest[index]))
        if size > worst.size:
            worst = Violation(size, candidates[index], at)
    return worst


class Halves:
    """All combinations of one half of the actuators' pressures against all of the other half's: many without a list."""

    def __init__(self, sums: CurveSum, box: Sequence[Array]):
        count = (sums.actuators + 1) // 2
        parts = []
        for members, sizes in ((range(count), HALF), (range(count, sums.actuators), OTHER_HALF)):
            free = sum(len(box[index]) > 1 for index in members)
            along = np.linspace(0, 1, sizes.get(free, 1)) if free else np.zeros(1)
            grids = [along if len(box[index]) > 1 else box[index] for index in members]
            pressure = np.array(list(product(*grids))) if grids else np.zeros((1, 0))
            own = CurveSum(sums.curves[list(members)], True, True)
            parts.append((pressure, own.at(pressure) if grids else np.zeros((1, 2))))
        (self.first, image), (self.second, self.offset) = parts
        _, kept = np.unique(np.round(image, 6), axis=0, return_index=True)  # repeats would slow the tree down
        self.first, image = self.first[kept], image[kept]
        self.tree = cKDTree(image, balanced_tree=False)

    def nearest(self, target: Array) -> Array:
        """Pressures (K, M) of the nearest reactions, of different pressures of the second half."""
        if len(self.offset) == 1:
            _, place = self.tree.query(target - self.offset[0], k=min(CONFIRMING, len(self.first)))
            place = np.atleast_1d(place)
            return np.hstack((self.first[place], np.repeat(self.second, len(place), axis=0)))
        distance, place = self.tree.query(target - self.offset)
        best = np.argsort(distance)[:CONFIRMING]
        return np.hstack((self.first[place[best]], self.second[best]))


def descend(sums: CurveSum, target: Array, fraction: Array, movable: Array) -> Array:
    """Distances (Q,) from targets (Q, 2) to the set near pressures (Q, M), of which some move: damped Gauss–Newton."""
    damping = np.full(len(target), 1e-6)
    gap = sums.at(fraction) - target
    for _ in range(STEPS):
        slope = np.where(movable[..., None], sums.slopes(fraction), 0.0)
        push = -np.einsum("qmk,qk->qm", slope, gap)
        stuck = ((fraction <= 0) & (push < 0)) | ((fraction >= 1) & (push > 0))
        slope = np.where(stuck[..., None], 0.0, slope)
        square = np.einsum("qmj,qmk->qjk", slope, slope)
        size = np.trace(square, axis1=1, axis2=2) * damping + 1e-30
        step = -np.einsum(
            "qmk,qk->qm", slope, np.linalg.solve(square + size[:, None, None] * np.eye(2), gap[..., None])[..., 0]
        )
        trial = np.clip(fraction + step, 0.0, 1.0)
        new = sums.at(trial) - target
        better = (new**2).sum(1) < (gap**2).sum(1)
        fraction, gap = np.where(better[:, None], trial, fraction), np.where(better[:, None], new, gap)
        damping = np.clip(np.where(better, damping / 4, damping * 10), 1e-9, 1e9)
    return np.hypot(*gap.T)


def confirm(sums: CurveSum, target: Array, fraction: Array, movable: NDArray[np.bool_]) -> tuple[float, Array]:
    """The distance to the set near a pressure, and the point there, by scipy."""
    free, whole = np.flatnonzero(movable), fraction.copy()

    def gap(values: Array) -> Array:
        whole[free] = values
        return sums.at(whole[None])[0] - target

    def slopes(values: Array) -> Array:
        whole[free] = values
        return sums.slopes(whole[None])[0, free].T

    off = sums.at(fraction[None])[0] - target
    if len(free):
        off = gap(least_squares(gap, fraction[free], slopes, bounds=(0.0, 1.0), max_nfev=50).x)
    return float(np.hypot(*off)), target + off


def beyond_edges(sums: CurveSum, corner: Array, normal: Array) -> Violation:
    """How far the set reaches beyond the convex hull of the image of all edges of the pressure box.

    Of two convex sets, one in the other, the largest distance is the largest difference of their support functions.
    """
    if not len(corner):
        return Violation(0.0, np.full(2, np.nan), np.full(2, np.nan))
    over = (corner * normal).sum(1) - (normal @ edge_image(sums, EDGES).T).max(1)
    worst = int(over.argmax())
    size = max(float(over[worst]), 0.0)
    return Violation(size, corner[worst], corner[worst] - size * normal[worst])


def edge_image(sums: CurveSum, samples: int) -> Array:
    """Reactions to `samples` pressures on every edge of the box."""
    along = np.linspace(0, 1, samples)
    rows = []
    for index in range(sums.actuators):
        for ends in product((0.0, 1.0), repeat=sums.actuators - 1):
            rows.append(np.insert(np.tile(ends, (samples, 1)), index, along, axis=1))
    return sums.at(np.concatenate(rows))
