"""Arm designs: actuators in parallel, batched and immutable."""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from types import EllipsisType
from typing import Any

import torch
from torch import Tensor

from torcharm.actuators import Actuator, is_passive, model_name, model_of
from torcharm.actuators.deviation import ForceDeviation
from torcharm.inputs import (
    HoldsTensors,
    TensorLike,
    as_floating,
    broadcast_shapes,
    check_at_least,
    check_count,
    check_finite,
    check_pressure,
    one_for_all,
)

Index = int | slice | EllipsisType | Tensor | None


@dataclass(frozen=True, eq=False, init=False, repr=False)
class ArmDesign(HoldsTensors):
    """M actuators in parallel: where they sit, how long they are, how hard they may be driven.

    Any number of designs with the same kinds of actuators make one batch. An arm whose actuators lie in one plane
    is planar; one with offsets out of it, be they zero, is spatial.

    Attributes:
        radii: (*batch, M) offsets y across the arm [m], positive to the left of its heading.
        length: (*batch, M) neutral lengths l̂_α [m].
        actuators: M force models.
        max_pressure: (*batch, M) pressure limits [kPa]; the lower limit is 0.
        out_of_plane: (*batch, M) offsets z out of the plane [m], or None for a planar arm.
        mass: (*batch) mass of the arm [kg], spread evenly over its normalised arc.
        torsion_stiffness: (*batch) stiffness C against torsion [N·m²], or None for an arm that does not twist.
        diameter: (*batch, M) outer diameters of the actuators [m], or None where they are not known.
        deviation: what built actuators do other than their models, or None.

    Example:
        >>> ta.ArmDesign(offsets=ta.ring(0.05, 6), length=0.4, actuators=["bellows", "mckibben"] * 3, mass=0.3)
        ArmDesign(spatial, 3 bellows, 3 mckibben, batch (), torch.float64)
        >>> ta.ArmDesign(radii=[[-0.05, 0.05], [-0.08, 0.08]], length=0.4, actuators="bellows")  # two in the plane
        ArmDesign(planar, 2 bellows, batch (2,), torch.float64)
    """

    radii: Tensor
    length: Tensor
    actuators: tuple[Actuator, ...]
    max_pressure: Tensor
    out_of_plane: Tensor | None
    mass: Tensor
    torsion_stiffness: Tensor | None
    diameter: Tensor | None
    deviation: ForceDeviation | None

    def __init__(
        self,
        radii: TensorLike | None = None,
        length: TensorLike | None = None,
        actuators: Actuator | str | Path | Sequence[Actuator | str | Path] | None = None,
        max_pressure: TensorLike | None = None,
        offsets: TensorLike | None = None,
        mass: TensorLike = 0.0,
        torsion_stiffness: TensorLike | None = None,
        diameter: TensorLike | None = None,
        *,
        out_of_plane: TensorLike | None = None,
        deviation: ForceDeviation | None = None,
    ) -> None:
        """Check and broadcast.

        Args:
            radii: (..., M), or one for all [m]; a planar arm's only offsets.
            length: (..., M) one for each actuator, or (...) one for each design [m].
            actuators: M force models or one for all: objects, names of shipped ones ("bellows", "mckibben"), or paths
                of their files (a `Path`, or text that ends in .toml).
            max_pressure: (..., M) or one for all [kPa]; None takes the models' own, and 0 for passive ones.
            offsets: (..., M, 2) a spatial arm's offsets (y, z) [m], in place of the radii; see `ring`.
            mass: (...) mass of the whole arm, one for each design [kg].
            torsion_stiffness: (...) one for each design [N·m²].
            diameter: (..., M) or one for all [m].
            out_of_plane: (..., M), or one for all, the offsets z beside radii that are the offsets y [m]: the other way
                to write `offsets`.
            deviation: what built actuators do other than their models, by tensors that broadcast to (..., M).

        Raises:
            ValueError: shapes do not fit, or a value is not finite, a length is not positive,
                a limit is negative, a name stands for no model, or a file holds none.
        """
        if offsets is not None and (radii is not None or out_of_plane is not None):
            raise ValueError("offsets: must stand alone, in place of radii and out_of_plane, got both")
        given = {"radii": radii} if offsets is None else {"offsets": offsets}
        for name, value in (*given.items(), ("length", length), ("actuators", actuators)):
            if value is None:
                raise ValueError(f"{name}: must be given, got None")
        models = _models(actuators, **given)
        passive = [is_passive(model) for model in models]
        own = [0.0 if without else model.max_pressure for without, model in zip(passive, models, strict=True)]
        limits = own if max_pressure is None else max_pressure
        given |= {"length": length, "max_pressure": limits, "mass": mass}
        optional = {"out_of_plane": out_of_plane, "torsion_stiffness": torsion_stiffness, "diameter": diameter}
        given |= {name: value for name, value in optional.items() if value is not None}
        values = dict(zip(given, as_floating(**given), strict=True))
        if values["max_pressure"].ndim == 0 and any(passive):  # one limit for all is one for all that it drives
            driven = [float(not without) for without in passive]
            values["max_pressure"] = values["max_pressure"] * values["max_pressure"].new_tensor(driven)
        if "offsets" in values:
            places = values["offsets"].shape[-2]
            if places != len(models):
                raise ValueError(f"offsets: must hold one (y, z) for each of the {len(models)} actuators, got {places}")
            values["radii"], values["out_of_plane"] = values.pop("offsets").unbind(-1)
        else:
            values["radii"] = one_for_all(values["radii"], len(models))
        checked = _check_and_expand(values, len(models))
        for name, value in {**dict.fromkeys((*optional, "deviation")), **checked, "actuators": models}.items():
            object.__setattr__(self, name, value)
        if deviation is not None:
            object.__setattr__(self, "deviation", deviation.changed(lambda value: value.expand(self.radii.shape)))

    def with_values(
        self, radii: Tensor, length: Tensor, max_pressure: Tensor, out_of_plane: Tensor | None = None
    ) -> "ArmDesign":
        """Designs of the same actuators, from tensors (..., M) of one shape that are known to be sound: not checked.

        What else there is stays, also offsets out of the plane unless given, and must have that shape or broadcast to
        it.
        """
        design = object.__new__(type(self))
        values: dict[str, Any] = {"radii": radii, "length": length, "max_pressure": max_pressure}
        values["actuators"] = self.actuators
        kept = {"out_of_plane": self.out_of_plane if out_of_plane is None else out_of_plane, "diameter": self.diameter}
        for name, value in kept.items():
            values[name] = None if value is None else value.expand(radii.shape).to(radii)
        for name in ("mass", "torsion_stiffness"):
            value = getattr(self, name)
            values[name] = None if value is None else value.expand(radii.shape[:-1]).to(radii)
        own = self.deviation
        values["deviation"] = None if own is None else own.changed(lambda value: value.expand(radii.shape).to(radii))
        for name, value in values.items():
            object.__setattr__(design, name, value)
        return design

    def with_deviation(self, deviation: ForceDeviation) -> "ArmDesign":
        """The same designs with actuators that deviate from their models, by tensors that broadcast to (*batch, M)."""
        design = self._map(lambda value: value)
        object.__setattr__(design, "deviation", deviation.changed(lambda value: value.expand(self.radii.shape)))
        return design

    def tensors(self) -> list[Tensor]:
        """All tensors of the designs; those of force models are their own."""
        held = [value for value in vars(self).values() if isinstance(value, Tensor)]
        return held if self.deviation is None else [*held, *self.deviation.tensors()]

    @property
    def batch_shape(self) -> torch.Size:
        """Shape of the batch of designs; empty for one design."""
        return self.radii.shape[:-1]

    @property
    def actuator_count(self) -> int:
        """M."""
        return len(self.actuators)

    @property
    def dimension(self) -> int:
        """2 for a planar arm, 3 for a spatial one."""
        return 2 if self.out_of_plane is None else 3

    @property
    def neutral_length(self) -> Tensor:
        """(*batch) the actuators' mean neutral length [m]."""
        return self.length.mean(-1)

    @property
    def offsets(self) -> Tensor:
        """(*batch, M, 2) offsets (y, z) [m]; z is 0 for a planar arm."""
        z = torch.zeros_like(self.radii) if self.out_of_plane is None else self.out_of_plane
        return torch.stack((self.radii, z), -1)

    def to(self, *args: Any, **kwargs: Any) -> "ArmDesign":
        """The designs in another dtype or on another device, as `Tensor.to`; the force models stay as they are."""
        return self._map(lambda value: value.to(*args, **kwargs))

    def flatten(self) -> "ArmDesign":
        """The same designs as a batch of one dimension."""
        count = math.prod(self.batch_shape)
        return self._map(lambda value: value.reshape(count, value.shape[-1]))

    def __getitem__(self, index: Index | tuple[Index, ...]) -> "ArmDesign":
        """The designs at an index into the batch, as a tensor of shape `batch_shape` is indexed."""
        if not self.batch_shape:
            raise ValueError("index: a single design has no batch to index")
        place = index if isinstance(index, tuple) else (index,)
        return self._map(lambda value: value[(*place, slice(None))])

    def __repr__(self) -> str:
        """Kinds and shapes, no numbers."""
        kinds = Counter(map(model_name, self.actuators))
        models = ", ".join(f"{count} {kind}" for kind, count in kinds.items())
        where = "planar" if self.dimension == 2 else "spatial"
        return f"ArmDesign({where}, {models}, batch {tuple(self.batch_shape)}, {self.radii.dtype})"

    def _map(self, change: Callable[[Tensor], Tensor]) -> "ArmDesign":
        """The designs with every tensor, as (*batch, M) or (*batch, 1), changed alike; what was checked stays so."""
        design = object.__new__(type(self))
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, Tensor):
                each_design = field.name in ("mass", "torsion_stiffness")
                value = change(value.unsqueeze(-1)).squeeze(-1) if each_design else change(value)
            elif isinstance(value, ForceDeviation):
                value = value.changed(change)
            object.__setattr__(design, field.name, value)
        return design


def ring(radius: TensorLike, count: int, phase: TensorLike = 0.0) -> Tensor:
    """Offsets (..., count, 2) of actuators evenly spaced on a circle: `(r cos φ, r sin φ)`, φ = phase + 2πk/count.

    Args:
        radius: (...) of the circle [m].
        count: of actuators.
        phase: (...) angle of the first from the arm's left (body y) towards body z [rad].

    Raises:
        ValueError: a value is not finite, a radius is negative, the count is no positive integer, or shapes do not
            broadcast.

    Example:
        >>> ta.ring(radius=0.05, count=3).round(decimals=3).tolist()
        [[0.05, 0.0], [-0.025, 0.043], [-0.025, -0.043]]
    """
    check_count("count", count, 1)
    size, first = as_floating(radius=radius, phase=phase)
    check_finite("radius", size)
    check_finite("phase", first)
    check_at_least("radius", size, 0.0, unit="m")
    broadcast_shapes(radius=size.shape, phase=first.shape)
    angle = first.unsqueeze(-1) + torch.arange(count, dtype=first.dtype, device=first.device) * (2 * math.pi / count)
    return size[..., None, None] * torch.stack((angle.cos(), angle.sin()), -1)


def _models(actuators: Any, **across: Any) -> tuple[Actuator, ...]:
    """Force models from objects, names and paths; one that is no list serves every offset across the arm."""
    (name,) = across
    (places,) = as_floating(**across)
    if name == "offsets" and (places.ndim < 2 or places.shape[-1] != 2):
        raise ValueError(f"offsets: must have shape (..., M, 2), got {tuple(places.shape)}")
    if isinstance(actuators, (Path, str)) or not isinstance(actuators, Sequence):
        count = places.shape[-2 if name == "offsets" else -1] if places.ndim else 1
        models = (find_model("actuators", actuators),) * count
    else:
        models = tuple(find_model(f"actuators[{index}]", given) for index, given in enumerate(actuators))
    if not models:
        raise ValueError("actuators: must hold at least one force model, got none")
    return models


def _check_and_expand(values: dict[str, Tensor], count: int) -> dict[str, Tensor]:
    """The tensors of a design, checked, in the shape of the batch."""
    _check_last("radii", values["radii"], count, ones=False)
    for name in ("max_pressure", "out_of_plane", "diameter"):
        if name in values and values[name].ndim:
            _check_last(name, values[name], count, ones=name != "out_of_plane")
    values["length"] = _per_actuator(values["length"], values["radii"], count)
    each_design = ("mass", "torsion_stiffness")
    shapes = {
        name: (*value.shape, 1) if name in each_design else value.shape
        for name, value in values.items()
        if value.ndim  # one number serves every batch
    }
    shape = broadcast_shapes(**shapes)
    for name, value in values.items():
        check_finite(name, value)
    check_at_least("length", values["length"], 0.0, strict=True, unit="m")
    check_pressure("max_pressure", values["max_pressure"])
    check_at_least("mass", values["mass"], 0.0, unit="kg")
    for name, unit in (("torsion_stiffness", "N·m²"), ("diameter", "m")):
        if name in values:
            check_at_least(name, values[name], 0.0, strict=True, unit=unit)
    return {name: value.expand(shape[:-1] if name in each_design else shape) for name, value in values.items()}


def find_model(field: str, given: Any) -> Actuator:
    """A force model from itself, from the name of a shipped one, or from the path of its file.

    Raises:
        ValueError: it is none, as `field` says.
    """
    if isinstance(given, Path) or (isinstance(given, str) and given.endswith(".toml")):
        from torcharm.characterise.model_file import load_actuator  # loads when it is first asked for

        return load_actuator(given)
    return model_of(field, given)


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
