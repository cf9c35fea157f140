"""Squared distances to faces that are known by their pressures, with gradients in closed form.

Of a point w nearest to `y = (1 - s) y_0 + s y_1` on a face, `d|w - y|² = 2 (w - y)·(dw - (1 - s) dy_0 - s dy_1)`:
pressures maximise along the face's normal, and s minimises, so neither's own move counts. At a kink of a
force, where `f(ε, p)` passes from one function to another as p rises, a pressure follows the kink instead.
"""

from dataclasses import dataclass, replace
from typing import no_type_check

import torch
from torch import Tensor

from torcharm.hulls import Sections
from torcharm.pieces import follow_kinks
from torcharm.polygon import face_square
from torcharm.wrenches import actuator_slopes

ASIDE = 1e-9
"""How far on either side of a kink, relative to its pressure, the force is looked at."""
OWN = 1e-3
"""A kink is that of the force whose slope changes most there, and of those that change by this share of it."""

Pair = tuple[Tensor, Tensor]


@dataclass(frozen=True)
class Faces:
    """Nearest faces of points (B, L).

    Attributes:
        fraction: (2, M, B, L) pressure fractions at the ends.
        kinked: (2, M, B, L) whether these are at a kink; None: nowhere.
        scale: factors on force and moment.
        relative: whether of differences from node 1.
    """

    fraction: Tensor
    kinked: Tensor | None
    scale: tuple[float, float]
    relative: bool


@dataclass(frozen=True)
class _Slopes:
    """Forces (2, M, B, L) at the faces' ends, and their derivatives.

    Attributes:
        force: [N]; relative: differences from node 1's.
        by_strain: by the section's own strains, and relative by node 1's, which count negative.
        by_pressure: [N/kPa].
        kink: of pressures that follow a kink, its derivatives in those strains [kPa], else 0; None: there is none.
    """

    force: Tensor
    by_strain: tuple[Tensor, ...]
    by_pressure: Tensor
    kink: tuple[Tensor, ...] | None


def face_squares(sections: Sections, point: Pair, faces: Faces) -> Tensor:
    """Squared distances (B, L), differentiable twice: first derivatives in closed form, second ones through the forces.

    Args:
        sections: the actuators, with or without a graph.
        point: scaled, as two tensors (B, L).
        faces: their nearest.
    """
    resting = sections.resting_moment(relative=faces.relative)
    answer: Tensor = _FaceSquares.apply(
        sections, faces, sections.strain, sections.bending, sections.radii, sections.limit, resting, *point
    )
    return answer


def _replayed(sections: Sections, point: Pair, faces: Faces, resting: Tensor | None) -> Tensor:
    """The same through the force models, operation by operation."""
    fraction = follow_kinks(sections, faces.fraction, relative=faces.relative)
    x, y = sections.wrench(fraction, relative=faces.relative)
    y = y if resting is None else y + resting.unsqueeze(-1)
    x, y = faces.scale[0] * x, faces.scale[1] * y
    return face_square(point, (x[0], y[0]), (x[1], y[1]))


def _slopes(sections: Sections, faces: Faces) -> _Slopes:
    strain, pressure = sections.strain.unsqueeze(-1), faces.fraction * sections.limit.unsqueeze(-1)
    strains = [strain]
    if faces.relative:
        strains.append(sections.at_first_node(sections.strain).unsqueeze(-1))
    off = 0.0 if faces.kinked is None else ASIDE * pressure * faces.kinked
    pressures = [pressure] if faces.kinked is None else [pressure - off, pressure + off]
    sides, count = len(pressures), len(strains)
    # All that differs goes along the second dimension: one call for each kind of force.
    at = torch.stack(pressures).unsqueeze(1).expand(sides, count, *pressure.shape)
    of = torch.stack(strains).unsqueeze(1).expand(at.shape)
    force, by_strain, by_pressure = actuator_slopes(sections.actuators, of.contiguous(), at, True, dim=-3)
    assert by_pressure is not None
    left, pull, kink = force[0], by_pressure[0], None
    if faces.kinked is not None:
        # On either side the force is the same function's all along the kink: so its two derivatives there agree.
        jump = by_pressure[1] - pull
        sharp = faces.kinked & (jump.abs() > OWN * jump.abs().amax(0)) & (jump != 0)
        kink = ((by_strain[0] - by_strain[1]) / torch.where(sharp, jump, 1.0) * sharp).unbind(0)
        left = left + pull * off
    if count == 1:
        return _Slopes(left[0], by_strain[0].unbind(0), pull[0], kink)
    return _Slopes(left[0] - left[1], by_strain[0].unbind(0), pull[0] - pull[1], kink)


class _FaceSquares(torch.autograd.Function):
    """`face_squares` of sections, from what they hold."""

    @staticmethod
    @no_type_check
    def forward(ctx, sections, faces, strain, bending, radii, limit, resting, x, y):
        slopes = _slopes(sections, faces)
        moment_rate = bending - sections.at_first_node(bending) if faces.relative else bending
        fraction, (scale_x, scale_y) = faces.fraction, faces.scale
        end_x = scale_x * slopes.force.sum(1)
        moment = moment_rate.unsqueeze(-1) * fraction - radii.unsqueeze(-1) * slopes.force
        end_y = scale_y * (moment.sum(1) if resting is None else moment.sum(1) + resting.unsqueeze(-1))
        edge_x, edge_y, from_x, from_y = end_x[1] - end_x[0], end_y[1] - end_y[0], x - end_x[0], y - end_y[0]
        span = edge_x * edge_x + edge_y * edge_y
        share = (from_x * edge_x + from_y * edge_y) / span.clamp(min=torch.finfo(span.dtype).tiny)
        share = share.clamp(0, 1)
        off_x, off_y = from_x - share * edge_x, from_y - share * edge_y
        ctx.sections, ctx.faces = sections, faces
        ctx.kept = slopes, moment_rate, share, off_x, off_y
        ctx.save_for_backward(strain, bending, radii, limit, resting, x, y)
        return off_x * off_x + off_y * off_y

    @staticmethod
    @no_type_check
    def backward(ctx, slope):
        strain, bending, radii, limit, resting, x, y = ctx.saved_tensors
        held = (strain, bending, radii, limit, resting, x, y)
        wanted = ctx.needs_input_grad[2:]
        if torch.is_grad_enabled():
            own = replace(ctx.sections, strain=strain, bending=bending, radii=radii, limit=limit, resting=None)
            value = _replayed(own, (x, y), ctx.faces, resting)
            leaves = [one for one, want in zip(held, wanted, strict=True) if want]
            found = iter(torch.autograd.grad(value, leaves, slope, create_graph=True, allow_unused=True))
            return None, None, *(next(found) if want else None for want in wanted)
        return None, None, *_pulled(ctx, slope, radii, limit, wanted)


@no_type_check
def _pulled(ctx, slope, radii, limit, wanted):
    """Derivatives in closed form, of what is wanted: strains, moments, radii, limits, moment at rest, points."""
    slopes, moment_rate, share, off_x, off_y = ctx.kept
    sections, faces = ctx.sections, ctx.faces
    fraction, (scale_x, scale_y) = faces.fraction, faces.scale
    pull_x, pull_y = 2 * slope * off_x, 2 * slope * off_y
    weight = torch.stack((share - 1, -share))
    end_x, end_y = (scale_x * weight * pull_x).unsqueeze(1), (scale_y * weight * pull_y).unsqueeze(1)
    by_force = end_x - radii.unsqueeze(-1) * end_y
    of_moment = end_y * fraction  # by the moment at the limit

    def total(value):
        return value.sum((0, -1))

    def from_first(value):
        """Of (M, B), what falls to node 1 of each arm: the sum over its nodes."""
        by_node = value.unflatten(-1, sections.shape)
        spread = torch.zeros_like(by_node)
        spread[..., :1, :] = by_node.sum(-2, keepdim=True)
        return spread.flatten(-3)

    by_fraction = end_y * moment_rate.unsqueeze(-1) + by_force * slopes.by_pressure * limit.unsqueeze(-1)
    least_limit = limit.clamp(min=torch.finfo(limit.dtype).tiny).unsqueeze(-1)
    found = [None] * 7
    if wanted[0]:
        parts = [by_force * own for own in slopes.by_strain]
        if slopes.kink is not None:
            signs = (1, -1)
            moved = by_fraction / least_limit
            parts = [part + sign * moved * own for part, sign, own in zip(parts, signs, slopes.kink, strict=False)]
        found[0] = total(parts[0])
        if len(parts) > 1:
            found[0] = found[0] - from_first(total(parts[1]))
    if wanted[1]:
        found[1] = total(of_moment)
        if faces.relative:
            found[1] = found[1] - from_first(found[1])
    if wanted[2]:
        found[2] = -total(end_y * slopes.force)
    if wanted[3]:
        held = by_force * slopes.by_pressure * fraction
        if faces.kinked is not None:  # the pressure at a kink does not change with the limit, its share does
            held = held - faces.kinked * by_fraction * fraction / least_limit
        found[3] = total(held)
    if wanted[4]:
        found[4] = end_y.sum((0, 1, -1))
    if wanted[5]:
        found[5] = pull_x
    if wanted[6]:
        found[6] = pull_y
    return found
