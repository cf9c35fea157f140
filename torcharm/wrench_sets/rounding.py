"""Distances that are no more than rounding of the wrenches from which they come are none."""

import torch
from torch import Tensor

from torcharm.statics.cross_section import CrossSections, actuator_force

ROUNDING_ULPS = 16
"""Distances of so many roundings of the largest wrench of their node are 0."""
SUSPECT_ULPS = 2**20
"""Distances of so many roundings of the loads, or of 1 N, are looked at: no set is so large as to make others 0."""


def without_rounding(
    distance: Tensor,
    sections: CrossSections,
    required: Tensor,
    scale: tuple[float, float],
    *,
    relative: bool,
) -> Tensor:
    """Distances (B, P, L, N), those of at most `ROUNDING_ULPS` of the wrenches required and provided replaced by 0.

    A straight arm with a hanging weight needs no moment but what sines leave of it, and is attainable. Of differences
    from the first node, the wrenches at both nodes count, not their difference.
    """
    with torch.no_grad():
        eps, largest = torch.finfo(distance.dtype).eps, 1 + (required.abs().amax() if required.numel() else 0.0)
        doubtful = (distance > 0) & (distance <= SUSPECT_ULPS * eps * max(scale) * largest)
        if not bool(doubtful.any()):
            return distance
        wrench = torch.maximum(_norm(required, scale), _provided(sections, scale).unsqueeze(-2))
        if relative:
            wrench = torch.maximum(wrench, wrench[..., :1])
        nothing = doubtful & (distance <= ROUNDING_ULPS * eps * wrench)
    return torch.where(nothing, 0.0, distance)


def _provided(sections: CrossSections, scale: tuple[float, float]) -> Tensor:
    """The most (B, P, N) that what actuators provide, without pressure or at their limits, may add up to."""
    strain, limit = sections.strain, sections.limit
    ends = torch.stack((torch.zeros_like(strain), limit.expand_as(strain)))
    force = actuator_force(sections.actuators, strain.expand_as(ends), ends).abs().amax(0)
    wrench = (force.unsqueeze(-1) * sections.lever.abs()).sum(-2)
    moment = (limit.unsqueeze(-1) * sections.bending.abs()).sum(-2)
    total = torch.cat((wrench[..., :1], wrench[..., 1:] + moment), -1)
    return _norm(total if sections.constant is None else total + sections.constant.abs(), scale)


def _norm(wrench: Tensor, scale: tuple[float, float]) -> Tensor:
    """Of wrenches (..., D) with their components weighted."""
    return torch.hypot(scale[0] * wrench[..., 0], scale[1] * wrench[..., 1:].norm(dim=-1))
