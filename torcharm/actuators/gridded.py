"""Force models given as numbers on a grid of strains and pressures, for data that no polynomial fits."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torcharm.actuators.bending import Bending, Number
from torcharm.actuators.measured import Measured
from torcharm.actuators.polynomial import PAPER_BENDING_STIFFNESS
from torcharm.actuators.protocol import check_numbers
from torcharm.inputs import HoldsTensors, refuse_graphs, shown

Array = NDArray[np.float64]
Row = tuple[float, ...]


@dataclass(frozen=True)
class GriddedActuator(Measured, HoldsTensors):
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
        region, provenance: as of `Measured`.

    Raises:
        ValueError: fewer than two strains or pressures, not in order, a force is missing or not finite, or a limit is
            not positive.

    Example:
        >>> model = ta.GriddedActuator((0.0, 0.4), (0.0, 50.0), ((0.0, 44.0), (-4.0, 30.0)), max_pressure=50.0)
        >>> round(float(model.force(torch.tensor(0.2), torch.tensor(25.0))), 3)  # in the middle of the four forces
        17.5
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
            object.__setattr__(self, name, grid_axis(name, getattr(self, name)))
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


def grid_axis(name: str, value: Any) -> Row:
    """Two or more finite numbers that increase, or a ValueError that names them."""
    try:
        axis = tuple(float(x) for x in value)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: must be two or more numbers in order, got {shown(value)}") from None
    if len(axis) < 2 or not np.isfinite(axis).all() or not (np.diff(axis) > 0).all():
        raise ValueError(f"{name}: must be two or more finite numbers that increase, got {shown(axis)}")
    return axis


def _forces(value: Any, strains: int, pressures: int) -> tuple[Row, ...]:
    try:
        rows = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"forces: must be rows of numbers, all as long, got {shown(value)}") from None
    if rows.shape != (strains, pressures):
        got = " rows of ".join(map(str, rows.shape)) or shown(value)
        raise ValueError(f"forces: must be {strains} rows (strains) of {pressures} (pressures), got {got}")
    if not np.isfinite(rows).all():
        raise ValueError("forces: must be finite, got one that is not")
    return tuple(map(tuple, rows.tolist()))
