"""The four coefficients of exponentials of rigid motions, as smooth functions of the squared angle."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

_SERIES_RADIUS = 2.0
"""Angle [rad] below which the series are used: above it, the closed forms lose no more than the last digit,
and their first two derivatives by the squared angle no more than two."""

_SERIES_TERMS = 16
"""Terms of each series: the first one left out, and its first two derivatives, are below 1e-19 at the radius."""


def turn_ratios(square: Float[Tensor, "*s"]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """A = sin θ/θ, B = (1 - cos θ)/θ², C = (θ - sin θ)/θ³ and D = (θ²/2 - 1 + cos θ)/θ⁴ of θ².

    C and D come from their power series in θ² below an angle of 2, and A and B from them (`A = 1 - θ²C`,
    `B = 1/2 - θ²D`); above it, it is the other way round. The branch that is not taken is given a harmless
    angle, so that its derivatives are finite.
    """
    near = square < _SERIES_RADIUS**2
    small = torch.where(near, square, torch.zeros_like(square))
    large = torch.where(near, torch.full_like(square, _SERIES_RADIUS**2), square)
    angle = large.sqrt()
    sine = angle.sin() / angle
    cosine = 2.0 * (angle / 2).sin().square() / large
    c_small, d_small = alternating_series(small, 3, _SERIES_TERMS), alternating_series(small, 4, _SERIES_TERMS)
    return (
        torch.where(near, 1.0 - small * c_small, sine),
        torch.where(near, 0.5 - small * d_small, cosine),
        torch.where(near, c_small, (1.0 - sine) / large),
        torch.where(near, d_small, (0.5 - cosine) / large),
    )


def alternating_series(square: Tensor, first_factorial: int, count: int) -> Tensor:
    """The first terms, so many, of Σ_k (-θ²)^k / (2k + first_factorial)!, by Horner."""
    terms = [(-1) ** k / math.factorial(2 * k + first_factorial) for k in range(count)]
    total = torch.full_like(square, terms[-1])
    for term in reversed(terms[:-1]):
        total = total * square + term
    return total
