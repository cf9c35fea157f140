"""Is a better design better in truth? The pressure search says."""

from collections.abc import Sequence
from dataclasses import dataclass

from torch import Tensor

from torcharm.design.result import OptimisedDesign
from torcharm.design.task_errors import TaskErrors, searched
from torcharm.inputs import HoldsTensors
from torcharm.task import Task, task_list


@dataclass(frozen=True, eq=False, repr=False)
class Verification(HoldsTensors):
    """What the search reaches on T tasks with the given and with the best design."""

    before: TaskErrors
    after: TaskErrors

    @property
    def both(self) -> Tensor:
        """(T,) tasks on which both designs come to a stable equilibrium: means are taken over these."""
        return self.before.stable & self.after.stable

    @property
    def mean_before(self) -> float:
        """Mean shape error [m] of the given design."""
        return float(self.before.shape_error[self.both].mean())

    @property
    def mean_after(self) -> float:
        """Mean shape error [m] of the best design."""
        return float(self.after.shape_error[self.both].mean())

    @property
    def improved(self) -> float:
        """Share of these tasks whose shape error fell; NaN if there are none."""
        return float((self.after.shape_error < self.before.shape_error)[self.both].double().mean())

    def __repr__(self) -> str:
        """Means and counts."""
        count, shared = len(self.both), int(self.both.sum())
        return (
            f"Verification(searched shape error {1e3 * self.mean_before:.4g} → {1e3 * self.mean_after:.4g} mm, mean of "
            f"the {shared} of {count} tasks with a stable equilibrium before and after; searches converged on "
            f"{int(self.before.converged.sum())} and {int(self.after.converged.sum())} of {count})"
        )


def verify_design(
    result: OptimisedDesign, task: Task | Sequence[Task], *, starts: int | None = None, seed: int = 0
) -> Verification:
    """Search the best pressure for every task, with the given and with the best design.

    Args:
        result: of `optimise_design`.
        task: the tasks it was optimised for, or others.
        starts, seed: of `torcharm.search_pressure`.

    Returns:
        Errors `before` and `after`, of the given and the best design, and the share `improved` of stable tasks.

    Raises:
        ValueError: as for `torcharm.search_pressure`.

    Example:
        >>> arm, task = ta.bellows_arm(), ta.Task(ta.constant_curvature(1.0, nodes=3), tip_load=[1.0, -1.0, 0.0])
        >>> ta.verify_design(ta.optimise_design(arm, task, starts=1, iterations=2), task).improved  # share of tasks
        1.0
    """
    tasks = task_list(task)
    cost = result.objective.pose_cost
    return Verification(*(searched(arm, tasks, cost, starts, seed) for arm in (result.given, result.best)))
