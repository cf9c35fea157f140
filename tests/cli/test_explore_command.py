"""`torcharm explore`: what it says, what it refuses, and that Ctrl-C ends it."""

import os
import re
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from test_cli import mistake

ROOT = Path(__file__).parents[2]
STUDY = """
name = "small"
[[arm]]
name = "mine"
radii = [-0.03, 0.03]
length = 0.22
actuators = "bellows"
[[task]]
name = "bend"
shape = { kind = "constant", curvature = 0.1, length = 0.22, nodes = 3 }
"""


@pytest.fixture
def study(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(STUDY)
    return path


@contextmanager
def exploring(study, out, port="0"):
    """A process that serves a study; tests in the background ignore Ctrl-C, it does not."""
    pytest.importorskip("viser", reason="needs torcharm[explore]")
    command = [sys.executable, "-m", "torcharm.cli", "explore", study, "--out", out, "--port", port, "--no-open"]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "COLUMNS": "200"}
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "env": environment}
    options["preexec_fn"] = lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)
    with subprocess.Popen(command, **options) as process:
        yield process


def address(process):
    """Where a process says that it serves."""
    where = re.fullmatch(r"small: (http://127\.0\.0\.1:\d+)\n", process.stdout.readline())
    assert where is not None
    return where[1]


@pytest.mark.skipif(os.name != "posix", reason="needs signals")
def test_it_serves_until_interrupted_and_says_where_and_what_it_writes(study, tmp_path):
    pytest.importorskip("viser", reason="needs torcharm[explore]")
    from experiments.live_page.socket import Page

    out = tmp_path / "better.toml"
    taken = socket.create_server(("127.0.0.1", 0))
    port = str(taken.getsockname()[1])
    with taken, exploring(study, out, port) as process:
        assert process.stdout.readline() == f"Port {port} is in use; the page has the next one that is free.\n"
        where = address(process)
        assert process.stdout.readline() == f"Its button saves to {out}. Ctrl-C ends it.\n"
        with socket.create_connection(("127.0.0.1", int(where.rpartition(":")[2]))) as stranger:
            stranger.sendall(b"\x16\x03\x01 as https begins\r\n\r\n")
        with Page(where) as page:
            page.until(lambda: page.pictures)
            page.press("save the study")
            page.until(out.exists)
        process.send_signal(signal.SIGINT)
        assert process.stdout.read() == "Ended.\n"
        assert "Traceback" not in process.stderr.read()
        assert process.wait(120) == 0


@pytest.mark.skipif(os.name != "posix", reason="needs signals")
@pytest.mark.parametrize("after", [0.05, 0.3, 0.8])
def test_ctrl_c_amid_long_work_ends_it_as_well(study, tmp_path, after):
    pytest.importorskip("viser", reason="needs torcharm[explore]")
    from experiments.live_page.socket import Page

    with exploring(study, tmp_path / "better.toml") as process:
        with Page(address(process)) as page:
            page.until(lambda: page.pictures)
            page.press("show the workspace")
            page.until(lambda: "Looking for" in page.words)
            time.sleep(after)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=120)
        assert process.returncode == 0, errors


@pytest.fixture
def refused(study, tmp_path, monkeypatch, capsys):
    """The one line that a command with some options ends on."""

    def run(*options, plan=study):
        return mistake(monkeypatch, capsys, "explore", plan, "--out", tmp_path / "out.toml", "--no-open", *options)

    return run


def test_mistakes_are_one_line(study, tmp_path, refused):
    assert "is the study itself" in refused("--out", study)
    assert "must end in .toml" in refused("--out", tmp_path / "page.html")
    assert "does not exist" in refused("--out", tmp_path / "none" / "out.toml")
    assert "cannot be read" in refused(plan=tmp_path / "none.toml")


def test_a_host_that_is_not_this_machine_is_refused(refused):
    pytest.importorskip("viser", reason="needs torcharm[explore]")
    assert "--host: must be an address of this machine, got 192.0.2.1" in refused("--host", "192.0.2.1")


def test_without_viser_it_says_what_to_install(monkeypatch, refused):
    monkeypatch.setitem(sys.modules, "viser", None)
    assert "explore: needs the package viser, which is not installed: pip install 'torcharm[explore]'" in refused()
