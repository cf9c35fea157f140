import csv
import json
import math
import os
import re
import signal
import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from commands import invoke, mistake
from standard_error import without_notice
from typer.testing import CliRunner

import torcharm as ta
from torcharm import cli, study
from torcharm.cli.app import app
from torcharm.study import results

STUDY = """
name = "two tasks"
[[arm]]
name = "[red]bellows[/red] ✓"
kind = "bellows"
[[arm]]
name = "an arm with a name that is far too long for a column of a table"
kind = "antagonistic"
[[task]]
name = "straight"
twists = [[0.5, 0, 0], [0.5, 0, 0]]
loads = [[0, 0, 0]]
[[task]]
name = "bent"
shape = { kind = "affine", slope = -3, intercept = 3 }
loads = { count = 4 }
"""


@pytest.fixture
def study_file(tmp_path: Path) -> Path:
    path = tmp_path / "study.toml"
    path.write_text(STUDY, encoding="utf-8")
    return path


def run(*args: object, **env: str) -> subprocess.CompletedProcess[bytes]:
    """The command as a process of its own, into a pipe."""
    clean = {key: value for key, value in os.environ.items() if key not in {"FORCE_COLOR", "COLUMNS"}}
    command = [sys.executable, "-m", "torcharm.cli", *map(str, args)]
    return subprocess.run(command, capture_output=True, timeout=120, env=clean | env, check=False)


# Evaluate


def test_the_papers_table_holds_what_evaluate_found():
    output = invoke("evaluate", "--paper")
    task = ta.Task(ta.affine_curvature(-3.0, 3.0), ta.sample_loads(100), wrench_at="start")
    for name, arm in (("antagonistic", ta.antagonistic_arm()), ("bellows-only", ta.bellows_arm())):
        found = ta.evaluate(arm, task, ("absolute", "relative"))
        row = next(line.split() for line in output.splitlines() if line.startswith(name))
        assert row[1:4] == [str(int(found.not_excluded.sum())), "of", "100"]
        mean = found.absolute_per_node.mean(0)
        assert row[4] == f"{int(mean.argmax()) + 1}:"
        assert float(row[5]) == pytest.approx(float(mean.max()), rel=0.05)
        assert float(row[6]) == pytest.approx(found.absolute.quantile(0.5).item(), rel=1e-2)
        assert float(row[7]) == pytest.approx(found.relative.quantile(0.5).item(), rel=1e-2)
    assert "shape (-3, 3), 10 nodes, 100 loads" in output
    assert "actuator 4 is strained to -0.48 at node 1" in output
    assert re.search(r"2 arms on 1 task: 200 evaluations in [\d.e-]+ s\.", output)


def test_the_first_command_shows_held_and_missed_tasks_and_what_to_do_next():
    output = invoke("evaluate")
    plan = study.example_study()
    for result in study.evaluate_study(plan):
        summary = study.summarise(result)
        part = output.split(f"Task {result.task.name}")[1]
        row = next(line for line in part.splitlines() if line.startswith(result.arm.name))
        cells = row.removeprefix(result.arm.name).split()
        assert cells[:3] == [str(summary.held), "of", str(summary.loads)]
        assert float(cells[3]) == pytest.approx(1e3 * summary.median["tip_error"], rel=1e-2)
        assert float(cells[4]) == pytest.approx(math.degrees(summary.median["tip_rotation_error"]), rel=1e-2)
    assert "missed" in output
    assert "node 10 lacks" in " ".join(output.split())
    assert output.strip().splitlines()[-2].startswith("Next: torcharm init")


def test_the_sentence_on_a_verdict_says_of_which_load_it_speaks(tmp_path):
    text = study.example_text().replace("count = 40", "count = 12")
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    output = " ".join(invoke("evaluate", tmp_path / "study.toml").split())
    checked = 0
    for result in study.evaluate_study(study.load_study(tmp_path / "study.toml")):
        found, words = result.attainability, result.verdicts
        missed = [index for index, word in enumerate(words) if word == "missed"]
        if len(missed) > 1 and len(missed) == max(words.count(word) for word in {*words} - {"held"}):
            worst = max(missed, key=lambda index: float(found.over_tolerance[index]))
            which = f"load {worst + 1} of {result.loads}, the furthest off of {len(missed)} missed"
            assert f"{result.arm.name}, {which}: {found.reason[worst]}." in output
            checked += 1
    assert checked >= 3


def test_one_load_is_not_counted(tmp_path):
    text = STUDY.replace("count = 4", "count = 1")
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    output = invoke("evaluate", tmp_path / "study.toml")
    assert ", load " not in output
    assert "[red]bellows[/red] ✓: " in output


def test_json_is_all_that_is_printed(study_file):
    rows = json.loads(invoke("evaluate", study_file, "--json"))
    assert [row["task"] for row in rows] == ["straight"] * 2 + ["bent"] * 8
    assert rows[0]["verdict"] == "held"
    assert rows[0]["tip_error_mm"] < 1e-3


def test_sums_are_shown_on_request(study_file):
    plain, full = invoke("evaluate", study_file), invoke("evaluate", study_file, "--sums")
    assert "absolute" not in plain
    assert "absolute" in full
    assert "relative" in full
    assert max(len(line) for line in full.split("Next: ")[0].splitlines()) <= 80


def test_every_line_fits_80_columns(study_file):
    for output in (invoke("evaluate").split("Next: ")[0], invoke("evaluate", "--paper")):
        assert max(len(line) for line in output.splitlines()) <= 80


def test_names_are_text_and_not_markup(study_file):
    output = invoke("evaluate", study_file)
    assert "[red]bellow" in output
    assert "\x1b" not in output
    assert output.index("straight") < output.index("bent")
    assert "1 load\n" in output
    assert "4 loads\n" in output


def test_tasks_that_are_held_have_no_worst_node(study_file):
    output = invoke("evaluate", study_file).split("Task bent")[0]
    (row,) = (line for line in output.splitlines() if "an arm" in line)
    *errors, worst = row.split()[-4:]
    assert set(errors) <= {"0", "<0.001"}
    assert worst == "-"
    assert "not held" not in output


def test_a_study_in_range_says_nothing_of_ranges(tmp_path):
    text = study.example_text().replace(
        'name = "bellows only"\nkind = "bellows"', 'name = "other"\nkind = "antagonistic"'
    )
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    assert "extrapolate" not in invoke("evaluate", tmp_path / "study.toml")


def test_limits_out_of_range_are_noted(tmp_path, study_file):
    text = STUDY.replace('kind = "bellows"', 'kind = "bellows"\nmax_pressure = 95')
    study_file.write_text(text, encoding="utf-8")
    output = " ".join(invoke("evaluate", study_file).split())
    assert "actuator 1 is driven to 95 kPa, characterised to 92 kPa" in output
    assert "excluded by range: beyond characterised" in output


@pytest.mark.parametrize(("metric", "other"), [("absolute", "relative"), ("relative", "absolute")])
def test_a_metric_not_asked_for_has_no_column(study_file, metric, other):
    study_file.write_text(f'{STUDY}\n[evaluate]\nmetrics = ["{metric}"]', encoding="utf-8")
    output = invoke("evaluate", study_file)
    assert metric in output
    assert other not in output
    assert "both" not in output
    assert "worst" in output


def test_the_legend_tells_the_unit(study_file):
    assert "distances from attainable wrenches, N·m counted as N" in invoke("evaluate", study_file, "--sums")
    study_file.write_text(f"{STUDY}\n[evaluate]\npower = 2", encoding="utf-8")
    assert "squared distances from" in invoke("evaluate", study_file, "--sums")
    study_file.write_text(f"{STUDY}\n[evaluate]\nweights = [4, 0.5]\ntolerance = '5 mm'", encoding="utf-8")
    output = invoke("evaluate", study_file, "--sums")
    assert "4 f² + 0.5 m²" in output
    assert "tip and shape within 5 mm, turned within 5°" in output


def test_out_writes_a_row_for_every_load(tmp_path, study_file):
    path = tmp_path / "results.csv"
    assert f"Wrote {path} (200 rows)." in invoke("evaluate", "--paper", "--out", path)
    with path.open(encoding="utf-8", newline="") as file:
        assert len(list(csv.DictReader(file))) == 200
    assert f"Wrote {path} (10 rows)." in invoke("evaluate", study_file, "--out", path)
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["task"], row["arm"]) for row in rows[:2]] == [
        ("straight", "[red]bellows[/red] ✓"),
        ("straight", "an arm with a name that is far too long for a column of a table"),
    ]


def test_figure_draws_each_task(monkeypatch, tmp_path, study_file):
    drawn = []

    def study_figure(*args):
        drawn.append(args)
        return types.SimpleNamespace(savefig=lambda path: path.write_text(f"{path.suffix} of {args[1]}"))

    monkeypatch.setitem(sys.modules, "torcharm.plot", types.SimpleNamespace(study_figure=study_figure))
    output = invoke("evaluate", study_file, "--figure", tmp_path / "figure.PNG")
    assert (tmp_path / "figure-1.PNG").read_text() == ".PNG of straight"
    assert (tmp_path / "figure-2.PNG").read_text() == ".PNG of bent"
    assert f"Wrote {tmp_path / 'figure-2.PNG'} (bent)." in output
    plan = study.load_study(study_file)
    for (arms, name, task, evaluated), expected in zip(drawn, plan.tasks, strict=True):
        assert [arm_name for arm_name, _ in arms] == [arm.name for arm in plan.arms]
        assert all(isinstance(design, ta.ArmDesign) for _, design in arms)
        assert name == expected.name
        assert task.batch_shape == expected.task.batch_shape
        assert [found.absolute.shape for found in evaluated] == [task.batch_shape] * 2

    assert f"Wrote {tmp_path / 'figure.png'} (shape (-3, 3))." in invoke(
        "evaluate", "--paper", "--figure", tmp_path / "figure.png"
    )
    assert sorted(path.name for path in tmp_path.glob("*fig*")) == ["figure-1.PNG", "figure-2.PNG", "figure.png"]
    assert not list(tmp_path.glob(".torcharm*"))


def test_figure_is_a_picture(tmp_path):
    pytest.importorskip("torcharm.plot")
    path = tmp_path / "figure.png"
    invoke("evaluate", "--paper", "--figure", path)
    assert path.read_bytes().startswith(b"\x89PNG")


# Init, version, help


def test_init_writes_the_example_and_does_not_overwrite(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert "torcharm evaluate study.toml" in invoke("init")
    path = tmp_path / "study.toml"
    assert path.read_text(encoding="utf-8") == study.example_text()
    invoke("evaluate", path)

    path.write_text("mine")
    assert mistake(monkeypatch, capsys, "init") == "study.toml: is there already; --force overwrites it"
    assert path.read_text() == "mine"
    invoke("init", "--force")
    assert path.read_text(encoding="utf-8") == study.example_text()
    invoke("init", "--out", "other.toml")
    assert (tmp_path / "other.toml").read_text(encoding="utf-8") == study.example_text()
    assert mistake(monkeypatch, capsys, "init", "--out", "other.toml").startswith("other.toml: is there already")
    assert "unexpected extra argument" in mistake(monkeypatch, capsys, "init", "third.toml")
    assert not (tmp_path / "third.toml").exists()


def test_version():
    assert invoke("--version") == f"torcharm {ta.__version__}\n"


@pytest.mark.parametrize("args", [[], ["--help"]])
def test_help(monkeypatch, capsys, args):
    monkeypatch.setattr(sys, "argv", ["torcharm", *args])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    assert caught.value.code == 0
    output = capsys.readouterr().out
    for word in ("evaluate", "init", "--version", "Example"):
        assert word in output


@pytest.mark.parametrize(
    ("command", "example"),
    [
        ("evaluate", "torcharm evaluate study.toml --out results.csv --figure picture.png"),
        ("init", "torcharm init --out arms.toml"),
    ],
)
def test_help_of_each_command_shows_an_example(command, example):
    assert f"Example: {example}" in re.sub(r"\x1b\[[\d;]*m", "", invoke(command, "--help"))


# Mistakes


@pytest.mark.parametrize(
    ("args", "parts"),
    [
        (["evaluate", "missing.toml"], ["missing.toml: ", "No such file"]),
        (["evaluate", "."], [".: cannot be read"]),
        (
            ["evaluate", "bad.toml"],
            ['bad.toml: arm[1].kind: must be one of antagonistic, bellows, mckibben, got "belows"'],
        ),
        (["evaluate", "--out", "."], ["--out: .: is a directory"]),
        (
            ["evaluate", "--out", "nowhere/results.csv"],
            ["--out: nowhere/results.csv: the directory nowhere does not exist"],
        ),
        (
            ["evaluate", "--figure", "figure.docx"],
            ["--figure: figure.docx: must end in one of .png, .pdf", "got .docx"],
        ),
        (["evaluate", "--figure", "figure"], ["--figure: figure: must end in one of .png", "got no ending"]),
        (["evaluate", "--figure", "nowhere/figure.png"], ["--figure: nowhere/figure.png: the directory"]),
        (["evaluate", "--out", "a.csv", "--figure", "a.csv"], ["--figure: a.csv: is the file of --out"]),
        (["evaluate", "bad.toml", "--out", "./bad.toml"], ["--out: bad.toml: is the study itself"]),
        (["evaluate", "--quick"], ["No such option", "--quick"]),
        (["evaluate", "--out"], ["--out", "requires an argument"]),
        (["evaluate", "a.toml", "b.toml"], ["unexpected extra argument", "b.toml"]),
        (["evalute"], ["No such command 'evalute'"]),
        (["init", "--out", "nowhere/study.toml"], ["nowhere/study.toml: No such file or directory"]),
        (["init", "--out", ".", "--force"], [".: "]),
    ],
)
def test_mistakes_are_one_line(monkeypatch, capsys, tmp_path, args, parts):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.toml").write_text('name = "x"\ntask = []\n[[arm]]\nname = "a"\nkind = "belows"')
    message = mistake(monkeypatch, capsys, *args)
    for part in parts:
        assert part in message
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bad.toml"]


def test_outputs_are_checked_before_the_work(monkeypatch, capsys):
    monkeypatch.setattr(study, "evaluate_arm", lambda *_: pytest.fail("the work was done"))
    mistake(monkeypatch, capsys, "evaluate", "--out", "nowhere/results.csv")
    mistake(monkeypatch, capsys, "evaluate", "--figure", "figure.txt")


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="permissions do not stop this user")
def test_outputs_without_permission(monkeypatch, capsys, tmp_path):
    tmp_path.chmod(0o500)
    assert "cannot be written, Permission denied" in mistake(
        monkeypatch, capsys, "evaluate", "--out", tmp_path / "results.csv"
    )


@pytest.mark.parametrize(
    ("error", "line"),
    [(OSError(28, "No space left on device"), "No space left on device"), (MemoryError(), "not enough memory")],
)
def test_failures_on_the_way_are_one_line(monkeypatch, capsys, error, line):
    def fail(*_):
        raise error

    monkeypatch.setattr(study, "evaluate_arm", fail)
    assert line in mistake(monkeypatch, capsys, "evaluate")


def test_a_defect_keeps_its_traceback(monkeypatch):
    def fail(*_):
        raise RuntimeError("a defect")

    monkeypatch.setattr(study, "evaluate_arm", fail)
    monkeypatch.setattr(sys, "argv", ["torcharm", "evaluate"])
    with pytest.raises(RuntimeError, match="a defect"):
        cli.main()


def test_interruption_is_one_line_and_keeps_what_is_finished(monkeypatch, capsys, tmp_path):
    plan, finished = study.paper_study(), study.evaluate_arm

    def interrupt(arm, *others):
        if arm.name != plan.arms[0].name:
            raise KeyboardInterrupt
        return finished(arm, *others)

    monkeypatch.setattr(study, "evaluate_arm", interrupt)
    monkeypatch.setattr(sys, "argv", ["torcharm", "evaluate", "--paper", "--out", str(tmp_path / "rows.csv")])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    assert caught.value.code == 130
    output = capsys.readouterr()
    assert without_notice(output.err) == "torcharm: interrupted\n"
    assert plan.arms[0].name in output.out
    assert len((tmp_path / "rows.csv").read_text().splitlines()) == 101


def test_an_arm_that_is_refused_costs_only_its_own_rows(monkeypatch, capsys, study_file, tmp_path):
    whole = ta.evaluate

    def refuse_bellows(arm, task, **settings):
        if len({type(model) for model in arm.actuators}) == 1:
            raise ValueError("actuators[0].force: must return a value")
        return whole(arm, task, **settings)

    monkeypatch.setattr(results, "evaluate", refuse_bellows)
    out = tmp_path / "rows.csv"
    monkeypatch.setattr(sys, "argv", ["torcharm", "evaluate", str(study_file), "--out", str(out)])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    output = capsys.readouterr()
    assert caught.value.code == 2
    line = "torcharm: [red]bellows[/red] ✓: actuators[0].force: must return a value\n"
    assert without_notice(output.err) == line
    assert "Task bent" in output.out
    with out.open(encoding="utf-8") as file:
        rows = [(row["task"], row["arm"][:6]) for row in csv.DictReader(file)]
    assert rows == [("straight", "an arm")] + [("bent", "an arm")] * 4


def test_limits_in_other_units_are_asked_about_and_not_refused(study_file):
    text = STUDY.replace('kind = "bellows"', 'kind = "bellows"\nmax_pressure = [1.2, 0, 50, 50]')
    study_file.write_text(text, encoding="utf-8")
    result = CliRunner().invoke(app, ["evaluate", str(study_file)])
    question = "max_pressure: 1.2 kPa is 1.3 % of the 92 kPa that were characterised: is it in bar?"
    assert result.exit_code == 0
    assert without_notice(result.stderr) == f"torcharm: [red]bellows[/red] ✓: {question}\n"


# As a process


def test_process_writes_plain_text_and_results(tmp_path):
    path = tmp_path / "results.csv"
    done = run("evaluate", "--paper", "--out", path, PYTHONIOENCODING="utf-8")
    assert (done.returncode, without_notice(done.stderr.decode())) == (0, "")
    output = done.stdout.decode()
    assert "\x1b" not in output
    assert max(len(line) for line in output.splitlines() if str(path) not in line) <= 80
    assert len(path.read_text(encoding="utf-8").splitlines()) == 201


def test_process_copes_with_a_narrow_encoding(study_file):
    done = run("evaluate", study_file, PYTHONIOENCODING="ascii")
    assert (done.returncode, without_notice(done.stderr.decode())) == (0, "")
    assert b"bellow" in done.stdout


def test_process_ends_in_one_line_after_a_mistake():
    done = run("evaluate", "missing.toml")
    assert (done.returncode, done.stdout) == (2, b"")
    assert done.stderr.decode().splitlines() == ["torcharm: missing.toml: cannot be read: No such file or directory"]


def test_entry_point():
    script = Path(sys.executable).with_name("torcharm")
    if not script.exists():
        pytest.skip("torcharm is not installed beside this Python")
    done = subprocess.run([script, "--version"], capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stdout) == (0, f"torcharm {ta.__version__}\n")


@pytest.mark.skipif(sys.platform == "win32", reason="Ctrl-C is no signal there")
def test_process_is_interrupted_by_a_signal():
    slow = (
        "import signal, sys, time; from torcharm import cli, study;"
        "signal.signal(signal.SIGINT, signal.default_int_handler);"  # which a process in the background ignores
        "study.evaluate_arm = lambda *_: (print('working', flush=True), time.sleep(60));"
        "sys.argv = ['torcharm', 'evaluate']; cli.main()"
    )
    with subprocess.Popen([sys.executable, "-c", slow], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"working\n"
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert errors == b"torcharm: interrupted: nothing was finished\n"


def test_the_table_shows_predicted_errors_in_millimetres(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(
        STUDY.replace("two tasks", "errors") + '[evaluate]\nmetrics = ["predicted_error"]\n', encoding="utf-8"
    )
    shown = invoke("evaluate", path, "--figure", tmp_path / "figure.png")
    assert "[mm]" in shown
    assert "worst node" not in shown
    task = ta.Task(ta.affine_curvature(-3.0, 3.0), ta.sample_loads(4))
    found = ta.evaluate(ta.bellows_arm(), task, metrics=("predicted_error",))
    assert f" {1e3 * float(np.median(found.tip_error)):.0f} " in shown
    assert (tmp_path / "figure-2.png").stat().st_size > 10_000
