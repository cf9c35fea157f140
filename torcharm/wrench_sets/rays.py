"""Where rays `start + t direction` of required wrenches enter and leave attainable sets: found by the engine, evaluated
once more by torch for gradients.

A ray ends where it meets the set's supporting plane with the normal n there, `t = (h(n) - n·start) / (n·direction)`. By
the envelope theorem its gradient by everything is that of this expression with n, and the weights and pressures of the
set's points that make up h(n), held.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torcharm.engine.arms import numbers
from torcharm.engine.arrays import make
from torcharm.engine.distance import TOUCHING
from torcharm.engine.node_sets import make_scratch
from torcharm.engine.ray import Ends, Ray, ray_kernel
from torcharm.engine.threads import spread
from torcharm.statics.cross_section import CrossSections
from torcharm.wrench_sets.distance import CERTIFIED, beyond_planes, engine_sections
from torcharm.wrench_sets.once import once

BALANCED = 1e-9
"""Of the wrenches required and provided, how far apart they may be and count as one where no pressure changes either:
ten times what equilibria are solved to."""


@dataclass(frozen=True, eq=False)
class RayEnds:
    """Where the rays of B designs, P shapes, L loads and N nodes enter (first) and leave (second) the sets; no graph.

    Attributes:
        factor: (B, 2, P, L, N) t; entry above exit if the ray misses the set, infinite if it stays within.
        slack: (B, 2, P, L, N) how far off rounding may put t.
        certified: (B, 2, P, L, N) whether t is known to rounding.
        normal: (B, 2, P, L, N, C) outward unit normals; None if not asked for, like what follows.
        weight: (B, 2, P, L, N, C) of the points whose mix is where the ray ends.
        pressure: (B, 2, P, L, N, C, M) of these points [kPa].
    """

    factor: Tensor
    slack: Tensor
    certified: Tensor
    normal: Tensor | None
    weight: Tensor | None
    pressure: Tensor | None


@torch.no_grad()
def find_ends(
    sections: CrossSections,
    start: Tensor,
    direction: Tensor,
    *,
    relative: bool,
    points: bool,
    least: bool = False,
) -> RayEnds:
    """Ask the engine for the ends of rays, in float64 on the CPU.

    Args:
        sections: of B designs on P shapes, (B, P) in all.
        start: (B, P, L, N, C) the wrenches at t = 0.
        direction: (P, L, N, C) what the wrenches change by as t grows by 1.
        relative: whether all are differences from the first node.
        points: whether to tell normals, weights and pressures.
        least: whether only the least exit of all nodes matters, which is quicker: entries are infinite then, and exits
            may be that are not the least.
    """
    models, data = engine_sections(sections, (1.0, 1.0))
    begin, change = numbers(start), numbers(direction)
    designs, *rest, components = begin.shape
    shape = (2 * designs, *rest)
    actuators = data.lever.shape[-2]
    sizes = dict(zip("BPLNDM", (designs, *rest, components, actuators), strict=True)) if points else {}
    ends = make(Ends, sizes, factor=np.empty(shape), slack=np.empty(shape), gap=np.empty(shape))
    kernel, still = ray_kernel(components), _still(change, relative)

    def work(first: int, last: int) -> None:
        scratch, ray = make_scratch(models, components, change.shape[1], data.samples), make(Ray, {"D": components})
        kernel(data, begin, change, still, relative, least, first, last, scratch, ray, ends)

    spread(designs, work)
    found = [torch.from_numpy(part).to(sections.strain).unflatten(0, (-1, 2)) for part in ends if part.size or points]
    factor, slack, gap = found[:3]
    return RayEnds(factor, slack, gap <= CERTIFIED, *(found[3:] if points else (None, None, None)))


def meet_points(
    sections: CrossSections, start: Tensor, direction: Tensor, *, relative: bool
) -> tuple[Tensor, Tensor, Tensor]:
    """Entries and exits (B, P, L, N) of rays where no actuator is driven, so that each set is one point; and slacks.

    A point is met to within what an equilibrium is solved to, as passive arms are looked at where they are at rest.
    """
    point = sections.reaction(torch.zeros_like(sections.limit)).unsqueeze(-3)
    size = point.norm(dim=-1) + start.norm(dim=-1) + direction.norm(dim=-1)
    still = torch.from_numpy(_still(numbers(direction), relative)).to(size.device)
    way, change = point - start, direction
    if relative:
        way, change = way - way[..., :1, :], change - change[..., :1, :]
    length = torch.where(still, 1.0, change.norm(dim=-1))
    factor = torch.where(still, 0.0, (way * change).sum(-1) / length.square())
    near = max(BALANCED, 16 * torch.finfo(size.dtype).eps) * size
    met = (way - factor.unsqueeze(-1) * change).norm(dim=-1) <= near
    ends = [torch.where(met, torch.where(still, end, factor), -end) for end in (-torch.inf, torch.inf)]
    return ends[0], ends[1], torch.where(still, 0.0, near.detach() / length.detach())


def _still(direction: np.ndarray, relative: bool) -> np.ndarray:  # type: ignore[type-arg]
    """Which directions (P, L, N) are nothing, or nothing but rounding of what the load asks of other nodes."""
    largest = np.abs(direction).sum(-1).max(-1, keepdims=True)
    own = direction - direction[..., :1, :] if relative else direction
    return np.ascontiguousarray(np.abs(own).sum(-1) <= TOUCHING * largest)


def evaluate_ends(
    sections: CrossSections, start: Tensor, direction: Tensor, ends: RayEnds, *, relative: bool
) -> Tensor:
    """The factors (B, 2, P, L, N) as functions of what sections, starts and directions depend on, where finite."""
    assert ends.normal is not None
    assert ends.weight is not None
    assert ends.pressure is not None
    real = ends.factor.isfinite()
    change = direction - direction[..., :1, :] if relative else direction
    found = []
    for side in (0, 1):
        normal = torch.where(real[:, side, ..., None], ends.normal[:, side], 0.0)
        beyond = beyond_planes(sections, start, normal, ends.weight[:, side], ends.pressure[:, side], relative=relative)
        rate = (normal * change).sum(-1)
        found.append(-beyond / torch.where(rate == 0, torch.ones_like(rate), rate))
    return once(torch.where(real, torch.stack(found, 1), ends.factor))
