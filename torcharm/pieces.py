"""Reaction curves as functions of pressure, piece by piece, for methods that need more than samples.

Between its kinks a force is a smooth function of pressure. Here every smooth stretch is a cubic through
four points inside it: exact for forces that are cubic between their kinks, as the paper's are (a muscle in
extension aside), and close for others.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from torcharm.actuators import Actuator, pressure_degree, pressure_knots
from torcharm.hulls import Sections
from torcharm.wrenches import actuator_force, group_alike

EVEN_PIECES = 4
"""Pieces of a force that says nothing of itself."""

_INWARD = 1e-9  # the outer nodes lie inside their piece: at a kink the force may jump
_NODES = (_INWARD, 0.25, 0.75, 1 - _INWARD)
_FIT = torch.linalg.inv(torch.tensor([[node**j for j in range(4)] for node in _NODES], dtype=torch.float64))
_CHECKED = 0.5
AT_KINK = 1e-9
"""Within so much of a kink, as fractions of the limit, a pressure is at it."""
ROUGH = 256.0
"""Roundings by which a force may be off its cubic, halfway between the nodes, and count as one."""


@dataclass(frozen=True)
class Pieces:
    """Forces of M actuators as K cubics each, `Σ_j c_j t^j` for `u = start + width t`, t in [0, 1].

    Attributes:
        start, width: (K, M, B) fractions of the pressure limits; pieces of width 0 are padding.
        coefficients: (4, K, M, B) [N].
        rough: (K, M, B) whether the force itself is another function.
    """

    start: Tensor
    width: Tensor
    coefficients: Tensor
    rough: Tensor

    def of(self, index: Tensor) -> "Pieces":
        """Those in `index`."""
        return Pieces(*(value[..., index] for value in vars(self).values()))


def fit_pieces(sections: Sections, section: Tensor, *, relative: bool) -> Pieces:
    """The forces of sections (Q); relative: their differences from node 1's at the same pressures."""
    strain, limit = sections.strain[:, section], sections.limit[:, section]
    first = sections.at_first_node(sections.strain)[:, section] if relative else None
    groups = []
    for model, members in group_alike(sections.actuators):
        own, reference = strain[members], None if first is None else first[members]
        edges = _edges(model, own, reference, limit[members])
        groups.append((members, _fit((model,), own, reference, limit[members], edges[:-1], edges.diff(dim=0))))
    shape = (max(len(fit.start) for _, fit in groups), *strain.shape)
    whole = Pieces(
        strain.new_ones(shape),
        strain.new_zeros(shape),
        strain.new_zeros(4, *shape),
        torch.zeros(shape, dtype=torch.bool, device=strain.device),
    )
    for members, fit in groups:
        used = len(fit.start)
        whole.start[:used, members], whole.width[:used, members] = fit.start, fit.width
        whole.coefficients[:, :used, members], whole.rough[:used, members] = fit.coefficients, fit.rough
        whole.coefficients[0, used:, members] = fit.coefficients[:, -1].sum(0)
    return whole


def refit_pieces(sections: Sections, section: Tensor, start: Tensor, width: Tensor, *, relative: bool) -> Pieces:
    """Cubics on given stretches (K, M, Q) of the curves of sections (Q)."""
    strain = sections.strain[:, section]
    first = sections.at_first_node(sections.strain)[:, section] if relative else None
    return _fit(sections.actuators, strain, first, sections.limit[:, section], start, width)


def follow_kinks(sections: Sections, fraction: Tensor, *, relative: bool) -> Tensor:
    """The same fractions (E, M, B, L), of which those at a kink of their curve move with it when differentiated.

    Away from kinks a maximising pressure may be held: the derivative along it is zero. At a kink it is not.
    """
    for strain in (sections.strain, sections.at_first_node(sections.strain)) if relative else (sections.strain,):
        for model, members in group_alike(sections.actuators):
            kinks = pressure_knots(model, strain[members]) / sections.limit[members].clamp(min=1e-6)
            held = fraction.detach()[:, members]
            for kink in kinks.unsqueeze(-1):
                at_kink = ((held - kink).abs() <= AT_KINK) & (held > 0) & (held < 1)
                moved = torch.zeros_like(fraction)
                moved[:, members] = torch.where(at_kink, kink - kink.detach(), torch.zeros_like(kink))
                fraction = fraction + moved
    return fraction


def _fit(
    actuators: tuple[Actuator, ...], strain: Tensor, first: Tensor | None, limit: Tensor, start: Tensor, width: Tensor
) -> Pieces:
    """Cubics on stretches (K, m, B); of one model that stands for all m, or of m."""
    nodes = start.new_tensor((*_NODES, _CHECKED)).view(-1, 1, 1, 1)
    pressure = (start + width * nodes) * limit
    force = actuator_force(actuators, strain, pressure, dim=-2)
    if first is not None:
        force = force - actuator_force(actuators, first, pressure, dim=-2)
    coefficients = _through_nodes(force[:4])
    c0, c1, c2, c3 = coefficients
    missed = (((c3 * _CHECKED + c2) * _CHECKED + c1) * _CHECKED + c0 - force[4]).abs()
    return Pieces(start, width, coefficients, missed > ROUGH * torch.finfo(force.dtype).eps * force.abs().amax((0, 1)))


def _through_nodes(force: Tensor) -> Tensor:
    """Coefficients (4, ...) of the cubics with forces (4, ...) at the four nodes of a piece."""
    fit = _FIT.to(force.dtype).to(force.device)
    return (fit @ force.reshape(4, -1)).view(force.shape)


def _edges(model: Actuator, strain: Tensor, first: Tensor | None, limit: Tensor) -> Tensor:
    """Fractions (K + 1, m, B) of the limits between which a model's force is smooth, in order from 0 to 1."""
    knots = [pressure_knots(model, strain)]
    if first is not None:
        knots.append(pressure_knots(model, first))
    inner = torch.cat([knot / limit.clamp(min=torch.finfo(limit.dtype).tiny) for knot in knots]).clamp(0, 1)
    if not len(inner) and not _is_cubic(model):
        inner = torch.linspace(0, 1, EVEN_PIECES + 1, dtype=limit.dtype, device=limit.device)[1:-1]
        inner = inner.view(-1, 1, 1).expand(-1, *strain.shape)
    ends = torch.zeros_like(strain), torch.ones_like(strain)
    return torch.cat((ends[0][None], inner.sort(0).values, ends[1][None]))


def _is_cubic(model: Actuator) -> bool:
    degree = pressure_degree(model)
    return degree is not None and degree <= 3
