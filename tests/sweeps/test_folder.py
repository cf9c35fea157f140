"""A sweep's folder: resumed after whatever ended the sweep, and never mixed with another."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import torch
from sweep_cases import SPACE, arm, contents, small_sweep, task

import torcharm as ta

SCRIPT = """
import sys
sys.path.insert(0, {here!r})
from sweep_cases import small_sweep
if __name__ == "__main__":
    small_sweep(sys.argv[1], 20_000, workers=int(sys.argv[2]), shard_size=250)
"""


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("undisturbed") / "run"
    small_sweep(folder, 20_000, shard_size=250)
    return contents(folder)


def started(tmp_path, folder, workers):
    script = tmp_path / "run_sweep.py"
    script.write_text(SCRIPT.format(here=str(Path(__file__).parent)))
    return subprocess.Popen([sys.executable, script, str(folder), str(workers)], stderr=subprocess.PIPE)


def wait_for_shards(folder, process, least=3):
    until = time.monotonic() + 120
    while len(list(folder.glob("shards/shard-*"))) < least:
        assert process.poll() is None, process.stderr.read().decode()
        assert time.monotonic() < until
        time.sleep(0.005)


def children_of(process):
    psutil = pytest.importorskip("psutil")
    return [one for one in psutil.Process(process.pid).children() if "spawn_main" in " ".join(one.cmdline())]


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="kill -9 is of POSIX")
def test_a_sweep_killed_with_its_processes_is_resumed_to_the_same_bytes(tmp_path, undisturbed):
    folder = tmp_path / "run"
    process = started(tmp_path, folder, 2)
    wait_for_shards(folder, process)
    workers = children_of(process)
    process.send_signal(signal.SIGKILL)
    process.wait()
    begun = set(contents(folder)) - {"summary.parquet"}
    assert len(begun) < 81
    for worker in workers:  # they end with the process that started them
        worker.wait(30)
    small_sweep(folder, 20_000, shard_size=250)
    assert contents(folder) == undisturbed
    assert not list(folder.rglob(".torcharm-*"))


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="kill -9 is of POSIX")
def test_shards_of_a_killed_process_are_done_again(tmp_path, undisturbed):
    folder = tmp_path / "run"
    process = started(tmp_path, folder, 2)
    wait_for_shards(folder, process)
    children_of(process)[0].kill()
    assert process.wait(300) == 0, process.stderr.read().decode()
    assert contents(folder) == undisturbed


def test_a_script_without_a_main_guard_is_told_so(tmp_path):
    script = tmp_path / "unguarded.py"
    text = SCRIPT.format(here=str(Path(__file__).parent)).replace('if __name__ == "__main__":', "if True:")
    script.write_text(f"from torcharm.sweeps import executors\nexecutors.ATTEMPTS = 1\n{text}")
    command = [sys.executable, script, str(tmp_path / "run"), "2"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode != 0
    assert "outside of `if __name__ == '__main__':`" in done.stderr


def test_an_arm_that_asks_for_gradients_is_swept(tmp_path):
    radius = torch.tensor(0.05, dtype=torch.float64, requires_grad=True)
    given = ta.antagonistic_arm(2 * radius / 2, 0.015, 0.5)
    options = {"metrics": ("absolute", "relative"), "seed": 3, "shard_size": 32}
    with ThreadPoolExecutor(1) as pool:  # to which designs go in bytes, as to processes
        ta.sweep(given, SPACE, task(), 64, out=tmp_path / "a", executor=pool, **options)
    plain = ta.antagonistic_arm(0.05, 0.015, 0.5)
    ta.sweep(plain, SPACE, task(), 64, out=tmp_path / "b", workers=1, **options)
    assert contents(tmp_path / "a") == contents(tmp_path / "b")


def test_an_executor_of_ones_own(tmp_path, undisturbed):
    with ThreadPoolExecutor(2) as pool:
        small_sweep(tmp_path, 20_000, shard_size=250, workers=None, executor=pool)
    assert contents(tmp_path) == undisturbed


def test_an_executor_that_loses_its_workers_is_told_and_not_started_again(tmp_path):
    def lose():
        raise MemoryError

    with (
        ThreadPoolExecutor(1, initializer=lose) as pool,
        pytest.raises(ValueError, match=r"^executor: has lost its workers; finished shards are kept"),
    ):
        small_sweep(tmp_path, 200, workers=None, executor=pool)
    assert small_sweep(tmp_path, 200).complete


def test_damaged_and_deleted_shards_are_computed_again(tmp_path):
    small_sweep(tmp_path, 200)
    before = contents(tmp_path)
    (tmp_path / "shards/shard-000001.parquet").write_bytes(b"PAR1")
    (tmp_path / "shards/shard-000003.parquet").unlink()
    assert ta.open_sweep(tmp_path).finished == 136
    small_sweep(tmp_path, 200)
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"count": 300}, r"count \(200 there, 300 given\)"),
        ({"seed": 4}, r"seed \(3 there, 4 given\)"),
        ({"metrics": "absolute"}, "metrics"),
        ({"reduce": "worst"}, "reduce"),
        ({"tolerance": 0.01}, "tolerance"),
        ({"power": 2}, r"power \(1 there, 2 given\)"),
        ({"shard_size": 64}, r"shard_size \(32 there, 64 given\)"),
    ],
)
def test_another_sweep_is_refused_and_named(tmp_path, options, named):
    small_sweep(tmp_path, 200)
    before = contents(tmp_path)
    with pytest.raises(ValueError, match=rf"^out: .* holds another sweep, whose {named} differs"):
        small_sweep(tmp_path, **({"count": 200} | options))
    assert contents(tmp_path) == before


def test_what_means_the_same_is_the_same_sweep(tmp_path):
    small_sweep(tmp_path, 200)
    before = contents(tmp_path)
    assert small_sweep(tmp_path, 200, weights=(1, 1), metrics=["relative", "absolute"], reduce={}).complete
    assert contents(tmp_path) == before


def test_another_arm_task_or_space_is_refused_and_named(tmp_path):
    small_sweep(tmp_path, 200)
    options = {"metrics": ("absolute", "relative"), "workers": 1, "seed": 3}
    other = ta.Task(ta.affine_curvature(1.0, 1.1, nodes=4), task().tip_load)
    wider = ta.DesignSpace(free="radii", spacing=0.01, in_range=False, bounds={"radii": (-0.2, 0.2)})
    for own, space, what, named in (
        (ta.antagonistic_arm(0.06), SPACE, task(), "arm"),
        (arm(), SPACE, other, "task"),
        (arm(), wider, task(), "space"),
    ):
        with pytest.raises(ValueError, match=f"holds another sweep, whose {named} differs"):
            ta.sweep(own, space, what, 200, out=tmp_path, **options)


def test_two_sweeps_in_one_folder_are_refused(tmp_path):
    from torcharm.sweeps.manifest import locked

    small_sweep(tmp_path, 100)
    with locked(tmp_path, None):
        for part in (None, (1, 2)):
            with pytest.raises(ValueError, match="runs in this folder already"):
                small_sweep(tmp_path, 100, shard=part)
    with locked(tmp_path, (1, 2)):
        with pytest.raises(ValueError, match=r"part 1/2 of the sweep runs in this folder already"):
            small_sweep(tmp_path, 100, shard=(1, 2))
        with pytest.raises(ValueError, match="runs in this folder already"):
            small_sweep(tmp_path, 100)
        small_sweep(tmp_path, 100, shard=(2, 2))
    small_sweep(tmp_path, 100)


def test_a_folder_that_cannot_be_written_is_refused_at_once(tmp_path, monkeypatch):
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(ValueError, match=r"^out: .*file/run: cannot be written, Not a directory"):
        small_sweep(file / "run")

    def denied(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", denied)
    with pytest.raises(ValueError, match=r"^out: .*: cannot be written, Permission denied"):
        small_sweep(tmp_path / "run")


@pytest.mark.skipif(os.name != "posix", reason="limits of files are of POSIX")
def test_a_full_disk_costs_no_finished_shard(tmp_path):
    script = f"""
import resource, signal, sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from sweep_cases import small_sweep
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
def full(progress):
    if progress.finished >= 3000:
        resource.setrlimit(resource.RLIMIT_FSIZE, (500, -1))
try:
    small_sweep({str(tmp_path / "run")!r}, 20_000, shard_size=1000, callback=full)
except OSError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert "File too large" in done.stdout, done.stderr
    assert ta.open_sweep(tmp_path / "run").finished == 3000
    assert not list((tmp_path / "run").rglob(".torcharm-*"))


def test_a_folder_without_a_sweep_is_none(tmp_path):
    with pytest.raises(ValueError, match="holds no sweep"):
        ta.open_sweep(tmp_path)
    (tmp_path / "manifest.json").write_text("{}")
    with pytest.raises(ValueError, match="is no manifest that this torcharm wrote"):
        ta.open_sweep(tmp_path)
