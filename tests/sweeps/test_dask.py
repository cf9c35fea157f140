"""Sweeps on a Dask cluster of this machine."""

import subprocess
import sys

import pytest
from sweep_cases import contents, small_sweep
from test_sweep_command import STUDY, invoke

distributed = pytest.importorskip("distributed", reason="dask[distributed] is not installed")


class Cluster:
    """A Dask scheduler and workers of one thread, each a process that is started as on a cluster: `dask scheduler`."""

    def __init__(self, folder, workers):
        self.file = folder / "scheduler.json"
        self.scheduler = self.started("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")
        self.workers = [
            self.started("worker", "--nthreads", "1", "--no-nanny", "--no-dashboard") for _ in range(workers)
        ]

    def started(self, *command):
        where = ("--scheduler-file", str(self.file))
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": self.file.parent}
        return subprocess.Popen([sys.executable, "-m", "dask", *command, *where], **quiet)

    def ready(self):
        """The scheduler's address, once all workers are there that were not killed."""
        with distributed.Client(scheduler_file=str(self.file), timeout=60) as client:
            client.wait_for_workers(sum(worker.poll() is None for worker in self.workers), timeout=60)
            return client.scheduler.address

    def end(self):
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    found = Cluster(tmp_path_factory.mktemp("cluster"), 3)
    try:
        yield found
    finally:
        found.end()


@pytest.mark.slow
def test_a_cluster_of_which_a_worker_is_killed_leaves_the_same_bytes(tmp_path, cluster):
    small_sweep(tmp_path / "here", 20_000, shard_size=250)
    address, killed = cluster.ready(), []

    def kill(progress):
        if progress.finished >= 500 and not killed:
            killed.append(cluster.workers[1].pid)
            cluster.workers[1].kill()

    found = small_sweep(tmp_path / "there", 20_000, shard_size=250, workers=None, executor=address, callback=kill)
    assert killed
    assert found.complete
    assert cluster.workers[1].wait() < 0
    assert contents(tmp_path / "there") == contents(tmp_path / "here")


@pytest.mark.slow
def test_the_command_takes_an_address_and_python_a_client(tmp_path, cluster):
    study = tmp_path / "study.toml"
    study.write_text(STUDY)
    address = cluster.ready()
    command = (study, "--out", tmp_path / "run", "--arm", "two", "--count", 200, "--metrics", "absolute")
    assert "200 of 200 designs" in invoke(*command, "--scheduler", address)
    with distributed.Client(address) as client:
        assert small_sweep(tmp_path / "other", 200, workers=None, executor=client).complete


def test_a_scheduler_that_does_not_answer_is_a_sentence(tmp_path, monkeypatch):
    monkeypatch.setattr("torcharm.sweeps.executors.ANSWER", 0.5)
    with pytest.raises(ValueError, match=r"^executor: no Dask scheduler answers at tcp://127.0.0.1:9"):
        small_sweep(tmp_path, 200, workers=None, executor="tcp://127.0.0.1:9")
    assert not list(tmp_path.iterdir())  # nothing was begun


def test_packages_that_are_missing_are_a_sentence(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ValueError, match=r"needs the package pyarrow.*pip install 'torcharm\[sweep\]'"):
        small_sweep(tmp_path)
