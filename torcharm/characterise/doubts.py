"""What is doubtful about a fit, in words: forces that it does not follow, samples that stand out, limits beyond it."""

import warnings

import numpy as np

from torcharm.actuators.measured import Measured
from torcharm.actuators.polynomial import PolynomialActuator
from torcharm.actuators.protocol import Actuator
from torcharm.characterise.alignment import Recording, is_table
from torcharm.characterise.choice import forces
from torcharm.characterise.least_squares import MAD, Array, Monomials, exponents, least_squares_loss
from torcharm.characterise.misfit import USUAL_DEGREE

THIN = 0.2
"""Of the box of strains and pressures, what share samples must cover to tell what each of the two does."""
LEVERAGE, UNSURE = 10.0, 0.03
"""In square roots of their number, by what coefficients may amplify what the fit leaves where the model counts as
characterised; and of the largest force, how much that may make."""
LOW = 0.9
"""R² below which strain and pressure hardly tell the force."""
UNBALANCED, LEAST_REST = 0.7, 0.005
"""Of the root mean square that a fit leaves, what one with a force at rest may leave to doubt the load cell; and of the
range of forces, what the fit must leave."""
WINDOW = 11
"""Samples about each: a spike is no longer than half of them, and stands out from their median."""
SPIKE, SPIKE_OF_RMSE, SPIKE_OF_FORCE = 10.0, 5.0, 0.02
"""By so many of the usual distances from that median a spike stands out, so many root mean squares of residuals, and so
much of the largest force."""


def warn_of_doubts(model: Actuator, recording: Recording) -> None:
    """A warning for each thing that is doubtful about a model that was fitted to a recording."""
    residual = recording.force - forces(model, recording.strain, recording.pressure)
    for doubt in (
        _unbalanced(recording),
        _low(recording, residual),
        _spikes(recording, residual),
        _undetermined(model, recording, residual),
        _beyond(model),
    ):
        if doubt:
            warnings.warn(doubt, stacklevel=2)


def covered(model: Measured) -> float:
    """Of the box of its strains and pressures, what share a model's region covers, which is a polygon."""
    (low, high), (first, last) = model.strain_range, model.pressure_range  # type: ignore[attr-defined]
    following = (*model.region[1:], *model.region[:1])
    area = abs(sum(x * v - u * y for (x, y), (u, v) in zip(model.region, following, strict=True))) / 2
    return min(1.0, area / ((high - low) * (last - first)))


def _undetermined(model: Actuator, recording: Recording, residual: Array) -> str:
    """Whether samples lie about a line of strains and pressures, or leave coefficients open that count between them.

    A misfit that is no noise changes a force by up to `√(gᵀ (XᵀX / n)⁻¹ g)` of its root mean square, with X the
    monomials of samples and g those of the force.
    """
    if not isinstance(model, Measured):
        return ""
    share = covered(model)
    if share < THIN:
        return (
            f"strain and pressure moved together: samples cover {100 * share:.2g} % of the box of their ranges, and "
            "beyond nothing tells what each of the two does: test at several pressures for each strain"
        )
    if not isinstance(model, PolynomialActuator):
        return ""
    powers = tuple((i, j) for i, j, _ in model.coefficients)
    monomials = Monomials.for_data(powers, recording.strain, recording.pressure)
    _, triangle = np.linalg.qr(monomials.values(recording.strain, recording.pressure))
    corners = np.array(model.region)
    strain, pressure = ((corners + corners[:, None]) / 2).reshape(-1, 2).T  # between any two, which lies inside
    wanted = np.linalg.lstsq(triangle.T, monomials.values(strain, pressure).T, rcond=None)[0]
    gain = np.sqrt(len(residual) * (wanted**2).sum(0))
    worst, most = int(gain.argmax()), float(np.abs(recording.force).max())
    off = float(gain[worst]) * float(np.sqrt((residual**2).mean()))
    if gain[worst] < LEVERAGE * np.sqrt(len(powers)) or off < UNSURE * most:
        return ""
    return (
        f"{len(powers)} coefficients are more than the samples determine: by what the fit leaves, the force at strain "
        f"{strain[worst]:.3g} and {pressure[worst]:.3g} kPa may be {100 * min(off / most, 1):.0f} % of "
        "the largest force off: were both ever away from 0 at once, and at three values each? Test more of them, or "
        "fit a lower --degree"
    )


def _low(recording: Recording, residual: Array) -> str:
    share = float(residual @ residual) / max(float(np.sum((recording.force - recording.force.mean()) ** 2)), 1e-300)
    if share <= 1 - LOW:
        return ""
    return (
        f"R² is {1 - share:.2g}: strain and pressure hardly tell the force; are columns, units, signs, clocks and the "
        "runs' order right?"
    )


def _unbalanced(recording: Recording) -> str:
    """Whether forces fit notably better with one more at no strain and pressure, which no model here has."""
    strain, pressure, force = recording.strain, recording.pressure, recording.force
    powers, spread = exponents(USUAL_DEGREE), float(np.ptp(force))
    if is_table(recording) or len(force) < 10 * len(powers):
        return ""
    plain, more = (least_squares_loss(strain, pressure, force, own) for own in (powers, ((0, 0), *powers)))
    if more > UNBALANCED**2 * plain or plain < (LEAST_REST * spread) ** 2 * len(force):
        return ""
    return (
        f"forces fit {np.sqrt(plain / max(more, 1e-300)):.2g} times as closely with a force at rest, which models have "
        "none of: was the load cell balanced with the actuators at their own length, without pressure, and are "
        'pressures absolute? --columns or --pressure-columns says that: "pressure=2:kPa abs"'
    )


def _spikes(recording: Recording, residual: Array) -> str:
    """The samples of runs whose residuals stand out from the median of those before and after."""
    from scipy.ndimage import median_filter

    if is_table(recording) or len(residual) < WINDOW:
        return ""
    out = np.zeros_like(residual)
    for own in (recording.run == run for run in np.unique(recording.run)):
        out[own] = residual[own] - median_filter(residual[own], WINDOW, mode="nearest")
    rmse = float(np.sqrt((residual**2).mean()))
    usual = MAD * float(np.median(np.abs(out)))
    least = max(SPIKE * usual, SPIKE_OF_RMSE * rmse, SPIKE_OF_FORCE * float(np.abs(recording.force).max()))
    found = np.flatnonzero(np.abs(out) > least)
    if not len(found):
        return ""
    worst = int(found[np.abs(out[found]).argmax()])
    which = "a sample stands" if len(found) == 1 else f"{len(found)} samples stand"
    return (
        f"{which} out from those about, sample {worst + 1} of {recording.sources[recording.run[worst]]} the most, by "
        f"{abs(out[worst]):.3g} N at strain {recording.strain[worst]:.3g} and {recording.pressure[worst]:.4g} kPa "
        f"(RMSE {rmse:.3g} N): --loss huber bears such"
    )


def _beyond(model: Actuator) -> str:
    known, limit = float(model.pressure_range[1]), float(model.max_pressure)
    if not isinstance(model, Measured) or limit <= known * (1 + 1e-6):
        return ""
    return f"max_pressure: {limit:g} kPa is beyond {known:.4g} kPa, above which nothing was measured"
