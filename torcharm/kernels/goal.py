"""The cost of one arm's poses: `_descent.Goal` for one element."""

import math
from typing import NamedTuple

from torcharm._arrays import Array
from torcharm.engine.compilation import inlined
from torcharm.kernels.march import March


class Goal(NamedTuple):
    """What B searches aim at.

    Attributes:
        target: (B, 3, N) poses after the segments.
        weight: (3, N) square roots of the weights on their errors.
        turned: whether errors along and across the arm weigh differently.
    """

    target: Array
    weight: Array
    turned: bool


@inlined
def cost_of(goal: Goal, at: int, pose: Array) -> float:
    """The sum of squares at poses (3, N)."""
    total = 0.0
    for i in range(pose.shape[1]):
        x, y = goal.target[at, 0, i] - pose[0, i], goal.target[at, 1, i] - pose[1, i]
        if goal.turned:
            cos, sin = math.cos(pose[2, i]), math.sin(pose[2, i])
            x, y = cos * x + sin * y, cos * y - sin * x
        x, y = x * goal.weight[0, i], y * goal.weight[1, i]
        turn = (goal.target[at, 2, i] - pose[2, i]) * goal.weight[2, i]
        total += x * x + y * y + turn * turn
    return total


@inlined
def model(goal: Goal, at: int, march: March, first: int, columns: Array, normal: Array) -> None:
    """`CᵀC` (1 + M, 1 + M) of the errors after Newton's step, and their changes by pressures as shares of limits.

    Right sides of the march: 1 is R, those from `first` on are the pressures'; columns (1 + M, 3, N) are scratch.
    """
    size, nodes = normal.shape[0], march.pose.shape[1]
    pose = march.pose
    for i in range(nodes):
        x, y = goal.target[at, 0, i] - pose[0, i], goal.target[at, 1, i] - pose[1, i]
        turn = goal.target[at, 2, i] - pose[2, i]
        cos, sin = 1.0, 0.0
        if goal.turned:
            cos, sin = math.cos(pose[2, i]), math.sin(pose[2, i])
            x, y = cos * x + sin * y, cos * y - sin * x
        for k in range(size):
            side = 1 if k == 0 else first + k - 1
            u, v, t = -march.slid[side, 0, i], -march.slid[side, 1, i], -march.turned[side, i]
            if goal.turned:
                u, v = cos * u + sin * v - y * t, cos * v - sin * u + x * t
            if k == 0:
                u, v, t = u + x, v + y, t + turn
            columns[k, 0, i], columns[k, 1, i] = u * goal.weight[0, i], v * goal.weight[1, i]
            columns[k, 2, i] = t * goal.weight[2, i]
    for k in range(size):
        for j in range(k, size):
            total = 0.0
            for c in range(3):
                for i in range(nodes):
                    total += columns[k, c, i] * columns[j, c, i]
            normal[k, j] = normal[j, k] = total
