"""The balance of one arm, and solutions with its stiffness: `mechanics.march` for one element."""

import math
from typing import NamedTuple

import numpy as np

from torcharm._arrays import Array
from torcharm.engine.compilation import inlined, jit
from torcharm.engine.forces import muscle
from torcharm.kernels.arms import MUSCLE, Arms

NONE, BY_LOAD, BY_FILLING = 0, 1, 2
"""The tangent that is wanted: none, by the share of the load, or by that of all pressures."""


_ROUNDING = 2.0**-53


class March(NamedTuple):
    """Scratch, and what `look` and `solve` find for K right sides: that of u, R, the tangent's if wanted, and M by
    pressure if wanted.

    Attributes:
        rod: (N, 10) cos, sin and position of the nodes; the segments' strides, and these by length and by curvature.
        reaction: (N, 4) axial miss and moment miss, the load's axial part and that across.
        stiffness: (N, 4) a11, a12, a21, a22.
        rate: (N, M, 2) of axial force and moment by pressure.
        collapsed, slope: (M, S) polynomials of strain at these pressures, and their derivatives by pressure.
        logarithm, per_neutral: (M,) of the muscles' pressures, and one over the neutral lengths.
        free: (N, K, 2); local: (N, 6); state: (N + 1, K, 2) of the march.
        change: (K, 2, N), turned: (K, N), slid: (K, 2, N): the first, u's, is not used.
        pose: (3, N) after the segments.
    """

    rod: Array
    reaction: Array
    stiffness: Array
    rate: Array
    collapsed: Array
    slope: Array
    logarithm: Array
    per_neutral: Array
    free: Array
    local: Array
    state: Array
    change: Array
    turned: Array
    slid: Array
    pose: Array


@jit
def new_march(arms: Arms, nodes: int) -> March:
    """Room for the largest of looks."""
    actuators = arms.kind.shape[0]
    sides = 3 + actuators
    return March(
        np.empty((nodes, 10)),
        np.empty((nodes, 4)),
        np.empty((nodes, 4)),
        np.empty((nodes, actuators, 2)),
        np.empty((actuators, arms.table.shape[2])),
        np.empty((actuators, arms.table.shape[2])),
        np.empty(actuators),
        np.empty(actuators),
        np.empty((nodes, sides, 2)),
        np.empty((nodes, 6)),
        np.empty((nodes + 1, sides, 2)),
        np.empty((sides, 2, nodes)),
        np.empty((sides, nodes)),
        np.empty((sides, 2, nodes)),
        np.empty((3, nodes)),
    )


@inlined
def _half_turn(x: float) -> tuple[float, float, float]:
    """cos x, sin x / x and its derivative."""
    y = x * x
    if y > 0.15:
        cos, ratio = math.cos(x), math.sin(x) / x
        return cos, ratio, (cos - ratio) / x
    # by series, to rounding: a third of the time, and no difference of numbers that are alike
    cos = 1 + y * (-1 / 2 + y * (1 / 24 + y * (-1 / 720 + y * (1 / 40320 + y * (-1 / 3628800 + y * (1 / 479001600))))))
    ratio = 1 + y * (-1 / 6 + y * (1 / 120 + y * (-1 / 5040 + y * (1 / 362880 + y * (-1 / 39916800 + y / 6227020800)))))
    slope = -1 / 3 + y * (
        1 / 30 + y * (-1 / 840 + y * (1 / 45360 + y * (-1 / 3991680 + y * (1 / 518918400 - y / 93405312000))))
    )
    return cos, ratio, slope * x


@inlined
def follow_rod(base: Array, z: Array, march: March) -> None:
    """Kinematics: a whole segment is a straight step half-way turned."""
    nodes = z.shape[1]
    step = 1.0 / nodes
    rod, pose = march.rod, march.pose
    heading, x, y = base[2], base[0], base[1]
    cos, sin = math.cos(heading), math.sin(heading)
    turned = 0.0
    for i in range(nodes):
        length, half = z[0, i], z[1, i] * (step / 2)
        cos_half, ratio, slope = _half_turn(half)
        sin_half = ratio * half
        slope *= step * step / 2
        a, b = cos * cos_half - sin * sin_half, sin * cos_half + cos * sin_half
        scale = ratio * step
        length_x, length_y = a * scale, b * scale
        curve_x, curve_y = a * slope - length_y * (step / 2), b * slope + length_x * (step / 2)
        rod[i, 0], rod[i, 1], rod[i, 2], rod[i, 3] = cos, sin, x, y
        rod[i, 4], rod[i, 5] = length_x * length, length_y * length
        rod[i, 6], rod[i, 7] = length_x, length_y
        rod[i, 8], rod[i, 9] = curve_x * length, curve_y * length
        x += rod[i, 4]
        y += rod[i, 5]
        turned += z[1, i] * step
        cos, sin = a * cos_half - b * sin_half, b * cos_half + a * sin_half
        pose[0, i], pose[1, i], pose[2, i] = x, y, heading + turned


@inlined
def _react(arms: Arms, at: int, z: Array, pressure: Array, rates: bool, march: March) -> None:
    """The cross-sections' reaction, their stiffness, and their rates by pressure if wanted."""
    nodes, actuators = z.shape[1], arms.kind.shape[0]
    table, reaction, stiffness, rate = arms.table, march.reaction, march.stiffness, march.rate
    collapsed, slope, logarithm, per_neutral = march.collapsed, march.slope, march.logarithm, march.per_neutral
    degrees, powers = table.shape[1], table.shape[2]
    for m in range(actuators):
        p = pressure[m]
        per_neutral[m] = 1.0 / arms.neutral[at, m]
        if arms.kind[m] == MUSCLE:
            logarithm[m] = math.log(max(p, 1e-30))
            continue
        for s in range(powers):
            total, by = table[m, degrees - 1, s], 0.0
            for j in range(degrees - 2, -1, -1):
                by = by * p + total
                total = total * p + table[m, j, s]
            collapsed[m, s], slope[m, s] = total, by
    for i in range(nodes):
        length, curvature = z[0, i], z[1, i]
        axial, moment, a11, a12, a21, a22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for m in range(actuators):
            p, radius, neutral, bending = pressure[m], arms.radii[at, m], arms.neutral[at, m], arms.bending[m]
            own = length - radius * curvature
            strain = own * per_neutral[m] - 1.0
            by_pressure = 0.0
            if arms.kind[m] == MUSCLE:
                factor = -arms.factor[m]
                force, by_strain, by_pressure = muscle(strain, p, logarithm[m])
                force, by_strain, by_pressure = force * factor, by_strain * factor, by_pressure * factor
            else:
                force, by_strain = _polynomial(collapsed, m, powers, strain)
                if rates:
                    by_pressure, _ = _polynomial(slope, m, powers, strain)
            stiff = by_strain * per_neutral[m]
            leaning = stiff * radius
            axial += force
            moment -= radius * force
            a11 += stiff
            a12 -= leaning
            a21 -= leaning
            a22 += leaning * radius
            moment_rate = -radius * by_pressure
            if bending != 0:
                floor = 1e-6 * neutral
                held = own if abs(own) >= floor else math.copysign(floor, own)
                per_length = 1.0 / held
                slant = bending * per_length
                moment_rate += slant * curvature
                bent = slant * p
                squeezed = per_length * bent * curvature
                moment += curvature * bent
                a21 -= squeezed
                a22 += bent + squeezed * radius
            if rates:
                rate[i, m, 0], rate[i, m, 1] = by_pressure, moment_rate
        reaction[i, 0], reaction[i, 1] = axial, moment
        stiffness[i, 0], stiffness[i, 1], stiffness[i, 2], stiffness[i, 3] = a11, a12, a21, a22


@inlined
def _polynomial(table: Array, row: int, powers: int, x: float) -> tuple[float, float]:
    """The polynomial in a row of a table (M, S), and its derivative."""
    total, slope = table[row, powers - 1], 0.0
    for s in range(powers - 2, -1, -1):
        slope = slope * x + total
        total = total * x + table[row, s]
    return total, slope


@inlined
def look(
    arms: Arms, at: int, z: Array, pressure: Array, share: float, rates: bool, march: March
) -> tuple[float, float]:
    """The balance of arm `at` at z (2, N) and pressures (M,), with a share of the load: the largest imbalances of a
    node [N], [N·m]."""
    nodes = z.shape[1]
    rod, reaction = march.rod, march.reaction
    follow_rod(arms.base[at], z, march)
    _react(arms, at, z, pressure, rates, march)
    force_x, force_y, tip_moment = arms.load[at, 0] * share, arms.load[at, 1] * share, arms.load[at, 2] * share
    tip_x, tip_y = march.pose[0, nodes - 1], march.pose[1, nodes - 1]
    force, moment, check = 0.0, 0.0, 0.0
    for i in range(nodes):
        cos, sin = rod[i, 0], rod[i, 1]
        reaction[i, 2], reaction[i, 3] = cos * force_x + sin * force_y, cos * force_y - sin * force_x
        reaction[i, 0] += reaction[i, 2]
        reaction[i, 1] += tip_moment + (tip_x - rod[i, 2]) * force_y - (tip_y - rod[i, 3]) * force_x
        force, moment = max(force, abs(reaction[i, 0])), max(moment, abs(reaction[i, 1]))
        check += abs(reaction[i, 0]) + abs(reaction[i, 1])
    if math.isnan(check):
        return math.nan, math.nan
    return force, moment


@inlined
def solve(
    arms: Arms,
    at: int,
    z: Array,
    pressure: Array,
    share: float,
    tangent: int,
    rates: bool,
    poses: bool,
    drag_length: float,
    drag_curvature: float,
    march: March,
) -> tuple[int, float]:
    """`-J⁻¹ r` for all right sides after a look; how many they are, and the sign of det J.

    Drags are taken off the sections' own stiffness, see `settle`.
    """
    nodes, actuators = z.shape[1], arms.kind.shape[0]
    step = 1.0 / nodes
    rod, reaction, stiffness, rate = march.rod, march.reaction, march.stiffness, march.rate
    free, local, state = march.free, march.local, march.state
    load_x, load_y, load_moment = arms.load[at, 0], arms.load[at, 1], arms.load[at, 2]
    force_x, force_y = load_x * share, load_y * share
    tip_x, tip_y = march.pose[0, nodes - 1], march.pose[1, nodes - 1]
    first = 2 if tangent == NONE else 3
    sides = first + actuators if rates else first
    flips = 0
    for k in range(sides):
        state[0, k, 0] = state[0, k, 1] = 0.0
    for i in range(nodes):
        # The section by itself
        a11, a12 = stiffness[i, 0] - drag_length, stiffness[i, 1]
        a21, a22 = stiffness[i, 2], stiffness[i, 3] - drag_curvature
        product, other = a11 * a22, a12 * a21
        determinant = product - other
        if determinant == 0:  # as rounding would have it: actuators at one offset, say, resist no bending at rest
            determinant = _ROUNDING * (abs(product) + abs(other))
        if determinant < 0:
            flips += 1
        inverse = 1.0 / determinant
        i11, i12, i21, i22 = a22 * inverse, -a12 * inverse, -a21 * inverse, a11 * inverse
        free[i, 0, 0], free[i, 0, 1] = -i12, -i22
        free[i, 1, 0] = -(i11 * reaction[i, 0] + i12 * reaction[i, 1])
        free[i, 1, 1] = -(i21 * reaction[i, 0] + i22 * reaction[i, 1])
        if tangent != NONE:
            if tangent == BY_LOAD:
                cos, sin = rod[i, 0], rod[i, 1]
                axial = cos * load_x + sin * load_y
                moment = load_moment + (tip_x - rod[i, 2]) * load_y - (tip_y - rod[i, 3]) * load_x
            else:
                axial, moment = 0.0, 0.0
                for m in range(actuators):
                    axial += rate[i, m, 0] * pressure[m]
                    moment += rate[i, m, 1] * pressure[m]
            free[i, 2, 0], free[i, 2, 1] = -(i11 * axial + i12 * moment), -(i21 * axial + i22 * moment)
        if rates:
            for m in range(actuators):
                axial, moment = rate[i, m, 0] * arms.limits[at, m], rate[i, m, 1] * arms.limits[at, m]
                free[i, first + m, 0] = -(i11 * axial + i12 * moment)
                free[i, first + m, 1] = -(i21 * axial + i22 * moment)
        # The march
        across = reaction[i, 3]
        bow_length, bow_curvature = i11 * across, i21 * across  # -δz by δθ
        lift_length = rod[i, 6] * force_y - rod[i, 7] * force_x  # δw by δz
        lift_curvature = rod[i, 8] * force_y - rod[i, 9] * force_x
        falling = rod[i, 4] * force_x + rod[i, 5] * force_y
        falling = -(falling + lift_length * bow_length + lift_curvature * bow_curvature)
        stay, rise = 1.0 - step * bow_curvature, 1.0 + lift_length * i12 + lift_curvature * i22
        for k in range(sides):
            turn, raised = state[i, k, 0], state[i, k, 1]
            forced = free[i, k, 0] * lift_length + free[i, k, 1] * lift_curvature
            state[i + 1, k, 0] = free[i, k, 1] * step + stay * turn + i22 * step * raised
            state[i + 1, k, 1] = forced + falling * turn + rise * raised
        local[i, 0], local[i, 1], local[i, 2], local[i, 3] = bow_length, bow_curvature, i12, i22
    # The tip closes it: δw is δu
    closing = 1.0 - state[nodes, 0, 1]
    for k in range(1, sides):
        tip = state[nodes, k, 1] / closing
        slid_x, slid_y = 0.0, 0.0
        for i in range(nodes):
            turn, raised = state[i, k, 0] + state[i, 0, 0] * tip, state[i, k, 1] + state[i, 0, 1] * tip
            length = free[i, k, 0] + free[i, 0, 0] * tip - local[i, 0] * turn + local[i, 2] * raised
            curvature = free[i, k, 1] + free[i, 0, 1] * tip - local[i, 1] * turn + local[i, 3] * raised
            march.change[k, 0, i], march.change[k, 1, i] = length, curvature
            march.turned[k, i] = state[i + 1, k, 0] + state[i + 1, 0, 0] * tip
            if poses:
                slid_x += length * rod[i, 6] + curvature * rod[i, 8] - turn * rod[i, 5]
                slid_y += length * rod[i, 7] + curvature * rod[i, 9] + turn * rod[i, 4]
                march.slid[k, 0, i], march.slid[k, 1, i] = slid_x, slid_y
    sign = 1.0 if closing > 0 else (-1.0 if closing < 0 else closing)
    return sides, -sign if flips % 2 else sign


@inlined
def imbalance(arms: Arms, at: int, force: float, moment: float) -> float:
    """As of `Equilibrium`."""
    turn = moment / arms.measure[at, 1]
    if math.isnan(force) or math.isnan(turn):
        return math.nan
    return max(force, turn) / arms.measure[at, 0]


@inlined
def moves(arms: Arms, at: int, change: Array, turned: Array) -> float:
    """The size of a change of z (2, N) that turns headings (N,): see `Scale.moves`."""
    stretch, bend, heading, check = 0.0, 0.0, 0.0, 0.0
    for i in range(change.shape[1]):
        stretch, bend = max(stretch, abs(change[0, i])), max(bend, abs(change[1, i]))
        heading = max(heading, abs(turned[i]))
        check += abs(change[0, i]) + abs(change[1, i]) + abs(turned[i])
    if math.isnan(check):
        return math.nan
    return max(heading, (stretch + arms.measure[at, 2] * bend) * (3.0 / arms.measure[at, 1]))
