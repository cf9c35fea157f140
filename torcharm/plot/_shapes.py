"""Shapes that pictures show: those of tasks, those that were found, and where a centreline lies at them."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.arm_series import segments_of
from torcharm.attainability import Attainability
from torcharm.attainability.reasons import NO_CENTRELINE, out_of_range
from torcharm.design.space import Arm
from torcharm.equilibrium import Equilibrium
from torcharm.geometry import rod, se3
from torcharm.inputs import shown
from torcharm.load import ExternalLoad
from torcharm.plot._common import SMOOTHING, Array, array
from torcharm.pressure.predicted_error import PredictedError
from torcharm.pressure.search import PressureSearch
from torcharm.task import Task

AROUND = 12
"""Sides of a tube."""
SLIM = 0.35
"""A tube's radius over the least distance of two actuators, where no diameter is known."""

Shape = Tensor | Equilibrium | PressureSearch | PredictedError | Attainability
"""What a shape may be given as."""


def twists_of(field: str, found: Any) -> Tensor:
    """The twists of a shape, or of what was found, once they are known to be some."""
    given = found.prediction if isinstance(found, Attainability) else found
    twists = given if isinstance(given, Tensor) else getattr(given, "twists", None)
    if not isinstance(twists, Tensor):
        raise ValueError(
            f"{field}: must be twists, or what solve_equilibrium, search_pressure, predict_error or evaluate found, "
            f"got {shown(found)}"
        )
    if not bool(twists.isfinite().all()):
        raise ValueError(f"{field}: must be a shape that was found, got status {getattr(found, 'status', 'NaN')}")
    return twists.detach()


def task_of(arm: Arm, found: Task | Shape) -> Task:
    """The task itself, or that of an evaluation; or the shape that was found, with an equilibrium's loads and base."""
    if isinstance(found, Task | Attainability):
        return found if isinstance(found, Task) else found.task
    twists = twists_of("task", found)
    if isinstance(found, Equilibrium):
        base = found.base_pose.detach().reshape(-1, *rod.group_of(twists.shape[-1]).POSE_SHAPE)
        return Task(twists, None, base[0], found.load._map(Tensor.detach), segment_nodes=found.segment_nodes)
    count = len(segments_of(arm)[0])
    if twists.ndim < 2 or twists.shape[-2] % count:
        rows = tuple(twists.shape)
        raise ValueError(f"task: must be a Task where segments differ in their nodes, got twists of shape {rows}")
    segment_nodes = [twists.shape[-2] // count] * count if count > 1 else None
    return Task(twists, None, None, ExternalLoad(), segment_nodes=segment_nodes)


def why_impossible(arm: Arm, task: Task) -> str:
    """Of a task of one shape that leaves the centreline or an actuator no length."""
    if not bool((task.twists[..., 0] > 0).all()):
        return NO_CENTRELINE
    return out_of_range(segments_of(arm)[0], task.twists, task.nodes_of_segments)


@dataclass(frozen=True)
class Centreline:
    """Poses (P, 4, 4) along each segment, SMOOTHING to an element, and that of the tip."""

    segments: list[Array]
    tip: Array

    @property
    def points(self) -> Array:
        """(Q, 3) places from the base to the tip, links included."""
        return np.concatenate((*self.segments, self.tip[None]))[:, :3, 3]

    @property
    def gaps(self) -> list[Array]:
        """(2, 3) where what follows each segment begins and ends."""
        ends = [*(line[0] for line in self.segments[1:]), self.tip]
        return [np.stack((line[-1], end))[:, :3, 3] for line, end in zip(self.segments, ends, strict=True)]


def centreline(arm: Arm, twists: Tensor, task: Task) -> Centreline:
    """Where an arm's centreline lies at twists, from a task's base."""
    found, start = [], task.base_pose
    parts = twists.detach().to(start).split(task.nodes_of_segments)
    for own, link in zip(parts, segments_of(arm)[1], strict=True):
        poses = rod.poses(own.repeat_interleave(SMOOTHING, 0), start)
        found.append(in_space(poses))
        group, start = rod.group_of(twists.shape[-1]), poses[-1]
        if link is not None:
            start = group.compose(start, link.end(arm.dimension).detach().reshape(start.shape).to(start))
    return Centreline(found, in_space(start))


def tubes(segment: ArmDesign, line: Array) -> list[Array]:
    """Of each actuator of a segment the skin (P, AROUND + 1, 3) of a tube where it lies, by the poses (P, 4, 4) of the
    segment's centreline."""
    offsets = array(segment.offsets)
    apart = [np.linalg.norm(a - b) for i, a in enumerate(offsets) for b in offsets[:i]]
    slim = SLIM * min([float(one) for one in apart if one > 0] or [0.03])
    radii = [slim] * len(offsets) if segment.diameter is None else (0.5 * array(segment.diameter)).tolist()
    return [skin_of(line, y, z, radius) for (y, z), radius in zip(offsets, radii, strict=True)]


def skin_of(line: Array, y: float, z: float, radius: float) -> Array:
    """(P, AROUND + 1, 3) a tube along poses (P, 4, 4), whose axis is at (y, z) across them."""
    turn = np.linspace(0, 2 * np.pi, AROUND + 1)
    own = np.stack((0 * turn, y + radius * np.cos(turn), z + radius * np.sin(turn), 1 + 0 * turn))
    return np.moveaxis((line @ own)[:, :3], 1, -1)


def in_space(poses: Tensor) -> Array:
    """Poses as homogeneous matrices (..., 4, 4), those of the plane (..., 3) at z = 0."""
    return array(poses if poses.shape[-2:] == se3.POSE_SHAPE else se3.from_plane(poses))
