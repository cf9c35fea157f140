"""The rounds of the batched pressure search: descents that go on, and moves along the boundary of what is reached.

Where a descent leads over the boundary, the best pressure is on it, or near. If the boundary is known, a descent along
its tangent, set back on it, is the next place; a little away from it continuation can be followed. If it is not, the
way to where the descent led is divided, so that it is near in the next round. All trials of a round are one batch.
The batch comes last.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from torcharm._boundary import Boundary, find_boundary
from torcharm._box import box_step
from torcharm._descent import Descended, descend
from torcharm._reaching import COARSE_SHAPE, SAME_SHAPE, Block, Reached, joined, lowest
from torcharm.mechanics import pick, put

GAIN, AGAIN_LOOKS = 1e-9, 12
"""Of a descent: relative decrease of the cost at which it ends; evaluations of the balance, where it goes on."""
CROSSED = 3
"""Descents of a search that were not confirmed, from whose ends the boundary is crossed at first."""
SLIDES, CROSSING = ((0.0, (1e-4, 1e-3)), (1.0, (1e-4, 1e-3, 4e-3, 1.6e-2)), (0.5, (1e-4, 1e-3, 4e-3))), (1e-3, 4e-3)
"""Parts of a step along a boundary, and the distances from it that are tried there, in lengths of the box; the same
where a descent that was not confirmed crosses it."""
SHORTENED, UNTIL = (0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1), (0.9, 0.7, 0.4)
"""Parts of such a descent, where no boundary is known; and of it until there."""
ASIDE = (0.03, 0.1)
"""Steps along a boundary that is known roughly: moves away from it, in lengths of the step."""
LEAST_STEP = 1e-3
"""Their length, at least, in lengths of the box."""
DAMPING = 1.0
"""Of the step regardless of it."""
CROSS, FLIPS = (3e-4, 1e-3, 4e-3, 1.6e-2), (0.01, 0.03, 0.1, 0.3)
"""Steps across a boundary, from it, and from a place somewhere on the other side, in lengths of the box."""
NEWTON_STEPS, AGAIN_STEPS = 8, 4
"""To the boundary; and from there to another place on it."""
BESIDE, NEXT = 12, 3e-4
"""Places beside the end of a descent that could not be followed, and how near, in lengths of the box."""


class Lost(NamedTuple):
    """(L,) rows of searches, places (M, L) to which continuation could not be followed, and whether a descent ended
    beside them (L,)."""

    rows: Tensor
    place: Tensor
    ended: Tensor


@dataclass
class State:
    """Where T searches are.

    Attributes:
        best: of what is confirmed.
        converged: (T,) whether it is the end of a descent.
        active: (T,) whether there is more to do.
        held: (T,) whether the descent from there leads over a boundary.
        start_cost: (S, T) what each start came to.
        lost: what was tried last.
    """

    best: Reached
    converged: Tensor
    active: Tensor
    held: Tensor
    start_cost: Tensor
    lost: Lost

    @staticmethod
    def of(begun: Reached, end: Descended, found: Reached, total: int) -> "State":
        """After the first descents: their ends, or where they began."""
        both = torch.cat((found.cost, begun.cost))
        rank = both.view(-1, total).argmin(0)
        index = rank * total + torch.arange(total, device=rank.device)
        at_end = index < len(found.cost)
        index_end = index.where(at_end, 0)
        best = pick(joined(found, begun), index)
        same = _same(found, end.unknowns)
        converged = at_end & (same & end.ended)[index_end]
        warm = torch.where(same, float("inf"), end.cost).view(-1, total).amin(0)
        held = _worth(warm, best.cost)
        start = torch.minimum(found.cost, begun.cost).view(-1, total)
        return State(
            best, converged & ~held, ~converged | held, held, start, Lost(rank[:0], best.place[:, :0], held[:0])
        )


@dataclass(frozen=True)
class Others:
    """What continuation reached on the other side of a boundary: (O,) rows of the searches it is of, and O results."""

    rows: Tensor
    reached: Reached

    @staticmethod
    def of(state: State, end: Descended, found: Reached) -> "Others":
        """Where the best descents ended that were not confirmed, for each search that is held."""
        total, rows = len(state.held), state.held.nonzero().squeeze(-1)
        warm = torch.where(_same(found, end.unknowns), float("inf"), end.cost).view(-1, total)[:, rows]
        rank = warm.topk(min(CROSSED, len(warm)), dim=0, largest=False)
        worth = _worth(rank.values, state.best.cost[rows])
        return Others(rows.expand_as(worth)[worth], pick(found, (rank.indices * total + rows)[worth]))

    @staticmethod
    def nearest(block: Block, state: State, rows: Tensor, found: Reached) -> "Others":
        """Of what was found, the nearest to the best for each search that is held."""
        best = pick(state.best, rows)
        across = (_measure(block[rows], best) * found.rush).sum((0, 1)) < 0
        distance = (found.place - best.place).norm(dim=0)
        have, taken = lowest(rows, distance.where(across & state.held[rows], float("inf")), len(state.held))
        return Others(have, pick(found, taken))


def _same(found: Reached, unknowns: Tensor) -> Tensor:
    """(B,) whether continuation reaches these equilibria (C, N, B)."""
    near = 10 * SAME_SHAPE if unknowns.dtype == torch.float64 else COARSE_SHAPE
    return found.cost.isfinite() & ((found.unknowns - unknowns).abs().amax((0, 1)) < near)


def _worth(cost: Tensor, best: Tensor) -> Tensor:
    """(B,) whether a cost is worth going for."""
    return cost < best * (1 - 1e-4) - 1e-12


def work(block: Block, state: State, others: Others, seed: int) -> Others:
    """One round: descend further from the best; and where that leads over a boundary, go along it, or look for it
    between both sides. Changes the state, and returns what is on the other side for the next round."""
    rows = state.active.nonzero().squeeze(-1)
    at = state.held[rows].nonzero().squeeze(-1)
    held, count = rows[at], len(rows)
    keep = state.held[others.rows].nonzero().squeeze(-1)
    theirs, other = others.rows[keep], pick(others.reached, keep)
    best = pick(state.best, held)
    edges, normals = _edges(block[torch.cat((held, theirs))], joined(best, other))
    edge, normal = pick(edges, torch.arange(len(held), device=rows.device)), normals[:, : len(held)]

    both = torch.cat((rows, held))
    wall = torch.cat((normal.new_zeros(len(normal), count), normal), 1)
    start = pick(state.best, both)
    searches = replace(block[both].searches, wall=wall)
    end = descend(searches, start.place, start.unknowns, gain=GAIN, looks=AGAIN_LOOKS)
    along, free = end.place[:, count:], end.place[:, at]
    known = edge.found.nonzero().squeeze(-1)
    clear, sharp = pick(best, known), pick(edge, known)
    unknown = (~edge.found).nonzero().squeeze(-1)
    part = pick(best, unknown)
    lost = (~edge.found)[torch.searchsorted(held, theirs)].nonzero().squeeze(-1)
    groups = (
        (rows, end.place[:, :count].unsqueeze(1)),
        (held, torch.stack((along, best.place.round()), 1)),
        (
            held[known],
            _slides(block[held[known]], clear, sharp, along[:, known], free[:, known]),
        ),
        (held[known], _until(clear.place, sharp, free[:, known], UNTIL)),
        (held[unknown], _shortened(part.place, free[:, unknown], SHORTENED)),
        (held[unknown], _regardless(block[held[unknown]], part, normal[:, unknown], along[:, unknown])),
        (theirs[lost], _crossings(pick(other, lost), pick(edges, len(held) + lost), normals[:, len(held) + lost])),
    )
    many = torch.cat([own.repeat(places.shape[1]) for own, places in groups])
    found = block[many].reach(torch.cat([places.flatten(1) for _, places in groups], 1), pick(state.best.rest, many))
    _take(state, many, found)
    own_end = pick(found, torch.arange(count, device=rows.device))
    same = _same(own_end, end.unknowns[:, :, :count])
    done = same & end.ended[:count] & (own_end.cost <= state.best.cost[rows])
    state.converged[rows] = done
    state.held[rows] = ~same
    state.active[rows] = ~done
    gone = found.cost.isinf()
    state.lost = _lost(many, found.place, gone, rows, end.place[:, :count], gone[:count] & end.ended[:count], seed)
    return Others.nearest(block, state, many, found)


def _take(state: State, rows: Tensor, found: Reached) -> None:
    """The best of what was found for some of the searches (B,), where it is better."""
    have, taken = lowest(rows, found.cost, len(state.held))
    better = found.cost[taken] < state.best.cost[have]
    have, taken = have[better], taken[better]
    put(state.best, have, pick(found, taken))


def _lost(rows: Tensor, place: Tensor, gone: Tensor, searches: Tensor, end: Tensor, ended: Tensor, seed: int) -> Lost:
    """Trials that are gone; and places beside the ends of descents that are, so near that the cost is the same, along
    bounds of the box."""
    index, at = gone.nonzero().squeeze(-1), ended.nonzero().squeeze(-1)
    end = end[:, at].unsqueeze(1)
    drawn = torch.randn(len(end), BESIDE, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    way = drawn.to(end).unsqueeze(-1) * ((end > 0) & (end < 1))
    beside = (end + NEXT * way / way.norm(dim=0).clamp(min=1e-9)).clamp(0, 1).flatten(1)
    return Lost(
        torch.cat((rows[index], searches[at].repeat(BESIDE))),
        torch.cat((place[:, index], beside), 1),
        torch.cat((torch.zeros_like(index, dtype=torch.bool), torch.ones_like(beside[0], dtype=torch.bool))),
    )


def _edges(block: Block, near: Reached) -> tuple[Boundary, Tensor]:
    """The boundary next to what is on one side of it, and its normals (M, B) into that side; roughly, where it was
    not found."""
    measure = _measure(block, near)
    rough = _normal(block, near)
    way = _inner(rough, near.place)
    edge = find_boundary(block.searches, near.place, near.quick, near.share, measure, way, NEWTON_STEPS)
    side = (edge.normal * rough).sum(0)
    return edge, torch.where(edge.found, torch.where(side < 0, -edge.normal, edge.normal), rough)


def _normal(block: Block, at: Reached) -> Tensor:
    """(M, B) the direction of pressures in which the arm gives way more, where it gives way most.

    Next to a bifurcation all changes are along one vector, with the tangent; whoever goes along it stays on the branch.
    """
    normal = block.searches.gains(at.place, at.quick, at.share, _measure(block, at))
    normal = torch.where(normal.isfinite().all(0), normal, 0.0)  # no direction is known: none is taken
    return normal / normal.norm(dim=0).clamp(min=torch.finfo(normal.dtype).tiny)


def _measure(block: Block, at: Reached) -> Tensor:
    """(C, N, B) what changes of the unknowns are multiplied by, to tell how far the arm gives way."""
    rush = torch.where(at.rush.isfinite(), at.rush, 0.0)
    rush[:-1] /= pick(block.searches.setting.scale.length, block.searches.rows) ** 2
    return rush / rush.square().sum((0, 1)).sqrt().clamp(min=torch.finfo(rush.dtype).tiny)


def _inner(normal: Tensor, place: Tensor) -> Tensor:
    """(M, B) away from the boundary, along bounds of the box."""
    inner = normal * (((place > 0) | (normal > 0)) & ((place < 1) | (normal < 0)))
    return inner / inner.norm(dim=0).clamp(min=1e-9)


def _shortened(place: Tensor, free: Tensor, parts: tuple[float, ...]) -> Tensor:
    """(M, Q, H) on the way to where a descent led."""
    return torch.stack([torch.lerp(place, free, part) for part in parts], 1)


def _until(place: Tensor, edge: Boundary, free: Tensor, parts: tuple[float, ...]) -> Tensor:
    """(M, Q, H) on the way to `free`, as parts of it until it crosses the boundary's tangent."""
    far, near = ((edge.normal * (point - place)).sum(0) for point in (free, edge.place))
    crossing = (near / torch.where(far == 0, 1.0, far)).clamp(0, 1)
    crossing = torch.where(far * near > 0, crossing, 1.0)
    return torch.stack([torch.lerp(place, free, part * crossing) for part in parts], 1)


def _slides(block: Block, best: Reached, edge: Boundary, along: Tensor, free: Tensor) -> Tensor:
    """(M, Q, H) next to the boundary, which is known: at the nearest place, where the way to `free` (M, H) crosses it,
    and towards `along` (M, H)."""
    count = along.shape[-1]
    across = _until(best.place, edge, free, (1.0,)).squeeze(1)
    targets = torch.cat([torch.lerp(best.place, along, part) for part, _ in SLIDES] + [across], 1)
    many = torch.arange(count, device=along.device).repeat(len(SLIDES) + 1)
    start, measure = pick(edge, many), pick(_measure(block, best), many)
    sign = (_normal(block, best) * edge.normal).sum(0).sign()
    normal = pick(edge.normal * sign, many)
    way = _inner(normal, targets)
    # Along the tangent of the boundary, where nothing gives way
    move = targets - start.place
    move = move - way * ((normal * move).sum(0) / (normal * way).sum(0).clamp(min=1e-3))
    guess = start.unknowns + (start.shift * move).sum(2)
    there = find_boundary(block[many].searches, start.place + move, guess, start.share, measure, way, AGAIN_STEPS)
    place = torch.where(there.found, there.place, targets).clamp(0, 1)
    turned = there.normal * (there.normal * normal).sum(0).sign()
    way = torch.where(there.found, _inner(turned, place), way)
    margins = (*(each for _, each in SLIDES), CROSSING)
    points = zip(*(value.view(len(value), len(margins), count).unbind(1) for value in (place, way)), strict=True)
    trials = [at + margin * inner for (at, inner), each in zip(points, margins, strict=True) for margin in each]
    return torch.stack(trials, 1).clamp(0, 1)


def _regardless(block: Block, best: Reached, normal: Tensor, along: Tensor) -> Tensor:
    """(M, Q, H) where the boundary is not known: about as far as the step along it, and the step without it."""
    own, place = block.searches, best.place
    inner, step = _inner(normal, place), along - place
    length = step.norm(dim=0) + LEAST_STEP
    _, gradient, matrix = own.model(place, best.unknowns)
    free = place + box_step(matrix, gradient, place, torch.full_like(length, DAMPING))
    trials = torch.stack([along + offset * length * inner for offset in ASIDE] + [free], 1).clamp(0, 1)
    return torch.where(trials.isfinite(), trials, place.unsqueeze(1))  # a step that is no number is none


def _crossings(other: Reached, edge: Boundary, normal: Tensor) -> Tensor:
    """(M, Q, O) across the boundary from what is on its other side."""
    base = torch.where(edge.found, edge.place, other.place).clamp(0, 1)
    way = _inner(-normal, base)
    steps = torch.where(edge.found, base.new_tensor(CROSS).unsqueeze(-1), base.new_tensor(FLIPS).unsqueeze(-1))
    return (base.unsqueeze(1) + way.unsqueeze(1) * steps).clamp(0, 1)
