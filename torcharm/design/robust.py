"""An objective over built arms: of the values that a design has once built, the mean or a quantile, on fixed samples.

The samples are the same for all designs that are compared (common random numbers), so that the objective is as smooth
as one design's. A quantile is estimated as by Harrell and Davis (Biometrika 1982): a mean of all ordered values, the
nearer to the quantile the more weight they have, which is smooth where the plain one jumps from sample to sample.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from torcharm.arm_series import rebuilt, segments_of
from torcharm.design.scatter import Scatter, Source, built_arms, normal_numbers, scattered
from torcharm.design.space import Arm
from torcharm.inputs import check_count, check_flag, check_number, shown


@dataclass(frozen=True)
class Robust:
    """That built arms count, in place of the drawn one.

    Attributes:
        scatter: how they differ from it.
        quantile: of their values what is made small, between 0 and 1: 0.9 is what nine of ten stay below, by Harrell
            and Davis (1982), which is smooth; None is the mean.
        samples: built arms of each design.
        seed: of the samples.
        compensated: whether pressures are found anew for each built arm; else they keep the drawn arm's.

    Raises:
        ValueError: an argument is none of those allowed.

    Example:
        >>> robust = ta.Robust(ta.Scatter(length=2e-3), quantile=0.5, samples=10)  # for an `Objective`
        >>> round(float(robust.total(torch.arange(1.0, 11.0))), 1)  # half of ten built arms stay below
        5.5
    """

    scatter: Scatter
    quantile: float | None = 0.9
    samples: int = 32
    seed: int = 0
    compensated: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.scatter, Scatter):
            raise ValueError(f"scatter: must be a Scatter, got {shown(self.scatter)}")
        if self.quantile is not None and not 0 < check_number("quantile", self.quantile) < 1:
            raise ValueError(f"quantile: must be between 0 and 1, or None for the mean, got {self.quantile:g}")
        check_count("samples", self.samples, 2)
        check_count("seed", self.seed, 0)
        check_flag("compensated", self.compensated)

    def total(self, values: Tensor) -> Tensor:
        """The number (...) of designs whose built arms have values (..., S)."""
        if self.quantile is None:
            return values.mean(-1)
        return (values.sort(-1).values * torch.from_numpy(self._weights).to(values)).sum(-1)

    @cached_property
    def _weights(self) -> "np.ndarray[tuple[int], np.dtype[np.float64]]":
        """(S,) of the ordered values."""
        from scipy.special import betainc

        assert self.quantile is not None
        places, count = np.linspace(0, 1, self.samples + 1), self.samples + 1
        return np.diff(betainc(count * self.quantile, count * (1 - self.quantile), places))

    def draw(self, arm: Arm) -> tuple[Sequence[Source], Sequence[Tensor]]:
        """What is scattered of designs like an arm, and for each source its parameters (S, K).

        Raises:
            ValueError: as of `Scatter.sources`.
        """
        sources = self.scatter.sources(arm)
        return sources, scattered(sources, normal_numbers(sources, self.samples, self.seed))


def built_beside(arm: Arm, sources: Sequence[Source], values: Sequence[Tensor]) -> Arm:
    """The built arms (*batch, S) of designs (*batch), by parameters (S, K) of each source."""
    beside = [segment._map(lambda value: value.unsqueeze(-2)) for segment in segments_of(arm)[0]]
    return built_arms(rebuilt(arm, beside), sources, values)
