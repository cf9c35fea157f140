"""What a force model that was fitted carries beside its force: where it was measured, and where it comes from."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

Vertices = tuple[tuple[float, float], ...]
Provenance = tuple[tuple[str, str | float], ...]

SLACK = 0.02
"""Of the widths of its ranges, how far beyond its region a model is still taken for characterised: sensors are good to
about as much, and a log that rests at 0.3 kPa shall not leave out an actuator without pressure."""


@dataclass(frozen=True, kw_only=True)
class Measured:
    """A force model that knows the region over which it was measured, and where it comes from.

    Attributes:
        region: corners (strain, pressure [kPa]) of the convex region over which it was measured, in order around it,
            counterclockwise; none: the whole of its ranges.
        provenance: names and values: files, settings, versions.
    """

    region: Vertices = field(default=(), repr=False)
    provenance: Provenance = field(default=(), repr=False)

    def characterised(self, strain: Tensor, pressure: Tensor) -> Tensor:
        """Whether strains and pressures [kPa], which broadcast, lie in the region, or next to it."""
        inside = (strain == strain) & (pressure == pressure)
        if not self.region:
            return inside
        corners = np.array(self.region)
        widths = np.ptp(corners, axis=0)
        scaled = corners / widths
        edges = np.roll(scaled, -1, 0) - scaled
        directions = edges / np.linalg.norm(edges, axis=1, keepdims=True)
        for (x, y), (along, up) in zip(scaled.tolist(), directions.tolist(), strict=True):
            outside = up * (strain / widths[0] - x) - along * (pressure / widths[1] - y)
            inside = inside & (outside <= SLACK)
        return inside


def measured_region(strain: NDArray[np.float64], pressure: NDArray[np.float64]) -> Vertices:
    """The convex hull of samples, counterclockwise; none if they lie on a line."""
    from scipy.spatial import ConvexHull, QhullError

    points = np.column_stack((strain, pressure))
    widths = np.ptp(points, axis=0)
    if not (widths > 0).all():
        return ()
    try:
        corners = ConvexHull(points / widths).vertices
    except QhullError:
        return ()
    return tuple((float(x), float(y)) for x, y in points[corners])
