"""Attainable sets given by vertices: the paper's edge sampling, and what solvers of quadratic programs need."""

from collections.abc import Callable
from itertools import product

import numpy as np
import torch
from torch import Tensor

from torcharm._inputs import check_choice, check_count
from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries
from torcharm.distance.result import HullDistance
from torcharm.statics.cross_section import CrossSections
from torcharm.wrench_sets.design_task_grid import RequiredWrench, segments_of

HULLS = ("exact", "edges")
DISTANCES = ("gjk", "qpth", "scipy")
EDGE_SAMPLES, CURVE_SAMPLES = 3, 9
"""Points on an edge of the pressure box, the paper's number, and on an actuator's curve, unless told."""
MOST_EDGE_ACTUATORS = 12
"""Edges are M 2^(M-1): more actuators would not fit in memory."""

DistanceFunction = Callable[[Tensor, Tensor], HullDistance]
"""What answers distances from points (*batch, D) to the convex hulls of vertices (*batch, V, D)."""


def check_hull(arm: ArmDesign | ArmSeries, hull: str, samples: int | None) -> None:
    """Raise a ValueError unless a hull of this kind can be made of so many samples."""
    check_choice("hull", hull, HULLS)
    most = max(segment.actuator_count for segment in segments_of(arm))
    if hull == "edges" and most > MOST_EDGE_ACTUATORS:
        raise ValueError(
            f"hull: 'edges' samples M 2^(M-1) edges and is for at most {MOST_EDGE_ACTUATORS} actuators, "
            f"got {most}; use 'exact'"
        )
    if samples is not None:
        check_count("samples", samples, 2)


def edge_pressures(actuators: int, samples: int) -> Tensor:
    """Normalised pressures (V, M) at points on all edges of the pressure box, each once."""
    inner = np.linspace(0, 1, samples)[1:-1]
    corners = [np.array(corner, float) for corner in product((0.0, 1.0), repeat=actuators)]
    rows = list(corners)
    for a in range(actuators):
        for corner in corners:
            if corner[a] == 0.0:
                for u in inner:
                    row = corner.copy()
                    row[a] = u
                    rows.append(row)
    return torch.from_numpy(np.stack(rows))


def edge_vertices(sections: CrossSections, samples: int, *, relative: bool) -> Tensor:
    """The wrenches (..., N, V, C) that pressures on the edges of the pressure box provide."""
    table = edge_pressures(len(sections.actuators), samples).to(sections.strain)
    pressure = table.view(*table.shape[:1], *[1] * (sections.limit.ndim), table.shape[1]) * sections.limit
    wrench = torch.stack([sections.reaction(own) for own in pressure.squeeze(1) if own is not None], -2)
    return wrench - wrench[..., :1, :, :] if relative else wrench


def curve_vertices(sections: CrossSections, samples: int, *, relative: bool) -> Tensor:
    """Each actuator's wrenches (..., N, M, S, C) at evenly spaced pressures, without constant moments."""
    raise NotImplementedError


def vertex_distances(
    sections: CrossSections,
    required: RequiredWrench,
    relative: bool,
    *,
    hull: str,
    samples: int | None,
    distance: str | DistanceFunction,
    scale: tuple[float, float],
) -> tuple[Tensor, Tensor]:
    """Distances (B, P, L, N) of required wrenches from hulls of vertices, and whether they converged."""
    raise NotImplementedError
