"""The rounds of the batched pressure search: descents that go on, and moves along the ends of branches.

The batch comes last.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from torcharm import mechanics
from torcharm._box import box_step
from torcharm._descent import Descended, descend
from torcharm._reaching import COARSE_SHAPE, SAME_SHAPE, Block, Reached
from torcharm.mechanics import pick

DESCENT_LOOKS, ONLY_LOOKS, AGAIN_LOOKS, WALL_LOOKS = 20, 200, 12, 8
"""Evaluations of the balance in a descent; in one without further rounds; in one that goes on; along a boundary."""
GAIN, WALL_GAIN = 1e-9, 1e-4
"""Relative decrease of the cost at which they end."""
FLIPS = 10
"""Steps across a boundary, from a hundredth of the box to all of it and more."""
PARTS, OFFSETS = (1.0, 0.3), (0.0, 0.03, 0.1, 0.3)
"""Of a step along a boundary: parts that are tried, and moves away from it, in lengths of the step."""
DAMPINGS = (1.0, 10.0, 100.0)
"""Of the steps regardless of it."""
AHEAD = ((1.0, 0.0), (1.0, 0.1), (3.0, 0.0), (3.0, 0.1))
"""Once more as far as the last time: how many times, and how far away from the boundary besides."""
SHORTENED = (0.3, 0.1)
"""Parts of a descent that was not confirmed."""
LEAST_STEP = 1e-3
ARCHIVE, DIFFERENCES, LEAST_FACTOR, FROM_BEST = 8, 16, 0.3, 0.5


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
    places: Tensor
    costs: Tensor

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
        costs = both.view(-1, total)
        places = torch.cat((found.place, begun.place), 1).view(len(found.place), -1, total)
        order = costs.topk(min(ARCHIVE, len(costs)), dim=0, largest=False).indices
        costs, places = costs.gather(0, order), places.gather(1, order.expand(len(places), -1, -1))
        return State(best, best.place.clone(), converged & ~held, ~converged | held, held, start, places, costs)


def _same(found: Reached, unknowns: Tensor) -> Tensor:
    """(B,) whether continuation reaches these equilibria (C, N, B)."""
    near = 10 * SAME_SHAPE if unknowns.dtype == torch.float64 else COARSE_SHAPE
    return found.cost.isfinite() & ((found.unknowns - unknowns).abs().amax((0, 1)) < near)


def _worth(cost: Tensor, best: Tensor) -> Tensor:
    """(B,) whether a cost is worth going for."""
    return cost < best * (1 - 1e-4) - 1e-12


def crossings(block: Block, state: State, end: Descended, found: Reached) -> Tensor:
    """(M, Q, H) pressures to try where the best descent was not confirmed: across the boundary from its end, against
    the way the arm gives there."""
    total, rows = len(state.held), state.held.nonzero().squeeze(-1)
    warm = torch.where(_same(found, end.unknowns), float("inf"), end.cost).view(-1, total)
    wrong = found.at(warm.argmin(0)[rows] * total + rows)
    normal = _normal(block[rows], wrong)
    reach = torch.logspace(-2, 0.2, FLIPS).to(normal)
    return (wrong.place.unsqueeze(1) - reach.unsqueeze(-1) * normal.unsqueeze(1)).clamp(0, 1)


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


def work(block: Block, state: State, crossings: Tensor | None, generator: torch.Generator) -> None:
    """Descend further from the best; and where that leads over a boundary, along it, or first of all across it."""
    rows = state.active.nonzero().squeeze(-1)
    at = state.held[rows].nonzero().squeeze(-1)
    held, count = rows[at], len(rows)
    best = state.best.at(torch.cat((rows, held)))
    normal = _normal(block[held], state.best.at(held))
    wall = torch.cat((normal.new_zeros(len(normal), count), normal), 1)
    both = torch.cat((rows, held))
    end = descend(block[both].searches, best.place, best.unknowns, gain=GAIN, looks=AGAIN_LOOKS, wall=wall)
    along, free = end.place[:, count:], end.place[:, :count]
    trials = _trials(block[held], state.best.at(held), normal, pick(state.before, held), free[:, at], along)
    more = _differences(state, held, generator)
    trials = torch.cat((trials, more), 1)
    if crossings is not None:
        trials = torch.cat((trials, crossings), 1)
    many = torch.cat((rows, held.repeat(trials.shape[1])))
    places = torch.cat((free, trials.flatten(1)), 1)
    state.before[:, rows] = state.best.place[:, rows]
    found = block[many].reach(places, pick(state.best.rest, many))
    _take(state, many, found)
    _archive(state, held, found.place[:, count:].unflatten(1, (-1, len(held))), found.cost[count:].view(-1, len(held)))
    own_end = found.at(torch.arange(count, device=rows.device))
    same = _same(own_end, end.unknowns[:, :, :count])
    done = same & end.ended[:count] & (own_end.cost <= state.best.cost[rows])
    state.converged[rows] = done
    state.held[rows] = ~same & _worth(end.cost[:count], state.best.cost[rows])
    state.active[rows] = ~done


def _archive(state: State, rows: Tensor, places: Tensor, costs: Tensor) -> None:
    """Keep the best of what was found so far at (M, Q, H) too."""
    size = len(state.costs)
    costs = torch.cat((state.costs[:, rows], costs))
    places = torch.cat((state.places[:, :, rows], places), 1)
    order = costs.topk(min(size, len(costs)), dim=0, largest=False).indices
    state.costs[:, rows] = costs.gather(0, order)
    state.places[:, :, rows] = places.gather(1, order.expand(len(places), -1, -1))


def _differences(state: State, rows: Tensor, generator: torch.Generator) -> Tensor:
    """(M, Q, H) as differential evolution."""
    size = len(state.costs)
    draw = torch.rand(5, DIFFERENCES, generator=generator, dtype=torch.float64)
    index = (draw[:3] * size).long().to(rows.device)
    factor = (LEAST_FACTOR + (1 - LEAST_FACTOR) * draw[3]).to(state.costs).unsqueeze(-1)
    pool = state.places[:, :, rows]
    one, two, three = (pool[:, i] for i in index)
    best = state.best.place[:, rows].unsqueeze(1)
    start = torch.where((draw[4] < FROM_BEST).to(rows.device).unsqueeze(-1), best, torch.lerp(one, best, factor))
    return (start + factor * (two - three)).clamp(0, 1)


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
