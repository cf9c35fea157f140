"""What large sweeps take: designs a second on one process and on two, memory, bytes; and kills that cost nothing.

`python -m experiments.sweep.scale` prints a table and writes scale.csv beside this file; `--largest` adds 10⁸ designs.
`python -m experiments.sweep.scale --kills` kills sweeps and their workers at random moments, and compares bytes.
"""

import argparse
import hashlib
import random
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import torch
from rich.console import Console
from rich.table import Table

import torcharm as ta
from experiments.design_optimisation.scenes import ARMS, tasks_of
from experiments.rows import read_rows, write_rows
from experiments.sweep.memory import bytes_of, most_memory
from torcharm.sweeps.progress import SweepProgress

HERE = Path(__file__).parent
SPACE = ta.DesignSpace(bounds={"radii": (-0.1, 0.1), "length": (0.25, 0.75)}, spacing=0.01, in_range=False)
"""Without the condition on strains most of the box is allowed, and evaluated."""
PLANS = [
    (*what, processes) for what in (("absolute", 10_000_000), ("predicted_error", 100_000)) for processes in (1, 2)
]
LARGEST = ("absolute", 100_000_000, 2)
KILLED = ("absolute", 3_000_000)
SMALL_SHARD = 2**15
"""Of a sweep to be killed: so many shards that every moment finds some finished and some not."""
KILLS = 5
"""Of the whole sweep, and as many of a worker."""


@dataclass(frozen=True)
class Scale:
    """One sweep of the antagonistic arm's space on the first of the paper's loads of the shape (1, 1.5).

    Attributes:
        metric: that was asked for.
        designs, feasible: how many were drawn, and how many of them the space allows and were evaluated.
        processes: of the sweep.
        seconds: it took, the start of its processes included.
        rate: designs a second once all had started: the slope of a line through how many were finished when.
        bytes_a_design: on disk.
        worker_mib: most memory that a process held.
    """

    metric: str
    designs: int
    feasible: int
    processes: int
    seconds: float
    rate: float
    bytes_a_design: float
    worker_mib: int


def main() -> None:
    """Measure what is not known yet, or kill."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--largest", action="store_true", help="10⁸ designs, too: some minutes")
    parser.add_argument("--fresh", action="store_true", help="measure again what scale.csv holds")
    parser.add_argument("--kills", action="store_true", help="kill sweeps and workers instead, and compare bytes")
    parser.add_argument("--run", metavar="FOLDER", help=argparse.SUPPRESS)
    options = parser.parse_args()
    torch.set_num_threads(1)
    if options.run:
        run(*KILLED, 2, options.run, shard_size=SMALL_SHARD)
    elif options.kills:
        kill()
    else:
        measure(options.largest, options.fresh)


def run(metric: str, designs: int, processes: int, folder: str, **options: Any) -> "ta.SweepResult":
    """A sweep of the scene."""
    task = tasks_of("(1, 1.5)", 1)
    arm = ARMS["antagonistic"]
    return ta.sweep(arm, SPACE, task, designs, out=folder, metrics=metric, workers=processes, **options)


def measure(largest: bool, fresh: bool) -> None:
    """A row a plan."""
    known: list[Scale] = [] if fresh else read_rows(HERE / "scale.csv", Scale)
    for plan in (*PLANS, *([LARGEST] if largest else [])):
        if plan not in [(row.metric, row.designs, row.processes) for row in known]:
            known.append(measured(*plan))
            write_rows(HERE / "scale.csv", known)
    table = Table(title="sweeps of the antagonistic arm", title_justify="left")
    for heading in ("metric", "designs", "feasible", "processes", "s", "designs/s", "bytes a design", "MiB a worker"):
        table.add_column(heading, justify="right")
    for row in known:
        table.add_row(*(f"{value:,}" if isinstance(value, int) else str(value) for value in vars(row).values()))
    Console(width=140).print(table)


def measured(metric: str, designs: int, processes: int) -> Scale:
    """One plan, in a folder of its own."""
    with tempfile.TemporaryDirectory() as folder:
        held, when, finished = [0.0], [0.0], [0]

        def watch(progress: SweepProgress) -> None:
            held.append(most_memory())
            if progress.finished > finished[-1]:
                when.append(time.perf_counter())
                finished.append(progress.finished)

        begun = time.perf_counter()
        found = run(metric, designs, processes, folder, callback=watch)
        seconds = round(time.perf_counter() - begun, 1)
        size = round(bytes_of(found) / designs, 2)
        rate = round(float(np.polyfit(np.array(when[1:]) - when[1], finished[1:], 1)[0]))
        return Scale(metric, designs, found.feasible, processes, seconds, rate, size, round(max(held)))


def kill() -> None:
    """Sweeps killed at random moments and taken up again, and one that loses workers, against an undisturbed one."""
    moments = random.Random(7)
    with tempfile.TemporaryDirectory() as place:
        undisturbed, worker = Path(place, "undisturbed"), Path(place, "worker")
        assert started(undisturbed).wait() == 0
        shards = shards_in(undisturbed)
        for number in range(KILLS):
            folder = Path(place, f"sweep {number}")
            process = started(folder)
            wait_for(folder, moments.randrange(1, shards - 10), process)
            time.sleep(moments.uniform(0.0, 0.3))
            process.kill()
            process.wait()
            print(f"sweep killed at {shards_in(folder)} of {shards} shards", end=", ")
            assert started(folder).wait() == 0
            print("the same bytes" if digest(folder) == digest(undisturbed) else "bytes DIFFER", flush=True)
        process = started(worker)
        for least in sorted(moments.sample(range(1, shards - 10), KILLS)):
            wait_for(worker, least, process)
            time.sleep(moments.uniform(0.0, 0.3))
            moments.choice(workers_of(process)).kill()
            print(f"worker killed at {shards_in(worker)} of {shards} shards", flush=True)
        assert process.wait() == 0
        print("the same bytes" if digest(worker) == digest(undisturbed) else "bytes DIFFER")


def started(folder: Path) -> "subprocess.Popen[bytes]":
    """A process that sweeps."""
    return subprocess.Popen([sys.executable, "-W", "ignore", "-m", "experiments.sweep.scale", "--run", str(folder)])


def shards_in(folder: Path) -> int:
    """How many are finished."""
    return len(list(folder.glob("shards/shard-*.parquet")))


def wait_for(folder: Path, least: int, process: "subprocess.Popen[bytes]") -> None:
    """Until so many shards are finished, and workers are there."""
    while process.poll() is None and (shards_in(folder) < least or not workers_of(process)):
        time.sleep(0.01)


def workers_of(process: "subprocess.Popen[bytes]") -> list[psutil.Process]:
    """Its workers."""
    return [one for one in psutil.Process(process.pid).children() if "spawn_main" in " ".join(one.cmdline())]


def digest(folder: Path) -> str:
    """Of the names and bytes of all results, and of what says what they are."""
    found = hashlib.sha256()
    for path in sorted(path for path in folder.rglob("*") if path.suffix in (".parquet", ".json")):
        found.update(str(path.relative_to(folder)).encode() + path.read_bytes())
    return found.hexdigest()


if __name__ == "__main__":
    main()
