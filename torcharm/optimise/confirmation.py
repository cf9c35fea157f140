"""Whether what an objective says of a design is what the arm does: told in words, and kept from doing harm.

A predicted error is that of an equilibrium near the task's shape. Under compression there are several, and loading the
arm may lead to another one; so predictions that a design was chosen by are compared with a pressure search.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.attainability import Attainability
from torcharm.optimise.objective import Objective
from torcharm.task import Task

AGREEMENT = (0.2, 0.01)
"""Share of the searched error, and length [m], within which a predicted error is confirmed."""
INTERRUPTED = "not confirmed: interrupted before the pressure search"


NOISE = 1e-6
"""Share of a searched value that one must be below another to be better: searches end at their tolerance."""


@dataclass(frozen=True)
class Comparison:
    """What is to be said of the best design, and whether the given one is better by the search."""

    status: str
    given_is_better: bool


@dataclass(frozen=True, eq=False)
class Searched:
    """What a pressure search reached with D designs on T tasks.

    Attributes:
        error: (D, T) [m]; infinite where the search came to no stable equilibrium.
        converged: (D, T) of the search.
    """

    error: Tensor
    converged: Tensor

    def total(self, objective: Objective, designs: ArmDesign) -> list[float]:
        """The objective of each design, by the errors searched."""
        value = objective.total(self.error) + objective.size(designs)
        return torch.where(value.isfinite(), value, torch.inf).tolist()


def search_designs(designs: ArmDesign, tasks: Sequence[Task]) -> Searched:
    """Search the best pressures of designs of batch shape (D,) on all tasks."""
    from torcharm.pressure.search import search_pressure

    with torch.no_grad():
        found = [search_pressure(designs, task) for task in tasks]
    rows = len(designs.radii)
    error, converged, stable = (
        torch.cat([getattr(one, name).reshape(rows, -1) for one in found], -1)
        for name in ("shape_error", "converged", "stable")
    )
    return Searched(torch.where(stable & error.isfinite(), error, torch.inf), converged)


def prediction_status(results: Sequence[Attainability], searched: Searched, index: int) -> str:
    """How far the predicted errors of one design can be trusted.

    Args:
        results: of `evaluate`, for each batch of tasks.
        searched: of the same tasks.
        index: of the design among those searched.
    """
    predictions = [result.prediction for result in results]
    assert all(prediction is not None for prediction in predictions)
    stable, converged, predicted, reached = (
        torch.cat([getattr(prediction, name).detach().reshape(-1) for prediction in predictions])
        for name in ("stable", "converged", "shape_error", "reached")
    )
    error, sure = searched.error[index], searched.converged[index]
    count = len(predicted)
    lost = ~stable | ~predicted.isfinite()
    if bool(lost.any()):
        return f"no candidate: no stable equilibrium was predicted {_on(lost, count)}"
    if not bool(converged.all()):
        return f"no candidate: the prediction did not converge {_on(~converged, count)}"
    share, length = AGREEMENT
    apart = (predicted - error).abs() > share * error + length
    if bool(apart.any()):
        worst = int((predicted - error).abs().argmax())
        unsure = "" if bool(sure[apart].all()) else ", which did not converge everywhere,"
        elsewhere = "" if bool(reached[worst]) else ", to which loading does not lead"
        return (
            f"not confirmed: the pressure search{unsure} reaches {float(error[worst]):.3g} m where "
            f"{float(predicted[worst]):.3g} m is predicted{elsewhere}; they are apart {_on(apart, count)}"
        )
    if not bool(sure.all()):
        return f"confirmed by a pressure search that did not converge {_on(~sure, count)}"
    return "confirmed by a pressure search"


def distance_status(converged: Tensor, impossible: Tensor) -> str:
    """The same of distances, by whether they converged (T,) and whether an actuator has no length (T,)."""
    if bool(impossible.any()):
        return f"no candidate: an actuator has no length {_on(impossible, len(impossible))}"
    if bool(converged.all()):
        return "converged"
    return f"not converged: distances {_on(~converged, len(converged))}"


def _on(marked: Tensor, count: int) -> str:
    return f"on {int(marked.sum())} of {count} tasks" if count > 1 else "on the task"


def compared_with_given(objective: Objective, tasks: Sequence[Task], given: ArmDesign, best: ArmDesign) -> Comparison:
    """What a pressure search says of the given design, and of the one chosen by its predicted errors."""
    with torch.no_grad():
        pair = given.with_values(
            *(torch.stack((getattr(given, name), getattr(best, name))) for name in ("radii", "length", "max_pressure"))
        )
        results = objective.results(best, tasks)
        try:
            searched = search_designs(pair, tasks)
        except KeyboardInterrupt:
            return Comparison(INTERRUPTED, False)
    status = prediction_status(results, searched, 1)
    before, after = searched.total(objective, pair)
    if before < after * (1 - NOISE):
        kept = f"given design kept: the pressure search reaches {before:.3g} with it, and {after:.3g} with another"
        return Comparison(f"{kept}, of which it is to say: {status}", True)
    return Comparison(status, False)
