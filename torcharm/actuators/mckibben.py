"""The contracting McKibben muscle of Olson et al. (2020)."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torcharm.actuators.bending import Bending, Number
from torcharm.actuators.polynomial import PAPER_BENDING_STIFFNESS
from torcharm.actuators.protocol import check_numbers
from torcharm.inputs import HoldsTensors, plain_number

_A1, _A2 = 1.038555666, 0.511454549
_B1, _B2, _B3 = 1.963398204, -3.169979385, 4.231857967
_E1, _E2, _E3 = 62.59606786, 836.5810641, 89998.04265
_S1, _S2 = 0.637225654, 0.453137516
_SLACK = (_A1 * _A2**2 / _B1) ** 0.5
_STRAIN_LIM, _STRAIN_CRIT = -0.274484489, -0.303225592
_COLLAPSE_RATE = -3.695687763
_NEVER = 1e30  # a pressure [kPa] that no muscle sees; finite, so that no gradient is 0 · inf
_TRACE = 1e-30  # a pressure [kPa] as good as none


_EXTENSION = (_E1, _E2, _E3)
"""E, the passive force in extension [N], by powers 1, 2, … of the strain."""
_COMPRESSION = (21.92761236, 126.11975, 320.5906703, 265.2968218)
"""C, the passive force in contraction [N]."""
_THRESHOLD = (-395.9792747, -1032.874471, 5991.799518, 34610.2847)
"""Z, the pressure [kPa] from which the contracted muscle pulls."""


def _polynomial(coefficients: tuple[float, ...], x: Tensor) -> Tensor:
    total = coefficients[-1] * x
    for coefficient in reversed(coefficients[:-1]):
        total = (total + coefficient) * x
    return total


def _recovery(x: Tensor) -> Tensor:
    """S(ε): rise of force with pressure on the way from compression to pull [N/kPa]."""
    return _S1 * (_S2 + x).square()


_CONTRACTION = tuple(
    powers
    for own in (_COMPRESSION, _THRESHOLD)
    for powers in ((0.0, *own), (*(power * c for power, c in enumerate(own, 1)), 0.0))
)
"""C, C', Z and Z' by powers 0, 1, … of the strain."""
_AT_LIM = torch.tensor(_STRAIN_LIM, dtype=torch.float64)
_RECOVERY_LIM = _recovery(_AT_LIM).item()
_RISE_LIM = (_polynomial(_COMPRESSION, _AT_LIM) / _recovery(_AT_LIM) + _polynomial(_THRESHOLD, _AT_LIM)).item()
_RISE_RATE = _RECOVERY_LIM / (_STRAIN_LIM - _STRAIN_CRIT) ** 2


@dataclass(frozen=True)
class McKibben(HoldsTensors):
    """A McKibben muscle: it pulls (force ≤ 0) when pressurised.

    The piecewise model F of Olson et al. (2020) [N, kPa] is written with coefficients that depend on strain alone, so
    that the work per pressure is small; both branches are finite everywhere:

        F = (C + k max(0, p - p_0) if p < Z else A (p - Z)) + B p^x,    f = -F

    in extension (ε ≥ 0) C is E and Z is out of reach; in contraction B is 0. At a kink the gradient
    is that of the side to which the published model assigns the point (0 for the max).

    Used for strains in [-0.5, 0.05] and pressures up to 100 kPa; monotonic in pressure only for
    strains above -0.303. Beyond +0.05 the cubic of its passive extension explodes.

    Attributes:
        strain_range, pressure_range [kPa]: where the model is used.
        max_pressure: highest pressure in use [kPa].
        bending_stiffness: K [N·m²] at `max_pressure`, or a bending model.
        force_scale: a factor on the force: 2.0 stands for two of them side by side.

    Raises:
        ValueError: a limit is not positive, a range is none, or a number is not finite.

    Example:
        >>> ta.McKibben().force(torch.tensor([0.0, -0.1, -0.2]), torch.tensor(100.0)).round().tolist()  # shorter, less
        [-27.0, -13.0, -6.0]
    """

    name: ClassVar[str] = "mckibben"
    strain_range: tuple[float, float] = (-0.5, 0.05)
    pressure_range: tuple[float, float] = (0.0, 100.0)
    max_pressure: Number = 100.0
    bending_stiffness: Number | Bending = PAPER_BENDING_STIFFNESS
    force_scale: Number = 1.0

    def __post_init__(self) -> None:
        check_numbers(self)

    def force(self, strain: Tensor, pressure: Tensor) -> Tensor:
        """Axial force [N]; strain and pressure [kPa] broadcast."""
        extended = strain >= 0
        extends = extended.to(strain.dtype)
        contracts = 1 - extends
        compression, threshold = _polynomial(_COMPRESSION, strain), _polynomial(_THRESHOLD, strain)

        passive = _select(extended, _polynomial(_EXTENSION, strain), compression)
        pull_from = _select(extended, strain.new_tensor(_NEVER), threshold)
        pull_rate = contracts * (_A1 * (_A2 + strain).square())
        rise_rate, rise_from = _rise(strain, compression, threshold)
        gain = extends * (_B1 * (_B2 * strain + _SLACK).square())
        exponent = _B3 * extends * strain

        recovering = passive + (contracts * rise_rate) * (pressure - rise_from).relu()
        pulling = pull_rate * (pressure - pull_from)
        contracted = _select(pressure < pull_from, recovering, pulling)
        # p exp((x - 1) ln p) instead of p^x: its second derivatives are right, and finite at p = 0.
        power = pressure * (exponent * pressure.clamp(min=_TRACE).log()).exp()
        return (contracted + gain * power) * -self.force_scale

    def pressure_knots(self, strain: Tensor) -> Tensor:
        """Pressures (2, *strain.shape) [kPa] of the kinks in contraction: the onset of recovery, and Z.

        In extension there is none; there they divide a power of pressure that is steepest near 0.
        """
        compression, threshold = _polynomial(_COMPRESSION, strain), _polynomial(_THRESHOLD, strain)
        kinks = torch.stack((_rise(strain, compression, threshold)[1], threshold))
        most = plain_number(self.max_pressure)
        ladder = strain.new_tensor((most / 64, most / 8)).view(-1, *[1] * strain.ndim)
        return _select(strain >= 0, ladder.expand_as(kinks), kinks)


def _rise(strain: Tensor, compression: Tensor, threshold: Tensor) -> tuple[Tensor, Tensor]:
    """Rate [N/kPa] and onset [kPa] of the force's recovery below the threshold Z.

    For ε ≥ ε_lim, `C + max(0, S (p - Z) - C)` is a rise of rate S from `Z + C/S`; below ε_lim the
    published rate is `k (ε - ε_crit)²` from `p_c`. Of use in contraction only.
    """
    mild = strain >= _STRAIN_LIM
    slope = _select(mild, _recovery(strain), strain.new_tensor(_RECOVERY_LIM))
    onset = _select(mild, threshold + compression / slope, strain.new_tensor(_RISE_LIM))
    collapsing = _select(strain >= _STRAIN_CRIT, strain.new_tensor(_RISE_RATE), strain.new_tensor(_COLLAPSE_RATE))
    return _select(mild, slope, collapsing * (strain - _STRAIN_CRIT).square()), onset


def _select(mask: Tensor, chosen: Tensor, other: Tensor) -> Tensor:
    """`torch.where(mask, chosen, other)`, exactly, where both branches are finite.

    On a CPU `where` costs as much as four multiplications, and its gradient twice that; `lerp`
    costs one, and is exact at both of its ends.
    """
    return torch.lerp(other, chosen, mask.to(other.dtype))
