"""Force models that are polynomials in strain and pressure, and the paper's bellows among them."""

import math
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torcharm.actuators.bending import Bending, Number
from torcharm.actuators.protocol import check_numbers
from torcharm.inputs import HoldsTensors, refuse_graphs, shown

PAPER_BENDING_STIFFNESS = -1.0 / 3.5
"""K [N·m²]; the paper estimated one value for bellows and muscles alike."""

Coefficients = tuple[tuple[int, int, float], ...]
"""Terms `(i, j, c)` of `Σ c ε^i p^j`, p in kPa and the sum in N."""


@dataclass(frozen=True)
class PolynomialActuator(HoldsTensors):
    """`f(ε, p) = Σ c_ij ε^i p^j` [N], positive pushing outward.

    Attributes:
        coefficients: terms `(i, j, c)`, with i and j the powers of strain and pressure [kPa].
        strain_range, pressure_range [kPa]: where the coefficients were fitted.
        max_pressure: highest pressure in use [kPa].
        bending_stiffness: K [N·m²] at `max_pressure`, or a bending model.
        force_scale: a factor on the force: 2.0 stands for two of them side by side.

    Raises:
        ValueError: a power is negative or no whole number, a limit is not positive, a range is none,
            or a number is not finite.

    Example:
        >>> spring = ta.PolynomialActuator(((0, 1, 0.8), (1, 0, -40.0)), (-0.2, 0.4), (0.0, 60.0), 60.0)  # 0.8 p - 40 ε
        >>> round(float(spring.force(torch.tensor(0.1), torch.tensor(50.0))), 3)
        36.0
    """

    name: ClassVar[str] = "polynomial"
    coefficients: Coefficients
    strain_range: tuple[float, float]
    pressure_range: tuple[float, float]
    max_pressure: Number
    bending_stiffness: Number | Bending = PAPER_BENDING_STIFFNESS
    force_scale: Number = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "coefficients", _terms(self.coefficients))
        check_numbers(self)

    @property
    def pressure_degree(self) -> int:
        """The highest power of pressure that acts."""
        return max([0, *(j for _, j, c in self.coefficients if c != 0)])

    def force(self, strain: Tensor, pressure: Tensor) -> Tensor:
        """Axial force [N]; strain and pressure [kPa] broadcast."""
        if isinstance(self.force_scale, Tensor):
            return self._force(self._rows(1.0), strain, pressure) * self.force_scale
        return self._force(self._rows(self.force_scale), strain, pressure)

    @staticmethod
    def _force(rows: list[list[float]], strain: Tensor, pressure: Tensor) -> Tensor:
        total = _horner(rows[-1], strain)
        for row in reversed(rows[:-1]):
            total = total * pressure + _horner(row, strain)
        return total if len(rows) > 1 else total.expand(torch.broadcast_shapes(strain.shape, pressure.shape))

    def _rows(self, scale: float) -> list[list[float]]:
        """`rows[j][i] = c_ij` times a scale: for each power of pressure a polynomial in strain."""
        strain_degree = max([0, *(i for i, _, _ in self.coefficients)])
        pressure_degree = max([0, *(j for _, j, _ in self.coefficients)])
        rows = [[0.0] * (strain_degree + 1) for _ in range(pressure_degree + 1)]
        for i, j, c in self.coefficients:
            rows[j][i] += c * scale
        return rows


def _terms(coefficients: Coefficients) -> Coefficients:
    """The terms, checked, as a tuple with powers that are integers."""
    refuse_graphs("coefficients", coefficients, "TensorPolynomial has coefficients to differentiate by")
    try:
        terms = [(float(i), float(j), float(c)) for i, j, c in coefficients]
    except (TypeError, ValueError):
        raise ValueError(f"coefficients: must be terms (i, j, c) of numbers, got {shown(coefficients)}") from None
    for i, j, c in terms:
        if not (i.is_integer() and j.is_integer() and min(i, j) >= 0):
            raise ValueError(f"coefficients: powers must be whole and at least 0, got ({i:g}, {j:g})")
        if not math.isfinite(c):
            raise ValueError(f"coefficients: must be finite, got {c} at powers ({i:g}, {j:g})")
    return tuple((int(i), int(j), c) for i, j, c in terms)


def _horner(row: list[float], x: Tensor) -> Tensor:
    degree = max([0, *(i for i, c in enumerate(row) if c != 0)])
    total = torch.full_like(x, row[degree])
    for c in reversed(row[:degree]):
        total = total * x + c
    return total


BELLOWS_COEFFICIENTS: Coefficients = (
    (1, 0, -10.47),
    (0, 1, 1.068),
    (2, 0, 7.344),
    (1, 1, -0.5504),
    (0, 2, -0.00205),
    (3, 0, -19.39),
    (2, 1, 0.03461),
    (1, 2, 0.006294),
    (0, 3, -3.081e-5),
)
"""The paper's fit to test-bench data (R² 0.9947), in torcharm's sign: a bellows pushes."""


@dataclass(frozen=True)
class Bellows(PolynomialActuator):
    """The paper's extending bellows: a cubic in strain and pressure [N], fitted to tensile tests (R² 0.9947).

    Characterised for strains in [-0.167, 0.668] and pressures up to 92 kPa; used up to 50 kPa, to
    which it is monotonic in pressure. Attributes and errors are those of `PolynomialActuator`.

    Example:
        >>> ta.Bellows().force(torch.tensor([0.0, 0.2, 0.4]), torch.tensor(50.0)).round().tolist()  # longer, less
        [44.0, 40.0, 36.0]
    """

    name: ClassVar[str] = "bellows"
    coefficients: Coefficients = BELLOWS_COEFFICIENTS
    strain_range: tuple[float, float] = (-0.167, 0.668)
    pressure_range: tuple[float, float] = (0.0, 92.0)
    max_pressure: Number = 50.0
