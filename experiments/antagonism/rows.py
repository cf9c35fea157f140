"""What this experiment measures, a row each."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from torch import Tensor

import torcharm as ta

ARMS = {"antagonistic": ta.antagonistic_arm, "bellows-only": ta.bellows_arm, "muscle-only": ta.mckibben_arm}


SHAPES = ((-3.0, 3.0), (1.0, 1.5), (6.0, -1.5))


@dataclass(frozen=True)
class Result:
    """One arm, shape and load.

    Attributes:
        arm, slope, intercept, load: which; loads from 1.
        force_x, force_y, moment: the load [N, N, N·m].
        absolute, relative: unattainability of the exact sets [N].
        converged: whether the distances of all nodes are known to rounding.
        absolute_paper: with the paper's 3 points an edge.
        absolute_reused: the same with, at every node, only the pressures that are vertices at node 1.
        in_range: whether every strain is characterised.
        wins: whether none of the three arms has a smaller absolute unattainability here.
    """

    arm: str
    slope: float
    intercept: float
    load: int
    force_x: float
    force_y: float
    moment: float
    absolute: float
    relative: float
    absolute_paper: float
    absolute_reused: float
    converged: bool
    in_range: bool
    wins: bool


@dataclass(frozen=True)
class Hull:
    """One node's attainable set, and how the loads' requirements lie to it.

    Attributes:
        arm, slope, intercept, node: which; nodes from 1.
        force_min, force_max, moment_min, moment_max: its extent [N, N·m].
        area: [N²·m].
        origin: signed distance of the origin from it [N], negative inside.
        held: the share of requirements inside.
        miss: mean distance of the requirements [N].
        miss_force: the share of the misses' squares that is force; the rest is moment.
        strain_min, strain_max: of the actuators.
    """

    arm: str
    slope: float
    intercept: float
    node: int
    force_min: float
    force_max: float
    moment_min: float
    moment_max: float
    area: float
    origin: float
    held: float
    miss: float
    miss_force: float
    strain_min: float
    strain_max: float


def twists_of(shape: tuple[float, float]) -> Tensor:
    return ta.affine_curvature(*shape, length=0.5, nodes=10)


def chosen(rows: Sequence[Any], arm: str, shape: tuple[float, float]) -> list[Any]:
    return [row for row in rows if (row.arm, row.slope, row.intercept) == (arm, *shape)]
