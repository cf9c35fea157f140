"""How far off an arm is at pressures that a person has chosen."""

import torch

from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries
from torcharm.equilibrium import Equilibrium, solve_equilibrium
from torcharm.equilibrium.stability import lengths_positive
from torcharm.inputs import TensorLike
from torcharm.pressure.errors import errors_at
from torcharm.pressure.pose_cost import PoseCost
from torcharm.pressure.prepared import detached, prepare
from torcharm.pressure.search import PressureSearch
from torcharm.task import Task


@torch.no_grad()
def errors_at_pressure(
    arm: ArmDesign | ArmSeries, task: Task, pressure: TensorLike, pose_cost: PoseCost | None = None
) -> tuple[PressureSearch, Equilibrium]:
    """The errors of one design on one task at a pressure, loading from rest, as a search that tried nothing else.

    No gradients. `optimality` and `start_cost` are NaN and empty: nothing was minimised.

    Args:
        arm: one design.
        task: one shape under one load.
        pressure: (M,) within the limits [kPa].
        pose_cost: by which errors are measured; None is `PoseCost()`.

    Returns:
        The errors, which `evaluate_search` gives a verdict, and the equilibrium.

    Raises:
        ValueError: arm, task and pressure do not fit.
    """
    nodes = task.segment_nodes or (task.nodes,)
    found = solve_equilibrium(arm, pressure, task.load, nodes, base_pose=task.base_pose, wrench_at=task.wrench_at)
    prepared = detached(prepare(arm, task, pose_cost))
    limit = prepared.problem.pressure
    given = torch.as_tensor(pressure, dtype=limit.dtype)
    place = torch.where(limit > 0, given / torch.where(limit > 0, limit, 1.0), 0.0)
    errors = errors_at(prepared, place, found.twists.to(limit), found.stable, found.stable)
    reached = found.continued & found.stable
    search = PressureSearch(
        pressure=errors.pressure,
        tip_error=errors.tip_error,
        tip_rotation_error=errors.tip_rotation_error,
        shape_error=errors.shape_error,
        cost=errors.cost,
        per_node=errors.per_node,
        pose_errors=errors.pose_errors,
        twists=errors.twists,
        optimality=torch.full_like(errors.cost, torch.nan),
        converged=reached,
        continued=reached,
        stable=found.stable,
        possible=lengths_positive(prepared.problem, prepared.twists),
        strain_excess=found.strain_excess,
        in_range=found.in_range,
        start_cost=errors.cost.new_empty((*errors.cost.shape, 0)),
    )
    return search, found
