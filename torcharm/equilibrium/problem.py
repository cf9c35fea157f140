"""B problems of equilibrium, and the equilibria that the engine finds of them."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries
from torcharm.engine.arms import Arms, Loads, arms_of, flat
from torcharm.engine.loads import loads_of
from torcharm.engine.path import Scale
from torcharm.engine.pose_error import NO_GOAL
from torcharm.engine.pressure_model import Problem as EngineProblem
from torcharm.load import ExternalLoad
from torcharm.statics.balance import balance_residual, unknown_columns

LEAST_LOAD = 1.0
"""Load scale [N] of an arm without load: its imbalances are measured by that, and by its stiffness."""


@dataclass(frozen=True, eq=False)
class Problem:
    """B problems, whose batches broadcast to `batch`; all tensors of one dtype.

    Attributes:
        arm: the designs.
        pressure: (..., M) [kPa], segment after segment.
        load: all that loads the arms.
        base_pose: (..., 3) or (..., 4, 4).
        nodes: number of elements of each segment.
        wrench_at: "start" or "middle".
        shear_stiffness: k [N/m] of each actuator, or None.
        batch: shape of the B problems.
    """

    arm: ArmDesign | ArmSeries
    pressure: Tensor
    load: ExternalLoad
    base_pose: Tensor
    nodes: tuple[int, ...]
    wrench_at: str
    shear_stiffness: float | None
    batch: tuple[int, ...]

    @property
    def count(self) -> int:
        """B."""
        return math.prod(self.batch)

    @property
    def unknown(self) -> list[int]:
        """The columns of twists that are unknown."""
        return list(unknown_columns(self.arm, self.shear_stiffness))

    def double(self) -> "Problem":
        """The same in float64 on the CPU, with its graphs."""
        like: dict[str, Any] = {"device": "cpu", "dtype": torch.float64}
        arm, load = self.arm.to(**like), self.load.to(**like)
        return replace(self, arm=arm, pressure=self.pressure.to(**like), load=load, base_pose=self.base_pose.to(**like))

    def residual(self, twists: Tensor) -> Tensor:
        """R (*batch, N, C), with its graph."""
        return balance_residual(
            self.arm,
            twists,
            self.pressure,
            self.load,
            self.base_pose,
            self.nodes,
            self.wrench_at,
            self.shear_stiffness,
        )

    @cached_property
    def packed(self) -> EngineProblem:
        """The problems as the engine takes them, with pressures for limits, and without a goal."""
        pressure = flat(self.pressure, self.batch)
        highest = pressure.max(0) if self.count else np.zeros(self.arm.actuator_count)
        arms = arms_of(self.arm, self.batch, self.nodes, self.shear_stiffness, highest)
        loads = loads_of(self.arm, self.load, self.base_pose, self.batch, self.nodes, middle=self.wrench_at == "middle")
        return EngineProblem(arms, loads, _scale(arms, loads), NO_GOAL, pressure)


def _scale(arms: Arms, loads: Loads) -> Scale:
    """What imbalances and moves are measured by."""
    dimension = loads.offset.shape[2]
    lengths = [arms.neutral[:, first:last].mean(-1) for first, last in pairwise(arms.first_actuator)]
    length = np.mean(lengths, 0)
    force = np.linalg.norm(loads.wrench[..., :dimension], axis=-1).sum(-1)
    moment = np.linalg.norm(loads.wrench[..., dimension:], axis=-1).sum(-1)
    weight = (loads.weight * np.diff(arms.first_node)).sum(-1)
    load = np.maximum(np.maximum(force + weight, moment / length), LEAST_LOAD)
    return Scale(load, length, np.sqrt(arms.y**2 + arms.z**2).max(-1))
