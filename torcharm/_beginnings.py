"""Where the descents of the batched pressure search begin. The batch comes last."""

import torch
from torch import Tensor

from torcharm._box import spread_points
from torcharm._descent import Searches
from torcharm._reaching import Block, Reached, joined
from torcharm.mechanics import pick

LOOKS = 20
"""Evaluations of the balance on the way to these: who takes longer is no promising start."""
POOL = 4
"""Pressures that compete, to first order at the task shape, for each start that is guided."""


def begin(block: Block, wanted: Tensor, starts: int, seed: int) -> Reached:
    """S starts for each, one lot after the other: the best of those loaded, from three on the middle of the box among
    them; the last of several is at the task shape, with the pressure that is best there to first order.

    Loaded are S that are promising to first order at the task shape, half as many spread over the box, and none at all.
    """
    own, total = block.searches, wanted.shape[-1]
    size = len(own.limits)
    like = own.limits
    guided, spread = starts, spread_points(starts // 2 + 1, size, like, seed)
    spread[1:] = (1.6 * spread[1:] - 0.3).clamp(0, 1)
    spread = torch.cat((spread, torch.zeros_like(spread[:1])))
    pool = torch.rand(guided * POOL, size, generator=torch.Generator().manual_seed(seed)).to(like)
    pool = (1.2 * pool - 0.1).clamp(0, 1)  # the bounds are where optima like to be
    expected = _expected_cost(own, wanted, pool).unflatten(0, (guided, POOL))
    lots = torch.arange(guided, device=like.device).unsqueeze(-1) * POOL
    best = pool[lots + expected.argmin(1)]  # (G, T, M)
    places = torch.cat((best, spread.unsqueeze(1).expand(-1, total, -1)))
    count = len(places)
    every = torch.arange(total, device=like.device)
    loaded = block[every.repeat(count)].reach(places.flatten(0, 1).mT.contiguous(), looks=LOOKS)
    kept = max(1, starts - 1)
    rank = loaded.cost.view(count, total).topk(kept, dim=0, largest=False).indices
    if kept > 1:
        rank[-1] = torch.where((rank == guided).any(0), rank[-1], guided)
    begun = pick(loaded, (rank * total + every).flatten())
    if starts == 1:
        return begun
    first = pool[expected.flatten(0, 1).argmin(0)].mT
    none = wanted.new_full((total,), float("inf"))
    at_shape = Reached(first, none, wanted, block.idle, wanted, torch.zeros_like(wanted), torch.zeros_like(none))
    return joined(begun, at_shape)


def _expected_cost(own: Searches, wanted: Tensor, pool: Tensor) -> Tensor:
    """(Q, T) the cost of Q pressures to first order at the task shape: twists move by `-J⁻¹R`."""
    total, columns = wanted.shape[-1], []
    step = max(1, 2000 // total)
    for part in pool.split(step):
        index = torch.arange(total, device=pool.device).repeat(len(part))
        cost, _, _ = own.model(part.mT.repeat_interleave(total, 1), wanted, index)
        columns.append(cost.view(len(part), total))
    expected = torch.cat(columns)
    return torch.where(expected.isnan(), float("inf"), expected)  # ranked last
