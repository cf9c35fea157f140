"""An arm's loads as the engine takes them: from external loads, masses and links to wrenches at places."""

import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries, RigidLink, segments_of
from torcharm.engine.arms import Loads, flat, pose_rows
from torcharm.geometry import se2, se3
from torcharm.load import GRAVITY, ExternalLoad, PointLoad
from torcharm.statics.external_load import carrier, place_of


def loads_of(
    arm: ArmDesign | ArmSeries,
    load: ExternalLoad,
    base_pose: Tensor,
    batch: tuple[int, ...],
    nodes: Sequence[int],
    *,
    middle: bool,
) -> Loads:
    """The loads of a batch, expanded and flattened; arguments as of `arms_of`.

    Args:
        load: whose batch broadcasts to `batch`, like that of the arm's masses.
        base_pose: (..., 3) or (..., 4, 4).
        middle: whether wrenches are taken in the middle of elements.
    """
    segments, links = segments_of(arm)
    size = 3 if arm.dimension == 2 else 6
    places = [] if load.tip is None else [_Place(load.tip, sum(nodes) - 1, 1.0)]
    for point in load.points:
        places += _point(point, nodes, load.gravity, size)
    if load.gravity:
        for index, link in enumerate(links):
            if link is not None and bool((link.mass != 0).any()):
                places.append(_link(link, sum(nodes[: index + 1]) - 1, size))
    places.sort(key=lambda place: (place.element, place.fraction))
    count, dimension = math.prod(batch), arm.dimension
    wrench, offset = np.zeros((count, len(places), size)), np.zeros((count, len(places), dimension))
    for q, place in enumerate(places):
        wrench[:, q] = flat(place.wrench, batch)
        if place.offset is not None:
            offset[:, q] = flat(place.offset, batch)
    weight = np.zeros((count, len(segments)))
    if load.gravity:
        for index, (segment, number) in enumerate(zip(segments, nodes, strict=True)):
            weight[:, index] = GRAVITY / number * flat(segment.mass.unsqueeze(-1), batch)[:, 0]
    base = pose_rows(base_pose)
    base = torch.cat((base[..., :-dimension], torch.zeros_like(base[..., -dimension:])), -1)
    return Loads(
        flat(base, batch),
        wrench,
        offset,
        np.array([place.element for place in places], dtype=np.int64),
        np.array([place.fraction for place in places], dtype=np.float64),
        np.array([place.before_link for place in places], dtype=np.bool_),
        np.array([place.follows for place in places], dtype=np.bool_),
        weight,
        middle,
    )


class _Place:
    """A wrench (..., K) at a fraction of an element."""

    def __init__(
        self, wrench: Tensor, element: int, fraction: float, follows: bool = False, before_link: bool = False
    ) -> None:
        self.wrench, self.element, self.fraction = wrench, element, fraction
        self.follows, self.before_link = follows, before_link
        self.offset: Tensor | None = None


def _point(point: PointLoad, nodes: Sequence[int], gravity: bool, size: int) -> list[_Place]:
    """A point load's wrench and weight; none where the base carries it."""
    at, along = place_of(point, nodes)
    element, fraction = carrier(at, along)
    if element < 0:
        return []
    before, found = along > 0, []
    if point.wrench is not None:
        found.append(_Place(point.wrench, element, fraction, point.frame == "body", before))
    if gravity and bool((point.mass != 0).any()):
        found.append(_Place(_weight(point.mass, size), element, fraction, before_link=before))
    return found


def _link(link: RigidLink, element: int, size: int) -> _Place:
    """A link's weight, in the middle of the line from its start to its end."""
    place = _Place(_weight(link.mass, size), element, 1.0, before_link=True)
    group = se2 if size == 3 else se3
    place.offset = group.position(link.end(group.DIMENSION)) / 2
    return place


def _weight(mass: Tensor, size: int) -> Tensor:
    """The weight of a mass (...) as a wrench (..., K)."""
    zero = torch.zeros_like(mass)
    return torch.stack((zero, -GRAVITY * mass, *(zero,) * (size - 2)), -1)
