"""Random problems, for the library and for the reference: arms of 1 to 12 actuators, ordinary and degenerate."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

import torcharm as ta
from experiments.exactness.models import PAIRS
from experiments.exactness.reference import Array, Sets, support
from torcharm.statics.cross_section import CrossSections

FAMILIES = (
    "ordinary",
    "stretched",
    "weak bending",
    "identical",
    "parallel",
    "collinear",
    "flat",
    "some limits zero",
    "a point",
    "nonsense",
)
"""Kinds of sets; half of all problems are ordinary."""
PLACES = ("outside", "far", "inside", "boundary", "near")
"""Kinds of wrenches that are asked for."""


@dataclass(frozen=True)
class Problems:
    """B problems of M actuators.

    Attributes:
        family: of the sets.
        names: of the M force models.
        place: (B,) index into `PLACES`.
        sets: for the reference.
        sections, required: for the library, B designs, one shape, one load, and one node, or two if relative.
        relative: whether forces count less those of another strain.
    """

    family: str
    names: tuple[str, ...]
    place: Array
    sets: Sets
    sections: CrossSections
    required: Tensor
    relative: bool


def make(family: str, dimension: int, count: int, generator: np.random.Generator, names: tuple[str, ...]) -> Problems:
    """So many random problems."""
    M, D, draw = len(names), dimension, generator.uniform
    names = (names[0],) * M if family == "identical" else names
    if family in ("stretched", "nonsense"):
        names = (*names[:-1], "muscle")
    pairs = [PAIRS[name]() for name in names]
    relative = bool(generator.integers(2))
    low, high = np.array([pair.strains for pair in pairs]).T
    strain, first = (low + (high - low) * draw(size=(count, M)) for _ in range(2))
    limit = np.array([pair.limit for pair in pairs]) * draw(0.1, 1.2, (count, M))
    offset = draw(-0.08, 0.08, (count, M, D - 1))
    bending = draw(-0.03, 0.03, (count, M, D - 1)) * 10.0 ** draw(-2, 0, (count, 1, 1))
    if family == "stretched":
        strain[:, -1], first[:, -1] = draw(0.0, 0.3, count), draw(-0.3, 0.3, count)
    if family == "nonsense":
        strain, first = (
            np.where(
                generator.integers(2, size=(count, M)), draw(-0.5, 2.0, (count, M)), -(10.0 ** draw(-1, 4, (count, M)))
            )
            for _ in range(2)
        )
    if family == "weak bending":
        bending *= 10.0 ** draw(-14, -3, (count, 1, 1))
    if family == "identical":
        strain[:], first[:], limit[:] = strain[:, :1], first[:, :1], limit[:, :1]
        offset[:], bending[:] = offset[:, :1], bending[:, :1]
    if family in ("parallel", "collinear"):
        offset[:] = offset[:, :1]
    if family == "collinear":
        bending[:] = 0.0
    if family == "flat":
        offset[..., 0], bending[..., 0] = offset[..., 0] if D == 2 else 0.0, 0.0
    if family == "some limits zero":
        limit *= generator.integers(0, 2, (count, M))
    if family == "a point":
        limit[:] = 0.0
    one = np.ones((count, M, 1))
    sets = Sets(
        tuple(pair.model for pair in pairs),
        strain,
        first if relative else None,
        np.concatenate((one, offset), -1),
        np.concatenate((0 * one, bending), -1),
        limit,
        np.zeros((count, D)),
    )
    place = generator.integers(len(PLACES), size=count)
    sets = replace(sets, target=_targets(sets, place, generator))
    return _for_the_library(family, names, place, sets, [pair.actuator for pair in pairs])


def _targets(sets: Sets, place: Array, generator: np.random.Generator) -> Array:
    """Wrenches (B, D) in places of each kind."""
    count, D = sets.target.shape
    normal = generator.normal(size=(count, D))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    reach, edge = support(sets, normal)
    width = np.abs(reach + support(sets, -normal)[0]).astype(float)[:, None] + 1e-9
    mix = generator.dirichlet(np.ones(3), count)
    inner = sum(mix[:, k, None] * sets.wrench(sets.limit * generator.uniform(size=sets.limit.shape)) for k in range(3))
    moved = [
        edge + normal * width * 10.0 ** generator.uniform(-2, 1, (count, 1)),
        edge + normal * width * 1e6,
        inner,
        edge,
        edge + normal * width * 10.0 ** generator.uniform(-12, -3, (count, 1)) * generator.choice((-1, 1), (count, 1)),
    ]
    return np.stack(moved)[place, np.arange(count)].astype(float)


def _for_the_library(
    family: str, names: tuple[str, ...], place: Array, sets: Sets, actuators: list[ta.Actuator]
) -> Problems:
    """The same problems as cross-sections."""
    relative = sets.first is not None
    strain, bending = torch.from_numpy(sets.strain)[:, None, None], torch.from_numpy(sets.bending)[:, None, None, :, 1:]
    required = torch.from_numpy(sets.target)[:, None, None, None]
    if relative:
        assert sets.first is not None
        strain = torch.cat((torch.from_numpy(sets.first)[:, None, None], strain), -2)
        bending = torch.cat((torch.zeros_like(bending), bending), -3)
        required = torch.cat((torch.zeros_like(required), required), -2)
    sections = CrossSections(
        tuple(actuators),
        strain.contiguous(),
        torch.from_numpy(sets.lever)[:, None, None],
        bending.contiguous(),
        None,
        torch.from_numpy(sets.limit)[:, None, None],
    )
    return Problems(family, names, place, sets, sections, required, relative)
