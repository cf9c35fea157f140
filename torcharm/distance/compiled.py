"""Nearest faces of sets whose curves are written out, by machine code."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torcharm._arrays import Array, as_array
from torcharm.actuators import pressure_law
from torcharm.distance.closed_form import NearestFaces
from torcharm.hulls import Sections
from torcharm.wrenches import group_alike

MOST_COEFFICIENTS = 4


@dataclass(frozen=True)
class LawTable:
    """The laws of M actuators' forces at B sections, over pressures [kPa].

    Attributes:
        rows: (6 + 2K, M, B) four coefficients, K kinks, K slopes, a gain and an exponent.
        kinks: K.
    """

    rows: Array
    kinks: int


@dataclass(frozen=True)
class CompiledFaces:
    """Nearest faces of points (B, L).

    Attributes:
        faces: as of polygons, without slots.
        converged: (B, L).
        fraction: (2, M, B, L) pressure fractions at their ends, if asked for; 0 where no face was searched for.
        kinked: (2, M, B, L) whether these are at a kink of a curve, if any is.
    """

    faces: NearestFaces
    converged: Tensor
    fraction: Tensor | None
    kinked: Tensor | None


def law_table(sections: Sections) -> LawTable | None:
    """The laws, if machine code knows them: all models write theirs, up to the limits."""
    strain, limit = sections.strain, sections.limit
    if strain.dtype != torch.float64 or strain.device.type != "cpu":
        return None
    found = []
    for model, rows in group_alike(sections.actuators):
        law = pressure_law(model, strain[rows].detach())
        if law is None or len(law.coefficients) > (MOST_COEFFICIENTS if law.gain is None else 2):
            return None
        if law.until is not None and not bool((limit[rows] <= law.until).all()):
            return None
        found.append((rows, law))
    kinks = max(0 if law.kinks is None else len(law.kinks) for _, law in found)
    table = np.zeros((MOST_COEFFICIENTS + 2 * kinks + 2, *strain.shape))
    for rows, law in found:
        for row, coefficient in enumerate(law.coefficients):
            table[row, rows] = as_array(coefficient)
        if law.kinks is not None and law.slopes is not None:
            own = MOST_COEFFICIENTS + len(law.kinks)
            table[MOST_COEFFICIENTS:own, rows] = as_array(law.kinks)
            own = MOST_COEFFICIENTS + kinks
            table[own : own + len(law.slopes), rows] = as_array(law.slopes)
        if law.gain is not None and law.exponent is not None:
            table[-2, rows], table[-1, rows] = as_array(law.gain), as_array(law.exponent)
    return LawTable(table, kinks)


def compiled_faces(
    sections: Sections,
    laws: LawTable,
    point: tuple[Tensor, Tensor],
    scale: tuple[float, float],
    *,
    relative: bool,
    signed: bool,
    fractions: bool,
) -> CompiledFaces:
    """Nearest faces to points (B, L) of sections' attainable sets.

    Args:
        sections: the actuators.
        laws: theirs.
        point: scaled, as two tensors (B, L).
        scale: factors on force and moment.
        relative: whether sets are of differences from node 1.
        signed: whether margins of points inside are asked for.
        fractions: whether pressure fractions are.
    """
    from torcharm.distance.kernel import nearest  # loads numba when it is first asked for

    resting = sections.resting_moment(relative=relative)
    x, y = point
    y = y if resting is None else y - scale[1] * resting.unsqueeze(-1)
    shape, actuators = x.shape, len(sections.radii)
    square, blur = np.empty(shape), np.empty(shape)
    inside, converged = np.empty(shape, dtype=bool), np.empty(shape, dtype=bool)
    ends = (2 if fractions else 0, actuators, *shape)
    fraction, kinked = np.zeros(ends), np.zeros(ends, dtype=bool)
    nearest(
        laws.rows,
        laws.kinks,
        _packed(sections.limit),
        _packed(sections.bending),
        _packed(sections.radii),
        np.array(scale),
        _first_sections(sections.shape) if relative else np.empty(0, np.int64),
        _packed(x),
        _packed(y),
        signed,
        square,
        inside,
        blur,
        converged,
        fraction,
        kinked,
    )
    faces = NearestFaces(torch.from_numpy(square), torch.from_numpy(inside), torch.from_numpy(blur), None)
    return CompiledFaces(
        faces,
        torch.from_numpy(converged),
        torch.from_numpy(fraction) if fractions else None,
        torch.from_numpy(kinked) if kinked.any() else None,
    )


def _packed(value: Tensor) -> Array:
    return np.ascontiguousarray(as_array(value))


def _first_sections(shape: Sequence[int]) -> Array:
    """For each of P·N·D sections that of its arm's node 1."""
    shapes, nodes, designs = shape
    first = np.arange(shapes)[:, None, None] * (nodes * designs) + np.arange(designs)
    return np.broadcast_to(first, (shapes, nodes, designs)).flatten()  # of one layout: machine code is for that
