"""How far a sweep has come, and a bar that shows it."""

import math
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta

from torcharm.sweeps.ranking import label


@dataclass(frozen=True)
class SweepProgress:
    """How far a sweep has come.

    Attributes:
        finished, count: designs finished, those of earlier runs included, and to be finished by this run.
        rate: designs a second in this run.
        seconds_left: at this rate; infinite before the first shard.
        best: of the first metric, as its column has it, and
        by: that column's name; `best` is infinite before a feasible design is known.
        design: the index of the best.
    """

    finished: int
    count: int
    rate: float
    seconds_left: float
    best: float
    by: str
    design: int

    def __str__(self) -> str:
        """The rate, the time left and the best so far, as they stand behind a bar."""
        words = "the first shards"
        if self.rate:
            words = f"{self.rate:,.0f} designs/s, {timedelta(seconds=round(self.seconds_left))} left"
        if math.isfinite(self.best):
            words += f", best {label(self.by)} {self.best:.4g}"
        return words


Callback = Callable[[SweepProgress], bool | None]


@contextmanager
def with_bar(shown: bool | None, callback: Callback | None) -> Iterator[Callback]:
    """A bar on the standard error, of None on a terminal alone; gives a callback that moves it on and calls another."""
    if not (sys.stderr.isatty() if shown is None else shown):
        yield callback or (lambda progress: None)
        return
    from rich.console import Console
    from rich.progress import Progress, TextColumn

    columns = (*Progress.get_default_columns()[:3], TextColumn("{task.fields[words]}", markup=False))
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=console.is_terminal) as bar:
        task = bar.add_task("sweeping", total=None, words="")

        def move(progress: SweepProgress) -> bool | None:
            bar.update(task, total=progress.count, completed=progress.finished, words=str(progress))
            return None if callback is None else callback(progress)

        yield move
