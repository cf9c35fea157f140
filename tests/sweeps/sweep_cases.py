"""A small sweep that takes a second, and what its folder holds."""

import hashlib
from pathlib import Path

import torcharm as ta

SPACE = ta.DesignSpace(free="radii", spacing=0.01, in_range=False)


def arm():
    return ta.antagonistic_arm()


def task():
    return ta.Task(ta.affine_curvature(1.0, 1.0, nodes=4), ta.sample_loads(2, (4.0, 4.0, 0.4)))


def small_sweep(out, count=200, **options):
    """Two loads on one shape, by sets alone, in this process, in shards of 32 designs."""
    given = {"metrics": ("absolute", "relative"), "workers": 1, "shard_size": 32, "seed": 3} | options
    return ta.sweep(arm(), SPACE, task(), count, out=out, **given)


def contents(folder):
    """Digests of all that a sweep keeps for others, by name."""
    paths = [path for path in Path(folder).rglob("*") if path.suffix in (".parquet", ".json")]
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}
