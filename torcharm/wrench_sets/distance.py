"""Distances of required wrenches from attainable sets: found by the engine, evaluated once more by torch for gradients.

At the nearest point the distance is `n·w - Σ_k λ_k Σ_α (n·u_α) f_α(ε_α, p_kα) + (n·t_α) p_kα`. By the envelope theorem
its gradient by everything, parameters of force models too, is that of this expression with the normal n, the weights λ
and the pressures p held (those at a limit or at a model's kink move with it).
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torcharm.actuators import Actuator, pressure_knots
from torcharm.actuators.protocol import sampled_of
from torcharm.engine.arms import numbers
from torcharm.engine.arrays import make
from torcharm.engine.curves import Samples
from torcharm.engine.forces import SAMPLED, Models, models_of
from torcharm.engine.node_sets import Answers, Sections, distance_kernel, make_scratch
from torcharm.engine.threads import spread
from torcharm.statics.cross_section import CrossSections, actuator_force, group_alike
from torcharm.wrench_sets.curves import Curves, as_samples, sample_curves

CERTIFIED = 1e-8
"""The gap, as a part of a problem's size, up to which a distance counts as known: what rounding leaves in bad cases."""
OFF = 5e-7
"""By this part of a problem's size a distance by cubic pieces may be off that by the forces at the points found: more,
and a model that only torch knows bends too much for its pieces."""
KINK = 1e-6
"""How near to a kink, as a part of the limit, a pressure counts as held by it."""


@dataclass(frozen=True, eq=False)
class NearestPoints:
    """Where required wrenches stand to the sets of B designs, P shapes, L loads and N nodes; without a graph.

    Attributes:
        distance: (B, P, L, N), 0 inside or, signed, negative.
        certified: (B, P, L, N) whether the distance is known to rounding.
        normal: (B, P, L, N, C) unit normals of the weighted components; None if not asked for, like what follows.
        weight: (B, P, L, N, C) of the points whose mix is nearest.
        pressure: (B, P, L, N, C, M) of these points [kPa].
        size: (B, P, L, N) the most that the numbers in a problem can add up to [N].
    """

    distance: Tensor
    certified: Tensor
    normal: Tensor | None
    weight: Tensor | None
    pressure: Tensor | None
    size: Tensor | None = None

    def known(self, value: Tensor) -> Tensor:
        """Whether distances are known to rounding, and forces at the points found agree: `value` is by these."""
        if self.size is None:
            return self.certified
        off = max(OFF, 64 * torch.finfo(value.dtype).eps)
        return self.certified & ((value.detach() - self.distance).abs() <= off * self.size)


@torch.no_grad()
def find_nearest(
    sections: CrossSections,
    required: Tensor,
    scale: tuple[float, float],
    *,
    relative: bool,
    signed: bool,
    points: bool,
    samples: Samples | None = None,
) -> NearestPoints:
    """Ask the engine for distances, in float64 on the CPU.

    Args:
        sections: of B designs on P shapes, (B, P) in all.
        required: (B, P, L, N, C) what is asked of them [N, N·m].
        scale: factors on force and moment.
        relative: whether of differences from the first node.
        signed: whether inside counts as negative.
        points: whether to tell normals, weights and pressures.
        samples: as of `sampled`, if they are known.
    """
    shape, components, actuators = required.shape[:-1], required.shape[-1], sections.strain.shape[-1]
    models, data = engine_sections(sections, scale, samples)
    wanted = numbers(required) * components_scale(scale, components)
    sizes = dict(zip("BPLNDM", (*shape, components, actuators), strict=True)) if points else {}
    answers = make(Answers, sizes, distance=np.empty(shape), gap=np.empty(shape))
    kernel = distance_kernel(components, signed)

    def work(first: int, last: int) -> None:
        scratch = make_scratch(models, components, shape[2], data.samples)
        kernel(data, wanted, relative, first, last, scratch, answers)

    spread(shape[0], work)
    found = [torch.from_numpy(part).to(sections.strain) for part in answers]
    certified = (found[1] <= CERTIFIED) & found[0].isfinite()
    return NearestPoints(found[0], certified, *(found[2:] if points else (None, None, None, None)))


def engine_sections(
    sections: CrossSections, scale: tuple[float, float], samples: Samples | None = None
) -> tuple[Models, Sections]:
    """The force models, and sections (B, P), as the engine takes them."""
    designs, shapes, nodes, actuators = sections.strain.shape
    components = sections.lever.shape[-1]
    factors = components_scale(scale, components)
    models = models_of(sections.actuators)
    constant = sections.constant
    constant = sections.strain.new_zeros(designs, shapes, nodes, components) if constant is None else constant
    return models, Sections(
        numbers(sections.limit.expand(designs, 1, 1, actuators).reshape(designs, actuators)),
        numbers(sections.strain),
        numbers(sections.lever.expand(designs, 1, 1, actuators, components).reshape(designs, actuators, -1)) * factors,
        numbers(sections.bending.expand(designs, shapes, nodes, actuators, components - 1)) * scale[1],
        numbers(constant.expand(designs, shapes, nodes, components)) * factors,
        sampled(sections) if samples is None else samples,
    )


def components_scale(scale: tuple[float, float], components: int) -> np.ndarray:  # type: ignore[type-arg]
    """Factors on the components of a wrench, from those on force and moment."""
    return np.array([scale[0]] + [scale[1]] * (components - 1))


@torch.no_grad()
def sampled(sections: CrossSections) -> Samples:
    """Curves of the actuators that the engine does not know: the same for all that is asked of the sections."""
    kind = models_of(sections.actuators).kind
    found: list[Curves | None] = [None] * len(kind)
    limit = sections.limit.expand_as(sections.strain)
    for model, own in group_alike(sections.actuators) if (kind == SAMPLED).any() else ():
        if kind[own[0]] != SAMPLED:
            continue
        strains, limits = (x[..., own].movedim(-1, 0).flatten() for x in (sections.strain, limit))
        curves = sampled_of(f"actuators[{own[0]}].force", sample_curves, model, strains, limits)
        each = strains.numel() // len(own)
        for j, a in enumerate(own):
            mine = slice(j * each, (j + 1) * each)
            rest = None if curves.rest is None else curves.rest[mine]
            found[a] = Curves(curves.pieces if curves.grid is not None else curves.pieces[mine], curves.grid, rest)
    return as_samples(found)


def evaluate_distance(
    sections: CrossSections,
    required: Tensor,
    scale: tuple[float, float],
    nearest: NearestPoints,
    *,
    relative: bool,
) -> Tensor:
    """The distances (B, P, L, N) as functions of what sections and requirements depend on; 0 where they are 0."""
    assert nearest.normal is not None
    assert nearest.weight is not None
    assert nearest.pressure is not None
    normal = nearest.normal * nearest.normal.new_tensor(components_scale(scale, nearest.normal.shape[-1]))
    nothing = nearest.distance == 0
    weight = torch.where(nothing.unsqueeze(-1), 0.0, nearest.weight)
    distance = beyond_planes(sections, required, normal, weight, nearest.pressure, relative=relative)
    # By forces that pieces only come near, a point barely outside may be inside, and the other way round.
    other_side = torch.where(nearest.distance < 0, distance >= 0, distance <= 0)
    return torch.where(nothing | other_side, torch.zeros_like(distance), distance)


def beyond_planes(
    sections: CrossSections,
    required: Tensor,
    normal: Tensor,
    weight: Tensor,
    held: Tensor,
    *,
    relative: bool,
) -> Tensor:
    """How far (B, P, L, N) required wrenches lie beyond the planes with given normals through points of the sets.

    Args:
        normal: (B, P, L, N, C), of unscaled components.
        weight: (B, P, L, N, C) of the points whose mixes the planes go through.
        held: (B, P, L, N, C, M) their pressures [kPa]; those at limits and kinks move with these.
    """
    bending, constant = sections.bending, sections.constant
    if relative:
        required, bending = required - required[..., :1, :], bending - bending[..., :1, :, :]
        constant = None if constant is None else constant - constant[..., :1, :]
    force, pressure = _mixed(sections, weight, held, relative=relative)
    distance = (normal * required).sum(-1)
    for c, own in enumerate(normal.unbind(-1)):
        provided = (force * sections.lever[..., c].unsqueeze(-3)).sum(-1)
        if c > 0:
            provided = provided + (pressure * bending[..., c - 1].unsqueeze(-3)).sum(-1)
        distance = distance - own * provided
    if constant is not None:
        distance = distance - (normal * constant.unsqueeze(-3)).sum(-1)
    return distance


def _mixed(sections: CrossSections, weight: Tensor, pressure: Tensor, *, relative: bool) -> tuple[Tensor, Tensor]:
    """Forces and pressures (B, P, L, N, M) of points (B, P, L, N, C, M), mixed by weights (B, P, L, N, C).

    Most points have no pressure or the limit: the forces there are worked out once for all loads, and one by one only
    those between.
    """
    strain, limit = sections.strain, sections.limit
    bound, share = limit.detach().unsqueeze(-3).unsqueeze(-2), weight.unsqueeze(-1)
    empty = pressure <= 0
    full = (pressure >= bound) & ~empty
    ends = torch.stack((torch.zeros_like(strain), limit.expand_as(strain)))
    at_ends = actuator_force(sections.actuators, strain.expand_as(ends), ends)
    if relative:
        first = strain[..., :1, :].expand_as(strain)
        at_ends = at_ends - actuator_force(sections.actuators, first.expand_as(ends), ends)
    filled = torch.where(full, share, 0.0).sum(-2)
    force = torch.where(empty, share, 0.0).sum(-2) * at_ends[0].unsqueeze(-3) + filled * at_ends[1].unsqueeze(-3)
    mixed = filled * limit.unsqueeze(-3)
    between = ~(empty | full) & (share != 0)
    if not bool(between.any()):
        return force, mixed
    b, p, l, n, c, a = between.nonzero(as_tuple=True)
    own_weight, own_pressure = weight[b, p, l, n, c], pressure[b, p, l, n, c, a]
    forces, pressures = force.new_empty(len(a)), force.new_empty(len(a))
    for model, members in group_alike(sections.actuators):
        inside = torch.zeros(len(sections.actuators), dtype=torch.bool, device=a.device)
        inside[members] = True
        own = inside[a].nonzero().squeeze(-1)
        where = b[own], p[own], a[own]
        strains = [strain[where[0], where[1], n[own], where[2]]]
        strains += [strain[where[0], where[1], 0, where[2]]] if relative else []
        held = _held(model, strains, own_pressure[own], limit.expand(len(strain), 1, 1, -1)[where[0], 0, 0, where[2]])
        found = [model.force(one, held).expand_as(held) for one in strains]
        forces = forces.index_copy(0, own, found[0] - found[1] if relative else found[0])
        pressures = pressures.index_copy(0, own, held)
    place = (((b * force.shape[1] + p) * force.shape[2] + l) * force.shape[3] + n) * force.shape[4] + a
    return _added(force, place, own_weight * forces), _added(mixed, place, own_weight * pressures)


def _added(total: Tensor, place: Tensor, value: Tensor) -> Tensor:
    """A tensor with values added at places of its flat form."""
    return total.flatten().index_add(0, place, value).view_as(total)


def _held(model: Actuator, strains: list[Tensor], pressure: Tensor, limit: Tensor) -> Tensor:
    """Pressures (K,) of one model: those as near as kinks to a limit move with it, and those at kinks with these."""
    near = KINK * limit.detach()
    at = torch.where(limit.detach() - pressure <= near, pressure / limit.detach() * limit, pressure)
    for strain in strains:
        knots = pressure_knots(model, strain) if strain.requires_grad else strain.new_zeros(0)
        for knot in knots if knots.requires_grad else ():
            moved = torch.where((pressure - knot.detach()).abs() <= near, knot - knot.detach(), 0.0)
            at = at + moved
    return at
