"""Equilibria by other means: scipy's root finders on equations written in numpy once more.

Shares no code with the library: force models, kinematics and statics are written out here, node by node.
Two formulations. `solve_all` hands the 2N equations to `scipy.optimize.root`. `shoot` has one unknown: with
`u = p_tip × F` given, the wrench at the base is known, and a march from the base solves a cross-section at a time; u is
right when the tip it reaches gives it back.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import brentq, minimize, root

Array = np.ndarray[Any, np.dtype[np.float64]]
Force = Callable[[float, float], float]
STIFFNESS = -1.0 / 3.5
TURN_WEIGHT = 0.05
"""Of squared turns in the paper's cost [m²/rad²]."""
NOTHING = 1e3
"""A cost [m²] where no equilibrium is found."""


def bellows(e: float, p: float) -> float:
    passive = 10.47 * e - 7.344 * e**2 + 19.39 * e**3
    return -(
        passive
        - 1.068 * p
        + 0.5504 * e * p
        + 0.00205 * p**2
        - 0.03461 * e**2 * p
        - 0.006294 * e * p**2
        + 3.081e-5 * p**3
    )


def muscle(e: float, p: float) -> float:
    a1, a2 = 1.038555666, 0.511454549
    lim, crit = -0.274484489, -0.303225592

    def c(x: float) -> float:
        return 265.2968218 * x**4 + 320.5906703 * x**3 + 126.11975 * x**2 + 21.92761236 * x

    def z(x: float) -> float:
        return 34610.2847 * x**4 + 5991.799518 * x**3 - 1032.874471 * x**2 - 395.9792747 * x

    def s(x: float) -> float:
        return 0.637225654 * (0.453137516 + x) ** 2

    if e >= 0:
        stretch = 89998.04265 * e**3 + 836.5810641 * e**2 + 62.59606786 * e
        b1, b2, b3 = 1.963398204, -3.169979385, 4.231857967
        return -(stretch + b1 * (math.sqrt(a1 * a2**2 / b1) + b2 * e) ** 2 * p ** (1 + b3 * e))
    if p >= z(e):
        return -a1 * (a2 + e) ** 2 * (p - z(e))
    if e >= lim:
        return -(c(e) + max(0.0, s(e) * (p - z(e)) - c(e)))
    rate = s(lim) / (lim - crit) ** 2 if e >= crit else -3.695687763
    return -(c(e) + rate * (e - crit) ** 2 * max(0.0, p - c(lim) / s(lim) - z(lim)))


@dataclass(frozen=True)
class Arm:
    """M actuators: forces, offsets [m], neutral lengths [m], and the pressures [kPa] at which K holds."""

    forces: tuple[Force, ...]
    radii: tuple[float, ...]
    lengths: tuple[float, ...]
    references: tuple[float, ...]


RADII, LENGTHS = (-0.08, -0.015, 0.015, 0.08), (0.5,) * 4
ANTAGONISTIC = Arm((bellows, muscle, muscle, bellows), RADII, LENGTHS, (50.0, 100.0, 100.0, 50.0))
BELLOWS = Arm((bellows,) * 4, RADII, LENGTHS, (50.0,) * 4)


def reaction(arm: Arm, length: float, curvature: float, pressure: Array) -> tuple[float, float]:
    axial = moment = 0.0
    for force, r, neutral, reference, p in zip(
        arm.forces, arm.radii, arm.lengths, arm.references, pressure, strict=True
    ):
        own = length - r * curvature
        f = force(own / neutral - 1, p)
        axial += f
        moment += STIFFNESS * p / reference * curvature / own - r * f
    return axial, moment


def step(pose: Array, length: float, curvature: float, nodes: int) -> Array:
    """The next pose: an arc of a circle, by its chord."""
    x, y, angle = pose
    turn = curvature / nodes
    chord = length / nodes * (math.sin(turn / 2) / (turn / 2) if turn else 1.0)
    return np.array((x + chord * math.cos(angle + turn / 2), y + chord * math.sin(angle + turn / 2), angle + turn))


def march(lengths: Array, curvatures: Array) -> Array:
    poses = [np.array((0.0, 0.0, -math.pi / 2))]
    for length, curvature in zip(lengths, curvatures, strict=True):
        poses.append(step(poses[-1], length, curvature, len(lengths)))
    return np.array(poses)


def imbalance(unknowns: Array, arm: Arm, pressure: Array, load: Array, midpoint: bool = False) -> Array:
    """The 2N equations at unknowns (2N,): lengths, then curvatures. Nodes start their segments, or halve them."""
    lengths, curvatures = np.split(unknowns, 2)
    poses = march(lengths, curvatures)
    rows = []
    for pose, length, curvature in zip(poses[:-1], lengths, curvatures, strict=True):
        axial, moment = reaction(arm, length, curvature, pressure)
        if midpoint:
            pose = step(pose, length, curvature, 2 * len(lengths))
        lever = poses[-1, :2] - pose[:2]
        axial += math.cos(pose[2]) * load[0] + math.sin(pose[2]) * load[1]
        moment += load[2] + lever[0] * load[1] - lever[1] * load[0]
        rows.append((axial, moment))
    return np.array(rows).T.ravel()


def solve_all(arm: Arm, pressure: Array, load: Array, start: Array, method: str = "hybr") -> Array | None:
    """Unknowns (2N,) by `scipy.optimize.root` from a start, or None."""
    options = {"xtol": 1e-13} if method == "hybr" else {"xtol": 1e-13, "ftol": 1e-13}
    # its differences are relative to the unknowns, which a straight arm's curvatures of 1e-18 rad leave nothing of
    found = root(lambda u: imbalance(u - 1.0, arm, pressure, load), start + 1.0, method=method, options=options)
    unknowns = np.asarray(found.x) - 1.0
    return unknowns if np.abs(imbalance(unknowns, arm, pressure, load)).max() < 1e-8 else None


def continue_all(arm: Arm, pressure: Array, load: Array, nodes: int, steps: int = 8) -> Array | None:
    """The same, in steps of the load from a straight arm: what a careful person does with scipy alone."""
    z: Array | None = np.concatenate((np.full(nodes, np.mean(arm.lengths)), np.zeros(nodes)))
    for share in np.linspace(0, 1, steps + 1):
        assert z is not None
        z = solve_all(arm, pressure, share * load, z)
        if z is None:
            return None
    return z


def shoot(arm: Arm, pressure: Array, load: Array, near: Array) -> Array | None:
    """Unknowns (2N,) by one scalar equation in u = p_tip × F, bracketed around that of a guess `near`."""
    nodes = len(near) // 2

    def run(u: float) -> tuple[float, Array]:
        pose = np.array((0.0, 0.0, -math.pi / 2))
        local = np.array((near[0], near[nodes]))
        found = []
        for i in range(nodes):
            axial = math.cos(pose[2]) * load[0] + math.sin(pose[2]) * load[1]
            moment = load[2] + u - (pose[0] * load[1] - pose[1] * load[0])

            def miss(z: Array, axial: float = axial, moment: float = moment) -> Array:
                return np.add(reaction(arm, z[0], z[1], pressure), (axial, moment))

            answer = root(miss, local, options={"xtol": 1e-14})
            if np.abs(miss(answer.x)).max() > 1e-8:
                answer = root(miss, (near[i], near[nodes + i]), options={"xtol": 1e-14})
                if np.abs(miss(answer.x)).max() > 1e-8:
                    raise ArithmeticError
            local = answer.x
            found.append(local)
            pose = step(pose, local[0], local[1], nodes)
        return pose[0] * load[1] - pose[1] * load[0] - u, np.array(found).T.ravel()

    tip = march(*np.split(near, 2))[-1]
    guess = tip[0] * load[1] - tip[1] * load[0]
    try:
        if abs(run(guess)[0]) < 1e-13:
            return run(guess)[1]
        for width in (1e-6, 1e-4, 1e-2, 0.1):
            ends = guess - width, guess + width
            if run(ends[0])[0] * run(ends[1])[0] < 0:
                return run(float(brentq(lambda u: run(u)[0], *ends, xtol=1e-14, rtol=1e-14)))[1]
    except ArithmeticError:
        pass
    return None


def pose_cost(unknowns: Array, wanted: Array) -> float:
    """`Σ ω_i e_iᵀ K e_i` [m²] of the poses of nodes 1 to N, ω from 0 to 1; e_i is the wanted one seen from the pose."""
    cost, nodes = 0.0, len(unknowns) // 2
    for weight, pose, target in zip(np.linspace(0, 1, nodes), march(*np.split(unknowns, 2)), wanted, strict=False):
        gap = target - pose
        cost += weight * (gap[0] ** 2 + gap[1] ** 2 + TURN_WEIGHT * gap[2] ** 2)
    return float(cost)


def search(arm: Arm, wanted: Array, load: Array, limits: Array, nodes: int) -> tuple[Array, float]:
    """The paper's search with scipy alone, from the middle of the box: pressures [kPa] and their cost [m²].

    `scipy.optimize.minimize` with finite differences, each equilibrium by `root` from the last one or, where that
    fails, in steps of the load.
    """
    warm: Array | None = None

    def cost(place: Array) -> float:
        nonlocal warm
        pressure = np.clip(place, 0, 1) * limits
        found = None if warm is None else solve_all(arm, pressure, load, warm)
        if found is None:
            found = continue_all(arm, pressure, load, nodes, 4)
        if found is None:
            return NOTHING
        warm = found
        return pose_cost(found, wanted)

    answer = minimize(cost, np.full(len(limits), 0.5), method="L-BFGS-B", bounds=[(0.0, 1.0)] * len(limits))
    return np.clip(answer.x, 0, 1) * limits, float(answer.fun)
