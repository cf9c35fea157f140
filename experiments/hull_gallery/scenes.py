"""The arms and shapes whose attainable sets are drawn and searched."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

import torcharm as ta

Array = NDArray[np.float64]
NODES = 6
SHAPES = ((-2.0, 3.0), (2.0, 1.0), (8.0, -1.0))
"""Slope and intercept of the curvature [rad]."""
OUTER, INNER = 0.08, 0.015
SQUEEZED = 0.5 / 0.65
"""Neutral length [m] that a centreline of 0.5 m squeezes by 35 %: beyond the muscle's ε_crit, 30.3 %."""
DRAWS, SHAPE_PARAMETER, SEED = 150, 0.3, 3
EDGE_POINTS = 4


def twists(shape: tuple[float, float]) -> Tensor:
    return ta.affine_curvature(*shape, length=0.5, nodes=NODES)


def interior_pressures(arm: ta.ArmDesign) -> Tensor:
    """The gallery's draws (150, M) [kPa]: Beta(0.3, 0.3), which crowds at the box's faces, of each limit."""
    drawn = np.random.default_rng(SEED).beta(SHAPE_PARAMETER, SHAPE_PARAMETER, (DRAWS, arm.actuator_count))
    return torch.from_numpy(drawn) * arm.max_pressure


def bent(quadratic: float) -> ta.PolynomialActuator:
    """A push of 50 N at 50 kPa and no strain, monotonic in pressure but far from linear: up to 45 % off its chord."""
    linear = 1.0 - 50.0 * quadratic
    return ta.PolynomialActuator(((0, 1, linear), (0, 2, quadratic), (1, 0, -40.0)), (-0.5, 0.7), (0.0, 50.0), 50.0)


SLOWING, QUICKENING = bent(-0.018), bent(0.018)


@dataclass(frozen=True)
class Case:
    """A design, and what it stands for."""

    name: str
    build: Callable[[], ta.ArmDesign]


def _arm(radii: list[float], models: list[ta.Actuator], length: float = 0.5) -> Callable[[], ta.ArmDesign]:
    return lambda: ta.ArmDesign(radii, length, models)


BELLOWS, MUSCLE = ta.Bellows(), ta.McKibben()
FOUR = [-OUTER, -INNER, INNER, OUTER]
CASES = (
    Case("M = 1: bellows", _arm([OUTER], [BELLOWS])),
    Case("M = 1: muscle", _arm([INNER], [MUSCLE])),
    Case("M = 2: bellows, muscle", _arm([-OUTER, INNER], [BELLOWS, MUSCLE])),
    Case("M = 2: two bellows", _arm([-OUTER, OUTER], [BELLOWS, BELLOWS])),
    Case("M = 3: bellows, muscle, bellows", _arm([-OUTER, 0.0, OUTER], [BELLOWS, MUSCLE, BELLOWS])),
    Case("M = 4: antagonistic (paper)", ta.antagonistic_arm),
    Case("M = 4: bellows-only (paper)", ta.bellows_arm),
    Case("M = 4: muscle-only (paper)", ta.mckibben_arm),
    Case("M = 2: slowing, side by side", _arm([-0.005, 0.005], [SLOWING, SLOWING])),
    Case("M = 4: slowing", _arm(FOUR, [SLOWING] * 4)),
    Case("M = 4: slowing and quickening", _arm(FOUR, [SLOWING, QUICKENING, QUICKENING, SLOWING])),
    Case("M = 4: muscles squeezed past ε_crit", _arm([-0.03, -INNER, INNER, 0.03], [MUSCLE] * 4, SQUEEZED)),
)
