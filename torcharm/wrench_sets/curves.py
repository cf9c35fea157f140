"""Pressure curves of any force model as cubic pieces, for the engine.

A model's force and its slope by pressure are sampled at a few pressures, with the model's own kinks among them; between
two there is a cubic. Where a cubic is off, more samples are taken, until all are good to `ACCURACY`.

Of many curves of one model only those at some strains are sampled, closely enough for the engine to find those between
as well by interpolation (`engine.curves.write_sampled`). Of few, each is sampled.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torcharm.actuators import Actuator, force_slopes, pressure_degree, pressure_knots
from torcharm.actuators.protocol import PROBED_SHARES
from torcharm.engine.curves import Samples

ACCURACY = 1e-7
"""By how much of a model's largest force its cubic pieces may be off: far below what any model is good to."""
ROUNDING = 64
"""So many roundings of the dtype they may be off in any case."""
PLACES, FIRST_PLACES = 7, 63
"""At how many places on a piece a cubic is compared with the force; and over all pieces at least, of which there is one
to begin with."""
PARTS = 4
"""A piece that is off is cut into so many at most, by how much it is off."""
REFINEMENTS = 24
"""So often: powers of pressure as low as 1.01 need 6, a square root as many."""
MOST_PIECES = 256
"""Pieces at most: a curve with kinks that its model does not name would take any number."""
INWARD = 1e-9
"""By this part of a piece its ends are moved inwards where the model names kinks: at one the force may jump."""
PROBES = 512
"""So many strains decide how densely a model is sampled."""
LEAST_CURVES, CURVES_PER_STRAIN = 256, 4
"""Of fewer curves, or fewer to each strain of a grid, each is sampled: which is quicker."""
GRADED_AT, FIRST_STRAINS, MOST_STRAINS = 33, 33, 4096
"""Evenly spaced strains that, with as many of the curves', decide how densely a grid is sampled by pressure; those that
it begins with; and most of them."""
NARROWEST = 1e-9
"""By this part of all strains two of a grid are next to each other at least: where the force jumps."""
CAUTION = 8.0
"""So much better than allowed curves must be told half-way between two strains: a kink nearby does more elsewhere."""
LEAST_RANGE = 1e-3
"""Strains of a grid are so far apart in all, at least."""
LIMITS = 1e3
"""By this factor limits may differ: what is small beside the force at the highest may be all there is at the lowest."""

Grades = list[list[float]]
"""For each stretch between kinks, the places from 0 to 1 at which its pieces begin and end."""


class Curves(NamedTuple):
    """Sampled curves of one model.

    Attributes:
        pieces: (R, K, 6) begin and end [kPa], forces [N] and slopes [N/kPa] there, of each piece: of each curve that
            was asked for, or at strains of a grid.
        grid: (R,) strains between which curves are interpolated, four at least; None if each curve has its own pieces.
        rest: (n,) with a grid the force [N] of each curve at no pressure, from which the interpolated one goes on: what
            is passive is exact.
    """

    pieces: Tensor
    grid: Tensor | None = None
    rest: Tensor | None = None


@torch.no_grad()
def sample_curves(model: Actuator, strain: Tensor, limit: Tensor) -> Curves:
    """Pieces of a model's force by pressure up to limits.

    Args:
        strain: (n,) of the curves.
        limit: (n,) [kPa].
    """
    used = limit[limit > 0]
    if len(strain) >= LEAST_CURVES and len(used) and used.max() <= LIMITS * used.min():
        found = _on_grid(model, strain, used.min(), used.max())
        if found is not None and len(found.pieces) * CURVES_PER_STRAIN <= len(strain):
            return found._replace(rest=model.force(strain, torch.zeros_like(strain)).expand_as(strain))
    few = slice(None, None, max(1, len(strain) // PROBES))
    allowed = _allowed(model, strain[few], limit[few])
    return Curves(_pieces(model, strain, limit, _grades(model, strain[few], limit[few], allowed)))


class _Allowed(NamedTuple):
    """By how much curves may be off: this ratio of the largest force at a strain, or of a usual one if that is less."""

    ratio: float
    usual: Tensor

    def of(self, largest: Tensor) -> Tensor:
        """What is allowed where forces are so large at most."""
        return self.ratio * torch.maximum(largest, self.usual)


def _allowed(model: Actuator, strain: Tensor, limit: Tensor, part: float = 1.0) -> _Allowed:
    """What is allowed of a model's curves.

    Args:
        strain, limit: (n,) of some of the curves, by whose forces it is told what is next to none.
        part: of the highest limit, at which curves must be as good.
    """
    pressure = torch.stack([share * limit for share in PROBED_SHARES])
    force = model.force(strain.expand_as(pressure).contiguous(), pressure).expand_as(pressure)
    usual = torch.where(force.isfinite(), force.abs(), 0.0).amax(0).median()
    return _Allowed(max(part * ACCURACY, ROUNDING * torch.finfo(strain.dtype).eps), usual)


def _on_grid(model: Actuator, strain: Tensor, least: Tensor, most: Tensor) -> Curves | None:
    """Curves up to the highest limit, at strains between which all others follow; None if there are not enough.

    Where a cubic between four strains does not tell the curve in the middle of two, that one is added. Where the force
    jumps, so are the strains asked for between the narrowest two: such as none at all, where a law may begin.
    """
    low = strain.min()
    high = torch.maximum(strain.max(), low + LEAST_RANGE * (1 + low.abs()))
    if not bool((high - low).isfinite()):
        return None
    some = strain[:: max(1, len(strain) // GRADED_AT)]
    allowed = _allowed(model, some, most.expand_as(some), float(least / most))
    some = torch.cat((some, torch.lerp(low, high, torch.linspace(0, 1, GRADED_AT).to(low))))
    grades = _grades(model, some, most.expand_as(some), allowed)
    grid = torch.lerp(low, high, torch.linspace(0, 1, FIRST_STRAINS).to(low))
    pieces = _pieces(model, grid, most.expand(len(grid)), grades)
    doubtful, torn = torch.arange(len(grid) - 1, device=grid.device), []
    narrowest = NARROWEST * (high - low) + 8 * torch.finfo(low.dtype).eps * torch.maximum(low.abs(), high.abs())
    while len(doubtful):
        if len(grid) > MOST_STRAINS:
            return None
        middle = torch.lerp(grid[doubtful], grid[doubtful + 1], 0.5)
        true = _pieces(model, middle, most.expand(len(middle)), grades)
        wrong = _disagree(_interpolated(grid, pieces, doubtful, middle), true, allowed)
        wide = grid[doubtful + 1] - grid[doubtful] > narrowest
        for k in doubtful[wrong & ~wide].tolist():
            torn.append(strain[(strain > grid[k]) & (strain < grid[k + 1])].unique())
        wrong &= wide
        added = torch.cat((torch.zeros_like(grid, dtype=torch.bool), torch.ones_like(middle[wrong], dtype=torch.bool)))
        grid, order = torch.cat((grid, middle[wrong])).sort()
        pieces, added = torch.cat((pieces, true[wrong]))[order], added[order]
        doubtful = (added[1:] | added[:-1]).nonzero().squeeze(-1)
    more = torch.cat((*torn, grid[:0])).unique()
    grid, order = torch.cat((grid, more)).sort()
    return Curves(torch.cat((pieces, _pieces(model, more, most.expand(len(more)), grades)))[order], grid)


def _interpolated(grid: Tensor, pieces: Tensor, interval: Tensor, strain: Tensor) -> Tensor:
    """Pieces at strains within intervals of a grid, by cubics through four neighbours, as in the engine."""
    four = (interval - 1).clamp(0, len(grid) - 4).unsqueeze(-1) + torch.arange(4, device=grid.device)
    weights = torch.ones_like(grid[four])
    for j in range(4):
        others = torch.arange(4, device=grid.device) != j
        factors = (strain.unsqueeze(-1) - grid[four[:, j : j + 1]]) / (grid[four] - grid[four[:, j : j + 1]])
        weights[:, others] *= factors[:, others]
    return torch.einsum("nj, njkc -> nkc", weights, pieces[four])


def _disagree(guess: Tensor, true: Tensor, allowed: _Allowed) -> Tensor:
    """(n,) whether pieces are further from the true ones than allowed."""
    off = (guess - true).abs()
    begin, end, force, slope, force_end, slope_end = true.unbind(-1)
    steep, span = torch.maximum(slope.abs(), slope_end.abs()), end - begin
    itself = torch.ones_like(span)
    by = torch.stack((steep, steep, itself, span, itself, span), -1)
    largest = torch.maximum(force.abs(), force_end.abs()).amax(1)
    close = (off * by).amax((1, 2)) <= allowed.of(largest) / CAUTION
    neither = ~(true.isfinite().flatten(1).all(1) | guess.isfinite().flatten(1).all(1))
    return ~(close | neither)


def as_samples(curves: Sequence[Curves | None]) -> Samples:
    """The sampled curves of actuators, for the engine; None for those whose force the engine evaluates itself."""
    known = [one for one in curves if one is not None]
    if not known:
        none = np.zeros(len(curves), np.int64)
        return Samples(np.zeros((0, 0, 6)), np.zeros(0), none, none, np.zeros(0), none)
    distinct = {id(one.pieces): one for one in known}  # actuators of one model share a grid
    most = max(one.pieces.shape[-2] for one in known)
    grids = [one.pieces.new_zeros(len(one.pieces)) if one.grid is None else one.grid for one in distinct.values()]
    begin = dict(zip(distinct, np.cumsum([0, *map(len, grids)]), strict=False))
    resting = [one.pieces.new_zeros(0) if one.rest is None else one.rest for one in known]
    rests = np.array([0 if one is None or one.rest is None else len(one.rest) for one in curves], np.int64)
    return Samples(
        torch.cat([_padded(one.pieces, most) for one in distinct.values()]).cpu().double().numpy(),
        torch.cat(grids).cpu().double().numpy(),
        np.array([0 if one is None else begin[id(one.pieces)] for one in curves], np.int64),
        np.array([0 if one is None or one.grid is None else len(one.grid) for one in curves], np.int64),
        torch.cat(resting).cpu().double().numpy(),
        np.cumsum(rests) - rests,
    )


def _padded(pieces: Tensor, count: int) -> Tensor:
    """As many pieces as asked for; those added have no length, at the end of the last."""
    missing = count - pieces.shape[-2]
    if not missing:
        return pieces
    end, force, slope = pieces[..., -1:, (1, 4, 5)].unbind(-1)
    more = torch.stack((end, end, force, slope, force, slope), -1)
    return torch.cat((pieces, more.expand(*more.shape[:-2], missing, 6)), -2)


def _grades(model: Actuator, strain: Tensor, limit: Tensor, allowed: _Allowed) -> Grades:
    """Where pieces begin and end that are good enough at some strains."""
    stretches = len(pressure_knots(model, strain[:1])) + 1
    degree = pressure_degree(model)
    if degree is not None and degree <= 3:
        return [[0.0, 1.0]] * stretches
    grades: Grades = [[0.0, 1.0]] * stretches
    for _ in range(REFINEMENTS):
        finer = _refined(grades, _excess(model, strain, _pieces(model, strain, limit, grades), allowed).tolist())
        if finer == grades:
            break
        grades = finer
    return grades


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
        span = edges.diff(dim=-1) * max(INWARD, 16 * torch.finfo(edges.dtype).eps)
        ends = torch.stack((edges[..., :-1] + span, edges[..., 1:] - span), -1)
        force, _, slope = force_slopes(model, strain[..., None, None].expand_as(ends).contiguous(), ends)
    else:
        at, _, rate = force_slopes(model, strain.unsqueeze(-1).expand_as(edges).contiguous(), edges)
        force = torch.stack((at[..., :-1], at[..., 1:]), -1)
        slope = torch.stack((rate[..., :-1], rate[..., 1:]), -1)
    chord = (force.diff(dim=-1) / edges.diff(dim=-1).unsqueeze(-1)).expand_as(slope)
    slope = torch.where(
        slope.isfinite(), slope, torch.where(chord.isfinite(), chord, 0.0)
    )  # as of a root at no pressure
    columns = (edges[..., :-1], edges[..., 1:], force[..., 0], slope[..., 0], force[..., 1], slope[..., 1])
    return torch.stack(columns, -1)


def _excess(model: Actuator, strain: Tensor, pieces: Tensor, allowed: _Allowed) -> Tensor:
    """(K,) by how much more than allowed the pieces are off, at most."""
    begin, end, force, slope, force_end, slope_end = (column.unsqueeze(-1) for column in pieces.unbind(-1))
    places = max(PLACES, FIRST_PLACES // pieces.shape[-2])
    t = torch.arange(1, places + 1, dtype=strain.dtype, device=strain.device) / (places + 1)
    s, span = 1 - t, end - begin
    ends = s * s * (1 + 2 * t) * force + t * t * (1 + 2 * s) * force_end
    cubic = ends + s * t * span * (s * slope - t * slope_end)
    true = model.force(strain[:, None, None].expand_as(cubic).contiguous(), begin + t * span).expand_as(cubic)
    off = (cubic - true).abs().amax(-1)
    ratio = torch.where(off > 0, off / allowed.of(true.abs().flatten(1).amax(1)).unsqueeze(-1), 0.0)
    return torch.where(ratio.isfinite(), ratio, 0.0).amax(0)


def _refined(grades: Grades, excess: list[float]) -> Grades:
    """With those pieces cut that are off, the worst first: errors of cubics fall with length to the fourth."""
    left = MOST_PIECES - len(excess)
    counts = [1] * len(excess)
    for k in sorted(range(len(excess)), key=lambda k: -excess[k]):
        if excess[k] > 1:
            counts[k] += min(PARTS - 1, max(1, math.ceil(excess[k] ** 0.25) - 1), left)
            left -= counts[k] - 1
    finer, k = [], 0
    for row in grades:
        places = row[:1]
        for begin, end in pairwise(row):
            places += [begin + (end - begin) * i / counts[k] for i in range(1, counts[k])] + [end]
            k += 1
        finer.append(places)
    return finer
