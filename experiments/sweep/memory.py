"""What a sweep takes up: memory of its processes, bytes of its files."""

from contextlib import suppress
from multiprocessing import active_children
from pathlib import Path

from torcharm.sweeps import SweepResult


def most_memory() -> float:
    """The most that a process of the pool has held so far, without a pool this one [MiB]; 0 where Linux is not."""
    found = [0.0]
    for process in [str(child.pid) for child in active_children()] or ["self"]:
        with suppress(OSError):  # one that has just ended
            status = Path(f"/proc/{process}/status").read_text()
            found += [int(line.split()[1]) / 1024 for line in status.splitlines() if line.startswith("VmHWM")]
    return max(found)


def bytes_of(found: SweepResult) -> int:
    """Of all files of a sweep."""
    return sum(path.stat().st_size for path in found.folder.rglob("*") if path.is_file())
