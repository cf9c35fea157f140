"""Arms of one to four segments that are else alike, and shapes that ask for more and more of them."""

import math
from typing import Any

import torch
from torch import Tensor

import torcharm as ta

LENGTH, MASS, PAYLOAD = 0.48, 0.2, 0.05
"""Of the whole arm at rest [m, kg], and at its tip [kg]."""
OUTER, INNER, BEND = 0.05, 0.016, 1.0
"""Radii of the two rings [m], and largest curvature of the shapes [rad]."""
NODES, SEGMENTS = 12, (1, 2, 3, 4)
TOWARDS = 0.4
"""Side to which the shapes begin to bend [rad]; an outer actuator is at 0."""
KINDS = {"antagonistic": 1.0, "bellows": 1.36}
"""Actuators, and how long a shape is over the arm at rest: bellows bear no pull but by their own stretch. All strains
of all shapes are in the range in which forces were measured."""


def arm(kind: str, count: int) -> ta.ArmSeries:
    """Segments of one section: three bellows outside, and three muscles behind them inside unless it is bellows-only.

    Muscles do not follow a shape that is longer than they are; the bellows-only arm has six bellows in their places.
    """
    inner: ta.Actuator = ta.McKibben() if kind == "antagonistic" else ta.Bellows()
    offsets = torch.cat((ta.ring(OUTER, 3), ta.ring(INNER, 3)))
    models = [ta.Bellows()] * 3 + [inner] * 3
    segment = ta.ArmDesign(offsets=offsets, length=LENGTH / count, actuators=models, mass=MASS / count)
    return ta.series([segment] * count)


def shapes(kind: str) -> dict[str, Tensor]:
    """Twists (N, 6) of whole arms, per unit of the whole arm's arc."""
    given: dict[str, Any] = {"length": KINDS[kind] * LENGTH, "nodes": NODES, "direction": TOWARDS}
    half = {**given, "nodes": NODES // 2}
    return {
        "arc": ta.constant_curvature(BEND, **given),
        "S of two arcs": torch.cat((ta.constant_curvature(BEND, **half), ta.constant_curvature(-BEND, **half))),
        "smooth S": ta.affine_curvature(-2 * BEND, BEND, **given),
        "cubic": ta.cubic_curvature(32 * BEND, -48 * BEND, 18 * BEND, -BEND, **given),
        "helix": ta.helix(BEND, 1.5 * math.pi, **given),
    }


def task(twists: Tensor, count: int) -> ta.Task:
    """The same curve for an arm of so many segments, each of which has an arc of its own: a part of the twist."""
    points = [ta.PointLoad(segment=count - 1, mass=PAYLOAD)]
    load = ta.ExternalLoad(gravity=True, points=points)
    return ta.Task(twists / count, load=load, segment_nodes=[NODES // count] * count)


def aims() -> dict[str, ta.PoseCost]:
    """What pressures are chosen for: the whole shape, the tip's place and heading, or its place alone.

    Roll is left out, which no pressure steers.
    """
    return {
        "shape": ta.PoseCost("uniform", (1, 1, 1, 0, 0.05, 0.05)),
        "tip pose": ta.PoseCost("tip", (1, 1, 1, 0, 0.05, 0.05)),
        "tip place": ta.PoseCost("tip", (1, 1, 1, 0, 0, 0)),
    }
