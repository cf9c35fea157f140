"""The pressure whose reaction comes closest to what a task requires, in wrenches, without forward mechanics."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries
from torcharm.engine.arms import sizes_of
from torcharm.engine.arrays import make
from torcharm.engine.questions import FITS, Given, answer
from torcharm.engine.wrench_fit import FitAnswers
from torcharm.inputs import HoldsTensors, as_floating, check_at_least, check_count, check_finite
from torcharm.pressure.prepared import Prepared, detached, prepare
from torcharm.pressure.starts import spread_points
from torcharm.statics.external_load import HULL
from torcharm.task import Task


@dataclass(frozen=True, eq=False, repr=False)
class PressureFit(HoldsTensors):
    """What `fit_pressure` found; `batch` is (*design batch, *task batch).

    Attributes:
        pressure: (*batch, M) [kPa].
        distance: (*batch) `sqrt(Σ_i k_f Δf_i² + k_m |Δm_i|²)` over the nodes: 0 if this pressure holds the task, which
            makes the task's shape an equilibrium under its load.
        per_node: (*batch, N) the distance of each node's reaction from what is required.
        optimality: (*batch) the largest entry of the projected gradient of ½ distance², by normalised pressures.
        converged: (*batch) whether the descent came to its end.

    Example:
        >>> found = ta.fit_pressure(ta.bellows_arm(), ta.Task(ta.constant_curvature(0.5), [1.0, 0.0, 0.0]))
        >>> round(float(found.distance), 3), int(found.per_node.argmax())  # no pressure serves all nodes; the worst one
        (1.282, 9)
    """

    pressure: Tensor
    distance: Tensor
    per_node: Tensor
    optimality: Tensor
    converged: Tensor


def fit_pressure(
    arm: ArmDesign | ArmSeries,
    task: Task,
    *,
    weights: Sequence[float] = (1.0, 1.0),
    starts: int = 8,
    seed: int = 0,
) -> PressureFit:
    """The pressure within the limits whose reaction along the task shape comes closest to what is required.

    Minimises `Σ_i ‖a_i(z*, p) - w_i‖²_K` over `p ∈ [0, p̄]` by Levenberg and Marquardt's method from several starts,
    with steps bent along curved valleys. A distance of zero is a certificate: one pressure holds the shape under the
    load. Above zero it is no distance of shapes: what is a newton too much may move the arm far or not at all.
    Results hold no graph: they are not differentiable.

    Args:
        arm: designs, of any batch shape; or segments in series.
        task: tasks, of any batch shape; every design meets every task.
        weights: k_f [1/N²] and k_m [1/(N·m)²] of the hull wrenches.
        starts: S, the middle of the box and points spread over it. Many muscles have many local minima: of a bundle of
            nine actuators, 8 starts found the pressure that holds a shape in most cases, 32 in more.
        seed: of these.

    Raises:
        ValueError: an argument is none of those allowed, or arm and task do not fit.

    Example:
        >>> shape = ta.solve_equilibrium(ta.bellows_arm(), [20.0, 30.0, 5.0, 10.0], load=[1.0, 2.0, 0.2]).twists
        >>> found = ta.fit_pressure(ta.bellows_arm(), ta.Task(shape, [1.0, 2.0, 0.2]))
        >>> round(float(found.distance), 6)  # one pressure holds it
        0.0
    """
    check_count("starts", starts, 1)
    check_count("seed", seed, 0)
    (pair,) = as_floating(weights=weights)
    if pair.shape != (2,):
        raise ValueError(f"weights: must be two numbers (k_f, k_m), got shape {tuple(pair.shape)}")
    check_finite("weights", pair)
    check_at_least("weights", pair, 0.0, strict=True)
    prepared = detached(prepare(arm, task, None))
    force, moment = pair.double().sqrt().tolist()
    found = _fitted(prepared, force, moment, spread_points(starts, arm.actuator_count, seed))
    columns = (
        prepared.shaped(found.normalised) * prepared.problem.pressure,
        prepared.shaped(np.sqrt(found.square)),
        prepared.shaped(np.linalg.norm(found.miss, axis=-1)),
        prepared.shaped(found.optimality),
        prepared.shaped(found.done & np.isfinite(found.square)),
    )
    return PressureFit(*(prepared.given_back(column) for column in columns))


def _fitted(prepared: Prepared, force: float, moment: float, starts: NDArray[np.float64]) -> FitAnswers:
    """What the engine finds, with the roots of the weights."""
    problem, shape = prepared.engine, prepared.shape
    hull = HULL[shape.shape[2]]
    weight = np.array(
        [
            (force if column < prepared.dimension else moment) if column in hull else 0.0
            for column in problem.arms.unknown
        ]
    )
    fits = make(FitAnswers, sizes_of(problem.arms, B=len(problem.limit)))
    answer(FITS, problem, 0.0, Given(twists=shape, starts=starts, weight=weight), fits=fits)
    return fits
