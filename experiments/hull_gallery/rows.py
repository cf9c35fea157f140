"""What this experiment measures, a row each."""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """The worst violations found at one node [N, with 1 N·m counted as 1 N].

    Attributes:
        case, slope, intercept, metric, node: which set; shapes [rad], nodes from 1.
        convex: largest distance from the set to a point of its convex hull.
        boundary: largest distance from the image of the pressure box's boundary to a boundary point of the set.
        edges: by how much the set reaches beyond the hull of the image of the box's edges, densely sampled.
        free: the most pressures that are inside their range at once on the hull's boundary.
        diameter: of the hull.
        monotonic, in_range: whether all forces are monotonic in pressure, and all strains characterised.
    """

    case: str
    slope: float
    intercept: float
    metric: str
    node: int
    convex: float
    boundary: float
    edges: float
    free: int
    diameter: float
    monotonic: bool
    in_range: bool


@dataclass(frozen=True)
class GalleryRow:
    """One node of the gallery.

    Attributes:
        slope, intercept, metric, node: which set.
        outside: of the 150 reactions, those outside the paper's hull, of 4 points an edge.
        outside_by: by how much at most [N].
        hull_short_by: by how much the exact set's hull reaches beyond the paper's [N].
    """

    slope: float
    intercept: float
    metric: str
    node: int
    outside: int
    outside_by: float
    hull_short_by: float


def worst(rows: Sequence[Row], claim: str) -> Row:
    return max(rows, key=lambda row: float(getattr(row, claim)))
