"""The batched pressure search: descents from several starts, and along the ends of branches.

What a pressure costs is decided by continuation from zero load. A descent goes along warm equilibria, which
continuation may not reach: under compression an arm buckles to one side or to the other, and a small change of pressure
decides to which. The best pressures often lie where it does. So what a descent finds is confirmed by continuation;
where it is not, the search goes on at the boundary, from what is confirmed: see `_rounds`.
The batch comes last, as in `mechanics.march`.
"""

from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from torcharm._beginnings import begin
from torcharm._box import optimality
from torcharm._continuation import SETTLING_STEPS, Problem, resting, solved
from torcharm._descent import Goal, Searches, Setting, descend
from torcharm._reaching import COARSE_SHAPE, SAME_SHAPE, Block, Reached, lowest
from torcharm._rounds import GAIN, Lost, Others, State, work
from torcharm.mechanics import pick, put

DESCENT_LOOKS, ONLY_LOOKS = 20, 200
"""Evaluations of the balance in a descent; in one without further rounds."""

TRIED_AGAIN, NEARBY = 10, 0.5
"""Places for each search that are tried again at the end, and how near they are, in lengths of the box."""
TRIAL_SETTLING = 30
"""Steps of letting go there, at most: a few that never come to rest take as long as all others."""
SNAPPED = 0.99
"""Share of the cost that a place where the arm snaps must come down to, unless a descent ended there."""


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
    found = _searched(problem, goal, shape, starts, hops, seed, patient=False)
    # Of some floppy arms no start is reached
    slow = found.start_cost.isinf().all(1).nonzero().squeeze(-1)
    if len(slow):
        again = _searched(problem[slow], goal[slow], shape[slow], starts, hops, seed, patient=True)
        better = again.cost < found.cost[slow]
        for old, new in zip(found, again, strict=True):
            old[slow[better]] = new[better]
    return found


def _searched(
    problem: Problem, goal: Goal, shape: Tensor, starts: int, hops: int, seed: int, *, patient: bool
) -> Searched:
    """As `search_block`, patient or not: see `Block`."""
    arms = problem.arms
    limits = problem.arm.max_pressure.mT.contiguous()
    own = Searches.of(Setting(arms, problem.scale, limits, goal), problem.tolerance, compiled=problem.compiled)
    idle = resting(problem).unknowns.movedim(0, -1).contiguous()
    block = Block(own, idle, shape.shape[-1], problem if patient else None)
    wanted = shape.movedim(0, -1).contiguous()
    begun = begin(block, wanted, starts, seed)
    total, count = len(problem.pressure), starts
    every = torch.arange(total, device=shape.device)
    many = every.repeat(count)
    end = descend(own[many], begun.place, begun.unknowns, gain=GAIN, looks=DESCENT_LOOKS if hops else ONLY_LOOKS)
    found = block[many].reach(end.place, begun.rest, far=True)
    state = State.of(begun, end, found, total)
    others = Others.of(state, end, found)
    for _ in range(hops):
        if not bool(state.active.any()):
            break
        others = work(block, state, others, seed)
    return _finish(problem, block, state)


def _finish(problem: Problem, block: Block, state: State) -> Searched:
    """Make sure that it is `solve_equilibrium`'s; where nothing was confirmed, take that of the best start. Where the
    search was held up, a place may be better to which it could not follow, even if the arm snaps there."""
    best, own = state.best, block.searches
    rest, still = block.rest(best.place)
    near = SAME_SHAPE if rest.dtype == torch.float64 else COARSE_SHAPE
    sure = still & best.cost.isfinite() & ((rest - best.rest).abs().amax((0, 1)) < near)
    end = _Solved(best.place.clone(), best.cost.clone(), best.unknowns.clone(), sure.clone())
    converged = state.converged & sure
    left = (~sure).nonzero().squeeze(-1)
    lost = _hopeful(own, best, state.lost, ~converged)
    rows = torch.cat((left, lost.rows))
    if len(rows):
        again = _solved(problem, block, rows, torch.cat((best.place[:, left], lost.place), 1), TRIAL_SETTLING)
        slow = again.cost[: len(left)].isinf().nonzero().squeeze(-1)
        if len(slow):
            put(again, slow, _solved(problem, block, rows[slow], again.place[:, slow], SETTLING_STEPS))
        put(end, left, pick(again, torch.arange(len(left), device=rows.device)))
        whole = torch.cat((torch.ones_like(left, dtype=torch.bool), lost.ended)) | again.continued
        handicapped = torch.where(whole, again.cost, again.cost / SNAPPED)
        have, taken = lowest(rows, handicapped, len(sure))
        better = handicapped[taken] < end.cost[have]
        put(end, have[better], pick(again, taken[better]))
    _, gradient, _ = own.model(end.place, end.unknowns)
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


def _hopeful(own: Searches, best: Reached, lost: Lost, wanted: Tensor) -> Lost:
    """Of the places that could not be followed, for each search that is wanted (T,) some that promise most by the
    model at the best place, if they are near; and corners of the box."""
    cost, gradient, matrix = (pick(value, lost.rows) for value in own.model(best.place, best.unknowns))
    move = lost.place - best.place[:, lost.rows]
    hoped = cost + (move * (2 * gradient + (matrix * move).sum(1))).sum(0)
    corner = ((lost.place == 0) | (lost.place == 1)).all(0)
    worth = wanted[lost.rows] & (corner | ((move.norm(dim=0) < NEARBY) & (hoped < best.cost[lost.rows])))
    order = torch.where(corner, -1.0, hoped).argsort()
    order = order[worth[order]]
    order = order[_distinct(torch.cat((lost.rows.to(lost.place).unsqueeze(0), lost.place))[:, order])]
    order = order[lost.rows[order].argsort(stable=True)]
    rows = lost.rows[order]
    rank = torch.arange(len(rows), device=rows.device) - torch.searchsorted(rows, rows)
    order = order[rank < TRIED_AGAIN]
    return Lost(lost.rows[order], lost.place[:, order], lost.ended[order])


def _distinct(columns: Tensor) -> Tensor:
    """(D,) where each of the columns (K, L) is for the first time."""
    _, kind = columns.unique(dim=1, return_inverse=True)
    index = torch.arange(len(kind), device=kind.device)
    return torch.full_like(kind, len(kind)).scatter_reduce(0, kind, index, "amin")[kind].eq(index).nonzero().squeeze(-1)


class _Solved(NamedTuple):
    """What `solve_equilibrium` finds at places (M, B): costs (B,), infinite where it fails or the arm would not stay,
    unknowns (C, N, B), and whether continuation led there (B,)."""

    place: Tensor
    cost: Tensor
    unknowns: Tensor
    continued: Tensor


def _solved(problem: Problem, block: Block, rows: Tensor, place: Tensor, settling: int) -> _Solved:
    part, own = problem[rows], block.searches
    found = solved(replace(part, pressure=place.mT * part.arm.max_pressure), block.nodes, settling=settling)
    unknowns = found.unknowns.movedim(0, -1)
    cost = own[rows].cost(unknowns)
    return _Solved(place, torch.where(found.stable, cost, float("inf")), unknowns, found.continued)
