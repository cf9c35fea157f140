"""The force models of the experiment, each twice: as the library takes it, and from its equations in numpy."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from scipy.interpolate import CubicSpline
from torch import Tensor

import torcharm as ta
from experiments.exactness.reference import Array, Model, Real

BELLOWS = (
    (1, 0, -10.47),
    (0, 1, 1.068),
    (2, 0, 7.344),
    (1, 1, -0.5504),
    (0, 2, -0.00205),
    (3, 0, -19.39),
    (2, 1, 0.03461),
    (1, 2, 0.006294),
    (0, 3, -3.081e-5),
)
QUINTIC = ((1, 0, -9.0), (0, 1, 0.9), (1, 1, -0.6), (0, 3, -4e-5), (0, 4, 9e-7), (2, 5, 4e-9), (0, 5, -1.1e-8))
GRID_STRAINS, GRID_PRESSURES = (-0.2, 0.0, 0.25, 0.7), (0.0, 10.0, 25.0, 40.0, 60.0)
GRID_FORCES = tuple(
    tuple(30.0 * np.tanh(p / 30.0) * (1 + 0.3 * np.sin(9 * e)) - 12.0 * e for p in GRID_PRESSURES) for e in GRID_STRAINS
)


def polynomial(terms: tuple[tuple[int, int, float], ...]) -> Model:
    def force(e: Array, p: Array) -> Array:
        return np.asarray(sum(p.dtype.type(c) * e**i * p**j for i, j, c in terms))

    return Model(force, lambda _: ())


def mckibben(scale: float = 1.0) -> Model:
    """The published muscle, branch by branch."""

    def force(e: Array, p: Array) -> Array:
        e, p = np.broadcast_arrays(e, p)
        lim, crit = -0.274484489, -0.303225592
        z, c, s = _threshold(e), _passive(e), _slope(e)
        with np.errstate(all="ignore"):
            stretch = 89998.04265 * e**3 + 836.5810641 * e**2 + 62.59606786 * e
            root = np.sqrt(1.038555666 * 0.511454549**2 / 1.963398204) - 3.169979385 * e
            pulled = stretch + 1.963398204 * root**2 * p ** (1 + 4.231857967 * e)
        full = 1.038555666 * (0.511454549 + e) ** 2 * (p - z)
        rising = c + np.maximum(0, s * (p - z) - c)
        rate = np.where(e >= crit, _slope(e * 0 + lim) / (lim - crit) ** 2, -3.695687763)
        collapsed = c + rate * (e - crit) ** 2 * np.maximum(0, p - _onset(e * 0 + lim))
        pull = np.where(e >= 0, pulled, np.where(p >= z, full, np.where(e >= lim, rising, collapsed)))
        return np.asarray(-scale * pull)

    def kinks(e: Array) -> tuple[Array, ...]:
        inside = np.minimum(e, 0.0)
        with np.errstate(all="ignore"):
            onset = np.where(e >= -0.274484489, _onset(inside), _onset(e * 0 - 0.274484489))
        none = np.zeros_like(e)
        return np.where(e < 0, _threshold(inside), none), np.where((e < 0) & np.isfinite(onset), onset, none)

    return Model(force, kinks)


def _passive(e: Array) -> Array:
    return 265.2968218 * e**4 + 320.5906703 * e**3 + 126.11975 * e**2 + 21.92761236 * e


def _threshold(e: Array) -> Array:
    return 34610.2847 * e**4 + 5991.799518 * e**3 - 1032.874471 * e**2 - 395.9792747 * e


def _slope(e: Array) -> Array:
    return 0.637225654 * (0.453137516 + e) ** 2


def _onset(e: Array) -> Array:
    return _passive(e) / _slope(e) + _threshold(e)


def gridded() -> Model:
    """The tensor product of scipy's cubic splines, straight beyond its ends."""
    table = np.array(GRID_FORCES)
    rows = np.stack([CubicSpline(GRID_STRAINS, row)(GRID_STRAINS) for row in table.T])
    by_strain = CubicSpline(GRID_STRAINS, rows.T, axis=0)
    unit = CubicSpline(GRID_PRESSURES, np.eye(len(GRID_PRESSURES)), axis=0)

    def extended(spline: CubicSpline, x: Array) -> Array:
        low, high = spline.x[[0, -1]]
        inner = np.clip(x, low, high)
        return np.asarray(spline(inner) + (x - inner)[..., None] * spline(inner, 1))

    def force(e: Array, p: Array) -> Array:
        e, p = np.broadcast_arrays(e, p)
        values = extended(by_strain, e.astype(float)) * extended(unit, p.astype(float))
        return np.asarray(values.sum(-1).astype(p.dtype))

    return Model(force, lambda e: tuple(np.full_like(e, p) for p in GRID_PRESSURES))


@dataclass(frozen=True)
class SmoothModel:
    """A user's force: it saturates with pressure, without kinks, and is no polynomial."""

    bending_stiffness: float = -0.2
    max_pressure: float = 60.0
    strain_range: tuple[float, float] = (-0.3, 0.3)
    pressure_range: tuple[float, float] = (0.0, 60.0)

    def force(self, strain: Tensor, pressure: Tensor) -> Tensor:
        return 40 * torch.tanh(pressure / 35) * (1 - strain) + 0.05 * pressure * torch.cos(pressure / 20) - 20 * strain


def smooth() -> Model:
    def force(e: Array, p: Array) -> Array:
        return np.asarray(40 * np.tanh(p / 35) * (1 - e) + Real(0.05) * p * np.cos(p / 20) - 20 * e)

    return Model(force, lambda _: ())


@dataclass(frozen=True)
class KinkedModel:
    """A user's force with a kink that moves with the strain, a dead zone below it, and a square root of pressure."""

    bending_stiffness: float = -0.3
    max_pressure: float = 60.0
    strain_range: tuple[float, float] = (-0.3, 0.3)
    pressure_range: tuple[float, float] = (0.0, 60.0)

    def pressure_knots(self, strain: Tensor) -> Tensor:
        return (20 + 40 * strain).unsqueeze(0)

    def force(self, strain: Tensor, pressure: Tensor) -> Tensor:
        beyond = (pressure - 20 - 40 * strain).relu()
        return 3 * (beyond + 1).sqrt() + 0.2 * beyond - 3 - 0.1 * pressure - 30 * strain


def kinked() -> Model:
    def force(e: Array, p: Array) -> Array:
        beyond = np.maximum(p - 20 - 40 * e, 0)
        return np.asarray(3 * np.sqrt(beyond + 1) + Real(0.2) * beyond - 3 - Real(0.1) * p - 30 * e)

    return Model(force, lambda e: (20 + 40 * e,))


@dataclass(frozen=True)
class Pair:
    """A model for the library, its equations, the strains it is tried at, and its usual limit [kPa]."""

    actuator: ta.Actuator
    model: Model
    strains: tuple[float, float]
    limit: float


PAIRS: dict[str, Callable[[], Pair]] = {
    "bellows": lambda: Pair(ta.Bellows(), polynomial(BELLOWS), (-0.16, 0.66), 50.0),
    "muscle": lambda: Pair(ta.McKibben(), mckibben(), (-0.5, 0.05), 100.0),
    "doubled muscle": lambda: Pair(ta.McKibben(force_scale=2.0), mckibben(2.0), (-0.2, 0.05), 100.0),
    "quintic": lambda: Pair(
        ta.PolynomialActuator(QUINTIC, (-0.3, 0.3), (0.0, 60.0), 60.0), polynomial(QUINTIC), (-0.3, 0.3), 60.0
    ),
    "gridded": lambda: Pair(
        ta.GriddedActuator(GRID_STRAINS, GRID_PRESSURES, GRID_FORCES, 60.0), gridded(), (-0.2, 0.7), 60.0
    ),
    "smooth": lambda: Pair(SmoothModel(), smooth(), (-0.3, 0.3), 60.0),
    "kinked": lambda: Pair(KinkedModel(), kinked(), (-0.3, 0.3), 60.0),
}
"""By name."""
