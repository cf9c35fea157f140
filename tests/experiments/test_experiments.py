"""Every experiment's smoke run, through the command that a person uses; and that command on made-up experiments."""

import json
import os
import runpy
import subprocess
import sys
import time
from pathlib import Path

import pytest

from experiments import runner

ROOT = Path(__file__).parents[2]


def command(*arguments, cwd=ROOT, timeout=600):
    # A thread each: on a busy machine more of them wait for one another.
    environment = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(cwd), "COLUMNS": "200"}
    return subprocess.run(
        [sys.executable, "-m", "experiments", *map(str, arguments)],
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
    )


def contents(folder):
    """Every file that is neither git's nor a cache, with its size and time."""
    return {
        path: (path.stat().st_size, path.stat().st_mtime_ns)
        for path in folder.rglob("*")
        if path.is_file() and not {".git", "__pycache__"} & set(path.parts)
    }


def test_every_experiment_has_a_folder_a_summary_a_readme_and_results():
    found = runner.discover()
    assert len(found) >= 3
    for experiment in found:
        assert experiment.summary
        for name in ("README.md", "run.py", "__init__.py", "results.csv"):
            assert (experiment.folder / name).is_file(), f"{experiment.name}/{name}"


@pytest.mark.slow
@pytest.mark.parametrize("experiment", runner.discover(), ids=lambda experiment: experiment.name)
def test_a_smoke_run_succeeds_and_leaves_the_folder_as_it_was(experiment, monkeypatch, capfd):
    """In this process, where all is imported, with the signatures checked."""
    before = contents(experiment.folder)
    monkeypatch.setattr(sys, "argv", [experiment.name, "--quick"])
    runpy.run_module(f"experiments.{experiment.name}", run_name="__main__")
    assert contents(experiment.folder) == before
    assert capfd.readouterr().out


def test_a_smoke_run_in_a_process_of_its_own_is_recorded(tmp_path):
    done = command("run", "refinement", "--quick", "--state", tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert json.loads((tmp_path / "refinement.json").read_text())["code"] == 0
    assert (tmp_path / "refinement.log").stat().st_size > 0


@pytest.fixture
def made_up(tmp_path):
    """A checkout with three experiments: one that works, one that fails, one that says what it was given."""
    folder = tmp_path / "checkout" / "experiments"
    folder.mkdir(parents=True)
    for name in ("__init__.py", "__main__.py", "runner.py"):
        (folder / name).write_text((ROOT / "experiments" / name).read_text())
    for name, code in (
        ("a_works", "open('worked', 'a').write('x')"),
        ("b_fails", "print('the last words'); raise SystemExit(3)"),
        ("c_echoes", "import sys; print(sys.argv[1:])"),
    ):
        (folder / name).mkdir()
        (folder / name / "__init__.py").write_text(f'"""What {name} is about.\n\nMore."""\n')
        (folder / name / "__main__.py").write_text(code)
    (folder / "not_one").mkdir()
    return folder.parent


def test_list(made_up):
    done = command(cwd=made_up)
    assert done.returncode == 0
    lines = [line.split(maxsplit=1) for line in done.stdout.splitlines()[:3]]
    assert [name for name, _ in lines] == ["a_works", "b_fails", "c_echoes"]
    assert lines[0][1].strip() == "What a_works is about."
    assert "not_one" not in done.stdout


def test_a_failure_is_shown_and_stops_no_other(made_up, tmp_path):
    done = command("run", "--quick", "--state", tmp_path / "state", cwd=made_up)
    assert done.returncode == 1
    assert "b_fails failed with exit code 3" in done.stdout
    assert "the last words" in done.stdout
    assert (tmp_path / "state" / "c_echoes.log").read_text().strip() == "['--quick']"


def test_what_is_finished_is_skipped_until_its_code_changes(made_up, tmp_path):
    options = ("run", "a_works", "--state", tmp_path / "state")
    worked = made_up / "worked"

    def runs(*more):
        done = command(*options, *more, cwd=made_up)
        assert done.returncode == 0, done.stderr
        return len(worked.read_text()), "finished before" in done.stdout

    assert runs() == (1, False)
    assert runs() == (1, True)
    assert runs("--fresh") == (2, False)
    (made_up / "torcharm").mkdir()
    (made_up / "torcharm" / "new.py").write_text("")
    assert runs() == (3, False)


def test_a_failure_is_tried_again(made_up, tmp_path):
    for _ in range(2):
        done = command("run", "b_fails", "--state", tmp_path / "state", cwd=made_up)
        assert done.returncode == 1
        assert "finished before" not in done.stdout


def test_an_unknown_name_is_one_line(made_up, tmp_path):
    done = command("run", "d_missing", "--state", tmp_path / "state", cwd=made_up)
    assert done.returncode == 2
    assert done.stderr.splitlines() == ["experiments: names: must be among a_works, b_fails, c_echoes, got d_missing"]


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGINT to send")
def test_interrupted_it_keeps_what_is_finished_and_ends_what_runs(made_up, tmp_path):
    import signal

    (made_up / "experiments" / "b_fails" / "__main__.py").write_text(
        "import os, time; open('started', 'w').write(str(os.getpid())); time.sleep(60)"
    )
    process = subprocess.Popen(
        [sys.executable, "-m", "experiments", "run", "--state", str(tmp_path / "state")],
        cwd=made_up,
        env=os.environ | {"PYTHONPATH": str(made_up)},
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # tests in the background ignore it
    )
    started = made_up / "started"
    for _ in range(600):
        if started.is_file() and started.read_text():
            break
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=30)
    assert process.returncode == 130
    assert "1 of 3 are done" in output
    assert (tmp_path / "state" / "a_works.json").is_file()
    assert not (tmp_path / "state" / "b_fails.json").exists()
    with pytest.raises(ProcessLookupError):
        os.kill(int(started.read_text()), 0)
