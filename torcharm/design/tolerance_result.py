"""What was found of built arms: percentiles, yields, and what decides them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torcharm.attainability.verdict import EXCLUDED, VERDICTS, PoseTolerance
from torcharm.design.scatter import Scatter
from torcharm.design.space import Arm
from torcharm.inputs import HoldsTensors, Tabular, check_number

PERCENTILES = (5.0, 50.0, 95.0)
CONFIDENCE = 0.95
CRITERIA = ("tip", "turn", "shape", "no stable shape")
"""What an arm may fail on a task: the tip's place, its turn, the shape; or no stable equilibrium that loading leads to,
which fails in nothing else."""
LINEAR = 0.9
"""Of the variance of tips, so much is explained by slopes that what decides is told by them alone."""


@dataclass(frozen=True)
class Yield:
    """A share of built arms, and between which bounds it lies with some confidence.

    Attributes:
        count, samples: of the arms drawn, and in all.
        value: their ratio.
        low, high: bounds by Clopper and Pearson. Sobol' numbers are spread more evenly than those that these bounds
            are for, so that they are rather too wide.
    """

    count: int
    samples: int
    value: float
    low: float
    high: float

    @classmethod
    def of(cls, within: Tensor, confidence: float = CONFIDENCE) -> "Yield":
        """Of flags (S,)."""
        from scipy.stats import binomtest

        count, samples = int(within.sum()), len(within)
        bounds = binomtest(count, samples).proportion_ci(confidence, "exact")
        return cls(count, samples, count / samples, float(bounds.low), float(bounds.high))

    def __str__(self) -> str:
        """In percent, with its bounds."""
        return f"{100 * self.value:.1f} % ({100 * self.low:.1f} to {100 * self.high:.1f})"


@dataclass(frozen=True, eq=False, repr=False)
class BuiltArms(HoldsTensors, Tabular):
    """What `tolerance` found of S built arms on T tasks.

    Attributes:
        tip_error: (S, T) distance of the tip from the task's [m]; infinite where there is no stable equilibrium.
        failed: (S, T, 4) which of `CRITERIA` each arm fails: yields count those that fail none. Strains may be beyond
            what was characterised: manufacture does not know of that range, and the verdict does.
        verdict_code: (S, T) indices into `torcharm.attainability.verdict.VERDICTS`: "held" is within, and in range.
        tip: (S, T, D) the tip's place seen from the task's [m]; NaN where there is none.
        margin: (S, T) capacity margin [N], if it was asked for.
        nominal_tip_error: (T,) of the drawn arm.
        sources: G names of what is scattered, in the order in which it is told.
        slopes: for each source (T, D, K) of the tip's place by its K parameters, at the drawn arm.
        variance_by_gradient: (G, T) what each source adds to the variance of the tip's place by these slopes [m²].
        variance_by_samples: (G, T) the same by slopes that fit the samples best; NaN of samples fewer than twice the
            parameters.
        explained: (T,) the share of the samples' variance that the fitted slopes explain: 1 where the tip moves in
            proportion with what is scattered.
        scatter: what was scattered, and how far.
        tolerance: what counts as within, in metres.
        compensated: whether pressures were found anew for each arm.
        arm: the drawn one.
        wanted: how many built arms were asked for.
        stopped: "finished", or "interrupted": then S is less than that.

    Example:
        >>> found = ta.tolerance(ta.antagonistic_arm(), ta.Task(ta.constant_curvature(0.5)), length=2e-3, samples=64)
        >>> (1e3 * found.percentiles([50, 95])).round().flatten().tolist()  # half, and 95 % of tips are within [mm]
        [2.0, 4.0]
    """

    tip_error: Tensor
    failed: Tensor
    verdict_code: Tensor
    tip: Tensor
    margin: Tensor | None
    nominal_tip_error: Tensor
    sources: tuple[str, ...]
    slopes: tuple[Tensor, ...]
    variance_by_gradient: Tensor
    variance_by_samples: Tensor
    explained: Tensor
    scatter: Scatter
    tolerance: PoseTolerance
    compensated: bool
    arm: Arm
    wanted: int
    stopped: str = "finished"

    @property
    def verdict(self) -> NDArray[Any]:
        """(S, T) the verdicts in words."""
        return np.array(VERDICTS)[self.verdict_code.numpy(force=True)]

    @property
    def within(self) -> Tensor:
        """(S, T) which built arms fail no criterion: what yields count."""
        return ~self.failed.any(-1)

    @property
    def failing(self) -> str:
        """Of the pairs of a built arm and a task how many fail each criterion, most often first; empty if none does.

        One pair may fail several.
        """
        counts = dict(zip(CRITERIA, self.failed.sum((0, 1)).tolist(), strict=True))
        words = [f"{name} {counts[name]}" for name in sorted(CRITERIA, key=lambda one: -counts[one]) if counts[name]]
        return ", ".join([f"{words[0]} of {self.tip_error.numel()}", *words[1:]]) if words else ""

    @property
    def interruption(self) -> str:
        """That it was stopped before its end, and after how many built arms; empty if it was not."""
        if self.stopped == "finished":
            return ""
        return f"interrupted: {len(self.tip_error)} of {self.wanted} built arms"

    @property
    def names(self) -> tuple[str, ...]:
        """What is scattered, each once: a model's name stands for all fitted models."""
        return tuple(dict.fromkeys(self.sources))

    @property
    def yields(self) -> tuple[Yield, ...]:
        """For each task the share of built arms that are within tolerance."""
        return tuple(Yield.of(own) for own in self.within.unbind(-1))

    @property
    def yield_of_all(self) -> Yield:
        """The share of built arms that are within tolerance on every task."""
        return Yield.of(self.within.all(-1))

    @property
    def extrapolated(self) -> float:
        """The share of arms and tasks whose strains or limits are beyond what was characterised: models guess there."""
        return float((self.verdict_code == EXCLUDED).double().mean())

    def percentiles(self, percents: Sequence[float] = PERCENTILES) -> Tensor:
        """(P, T) tip errors [m] that so many percent of built arms stay within; infinite where so many hold no shape.

        Raises:
            ValueError: a percentage is not from 0 to 100.
        """
        shares = [check_number("percents", percent, 0.0) / 100 for percent in percents]
        if max(shares, default=0.0) > 1:
            raise ValueError(f"percents: must be at most 100, got {100 * max(shares):g}")
        error = self.tip_error.sort(0).values
        return error[[_place(share, len(error)) for share in shares]]

    def pooled_percentile(self, percent: float) -> Tensor:
        """The tip error [m] that so many percent of built arms on all tasks together stay within."""
        error = self.tip_error.flatten().sort().values
        return error[_place(percent / 100, len(error))]

    @property
    def deviation_by_samples(self) -> Tensor:
        """(T,) root mean square distance of the built arms' tips from their mean [m]; of those that have one."""
        away = torch.where(self._known, self.tip - self._mean, 0.0)
        return (away.square().sum((0, 2)) / self._known.sum((0, 2))).sqrt()

    @property
    def deviation_by_gradient(self) -> Tensor:
        """(T,) the same to first order, by gradients at the drawn arm [m]."""
        return self.variance_by_gradient.sum(0).sqrt()

    @property
    def _known(self) -> Tensor:
        """(S, T, 1) which built arms have a tip."""
        return self.tip.isfinite().all(-1, keepdim=True)

    @property
    def _mean(self) -> Tensor:
        """(T, D) of the tips that there are [m]."""
        return torch.where(self._known, self.tip, 0.0).sum(0) / self._known.sum(0)

    @property
    def shares(self) -> dict[str, float]:
        """Of each source the share in the variance of the tip's place, mean over the tasks, by gradients."""
        return self._shares(self._variance_of_stable)

    @property
    def _variance_of_stable(self) -> Tensor:
        """(G, T) what sources add to the variance by gradients; NaN where the drawn arm or all built ones have no
        stable shape, whose slopes would tell of a tip that never is there."""
        stable = self.nominal_tip_error.isfinite() & self.tip_error.isfinite().any(0)
        return self.variance_by_gradient.where(stable, torch.nan)

    @property
    def shares_by_samples(self) -> dict[str, float]:
        """The same by slopes that fit the samples."""
        return self._shares(self.variance_by_samples)

    def _shares(self, variance: Tensor) -> dict[str, float]:
        each = variance / variance.sum(0)  # a task near a snap, whose tip moves by far more, counts as much as others
        shares = each.nanmean(-1).tolist()
        return {
            name: sum(share for other, share in zip(self.sources, shares, strict=True) if other == name)
            for name in self.names
        }

    @property
    def decisive(self) -> str:
        """The source with the largest share; empty where no task has a stable shape."""
        known = {name: share for name, share in self.shares.items() if math.isfinite(share)}
        return max(known, key=lambda name: known[name], default="")

    def sensitivity(self, name: str) -> Tensor:
        """(T, K) how far the tip moves with each parameter of a source, to first order: m per m, kPa, N or 1.

        Of radii in space the K parameters are all y, then all z; else they are the actuators'.

        Raises:
            ValueError: nothing of that name is scattered, or it is a model, whose coefficients have units of their own.
        """
        if self.sources.count(name) != 1:
            raise ValueError(f"name: must be one of {', '.join(self.sources)} that stands once, got {name!r:.60}")
        return torch.linalg.vector_norm(self.slopes[self.sources.index(name)], dim=-2)

    @property
    def agreement(self) -> str:
        """How far gradients and samples agree, in words."""
        known = self.deviation_by_gradient.isfinite() & self.deviation_by_samples.isfinite()
        if not bool(known.any()):
            return "no task has a stable shape, so that nothing can be compared"
        first, second = (
            1e3 * float(value[known].median()) for value in (self.deviation_by_gradient, self.deviation_by_samples)
        )
        explained = float(self.explained[known].nanmedian())
        words = (
            f"tips scatter by {second:.3g} mm (rms) by samples, by {first:.3g} mm to first order by gradients"
            f"{', medians over the tasks' if len(known) > 1 else ''}"
        )
        if not np.isfinite(explained):
            return f"{words}; too few samples to tell how much of it is linear"
        words += f"; {100 * explained:.0f} % of the samples' variance is linear"
        if explained < LINEAR or abs(first - second) > (1 - LINEAR) * second:
            words += ": gradients at the drawn arm tell only part of it"
        return words

    def to_dict(self) -> dict[str, list[Any]]:
        """Columns with an entry for each task, counted from 0: yields and percentiles of tip errors [m]."""
        columns: dict[str, list[Any]] = {"task": list(range(self.tip_error.shape[-1]))}
        columns["nominal_tip_error"] = self.nominal_tip_error.tolist()
        for percent, row in zip(PERCENTILES, self.percentiles(), strict=True):
            columns[f"tip_error_p{percent:g}"] = row.tolist()
        yields = self.yields
        columns |= {"yield": [one.value for one in yields], "yield_low": [one.low for one in yields]}
        columns |= {"yield_high": [one.high for one in yields], "explained": self.explained.tolist()}
        for name in self.names:
            variance = self._variance_of_stable
            rows = [row for other, row in zip(self.sources, variance, strict=True) if other == name]
            columns[f"share_{name}"] = (torch.stack(rows).sum(0) / variance.sum(0)).tolist()
        for name, rate in zip(CRITERIA, self.failed.double().mean(0).unbind(-1), strict=True):
            columns[f"failed_{name.replace(' ', '_')}"] = rate.tolist()
        if self.margin is not None:
            columns["capacity_margin_p5"] = self.margin.quantile(0.05, dim=0).tolist()
        return columns

    def __repr__(self) -> str:
        """Counts and the yield, no tensors."""
        samples, tasks = self.tip_error.shape
        parts = [f"{samples} arms on {tasks} tasks", f"yield {self.yield_of_all}"]
        parts += [f"not within tolerance: {self.failing}"] if self.failing else []
        parts += [f"{self.decisive} decides"] if self.decisive else []
        return f"BuiltArms({', '.join([*parts, *filter(None, [self.interruption])])})"


def _place(share: float, count: int) -> int:
    """The place among so many ordered values below which a share of them lies, itself included."""
    return min(count - 1, max(0, math.ceil(share * count - 1e-9) - 1))
