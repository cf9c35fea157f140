"""States of an arm under one load: the equilibria at many pressures, what to think of each, and how each moves."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torcharm.arm_series import segments_of
from torcharm.equilibrium.problem import Problem
from torcharm.equilibrium.sensitivity import pressure_sensitivity
from torcharm.equilibrium.solve import Equilibrium, solved
from torcharm.equilibrium.stability import beyond_range
from torcharm.geometry import rod
from torcharm.load import ExternalLoad
from torcharm.statics.cross_section import RANGE_SLACK
from torcharm.task import Task
from torcharm.wrench_sets.capacity import held_factor

STATES = ("reached", "excluded by range", "snapped", "unstable", "not converged", "impossible")
"""Reached: a stable equilibrium to which loading from rest leads along one branch, with strains and pressures that were
characterised. Excluded by range: the same, but for strains or pressures beyond that, where figures extrapolate.
Snapped: stable, but on another branch than the one that leads from rest, which has ended before. Unstable: the arm
would not stay. Not converged, impossible: as of an equilibrium."""
REACHED, EXCLUDED, SNAPPED, UNSTABLE, NOT_CONVERGED, IMPOSSIBLE = range(len(STATES))

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Batch:
    """S states, in float64.

    Attributes:
        normalised: (S, M) normalised pressures.
        twists: (S, N, K).
        tip_pose: (S, 3) or (S, 4, 4).
        code: (S,) indices into `STATES`.
        strain_excess: (S,) the largest strain beyond its characterised range.
    """

    normalised: Tensor
    twists: Tensor
    tip_pose: Tensor
    code: Tensor
    strain_excess: Tensor

    def __len__(self) -> int:
        return len(self.normalised)

    @property
    def position(self) -> Array:
        """(S, D) where the tips are [m]."""
        return position_of(self.tip_pose).numpy()


def joined(batches: Sequence[Batch]) -> Batch:
    """All states of some batches, one after the other."""
    return Batch(*(torch.cat([getattr(one, own.name) for one in batches]) for own in fields(Batch)))


def position_of(pose: Tensor) -> Tensor:
    """(..., D) of poses (..., 3) or (..., 4, 4) [m]."""
    return pose[..., :3, 3] if pose.shape[-2:] == (4, 4) else pose[..., :2]


@torch.no_grad()
def solve_states(scene: Problem, normalised: Array) -> Batch:
    """The states at normalised pressures (S, M) of a scene: the arm and what loads it."""
    tried = torch.from_numpy(normalised)
    found = solved(at_pressures(scene, tried))
    return Batch(tried, found.twists, found.poses[:, -1], _codes(found), found.strain_excess)


def at_pressures(scene: Problem, normalised: Tensor) -> Problem:
    """The scene at normalised pressures (S, M)."""
    return replace(scene, pressure=normalised * scene.arm.max_pressure, batch=(len(normalised),))


def _codes(found: Equilibrium) -> Tensor:
    """Indices into `STATES`."""
    code = torch.full(found.stable.shape, REACHED)
    for flag, word in (
        (found.in_range, EXCLUDED),
        (found.continued, SNAPPED),
        (found.stable, UNSTABLE),
        (found.converged, NOT_CONVERGED),
        (found.possible, IMPOSSIBLE),
    ):
        code = torch.where(flag, code, word)
    return code


@torch.no_grad()
def payload_factors(scene: Problem, states: Batch) -> Tensor:
    """(S,) by what the payload can grow at each shape; infinite without one, NaN of states that are not stable."""
    stable = states.code <= SNAPPED
    factor = torch.where(stable, torch.inf, torch.nan).double()
    if has_payload(scene.load) and bool(stable.any()):
        nodes = scene.nodes if len(scene.nodes) > 1 else None
        task = Task(states.twists[stable], None, scene.base_pose, scene.load, scene.wrench_at, nodes)
        factor[stable] = held_factor(scene.arm, task)
    return factor


def has_payload(load: ExternalLoad) -> bool:
    """Whether there is anything to scale beside the arm's own weight."""
    return any(bool((value != 0).any()) for value in load.tensors().values())


@dataclass(frozen=True, eq=False)
class Slopes:
    """How b states move with their normalised pressures, to first order.

    Attributes:
        tip: (b, D, M) of the tip's position [m].
        beyond: (b, 3 M) by how much of its width each actuator's strain leaves its characterised range at its worst
            node, and at the first and the last of its segment; negative within. Another may become the worst.
        beyond_slope: (b, 3 M, M) of that.
    """

    tip: Array
    beyond: Array
    beyond_slope: Array


class KnownSlopes:
    """Slopes of some of the states of a scene, which become more: none is worked out twice."""

    def __init__(self, scene: Problem, most: int) -> None:
        """Of so many states at most."""
        self.scene, self.known = scene, np.zeros(most, dtype=bool)
        self.slopes: tuple[Array, ...] | None = None

    def of(self, states: Batch, index: NDArray[np.intp]) -> Slopes:
        """Of states at an index (b,) into all that there are."""
        new = np.unique(index[~self.known[index]])
        if len(new) or self.slopes is None:
            found = slopes_of(self.scene, states.normalised[new], states.twists[new])
            parts = found.tip, found.beyond, found.beyond_slope
            self.slopes = self.slopes or tuple(np.empty((len(self.known), *part.shape[1:])) for part in parts)
            for every, part in zip(self.slopes, parts, strict=True):
                every[new] = part
            self.known[new] = True
        return Slopes(*(every[index] for every in self.slopes))


def slopes_of(scene: Problem, normalised: Tensor, twists: Tensor) -> Slopes:
    """The slopes at states, by their normalised pressures (b, M) and twists (b, N, K)."""
    problem = at_pressures(scene, normalised)
    rate = pressure_sensitivity(problem, twists) * scene.arm.max_pressure[:, None, None]
    beyond, slope = _range_slopes(problem, twists, rate)
    return Slopes(_tip_slope(scene, twists, rate).numpy(), beyond.numpy(), slope.numpy())


def _tip_slope(scene: Problem, twists: Tensor, rate: Tensor) -> Tensor:
    """(b, D, M), for changes (b, M, N, K) of the twists."""
    links = [None if link is None else link.end(scene.arm.dimension) for link in segments_of(scene.arm)[1]]
    with torch.enable_grad():
        at = twists.detach().clone().requires_grad_()
        poses = rod.poses(at, scene.base_pose, segment_nodes=scene.nodes, links=links)
        tip = position_of(poses[:, -1])
        rows = [torch.autograd.grad(one.sum(), at, retain_graph=True)[0] for one in tip.unbind(-1)]
    return torch.einsum("bdnk,bmnk->bdm", torch.stack(rows, 1), rate)


def _range_slopes(problem: Problem, twists: Tensor, rate: Tensor) -> tuple[Tensor, Tensor]:
    """How far strains leave their range and its slack (b, 3 M), and the slope of that (b, 3 M, M)."""
    values, slopes, node = [], [], 0
    segments = segments_of(problem.arm)[0]
    for segment, (_, beyond, width, side) in zip(segments, beyond_range(problem, twists), strict=True):
        beyond = beyond - RANGE_SLACK
        here = slice(node, node + beyond.shape[1])
        node = here.stop
        across = segment.radii if segment.dimension == 2 else segment.offsets
        change = rod.actuator_lengths(rate[:, :, here], across) / segment.length  # lengths are linear in the twists
        worst = (beyond / width).argmax(1, keepdim=True)
        ends = torch.zeros_like(worst), torch.full_like(worst, beyond.shape[1] - 1)
        some = torch.cat((worst, *ends), 1)
        values.append((beyond / width).gather(1, some).flatten(1))
        own = change * (side / width).unsqueeze(1)
        slopes.append(own.gather(2, some.unsqueeze(1).expand(-1, change.shape[1], -1, -1)).flatten(2).mT)
    return torch.cat(values, 1), torch.cat(slopes, 1)
