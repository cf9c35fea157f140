"""Choosing between branches, element by element, and choosing elements."""

from dataclasses import fields, is_dataclass
from typing import TypeVar, cast

import torch
from torch import Tensor

T = TypeVar("T")


def select(mask: Tensor, chosen: Tensor, other: Tensor) -> Tensor:
    """`torch.where(mask, chosen, other)`, exactly, where both branches are finite.

    On a CPU `where` costs as much as four multiplications, and its gradient twice that; `lerp`
    costs one, and is exact at both of its ends.
    """
    return torch.lerp(other, chosen, mask.to(other.dtype))


def pick(value: T, index: Tensor) -> T:
    """Entries in `index` along the last dimension of a tensor, or of all tensors in a dataclass or tuple."""
    if isinstance(value, Tensor):
        return cast(T, value.index_select(-1, index))
    if isinstance(value, tuple):
        return cast(T, tuple(pick(part, index) for part in value))
    if is_dataclass(value) and not isinstance(value, type):
        return type(value)(*(pick(getattr(value, field.name), index) for field in fields(value)))
    return value
