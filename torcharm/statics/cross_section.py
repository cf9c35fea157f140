"""Cross-sections: from the backbone's strains to what actuators do there. The only place that sums over actuators.

At a node actuator α provides, at pressure p, the wrench `f_α(ε_α, p) u_α + p t_α` and a constant moment, in the
components that pressures can change: `(f_x, m)` in the plane, `(f_x, m_y, m_z)` in space. Its lever is
`u = (1, -r)` or `(1, z, -y)`; t comes from its bending stiffness. The paper prints `+r`; virtual work
(`∂l_α/∂κ = -r_α`) asks for the minus. Of a built actuator u and t bear the factors by which its force and its bending
moments deviate from the model's.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from torcharm.actuators import Actuator
from torcharm.actuators.bending import (
    active_moment,
    linear_stiffness,
    passive_moment,
    reference_pressure,
)
from torcharm.actuators.deviation import added_force
from torcharm.actuators.inspection import same_model
from torcharm.actuators.protocol import sampled_of
from torcharm.arm import ArmDesign
from torcharm.geometry.rod import material_curvature, offset_length, strain
from torcharm.inputs import (
    TensorLike,
    as_floating,
    broadcast_shapes,
    check_finite,
    check_pressure,
    check_tensor,
    one_for_all,
)

RANGE_SLACK = 1e-3
"""A strain beyond its characterised range by so little, or a pressure by so large a part of itself, is at its end: no
grip and no sensor of a bench tells it from the end, and no force changes by it; rounding is far less."""
STRAIGHT = 1e-8
"""A curvature [rad/m] below which the direction of bending in space is of no matter: it keeps its length from 0."""


@dataclass(frozen=True, eq=False)
class CrossSections:
    """M actuators at the nodes of shapes; D components are those of hull wrenches, 2 or 3.

    Attributes:
        actuators: M force models.
        strain: (..., N, M) ε.
        lever: (..., 1, M, D) u, the wrench of a model's force of 1 N [-, m].
        bending: (..., N, M, D-1) t, the moments of a pressure of 1 kPa [N·m/kPa].
        constant: (..., N, D) the wrench that no pressure changes, of all actuators [N, N·m]; None is none.
        limit: (..., 1, M) pressure limits [kPa].
        powers, terms: of what is added to the models' forces, as of `ForceDeviation`; terms (..., 1, M).
    """

    actuators: tuple[Actuator, ...]
    strain: Tensor
    lever: Tensor
    bending: Tensor
    constant: Tensor | None
    limit: Tensor
    powers: tuple[tuple[int, int], ...] = ()
    terms: tuple[Tensor, ...] = ()

    def force(self, pressure: Tensor) -> Tensor:
        """The axial forces (..., N, M) [N] that levers turn into wrenches, at pressures (..., N or 1, M) [kPa]."""
        force = actuator_force(self.actuators, self.strain, pressure)
        return force + added_force(self.powers, self.terms, self.strain, pressure) if self.terms else force

    def reaction(self, pressure: Tensor) -> Tensor:
        """The wrenches (..., N, D) that pressures (..., N or 1, M) [kPa] provide."""
        wrench = (self.force(pressure).unsqueeze(-1) * self.lever).sum(-2)
        moment = (pressure.unsqueeze(-1) * self.bending).sum(-2)
        total = torch.cat((wrench[..., :1].expand(*moment.shape[:-1], 1), wrench[..., 1:] + moment), -1)
        return total if self.constant is None else total + self.constant

    def for_many(self) -> "CrossSections":
        """The same with a dimension (..., N, 1, M) added for several pressures a node."""
        constant = None if self.constant is None else self.constant.unsqueeze(-2)
        alike = {name: getattr(self, name).unsqueeze(-2) for name in ("strain", "limit")}
        return replace(
            self, **alike, lever=self.lever.unsqueeze(-3), bending=self.bending.unsqueeze(-3), constant=constant
        )

    def first(self) -> "CrossSections":
        """The same of the first node (..., 1, M) alone."""
        constant = None if self.constant is None else self.constant[..., :1, :]
        return replace(self, strain=self.strain[..., :1, :], bending=self.bending[..., :1, :, :], constant=constant)

    def for_sets(self) -> "CrossSections":
        """The same, with offsets of forces in the constant wrench: sets know the forces of models, and that.

        Raises:
            ValueError: terms of forces depend on strain or pressure.
        """
        if not self.terms:
            return self
        if any(power != (0, 0) for power in self.powers):
            raise ValueError(
                "metrics: must be predicted_error alone for arms whose force models have scattered coefficients, "
                "which attainable sets do not know"
            )
        offset = (torch.stack(torch.broadcast_tensors(*self.terms)).sum(0).unsqueeze(-1) * self.lever).sum(-2)
        return replace(self, constant=offset if self.constant is None else self.constant + offset, powers=(), terms=())


def cross_sections(arm: ArmDesign, twists: Tensor) -> CrossSections:
    """The sections of designs (*#batch) on shapes (*#batch, N, 3 or 6)."""
    y, neutral = arm.radii.unsqueeze(-2), arm.length.unsqueeze(-2)
    length, one = twists[..., :1], torch.ones_like(y)
    if twists.shape[-1] == 3:
        own_length = offset_length(length, twists[..., 2:], y)
        lever, turn = torch.stack((one, -y), -1), twists[..., 2:]
    else:
        z = torch.zeros_like(y) if arm.out_of_plane is None else arm.out_of_plane.unsqueeze(-2)
        own_length = offset_length(length, twists[..., 5:], y, twists[..., 4:5], z)
        lever, turn = torch.stack((one, z, -y), -1), twists[..., 4:]
    curvature = torch.stack([material_curvature(k, own_length, neutral) for k in turn.split(1, -1)], -1)
    own_strain, limit, deviation = strain(own_length, neutral), arm.max_pressure.unsqueeze(-2), arm.deviation
    if deviation is None:
        return CrossSections(arm.actuators, own_strain, lever, *_bending(arm.actuators, curvature), limit)
    bending, constant = _bending(arm.actuators, curvature, deviation.bending_scale.unsqueeze(-2))
    lever = deviation.force_scale[..., None, :, None] * lever
    terms = tuple(term.unsqueeze(-2) for term in deviation.terms)
    return CrossSections(arm.actuators, own_strain, lever, bending, constant, limit, deviation.powers, terms)


def _bending(
    actuators: tuple[Actuator, ...], curvature: Tensor, scale: Tensor | None = None
) -> tuple[Tensor, Tensor | None]:
    """Moments a kPa (..., M, D-1), and the wrench that no pressure changes (..., D), at material curvatures; moments
    times a scale (..., 1, M)."""
    reference = [reference_pressure(model.bending_stiffness, model.max_pressure) for model in actuators]
    linear = [linear_stiffness(model.bending_stiffness) for model in actuators]
    if None not in linear:
        rate = per_actuator([k / p for k, p in zip(linear, reference, strict=True) if k is not None], curvature)
        active = rate.unsqueeze(-1) * curvature
    else:
        moments = [
            _along(curvature[..., a, :], partial(active_moment, model.bending_stiffness))
            for a, model in enumerate(actuators)
        ]
        active = torch.stack([m / p for m, p in zip(moments, reference, strict=True) if m is not None], -2)
    constant = None
    for a, model in enumerate(actuators):
        moment = _along(curvature[..., a, :], partial(passive_moment, model.bending_stiffness))
        if moment is not None:
            moment = moment if scale is None else scale[..., a, None] * moment
            constant = moment if constant is None else constant + moment
    constant = None if constant is None else torch.nn.functional.pad(constant, (1, 0))
    return active if scale is None else scale.unsqueeze(-1) * active, constant


def _along(curvature: Tensor, law: Callable[[Tensor], Tensor | None]) -> Tensor | None:
    """The moments (..., D-1) of a law of one curvature. In space it is the same for all directions of bending."""
    planar = curvature.shape[-1] == 1
    size = curvature.squeeze(-1) if planar else (curvature.square().sum(-1) + STRAIGHT**2).sqrt()
    moment = law(size)
    if moment is None:
        return None
    return moment.unsqueeze(-1) if planar else (moment / size).unsqueeze(-1) * curvature


def per_actuator(values: Sequence[float | Tensor], like: Tensor) -> Tensor:
    """Numbers, some of which may be tensors with graphs, as one row."""
    if any(isinstance(value, Tensor) for value in values):
        return torch.stack([torch.as_tensor(value, dtype=like.dtype, device=like.device).squeeze() for value in values])
    return like.new_tensor(values)


def characterised_range(actuators: Sequence[Actuator], own_strain: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The ends (M) of actuators' characterised ranges of strain, and how far strains (..., M) lie beyond the nearer
    one; negative within."""
    low, high = (per_actuator([model.strain_range[end] for model in actuators], own_strain) for end in (0, 1))
    return low, high, torch.maximum(low - own_strain, own_strain - high)


def actuator_force(actuators: tuple[Actuator, ...], own_strain: Tensor, pressure: Tensor) -> Tensor:
    """Axial forces (..., M) [N]. Models that are the same are asked together: the cost follows the number of kinds.

    Raises:
        ValueError: a model has no force for tensors.
    """
    groups = group_alike(actuators)
    parts, places = [], [_as_slice(members) for _, members in groups]
    for (model, members), place in zip(groups, places, strict=True):
        own = (own_strain, pressure) if len(groups) == 1 else (own_strain[..., place], pressure[..., place])
        parts.append(sampled_of(f"actuators[{members[0]}].force", _force_of, model, *own))
    if len(groups) == 1:
        return parts[0]
    force = parts[0].new_empty(torch.broadcast_shapes(own_strain.shape, pressure.shape))
    for place, part in zip(places, parts, strict=True):
        force[..., place] = part
    return force


def _force_of(model: Actuator, strain: Tensor, pressure: Tensor) -> Tensor:
    return model.force(strain, pressure).expand(torch.broadcast_shapes(strain.shape, pressure.shape))


def group_alike(actuators: Sequence[Actuator]) -> list[tuple[Actuator, list[int]]]:
    """Each kind of model, and where it sits."""
    groups: list[tuple[Actuator, list[int]]] = []
    for index, model in enumerate(actuators):
        for known, members in groups:
            if same_model(known, model):
                members.append(index)
                break
        else:
            groups.append((model, [index]))
    return groups


def _as_slice(members: list[int]) -> slice | list[int]:
    """The same places as a slice, which costs no copy, if they are evenly spaced."""
    step = members[1] - members[0] if len(members) > 1 else 1
    evenly = slice(members[0], members[-1] + 1, step)
    return evenly if list(range(members[-1] + 1))[evenly] == members else members


def reaction_wrench(
    arm: ArmDesign, twists: Float[Tensor, "*#batch N K"], pressure: TensorLike
) -> Float[Tensor, "... N D"]:
    """Reaction of each node to pressures [kPa], in the node's frame: `(f_x, m)` or, in space, `(f_x, m_y, m_z)`.

    `f_x = Σ f_α(ε_α, p_α)`, `m = Σ (-r_α f_α + τ_α)`; in space `m_y = Σ (z_α f_α + τ_α,y)` and
    `m_z = Σ (-y_α f_α + τ_α,z)` [N, N·m].

    Args:
        arm: (...) designs, of one segment.
        twists: (..., N, 3) or (..., N, 6) [m, rad].
        pressure: (..., M) one for each actuator, or one for all [kPa].

    Raises:
        ValueError: a pressure is negative or not finite, or shapes do not fit.

    Example:
        >>> arm, straight = ta.bellows_arm(), ta.constant_curvature(0.0, length=0.5, nodes=1)
        >>> ta.reaction_wrench(arm, straight, [50.0, 50.0, 0.0, 0.0]).round(decimals=1).tolist()  # would bend it left
        [[88.8, 4.2]]
    """
    check_tensor("twists", twists, "N", 3 if arm.dimension == 2 else 6)
    given, _ = as_floating(pressure=pressure, radii=arm.radii)
    given = one_for_all(given, arm.actuator_count)
    check_tensor("pressure", given, arm.actuator_count)
    broadcast_shapes(twists=twists.shape[:-2], pressure=given.shape[:-1], radii=arm.batch_shape)
    check_finite("pressure", given)
    check_pressure("pressure", given)
    return cross_sections(arm, twists).reaction(given.unsqueeze(-2))
