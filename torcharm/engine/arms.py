"""What describes arms and their loads to the engine: batches of numbers, with a row for each arm.

The engine's mechanics is one for the plane and for space. K is the number of components of a twist, 3 or 6, and C that
of its unknown ones. Poses are rows of P numbers with the base's position as origin, along the world's axes:
`(cos, sin, x, y)` in the plane, the nine entries of the rotation, row by row, and the position in space.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float64, Int64
from torch import Tensor

from torcharm.actuators import Actuator
from torcharm.actuators.bending import LinearBending, bending_model, linear_stiffness, reference_pressure
from torcharm.actuators.inspection import follows
from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries, segments_of
from torcharm.engine.arrays import Array
from torcharm.engine.forces import Models, models_of
from torcharm.engine.references import by_reference
from torcharm.engine.tables import Tables, is_sampled, tables_of
from torcharm.inputs import plain_number
from torcharm.statics.balance import RIGID, unknown_columns

POSE_NUMBERS = {2: 4, 3: 12}
"""P for an arm in the plane and in space."""


@by_reference
class Arms(NamedTuple):
    """B arms of the same M actuators in S segments of N elements in all."""

    size: int  # K
    unknown: Int64[Array, "C"]  # ascending columns of a twist that are unknown; the arm is rigid in the others
    models: Models  # the actuators' force models
    tables: Tables  # those of them, and of their bending laws, that are sampled
    active: Float64[Array, "M"]  # bending stiffness a kilopascal [N·m²/kPa]
    passive: Float64[Array, "M"]  # bending stiffness at any pressure [N·m²]
    y: Float64[Array, "B M"]  # offsets [m]
    z: Float64[Array, "B M"]  # 0 in the plane
    neutral: Float64[Array, "B M"]  # neutral lengths [m]
    # stiffness against torsion [N·m²], where κ_x is unknown; RIGID for a segment that does not twist though others do
    torsion: Float64[Array, "B S"]
    shear: Float64[Array, "S"]  # stiffness against shear [N], where shear is unknown
    link: Float64[Array, "B S P"]  # pose of what follows a segment, in the frame of its end
    first_actuator: Int64[Array, "S+1"]  # where the segments' actuators begin, and end
    first_node: Int64[Array, "S+1"]  # and their elements
    force_scale: Float64[Array, "B M"]  # factors on the models' forces, of built arms; else (0, M)
    bending_scale: Float64[Array, "B M"]  # and on their moments
    added: Float64[Array, "B M J I"]  # what built arms add to polynomials' coefficients; else (0, M, J, I)


@by_reference
class Loads(NamedTuple):
    """What loads B arms at Q places, and gravity. All of it grows with one load factor."""

    base: Float64[Array, "B P"]  # pose of the base
    wrench: Float64[Array, "B Q K"]  # in the world's axes, or in those of the body if it follows [N, N·m]
    offset: Float64[Array, "B Q D"]  # from the pose at its place, in the axes there [m]
    element: Int64[Array, "Q"]  # that a place is on, in ascending order
    # of that element, above 0, up to 1. At 1 a load sits behind the link that follows, if there is one, unless
    # `before_link`
    fraction: Float64[Array, "Q"]
    before_link: Bool[Array, "Q"]  # whether a load at the end of a segment sits before its link
    follows: Bool[Array, "Q"]  # whether the wrench turns with the body
    weight: Float64[Array, "B S"]  # of one element of each segment [N]
    middle: bool  # whether wrenches are taken in the middle of elements, or at their starts


def sizes_of(arms: Arms, **more: int) -> dict[str, int]:
    """What the names in shapes of scratch for one of these arms stand for, and more of them."""
    tables = arms.tables
    _, powers, strain_powers = arms.models.table.shape
    return {
        "N": int(arms.first_node[-1]),
        "K": arms.size,
        "C": len(arms.unknown),
        "M": len(arms.models.kind),
        "S": arms.link.shape[1],
        "P": arms.link.shape[2],
        "D": 2 if arms.size == 3 else 3,
        "J": powers,
        "I": strain_powers,
        "E": tables.strain.shape[1],
        "sampled": len(tables.force) if (tables.force >= 0).any() else 0,
        **more,
    }


def numbers(value: Tensor) -> Array:
    """A tensor as the engine takes it: float64, without its graph."""
    return np.ascontiguousarray(value.detach().cpu().double().numpy())


def flat(value: Tensor, batch: tuple[int, ...], data: int = 1) -> Array:
    """A tensor (*#batch, ...) as the numbers (B, ...), of so many dimensions of data."""
    tail = value.shape[value.ndim - data :]
    return numbers(value.expand(*batch, *tail).reshape(math.prod(batch), *tail))


def pose_rows(pose: Tensor) -> Tensor:
    """Rows (..., P) of poses (..., 3) of the plane or (..., 4, 4) of space."""
    if pose.shape[-2:] == (4, 4):
        return torch.cat((pose[..., :3, :3].flatten(-2), pose[..., :3, 3]), -1)
    return torch.cat((pose[..., 2:].cos(), pose[..., 2:].sin(), pose[..., :2]), -1)


def arms_of(
    arm: ArmDesign | ArmSeries,
    batch: tuple[int, ...],
    nodes: Sequence[int],
    shear_stiffness: float | None = None,
    highest: Array | None = None,
) -> Arms:
    """The arms of a batch, expanded and flattened.

    Args:
        arm: designs whose batch broadcasts to `batch`.
        batch: shape of the B arms.
        nodes: number of elements of each segment.
        shear_stiffness: k [N/m] of each actuator, in the sense of `-k Σ γ`; None is rigid.
        highest: (M,) highest pressures in use [kPa], up to which models are sampled; None takes the arms' limits.
    """
    segments, links = segments_of(arm)
    count = math.prod(batch)
    every = [model for segment in segments for model in segment.actuators]
    models, *built = _built(segments, models_of(every), batch)
    if highest is None:
        highest = np.concatenate(
            [numbers(segment.max_pressure).reshape(-1, segment.actuator_count).max(0) for segment in segments]
        )

    def rows(values: list[Tensor]) -> Array:
        return np.concatenate([flat(value, batch) for value in values], -1)

    y = rows([segment.radii for segment in segments])
    aside = [segment.out_of_plane for segment in segments]
    z = rows([value for value in aside if value is not None]) if arm.dimension == 3 else np.zeros_like(y)
    stiff = [
        torch.full_like(segment.mass, RIGID) if segment.torsion_stiffness is None else segment.torsion_stiffness
        for segment in segments
    ]
    width = POSE_NUMBERS[arm.dimension]
    link = np.zeros((count, len(segments), width))
    link[..., 0] = 1.0
    if arm.dimension == 3:
        link[..., (4, 8)] = 1.0
    for index, one in enumerate(links):
        if one is not None:
            link[:, index] = flat(pose_rows(one.end(arm.dimension)), batch)
    sizes = [segment.actuator_count for segment in segments]
    return Arms(
        3 if arm.dimension == 2 else 6,
        np.array(unknown_columns(arm, shear_stiffness)),
        models,
        tables_of(every, models, highest),
        *_bending(every),
        y,
        z,
        rows([segment.length for segment in segments]),
        rows([value.unsqueeze(-1) for value in stiff]),
        np.array([0.0 if shear_stiffness is None else shear_stiffness * size for size in sizes]),
        link,
        np.cumsum([0, *sizes]),
        np.cumsum([0, *nodes]),
        *built,
    )


def _built(segments: Sequence[ArmDesign], models: Models, batch: tuple[int, ...]) -> tuple[Models, Array, Array, Array]:
    """The models, with tables that have room for all powers, and how built arms deviate from them, as of `Arms`."""
    count, actuators = math.prod(batch), len(models.kind)
    if all(segment.deviation is None for segment in segments):
        return models, np.zeros((0, actuators)), np.zeros((0, actuators)), np.zeros((0, *models.table.shape))
    powers = [power for segment in segments if segment.deviation is not None for power in segment.deviation.powers]
    most_i, most_j = (max([0, *(power[axis] for power in powers)]) for axis in (0, 1))
    _, rows, columns = models.table.shape
    wider = ((0, 0), (0, max(0, most_j + 1 - rows)), (0, max(0, most_i + 1 - columns)))
    models = models._replace(table=np.pad(models.table, wider))
    scale, bending, added = (
        np.ones((count, actuators)),
        np.ones((count, actuators)),
        np.zeros((count, *models.table.shape)),
    )
    first = 0
    for segment in segments:
        own, first = slice(first, first + segment.actuator_count), first + segment.actuator_count
        if segment.deviation is not None:
            scale[:, own] = flat(segment.deviation.force_scale, batch)
            bending[:, own] = flat(segment.deviation.bending_scale, batch)
            for (i, j), term in zip(segment.deviation.powers, segment.deviation.terms, strict=True):
                added[:, own, j, i] += flat(term, batch)
    return models, scale, bending, added


def _bending(actuators: Sequence[Actuator]) -> tuple[Array, Array]:
    """Bending stiffness (M,) a kilopascal, and at any pressure."""
    active, passive = np.zeros(len(actuators)), np.zeros(len(actuators))
    for index, model in enumerate(actuators):
        if is_sampled(model):
            continue
        linear = linear_stiffness(model.bending_stiffness)
        if linear is not None:
            pressure = reference_pressure(model.bending_stiffness, model.max_pressure)
            active[index] = plain_number(linear) / plain_number(pressure)
        if bending_model(model.bending_stiffness) is not None and not follows(
            model.bending_stiffness, LinearBending, "passive"
        ):
            passive[index] = plain_number(model.bending_stiffness.stiffness)  # type: ignore[union-attr]
    return active, passive
