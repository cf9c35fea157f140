"""Pressures smoothed, and the misfit: what a polynomial of strain and pressure leaves of a run's force."""

import math
import warnings
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from torcharm.characterise.least_squares import Monomials, Powers, correlation_length, exponents, least_squares_loss
from torcharm.characterise.recordings import Array, Floats, PressureRecord, TesterRecord
from torcharm.inputs import check_number

PAPER_SMOOTHING = 440.0
"""σ [ms] of the paper's Gaussian smoothing of pressure: 40 samples of its log, one each 11 ms."""
SMOOTHING_REACH = 2.5
"""The Gaussian ends at so many σ: the paper's spans 201 samples."""
LEAST_SHARED = 0.3
"""Of the tester's stamps, how many log and tester must share at an offset for it to count."""
USUAL_DEGREE = 3
"""Of the polynomial by which questions of smoothing and clocks are settled unless told: the paper's."""
MOST_STAMPS = 2000
"""Of the tester's, evenly spread, answer such a question as well as all."""
SPIKES = 5
"""Samples of the median that leaves out spikes of the force."""
SEARCHED = 10_000.0
"""How far an offset is looked for unless told [ms]."""
SEARCH_STEP = 100.0
"""Of the grid on which it is looked for [ms]: actuators fill in no less than a few of it, so that the valley of the
misfit about the offset is wider."""
NEGLIGIBLE = 1e-6
"""Of the force's variance, a misfit that is as good as none: a thousandth of its deviation."""
ONE_PERCENT = 0.01
"""Of the force's deviation, what a fit may leave before clocks are doubted."""
SLIPPED = 0.8
"""Of the root mean square that a fit leaves: with no more than this at another offset, the clocks seem to be apart."""


def smooth(values: Float[Floats, " n"], deviation: float) -> Float[Floats, " n"]:
    """A Gaussian-weighted mean over the samples within 2.5 deviations, and at the ends over those there are.

    Args:
        values: evenly spaced.
        deviation: σ in samples; 0 leaves the values as they are.
    """
    if deviation == 0:
        return values
    from scipy.ndimage import gaussian_filter1d

    options = {"sigma": deviation, "mode": "constant", "truncate": SMOOTHING_REACH}
    return gaussian_filter1d(values, **options) / gaussian_filter1d(np.ones_like(values), **options)


def smoothed(log: PressureRecord, smoothing: float) -> Array:
    """The log's pressures [kPa] after `smooth` by a deviation [ms], which its usual step turns into samples.

    Raises:
        ValueError: the deviation is none, or longer than the log.
    """
    check_number("smoothing", smoothing, 0.0, unit="ms")
    length = float(log.time[-1] - log.time[0])
    if smoothing > length:
        raise ValueError(f"smoothing: must be at most the length of {log.source}, {length:g} ms, got {smoothing:g} ms")
    return smooth(log.pressure, smoothing / float(np.median(np.diff(log.time))) if smoothing else 0.0)


def usually_smoothed(tester: TesterRecord, log: PressureRecord, offset: float) -> tuple[float, Array]:
    """The paper's smoothing [ms], if a run's forces fit better with it, else none; and the pressures [kPa] after it.

    A Gaussian takes noise from slow pressures, and from fast ones what happened.
    """
    if float(log.time[-1] - log.time[0]) < PAPER_SMOOTHING:
        return 0.0, log.pressure
    paper = smoothed(log, PAPER_SMOOTHING)
    better = coarse_misfit(tester, log, paper)(offset) < coarse_misfit(tester, log, log.pressure)(offset)
    return (PAPER_SMOOTHING, paper) if better else (0.0, log.pressure)


def coarse_misfit(tester: TesterRecord, log: PressureRecord, pressure: Array) -> "Misfit":
    """The misfit of a cubic at a few of the tester's stamps, which is quick; a median leaves out the force's spikes.

    Args:
        tester, log: of a run.
        pressure: of the log [kPa], smoothed.
    """
    from scipy.ndimage import median_filter

    step = max(1, len(tester.time) // MOST_STAMPS)
    force = median_filter(tester.force, SPIKES, mode="nearest")
    few = TesterRecord(tester.time[::step], tester.strain[::step], force[::step], tester.source)
    return Misfit(few, log.time, pressure, exponents(USUAL_DEGREE))


def warn_of_slipped_clocks(tester: TesterRecord, log: PressureRecord, pressure: Array) -> None:
    """Warn where forces fit notably better with the log's clock shifted, if it is not shifted yet."""
    misfit = coarse_misfit(tester, log, pressure)
    here = misfit(0.0)
    if not ONE_PERCENT**2 < here < math.inf:
        return
    grid = offset_grid(SEARCHED)
    found = np.array([misfit(shift) for shift in grid])
    best = found.min()
    if best <= SLIPPED**2 * here:
        shift, gain = grid[found.argmin()], math.sqrt(here / max(best, NEGLIGIBLE))
        warnings.warn(
            f"{tester.source} and {log.source}: clocks seem to be apart: with {shift:+.0f} ms on the log's, forces fit "
            f"{gain:.2g} times as closely; --find-offset takes what fits best, --offset 0 leaves them so",
            stacklevel=4,
        )


def offset_grid(search: float) -> Array:
    """Offsets within ±`search` [ms], 0 among them, about `SEARCH_STEP` apart."""
    return np.linspace(-search, search, 2 * math.ceil(search / SEARCH_STEP) + 1)


@dataclass(frozen=True)
class Misfit:
    """What share of the force's variance a polynomial leaves at an offset, over the stamps that log and tester share.

    The share, and not the sum of squares: else an offset at which little is shared, or only rest, would be the best.
    """

    tester: TesterRecord
    clock: Array
    pressure: Array
    powers: Powers

    def both(self, offset: float) -> NDArray[np.bool_]:
        """Which of the tester's stamps the log has, too."""
        return (self.tester.time >= self.clock[0] + offset) & (self.tester.time <= self.clock[-1] + offset)

    def shared(self, offset: float) -> tuple[Array, Array, Array]:
        """Strain, pressure and force at those."""
        own = self.both(offset)
        pressure = np.interp(self.tester.time[own], self.clock + offset, self.pressure)
        return self.tester.strain[own], pressure, self.tester.force[own]

    def __call__(self, offset: float) -> float:
        """That share; infinite where log and tester share too little."""
        strain, pressure, force = self.shared(offset)
        if len(force) < max(10 * len(self.powers), LEAST_SHARED * len(self.tester.time)):
            return math.inf
        total = float(((force - force.mean()) ** 2).sum())
        return least_squares_loss(strain, pressure, force, self.powers) / total if total > 0 else math.inf

    def rmse(self, share: float) -> float:
        """A share of variance as a root mean square [N], of the whole run."""
        return float(self.tester.force.std()) * math.sqrt(max(share, 0.0))

    def deviation(self, offset: float) -> float:
        """One standard deviation of the offset [ms], as of a fit in which it is one more unknown.

        `σ √(L / Σ J²)` with the residuals' deviation σ, L samples of them correlated, and of the force's slope by the
        offset, `J = ∂f/∂p dp/dt`, what the polynomial itself cannot follow.
        """
        strain, pressure, force = self.shared(offset)
        monomials = Monomials.for_data(self.powers, strain, pressure)
        basis, triangle = np.linalg.qr(monomials.values(strain, pressure))
        residual = force - basis @ (basis.T @ force)
        coefficients = np.linalg.lstsq(triangle, basis.T @ force, rcond=None)[0]
        gradient = np.gradient(self.pressure, self.clock)
        rate = np.interp(self.tester.time[self.both(offset)], self.clock + offset, gradient)
        slope = monomials.slopes(strain, pressure) @ coefficients * rate
        free = slope - basis @ (basis.T @ slope)
        length = correlation_length(residual, [slice(0, len(residual))])
        sharp = float(free @ free)
        return float(residual.std()) * math.sqrt(length / sharp) if sharp > 0 else math.inf
