"""Attainable sets given by vertices: the paper's edge sampling, and what solvers of quadratic programmes need.

*Edges*: the wrenches at pressures on the edges of the pressure box, all vertices of one hull. There are M 2^(M-1)
edges. *Exact*, for solvers that need vertices: samples of each actuator's curve, one simplex of weights for each
actuator, `min ½‖Σ_α C_α s_α - w‖²`: the size of that problem is linear in M.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from inspect import signature

import numpy as np
import torch
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries, segments_of
from torcharm.inputs import check_choice, check_count
from torcharm.statics.cross_section import CrossSections, actuator_force
from torcharm.wrench_sets.distance import NearestPoints
from torcharm.wrench_sets.hull_distance import HullDistance
from torcharm.wrench_sets.vertices import find_nearest_vertices

HULLS = ("exact", "edges")
EDGE_SAMPLES, CURVE_SAMPLES = 3, 9
"""Points on an edge of the pressure box, the paper's number, and on an actuator's curve, unless told."""
MOST_EDGE_ACTUATORS = 12
"""Edges are M 2^(M-1): more actuators would not fit in memory."""

DistanceFunction = Callable[..., HullDistance]
"""What answers distances from points (*batch, D) to the convex hulls of vertices (*batch, V, D); for exact sets, given
`groups=M`, to the sum of M hulls."""


def _load_qpth() -> DistanceFunction:
    from torcharm.wrench_sets.qp import qp_distance, require_qpth

    require_qpth()
    return qp_distance


def _load_nnls() -> DistanceFunction:
    from torcharm.wrench_sets.reference import nnls_distance

    return nnls_distance


SOLVERS: dict[str, Callable[[], DistanceFunction]] = {"qpth": _load_qpth, "scipy": _load_nnls}
"""By name, what loads a solver of distances to vertices."""
DISTANCES = ("gjk", *SOLVERS)
"""All names of distances; the first is the engine's own."""


def check_sets(
    arm: ArmDesign | ArmSeries, hull: str, samples: int | None, distance: str | DistanceFunction = "gjk"
) -> None:
    """Raise a ValueError unless sets of this kind can be made of so many samples, and measured like this."""
    check_choice("hull", hull, HULLS)
    most = max(segment.actuator_count for segment in segments_of(arm)[0])
    if hull == "edges" and most > MOST_EDGE_ACTUATORS:
        raise ValueError(
            f"hull: 'edges' samples M 2^(M-1) edges and is for at most {MOST_EDGE_ACTUATORS} actuators, "
            f"got {most}; use 'exact'"
        )
    if samples is not None:
        check_count("samples", samples, 2)
    if isinstance(distance, str) or not callable(distance):
        check_choice("distance", distance, DISTANCES)
    elif hull == "exact" and not _takes_groups(distance):
        raise ValueError(
            f"distance: of exact sets a function must take the keyword groups, got {distance}; use hull='edges'"
        )


def _takes_groups(distance: DistanceFunction) -> bool:
    taken = signature(distance).parameters
    return "groups" in taken or any(one.kind is one.VAR_KEYWORD for one in taken.values())


def find_solver(distance: str | DistanceFunction) -> DistanceFunction:
    """The solver of that name, which loads when it is first asked for; a function is one already.

    Raises:
        ValueError: no solver has that name, or qpth is asked for and not installed.
    """
    if not isinstance(distance, str):
        return distance
    check_choice("distance", distance, SOLVERS)
    return SOLVERS[distance]()


@dataclass(frozen=True)
class VertexSets:
    """Of which vertices sets are made, and who measures distances to them.

    Attributes:
        hull: one of `HULLS`.
        samples: on an edge or a curve.
        solver: None is the engine, for edges.
    """

    hull: str
    samples: int
    solver: DistanceFunction | None

    @classmethod
    def of(cls, hull: str, samples: int | None, distance: str | DistanceFunction) -> "VertexSets":
        """What passed `check_sets`."""
        chosen = samples or (EDGE_SAMPLES if hull == "edges" else CURVE_SAMPLES)
        return cls(hull, chosen, None if distance == "gjk" else find_solver(distance))

    @property
    def by_engine(self) -> bool:
        """Whether the engine measures them."""
        return self.solver is None

    def count(self, actuators: int) -> int:
        """Vertices of a node."""
        return len(edge_pressures(actuators, self.samples)) if self.hull == "edges" else actuators * self.samples

    @torch.no_grad()
    def find_nearest(
        self, sections: CrossSections, required: Tensor, scale: tuple[float, float], *, relative: bool
    ) -> NearestPoints:
        """Where required wrenches stand to hulls of edges, as the engine finds it.

        Args:
            sections: of B designs on P shapes, (B, P) in all.
            required: (B, P, L, N, C) what is asked of them [N, N·m].
            scale: factors on force and moment.
            relative: whether of differences from the first node.
        """
        wanted = required - required[..., :1, :] if relative else required
        vertices = edge_vertices(sections, self.samples, relative=relative)
        point, vertices = _scaled(scale, wanted.transpose(2, 3), vertices)
        found = find_nearest_vertices(point.flatten(0, 2), vertices.flatten(0, 2))
        distance, certified, normal, weight, vertex = (
            part.unflatten(0, point.shape[:3]).transpose(2, 3) for part in found
        )
        grades = torch.from_numpy(edge_pressures(len(sections.actuators), self.samples)).to(point)
        limit = sections.limit.unsqueeze(-2).unsqueeze(-2)  # (B, 1, 1, 1, 1, M)
        return NearestPoints(distance, certified, normal, weight, grades[vertex] * limit)

    @staticmethod
    def tied_to_limits(nearest: NearestPoints, sections: CrossSections) -> NearestPoints:
        """The same points, with pressures that are held as parts of the limits: so vertices are made."""
        assert nearest.pressure is not None
        limit = sections.limit.unsqueeze(-2).unsqueeze(-2)
        share = nearest.pressure / torch.where(limit > 0, limit, 1.0).detach()
        return replace(nearest, pressure=share * limit)

    def solve(
        self, sections: CrossSections, required: Tensor, scale: tuple[float, float], *, relative: bool
    ) -> tuple[Tensor, Tensor]:
        """Distances (B, P, L, N) by the solver, and whether they converged; arguments as of `find_nearest`."""
        assert self.solver is not None
        wanted = required - required[..., :1, :] if relative else required
        if self.hull == "edges":
            vertices = edge_vertices(sections, self.samples, relative=relative)
            point, vertices = _scaled(scale, wanted, vertices)
            found = self.solver(point, vertices.unsqueeze(2))
        else:
            if sections.constant is not None:
                constant = sections.constant.unsqueeze(2)
                constant = constant - constant[..., :1, :] if relative else constant
                wanted = wanted - constant
            grades = torch.linspace(0, 1, self.samples, dtype=wanted.dtype, device=wanted.device).unsqueeze(-1)
            curves = curve_points(sections, grades, relative=relative).transpose(-3, -2)  # (B, P, N, M, S, C)
            point, vertices = _scaled(scale, wanted, curves.flatten(-3, -2))
            found = self.solver(point, vertices.unsqueeze(2), groups=len(sections.actuators))
        return found.value, found.converged


def _scaled(scale: tuple[float, float], *wrenches: Tensor) -> tuple[Tensor, ...]:
    """Wrenches (..., C) with forces and moments times their factors."""
    factors = wrenches[0].new_tensor([scale[0]] + [scale[1]] * (wrenches[0].shape[-1] - 1))
    return tuple(wrench * factors for wrench in wrenches)


@cache
def edge_pressures(actuators: int, samples: int) -> np.ndarray:  # type: ignore[type-arg]
    """Normalised pressures (V, M) at points on all edges of the pressure box, each once; not to be written to."""
    corners = (np.arange(2**actuators)[:, None] >> np.arange(actuators) & 1).astype(float)
    parts = [corners]
    for a in range(actuators):
        low = corners[corners[:, a] == 0.0]
        for grade in np.linspace(0, 1, samples)[1:-1]:
            inner = low.copy()
            inner[:, a] = grade
            parts.append(inner)
    return np.concatenate(parts)


def edge_vertices(sections: CrossSections, samples: int, *, relative: bool) -> Tensor:
    """The wrenches (..., N, V, C) that pressures on the edges of the pressure box provide; V as of `edge_pressures`."""
    grades = torch.from_numpy(edge_pressures(len(sections.actuators), samples)).to(sections.strain)
    return reactions(sections, grades * sections.limit.unsqueeze(-2), relative=relative)


def reactions(sections: CrossSections, pressure: Tensor, *, relative: bool) -> Tensor:
    """The wrenches (..., N, V, C) that V pressures (..., N or 1, V, M) [kPa] a node provide, or their differences."""
    wrench = sections.for_many().reaction(pressure)
    return wrench - sections.first().for_many().reaction(pressure) if relative else wrench


def curve_points(sections: CrossSections, share: Tensor, *, relative: bool) -> Tensor:
    """Each actuator's wrenches (..., N, S, M, C) at S parts (..., N or 1, S, M) of its limit, without the constant one;
    or their differences."""
    own, first, pressure = sections.for_many(), sections.first().for_many(), share * sections.limit.unsqueeze(-2)
    force, bending = actuator_force(sections.actuators, own.strain, pressure), own.bending
    if relative:
        force, bending = force - actuator_force(sections.actuators, first.strain, pressure), bending - first.bending
    curve = force.unsqueeze(-1) * own.lever
    return torch.cat((curve[..., :1], curve[..., 1:] + pressure.unsqueeze(-1) * bending), -1)
