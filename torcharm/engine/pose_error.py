"""How far one arm's poses are from those wanted, and how that changes as the arm moves.

The error of a pose g is that of the target seen from it, of `g⁻¹ g*`: `(x, y, θ)` in the plane, position and rotation
vector φ in space. With motions as spatial twists `(v, ω)` (see `engine.elements`) of a body at p with rotation R,

    d(Rᵀ(p* - p)) = -Rᵀ(v + ω×p) - (Rᵀω)×e,    dφ = -J⁻¹(φ) Rᵀω,

with the inverse left Jacobian `J⁻¹(φ) = 1 - ½ Φ + (1/|φ|² - cot(|φ|/2)/(2|φ|)) Φ²`, Φ the cross product by φ
(Chirikjian, *Stochastic Models, Information Theory, and Lie Groups*, 2011, vol. 2, eq. 10.86). Rotation vectors jump
at half a turn; headings in the plane are counted on beyond it.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from torcharm.engine.arrays import Array
from torcharm.engine.compilation import part
from torcharm.engine.references import by_reference

SMALL_TURN = 1e-8
"""Squared angle [rad²] below which the last factor of J⁻¹ is 1/12: it differs from that by a 720th of the square."""


@by_reference
class Goal(NamedTuple):
    """What B arms aim at, at the ends of their N elements: poses as positions from the base's and turns from the base's
    heading, without those of links, in the plane; as rows of rotations and positions in space."""

    pose: Float64[Array, "B N G"]  # G is 3 or 12
    weight: Float64[Array, "B N K"]  # ω_i K of each error


NO_GOAL = Goal(np.zeros((0, 0, 0)), np.zeros((0, 0, 0)))
"""Where poses are not compared."""


@by_reference
class Errors(NamedTuple):
    """Scratch of the errors of one arm."""

    value: Float64[Array, "1+M N K"]  # the errors, times the roots of their weights, and their changes in M directions
    motion: Float64[Array, "K"]  # of one node


@part
def write_errors(arms, goal, balance, b, twist, change, directions, errors):  # type: ignore[no-untyped-def]
    """Write the errors as the first of the changes corrects them, and what the others change.

    Args:
        balance: in which `write_shape` was before.
        twist: (N, K), with which the shape was written.
        change: (1 + X, N, C) of the unknowns.
        directions: X, or fewer.
    """
    motion, value = errors.motion, errors.value
    size, planar = arms.size, arms.size == 3
    for x in range(1 + directions):
        for k in range(size):
            motion[k] = 0.0
        turn = 0.0
        for segment in range(len(arms.first_node) - 1):
            first, last = arms.first_node[segment], arms.first_node[segment + 1]
            for i in range(first, last):
                for c in range(len(arms.unknown)):
                    for k in range(size):
                        motion[k] += balance.move[i, k, c] * change[x, i, c]
                if planar:
                    turn += twist[i, 2] / (last - first)
                    _planar_error(goal, balance, b, i, turn, x, errors)
                else:
                    _spatial_error(goal, balance, b, i, x, errors)
    for i in range(value.shape[1]):
        for e in range(size):
            root = math.sqrt(goal.weight[b, i, e])
            value[0, i, e] *= root
            for x in range(1, 1 + directions):
                value[x, i, e] *= root


@part
def tip_error(arms, goal, balance, b):  # type: ignore[no-untyped-def]
    """How far the arm's end is from where it is to be [m], whatever that weighs."""
    count, wanted = (2, 0) if arms.size == 3 else (3, 9)
    square, last, place = 0.0, goal.pose.shape[1] - 1, balance.node.shape[1] - count
    for k in range(count):
        square += (goal.pose[b, last, wanted + k] - balance.node[last + 1, place + k]) ** 2
    return math.sqrt(square)


@part
def _planar_error(goal, balance, b, i, turn, x, errors):  # type: ignore[no-untyped-def]
    """Write the change of an error by a motion; the first change is added to the error itself."""
    c, s, p_x, p_y = balance.node[i + 1, 0], balance.node[i + 1, 1], balance.node[i + 1, 2], balance.node[i + 1, 3]
    gap_x, gap_y, w = goal.pose[b, i, 0] - p_x, goal.pose[b, i, 1] - p_y, errors.motion[2]
    e_x, e_y = c * gap_x + s * gap_y, c * gap_y - s * gap_x
    d_x, d_y = errors.motion[0] - w * p_y, errors.motion[1] + w * p_x
    u, v, t = w * e_y - c * d_x - s * d_y, s * d_x - c * d_y - w * e_x, -w
    if x == 0:
        u, v, t = u + e_x, v + e_y, t + goal.pose[b, i, 2] - turn
    errors.value[x, i, 0], errors.value[x, i, 1], errors.value[x, i, 2] = u, v, t


@part
def _back(pose, i, x, y, z):  # type: ignore[no-untyped-def]
    """A vector of the world, along the axes of a pose in space."""
    return (
        pose[i, 0] * x + pose[i, 3] * y + pose[i, 6] * z,
        pose[i, 1] * x + pose[i, 4] * y + pose[i, 7] * z,
        pose[i, 2] * x + pose[i, 5] * y + pose[i, 8] * z,
    )


@part
def _spatial_error(goal, balance, b, i, x, errors):  # type: ignore[no-untyped-def]
    """The same in space."""
    node, motion, value = balance.node, errors.motion, errors.value
    p_x, p_y, p_z = node[i + 1, 9], node[i + 1, 10], node[i + 1, 11]
    e_x, e_y, e_z = _back(node, i + 1, goal.pose[b, i, 9] - p_x, goal.pose[b, i, 10] - p_y, goal.pose[b, i, 11] - p_z)
    f_x, f_y, f_z = rotation_error(goal, node, b, i)
    w_x, w_y, w_z = motion[3], motion[4], motion[5]
    d_x, d_y, d_z = _back(
        node,
        i + 1,
        motion[0] + w_y * p_z - w_z * p_y,
        motion[1] + w_z * p_x - w_x * p_z,
        motion[2] + w_x * p_y - w_y * p_x,
    )
    w_x, w_y, w_z = _back(node, i + 1, w_x, w_y, w_z)
    value[x, i, 0] = -d_x - (w_y * e_z - w_z * e_y)
    value[x, i, 1] = -d_y - (w_z * e_x - w_x * e_z)
    value[x, i, 2] = -d_z - (w_x * e_y - w_y * e_x)
    square = f_x * f_x + f_y * f_y + f_z * f_z
    factor = 1.0 / 12.0
    if square > SMALL_TURN:
        angle = math.sqrt(square)
        factor = 1.0 / square - 0.5 * math.cos(0.5 * angle) / (angle * math.sin(0.5 * angle))
    o_x, o_y, o_z = f_y * w_z - f_z * w_y, f_z * w_x - f_x * w_z, f_x * w_y - f_y * w_x
    value[x, i, 3] = -(w_x - 0.5 * o_x + factor * (f_y * o_z - f_z * o_y))
    value[x, i, 4] = -(w_y - 0.5 * o_y + factor * (f_z * o_x - f_x * o_z))
    value[x, i, 5] = -(w_z - 0.5 * o_z + factor * (f_x * o_y - f_y * o_x))
    if x == 0:
        value[x, i, 0] += e_x
        value[x, i, 1] += e_y
        value[x, i, 2] += e_z
        value[x, i, 3] += f_x
        value[x, i, 4] += f_y
        value[x, i, 5] += f_z


@part
def rotation_error(goal, node, b, i):  # type: ignore[no-untyped-def]
    """The rotation vector of `Rᵀ R*` at the end of element i: by its quaternion, which is exact at 0 and at π."""
    pose = goal.pose
    x_x, y_x, z_x = _back(node, i + 1, pose[b, i, 0], pose[b, i, 3], pose[b, i, 6])
    x_y, y_y, z_y = _back(node, i + 1, pose[b, i, 1], pose[b, i, 4], pose[b, i, 7])
    x_z, y_z, z_z = _back(node, i + 1, pose[b, i, 2], pose[b, i, 5], pose[b, i, 8])
    # four times the products of the quaternion's entries with its largest one
    if x_x + y_y + z_z > 0.0:
        real, x, y, z = 1.0 + x_x + y_y + z_z, z_y - y_z, x_z - z_x, y_x - x_y
    elif x_x >= y_y and x_x >= z_z:
        real, x, y, z = z_y - y_z, 1.0 + x_x - y_y - z_z, x_y + y_x, x_z + z_x
    elif y_y >= z_z:
        real, x, y, z = x_z - z_x, x_y + y_x, 1.0 + y_y - x_x - z_z, y_z + z_y
    else:
        real, x, y, z = y_x - x_y, x_z + z_x, y_z + z_y, 1.0 + z_z - x_x - y_y
    if real < 0.0:
        real, x, y, z = -real, -x, -y, -z
    size = math.sqrt(x * x + y * y + z * z)
    factor = 2.0 * math.atan2(size, real) / size if size > 0.0 else 0.0
    return factor * x, factor * y, factor * z
