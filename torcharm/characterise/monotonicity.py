"""Whether a force model is monotonic in pressure, as the paper assumes of all actuators, and where it is not."""

from dataclasses import dataclass

import torch

from torcharm.actuators.protocol import Actuator
from torcharm.actuators.shipped import model_of
from torcharm.inputs import check_count, shown

FLAT = 1e-9
"""A slope of so much of the steepest against the rest counts as none."""

Range = tuple[float, float]


@dataclass(frozen=True)
class Monotonicity:
    """What `monotonicity` found on its grid.

    Attributes:
        monotonic: whether force never runs against its trend as pressure grows, at any strain.
        rising: whether the trend is upwards.
        up_to: the highest pressure [kPa] to which it is monotonic at every strain.
        failing_share: of the box, 0 to 1.
        failing_strain, failing_pressure [kPa]: ranges that hold all failures; None if there is none.
        worst_slope: the slope that runs against the trend most, or along it least [N/kPa].
        worst_strain, worst_pressure [kPa]: where.

    Example:
        >>> round(ta.monotonicity("bellows").up_to)  # the pressure to which more of it pushes more [kPa]
        83
    """

    monotonic: bool
    rising: bool
    up_to: float
    failing_share: float
    failing_strain: Range | None
    failing_pressure: Range | None
    worst_slope: float
    worst_strain: float
    worst_pressure: float


def monotonicity(
    model: Actuator | str,
    strain_range: Range | None = None,
    pressure_range: Range | None = None,
    *,
    points: int = 201,
) -> Monotonicity:
    """Look at the slope of force over pressure on a grid of points × points strains and pressures.

    Args:
        model: any force model, or the name of a shipped one.
        strain_range, pressure_range [kPa]: the box; None takes the model's own.
        points: a side.

    Raises:
        ValueError: the model is none, a range is not two finite numbers in order, or there are fewer than 2 points.

    Example:
        >>> [round(strain, 2) for strain in ta.monotonicity("mckibben").failing_strain]  # pressure weakens it there
        [-0.5, -0.3]
    """
    model = model_of("model", model)
    count = check_count("points", points, 2)
    axes = []
    for name, own in (
        ("strain_range", strain_range or model.strain_range),
        ("pressure_range", pressure_range or model.pressure_range),
    ):
        if not (len(own) == 2 and -float("inf") < own[0] <= own[1] < float("inf")):
            raise ValueError(f"{name}: must be two finite numbers (lowest, highest), got {shown(own)}")
        axes.append(torch.linspace(*own, count, dtype=torch.float64))
    strain, pressure = axes
    grid = pressure.expand(count, count).clone().requires_grad_()
    with torch.enable_grad():
        force = model.force(strain.unsqueeze(-1), grid)
        if force.requires_grad:
            (slope,) = torch.autograd.grad(force.sum(), grid)
        else:
            slope = torch.zeros_like(grid)
    trend = 1.0 if slope.mean() >= 0 else -1.0
    along = trend * slope.detach()
    failing = along < -FLAT * along.abs().max()
    worst = int(along.argmin())
    places = failing.nonzero()
    return Monotonicity(
        monotonic=not len(places),
        rising=trend > 0,
        up_to=_up_to(pressure, along, failing),
        failing_share=failing.double().mean().item(),
        failing_strain=_span(strain, places[:, 0]),
        failing_pressure=_span(pressure, places[:, 1]),
        worst_slope=slope.flatten()[worst].item(),
        worst_strain=strain[worst // count].item(),
        worst_pressure=pressure[worst % count].item(),
    )


def _up_to(pressure: torch.Tensor, along: torch.Tensor, failing: torch.Tensor) -> float:
    """The least pressure, over strains, at which the slope changes sign; between grid points by interpolation."""
    first = torch.where(failing.any(1), failing.double().argmax(1), len(pressure))
    column = int(first.min())
    if column == len(pressure):
        return pressure[-1].item()
    if column == 0:
        return pressure[0].item()
    rows = (first == column).nonzero().squeeze(-1)
    before, after = along[rows, column - 1], along[rows, column]
    share = (before / (before - after)).clamp(0, 1).min()
    return torch.lerp(pressure[column - 1], pressure[column], share).item()


def _span(axis: torch.Tensor, index: torch.Tensor) -> Range | None:
    return (axis[index.min()].item(), axis[index.max()].item()) if len(index) else None
