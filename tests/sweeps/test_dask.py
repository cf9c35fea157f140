"""Sweeps on a Dask cluster of this machine."""

import pytest
from sweep_cases import contents, small_sweep
from test_sweep_command import STUDY, invoke

distributed = pytest.importorskip("distributed", reason="dask[distributed] is not installed")


@pytest.fixture(scope="module")
def cluster():
    options = {"n_workers": 2, "threads_per_worker": 1, "processes": True, "dashboard_address": ":0"}
    with distributed.LocalCluster(**options) as found:
        yield found


def test_a_cluster_of_which_a_worker_is_killed_leaves_the_same_bytes(tmp_path, cluster):
    small_sweep(tmp_path / "here", 20_000, shard_size=250)
    killed = []

    def kill(progress):
        if progress.finished >= 500 and not killed:
            killed.append(next(iter(cluster.workers.values())))
            killed[0].process.process._process.kill()

    found = small_sweep(
        tmp_path / "there", 20_000, shard_size=250, workers=None, executor=cluster.scheduler_address, callback=kill
    )
    assert killed
    assert found.complete
    assert contents(tmp_path / "there") == contents(tmp_path / "here")


def test_a_client_is_taken_too(tmp_path, cluster):
    with distributed.Client(cluster) as client:
        assert small_sweep(tmp_path, 200, workers=None, executor=client).complete


def test_the_command_takes_an_address(tmp_path, cluster):
    study = tmp_path / "study.toml"
    study.write_text(STUDY)
    out = tmp_path / "run"
    address = cluster.scheduler_address
    command = (study, "--out", out, "--arm", "two", "--count", 200, "--metrics", "absolute", "--scheduler", address)
    assert "200 of 200 designs" in invoke(*command)


def test_a_scheduler_that_does_not_answer_is_a_sentence(tmp_path, monkeypatch):
    monkeypatch.setattr("torcharm.sweeps.executors.ANSWER", 0.5)
    with pytest.raises(ValueError, match=r"^executor: no Dask scheduler answers at tcp://127.0.0.1:9"):
        small_sweep(tmp_path, 200, workers=None, executor="tcp://127.0.0.1:9")


def test_packages_that_are_missing_are_a_sentence(tmp_path, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ValueError, match=r"needs the package pyarrow.*pip install 'torcharm\[sweep\]'"):
        small_sweep(tmp_path)
