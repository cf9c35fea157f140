"""Pressure curves of any force model as cubic pieces, for the engine.

A model's force and its slope by pressure are sampled at a few pressures, with the model's own kinks among them; between
two there is a cubic. Where a cubic is off, more samples are taken, until all are good to `ACCURACY`.
"""

import math
from itertools import pairwise

import torch
from torch import Tensor

from torcharm.actuators import Actuator, force_slopes, pressure_degree, pressure_knots

ACCURACY = 1e-7
"""By how much of a model's largest force its cubic pieces may be off: far below what any model is good to."""
ROUNDING = 64
"""So many roundings of the dtype they may be off in any case."""
FIRST_PIECES = 4
"""Pieces between two kinks to begin with, of models that do not say that they are cubics."""
PARTS = 4
"""A piece that is off is cut into so many at most, by how much it is off."""
REFINEMENTS = 8
"""So often: powers of pressure as low as 1.01 need 6."""
MOST_PIECES = 96
"""Pieces at most: a curve with kinks that its model does not name would take any number."""
INWARD = 1e-9
"""By this part of a piece its ends are moved inwards where the model names kinks: at one the force may jump."""
PROBES = 512
"""So many strains decide how densely a model is sampled."""

Grades = list[list[float]]
"""For each stretch between kinks, the places from 0 to 1 at which its pieces begin and end."""


@torch.no_grad()
def sample_pieces(model: Actuator, strain: Tensor, limit: Tensor) -> Tensor:
    """Pieces (*strain.shape, K, 6) of a model's force up to the limits: begin and end [kPa], forces and slopes there.

    Each piece is (begin, end, force and slope at the begin, force and slope at the end) [kPa, N, N/kPa].

    Args:
        strain: of any shape.
        limit: of the same shape [kPa].
    """
    stretches = len(pressure_knots(model, strain.flatten()[:1])) + 1
    degree = pressure_degree(model)
    if degree is not None and degree <= 3:
        return _pieces(model, strain, limit, [[0.0, 1.0]] * stretches)
    grades: Grades = [[k / FIRST_PIECES for k in range(FIRST_PIECES + 1)]] * stretches
    step = max(1, strain.numel() // PROBES)
    few_strains, few_limits = strain.flatten()[::step], limit.flatten()[::step]
    for _ in range(REFINEMENTS):
        pieces = _pieces(model, few_strains, few_limits, grades)
        finer = _refined(grades, _excess(model, few_strains, pieces).tolist())
        if finer == grades or sum(map(len, finer)) - stretches > MOST_PIECES:
            break
        grades = finer
    return _pieces(model, strain, limit, grades)


def _pieces(model: Actuator, strain: Tensor, limit: Tensor, grades: Grades) -> Tensor:
    kinks = pressure_knots(model, strain).movedim(0, -1)
    limit = limit.unsqueeze(-1)
    bounds = torch.cat((torch.zeros_like(limit), torch.minimum(kinks.clamp(min=0), limit), limit), -1).sort(-1).values
    parts = []
    for j, row in enumerate(grades):
        start, end = bounds[..., j : j + 1], bounds[..., j + 1 : j + 2]
        parts.append(torch.lerp(start, end, start.new_tensor(row[:-1])))
    edges = torch.cat((*parts, limit), -1)
    if kinks.shape[-1]:
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


def _excess(model: Actuator, strain: Tensor, pieces: Tensor) -> Tensor:
    """(K,) by how much more than allowed the pieces are off, in the middle and half-way to it, at most.

    What is allowed is a part of the largest force at the strain, but for strains at which there is next to none.
    """
    begin, end, force, slope, force_end, slope_end = (column.unsqueeze(-1) for column in pieces.unbind(-1))
    t = strain.new_tensor((0.25, 0.5, 0.75))
    s, span = 1 - t, end - begin
    ends = s * s * (1 + 2 * t) * force + t * t * (1 + 2 * s) * force_end
    cubic = ends + s * t * span * (s * slope - t * slope_end)
    true = model.force(strain[:, None, None].expand_as(cubic).contiguous(), begin + t * span)
    largest = true.abs().flatten(1).amax(1)
    allowed = max(ACCURACY, ROUNDING * torch.finfo(strain.dtype).eps) * torch.maximum(largest, largest.median())
    off = (cubic - true).abs().amax(-1)
    ratio = torch.where(off > 0, off / allowed.unsqueeze(-1), 0.0)
    return torch.where(ratio.isfinite(), ratio, 0.0).amax(0)


def _refined(grades: Grades, excess: list[float]) -> Grades:
    """With the pieces cut that are off: the error of a cubic falls with the fourth power of its length."""
    finer, k = [], 0
    for row in grades:
        places = row[:1]
        for begin, end in pairwise(row):
            count = 1 if excess[k] <= 1 else min(PARTS, max(2, math.ceil(excess[k] ** 0.25)))
            places += [begin + (end - begin) * i / count for i in range(1, count)] + [end]
            k += 1
        finer.append(places)
    return finer
