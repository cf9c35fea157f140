"""Distances of a grid of designs and tasks: chunk by chunk, with a graph where gradients are wanted."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from torcharm.actuators import want_gradients
from torcharm.statics.cross_section import CrossSections, characterised_range, cross_sections
from torcharm.wrench_sets.design_task_grid import DesignTaskGrid, map_chunks
from torcharm.wrench_sets.distance import NearestPoints, evaluate_distance, find_nearest, sampled
from torcharm.wrench_sets.once import once
from torcharm.wrench_sets.rounding import without_rounding
from torcharm.wrench_sets.vertex_sets import VertexSets

METRICS = ("absolute", "relative")
"""Of wrenches, by attainable sets."""
CHUNK_ELEMENTS = 200_000
"""Numbers in a chunk's largest tensor, one for each actuator, node and point: 1.6 MB, which caches hold."""
KEPT_CHUNKS = 72
"""Chunks whose nearest points are kept for gradients, 3 MB each and for each metric: of more they are found again,
which takes half as long once more."""
VERTEX_CHUNK_NUMBERS = 2_000_000
"""The same where sets are given by vertices: what is worked out of these at once must be worth a call."""


def counted(weights: tuple[float, float]) -> str:
    """How forces and moments are one distance, by the weights of their squares."""
    force, moment = weights
    return "N·m counted as N" if force == moment == 1 else f"squared: {force:g} f² + {moment:g} m²"


def lack_in_words(node: int, lack: float, weights: tuple[float, float], *, relative: bool) -> str:
    """What a node, from 0, lacks of what it needs, or of its difference from what the base needs."""
    unit = " N" if weights == (1.0, 1.0) else ""
    what = f"{'change from the base in ' if relative else ''}force and moment"
    return f"node {node + 1} lacks {lack:.3g}{unit} of {what} ({counted(weights)})"


@dataclass(frozen=True)
class SetOptions:
    """Which distances to measure, and how.

    Attributes:
        metrics: of "absolute" and "relative".
        scale: factors on force and moment.
        signed: whether inside counts as negative.
        vertices: of which vertices sets are made, and who measures them; None measures the sets themselves.
    """

    metrics: tuple[str, ...]
    scale: tuple[float, float]
    signed: bool = False
    vertices: VertexSets | None = None


@dataclass(frozen=True, eq=False)
class NodeDistances:
    """What `node_distances` found, for B designs, P shapes, L loads and K metrics.

    Attributes:
        distance: (B, P, L, K, N); infinite where the shape is impossible.
        converged: (B, P, L, K, N) whether they are as exact as promised.
        strain_excess: (B, P, L) the largest strain beyond its actuator's characterised range.
        impossible: (B, P, L) whether the shape leaves an actuator no length.
    """

    distance: Tensor
    converged: Tensor
    strain_excess: Tensor
    impossible: Tensor


def node_distances(grid: DesignTaskGrid, options: SetOptions, chunk_size: int | None = None) -> NodeDistances:
    """The distances of all nodes' required wrenches from what pressures can provide there.

    Args:
        grid: designs and tasks.
        options: what to measure.
        chunk_size: (design, shape, load) triples worked on at once; None chooses. Bounds memory.
    """
    if 0 in grid.sizes:
        real = grid.twists.new_zeros(*grid.sizes, len(options.metrics), grid.twists.shape[-2])
        flag = torch.zeros_like(real, dtype=torch.bool)
        return NodeDistances(real, ~flag, real.new_zeros(grid.sizes), flag.new_zeros(grid.sizes))
    size = chunk_size or default_chunk(grid, options.vertices)
    triples = len(grid.segments[0].radii) * grid.sizes[1] * grid.sizes[2]
    again, keep = triples > size, triples <= KEPT_CHUNKS * size

    def work(designs: slice, shapes: slice, loads: slice) -> tuple[Tensor, ...]:
        parts = [_segment(grid, s, (designs, shapes, loads), options, again, keep) for s in range(len(grid.segments))]
        distance, converged, excess, lost = zip(*parts, strict=True)
        impossible = torch.stack(lost).any(0)
        whole = torch.cat(distance, -1)
        if bool(impossible.any()):
            whole = torch.where(impossible[..., None, None], torch.inf, whole)
        return whole, torch.cat(converged, -1), torch.stack(excess).amax(0), impossible

    return NodeDistances(*map_chunks(grid, size, work))


def default_chunk(grid: DesignTaskGrid, vertices: VertexSets | None = None) -> int:
    """(design, shape, load) triples worked on at once."""
    components = grid.external.shape[-1]
    actuators = max(segment.actuator_count for segment in grid.segments)
    if vertices is not None:
        numbers = vertices.count(actuators) * max(actuators, components) * grid.twists.shape[-2]
        return max(1, VERTEX_CHUNK_NUMBERS // numbers)
    return max(1, CHUNK_ELEMENTS // (components * actuators * grid.twists.shape[-2]))


def _segment(
    grid: DesignTaskGrid, segment: int, place: tuple[slice, slice, slice], options: SetOptions, again: bool, keep: bool
) -> tuple[Tensor, ...]:
    """The columns of `NodeDistances`, (b, p, l, ...), of the nodes of one segment.

    Args:
        again: whether a graph is built when it is needed instead of kept.
        keep: whether nearest points are kept for it, in place of being found again.
    """
    designs, shapes, _ = place
    required = grid.required(*place, grid.nodes[segment])
    arm, twists = grid.segments[segment][designs, None], grid.twists[shapes, grid.nodes[segment]]

    def prepare() -> tuple[CrossSections, Tensor, Tensor]:
        sections = cross_sections(arm, twists)
        sections = sections.for_sets() if options.metrics else sections
        return *possible_sections(sections), strain_excess(sections)

    with torch.no_grad():
        sections, lost, excess = prepare()
    if not wants_gradient(grid, segment):
        with torch.no_grad():
            found = _measured(sections, required, options)
    elif options.vertices is not None and not options.vertices.by_engine:
        sections, lost, excess = prepare()
        found = _measured(sections, required, options)
    else:
        kept = _nearest(sections, required, options) if keep else []

        def replay() -> tuple[Tensor, ...]:
            sections, _, excess = prepare()
            points = kept or _nearest(sections, required, options)
            values = [
                evaluate_distance(
                    sections, required, options.scale, _held(options, sections, one), relative=metric == "relative"
                )
                for metric, one in zip(options.metrics, points, strict=True)
            ]
            return *values, *(one.known(value) for one, value in zip(points, values, strict=True)), excess

        if not again:
            *both, excess = replay()
        elif options.vertices is None and not any_sampled(sections) and not want_gradients(arm.actuators, arm.radii):
            inputs = (*arm.tensors(), twists, required)
            with torch.no_grad():
                pairs = [(one.distance, one.certified) for one in kept] or _measured(sections, required, options)
            plain = (*(value for value, _ in pairs), *(flag for _, flag in pairs), excess)
            *both, excess = Replayed.apply(replay, plain, *(x for x in inputs if x.requires_grad))
        else:  # parameters inside of models are found only by a forward pass through them
            *both, excess = checkpoint(replay, use_reentrant=False)
        count = len(options.metrics)
        found = list(zip(both[:count], both[count:], strict=True))
    found = [
        (without_rounding(value, sections, required, options.scale, relative=metric == "relative"), flag)
        for metric, (value, flag) in zip(options.metrics, found, strict=True)
    ]
    shape = required.shape[:3]
    none = excess.new_zeros(*shape, 0, required.shape[3])
    distance = once(torch.stack([value for value, _ in found], -2)) if found else none
    converged = torch.stack([flag for _, flag in found], -2) if found else none.bool()
    return distance, converged, excess.unsqueeze(-1).expand(shape), lost.unsqueeze(-1).expand(shape)


class Replayed(torch.autograd.Function):
    """Values that the engine has found, as functions of tensors whose graph is built when a gradient is asked for."""

    @staticmethod
    def forward(ctx: Any, build: Callable[[], tuple[Tensor, ...]], known: tuple[Tensor, ...], *inputs: Tensor) -> Any:
        """The known values; `build` makes them anew from the inputs, with a graph."""
        ctx.build, ctx.inputs = build, inputs
        return known

    @staticmethod
    def backward(ctx: Any, *wanted: Tensor) -> Any:
        """Gradients by the inputs, of values built anew."""
        more = torch.is_grad_enabled()
        with torch.enable_grad():
            values = ctx.build()
        pairs = [(value, own) for value, own in zip(values, wanted, strict=True) if value.requires_grad]
        found, outer = [value for value, _ in pairs], [own for _, own in pairs]
        return None, None, *torch.autograd.grad(found, ctx.inputs, outer, allow_unused=True, create_graph=more)


@torch.no_grad()
def _nearest(
    sections: CrossSections, required: Tensor, options: SetOptions, *, points: bool = True
) -> list[NearestPoints]:
    """What the engine finds for each metric, of the sets themselves or of their vertices."""
    vertices, scale, signed = options.vertices, options.scale, options.signed
    relative = [metric == "relative" for metric in options.metrics]
    if vertices is not None:
        return [vertices.find_nearest(sections, required, scale, relative=one) for one in relative]
    samples = sampled(sections)  # once for all metrics
    return [
        find_nearest(sections, required, scale, relative=one, signed=signed, points=points, samples=samples)
        for one in relative
    ]


def _held(options: SetOptions, sections: CrossSections, nearest: NearestPoints) -> NearestPoints:
    """The same points, whose pressures move with limits if they are those of vertices."""
    return nearest if options.vertices is None else options.vertices.tied_to_limits(nearest, sections)


def _measured(sections: CrossSections, required: Tensor, options: SetOptions) -> list[tuple[Tensor, Tensor]]:
    """Distances (b, p, l, N) of each metric, and whether they converged; solvers that keep a graph keep it."""
    vertices, scale = options.vertices, options.scale
    if vertices is not None and not vertices.by_engine:
        return [vertices.solve(sections, required, scale, relative=metric == "relative") for metric in options.metrics]
    by_torch = vertices is None and any_sampled(sections)
    found = _nearest(sections, required, options, points=by_torch)
    if not by_torch:
        return [(one.distance, one.certified) for one in found]
    values = [
        evaluate_distance(sections, required, scale, one, relative=metric == "relative")
        for metric, one in zip(options.metrics, found, strict=True)
    ]
    return [(value, one.known(value)) for value, one in zip(values, found, strict=True)]


def any_sampled(sections: CrossSections) -> bool:
    """Whether the engine knows one of the force models by samples only."""
    from torcharm.engine.forces import SAMPLED, models_of

    return bool((models_of(sections.actuators).kind == SAMPLED).any())


def wants_gradient(grid: DesignTaskGrid, segment: int) -> bool:
    """Whether anything that distances depend on asks for its gradient."""
    arm = grid.segments[segment]
    inputs = (*arm.tensors(), grid.twists, grid.external, grid.unit_weight, grid.mass)
    wanted = any(value.requires_grad for value in inputs)
    return torch.is_grad_enabled() and (wanted or want_gradients(arm.actuators, arm.radii))


def possible_sections(sections: CrossSections) -> tuple[CrossSections, Tensor]:
    """The sections with those of impossible shapes made harmless, and which (b, p) these are."""
    lost = (sections.strain.detach() <= -1).flatten(-2).any(-1)
    if not bool(lost.any()):
        return sections, lost
    mask = lost[..., None, None]
    constant = sections.constant
    return replace(
        sections,
        strain=torch.where(mask, 0.0, sections.strain),
        bending=torch.where(mask.unsqueeze(-1), 0.0, sections.bending),
        constant=None if constant is None else torch.where(mask, 0.0, constant),
    ), lost


def strain_excess(sections: CrossSections) -> Tensor:
    """(b, p) the largest strain beyond its actuator's characterised range, 0 if none is."""
    *_, beyond = characterised_range(sections.actuators, sections.strain)
    return beyond.flatten(-2).amax(-1).clamp(min=0)
