"""Turning what a person passes into tensors, with errors that name the field."""

import difflib
import math
import operator
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Sequence
from dataclasses import fields
from functools import reduce
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

if TYPE_CHECKING:
    from pandas import DataFrame

Held = TypeVar("Held", bound="HoldsTensors")

TensorLike = Tensor | npt.NDArray[Any] | float | int | Sequence[Any]
"""Whatever `torch.as_tensor` understands: tensors, numbers, nested lists, numpy arrays."""


def as_floating(**fields: Any) -> list[Tensor]:
    """Tensors of one floating dtype and one device, in the order of the fields.

    The dtype is the promotion of the floating tensors and arrays among the fields;
    numbers, lists and integers follow it, and are float64 if nothing else decides.
    """
    tensors = {
        name: _tensor(name, value)
        for name, value in fields.items()
        if hasattr(value, "dtype") or any(True for _ in _leaves(value))
    }
    dtype: torch.dtype | None = None
    device: torch.device | None = None
    for name, tensor in tensors.items():
        if tensor.is_complex():
            raise ValueError(f"{name}: must be real, got {tensor.dtype}")
        if tensor.is_floating_point():
            dtype = tensor.dtype if dtype is None else torch.promote_types(dtype, tensor.dtype)
        for _ in _leaves(fields[name]):
            if device is not None and tensor.device != device:
                raise ValueError(f"{name}: is on {tensor.device}, the other inputs on {device}")
            device = tensor.device
    dtype = dtype or torch.float64
    return [
        (tensors[name] if name in tensors else _tensor(name, value, dtype)).to(dtype=dtype, device=device)
        for name, value in fields.items()
    ]


def _tensor(name: str, value: Any, dtype: torch.dtype | None = None) -> Tensor:
    """A tensor that keeps the gradients of tensors in lists, and shares no memory with numpy."""
    try:
        leaves = list(_leaves(value))
        if leaves and not isinstance(value, Tensor):
            given = reduce(torch.promote_types, (leaf.dtype for leaf in leaves))
            own = given if given.is_floating_point or given.is_complex else torch.float64
            return torch.stack([_tensor(name, item, dtype or own) for item in value])
        return torch.as_tensor(value.copy() if isinstance(value, np.ndarray) else value, dtype=dtype)
    except (TypeError, ValueError, RuntimeError, OverflowError) as error:
        if _has_text(value):
            raise ValueError(
                f"{name}: must be numbers in metres, radians, kilograms, newtons or kilopascals; texts with units are "
                f"for study files only, got {shown(value)}"
            ) from None
        raise ValueError(
            f"{name}: must be numbers in a regular array, got {shown(value)} ({' '.join(str(error).split())})"
        ) from None


def _has_text(value: Any) -> bool:
    """Whether it is a text, or holds one in nested lists."""
    return isinstance(value, str) or (isinstance(value, (list, tuple)) and any(map(_has_text, value)))


def _leaves(value: Any) -> Iterator[Tensor]:
    """The tensors in nested lists, or the tensor itself."""
    if isinstance(value, Tensor):
        yield value
    elif isinstance(value, (list, tuple)):
        for item in value:
            yield from _leaves(item)


def shown(value: object) -> str:
    """What was given, on one short line."""
    return f"{' '.join(repr(value).split()):.60}"


def three_digits(value: float) -> str:
    """A number as tables and pictures show it: no exponent where none is needed, and "-" for what is not finite."""
    if not math.isfinite(value):
        return "-"
    if 0 < value < 1e-3:
        return "<0.001"
    return f"{value:.0f}" if 100 <= value < 1e5 else f"{value:.3g}"


def shapes_only(value: Any) -> str:
    """A dataclass by the shapes of its tensors, and how many of its flags are set."""
    parts = []
    for field in fields(value):
        held = getattr(value, field.name)
        if isinstance(held, Tensor) and not field.name.startswith("_"):
            counted = f": {int(held.sum())} of {held.numel()}" if held.dtype == torch.bool else ""
            parts.append(f"{field.name} {tuple(held.shape)}{counted}")
    return f"{type(value).__name__}({', '.join(parts)})"


class HoldsTensors:
    """A dataclass that holds tensors, or other such dataclasses, by themselves or in tuples."""

    def __repr__(self) -> str:
        """Shapes, no numbers."""
        return shapes_only(self)

    def to(self: Held, *args: Any, **kwargs: Any) -> Held:
        """The same in another dtype or on another device, as `Tensor.to`; flags and whole numbers keep their dtype."""
        moved = object.__new__(type(self))
        for field in fields(self):  # type: ignore[arg-type]
            object.__setattr__(moved, field.name, _moved(getattr(self, field.name), args, kwargs))
        return moved


class Tabular(ABC):
    """What is a table: columns with an entry for each row."""

    @abstractmethod
    def to_dict(self) -> dict[str, list[Any]]:
        """The columns by their names."""

    def to_frame(self) -> "DataFrame":
        """The same as a table of pandas.

        Raises:
            ModuleNotFoundError: pandas is not installed.
        """
        from pandas import DataFrame

        return DataFrame(self.to_dict())


def _moved(value: Any, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
    """A value of a field after `to` with these arguments."""
    if isinstance(value, HoldsTensors) or (isinstance(value, Tensor) and value.is_floating_point()):
        return value.to(*args, **kwargs)
    if isinstance(value, Tensor):
        return value.to(torch.empty(0, device=value.device).to(*args, **kwargs).device)
    return tuple(_moved(item, args, kwargs) for item in value) if isinstance(value, tuple) else value


def check_tensor(name: str, value: object, *dims: str | int) -> None:
    """Raise unless `value` is a floating tensor of shape (..., *dims); a word stands for any size but 0."""
    form = f"(..., {', '.join(map(str, dims))})"
    if not isinstance(value, Tensor) or not value.is_floating_point():
        raise ValueError(f"{name}: must be a floating-point tensor of shape {form}, got {shown(value)}")
    sizes = value.shape[-len(dims) :]
    if len(sizes) < len(dims) or any(
        size == 0 if isinstance(dim, str) else size != dim for size, dim in zip(sizes, dims, strict=True)
    ):
        raise ValueError(f"{name}: must have shape {form} with no size 0, got {tuple(value.shape)}")


def check_finite(name: str, value: Tensor) -> None:
    """Raise unless every entry is finite, and so are squares of sums of what it is multiplied with."""
    if torch._C._functorch.is_batchedtensor(value):
        refuse_transforms(name)
    largest = torch.finfo(value.dtype).max
    most = largest if value.dtype == torch.float16 else 1e-4 * math.sqrt(largest)
    good = value.abs() <= most
    if not bool(good.all()):
        bad = value[~good].flatten()[0].item()
        bound = f", and at most {most:.1e} in size" if math.isfinite(bad) else ""
        raise ValueError(f"{name}: must be finite{bound}, got {bad:g}")


def refuse_transforms(name: str) -> None:
    """Raise under a transform of torch.func or forward-mode differentiation, which iterations without graph escape."""
    if torch._C._are_functorch_transforms_active() or torch.autograd.forward_ad._current_level >= 0:
        raise RuntimeError(
            f"{name}: transforms of torch.func and forward-mode differentiation are not supported; use plain autograd "
            "(requires_grad with torch.autograd.grad or backward), and batches of designs and tasks instead of vmap"
        )


def check_at_least(name: str, value: Tensor, low: float, *, strict: bool = False, unit: str = "") -> None:
    """Raise unless every entry is at least (or, strictly, above) `low`."""
    bad = value <= low if strict else value < low
    if bool(bad.any()):
        bound = f"above {low:g}" if strict else f"at least {low:g}"
        raise ValueError(f"{name}: must be {bound}{unit and ' ' + unit}, got {value[bad].flatten()[0].item():g}")


def check_pressure(name: str, value: Tensor) -> None:
    """Raise unless every pressure is at least 0 kPa: sets, limits and searches begin there."""
    check_at_least(name, value, 0.0, unit="kPa, as vacuum is not supported")


def check_number(name: str, value: Any, low: float = -math.inf, *, strict: bool = False, unit: str = "") -> float:
    """A finite number of at least (or, strictly, above) `low`."""
    try:
        number = plain_number(value)
    except (TypeError, ValueError, OverflowError, RuntimeError):
        number = math.nan
    if not (low < number if strict else low <= number) or not abs(number) < math.inf:
        bound = "" if low == -math.inf else f" and {'above' if strict else 'at least'} {low:g}{unit and ' ' + unit}"
        raise ValueError(f"{name}: must be a finite number{bound}, got {shown(value)}")
    return number


def plain_number(value: Any) -> float:
    """A number, of a tensor without its graph."""
    return float(value.detach() if isinstance(value, Tensor) else value)


def refuse_graphs(name: str, value: Any, instead: str) -> None:
    """Raise if a tensor, or one in nested lists, asks for a gradient that would be lost."""
    if any(leaf.requires_grad for leaf in _leaves(value)):
        raise ValueError(f"{name}: must be plain numbers, got a tensor that asks for a gradient; {instead}")


def check_choice(name: str, value: object, allowed: Collection[str]) -> None:
    """Raise unless `value` is one of the allowed words."""
    if not isinstance(value, str) or value not in allowed:
        raise ValueError(f"{name}: must be one of {', '.join(allowed)}, got {shown(value)}{hint(value, allowed)}")


def hint(word: object, allowed: Collection[str]) -> str:
    """The word that was meant, if one is near, to end a message with."""
    near = difflib.get_close_matches(word, allowed, 1) if isinstance(word, str) else []
    return f"; did you mean {near[0]}?" if near else ""


def check_count(name: str, value: Any, low: int) -> int:
    """An integer of at least `low` that PyTorch takes; numpy's integers count."""
    try:
        count = operator.index(value)
    except TypeError:
        count = low - 1
    if isinstance(value, bool) or not low <= count < 2**63:
        bound = "" if count < 2**63 else " and below 2**63"
        raise ValueError(f"{name}: must be an integer of at least {low}{bound}, got {shown(value)}")
    return count


def check_flag(name: str, value: object) -> None:
    """Raise unless `value` is True or False."""
    if not isinstance(value, bool):
        raise ValueError(f"{name}: must be True or False, got {shown(value)}")


def check_above_zero(name: str, value: Any) -> float | None:
    """A finite number above 0, or None."""
    if value is None:
        return None
    try:
        return check_number(name, math.nan if isinstance(value, (bool, np.bool_)) else value, 0.0, strict=True)
    except ValueError:
        raise ValueError(f"{name}: must be a finite number above 0, or None, got {shown(value)}") from None


def one_for_all(value: Tensor, count: int) -> Tensor:
    """A value for each of so many actuators (..., M): one number serves them all."""
    return value if value.ndim else value.expand(count)


def broadcast_shapes(**shapes: tuple[int, ...]) -> torch.Size:
    """`torch.broadcast_shapes` with an error that names the fields."""
    try:
        return torch.broadcast_shapes(*shapes.values())
    except RuntimeError:
        given = " and ".join(f"{name} {tuple(shape)}" for name, shape in shapes.items())
        raise ValueError(f"{', '.join(shapes)}: batch shapes do not broadcast, got {given}") from None
