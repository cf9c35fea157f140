"""Axial force of a muscle, with its slopes: `McKibben.force_slopes` for one."""

import math

from torcharm._compiled import inlined
from torcharm.actuators import mckibben

_A1, _A2, _B1, _B2, _B3 = mckibben._A1, mckibben._A2, mckibben._B1, mckibben._B2, mckibben._B3
_E1, _E2, _E3, _S1, _S2 = mckibben._E1, mckibben._E2, mckibben._E3, mckibben._S1, mckibben._S2
_SLACK, _TRACE = mckibben._SLACK, mckibben._TRACE
_LIM, _CRIT, _RISE_LIM = mckibben._STRAIN_LIM, mckibben._STRAIN_CRIT, mckibben._RISE_LIM
_RISE_RATE, _COLLAPSE_RATE = mckibben._RISE_RATE, mckibben._COLLAPSE_RATE
_C, _C_SLOPE, _Z, _Z_SLOPE = mckibben._CONTRACTION


@inlined
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


@inlined
def _in_proportion(factor: float, shift: float, beyond: float, x: float) -> tuple[float, float, float]:
    """A rate times what the pressure is beyond Z, both in pull and on the way there."""
    growth = factor * shift
    rate = growth * shift
    return rate * beyond, 2 * growth * beyond - rate * _quartic(_Z_SLOPE, x), rate


@inlined
def _quartic(c: tuple[float, ...], x: float) -> float:
    """`Σ c_i x^i`."""
    return (((c[4] * x + c[3]) * x + c[2]) * x + c[1]) * x + c[0]
