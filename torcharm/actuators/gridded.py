"""Force models given as numbers on a grid of strains and pressures, for data that no polynomial fits."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from torcharm.actuators.bending import Bending, Number
from torcharm.actuators.fitting import Array
from torcharm.actuators.polynomial import PAPER_BENDING_STIFFNESS
from torcharm.actuators.protocol import check_numbers
from torcharm.inputs import HoldsTensors, TensorLike, check_number, refuse_graphs, shown

SMOOTHNESS = 1e-6
"""Of `fit_gridded_model`: weight of roughness against the mean square of the residuals."""
DEPENDENT = 1e-14

Row = tuple[float, ...]


@dataclass(frozen=True)
class GriddedActuator(HoldsTensors):
    """Bicubic spline through forces on a grid: twice continuously differentiable, exact at the grid's points.

    The tensor product of cubic splines with not-a-knot ends (de Boor): with two points a side it is bilinear, with
    three it is a parabola. Beyond the grid it goes on linearly from the edge; strains there are out of range,
    and flagged as such in results.

    Attributes:
        strains: S of them, increasing.
        pressures: P of them [kPa], increasing.
        forces: S rows of P [N], positive pushing outward.
        max_pressure: highest pressure in use [kPa].
        bending_stiffness: K [N·m²] at `max_pressure`, or a bending model.
        force_scale: a factor on the force: 2.0 stands for two of them side by side.

    Raises:
        ValueError: fewer than two strains or pressures, not in order, a force is missing or not finite, or a limit is
            not positive.
    """

    name: ClassVar[str] = "gridded"
    strains: Row
    pressures: Row
    forces: tuple[Row, ...]
    max_pressure: Number
    bending_stiffness: Number | Bending = PAPER_BENDING_STIFFNESS
    force_scale: Number = 1.0
    strain_range: tuple[float, float] = field(init=False)
    pressure_range: tuple[float, float] = field(init=False)

    def __post_init__(self) -> None:
        for name in ("strains", "pressures", "forces"):
            refuse_graphs(name, getattr(self, name), "results differentiate by force_scale and bending_stiffness alone")
        for name in ("strains", "pressures"):
            object.__setattr__(self, name, _axis(name, getattr(self, name)))
        object.__setattr__(self, "forces", _forces(self.forces, len(self.strains), len(self.pressures)))
        object.__setattr__(self, "strain_range", (self.strains[0], self.strains[-1]))
        object.__setattr__(self, "pressure_range", (self.pressures[0], self.pressures[-1]))
        check_numbers(self)

    @property
    def pressure_degree(self) -> int:
        """Between the grid's pressures the force is a cubic in pressure."""
        return 3

    def pressure_knots(self, strain: Tensor) -> Tensor:
        """The grid's pressures (P, *strain.shape) [kPa], between which the force is one cubic."""
        return strain.new_tensor(self.pressures).view(-1, *(1,) * strain.ndim).expand(-1, *strain.shape)

    def force(self, strain: Tensor, pressure: Tensor) -> Tensor:
        """Axial force [N]; strain and pressure [kPa] broadcast."""
        table, anchors = self._spline
        edges = strain.new_tensor(self.strains), strain.new_tensor(self.pressures)
        row, column = (
            torch.bucketize(value.contiguous(), edge) for value, edge in ((strain, edges[0]), (pressure, edges[1]))
        )
        x = strain - strain.new_tensor(anchors[0])[row]
        y = pressure - strain.new_tensor(anchors[1])[column]
        cell = row * (len(self.pressures) + 1) + column
        total: Any = 0.0
        for by_strain in table.to(strain):  # highest power of pressure first, and of strain in it
            part: Any = 0.0
            for coefficient in by_strain:
                part = part * x + coefficient.take(cell)
            total = total * y + part
        return total * self.force_scale

    @cached_property
    def _spline(self) -> tuple[Tensor, tuple[Row, Row]]:
        """Coefficients (4, 4, cells) of each cell's bicubic, powers of pressure first; and where cells count from."""
        by_strain, from_strain = _pieces(np.array(self.strains), np.array(self.forces))
        both, from_pressure = _pieces(np.array(self.pressures), np.moveaxis(by_strain, -1, 0))
        table = torch.from_numpy(np.ascontiguousarray(np.transpose(both, (0, 2, 3, 1))).reshape(4, 4, -1))
        return table, (from_strain, from_pressure)


def _pieces(knots: Array, values: Array) -> tuple[Array, Row]:
    """A spline's cubics (4, n + 1, ...), highest power first, with a straight one at either end; and origins."""
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(knots, values, axis=0)
    ends = knots[[0, -1]]
    straight = np.zeros((4, 2, *values.shape[1:]))
    straight[2], straight[3] = spline(ends, 1), spline(ends)
    cubics = np.concatenate((straight[:, :1], spline.c, straight[:, 1:]), 1)
    return cubics, (float(knots[0]), *knots.tolist())


def _axis(name: str, value: Any) -> Row:
    try:
        axis = tuple(float(x) for x in value)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: must be two or more numbers in order, got {shown(value)}") from None
    if len(axis) < 2 or not np.isfinite(axis).all() or not (np.diff(axis) > 0).all():
        raise ValueError(f"{name}: must be two or more finite numbers that increase, got {shown(axis)}")
    return axis


def _forces(value: Any, strains: int, pressures: int) -> tuple[Row, ...]:
    try:
        rows = tuple(tuple(float(x) for x in row) for row in value)
    except (TypeError, ValueError):
        raise ValueError(f"forces: must be rows of numbers, got {shown(value)}") from None
    if len(rows) != strains or any(len(row) != pressures for row in rows):
        sizes = sorted({len(row) for row in rows})
        raise ValueError(
            f"forces: must be {strains} rows (strains) of {pressures} (pressures), got {len(rows)} rows of {sizes}"
        )
    if not np.isfinite(rows).all():
        raise ValueError("forces: must be finite, got one that is not")
    return rows


def fit_gridded_model(
    strain: TensorLike,
    pressure: TensorLike,
    force: TensorLike,
    strains: TensorLike,
    pressures: TensorLike,
    *,
    smoothness: float = SMOOTHNESS,
    **options: Any,
) -> GriddedActuator:
    """The bicubic spline on a grid that fits scattered samples best, smoothed where they are few.

    Minimises the mean squared residual plus `smoothness` times the mean squared second differences of force from one
    grid point to the next (in units of their index), which also settles cells without samples.

    Args:
        strain, pressure [kPa], force [N]: n samples each.
        strains, pressures [kPa]: the grid.
        smoothness: above 0.
        **options: further fields of `GriddedActuator`; `max_pressure` is the grid's highest unless told.

    Raises:
        ValueError: samples do not match in number or are not finite; or as for `GriddedActuator`.
    """
    from scipy.interpolate import CubicSpline
    from scipy.linalg import solve

    from torcharm.actuators.characterisation import checked_samples

    x, y, f = checked_samples(strain, pressure, force)
    check_number("smoothness", smoothness, 0.0, strict=True)
    axes = _axis("strains", strains), _axis("pressures", pressures)
    bases = [
        CubicSpline(axis, np.eye(len(axis)))(np.clip(value, axis[0], axis[-1]))
        for axis, value in zip(axes, (x, y), strict=True)
    ]
    count = len(axes[0]) * len(axes[1])
    gram, right = np.zeros((count, count)), np.zeros(count)
    for start in range(0, len(f), 20_000):  # bounds memory
        part = slice(start, start + 20_000)
        rows = (bases[0][part, :, None] * bases[1][part, None, :]).reshape(-1, count)
        gram += rows.T @ rows
        right += rows.T @ f[part]
    bends = [np.diff(np.eye(len(axis)), 2, axis=0) for axis in axes]
    roughness = np.kron(bends[0].T @ bends[0], np.eye(len(axes[1]))) + np.kron(
        np.eye(len(axes[0])), bends[1].T @ bends[1]
    )
    system = gram / len(f) + smoothness * roughness
    try:
        values = solve(system, right / len(f), assume_a="pos")
    except np.linalg.LinAlgError:
        raise ValueError(
            "strain, pressure: must vary enough to determine the grid's forces, got samples that do not"
        ) from None
    forces = values.reshape(len(axes[0]), len(axes[1]))
    fields = {"max_pressure": axes[1][-1], **options}
    return GriddedActuator(axes[0], axes[1], tuple(map(tuple, forces.tolist())), **fields)
