"""External loads, carried to the nodes: the wrench that a task requires of each.

Plain statics in the plane and in space: at a node the loads beyond it ask for the force `Σ F_j` and the moment
`Σ M_j + (p_j - p) × F_j`, both turned into the node's frame. The same as carrying wrenches from node to node by
`Ad⁻ᵀ`, without a loop. How loads change as an arm moves is in `engine/carried_load.py`, held against this by a test.
"""

import math
import operator
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from types import ModuleType

import torch
from jaxtyping import Float
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries, RigidLink
from torcharm.geometry.rod import chain, check_rod, element_twists, with_links
from torcharm.inputs import broadcast_shapes, check_choice, check_tensor, shown
from torcharm.load import GRAVITY, ExternalLoad, PointLoad
from torcharm.task import WRENCH_AT, WRENCH_PLACES, Task, check_segments

HULL = {3: (0, 2), 6: (0, 4, 5)}
"""Components that pressures can change, of wrenches of the plane and of space: what hulls are made of."""

_ON_A_NODE = 1e-9
"""How near to a node, in elements, a load counts as sitting on it: above what rounding makes of a place such as
0.7 times 10 elements, and far below any distance that matters."""


def required_wrench(
    twists: Float[Tensor, "*#batch N K"],
    load: Tensor | ExternalLoad,
    base_pose: Tensor | str | None = None,
    *,
    wrench_at: str = WRENCH_AT,
    segment_nodes: Sequence[int] | None = None,
    mass: Tensor | float | Sequence[Tensor | float] | None = None,
    links: Sequence[RigidLink | None] | None = None,
) -> Float[Tensor, "... N K"]:
    """The reaction `w_i = -q_i` that loads ask of each node, in the node's frame [N, N·m].

    Where a load sits decides which elements carry it. At "start" (the paper) the wrench is that at the element's
    start: node i carries what lies beyond it, a load inside of element i in full and the element's whole weight. A
    load on a node acts on the element before it, and one at the arm's base on none. First order in 1/N.

    At "middle" the wrench is that in the middle of the element, in the frame there: it carries what lies beyond, and
    the outer half of its own weight. Of a load inside an element it carries the share φ that lies before the load, at
    the middle of that share: the mean over the element, of which the strain is constant. (All or nothing, by the
    side of the middle that the load is on, would leave an error of half an element's stretch, of first order.)
    Second order in 1/N.

    Args:
        twists: (..., N, 3) or (..., N, 6), as of `poses` [m, rad].
        load: a tip load (..., 3) or (..., 6) in the world frame [N, N·m], or an ExternalLoad.
        base_pose: pose of node 1, as of `poses`.
        wrench_at: "middle" or "start".
        segment_nodes: number of elements of each segment in series; None is one segment.
        mass: the arm's own (...) [kg], or one for each segment, spread evenly over the segment's normalised arc; it
            weighs if the load has gravity.
        links: for each segment the rigid link that follows it, or None.

    Raises:
        ValueError: shapes do not fit.

    Example:
        >>> straight, pull = ta.constant_curvature(0.0, length=0.4, nodes=2), ta.ExternalLoad(tip=[1.0, -2.0, 0.0])
        >>> ta.required_wrench(straight, pull).round(decimals=3).tolist()  # the base has the longer lever
        [[-2.0, -1.0, -0.3], [-2.0, -1.0, -0.1]]
    """
    check_choice("wrench_at", wrench_at, WRENCH_PLACES)
    group, counts, base = check_rod(twists, base_pose, segment_nodes)
    columns = twists.shape[-1]
    if not isinstance(load, ExternalLoad):
        check_tensor("load", load, columns)
        load = ExternalLoad().with_tip(load)
    elif load.columns not in (None, columns):
        raise ValueError(f"load: must be of {columns} components as the twists are, got {load.columns}")
    broadcast_shapes(twists=twists.shape[:-2], load=load.batch_shape)
    check_segments(load, len(counts))
    rod = _rod(group, element_twists(twists, counts), base, counts, _check_links(links, counts), wrench_at)
    parts = [] if load.tip is None else [_carried(rod, load.tip.unsqueeze(-2), rod.tip_place)]
    for point in load.points:
        parts += _point_load(rod, point, gravity=load.gravity)
    if load.gravity:
        parts += _link_weights(rod)
        parts += _own_weight(rod, _masses(mass, counts, twists))
    return -_in_node_frames(rod, parts)


def arm_wrench(
    arm: ArmDesign | ArmSeries,
    twists: Tensor,
    load: ExternalLoad,
    base_pose: Tensor,
    wrench_at: str,
    segment_nodes: Sequence[int] | None,
) -> Tensor:
    """`required_wrench` with the masses and links of an arm."""
    links = arm.links if isinstance(arm, ArmSeries) else None
    mass = [segment.mass for segment in arm.segments] if isinstance(arm, ArmSeries) else [arm.mass]
    options = {"wrench_at": wrench_at, "segment_nodes": segment_nodes}
    return required_wrench(twists, load, base_pose, **options, mass=mass, links=links)  # type: ignore[arg-type]


def task_wrench(arm: ArmDesign | ArmSeries, task: Task) -> Float[Tensor, "... N K"]:
    """`required_wrench` of a task for an arm: with the arm's masses and links, at the task's place.

    Raises:
        ValueError: the task's dimension or its segments are not the arm's.
    """
    segments = len(arm.segments) if isinstance(arm, ArmSeries) else 1
    if arm.dimension != task.dimension:
        raise ValueError(f"task: must be of the arm's dimension {arm.dimension}, got {task.dimension}")
    if len(task.segment_nodes or (0,)) != segments:
        raise ValueError(f"segment_nodes: must hold one number for each of {segments} segments, got {shown(task)}")
    return arm_wrench(arm, task.twists, task.load, task.base_pose, task.wrench_at, task.segment_nodes)


@dataclass(frozen=True)
class _Rod:
    """A shape, and where on it wrenches are taken.

    Attributes:
        group: se2 or se3.
        step: (..., N, K) twists of the elements.
        node: poses of the elements' starts.
        frame: poses at which the elements' wrenches are taken.
        base_place: (..., 1, D) position of the base.
        place: (..., N, D) positions at which the wrenches are taken.
        tip_place: (..., 1, D).
        counts: elements of each segment.
        links: what follows each segment.
        middle: whether wrenches are taken in the middle of an element.
    """

    group: ModuleType
    step: Tensor
    node: Tensor
    frame: Tensor
    base_place: Tensor
    place: Tensor
    tip_place: Tensor
    counts: tuple[int, ...]
    links: tuple[RigidLink | None, ...]
    middle: bool

    def pose_at(self, element: int, fraction: float) -> Tensor:
        """Pose at a fraction of an element, with the nodes' dimension kept, of size 1."""
        node = self.node.narrow(-1 - len(self.group.POSE_SHAPE), element, 1)
        if fraction == 0:
            return node
        return self.group.compose(node, self.group.exp(fraction * self.step[..., element : element + 1, :]))

    @property
    def down(self) -> Tensor:
        """Weight (D,) of a kilogram in the world frame [N]."""
        return self.step.new_tensor((0.0, -GRAVITY, 0.0)[: self.group.DIMENSION])


Part = tuple[Tensor, Tensor]
"""Force (..., N or 1, D) and moment (..., N or 1, 1 or 3) on the elements about where their wrenches are taken, along
the world's axes."""


def _rod(
    group: ModuleType,
    step: Tensor,
    base: Tensor,
    counts: tuple[int, ...],
    links: tuple[RigidLink | None, ...],
    wrench_at: str,
) -> _Rod:
    """The poses of a shape's elements."""
    ends = [None if link is None else link.end(group.DIMENSION).to(step) for link in links]
    pose = chain(base, with_links(group.exp(step), counts, ends), group)
    node = pose.narrow(-1 - len(group.POSE_SHAPE), 0, step.shape[-2])
    middle = wrench_at == "middle"
    frame = group.compose(node, group.exp(step / 2)) if middle else node
    at = group.position(pose)
    place = group.position(frame) if middle else at[..., :-1, :]
    return _Rod(group, step, node, frame, at[..., :1, :], place, at[..., -1:, :], counts, links, middle)


def _carried(rod: _Rod, wrench: Tensor, place: Tensor, element: int | None = None, fraction: float = 1.0) -> Part:
    """A wrench (..., 1, K) along the world's axes at a place (..., 1, D), carried to the elements before it.

    The place is at a fraction of an element, or at the tip.
    """
    group, lever = rod.group, place - rod.place
    force, moment = wrench[..., : group.DIMENSION], wrench[..., group.DIMENSION :]
    if element is None:
        return force, moment + group.lever_moment(lever, force)
    share = [1.0] * (element + 1) + [0.0] * (rod.step.shape[-2] - element - 1)
    if rod.middle and fraction < 1:
        share[element] = fraction
        own = place - group.position(rod.pose_at(element, fraction / 2))
        lever = torch.cat((lever[..., :element, :], own, lever[..., element + 1 :, :]), -2)
    part = rod.step.new_tensor(share).unsqueeze(-1)
    return part * force, part * (moment + group.lever_moment(lever, force))


def _in_node_frames(rod: _Rod, parts: list[Part]) -> Tensor:
    """The sum of all parts as wrenches (..., N, K) in the frames at which they are taken."""
    if not parts:
        return torch.zeros_like(rod.step)
    force, moment = (reduce(operator.add, column) for column in zip(*parts, strict=True))
    shape = torch.broadcast_shapes(force.shape[:-1], moment.shape[:-1], rod.place.shape[:-1])
    wrench = torch.cat((force.expand(*shape, -1), moment.expand(*shape, -1)), -1)
    return rod.group.turn_wrench_back(rod.frame, wrench)


def _weight(rod: _Rod, mass: Tensor) -> Tensor:
    """Wrench (..., 1, K) of the weight of a mass (...) about itself."""
    force = mass[..., None, None] * rod.down
    return torch.cat((force, force.new_zeros(*force.shape[:-1], rod.step.shape[-1] - rod.group.DIMENSION)), -1)


def place_of(point: PointLoad, counts: Sequence[int]) -> tuple[int, float]:
    """Where a point load is: the element, and the fraction of it, 0 only where the load's segment begins."""
    first, count = sum(counts[: point.segment]), counts[point.segment]
    along = point.at * count
    along = round(along) if abs(along - round(along)) < _ON_A_NODE else along
    local = max(math.ceil(along) - 1, 0)
    return first + local, along - local


def carrier(element: int, fraction: float) -> tuple[int, float]:
    """The last element that carries a load at such a place, and to which fraction of it; -1 if only the base does."""
    return (element, fraction) if fraction > 0 else (element - 1, 1.0)


def _point_load(rod: _Rod, point: PointLoad, *, gravity: bool) -> list[Part]:
    """A point load's wrench and weight, on the elements before it."""
    element, fraction = place_of(point, rod.counts)
    pose = rod.pose_at(element, fraction)
    element, fraction = carrier(element, fraction)
    if element < 0:
        return []  # the base carries it
    place, parts = rod.group.position(pose), []
    if point.wrench is not None:
        wrench = point.wrench.unsqueeze(-2)
        wrench = rod.group.turn_wrench(pose, wrench) if point.frame == "body" else wrench
        parts.append(_carried(rod, wrench, place, element, fraction))
    if gravity and _weighs(point.mass):
        parts.append(_carried(rod, _weight(rod, point.mass), place, element, fraction))
    return parts


def _link_weights(rod: _Rod) -> list[Part]:
    """The weights of links, in the middle of the line from their start to their end."""
    parts = []
    for index, link in enumerate(rod.links):
        if link is not None and _weighs(link.mass):
            last = sum(rod.counts[: index + 1]) - 1
            half = rod.group.position(link.end(rod.group.DIMENSION).to(rod.step)) / 2
            place = rod.group.act(rod.pose_at(last, 1.0), half.unsqueeze(-2))
            parts.append(_carried(rod, _weight(rod, link.mass.to(rod.step)), place, last))
    return parts


def _own_weight(rod: _Rod, mass: Tensor | None) -> list[Part]:
    """The arm's own weight: every element's mass (..., N) at the centroid of its path."""
    if mass is None:
        return []
    group, mass = rod.group, mass.unsqueeze(-1)
    first = mass * (group.act(rod.node, group.centroid(rod.step)) - rod.base_place)
    beyond, moment = _from_tip(mass), _from_tip(first)
    if rod.middle:
        outer = group.act(rod.frame, group.centroid(rod.step / 2)) - rod.base_place
        beyond, moment = beyond - mass / 2, moment - first + mass / 2 * outer
    lever = moment - beyond * (rod.place - rod.base_place)
    return [(beyond * rod.down, group.lever_moment(lever, rod.down))]


def _from_tip(value: Tensor) -> Tensor:
    """Running sums along the nodes from the tip: of an element and all beyond it."""
    return value.flip(-2).cumsum(-2).flip(-2)


def _weighs(mass: Tensor) -> bool:
    """Whether there is a mass to be carried, or one whose gradient may be asked for."""
    return mass.requires_grad or bool((mass != 0).any())


def _masses(mass: object, counts: tuple[int, ...], like: Tensor) -> Tensor | None:
    """Masses (..., N) of the elements, or None where there are none."""
    given = list(mass) if isinstance(mass, (list, tuple)) else [mass]
    if mass is None:
        return None
    if len(given) != len(counts):
        raise ValueError(f"mass: must be one for each of {len(counts)} segments, got {len(given)}")
    each = [torch.as_tensor(one, dtype=like.dtype, device=like.device) for one in given]
    if not any(_weighs(one) for one in each):
        return None
    shape = broadcast_shapes(**{f"mass[{index}]": one.shape for index, one in enumerate(each)})
    parts = [
        (one / count).expand(shape).unsqueeze(-1).expand(*shape, count) for one, count in zip(each, counts, strict=True)
    ]
    return torch.cat(parts, -1)


def _check_links(links: Sequence[RigidLink | None] | None, counts: tuple[int, ...]) -> tuple[RigidLink | None, ...]:
    """One link or None for each segment."""
    if links is None:
        return (None,) * len(counts)
    if len(links) != len(counts):
        raise ValueError(f"links: must be one for each of the {len(counts)} segments, got {len(links)}")
    for index, link in enumerate(links):
        if link is not None and not isinstance(link, RigidLink):
            raise ValueError(f"links[{index}]: must be a RigidLink or None, got {shown(link)}")
    return tuple(links)
