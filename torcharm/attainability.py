"""Can these designs hold these shapes under these loads, and by how much do they miss?"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import prod

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from torcharm._inputs import check_choice, check_count, shown
from torcharm._outer import Block, OuterProduct, map_blocks, outer_product
from torcharm.arm import ArmDesign
from torcharm.distance.closed_form import NearestFaces, face_normals, nearest_faces, signed_length
from torcharm.hulls import (
    Curves,
    Sections,
    build_hulls,
    cross_sections,
    relative_curves,
    sample_count,
    sample_curves,
    slot_count,
)
from torcharm.polygon import face_square
from torcharm.task import Task
from torcharm.wrenches import PLANAR, along, required_wrench

METRICS = ("absolute", "relative")
DISTANCES = ("closed_form",)
BLOCK_ELEMENTS = 300_000
"""Hull slots × points in one block: a tensor of them is 2.4 MB, small enough for the caches."""


@dataclass(frozen=True, eq=False)
class Attainability:
    """What `evaluate` found; a metric that was not asked for is None.

    Shapes are (*design batch, *task batch), with N nodes added per node. The unit of a distance
    is that of `sqrt(k_f f² + k_m m²)`: with weights of one it mixes newtons and newton-metres, as
    the paper does.

    Attributes:
        absolute, relative: unattainability summed over the nodes, 0 if attainable.
        absolute_per_node, relative_per_node: each node's distance to its hull, not raised to a power.
        strain_excess: largest strain beyond its actuator's characterised range, 0 if none is.
        in_range: whether every strain, and every pressure limit, lies in the characterised range.
    """

    absolute: Tensor | None
    relative: Tensor | None
    absolute_per_node: Tensor | None
    relative_per_node: Tensor | None
    strain_excess: Tensor
    in_range: Tensor


@dataclass(frozen=True)
class _Check:
    """What to measure, and how."""

    metrics: tuple[str, ...]
    hull: str
    samples: int
    scale: tuple[float, float]
    signed: bool


def evaluate(
    arm: ArmDesign,
    task: Task,
    metrics: Sequence[str] = METRICS,
    *,
    hull: str = "exact",
    samples: int | None = None,
    distance: str = "closed_form",
    weights: tuple[float, float] = (1.0, 1.0),
    power: int = 1,
    signed: bool = False,
    chunk_size: int | None = None,
) -> Attainability:
    """Unattainability of every design on every task.

    At each node the reaction must equal the wrench that the load requires. *Absolute*
    unattainability is the distance from the required wrench to the hull of the wrenches that
    pressures can provide, summed over the nodes; *relative* unattainability is the same for
    differences from node 1. Both zero: as far as hulls can tell, the arm can hold the shape.

    Differentiable with respect to radii, lengths, pressure limits, twists and loads.

    Args:
        arm: designs, of any batch shape.
        task: tasks, of any batch shape. Loads that share a shape share its hulls.
        metrics: which of "absolute", "relative" to compute.
        hull: "exact", or "edges" as the paper samples.
        samples: points on each actuator's curve (exact) or on each edge of the pressure box
            (edges; the paper's 3); None chooses.
        distance: "closed_form".
        weights: k_f [1/N²] and k_m [1/(N·m)²] of the distance `sqrt(k_f f² + k_m m²)`.
        power: 1 sums distances (the paper's text), 2 their squares (the paper's table).
        signed: gives attainable tasks a negative value: where every node is inside its hull, minus
            the smallest margin along the arm (to the power). Node 1 has no part in the relative
            margin.
        chunk_size: (design, shape, load) triples worked on at once; None chooses. Bounds memory.

    Raises:
        ValueError: an argument is none of those allowed, or arm and task differ in dtype or device.
    """
    _check_arguments(arm, task, power, signed)
    check_choice("distance", distance, DISTANCES)
    check = _Check(_metrics(metrics), hull, sample_count(arm, hull, samples), _scale(weights), signed)
    outer = outer_product(arm, task)
    per_node, excess = _per_node(outer, check, chunk_size)
    found = {metric: per_node[..., index, :] for index, metric in enumerate(check.metrics)}
    total = {metric: _over_nodes(value, metric, power, signed) for metric, value in found.items()}
    return Attainability(
        absolute=total.get("absolute"),
        relative=total.get("relative"),
        absolute_per_node=found.get("absolute"),
        relative_per_node=found.get("relative"),
        strain_excess=excess,
        in_range=(excess <= 16 * torch.finfo(excess.dtype).eps) & _limits_in_range(outer),
    )


def _check_arguments(arm: ArmDesign, task: Task, power: int, signed: bool) -> None:
    for name, value, kind in (("arm", arm, ArmDesign), ("task", task, Task), ("signed", signed, bool)):
        if not isinstance(value, kind):
            raise ValueError(f"{name}: must be of type {kind.__name__}, got {shown(value)}")
    if isinstance(power, bool) or not isinstance(power, int) or power not in (1, 2):
        raise ValueError(f"power: must be 1 or 2, got {shown(power)}")
    ours, theirs = arm.radii, task.twists
    if ours.dtype != theirs.dtype or ours.device != theirs.device:
        raise ValueError(
            f"task: must have the arm's dtype and device, {ours.dtype} on {ours.device}, "
            f"got {theirs.dtype} on {theirs.device}; use task.to(...)"
        )


def _metrics(metrics: Sequence[str]) -> tuple[str, ...]:
    """The metrics asked for, once each."""
    names = (metrics,) if isinstance(metrics, str) else metrics
    if not isinstance(names, (list, tuple, set, frozenset)) or not names:
        raise ValueError(f"metrics: must name at least one of {', '.join(METRICS)}, got {shown(metrics)}")
    for name in names:
        check_choice("metrics", name, METRICS)
    return tuple(dict.fromkeys(names))


def _scale(weights: tuple[float, float]) -> tuple[float, float]:
    try:
        force, moment = (float(weight) for weight in weights)
    except (TypeError, ValueError, RuntimeError):
        raise ValueError(f"weights: must be two numbers (k_f, k_m), got {shown(weights)}") from None
    if not (0 < force < float("inf") and 0 < moment < float("inf")):
        raise ValueError(f"weights: must be finite and above 0, got {(force, moment)}")
    return force**0.5, moment**0.5


def _per_node(outer: OuterProduct, check: _Check, chunk_size: int | None) -> tuple[Tensor, Tensor]:
    """Distances (*design batch, *task batch, K, N) of the K metrics, and the strain excess."""
    if chunk_size is None:
        slots = slot_count(outer.arm.actuator_count, check.hull, check.samples)
        chunk_size = max(1, BLOCK_ELEMENTS // (slots * outer.nodes))
    check_count("chunk_size", chunk_size, 1)
    if 0 in outer.sizes:
        empty = outer.arm.radii.new_zeros(*outer.sizes, len(check.metrics), outer.nodes)
        return outer.unflatten(empty), outer.unflatten(empty.new_zeros(outer.sizes))
    recompute = prod(outer.sizes) > chunk_size
    blocks = map_blocks(outer, chunk_size, lambda block: _distances(block, check, recompute))
    return outer.unflatten(blocks[0]), outer.unflatten(blocks[1])


def _distances(block: Block, check: _Check, recompute: bool) -> tuple[Tensor, Tensor]:
    """Distances (d, p, l, K, N) to the hulls, and the strain excess (d, p, l).

    The hulls are searched without gradients. Where gradients are wanted, the reactions at the two
    ends of each nearest face are evaluated once more with them: a graph of two pressures a
    node, not of whole hulls, and one that is rebuilt when it is needed if there are many blocks.
    """
    recording = torch.is_grad_enabled()
    followed = recording and _inputs_want_gradient(block)
    with torch.no_grad():
        sections = cross_sections(block.arm, block.twists)
        with torch.set_grad_enabled(recording and not followed):
            curves = sample_curves(sections, check.samples)
        replayed = followed or curves.force.requires_grad  # a force model may hold what is asked about
        found = _nearest_faces(block, sections, curves, check, slots=replayed)
    if not replayed:
        squares = [faces.square for faces, _ in found]
        excess = _strain_excess(sections)
    else:
        replay = _Replay(block, check, [fraction for _, fraction in found])
        *squares, excess = checkpoint(replay, use_reentrant=False) if recompute else replay()
    lengths = [
        signed_length(square, faces.inside, faces.blur, signed=check.signed)
        for square, (faces, _) in zip(squares, found, strict=True)
    ]
    per_node = torch.stack(lengths).unflatten(1, sections.shape)  # (K, p, N, d, l)
    return per_node.permute(3, 1, 4, 0, 2), excess.T.unsqueeze(-1).expand(-1, -1, per_node.shape[-1])


def _inputs_want_gradient(block: Block) -> bool:
    arm = block.arm
    inputs = (arm.radii, arm.length, arm.max_pressure, block.twists, block.tip_load, block.base_pose)
    return any(value.requires_grad for value in inputs)


def _nearest_faces(
    block: Block, sections: Sections, curves: Curves, check: _Check, *, slots: bool
) -> list[tuple[NearestFaces, Tensor | None]]:
    """For each metric, where the required wrenches stand to the hulls, and (with slots) the
    pressure fractions (2, M, B, l) of the nearest faces."""
    found = []
    for metric in check.metrics:
        relative = metric == "relative"
        hulls = build_hulls(relative_curves(sections, curves) if relative else curves, check.hull, check.scale)
        point = _required(block, check, relative)
        faces = nearest_faces(hulls.polygons, *point, slots=slots)
        fraction = None
        if faces.slot is not None:
            normal = face_normals(hulls.polygons, faces, *point)
            fraction = hulls.fractions(faces.slot, normal, point, faces.square)
        found.append((faces, fraction))
    return found


@dataclass(frozen=True)
class _Replay:
    """Squared distances to faces already found, and the strain excess, with gradients."""

    block: Block
    check: _Check
    fractions: list[Tensor | None]

    def __call__(self) -> tuple[Tensor, ...]:
        sections = cross_sections(self.block.arm, self.block.twists)
        squares = []
        for metric, fraction in zip(self.check.metrics, self.fractions, strict=True):
            assert fraction is not None
            relative = metric == "relative"
            force, moment = sections.wrench(fraction, relative=relative)
            x, y = self.check.scale[0] * force, self.check.scale[1] * moment
            point = _required(self.block, self.check, relative)
            squares.append(face_square(point, (x[0], y[0]), (x[1], y[1])))
        return *squares, _strain_excess(sections)


def _required(block: Block, check: _Check, relative: bool) -> tuple[Tensor, Tensor]:
    """Required wrenches, scaled, as two tensors (B, l)."""
    wrench = required_wrench(block.twists[:, None], block.tip_load, block.base_pose)[..., PLANAR]
    if relative:
        wrench = wrench - wrench[..., :1, :]
    by_node = wrench.movedim(1, -2).unsqueeze(2)  # (p, N, 1, l, 2)
    by_section = by_node.expand(-1, -1, len(block.arm.radii), -1, -1).flatten(0, 2)
    return check.scale[0] * by_section[..., 0], check.scale[1] * by_section[..., 1]


def _strain_excess(sections: Sections) -> Tensor:
    """Largest strain (p, d) beyond its actuator's characterised range, 0 if none is."""
    low, high = zip(*(model.strain_range for model in sections.actuators), strict=True)
    strain = sections.strain
    beyond = torch.maximum(strain - along(high, strain, -2), along(low, strain, -2) - strain)
    return beyond.amax(0).view(sections.shape).amax(1).clamp(min=0)


def _limits_in_range(outer: OuterProduct) -> Tensor:
    """Whether every pressure limit lies in its model's characterised range."""
    highest = along([model.pressure_range[1] for model in outer.arm.actuators], outer.arm.radii, -1)
    inside = (outer.arm.max_pressure <= highest).all(-1)
    return outer.unflatten(inside.view(-1, 1, 1).expand(outer.sizes))


def _over_nodes(distance: Tensor, metric: str, power: int, signed: bool) -> Tensor:
    """The sum of distances to a power over the nodes; where all are inside, minus the least margin."""
    total = distance.clamp(min=0).pow(power).sum(-1)
    if not signed:
        return total
    free = distance[..., 1:] if metric == "relative" and distance.shape[-1] > 1 else distance
    nearest = free.amax(-1)
    return torch.where(nearest < 0, -nearest.abs().pow(power), total)
