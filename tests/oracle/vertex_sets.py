"""Sets of vertices of every kind, in the plane and in space, points about them, and their distances by brute force."""

from functools import cache
from itertools import combinations

import numpy as np
import torch
from scipy.spatial import ConvexHull, QhullError

RNG = np.random.default_rng(11)
LINE = {2: np.array([0.6, -0.8]), 3: np.array([0.6, -0.64, 0.48])}


def sets_in(dimension):
    """Vertices (V, D) by name."""
    flat = np.array([[1.0, 0.3, -2.0], [0.2, 1.0, 0.7]])[: dimension - 1, :dimension]
    box = np.stack(np.meshgrid(*[[0.0, 1.0, 2.0]] * dimension), -1).reshape(-1, dimension)
    line = LINE[dimension]
    return {
        "random": RNG.normal(size=(10, dimension)),
        "far from the origin": RNG.normal(size=(10, dimension)) + 50.0,
        "flat": RNG.normal(size=(10, dimension)) * [1.0, 1e-6, 1.0][:dimension],
        "simplex": RNG.normal(size=(dimension + 1, dimension)),
        "duplicates": np.repeat(RNG.normal(size=(6, dimension)), 3, axis=0),
        "near duplicates": np.repeat(RNG.normal(size=(6, dimension)), 3, axis=0)
        + RNG.uniform(-1e-14, 1e-14, size=(18, dimension)),
        "coplanar": RNG.normal(size=(9, dimension - 1)) @ flat,
        "coplanar with an axis": RNG.normal(size=(9, dimension)) * [1.0, 1.0, 0.0][-dimension:],
        "two points": RNG.normal(size=(2, dimension)),
        "near-duplicate pair": np.stack([0.3 * line, 0.3 * line + 1e-14]),
        "collinear": np.outer([0.0, 4.0, -2.0, 1.0, 8.0], 2 * line),
        "nearly collinear": np.outer(RNG.normal(size=8), line) + RNG.uniform(-1e-14, 1e-14, size=(8, dimension)),
        "along an axis": np.outer([2.0, -1.0, 0.5, 2.0], np.eye(dimension)[-1]) + 1.0,
        "one point": RNG.normal(size=(1, dimension)),
        "the same point": np.full((4, dimension), 0.25),
        "box with points on its faces": box,
        "very different sizes": RNG.normal(size=(9, dimension)) * [1e3, 1.0, 1.0][:dimension],
    }


SETS = {dimension: sets_in(dimension) for dimension in (2, 3)}
NAMES = tuple(SETS[2])
WITHOUT_INSIDE = frozenset(
    name
    for name in NAMES
    if name.startswith(("coplanar", "two", "near-", "collinear", "nearly", "along", "one", "the "))
)


def points_about(vertices, count=12):
    """Points far and near, inside where there is an inside, on vertices, and between two of them."""
    rng = np.random.default_rng(5)
    spread = np.ptp(vertices, axis=0).max() + 0.1
    around = vertices.mean(0) + rng.normal(size=(count, vertices.shape[1])) * spread
    mixtures = rng.dirichlet(np.ones(len(vertices)), size=count // 2) @ vertices
    near = vertices[:4] + rng.normal(size=vertices[:4].shape) * 1e-3
    return np.concatenate((around, mixtures, near, vertices[:4], (vertices[:3] + vertices[-3:][::-1]) / 2))


@cache
def problems(name, dimension):
    """Vertices, points, and their distances: 0 inside, and by brute force in 80-bit floats."""
    vertices = SETS[dimension][name]
    points = points_about(vertices)
    return vertices, points, np.array([distance(point, vertices) for point in points])


def distance(point, vertices):
    """Of a point from the hull: the nearest point lies on a vertex, a segment or a triangle of vertices."""
    offsets = np.asarray(vertices, np.longdouble) - np.asarray(point, np.longdouble)
    return 0.0 if depth(point, vertices) > 0 else float(np.sqrt(min(*_squares(offsets), np.inf)))


def depth(point, vertices):
    """How deep a point is inside by Qhull's facets; 0 or less outside, and where there is no inside."""
    if len(vertices) <= vertices.shape[1]:
        return 0.0
    try:
        planes = ConvexHull(vertices).equations
    except QhullError:
        return 0.0
    return -float((planes[:, :-1] @ point + planes[:, -1]).max())


def _squares(offsets):
    """Squared distances of the origin from vertices, and from segments and triangles where it projects into them."""
    found = list((offsets**2).sum(-1))
    for i, j in combinations(range(len(offsets)), 2):
        start, edge = offsets[i], offsets[j] - offsets[i]
        span = edge @ edge
        if span > 0:
            nearest = start + min(max(-(start @ edge) / span, np.longdouble(0)), np.longdouble(1)) * edge
            found.append(nearest @ nearest)
    triples = np.array(list(combinations(range(len(offsets)), 3)), int).reshape(-1, 3)
    start = offsets[triples[:, 0]]
    edge, side = offsets[triples[:, 1]] - start, offsets[triples[:, 2]] - start
    with np.errstate(divide="ignore", invalid="ignore"):
        shear = (edge * side).sum(-1) / (edge**2).sum(-1)
        upright = side - shear[:, None] * edge
        v = -(start * upright).sum(-1) / (upright**2).sum(-1)
        u = -((start + v[:, None] * side) * edge).sum(-1) / (edge**2).sum(-1)
        inner = (u >= 0) & (v >= 0) & (u + v <= 1)
    nearest = start + u[:, None] * edge + v[:, None] * side
    return found + list((nearest**2).sum(-1)[inner])


def size_of(points, vertices):
    """max|H - w| (n,), 1 where it is 0."""
    size = np.abs(vertices - points[:, None]).max((1, 2))
    return np.where(size > 0, size, 1.0)


def coordinates_of(points, vertices):
    """What rounding goes by (n,): the sizes of the largest coordinates, summed over the components."""
    return np.abs(vertices).max(0).sum() + np.abs(points).sum(-1)


def double(values, *, grad=False):
    return torch.tensor(np.asarray(values, dtype=float), requires_grad=grad)


def random_problems(count, vertices=8, dimension=2, seed=0, *, grad=False):
    """Points (count, D), most of them outside, and vertices (count, V, D)."""
    rng = np.random.default_rng(seed)
    return (
        double(rng.normal(size=(count, dimension)) * 1.5, grad=grad),
        double(rng.normal(size=(count, vertices, dimension)), grad=grad),
    )


def derivatives(value, *inputs):
    return torch.autograd.grad(value.sum(), inputs)
