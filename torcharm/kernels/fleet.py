"""Whole batches through the kernels: from tensors with the batch last, and back."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torcharm import mechanics
from torcharm._arrays import Array, as_array
from torcharm.kernels import looks as one
from torcharm.kernels.arms import Arms, arms_of
from torcharm.kernels.boundary import find_boundary
from torcharm.kernels.descend import descend
from torcharm.kernels.goal import Goal
from torcharm.kernels.settle import settle
from torcharm.kernels.trace import trace

LEAST = 16
"""Elements that are worth a thread."""
PARTS = 4
"""Of a batch for each thread: elements take unlike times."""

NO_GOAL = Goal(np.empty((0, 3, 0)), np.empty((3, 0)), False)


@dataclass(frozen=True)
class Fleet:
    """B arms, and what searches aim at.

    Attributes:
        arms: T of them.
        goal: of the searches; empty where only equilibria are wanted.
        rows: (B,) which of these.
    """

    arms: Arms
    goal: Goal
    rows: Array

    @staticmethod
    def of(arms: mechanics.Arms, scale: tuple[Tensor, Tensor, Tensor], limits: Tensor, tolerance: float) -> "Fleet":
        """Arms of kinds that are known, with limits (M, T)."""
        every = np.arange(limits.shape[-1])
        return Fleet(arms_of(arms, scale, limits, tolerance), NO_GOAL, every)

    def aiming(self, target: Tensor, weight: Tensor, turned: bool) -> "Fleet":
        """The same, for searches: see `Goal` of `_descent`."""
        goal = Goal(_batch_first(target), np.ascontiguousarray(as_array(weight[..., 0])), turned)
        return replace(self, goal=goal)

    def __getitem__(self, index: Tensor) -> "Fleet":
        return replace(self, rows=self.rows[as_array(index)])

    def trace(
        self, place: Tensor, loading: bool, start: Tensor, first_step: float, looks: int, least_share: float
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """The fields of `Traced`, at places (M, B)."""
        places, z, (count,) = _batch_first(place), _batch_first(start), self.rows.shape
        out, shares = np.empty((3, *z.shape)), np.empty((2, count))

        def work(first: int, last: int) -> None:
            trace(self.arms, self.rows, places, loading, z, first_step, looks, least_share, first, last, out, shares)

        _spread(count, work)
        end, quick, rush = (_batch_last(value) for value in out)
        share, when = torch.from_numpy(shares)
        return end, share >= 1, quick, rush, when

    def relax(self, place: Tensor, unknowns: Tensor, steps: int) -> tuple[Tensor, Tensor]:
        """Unloaded arms (C, 1, B) after Newton steps, and the sizes (B,) of the last."""
        z, sizes = _own(unknowns), np.zeros(unknowns.shape[-1])
        one.relax(self.arms, self.rows, _batch_first(place), steps, z, sizes)
        return _batch_last(z), torch.from_numpy(sizes)

    def descend(
        self, wall: Tensor | None, place: Tensor, unknowns: Tensor, gain: float, settled: float, looks: int
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """The fields of `Descended`."""
        count, places, z = len(self.rows), _own(place), _own(unknowns)
        walls, walled = _batch_first(place if wall is None else wall), wall is not None
        cost, ended = np.empty(count), np.empty(count, dtype=bool)
        out = places, z, cost, ended

        def work(first: int, last: int) -> None:
            descend(self.arms, self.goal, self.rows, walls, walled, gain, settled, looks, first, last, *out)

        _spread(count, work)
        return _batch_last(places), _batch_last(z), torch.from_numpy(cost), torch.from_numpy(ended)

    def find_boundary(
        self, place: Tensor, unknowns: Tensor, share: Tensor, measure: Tensor, direction: Tensor, looks: int
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
        """As of `_boundary._find`."""
        z, places, shares = _own(unknowns), _own(place), _own(share)
        count, size = places.shape
        shifts, gains, sizes = np.zeros((count, size, *z.shape[1:])), np.zeros((count, size)), np.empty(count)
        lines, ways = _batch_first(measure), _batch_first(direction)

        def work(first: int, last: int) -> None:
            find_boundary(
                self.arms, self.rows, lines, ways, looks, first, last, z, places, shares, shifts, gains, sizes
            )

        _spread(count, work)
        ends = _batch_last(z), _batch_last(places), torch.from_numpy(shares)
        return *ends, _batch_last(shifts).permute(1, 2, 0, 3), _batch_last(gains), torch.from_numpy(sizes)

    def cost(self, unknowns: Tensor) -> Tensor:
        """(B,) as of `Searches.cost`."""
        out = np.empty(unknowns.shape[-1])
        one.costs(self.arms, self.goal, self.rows, _batch_first(unknowns), out)
        return torch.from_numpy(out)

    def model(self, place: Tensor, unknowns: Tensor, rows: Tensor | None) -> tuple[Tensor, Tensor, Tensor]:
        """As of `Searches.model`."""
        size, count = place.shape
        shapes = np.arange(count) if rows is None else as_array(rows)
        out = np.empty((count, 1 + size, 1 + size))
        z = _batch_first(unknowns)
        one.models(self.arms, self.goal, self.rows[shapes], shapes, _batch_first(place), z, out)
        products = _batch_last(out)
        return products[0, 0], products[0, 1:], products[1:, 1:]

    def gains(self, place: Tensor, unknowns: Tensor, share: Tensor, measure: Tensor) -> Tensor:
        """(M, B) as of `Searches.gains`."""
        places, shares = _batch_first(place), _batch_first(share)
        out = np.empty_like(places)
        one.gains(self.arms, self.rows, _batch_first(measure), places, _batch_first(unknowns), shares, out)
        return _batch_last(out)

    def settle(self, start: Tensor, damping: float, steps: int) -> tuple[Tensor, Tensor]:
        """The fields of `Settled`, at the limits."""
        z, arrived = np.array(as_array(start), order="C"), np.empty(len(start), dtype=bool)

        def work(first: int, last: int) -> None:
            settle(self.arms, self.rows, damping, steps, first, last, z, arrived)

        _spread(len(start), work)
        return torch.from_numpy(z), torch.from_numpy(arrived)


def _spread(count: int, work: Callable[[int, int], None]) -> None:
    """Work on the elements from one to another, of so many, in as many threads as PyTorch takes."""
    threads = min(torch.get_num_threads(), count // LEAST)
    if threads < 2:
        work(0, count)
        return
    edges = [count * part // (PARTS * threads) for part in range(PARTS * threads + 1)]
    with ThreadPoolExecutor(threads) as pool:  # none that a fork would inherit without its threads
        for done in [pool.submit(work, *edge) for edge in pairwise(edges)]:
            done.result()


def _batch_first(value: Tensor) -> Array:
    """(B, ...) from (..., B), in a row."""
    array = as_array(value)
    return np.ascontiguousarray(array.transpose(-1, *range(array.ndim - 1)))


def _own(value: Tensor) -> Array:
    """The same, to be written to."""
    array = as_array(value)
    return np.array(array.transpose(-1, *range(array.ndim - 1)), order="C")


def _batch_last(value: Any) -> Tensor:
    """(..., B) from (B, ...)."""
    return torch.from_numpy(value).movedim(0, -1)
