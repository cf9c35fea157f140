"""Whole batches through the kernels: from tensors with the batch last, and back."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from torcharm._arrays import Array, as_array
from torcharm.kernels import looks as _looks
from torcharm.kernels.arms import Arms, arms_of, batch_first, batch_last
from torcharm.kernels.boundary import find_boundary as _find_boundary
from torcharm.kernels.descend import descend as _descend
from torcharm.kernels.goal import Goal
from torcharm.kernels.settle import settle as _settle
from torcharm.kernels.trace import trace as _trace

if TYPE_CHECKING:
    from torcharm._continuation import Problem
    from torcharm._descent import Searches
    from torcharm._tracing import Course

LEAST = 16
"""Elements that are worth a thread."""
PARTS = 4
"""Of a batch for each thread: elements take unlike times."""


def _spread(count: int, work: Callable[[int, int], None]) -> None:
    """Work on the elements from one to another, of so many, in as many threads as PyTorch takes."""
    threads = min(torch.get_num_threads(), count // LEAST)
    if threads < 2:
        work(0, count)
        return
    edges = [count * part // (PARTS * threads) for part in range(PARTS * threads + 1)]
    for done in [_pool(threads).submit(work, *edge) for edge in pairwise(edges)]:
        done.result()


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads)


def trace(
    course: "Course", start: Tensor, first_step: float, looks: int, least_share: float
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """The fields of `Traced`."""
    count, pressure = start.shape[-1], batch_first(course.pressure)
    arms = arms_of(course.arms, course.scale, course.pressure, course.tolerance)
    out, shares = np.empty((3, count, *start.shape[:-1])), np.empty((2, count))
    z, loading = batch_first(start), course.loading

    def work(first: int, last: int) -> None:
        _trace(arms, pressure, loading, z, first_step, looks, least_share, first, last, out, shares)

    _spread(count, work)
    end, quick, rush = (batch_last(value) for value in out)
    share, when = torch.from_numpy(shares)
    return end, share >= 1, quick, rush, when


def descend(
    searches: "Searches", place: Tensor, unknowns: Tensor, gain: float, settled: float, looks: int
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The fields of `Descended`."""
    count, arms, goal = place.shape[-1], _arms(searches), _goal(searches)
    wall = batch_first(torch.zeros_like(place) if searches.wall is None else searches.wall)
    places, z = np.array(batch_first(place)), np.array(batch_first(unknowns))
    cost, ended = np.empty(count), np.empty(count, dtype=bool)
    walled = searches.wall is not None

    def work(first: int, last: int) -> None:
        _descend(arms, goal, wall, walled, gain, settled, looks, first, last, places, z, cost, ended)

    _spread(count, work)
    return batch_last(places), batch_last(z), torch.from_numpy(cost), torch.from_numpy(ended)


def find_boundary(
    searches: "Searches",
    place: Tensor,
    unknowns: Tensor,
    share: Tensor,
    measure: Tensor,
    direction: Tensor,
    looks: int,
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Unknowns, places and shares where Newton's method ended, (C, N, M, B) shifts, (M, B) gains, and (B,) sizes."""
    arms = _arms(searches)
    z, places, shares = (np.array(batch_first(value)) for value in (unknowns, place, share))
    count, size = places.shape
    shifts, gains, sizes = np.zeros((count, size, *z.shape[1:])), np.zeros((count, size)), np.empty(count)
    lines, ways = batch_first(measure), batch_first(direction)

    def work(first: int, last: int) -> None:
        _find_boundary(arms, lines, ways, looks, first, last, z, places, shares, shifts, gains, sizes)

    _spread(count, work)
    ends = batch_last(z), batch_last(places), torch.from_numpy(shares)
    return *ends, batch_last(shifts).permute(1, 2, 0, 3), batch_last(gains), torch.from_numpy(sizes)


def settle(problem: "Problem", start: Tensor, damping: float, steps: int) -> tuple[Tensor, Tensor]:
    """The fields of `Settled`."""
    pressure = problem.pressure.mT
    arms = arms_of(problem.arms, problem.scale, pressure, problem.tolerance)
    z, arrived = np.array(start.numpy(), order="C"), np.empty(len(start), dtype=bool)
    acting = batch_first(pressure)

    def work(first: int, last: int) -> None:
        _settle(arms, acting, damping, steps, first, last, z, arrived)

    _spread(len(start), work)
    return torch.from_numpy(z), torch.from_numpy(arrived)


def models(searches: "Searches", rows: Tensor, place: Tensor, unknowns: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """As `Searches.model`, of searches and shapes `rows` (B,)."""
    size, count = place.shape
    out = np.empty((1 + size, 1 + size, count))
    arms, goal = _arms(searches), _goal(searches)
    _looks.models(arms, goal, as_array(rows), batch_first(place), batch_first(unknowns), out)
    products = torch.from_numpy(out)
    return products[0, 0], products[0, 1:], products[1:, 1:]


def costs(searches: "Searches", unknowns: Tensor) -> Tensor:
    """(B,) as of `Goal.cost`."""
    out = np.empty(unknowns.shape[-1])
    _looks.costs(_arms(searches), _goal(searches), batch_first(unknowns), out)
    return torch.from_numpy(out)


def gains(searches: "Searches", place: Tensor, unknowns: Tensor, share: Tensor, measure: Tensor) -> Tensor:
    """(M, B) as of `Searches.gains`."""
    places = batch_first(place)
    out = np.empty_like(places)
    _looks.gains(_arms(searches), batch_first(measure), places, batch_first(unknowns), batch_first(share), out)
    return batch_last(out)


def relax(course: "Course", unknowns: Tensor, steps: int) -> tuple[Tensor, Tensor]:
    """Unloaded arms (C, 1, B) after Newton steps, and the sizes (B,) of the last."""
    arms = arms_of(course.arms, course.scale, course.pressure, course.tolerance)
    z, sizes = np.array(batch_first(unknowns)), np.zeros(unknowns.shape[-1])
    _looks.relax(arms, batch_first(course.pressure), steps, z, sizes)
    return batch_last(z), torch.from_numpy(sizes)


def _arms(searches: "Searches") -> Arms:
    return arms_of(searches.arms, searches.scale, searches.limits, searches.tolerance)


def _goal(searches: "Searches") -> Goal:
    own = searches.goal
    return Goal(batch_first(own.target), np.ascontiguousarray(own.weight[..., 0].numpy()), own.turned)
