"""The best of rows, by one column or by two against each other: what is kept of shards, and how shards are merged.

Rows are arrays (n,) by the names of their columns. Ties go to the design with the lower index, so that the best of many
rows are the best of the best of their parts, in whatever order these come.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from torcharm.sweeps.measures import SIZE, Rows

Places = npt.NDArray[np.intp]

KEPT = 1000
"""How many of the best by each metric every summary keeps."""
MOST = ("held", "not_excluded")
"""Columns of which more is better; among equals the first metric decides."""


def rankings(columns: Sequence[str]) -> tuple[str, ...]:
    """The columns by which summaries know the best: all metrics, and the count of tasks that are held."""
    return tuple(name for name in columns if name in MOST or name.endswith(("error_mm", "absolute_N", "relative_N")))


def best_places(rows: Rows, by: str, count: int) -> Places:
    """Places of the best feasible rows, the best first; what is infinite is none of them."""
    value = rows[by].astype(np.float64)
    keys = [rows["design"], value]
    if by in MOST:
        metric = next(name for name in rows if name.endswith(("_mm", "_N")))
        keys = [rows["design"], rows[metric], -value]
    known = np.flatnonzero(rows["feasible"] & np.isfinite(value))
    if len(known) > 4 * count:  # a partial sort first: only what is no worse than the last one kept can be among them
        leading = keys[-1][known]
        known = known[leading <= np.partition(leading, count - 1)[count - 1]]
    order = np.lexsort([key[known] for key in keys])
    return known[order[:count]]


def pareto_places(rows: Rows, first: str, second: str) -> Places:
    """Places of the feasible rows that no other beats in both columns, smaller being better; least `second` first."""
    x, y = (rows[name].astype(np.float64) for name in (first, second))
    known = np.flatnonzero(rows["feasible"] & np.isfinite(x) & np.isfinite(y))
    order = known[np.lexsort((rows["design"][known], x[known], y[known]))]
    before = np.minimum.accumulate(np.concatenate(([np.inf], x[order])))[:-1]
    return order[x[order] < before]


def needed_rows(rows: Rows, numbers: Sequence[str]) -> Places:
    """Places, in order, of all rows that are among the best by some column, or of a metric's Pareto set with size."""
    found = [np.zeros(0, dtype=np.intp)]
    for name in rankings(tuple(rows)):
        found.append(best_places(rows, name, KEPT))
        if name in numbers:
            found.append(pareto_places(rows, name, SIZE))
    return np.unique(np.concatenate(found))


def merged(parts: Sequence[Rows], numbers: Sequence[str]) -> Rows:
    """The rows of all parts that a summary needs, by index."""
    parts = [part for part in parts if len(part["design"])] or list(parts[:1])
    rows = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    _, once = np.unique(rows["design"], return_index=True)
    rows = taken(rows, once)
    return taken(rows, needed_rows(rows, numbers))


def taken(rows: Rows, places: Any) -> Rows:
    """The rows at some places."""
    return {name: values[places] for name, values in rows.items()}


def label(name: str, gap: str = " ") -> str:
    """A column as a table or an axis names it: tip error [mm]."""
    words, _, unit = name.rpartition("_")
    return f"{words.replace('_', ' ')}{gap}[{unit}]" if unit in ("mm", "N", "deg", "kPa") else name.replace("_", " ")
