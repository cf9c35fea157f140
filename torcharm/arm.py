"""Arm designs: actuators in parallel, batched and immutable."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from types import EllipsisType
from typing import Any

import torch
from torch import Tensor

from torcharm._inputs import (
    TensorLike,
    as_floating,
    broadcast_shapes,
    check_at_least,
    check_finite,
    shown,
)
from torcharm.actuators import Actuator, Bellows, McKibben, check_actuator

Index = int | slice | EllipsisType | Tensor


@dataclass(frozen=True, eq=False, init=False)
class ArmDesign:
    """M actuators in parallel: where they sit, how long they are, how hard they may be driven.

    Any number of designs with the same kinds of actuators make one batch.

    Attributes:
        radii: (*batch, M) offsets r_α across the arm [m], positive to the left of its heading.
        length: (*batch, M) neutral lengths l̂_α [m].
        actuators: M force models.
        max_pressure: (*batch, M) pressure limits [kPa]; the lower limit is 0.
    """

    radii: Tensor
    length: Tensor
    actuators: tuple[Actuator, ...]
    max_pressure: Tensor

    def __init__(
        self,
        radii: TensorLike,
        length: TensorLike,
        actuators: Sequence[Actuator | str | Path],
        max_pressure: TensorLike | None = None,
    ) -> None:
        """Check and broadcast.

        Args:
            radii: (..., M) [m].
            length: (..., M) one for each actuator, or (...) one for each design [m].
            actuators: M force models, or paths of their files (a `Path`, or text that ends in .toml).
            max_pressure: (..., M) [kPa]; None takes the models' own.

        Raises:
            ValueError: shapes do not fit, or a value is not finite, a length is not positive,
                a limit is negative, or a file holds no force model.
        """
        if not isinstance(actuators, Sequence) or isinstance(actuators, str):
            raise ValueError(f"actuators: must be a list of force models, got {shown(actuators)}")
        models = tuple(_from_file(model) for model in actuators)
        if not models:
            raise ValueError("actuators: must hold at least one force model, got none")
        for index, model in enumerate(models):
            check_actuator(f"actuators[{index}]", model)
        limits = [model.max_pressure for model in models] if max_pressure is None else max_pressure
        radii_, length_, limit = as_floating(radii=radii, length=length, max_pressure=limits)
        count = len(models)
        _check_last("radii", radii_, count, ones=False)
        _check_last("max_pressure", limit, count, ones=True)
        length_ = _per_actuator(length_, radii_, count)
        shape = broadcast_shapes(radii=radii_.shape, length=length_.shape, max_pressure=limit.shape)
        for name, value in (("radii", radii_), ("length", length_), ("max_pressure", limit)):
            check_finite(name, value)
        check_at_least("length", length_, 0.0, strict=True, unit="m")
        check_at_least("max_pressure", limit, 0.0, unit="kPa")
        object.__setattr__(self, "radii", radii_.expand(shape))
        object.__setattr__(self, "length", length_.expand(shape))
        object.__setattr__(self, "actuators", models)
        object.__setattr__(self, "max_pressure", limit.expand(shape))

    def with_values(self, radii: Tensor, length: Tensor, max_pressure: Tensor) -> "ArmDesign":
        """Designs of the same actuators, from tensors (..., M) of one shape that are known to be sound: not checked."""
        design = object.__new__(type(self))
        values = {"radii": radii, "length": length, "actuators": self.actuators, "max_pressure": max_pressure}
        for name, value in values.items():
            object.__setattr__(design, name, value)
        return design

    @property
    def batch_shape(self) -> torch.Size:
        """Shape of the batch of designs; empty for one design."""
        return self.radii.shape[:-1]

    @property
    def actuator_count(self) -> int:
        """M."""
        return len(self.actuators)

    def flatten(self) -> "ArmDesign":
        """The same designs as a batch of one dimension."""
        return self._map(lambda value: value.reshape(-1, self.actuator_count))

    def __getitem__(self, index: Index | tuple[Index, ...]) -> "ArmDesign":
        """The designs at an index into the batch, as a tensor of shape `batch_shape` is indexed."""
        if not self.batch_shape:
            raise ValueError("index: a single design has no batch to index")
        place = index if isinstance(index, tuple) else (index,)
        return self._map(lambda value: value[(*place, slice(None))])

    def _map(self, change: Callable[[Tensor], Tensor]) -> "ArmDesign":
        """The designs with every tensor changed alike; what was checked stays checked."""
        design = object.__new__(type(self))
        for field in fields(self):
            value = getattr(self, field.name)
            object.__setattr__(design, field.name, change(value) if isinstance(value, Tensor) else value)
        return design


def _from_file(model: Any) -> Any:
    """The model that a path stands for; what is no path stays as it is."""
    if isinstance(model, Path) or (isinstance(model, str) and model.endswith(".toml")):
        from torcharm.actuators.model_file import load_actuator  # loads when it is first asked for

        return load_actuator(model)
    return model


def _check_last(name: str, value: Tensor, count: int, *, ones: bool) -> None:
    allowed = (count, 1) if ones else (count,)
    if value.ndim == 0 or value.shape[-1] not in allowed:
        raise ValueError(
            f"{name}: the last dimension must be the number of actuators, {count}{' (or 1)' if ones else ''}, "
            f"got shape {tuple(value.shape)}"
        )


def _per_actuator(length: Tensor, radii: Tensor, count: int) -> Tensor:
    """Neutral lengths as (..., M), told from (...) by shape; what cannot be told is an error."""
    batch = radii.shape[:-1]
    each_actuator = length.ndim > 0 and length.shape[-1] in (count, 1)
    each_design = length.ndim == 0 or length.shape == batch
    if each_actuator and each_design and count > 1 and length.shape[-1] > 1:
        raise ValueError(
            f"length: shape {tuple(length.shape)} could be one for each actuator or one for each design; "
            f"give (1, {count}) or ({', '.join(map(str, length.shape))}, 1)"
        )
    if each_design:
        return length.unsqueeze(-1)
    if each_actuator:
        return length
    raise ValueError(
        f"length: must have shape {(*batch, count)} (each actuator) or {tuple(batch)} (each design), "
        f"got {tuple(length.shape)}"
    )


def antagonistic_arm(
    outer_radius: TensorLike = 0.08, inner_radius: TensorLike = 0.015, length: TensorLike = 0.5
) -> ArmDesign:
    """The paper's antagonistic arm: bellows outside, muscles inside.

    Args:
        outer_radius, inner_radius: (...) offsets [m]; tensors make a batch of designs.
        length: (...) or (..., 4) neutral lengths [m].
    """
    return ArmDesign(_mirrored(outer_radius, inner_radius), length, (Bellows(), McKibben(), McKibben(), Bellows()))


def bellows_arm(
    outer_radius: TensorLike = 0.08, inner_radius: TensorLike = 0.015, length: TensorLike = 0.5
) -> ArmDesign:
    """The paper's bellows-only arm; arguments as for `antagonistic_arm`."""
    return ArmDesign(_mirrored(outer_radius, inner_radius), length, (Bellows(),) * 4)


def mckibben_arm(
    outer_radius: TensorLike = 0.01, inner_radius: TensorLike = 0.01, length: TensorLike = 0.5
) -> ArmDesign:
    """The paper's muscle-only arm: four muscles at ±1 cm, every one doubled in force.

    Arguments as for `antagonistic_arm`.
    """
    return ArmDesign(_mirrored(outer_radius, inner_radius), length, (McKibben(force_scale=2.0),) * 4)


def _mirrored(outer_radius: TensorLike, inner_radius: TensorLike) -> Tensor:
    """Radii (-outer, -inner, inner, outer)."""
    outer, inner = as_floating(outer_radius=outer_radius, inner_radius=inner_radius)
    broadcast_shapes(outer_radius=outer.shape, inner_radius=inner.shape)
    check_finite("outer_radius", outer)
    check_finite("inner_radius", inner)
    outer, inner = torch.broadcast_tensors(outer, inner)
    return torch.stack((-outer, -inner, inner, outer), -1)
