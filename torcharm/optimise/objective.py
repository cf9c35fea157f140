"""What a design is judged by: one number from its results on all tasks, and its gradient."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import ceil
from typing import Any

import torch
from torch import Tensor

from torcharm._inputs import check_choice, check_count, shown
from torcharm.arm import ArmDesign
from torcharm.attainability import Attainability, check_power, evaluate, scale_of
from torcharm.optimise.feasible import Polytope
from torcharm.optimise.scene import Scene
from torcharm.task import Task
from torcharm.wrench_sets.node_distances import SetOptions

METRICS = ("unattainability", "predicted_error")
AGGREGATES = ("mean", "worst", "cvar", "count")
LEAST_TOGETHER, BLOCKS_TOGETHER = 4, 2
"""Of starts that descend at once, the least number and how many blocks of work they make."""
SMOOTHED = ("worst", "count")
"""Aggregates that a gradient follows through a smooth stand-in, sharpened in stages."""


@dataclass(frozen=True)
class Objective:
    """How designs are compared; smaller is better.

    Attributes:
        metric: "unattainability", or "predicted_error", the predicted shape error [m]. A design whose prediction is
            not converged and stable on every task is no candidate: its value is infinite.
        relative_weight: λ of `absolute + λ relative` unattainability.
        over: "mean" over the tasks; "worst", the largest; "cvar", the mean of the worst share `tail`;
            "count", of tasks above `threshold`, and among equal counts the mean m by `m/(1 + m)`.
        tail: the share of tasks in "cvar".
        threshold: up to which a task counts as done in "count".
        margin: whether to go on once every task is attainable, by the (negative) margins; None does
            wherever `metric` knows margins.
        size_weight: added per metre of the arm's width and of its mean neutral length.
        weights, power, chunk_size: as in `torcharm.evaluate`, whose exact sets and distances are used.

    Raises:
        ValueError: an argument is none of those allowed.
    """

    metric: str = "unattainability"
    relative_weight: float = 0.0
    over: str = "mean"
    tail: float = 0.1
    threshold: float = 0.0
    margin: bool | None = None
    size_weight: float = 0.0
    weights: tuple[float, float] = (1.0, 1.0)
    power: int = 1
    chunk_size: int | None = None

    def __post_init__(self) -> None:
        check_choice("metric", self.metric, METRICS)
        check_choice("over", self.over, AGGREGATES)
        for name in ("relative_weight", "threshold", "size_weight"):
            value = getattr(self, name)
            if not (isinstance(value, (int, float)) and 0 <= value < float("inf")):
                raise ValueError(f"{name}: must be a number of at least 0, got {shown(value)}")
        if not (isinstance(self.tail, (int, float)) and 0 < self.tail <= 1):
            raise ValueError(f"tail: must be above 0 and at most 1, got {shown(self.tail)}")
        scale_of(self.weights)
        check_power(self.power)
        able = self.metric == "unattainability"
        if self.margin and not able:
            raise ValueError(f"margin: True needs metric='unattainability', got {self.metric!r}")
        if self.chunk_size is not None:
            check_count("chunk_size", self.chunk_size, 1)
        object.__setattr__(self, "margin", able if self.margin is None else self.margin)

    @property
    def metrics(self) -> tuple[str, ...]:
        """The metrics of `torcharm.evaluate` that are needed."""
        if self.metric != "unattainability":
            return (self.metric,)
        return ("absolute", "relative") if self.relative_weight else ("absolute",)

    def scene(self, arm: ArmDesign, task: Task) -> Scene | None:
        """Tasks prepared for designs like `arm`, where the metrics are distances to attainable sets; else None."""
        if self.metric != "unattainability":
            return None
        options = SetOptions(self.metrics, scale_of(self.weights), bool(self.margin))
        factors = (1.0, self.relative_weight)[: len(self.metrics)]
        return Scene.of(arm, task, options, factors, self.power, self.chunk_size)

    def results(self, arm: ArmDesign, tasks: Sequence[Task]) -> list[Attainability]:
        """What `torcharm.evaluate` finds, of the metrics needed, for each batch of tasks."""
        options: dict[str, Any] = {"weights": self.weights, "power": self.power, "chunk_size": self.chunk_size}
        return [evaluate(arm, task, self.metrics, signed=bool(self.margin), **options) for task in tasks]

    def of_result(self, result: Attainability) -> Tensor:
        """One value a task, of the shape of the result's metrics.

        NaN where a distance did not converge; infinite where an actuator has no length, or where a predicted error is
        not that of a stable equilibrium, or its pressures did not converge.
        """
        if self.metric == "predicted_error":
            assert result.prediction is not None
            error = result.prediction.shape_error
            sound = result.prediction.converged & result.prediction.stable & error.isfinite()
            return torch.where(sound, error, torch.inf)
        assert result.absolute is not None
        value = result.absolute
        if self.relative_weight:
            assert result.relative is not None
            value = value + self.relative_weight * result.relative
        return torch.where(result.converged | result.impossible, value, value.new_full((), torch.nan))

    def per_task(self, arm: ArmDesign, tasks: Sequence[Task]) -> Tensor:
        """Values (*design batch, T) of all T tasks."""
        lead = len(arm.batch_shape)
        values = [self.of_result(result) for result in self.results(arm, tasks)]
        return torch.cat([value.flatten(lead) if value.ndim > lead else value.unsqueeze(-1) for value in values], -1)

    def total(self, values: Tensor) -> Tensor:
        """The number (...) that designs with values (..., T) are compared by, the cost of size aside."""
        if self.over == "worst":
            return values.amax(-1)
        if self.over == "cvar":
            return values.topk(ceil(self.tail * values.shape[-1]), -1).values.mean(-1)
        mean = values.clamp(min=0).mean(-1)
        if self.over == "count":
            missed = (values > self.threshold).to(values.dtype).sum(-1)
            return torch.where(mean.isfinite(), missed + mean / (1 + mean), mean)
        with torch.no_grad():
            done = (values <= 0).all(-1)
            if not bool(done.any()):
                return mean
        return torch.where(done, values.mean(-1), mean)

    def smooth_total(self, values: Tensor, temperature: Tensor) -> Tensor:
        """A stand-in (...) that has a gradient worth following; the total itself where that has one.

        The worst case is `τ log mean exp(v/τ)`; a count is the sum of `v₊/(v₊ + τ)`, of excesses over the
        threshold, which is the count for small τ and proportional to the sum for large.
        """
        if self.over not in SMOOTHED:
            return self.total(values)
        spread = temperature.unsqueeze(-1)
        if self.over == "worst":
            scaled = torch.logsumexp(values / spread, -1) - torch.tensor(float(values.shape[-1])).log()
            return temperature * scaled
        excess = (values - self.threshold).clamp(min=0)
        return (excess / (excess + spread)).sum(-1)

    def size(self, arm: ArmDesign) -> Tensor:
        """The cost (*design batch) of size."""
        width = arm.radii.amax(-1) - arm.radii.amin(-1)
        return self.size_weight * (width + arm.length.mean(-1))


@dataclass(frozen=True, eq=False)
class Judged:
    """S points, judged.

    Attributes:
        value: (S,) the objective; infinite where it is no number.
        smooth: (S,) the stand-in that descent follows.
        gradient: (S, F) of the stand-in; None if not asked for.
        spread: (S,) the size of values over tasks, for choosing temperatures.
    """

    value: Tensor
    smooth: Tensor
    gradient: Tensor | None
    spread: Tensor


@dataclass(frozen=True, eq=False)
class Problem:
    """A polytope of designs for each architecture, the tasks, and the objective.

    Attributes:
        polytopes: A of them, of one dimension F.
        tasks: batches of tasks.
        objective: by which designs are judged.
        scenes: the tasks, prepared, for each architecture; None where the objective goes through `evaluate`.
    """

    polytopes: tuple[Polytope, ...]
    tasks: tuple[Task, ...]
    objective: Objective
    scenes: tuple[tuple[Scene, ...] | None, ...] = field(init=False)

    def __post_init__(self) -> None:
        found = []
        for polytope in self.polytopes:
            own = [self.objective.scene(polytope.arm, task) for task in self.tasks]
            scenes = tuple(scene for scene in own if scene is not None)
            found.append(scenes if len(scenes) == len(own) else None)
        object.__setattr__(self, "scenes", tuple(found))

    @property
    def dimension(self) -> int:
        """F."""
        return self.polytopes[0].dimension

    @property
    def together(self) -> int:
        """Starts that descend at once: more would not be done sooner."""
        scenes = [scene for own in self.scenes if own is not None for scene in own]
        return max([LEAST_TOGETHER, *(BLOCKS_TOGETHER * scene.designs_at_once for scene in scenes)])

    def constraints(self, owner: Tensor) -> tuple[Tensor, Tensor]:
        """A (S, C, F) and b (S, C) of points whose polytopes are numbered by `owner` (S,), padded to one C."""
        if len(self.polytopes) == 1:
            only = self.polytopes[0]
            return only.rows[None], only.bound[None]
        most = max(len(one.bound) for one in self.polytopes)
        rows = torch.zeros(len(self.polytopes), most, self.dimension, dtype=torch.float64)
        bound = torch.ones(len(self.polytopes), most, dtype=torch.float64)
        for index, one in enumerate(self.polytopes):
            rows[index, : len(one.bound)], bound[index, : len(one.bound)] = one.rows, one.bound
        return rows[owner], bound[owner]

    def judge(self, point: Tensor, owner: Tensor, temperature: Tensor, *, gradient: bool) -> Judged:
        """Judge points (S, F), each of the polytope numbered by `owner` (S,)."""
        if len(self.polytopes) == 1:
            return self._judge_alike(0, point, temperature, gradient)
        value, smooth, spread = (point.new_empty(len(point)) for _ in range(3))
        slope = torch.zeros_like(point)
        for index in owner.unique().tolist():
            own = (owner == index).nonzero().squeeze(-1)
            part = self._judge_alike(index, point[own], temperature[own], gradient)
            value[own], smooth[own], spread[own] = part.value, part.smooth, part.spread
            if part.gradient is not None:
                slope[own] = part.gradient
        return Judged(value, smooth, slope if gradient else None, spread)

    def _values(self, architecture: int, arm: ArmDesign) -> Tensor:
        """(S, T) of all T tasks."""
        scenes = self.scenes[architecture]
        if scenes is None:
            return self.objective.per_task(arm, self.tasks)
        values = [scene.values(arm) for scene in scenes]
        return values[0] if len(values) == 1 else torch.cat(values, -1)

    def _judge_alike(self, architecture: int, point: Tensor, temperature: Tensor, gradient: bool) -> Judged:
        """Judge points of one polytope: with gradients, so many at once that their graph stays small."""
        scenes = self.scenes[architecture]
        each = len(point) if scenes is None or not gradient else min(scene.designs_at_once for scene in scenes)
        parts = [
            self._judge_at_once(architecture, part, heat, gradient)
            for part, heat in zip(point.split(max(1, each)), temperature.split(max(1, each)), strict=True)
        ]
        if len(parts) == 1:
            return parts[0]
        value, smooth, slope, spread = (
            torch.cat([getattr(part, name) for part in parts]) if name != "gradient" or gradient else None
            for name in ("value", "smooth", "gradient", "spread")
        )
        assert value is not None
        assert smooth is not None
        assert spread is not None
        return Judged(value, smooth, slope, spread)

    def _judge_at_once(self, architecture: int, point: Tensor, temperature: Tensor, gradient: bool) -> Judged:
        objective = self.objective
        slope = torch.zeros_like(point) if gradient else None
        with torch.set_grad_enabled(gradient):
            at = point.detach().requires_grad_(gradient)
            arm = self.polytopes[architecture].design(at)
            values = self._values(architecture, arm).double().cpu()
            smooth = objective.smooth_total(values, temperature)
            size = objective.size(arm).double().cpu() if objective.size_weight else None
            smooth = smooth if size is None else smooth + size
            if gradient and smooth.requires_grad:
                (slope,) = torch.autograd.grad(smooth.sum(), at)
        smooth, values = smooth.detach(), values.detach()
        with torch.no_grad():
            value = smooth
            if objective.over in SMOOTHED:
                value = objective.total(values) if size is None else objective.total(values) + size.detach()
            spread = values.abs().amax(-1)
            sound = value.isfinite() & smooth.isfinite()
            sound = sound if slope is None else sound & slope.isfinite().all(-1)
            if bool(sound.all()):
                return Judged(value, smooth, slope, spread)
            return Judged(
                torch.where(sound, value, torch.inf),
                torch.where(sound, smooth, torch.inf),
                None if slope is None else torch.where(sound.unsqueeze(-1), slope, 0.0),
                torch.where(sound, spread, 1.0),
            )
