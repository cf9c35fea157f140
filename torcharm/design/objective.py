"""What designs are compared by: one number from all tasks, and its gradient."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from torcharm.attainability import check_power, evaluate, scale_of
from torcharm.design.feasible import FeasibleDesigns
from torcharm.design.robust import Robust, built_beside
from torcharm.design.scatter import Source
from torcharm.design.space import Arm, Array
from torcharm.inputs import check_choice, check_flag, check_number, shown
from torcharm.pressure.at_pressure import error_at_pressure
from torcharm.pressure.followed import beyond_range, followed_pressure, followed_twists
from torcharm.pressure.pose_cost import PoseCost
from torcharm.pressure.predicted_error import PredictedError, prediction
from torcharm.pressure.prepared import prepare
from torcharm.task import Task

METRICS = ("predicted_error", "unattainability")
AGGREGATES = ("mean", "worst")
NEAR_EDGE = 0.01
"""Of its characterised range, how close to an edge a strain may come at no price: so that a price that is not yet steep
stops it within."""
PRICE = 5.0
"""How steep the price is at the edge: a strain that leaves its range by a fifth of it halves what its error tells. A
gain on other tasks is seldom worth it."""
SMOOTHING = 0.02
"""Of the worst task's value, by how much others may differ from it and steer the descent as much: the mere maximum has
kinks at its minima, where a descent sticks."""


@dataclass(frozen=True)
class Objective:
    """How designs are compared; smaller is better.

    Attributes:
        metric: "predicted_error", the predicted shape error [m], or "unattainability", the paper's distances [N].
            A predicted error that is not converged counts as what its pressures reach; where no stable equilibrium is
            predicted, or an actuator has no length, the error counts as the length of the task's shape. Where a space
            asks for designs in range, it counts ever more like that length the farther the strains of the shape that is
            predicted leave their characterised range, as it is ever more of a guess: see `counted`.
        over: "mean" over the tasks, or "worst", the largest.
        task_weights: in the mean, one number for each task, in the order of the results; None weighs all alike.
        pose_cost: what predicted errors measure; None is `PoseCost()`.
        relative_weight: λ of `absolute + λ relative` unattainability.
        margin: whether unattainability goes on, below zero, to the margins once every task is attainable.
        weights, power: of unattainability, as in `torcharm.evaluate`, whose exact sets are used.
        robust: whether, and how, built arms count in place of the drawn one; of predicted errors alone.

    Raises:
        ValueError: an argument is none of those allowed.

    Example:
        >>> worst = ta.Objective("predicted_error", over="worst")
        >>> round(float(worst.total(torch.tensor([0.002, 0.005, 0.003]))), 4)  # the largest error of three tasks [m]
        0.005
    """

    metric: str = "predicted_error"
    over: str = "mean"
    task_weights: Sequence[float] | None = None
    pose_cost: PoseCost | None = None
    relative_weight: float = 0.0
    margin: bool = True
    weights: tuple[float, float] = (1.0, 1.0)
    power: int = 1
    robust: Robust | None = None

    def __post_init__(self) -> None:
        check_choice("metric", self.metric, METRICS)
        check_choice("over", self.over, AGGREGATES)
        check_number("relative_weight", self.relative_weight, 0.0)
        check_flag("margin", self.margin)
        scale_of(self.weights)
        check_power(self.power)
        if self.pose_cost is not None and not isinstance(self.pose_cost, PoseCost):
            raise ValueError(f"pose_cost: must be a PoseCost, got {shown(self.pose_cost)}")
        if self.robust is not None and (not isinstance(self.robust, Robust) or self.metric != "predicted_error"):
            raise ValueError(
                f"robust: must be a Robust, with metric 'predicted_error', got {shown(self.robust)} with {self.metric}"
            )
        if self.task_weights is not None:
            given = tuple(check_number("task_weights", weight, 0.0) for weight in self.task_weights)
            if not any(given) or self.over != "mean":
                raise ValueError("task_weights: must not all be 0, and over must be 'mean'")
            object.__setattr__(self, "task_weights", given)

    @property
    def unit(self) -> str:
        """Of the values."""
        return "m" if self.metric == "predicted_error" else "N"

    @property
    def metrics(self) -> tuple[str, ...]:
        """Of attainable sets."""
        return ("absolute", "relative") if self.relative_weight else ("absolute",)

    def total(self, values: Tensor) -> Tensor:
        """The number (...) that designs with values (..., T) are compared by; robust, that of values (..., S, T)."""
        return self._over_samples(self._over_tasks(values))

    def _over_samples(self, values: Tensor) -> Tensor:
        return values if self.robust is None else self.robust.total(values)

    def _over_tasks(self, values: Tensor) -> Tensor:
        if self.over == "worst":
            return values.amax(-1)
        if self.task_weights is not None:
            if len(self.task_weights) != values.shape[-1]:
                raise ValueError(f"task_weights: must be {values.shape[-1]} numbers, got {len(self.task_weights)}")
            share = values.new_tensor(self.task_weights)
            return (values * share).sum(-1) / share.sum()
        mean = values.clamp(min=0).mean(-1)  # what one task has to spare helps no other
        return torch.where((values.detach() <= 0).all(-1), values.mean(-1), mean)

    def smooth_total(self, values: Tensor) -> Tensor:
        """What the descent follows: the total, but of the worst case `τ log Σ exp(v/τ)`."""
        if self.over != "worst":
            return self.total(values)
        spread = SMOOTHING * values.abs().amax(-1).clamp(min=1e-12)
        return self._over_samples(spread * torch.logsumexp(values / spread.unsqueeze(-1), -1))


def flat_tasks(value: Tensor, lead: int) -> Tensor:
    """(*design batch, *task batch) of so many design dimensions as (*design batch, T)."""
    return value.flatten(lead) if value.ndim > lead else value.unsqueeze(-1)


def shape_lengths(task: Task) -> Tensor:
    """(T,) length of each task's shape [m]: what a shape error counts as that is not known."""
    length = task.twists[..., 0].detach().expand(*task.batch_shape, task.nodes)
    parts = length.split(task.nodes_of_segments, -1)
    return torch.stack([part.mean(-1) for part in parts]).sum(0).reshape(-1)


def counted(error: Tensor, stable: Tensor, beyond: Tensor | None, length: Tensor) -> Tensor:
    """What shape errors (..., T) [m] count as.

    Where an equilibrium is stable an error e counts as `e + (L - e) h / (1 + h)`, with L the length of the task's
    shape and h the price of a strain that leaves its range by a share x of it: 0 until `-d`, then a parabola that
    reaches slope s at the edge, then straight, with `d = NEAR_EDGE` and `s = PRICE`. Elsewhere it counts as L.

    Args:
        error: (..., T); those that are not stable may be anything.
        stable: (..., T).
        beyond: (..., T) the share x of the strain that leaves its range farthest; None sets no price.
        length: (T,) L.
    """
    length = length.to(error)
    if beyond is not None:
        near = (1 + beyond.clamp(max=0) / NEAR_EDGE).clamp(min=0)
        price = PRICE * (NEAR_EDGE / 2 * near.square() + beyond.clamp(min=0))
        error = error + (length - error).clamp(min=0) * price / (1 + price)
    return torch.where(stable, error, length)


def task_values(objective: Objective, arm: Arm, task: Task, *, in_range: bool, kept_from: Arm | None = None) -> Tensor:
    """(*design batch, T) of the T tasks of a batch, with a graph: predicted errors as `counted`, or unattainabilities,
    which are infinite where an actuator has no length and NaN where a distance is not known.

    Args:
        objective, arm, task: what and by what.
        in_range: whether strains that are predicted beyond their range have a price.
        kept_from: designs (*batch) whose pressures arms (*batch, S) keep; None finds the best for each arm.
    """
    lead = len(arm.batch_shape)
    if objective.metric == "predicted_error":
        if kept_from is None:
            found = prediction(arm, task, objective.pose_cost, held=True)
            beyond = _beyond(objective, arm, task, found) if in_range else None
        else:
            kept = _best_pressure(objective, kept_from, task).unsqueeze(lead - 1)
            found = error_at_pressure(arm, task, kept, objective.pose_cost)
            beyond = beyond_range(arm, task, found.twists) if in_range else None
        error, known = flat_tasks(found.shape_error, lead), flat_tasks(found.stable, lead)
        return counted(error, known, None if beyond is None else flat_tasks(beyond, lead), shape_lengths(task))
    options: dict[str, Any] = {"weights": objective.weights, "power": objective.power, "signed": objective.margin}
    result = evaluate(arm, task, objective.metrics, **options)
    total = result.absolute
    assert total is not None
    if objective.relative_weight:
        assert result.relative is not None
        total = total + objective.relative_weight * result.relative
    return flat_tasks(torch.where(result.converged | result.impossible, total, torch.nan), lead)


def _best_pressure(objective: Objective, arm: Arm, task: Task) -> Tensor:
    """(*design batch, *task batch, M) the pressures [kPa] that come closest, which follow their minimum."""
    with torch.no_grad():
        found = prediction(arm, task, objective.pose_cost)
    if not torch.is_grad_enabled():
        return found.pressure
    return followed_pressure(prepare(arm, task, objective.pose_cost), found)


def _beyond(objective: Objective, arm: Arm, task: Task, found: PredictedError) -> Tensor:
    """By which share of its range a strain that is predicted leaves it, with a graph where it has a price."""
    beyond = beyond_range(arm, task, found.twists)
    if found.shape_error.requires_grad and bool((found.stable & (beyond > -NEAR_EDGE)).any()):
        return beyond_range(arm, task, followed_twists(arm, task, objective.pose_cost, found))
    return beyond.detach()


@dataclass(frozen=True, eq=False)
class Problem:
    """Designs of one architecture on tasks, compared by an objective."""

    designs: FeasibleDesigns
    tasks: tuple[Task, ...]
    objective: Objective

    def values(self, arm: Arm) -> Tensor:
        """(*design batch, T) of all T tasks, with a graph; robust, (*design batch, S, T) of built arms."""
        robust, options = self.objective.robust, dict[str, Any](in_range=self.designs.in_range)
        if robust is None:
            return torch.cat([task_values(self.objective, arm, task, **options) for task in self.tasks], -1)
        built, kept_from = built_beside(arm, *self._draw), None if robust.compensated else arm
        values = [task_values(self.objective, built, task, **options, kept_from=kept_from) for task in self.tasks]
        return torch.cat(values, -1)

    @cached_property
    def _draw(self) -> tuple[Sequence[Source], Sequence[Tensor]]:
        """The samples of a robust objective."""
        assert self.objective.robust is not None
        return self.objective.robust.draw(self.designs.arm)

    def value(self, arm: Arm) -> Tensor:
        """(*design batch) the objective of designs, which need not be feasible; infinite where it is no number."""
        with torch.no_grad():
            value = self.objective.total(self.values(arm))
            return torch.where(value.isfinite(), value, torch.inf)

    def slope(self, point: Array) -> tuple[float, float, Array]:
        """The objective at a point (F,), what the descent follows, and the latter's gradient (F,)."""
        at = torch.from_numpy(point).requires_grad_()
        values = self.values(self.designs.design(at))
        followed = self.objective.smooth_total(values)
        (gradient,) = torch.autograd.grad(followed, at)
        return float(self.objective.total(values).detach()), float(followed.detach()), gradient.numpy()
