"""What this experiment measures, a row each."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """One state; with a hypothesis that is fitted, on the other half of the states [mm]."""

    hypothesis: str
    case: str
    state: int
    pulled: bool
    value: float
    tip_error_mm: float
    deflection_mm: float
