"""Attainable sets as vertices: for pictures, areas and volumes, and solvers that take vertices.

A set is the convex hull of a sum of pressure curves. Along a direction n it reaches as far as each of its curves does,
so every direction yields one point of its boundary, with the pressures that provide it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import ConvexHull, QhullError
from torch import Tensor

from torcharm.actuators import is_linear_in_pressure, pressure_knots
from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries, segments_of
from torcharm.geometry.rod import check_segment_nodes
from torcharm.inputs import HoldsTensors, check_tensor, shown
from torcharm.statics.cross_section import CrossSections, cross_sections
from torcharm.wrench_sets.design_task_grid import flat_segments
from torcharm.wrench_sets.vertex_sets import EDGE_SAMPLES, check_sets, curve_points, edge_pressures, reactions

CURVE_POINTS = 17
"""Points on an actuator's curve unless told, besides its kinks: between them it is off by 1e-5 of its reach."""
APART = 1e-11
"""An angle [rad] below which the sides of two curves count as parallel: rounding turns them by as much."""
DIRECTIONS = 600
"""Evenly spread directions in which a set of space is asked for points: so smooth a set looks smooth."""
TILT = 1e-6
"""By this angle [rad] the normal of a flat side is tilted to find the side's corners: far above rounding."""
FLAT = 1e-9
"""A set is flat in directions in which it extends by less than this part of its largest extent."""


@dataclass(frozen=True, eq=False, repr=False)
class WrenchHulls(HoldsTensors):
    """Attainable sets of C components, 2 in the plane and 3 in space, as the convex hulls of V vertices.

    Attributes:
        vertices: (*design batch, *shape batch, N, V, C) `(f_x, m)` or `(f_x, m_y, m_z)` [N, N·m]; in the plane in
            counter-clockwise order. Sets of fewer vertices repeat some.
        pressure: (..., N, V, M) the pressures [kPa] that provide the vertices. Of arms in series, segment after
            segment, those of other segments than the node's are 0.

    Example:
        >>> hulls = ta.wrench_hulls(ta.antagonistic_arm(), ta.constant_curvature([0.0, 2.0], nodes=1))
        >>> hulls.volume().flatten().round().tolist()  # what pressures can do, straight and bent [N·N·m]
        [724.0, 707.0]
    """

    vertices: Tensor
    pressure: Tensor

    def volume(self) -> Tensor:
        """(..., N) areas [N·N·m] in the plane, volumes [N·(N·m)²] in space; differentiable as the vertices are."""
        if self.vertices.shape[-1] == 2:
            x, y = self.vertices.unbind(-1)
            return 0.5 * (x * y.roll(-1, -1) - y * x.roll(-1, -1)).sum(-1)
        flat = self.vertices.flatten(0, -3)
        found = [_volume(points) for points in flat]
        total = torch.stack(found) if found else flat.new_zeros(0)
        return total.reshape(self.vertices.shape[:-2])


def wrench_hulls(
    arm: ArmDesign | ArmSeries,
    twists: Tensor,
    *,
    relative: bool = False,
    hull: str = "exact",
    samples: int | None = None,
    segment_nodes: Sequence[int] | None = None,
) -> WrenchHulls:
    """The attainable set of every node, absolute or relative to the first node of the same segment.

    Vertices are points of the set. Of a set that is bent, and "exact", they are on its boundary: all the corners of the
    hull of so many points on each actuator's curve in the plane, and its furthest points in 600 directions in space.
    They are differentiable, with the pressures held, as parts of the limits.

    Args:
        arm: designs; or segments in series.
        twists: (..., N, 3) or (..., N, 6) shapes [m, rad]; every design meets every shape.
        relative: differences from the first node's reaction, instead of reactions.
        hull: "exact", or "edges" as the paper samples.
        samples: points on each actuator's curve (exact; None takes 17, and 2 where forces are linear in pressure), to
            which kinks are added; or on each edge of the pressure box (edges; None takes the paper's 3).
        segment_nodes: of arms in series, how many of the N rows belong to each segment.

    Raises:
        ValueError: unknown hull, fewer than 2 samples, too many actuators for edges, or twists that do not fit.

    Example:
        >>> hulls = ta.wrench_hulls(ta.antagonistic_arm(), ta.affine_curvature(2.0, 0.0, nodes=3))
        >>> hulls.vertices[..., 1].amax(-1).round(decimals=2).tolist()  # the largest moment of each node [N·m]
        [3.96, 2.55, 1.36]
    """
    if not isinstance(arm, (ArmDesign, ArmSeries)):
        raise ValueError(f"arm: must be an ArmDesign or an ArmSeries, got {shown(arm)}")
    check_tensor("twists", twists, "N", 3 if arm.dimension == 2 else 6)
    check_sets(arm, hull, samples)
    counts = (twists.shape[-2],) if segment_nodes is None else check_segment_nodes(segment_nodes, twists.shape[-2])
    if len(counts) != len(segments_of(arm)[0]):
        raise ValueError(f"segment_nodes: must hold one number for each segment, got {shown(segment_nodes)}")
    shapes = twists.reshape(-1, *twists.shape[-2:])
    parts = zip(flat_segments(arm), shapes.split(counts, -2), strict=True)
    found = [_segment(cross_sections(own[:, None], part).for_sets(), relative, hull, samples) for own, part in parts]
    most = max(vertices.shape[-2] for vertices, _ in found)
    vertices = torch.cat([_repeated(vertices, most) for vertices, _ in found], -3)
    before, rows = 0, []
    for _, pressure in found:
        after = arm.actuator_count - before - pressure.shape[-1]
        rows.append(torch.nn.functional.pad(_repeated(pressure, most), (before, after)))
        before += pressure.shape[-1]
    batch = (*arm.batch_shape, *twists.shape[:-1])
    pressure = torch.cat(rows, -3)
    return WrenchHulls(vertices.reshape(*batch, *vertices.shape[3:]), pressure.reshape(*batch, *pressure.shape[3:]))


def hull_faces(points: np.ndarray) -> np.ndarray:  # type: ignore[type-arg]
    """Corners (F, C) of the simplices around points (V, C), as numbers of points; none around a set that is flat."""
    if _rank(points)[0] < points.shape[-1]:
        return np.zeros((0, points.shape[-1]), int)
    try:
        return np.asarray(ConvexHull(points).simplices)
    except QhullError:
        return np.zeros((0, points.shape[-1]), int)


def _repeated(value: Tensor, count: int) -> Tensor:
    """(..., V, K) with the last of V repeated."""
    missing = count - value.shape[-2]
    return torch.cat((value, value[..., -1:, :].expand(*value.shape[:-2], missing, -1)), -2) if missing else value


def _volume(points: Tensor) -> Tensor:
    """Of the hull of points (V, 3): the sum of its faces' pyramids."""
    faces = torch.from_numpy(hull_faces(points.detach().double().cpu().numpy()).astype(int)).to(points.device)
    corners = points[faces] - points.mean(0)
    return torch.linalg.det(corners).abs().sum() / 6


def _segment(sections: CrossSections, relative: bool, hull: str, samples: int | None) -> tuple[Tensor, Tensor]:
    """Vertices (B, P, N, V, C) and pressures (B, P, N, V, M) of the nodes of one segment."""
    planar = sections.lever.shape[-1] == 2
    if hull == "edges":
        table = torch.from_numpy(edge_pressures(len(sections.actuators), samples or EDGE_SAMPLES)).to(sections.strain)
        pressure = table * sections.limit.unsqueeze(-2)
        vertices = reactions(sections, pressure, relative=relative)
        return _extreme(vertices, pressure.expand(*vertices.shape[:-1], -1))
    with torch.no_grad():
        share = _furthest_shares(sections, relative, samples)
    pressure = share * sections.limit.unsqueeze(-2)
    vertices = reactions(sections, pressure, relative=relative)
    return (vertices, pressure) if planar else _extreme(vertices, pressure)


def _furthest_shares(sections: CrossSections, relative: bool, samples: int | None) -> Tensor:
    """Normalised pressures (B, P, N, V, M) at which the curves reach furthest, along directions that show the set."""
    share = _candidates(sections, relative, samples)  # (B, P, N, S, M)
    curve = curve_points(sections, share, relative=relative)  # (B, P, N, S, M, C)
    planar = curve.shape[-1] == 2
    directions = _planar_directions(_sides(share, curve)) if planar else _spatial_directions(curve)
    chosen = [(directions @ curve[..., a, :].mT).max(-1).indices for a in range(curve.shape[-2])]
    return torch.stack([share[..., a].gather(-1, index) for a, index in enumerate(chosen)], -1)


def _candidates(sections: CrossSections, relative: bool, samples: int | None) -> Tensor:
    """Normalised pressures (B, P, N, S, M) on the curves, from 0 to 1: evenly spaced ones, and kinks."""
    strain, models = sections.strain, sections.actuators
    count = samples or (2 if all(is_linear_in_pressure(model) for model in models) else CURVE_POINTS)
    even = torch.linspace(0, 1, count, dtype=strain.dtype, device=strain.device)
    places = (strain, strain[..., :1, :].expand_as(strain)) if relative else (strain,)
    limit = sections.limit.expand_as(strain)
    rows = []
    for a, model in enumerate(models):
        bound = limit[..., a]
        knots = torch.cat([pressure_knots(model, place[..., a]) for place in places]).movedim(0, -1)
        # a kink without a place, as of a strain that no pressure brings to one, adds the curve's start once more
        kinks = (knots / torch.where(bound > 0, bound, 1.0).unsqueeze(-1)).nan_to_num(0.0).clamp(0, 1)
        rows.append(torch.cat((even.expand(*strain.shape[:-1], count), kinks), -1).sort(-1).values.unsqueeze(-1))
    most = max(row.shape[-2] for row in rows)
    return torch.cat([_repeated(row, most) for row in rows], -1)


def _sides(share: Tensor, curve: Tensor) -> Tensor:
    """Chords (..., 2 S, M, 2) of planar curves (..., S, M, 2), with all sides of their hulls among them.

    Of the hull of a graph of forces over shares, the side that begins at a sample goes to where, of those with a higher
    share, the slope is largest, or least.
    """
    force = curve[..., 0]
    ahead = share.unsqueeze(-3) - share.unsqueeze(-2)  # (..., S, S, M), to the second from the first
    slope = (force.unsqueeze(-3) - force.unsqueeze(-2)) / torch.where(ahead > 0, ahead, 1.0)
    ends = (
        torch.where(ahead > 0, slope, -torch.inf).max(-2).indices,
        torch.where(ahead > 0, slope, torch.inf).min(-2).indices,
    )
    return torch.cat([curve.gather(-3, end.unsqueeze(-1).expand_as(curve)) - curve for end in ends], -3)


def _planar_directions(chord: Tensor) -> Tensor:
    """Directions (..., V, 2) in counter-clockwise order, one for each corner of a sum of curves with sides (..., M, 2).

    The sum's sides are sides of the curves' hulls. Each of its corners is furthest in the directions between the
    normals of two sides, so it is asked for in the middle of them.
    """
    chord = chord.flatten(-3, -2)
    angle = torch.atan2(-chord[..., 0], chord[..., 1])
    angle = torch.cat((angle, angle + torch.pi), -1).remainder(2 * torch.pi).sort(-1).values
    gap = torch.cat((angle.diff(dim=-1), angle[..., :1] + 2 * torch.pi - angle[..., -1:]), -1)
    middle = angle + 0.5 * gap
    # Between parallel sides there is no corner: the last one before them is taken again.
    index = torch.arange(gap.shape[-1], device=gap.device)
    known = torch.where(gap > APART, index, -1).cummax(-1).values
    last = known[..., -1:]
    middle = middle.gather(-1, torch.where(known < 0, last, known).clamp(min=0))
    return torch.stack((middle.cos(), middle.sin()), -1)


def _spatial_directions(curve: Tensor) -> Tensor:
    """Directions (..., V, 3): evenly spread ones, and about the normals of the sides that pairs of chords span.

    Spread in units in which the set is as wide in all components: one of 100 N by 5 N·m is thin in others.
    """
    span = (curve.amax(-3) - curve.amin(-3)).sum(-2)
    unit = torch.where(span > 0, span, 1.0).unsqueeze(-2)
    chord = (curve[..., -1, :, :] - curve[..., 0, :, :]) / unit
    chord = chord / chord.norm(dim=-1, keepdim=True).clamp(min=torch.finfo(chord.dtype).tiny)
    step = torch.arange(DIRECTIONS, dtype=curve.dtype, device=curve.device) + 0.5
    height, turn = 1 - 2 * step / DIRECTIONS, step * (np.pi * (3 - 5**0.5))  # a spiral with the golden angle
    radius = (1 - height.square()).sqrt()
    spread = torch.stack((radius * turn.cos(), radius * turn.sin(), height), -1)
    found = [spread.expand(*curve.shape[:-3], -1, -1)]
    for a in range(chord.shape[-2]):
        for b in range(a):
            one, other = chord[..., a, :], chord[..., b, :]
            normal = torch.linalg.cross(one, other)
            normal = normal / normal.norm(dim=-1, keepdim=True).clamp(min=TILT)
            tilts = [TILT * (one + other), TILT * (one - other)]
            sides = [sign * normal + way * tilt for sign in (1, -1) for tilt in tilts for way in (1, -1)]
            found.append(torch.stack(sides, -2))
    return torch.cat(found, -2) / unit


def _extreme(vertices: Tensor, pressure: Tensor) -> tuple[Tensor, Tensor]:
    """The corners of the hulls of points (B, P, N, V, C), counter-clockwise in the plane, and their pressures."""
    flat = vertices.flatten(0, 2)
    if not len(flat):
        return vertices, pressure
    corners = [_corners(points) for points in flat.detach().double().cpu().numpy()]
    most = max(len(own) for own in corners)
    index = torch.from_numpy(np.stack([np.pad(own, (0, most - len(own)), "edge") for own in corners]))
    index = index.to(vertices.device, torch.int64).unsqueeze(-1)  # all that gather of older torch takes

    def chosen(value: Tensor) -> Tensor:
        rows = value.flatten(0, 2).gather(1, index.expand(-1, -1, value.shape[-1]))
        return rows.reshape(*vertices.shape[:3], most, value.shape[-1])

    return chosen(vertices), chosen(pressure)


def _corners(points: np.ndarray) -> np.ndarray:  # type: ignore[type-arg]
    """Numbers of the points (V, C) that are corners of their hull."""
    rank, axes = _rank(points)
    while rank > 1:
        own = points if rank == points.shape[-1] else points @ axes[:rank].T
        try:
            return np.asarray(ConvexHull(own - own.mean(0)).vertices)
        except QhullError:  # flatter than it seemed
            rank -= 1
    if rank == 0:
        return np.zeros(1, int)
    place = points @ axes[0]
    return np.array([place.argmin(), place.argmax()])


def _rank(points: np.ndarray) -> tuple[int, np.ndarray]:  # type: ignore[type-arg]
    """In how many directions points extend, and the directions, the longest first.

    Components are compared by their own extents: a set of 100 N by 1e-3 N·m is thin, not flat.
    """
    away = points - points.mean(0)
    size = np.abs(points).max(0)
    extent = np.abs(away).max(0)
    unit = np.where(extent > FLAT * np.where(size > 0, size, 1.0), extent, np.inf)
    _, length, axes = np.linalg.svd(away / unit, full_matrices=False)
    axes = axes / np.where(np.isfinite(unit), unit, 1.0)
    return int((length > FLAT * np.sqrt(len(points))).sum()), axes
