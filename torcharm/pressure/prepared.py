"""Every design against every task, as problems of equilibrium with the poses that are wanted."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries
from torcharm.engine.arms import flat, pose_rows
from torcharm.engine.continuation import CONTINUED, FAILED
from torcharm.engine.path import Found
from torcharm.engine.pose_error import Goal
from torcharm.engine.pressure_model import Problem as EngineProblem
from torcharm.equilibrium.problem import Problem
from torcharm.equilibrium.stability import lengths_positive, stays
from torcharm.geometry import rod
from torcharm.inputs import check_above_zero, shown
from torcharm.pressure.pose_cost import PoseCost
from torcharm.statics.balance import link_ends
from torcharm.task import Task
from torcharm.wrench_sets.design_task_grid import fitted

Numbers = NDArray[Any]


@dataclass(frozen=True, eq=False)
class Prepared:
    """B = D·T pairs of D designs and T tasks, in float64 on the CPU, with their graphs.

    Attributes:
        problem: of equilibrium, of batch (*design batch, *task batch), with the limits (*batch, M) as pressures.
        twists: (*task batch, N, K) the shapes that are wanted.
        cost: what is minimised.
        like: a tensor of the dtype and on the device in which results are wanted.
    """

    problem: Problem
    twists: Tensor
    cost: PoseCost
    like: Tensor

    @property
    def batch(self) -> tuple[int, ...]:
        """(*design batch, *task batch)."""
        return self.problem.batch

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return self.problem.arm.dimension

    @property
    def nodes(self) -> int:
        """N."""
        return self.twists.shape[-2]

    @property
    def weights(self) -> Tensor:
        """(*#batch, N+1, 3 or 6) of the squared errors of poses."""
        return self.cost.weights(self.nodes, self.problem.arm.neutral_length, self.dimension)

    @cached_property
    def possible(self) -> Tensor:
        """(*batch) whether every length of the shape that is wanted is above 0."""
        with torch.no_grad():
            return lengths_positive(self.problem, self.twists).expand(self.batch)

    def poses(self, twists: Tensor) -> Tensor:
        """Poses (..., N+1, 3) or (..., N+1, 4, 4) of twists (..., N, K)."""
        problem = self.problem
        return rod.poses(twists, problem.base_pose, segment_nodes=problem.nodes, links=link_ends(problem.arm))

    def flat(self, value: Tensor, data: int) -> Numbers:
        """A tensor (*#batch, ...) as numbers (B, ...), of so many dimensions of data."""
        return flat(value, self.batch, data)

    def shaped(self, value: Numbers) -> Tensor:
        """Numbers (B, ...) as a tensor (*batch, ...)."""
        return torch.from_numpy(value).reshape((*self.batch, *value.shape[1:]))

    def at(self, normalised: Tensor) -> Problem:
        """The problems at normalised pressures (*batch, M)."""
        return replace(self.problem, pressure=normalised * self.problem.pressure)

    def given_back(self, value: Tensor) -> Tensor:
        """A result in the dtype and on the device of what was given."""
        value = value.to(self.like.dtype) if value.is_floating_point() else value
        return value.to(self.like.device)

    @cached_property
    def shape(self) -> Numbers:
        """(B, N, K) twists that are wanted."""
        return self.flat(self.twists, 2)

    @cached_property
    def start(self) -> Numbers:
        """(B, N, K) the same, but 0 in the columns in which the arms are rigid, as they are without load."""
        start = np.zeros_like(self.shape)
        start[..., self.problem.unknown] = self.shape[..., self.problem.unknown]
        return start

    @property
    def wrench_weights(self) -> Numbers:
        """(C,) roots of the weights of forces [1/N] and moments [1/(N·m)] where pressures are looked for that hold a
        shape: a moment counts as the force that has it at the largest offset."""
        linear = np.array([column < self.dimension for column in self.engine.arms.unknown])
        reach = max(float(self.engine.scale.reach.max(initial=0.0)), 1e-3)
        return np.where(linear, 1.0, 1.0 / reach)

    @cached_property
    def engine(self) -> EngineProblem:
        """The problems as the engine takes them."""
        with torch.no_grad():
            goal = Goal(self.flat(self._goal(), 2), self.flat(self.weights[..., 1:, :], 2))
        return self.problem.packed._replace(goal=goal)

    def _goal(self) -> Tensor:
        """Poses wanted at the ends of the elements, as of `Goal`."""
        wanted, base = self.poses(self.twists)[..., 1:, :], self.problem.base_pose
        if self.dimension == 3:
            wanted = self.poses(self.twists)[..., 1:, :, :]
            rows = pose_rows(wanted)
            return torch.cat((rows[..., :9], rows[..., 9:] - base[:3, 3]), -1)
        turn = rod.element_twists(self.twists, self.problem.nodes)[..., 2].cumsum(-1)
        return torch.cat((wanted[..., :2] - base[:2], turn.expand(wanted.shape[:-1]).unsqueeze(-1)), -1)


def prepare(
    arm: ArmDesign | ArmSeries, task: Task, cost: PoseCost | None, shear_stiffness: float | None = None
) -> Prepared:
    """Every design against every task.

    Raises:
        ValueError: arm and task do not fit, or another argument is none of those allowed.
    """
    arm, task = fitted(arm, task)
    cost = PoseCost() if cost is None else cost
    if not isinstance(cost, PoseCost):
        raise ValueError(f"pose_cost: must be a PoseCost, got {shown(cost)}")
    cost.weights(task.nodes, arm.neutral_length, task.dimension)
    stiffness = check_above_zero("shear_stiffness", shear_stiffness)
    beside = _beside(arm, len(task.batch_shape))
    batch = (*arm.batch_shape, *task.batch_shape)
    nodes = task.segment_nodes or (task.nodes,)
    limits = beside.max_pressure.expand(*batch, arm.actuator_count)
    problem = Problem(beside, limits, task.load, task.base_pose, nodes, task.wrench_at, stiffness, batch)
    twists = task.twists.to(device="cpu", dtype=torch.float64)
    return Prepared(problem.double(), twists, cost, task.twists)


def detached(prepared: Prepared) -> Prepared:
    """The same without graphs."""
    problem = prepared.problem

    def cut(value: Tensor) -> Tensor:
        return value.detach()

    arm = _mapped(problem.arm, cut, cut)
    plain = replace(
        problem,
        arm=arm,
        pressure=problem.pressure.detach(),
        load=problem.load._map(cut),
        base_pose=problem.base_pose.detach(),
    )
    return replace(prepared, problem=plain, twists=prepared.twists.detach())


def _beside(arm: ArmDesign | ArmSeries, count: int) -> ArmDesign | ArmSeries:
    """Designs whose batch has so many dimensions of size 1 behind it, for the tasks."""
    ones = (1,) * count

    def each_actuator(value: Tensor) -> Tensor:
        return value.reshape(*value.shape[:-1], *ones, value.shape[-1])

    return _mapped(arm, each_actuator, lambda value: value)


def _mapped(
    arm: ArmDesign | ArmSeries, change: Callable[[Tensor], Tensor], change_link: Callable[[Tensor], Tensor]
) -> ArmDesign | ArmSeries:
    """Designs with every tensor (*batch, M) or (*batch, 1) changed, and those of links, which serve all designs."""
    if isinstance(arm, ArmDesign):
        return arm._map(change)
    links = tuple(None if link is None else link._map(change_link) for link in arm.links)
    return ArmSeries(tuple(segment._map(change) for segment in arm.segments), links)


def stays_at(prepared: Prepared, normalised: Numbers, twists: Numbers, known: Numbers) -> Numbers:
    """(B,) which equilibria at normalised pressures (B, M) are stable, of those (B,) of which pivots say so: where
    these leave it open, eigenvalues tell."""
    nothing = np.zeros((len(known), 2))
    found = Found(twists, nothing[:, 0], np.where(known, CONTINUED, FAILED), nothing.astype(np.int64), nothing)
    return stays(prepared.engine._replace(limit=normalised * prepared.engine.limit), found)
