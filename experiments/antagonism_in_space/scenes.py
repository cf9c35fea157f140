"""Arms of equal size, and what they are asked to hold: a bend towards every side, under forces from every side."""

import math
from itertools import product

import torch
from torch import Tensor

import torcharm as ta

OUTER, INNER, LENGTH, MASS = 0.04, 0.016, 0.45, 0.3
"""Radii of the two rings and length at rest [m], and mass [kg], of every arm."""
BEND = (-0.4, 1.0)
"""Slope and intercept of the curvature [rad]: a bend by 46° that is stronger at the base."""
LENGTHS = (-0.18, -0.12, -0.06, 0.0, 0.12, 0.24, 0.36, 0.48)
"""By how much the shape is longer than the arms are at rest: each kind has lengths that suit it."""
NODES, DIRECTIONS, FORCE = 10, 24, 2.0
"""Elements; sides towards which arms bend; and the force at the tip [N]."""


def arms() -> dict[str, ta.ArmDesign]:
    """Six actuators each, then nine; the first of either is the antagonistic arm that others are compared with."""
    bellows, muscle = ta.Bellows(), ta.McKibben()
    between, behind = _rings(3, math.pi / 3), _rings(3, 0.0)
    found = {
        "3 bellows outside, 3 muscles between": _arm(between, [bellows] * 3 + [muscle] * 3),
        "3 bellows outside, 3 muscles behind": _arm(behind, [bellows] * 3 + [muscle] * 3),
        "3 muscles outside, 3 bellows between": _arm(between, [muscle] * 3 + [bellows] * 3),
        "6 bellows on the outer ring": _arm(ta.ring(OUTER, 6), [bellows] * 6),
        "6 bellows on both rings": _arm(between, [bellows] * 6),
        "6 muscles on the outer ring": _arm(ta.ring(OUTER, 6), [muscle] * 6),
        "6 muscles on both rings": _arm(between, [muscle] * 6),
    }
    return found | {
        "3 bellows outside, 6 muscles inside": _arm(_rings(6, math.pi / 6), [bellows] * 3 + [muscle] * 6),
        "9 bellows on the outer ring": _arm(ta.ring(OUTER, 9), [bellows] * 9),
        "9 muscles on the outer ring": _arm(ta.ring(OUTER, 9), [muscle] * 9),
    }


def three_bellows() -> ta.ArmDesign:
    """As many actuators as a set has dimensions: of its sets alone the claims are asked."""
    return _arm(ta.ring(OUTER, 3), [ta.Bellows()] * 3)


def kind_of(name: str) -> str:
    """What an arm is made of."""
    if "bellows" in name and "muscles" in name:
        return "antagonistic"
    return "bellows" if "bellows" in name else "muscles"


def _rings(inside: int, phase: float) -> Tensor:
    """Three places on the outer ring, and so many on the inner one."""
    return torch.cat((ta.ring(OUTER, 3), ta.ring(INNER, inside, phase=phase)))


def _arm(offsets: Tensor, actuators: list[ta.Actuator]) -> ta.ArmDesign:
    return ta.ArmDesign(offsets=offsets, length=LENGTH, actuators=actuators, mass=MASS)


def directions(count: int = DIRECTIONS) -> Tensor:
    """(D,) sides towards which arms bend [rad]; the first bellows is at 0."""
    return torch.arange(count, dtype=torch.float64) * (2 * math.pi / count)


def force_ways() -> dict[str, Tensor]:
    """Unit vectors in the frame of the bend (towards it, up, aside): the faces and corners of a cube."""
    names = (("away from the bend", "towards the bend"), ("down", "up"), ("to one side", "to the other side"))
    found = {}
    for axis, both in enumerate(names):
        for name, sign in zip(both, (-1.0, 1.0), strict=True):
            found[name] = sign * torch.eye(3, dtype=torch.float64)[axis]
    for signs in product((-1.0, 1.0), repeat=3):
        words = [both[int(sign > 0)] for both, sign in zip(names, signs, strict=True)]
        found[", ".join(words)] = torch.tensor(signs, dtype=torch.float64) / math.sqrt(3)
    return found


def tasks(longer: float, count: int = DIRECTIONS) -> ta.Task:
    """(D, F) every bend under every force, which turns with the bend, and the arm's own weight.

    The force that points down is a hanging weight of 204 g.
    """
    towards = directions(count)
    twists = ta.affine_curvature(*BEND, length=(1 + longer) * LENGTH, nodes=NODES, direction=towards)
    ways = torch.stack(list(force_ways().values()))
    cosine, sine = towards.cos().unsqueeze(-1), towards.sin().unsqueeze(-1)
    bent, up, aside = ways.unbind(-1)
    force = torch.stack((bent * cosine - aside * sine, up.expand(count, -1), bent * sine + aside * cosine), -1)
    load = ta.ExternalLoad(tip=torch.cat((FORCE * force, torch.zeros_like(force)), -1), gravity=True)
    return ta.Task(twists.unsqueeze(1), load=load)
