"""Attainable sets: which wrenches a node's actuators can provide over the pressure box.

For a fixed shape the reaction is a sum of one curve per actuator, `a(p) = Σ_α c_α(p_α)` with
`c = (f, -r f + τ)`. The convex hull of a sum is the Minkowski sum of the convex hulls, so the exact
hull costs as many curve samples as there are actuators. The paper samples the edges of the
pressure box instead: `hull="edges"`, an inner approximation kept for validation.

The same holds for the relative sets, with the curves `c_i - c_1`.
"""

from dataclasses import dataclass
from itertools import product

import torch
from jaxtyping import Float
from torch import Tensor

from torcharm._inputs import check_choice, check_count, check_tensor
from torcharm.actuators import Actuator, is_linear_in_pressure
from torcharm.arm import ArmDesign, check_planar
from torcharm.envelope import convex_curves
from torcharm.polygon import Polygons, all_faces, convex_hull, face_square, minkowski_sum
from torcharm.wrenches import actuator_force, actuator_state, along, reference_pressures, resting_moment

KINDS = ("exact", "edges")
DEFAULT_SAMPLES = {"exact": 9, "edges": 3}
MOST_EDGE_ACTUATORS = 12
ROUNDINGS = (32.0, 3e4, 3e7)
"""Multiples of the rounding error within which samples may count as equally far along a normal."""

Pair = tuple[Tensor, Tensor]


def sample_count(arm: ArmDesign, kind: str, samples: int | None) -> int:
    """Samples a curve (exact) or an edge (edges), checked; 2 are exact for forces linear in pressure.

    Raises:
        ValueError: unknown kind, fewer than 2 samples, or too many actuators for edges.
    """
    check_choice("hull", kind, KINDS)
    if kind == "edges" and arm.actuator_count > MOST_EDGE_ACTUATORS:
        raise ValueError(
            f"hull: 'edges' samples M 2^(M-1) edges and is for at most {MOST_EDGE_ACTUATORS} actuators, "
            f"got {arm.actuator_count}; use 'exact'"
        )
    if samples is not None:
        return check_count("samples", samples, 2)
    if all(is_linear_in_pressure(model) for model in arm.actuators):
        return 2
    return DEFAULT_SAMPLES[kind]


def slot_count(actuators: int, kind: str, samples: int) -> int:
    """Slots of the polygons that a hull of this kind has, for sizing blocks of work."""
    if kind == "exact":
        return actuators * samples
    return 2 * (2**actuators + actuators * 2 ** (actuators - 1) * (samples - 2))


@dataclass(frozen=True)
class Sections:
    """The actuators at B = P·N·D cross-sections: on P shapes, at N nodes, of D designs.

    Everything is actuators first, batch last, and designs last in the batch: the work is then done
    along whichever dimension is long.

    Attributes:
        actuators: M force models.
        shape: (P, N, D).
        strain: (M, B).
        bending: (M, B) bending moment at the pressure limit [N·m]; linear in pressure.
        radii: (M, B) [m].
        limit: (M, B) pressure limits [kPa].
        resting: (B) bending moment at no pressure, of all actuators [N·m]; None is none.
    """

    actuators: tuple[Actuator, ...]
    shape: tuple[int, int, int]
    strain: Tensor
    bending: Tensor
    radii: Tensor
    limit: Tensor
    resting: Tensor | None = None

    def at_first_node(self, value: Tensor) -> Tensor:
        """(..., B) with each node's entry replaced by that of its arm's node 1."""
        by_node = value.unflatten(-1, self.shape)
        return by_node[..., :1, :].expand_as(by_node).flatten(-3)

    def wrench(self, fraction: Tensor, *, relative: bool) -> tuple[Tensor, Tensor]:
        """Reaction `(f_x, m)`, each (..., B, L), at fractions (..., M, B, L) of the limits."""
        pressure = fraction * self.limit.unsqueeze(-1)
        force = actuator_force(self.actuators, self.strain.unsqueeze(-1), pressure, dim=-3)
        bending = self.bending
        if relative:
            first = self.at_first_node(self.strain).unsqueeze(-1)
            force = force - actuator_force(self.actuators, first, pressure, dim=-3)
            bending = bending - self.at_first_node(bending)
        moment = bending.unsqueeze(-1) * fraction - self.radii.unsqueeze(-1) * force
        resting = self.resting_moment(relative=relative)
        return force.sum(-3), moment.sum(-3) if resting is None else moment.sum(-3) + resting.unsqueeze(-1)

    def resting_moment(self, *, relative: bool) -> Tensor | None:
        """The moment (B) that no pressure changes [N·m]; relative: its difference from node 1's."""
        if self.resting is None or not relative:
            return self.resting
        return self.resting - self.at_first_node(self.resting)


def cross_sections(arm: ArmDesign, twists: Float[Tensor, "P N 3"]) -> Sections:
    """The sections of designs, of batch shape (D,), on P shapes."""
    radii, neutral, limit = (value.T[:, None, None].contiguous() for value in (arm.radii, arm.length, arm.max_pressure))
    length, _, curvature = twists.unsqueeze(-2).unbind(-1)  # (P, N, 1)
    strain, bending = actuator_state(arm.actuators, length, curvature, radii, neutral, dim=-4)
    bending = bending * (limit / along(reference_pressures(arm.actuators), limit, -4))

    def flat(value: Tensor) -> Tensor:
        return value.expand_as(strain).flatten(1)

    shape = (len(twists), twists.shape[-2], len(arm.radii))
    resting = resting_moment(arm.actuators, length, curvature, radii, neutral, dim=-4)
    resting = None if resting is None else resting.flatten()
    return Sections(arm.actuators, shape, flat(strain), flat(bending), flat(radii), flat(limit), resting)


@dataclass(frozen=True)
class Curves:
    """Each actuator's reaction curve at B sections: S forces, and a moment linear in pressure.

    Attributes:
        grid: (S, 1, 1) pressure fractions, evenly spaced from 0 to 1, or (S, M, B), rising.
        force: (S, M, B) [N].
        bending: (M, B) bending moment at fraction 1 [N·m].
        radii: (M, B) [m].
        resting: (B) moment at no pressure, of all actuators [N·m]; None is none.
    """

    grid: Tensor
    force: Tensor
    bending: Tensor
    radii: Tensor
    resting: Tensor | None = None

    def lifted(self, moment: Tensor) -> Tensor:
        """Sums of moments (..., B) over the actuators, with what they bear at no pressure."""
        return moment if self.resting is None else moment + self.resting


def sample_curves(sections: Sections, samples: int) -> Curves:
    """The curves of absolute reactions."""
    grid = torch.linspace(0, 1, samples, dtype=sections.strain.dtype, device=sections.strain.device).view(-1, 1, 1)
    force = actuator_force(sections.actuators, sections.strain, grid * sections.limit, dim=-2)
    return Curves(grid, force, sections.bending, sections.radii, sections.resting)


def relative_curves(sections: Sections, curves: Curves) -> Curves:
    """The curves of differences from node 1."""
    force = curves.force - sections.at_first_node(curves.force)
    bending = curves.bending - sections.at_first_node(curves.bending)
    return Curves(curves.grid, force, bending, curves.radii, sections.resting_moment(relative=True))


@dataclass(frozen=True)
class ExactHulls:
    """Minkowski sums of the actuators' curves, each sampled at S pressures.

    Attributes:
        polygons: V = S·M slots.
        curves: whose sums they are.
        scale: factors on force and moment.
    """

    polygons: Polygons
    curves: Curves
    scale: tuple[float, float]

    def fractions(self, slot: Tensor, normal: Pair, point: Pair, square: Tensor) -> Tensor:
        """Pressure fractions (2, M, B, L) at the two ends of faces.

        Each actuator sits where it reaches furthest along the face's normal; where several samples
        do, to within rounding, at the two that lie furthest apart. So all that is parallel is one
        face, and the order in which parallel edges were summed does not matter. How much rounding
        to allow for is not known beforehand: of several answers the one is taken that lies where
        the polygon's face does.

        Args:
            slot: (B, L) the faces' slots.
            normal: (B, L) their outward normals.
            point: (B, L) points to which they are nearest.
            square: (B, L) squared distances of these.
        """
        index = self._ends(normal, ROUNDINGS[0])
        miss = self._miss(index, point, square)
        for allowed in ROUNDINGS[1:]:
            if not bool((miss > 1e3 * torch.finfo(miss.dtype).eps * (point[0].abs() + point[1].abs() + 1)).any()):
                break
            wider = self._ends(normal, allowed)
            wider_miss = self._miss(wider, point, square)
            index = torch.where(wider_miss < miss, wider, index)
            miss = torch.minimum(miss, wider_miss)
        grid = self.curves.grid.unsqueeze(-1)
        return grid.expand(-1, *index.shape[1:]).gather(0, index)

    def lowered(self, y: Tensor, section: Tensor) -> Tensor:
        """Scaled moments (Q) required of sections (Q), less what is borne at no pressure: for curves without it."""
        resting = self.curves.resting
        return y if resting is None else y - self.scale[1] * resting[section]

    def _ends(self, normal: Pair, allowed: float) -> Tensor:
        """Samples (2, M, B, L) that reach furthest along the normal, to within so many roundings."""
        curves, (scale_x, scale_y) = self.curves, self.scale
        radii, bending = curves.radii.unsqueeze(-1), curves.bending.unsqueeze(-1)
        force, grid = curves.force.unsqueeze(-1), curves.grid.unsqueeze(-1)
        per_force = scale_x * normal[0] - scale_y * normal[1] * radii
        per_fraction = scale_y * normal[1] * bending
        reach = per_force * force + per_fraction * grid
        weight = (scale_x * normal[0]).abs() + (scale_y * normal[1] * radii).abs()
        size = weight * force.abs().amax(0) + per_fraction.abs()
        behind = (reach < reach.amax(0) - allowed * torch.finfo(reach.dtype).eps * size).to(reach.dtype)
        aside = (-scale_x * normal[1] - scale_y * normal[0] * radii) * force + scale_y * normal[0] * bending * grid
        out = behind.mul_(torch.finfo(reach.dtype).max / 4)
        # min and max with indices are many times faster than argmin and argmax along the first dimension
        first, last = (aside + out).min(0).indices, (aside - out).max(0).indices
        return torch.stack((first, last))

    def _miss(self, index: Tensor, point: Pair, square: Tensor) -> Tensor:
        """By how much (B, L) points are off in distance from the faces between sums of samples (2, M, B, L)."""
        curves = self.curves
        force = curves.force.unsqueeze(-1).expand(-1, *index.shape[1:]).gather(0, index)
        fraction = curves.grid.unsqueeze(-1).expand(-1, *index.shape[1:]).gather(0, index)
        moment = curves.bending.unsqueeze(-1) * fraction - curves.radii.unsqueeze(-1) * force
        total = moment.sum(1) if curves.resting is None else moment.sum(1) + curves.resting.unsqueeze(-1)
        x, y = self.scale[0] * force.sum(1), self.scale[1] * total
        return (face_square(point, (x[0], y[0]), (x[1], y[1])).sqrt() - square.sqrt()).abs()


@dataclass(frozen=True)
class EdgeHulls:
    """Convex hulls of the reactions to pressures sampled on all edges of the pressure box.

    Attributes:
        polygons: the hulls.
        source, target: (V, B) the sampled pressures at the ends of each slot's face.
        table: (samples, M) the sampled pressures, as fractions of the limits.
    """

    polygons: Polygons
    source: Tensor
    target: Tensor
    table: Tensor

    def fractions(self, slot: Tensor, normal: Pair, point: Pair, square: Tensor) -> Tensor:
        """Pressure fractions (2, M, B, L) at the two ends of faces; arguments as for `ExactHulls`."""
        ends = torch.stack((self.source.gather(0, slot.T).T, self.target.gather(0, slot.T).T))
        return self.table[ends].movedim(-1, 1)


Hulls = ExactHulls | EdgeHulls


def build_hulls(curves: Curves, kind: str, scale: tuple[float, float]) -> Hulls:
    """The hulls of all sections, with forces and moments multiplied by `scale`."""
    return _exact_hulls(curves, scale) if kind == "exact" else _edge_hulls(curves, scale)


def _exact_hulls(curves: Curves, scale: tuple[float, float]) -> ExactHulls:
    step, rise, turn = convex_curves(curves.grid, curves.force)
    # The graph of force over pressure turns the other way in the (f, m) plane if τ grows with p.
    turn = turn * (1 - 2 * (curves.bending > 0).to(rise.dtype))
    edge_force = rise.mul_(scale[0] * turn)
    edge_moment = ((scale[1] * turn * curves.bending) * step).addcmul_(
        edge_force, curves.radii, value=-scale[1] / scale[0]
    )
    least, start = _leftmost(curves)
    polygons = minkowski_sum(
        scale[0] * least.sum(0),
        scale[1] * curves.lifted((curves.bending * start - curves.radii * least).sum(0)),
        edge_force.flatten(0, 1),
        edge_moment.flatten(0, 1),
    )
    return ExactHulls(polygons, curves, scale)


def _leftmost(curves: Curves) -> tuple[Tensor, Tensor]:
    """Least force (M, B) of each curve, and the fraction of it where, among ties, τ is largest."""
    with torch.no_grad():
        least = curves.force.amin(0)
        falling = (curves.bending < 0).to(least.dtype)
        sign = 1 - 2 * falling
        ranked = torch.addcmul(falling, sign, curves.grid).mul_(curves.force == least)
        if not curves.force.requires_grad:
            return least, sign * ranked.amax(0) + falling
        place = ranked.add_(curves.force == least).max(0, keepdim=True).indices
    # The derivative of that sample, not of all those that tie with it.
    return curves.force.gather(0, place)[0], curves.grid.expand_as(curves.force).gather(0, place)[0]


def edge_table(actuators: int, samples: int) -> list[tuple[int, ...]]:
    """Sample indices (0 to samples - 1) of the pressures on all edges of the pressure box, once each."""
    last = samples - 1
    corners = list(product((0, last), repeat=actuators))
    inner = [
        (*rest[:free], step, *rest[free:])
        for free in range(actuators)
        for rest in product((0, last), repeat=actuators - 1)
        for step in range(1, last)
    ]
    return corners + inner


def _edge_hulls(curves: Curves, scale: tuple[float, float]) -> EdgeHulls:
    samples, actuators, batch = curves.force.shape
    table = torch.tensor(edge_table(actuators, samples), device=curves.force.device)
    row = (table * actuators + torch.arange(actuators, device=table.device)).flatten()
    moment = curves.bending * curves.grid - curves.radii * curves.force

    def total(curve: Tensor) -> Tensor:
        return curve.flatten(0, 1).index_select(0, row).view(-1, actuators, batch).sum(1)

    polygons, source, target = convex_hull(scale[0] * total(curves.force), scale[1] * curves.lifted(total(moment)))
    return EdgeHulls(polygons, source, target, curves.grid.view(-1)[table])


def corner_fractions(hulls: Hulls) -> Tensor:
    """Pressure fractions (M, B, V) of the hulls' vertices, in counter-clockwise order; some repeat others."""
    polygons = hulls.polygons
    slot, *normal = all_faces(polygons)
    corner = polygons.x.gather(0, slot.T).T, polygons.y.gather(0, slot.T).T
    return hulls.fractions(slot, (normal[0], normal[1]), corner, torch.zeros_like(corner[0]))[0]


@dataclass(frozen=True, eq=False)
class WrenchHulls:
    """Attainable sets as polygons, for looking at and for solvers that take vertices.

    Attributes:
        vertices: (*design batch, *shape batch, N, V, 2) `(f_x, m)` [N, N·m] in counter-clockwise
            order; polygons of fewer vertices repeat some.
        pressure: (..., N, V, M) the pressures [kPa] that provide the vertices.
    """

    vertices: Tensor
    pressure: Tensor


def wrench_hulls(
    arm: ArmDesign,
    twists: Float[Tensor, "*shapes N 3"],
    *,
    relative: bool = False,
    hull: str = "exact",
    samples: int | None = None,
) -> WrenchHulls:
    """The attainable set of every node, absolute or relative to node 1.

    The vertices are differentiable, with the pressures held.

    Args:
        arm: designs.
        twists: shapes [m, m, rad]; every design meets every shape.
        relative: differences from node 1's reaction, instead of reactions.
        hull, samples: as for `evaluate`.

    Raises:
        ValueError: unknown hull, fewer than 2 samples, too many actuators for edges, or no twists.
    """
    check_planar(arm)
    check_tensor("twists", twists, "N", 3)
    count = sample_count(arm, hull, samples)
    sections = cross_sections(arm.flatten(), twists.reshape(-1, *twists.shape[-2:]))
    with torch.no_grad():
        curves = sample_curves(sections, count)
        hulls = build_hulls(relative_curves(sections, curves) if relative else curves, hull, (1.0, 1.0))
        fraction = corner_fractions(hulls)
    vertices = torch.stack(sections.wrench(fraction, relative=relative), -1)
    pressure = (fraction * sections.limit.unsqueeze(-1)).movedim(0, -1)

    def outer(value: Tensor) -> Tensor:
        by_design = value.unflatten(0, sections.shape).movedim(2, 0)
        return by_design.reshape(*arm.batch_shape, *twists.shape[:-1], *value.shape[1:])

    return WrenchHulls(outer(vertices), outer(pressure))
