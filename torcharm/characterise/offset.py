"""The offset between a tester's clock and a logger's: found by which fits the run best, and how sure that is."""

import math
import warnings
from dataclasses import dataclass

import numpy as np

from torcharm.characterise.least_squares import exponents
from torcharm.characterise.misfit import (
    NEGLIGIBLE,
    PAPER_SMOOTHING,
    SEARCHED,
    USUAL_DEGREE,
    Misfit,
    offset_grid,
    smoothed,
)
from torcharm.characterise.recordings import Array, PressureRecord, TesterRecord
from torcharm.inputs import check_count, check_number

VALLEYS = 4
"""Of the misfit, how many are followed to the bottom: the best on the grid need not be the best there."""
ALIKE = 1.1
"""Root mean squares within this factor of the least are alike, where a run repeats itself."""


@dataclass(frozen=True)
class OffsetEstimate:
    """Where a log's clock fits a run best, and how sure that is.

    Attributes:
        offset: what is added to the log's time to give the tester's [ms].
        deviation: by how much it may be off, one standard deviation [ms], from how sharply the misfit rises about it,
            taking residuals as correlated (see `least_squares.correlation_length`).
        rmse: of the fit there [N], of the force on all actuators together.
        other, other_rmse: the best offset elsewhere [ms], and what its fit leaves [N]; infinite if there is none.
        repeats: whether that fits as well.

    Example:
        >>> rows = [f"{t},{math.sin(t) / 9},{-(t % 50)},{t % 50}" for t in range(200)]
        >>> _ = (path := folder / "run.csv").write_text("\\n".join(["t [s],strain [1],F [N],p [kPa]", *rows, ""]))
        >>> ta.estimate_offset(ta.read_tester(path), ta.read_pressure(path), smoothing=0).repeats  # one alone fits
        False
    """

    offset: float
    deviation: float
    rmse: float
    other: float
    other_rmse: float
    repeats: bool

    @property
    def words(self) -> str:
        """How sure it is."""
        if math.isinf(self.other_rmse):
            other = "nowhere else is a fit"
        elif self.repeats:
            other = f"{self.other:.1f} ms fits as well, as the run repeats itself: the nearer to 0 is taken"
        else:
            other = f"elsewhere {self.other_rmse:.3g} N at best"
        return f"{self.offset:.1f} ± {self.deviation:.2g} ms; forces fit to {self.rmse:.3g} N there, {other}"


def estimate_offset(
    tester: TesterRecord,
    log: PressureRecord,
    *,
    degree: int = USUAL_DEGREE,
    smoothing: float = PAPER_SMOOTHING,
    search: float = SEARCHED,
) -> OffsetEstimate:
    """The offset of the log [ms] with which a polynomial of strain and pressure fits the run's force best.

    Looked for on a grid within ±`search`, of clocks as they are or, if they do not overlap at all, of clocks that start
    at once; then by golden sections about the best few points. Of offsets that fit alike the nearest is taken.

    Args:
        tester, log: as for `align`.
        smoothing: σ of the log's Gaussian [ms]; 0 for none.
        degree: of the polynomial.
        search: how far to look [ms].

    Raises:
        ValueError: the run and the log overlap too little at all offsets, or a setting is out of range.

    Example:
        >>> rows = [f"{t},{math.sin(t) / 9},{-(t % 50)},{t % 50},{t + 2}" for t in range(200)]
        >>> _ = (path := folder / "run.csv").write_text("\\n".join(["t [s],ε [1],F [N],p [kPa],log [s]", *rows, ""]))
        >>> tester, log = ta.read_tester(path), ta.read_pressure(path, columns="time=5:s")  # whose clock is 2 s ahead
        >>> round(ta.estimate_offset(tester, log, smoothing=0).offset)
        -2000
    """
    check_count("degree", degree, 1)
    check_number("search", search, 0.0, strict=True, unit="ms")
    apart = log.time[0] > tester.time[-1] or log.time[-1] < tester.time[0]
    centre = float(tester.time[0] - log.time[0]) if apart else 0.0
    search = min(search, float(np.ptp(tester.time) + np.ptp(log.time)))  # beyond, the two do not overlap
    misfit = Misfit(tester, log.time + centre, smoothed(log, smoothing), exponents(degree))
    grid = offset_grid(search)
    found = np.array([misfit(shift) for shift in grid])
    if not np.isfinite(found).any():
        raise ValueError(
            f"search (--find-offset): must reach further, {tester.source} and {log.source} overlap too little within "
            f"±{search:g} ms"
        )
    if found.argmin() in (0, len(grid) - 1):
        warnings.warn(
            f"{tester.source} and {log.source}: the best offset lies at the edge of ±{search:g} ms: look further, "
            f"as by --find-offset {3e-3 * search:g}",
            stacklevel=2,
        )
    valleys = sorted((misfit(shift), shift) for shift in _valleys(misfit, grid, found))
    alike = [(value, shift) for value, shift in valleys if value <= max(ALIKE**2 * valleys[0][0], NEGLIGIBLE)]
    value, shift = min(alike, key=lambda one: abs(one[1]))
    rest = [one for one in valleys if one[1] != shift] or [(math.inf, math.inf)]
    return OffsetEstimate(
        offset=centre + shift,
        deviation=misfit.deviation(shift),
        rmse=misfit.rmse(value),
        other=centre + rest[0][1],
        other_rmse=misfit.rmse(rest[0][0]),
        repeats=len(alike) > 1,
    )


def _valleys(misfit: Misfit, grid: Array, found: Array) -> list[float]:
    """The bottoms of the deepest valleys of the misfit [ms]."""
    from scipy.optimize import minimize_scalar

    padded = np.concatenate(([math.inf], found, [math.inf]))
    low = np.flatnonzero(np.isfinite(found) & (found <= padded[:-2]) & (found <= padded[2:]))
    best = low[np.argsort(found[low], kind="stable")][:VALLEYS]
    ends = [(grid[max(i - 1, 0)], grid[min(i + 1, len(grid) - 1)]) for i in best.tolist()]
    with np.errstate(invalid="ignore"):  # where nothing is shared the misfit is infinite
        return [
            float(minimize_scalar(misfit, bounds=pair, method="bounded", options={"xatol": 0.1}).x) for pair in ends
        ]
