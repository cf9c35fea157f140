"""The problems: nodes of random arms on bent shapes under random loads; and their distances by certified bounds."""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

import torcharm as ta
from experiments.paper import paper_task
from torcharm.statics.cross_section import CrossSections
from torcharm.wrench_sets.design_task_grid import design_task_grid
from torcharm.wrench_sets.distance import find_nearest

DESIGNS, TASKS, NODES = 10, 20, 10
SPACES = ("plane", "space")
METRICS = ("absolute", "relative")
GRID = 4097
"""Pressures at which every curve is scanned before its largest values are refined."""
REFINEMENTS = 60
"""Steps of golden section: an interval of the grid shrinks to rounding."""
GOLDEN = (5**0.5 - 1) / 2

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Problems:
    """B designs × P tasks × NODES problems of one kind.

    Attributes:
        radii: (B, 4) or, in space, offsets (B, 4, 2) [m]; gradients are taken in them.
        length: (B, 1) [m].
        task: P shapes, each with a load.
    """

    radii: Tensor
    length: Tensor
    task: ta.Task

    def arm(self, radii: Tensor | None = None) -> ta.ArmDesign:
        """The designs, or the first of them with these places: two bellows and two muscles each."""
        where = self.radii if radii is None else radii
        models = (ta.Bellows(), ta.McKibben(), ta.McKibben(), ta.Bellows())
        places: dict[str, Any] = {"radii" if where.ndim == 2 else "offsets": where}
        return ta.ArmDesign(**places, length=self.length[: len(where)], actuators=models)

    def first(self, designs: int, tasks: int) -> "Problems":
        """Those of the first so many."""
        task = paper_task(self.task.twists[:tasks], self.task.tip_load[:tasks])
        return Problems(self.radii[:designs], self.length[:designs], task)


@cache
def problems(space: str) -> Problems:
    """All: of arms like the paper's antagonistic one; in space the four sit around the backbone."""
    rng = np.random.default_rng(5)
    flat = space == "plane"
    size = rng.uniform([0.04, 0.01], [0.10, 0.03], (DESIGNS, 2))
    outer, inner = size[:, :1], size[:, 1:]
    if flat:
        places = np.concatenate((-outer, -inner, inner, outer), 1)
    else:
        zero = np.zeros_like(outer)
        y, z = np.concatenate((-outer, zero, zero, outer), 1), np.concatenate((zero, -inner, inner, zero), 1)
        places = np.stack((y, z + rng.normal(size=z.shape) * 0.01), -1)
    shape = (TASKS, NODES, 3 if flat else 6)
    twists = np.zeros(shape)
    twists[..., 0] = 0.5
    turning = [2] if flat else [4, 5]
    start, change = rng.uniform(-3, 3, (2, TASKS, 1, len(turning)))
    twists[..., turning] = start + change * np.linspace(0, 1, NODES)[:, None]
    load = rng.uniform(-10, 10, (TASKS, shape[-1]))
    load[:, shape[-1] // 2 + flat :] *= 0.25
    radii, length = torch.from_numpy(places), torch.from_numpy(rng.uniform(0.45, 0.55, (DESIGNS, 1)))
    return Problems(radii, length, paper_task(torch.from_numpy(twists), torch.from_numpy(load)))


@cache
def reference(space: str, metric: str, designs: int = DESIGNS, tasks: int = TASKS) -> tuple[Array, Array]:
    """Lower bounds of the distances (B, P, N), which are theirs to rounding, and max|H - w|, of the first B and P.

    Of any direction n, `n·w - Σ_α max_p n·c_α(p)` is a lower bound. The engine only says in which direction to look;
    that each maximum is one is found by a scan of the models' own forces, and the difference between an answer and
    the bound is an error that the answer may have.
    """
    given, relative = problems(space).first(designs, tasks), metric == "relative"
    grid = design_task_grid(given.arm(), given.task)
    everything = slice(None)
    sections = grid.sections(0, everything, everything)
    required = grid.required(everything, everything, everything, everything)
    found = find_nearest(sections, required, (1.0, 1.0), relative=relative, signed=False, points=True)
    required = required - required[..., :1, :] if relative else required
    assert found.normal is not None
    normal, wanted = found.normal[:, :, 0], required[:, :, 0]  # (B, P, N, D): a load a shape
    support, extent = _support(sections, normal, relative=relative)
    ahead = ((normal * wanted).sum(-1) - support).clamp(min=0)
    lower = torch.where(found.distance[:, :, 0] > 0, ahead, torch.zeros_like(ahead))
    return lower.numpy(), (extent + wanted.abs().amax(-1)).numpy()


def _support(sections: CrossSections, normal: Tensor, *, relative: bool) -> tuple[Tensor, Tensor]:
    """Σ_α max_p n·c_α(p) (B, P, N), and the sum of the actuators' largest forces there."""
    total, extent = torch.zeros_like(normal[..., 0]), torch.zeros_like(normal[..., 0])
    bending = sections.bending - sections.bending[..., :1, :, :] if relative else sections.bending
    for a, model in enumerate(sections.actuators):
        strain, limit = sections.strain[..., a], sections.limit[..., a]
        by_force = (normal * sections.lever[..., a, :]).sum(-1)
        by_pressure = (normal[..., 1:] * bending[..., a, :]).sum(-1)

        def force(p: Tensor, model: ta.Actuator = model, strain: Tensor = strain) -> Tensor:
            own = model.force(strain.unsqueeze(-1).expand_as(p).contiguous(), p)
            if not relative:
                return own
            return own - model.force(strain[..., :1, None].expand_as(p).contiguous(), p)

        pressure = (torch.linspace(0, 1, GRID, dtype=strain.dtype) * limit.unsqueeze(-1)).expand(*strain.shape, GRID)
        forces = force(pressure.contiguous())
        reach = by_force.unsqueeze(-1) * forces + by_pressure.unsqueeze(-1) * pressure
        at = reach.argmax(-1, keepdim=True)
        low, high = (pressure.gather(-1, (at + side).clamp(0, GRID - 1)) for side in (-1, 1))
        best = reach.amax(-1)
        for _ in range(REFINEMENTS):
            ends = torch.cat((high - GOLDEN * (high - low), low + GOLDEN * (high - low)), -1)
            values = by_force.unsqueeze(-1) * force(ends) + by_pressure.unsqueeze(-1) * ends
            rising = values[..., 1:] > values[..., :1]
            low, high = torch.where(rising, ends[..., :1], low), torch.where(rising, high, ends[..., 1:])
            best = torch.maximum(best, values.amax(-1))
        total, extent = total + best, extent + forces.abs().amax(-1)
    return total, extent
