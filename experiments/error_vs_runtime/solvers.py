"""Distance solvers on the same 2,000 problems from real arms, against extended precision."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from importlib.util import find_spec
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torcharm.distance.qp import HalfspaceForm, VertexForm, require_qpth
from torcharm.distance.result import HullAnswer, HullDistance, HullProblem, solve_hulls

import torcharm as ta
from experiments.error_vs_runtime import measure, sets
from experiments.error_vs_runtime.rows import Row
from torcharm import hulls

COUNT = 2000
SINGLES = 20
NEAR = 1e-6
"""Gradients are compared where the point is further from the hull than this share of max|H - w|."""
Distance = Callable[[Tensor, Tensor], Any]


@dataclass(frozen=True)
class Problems:
    """Points (B, 2), vertices (B, V, 2), and for each the distance, its gradient in the point, and max|H - w|."""

    point: Tensor
    vertices: Tensor
    distance: measure.Array
    slope: measure.Array
    scale: measure.Array


@dataclass(frozen=True)
class Method:
    """A way to the distance: its name in the figure, its setting, and how many problems it can be given."""

    name: str
    setting: str
    work: Distance
    most: int = COUNT
    dtypes: tuple[str, ...] = ("float64",)
    differentiable: bool = True
    one_case: bool = False


# ---- the problems --------------------------------------------------------------------------


@cache
def problems(case: str) -> Problems:
    """2,000 of the random scenes' nodes, of the three arms in equal parts."""
    points, corners = [], []
    for arm, build in sets.ARMS.items():
        design = build(*sets.parameters(arm))
        shapes = sets.twists()[:3]
        if case.startswith("exact"):
            found = ta.wrench_hulls(design, shapes, samples=9).vertices  # (D, 3, N, V, 2)
        else:
            found = torch.stack([paper_points(design, shape) for shape in shapes], 1)
        wanted = ta.required_wrench(shapes[:, None], ta.sample_loads(sets.TASKS))[..., (0, 2)]  # (3, L, N, 2)
        shape = (sets.DESIGNS, *wanted.shape[:-1])
        points.append(wanted.expand(*shape, 2).reshape(-1, 2))
        corners.append(found.unsqueeze(2).expand(*shape, *found.shape[-2:]).reshape(-1, *found.shape[-2:]))
    every_point, every_corner = torch.cat(points), torch.cat(corners)
    order = torch.randperm(len(every_point), generator=torch.Generator().manual_seed(3))[:COUNT]
    point, vertices = every_point[order].contiguous(), every_corner[order].contiguous()
    return Problems(point, vertices, *extended(point.numpy(), vertices.numpy()))


def paper_points(design: ta.ArmDesign, shape: Tensor) -> Tensor:
    """Reactions (D, N, 48, 2) to the paper's pressures: three on every edge of the pressure box."""
    table = torch.tensor(hulls.edge_table(design.actuator_count, 3)) / 2
    each = [
        ta.reaction_wrench(design[index], shape, table * design[index].max_pressure).movedim(0, 1)
        for index in range(sets.DESIGNS)
    ]
    return torch.stack(each)


def extended(point: measure.Array, vertices: measure.Array) -> tuple[measure.Array, measure.Array, measure.Array]:
    """Distances, gradients and scales, by all segments between two vertices in numpy's longest floats.

    A hull's boundary is among the segments. The point is inside if its directions to the vertices leave
    no gap of half a turn.
    """
    distance, slope = np.empty(len(point)), np.zeros((len(point), 2))
    scale = np.abs(vertices - point[:, None]).max((1, 2))
    first, second = np.triu_indices(vertices.shape[1])
    for index, (own, corners) in enumerate(zip(point, vertices, strict=True)):
        offsets = corners.astype(np.longdouble) - own.astype(np.longdouble)
        start, edge = offsets[first], offsets[second] - offsets[first]
        span = (edge * edge).sum(-1)
        share = (-(start * edge).sum(-1) / np.where(span > 0, span, 1)).clip(0, 1)
        nearest = start + share[:, None] * edge
        length = np.sqrt((nearest * nearest).sum(-1))
        best = length.argmin()
        heading = np.sort(np.arctan2(offsets[:, 1], offsets[:, 0]))
        widest = np.append(np.diff(heading), heading[0] + 2 * np.longdouble(np.pi) - heading[-1]).max()
        inside = widest < np.pi
        distance[index] = 0.0 if inside else float(length[best])
        if distance[index] > 0:
            slope[index] = -nearest[best] / length[best]
    return distance, slope, scale


# ---- the methods ---------------------------------------------------------------------------


def alone(form: str, regularisation: float, point: Tensor, vertices: Tensor) -> HullDistance:
    """qpth's answer as it is, with neither check nor re-solve."""
    layer = require_qpth()
    chosen = HalfspaceForm(layer) if form == "halfspaces" else VertexForm(layer, regularisation)

    def answer(problem: HullProblem) -> HullAnswer:
        with torch.no_grad():
            weights, slack = chosen.solve(problem.offsets)
        never = torch.zeros(len(weights), dtype=torch.bool)
        return HullAnswer(weights, never, never, problem.length(weights, never), slack)

    return solve_hulls(point, vertices, answer, 1000)


def methods() -> list[Method]:
    both = ("float64", "float32")
    found = [
        Method("closed form", "distance", ta.distance_to_hull, dtypes=both),
        Method("closed form, with weights", "planar", ta.planar_distance, dtypes=both),
        Method("scipy nnls", "", ta.nnls_distance, dtypes=both),
        Method("scipy SLSQP", "", ta.slsqp_distance, most=200, differentiable=False),
    ]
    return found if find_spec("qpth") is None else found + qpth_methods()


def qpth_methods() -> list[Method]:
    found: list[Method] = []
    for exponent in (4, 6, 8, 10, 12):
        size = 10.0**-exponent
        setting = f"ε = 1e-{exponent}"
        raw = partial(alone, "vertices", size)
        many = COUNT if exponent == 10 else COUNT // 2
        found.append(
            Method("qpth vertices, alone", setting, raw, most=many, differentiable=False, one_case=exponent != 10)
        )
        checked = partial(ta.qp_distance, regularisation=size)
        # A large ε fails nearly everywhere, and everything that fails is tried again by itself: dear.
        most = 50 if exponent < 8 else many
        found.append(Method("qpth vertices, checked", setting, checked, most=most, one_case=exponent != 10))
    envelope = partial(ta.qp_distance, gradient="envelope")
    found.append(Method("qpth vertices, checked", "ε = 1e-10, envelope gradient", envelope, most=500, one_case=True))
    raw = partial(alone, "halfspaces", 1.0)
    found.append(Method("qpth half-spaces, alone", "", raw, differentiable=False))
    found.append(
        Method(
            "qpth half-spaces, checked", "", partial(ta.qp_distance, form="halfspaces"), dtypes=("float64", "float32")
        )
    )
    return found


CASES = ("paper's edges, V = 48", "exact, 9 points a curve, V = 36")


def jobs() -> sets.Jobs:
    for case in CASES:
        for method in methods():
            if method.one_case and case != CASES[0]:
                continue
            for dtype in method.dtypes:
                for batch in (method.most, 1):
                    key = ("solvers", case, method.name, method.setting, dtype, str(batch))
                    yield key, partial(row, case, method, dtype, batch)


def row(case: str, method: Method, dtype: str, batch: int) -> Row:
    """Measure: in a call of many problems, or in calls of one."""
    given = problems(case)
    kind = getattr(torch, dtype)
    count = min(batch, method.most) if batch > 1 else min(SINGLES, method.most)
    point, vertices = given.point[:count].to(kind), given.vertices[:count].to(kind)
    answers: list[Any] = []
    slopes: list[Tensor] = []

    def chosen(call: int) -> slice:
        return slice(0, count) if batch > 1 else slice(call, call + 1)

    def forward(call: int) -> None:
        with torch.no_grad():
            answers.append(method.work(point[chosen(call)], vertices[chosen(call)]))

    def gradient(call: int) -> None:
        leaf, corners = (value[chosen(call)].clone().requires_grad_() for value in (point, vertices))
        found = method.work(leaf, corners)
        distance = found if isinstance(found, Tensor) else found.value
        slopes.append(torch.autograd.grad(distance.sum(), (leaf, corners))[0])

    with torch.no_grad():
        method.work(point[:1], vertices[:1])  # loads what is loaded late
    most = 15 if batch > 1 else count
    budget = sets.BUDGET if batch > 1 else float("inf")
    spent, memory = measure.timed_with_memory(forward, budget, most)
    both = measure.timed(gradient, budget, most) if method.differentiable else measure.Timing()
    answers = answers[:1] if batch > 1 else answers[1:]  # of single calls the first is done twice
    columns = _columns(answers, point, vertices)
    error = measure.errors(columns["value"], given.distance[:count], given.scale[:count], columns["converged"] > 0)
    return Row(
        family="solvers",
        case=case,
        method=method.name,
        setting=method.setting,
        dtype=dtype,
        batch=batch,
        problems=count,
        memory_mib=memory,
        primal_max=float(columns["primal"].max()),
        dual_max=float(columns["dual"].max()),
        gap_max=float(columns["gap"].max()),
        converged=float(columns["converged"].mean()),
        resolved=float(columns["resolved"].mean()),
        in_range=measure.NAN,
        **measure.error_columns(error),
        **measure.slope_columns(_slope_errors(slopes, given, count)),
        **measure.time_columns(spent, both, batch),
    )


def _columns(answers: list[Any], point: Tensor, vertices: Tensor) -> dict[str, measure.Array]:
    """Values, residuals and flags of answers to consecutive problems; a plain distance has no residuals."""
    names = ("value", "primal", "dual", "gap", "converged", "resolved")
    if isinstance(answers[0], Tensor):
        value = torch.cat(answers).double().numpy()
        nothing = np.full_like(value, np.nan)
        found = dict.fromkeys(names, nothing)
        return found | {"value": value, "converged": np.isfinite(value).astype(float), "resolved": np.zeros_like(value)}
    return {name: torch.cat([getattr(one, name) for one in answers]).double().numpy() for name in names}


def _slope_errors(slopes: list[Tensor], given: Problems, count: int) -> measure.Array:
    if not slopes:
        return np.empty(0)
    found = torch.cat(slopes)[:count].double().numpy()
    apart: NDArray[np.bool_] = given.distance[:count] > NEAR * given.scale[:count]
    error: measure.Array = np.linalg.norm(found - given.slope[:count], axis=-1)[apart]
    return np.where(np.isfinite(error), error, 1.0)
