"""External loads: a tip load, loads at places along the arm, and gravity."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from torcharm.inputs import (
    HoldsTensors,
    TensorLike,
    as_floating,
    broadcast_shapes,
    check_at_least,
    check_choice,
    check_count,
    check_finite,
    check_flag,
    check_number,
    shown,
)

GRAVITY = 9.81
"""Acceleration [m/s²] along world -y."""

FRAMES = ("world", "body")


@dataclass(frozen=True, eq=False, init=False, repr=False)
class PointLoad(HoldsTensors):
    """A wrench, a point mass or both at a place of the arm.

    Attributes:
        wrench: (..., 3) `(f_x, f_y, m)` in the plane, (..., 6) `(f_x, f_y, f_z, m_x, m_y, m_z)` in space
            [N, N·m], or None for a mass alone.
        segment: index of the pressure segment that it sits on, from 0 at the base; -1 is the last.
        at: the place on that segment's normalised arc, from 0 (its start) to 1 (its end, before a link).
        frame: "world" for a wrench of fixed direction, "body" for one that turns with the arm.
        mass: (...) [kg], which weighs where the load has gravity.

    Example:
        >>> ta.PointLoad(wrench=[0.0, 2.0, 0.0], at=0.5, frame="body")  # 2 N to the arm's left, half way
        PointLoad(wrench (3,) in the body frame, last segment at 0.5, mass ())
    """

    wrench: Tensor | None
    segment: int
    at: float
    frame: str
    mass: Tensor

    def __init__(
        self,
        wrench: TensorLike | None = None,
        segment: int = -1,
        at: float = 1.0,
        frame: str = "world",
        mass: TensorLike | None = None,
    ) -> None:
        """Check.

        Raises:
            ValueError: a value makes no sense, or there is neither a wrench nor a mass, which may be 0.
        """
        if wrench is None and mass is None:
            raise ValueError("wrench: must be given for a point load without a mass, got None")
        own = 0.0 if mass is None else mass
        given = {"mass": own} if wrench is None else {"wrench": wrench, "mass": own}
        values = dict(zip(given, as_floating(**given), strict=True))
        for name, value in values.items():
            check_finite(name, value)
        if wrench is not None and (values["wrench"].ndim < 1 or values["wrench"].shape[-1] not in (3, 6)):
            shape = tuple(values["wrench"].shape)
            raise ValueError(f"wrench: must have shape (..., 3) in the plane or (..., 6) in space, got {shape}")
        check_at_least("mass", values["mass"], 0.0, unit="kg")
        check_choice("frame", frame, FRAMES)
        place = check_number("at", at, 0.0)
        if place > 1:
            raise ValueError(f"at: must be from 0 to 1, the ends of the segment, got {place:g}")
        object.__setattr__(self, "wrench", values.get("wrench"))
        object.__setattr__(self, "segment", check_count("segment", segment, -1))
        object.__setattr__(self, "at", place)
        object.__setattr__(self, "frame", frame)
        object.__setattr__(self, "mass", values["mass"])

    def _map(self, change: Callable[[Tensor], Tensor]) -> "PointLoad":
        load = object.__new__(type(self))
        for name in ("segment", "at", "frame"):
            object.__setattr__(load, name, getattr(self, name))
        object.__setattr__(load, "wrench", None if self.wrench is None else change(self.wrench))
        object.__setattr__(load, "mass", change(self.mass))
        return load

    def __repr__(self) -> str:
        """Shapes, and where it sits."""
        wrench = "no wrench" if self.wrench is None else f"wrench {tuple(self.wrench.shape)} in the {self.frame} frame"
        where = "last segment" if self.segment < 0 else f"segment {self.segment}"
        return f"PointLoad({wrench}, {where} at {self.at:g}, mass {tuple(self.mass.shape)})"


@dataclass(frozen=True, eq=False, init=False, repr=False)
class ExternalLoad(HoldsTensors):
    """All that loads an arm from outside.

    Attributes:
        tip: (..., 3) or (..., 6) wrench at the tip in the world frame [N, N·m], or None.
        gravity: whether the arm, its links and the points' masses weigh: 9.81 m/s² along world -y.
        points: loads at places along the arm.

    Example:
        >>> ta.ExternalLoad(gravity=True, points=[ta.PointLoad(mass=0.1)])  # its own weight, and 100 g at the tip
        ExternalLoad(no tip load, gravity=True, points=[PointLoad(no wrench, last segment at 1, mass ())])
    """

    tip: Tensor | None
    gravity: bool
    points: tuple[PointLoad, ...]

    def __init__(
        self, tip: TensorLike | None = None, gravity: bool = False, points: PointLoad | Sequence[PointLoad] = ()
    ) -> None:
        """Check, and bring all to one dtype.

        Raises:
            ValueError: a value makes no sense, planar and spatial wrenches are mixed, batches do not broadcast, or a
                point has a mass that has no weight without gravity.
        """
        check_flag("gravity", gravity)
        listed = (points,) if isinstance(points, PointLoad) else points
        if not isinstance(listed, Sequence):
            raise ValueError(f"points: must be a list of PointLoad, got {shown(points)}")
        for index, point in enumerate(listed):
            if not isinstance(point, PointLoad):
                raise ValueError(f"points[{index}]: must be a PointLoad, got {shown(point)}")
            if not gravity and bool((point.mass > 0).any()):
                raise ValueError(f"points[{index}].mass: must be 0 without gravity=True, which gives it its weight")
        given: dict[str, Any] = {} if tip is None else {"tip": tip}
        for index, point in enumerate(listed):
            given |= {} if point.wrench is None else {f"points[{index}].wrench": point.wrench}
            given[f"points[{index}].mass"] = point.mass
        values = dict(zip(given, as_floating(**given), strict=True))
        if tip is not None:
            check_tip("tip", values["tip"])
        wrenches = {name: value for name, value in values.items() if not name.endswith("mass")}
        first = next(iter(wrenches.items()), None)
        for name, value in wrenches.items():
            if first is not None and value.shape[-1] != first[1].shape[-1]:
                raise ValueError(
                    f"{name}: must have {first[1].shape[-1]} components as {first[0]} has, got {value.shape[-1]}"
                )
        dtype = next(iter(values.values())).dtype if values else torch.float64
        object.__setattr__(self, "tip", values.get("tip"))
        object.__setattr__(self, "gravity", gravity)
        object.__setattr__(self, "points", tuple(point._map(lambda value: value.to(dtype)) for point in listed))
        _ = self.batch_shape

    @property
    def batch_shape(self) -> torch.Size:
        """Shape to which the batches of all its wrenches and masses broadcast."""
        shapes = {
            name: value.shape if name.endswith("mass") else value.shape[:-1] for name, value in self.tensors().items()
        }
        return broadcast_shapes(**shapes) if shapes else torch.Size()

    @property
    def columns(self) -> int | None:
        """Components of its wrenches, 3 or 6; None if it has none."""
        wrenches = (self.tip, *(point.wrench for point in self.points))
        return next((wrench.shape[-1] for wrench in wrenches if wrench is not None), None)

    def tensors(self) -> dict[str, Tensor]:
        """Its tensors, by the names of their fields."""
        found = {} if self.tip is None else {"tip": self.tip}
        for index, point in enumerate(self.points):
            found |= {} if point.wrench is None else {f"points[{index}].wrench": point.wrench}
            found[f"points[{index}].mass"] = point.mass
        return found

    def with_tip(self, tip: Tensor | None) -> "ExternalLoad":
        """The same load but for its tip load, which is not checked."""
        load = object.__new__(type(self))
        for name, value in (("tip", tip), ("gravity", self.gravity), ("points", self.points)):
            object.__setattr__(load, name, value)
        return load

    def _map(self, change: Callable[[Tensor], Tensor]) -> "ExternalLoad":
        load = self.with_tip(None if self.tip is None else change(self.tip))
        object.__setattr__(load, "points", tuple(point._map(change) for point in self.points))
        return load

    def __repr__(self) -> str:
        """Shapes, no numbers."""
        tip = "no tip load" if self.tip is None else f"tip {tuple(self.tip.shape)}"
        return f"ExternalLoad({tip}, gravity={self.gravity}, points={list(self.points)})"


def check_tip(name: str, tip: Tensor, columns: tuple[int, ...] = (3, 6)) -> None:
    """Raise unless a tip load is a finite wrench of the plane or of space."""
    if tip.ndim < 1 or tip.shape[-1] not in columns:
        form = " or ".join(f"(..., {count})" for count in columns)
        raise ValueError(f"{name}: must have shape {form}, got {tuple(tip.shape)}")
    check_finite(name, tip)
