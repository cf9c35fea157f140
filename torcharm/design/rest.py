"""How an arm is without pressure and load, where that is not as drawn: straight, at strains that were measured."""

import torch

from torcharm.design.space import Arm
from torcharm.equilibrium.solve import solve_equilibrium
from torcharm.inputs import three_digits

ASIDE = 0.02
"""Of its length, how far aside the tip may be at rest, and the arm still counts as straight."""


def rest_words(arm: Arm) -> str:
    """Where the tip of one hanging design is at rest, and how long it is; empty where it is straight and in range."""
    columns = 3 if arm.dimension == 2 else 6
    with torch.no_grad():
        rest = solve_equilibrium(arm, 0.0, [0.0] * columns)
    if not bool(rest.stable):
        return "without pressure and load no stable shape of it was found"
    ends = rest.poses[..., :2] if arm.dimension == 2 else rest.poses[..., :3, 3]
    aside = float(ends[-1, [0, -1]].norm() if arm.dimension == 3 else ends[-1, 0].abs())
    length = sum(float(part.mean()) for part in rest.twists[:, 0].split(rest.segment_nodes))
    excess = float(rest.strain_excess)
    if aside <= ASIDE * length and excess <= 0:
        return ""
    words = f"without pressure and load its tip hangs {three_digits(1e3 * aside)} mm to the side, and it is "
    words += f"{1e3 * length:.0f} mm long"
    return words + (", strained beyond the characterised range" if excess > 0 else "")
