"""`sweep`: from an arm, a space and tasks to a folder of evaluated designs."""

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from torcharm import __version__
from torcharm.attainability import CHOICES, PoseTolerance
from torcharm.attainability.evaluation import as_tolerance, check_metrics
from torcharm.design.checkpoint import describe
from torcharm.design.feasible import FeasibleDesigns, feasible_designs
from torcharm.design.space import Arm, DesignSpace, fitting_tasks
from torcharm.extras import extra
from torcharm.files import StrPath
from torcharm.inputs import check_count, check_flag, shown
from torcharm.pressure.pose_cost import PoseCost
from torcharm.sweeps.designs import DesignPoints, Indices, sampler_of
from torcharm.sweeps.executors import run_shards, usable_cores, workers_of
from torcharm.sweeps.manifest import (
    Manifest,
    Part,
    check_same,
    locked,
    make_manifest,
    remove_leftovers,
)
from torcharm.sweeps.measures import Measures, Reduce
from torcharm.sweeps.progress import Callback, SweepProgress, with_bar
from torcharm.sweeps.ranking import best_places, rankings, taken
from torcharm.sweeps.result import SweepResult
from torcharm.sweeps.shards import Job, compute_shard, measured, one_thread, shard_path
from torcharm.sweeps.summary import Summary, summary_of
from torcharm.task import Task

SHARD_SECONDS = 5.0
"""Of one worker: little is lost with a worker, and handing shards over takes no time beside it."""
MOST_SHARDS = 20_000
"""Files in a folder that file systems still list at once; beyond it shards take longer."""
LARGEST_SHARD = 2**18
"""Designs: some megabytes."""
CHUNK = 4096
"""(design, task) pairs evaluated at once: more are no faster, and take memory."""
SHARDS_A_WORKER = 4
"""At least, so that no worker is idle for long at the end."""
FIRST_TRIAL, TRIAL_SECONDS = 16, 0.2
"""Designs of a first trial, which grows until it takes so long, of the processor: others may be at work, too."""
KEEP_SECONDS = 30.0
"""Between two writings of the summary, from which a sweep that was killed goes on, or is shown while it runs."""


def sweep(
    arm: Arm,
    space: DesignSpace | None,
    task: Task | Sequence[Task],
    count: int | None = None,
    *,
    out: StrPath,
    metrics: str | Sequence[str] = CHOICES,
    reduce: Reduce | Mapping[str, Reduce] = "mean",
    sampling: str = "sobol",
    levels: int | Sequence[int] | None = None,
    seed: int = 0,
    tolerance: PoseTolerance | float | None = None,
    weights: tuple[float, float] = (1.0, 1.0),
    power: int = 1,
    pose_cost: PoseCost | None = None,
    workers: int | None = None,
    executor: Any = None,
    shard: Part | None = None,
    shard_size: int | None = None,
    progress: bool | None = None,
    callback: Callback | None = None,
) -> SweepResult:
    """Evaluate a whole space of designs on tasks, on all cores, and keep the results in a folder.

    Design i follows from arm, space, seed and i. Designs that the space does not allow (order, spacing, strains) are
    counted and not evaluated. Results are written in shards, files of Parquet that take a worker some seconds each,
    whole or not at all: called again with the same arguments, after whatever ended it, a sweep does what is missing,
    and its results are to the byte those of an undisturbed run on such a machine. Ctrl-C finishes the shards
    that have begun and returns what there is.

    A script that uses several processes must call this under `if __name__ == "__main__":`.

    Args:
        arm: a design, or a batch of such, that the space is of; in the plane or in space, or segments in series.
        space: what changes, and how far; None frees radii and lengths.
        task: tasks of any batch shape, or several such.
        count: designs, up to 2³⁰; may be left out of a grid.
        out: the folder, made if it is not there. Workers on other machines must see it by the same name.
        metrics: which of "absolute", "relative", "predicted_error" to compute, as in `evaluate`. Sets cost some
            microseconds a design and load, the predicted error some hundred.
        reduce: what becomes of a metric over all tasks: "mean", "worst", or a quantile as 0.9; or a mapping with one of
            these for some of tip_error, shape_error, absolute and relative. An error counts as the length of the task's
            shape where no stable equilibrium is predicted, and unattainability as infinite where it is not known.
        sampling: "sobol", scrambled points that fill the space evenly, or "grid".
        levels: of a grid, for all free values or for each.
        seed: of the scrambling.
        tolerance, weights, power, pose_cost: as in `evaluate`.
        workers: processes of this machine; None is one for each core. One computes in this process.
        executor: instead of these an executor of concurrent.futures, a Dask client, or the address of a Dask scheduler,
            whose workers must have torcharm installed.
        shard: (k, n) computes only the k-th of n parts, counted from 1, as for the jobs of a batch queue: they may run
            in any order or at once, on one folder.
        shard_size: designs in a shard; None finds it out by a short trial. It is part of what the sweep is.
        progress: whether to show a bar, with the rate, the time left and the best so far; None shows one on a terminal.
        callback: is told the `SweepProgress` twice a second; returning True stops.

    Raises:
        ValueError: an argument is none of those allowed; the folder holds another sweep (the message says what
            differs), cannot be written, or another process is at it; a package is missing; workers were lost again and
            again.
        OSError: a file cannot be written, as where the disk is full: what is finished is kept.

    Example:
        >>> arm, task = ta.bellows_arm(), ta.Task(ta.constant_curvature(0.5), tip_load=[1.0, 0.0, 0.0])
        >>> found = ta.sweep(arm, ta.DesignSpace("radii"), task, 64, out=folder, metrics="absolute", workers=1)
        >>> found.best(1, "absolute")["radii"].round(3).tolist()  # of 64 designs [m]
        [[-0.097, -0.085, 0.008, 0.077]]
    """
    for name in ("pyarrow", "filelock"):
        extra(name, "sweep")
    space = DesignSpace() if space is None else space
    if not isinstance(space, DesignSpace):
        raise ValueError(f"space: must be a DesignSpace, got {shown(space)}")
    tasks = fitting_tasks(arm, task)
    measures = Measures(
        check_metrics(metrics),
        reduce,
        {"tolerance": as_tolerance(tolerance), "weights": weights, "power": power, "pose_cost": pose_cost},
    )
    check_part(shard)
    if shard_size is not None:
        check_count("shard_size", shard_size, 1)
    if progress is not None:
        check_flag("progress", progress)
    designs = feasible_designs(space, arm, tasks)
    sampler, number = sampler_of(sampling, designs.dimension, count, levels, seed)
    asked = {"space": space, "count": number, "sampling": sampling, "levels": levels, "seed": seed}
    asked |= {"metrics": measures.metrics, "reduce": measures.reduce, **measures.options}
    problem = {"torcharm": __version__} | describe(arm, arm.actuators, tasks, **asked)
    folder = Path(out).absolute()
    with workers_of(executor, workers) as crew, locked(folder, shard):
        parts = shard[1] if shard else workers or usable_cores()
        points = DesignPoints(designs.free, sampler, designs.order)
        decide = partial(_decided, problem, designs, points, number, tasks, measures, shard_size, parts)
        manifest = make_manifest(folder, designs.arm, decide)
        check_same(out, manifest, problem, shard_size)
        job = Job(str(folder), manifest, designs, tasks, measures)
        with with_bar(progress, callback) as watch:
            run = _Run(folder, manifest, shard, watch)
            complete = run_shards(crew, partial(compute_shard, job), run.missing, run.finished, run.watch)
        # Ctrl-C may have come while a shard was taken up.
        summary = run.summary if complete else summary_of(folder, manifest)
        run.keep(summary)
        if shard is None and complete:
            remove_leftovers(folder)  # of workers that were lost on the way
    return SweepResult(folder, manifest, summary, designs.arm, interrupted=not complete)


class _Run:
    """One run of a sweep, or of a part of it: what is missing, and what it has found."""

    def __init__(self, folder: Path, manifest: Manifest, part: Part | None, callback: Callback) -> None:
        self.folder, self.manifest, self.part, self.callback = folder, manifest, part, callback
        self.summary = summary_of(folder, manifest)
        first, step = (1, 1) if part is None else part
        mine = range(first - 1, manifest.shards, step)
        self.missing = [shard for shard in mine if shard not in self.summary.shards]
        self.begun = self.kept = time.monotonic()
        self.count = sum(map(self._designs, mine))
        self.done = self.before = self.count - sum(map(self._designs, self.missing))

    def _designs(self, shard: int) -> int:
        return self.manifest.first_of(shard + 1) - self.manifest.first_of(shard)

    def finished(self, shard: int) -> None:
        """Take up a shard."""
        if not self.summary.add(shard_path(self.folder, shard)) and shard not in self.summary.shards:
            raise ValueError(
                f"out: {self.folder}: shard {shard} was finished by a worker and is not there: workers on other "
                "machines must see the folder by the same name"
            )
        self.done += self._designs(shard)
        if time.monotonic() - self.kept > KEEP_SECONDS:
            self.keep(self.summary)

    def keep(self, summary: Summary) -> None:
        """Write a summary; jobs that compute parts leave that to whoever opens the sweep."""
        if self.part is None:
            summary.keep(self.folder)
        self.kept = time.monotonic()

    def watch(self) -> bool:
        """Tell how far it has come; whether to stop."""
        rate = (self.done - self.before) / max(time.monotonic() - self.begun, 1e-9)
        left = (self.count - self.done) / rate if rate else np.inf
        by = rankings((*self.manifest.numbers, *self.manifest.counts))[0]
        best, design = np.inf, -1
        if self.summary.rows:
            found = taken(self.summary.rows, best_places(self.summary.rows, by, 1))
            if len(found[by]):
                best, design = float(found[by][0]), int(found["design"][0])
        return bool(self.callback(SweepProgress(self.done, self.count, rate, left, best, by, design)))


def check_part(part: Part | None) -> None:
    """Raise a ValueError unless it is (k, n) with k from 1 to n, or None."""
    if part is None:
        return
    good = isinstance(part, (tuple, list)) and len(part) == 2 and all(isinstance(number, int) for number in part)
    if not good or not 1 <= part[0] <= part[1]:
        raise ValueError(f"shard: must be (k, n) with k from 1 to n, got {shown(part)}")


def _decided(
    problem: Mapping[str, str],
    designs: FeasibleDesigns,
    points: DesignPoints,
    count: int,
    tasks: tuple[Task, ...],
    measures: Measures,
    shard_size: int | None,
    parts: int,
) -> Manifest:
    """The manifest of a sweep that has none yet."""
    loads = sum(task.batch_shape.numel() for task in tasks)
    chunk = max(1, CHUNK // loads)
    size = shard_size
    if size is None:
        seconds = _seconds_each(lambda one: measured(designs, points(one), tasks, measures, chunk), count)
        most = min(LARGEST_SHARD, max(1, count // (SHARDS_A_WORKER * parts)))
        size = 2 ** int(np.log2(max(1, min(SHARD_SECONDS / seconds, most))))
        size = max(size, -(-count // MOST_SHARDS))
    columns = measures.numbers, measures.counts
    return Manifest(dict(problem), count, size, min(chunk, size), loads, *columns, points.to_json())


def _seconds_each(measure: Callable[[Indices], object], count: int) -> float:
    """Of the processor, that a design takes, by a trial with the first ones."""
    end = min(count, FIRST_TRIAL)
    with one_thread():
        measure(np.arange(end))  # which may compile
        while True:
            begun = time.process_time()
            measure(np.arange(end))
            seconds = time.process_time() - begun
            if seconds >= TRIAL_SECONDS or end == min(count, LARGEST_SHARD):
                return max(seconds, 1e-9) / end
            end = min(4 * end, count, LARGEST_SHARD)
