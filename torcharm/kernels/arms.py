"""What the kernels know of arms: numbers in arrays."""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torcharm import mechanics
from torcharm._arrays import Array, as_array
from torcharm._inputs import plain_number
from torcharm.actuators import Actuator, McKibben, PolynomialActuator
from torcharm.actuators.bending import bending_model
from torcharm.actuators.inspection import follows
from torcharm.wrenches import reference_pressures

POLYNOMIAL, MUSCLE = 0, 1


class Arms(NamedTuple):
    """B arms of M actuators.

    Attributes:
        kind: (M,) POLYNOMIAL or MUSCLE.
        table: (M, P, S) `c_ji` of `Σ c_ji p^j ε^i`, of the polynomials.
        factor: (M,) on the forces, in use for the muscles alone.
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
    """Whether the kernels know such arms: of this package's force models, or classes with their forces."""
    alike = all(any(_is_of(model, kind) for kind in (McKibben, PolynomialActuator)) for model in models)
    simple = alike and all(bending_model(model.bending_stiffness) is None for model in models)
    return simple and shear_stiffness is None and like.dtype == torch.float64 and like.device.type == "cpu"


def _is_of(model: Actuator, kind: type) -> bool:
    return follows(model, kind, "force", "force_slopes", *(("_rows",) if kind is PolynomialActuator else ()))


def arms_of(arms: mechanics.Arms, scale: tuple[Tensor, Tensor, Tensor], limits: Tensor, tolerance: float) -> Arms:
    """From arms of known kinds; limits (M, B)."""
    kind = [MUSCLE if isinstance(model, McKibben) else POLYNOMIAL for model in arms.models]
    factor = np.array(
        [plain_number(model.force_scale) if isinstance(model, McKibben) else 1.0 for model in arms.models]
    )
    tables = [
        model._rows(plain_number(model.force_scale)) if isinstance(model, PolynomialActuator) else [[0.0]]
        for model in arms.models
    ]
    table = np.zeros((len(kind), max(map(len, tables)), max(len(rows[0]) for rows in tables)))
    for at, rows in enumerate(tables):
        table[at, : len(rows), : len(rows[0])] = rows
    factors = [plain_number(model.bending_stiffness) for model in arms.models]
    bending = np.array(factors) / [plain_number(pressure) for pressure in reference_pressures(arms.models)]
    flat = (arms.radii[:, 0], arms.length[:, 0], arms.tip_load, arms.base_pose, torch.stack(scale), limits)
    radii, neutral, load, base, measure, most = (np.array(as_array(part).T, order="C") for part in flat)
    return Arms(np.array(kind), table, factor, bending, radii, neutral, load, base, measure, most, tolerance)
