"""The batched pressure search: descents from several starts, and along the ends of branches.

What a pressure costs is decided by continuation from zero load. A descent goes along warm equilibria, which
continuation may not reach: under compression an arm buckles to one side or to the other, and a small change of pressure
decides to which. The best pressures often lie where it does. So what a descent finds is confirmed by continuation;
where it is not, the search goes on at the boundary, from what is confirmed: see `_trials`.
The batch comes last, as in `mechanics.march`.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from torcharm import mechanics
from torcharm._box import box_step, optimality, spread_points
from torcharm._continuation import FIRST_FILLING, Problem, resting
from torcharm._descent import Descended, Goal, Searches, descend
from torcharm._tracing import FIRST_SHARE, Course, trace
from torcharm.equilibrium import solved
from torcharm.mechanics import pick

CANDIDATES = 2
"""Pressures that are loaded, for each start."""
POOL = 4
"""Pressures that compete, to first order at the task shape, for each start that is guided."""
LOOKS, LEAST_SHARE = 40, 4e-3
"""Of paths: evaluations of the balance at most, and the share of the load below which they are given up."""
DESCENT_LOOKS, ONLY_LOOKS, AGAIN_LOOKS, WALL_LOOKS = 20, 200, 12, 8
"""Evaluations of the balance in a descent; in one without further rounds; in one that goes on; along a boundary."""
GAIN, WALL_GAIN = 1e-9, 1e-4
"""Relative decrease of the cost at which they end."""
SAME_SHAPE, COARSE_SHAPE = 1e-6, 1e-2
"""Twists [m, rad] that differ by less are of one branch; in single precision."""
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
NEWTON_STEPS = 5
"""From an unloaded arm to that at another pressure."""


class Reached(NamedTuple):
    """What continuation from zero load reaches at B pressures.

    Attributes:
        place: (M, B) the pressures, as shares of their limits.
        cost: (B,) infinite where the branch ends.
        unknowns: (C, N, B) at the full load.
        rest: (C, 1, B) without load.
        quick, rush: (C, N, B) the equilibrium on the way at which the arm gives way most, and its rate by the
            share of the load: next to a bifurcation if there is any.
        share: (B,) of the load there.
    """

    place: Tensor
    cost: Tensor
    unknowns: Tensor
    rest: Tensor
    quick: Tensor
    rush: Tensor
    share: Tensor

    def at(self, index: Tensor) -> "Reached":
        return Reached(*(pick(value, index) for value in self))

    def put(self, index: Tensor, new: "Reached") -> None:
        for old, fresh in zip(self, new, strict=True):
            old[..., index] = fresh


@dataclass(frozen=True)
class _Block:
    """T searches, with what continuation starts from: idle arms (C, 1, T), without load or pressure."""

    searches: Searches
    idle: Tensor
    nodes: int

    def __getitem__(self, index: Tensor) -> "_Block":
        return _Block(self.searches[index], pick(self.idle, index), self.nodes)

    def rest(self, place: Tensor) -> tuple[Tensor, Tensor]:
        """The unloaded arms (C, 1, B) at (M, B), continued from zero pressure; and whether there."""
        path = trace(self._course(place, False), self.idle, FIRST_FILLING, LOOKS, LEAST_SHARE)
        return path.unknowns, path.arrived

    def rest_near(self, place: Tensor, near: Tensor) -> tuple[Tensor, Tensor]:
        """The same, from unloaded arms at pressures nearby."""
        course = self._course(place, False)
        size = place.new_zeros(place.shape[-1])
        for _ in range(NEWTON_STEPS):
            look = mechanics.relax(course.arms, near, course.pressure, course.pressure)
            near = near + look.change[:, :, 0]
            size = course.scale.moves(look.change[:, :, :1], look.turned[:, :1])[0]
        return near, size <= (SAME_SHAPE if near.dtype == torch.float64 else COARSE_SHAPE)

    def _course(self, place: Tensor, loading: bool) -> Course:
        own = self.searches
        return Course(own.arms, place * own.limits, loading, own.scale, own.tolerance, own.compiled)

    def reach(self, place: Tensor, near: Tensor | None = None) -> Reached:
        """What continuation reaches at shares of the limits (M, B); `near` are unloaded arms (C, 1, B) nearby."""
        rest, still = self.rest(place) if near is None else self.rest_near(place, near)
        start = rest.expand(-1, self.nodes, -1).contiguous()
        path = trace(self._course(place, True), start, FIRST_SHARE, LOOKS, LEAST_SHARE)
        cost = self.searches.goal.cost(path.unknowns, self.searches.arms.base_pose)
        cost = torch.where(path.arrived & still & cost.isfinite(), cost, float("inf"))
        return Reached(place, cost, path.unknowns, rest, path.quick, path.rush, path.share)


class Searched(NamedTuple):
    """What T searches found, as of `PressureSearch`: with pressures as shares of the limits (T, M) and the unknowns
    (T, C, N)."""

    place: Tensor
    cost: Tensor
    unknowns: Tensor
    continued: Tensor
    converged: Tensor
    optimality: Tensor
    start_cost: Tensor


def search_block(problem: Problem, goal: Goal, shape: Tensor, starts: int, hops: int, seed: int) -> Searched:
    """The best pressures of T searches.

    Args:
        problem: T of them, with the limits as pressures.
        goal: what they aim at.
        shape: (T, C, N) the task shapes.
        starts: S.
        hops: rounds on what is not at its end.
        seed: of the pressures to start from.
    """
    arms = problem.arms
    limits = problem.arm.max_pressure.mT.contiguous()
    own = Searches(arms, problem.scale, limits, goal, problem.tolerance, problem.compiled)
    block = _Block(own, resting(problem).unknowns.movedim(0, -1).contiguous(), shape.shape[-1])
    wanted = shape.movedim(0, -1).contiguous()
    begun = _begin(block, wanted, starts, seed)
    total, count = len(problem.pressure), starts
    every = torch.arange(total, device=shape.device)
    many = every.repeat(count)
    end = descend(own[many], begun.place, begun.unknowns, gain=GAIN, looks=DESCENT_LOOKS if hops else ONLY_LOOKS)
    found = block[many].reach(end.place)
    state = _State.of(begun, end, found, total)
    crossings: Tensor | None = _crossings(block, state, end, found)
    for _ in range(hops):
        if not bool(state.active.any()):
            break
        _work(block, state, crossings)
        crossings = None
    return _finish(problem, block, state)


def _begin(block: _Block, wanted: Tensor, starts: int, seed: int) -> Reached:
    """S starts for each, one lot after the other: the best of those loaded, the middle of the box among them; and
    if there are several, one that is at the task shape, with the pressure that is best there to first order."""
    own, total = block.searches, wanted.shape[-1]
    size = len(own.limits)
    like = own.limits
    guided, spread = starts, spread_points(starts * (CANDIDATES - 1), size, like, seed)
    spread[1:] = (1.6 * spread[1:] - 0.3).clamp(0, 1)
    pool = torch.rand(guided * POOL, size, generator=torch.Generator().manual_seed(seed)).to(like)
    pool = (1.2 * pool - 0.1).clamp(0, 1)  # the bounds are where optima like to be
    expected = _expected_cost(own, wanted, pool).unflatten(0, (guided, POOL))
    lots = torch.arange(guided, device=like.device).unsqueeze(-1) * POOL
    best = pool[lots + expected.argmin(1)]  # (G, T, M)
    places = torch.cat((best, spread.unsqueeze(1).expand(-1, total, -1)))
    count = len(places)
    every = torch.arange(total, device=like.device)
    loaded = block[every.repeat(count)].reach(places.flatten(0, 1).mT.contiguous())
    kept = max(1, starts - 1)
    rank = loaded.cost.view(count, total).topk(kept, dim=0, largest=False).indices
    if kept > 1:
        rank[-1] = torch.where((rank == guided).any(0), rank[-1], guided)
    begun = loaded.at((rank * total + every).flatten())
    if starts == 1:
        return begun
    first = pool[expected.flatten(0, 1).argmin(0)].mT
    none = wanted.new_full((total,), float("inf"))
    at_shape = Reached(first, none, wanted, block.idle, wanted, torch.zeros_like(wanted), torch.zeros_like(none))
    return Reached(*(torch.cat(pair, -1) for pair in zip(begun, at_shape, strict=True)))


def _expected_cost(own: Searches, wanted: Tensor, pool: Tensor) -> Tensor:
    """(Q, T) the cost of Q pressures to first order at the task shape: twists move by `-J⁻¹R`."""
    total, columns = wanted.shape[-1], []
    step = max(1, 2000 // total)
    for part in pool.split(step):
        index = torch.arange(total, device=pool.device).repeat(len(part))
        some = own[index]
        place = part.mT.repeat_interleave(total, 1)
        look = mechanics.march(some.arms, pick(wanted, index), place * some.limits)
        cost, _, _ = some.goal.model(look)
        columns.append(cost.view(len(part), total))
    expected = torch.cat(columns)
    return torch.where(expected.isnan(), float("inf"), expected)  # ranked last


@dataclass
class _State:
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
    def of(begun: Reached, end: Descended, found: Reached, total: int) -> "_State":
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
        return _State(best, best.place.clone(), converged & ~held, ~converged | held, held, start)


def _same(found: Reached, unknowns: Tensor) -> Tensor:
    """(B,) whether continuation reaches these equilibria (C, N, B)."""
    near = 10 * SAME_SHAPE if unknowns.dtype == torch.float64 else COARSE_SHAPE
    return found.cost.isfinite() & ((found.unknowns - unknowns).abs().amax((0, 1)) < near)


def _worth(cost: Tensor, best: Tensor) -> Tensor:
    """(B,) whether a cost is worth going for."""
    return cost < best * (1 - 1e-4) - 1e-12


def _crossings(block: _Block, state: _State, end: Descended, found: Reached) -> Tensor:
    """(M, Q, H) pressures to try where the best descent was not confirmed: across the boundary from its end, against
    the way the arm gives there."""
    total, rows = len(state.held), state.held.nonzero().squeeze(-1)
    warm = torch.where(_same(found, end.unknowns), float("inf"), end.cost).view(-1, total)
    wrong = found.at(warm.argmin(0)[rows] * total + rows)
    normal = _normal(block[rows], wrong)
    reach = torch.logspace(-2, 0.2, FLIPS).to(normal)
    return (wrong.place.unsqueeze(1) - reach.unsqueeze(-1) * normal.unsqueeze(1)).clamp(0, 1)


def _normal(block: _Block, at: Reached) -> Tensor:
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


def _take(state: _State, rows: Tensor, found: Reached) -> None:
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


def _work(block: _Block, state: _State, crossings: Tensor | None) -> None:
    """Descend further from the best; and where that leads over a boundary, along it, or first of all across it."""
    rows = state.active.nonzero().squeeze(-1)
    part, best, before = block[rows], state.best.at(rows), pick(state.before, rows)
    end = descend(part.searches, best.place, best.unknowns, gain=GAIN, looks=AGAIN_LOOKS)
    at = state.held[rows].nonzero().squeeze(-1)
    held = rows[at]
    trials = crossings
    if trials is None:
        trials = _trials(block[held], best.at(at), pick(before, at), pick(end.place, at))
    many = torch.cat((rows, held.repeat(trials.shape[1])))
    places = torch.cat((end.place, trials.flatten(1)), 1)
    state.before[:, rows] = best.place
    found = block[many].reach(places, pick(state.best.rest, many))
    _take(state, many, found)
    count = len(rows)
    own_end = found.at(torch.arange(count, device=rows.device))
    same = _same(own_end, end.unknowns)
    done = same & end.ended & (own_end.cost <= state.best.cost[rows])
    state.converged[rows] = done
    state.held[rows] = ~same & _worth(end.cost, state.best.cost[rows])
    state.active[rows] = ~done


def _trials(block: _Block, best: Reached, before: Tensor, free: Tensor) -> Tensor:
    """(M, Q, H) pressures to try from the best confirmed of H searches, where the descent to `free` (M, H) leads
    over a boundary: along the boundary and away from it, and towards it in steps of any length."""
    own, place = block.searches, best.place
    normal = _normal(block, best)
    along = descend(replace(own, wall=normal), place, best.unknowns, gain=WALL_GAIN, looks=WALL_LOOKS).place - place
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


def _finish(problem: Problem, block: _Block, state: _State) -> Searched:
    """Make sure that it is `solve_equilibrium`'s; where nothing was confirmed, take that of the best start. Where the
    search was held up, the nearest corner of the box may be better, even if the arm snaps there."""
    best, own = state.best, block.searches
    rest, still = block.rest(best.place)
    near = SAME_SHAPE if rest.dtype == torch.float64 else COARSE_SHAPE
    sure = still & best.cost.isfinite() & ((rest - best.rest).abs().amax((0, 1)) < near)
    end = _Solved(best.place.clone(), best.cost.clone(), best.unknowns.clone(), sure.clone())
    left = (~sure).nonzero().squeeze(-1)
    end.put(left, _solved(problem, block, left, best.place[:, left]))
    converged = state.converged & sure
    held = (~converged).nonzero().squeeze(-1)
    corner = _solved(problem, block, held, end.place[:, held].round())
    better = corner.cost < end.cost[held]
    end.put(held[better], corner.at(better))
    look = mechanics.march(own.arms, end.unknowns, end.place * own.limits, each_pressure=own.limits)
    _, gradient, _ = own.goal.model(look)
    place = end.place.mT
    return Searched(
        place,
        end.cost,
        end.unknowns.movedim(-1, 0),
        end.continued,
        converged,
        2 * optimality(gradient.mT, place),
        state.start_cost.mT,
    )


class _Solved(NamedTuple):
    """What `solve_equilibrium` finds at places (M, B): costs (B,), infinite where it fails, unknowns (C, N, B), and
    whether continuation led there (B,)."""

    place: Tensor
    cost: Tensor
    unknowns: Tensor
    continued: Tensor

    def at(self, index: Tensor) -> "_Solved":
        return _Solved(*(value[..., index] for value in self))

    def put(self, index: Tensor, new: "_Solved") -> None:
        for old, fresh in zip(self, new, strict=True):
            old[..., index] = fresh


def _solved(problem: Problem, block: _Block, rows: Tensor, place: Tensor) -> _Solved:
    part, own = problem[rows], block.searches
    found = solved(replace(part, pressure=place.mT * part.arm.max_pressure), block.nodes)
    unknowns = found.unknowns.movedim(0, -1)
    cost = own.goal[rows].cost(unknowns, pick(own.arms.base_pose, rows))
    return _Solved(place, torch.where(found.converged, cost, float("inf")), unknowns, found.continued)
