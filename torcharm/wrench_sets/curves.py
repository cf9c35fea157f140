"""Pressure curves of any force model as cubic pieces, for the engine.

A model's force and its slope by pressure are sampled at a few pressures, with the model's own kinks among them; between
two there is a cubic. Samples are refined until the cubics are good to `ACCURACY`, or the densest sampling is reached.
"""

import torch
from torch import Tensor

from torcharm.actuators import Actuator, force_slopes, pressure_degree, pressure_knots

ACCURACY = 1e-7
"""By how much of a model's largest force its cubic pieces may be off: far below what any model is good to."""
SAMPLINGS = ((4, 1.0), (8, 1.0), (8, 2.0), (16, 1.0), (16, 3.0), (32, 3.0))
"""Pieces, and the power with which they crowd towards no pressure, where forces that are powers of it bend most."""
INWARD = 1e-9
"""By this part of a piece its ends are moved inwards where the model names kinks: at one the force may jump."""
PROBES = 512
"""So many strains decide how densely a model is sampled."""


@torch.no_grad()
def sample_pieces(model: Actuator, strain: Tensor, limit: Tensor) -> Tensor:
    """Pieces (*strain.shape, K, 6) of a model's force up to the limits: begin and end [kPa], forces and slopes there.

    Each piece is (begin, end, force and slope at the begin, force and slope at the end) [kPa, N, N/kPa].

    Args:
        strain: of any shape.
        limit: of the same shape [kPa].
    """
    degree = pressure_degree(model)
    if degree is not None and degree <= 3:
        return _pieces(model, strain, limit, 1, 1.0)
    step = max(1, strain.numel() // PROBES)
    few_strains, few_limits = strain.flatten()[::step], limit.flatten()[::step]
    for count, power in SAMPLINGS:
        pieces = _pieces(model, few_strains, few_limits, count, power)
        if step == 1 and _is_accurate(model, few_strains, pieces):
            return pieces.reshape(*strain.shape, *pieces.shape[-2:])
        if _is_accurate(model, few_strains, pieces):
            break
    return _pieces(model, strain, limit, count, power)


def _pieces(model: Actuator, strain: Tensor, limit: Tensor, count: int, power: float) -> Tensor:
    grades = torch.linspace(0, 1, count + 1, dtype=strain.dtype, device=strain.device) ** power
    edges = grades * limit.unsqueeze(-1)
    kinks = pressure_knots(model, strain).movedim(0, -1)
    if kinks.shape[-1]:
        inner = torch.minimum(kinks.clamp(min=0), limit.unsqueeze(-1))
        edges = torch.cat((edges, inner), -1).sort(-1).values
        span = edges.diff(dim=-1) * INWARD
        ends = torch.stack((edges[..., :-1] + span, edges[..., 1:] - span), -1)
        force, _, slope = force_slopes(model, strain[..., None, None].expand_as(ends).contiguous(), ends)
    else:
        at, _, rate = force_slopes(model, strain.unsqueeze(-1).expand_as(edges).contiguous(), edges)
        assert rate is not None
        force = torch.stack((at[..., :-1], at[..., 1:]), -1)
        slope = torch.stack((rate[..., :-1], rate[..., 1:]), -1)
    assert slope is not None
    columns = (edges[..., :-1], edges[..., 1:], force[..., 0], slope[..., 0], force[..., 1], slope[..., 1])
    return torch.stack(columns, -1)


def _is_accurate(model: Actuator, strain: Tensor, pieces: Tensor) -> bool:
    """Whether every piece's middle is where the model is."""
    begin, end, force, slope, force_end, slope_end = pieces.unbind(-1)
    middle = 0.5 * (force + force_end) + 0.125 * (end - begin) * (slope - slope_end)
    true = model.force(strain.unsqueeze(-1).expand_as(middle).contiguous(), 0.5 * (begin + end))
    return bool(((middle - true).abs() <= ACCURACY * true.abs().amax()).all())
