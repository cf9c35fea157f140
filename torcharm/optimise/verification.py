"""A check of an optimised design by what the arm really does: the pressure search, before and after."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from torcharm.optimise.result import OptimisedDesign
from torcharm.task import Task


@dataclass(frozen=True, eq=False)
class Verification:
    """Shape errors that the search reached on T tasks, with the given and with the best design.

    Attributes:
        before, after: (T,) the search's shape errors [m]; NaN where the search did not converge.
        pressure_before, pressure_after: (T, M) the pressures found [kPa].
        converged_before, converged_after: (T,) whether the search and its equilibria converged.
    """

    before: Tensor
    after: Tensor
    pressure_before: Tensor
    pressure_after: Tensor
    converged_before: Tensor
    converged_after: Tensor

    @property
    def improved(self) -> float:
        """Share of the tasks, of those that converged both times, whose error fell."""
        both = self.converged_before & self.converged_after
        return float((self.after < self.before)[both].double().mean()) if bool(both.any()) else float("nan")


def verify_design(
    result: OptimisedDesign,
    task: Task | Sequence[Task],
    *,
    method: str = "multistart",
    options: Mapping[str, Any] | None = None,
) -> Verification:
    """Search the best pressure for every task, with the given and with the best design.

    Args:
        result: of `optimise_design`.
        task: the tasks it was optimised for, or others.
        method: of `torcharm.search_pressure`, and
        options: its other arguments.

    Raises:
        ValueError: as for `torcharm.search_pressure`.
    """
    from torcharm.pressure.search import search_pressure

    tasks = (task,) if isinstance(task, Task) else tuple(task)
    sides = []
    for design in (result.given, result.best):
        found = [search_pressure(design, one, method=method, **(options or {})) for one in tasks]
        error = torch.cat([one.shape_error.detach().reshape(-1) for one in found])
        pressure = torch.cat([one.pressure.detach().reshape(-1, design.actuator_count) for one in found])
        converged = torch.cat([one.converged.reshape(-1) for one in found])
        sides.append((torch.where(converged, error, torch.nan), pressure, converged))
    (before, first, sound), (after, second, still) = sides
    return Verification(before, after, first, second, sound, still)
