"""What this experiment measures, a row each."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import spearmanr


@dataclass(frozen=True)
class Length:
    """One arm at one length of the shape: medians over bends and forces [mm, N].

    Attributes:
        in_range: whether every strain of the shapes is characterised.
        held: share of the tasks.
    """

    arm: str
    longer: float
    in_range: bool
    held: float
    shape_mm: float
    tip_mm: float
    absolute: float
    relative: float


@dataclass(frozen=True)
class Result:
    """One arm at the length that suits it, one bend and one force; errors in mm, unattainability in N.

    Attributes:
        searched_mm: the shape error that a search reaches; NaN where none was made, or it found nothing.
        converged: whether that search converged.
        edges: absolute unattainability by the paper's three points an edge; NaN where no search was made.
    """

    arm: str
    longer: float
    direction: float
    force: str
    verdict: str
    shape_mm: float
    tip_mm: float
    tip_deg: float
    absolute: float
    relative: float
    searched_mm: float
    converged: bool
    edges: float


def pairs_in_order(metric: Sequence[float], error: Sequence[float]) -> float:
    """Of all pairs of tasks that differ in both, the share in which the one of less unattainability comes closer."""
    one, other = np.asarray(metric), np.asarray(error)
    more, further = one[:, None] - one, other[:, None] - other
    known = (more > 0) & (further != 0) & np.isfinite(further)
    return float((further[known] > 0).mean()) if known.any() else math.nan


def ranks(results: Sequence[Result], name: str) -> dict[str, tuple[float, float]]:
    """By metric: Spearman's rank correlation with the searched error, and the share of pairs in order."""
    own = [row for row in results if row.arm == name and math.isfinite(row.searched_mm)]
    error = [row.searched_mm for row in own]
    found = {}
    for metric in ("absolute", "relative", "shape_mm"):
        value = [getattr(row, metric) for row in own]
        varies = len(set(value)) > 1
        found[metric] = (
            (float(spearmanr(value, error).statistic), pairs_in_order(value, error)) if varies else (math.nan, math.nan)
        )
    return found
