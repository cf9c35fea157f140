"""What this experiment measures, a row each."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """One arm on one shape, with pressures chosen for one aim; errors in mm and degrees, unattainability in N.

    Attributes:
        predicted_mm, searched_mm: the error of the aim: of the shape, of the tip's pose, or of its place.
        shape_mm: the shape error of what the search reaches, whatever its aim.
        tip_mm, tip_deg: of what the search reaches.
        verdict: of the prediction.
    """

    kind: str
    shape: str
    segments: int
    aim: str
    predicted_mm: float
    searched_mm: float
    shape_mm: float
    tip_mm: float
    tip_deg: float
    absolute: float
    relative: float
    verdict: str
    status: str
    in_range: bool
