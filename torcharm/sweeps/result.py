"""A sweep's folder, opened: the best designs, Pareto sets, tables; nothing is read that is not needed."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from torcharm.design.space import FIELDS, UNITS, Arm
from torcharm.extras import extra
from torcharm.files import StrPath
from torcharm.inputs import check_choice, check_count, shown
from torcharm.sweeps.designs import DesignPoints, Indices
from torcharm.sweeps.manifest import Manifest, read_manifest, stored_arm
from torcharm.sweeps.measures import SIZE, Rows
from torcharm.sweeps.ranking import KEPT, Places, best_places, pareto_places, rankings, taken
from torcharm.sweeps.shards import rows_of, shard_path
from torcharm.sweeps.summary import Summary, summary_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

FILE_UNITS = {"m": ("mm", 1e3), "rad": ("deg", 180.0 / np.pi), "kPa": ("kPa", 1.0)}
"""Unit and factor of columns of free values, by the unit that they have in the library."""


@dataclass(frozen=True, eq=False, repr=False)
class SweepRows:
    """Some designs of a sweep and what was found of them.

    Attributes:
        columns: arrays (n,) by their names, which end in their units: `design` is the index.
        points: of all designs of the sweep.
    """

    columns: Rows
    points: DesignPoints

    @property
    def indices(self) -> Indices:
        """(n,) of the designs."""
        return np.asarray(self.columns["design"])

    def __len__(self) -> int:
        """How many there are."""
        return len(self.indices)

    def __getitem__(self, name: str) -> npt.NDArray[Any]:
        """A column, or one of `radii`, `angles`, `length` and `max_pressure`, (n, M) [m, rad, m, kPa]."""
        if name in FIELDS:
            return np.asarray(self.points.values(self.indices)[:, FIELDS.index(name)])
        check_choice("name", name, tuple(self.columns))
        return self.columns[name]

    def taken(self, places: Sequence[int]) -> "SweepRows":
        """The rows at some places."""
        return SweepRows(taken(self.columns, np.asarray(places, dtype=np.intp)), self.points)

    def to_frame(self) -> "DataFrame":
        """As a table of pandas.

        Raises:
            ValueError: pandas is not installed.
        """
        frame: DataFrame = extra("pandas", "sweep", "pip install pandas").DataFrame(self.columns)
        return frame

    def __repr__(self) -> str:
        """How many, and which columns."""
        return f"SweepRows({len(self)} designs: {', '.join(self.columns)})"


class SweepResult:
    """What a sweep has found so far.

    Attributes:
        folder: where it lies.
        manifest: what it is.
        summary: counts and best rows of all finished shards.
        interrupted: whether the run that returned this was stopped before it had done its shards.

    Example:
        >>> arm, task = ta.bellows_arm(), ta.Task(ta.constant_curvature(0.5), tip_load=[1.0, 0.0, 0.0])
        >>> found = ta.sweep(arm, ta.DesignSpace("radii"), task, 64, out=folder, metrics="absolute", workers=1)
        >>> found.designs(found.best(3, "absolute"))  # the three best arms
        ArmDesign(planar, 4 bellows, batch (3,), torch.float64)
    """

    def __init__(
        self, folder: Path, manifest: Manifest, summary: Summary, arm: Arm | None = None, *, interrupted: bool = False
    ) -> None:
        self.folder, self.manifest, self.summary, self._arm = folder, manifest, summary, arm
        self.interrupted = interrupted

    @property
    def count(self) -> int:
        """Designs in all."""
        return self.manifest.count

    @property
    def finished(self) -> int:
        """Designs in finished shards."""
        return self.summary.designs

    @property
    def feasible(self) -> int:
        """Of these, designs that the space allows: the others were not evaluated."""
        return self.summary.feasible

    @property
    def complete(self) -> bool:
        """Whether all shards are finished."""
        return len(self.summary.shards) == self.manifest.shards

    @property
    def columns(self) -> tuple[str, ...]:
        """What is known of each design, with units in the names."""
        return ("design", "feasible", *self.manifest.numbers, *self.manifest.counts)

    @property
    def verdicts(self) -> dict[str, int]:
        """How many pairs of a feasible design and a task have each verdict, or are not excluded."""
        return dict(self.summary.counts)

    @property
    def free_values(self) -> tuple[str, ...]:
        """Columns of free values, which follow from the index and are in no file; of tied actuators the first one's."""
        free = self.manifest.design_points.free
        return tuple(
            f"{field}_{'_'.join(str(index + 1) for index in own)}_{FILE_UNITS[UNITS[field]][0]}"
            for field, own in zip(free.fields, free.members, strict=True)
        )

    def best(self, count: int = 100, by: str = "tip_error") -> SweepRows:
        """The best feasible designs, the best first; equal ones by their index.

        Args:
            count: at most so many. Up to 1000 the summary knows them; for more, all shards are read.
            by: a metric, with or without its unit: the least; or how many tasks are held or not excluded: the most, and
                among equals the least by the first metric.

        Raises:
            ValueError: an argument is none of those allowed.
        """
        check_count("count", count, 1)
        column = self.column(by)
        known = count <= KEPT and column in rankings(self.columns)
        return self._leading(known, lambda rows: best_places(rows, column, count))

    def pareto(self, first: str = "tip_error", second: str = "size") -> SweepRows:
        """The feasible designs that no other beats in two columns, smaller being better, by the second.

        The summary knows those of each metric against size; for other pairs, all shards are read.

        Args:
            first, second: columns, with or without their units.

        Raises:
            ValueError: a name is none of those allowed.
        """
        x, y = self.column(first), self.column(second)
        known = y == SIZE and x in rankings(self.manifest.numbers)
        return self._leading(known, lambda rows: pareto_places(rows, x, y))

    def _leading(self, known: bool, places: Callable[[Rows], Places]) -> SweepRows:
        """The rows at the places that lead among all, which the summary knows, or one shard after the other tells."""
        rows = self.summary.rows if known else {}
        for block in () if known else self.blocks():
            both = {name: np.concatenate((rows[name], block[name])) for name in block} if rows else block
            rows = taken(both, places(both))
        found = taken(rows, places(rows)) if rows else {name: np.zeros(0) for name in self.columns}
        return SweepRows(found, self.manifest.design_points)

    def designs(self, indices: Any) -> Arm:
        """The designs at some indices, as a batch in their order.

        The arm's force models come from the folder unless the arm was given. They are pickled: as with `torch.load`,
        open no folder in this way that you do not trust.

        Args:
            indices: (n,) integers, or what `best` and `pareto` return.

        Raises:
            ValueError: there is no such design, none is named, or the arm cannot be read.
        """
        from torcharm.design.feasible import designs_at

        chosen = indices.indices if isinstance(indices, SweepRows) else np.atleast_1d(np.asarray(indices))
        if not len(chosen):
            none = ": the space allows no design of this sweep" if not self.feasible else ""
            raise ValueError(f"indices: must name at least one design, got none{none}")
        if chosen.dtype.kind not in "iu" or not 0 <= chosen.min() <= chosen.max() < self.count:
            raise ValueError(f"indices: must be integers from 0 to {self.count - 1}, got {shown(indices)}")
        if self._arm is None:
            self._arm = stored_arm(self.folder)
        points = self.manifest.design_points
        return designs_at(self._arm, points.free, points(chosen.astype(np.int64)))

    def column(self, name: str) -> str:
        """The column that a name with or without its unit stands for.

        Raises:
            ValueError: there is none.
        """
        every = (*self.columns, *self.free_values)
        short = {one.rsplit("_", 1)[0]: one for one in (*self.manifest.numbers, *self.free_values)}
        if name in every:
            return name
        check_choice("column", name, (*short, *self.manifest.counts))
        return short[name]

    def blocks(self, columns: Sequence[str] | None = None, filter: Any = None) -> Iterator[Rows]:
        """The rows of one finished shard after the other, so that none but one is in memory.

        Args:
            columns: with or without their units; free values are allowed. None is all but free values.
            filter: as `filters` of pyarrow: [("tip_error_mm", "<", 5.0), ("feasible", "==", True)], whose names are
                those of columns in files.

        Raises:
            ValueError: there is no such column, or the filter is none.
        """
        wanted = [self.column(name) for name in (self.columns if columns is None else columns)]
        stored = list(dict.fromkeys(("design", *(name for name in wanted if name in self.columns))))
        parquet, arrow = extra("pyarrow.parquet", "sweep"), extra("pyarrow", "sweep")
        made = [name for name in wanted if name in self.free_values]
        for shard in sorted(self.summary.shards):
            try:
                table = parquet.read_table(shard_path(self.folder, shard), columns=stored, filters=filter)
            except (arrow.ArrowException, ValueError, TypeError, KeyError) as error:
                raise ValueError(f"filter: {error}, got {shown(filter)}") from None
            rows = rows_of(table)
            if made:
                rows |= self.free_columns(rows["design"])
            yield {name: rows[name] for name in wanted}

    def free_columns(self, indices: Indices) -> Rows:
        """The columns of free values (n,) of the designs at indices (n,)."""
        points = self.manifest.design_points
        values = points.values(indices)
        return {
            column: FILE_UNITS[UNITS[field]][1] * values[:, FIELDS.index(field), own[0]]
            for column, field, own in zip(self.free_values, points.free.fields, points.free.members, strict=True)
        }

    def to_frame(self, columns: Sequence[str] | None = None, filter: Any = None) -> "DataFrame":
        """A table of pandas with all finished designs that a filter lets through: see that it fits into memory.

        Args:
            columns, filter: as in `blocks`.

        Raises:
            ValueError: as for `blocks`, or pandas is not installed.
        """
        pandas = extra("pandas", "sweep", "pip install pandas")
        wanted = [self.column(name) for name in (self.columns if columns is None else columns)]
        frames = [pandas.DataFrame(block) for block in self.blocks(columns, filter)]
        found: DataFrame = pandas.concat(frames, ignore_index=True) if frames else pandas.DataFrame(columns=wanted)
        return found

    def plot(self, x: str | None = None, y: str | None = None, *, filter: Any = None, bins: int = 100) -> "Figure":
        """How the feasible designs are distributed: counts in bins, read shard by shard.

        Args:
            x: a column or a free value; None draws every metric.
            y: one to be drawn against it; None draws a histogram.
            filter: as in `blocks`.
            bins: along each axis.

        Raises:
            ValueError: as for `blocks`, or nothing finite is known of a column.
        """
        from torcharm.sweeps.figures import density, histograms

        check_count("bins", bins, 1)
        if y is not None and x is None:
            raise ValueError("x: must be given where y is, got None")

        def blocks(columns: Sequence[str]) -> Iterator[Rows]:
            return self.blocks(columns, filter)

        if x is not None and y is not None:
            return density(blocks, self.column(x), self.column(y), bins)
        return histograms(blocks, self.manifest.numbers if x is None else (self.column(x),), bins)

    def __repr__(self) -> str:
        """How much there is."""
        return f"SweepResult({self.folder}: {self.finished} of {self.count} designs, {self.feasible} feasible)"


def open_sweep(folder: StrPath, arm: Arm | None = None) -> SweepResult:
    """What a sweep has found so far, whether it is finished, running or interrupted.

    Args:
        folder: of the sweep.
        arm: that the sweep was called with; None reads it from the folder when `designs` are asked for.

    Raises:
        ValueError: the folder holds no sweep that this torcharm wrote, the arm is another, or a package is missing.

    Example:
        >>> arm, task = ta.bellows_arm(), ta.Task(ta.constant_curvature(0.5), tip_load=[1.0, 0.0, 0.0])
        >>> _ = ta.sweep(arm, ta.DesignSpace("radii"), task, 64, out=folder, metrics="absolute", workers=1)
        >>> ta.open_sweep(folder).complete  # also in another process, and while the sweep runs
        True
    """
    extra("pyarrow", "sweep")
    path = Path(folder)
    manifest = read_manifest(path)
    actuators = manifest.design_points.free.base.shape[-1]
    if arm is not None and arm.actuator_count != actuators:
        raise ValueError(f"arm: must have the sweep's {actuators} actuators, got {arm.actuator_count}")
    summary = summary_of(path, manifest)
    with suppress(OSError):  # what could not be kept is found again the next time
        summary.keep(path)
    return SweepResult(path, manifest, summary, arm)
