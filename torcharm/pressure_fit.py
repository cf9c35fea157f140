"""The pressure whose reaction comes closest to what a task requires, in wrenches, without forward mechanics."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torcharm import mechanics
from torcharm._box import spread_points
from torcharm._continuation import Problem, default_chunk
from torcharm._inputs import as_floating, check_at_least, check_count, check_finite
from torcharm._wrench_fit import fit_wrenches
from torcharm.arm import ArmDesign
from torcharm.search import checked_outer, flat_problem
from torcharm.task import Task


@dataclass(frozen=True, eq=False)
class PressureFit:
    """What `fit_pressure` found; `batch` is (*design batch, *task batch).

    Attributes:
        pressure: (*batch, M) [kPa].
        distance: (*batch) `sqrt(Σ_i k_f (f_i - f_i*)² + k_m (m_i - m_i*)²)` over the nodes: 0 if this pressure holds
            the task, which makes the task's shape an equilibrium under its load.
        per_node: (*batch, N) the distance of each node's reaction from what is required.
        optimality: (*batch) the largest entry of the projected gradient of ½ distance², by pressures as shares of
            their limits.
        converged: (*batch) whether the descent came to its end.
    """

    pressure: Tensor
    distance: Tensor
    per_node: Tensor
    optimality: Tensor
    converged: Tensor


def fit_pressure(
    arm: ArmDesign,
    task: Task,
    *,
    weights: Sequence[float] = (1.0, 1.0),
    starts: int = 8,
    seed: int = 0,
    chunk_size: int | None = None,
) -> PressureFit:
    """The pressure within the limits whose reaction along the task shape comes closest to what is required.

    Minimises `Σ_i ‖a_i(z*, p) - w_i‖²_K` over `p ∈ [0, p̄]` by Levenberg-Marquardt from several starts, with
    steps bent along curved valleys. A distance of zero is a certificate: one pressure holds the shape under the load.
    Above zero it is no distance of shapes: what is a newton too much may move the arm far or not at all.
    Results hold no graph: they are not differentiable.

    Args:
        arm: designs, of any batch shape.
        task: tasks, of any batch shape; the fit is an outer product.
        weights: k_f [1/N²] and k_m [1/(N·m)²].
        starts: S, the middle of the box and points spread over it.
        seed: of these.
        chunk_size: fits worked on at once; None chooses. Bounds memory.

    Raises:
        ValueError: an argument is none of those allowed, or arm and task differ in dtype or device.
    """
    check_count("starts", starts, 1)
    check_count("seed", seed, 0)
    (pair,) = as_floating(weights=weights)
    if pair.shape != (2,):
        raise ValueError(f"weights: must be two numbers (k_f, k_m), got shape {tuple(pair.shape)}")
    check_finite("weights", pair)
    check_at_least("weights", pair, 0.0, strict=True)
    outer = checked_outer(arm, task)
    problem, shape = flat_problem(outer, None)
    scale = pair.to(shape).sqrt().unsqueeze(-1)
    chunk = max(1, 4 * default_chunk(outer.nodes, 2) // starts)
    chunk = chunk if chunk_size is None else check_count("chunk_size", chunk_size, 1)
    places = spread_points(starts, arm.actuator_count, shape, seed)
    with torch.no_grad():
        parts = [
            _fit(problem[at], shape[at], scale, places)
            for at in torch.arange(max(1, len(shape)), device=shape.device).split(chunk)
            if len(shape)
        ]
    if not parts:
        real = shape.new_zeros(0)
        parts = [(problem.pressure, real, shape[:, 0], real, real.bool())]
    found = [torch.cat(column) for column in zip(*parts, strict=True)]
    return PressureFit(*(outer.unflatten(value.reshape(*outer.sizes, *value.shape[1:])) for value in found))


def _fit(problem: Problem, shape: Tensor, scale: Tensor, places: Tensor) -> tuple[Tensor, ...]:
    total, starts = len(shape), len(places)
    every = torch.arange(total, device=shape.device).repeat_interleave(starts)
    load = mechanics.load_wrench(mechanics.kinematics(shape, problem.base_pose), problem.tip_load)
    many = problem[every]
    found = fit_wrenches(many.arm, shape[every], load[every], scale, places.repeat(total, 1))
    best = found.cost.unflatten(0, (total, starts)).nan_to_num(nan=float("inf")).argmin(-1)
    at = torch.arange(total, device=shape.device) * starts + best
    pressure = found.share * many.arm.max_pressure
    return (
        pressure[at],
        found.cost[at].sqrt(),
        found.miss[at].norm(dim=-2),
        found.optimality[at],
        (found.done & found.cost.isfinite())[at],
    )
