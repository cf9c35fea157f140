"""An independent oracle: the model's equations, written down once more in plain numpy and scipy.

It shares nothing with torcharm: scalar arithmetic, matrix exponentials, Qhull, branches and loops.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import product

import numpy as np
from scipy.spatial import ConvexHull, QhullError

HANGING = (0.0, 0.0, -math.pi / 2)
PAPER_STIFFNESS = -1.0 / 3.5


@dataclass(frozen=True)
class Actuator:
    """A force f(ε, p) [N], its K [N·m²], and the pressure [kPa] at which K holds."""

    force: Callable[[float, float], float]
    stiffness: float = PAPER_STIFFNESS
    reference: float = 50.0


@dataclass(frozen=True)
class Arm:
    radii: tuple[float, ...]
    lengths: tuple[float, ...]
    limits: tuple[float, ...]
    actuators: tuple[Actuator, ...]


def bellows_force(e: float, p: float) -> float:
    return -(
        10.47 * e
        - 1.068 * p
        - 7.344 * e**2
        + 0.5504 * e * p
        + 0.00205 * p**2
        + 19.39 * e**3
        - 0.03461 * e**2 * p
        - 0.006294 * e * p**2
        + 3.081e-5 * p**3
    )


def mckibben_force(e: float, p: float) -> float:
    a1, a2 = 1.038555666, 0.511454549
    b1, b2, b3 = 1.963398204, -3.169979385, 4.231857967
    lim, crit = -0.274484489, -0.303225592

    def passive(x: float) -> float:
        return 265.2968218 * x**4 + 320.5906703 * x**3 + 126.11975 * x**2 + 21.92761236 * x

    def threshold(x: float) -> float:
        return 34610.2847 * x**4 + 5991.799518 * x**3 - 1032.874471 * x**2 - 395.9792747 * x

    def slope(x: float) -> float:
        return 0.637225654 * (0.453137516 + x) ** 2

    if e >= 0:
        stretch = 89998.04265 * e**3 + 836.5810641 * e**2 + 62.59606786 * e
        pull = stretch + b1 * (math.sqrt(a1 * a2**2 / b1) + b2 * e) ** 2 * p ** (1 + b3 * e)
    elif p >= threshold(e):
        pull = a1 * (a2 + e) ** 2 * (p - threshold(e))
    elif e >= lim:
        pull = passive(e) + max(0.0, slope(e) * (p - threshold(e)) - passive(e))
    else:
        onset = passive(lim) / slope(lim) + threshold(lim)
        rate = slope(lim) / (lim - crit) ** 2 if e >= crit else -3.695687763
        pull = passive(e) + rate * (e - crit) ** 2 * max(0.0, p - onset)
    return -pull


def polynomial_force(coefficients) -> Callable[[float, float], float]:
    return lambda e, p: sum(c * e**i * p**j for i, j, c in coefficients)


def scaled(force: Callable[[float, float], float], factor: float) -> Callable[[float, float], float]:
    return lambda e, p: factor * force(e, p)


# --- the rod ---


def pose_matrix(pose) -> np.ndarray:
    x, y, angle = pose
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array([[cos, -sin, x], [sin, cos, y], [0, 0, 1]])


def matrix_exponential(matrix: np.ndarray) -> np.ndarray:
    """The power series, for matrices of moderate size (scipy's wakes its threads for every call)."""
    total = term = np.eye(len(matrix))
    for order in range(1, 40):
        term = term @ matrix / order
        total = total + term
    return total


def node_matrices(twists, base_pose=HANGING) -> list[np.ndarray]:
    """N+1 homogeneous matrices, by products of matrix exponentials."""
    nodes = [pose_matrix(base_pose)]
    for length, shear, turn in np.asarray(twists):
        generator = np.array([[0, -turn, length], [turn, 0, shear], [0, 0, 0]])
        nodes.append(nodes[-1] @ matrix_exponential(generator / len(twists)))
    return nodes


def required_wrenches(twists, load, base_pose=HANGING) -> np.ndarray:
    """(N, 3), by plain statics: the load's force and its moment about each node, negated."""
    nodes = node_matrices(twists, base_pose)
    force = np.array(load[:2])
    found = []
    for node in nodes[:-1]:
        lever = nodes[-1][:2, 2] - node[:2, 2]
        moment = load[2] + lever[0] * force[1] - lever[1] * force[0]
        found.append(-np.append(node[:2, :2].T @ force, moment))
    return np.array(found)


def required_wrenches_by_adjoint(twists, load, base_pose=HANGING) -> np.ndarray:
    """(N, 3), by carrying the load's body wrench with Ad^{-T} of the pose from node to tip."""
    nodes = node_matrices(twists, base_pose)
    tip = nodes[-1]
    body = np.append(tip[:2, :2].T @ np.array(load[:2]), load[2])
    found = []
    for node in nodes[:-1]:
        to_tip = np.linalg.inv(node) @ tip
        adjoint = np.eye(3)
        adjoint[:2, :2] = to_tip[:2, :2]
        adjoint[:2, 2] = to_tip[1, 2], -to_tip[0, 2]
        found.append(-np.linalg.inv(adjoint).T @ body)
    return np.array(found)


# --- reactions ---


def actuator_wrench(arm: Arm, index: int, twist, pressure: float) -> tuple[float, float]:
    """What one actuator adds to the reaction `(f_x, m)` of a cross-section."""
    model, radius, neutral = arm.actuators[index], arm.radii[index], arm.lengths[index]
    own_length = twist[0] - radius * twist[2]
    force = model.force((own_length - neutral) / neutral, pressure)
    bending = model.stiffness * (pressure / model.reference) * twist[2] / own_length
    return force, -radius * force + bending


def reaction(arm: Arm, twist, pressures) -> np.ndarray:
    return sum(np.array(actuator_wrench(arm, index, twist, p)) for index, p in enumerate(pressures))


def curves(arm: Arm, twist, samples: int) -> np.ndarray:
    """(M, S, 2): each actuator's reaction at S evenly spaced pressures from 0 to its limit."""
    return np.array(
        [
            [actuator_wrench(arm, index, twist, p) for p in np.linspace(0.0, limit, samples)]
            for index, limit in enumerate(arm.limits)
        ]
    )


@cache
def edge_indices(actuators: int, samples: int) -> np.ndarray:
    """(points, M) sample indices of the paper: every edge of the pressure box, `samples` points each."""
    rows = []
    for free in range(actuators):
        for ends in product((0, samples - 1), repeat=actuators - 1):
            rows += [(*ends[:free], step, *ends[free:]) for step in range(samples)]
    return np.array(rows)


def edge_points(table: np.ndarray) -> np.ndarray:
    """The sums of curves (M, S, 2) at the paper's samples."""
    actuators, samples, _ = table.shape
    index = edge_indices(actuators, samples)
    return sum(table[actuator, index[:, actuator]] for actuator in range(actuators))


def box_points(table: np.ndarray) -> np.ndarray:
    """The sums of curves (M, S, 2) at all S^M combinations: for few actuators."""
    points = np.zeros((1, 2))
    for curve in table:
        points = (points[:, None] + curve).reshape(-1, 2)
    return points


# --- hulls ---


def hull(points) -> np.ndarray:
    """Corners of the convex hull, counter-clockwise: one, two or more of them."""
    points = np.asarray(points, dtype=float)
    try:
        return points[ConvexHull(points - points.mean(0)).vertices]
    except (QhullError, ValueError):  # without area, or fewer than three points
        return segment(np.unique(points, axis=0))


def segment(points: np.ndarray) -> np.ndarray:
    """The two ends of different points on a line, or the only one."""
    if len(points) < 3:
        return points
    away = points - points[0]
    far = away[np.argmax(np.hypot(*away.T))]
    along = away @ far
    return points[[np.argmin(along), np.argmax(along)]]


def minkowski_hull(table) -> np.ndarray:
    """Hull of the sums of one point of each set."""
    total = np.zeros((1, 2))
    for points in table:
        total = hull((total[:, None] + hull(points)).reshape(-1, 2))
    return total


def attainable_hull(table: np.ndarray, kind: str) -> np.ndarray:
    return minkowski_hull(table) if kind == "exact" else hull(edge_points(table))


def cross(a, b) -> float:
    return a[0] * b[1] - a[1] * b[0]


def distance(point, corners, *, signed: bool = True) -> float:
    """Distance to the hull with these corners (counter-clockwise); inside minus the margin, or 0."""
    point = np.asarray(point, dtype=float)
    if len(corners) == 1:
        return math.dist(point, corners[0])
    gaps, left = [], []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        edge, offset = end - start, point - start
        share = min(1.0, max(0.0, float(offset @ edge) / float(edge @ edge)))
        gaps.append(math.dist(offset, share * edge))
        left.append(cross(edge, offset) > 0)
    if len(corners) > 2 and all(left):
        return -min(gaps) if signed else 0.0
    return min(gaps)


# --- attainability ---


@dataclass(frozen=True)
class NodeDistances:
    """Signed distances (N,) of the nodes, and the size of the numbers they came from."""

    absolute: np.ndarray
    relative: np.ndarray
    size: float


def node_distances(
    arm: Arm, twists, load, *, kind: str, samples: int, weights=(1.0, 1.0), base_pose=HANGING
) -> NodeDistances:
    scale = np.sqrt(weights)
    required = required_wrenches(twists, load, base_pose)[:, [0, 2]] * scale
    tables = [curves(arm, twist, samples) * scale for twist in np.asarray(twists)]
    absolute, relative, size = [], [], 1.0
    for wrench, table in zip(required, tables, strict=True):
        absolute.append(distance(wrench, attainable_hull(table, kind)))
        relative.append(distance(wrench - required[0], attainable_hull(table - tables[0], kind)))
        size = max(size, np.abs(wrench).max(), np.abs(table).sum(0).max())
    return NodeDistances(np.array(absolute), np.array(relative), size)


def total(per_node: np.ndarray, metric: str, *, power: int = 1, signed: bool = False) -> float:
    """Σ distance^power; signed and all nodes inside: minus the least margin, to the power."""
    free = per_node[1:] if metric == "relative" and len(per_node) > 1 else per_node
    if signed and free.max() < 0:
        return -(abs(free.max()) ** power)
    return float((np.maximum(per_node, 0.0) ** power).sum())
