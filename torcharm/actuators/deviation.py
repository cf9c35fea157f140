"""How far the actuators of built arms are from their force models."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from torcharm.inputs import HoldsTensors


@dataclass(frozen=True, eq=False)
class ForceDeviation(HoldsTensors):
    """What M built actuators do other than their models: `f = s (f_model(ε, p) + Σ c_ij ε^i p^j)`, `τ = k τ_model`.

    Attributes:
        force_scale: (*batch, M) s, factors on forces.
        bending_scale: (*batch, M) k, factors on bending moments.
        powers: (i, j) of strain and pressure [kPa] of each further term; (0, 0) is a force offset.
        terms: for each of these c (*batch, M) [N] and kPa.
    """

    force_scale: Tensor
    bending_scale: Tensor
    powers: tuple[tuple[int, int], ...] = ()
    terms: tuple[Tensor, ...] = ()

    def changed(self, change: Callable[[Tensor], Tensor]) -> "ForceDeviation":
        """With every tensor (*batch, M) changed alike."""
        terms = tuple(change(term) for term in self.terms)
        return ForceDeviation(change(self.force_scale), change(self.bending_scale), self.powers, terms)

    def tensors(self) -> tuple[Tensor, ...]:
        """All that it holds."""
        return (self.force_scale, self.bending_scale, *self.terms)


def added_force(
    powers: tuple[tuple[int, int], ...], terms: tuple[Tensor, ...], strain: Tensor, pressure: Tensor
) -> Tensor:
    """`Σ c_ij ε^i p^j` [N]; all broadcast."""
    total = strain.new_zeros(()).expand(torch.broadcast_shapes(strain.shape, pressure.shape))
    for (i, j), c in zip(powers, terms, strict=True):
        total = total + c * strain**i * pressure**j
    return total
