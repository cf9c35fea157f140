"""Tasks prepared for many designs: what no design changes is worked out once, and only what an objective needs."""

from dataclasses import dataclass

import torch
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.attainability import over_nodes
from torcharm.task import Task
from torcharm.wrench_sets.design_task_grid import DesignTaskGrid, design_task_grid
from torcharm.wrench_sets.node_distances import SetOptions, default_chunk, node_distances


@dataclass(frozen=True, eq=False)
class Scene:
    """A batch of T tasks for designs of the same actuators, and how their attainable sets are measured.

    Attributes:
        grid: the tasks, beside any design.
        options: of the metrics.
        factors: for each metric, its part in a task's value.
        power: of distances.
        chunk_size: as in `torcharm.evaluate`.
    """

    grid: DesignTaskGrid
    options: SetOptions
    factors: tuple[float, ...]
    power: int
    chunk_size: int | None

    @classmethod
    def of(
        cls, arm: ArmDesign, task: Task, options: SetOptions, factors: tuple[float, ...], power: int, chunk: int | None
    ) -> "Scene":
        """Prepare tasks for designs like `arm`."""
        with torch.no_grad():
            return cls(design_task_grid(arm, task), options, factors, power, chunk)

    @property
    def designs_at_once(self) -> int:
        """Designs that make one chunk, at least one."""
        _, shapes, loads = self.grid.sizes
        return max(1, (self.chunk_size or default_chunk(self.grid)) // max(1, shapes * loads))

    def values(self, arm: ArmDesign) -> Tensor:
        """The sum of unattainabilities (D, T) of designs, of batch shape (D,).

        Infinite where an actuator has no length, and not a number where a distance is not known as exactly as promised.
        """
        found = node_distances(self.grid.with_designs(arm), self.options, self.chunk_size)
        parts = []
        for index, (metric, factor) in enumerate(zip(self.options.metrics, self.factors, strict=True)):
            own = over_nodes(found.distance[..., index, :], metric, self.power, signed=self.options.signed)
            parts.append(own if factor == 1.0 else factor * own)
        total = parts[0] if len(parts) == 1 else torch.stack(parts).sum(0)
        sound = (found.converged & found.distance.isfinite()).flatten(-2).all(-1) | found.impossible
        return torch.where(sound, total, total.new_full((), torch.nan)).flatten(1)
