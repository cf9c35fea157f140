"""What the kernels know of arms: numbers in arrays."""

from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from torcharm import mechanics
from torcharm._arrays import Array, as_array
from torcharm.actuators import Actuator, McKibben, PolynomialActuator
from torcharm.actuators.bending import bending_model
from torcharm.wrenches import reference_pressures

POLYNOMIAL, MUSCLE = 0, 1


class Arms(NamedTuple):
    """B arms of M actuators.

    Attributes:
        kind: (M,) POLYNOMIAL or MUSCLE.
        table: (M, P, S) `c_ji` of `Σ c_ji p^j ε^i`, of the polynomials.
        factor: (M,) on the forces of the muscles.
        bending: (M,) bending stiffness by pressure [N·m²/kPa].
        radii, neutral: (B, M) [m].
        load, base: (B, 3) tip loads and base poses.
        measure: (B, 3) load scale [N], length and largest offset [m].
        limits: (B, M) of pressure [kPa].
        tolerance: of the load scale.
    """

    kind: Array
    table: Array
    factor: Array
    bending: Array
    radii: Array
    neutral: Array
    load: Array
    base: Array
    measure: Array
    limits: Array
    tolerance: float


def known(models: tuple[Actuator, ...], like: Tensor, shear_stiffness: float | None) -> bool:
    """Whether the kernels know such arms."""
    alike = all(type(model).force in (McKibben.force, PolynomialActuator.force) for model in models)
    simple = alike and all(bending_model(model.bending_stiffness) is None for model in models)
    return simple and shear_stiffness is None and like.dtype == torch.float64 and like.device.type == "cpu"


def arms_of(arms: mechanics.Arms, scale: tuple[Tensor, Tensor, Tensor], limits: Tensor, tolerance: float) -> Arms:
    """From arms of known kinds; limits (M, B)."""
    kind = [MUSCLE if isinstance(model, McKibben) else POLYNOMIAL for model in arms.models]
    rows: list[list[list[float]]] = [[[0.0]] if kind_ == MUSCLE else model._rows() for kind_, model in zip(kind, arms.models, strict=True)]
    table = np.zeros((len(rows), max(map(len, rows)), max(len(row[0]) for row in rows)))
    for at, row in enumerate(rows):
        table[at, : len(row), : len(row[0])] = row
    bending = np.array([float(model.bending_stiffness) for model in arms.models]) / reference_pressures(arms.models)
    factor = np.array([float(getattr(model, "force_scale", 1.0)) for model in arms.models])
    flat = (arms.radii[:, 0], arms.length[:, 0], arms.tip_load, arms.base_pose, torch.stack(scale), limits)
    radii, neutral, load, base, measure, limits_ = (batch_first(value) for value in flat)
    return Arms(np.array(kind), table, factor, bending, radii, neutral, load, base, measure, limits_, tolerance)


def batch_first(value: Tensor) -> Array:
    """(B, ...) from (..., B), in a row."""
    return np.ascontiguousarray(as_array(value.movedim(-1, 0)))


def batch_last(value: Any) -> Tensor:
    """(..., B) from (B, ...)."""
    return torch.from_numpy(value).movedim(0, -1)
