"""NumPy arrays from tensors, and entries of them."""

from dataclasses import is_dataclass
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

Array = NDArray[Any]
T = TypeVar("T")


def as_array(value: Tensor) -> Array:
    """A tensor's numbers, not copied if they are the processor's own."""
    array: Array = value.detach().cpu().numpy()
    return array


def pick(value: T, index: Array) -> T:
    """Entries in `index` along the last dimension of an array, or of all arrays in a dataclass or tuple."""
    if isinstance(value, np.ndarray):
        return cast(T, value.take(index, -1))
    if isinstance(value, tuple):
        return cast(T, tuple(pick(part, index) for part in value))
    if is_dataclass(value) and not isinstance(value, type):
        return type(value)(*(pick(part, index) for part in vars(value).values()))
    return value
