"""What an optimisation found, as data that can be saved and loaded."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any

import torch
from torch import Tensor

from torcharm.actuators import Actuator
from torcharm.arm import ArmDesign
from torcharm.optimise.archive import (
    design_arrays,
    design_from,
    model_header,
    models_from,
    plain,
    read_archive,
    write_archive,
)
from torcharm.optimise.objective import Objective
from torcharm.optimise.space import DesignSpace

NUMBERS = ("value", "given_value", "seconds", "stationarity", "violation")
WORDS = ("evaluations", "method", "stopped", "in_range", "status")
ARRAYS = ("start_values", "end_values", "projected_gradients")


@dataclass(frozen=True, eq=False)
class History:
    """How the values fell: a row for the start and for each of I iterations (of scipy's methods: each gain).

    Attributes:
        evaluations: (I+1,) designs evaluated so far.
        seconds: (I+1,) so far, from the call, all preparations included.
        values: (I+1, S) the best value of each start so far, infinite until it has its turn.
    """

    evaluations: Tensor
    seconds: Tensor
    values: Tensor

    @property
    def best(self) -> Tensor:
        """(I+1,) the best value of all starts so far."""
        return self.values.amin(-1)


@dataclass(frozen=True, eq=False)
class OptimisedDesign:
    """The outcome of `optimise_design`.

    Attributes:
        given: the design to improve on (of a batch, the one of the best value).
        best: the best design found, feasible.
        value, given_value: the objective of the two. The given design need not be feasible.
        status: how far `value` can be trusted, in words. Of distances "converged", or on how many tasks they did not,
            or an actuator has no length.
            Of predicted errors, which are compared with a `search_pressure` of the given and the best design:
            "confirmed by a pressure search" (within 20 % + 1 cm on every task), the same "that did not converge ...",
            "not confirmed: ..." with both errors, or "no candidate: ..." where the prediction itself is not converged
            and stable; the value is then infinite. If the given design satisfies the constraints and the search does
            better with it, it is kept as the best, and the status begins with "given design kept".
        before, after: for each metric of `torcharm.evaluate` ("absolute", "relative", unsigned, and any other
            the objective uses) the values (T,) of all tasks, with the given and with the best design, and
            whether they "converged".
        in_range: whether all strains and limits of the best design lie in the characterised range.
        violation: by how much the best design breaks a constraint, as a fraction of the bounds; about 1e-10.
        starts: S designs from which the search began, the first of them the feasible ones nearest to the given.
        start_values: (S,) their objective.
        ends: S designs at which it ended.
        end_values: (S,) their objective.
        reasons: S words: "optimal" (the model promises no gain worth having), "stalled" (no gain for some iterations,
            as at a kink), "iterations" (the limit), "failed" (the start is no candidate: no value is a number), "going"
            (stopped before).
        projected_gradients: (S,) `‖P(u - ∇) - u‖∞` at the ends, of the free values scaled to their bounds. Not small
            at kinks of the objective; NaN where the value is no number.
        stationarity: the least norm of a convex mix of gradients around the best design and of the normals of its
            constraints, as a fraction of the mean gradient's: 0 at a minimum, kinks included. NaN where the value is no
            number.
        history: how the values fell.
        method, evaluations, seconds: with what, how many designs on all tasks, and how long.
        stopped: "finished", "interrupted", "callback" or "time".
        space, objective: what was asked for.
    """

    given: ArmDesign
    best: ArmDesign
    value: float
    given_value: float
    before: Mapping[str, Tensor]
    after: Mapping[str, Tensor]
    in_range: bool
    violation: float
    starts: ArmDesign
    start_values: Tensor
    ends: ArmDesign
    end_values: Tensor
    reasons: tuple[str, ...]
    projected_gradients: Tensor
    stationarity: float
    history: History
    method: str
    evaluations: int
    seconds: float
    stopped: str
    space: DesignSpace
    objective: Objective
    status: str

    def save(self, path: str | PathLike[str]) -> None:
        """Write everything to one .npz file, without pickle: whole, or not at all, when the old file stays.

        Raises:
            ValueError: there can be no such file, as in a folder that does not exist.
            OSError: writing failed.
        """
        header: dict[str, Any] = {"kind": "optimised design", "reasons": list(self.reasons)}
        header |= {name: getattr(self, name) for name in (*NUMBERS, *WORDS)}
        header |= {"actuators": model_header(self.best.actuators)}
        header |= {"space": plain(self.space), "objective": plain(self.objective)}
        arrays: dict[str, Tensor] = {name: getattr(self, name) for name in ARRAYS}
        arrays |= {f"history.{name}": value for name, value in vars(self.history).items()}
        for name in ("given", "best", "starts", "ends"):
            arrays |= design_arrays(name, getattr(self, name))
        for name in ("before", "after"):
            arrays |= {f"{name}.{metric}": value for metric, value in getattr(self, name).items()}
        write_archive(path, header, arrays)


def load_optimised(path: str | PathLike[str], actuators: Sequence[Actuator] | None = None) -> OptimisedDesign:
    """Read what `OptimisedDesign.save` wrote.

    Args:
        path: the file.
        actuators: the force models, if they are not torcharm's own.

    Raises:
        ValueError: the file holds no optimised design, or force models that must be given.
    """
    header, arrays = read_archive(path)
    if header.get("kind") != "optimised design":
        raise ValueError(f"{path}: holds no optimised design but a {header.get('kind')}")
    models = models_from(header["actuators"], actuators, path)
    metrics = {
        prefix: {
            name.split(".", 1)[1]: torch.from_numpy(value)
            for name, value in arrays.items()
            if name.startswith(f"{prefix}.") and not name.endswith((".radii", ".length", ".max_pressure"))
        }
        for prefix in ("before", "after", "history")
    }
    space = {name: _hashable(value) for name, value in header["space"].items()}
    objective = {name: _hashable(value) for name, value in header["objective"].items()}
    parts: dict[str, Any] = {name: header[name] for name in (*NUMBERS, *WORDS) if name != "status"}
    parts["status"] = header.get("status", "")  # what was saved before there was one
    parts |= {name: torch.from_numpy(arrays[name]) for name in ARRAYS}
    parts |= {name: design_from(name, arrays, models) for name in ("given", "best", "starts", "ends")}
    return OptimisedDesign(
        **parts,
        before=metrics["before"],
        after=metrics["after"],
        reasons=tuple(header["reasons"]),
        history=History(**metrics["history"]),
        space=DesignSpace(**space),
        objective=Objective(**objective),
    )


def _hashable(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _hashable(entry) for name, entry in value.items()}
    return tuple(_hashable(entry) for entry in value) if isinstance(value, list) else value
