"""How attainable sets are sampled: error and time of `evaluate`, against converged distances."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

import torcharm as ta
from experiments.error_vs_runtime import measure
from experiments.error_vs_runtime.rows import Key, Row
from experiments.reference import SCAN, CurveSums, attainable_sets, enclosed_distance, extents, joined, required

DESIGNS, NODES = 10, 10
SHAPES = ((-3.0, 3.0), (1.0, 1.5), (6.0, -1.5))
TASKS = 20
BATCH = DESIGNS * TASKS * NODES
CHECKED = 6
"""Of the tasks, those whose errors are taken."""
BUDGET = 0.2
"""Seconds that a time's repeats may take."""
SAMPLES = (2, 3, 5, 9, 17)
ARMS: dict[str, Callable[..., ta.ArmDesign]] = {
    "antagonistic": ta.antagonistic_arm,
    "bellows-only": ta.bellows_arm,
    "muscle-only": ta.mckibben_arm,
}
RADII = {
    "antagonistic": ((0.04, 0.10), (0.01, 0.03)),
    "bellows-only": ((0.04, 0.10), (0.01, 0.03)),
    "muscle-only": ((0.005, 0.03), (0.005, 0.03)),
}
BOUNDS, DOUBLED = "between its bounds", "scan doubled"
Jobs = Iterator[tuple[Key, Callable[[], Row]]]


@dataclass(frozen=True)
class Method:
    name: str
    hull: str
    samples: int
    polish: bool = False
    compiled: bool = False

    @property
    def setting(self) -> str:
        return f"{self.samples} points"


METHODS = (
    *(Method("edges", "edges", samples) for samples in SAMPLES),
    *(Method("exact, sampled", "exact", samples) for samples in SAMPLES),
    Method("exact, polished", "exact", 3, polish=True),
    Method("exact, polished, compiled", "exact", 3, polish=True, compiled=True),
)


def parameters(arm: str) -> Tensor:
    """Outer and inner radius and length (3, DESIGNS) [m] of random designs."""
    generator = torch.Generator().manual_seed(sum(map(ord, arm)))
    low, high = torch.tensor((*RADII[arm], (0.45, 0.55)), dtype=torch.float64).T.unsqueeze(-1)
    return low + (high - low) * torch.rand(3, DESIGNS, generator=generator, dtype=torch.float64)


def twists() -> Tensor:
    """Shapes (TASKS, N, 3): the paper's three in turn."""
    slope, intercept = torch.tensor([SHAPES[index % len(SHAPES)] for index in range(TASKS)], dtype=torch.float64).T
    return ta.affine_curvature(slope, intercept, length=0.5, nodes=NODES)


def checked_scenes(arm: str, metric: str, count: int = DESIGNS) -> tuple[CurveSums, measure.Array]:
    """The sets and required wrenches of some designs' checked tasks, design by design and node by node."""
    designs, relative = ARMS[arm](*parameters(arm)), metric == "relative"
    shapes, loads = twists().numpy()[:CHECKED], ta.sample_loads(TASKS).numpy()[:CHECKED]
    scenes = [(designs[index], *task) for index in range(count) for task in zip(shapes, loads, strict=True)]
    sets = joined([attainable_sets(design, shape, relative=relative) for design, shape, _ in scenes])
    return sets, np.concatenate([required(shape, load, relative=relative) for _, shape, load in scenes])


@cache
def reference(arm: str, metric: str) -> tuple[measure.Array, measure.Array]:
    """Distances and scales, (DESIGNS, CHECKED, N) each."""
    sets, points = checked_scenes(arm, metric)
    distance = enclosed_distance(sets, points)[0].clip(min=0.0)
    grid = (DESIGNS, CHECKED, NODES)
    return distance.reshape(grid), extents(sets, points).reshape(grid)


def reference_row(arm: str, metric: str, setting: str) -> Row:
    """How converged the reference is: by its own bounds, or by what a scan twice as fine changes."""
    sets, points = checked_scenes(arm, metric, 1)
    spent = measure.timed(lambda _: enclosed_distance(sets, points), BUDGET)
    scale = extents(sets, points)
    lower, upper = enclosed_distance(sets, points)
    other = upper if setting == BOUNDS else enclosed_distance(sets, points, SCAN.doubled())[0]
    return Row(
        family="reference",
        case=f"{arm}, {metric}",
        method="converged distance",
        setting=setting,
        dtype="float64",
        batch=len(points),
        problems=len(points),
        **measure.not_measured(),
        converged=float(np.isfinite(lower).mean()),
        **measure.error_columns(measure.errors(other, lower, scale, np.isfinite(lower))),
        **measure.slope_columns(np.empty(0)),
        **measure.time_columns(spent, measure.Timing(), len(points)),
    )


def jobs() -> Jobs:
    for arm in ARMS:
        for metric in ("absolute", "relative"):
            for setting in (BOUNDS, DOUBLED):
                key = ("reference", f"{arm}, {metric}", "converged distance", setting, "float64", str(CHECKED * NODES))
                yield key, partial(reference_row, arm, metric, setting)
            for method in METHODS:
                for dtype, batch in (("float64", BATCH), ("float32", BATCH), ("float64", NODES)):
                    if dtype == "float32" and method.name == "edges" and method.samples not in (2, 3, 5):
                        continue  # dear, and no better than in float64
                    if dtype == "float32" and method.compiled:
                        continue  # polished without machine code
                    key = ("sets", f"{arm}, {metric}", method.name, method.setting, dtype, str(batch))
                    yield key, partial(row, arm, metric, method, dtype, batch)


@dataclass(frozen=True)
class Calls:
    """What is timed: a call of one design and task (a batch of N nodes), or of all.

    Attributes:
        kind: of the numbers.
        values: outer and inner radii and lengths (3, designs).
        task: theirs.
    """

    arm: str
    metric: str
    method: Method
    kind: torch.dtype
    values: Tensor
    task: ta.Task

    @classmethod
    def of(cls, arm: str, metric: str, method: Method, dtype: str, batch: int) -> "Calls":
        kind, single = getattr(torch, dtype), batch == NODES
        columns = parameters(arm)[:, :1] if single else parameters(arm)
        chosen = slice(0, 1) if single else slice(None)
        shapes, loads = twists().to(kind), ta.sample_loads(TASKS).to(kind)
        return cls(arm, metric, method, kind, columns, ta.Task(shapes[chosen], loads[chosen]))

    def evaluate(self, values: Tensor, task: ta.Task, **more: Any) -> ta.Attainability:
        """Designs on a task."""
        return ta.evaluate(
            ARMS[self.arm](*values.to(self.kind)),
            task,
            (self.metric,),
            hull=self.method.hull,
            samples=self.method.samples,
            polish=self.method.polish,
            compiled=self.method.compiled,
            **more,
        )

    def forward(self, _: int) -> None:
        with torch.no_grad():
            self.evaluate(self.values, self.task)

    def gradient(self, _: int) -> None:
        leaf = self.values.clone().requires_grad_()
        torch.autograd.grad(getattr(self.evaluate(leaf, self.task), self.metric).sum(), leaf)


def row(arm: str, metric: str, method: Method, dtype: str, batch: int) -> Row:
    """Measure: in a call of one design and task (a batch of N nodes), or of all."""
    calls = Calls.of(arm, metric, method, dtype, batch)
    if method.compiled:
        calls.forward(0)  # compiles, or loads what was
    spent, memory = measure.timed_with_memory(calls.forward, BUDGET)
    with torch.no_grad():
        checked = ta.Task(twists().to(calls.kind)[:CHECKED], ta.sample_loads(TASKS).to(calls.kind)[:CHECKED])
        found = calls.evaluate(parameters(arm), checked)
        audited = calls.evaluate(parameters(arm)[:, :1], checked, residuals=True)
    own = slice(1, None) if metric == "relative" else slice(None)  # node 1 differs from itself by nothing
    distance, scale = (value[..., own] for value in reference(arm, metric))
    value = getattr(found, f"{metric}_per_node").double().numpy()[..., own]
    error = measure.errors(value, distance, scale, np.ones_like(value, dtype=bool)).ravel()
    assert audited.residuals is not None
    residuals = audited.residuals[metric]
    return Row(
        family="sets",
        case=f"{arm}, {metric}",
        method=method.name,
        setting=method.setting,
        dtype=dtype,
        batch=batch,
        problems=error.size,
        memory_mib=memory,
        primal_max=float(residuals.primal.max()),
        dual_max=float(residuals.dual.max()),
        gap_max=float(residuals.gap.max()),
        converged=float(found.converged.double().mean()),
        resolved=float(residuals.resolved.double().mean()),
        in_range=float(found.in_range.double().mean()),
        **measure.error_columns(error),
        **measure.slope_columns(np.empty(0)),
        **measure.time_columns(spent, measure.timed(calls.gradient, BUDGET), batch),
    )
