"""The commands `torcharm optimise` and `torcharm plan`, run as a person runs them."""

import csv
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import pytest
import torch
from commands import one_start, twists_of
from standard_error import without_notice

import torcharm as ta
from torcharm import cli, files
from torcharm.design.objective import task_values
from torcharm.inputs import three_digits
from torcharm.study import load_study, moved_files, parse_study

STUDY = """
name = "try"

[[arm]]
name = "antagonistic"
kind = "antagonistic"
outer_radius = 0.04
inner_radius = 0.01
length = 0.51

[[task]]
name = "reach"
shape = { kind = "affine", slope = -3.0, intercept = 3.0, nodes = 4 }
loads = { count = 2 }

[[task]]
name = "hold"
shape = { kind = "affine", slope = 1.0, intercept = 1.5, nodes = 3 }
loads = [[3.0, -2.0, 0.5]]

[optimise]
tied = "mirror"
spacing = 0.005
starts = 2
iterations = 6
bounds = { radii = [-0.09, 0.09] }

[[plan]]
name = "shape 1"
tip_pose = [0.35, -0.3, 0.0]
tip_load = [6.0, 0.0, 0.0]
length_weight = 45.0
reference_length = 0.5
"""

SHAPE = 'shape = { kind = "affine", slope = 0.0, intercept = 1.0, nodes = 3 }\n\n'


@dataclass(frozen=True)
class Answer:
    """How a command ended, and what it printed."""

    returncode: int
    stdout: str
    stderr: str


Run = Callable[..., Answer]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """The command on a study in a folder, as a person runs it but in this process."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")

    def run(*arguments: str, text: str = STUDY) -> Answer:
        Path("study.toml").write_text(text, encoding="utf-8")
        monkeypatch.setattr(sys, "argv", ["torcharm", *arguments])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        said = capsys.readouterr()
        return Answer(int(ended.value.code or 0), said.out, without_notice(said.err))

    return run


FEW = STUDY.replace("starts = 2", "starts = 1").replace("iterations = 6", "iterations = 1")


def test_optimise_shows_and_saves_a_better_arm(run: Run, tmp_path: Path) -> None:
    answer = run("optimise", "study.toml", "--out", "best.csv", "--figure", "best.png")
    assert answer.returncode == 0, answer.stderr
    assert "Wrote best.csv" in answer.stdout
    assert (tmp_path / "best.png").stat().st_size > 1000
    with (tmp_path / "best.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["model"] for row in rows] == ["bellows", "mckibben", "mckibben", "bellows"]
    assert [float(row["given_radius_mm"]) for row in rows] == pytest.approx([-40.0, -10.0, 10.0, 40.0])
    radii, length = ([float(row[name]) / 1e3 for row in rows] for name in ("radius_mm", "length_mm"))
    study = parse_study(STUDY)
    models = study.arms[0].design.actuators
    best = ta.ArmDesign(torch.tensor(radii).double(), torch.tensor(length).double(), models)
    values = [
        [task_values(ta.Objective(), arm, named.task, in_range=False).flatten() for named in study.tasks]
        for arm in (study.arms[0].design, best)
    ]
    given, value = (1e3 * float(torch.cat(each).mean()) for each in values)
    assert value < given
    assert f"{three_digits(given)} → {three_digits(value)}" in answer.stdout, "plain errors, at no price"
    assert "Minimised is the mean predicted shape error, in which a task counts the more" in answer.stdout
    assert min(b - a for a, b in pairwise(radii)) > 0.005 - 1e-7
    assert "antagonistic: better, as a pressure search confirms" in answer.stdout


def test_one_arm_that_is_refused_costs_no_other(run: Run, tmp_path: Path) -> None:
    bad = '[[arm]]\nname = "short"\nkind = "antagonistic"\nlength = 0.1\n\n'
    text = STUDY.replace("[[task]]", f'{bad}[[arm]]\nname = "last"\nkind = "antagonistic"\n\n[[task]]', 1)
    answer = run("optimise", "study.toml", "--out", "best.toml", "--figure", "best.png", text=text)
    assert answer.returncode == 2
    assert answer.stderr.count("\n") == 1
    assert answer.stderr.startswith("torcharm: short: space: no design within the bounds")
    assert "antagonistic: better" in answer.stdout
    assert "last: " in answer.stdout  # after the one that is refused
    assert (tmp_path / "best.toml").read_text(encoding="utf-8").count("[[arm]]") == 2
    names = {"best.toml", "study.toml", "best-1.png", "best-3.png"}
    assert {path.name for path in tmp_path.iterdir()} == names


def test_a_spacing_that_nobody_gave_is_said(run: Run) -> None:
    said = "without a diameter may come as close as 5 mm, axis to axis: give them one, or set optimise.spacing."
    bare = FEW.replace("spacing = 0.005\n", "")
    wide = bare.replace("length = 0.51\n", 'length = 0.51\ndiameter = "6 mm"\n')
    for text, expected in ((FEW, False), (bare, True), (wide, False)):
        answer = run("optimise", "study.toml", text=text)
        assert answer.returncode == 0, answer.stderr
        assert (said in answer.stdout) == expected


def test_numbers_of_a_search_are_distances_that_it_reaches(run: Run) -> None:
    answer = run("optimise", "study.toml")
    study = parse_study(STUDY)
    tasks = [named.task for named in study.tasks]
    found = [ta.search_pressure(study.arms[0].design, task) for task in tasks]
    mean = 1e3 * float(torch.cat([one.shape_error.flatten() for one in found]).mean())
    beyond = sum(int((~one.in_range).sum()) for one in found)
    assert f"confirms (shape off by {three_digits(mean)} → " in answer.stdout
    assert f"out of range on {beyond} → " in answer.stdout


def test_the_best_arms_are_a_study_to_evaluate(run: Run, tmp_path: Path) -> None:
    """Of arms of which one is refused, on tasks that name arms; what was free is as round as one builds."""
    bad = '[[arm]]\nname = "short"\nkind = "antagonistic"\nlength = 0.1\n\n'
    text = STUDY.replace("[[task]]", f"{bad}[[task]]", 1)
    text = text.replace('name = "reach"', 'name = "reach"\narms = ["short", "antagonistic"]')
    text = text.replace("[optimise]", '[[task]]\nname = "gone"\narms = ["short"]\n' + SHAPE + "[optimise]")
    (tmp_path / "there").mkdir()
    answer = run("optimise", "study.toml", "--out", "there/best.toml", text=text)
    assert "Wrote there/best.toml." in answer.stdout
    assert "Next: torcharm evaluate there/best.toml" in answer.stdout.splitlines()[-1]
    best, given = load_study(tmp_path / "there/best.toml"), parse_study(text)
    assert best.name == "try, optimised"
    assert [arm.name for arm in best.arms] == ["antagonistic, optimised"]
    assert [(task.name, task.arms) for task in best.tasks] == [("reach", ("antagonistic, optimised",)), ("hold", ())]
    assert best.optimisation == given.optimisation
    for old, new in zip(given.tasks, best.tasks, strict=False):
        torch.testing.assert_close(new.task.load.tip, old.task.load.tip)
    arm, old_arm = best.arms[0].design, given.arms[0].design
    assert isinstance(arm, ta.ArmDesign)
    assert isinstance(old_arm, ta.ArmDesign)
    assert arm.actuators == old_arm.actuators
    assert arm.radii.tolist() != old_arm.radii.tolist()
    for values in (arm.radii, arm.length):
        assert all(f"{1e3 * value:.1f}" in answer.stdout for value in values.tolist())
        assert values.tolist() == [round(value, 5) for value in values.tolist()]
    assert run("evaluate", "there/best.toml", text=text).returncode == 0


def test_models_of_a_study_are_found_from_where_the_best_arms_are_written(tmp_path: Path) -> None:
    study, out = tmp_path / "study.toml", tmp_path / "there" / "best.toml"
    out.parent.mkdir()
    assert moved_files(("models/own.toml", None), study, out) == ("../models/own.toml", None)
    assert moved_files(("models/own.toml", None), study, tmp_path / "best.toml") == ("models/own.toml", None)


def test_one_plan_without_a_shape_costs_only_its_own_row(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one_start(monkeypatch)
    far = '[[plan]]\nname = "far"\ntip_pose = [3.0, 3.0, 0.0]\ntip_load = [6.0, 0.0, 0.0]\nnodes = 3\n\n'
    answer = run("plan", "study.toml", "--out", "shapes.csv", text=STUDY.replace("[[plan]]", far + "[[plan]]"))
    assert answer.returncode == 0, answer.stderr
    assert "\nantagonistic: no shape: none of 3 elements was found" in answer.stdout
    with (tmp_path / "shapes.csv").open(encoding="utf-8") as file:
        assert {row["plan"] for row in csv.DictReader(file)} == {"shape 1"}


def test_plan_writes_the_paper_s_shape(run: Run, tmp_path: Path) -> None:
    answer = run("plan", "study.toml", "--out", "shapes.csv")
    assert answer.returncode == 0, answer.stderr
    with (tmp_path / "shapes.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    twists = twists_of(rows)
    arm = ta.antagonistic_arm(0.04, 0.01, 0.51)
    task = ta.Task(twists, (6.0, 0.0, 0.0), wrench_at="start")
    found = ta.evaluate(arm, task, ("absolute", "relative"), hull="edges", power=2)
    assert float(found.absolute) == pytest.approx(0.2343, abs=5e-5)  # type: ignore[arg-type]
    assert re.search(r"  500 ", answer.stdout), "the length of all elements [mm]"


@pytest.mark.parametrize(
    ("command", "change", "words"),
    [
        ("optimise", ("starts = 2", "startz = 2"), "optimise.startz: unknown key; did you mean starts?"),
        ("optimise", ('tied = "mirror"', 'tied = "mirrored"'), "optimise.tied: must be one of mirror, equal"),
        ("optimise", ("radii = [-0.09, 0.09]", "length = [0.1, 0.2]"), "no design within the bounds"),
        ("optimise", ("spacing = 0.005", "spacing = 0.0"), "optimise.spacing"),
        ("plan", ("length_weight = 45.0\n", ""), "length_weight: must be given too"),
        ("plan", ("tip_pose = [0.35, -0.3, 0.0]", "tip_pose = [0.35]"), "plan[1].tip_pose: must be a list of 3"),
        ("plan", ("[[plan]]", "[[plans]]"), "plans"),
    ],
)
def test_mistakes_end_in_one_line(run: Run, command: str, change: tuple[str, str], words: str) -> None:
    assert change[0] in STUDY
    answer = run(command, "study.toml", text=STUDY.replace(*change))
    assert answer.returncode == 2
    assert words in answer.stderr
    assert answer.stderr.count("\n") == 1
    assert "Traceback" not in answer.stderr


def test_outputs_that_cannot_be_written_are_found_before_the_work(run: Run, tmp_path: Path) -> None:
    two = STUDY.replace("[[task]]", '[[arm]]\nname = "other"\nkind = "bellows"\n\n[[task]]', 1)
    (tmp_path / "best-2.png").mkdir()
    for arguments, words in (
        (("--out", "none/best.csv"), "--out: none/best.csv: the directory none does not exist"),
        (("--figure", "best.png"), "--figure: best-2.png: is a directory"),
        (("--checkpoint", "none/run.json"), "--checkpoint: none/run-1.json: the directory none does not exist"),
        (("--checkpoint", "study.toml"), "--checkpoint: study.toml: is the study itself"),
        (("--out", "a.csv", "--checkpoint", "a.csv"), "--checkpoint: a.csv: is the file of --out"),
    ):
        answer = run("optimise", "study.toml", *arguments, text=two)
        assert answer.returncode == 2
        assert answer.stderr == f"torcharm: {words}{answer.stderr.partition(words)[2]}"
        assert answer.stderr.count("\n") == 1
        assert answer.stdout == ""


def test_a_failing_save_costs_no_result(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files, "to_disk", full)
    (tmp_path / "best.csv").write_text("old")
    answer = run("optimise", "study.toml", "--out", "best.csv", "--checkpoint", "run.json", text=FEW)
    assert answer.returncode == 2
    assert "Shape: mean predicted shape error." in answer.stdout, "the results are shown"
    lines = [line for line in answer.stderr.splitlines() if line.startswith("torcharm:")]
    assert len(lines) == 2, answer.stderr
    assert "checkpoint: run.json could not be written: No space left" in lines[0]
    assert "best.csv: cannot be written: No space left" in lines[1]
    assert (tmp_path / "best.csv").read_text() == "old"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["best.csv", "study.toml"]
