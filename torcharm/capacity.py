"""How much of a load a design can bear at a shape: where a growing load leaves the attainable sets.

The wrench that a node requires is linear in the load: `t` times the load requires `t w_i`. It moves along a line
through the origin, and a convex set cuts an interval of factors out of that line. An arm bears the factors that
lie in the intervals of all its nodes.
"""

from dataclasses import dataclass
from math import prod

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from torcharm._inputs import check_choice, check_count, check_flag
from torcharm._node_distances import required_points
from torcharm._outer import Block, OuterProduct, check_arm_and_task, map_blocks, outer_product
from torcharm._sampled_distances import inputs_want_gradient, strain_excess
from torcharm.arm import ArmDesign
from torcharm.attainability import BLOCK_ELEMENTS, METRICS, limits_in_range
from torcharm.distance.closed_form import BOUNDARY_ULPS
from torcharm.hulls import (
    Hulls,
    build_hulls,
    cross_sections,
    relative_curves,
    sample_count,
    sample_curves,
    slot_count,
)
from torcharm.polygon import Polygons
from torcharm.task import Task

AGREEMENT = 1e-8
"""By how much of the hull's size a hit may differ when its face is evaluated again with gradients."""
PARALLEL_ULPS = 32
"""Roundings of a direction within which a face counts as parallel to it."""


@dataclass(frozen=True, eq=False)
class LoadCapacity:
    """What `load_capacity` found. Shapes are (*design batch, *task batch), with N nodes added per node.

    Factors multiply the task's whole load. Where no factor serves, they are NaN; a bound that there is not is
    infinite.

    Attributes:
        factor: the largest factor of at least 0 that the hulls of all nodes allow.
        t_min, t_max: the least and the largest factor, of either sign, that they allow. An arm may need a load:
            then `t_min` is above 0.
        t_min_per_node, t_max_per_node: the same for each node alone.
        limiting_node: the node, from 1 (base) to N, that sets `factor`; 0 where none does.
        attainable: whether there is a factor of at least 0.
        attainable_unloaded: whether factor 0 is allowed.
        unbounded: whether `factor` is infinite, as that of a load that asks nothing of any hull.
        in_range: whether every strain and every pressure limit lies in the range of its force model.
        converged: whether every node's answer is as exact as was asked for.
    """

    factor: Tensor
    t_min: Tensor
    t_max: Tensor
    t_min_per_node: Tensor
    t_max_per_node: Tensor
    limiting_node: Tensor
    attainable: Tensor
    attainable_unloaded: Tensor
    unbounded: Tensor
    in_range: Tensor
    converged: Tensor

    @property
    def factor_per_node(self) -> Tensor:
        """(..., N) the largest factor of at least 0 that each node's hull allows; NaN where there is none."""
        return torch.where(self.t_max_per_node >= 0, self.t_max_per_node, torch.nan)


def load_capacity(
    arm: ArmDesign,
    task: Task,
    metric: str = "absolute",
    *,
    samples: int | None = None,
    polish: bool = False,
    chunk_size: int | None = None,
) -> LoadCapacity:
    """The largest factor by which every task's load can grow, at its shape, for every design.

    Along the outward normal n of the face that the line `t w` leaves a node's hull by, `t = h(n)/(n·w)`, with h
    the hull's support function. Differentiable once with respect to radii, lengths, pressure limits, twists, loads
    and whatever force models hold, by the same formula with the normal held; where a vertex or two nodes limit alike
    there is a kink, and the gradient is a one-sided one.

    As all that hulls say, the factor is an upper bound: every node's requirement can be met below it, each by a
    pressure of its own.

    Args:
        arm: designs, of any batch shape.
        task: tasks, of any batch shape. Loads that share a shape share its hulls.
        metric: "absolute", or "relative" for differences from node 1.
        samples: points on each actuator's curve, as for `evaluate`; sampled hulls lie inside the sets, so
            factors err on the safe side.
        polish: go on from the sampled hulls to the sets themselves, wherever the line meets the sampled hull:
            exact to rounding for forces that are cubic in pressure between their kinks, to 1e-8 for others
            that are smooth. A node that does not converge keeps its sampled answer and clears `converged`.
        chunk_size: (design, shape, load) triples worked on at once; None chooses. Bounds memory.

    Raises:
        ValueError: an argument is none of those allowed, or arm and task differ in dtype or device.
    """
    check_arm_and_task(arm, task)
    check_choice("metric", metric, METRICS)
    check_flag("polish", polish)
    count = sample_count(arm, "exact", samples)
    outer = outer_product(arm, task)
    low, high, slack, converged, excess = _per_node(outer, count, metric == "relative", polish, chunk_size)
    return _over_nodes(low, high, slack, converged, excess, limits_in_range(outer))


def _over_nodes(
    low: Tensor, high: Tensor, slack: Tensor, converged: Tensor, excess: Tensor, limits: Tensor
) -> LoadCapacity:
    """Intersect the nodes' intervals (..., N), known to within `slack`; one that is empty has `low > high`."""
    least, latest = low.max(-1)
    most, limiting = high.min(-1)
    either = torch.stack((latest, limiting), -1)
    possible = (low <= high).all(-1) & (least - most <= slack.gather(-1, either).sum(-1))
    least = torch.minimum(least, most)
    serves = possible & (most >= 0)
    factor = torch.where(serves, most, torch.nan)
    unbounded = factor == torch.inf
    own = low <= high
    return LoadCapacity(
        factor=factor,
        t_min=torch.where(possible, least, torch.nan),
        t_max=torch.where(possible, most, torch.nan),
        t_min_per_node=torch.where(own, low, torch.nan),
        t_max_per_node=torch.where(own, high, torch.nan),
        limiting_node=torch.where(serves & ~unbounded, limiting + 1, 0),
        attainable=serves,
        attainable_unloaded=possible & (least <= 0) & (most >= 0),
        unbounded=unbounded,
        in_range=(excess[..., 0] <= 16 * torch.finfo(excess.dtype).eps) & limits,
        converged=converged.all(-1) & ~(low.isnan() | high.isnan()).any(-1),
    )


def _per_node(
    outer: OuterProduct, samples: int, relative: bool, polish: bool, chunk_size: int | None
) -> tuple[Tensor, ...]:
    """Ends of the nodes' intervals (*design batch, *task batch, N), how well they are known, whether they converged,
    and the strain excess."""
    if chunk_size is None:
        chunk_size = max(1, BLOCK_ELEMENTS // (slot_count(outer.arm.actuator_count, "exact", samples) * outer.nodes))
    check_count("chunk_size", chunk_size, 1)
    if 0 in outer.sizes:
        real = outer.arm.radii.new_zeros(*outer.sizes, outer.nodes)
        columns: tuple[Tensor, ...] = (real, real, real, torch.ones_like(real, dtype=torch.bool), real)
    else:
        recompute = prod(outer.sizes) > chunk_size
        columns = map_blocks(
            outer, chunk_size, lambda block: _block_intervals(block, samples, relative, polish, recompute)
        )
    return tuple(outer.unflatten(column) for column in columns)


@dataclass(frozen=True)
class Hits:
    """Where lines `t w` enter and leave B hulls: the ends (2, B, L) of the intervals, entry first.

    Attributes:
        factor: t; entry above exit if the line misses the hull, infinite where the line has no end.
        normal: (2, 2, B, L) components, then ends: outward unit normals of the faces hit.
        size: (B, L) of the numbers they came from.
        slack: (B, L) how far off rounding may put an end, as a factor.
    """

    factor: Tensor
    normal: Tensor
    size: Tensor
    slack: Tensor


def _block_intervals(block: Block, samples: int, relative: bool, polish: bool, recompute: bool) -> tuple[Tensor, ...]:
    """The columns of `_per_node`, (d, p, l, N) each."""
    followed = torch.is_grad_enabled() and inputs_want_gradient(block)
    with torch.no_grad():
        sections = cross_sections(block.arm, block.twists)
        curves = sample_curves(sections, samples)
        hulls = build_hulls(relative_curves(sections, curves) if relative else curves, "exact", (1.0, 1.0))
        point = required_points(block, (1.0, 1.0), relative)
        hits = clip_line(hulls.polygons, *point)
        converged = torch.ones_like(hits.factor, dtype=torch.bool)
        fraction = _end_fractions(hulls, hits, point) if polish or followed else None
        if polish:
            from torcharm.distance.ray import polish_hits  # loads when it is first asked for

            assert fraction is not None
            hits, fraction, converged = polish_hits(sections, hits, fraction, point, relative=relative)
    factor = hits.factor
    if followed:
        assert fraction is not None
        replay = _Replay(block, hits, fraction, relative, polish)
        again, excess = checkpoint(replay, use_reentrant=False) if recompute else replay()
        real = hits.factor.isfinite()
        miss = (again.detach() - factor).abs() * torch.hypot(*point)
        converged = converged & (
            ~real | (miss <= AGREEMENT * hits.size + AGREEMENT * factor.abs() * torch.hypot(*point))
        )
        factor = factor + torch.where(real, again - again.detach(), torch.zeros_like(again))
    else:
        excess = strain_excess(sections)

    def by_design(value: Tensor) -> Tensor:  # (B, l) to (d, p, l, N)
        return value.unflatten(0, sections.shape).permute(2, 0, 3, 1)

    both = converged.all(0)
    columns = [by_design(value) for value in (factor[0], factor[1], hits.slack, both)]
    return *columns, _spread(excess, columns[-1])


def _spread(excess: Tensor, like: Tensor) -> Tensor:
    """(p, d) as (d, p, l, N)."""
    return excess.T[:, :, None, None].expand(like.shape)


def clip_line(polygons: Polygons, x: Tensor, y: Tensor) -> Hits:
    """Cut lines `t (x, y)`, L for each of B polygons, at every face, and keep the innermost cuts.

    The polygons' bounding boxes count as faces: what bounds a polygon without area in its own direction.
    """
    real = torch.finfo(x.dtype)
    length = torch.hypot(polygons.edge_x, polygons.edge_y)
    busy = length > real.tiny
    size = length.sum(0) + polygons.x[0].abs() + polygons.y[0].abs()
    per_length = busy / torch.where(busy, length, torch.ones_like(length))
    ones, none = torch.ones_like(size), torch.zeros_like(size)
    across = torch.cat((polygons.edge_y * per_length, torch.stack((ones, -ones, none, none))))
    up = torch.cat((-polygons.edge_x * per_length, torch.stack((none, none, ones, -ones))))
    box = (polygons.x.amax(0), -polygons.x.amin(0), polygons.y.amax(0), -polygons.y.amin(0))
    height = torch.cat((across[:-4] * polygons.x + up[:-4] * polygons.y, torch.stack(box)))
    blur = (BOUNDARY_ULPS * real.eps * size).unsqueeze(-1)
    across, up, height = across.unsqueeze(-1), up.unsqueeze(-1), height.unsqueeze(-1)
    rate = across * x + up * y
    parallel = rate.abs() <= PARALLEL_ULPS * real.eps * torch.hypot(x, y)
    cut = height / torch.where(parallel, torch.ones_like(rate), rate)
    leaves, enters = ~parallel & (rate > 0), ~parallel & (rate < 0)
    high, out = torch.where(leaves, cut, torch.inf).min(0)
    low, into = torch.where(enters, cut, -torch.inf).max(0)
    slack = blur * (_reciprocal(rate.gather(0, into[None])) + _reciprocal(rate.gather(0, out[None])))[0]
    missed = (parallel & (height < -blur)).any(0) | (low - high > slack)
    # A hull without area is met in one point, and what lies within rounding of the origin is the origin.
    thin = ~missed & (low > high)
    middle = torch.where(thin, 0.5 * (low + high), torch.zeros_like(low))
    near = (torch.stack((low, high)) * torch.hypot(x, y)).abs() <= blur
    factor = torch.where(near, 0.0, torch.where(thin, middle, torch.stack((low, high))))
    never = torch.stack((torch.full_like(low, torch.inf), torch.full_like(low, -torch.inf)))
    factor = torch.where(missed, never, factor)

    face = torch.stack((into, out)).flatten(0, 1)
    normals = [value.squeeze(-1).T.expand(2, -1, -1).flatten(0, 1).gather(1, face) for value in (across, up)]
    normal = torch.stack(normals).unflatten(1, (2, -1))
    return Hits(factor, normal, size.unsqueeze(-1).expand_as(low), slack)


def _reciprocal(rate: Tensor) -> Tensor:
    """1 / |rate|, and 0 of nothing."""
    return (rate != 0).to(rate.dtype) / torch.where(rate == 0, torch.ones_like(rate), rate.abs())


def hit_points(hits: Hits, point: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
    """Where the lines meet the hulls, (2, B, L) each; the origin where they do not."""
    factor = torch.where(hits.factor.isfinite(), hits.factor, 0.0)
    return factor * point[0], factor * point[1]


def _end_fractions(hulls: Hulls, hits: Hits, point: tuple[Tensor, Tensor]) -> Tensor:
    """Pressure fractions (2, M, 2, B, L) at the ends (first) of the faces hit at the interval's ends (third)."""
    x, y = hit_points(hits, point)
    slot = torch.zeros_like(x[0], dtype=torch.long)
    found = [
        hulls.fractions(slot, (hits.normal[0, end], hits.normal[1, end]), (x[end], y[end]), torch.zeros_like(x[end]))
        for end in (0, 1)
    ]
    return torch.stack(found, 2)


@dataclass(frozen=True)
class _Replay:
    """Factors (2, B, l) at faces already found, with gradients, and the strain excess."""

    block: Block
    hits: Hits
    fraction: Tensor
    relative: bool
    polished: bool

    def __call__(self) -> tuple[Tensor, Tensor]:
        sections = cross_sections(self.block.arm, self.block.twists)
        point = required_points(self.block, (1.0, 1.0), self.relative)
        (nx, ny), hit = self.hits.normal, hit_points(self.hits, (point[0].detach(), point[1].detach()))
        factors = []
        for end in (0, 1):
            fraction = self.fraction[:, :, end]
            if self.polished:
                from torcharm.pieces import follow_kinks

                fraction = follow_kinks(sections, fraction, relative=self.relative)
            x, y = sections.wrench(fraction, relative=self.relative)
            share = _share(hit[0][end], hit[1][end], x.detach(), y.detach())
            height = nx[end] * torch.lerp(x[0], x[1], share) + ny[end] * torch.lerp(y[0], y[1], share)
            rate = nx[end] * point[0] + ny[end] * point[1]
            factors.append(height / torch.where(rate == 0, torch.ones_like(rate), rate))
        return torch.stack(factors), strain_excess(sections)


def _share(x: Tensor, y: Tensor, ends_x: Tensor, ends_y: Tensor) -> Tensor:
    """Where between two ends (2, B, L) points lie: 0 at the first, 1 at the second."""
    along_x, along_y = ends_x[1] - ends_x[0], ends_y[1] - ends_y[0]
    span = along_x.square() + along_y.square()
    reach = (x - ends_x[0]) * along_x + (y - ends_y[0]) * along_y
    return (reach / (span + (span == 0).to(span.dtype))).clamp(0, 1)
