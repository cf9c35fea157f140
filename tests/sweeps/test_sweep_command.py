"""The command `torcharm sweep`, run as a person runs it."""

import os
import re
import signal
import subprocess
import sys
import time

import pytest
from typer.testing import CliRunner

import torcharm as ta
from torcharm.cli.app import app

STUDY = """
name = "sweep"
[[arm]]
name = "one"
kind = "antagonistic"
[[arm]]
name = "two"
kind = "bellows"
[[task]]
name = "bend"
shape = { kind = "affine", slope = 0.0, intercept = 1.0, nodes = 4 }
loads = { count = 2, scale = [4, 4, 0.4] }
[optimise]
free = ["radii"]
spacing = "10 mm"
seed = 3
in_range = false
"""


@pytest.fixture
def study(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(STUDY)
    return path


def invoke(*args, code=0):
    result = CliRunner().invoke(app, ["sweep", *map(str, args)], env={"COLUMNS": "80"})
    assert result.exit_code == code, result.output
    return result.stdout if code == 0 else result.output


def test_a_study_is_swept_and_shown_again(study, tmp_path):
    out = tmp_path / "run"
    command = (study, "--out", out, "--arm", "one", "--count", "3e2", "--metrics", "absolute", "--workers", 1)
    said = invoke(*command)
    found = ta.open_sweep(out)
    assert found.complete
    assert f"300 of 300 designs, {found.feasible} (" in said
    assert "absolute" in said
    best = found.best(10, "absolute")
    for value in (best.indices[0], f"{best['radii'][0, 3] * 1e3:.1f}", f"{best['size_mm'][-1]:.1f}"):
        assert str(value) in said
    assert "No other is both smaller and better by absolute [N]" in said
    assert invoke("--show", out) == said == invoke(*command)
    assert re.search(r"\n +\d+ .*\n", invoke("--show", out, "--by", "size", "--rows", 2))
    picture = tmp_path / "sweep.svg"
    assert "Wrote" in invoke("--show", out, "--figure", picture)
    assert "<svg" in picture.read_text()


def test_parts_of_a_sweep(study, tmp_path):
    out = tmp_path / "run"
    command = (study, "--out", out, "--arm", "two", "--count", "200", "--metrics", "absolute", "--workers", 1)
    said = invoke(*command, "--shard", "2/2")
    assert re.search(r"\d of \d+ shards are missing: the same command goes on", said)
    assert "200 of 200 designs" in invoke(*command, "--shard", "1/2")


@pytest.mark.parametrize(
    ("args", "message"),
    [
        ((), "STUDY: must be given"),
        (("STUDY",), "--out: must be given"),
        (("STUDY", "--out", "OUT"), "--arm: must name one of the study's arms: one, two"),
        (("STUDY", "--out", "OUT", "--arm", "tow"), "--arm: must be one of one, two, got 'tow'; did you mean two?"),
        (("STUDY", "--out", "OUT", "--count", "1.5"), "--count: must be a whole number of at least 1"),
        (("STUDY", "--out", "OUT", "--count", "9", "--levels", "3"), "--count: must be left out where --levels"),
        (("STUDY", "--out", "OUT", "--shard", "3"), "--shard: must be K/N"),
        (("STUDY", "--out", "OUT", "--arm", "one", "--metrics", "speed"), "metrics: must be one of absolute"),
        (("STUDY", "--out", "OUT", "--arm", "one", "--reduce", "middle"), "reduce: must be 'mean', 'worst'"),
        (("STUDY", "--show", "OUT"), "--show: stands alone"),
        (("--show", "OUT"), "holds no sweep"),
    ],
)
def test_a_mistake_is_one_line(study, tmp_path, args, message, capfd):
    places = {"STUDY": study, "OUT": tmp_path / "run"}
    output = invoke(*(places.get(one, one) for one in args), code=2) + capfd.readouterr().err
    assert message in " ".join(output.split())


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="Ctrl-C is sent as POSIX does")
def test_ctrl_c_keeps_what_is_finished_and_says_how_to_go_on(study, tmp_path):
    out = tmp_path / "run"
    command = [sys.executable, "-m", "torcharm.cli", "sweep", study, "--out", out, "--arm", "one", "--count", "5e5"]
    process = subprocess.Popen(
        [*map(str, command), "--metrics", "absolute", "--workers", "2"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # tests in the background ignore it
    )
    until = time.monotonic() + 200
    while not list(out.glob("shards/shard-*")):
        assert process.poll() is None, process.stderr.read().decode()
        assert time.monotonic() < until
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    said, errors = process.communicate(timeout=200)
    assert process.returncode == 130, errors
    assert b"the same command goes on" in said
    assert b"interrupted" in errors
    assert ta.open_sweep(out).finished > 0
