"""What is known of all finished shards together: counts and the best rows. Kept in the folder; the shards tell it.

Merging is associative and indifferent to order: whichever way a sweep came about, its summary is the same to the byte.
"""

import json
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from torcharm.extras import extra
from torcharm.sweeps.manifest import SHARDS, SUMMARY, Manifest
from torcharm.sweeps.measures import Rows
from torcharm.sweeps.ranking import merged
from torcharm.sweeps.shards import ABOUT, read_about, read_needed, rows_of, shard_named, table_of, write_table

PENDING = 64
"""Shards that are merged at once."""


class Summary:
    """Counts and best rows of those shards of a sweep that were added.

    Attributes:
        manifest: of the sweep.
        shards: numbers of the shards added.
        designs, feasible: how many they hold.
        counts: sums over their designs of each column of counts.
    """

    def __init__(self, manifest: Manifest) -> None:
        self.manifest = manifest
        self.shards: set[int] = set()
        self.designs = self.feasible = 0
        self.counts = dict.fromkeys(manifest.counts, 0)
        self._rows: Rows | None = None
        self._pending: list[Rows] = []
        self._kept = 0

    def add(self, path: Path) -> bool:
        """Add the shard of a file; False if it is there already, or the file is no whole shard of this sweep."""
        about = read_about(path, self.manifest)
        if about is None or about["shard"] in self.shards:
            return False
        self._pending.append(read_needed(path))
        self.shards.add(about["shard"])
        self.designs += about["designs"]
        self.feasible += about["feasible"]
        for name in self.counts:
            self.counts[name] += about["counts"][name]
        if len(self._pending) >= PENDING:
            self._merge()
        return True

    @property
    def rows(self) -> Rows:
        """By index, all rows that are among the best; none before a shard is added."""
        self._merge()
        return self._rows or {}

    def _merge(self) -> None:
        if self._pending:
            self._rows = merged([*([] if self._rows is None else [self._rows]), *self._pending], self.manifest.numbers)
            self._pending = []

    def keep(self, folder: Path) -> None:
        """Write it to the folder, if anything is new.

        Raises:
            OSError: it cannot be written.
        """
        if len(self.shards) == self._kept:
            return
        numbers = np.array(sorted(self.shards))
        runs = np.split(numbers, np.flatnonzero(np.diff(numbers) != 1) + 1)  # that follow each other
        about = {
            "manifest": self.manifest.digest,
            "shards": [[int(run[0]), int(run[-1]) + 1] for run in runs if len(run)],
            "designs": self.designs,
            "feasible": self.feasible,
            "counts": self.counts,
        }
        write_table(folder / SUMMARY, table_of(self.rows), {ABOUT: json.dumps(about).encode()})
        self._kept = len(self.shards)

    def _read(self, folder: Path) -> None:
        """Take up what the folder keeps, if it is of this sweep."""
        parquet = extra("pyarrow.parquet", "sweep")
        with suppress(OSError, ValueError, KeyError, TypeError, extra("pyarrow", "sweep").ArrowException):
            about: dict[str, Any] = json.loads(parquet.read_metadata(folder / SUMMARY).metadata[ABOUT])
            if about["manifest"] != self.manifest.digest:
                return
            rows = rows_of(parquet.read_table(folder / SUMMARY, use_threads=False))
            shards = {shard for first, end in about["shards"] for shard in range(first, end)}
            self.designs, self.feasible, self.counts = about["designs"], about["feasible"], about["counts"]
            self._rows, self.shards, self._kept = rows, shards, len(shards)


def summary_of(folder: Path, manifest: Manifest) -> Summary:
    """The summary of all whole shards in a folder: what is kept of it, and the shards that came later."""
    found = Summary(manifest)
    paths = {number: path for number, path in shard_files(folder) if number < manifest.shards}
    found._read(folder)
    if not found.shards <= set(paths):  # shards were deleted
        found = Summary(manifest)
    for number, path in paths.items():
        if number not in found.shards:
            found.add(path)
    return found


def shard_files(folder: Path) -> Iterator[tuple[int, Path]]:
    """Numbers and paths of all files of shards, in their order."""
    for path in sorted((folder / SHARDS).glob("shard-*.parquet")):
        number = shard_named(path)
        if number is not None:
            yield number, path
