"""Choosing between branches, element by element."""

import torch
from torch import Tensor


def select(mask: Tensor, chosen: Tensor, other: Tensor) -> Tensor:
    """`torch.where(mask, chosen, other)`, exactly, where both branches are finite.

    On a CPU `where` costs as much as four multiplications, and its gradient twice that; `lerp`
    costs one, and is exact at both of its ends.
    """
    return torch.lerp(other, chosen, mask.to(other.dtype))
