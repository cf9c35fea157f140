"""What a sweep measures of each design: errors over all tasks as one number each, verdicts counted, and the size."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torcharm.attainability import CHOICES, VERDICTS, Attainability, check_power, evaluate, scale_of
from torcharm.design.objective import flat_tasks, shape_lengths
from torcharm.design.space import Arm, given_values
from torcharm.inputs import check_choice, shown
from torcharm.pressure.pose_cost import PoseCost
from torcharm.task import Task

Reduce = str | float
Rows = dict[str, npt.NDArray[Any]]
"""Arrays (n,) by the names of their columns."""

COLUMNS = {
    "tip_error": ("tip_error_mm", 1e3),
    "shape_error": ("shape_error_mm", 1e3),
    "absolute": ("absolute_N", 1.0),
    "relative": ("relative_N", 1.0),
}
"""Of what is reduced over the tasks: the column, and its unit's factor."""
SIZE = "size_mm"
COUNTS = tuple(word.replace(" ", "_") for word in VERDICTS)
"""Columns that say on how many tasks a design has each verdict."""
NOT_EXCLUDED = "not_excluded"
"""Column that says how many tasks sets do not exclude, where no error was predicted."""


@dataclass(frozen=True)
class Measures:
    """What is measured of each design, and how it is reduced over the tasks.

    Attributes:
        metrics: of `torcharm.evaluate`.
        reduce: "mean", "worst" or a quantile of the tasks, or one for some of tip_error, shape_error, absolute and
            relative, and "mean" for others. A quantile q is the least number that the share q of all stays within.
        options: tolerance, weights, power and pose_cost, as in `torcharm.evaluate`.

    Raises:
        ValueError: a way to reduce, or an option, is none of those allowed.
    """

    metrics: tuple[str, ...]
    reduce: Any
    options: Mapping[str, Any]

    def __post_init__(self) -> None:
        whole = self.reduce
        given = dict(whole) if isinstance(whole, Mapping) else dict.fromkeys(COLUMNS, whole)
        for name, how in given.items():
            check_choice("reduce", name, tuple(COLUMNS))
            if how not in ("mean", "worst") and not (isinstance(how, float) and 0 < how < 1):
                raise ValueError(
                    f"reduce: must be 'mean', 'worst' or a quantile between 0 and 1, or one of these for some of "
                    f"{', '.join(COLUMNS)}, got {shown(how)}"
                )
        weights, cost = self.options["weights"], self.options["pose_cost"]
        scale_of(weights)
        check_power(self.options["power"])
        if cost is not None and not isinstance(cost, PoseCost):
            raise ValueError(f"pose_cost: must be a PoseCost, got {shown(cost)}")
        object.__setattr__(self, "options", {**self.options, "weights": tuple(map(float, weights))})
        object.__setattr__(self, "metrics", tuple(name for name in CHOICES if name in self.metrics))
        object.__setattr__(self, "reduce", dict.fromkeys(COLUMNS, "mean") | given)

    @property
    def reduced(self) -> tuple[str, ...]:
        """Which of `COLUMNS` there are."""
        predicted = "predicted_error" in self.metrics
        return tuple(name for name in COLUMNS if (predicted if name.endswith("error") else name in self.metrics))

    @property
    def numbers(self) -> tuple[str, ...]:
        """Columns of single precision."""
        return (*(COLUMNS[name][0] for name in self.reduced), SIZE)

    @property
    def counts(self) -> tuple[str, ...]:
        """Columns of whole numbers."""
        return COUNTS if "predicted_error" in self.metrics else (NOT_EXCLUDED,)

    def __call__(self, arm: Arm, tasks: Sequence[Task]) -> Rows:
        """All columns (n,) of designs of batch shape (n,) on all tasks, in single precision and whole numbers."""
        values: dict[str, list[Tensor]] = {name: [] for name in self.reduced}
        counts: dict[str, Any] = dict.fromkeys(self.counts, 0)
        with torch.no_grad():
            for task in tasks:
                result = evaluate(arm, task, self.metrics, **self.options)
                for name, so_far in values.items():
                    so_far.append(flat_tasks(_known(result, name, task), 1))
                for name, number in _counted(result).items():
                    counts[name] = counts[name] + number
        found: Rows = {}
        for name, parts in values.items():
            column, factor = COLUMNS[name]
            over_tasks = _reduced(torch.cat(parts, -1).double().numpy(force=True), self.reduce[name])
            found[column] = (factor * over_tasks).astype(np.float32)
        return found | {name: np.asarray(number, dtype=np.int32) for name, number in counts.items()}


def sizes(arm: Arm) -> npt.NDArray[np.float32]:
    """The largest offset (n,) of each design from the backbone [mm]."""
    return np.asarray(1e3 * np.abs(given_values(arm)[:, 0]).max(-1), dtype=np.float32)


def _known(result: Attainability, name: str, task: Task) -> Tensor:
    """A metric of each design and task, with what stands for it where it is not known.

    An error counts as the length of the task's shape where no stable equilibrium is predicted, as in `Objective`;
    unattainability is infinite where an actuator has no length or a distance is not known.
    """
    value = getattr(result, name)
    if name.endswith("error"):
        assert result.prediction is not None
        length = shape_lengths(task).to(value).reshape(task.batch_shape)
        return torch.where(result.prediction.stable & value.isfinite(), value, length)
    return torch.where(result.distances_converged | result.impossible, value, torch.inf)


def _counted(result: Attainability) -> Rows:
    """Of each design, how many tasks have each verdict, or are not excluded."""
    if result.prediction is None:
        assert result.not_excluded is not None
        return {NOT_EXCLUDED: flat_tasks(result.not_excluded, 1).sum(-1).numpy(force=True)}
    words = np.asarray(result.verdict).reshape(len(result.strain_excess), -1)
    return {name: (words == word).sum(-1) for name, word in zip(COUNTS, VERDICTS, strict=True)}


def _reduced(values: npt.NDArray[np.float64], how: Reduce) -> npt.NDArray[np.float64]:
    """Values (n, T) over the tasks."""
    if how == "mean":
        return np.asarray(values.mean(-1))
    if how == "worst":
        return np.asarray(values.max(-1))
    rank = int(np.ceil(float(how) * values.shape[-1])) - 1
    return np.asarray(np.sort(values, -1)[:, max(rank, 0)])
