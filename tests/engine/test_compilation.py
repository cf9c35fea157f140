"""Machine code on disk: where it is kept, and that it is of these sources."""

import os
import subprocess
import sys
from pathlib import Path

import torcharm
from torcharm.engine import compilation

PACKAGE = Path(torcharm.__file__).parent


def test_where_code_is_kept(tmp_path, monkeypatch):
    told, blocked = tmp_path / "told", tmp_path / "file"
    blocked.write_text("")
    for value, home, wanted in ((told, tmp_path, told), (blocked, tmp_path, None), (blocked, blocked, None)):
        monkeypatch.setenv("NUMBA_CACHE_DIR", str(value))
        monkeypatch.setenv("HOME", str(home))
        compilation.folder_of_code.cache_clear()
        folder = compilation.folder_of_code()
        assert folder is not None  # beside the sources, if nowhere else
        assert folder.endswith(f"torcharm-{compilation.version_of_sources()}")
        assert wanted is None or folder.startswith(str(wanted))
    with monkeypatch.context() as patch:  # nowhere to write
        patch.setattr(compilation.Path, "mkdir", refuse)
        compilation.folder_of_code.cache_clear()
        assert compilation.folder_of_code() is None
        square = compilation.kernel(lambda x: x * x)
        assert square(3.0) == 9.0
    compilation.folder_of_code.cache_clear()


def refuse(*_, **__):
    raise PermissionError("read-only")


def test_code_on_disk_is_of_these_sources(tmp_path, monkeypatch):
    """A change of what a kernel calls, or of a constant, makes it another."""
    before = compilation.version_of_sources()
    copy = tmp_path / "torcharm"
    (copy / "engine").mkdir(parents=True)
    for path in ("engine/compilation.py", "engine/forces.py"):
        (copy / path).write_bytes((PACKAGE / path).read_bytes())
    monkeypatch.setattr(compilation, "__file__", str(copy / "engine/compilation.py"))
    versions = [before]
    for text in ("", "# changed"):
        compilation.version_of_sources.cache_clear()
        (copy / "engine" / "forces.py").write_text(text)
        versions.append(compilation.version_of_sources())
    compilation.version_of_sources.cache_clear()
    assert len(set(versions)) == 3


def test_a_later_process_compiles_nothing(tmp_path):
    """Also of kernels that hold parts made for a dimension, which numba tells apart by names; and who waits is told."""
    told = []
    for _ in range(2):
        screen, terminal = os.openpty()
        env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
        subprocess.run([sys.executable, "-c", EVALUATE], env=env, check=True, stderr=terminal)
        os.write(terminal, b"end")
        told.append(os.read(screen, 10000).decode())
        os.close(screen)
        os.close(terminal)
        kept = sorted(path.name for path in tmp_path.rglob("*.nbc"))
        assert len(kept) == len({name.split("-")[0] for name in kept}) > 0
    assert told[0].startswith("torcharm compiles its engine, once: about ")
    assert told[0].count("torcharm") == 1
    assert told[1] == "end"


EVALUATE = """
import torcharm as ta
ta.evaluate(ta.antagonistic_arm(), ta.Task(ta.affine_curvature(1.0, 1.5), [3.0, -2.0, 0.5]), "absolute")
"""
