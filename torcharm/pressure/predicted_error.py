"""How far off the task an arm will be: predicted from the equilibria near the task's shape.

Put down at the task's shape with pressures p, the arm moves to where its balance `R(z, p) = 0` holds. The predicted
error is the least cost of the poses there, over the pressures within their limits and the equilibria that are stable.
No load is raised from zero, as the search does. In return a shape that is predicted need not be the one that the arm
reaches when it is loaded: under compression there are several.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, overload

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries
from torcharm.engine.arms import sizes_of
from torcharm.engine.arrays import make
from torcharm.engine.descent import HELD_UP, NO_GAIN, OPTIMUM
from torcharm.engine.predictions import SCREENED, Predictions
from torcharm.engine.questions import PREDICTIONS, Given, answer
from torcharm.equilibrium.solve import TOLERANCE
from torcharm.equilibrium.status import status_word
from torcharm.pressure.errors import Outcome, errors_at, outcome
from torcharm.pressure.pose_cost import PoseCost
from torcharm.pressure.prepared import Prepared, detached, prepare, stays_at
from torcharm.task import Task, for_each_task

WORDS = ("converged", "at a kink", "not reached", "not converged", "unstable", "impossible")
"""What may be said of a prediction. At a kink: a minimum at a kink of a force model, which has no gradient. Not
reached: a stable minimum, but loading the arm from zero leads elsewhere. Not converged: a stable equilibrium, but
perhaps not the best pressure, as where stability ends. Unstable: no stable equilibrium was found. Impossible: the
task's shape leaves an actuator no length."""
MINIMA = (OPTIMUM, NO_GAIN, HELD_UP)
"""Ends of descents from where no shorter step leads on."""


@dataclass(frozen=True, eq=False, repr=False)
class PredictedError(Outcome):
    """What `predict_error` found, of shape (*design batch, *task batch).

    Attributes:
        tip_error, tip_rotation_error: distance [m] and turn [rad] of the tip from the task's; infinite, as all errors
            are, where no stable equilibrium was found.
        shape_error: the weighted mean over the poses, `sqrt(Σ ω_i e_iᵀ K e_i / Σ ω_i)` [m].
        cost: `Σ ω_i e_iᵀ K e_i` [m²], what is minimised. Where a stable equilibrium was found and the descent did not
            converge, it is what that pressure reaches: others may do better.
        per_node: (..., N+1) `sqrt(e_iᵀ K e_i)` of each pose [m].
        pose_errors: (..., N+1, 3 or 6) e_i, the target seen from the pose predicted [m, rad]; NaN where no stable
            equilibrium was found.
        pressure: (..., M) that reaches it [kPa]; where nothing was found, the last that was tried.
        twists: (..., N, K) of the shape predicted [m, rad].
        optimality: largest slope of `sqrt(cost)` by a normalised pressure [m], of those that the limits leave free.
        converged: whether the optimality is within 1e-7 of the arm's length, at a stable equilibrium: only there the
            minimum has a gradient.
        at_minimum: whether no shorter step led on from there, at a stable equilibrium: converged, or at a kink of a
            force model, where the optimality does not vanish.
        stable: whether the task is possible (every actuator's length is above 0), and the equilibrium is stable, with
            such lengths.
        reached: whether it is stable, and `solve_equilibrium` leads there along one branch from zero load.
        strain_excess: largest strain beyond its actuator's characterised range at the shape predicted, 0 if none is.
        in_range: whether every strain, and every pressure found, lies in the characterised range.
        possible: whether every length of the task's shape is above 0.

    Example:
        >>> found = ta.predict_error(ta.antagonistic_arm(), ta.Task(ta.constant_curvature(0.5), [1.0, 0.0, 0.0]))
        >>> found.status, found.pressure.round().tolist()  # what to set the regulators to [kPa]
        ('converged', [33.0, 100.0, 100.0, 21.0])
    """

    at_minimum: Tensor
    reached: Tensor

    DOUBTS: ClassVar[Mapping[str, str]] = {
        "not converged": "a stable shape, but perhaps not the best pressure: search_pressure may find a better one",
        "unstable": "no stable equilibrium near the task's shape was found: search_pressure follows the arm from rest",
        "not reached": "stable there, but loading from rest leads to another shape, which solve_equilibrium tells of "
        "this pressure; search_pressure looks for the closest that loading reaches",
    }
    """Why a task is left undecided, by the status, and what to try."""

    @property
    def status(self) -> str | NDArray[Any]:
        """What to think of it, in a word of `WORDS`: one, or an array of them."""
        return status_word(WORDS, self.converged, self.reached, self.at_minimum, self.stable, self.possible)


@overload
def predict_error(arm: ArmDesign | ArmSeries, task: Task, pose_cost: PoseCost | None = ...) -> PredictedError: ...


@overload
def predict_error(
    arm: ArmDesign | ArmSeries, task: Sequence[Task], pose_cost: PoseCost | None = ...
) -> tuple[PredictedError, ...]: ...


def predict_error(
    arm: ArmDesign | ArmSeries, task: Task | Sequence[Task], pose_cost: PoseCost | None = None
) -> PredictedError | tuple[PredictedError, ...]:
    """The least pose error that each design can be expected to reach on each task, without a forward solve.

    Errors, cost and pose errors are differentiable once in radii, offsets, lengths, limits, twists, loads, masses,
    the base pose and whatever force models hold: by the envelope theorem the pressures found are held, but for those
    at a limit, which move with it, and the shape follows its balance. Of the cost, and of the shape error, that is
    the gradient of the minimum; of the others, that at these pressures. At a kink of a force model they are those of
    one side. That holds at a minimum only: **gradients of predictions that are not converged are NaN**, unless
    nothing depends on them, as where `torch.where(found.converged, found.cost, 0.0)` leaves them out.

    Args:
        arm: designs, of any batch shape; or segments in series.
        task: shapes and loads, of any batch shape; every design meets every task. Or a list of such.
        pose_cost: what is minimised; None is `PoseCost()`.

    Returns:
        What is predicted; of a list of tasks a tuple, with what is predicted for each, in their order.

    Raises:
        ValueError: an argument is none of those allowed, or arm and task do not fit.

    Example:
        >>> tasks = ta.Task(ta.constant_curvature(0.5), [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
        >>> (1e3 * ta.predict_error(ta.antagonistic_arm(), tasks).tip_error).round(decimals=1).tolist()  # [mm]
        [0.0, 0.6, 1.2]
    """
    return for_each_task(task, lambda one: prediction(arm, one, pose_cost))


def prediction(
    arm: ArmDesign | ArmSeries, task: Task, pose_cost: PoseCost | None = None, *, held: bool = False
) -> PredictedError:
    """What `predict_error` returns.

    Args:
        arm, task, pose_cost: as there.
        held: whether predictions that are stable but not converged have gradients, too: those at the pressures found,
            which are held. They tell an optimiser what these pressures would reach, though not what the best would.
    """
    prepared = prepare(arm, task, pose_cost)
    plain = detached(prepared)
    found = _found(plain)
    normalised, twists = plain.shaped(found.normalised), plain.shaped(found.twists)
    stable = plain.shaped(stays_at(plain, found.normalised, found.twists, found.stable)) & prepared.possible
    converged = plain.shaped(found.ended == OPTIMUM) & stable
    at_minimum = plain.shaped(np.isin(found.ended, MINIMA)) & stable
    errors = errors_at(prepared, normalised, twists, stable if held else converged, stable)
    return outcome(
        PredictedError,
        prepared,
        errors,
        optimality=plain.shaped(found.slope),
        converged=converged,
        stable=stable,
        at_minimum=at_minimum,
        reached=plain.shaped(found.reached) & stable,
    )


def _found(prepared: Prepared) -> Predictions:
    """What the engine finds."""
    problem = prepared.engine
    sizes = sizes_of(problem.arms, B=len(problem.limit))
    sobol = torch.quasirandom.SobolEngine(sizes["M"]).draw(1 + SCREENED[-1], dtype=torch.float64)
    out = make(Predictions, sizes)
    given = Given(twists=prepared.start, starts=sobol[1:].numpy(), weight=prepared.wrench_weights)
    answer(PREDICTIONS, problem, TOLERANCE, given, predictions=out)
    return out
