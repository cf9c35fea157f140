"""Tasks prepared for many designs: what no design changes is worked out once, and only what an objective needs."""

from dataclasses import dataclass, replace
from functools import cached_property
from math import prod

import torch
from torch import Tensor

from torcharm._outer import Block, OuterProduct, map_blocks, outer_product
from torcharm._sampled_distances import Required, Sampling, required_by_metric, sampled_distances
from torcharm.arm import ArmDesign
from torcharm.attainability import block_size, over_nodes
from torcharm.task import Task


@dataclass(frozen=True, eq=False)
class Scene:
    """A batch of T tasks, and the sampled attainable sets of designs that are to do them.

    Attributes:
        outer: the tasks, beside any design.
        required: wrenches that the tasks ask for.
        sampling: of the metrics.
        factors: for each metric, its part in a task's value.
        power: of distances.
        chunk_size: as in `torcharm.evaluate`.
    """

    outer: OuterProduct
    required: Required
    sampling: Sampling
    factors: tuple[float, ...]
    power: int
    chunk_size: int | None

    @classmethod
    def of(
        cls, arm: ArmDesign, task: Task, sampling: Sampling, factors: tuple[float, ...], power: int, chunk: int | None
    ) -> "Scene":
        """Prepare tasks for designs like `arm`."""
        outer = outer_product(arm, task)
        with torch.no_grad():
            required = required_by_metric(outer, sampling.metrics, sampling.scale)
        return cls(outer, required, sampling, factors, power, chunk)

    @cached_property
    def chunk(self) -> int:
        """(design, shape, load) triples worked on at once."""
        return self.chunk_size or block_size(self.outer, self.sampling.hull, self.sampling.samples)

    @property
    def designs_at_once(self) -> int:
        """Designs that make one block, at least one."""
        _, shapes, loads = self.outer.sizes
        return max(1, self.chunk // max(1, shapes * loads))

    def values(self, arm: ArmDesign) -> Tensor:
        """The sum of unattainabilities (D, T) of designs, of batch shape (D,); not a number where one is none."""
        outer = replace(self.outer, arm=arm, design_batch=tuple(arm.batch_shape))
        recompute = prod(outer.sizes) > self.chunk

        def work(block: Block) -> tuple[Tensor, ...]:
            found = sampled_distances(block, self.required, self.sampling, recompute=recompute, excess=False)
            return (self._total(found.lengths, found.sections.shape),)

        return map_blocks(outer, self.chunk, work)[0].flatten(1)

    def _total(self, lengths: tuple[Tensor, ...], shape: tuple[int, int, int]) -> Tensor:
        """(d, p, l) from distances (B, l) by metric."""
        total: Tensor | None = None
        for metric, factor, length in zip(self.sampling.metrics, self.factors, lengths, strict=True):
            by_node = length.unflatten(0, shape)
            own = over_nodes(by_node, metric, self.power, signed=self.sampling.signed, dim=1)
            own = own if factor == 1.0 else factor * own
            total = own if total is None else total + own
        assert total is not None
        return total.movedim(1, 0)
