"""Cosserat rods whose answers are known in closed form."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

import torcharm as ta

STRETCH, BEND, LENGTH = 2000.0, 0.02, 0.3
"""EA [N], EI [N·m²] and length [m] of a slender rod, which nothing presses on: a core alone."""
NODES = (10, 40)


@dataclass(frozen=True)
class Limit:
    """What the model says, and by how much of it that is off the closed form."""

    name: str
    formula: str
    unit: str
    nodes: int
    model: float
    off: float


def limits() -> Iterator[Limit]:
    """All of them, by numbers of nodes."""
    for nodes in NODES:
        yield limit(
            "stretch under its own weight",
            "m g L / (2 EA)",
            "m",
            nodes,
            own_weight(nodes),
            0.1 * 9.81 * LENGTH / (2 * STRETCH),
        )
        yield limit("turn by a moment", "M L / EI", "rad", nodes, moment(nodes), 0.1 * LENGTH / BEND)
        yield limit("helix by moment and torque", "its radius", "m", nodes, helix_radius(nodes), closed_radius())
        yield limit(
            "deflection by a small force",
            "F L³ / (3 EI)",
            "m",
            nodes,
            small_force(nodes),
            1e-4 * LENGTH**3 / (3 * BEND),
        )
        yield limit("buckling load", "π² EI / (4 L²)", "N", nodes, buckling(nodes), math.pi**2 * BEND / (4 * LENGTH**2))


def limit(name: str, formula: str, unit: str, nodes: int, model: float, known: float) -> Limit:
    return Limit(name, formula, unit, nodes, model, abs(model / known - 1))


def rod(mass: float = 0.0, twist: float | None = None, stretch: float = STRETCH) -> ta.ArmDesign:
    core = ta.elastic_core(stretch, BEND)
    return ta.ArmDesign(offsets=[[0.0, 0.0]], length=LENGTH, actuators=[core], mass=mass, torsion_stiffness=twist)


def held(
    arm: ta.ArmDesign, tip: tuple[float, ...], nodes: int, *, gravity: bool = False, base: str = "hanging"
) -> Tensor:
    """Poses (N + 1, 4, 4) of the rod at rest."""
    load = ta.ExternalLoad(tip=tip, gravity=gravity)
    found = ta.solve_equilibrium(arm, [0.0], load, nodes=nodes, base_pose=base, raise_on_failure=True)
    return found.poses


def own_weight(nodes: int) -> float:
    return -float(held(rod(mass=0.1), (0.0,) * 6, nodes, gravity=True)[-1, 1, 3]) - LENGTH


def moment(nodes: int) -> float:
    pose = held(rod(), (0.0, 0.0, 0.0, 0.0, 0.0, 0.1), nodes, base="horizontal")[-1]
    return math.atan2(float(pose[1, 0]), float(pose[0, 0]))


def small_force(nodes: int) -> float:
    return float(held(rod(), (0.0, 1e-4, 0.0, 0.0, 0.0, 0.0), nodes, base="horizontal")[-1, 1, 3])


HELIX = (0.08, 0.0, 0.06)
"""Moment along the world's x and z at the tip [N·m] of a rod whose ends are free to turn: a couple."""


def helix_radius(nodes: int) -> float:
    """Of the circle on whose cylinder the nodes lie: a couple bends and twists the rod alike all along."""
    poses = held(rod(twist=BEND), (0.0, 0.0, 0.0, *HELIX), nodes, base="horizontal")
    place = poses[:, :3, 3]
    axis = torch.tensor(HELIX, dtype=torch.float64)
    axis = axis / axis.norm()
    flat = place - (place @ axis).unsqueeze(-1) * axis
    a, b, c = flat[0], flat[len(flat) // 2], flat[-1]
    sides = (a - b).norm(), (b - c).norm(), (c - a).norm()
    doubled = torch.linalg.cross(b - a, c - a).norm()
    return float(sides[0] * sides[1] * sides[2] / (2 * doubled))


def closed_radius() -> float:
    """With C = EI the curvature vector is M/EI, constant in the world: radius `|κ⊥| / |κ|²` of the curve."""
    turn = math.hypot(HELIX[0], HELIX[2]) / BEND
    across = HELIX[2] / BEND
    return across / turn**2


def buckling(nodes: int) -> float:
    """The least push along an upright rod at which it is no longer stable, by bisection."""
    low, high = 0.0, 2 * math.pi**2 * BEND / (4 * LENGTH**2)
    arm = rod(stretch=1e7)
    while high - low > 1e-6 * high:
        middle = 0.5 * (low + high)
        found = ta.solve_equilibrium(arm, [0.0], [0.0, -middle, 0.0, 0.0, 0.0, 0.0], nodes=nodes, base_pose="upright")
        straight = bool(found.stable) and float(found.twists[:, 4:].abs().max()) < 1e-6
        low, high = (middle, high) if straight else (low, middle)
    return high
