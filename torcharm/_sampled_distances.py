"""Distances to sampled attainable sets: nearest faces found without a graph, then followed through the polygons.

The graph holds each section's samples once, whatever the number of loads, and one face of each load.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from torcharm._outer import Block, OuterProduct
from torcharm.actuators import want_gradients
from torcharm.distance.closed_form import NearestFaces, face_distance, nearest_faces, signed_length
from torcharm.hulls import Curves, Hulls, Sections, build_hulls, cross_sections, relative_curves, sample_curves
from torcharm.wrenches import PLANAR, actuator_force, along, required_wrench

ROUNDING_ULPS = 16
"""Distances of so many roundings of the largest wrench of their node are 0."""
SUSPECT_ULPS = 2**20
"""Distances of so many roundings of the load, or of 1 N, are looked at: no hull is as large as would make others 0."""
Pair = tuple[Tensor, Tensor]
Required = dict[str, Pair]
"""For each metric the required forces and moments, (P, N, L) each, scaled."""


@dataclass(frozen=True)
class Sampling:
    """What to measure, and how.

    Attributes:
        metrics: of "absolute" and "relative".
        hull, samples: how attainable sets are sampled.
        scale: factors on force and moment.
        signed: whether inside counts as negative.
    """

    metrics: tuple[str, ...]
    hull: str
    samples: int
    scale: tuple[float, float]
    signed: bool


def required_by_metric(tasks: OuterProduct | Block, metrics: tuple[str, ...], scale: tuple[float, float]) -> Required:
    """What tasks require, scaled (p, N, l), which depends on no design."""
    wrench = required_wrench(tasks.twists[:, None], tasks.tip_load, tasks.base_pose)[..., PLANAR].movedim(1, -2)
    found = {}
    for metric in metrics:
        own = wrench - wrench[:, :1] if metric == "relative" else wrench
        found[metric] = scale[0] * own[..., 0], scale[1] * own[..., 1]
    return found


def points_of(block: Block, required: Pair, *, whole: bool = True) -> Pair:
    """Of required wrenches, of the whole or of the block, those of the block as points (B, l) of its sections."""
    _, shapes, loads = block.place if whole else (slice(None),) * 3
    designs = len(block.arm.radii)
    x, y = (value[shapes, :, loads].unsqueeze(2).expand(-1, -1, designs, -1).flatten(0, 2) for value in required)
    return x, y


@dataclass(frozen=True, eq=False)
class Sampled:
    """Distances, and what they were found from.

    Attributes:
        lengths: (B, l) for each metric.
        sections: the actuators.
        hulls, points: for each metric; with the graph of none if it is rebuilt when needed.
        excess: (p, d) largest strain beyond its actuator's characterised range, if asked for.
    """

    lengths: tuple[Tensor, ...]
    sections: Sections
    hulls: tuple[Hulls, ...]
    points: tuple[Pair, ...]
    excess: Tensor | None


def sampled_distances(
    block: Block, required: Required, sampling: Sampling, *, recompute: bool, excess: bool = True
) -> Sampled:
    """Distances from what is required to what is attainable.

    Args:
        required: by all tasks, of which the block's are taken.
        recompute: whether to rebuild graphs when they are needed instead of keeping them.
        excess: whether strains beyond their range are asked for.
    """
    recording = torch.is_grad_enabled()
    points = tuple(points_of(block, required[metric]) for metric in sampling.metrics)
    followed = recording and (inputs_want_gradient(block) or any(x.requires_grad for x, _ in points))
    with torch.set_grad_enabled(recording and not (recompute and followed)):
        sections = possible_sections(block)
        curves = sample_curves(sections, sampling.samples)
    again = followed and recompute
    with torch.set_grad_enabled(recording and not again):
        hulls = _hulls(sections, curves, sampling)
    with torch.no_grad():
        faces = [nearest_faces(own.polygons, *point, slots=followed) for own, point in zip(hulls, points, strict=True)]
    if again:
        replay = partial(_replayed, block, points, sampling, faces, excess)
        *lengths, beyond = checkpoint(replay, use_reentrant=False)
    else:
        lengths = _lengths(hulls, points, sampling, faces, followed=followed)
        beyond = strain_excess(sections) if excess else None
    lengths = decided(block, sampling, lengths)
    return Sampled(tuple(lengths), sections, hulls, points, beyond)


def _hulls(sections: Sections, curves: Curves, sampling: Sampling) -> tuple[Hulls, ...]:
    return tuple(hulls_of(sections, curves, sampling, metric == "relative") for metric in sampling.metrics)


def hulls_of(sections: Sections, curves: Curves, sampling: Sampling, relative: bool) -> Hulls:
    """The attainable sets, or those of differences from node 1."""
    return build_hulls(relative_curves(sections, curves) if relative else curves, sampling.hull, sampling.scale)


def _lengths(
    hulls: tuple[Hulls, ...],
    points: tuple[Pair, ...],
    sampling: Sampling,
    faces: list[NearestFaces],
    *,
    followed: bool,
) -> list[Tensor]:
    if not followed:
        return [signed_length(one.square, one.inside, one.blur, signed=sampling.signed) for one in faces]
    return [
        face_distance(own.polygons, one, *point, signed=sampling.signed)
        for own, point, one in zip(hulls, points, faces, strict=True)
    ]


def _replayed(
    block: Block, points: tuple[Pair, ...], sampling: Sampling, faces: list[NearestFaces], excess: bool
) -> tuple[Tensor | None, ...]:
    """The distances to faces already found, and the strain excess, from the start."""
    sections = possible_sections(block)
    hulls = _hulls(sections, sample_curves(sections, sampling.samples), sampling)
    lengths = _lengths(hulls, points, sampling, faces, followed=True)
    return *lengths, strain_excess(sections) if excess else None


def inputs_want_gradient(block: Block) -> bool:
    """Whether any tensor of the block does, or what the force models hold."""
    arm = block.arm
    inputs = (arm.radii, arm.length, arm.max_pressure, block.twists, block.tip_load, block.base_pose)
    return any(value.requires_grad for value in inputs) or want_gradients(arm.actuators, arm.radii)


def impossible_nodes(radii: Tensor, twists: Tensor) -> Tensor:
    """(p, N, d) whether an actuator of designs with radii (d, M) has no length, or less, on shapes (p, N, 3)."""
    with torch.no_grad():
        length, _, curvature = twists.unsqueeze(-2).unbind(-1)
        highest, lowest = radii.amax(-1), radii.amin(-1)
        return torch.minimum(length - highest * curvature, length - lowest * curvature) <= 0


def possible_sections(block: Block) -> Sections:
    """The sections of a block. Shapes that leave an actuator no length are taken as unstrained, for which every force
    model has a number and a slope: what is found there is replaced by `decided`."""
    sections = cross_sections(block.arm, block.twists)
    lost = impossible_nodes(block.arm.radii, block.twists)
    if not bool(lost.any()):
        return sections
    lost = lost.any(1, keepdim=True).expand_as(lost).flatten()
    return replace(sections, strain=torch.where(lost, 0.0, sections.strain))


def decided(block: Block, sampling: Sampling, lengths: Sequence[Tensor]) -> list[Tensor]:
    """The distances (B, l) of each metric; infinite on shapes that leave an actuator no length, with a gradient of
    zero, as they stay so; and 0 where they are no more than rounding of the wrenches that are required and provided."""
    lost = impossible_nodes(block.arm.radii, block.twists)
    anywhere = bool(lost.any())
    lost = lost.any(1, keepdim=True).expand_as(lost).flatten().unsqueeze(-1)
    answers = []
    for metric, length in zip(sampling.metrics, lengths, strict=True):
        answer = _without_rounding(block, sampling.scale, length, relative=metric == "relative")
        answers.append(torch.where(lost, float("inf"), answer) if anywhere else answer)
    return answers


def _without_rounding(block: Block, scale: tuple[float, float], length: Tensor, *, relative: bool) -> Tensor:
    with torch.no_grad():
        eps = torch.finfo(length.dtype).eps
        largest = block.tip_load.abs().amax() if block.tip_load.numel() else length.new_zeros(())
        doubtful = (length > 0) & (length <= SUSPECT_ULPS * eps * max(scale) * (1 + largest))
        if not bool(doubtful.any()):
            return length
        x, y = points_of(block, required_by_metric(block, ("absolute",), scale)["absolute"], whole=False)
        sections = possible_sections(block)
        ends = sections.limit.new_tensor([0.0, 1.0]).view(2, 1, 1) * sections.limit
        force = actuator_force(sections.actuators, sections.strain, ends, dim=-2).abs().amax(0)
        moment = (force * sections.radii.abs()).sum(0) + sections.bending.abs().sum(0)
        provided = torch.hypot(scale[0] * force.sum(0), scale[1] * moment).unsqueeze(-1)
        wrench = torch.maximum(torch.hypot(x, y), provided)
        if relative:
            nodes = wrench.view(*sections.shape, -1)
            wrench = torch.maximum(nodes, nodes[:, :1]).flatten(0, 2)
        nothing = doubtful & (length <= ROUNDING_ULPS * eps * wrench)
    return torch.where(nothing, 0.0, length)


def strain_excess(sections: Sections) -> Tensor:
    """Largest strain (p, d) beyond its actuator's characterised range, 0 if none is."""
    low, high = zip(*(model.strain_range for model in sections.actuators), strict=True)
    strain = sections.strain
    beyond = torch.maximum(strain - along(high, strain, -2), along(low, strain, -2) - strain)
    return beyond.amax(0).view(sections.shape).amax(1).clamp(min=0)
