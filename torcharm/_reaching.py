"""What continuation from zero load reaches, for the batched pressure search. The batch comes last."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from torcharm._continuation import FIRST_FILLING, Problem, unloaded
from torcharm._descent import Searches
from torcharm._tracing import FIRST_SHARE, Course, Traced, relaxed, trace
from torcharm.mechanics import pick

LOOKS, LEAST_SHARE, PATIENCE = 30, 4e-3, (200, 1e-4)
"""Of paths: evaluations of the balance at most, and the share of the load below which they are given up; and both of
who is patient."""
SAME_SHAPE, COARSE_SHAPE = 1e-6, 1e-2
"""Twists [m, rad] that differ by less are of one branch; in single precision."""
NEWTON_STEPS = 5
"""From an unloaded arm to that at another pressure."""


def lowest(rows: Tensor, cost: Tensor, total: int) -> tuple[Tensor, Tensor]:
    """The lowest of the costs (B,) that belong to rows (B,) of T: which rows have any that is finite, and where."""
    least = cost.new_full((total,), float("inf")).scatter_reduce(0, rows, cost, "amin")
    index = ((cost == least[rows]) & cost.isfinite()).nonzero().squeeze(-1)
    where = torch.full((total,), -1, dtype=torch.long, device=rows.device)
    where[rows[index]] = index
    have = (where >= 0).nonzero().squeeze(-1)
    return have, where[have]


class Reached(NamedTuple):
    """What continuation from zero load reaches at B pressures.

    Attributes:
        place: (M, B) the pressures, as shares of their limits.
        cost: (B,) infinite where the branch ends, or the arm is folded.
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


def joined(one: Reached, two: Reached) -> Reached:
    """The one and then the other."""
    return Reached(*(torch.cat(pair, -1) for pair in zip(one, two, strict=True)))


@dataclass(frozen=True)
class Block:
    """T searches, with what continuation starts from.

    Attributes:
        searches: T of them.
        idle: (C, 1, T) arms without load or pressure.
        nodes: N.
        patient: the problems, if paths that take long are to be followed, and arms to be let go that do not come to
            rest along one: without pressure a lone actuator does not resist bending.
    """

    searches: Searches
    idle: Tensor
    nodes: int
    patient: Problem | None = None

    def __getitem__(self, index: Tensor) -> "Block":
        patient = None if self.patient is None else self.patient[index]
        return Block(self.searches[index], pick(self.idle, index), self.nodes, patient)

    def rest(self, place: Tensor) -> tuple[Tensor, Tensor]:
        """The unloaded arms (C, 1, B) at (M, B), continued from zero pressure; and whether there."""
        path = self._trace(place, self.idle, LOOKS, LEAST_SHARE, loading=False)
        left = (~path.arrived).nonzero().squeeze(-1)
        if self.patient is not None and len(left):
            part = self.patient[left]
            found = unloaded(replace(part, pressure=place[:, left].mT * part.arm.max_pressure))
            path.unknowns[:, :, left], path.arrived[left] = found.unknowns.movedim(0, -1), found.arrived
        return path.unknowns, path.arrived

    def rest_near(self, place: Tensor, near: Tensor) -> tuple[Tensor, Tensor]:
        """The same, from unloaded arms at pressures nearby."""
        own = self.searches
        if own.fleet is not None:
            near, size = own.fleet.relax(place, near, NEWTON_STEPS)
        else:
            near, size = relaxed(self._course(place, loading=False), near, NEWTON_STEPS)
        return near, size <= (SAME_SHAPE if near.dtype == torch.float64 else COARSE_SHAPE)

    def _trace(self, place: Tensor, start: Tensor, looks: int, least_share: float, *, loading: bool) -> Traced:
        fleet, first = self.searches.fleet, FIRST_SHARE if loading else FIRST_FILLING
        if fleet is not None:
            return Traced(*fleet.trace(place, loading, start, first, looks, least_share))
        return trace(self._course(place, loading=loading), start, first, looks, least_share)

    def _course(self, place: Tensor, *, loading: bool) -> Course:
        own = self.searches
        return Course(own.arms, place * own.limits, loading, own.scale, own.tolerance)

    def _unfolded(self, unknowns: Tensor) -> Tensor:
        """(B,) whether all lengths at unknowns (C, N, B) are above 0: the centreline's, and the actuators'."""
        length, curvature = unknowns[0], unknowns[-1]
        radii = pick(self.searches.setting.arms.radii, self.searches.rows)
        own = torch.minimum(length - radii.amax(0) * curvature, length - radii.amin(0) * curvature)
        return (torch.minimum(own, length) > 0).all(0)

    def reach(self, place: Tensor, near: Tensor | None = None, *, far: bool = False, looks: int = LOOKS) -> Reached:
        """What continuation reaches.

        Args:
            place: (M, B) shares of the limits.
            near: (C, 1, B) unloaded arms at pressures nearby.
            far: whether to start from no pressure where these are too far; else they are given up.
            looks: evaluations of the balance, at most, as the load grows, of those that are not patient.
        """
        rest, still = self.rest(place) if near is None else self.rest_near(place, near)
        left = (~still).nonzero().squeeze(-1)
        if near is not None and far and len(left):
            rest[:, :, left], still[left] = self[left].rest(place[:, left])
        start = rest.expand(-1, self.nodes, -1).contiguous()
        looks, least = (looks, LEAST_SHARE) if self.patient is None else PATIENCE
        path = self._trace(place, start, looks, least, loading=True)
        cost = self.searches.cost(path.unknowns)
        cost = torch.where(path.arrived & still & cost.isfinite() & self._unfolded(path.unknowns), cost, float("inf"))
        return Reached(place, cost, path.unknowns, rest, path.quick, path.rush, path.share)
