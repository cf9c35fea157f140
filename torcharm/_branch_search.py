"""The batched pressure search: descents from several starts, and along the ends of branches.

What a pressure costs is decided by continuation from zero load. A descent goes along warm equilibria, which
continuation may not reach: under compression an arm buckles to one side or to the other, and a small change of pressure
decides to which. The best pressures often lie where it does. So what a descent finds is confirmed by continuation;
where it is not, the search goes on at the boundary, from what is confirmed: see `_trials`.
The batch comes last, as in `mechanics.march`.
"""

from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from torcharm import mechanics
from torcharm._beginnings import begin
from torcharm._box import optimality
from torcharm._continuation import Problem, resting
from torcharm._descent import Goal, Searches, descend
from torcharm._reaching import COARSE_SHAPE, SAME_SHAPE, Block
from torcharm._rounds import GAIN, Others, State, work
from torcharm.equilibrium import solved
from torcharm.mechanics import pick

DESCENT_LOOKS, ONLY_LOOKS = 20, 200
"""Evaluations of the balance in a descent; in one without further rounds."""

SNAPS, SNAP_REACH, NOTE = 3, 0.1, []


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
    own = Searches(arms, problem.scale, problem.arm.max_pressure.mT.contiguous(), goal, problem.tolerance)
    block = Block(own, resting(problem).unknowns.movedim(0, -1).contiguous(), shape.shape[-1])
    wanted = shape.movedim(0, -1).contiguous()
    begun = begin(block, wanted, starts, seed)
    total, count = len(problem.pressure), starts
    every = torch.arange(total, device=shape.device)
    many = every.repeat(count)
    end = descend(own[many], begun.place, begun.unknowns, gain=GAIN, looks=DESCENT_LOOKS if hops else ONLY_LOOKS)
    found = block[many].reach(end.place)
    state = State.of(begun, end, found, total)
    others = Others.of(state, end, found)
    for _ in range(hops):
        if not bool(state.active.any()):
            break
        others = work(block, state, others)
    return _finish(problem, block, state)


def _finish(problem: Problem, block: Block, state: State) -> Searched:
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
    if state.lost is not None and SNAPS:
        rows, place = state.lost
        keep = (~converged)[rows].nonzero().squeeze(-1)
        rows, place = rows[keep], place[:, keep]
        look = mechanics.march(own.arms, best.unknowns, best.place * own.limits, each_pressure=own.limits)
        _, gradient, matrix = own.goal.model(look)
        move = place - best.place[:, rows]
        hoped = best.cost[rows] + (2 * gradient[:, rows] * move).sum(0) + (move * (matrix[:, :, rows] * move).sum(1)).sum(0)
        gain = hoped / best.cost[rows]
        gain = torch.where((move.norm(dim=0) < SNAP_REACH) & (gain < 1), gain, float("inf"))
        order = gain.argsort(stable=True)
        order = order[rows[order].argsort(stable=True)]
        counts = torch.bincount(rows, minlength=len(converged))
        first = counts.cumsum(0) - counts
        rank = torch.arange(len(rows)) - first[rows[order]]
        chosen = order[(rank < SNAPS) & gain[order].isfinite()]
        some = _solved(problem, block, rows[chosen], place[:, chosen])
        NOTE.append((len(chosen), rows[chosen], some.cost, end.cost[rows[chosen]], gain[chosen], some.continued))
        for k in range(SNAPS):
            mine = (rank[(rank < SNAPS) & gain[order].isfinite()] == k).nonzero().squeeze(-1)
            r = rows[chosen[mine]]
            ok = some.cost[mine] < end.cost[r]
            end.put(r[ok], some.at(mine[ok]))
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


def _solved(problem: Problem, block: Block, rows: Tensor, place: Tensor) -> _Solved:
    part, own = problem[rows], block.searches
    found = solved(replace(part, pressure=place.mT * part.arm.max_pressure), block.nodes)
    unknowns = found.unknowns.movedim(0, -1)
    cost = own.goal[rows].cost(unknowns, pick(own.arms.base_pose, rows))
    return _Solved(place, torch.where(found.converged, cost, float("inf")), unknowns, found.continued)
