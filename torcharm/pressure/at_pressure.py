"""How far off the task arms are at pressures that are given: by hand, or as those of a table made for another arm."""

from dataclasses import replace

import torch
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries
from torcharm.equilibrium.solve import solved
from torcharm.pressure.errors import errors_of, outcome
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
    stable = found.stable & prepared.possible
    return outcome(
        PredictedError,
        prepared,
        errors_of(prepared, held, found.twists, found.converged, stable),
        optimality=torch.full(prepared.batch, float("nan"), dtype=held.dtype),
        converged=found.converged,
        stable=stable,
        at_minimum=stable,
        reached=found.continued & stable,
    )
