"""The path of one arm to its equilibrium: where it is, and by what its imbalances and moves are measured."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from torcharm.engine.arms import Arms
from torcharm.engine.compilation import part
from torcharm.engine.newton_step import first_angular
from torcharm.engine.references import by_reference
from torcharm.statics.balance import RIGID

Array = NDArray[Any]

STIFF_STRAIN = 1e-4
"""The strain whose force counts as load, where it is more than the loads themselves: so that a tolerance of 1e-10 of
the load is never below the rounding of a strain, 1e-16, times the stiffness."""

STIFFEST = 1e-9 * RIGID
"""Stiffness [N·m] that is not an arm's own but stands for a direction in which it is rigid."""


@by_reference
class Scale(NamedTuple):
    """What imbalances and moves of B arms are measured by.

    Attributes:
        load: (B,) [N], 1 N at least.
        length: (B,) mean neutral length of the segments [m].
        reach: (B,) largest offset [m].
    """

    load: Array
    length: Array
    reach: Array


@by_reference
class Path(NamedTuple):
    """Room for one path.

    Attributes:
        trial, base: (N, K) twists of an attempt, and of the last equilibrium.
        tangent, bend: (N, C) change of the unknowns by the factor there, and half its slope.
        newton: (N, C) Newton's step.
        ahead: (N, C) the tangent at the trial.
        loaded: (1,) whether the load acts; without it one element stands for each segment.
        stays: (1,) whether an arm whose branch ends under load is given up, in place of letting it snap.
        quick, rush: (N, K) twists of the equilibrium under load at which the arm gives way most, and (N, C) how the
            unknowns change by the load factor there: next to a bifurcation if there is any.
        fastest: (2,) the size of that change, as of `move_size`, and the load factor.
    """

    trial: Array
    base: Array
    tangent: Array
    bend: Array
    newton: Array
    ahead: Array
    loaded: Array
    stays: Array
    quick: Array
    rush: Array
    fastest: Array


@by_reference
class Found(NamedTuple):
    """Equilibria of B arms.

    Attributes:
        twists: (B, N, K) [m, rad].
        residual: (B,) the largest imbalance of an element: forces, and moments over the length, over the load scale.
        reached: (B,) CONTINUED, SNAPPED, WARM or FAILED.
        pivots: (B, 2) numbers of positive pivots of J, and of zero ones.
        scale: (B, 2) by which imbalances of forces [N] and of moments [N·m] are measured.
    """

    twists: Array
    residual: Array
    reached: Array
    pivots: Array
    scale: Array


def make_path(arms: Arms) -> Path:
    """Room for one arm's path."""
    nodes, size, columns = arms.first_node[-1], arms.size, len(arms.unknown)
    trial, base, quick = np.zeros((3, nodes, size))
    tangent, bend, newton, ahead, rush = np.zeros((5, nodes, columns))
    loaded, stays = np.zeros((2, 1), dtype=np.bool_)
    return Path(trial, base, tangent, bend, newton, ahead, loaded, stays, quick, rush, np.zeros(2))


@part
def elements_under_way(arms, path, segment):  # type: ignore[no-untyped-def]
    """The first of a segment's elements, and the one after its last; without load one stands for all."""
    first = arms.first_node[segment]
    return first, arms.first_node[segment + 1] if path.loaded[0] else first + 1


@part
def scales(scale, room, b):  # type: ignore[no-untyped-def]
    """By what imbalances of forces and of moments are measured."""
    force = max(scale.load[b], STIFF_STRAIN * room.sections.stiffness[0])
    return force, max(scale.load[b] * scale.length[b], STIFF_STRAIN * room.sections.stiffness[1])


@part
def imbalance(arms, scale, room, path, b):  # type: ignore[no-untyped-def]
    """The largest residual: of forces over the load scale, of moments over that times the length. NaN if one is."""
    most = 0.0
    force_scale, moment_scale = scales(scale, room, b)
    for segment in range(len(arms.first_node) - 1):
        first, last = elements_under_way(arms, path, segment)
        for i in range(first, last):
            for c in range(len(arms.unknown)):
                size = abs(room.residual[i, c])
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
def copy_twists(out, given):  # type: ignore[no-untyped-def]
    """Write twists (N, K)."""
    for i in range(out.shape[0]):
        for c in range(out.shape[1]):
            out[i, c] = given[i, c]


@part
def own_stiffness(arms, room, path):  # type: ignore[no-untyped-def]
    """The largest slopes of sections' reactions by their own unknowns, of linear and of angular components."""
    linear = angular = 1e-9
    for segment in range(len(arms.first_node) - 1):
        first, last = elements_under_way(arms, path, segment)
        for i in range(first, last):
            for c in range(len(arms.unknown)):
                size = abs(room.sections.slope[i, c, c])
                if arms.unknown[c] < first_angular(arms):
                    linear = max(linear, size)
                elif size < STIFFEST:
                    angular = max(angular, size)
    return linear, angular
