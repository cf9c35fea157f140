"""Finished starts of an optimisation, in a file, and of which problem they are."""

import hashlib
import json
import warnings
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torcharm.actuators import Actuator
from torcharm.actuators.bending import active_moment, passive_moment
from torcharm.arm_series import segments_of
from torcharm.design.space import Arm, given_values
from torcharm.files import atomic_write, check_writable, read_file
from torcharm.task import Task

KIND = "torcharm optimisation, 2"
"""Of the file; another number stands for another way to descend."""
POINTS = 9
"""Strains, and pressures, on whose grid the forces of a model are compared."""
WIDEST_STRAINS = (-0.9, 1.5)
"""Stand for the ends of a strain range that is infinite."""
CURVATURES = torch.linspace(-20.0, 20.0, 17, dtype=torch.float64)
"""Material curvatures [rad/m] at which moments are compared."""


def describe(
    arm: Arm,
    models: Sequence[Actuator],
    tasks: Sequence[Task],
    **options: Any,
) -> dict[str, str]:
    """What tells a problem from others: digests of arm, tasks and force models, and options as they print.

    Force models are told by their class and by what they do, forces on a grid and moments, whatever they hold.
    """
    segments, links = segments_of(arm)
    rest = [getattr(one, name) for one in segments for name in ("mass", "torsion_stiffness", "diameter")]
    rest += [value for one in segments if one.deviation is not None for value in one.deviation.tensors()]
    rest += [getattr(link, name, None) for link in links for name in ("length", "pose", "mass")]
    parts = {
        "arm": _digest([torch.from_numpy(given_values(arm)), *rest]),
        "task": _digest([value for task in tasks for value in _task_parts(task)]),
    }
    parts |= {f"force model {index + 1}": _digest(_behaviour(model)) for index, model in enumerate(models)}
    return parts | {name: repr(value) for name, value in options.items()}


def _task_parts(task: Task) -> list[Any]:
    load = [value for pair in sorted(task.load.tensors().items()) for value in pair]
    return [task.twists, task.base_pose, *load, repr(task.load), task.wrench_at, task.segment_nodes]


def _behaviour(model: Actuator) -> list[Any]:
    ends = zip(model.strain_range, WIDEST_STRAINS, strict=True)
    low, high = (float(end) if abs(float(end)) < float("inf") else other for end, other in ends)
    strain = torch.linspace(low, high, POINTS, dtype=torch.float64).unsqueeze(-1)
    pressure = torch.linspace(0.0, float(model.max_pressure), POINTS, dtype=torch.float64)
    stiffness = model.bending_stiffness
    with torch.no_grad():
        force = model.force(*torch.broadcast_tensors(strain, pressure))
        moments = [active_moment(stiffness, CURVATURES), passive_moment(stiffness, CURVATURES)]
    limits = [float(end) for end in (*model.strain_range, *model.pressure_range, model.max_pressure)]
    return [type(model).__qualname__, force, *moments, limits]


def _digest(parts: Sequence[Any]) -> str:
    made = hashlib.sha256()
    for part in parts:
        if isinstance(part, Tensor):
            array = part.detach().cpu().contiguous()
            made.update(f"{array.dtype} {tuple(array.shape)} ".encode() + array.numpy().tobytes())
        else:
            made.update(f"{part!r} ".encode())
    return made.hexdigest()[:16]


class Checkpoint:
    """A file of finished starts, by their names."""

    def __init__(self, path: str | PathLike[str], problem: Mapping[str, str]) -> None:
        """Read what is there, and check that the file can be written.

        Raises:
            ValueError: it cannot, or it is no checkpoint of this problem; the message says what differs.
        """
        check_writable(path, "checkpoint")
        self.path, self.problem, self._warned = Path(path), dict(problem), False
        self.finished: dict[str, dict[str, Any]] = self._read() if self.path.exists() else {}

    def _read(self) -> dict[str, dict[str, Any]]:
        try:
            content = json.loads(read_file(self.path))
            if content["kind"] != KIND:
                raise ValueError
            others, finished = content["problem"], content["finished"]
            names = list(dict.fromkeys((*self.problem, *others)))
        except (ValueError, KeyError, TypeError, AttributeError):
            raise ValueError(
                f"checkpoint: {self.path}: is none that this torcharm wrote; delete it or name another file"
            ) from None
        differing = [name for name in names if self.problem.get(name) != others.get(name)]
        if differing:
            verb = "differs" if len(differing) == 1 else "differ"
            raise ValueError(
                f"checkpoint: {self.path} belongs to another problem, whose {', '.join(differing)} {verb}; delete it "
                "or name another file"
            )
        return dict(finished)

    def add(self, name: str, values: dict[str, Any]) -> None:
        """Keep a finished start; where the file cannot be written, warn once: no result is lost by it."""
        self.finished[name] = values
        content = {"kind": KIND, "problem": self.problem, "finished": self.finished}
        try:
            with atomic_write(self.path) as partial:
                partial.write_text(json.dumps(content), encoding="utf-8")
        except OSError as error:
            if not self._warned:
                words = f"checkpoint: {self.path} could not be written: {error.strerror or error}"
                warnings.warn(words, RuntimeWarning, stacklevel=4)
            self._warned = True
