"""What this experiment measures, a row each."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """What was measured: times a problem (a node's distance) [µs], and errors over max|H - w|."""

    space: str
    metric: str
    method: str
    samples: int
    problems: int
    forward_us: float
    gradient_us: float
    error_p50: float
    error_p99: float
    error_max: float
    converged: float
