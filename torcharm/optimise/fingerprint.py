"""What a problem is, as digests of its parts: equal for equal problems, in whatever process they are put together.

Data are digested by their bytes, objects by the name of their class and by their state: fields, attributes (but for
cached properties), a module's parameters, buffers and parts, what functions close over. Nothing is digested by how it
prints, which may leave things out or hold addresses. How a force model behaves cannot be read from its state alone, as
its code may have been edited: its forces and moments on a grid are kept besides, and compared.
"""

import functools
import itertools
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import fields, is_dataclass
from enum import Enum
from hashlib import sha256
from pathlib import PurePath
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torcharm._inputs import shown
from torcharm.actuators import Actuator
from torcharm.actuators.bending import active_moment, passive_moment

CHECKED_STRAINS, CHECKED_PRESSURES, CHECKED_CURVATURES = 9, 7, 8
"""Points of the grid on which a model's forces are compared, and curvatures, to either side, for its moments."""
WIDEST_STRAINS = (-0.9, 1.5)
"""Stand for the ends of a strain range that is infinite."""
HIGHEST_CURVATURE = 20.0
"""[rad/m] up to which moments are compared."""
SAME_FORCE = {torch.float64: 1e-9}
"""By how much of the largest force two models may differ that are taken for the same: rounding on two machines."""
SAME_FORCE_ELSE = 1e-4
"""The same for other numbers than float64."""
NUMBERS = (bool, int, float, complex, str, bytes, type(None), type(Ellipsis))


def digest(value: Any, name: str) -> str:
    """The digest of a value.

    Args:
        value: of any kind.
        name: what the error calls it.

    Raises:
        ValueError: it holds something that cannot be told from others of its kind.
    """
    return _digest(value, name, ())


def _digest(value: Any, name: str, above: tuple[int, ...]) -> str:
    if id(value) in above:  # a circle: how far up it closes is all that can be said
        return f"circle {len(above) - above.index(id(value))}"
    inside = (*above, id(value))
    made = sha256()
    for part in _parts(value, name, inside):
        text = part if isinstance(part, bytes) else _digest(part(), name, inside).encode()
        made.update(f"{len(text)}:".encode() + text)
    return made.hexdigest()


Part = bytes | Callable[[], Any]


def _parts(value: Any, name: str, inside: tuple[int, ...]) -> Iterator[Part]:
    """What tells a value from others: bytes, and functions that return further values."""
    if isinstance(value, (np.generic, Enum)) and not isinstance(value, (float, int, str)):
        value = value.item() if isinstance(value, np.generic) else (type(value), value.name)
    if isinstance(value, NUMBERS):
        yield _number(value)
    elif isinstance(value, Tensor):
        yield from _array(value.detach().to_dense().cpu().contiguous())
    elif isinstance(value, np.ndarray) and value.dtype != object:
        yield f"array {value.dtype} {value.shape}".encode()
        yield np.ascontiguousarray(value).tobytes()
    elif isinstance(value, (torch.dtype, torch.device, PurePath)):
        yield f"{type(value).__name__} {value}".encode()
    elif isinstance(value, Mapping):
        yield b"mapping"
        yield from sorted(_digest([key, entry], name, inside).encode() for key, entry in value.items())
    elif isinstance(value, AbstractSet):
        yield b"set"
        yield from sorted(_digest(entry, name, inside).encode() for entry in value)
    elif isinstance(value, (list, tuple, np.ndarray)):
        yield f"sequence {len(value)}".encode()
        yield from (functools.partial(_itself, entry) for entry in value)
    elif isinstance(value, type):
        yield _name(value)
    else:
        yield from _object(value, name)


def _itself(value: Any) -> Any:
    return value


def _number(value: Any) -> bytes:
    """Numbers by value: 1 and 1.0 are the same setting."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        exact = isinstance(value, float) or abs(value) <= 2**53
        return f"number {float(value).hex() if exact else value}".encode()
    return f"{type(value).__name__} {value!r}".encode()


def _array(value: Tensor) -> Iterator[bytes]:
    yield f"array {value.dtype} {tuple(value.shape)}".encode()
    yield value.reshape(-1).view(torch.uint8).numpy().tobytes() if value.numel() else b""


def _name(value: Any) -> bytes:
    return f"{value.__module__}.{value.__qualname__}".encode()


def _object(value: Any, name: str) -> Iterator[Part]:
    """The parts of functions, methods and of objects of a class."""
    if isinstance(value, types.FunctionType):
        yield from _function(value)
    elif isinstance(value, types.CodeType):
        yield value.co_code
        yield lambda: [value.co_consts, value.co_names]
    elif isinstance(value, types.MethodType):
        yield lambda: [value.__self__, value.__func__]
    elif isinstance(value, types.BuiltinFunctionType):
        owner = value.__self__
        yield f"{value.__module__}.{value.__qualname__}".encode()
        yield lambda: None if isinstance(owner, types.ModuleType) else owner
    elif isinstance(value, types.ModuleType):
        yield value.__name__.encode()
    elif isinstance(value, functools.partial):
        yield lambda: [value.func, value.args, value.keywords]
    else:
        state = _state(value)
        yield _name(type(value))
        if state is None:
            yield from _reduced(value, name)
        else:
            yield lambda: state
            yield lambda: _closures(type(value))


def _function(value: types.FunctionType) -> Iterator[Part]:
    """A function by its name; one without a name of its own by its code; and what it holds on to."""
    yield _name(value)
    yield lambda: [value.__defaults__, value.__kwdefaults__, _cells(value)]
    if "<" in value.__qualname__:
        yield lambda: value.__code__


def _cells(function: types.FunctionType) -> list[Any]:
    """What a function closes over, but for the class that it belongs to."""
    names = function.__code__.co_freevars
    cells = zip(names, function.__closure__ or (), strict=True)
    return [cell.cell_contents for name, cell in cells if name != "__class__"]


def _closures(kind: type) -> dict[str, Any]:
    """What methods close over, and the class itself holds, of classes that were made in a function."""
    held: dict[str, Any] = {}
    for owner in kind.__mro__:
        for name, entry in vars(owner).items() if "<locals>" in owner.__qualname__ else ():
            if name.startswith("__") and name != "__call__":
                continue
            function = entry.fget if isinstance(entry, property) else entry
            if isinstance(function, types.FunctionType):
                held[name] = _cells(function)
            elif isinstance(entry, (*NUMBERS, Tensor, np.ndarray, tuple, list, dict)):
                held[name] = entry
    return held


_BARE_MODULE = frozenset(vars(torch.nn.Module()))
"""Names that every module has."""


def _state(value: Any) -> dict[str, Any] | None:
    """What an object holds, by name; None for what is not made of attributes."""
    kind = type(value)
    slots = [slot for owner in kind.__mro__ for slot in _slots(owner)]
    if not hasattr(value, "__dict__") and not slots and not is_dataclass(value):
        return None
    names = [field.name for field in fields(value)] if is_dataclass(value) else []
    state = {name: getattr(value, name) for name in (*names, *slots) if hasattr(value, name)}
    cached = {
        name
        for owner in kind.__mro__
        for name, entry in vars(owner).items()
        if isinstance(entry, functools.cached_property)
    }
    held = {name: entry for name, entry in getattr(value, "__dict__", {}).items() if name not in cached}
    if isinstance(value, torch.nn.Module):
        held = {name: entry for name, entry in held.items() if name not in _BARE_MODULE}
        parts = (value.named_parameters(recurse=False), value.named_buffers(recurse=False), value.named_children())
        held |= dict(itertools.chain(*parts)) | {"training": value.training}
    return state | held


def _slots(owner: type) -> Sequence[str]:
    slots = vars(owner).get("__slots__", ())
    names = (slots,) if isinstance(slots, str) else tuple(slots)
    return [name for name in names if name not in ("__dict__", "__weakref__")]


def _reduced(value: Any, name: str) -> Iterator[Part]:
    """An object by how it would be put together again."""
    try:
        made = value.__reduce_ex__(4)
    except (TypeError, AttributeError, NotImplementedError):
        made = None
    if isinstance(made, str):  # a name in its module
        yield made.encode()
        return
    if made is None:
        raise ValueError(
            f"checkpoint: {name} holds {shown(value)}, which cannot be told from others of its kind; keep numbers, "
            "tensors and functions in it, or give no checkpoint"
        )
    function, arguments, state, *items = made if len(made) > 2 else (*made, None)
    yield lambda: [function, arguments, state, *(None if part is None else list(part) for part in items[:2])]


def model_digest(model: Actuator, name: str) -> str:
    """The digest of a force model: its class, its state, and the members that are asked of every model."""
    members = [getattr(model, member, None) for member in ("max_pressure", "strain_range", "pressure_range")]
    return digest([model, model.bending_stiffness, members, getattr(model, "force_scale", None)], name)


def behaviour(models: Sequence[Actuator], dtype: torch.dtype) -> npt.NDArray[np.float64]:
    """(K, n) forces and moments of K force models on a grid; NaN where a model gives no number."""
    return np.stack([np.concatenate((_forces(model, dtype), _moments(model, dtype))) for model in models])


def _forces(model: Actuator, dtype: torch.dtype) -> npt.NDArray[np.float64]:
    ends = [float(end) for end in model.strain_range]
    low, high = (end if abs(end) < np.inf else wide for end, wide in zip(ends, WIDEST_STRAINS, strict=True))
    strain = torch.linspace(low, high, CHECKED_STRAINS, dtype=dtype).unsqueeze(-1)
    pressure = torch.linspace(0.0, float(model.max_pressure), CHECKED_PRESSURES, dtype=dtype)
    return _called(lambda: model.force(strain, pressure), CHECKED_STRAINS * CHECKED_PRESSURES)


def _moments(model: Actuator, dtype: torch.dtype) -> npt.NDArray[np.float64]:
    curvature = torch.linspace(-HIGHEST_CURVATURE, HIGHEST_CURVATURE, 2 * CHECKED_CURVATURES + 1, dtype=dtype)
    stiffness, none = model.bending_stiffness, torch.zeros_like(curvature)

    def passive() -> Tensor:
        moment = passive_moment(stiffness, curvature)
        return none if moment is None else moment

    sides = (lambda: active_moment(stiffness, curvature), passive)
    return np.concatenate([_called(side, len(curvature)) for side in sides])


def _called(function: Callable[[], Tensor], count: int) -> npt.NDArray[np.float64]:
    """The numbers that a user's function returns; NaN if it fails, which is not for a fingerprint to say."""
    try:
        with torch.no_grad():
            found = function().detach().double().cpu().numpy().reshape(-1)
        return found if found.shape == (count,) else np.full(count, np.nan)
    except Exception:
        return np.full(count, np.nan)


def behaves_alike(one: npt.NDArray[np.float64], other: npt.NDArray[np.float64], dtype: torch.dtype) -> bool:
    """Whether forces and moments on the grid are the same but for rounding."""
    if one.shape != other.shape:
        return False
    apart = SAME_FORCE.get(dtype, SAME_FORCE_ELSE)
    split = CHECKED_STRAINS * CHECKED_PRESSURES
    return all(
        np.allclose(a, b, rtol=0.0, atol=apart * np.nanmax(np.abs(a), initial=0.0), equal_nan=True)
        for a, b in ((one[:split], other[:split]), (one[split:], other[split:]))
    )
