"""Turning what a person passes into tensors, with errors that name the field."""

from collections.abc import Collection, Sequence
from typing import Any

import torch
from torch import Tensor

TensorLike = Tensor | float | int | Sequence[Any]
"""Whatever `torch.as_tensor` understands: tensors, numbers, nested lists, numpy arrays."""


def as_floating(**fields: Any) -> list[Tensor]:
    """Tensors of one floating dtype and one device, in the order of the fields.

    The dtype is the promotion of the floating tensors and arrays among the fields;
    numbers, lists and integers follow it, and are float64 if nothing else decides.
    """
    arrays = {name: value for name, value in fields.items() if hasattr(value, "dtype")}
    tensors = {name: _tensor(name, value) for name, value in arrays.items()}
    dtype: torch.dtype | None = None
    device: torch.device | None = None
    for name, tensor in tensors.items():
        if tensor.is_complex():
            raise ValueError(f"{name}: must be real, got {tensor.dtype}")
        if tensor.is_floating_point():
            dtype = tensor.dtype if dtype is None else torch.promote_types(dtype, tensor.dtype)
        if isinstance(arrays[name], Tensor):
            if device is not None and tensor.device != device:
                raise ValueError(f"{name}: is on {tensor.device}, the other inputs on {device}")
            device = tensor.device
    dtype = dtype or torch.float64
    return [
        (tensors[name] if name in tensors else _tensor(name, value, dtype)).to(dtype=dtype, device=device)
        for name, value in fields.items()
    ]


def _tensor(name: str, value: Any, dtype: torch.dtype | None = None) -> Tensor:
    try:
        if isinstance(value, (list, tuple)) and any(isinstance(item, Tensor) for item in value):
            return torch.stack([_tensor(name, item, dtype) for item in value])
        return torch.as_tensor(value, dtype=dtype)
    except (TypeError, ValueError, RuntimeError) as error:
        raise ValueError(f"{name}: must be numbers in a regular array, got {value!r:.60} ({error})") from None


def check_finite(name: str, value: Tensor) -> None:
    """Raise unless every entry is finite."""
    finite = torch.isfinite(value)
    if not bool(finite.all()):
        bad = value[~finite].flatten()[0].item()
        raise ValueError(f"{name}: must be finite, got {bad}")


def check_at_least(name: str, value: Tensor, low: float, *, strict: bool = False, unit: str = "") -> None:
    """Raise unless every entry is at least (or, strictly, above) `low`."""
    bad = value <= low if strict else value < low
    if bool(bad.any()):
        bound = f"above {low:g}" if strict else f"at least {low:g}"
        raise ValueError(f"{name}: must be {bound}{unit and ' ' + unit}, got {value[bad].flatten()[0].item():g}")


def check_choice(name: str, value: object, allowed: Collection[str]) -> None:
    """Raise unless `value` is one of the allowed words."""
    if value not in allowed:
        raise ValueError(f"{name}: must be one of {', '.join(allowed)}, got {value!r}")


def check_count(name: str, value: object, low: int) -> int:
    """An integer of at least `low`."""
    if isinstance(value, bool) or not isinstance(value, int) or value < low:
        raise ValueError(f"{name}: must be an integer of at least {low}, got {value!r}")
    return value


def broadcast_shapes(**shapes: tuple[int, ...]) -> torch.Size:
    """`torch.broadcast_shapes` with an error that names the fields."""
    try:
        return torch.broadcast_shapes(*shapes.values())
    except RuntimeError:
        given = " and ".join(f"{name} {tuple(shape)}" for name, shape in shapes.items())
        raise ValueError(f"{', '.join(shapes)}: batch shapes do not broadcast, got {given}") from None
