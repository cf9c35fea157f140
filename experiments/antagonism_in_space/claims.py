"""What the paper says of a node's set, in space: is it convex, and do the edges of the pressure box bound it?

A node's reactions are sums of one curve an actuator. *Convex*: half-sums of the reactions to two corners of the
pressure box, which a convex set would hold; the least distance from each to the set is a minimum over pressures, by
damped Gauss-Newton steps within the box from several starts. *Edges*: along a direction n the set reaches
`Σ max_p n·c_α(p)`, but the box's edges, of which one pressure varies while the others are at an end, only
`Σ max(n·c_α(0), n·c_α(p̄)) + max_α (what curve α adds beyond its ends)`.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

import torcharm as ta
from experiments.hull_gallery.search import FINE, CurveSum

Array = NDArray[np.float64]
PAIRS = 24
"""Pairs of corners tried at a node."""
STARTS, MORE_STARTS, STEPS = 4, 16, 50
"""Starts of each half-sum's distance, more for those that seem to lie outside, and steps from each."""
OUTSIDE = 1e-5
"""Share of the set's size that counts as outside: ten times what chords of the sampled curves are off by."""
WAYS = 2000
"""Directions in which sets and the hulls of edges are compared."""


@dataclass(frozen=True)
class Claim:
    """One node's set; lengths in N, with 1 N·m as 1 N.

    Attributes:
        arm, direction, metric, node: which; the direction in degrees, nodes from 1.
        size: the largest distance between reactions to two corners.
        outside: of `tried` half-sums, those outside of the set.
        outside_by: the largest distance.
        edges, three: by how much the set reaches beyond the hull of the edges, and of three points an edge.
    """

    arm: str
    direction: float
    metric: str
    node: int
    size: float
    tried: int
    outside: int
    outside_by: float
    edges: float
    three: float


def claims(name: str, arm: ta.ArmDesign, twists: Tensor, direction: float, nodes: list[int]) -> Iterator[Claim]:
    """Of the absolute and the relative sets of some nodes, from 0; the first one's relative set is a point."""
    for metric in ("absolute", "relative"):
        sums = curve_sums(arm, twists, relative=metric == "relative")
        for node in nodes:
            if metric == "absolute" or node > 0:
                size, away = convexity(sums[node])
                beyond = (edges_fall_short(sums[node], sampled) for sampled in (FINE, 3))
                outside = int((away > OUTSIDE * size).sum())
                yield Claim(name, direction, metric, node + 1, size, len(away), outside, float(away.max()), *beyond)


def curve_sums(arm: ta.ArmDesign, twists: Tensor, *, relative: bool) -> list[CurveSum]:
    """Curves (M, FINE, 3) of every node (N), each less its own reaction to no pressure."""
    count = arm.actuator_count
    share = torch.linspace(0.0, 1.0, FINE, dtype=torch.float64).unsqueeze(-1).unsqueeze(-1)
    pressure = share * torch.eye(count, dtype=torch.float64) * arm.max_pressure  # (FINE, M, M): one actuator at a time
    reaction = ta.reaction_wrench(arm, twists, pressure)  # (FINE, M, N, 3)
    reaction = reaction - reaction[:, :, :1] if relative else reaction
    curves = (reaction - reaction[:1]).permute(2, 1, 0, 3).numpy()
    return [CurveSum(own, True, True) for own in curves]


def convexity(sums: CurveSum, seed: int = 0) -> tuple[float, Array]:
    """The size of a node's set, and the distances (PAIRS,) of half-sums of random pairs of its corners from it."""
    draw = np.random.default_rng(seed)
    ends = draw.integers(0, 2, (2, PAIRS, sums.actuators)).astype(float)
    one, other = sums.at(ends[0]), sums.at(ends[1])
    corners = sums.at(draw.integers(0, 2, (200, sums.actuators)).astype(float))
    size = float(np.linalg.norm(corners[:, None] - corners, axis=-1).max())
    goal, middle = 0.5 * (one + other), 0.5 * ends.sum(0)
    away = nearest(sums, goal, np.concatenate((middle[:, None], draw.uniform(size=(PAIRS, STARTS, sums.actuators))), 1))
    left = away > OUTSIDE * size
    if left.any():
        starts = draw.beta(0.4, 0.4, (int(left.sum()), MORE_STARTS, sums.actuators))
        away[left] = np.minimum(away[left], nearest(sums, goal[left], starts))
    return size, away


def nearest(sums: CurveSum, goal: Array, start: Array) -> Array:
    """The least distances (T,) found from goals (T, 3) to the set, from starts (T, S, M) of normalised pressures."""
    place = start.reshape(-1, sums.actuators).copy()
    aim = np.repeat(goal, start.shape[1], 0)
    gap = sums.at(place) - aim
    damping = np.full(len(place), 1e-2)
    for _ in range(STEPS):
        slope = sums.slopes(place).transpose(0, 2, 1)  # (T·S, 3, M)
        gradient = np.einsum("tdm,td->tm", slope, gap)
        free = ~(((place <= 0) & (gradient > 0)) | ((place >= 1) & (gradient < 0)))
        slope, gradient = slope * free[:, None], gradient * free
        square = np.einsum("tdm,tdn->tmn", slope, slope)
        most = square.diagonal(axis1=1, axis2=2).max(1)
        square += (damping * np.maximum(most, 1e-12))[:, None, None] * np.eye(sums.actuators)
        step = -np.linalg.solve(square, gradient[..., None])[..., 0]
        tried = np.clip(place + step, 0.0, 1.0)
        found = sums.at(tried) - aim
        better = (found**2).sum(1) < (gap**2).sum(1)
        place[better], gap[better] = tried[better], found[better]
        damping = np.clip(np.where(better, damping / 4, damping * 6), 1e-12, 1e6)
    return np.asarray(np.linalg.norm(gap, axis=1).reshape(start.shape[:2]).min(1))


def edges_fall_short(sums: CurveSum, points: int) -> float:
    """The largest difference of the support functions of the set and of so many points an edge."""
    height, turn = 1 - 2 * (np.arange(WAYS) + 0.5) / WAYS, np.arange(WAYS) * np.pi * (3 - 5**0.5)
    round_ = np.sqrt(1 - height**2)
    span = np.ptp(sums.curves, axis=1).sum(0)
    way = np.stack((height, round_ * np.cos(turn), round_ * np.sin(turn)), -1) / np.where(span > 0, span, 1.0)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    along = np.einsum("wd,mpd->wmp", way, sums.curves)
    ends = np.maximum(along[..., 0], along[..., -1])
    sampled = along[..., :: (FINE - 1) // (points - 1)].max(-1)
    reach, edges = along.max(-1).sum(1), ends.sum(1) + (sampled - ends).max(1)
    return float((reach - edges).max())
