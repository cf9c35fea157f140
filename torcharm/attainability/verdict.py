"""Verdicts: what a person may conclude from an evaluation, in a word for each task."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries
from torcharm.inputs import check_number

if TYPE_CHECKING:
    from torcharm.pressure.predicted_error import PredictedError
    from torcharm.pressure.search import PressureSearch

VERDICTS = ("held", "missed", "excluded by range", "undecided", "impossible")
"""Held: a shape within the tolerance was found, a stable equilibrium that loading leads to, with strains and pressures
that were characterised. Missed: the same, beyond the tolerance, and no pressure nearby does better. Excluded by range:
strains or pressure limits are beyond what was characterised, so that every figure extrapolates. Undecided: beyond the
tolerance, and a better pressure may exist, as the minimisation did not converge; or no stable equilibrium was found, or
loading leads to another one. Impossible: an actuator would have no length."""
HELD, MISSED, EXCLUDED, UNDECIDED, IMPOSSIBLE = range(len(VERDICTS))

LENGTH_SHARE = 0.02
"""Of an arm's length, how far off its tip may be unless told otherwise. Force models are good to a few percent: to ask
for less would be to ask the model for what it does not know."""
ROTATION = math.radians(5.0)
"""How far the tip may be turned unless told otherwise [rad]: that moves the end of a tool that is a quarter as long as
the arm by the same 2 % of the arm's length."""

WIDEST = {
    "tip": (1.0, "1 m (is it in millimetres?)"),
    "rotation": (math.pi, "π rad (is it in degrees?)"),
    "shape": (1.0, "1 m (is it in millimetres?)"),
}
"""What no tolerance exceeds, and in words: more was meant in other units."""


@dataclass(frozen=True)
class PoseTolerance:
    """How far off a pose may be that still does the job.

    Attributes:
        tip: distance of the tip [m]; None is 2 % of the arm's neutral length.
        rotation: turn of the tip [rad].
        shape: mean distance of the shape, as `shape_error` [m]; None is the same as for the tip.

    Raises:
        ValueError: a tolerance is not a number above 0, or above 1 m or π.

    Example:
        >>> task = ta.Task(ta.constant_curvature(0.5), tip_load=[1.0, 0.0, 0.0])
        >>> ta.evaluate(ta.antagonistic_arm(), task, tolerance=ta.PoseTolerance(tip=0.0002)).verdict  # else held
        'missed'
    """

    tip: float | None = None
    rotation: float = ROTATION
    shape: float | None = None

    def __post_init__(self) -> None:
        for name in ("tip", "rotation", "shape"):
            value = getattr(self, name)
            if value is not None:
                number = check_number(f"tolerance.{name}", value, 0.0, strict=True)
                most, words = WIDEST[name]
                if number > most:
                    raise ValueError(f"tolerance.{name}: must be at most {words}, got {number:g}")
                object.__setattr__(self, name, number)

    def lengths(self, arm: ArmDesign | ArmSeries) -> tuple[Tensor, Tensor]:
        """(*design batch) tolerances of tip and shape [m] for arms of their lengths."""
        own = LENGTH_SHARE * arm.neutral_length.detach()
        tip = own if self.tip is None else torch.full_like(own, self.tip)
        return tip, tip if self.shape is None else torch.full_like(own, self.shape)


def over_tolerance(
    arm: ArmDesign | ArmSeries, prediction: "PredictedError | PressureSearch", tolerance: PoseTolerance
) -> Tensor:
    """(3, *design batch, *task batch) errors of the tip's place, its turn and the shape, each over its tolerance."""
    tasks = prediction.tip_error.ndim - len(arm.batch_shape)
    tip, shape = (value.reshape(value.shape + (1,) * tasks) for value in tolerance.lengths(arm))
    found = (
        prediction.tip_error / tip,
        prediction.tip_rotation_error / tolerance.rotation,
        prediction.shape_error / shape,
    )
    return torch.stack(found).detach()


def judge(
    arm: ArmDesign | ArmSeries,
    prediction: "PredictedError | PressureSearch",
    tolerance: PoseTolerance,
    in_range: Tensor,
    impossible: Tensor,
) -> Tensor:
    """Indices into `VERDICTS` (*design batch, *task batch).

    Args:
        arm: the designs.
        prediction: of all of them on all tasks, or what a search found.
        tolerance: what counts as held.
        in_range: whether the task's shape, the limits and the shape predicted lie in the characterised range.
        impossible: whether an actuator would have no length at the task's shape.
    """
    close = (over_tolerance(arm, prediction, tolerance) <= 1).all(0)
    found = torch.where(close, HELD, torch.where(prediction.at_minimum, MISSED, UNDECIDED))
    found = torch.where(prediction.stable & prediction.reached, found, UNDECIDED)
    found = torch.where(in_range, found, EXCLUDED)
    return torch.where(impossible | ~prediction.possible, IMPOSSIBLE, found)
