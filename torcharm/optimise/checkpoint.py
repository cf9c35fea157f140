"""Checkpoints: what has been done of a descent, in a file, and whether it is this problem's.

A checkpoint is gone on from if the arm, the tasks, the space, the objective, the force models and the options are the
same, in whatever process it was written; else it is refused, with what differs. See `fingerprint` for what is compared.
Models that hold what cannot be compared, such as generators and open files, are refused before the work begins.
"""

import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from torcharm._inputs import shown
from torcharm.actuators import Actuator
from torcharm.arm import ArmDesign
from torcharm.files import check_writable
from torcharm.optimise.archive import read_archive, write_archive
from torcharm.optimise.descent import State
from torcharm.optimise.fingerprint import behaves_alike, behaviour, digest, model_digest
from torcharm.optimise.objective import Objective
from torcharm.optimise.running import Log
from torcharm.optimise.space import DesignSpace
from torcharm.task import Task

SCHEME = 3
"""Of descent: checkpoints of another one are not gone on from."""


@dataclass(frozen=True, eq=False)
class Identity:
    """What tells a problem from others.

    Attributes:
        parts: digests of the arm, the tasks, the space and the objective.
        models: digests of the force models.
        options: of the search, by name.
        behaviour: (K, n) forces and moments of the models.
        dtype: in which the arm is computed.
    """

    parts: Mapping[str, str]
    models: Sequence[str]
    options: Mapping[str, Any]
    behaviour: npt.NDArray[np.float64]
    dtype: torch.dtype

    @classmethod
    def of(
        cls,
        arm: ArmDesign,
        models: Sequence[Actuator],
        tasks: Sequence[Task],
        space: DesignSpace,
        objective: Objective,
        options: Mapping[str, Any],
    ) -> "Identity":
        """The identity of a problem.

        Args:
            arm: the designs given.
            models: those of the arm, or those to choose from.
            tasks, space, objective: as of `optimise_design`.
            options: numbers and words.

        Raises:
            ValueError: a part cannot be told from others of its kind.
        """
        return cls(
            {
                "arm": digest([arm.radii, arm.length, arm.max_pressure], "the arm"),
                "task": digest([(task.twists, task.tip_load, task.base_pose) for task in tasks], "a task"),
                "space": digest(space, "the space"),
                "objective": digest(objective, "the objective"),
            },
            [model_digest(model, f"force model {index + 1}") for index, model in enumerate(models)],
            json.loads(json.dumps({**options, "scheme": SCHEME})),
            behaviour(models, arm.radii.dtype),
            arm.radii.dtype,
        )

    def differences(self, header: Mapping[str, Any], measured: npt.NDArray[np.float64]) -> list[str]:
        """What is another in a checkpoint, in words."""
        found = [name for name, own in self.parts.items() if header["parts"].get(name) != own]
        if len(header["models"]) != len(self.models):
            found.append(f"number of force models ({len(header['models'])} there, {len(self.models)} here)")
        else:
            pairs = zip(self.models, header["models"], self.behaviour, measured, strict=True)
            found += [
                f"force model {index + 1}"
                for index, (own, other, mine, theirs) in enumerate(pairs)
                if own != other or not behaves_alike(mine, theirs, self.dtype)
            ]
        return found + [
            f"{name} ({shown(header['options'].get(name))} there, {shown(own)} here)"
            for name, own in self.options.items()
            if header["options"].get(name) != own
        ]


class Checkpoint:
    """A file in which a descent is kept."""

    def __init__(self, path: str | PathLike[str], identity: Identity) -> None:
        """Check that the file can be written.

        Raises:
            ValueError: it cannot.
        """
        check_writable(path, "checkpoint")
        if Path(path).exists() and not Path(path).is_file():
            raise ValueError(f"checkpoint: {path}: must be a regular file")
        self.path, self.identity = path, identity
        self._warned = False

    def save(self, state: State, log: Log) -> None:
        """Write what has been done; where that fails, warn once and go on: no result is lost by it."""
        own = self.identity
        header = {"kind": "checkpoint", "parts": own.parts, "models": own.models, "options": own.options}
        arrays = {f"state.{entry.name}": getattr(state, entry.name) for entry in fields(state)}
        arrays |= {"evaluations": np.array(log.evaluations), "seconds": np.array(log.seconds)}
        arrays |= {"values": np.array(log.values), "behaviour": own.behaviour}
        try:
            write_archive(self.path, header, arrays)
        except (OSError, ValueError) as error:
            if not self._warned:
                why = (error.strerror if isinstance(error, OSError) else None) or error
                warnings.warn(f"checkpoint: {self.path} could not be written: {why}", RuntimeWarning, stacklevel=5)
            self._warned = True

    def resume(self) -> tuple[State | None, Log]:
        """What has been done of this problem, if the file is there.

        Raises:
            ValueError: the file is of another problem, or damaged.
        """
        if not Path(self.path).exists():
            return None, Log()
        try:
            header, arrays = read_archive(self.path)
        except ValueError as error:
            raise ValueError(f"checkpoint: {error}") from None
        if header.get("kind") != "checkpoint":
            raise ValueError(f"checkpoint: {self.path}: is no checkpoint but a {header.get('kind')}")
        if "parts" not in header:
            raise ValueError(f"checkpoint: {self.path}: is another version's, whose problem cannot be told; delete it")
        try:
            others = self.identity.differences(header, arrays["behaviour"])
            if not others:
                state = State(*(torch.from_numpy(arrays[f"state.{entry.name}"]) for entry in fields(State)))
                return state, Log(arrays["evaluations"].tolist(), arrays["seconds"].tolist(), list(arrays["values"]))
        except (KeyError, AttributeError, TypeError):
            raise ValueError(f"checkpoint: {self.path}: is damaged; delete it or name another file") from None
        raise ValueError(
            f"checkpoint: {self.path} belongs to another problem, whose {', '.join(others)} "
            f"{'differs' if len(others) == 1 else 'differ'}; delete it or name another file"
        )
