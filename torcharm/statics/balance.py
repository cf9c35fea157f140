"""The balance of every element: what its section provides, less what its loads require.

`R = a - w` in the components z in which the arm gives way: lengths and bending curvatures, κ_x of an arm with
stiffness against torsion, shear of one with stiffness against shear. In torch, differentiable in everything; the engine
solves the same balance for the models that it knows.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries, segments_of, with_slices
from torcharm.load import ExternalLoad
from torcharm.statics.cross_section import CrossSections, cross_sections
from torcharm.statics.external_load import arm_wrench

RIGID = 1e30
"""Stiffness against torsion [N·m²] of a segment that does not twist in an arm that does: by it no load of this world
twists a segment by what rounding leaves of a number, and its products stay finite."""


def link_ends(arm: ArmDesign | ArmSeries) -> list[Tensor | None]:
    """Poses of the ends of an arm's links in the frames of their starts."""
    return [None if link is None else link.end(arm.dimension) for link in segments_of(arm)[1]]


def unknown_columns(arm: ArmDesign | ArmSeries, shear_stiffness: float | None) -> tuple[int, ...]:
    """The columns of a twist in which an arm gives way, in ascending order."""
    sheared = shear_stiffness is not None
    if arm.dimension == 2:
        return (0, 1, 2) if sheared else (0, 2)
    twisted = any(segment.torsion_stiffness is not None for segment in segments_of(arm)[0])
    return (0, *((1, 2) if sheared else ()), *((3,) if twisted else ()), 4, 5)


def balance_residual(
    arm: ArmDesign | ArmSeries,
    twists: Tensor,
    pressure: Tensor,
    load: ExternalLoad,
    base_pose: Tensor,
    nodes: Sequence[int],
    wrench_at: str,
    shear_stiffness: float | None = None,
) -> Tensor:
    """R (..., N, C) [N, N·m] at twists (..., N, 3 or 6) and pressures (..., M) [kPa].

    Args:
        arm: designs whose batch broadcasts.
        twists: of the elements, segment after segment [m, rad].
        pressure: of the actuators, segment after segment.
        load: all that loads the arm.
        base_pose: (..., 3) or (..., 4, 4).
        nodes: number of elements of each segment.
        wrench_at: "start" or "middle", as of `required_wrench`.
        shear_stiffness: k [N/m] of each actuator, for the reaction `-k Σ_α γ`; None is rigid.
    """
    required = arm_wrench(arm, twists, load, base_pose, wrench_at, nodes)
    columns = list(unknown_columns(arm, shear_stiffness))
    shapes = zip(with_slices(segments_of(arm)[0]), twists.split(list(nodes), -2), strict=True)
    parts = [
        segment_reaction(segment, shape, pressure[..., None, own], shear_stiffness)[..., columns]
        for (segment, own), shape in shapes
    ]
    batch = torch.broadcast_shapes(*(part.shape[:-2] for part in parts))
    return torch.cat([part.expand(*batch, *part.shape[-2:]) for part in parts], -2) - required[..., columns]


def segment_reaction(segment: ArmDesign, twists: Tensor, pressure: Tensor, shear_stiffness: float | None) -> Tensor:
    """What one segment's sections provide (..., N, 3 or 6) at pressures (..., N or 1, M); 0 in the components that are
    constraints."""
    sections = cross_sections(segment, twists)
    force, *moments = sections.reaction(pressure).unbind(-1)
    stiffness = 0.0 if shear_stiffness is None else shear_stiffness * segment.actuator_count
    shear = [(-stiffness * twists[..., k]).expand_as(force) for k in range(1, segment.dimension)]
    torsion = [] if segment.dimension == 2 else [_torsion(segment, sections, twists, pressure).expand_as(force)]
    return torch.stack((force, *shear, *torsion, *moments), -1)


def _torsion(segment: ArmDesign, sections: CrossSections, twists: Tensor, pressure: Tensor) -> Tensor:
    """`m_x = κ_x (Σ f_α ρ_α²/l_α - C/l)` (..., N) [N·m]."""
    stiffness = RIGID if segment.torsion_stiffness is None else segment.torsion_stiffness.unsqueeze(-1)
    lost = tilt_stiffness(segment, sections, pressure)
    return twists[..., 3] * (lost - stiffness / twists[..., 0])


def tilt_stiffness(segment: ArmDesign, sections: CrossSections, pressure: Tensor) -> Tensor:
    """`Σ f_α ρ_α²/l_α` (..., N) [N·m]: the stiffness against torsion that pushing actuators take away, as true
    lengths tilt their forces. The arm buckles in torsion where it reaches C/l."""
    force = sections.force(pressure) * sections.lever[..., 0]
    length = segment.length.unsqueeze(-2) * (1 + sections.strain)
    square = segment.offsets.square().sum(-1).unsqueeze(-2)
    return (force * square / length).sum(-1)
