"""Axial forces of one actuator, with their slopes: see `actuators`."""

import math

from torcharm._compiled import inlined
from torcharm.actuators import mckibben

_A1, _A2, _B1, _B2, _B3 = mckibben._A1, mckibben._A2, mckibben._B1, mckibben._B2, mckibben._B3
_SLACK, _TRACE = mckibben._SLACK, mckibben._TRACE
_LIM, _CRIT, _RISE_LIM = mckibben._STRAIN_LIM, mckibben._STRAIN_CRIT, mckibben._RISE_LIM
_RISE_RATE, _COLLAPSE_RATE = mckibben._RISE_RATE, mckibben._COLLAPSE_RATE


@inlined
def muscle(x: float, p: float, log_p: float) -> tuple[float, float, float]:
    """F, ∂F/∂ε and ∂F/∂p of a muscle at strain x and pressure p."""
    if x >= 0:
        slack = _B2 * x + _SLACK
        gain, exponent = _B1 * slack * slack, _B3 * x
        power = math.exp(exponent * log_p)
        pull = gain * power * p
        slope = (3 * 89998.04265 * x + 2 * 836.5810641) * x + 62.59606786
        slope += power * p * (2 * _B1 * _B2 * slack) + pull * (_B3 * log_p)
        rate = gain * power
        if p > _TRACE:
            rate *= 1 + exponent
        return ((89998.04265 * x + 836.5810641) * x + 62.59606786) * x + pull, slope, rate
    threshold = (((34610.2847 * x + 5991.799518) * x - 1032.874471) * x - 395.9792747) * x
    threshold_slope = ((4 * 34610.2847 * x + 3 * 5991.799518) * x - 2 * 1032.874471) * x - 395.9792747
    beyond = p - threshold
    if beyond >= 0:
        shift = x + _A2
        growth = _A1 * shift
        rate = growth * shift
        return rate * beyond, 2 * growth * beyond - rate * threshold_slope, rate
    compression = (((265.2968218 * x + 320.5906703) * x + 126.11975) * x + 21.92761236) * x
    at_rest = ((4 * 265.2968218 * x + 3 * 320.5906703) * x + 2 * 126.11975) * x + 21.92761236
    if x < _LIM:
        collapse = (_RISE_RATE if x >= _CRIT else _COLLAPSE_RATE) * (x - _CRIT)
        rise = max(p - _RISE_LIM, 0.0)
        steep = collapse * (x - _CRIT)
        return compression + steep * rise, at_rest + 2 * collapse * rise, steep if rise > 0 else 0.0
    shift = x + 0.453137516
    growth = 0.637225654 * shift
    rate = growth * shift
    force = rate * beyond
    if force <= compression:
        return compression, at_rest, 0.0
    return force, 2 * growth * beyond - rate * threshold_slope, rate
