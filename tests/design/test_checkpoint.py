"""Finished starts: taken up by the same problem and by no other, and never half-written."""

import json
import os
import subprocess
import sys
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

import torcharm as ta
from torcharm.design import DesignSpace, Objective, Progress, optimise_architectures, optimise_design

TASK = ta.Task(ta.affine_curvature(-2.0, 3.0, 0.5, 5), (8.0, -20.0, 2.0))
SPACE = DesignSpace(in_range=False)
NEWTONS = Objective("unattainability")


class Spring(torch.nn.Module):
    """A linear force model whose settings are of several kinds: attribute, parameter, function."""

    bending_stiffness, max_pressure, strain_range, pressure_range = -0.05, 60.0, (-0.5, 0.5), (0.0, 60.0)

    def __init__(self, k: float = 40.0, gain: float = 0.8, law: Callable[[Tensor], Tensor] = torch.sin) -> None:
        super().__init__()
        self.k, self.law = k, law
        self.gain = torch.nn.Parameter(torch.tensor(gain, dtype=torch.float64))

    def force(self, strain: Tensor, pressure: Tensor) -> Tensor:
        return self.gain.detach() * pressure - self.k * strain - self.law(strain)


def _arm(model: Any, radius: float = 0.03) -> ta.ArmDesign:
    return ta.ArmDesign([-radius, 0.03], 0.45, [model, Spring()])


def _run(arm: ta.ArmDesign, file: Path | None, task: ta.Task = TASK, **options: Any) -> ta.OptimisedDesign:
    settings: dict[str, Any] = {"starts": 2, "iterations": 2, "space": SPACE, "objective": NEWTONS} | options
    return optimise_design(arm, task, checkpoint=file, **settings)


@pytest.mark.parametrize(
    ("model", "other"),
    [
        (Spring, lambda: Spring(k=400.0)),
        (Spring, lambda: Spring(gain=0.7)),
        (Spring, lambda: Spring(law=torch.tanh)),
        (ta.Bellows, lambda: ta.Bellows(force_scale=1.01)),
        (ta.Bellows, lambda: ta.Bellows(bending_stiffness=-0.06)),
    ],
)
def test_another_model_is_refused_and_the_same_one_taken_up(
    tmp_path: Path, model: Callable[[], Any], other: Callable[[], Any]
) -> None:
    file = tmp_path / "run.json"
    first = _run(_arm(model()), file)
    with pytest.raises(ValueError, match=r"another problem, whose force model 1 differs"):
        _run(_arm(other()), file)
    again = _run(_arm(model()), file)
    assert again.value == first.value
    assert torch.equal(again.best.radii, first.best.radii)
    assert again.evaluations == 0, "gone on from, not done again"


def test_every_other_part_is_told_apart_and_named(tmp_path: Path) -> None:
    file = tmp_path / "run.json"
    _run(_arm(Spring()), file)
    changes: list[tuple[str, ta.ArmDesign, ta.Task, dict[str, Any]]] = [
        ("arm", _arm(Spring(), radius=0.031), TASK, {}),
        ("task", _arm(Spring()), ta.Task(TASK.twists, (8.0, -20.0, 2.1)), {}),
        ("space", _arm(Spring()), TASK, {"space": replace(SPACE, bounds={"length": (0.3, 0.6)})}),
        ("objective", _arm(Spring()), TASK, {"objective": replace(NEWTONS, relative_weight=0.2)}),
        ("seed", _arm(Spring()), TASK, {"seed": 1}),
        ("iterations", _arm(Spring()), TASK, {"iterations": 3}),
    ]
    for words, arm, task, options in changes:
        with pytest.raises(ValueError, match=f"another problem, whose {words} differs;"):
            _run(arm, file, task, **options)
    more = _run(_arm(Spring()), file, starts=3)
    assert more.evaluations > 0
    assert len(more.reasons) == 3


def test_an_interrupted_run_loses_nothing_finished(tmp_path: Path) -> None:
    file = tmp_path / "run.json"
    whole = _run(ta.antagonistic_arm(), None, starts=3)

    def interrupt(progress: Progress) -> None:
        if progress.start == 2:
            raise KeyboardInterrupt

    part = _run(ta.antagonistic_arm(), file, starts=3, callback=interrupt)
    assert part.stopped == "interrupted"
    assert len(json.loads(file.read_text())["finished"]) == 2
    resumed = _run(ta.antagonistic_arm(), file, starts=3)
    assert resumed.stopped == "finished"
    assert torch.equal(resumed.end_values, whole.end_values)
    assert 0 < resumed.evaluations < whole.evaluations


def test_architectures_have_checkpoints_of_their_own(tmp_path: Path) -> None:
    file = tmp_path / "run.json"
    settings: dict[str, Any] = {"space": SPACE, "objective": NEWTONS, "starts": 1, "iterations": 2, "checkpoint": file}
    found = optimise_architectures(_arm(Spring()), TASK, models=[Spring(), ta.Bellows()], **settings)
    again = optimise_architectures(_arm(Spring()), TASK, models=[Spring(), ta.Bellows()], **settings)
    assert again.names == found.names
    assert all(one.evaluations == 0 for one in again.designs)
    with pytest.raises(ValueError, match="force model 1 differs"):
        optimise_architectures(_arm(Spring()), TASK, models=[Spring(k=41.0), ta.Bellows()], **settings)
    with pytest.raises(ValueError, match="search"):
        _run(_arm(Spring()), file)


SCRIPT = """
import sys
sys.path.insert(0, {folder!r})
from pathlib import Path
import test_checkpoint as t
found = t._run(t._arm(t.Spring()), Path({file!r}))
print(found.value, found.evaluations)
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
    value, count = answers[0].stdout.split()
    assert int(count) > 0
    assert answers[1].stdout.split() == [value, "0"]


def test_an_unwritable_or_foreign_file_is_found_before_the_work(tmp_path: Path) -> None:
    def work(progress: Progress) -> None:
        raise AssertionError("the work has begun")

    (tmp_path / "other").write_text("not one", encoding="utf-8")
    for file, words in ((tmp_path / "none" / "run", "does not exist"), (tmp_path / "other", "none that this torcharm")):
        with pytest.raises(ValueError, match=words):
            _run(_arm(Spring()), file, callback=work)


def test_a_failing_save_warns_once_and_costs_no_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(path: Path, flags: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("torcharm.files.to_disk", full)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        found = _run(_arm(Spring()), tmp_path / "run")
    assert [str(one.message) for one in told if "checkpoint" in str(one.message)] == [
        f"checkpoint: {tmp_path / 'run'} could not be written: No space left on device"
    ]
    assert found.stopped == "finished"
    assert list(tmp_path.iterdir()) == []
