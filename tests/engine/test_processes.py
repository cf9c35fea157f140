"""What works in other processes, and compiled code that they left damaged."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import torcharm as ta

FORKED = """
import multiprocessing, sys, torch
import torcharm as ta
task = ta.Task(ta.affine_curvature(-3.0, 3.0), ta.sample_loads(100))

def miss(radius):
    return float(ta.evaluate(ta.antagonistic_arm(radius, 0.015, 0.5), task).absolute.mean())

def alone():
    torch.set_num_threads(1)

if __name__ == "__main__":
    torch.set_num_threads(2)
    print(miss(0.08))
    for way, first in (("fork", alone), ("spawn", None)):
        with multiprocessing.get_context(way).Pool(1, initializer=first) as pool:
            print(pool.map_async(miss, [0.08]).get(60)[0], flush=True)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="nothing forks there")
def test_what_is_said_to_work_after_a_large_call_works(tmp_path):
    script = tmp_path / "forked.py"
    script.write_text(FORKED)
    # Other threads than the workers' own would be forked, too.
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=150, check=False)
    assert done.returncode == 0, done.stderr
    here, *others = map(float, done.stdout.split())
    assert others == [here, here]
    for text in (ta.evaluate.__doc__, (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")):
        assert '"spawn"' in text
        assert "torch.set_num_threads(1)" in text


DAMAGES = {
    "cut": lambda data: data[: len(data) // 2],
    "cut by a byte": lambda data: data[:-1],
    "emptied": lambda data: b"",
    "zeros": lambda data: bytes(len(data)),
    "a bit": lambda data: data[: len(data) // 2] + bytes([data[len(data) // 2] ^ 1]) + data[len(data) // 2 + 1 :],
    "other": lambda data: b"\x80\x04not pickled",
}


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
def test_damaged_code_is_compiled_anew(tmp_path, monkeypatch, ending):
    from torcharm.engine import compilation

    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    compilation.folder_of_code.cache_clear()
    try:

        def answer():
            function = compilation.kernel(cube)
            return function(3.0), sum(function.stats.cache_hits.values())

        assert answer() == (28.0, 0)
        assert answer() == (28.0, 1)
        for damage in DAMAGES.values():
            (path,) = tmp_path.rglob(f"*cube*.{ending}")
            path.write_bytes(damage(path.read_bytes()))
            assert answer() == (28.0, 0)  # compiled anew, and kept
            assert answer() == (28.0, 1)
    finally:
        compilation.folder_of_code.cache_clear()


def test_code_that_cannot_be_kept_runs(tmp_path, monkeypatch):
    from torcharm.engine import compilation

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    compilation.folder_of_code.cache_clear()
    try:
        function = compilation.kernel(cube)
        monkeypatch.setattr(os, "replace", full)
        assert function(2.0) == 9.0
    finally:
        compilation.folder_of_code.cache_clear()


def cube(x):
    return x**3 + 1
