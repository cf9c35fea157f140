"""Where no shape meets a tip pose: how near the nearest comes, and what to try."""

import math
from collections.abc import Callable

import numpy as np

from torcharm.design.space import Array

ANGLE = 0.1
"""Which miss of the tip's place [m] counts as much as one of its heading by 1 rad."""
ACTIVE = 1e-4
"""How near to its end [m] a strain is that holds a shape back, by the length of its actuator."""


def nearest_shape(
    miss: Callable[[Array], Array],
    jacobian: Callable[[Array], Array],
    strains: tuple[Array, Array] | None,
    start: Array,
    nodes: int,
    away: float,
) -> tuple[Array, str]:
    """Unknowns whose tip comes nearest, by sequential least squares from one start, and what to try, in words.

    Args:
        miss, jacobian: of the tip, places first [m] and then angles [rad], and its derivatives by the unknowns.
        strains: rows A and bounds b of `A z ≤ b`; None without.
        start: lengths of the nodes in units of their own, and then curvatures.
        nodes: how many.
        away: the tip's distance from the base [m].
    """
    from scipy.optimize import minimize

    places = 2 if len(miss(start)) == 3 else 3
    scale = np.where(np.arange(len(miss(start))) < places, 1.0, ANGLE)

    def value(z: Array) -> tuple[float, Array]:
        off = scale * miss(z)
        return float(off @ off), 2 * (scale * off) @ jacobian(z)

    limits = []
    if strains is not None:
        rows, bound = strains
        for _ in range(40):  # an arc that strains allow, if there is one
            if (rows @ start <= bound).all():
                break
            start = np.concatenate((start[:nodes], 0.8 * start[nodes:]))
        limits.append({"type": "ineq", "fun": lambda z: bound - rows @ z, "jac": lambda z: -rows})
    options = {"maxiter": 200, "ftol": 1e-12}
    found = minimize(value, start, jac=True, method="SLSQP", constraints=limits, options=options).x
    return found, _advice(found, strains, nodes, away)


def _advice(found: Array, strains: tuple[Array, Array] | None, nodes: int, away: float) -> str:
    """What holds the nearest shape back says what to change."""
    if strains is None:
        return "try a tip nearer to the base, more nodes or more starts"
    rows, bound = strains
    reach = bound[rows[:, :nodes].sum(-1) > 0].min(initial=math.inf)
    if away > reach:
        return f"the tip is {away:.3g} m from the base, and the arm at most {reach:.3g} m long: try a longer one"
    held = rows[bound - rows @ found < ACTIVE, :nodes].sum(-1)  # above 0 where an actuator is as long as it may be
    if not len(held):
        return "try another heading, more nodes or more starts"
    if (held > 0).all():
        return "try a longer arm, or a tip nearer to the base"
    if (held < 0).all():
        return "try a shorter arm, or a tip further from the base"
    return "try less bend, actuators nearer to the centreline, or an arm of another length"


def miss_in_words(off: Array) -> str:
    """How far a tip is off, by the misses of its place and its heading."""
    places = 2 if len(off) == 3 else 3
    place, turn = 1e3 * float(np.linalg.norm(off[:places])), math.degrees(float(np.linalg.norm(off[places:])))
    return f"{place:.0f} mm and {turn:.0f}°" if place >= 10 else f"{place:.2g} mm and {turn:.2g}°"
