"""What this experiment measures, a row each."""

from dataclasses import dataclass

import torch
from torch import Tensor

import torcharm as ta


@dataclass(frozen=True)
class Row:
    """One arm under one load. Unattainabilities in N; predicted and reached shape errors in m."""

    arm: str
    load: int
    force_x_N: float
    force_y_N: float
    moment_Nm: float
    absolute_N: float
    relative_N: float
    predicted_m: float
    reached_m: float
    converged: bool
    in_range: bool
    starts_agree: bool


@dataclass(frozen=True)
class Answers:
    """What is known of one arm, each (loads,)."""

    name: str
    arm: ta.ArmDesign
    hulls: ta.Attainability
    predicted: Tensor
    search: ta.PressureSearch

    @property
    def reached(self) -> Tensor:
        """The search's shape error [m]; NaN where the search did not converge."""
        return torch.where(self.search.converged, self.search.shape_error, torch.nan)

    def metric(self, name: str) -> Tensor:
        """One of `METRICS`."""
        values = {"absolute": self.hulls.absolute, "relative": self.hulls.relative, "predicted error": self.predicted}
        found = values[name]
        assert found is not None
        return found
