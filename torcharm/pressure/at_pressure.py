"""How far off the task arms are at pressures that are given: by hand, or as those of a table made for another arm."""

from dataclasses import replace

import torch
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries
from torcharm.equilibrium.solve import solved
from torcharm.equilibrium.stability import lengths_positive
from torcharm.pressure.errors import errors_of
from torcharm.pressure.pose_cost import PoseCost
from torcharm.pressure.predicted_error import PredictedError
from torcharm.pressure.prepared import prepare
from torcharm.task import Task


def error_at_pressure(
    arm: ArmDesign | ArmSeries, task: Task, pressure: Tensor, pose_cost: PoseCost | None = None
) -> PredictedError:
    """The errors at the equilibria to which loading from rest leads at pressures.

    Differentiable in all that `solve_equilibrium` is, the pressures included. No better pressure is looked for, so that
    `optimality` is NaN and every stable equilibrium counts as a minimum; `reached` says that it was continued to
    without a snap.

    Args:
        arm, task, pose_cost: as of `predict_error`.
        pressure: (*#design batch, *#task batch, M) [kPa]; what exceeds a limit of an arm is held there.

    Raises:
        ValueError: as of `predict_error`.
    """
    prepared = prepare(arm, task, pose_cost)
    problem = prepared.problem
    held = torch.minimum(pressure.to(problem.pressure), problem.pressure)
    found = solved(replace(problem, pressure=held))
    with torch.no_grad():
        possible = lengths_positive(problem, prepared.twists).expand(prepared.batch)
    stable = found.stable & possible
    errors = errors_of(prepared, held, found.twists, found.converged, stable)
    columns = (
        errors.tip_error,
        errors.tip_rotation_error,
        errors.shape_error,
        errors.cost,
        errors.per_node,
        errors.pose_errors,
        errors.pressure,
        errors.twists,
        torch.full(prepared.batch, float("nan"), dtype=held.dtype),
        found.converged,
        stable,
        stable,
        found.continued & stable,
        found.strain_excess,
        found.in_range,
        possible,
    )
    return PredictedError(*(prepared.given_back(column) for column in columns))
