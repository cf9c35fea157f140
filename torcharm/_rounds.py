"""The rounds of the batched pressure search: descents that go on, and moves along the ends of branches.

The batch comes last.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from torcharm import mechanics
from torcharm._boundary import Boundary, find_boundary
from torcharm._box import box_step
from torcharm._descent import Descended, descend
from torcharm._reaching import COARSE_SHAPE, SAME_SHAPE, Block, Reached
from torcharm.mechanics import pick

DESCENT_LOOKS, ONLY_LOOKS, AGAIN_LOOKS, WALL_LOOKS = 20, 200, 12, 8
"""Evaluations of the balance in a descent; in one without further rounds; in one that goes on; along a boundary."""
GAIN, WALL_GAIN = 1e-9, 1e-4
"""Relative decrease of the cost at which they end."""
CROSSED = 3
CROSS = (3e-4, 1e-3, 4e-3, 1.6e-2, 0.06, 0.25)
FLIPS = (0.01, 0.03, 0.1, 0.25, 0.6, 1.6)
"""Steps across a boundary, from a hundredth of the box to all of it and more."""
PARTS, OFFSETS = (1.0, 0.3), (0.0, 0.03, 0.1, 0.3)
"""Of a step along a boundary: parts that are tried, and moves away from it, in lengths of the step."""
DAMPINGS = (1.0, 10.0, 100.0)
"""Of the steps regardless of it."""
AHEAD = ((1.0, 0.0), (1.0, 0.1), (3.0, 0.0), (3.0, 0.1))
"""Once more as far as the last time: how many times, and how far away from the boundary besides."""
SHORTENED = (0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1, 0.05)
"""Parts of a descent that was not confirmed."""
LEAST_STEP = 1e-3
SLIDES, MARGINS = (1.0, 0.5, 0.2), (1e-4, 1e-3, 4e-3, 1.6e-2)


@dataclass
class State:
    """Where T searches are.

    Attributes:
        best: of what is confirmed.
        before: (M, T) the place before it.
        converged: (T,) whether it is the end of a descent.
        active: (T,) whether there is more to do.
        held: (T,) whether the descent from there leads over a boundary.
        start_cost: (S, T) what each start came to.
    """

    best: Reached
    before: Tensor
    converged: Tensor
    active: Tensor
    held: Tensor
    start_cost: Tensor

    @staticmethod
    def of(begun: Reached, end: Descended, found: Reached, total: int) -> "State":
        """After the first descents: their ends, or where they began."""
        both = torch.cat((found.cost, begun.cost))
        rank = both.view(-1, total).argmin(0)
        index = rank * total + torch.arange(total, device=rank.device)
        at_end = index < len(found.cost)
        index_end = index.where(at_end, 0)
        best = Reached(*(torch.cat(pair, -1)[..., index] for pair in zip(found, begun, strict=True)))
        same = _same(found, end.unknowns)
        converged = at_end & (same & end.ended)[index_end]
        warm = torch.where(same, float("inf"), end.cost).view(-1, total).amin(0)
        held = _worth(warm, best.cost)
        start = torch.minimum(found.cost, begun.cost).view(-1, total)
        return State(best, best.place.clone(), converged & ~held, ~converged | held, held, start)


def _same(found: Reached, unknowns: Tensor) -> Tensor:
    """(B,) whether continuation reaches these equilibria (C, N, B)."""
    near = 10 * SAME_SHAPE if unknowns.dtype == torch.float64 else COARSE_SHAPE
    return found.cost.isfinite() & ((found.unknowns - unknowns).abs().amax((0, 1)) < near)


def _worth(cost: Tensor, best: Tensor) -> Tensor:
    """(B,) whether a cost is worth going for."""
    return cost < best * (1 - 1e-4) - 1e-12


def first_others(state: State, end: Descended, found: Reached) -> tuple[Tensor, Reached]:
    """What the best descents that were not confirmed came to by continuation, for each search that is held; rows and
    these."""
    total, rows = len(state.held), state.held.nonzero().squeeze(-1)
    warm = torch.where(_same(found, end.unknowns), float("inf"), end.cost).view(-1, total)[:, rows]
    rank = warm.topk(min(CROSSED, len(warm)), dim=0, largest=False)
    worth = _worth(rank.values, state.best.cost[rows])
    index = (rank.indices * total + rows)[worth]
    return rows.expand_as(worth)[worth], found.at(index)


def _normal(block: Block, at: Reached) -> Tensor:
    """(M, B) the direction of pressures in which the arm gives way more, where it gives way most.

    Next to a bifurcation all changes are along one vector, with the tangent; whoever goes along it stays on the branch.
    """
    own = block.searches
    look = mechanics.march(own.arms, at.quick, at.place * own.limits, at.share, each_pressure=own.limits, poses=False)
    rush = at.rush.clone()
    rush[:-1] /= own.scale.length**2
    normal = (look.change[:, :, 1:] * rush.unsqueeze(2)).sum((0, 1))
    normal = torch.where(normal.isfinite().all(0), normal, 0.0)  # no direction is known: none is taken
    return normal / normal.norm(dim=0).clamp(min=1e-300)


def _take(state: State, rows: Tensor, found: Reached) -> None:
    """The best of what was found for some of the searches (B,), where it is better."""
    total = len(state.held)
    order = found.cost.argsort(stable=True)
    first = torch.full((total,), -1, dtype=torch.long, device=rows.device)
    first[rows[order].flip(0)] = order.flip(0)
    have = (first >= 0).nonzero().squeeze(-1)
    taken = first[have]
    better = found.cost[taken] < state.best.cost[have]
    have, taken = have[better], taken[better]
    state.best.put(have, found.at(taken))


def work(block: Block, state: State, others: tuple[Tensor, Reached]) -> tuple[Tensor, Reached]:
    """Descend further from the best; and where that leads over a boundary, go along it, and to it from both sides.

    Args:
        block: of T searches.
        state: of them.
        others: some of them (O,), and what continuation reached on the other side.

    Returns:
        The same for the next round.
    """
    rows = state.active.nonzero().squeeze(-1)
    at = state.held[rows].nonzero().squeeze(-1)
    held, count = rows[at], len(rows)
    keep = state.held[others[0]].nonzero().squeeze(-1)
    theirs, other = others[0][keep], others[1].at(keep)
    sides = torch.cat((held, theirs))
    near = Reached(*(torch.cat(pair, -1) for pair in zip(state.best.at(held), other, strict=True)))
    rough = _normal(block[sides], near)
    found_edge = find_boundary(
        block[sides].searches, near.place, near.quick, near.share, _measure(block[sides], near), _inner(rough, near.place)
    )
    normals = torch.where(found_edge.found, found_edge.normal, rough)
    normals = torch.where((normals * rough).sum(0) < 0, -normals, normals)
    edge = Boundary(*(value[..., : len(held)] for value in found_edge))
    far = Boundary(*(value[..., len(held) :] for value in found_edge))
    normal = normals[:, : len(held)]

    both = torch.cat((rows, held))
    wall = torch.cat((normal.new_zeros(len(normal), count), normal), 1)
    start = state.best.at(both)
    end = descend(block[both].searches, start.place, start.unknowns, gain=GAIN, looks=AGAIN_LOOKS, wall=wall)
    along, free = end.place[:, count:], end.place[:, :count]
    some, best = block[held], state.best.at(held)
    trials = torch.cat(
        (
            _trials(some, best, normal, pick(state.before, held), free[:, at], along),
            _slides(some, best, edge, normal, along),
        ),
        1,
    )
    crossing = _crossings(other, far, normals[:, len(held) :])
    many = torch.cat((rows, held.repeat(trials.shape[1]), theirs.repeat(crossing.shape[1])))
    places = torch.cat((free, trials.flatten(1), crossing.flatten(1)), 1)
    state.before[:, rows] = state.best.place[:, rows]
    found = block[many].reach(places, pick(state.best.rest, many))
    _take(state, many, found)
    LOG.append((held, found.cost[count:count+trials[0].numel()].view(-1, len(held)), edge.found, (edge.place - best.place).norm(dim=0), best.cost, state.best.cost[held], theirs, far.found, found.cost[count+trials[0].numel():].view(-1,len(theirs))))
    own_end = found.at(torch.arange(count, device=rows.device))
    same = _same(own_end, end.unknowns[:, :, :count])
    done = same & end.ended[:count] & (own_end.cost <= state.best.cost[rows])
    state.converged[rows] = done
    state.held[rows] = ~same & _worth(end.cost[:count], state.best.cost[rows])
    state.active[rows] = ~done
    return _others(block, state, many, found)


def _others(block: Block, state: State, rows: Tensor, found: Reached) -> tuple[Tensor, Reached]:
    """For each search that is held, the nearest to its best place of what went to the other side."""
    best = state.best.at(rows)
    across = (_measure(block[rows], best) * found.rush).sum((0, 1)) < 0
    distance = (found.place - best.place).norm(dim=0)
    order = distance.where(across, float("inf")).argsort(stable=True, descending=True)
    first = torch.full((len(state.held),), -1, dtype=torch.long, device=rows.device)
    first[rows[order]] = order
    have = (state.held & (first >= 0)).nonzero().squeeze(-1)
    have = have[across[first[have]]]
    return have, found.at(first[have])


def _crossings(other: Reached, edge: Boundary, normal: Tensor) -> Tensor:
    """(M, Q, O) across the boundary from what is on its other side."""
    base = torch.where(edge.found, edge.place, other.place).clamp(0, 1)
    way = _inner(-normal, base)
    steps = torch.where(edge.found, base.new_tensor(CROSS).unsqueeze(-1), base.new_tensor(FLIPS).unsqueeze(-1))
    return torch.where(way.isfinite(), base, base).unsqueeze(1).add(way.unsqueeze(1) * steps).clamp(0, 1)


LOG = []


def _measure(block: Block, at: Reached) -> Tensor:
    """(C, N, B) what measures how far the arm has given way."""
    rush = at.rush.clone()
    rush[:-1] /= block.searches.scale.length**2
    rush = torch.where(rush.isfinite(), rush, 0.0)
    return rush / rush.square().sum((0, 1)).sqrt().clamp(min=1e-300)


def _inner(normal: Tensor, place: Tensor) -> Tensor:
    """(M, B) away from the boundary, along bounds of the box."""
    inner = normal * (((place > 0) | (normal > 0)) & ((place < 1) | (normal < 0)))
    return inner / inner.norm(dim=0).clamp(min=1e-9)


def _slides(block: Block, best: Reached, edge: Boundary, normal: Tensor, along: Tensor) -> Tensor:
    """(M, Q, H) places on the boundary and a little away from it."""
    count = normal.shape[-1]
    targets = torch.cat([torch.lerp(best.place, along, part) for part in SLIDES], 1)
    many = torch.arange(count, device=normal.device).repeat(len(SLIDES))
    way = _inner(pick(normal, many), targets)
    move = targets - pick(edge.place, many)
    miss = (pick(normal, many) * move).sum(0) / (pick(normal, many) * way).sum(0).clamp(min=1e-3)
    move = move - way * miss
    guess = pick(edge.unknowns, many) + (pick(edge.shift, many) * move).sum(2)
    found = find_boundary(
        block[many].searches, pick(edge.place, many) + move, guess, pick(edge.share, many), pick(_measure(block, best), many), way
    )
    inner = torch.where((found.normal * pick(normal, many)).sum(0) < 0, -found.normal, found.normal)
    inner = _inner(inner, found.place.clamp(0, 1))
    ok = found.found & pick(edge.found, many)
    base = torch.where(ok, found.place, targets).clamp(0, 1)
    inner = torch.where(ok, inner, way)
    first = torch.where(edge.found, edge.place, best.place).clamp(0, 1)
    base = torch.cat((first, base), 1)
    inner = torch.cat((_inner(normal, first), inner), 1)
    tried = base.unsqueeze(1) + inner.unsqueeze(1) * base.new_tensor(MARGINS).view(1, -1, 1)
    tried = tried.clamp(0, 1).flatten(1).unflatten(1, (-1, count))
    return torch.where(tried.isfinite(), tried, best.place.unsqueeze(1))


def _trials(block: Block, best: Reached, normal: Tensor, before: Tensor, free: Tensor, end: Tensor) -> Tensor:
    """(M, Q, H) pressures to try from the best confirmed of H searches, where the descent to `free` (M, H) leads
    over a boundary: along the boundary and away from it, and towards it in steps of any length."""
    own, place = block.searches, best.place
    along = end - place
    # away from the boundary, along bounds of the box
    inner = normal * (((place > 0) | (normal > 0)) & ((place < 1) | (normal < 0)))
    inner = inner / inner.norm(dim=0).clamp(min=1e-9)
    length = along.norm(dim=0) + LEAST_STEP
    trials = [place + part * (along + offset * length * inner) for part in PARTS for offset in OFFSETS]
    look = mechanics.march(own.arms, best.unknowns, place * own.limits, each_pressure=own.limits)
    _, gradient, matrix = own.goal.model(look)
    for damping in DAMPINGS:
        amount = torch.full_like(length, damping)
        trials.append(place + box_step(matrix, gradient, place, amount))
    trials += [torch.lerp(place, free, part) for part in SHORTENED]
    ahead = place - before
    for factor, offset in AHEAD:
        trials.append(place + factor * (ahead + offset * ahead.norm(dim=0) * inner))
    tried = torch.stack(trials, 1).clamp(0, 1)
    return torch.where(tried.isfinite(), tried, place.unsqueeze(1))  # a step that is no number is none
