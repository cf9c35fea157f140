"""The path of one arm to its equilibrium: where it is, and by what its imbalances and moves are measured."""

import math
from typing import NamedTuple

from jaxtyping import Bool, Float64, Int64

from torcharm.engine.arrays import Array
from torcharm.engine.compilation import part
from torcharm.engine.newton_step import first_angular
from torcharm.engine.references import by_reference
from torcharm.statics.balance import RIGID

STIFF_STRAIN = 1e-4
"""The strain whose force counts as load, where it is more than the loads themselves: so that a tolerance of 1e-10 of
the load is never below the rounding of a strain, 1e-16, times the stiffness."""

STIFFEST = 1e-9 * RIGID
"""Stiffness [N·m] that is not an arm's own but stands for a direction in which it is rigid."""


@by_reference
class Scale(NamedTuple):
    """What imbalances and moves of B arms are measured by."""

    load: Float64[Array, "B"]  # [N], 1 N at least
    length: Float64[Array, "B"]  # mean neutral length of the segments [m]
    reach: Float64[Array, "B"]  # largest offset [m]


@by_reference
class Path(NamedTuple):
    """Scratch of one path."""

    trial: Float64[Array, "N K"]  # twists of an attempt
    base: Float64[Array, "N K"]  # and of the last equilibrium
    tangent: Float64[Array, "N C"]  # change of the unknowns by the factor there
    bend: Float64[Array, "N C"]  # and half its slope
    newton: Float64[Array, "N C"]  # Newton's step
    ahead: Float64[Array, "N C"]  # the tangent at the trial
    loaded: Bool[Array, "1"]  # whether the load acts; without it one element stands for each segment
    stays: Bool[Array, "1"]  # whether an arm whose branch ends under load is given up, in place of letting it snap
    quick: Float64[Array, "N K"]  # twists of the equilibrium under load at which the arm gives way most
    rush: Float64[Array, "N C"]  # how unknowns change by the load factor there: next to a bifurcation if there is any
    fastest: Float64[Array, "2"]  # the size of that change, as of `move_size`, and the load factor


@by_reference
class Found(NamedTuple):
    """Equilibria of B arms."""

    twists: Float64[Array, "B N K"]  # [m, rad]
    residual: Float64[Array, "B"]  # largest imbalance: forces, and moments over the length, over the load scale
    reached: Int64[Array, "B"]  # CONTINUED, SNAPPED, WARM or FAILED
    pivots: Int64[Array, "B 2"]  # numbers of positive pivots of J, and of zero ones
    scale: Float64[Array, "B 2"]  # by which imbalances of forces [N] and of moments [N·m] are measured


@part
def elements_under_way(arms, path, segment):  # type: ignore[no-untyped-def]
    """The first of a segment's elements, and the one after its last; without load one stands for all."""
    first = arms.first_node[segment]
    return first, arms.first_node[segment + 1] if path.loaded[0] else first + 1


@part
def scales(scale, balance, b):  # type: ignore[no-untyped-def]
    """By what imbalances of forces and of moments are measured."""
    force = max(scale.load[b], STIFF_STRAIN * balance.sections.stiffness[0])
    return force, max(scale.load[b] * scale.length[b], STIFF_STRAIN * balance.sections.stiffness[1])


@part
def imbalance(arms, scale, balance, path, b):  # type: ignore[no-untyped-def]
    """The largest residual: of forces over the load scale, of moments over that times the length. NaN if one is."""
    most = 0.0
    force_scale, moment_scale = scales(scale, balance, b)
    for segment in range(len(arms.first_node) - 1):
        first, last = elements_under_way(arms, path, segment)
        for i in range(first, last):
            for c in range(len(arms.unknown)):
                size = abs(balance.residual[i, c])
                size /= force_scale if arms.unknown[c] < first_angular(arms) else moment_scale
                if not size <= most:  # takes a NaN, and keeps it
                    most = size
    return most


@part
def move_size(arms, scale, path, b, change):  # type: ignore[no-untyped-def]
    """The size of a change of the unknowns: headings along the arm [rad], or three times the strains."""
    turn_x = turn_y = turn_z = heading = stretch = bend = 0.0
    angular = first_angular(arms)
    for segment in range(len(arms.first_node) - 1):
        first, last = elements_under_way(arms, path, segment)
        share = 1.0 / (last - first)
        for i in range(first, last):
            for c in range(len(arms.unknown)):
                value = change[i, c]
                if arms.unknown[c] < angular:
                    stretch = max(stretch, abs(value))
                    continue
                bend = max(bend, abs(value))
                if arms.unknown[c] == arms.size - 1:
                    turn_z += value * share
                elif arms.unknown[c] == 4:
                    turn_y += value * share
                else:
                    turn_x += value * share
            heading = max(heading, turn_x * turn_x + turn_y * turn_y + turn_z * turn_z)
    size = max(math.sqrt(heading), 3.0 * (stretch + scale.reach[b] * bend) / scale.length[b])
    return size if math.isfinite(stretch + bend + turn_x + turn_y + turn_z) else math.nan


@part
def move(arms, path, factor):  # type: ignore[no-untyped-def]
    """Add a factor times Newton's step to the trial."""
    for segment in range(len(arms.first_node) - 1):
        first, last = elements_under_way(arms, path, segment)
        for i in range(first, last):
            for c in range(len(arms.unknown)):
                path.trial[i, arms.unknown[c]] += factor * path.newton[i, c]


@part
def own_stiffness(arms, balance, path):  # type: ignore[no-untyped-def]
    """The largest slopes of sections' reactions by their own unknowns, of linear and of angular components."""
    linear = angular = 1e-9
    for segment in range(len(arms.first_node) - 1):
        first, last = elements_under_way(arms, path, segment)
        for i in range(first, last):
            for c in range(len(arms.unknown)):
                size = abs(balance.sections.slope[i, c, c])
                if arms.unknown[c] < first_angular(arms):
                    linear = max(linear, size)
                elif size < STIFFEST:
                    angular = max(angular, size)
    return linear, angular
