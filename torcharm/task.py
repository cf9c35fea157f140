"""Tasks: the shape an arm is to hold and the load it is to hold it under."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np
import torch
from torch import Tensor

from torcharm._inputs import (
    TensorLike,
    as_floating,
    broadcast_shapes,
    check_at_least,
    check_count,
    check_finite,
)
from torcharm.geometry.rod import BASE_POSE


@dataclass(frozen=True, eq=False, init=False)
class Task:
    """Centreline shapes and tip loads; their batch dimensions broadcast.

    Attributes:
        twists: (..., N, 3) rows `(l, γ, κ)` per unit of normalised arc [m, m, rad].
        tip_load: (..., 3) `(f_x, f_y, m)` at the tip, in the world frame [N, N, N·m].
        base_pose: (3,) pose of node 1 [m, m, rad].
    """

    twists: Tensor
    tip_load: Tensor
    base_pose: Tensor

    def __init__(self, twists: TensorLike, tip_load: TensorLike, base_pose: TensorLike = BASE_POSE) -> None:
        """Check, without expanding: a shape shared by many loads stays shared.

        Raises:
            ValueError: shapes do not fit or a value is not finite.
        """
        twists_, load, base = as_floating(twists=twists, tip_load=tip_load, base_pose=base_pose)
        if twists_.ndim < 2 or twists_.shape[-1] != 3 or twists_.shape[-2] < 1:
            raise ValueError(f"twists: must have shape (..., N, 3) with N at least 1, got {tuple(twists_.shape)}")
        if load.ndim < 1 or load.shape[-1] != 3:
            raise ValueError(f"tip_load: must have shape (..., 3), got {tuple(load.shape)}")
        if base.shape != (3,):
            raise ValueError(f"base_pose: must have shape (3,), got {tuple(base.shape)}")
        for name, value in (("twists", twists_), ("tip_load", load), ("base_pose", base)):
            check_finite(name, value)
        broadcast_shapes(twists=twists_.shape[:-2], tip_load=load.shape[:-1])
        object.__setattr__(self, "twists", twists_)
        object.__setattr__(self, "tip_load", load)
        object.__setattr__(self, "base_pose", base)

    @property
    def batch_shape(self) -> torch.Size:
        """Shape of the batch of tasks; empty for one task."""
        return torch.broadcast_shapes(self.twists.shape[:-2], self.tip_load.shape[:-1])

    @property
    def nodes(self) -> int:
        """N, the number of segments; node i is the start of segment i."""
        return self.twists.shape[-2]

    def to(self, *args: object, **kwargs: object) -> "Task":
        """The task in another dtype or on another device, as `Tensor.to`."""
        return self._map(lambda value: value.to(*args, **kwargs))  # type: ignore[call-overload]

    def _map(self, change: Callable[[Tensor], Tensor]) -> "Task":
        task = object.__new__(type(self))
        for field in fields(self):
            object.__setattr__(task, field.name, change(getattr(self, field.name)))
        return task


def affine_curvature(slope: TensorLike, intercept: TensorLike, length: TensorLike = 0.5, nodes: int = 10) -> Tensor:
    """Twists (..., N, 3) of a shape whose curvature is affine in arc, `κ(s) = slope s + intercept`.

    Args:
        slope, intercept: (...) [rad]; sampled at `s = linspace(0, 1, N)`, as in the paper.
        length: (...) centreline length l [m].
        nodes: N.

    Raises:
        ValueError: shapes do not broadcast, a value is not finite, a length is not positive, or N is
            no positive integer.
    """
    return _polynomial_curvature(length, nodes, slope=slope, intercept=intercept)


def cubic_curvature(
    cubic: TensorLike,
    quadratic: TensorLike,
    slope: TensorLike,
    intercept: TensorLike,
    length: TensorLike = 0.5,
    nodes: int = 10,
) -> Tensor:
    """Twists of `κ(s) = cubic s³ + quadratic s² + slope s + intercept`; else as `affine_curvature`."""
    return _polynomial_curvature(length, nodes, cubic=cubic, quadratic=quadratic, slope=slope, intercept=intercept)


def _polynomial_curvature(length: TensorLike, nodes: int, **coefficients: TensorLike) -> Tensor:
    check_count("nodes", nodes, 1)
    tensors = dict(zip((*coefficients, "length"), as_floating(**coefficients, length=length), strict=True))
    for name, value in tensors.items():
        check_finite(name, value)
    check_at_least("length", tensors["length"], 0.0, strict=True, unit="m")
    shape = broadcast_shapes(**{name: value.shape for name, value in tensors.items()})
    *powers, along = (value.expand(shape).unsqueeze(-1) for value in tensors.values())
    arc = torch.linspace(0, 1, nodes, dtype=along.dtype, device=along.device)
    curvature = torch.zeros_like(arc).expand(*shape, nodes)
    for coefficient in powers:
        curvature = curvature * arc + coefficient
    return torch.stack((along.expand_as(curvature), torch.zeros_like(curvature), curvature), -1)


def sample_loads(count: int, scale: Sequence[float] = (20.0, 20.0, 2.0), seed: int = 100) -> Tensor:
    """Tip loads (count, 3) [N, N, N·m], uniform within ± scale/2: `diag(scale) (U - ½)`.

    The defaults draw the paper's loads: numpy's legacy generator, one load a row.

    Raises:
        ValueError: the count is negative or no integer, the scale not three finite numbers, or the
            seed outside [0, 2³²).
    """
    check_count("count", count, 0)
    if check_count("seed", seed, 0) >= 2**32:
        raise ValueError(f"seed: must be below 2**32, got {seed}")
    (spread,) = as_floating(scale=scale)
    if spread.shape != (3,):
        raise ValueError(f"scale: must be three numbers (f_x, f_y, m), got shape {tuple(spread.shape)}")
    check_finite("scale", spread)
    uniform = np.random.RandomState(seed).rand(count, 3)
    return spread * (torch.as_tensor(uniform, dtype=spread.dtype, device=spread.device) - 0.5)
