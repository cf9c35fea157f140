"""Whether arms stay at equilibria, and what the answers may be trusted for."""

from collections.abc import Iterator

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torcharm.arm_series import segments_of, with_slices
from torcharm.engine.continuation import FAILED
from torcharm.engine.path import Found
from torcharm.engine.pressure_model import Problem as EngineProblem
from torcharm.engine.questions import inverse
from torcharm.equilibrium.problem import Problem
from torcharm.geometry.rod import actuator_lengths, strain
from torcharm.inputs import plain_number
from torcharm.statics.balance import tilt_stiffness
from torcharm.statics.cross_section import RANGE_SLACK, characterised_range, cross_sections

EIGENVALUES_AT_ONCE = 4096
"""Matrices whose inverses are held at once: 30 MB of 30 by 30."""


def stays(packed: EngineProblem, found: Found) -> NDArray[np.bool_]:
    """(B,) whether arms stay at their equilibria when disturbed: all eigenvalues of J have a negative real part.

    The number of positive pivots tells it where J is symmetric. It nearly is under dead forces: the bending law, and
    wrenches that are taken at the start of an element, change it by some percent. An odd number of positive pivots is
    a real positive eigenvalue for any J. Loads that follow the body and, in space, dead moments can make an arm flutter
    with no positive pivot at all; there, and where an even number leaves it open, eigenvalues decide.
    """
    stable: NDArray[np.bool_] = (found.pivots == 0).all(-1) & (found.reached != FAILED)
    loads = packed.loads
    dimension = loads.offset.shape[2]
    unsure = (found.pivots[:, 0] % 2 == 0) & (found.pivots[:, 0] > 0) & (found.pivots[:, 1] == 0)
    if loads.follows.any():
        unsure |= stable
    elif dimension == 3 and loads.wrench.shape[1]:
        unsure |= stable & (loads.wrench[..., dimension:] != 0).any((-2, -1))
    rows = np.flatnonzero(unsure & (found.reached != FAILED))
    for index in np.split(rows, range(EIGENVALUES_AT_ONCE, len(rows), EIGENVALUES_AT_ONCE)):
        stable[index] = are_stable(inverse(packed, found.twists, index)) if len(index) else True
    return stable


def are_stable(inverses: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(b,) whether all eigenvalues of J have a negative real part, by the inverses (b, n, n), whose signs are the same.

    They have if the symmetric part is negative definite, which is quicker to find; else the eigenvalues are asked for.
    """
    _, failed = torch.linalg.cholesky_ex(torch.from_numpy(-(inverses + inverses.swapaxes(-1, -2))))
    stable: NDArray[np.bool_] = (failed == 0).numpy()
    if not stable.all():
        stable[~stable] = np.linalg.eigvals(inverses[~stable]).real.max(-1) < 0
    return stable


def lengths_positive(problem: Problem, twists: Tensor) -> Tensor:
    """(*batch) whether the lengths of the centreline and of all actuators are above 0: others are impossible."""
    found = (twists[..., 0] > 0).all(-1)
    for segment, shape in zip(segments_of(problem.arm)[0], twists.split(problem.nodes, -2), strict=True):
        across = segment.radii if segment.dimension == 2 else segment.offsets
        found = found & (actuator_lengths(shape, across) > 0).all(-1).all(-1)
    return found


def strain_excess(problem: Problem, twists: Tensor) -> tuple[Tensor, Tensor]:
    """The largest strain beyond its actuator's characterised range (*batch), and whether all strains and pressures
    lie within theirs."""
    excess = twists.new_zeros(twists.shape[:-2])
    within = torch.ones_like(excess, dtype=torch.bool)
    segments = with_slices(segments_of(problem.arm)[0])
    for (segment, place), (own, beyond, _, _) in zip(segments, beyond_range(problem, twists), strict=True):
        excess = torch.maximum(excess, beyond.clamp(min=0).amax((-1, -2)))
        pressure = problem.pressure[..., place]
        ends = [[plain_number(model.pressure_range[end]) for model in segment.actuators] for end in (0, 1)]
        low, high = (pressure.new_tensor(end) for end in ends)
        within = within & (pressure >= low - RANGE_SLACK * low.abs()).all(-1)
        within = within & (pressure <= high + RANGE_SLACK * high.abs()).all(-1)
        for index, model in enumerate(segment.actuators):
            if hasattr(model, "characterised"):  # a region that need not fill its ranges
                within = within & model.characterised(own[..., index], pressure[..., None, index]).all(-1)
    return excess, within & (excess <= RANGE_SLACK)


def share_beyond_range(problem: Problem, twists: Tensor) -> Tensor:
    """(*batch) by how much of its characterised range's width a strain leaves it, the largest; negative within.

    Differentiable. A range without an end, or without any width, counts as one of 1.
    """
    shares = [(beyond / width).amax((-1, -2)) for _, beyond, width, _ in beyond_range(problem, twists)]
    return torch.stack(torch.broadcast_tensors(*shares)).amax(0)


def beyond_range(problem: Problem, twists: Tensor) -> Iterator[tuple[Tensor, Tensor, Tensor, Tensor]]:
    """Of each segment strains (*batch, N, M), how far they lie beyond the nearer end of their characterised range, its
    width, and which end that is: 1 for the upper, -1 for the lower."""
    for segment, shape in zip(segments_of(problem.arm)[0], twists.split(problem.nodes, -2), strict=True):
        across = segment.radii if segment.dimension == 2 else segment.offsets
        own = strain(actuator_lengths(shape, across), segment.length.unsqueeze(-2))
        low, high, beyond = characterised_range(segment.actuators, own)
        width = high - low
        finite = torch.where(width.isfinite() & (width > 0), width, 1.0)
        yield own, beyond, finite, torch.where(beyond == own - high, 1.0, -1.0)


def buckles_in_torsion(problem: Problem, twists: Tensor) -> Tensor:
    """(*batch, N) where pushing actuators take all stiffness against torsion away: `Σ f_α ρ_α² l/l_α ≥ C`."""
    found, segments = [], with_slices(segments_of(problem.arm)[0])
    for (segment, place), shape in zip(segments, twists.split(problem.nodes, -2), strict=True):
        pressure = problem.pressure[..., None, place]
        if segment.torsion_stiffness is None:
            found.append(torch.zeros_like(shape[..., 0], dtype=torch.bool))
            continue
        lost = tilt_stiffness(segment, cross_sections(segment, shape), pressure) * shape[..., 0]
        found.append(lost >= segment.torsion_stiffness.unsqueeze(-1))
    batch = torch.broadcast_shapes(*(value.shape[:-1] for value in found))
    return torch.cat([value.expand(*batch, -1) for value in found], -1)
