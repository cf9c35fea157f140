"""Checkpoints: taken up by the same problem and by no other, and never half-written."""

import functools
import os
import subprocess
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

import torcharm as ta
from torcharm.optimise import DesignSpace, Objective, Report, optimise_architectures, optimise_design

TASK = ta.Task(ta.affine_curvature(-2.0, 3.0, 0.5, 5), (8.0, -20.0, 2.0))


class Spring(torch.nn.Module):
    """A linear force model whose settings are of every kind: attribute, parameter, buffer, part, function."""

    bending_stiffness, max_pressure, strain_range, pressure_range = -0.05, 60.0, (-0.5, 0.5), (0.0, 60.0)

    def __init__(self, k: float = 40.0, gain: float = 0.8, offset: float = 0.0, part: float = 0.0) -> None:
        super().__init__()
        self.k = k
        self.gain = torch.nn.Parameter(torch.tensor(gain, dtype=torch.float64))
        self.register_buffer("offset", torch.tensor(offset, dtype=torch.float64))
        self.part = torch.nn.Linear(1, 1, dtype=torch.float64)
        torch.nn.init.constant_(self.part.weight, part)
        torch.nn.init.zeros_(self.part.bias)

    def force(self, strain: Tensor, pressure: Tensor) -> Tensor:
        bent = self.part(strain.unsqueeze(-1)).squeeze(-1)
        return self.gain.detach() * pressure - self.k * strain + self.offset + bent.detach()


@dataclass(frozen=True, eq=False)
class Table:
    """A force model with a tensor in a field."""

    slope: Tensor
    law: Callable[[Tensor], Tensor] = torch.sin
    bending_stiffness: float = -0.05
    max_pressure: float = 60.0
    strain_range: tuple[float, float] = (-0.5, 0.5)
    pressure_range: tuple[float, float] = (0.0, 60.0)

    @functools.cached_property
    def doubled(self) -> Tensor:
        """What a fingerprint must not see: it is there only after the first evaluation."""
        return 2 * self.slope

    def force(self, strain: Tensor, pressure: Tensor) -> Tensor:
        return pressure - 0.5 * self.doubled * self.law(strain)


def made_with(k: float) -> Any:
    """A model of a class that closes over its setting."""

    class Closed(Spring):
        def force(self, strain: Tensor, pressure: Tensor) -> Tensor:
            return pressure - k * strain

    return Closed()


def _lambda(k: float) -> Table:
    return Table(torch.tensor(40.0).double(), law=lambda strain: k * strain)


def _arm(model: Any, radius: float = 0.03) -> ta.ArmDesign:
    return ta.ArmDesign([-radius, 0.03], 0.45, [model, Spring()])


def _run(arm: ta.ArmDesign, file: Path | None, task: ta.Task = TASK, **options: Any) -> ta.OptimisedDesign:
    settings: dict[str, Any] = {"starts": 1, "iterations": 2} | options
    return optimise_design(arm, task, checkpoint=file, **settings)


FIFTY = torch.tensor(50.0).double()
MODELS: list[tuple[Callable[[], Any], Callable[[], Any]]] = [
    (Spring, lambda: Spring(k=400.0)),
    (Spring, lambda: Spring(k=40.0 * (1 + 1e-13))),
    (Spring, lambda: Spring(gain=0.7)),
    (Spring, lambda: Spring(offset=1.0)),
    (Spring, lambda: Spring(part=-1.0)),
    (lambda: Table(0.8 * FIFTY), lambda: Table(FIFTY)),
    (lambda: Table(FIFTY), lambda: Table(FIFTY, torch.sinh)),
    (lambda: _lambda(1.0), lambda: _lambda(1.1)),
    (lambda: made_with(40.0), lambda: made_with(41.0)),
    (ta.Bellows, lambda: ta.Bellows(force_scale=1.01)),
]


@pytest.mark.parametrize(("model", "other"), MODELS)
def test_another_model_is_refused_and_the_same_one_taken_up(
    tmp_path: Path, model: Callable[[], Any], other: Callable[[], Any]
) -> None:
    file = tmp_path / "run.npz"
    first = _run(_arm(model()), file)
    with pytest.raises(ValueError, match=r"another problem, whose force model 1 differs"):
        _run(_arm(other()), file)
    again = _run(_arm(model()), file)
    assert again.value == first.value
    assert torch.equal(again.history.seconds, first.history.seconds), "gone on from, not done again"


def test_a_class_whose_code_was_edited_is_another_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "run.npz"
    _run(_arm(Spring()), file)
    monkeypatch.setattr(Spring, "force", lambda self, strain, pressure: pressure - 41.0 * strain)
    with pytest.raises(ValueError, match="force model 1, force model 2 differ"):
        _run(_arm(Spring()), file)


def test_every_other_part_is_told_apart_and_named(tmp_path: Path) -> None:
    file = tmp_path / "run.npz"
    space, objective = DesignSpace(spacing=0.001), Objective(relative_weight=0.1)
    _run(_arm(Spring()), file, space=space, objective=objective)
    changes: list[tuple[str, ta.ArmDesign, ta.Task, dict[str, Any]]] = [
        ("arm", _arm(Spring(), radius=0.031), TASK, {}),
        ("task", _arm(Spring()), ta.Task(TASK.twists, (8.0, -20.0, 2.1)), {}),
        ("space", _arm(Spring()), TASK, {"space": replace(space, bounds={"length": (0.3, 0.6)})}),
        ("objective", _arm(Spring()), TASK, {"objective": replace(objective, relative_weight=0.2)}),
        ("iterations (2 there, 3 here)", _arm(Spring()), TASK, {"iterations": 3}),
        ("method ('bfgs' there, 'adam' here)", _arm(Spring()), TASK, {"method": "adam"}),
    ]
    for words, arm, task, options in changes:
        with pytest.raises(ValueError, match="another problem") as refused:
            _run(arm, file, task, **({"space": space, "objective": objective} | options))
        assert f"whose {words} differs;" in str(refused.value)
    assert _run(_arm(Spring()), file, space=space, objective=objective).stopped == "finished"


def test_architectures_have_checkpoints_of_their_own(tmp_path: Path) -> None:
    file = tmp_path / "run.npz"
    arm = _arm(Spring())
    found = optimise_architectures(arm, TASK, models=[Spring()], starts=1, iterations=2, checkpoint=file)
    again = optimise_architectures(arm, TASK, models=[Spring()], starts=1, iterations=2, checkpoint=file)
    assert torch.equal(again.designs[0].history.seconds, found.designs[0].history.seconds)
    with pytest.raises(ValueError, match="force model 1 differs"):
        optimise_architectures(arm, TASK, models=[Spring(k=41.0)], starts=1, iterations=2, checkpoint=file)
    with pytest.raises(ValueError, match="search"):
        _run(arm, file)


SCRIPT = """
import sys, torch, torcharm as ta
sys.path.insert(0, {folder!r})
import test_checkpoint as t
for name, model in (("module", t.Spring()), ("lambda", t._lambda(1.0)), ("class", t.made_with(40.0))):
    found = t._run(t._arm(model), {file!r} + name)
    print(found.value, found.history.seconds.tolist())
"""


def test_a_fresh_process_takes_up_the_same_problem(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(folder=str(Path(__file__).parent), file=str(tmp_path / "run")), "utf-8")
    answers = [
        subprocess.run(
            [sys.executable, str(script)],
            capture_output=True,
            text=True,
            timeout=300,
            env=os.environ | {"PYTHONHASHSEED": seed},
        )
        for seed in ("1", "2")
    ]
    assert answers[0].returncode == 0, answers[0].stderr
    assert answers[0].stdout.count("\n") == 3
    assert answers[1].stdout == answers[0].stdout, "the very seconds are read from the file"


def test_what_cannot_be_told_apart_is_refused_before_the_work(tmp_path: Path) -> None:
    model = Spring()
    model.numbers = (number for number in range(3))  # type: ignore[assignment]
    with pytest.raises(ValueError, match="force model 1 holds <generator"):
        _run(_arm(model), tmp_path / "run.npz")
    assert _run(_arm(model), None).stopped == "finished"


# ---- written whole, or not at all ------------------------------------------------------------


def test_an_unwritable_checkpoint_is_found_before_the_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def work(*arguments: Any) -> None:
        raise AssertionError("the work has begun")

    monkeypatch.setattr("torcharm.optimise.design.feasible_designs", work)
    monkeypatch.setattr("torcharm.optimise.architectures.feasible_designs", work)
    (tmp_path / "file").write_text("")
    os.mkfifo(tmp_path / "pipe")
    for path, words in (
        (tmp_path / "none" / "run.npz", "does not exist"),
        (tmp_path, "is a directory"),
        (tmp_path / "pipe", "a regular file"),
        (tmp_path / "file" / "run.npz", "ot a directory"),
    ):
        with pytest.raises(ValueError, match=f"checkpoint: .*{words}"):
            _run(_arm(Spring()), path)
        with pytest.raises(ValueError, match=f"checkpoint: .*{words}"):
            optimise_architectures(_arm(Spring()), TASK, checkpoint=path)


def test_a_failing_save_costs_no_result_and_no_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "run.npz"
    whole = _run(_arm(Spring()), None, iterations=4)

    def stop(report: Report) -> bool:
        return report.iteration == 1

    _run(_arm(Spring()), file, iterations=4, callback=stop)
    old = file.read_bytes()

    def full(opened: Any, **arrays: Any) -> None:
        opened.write(b"half")
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as broken, warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        broken.setattr("torcharm.optimise.archive.np.savez", full)
        broken.setattr("torcharm.optimise.running.SAVE_EVERY", -1.0)
        found = _run(_arm(Spring()), file, iterations=4)
    assert found.value == whole.value
    lines = [str(one.message) for one in told if "checkpoint" in str(one.message)]
    assert len(lines) == 1, "one line, however often it failed"
    assert "No space left" in lines[0]
    assert file.read_bytes() == old
    assert [path.name for path in tmp_path.iterdir()] == ["run.npz"], "nothing half-written is left"
    assert _run(_arm(Spring()), file, iterations=4).value == whole.value, "and the old file is still of use"


def test_a_folder_that_vanishes_costs_no_result(tmp_path: Path) -> None:
    folder = tmp_path / "gone"
    folder.mkdir()

    def remove(report: Report) -> None:
        if folder.exists():
            folder.rmdir()

    with pytest.warns(RuntimeWarning, match="could not be written"):
        found = _run(_arm(Spring()), folder / "run.npz", callback=remove)
    assert found.stopped == "finished"


def test_a_damaged_checkpoint_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "run.npz"
    _run(_arm(Spring()), file)
    whole = file.read_bytes()
    for size in (0, len(whole) // 3, len(whole) - 8):
        file.write_bytes(whole[:size])
        with pytest.raises(ValueError, match="no optimisation that torcharm saved"):
            _run(_arm(Spring()), file)
