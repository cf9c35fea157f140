"""Why a task is not held."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.attainability.questions import question
from torcharm.statics.cross_section import RANGE_SLACK, cross_sections, per_actuator

UNDECIDED = {
    "not converged": "a stable shape, but perhaps not the best pressure: search_pressure may find a better one",
    "unstable": "no stable equilibrium near the task's shape was found: search_pressure follows the arm from rest",
    "not reached": "stable there, but loading from rest leads to another shape: search_pressure finds the closest",
}

NOTHING = 1e-6
"""A miss [N] that explains nothing: of the size of rounding."""


def one_design(segment: ArmDesign, batch: torch.Size, index: tuple[int, ...]) -> ArmDesign:
    """One design of a segment, whose arm has a batch of designs."""
    return segment._map(lambda value: value.detach().expand(*batch, value.shape[-1])[index])


def missing(absolute: Tensor | None, relative: Tensor | None, weights: tuple[float, float]) -> str:
    """Which node, from 1, lacks how much; "" where none does.

    Args:
        absolute, relative: distances (N,) from the nodes' sets; the latter count where the former are none.
        weights: k_f and k_m, by which forces and moments are one distance.
    """
    force, moment = weights
    unit = (
        "N (1 N·m as 1 N)" if (force, moment) == (1.0, 1.0) else f"(by weights {force:g} of N², {moment:g} of (N·m)²)"
    )
    for distance, what in (
        (absolute, "node {} lacks {:.3g} {}"),
        (relative, "no pressure serves all nodes: node {} lacks {:.3g} {} of change from the base"),
    ):
        if distance is not None:
            miss, node = distance.max(-1)
            if float(miss) > NOTHING:
                return what.format(int(node) + 1, float(miss), unit)
    return ""


@dataclass(frozen=True)
class _Strain:
    """A strain, where it is, and what was characterised."""

    excess: float
    value: float
    actuator: int
    node: int
    low: float
    high: float


def out_of_range(segments: Sequence[ArmDesign], twists: Tensor, nodes: Sequence[int]) -> str:
    """The actuator that is strained furthest beyond its range, or whose limit is, and whether units are to blame.

    Args:
        segments: of one design.
        twists: (N, 3 or 6) of all segments.
        nodes: of each segment.
    """
    asked = question(segments, twists, nodes)
    return "; ".join(filter(None, (_beyond(segments, twists, nodes), asked)))


def _beyond(segments: Sequence[ArmDesign], twists: Tensor, nodes: Sequence[int]) -> str:
    worst = max(_strains(segments, twists, nodes), key=lambda one: one.excess)
    if worst.value <= -1:
        return f"actuator {worst.actuator} would have no length at node {worst.node} (strain {worst.value:.3g})"
    if worst.excess > RANGE_SLACK:
        return (
            f"actuator {worst.actuator} is strained to {worst.value:+.2g} at node {worst.node}, "
            f"characterised from {worst.low:+.2g} to {worst.high:+.2g}"
        )
    first = 0
    for segment in segments:
        for index, model in enumerate(segment.actuators):
            limit, known = float(segment.max_pressure[index]), float(model.pressure_range[1])
            if limit > known * (1 + RANGE_SLACK):
                return f"actuator {first + index + 1} is driven to {limit:g} kPa, characterised to {known:g} kPa"
        first += segment.actuator_count
    return "a pressure lies outside of what was characterised"


def _strains(segments: Sequence[ArmDesign], twists: Tensor, nodes: Sequence[int]) -> list[_Strain]:
    """The worst strain of each segment."""
    found, actuators, before = [], 0, 0
    for segment, own in zip(segments, twists.split(list(nodes), -2), strict=True):
        with torch.no_grad():
            strain = cross_sections(segment, own).strain
            low, high = (per_actuator([m.strain_range[end] for m in segment.actuators], strain) for end in (0, 1))
            excess = torch.maximum(low - strain, strain - high)
        excess = torch.where(strain <= -1, 1e3 - strain, excess)  # no length at all is worse than any strain
        place = int(excess.argmax())
        node, actuator = divmod(place, segment.actuator_count)
        ends = float(low[actuator]), float(high[actuator])
        value = float(strain[node, actuator])
        found.append(_Strain(float(excess[node, actuator]), value, actuators + actuator + 1, before + node + 1, *ends))
        actuators, before = actuators + segment.actuator_count, before + own.shape[-2]
    return found
