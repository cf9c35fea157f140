"""Where a node's set lies: which forces it holds, and how much moment at the force that weight asks for."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from torch import Tensor

import torcharm as ta

Array = NDArray[np.float64]
WAYS = 36
"""Directions of a half turn in which moments are compared."""


@dataclass(frozen=True)
class Hull:
    """One node's set.

    Attributes:
        arm, direction, node: which; the direction in degrees, nodes from 1.
        force_min, force_max: its extent [N].
        volume: [N·(N·m)²].
        required: the axial force that the arm's weight and a hanging one ask for [N].
        moment: the range of moments that it has at that force, in the direction in which that is least [N·m]; 0 where
            the set has no such force.
    """

    arm: str
    direction: float
    node: int
    force_min: float
    force_max: float
    volume: float
    required: float
    moment: float


def hulls(
    name: str, arm: ta.ArmDesign, twists: Tensor, load: ta.ExternalLoad, direction: float, nodes: list[int]
) -> Iterator[Hull]:
    """Of some nodes, from 0, of one shape under one load."""
    found = ta.wrench_hulls(arm, twists)
    volume = found.volume()
    required = ta.required_wrench(twists, load, mass=arm.mass)[..., 0].reshape(-1)
    for node in nodes:
        corners, force = found.vertices[node].numpy(), float(required[node])
        low, high = corners[:, 0].min(), corners[:, 0].max()
        least = moment_range(corners, force)
        yield Hull(name, direction, node + 1, float(low), float(high), float(volume[node]), force, least)


def moment_range(corners: Array, force: float) -> float:
    """Least over directions: how far the hull of corners (V, 3) extends in moment at a force."""
    faces = ConvexHull(corners).simplices
    one, other = (corners[faces[:, ends].reshape(-1)] for ends in ([0, 1, 2], [1, 2, 0]))
    before, after = one[:, 0] - force, other[:, 0] - force
    crossing = before * after < 0
    if not crossing.any():
        return 0.0
    share = (before[crossing] / (before - after)[crossing])[:, None]
    moments = ((1 - share) * one[crossing] + share * other[crossing])[:, 1:]
    angle = np.arange(WAYS) * (np.pi / WAYS)
    return float(np.ptp(moments @ np.stack((np.cos(angle), np.sin(angle))), axis=0).min())
