"""Shards: so many designs after each other, evaluated and written to one Parquet file, whole or not at all.

A shard's file depends on the manifest and its number alone, to the byte. Its columns are `design` (the index),
`feasible` (whether the space allows the design), and what was measured: metrics in single precision, empty for designs
that are not feasible, which are not evaluated; and counts of tasks. In the file's metadata stand counts and ranges, and
the few rows that any summary needs, so that nobody must read the rest to find the best.
"""

import base64
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torcharm.design.feasible import FeasibleDesigns
from torcharm.design.space import Array
from torcharm.extras import extra
from torcharm.files import atomic_write
from torcharm.sweeps.manifest import SHARDS, Manifest
from torcharm.sweeps.measures import SIZE, Measures, Rows, sizes
from torcharm.sweeps.ranking import needed_rows
from torcharm.task import Task

ABOUT, BEST = b"torcharm", b"torcharm.best"
COMPRESSION = "zstd"
ALLOWED_AT_ONCE = 4096
"""Designs whose constraints are looked at together: a task of many shapes has thousands for each."""


@dataclass(frozen=True, eq=False)
class Job:
    """What a worker needs to know to compute any shard.

    Attributes:
        folder: of the sweep, as all workers see it.
        manifest: of the sweep.
        designs: what the space allows.
        tasks, measures: on what designs are evaluated, and how.
    """

    folder: str
    manifest: Manifest
    designs: FeasibleDesigns
    tasks: tuple[Task, ...]
    measures: Measures


def shard_path(folder: Path, shard: int) -> Path:
    """Where a shard's file is."""
    return folder / SHARDS / f"shard-{shard:06d}.parquet"


def compute_shard(job: Job, shard: int) -> None:
    """Evaluate a shard's designs and write its file."""
    manifest = job.manifest
    indices = np.arange(manifest.first_of(shard), manifest.first_of(shard + 1))
    with one_thread():
        found = measured(job.designs, manifest.design_points(indices), job.tasks, job.measures, manifest.chunk_designs)
    write_shard(shard_path(Path(job.folder), shard), {"design": indices, **found}, manifest, shard)


def measured(designs: FeasibleDesigns, points: Array, tasks: Sequence[Task], measures: Measures, chunk: int) -> Rows:
    """All columns but the index of the designs at points (n, F); NaN and 0 of those not allowed.

    A chunk is how many designs are evaluated at once.
    """
    allowed = np.concatenate([designs.allows(block) for block in blocks(points, ALLOWED_AT_ONCE)])
    found: Rows = {name: np.full(len(points), np.nan, dtype=np.float32) for name in measures.numbers}
    found |= {name: np.zeros(len(points), dtype=np.int32) for name in measures.counts}
    for places in blocks(np.flatnonzero(allowed), chunk):
        arm = designs.design(points[places])
        for name, values in {**measures(arm, tasks), SIZE: sizes(arm)}.items():
            found[name][places] = values
    return {"feasible": allowed, **found}


def blocks(values: Any, size: int) -> list[Any]:
    """An array (n, ...) in pieces of so many."""
    return [values[start : start + size] for start in range(0, len(values), size)]


@contextmanager
def one_thread() -> Iterator[None]:
    """PyTorch in one thread: processes share the cores, and sums come out alike wherever they are made."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def table_of(rows: Rows) -> Any:
    """Rows as a table of Arrow; what was not evaluated is empty."""
    arrow = extra("pyarrow", "sweep")
    absent = ~rows["feasible"]
    arrays = {
        name: arrow.array(values, mask=absent if name not in ("design", "feasible") else None)
        for name, values in rows.items()
    }
    return arrow.table(arrays)


def rows_of(table: Any) -> Rows:
    """The rows of a table: NaN and 0 where it is empty."""
    found = {}
    for name in table.column_names:
        column = table[name].combine_chunks()
        if column.null_count:
            column = column.fill_null(np.nan if str(column.type) == "float" else 0)
        found[name] = column.to_numpy(zero_copy_only=False)
    return found


def write_shard(path: Path, rows: Rows, manifest: Manifest, shard: int) -> None:
    """Write a shard's file, whole or not at all."""
    table, feasible = table_of(rows), rows["feasible"]
    about = {
        "manifest": manifest.digest,
        "shard": shard,
        "designs": len(feasible),
        "feasible": int(feasible.sum()),
        "counts": {name: int(rows[name].sum()) for name in manifest.counts},
    }
    needed, extra_text = needed_rows(rows, manifest.numbers), {ABOUT: json.dumps(about).encode()}
    if 2 * len(needed) < len(feasible):  # else the rows themselves are as short
        extra_text[BEST] = packed(table.take(needed))
    write_table(path, table, extra_text)


def write_table(path: Path, table: Any, texts: Mapping[bytes, bytes]) -> None:
    """Write a table with some texts beside it, whole or not at all; the same gives the same bytes."""
    plain = [name for name in table.column_names if name != "design"]
    options: dict[str, Any] = {
        "compression": COMPRESSION,
        "use_dictionary": [name for name in plain if str(table[name].type) == "int32"],
        "column_encoding": {"design": "DELTA_BINARY_PACKED"},
        "write_statistics": plain,
        "store_schema": False,
    }
    with (
        atomic_write(path) as partial,
        extra("pyarrow.parquet", "sweep").ParquetWriter(partial, table.schema, **options) as file,
    ):
        file.write_table(table)
        file.add_key_value_metadata(dict(texts))


def packed(table: Any) -> bytes:
    """A small table as text, to stand in a file's metadata."""
    target = BytesIO()
    extra("pyarrow.parquet", "sweep").write_table(table, target, compression=COMPRESSION, store_schema=False)
    return base64.b64encode(target.getvalue())


def read_about(path: Path, manifest: Manifest) -> dict[str, Any] | None:
    """What a shard's file says of itself; None if there is none, or it is no whole shard of this sweep."""
    parquet = extra("pyarrow.parquet", "sweep")
    try:
        texts = parquet.read_metadata(path).metadata or {}
        about: dict[str, Any] = json.loads(texts[ABOUT])
        return about if about["manifest"] == manifest.digest and shard_named(path) == about["shard"] else None
    except (OSError, ValueError, KeyError, TypeError, extra("pyarrow", "sweep").ArrowException):
        return None


def shard_named(path: Path) -> int | None:
    """The number of the shard in a file's name."""
    number = path.stem.removeprefix("shard-")
    return int(number) if number.isdecimal() else None


def read_needed(path: Path) -> Rows:
    """The rows of a shard that any summary needs, from its metadata if it is a large one."""
    parquet = extra("pyarrow.parquet", "sweep")
    text = (parquet.read_metadata(path).metadata or {}).get(BEST)
    return rows_of(parquet.read_table(path if text is None else BytesIO(base64.b64decode(text)), use_threads=False))
