"""Axial forces of the models that the engine evaluates itself, with their slopes, one actuator at a time.

The equations are those of `actuators.polynomial` and `actuators.mckibben`, from whose numbers they are made.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from torcharm.actuators import Actuator, McKibben, PolynomialActuator, mckibben
from torcharm.actuators.inspection import follows
from torcharm.engine.arrays import Array
from torcharm.engine.compilation import part
from torcharm.engine.references import by_reference
from torcharm.inputs import plain_number

_A1, _A2, _B1, _B2, _B3 = mckibben._A1, mckibben._A2, mckibben._B1, mckibben._B2, mckibben._B3
_E1, _E2, _E3, _S1, _S2 = mckibben._E1, mckibben._E2, mckibben._E3, mckibben._S1, mckibben._S2
_SLACK, _TRACE = mckibben._SLACK, mckibben._TRACE
_LIM, _CRIT, _RISE_LIM = mckibben._STRAIN_LIM, mckibben._STRAIN_CRIT, mckibben._RISE_LIM
_RISE_RATE, _COLLAPSE_RATE = mckibben._RISE_RATE, mckibben._COLLAPSE_RATE
_C, _C_SLOPE, _Z, _Z_SLOPE = mckibben._CONTRACTION

SAMPLED, POLYNOMIAL, MUSCLE = -1, 0, 1
"""Kinds of force models: any, sampled by torch, and two that the engine evaluates itself."""
STRETCHED_FROM = 0.0
"""The strain from which a muscle's force is a power of pressure; below, lines between corners."""


@by_reference
class Models(NamedTuple):
    """The force models of M actuators."""

    kind: Int64[Array, "M"]  # SAMPLED, POLYNOMIAL or MUSCLE
    table: Float64[Array, "M J I"]  # `c[j, i]` of `Σ c[j, i] p^j ε^i`, of the polynomials
    scale: Float64[Array, "M"]  # factors on the forces


def models_of(actuators: Sequence[Actuator]) -> Models:
    """The models as numbers; what the engine cannot evaluate itself is SAMPLED."""
    kind = np.array([_kind(model) for model in actuators])
    tables = [_table(model) for model in actuators]
    table = np.zeros((len(kind), max(2, *map(len, tables)), max(len(rows[0]) for rows in tables)))
    for a, rows in enumerate(tables):
        table[a, : len(rows), : len(rows[0])] = rows
    scale = [plain_number(model.force_scale) if isinstance(model, McKibben) else 1.0 for model in actuators]
    return Models(kind, table, np.array(scale))


def _kind(model: Actuator) -> int:
    if follows(model, McKibben, "force"):
        return MUSCLE
    return POLYNOMIAL if follows(model, PolynomialActuator, "force", "_rows") else SAMPLED


def _table(model: Actuator) -> list[list[float]]:
    """`c[j][i]` of a polynomial; zeros for other models."""
    if _kind(model) != POLYNOMIAL or not isinstance(model, PolynomialActuator):
        return [[0.0]]
    return model._rows(plain_number(model.force_scale))


@part
def muscle(x: float, p: float, log_p: float) -> tuple[float, float, float]:
    """F, ∂F/∂ε and ∂F/∂p of a muscle at strain x and pressure p."""
    if x >= 0:
        slack = _B2 * x + _SLACK
        gain, exponent = _B1 * slack * slack, _B3 * x
        power = math.exp(exponent * log_p)
        pull = gain * power * p
        slope = (3 * _E3 * x + 2 * _E2) * x + _E1
        slope += power * p * (2 * _B1 * _B2 * slack) + pull * (_B3 * log_p)
        rate = gain * power
        if p > _TRACE:
            rate *= 1 + exponent
        return ((_E3 * x + _E2) * x + _E1) * x + pull, slope, rate
    beyond = p - _quartic(_Z, x)
    if beyond >= 0:
        return _in_proportion(_A1, x + _A2, beyond, x)
    compression, at_rest = _quartic(_C, x), _quartic(_C_SLOPE, x)
    if x < _LIM:
        collapse = (_RISE_RATE if x >= _CRIT else _COLLAPSE_RATE) * (x - _CRIT)
        rise = max(p - _RISE_LIM, 0.0)
        steep = collapse * (x - _CRIT)
        return compression + steep * rise, at_rest + 2 * collapse * rise, steep if rise > 0 else 0.0
    force, slope, rate = _in_proportion(_S1, x + _S2, beyond, x)
    if force <= compression:
        return compression, at_rest, 0.0
    return force, slope, rate


@part
def _in_proportion(factor: float, shift: float, beyond: float, x: float) -> tuple[float, float, float]:
    """A rate times what the pressure is beyond Z, both in pull and on the way there."""
    growth = factor * shift
    rate = growth * shift
    return rate * beyond, 2 * growth * beyond - rate * _quartic(_Z_SLOPE, x), rate


@part
def _quartic(c: tuple[float, ...], x: float) -> float:
    """`Σ c_i x^i`."""
    return (((c[4] * x + c[3]) * x + c[2]) * x + c[1]) * x + c[0]


@part
def muscle_power(x: float) -> float:
    """By how much the power of pressure with which a stretched muscle pulls is above 1."""
    return _B3 * x


@part
def muscle_corners(x: float) -> tuple[float, float]:
    """Pressures [kPa] of a contracted muscle's kinks: where its force begins to recover, and Z, where it pulls."""
    pull = _quartic(_Z, x)
    if x < _LIM:
        return _RISE_LIM, pull
    shift = x + _S2
    return pull + _quartic(_C, x) / (_S1 * shift * shift), pull


@part
def polynomial_row(models, a, strain, row):  # type: ignore[no-untyped-def]
    """Write the coefficients by powers of pressure, two at least, of actuator a at a strain; returns the degree."""
    degree = 0
    row[1] = 0.0
    for j in range(models.table.shape[1]):
        total = 0.0
        for i in range(models.table.shape[2] - 1, -1, -1):
            total = total * strain + models.table[a, j, i]
        row[j] = models.scale[a] * total
        if total != 0.0:
            degree = j
    return degree


@part
def force_by_pressure(models, a, strain, pressure, row):  # type: ignore[no-untyped-def]
    """The axial force [N] of actuator a, of a kind that the engine knows, and its two derivatives by pressure."""
    if models.kind[a] == POLYNOMIAL:
        total = slope = bend = 0.0
        for j in range(polynomial_row(models, a, strain, row), -1, -1):
            bend = bend * pressure + 2.0 * slope
            slope = slope * pressure + total
            total = total * pressure + row[j]
        return total, slope, bend
    pull, _, rate = muscle(strain, pressure, math.log(max(pressure, _TRACE)))
    bend = rate * _B3 * strain / pressure if strain >= STRETCHED_FROM and pressure > 0.0 else 0.0
    return -models.scale[a] * pull, -models.scale[a] * rate, -models.scale[a] * bend
