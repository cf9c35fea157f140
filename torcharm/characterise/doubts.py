"""What is doubtful about a fit, in words: forces that it does not follow, samples that stand out, limits beyond it."""

import warnings
from collections.abc import Sequence

import numpy as np

from torcharm.actuators.measured import Measured
from torcharm.actuators.polynomial import PolynomialActuator
from torcharm.actuators.protocol import Actuator
from torcharm.characterise.alignment import Recording, is_table
from torcharm.characterise.choice import forces
from torcharm.characterise.least_squares import MAD, Array, Monomials, exponents, least_squares_loss
from torcharm.characterise.misfit import USUAL_DEGREE
from torcharm.characterise.recordings import PressureRecord, TesterRecord

THIN = 0.2
"""Of the box of strains and pressures, what share samples must cover to tell what each of the two does."""
LEVERAGE, UNSURE = 10.0, 0.03
"""In square roots of their number, by what coefficients may amplify what the fit leaves where the model counts as
characterised; and of the largest force, how much that may make."""
FORCES = (0.05, 1e4)
"""Between these [N] lies the largest force of a soft actuator."""
STUCK, MORE_OFF, AT_LEAST = 0.02, 1.5, 10
"""Of the samples, how many at the highest pressure, how much worse than others they fit, and how many at least, tell
of a sensor at its end."""
ATMOSPHERE = (80.0, 108.0)
"""Between these [kPa] lies that of the surroundings; pressures that are never beyond it are perhaps absolute."""
NEAR_REST, NO_FORCE = 0.02, 0.1
"""Strains, and shares of pressures' range, that are those at rest; of the largest force, what share is none."""
CONTRADICTING = 0.02
"""Of the largest force, by how much forces at one strain and pressure may differ: presses and hysteresis do as much."""
ALIKE, SAME_GAUGE, OTHER_PRESSURE = 0.9, 0.01, 0.2
"""The squared correlation of a file's strains and extensions, at least: grips slip. By which shares two gauge lengths
may differ, as files round strains, and the highest pressures of a run's two files."""
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


def warn_of_doubts(
    model: Actuator, recording: Recording, files: Sequence[tuple[TesterRecord, PressureRecord]] = ()
) -> None:
    """A warning for each thing that is doubtful about a model, the recording that it was fitted to, and its files."""
    residual = recording.force - forces(model, recording.strain, recording.pressure)
    for doubt in (
        _unbalanced(recording),
        _low(recording, residual),
        _contradicting(recording),
        _spikes(recording, residual),
        _size(recording),
        _absolute(recording),
        _clipped(recording),
        _undetermined(model, recording, residual),
        _beyond(model),
        *(_other_strains(tester) for tester, _ in files),
        *(_other_pressures(*both) for both in files),
    ):
        if doubt:
            warnings.warn(doubt, stacklevel=2)


def _size(recording: Recording) -> str:
    """Whether the largest force is none of a soft actuator."""
    most = float(np.quantile(np.abs(recording.force), 0.99))  # spikes are told as such
    if FORCES[0] <= most <= FORCES[1]:
        return ""
    return (
        f"forces of one actuator reach {most:.3g} N, those of soft ones {FORCES[0]:g} to {FORCES[1]:g} N: are the unit "
        "of force and the number of actuators right?"
    )


def _absolute(recording: Recording) -> str:
    """Whether pressures end at that of the surroundings, and no force at rest tells that this is a pressure."""
    strain, pressure, force = recording.strain, recording.pressure, np.abs(recording.force)
    low, high = float(pressure.min()), float(pressure.max())
    end = next((end for end in (low, high) if ATMOSPHERE[0] <= end <= ATMOSPHERE[1]), None)
    if end is None or low < NEAR_REST * high:
        return ""
    at_rest = (np.abs(strain) <= NEAR_REST) & (np.abs(pressure - end) <= NEAR_REST * (high - low))
    none = bool(at_rest.any()) and float(force[at_rest].mean()) < NO_FORCE * float(force.max())
    if not none and (at_rest.any() or end != low or is_table(recording)):  # tables may begin at any pressure
        return ""
    return (
        f"pressures are never {'below' if end == low else 'above'} {end:.4g} kPa"
        f"{', where the actuator has no force' * none}: are they absolute? --columns or --pressure-columns says so: "
        f'"pressure=2:kPa abs"{", beside --vacuum" * (end != low)}'
    )


def _clipped(recording: Recording) -> str:
    """Whether pressures stand at their highest while forces go on, as no function of strain tells them there."""
    strain, pressure, force = recording.strain, recording.pressure, recording.force
    top = pressure >= pressure.max() - 1e-6 * float(np.ptp(pressure))
    if is_table(recording) or top.sum() < max(AT_LEAST, STUCK * len(top)) or (~top).sum() < AT_LEAST:
        return ""
    own, rest = (
        np.sqrt(least_squares_loss(strain[part], pressure[part], force[part], powers) / part.sum())
        for part, powers in ((top, ((0, 0), (1, 0), (2, 0), (3, 0))), (~top, exponents(USUAL_DEGREE)))
    )
    if own < max(MORE_OFF * rest, SPIKE_OF_FORCE * float(np.abs(force).max())):
        return ""
    return (
        f"{top.sum()} samples are at exactly {pressure.max():.4g} kPa, the highest pressure, while forces change by "
        f"{own:.2g} N more than strains tell: was the pressure clipped, as the sensor or the logger reached its end?"
    )


def _contradicting(recording: Recording) -> str:
    """Whether a table has several forces at one strain and pressure."""
    if not is_table(recording):
        return ""
    strain, pressure, force = recording.strain, recording.pressure, recording.force
    order = np.lexsort((force, pressure, strain))
    same = (np.diff(strain[order]) == 0) & (np.diff(pressure[order]) == 0)
    apart = np.diff(force[order]) * same
    many, worst = (apart > CONTRADICTING * np.abs(force).max()).sum(), int(apart.argmax())
    if not many:
        return ""
    a, b = sorted(order[worst : worst + 2].tolist())
    return (
        f"{_sample(recording, a)} and {_sample(recording, b)} contradict each other: {force[a]:.4g} and "
        f"{force[b]:.4g} N at strain {strain[a]:.3g} and {pressure[a]:.4g} kPa; {many} such in all"
    )


def _sample(recording: Recording, index: int) -> str:
    """`sample 3 of b.csv`, counted from 1 in its run."""
    run = recording.run[index]
    return f"sample {index - int((recording.run == run).argmax()) + 1} of {recording.sources[run]}"


def _other_strains(tester: TesterRecord) -> str:
    """Whether a file's strains and lengths do not go together, or mean another gauge length than was given."""
    both = [tester.beside[name] for name in ("strain", "extension") if name in tester.beside]
    finite = np.isfinite(both).all(0)
    if len(both) < 2 or not finite.any():
        return ""
    strain, extension = (values[finite] - values[finite].mean() for values in both)
    together, own, other = float(strain @ extension), float(strain @ strain), float(extension @ extension)
    if together**2 < ALIKE * own * other:
        return (
            f"{tester.source}: its strains and its lengths do not go together: is the header right, or are columns "
            "swapped? --columns says which is which"
        )
    given, meant = tester.gauge_length, abs(together) / max(own, 1e-300)
    if given is None or not own or abs(meant / given - 1.0) <= SAME_GAUGE:
        return ""
    return (
        f"{tester.source}: its own strains mean a gauge length of {1e3 * meant:.4g} mm, got {1e3 * given:.4g} mm, "
        "which is taken"
    )


def _other_pressures(tester: TesterRecord, log: PressureRecord) -> str:
    """Whether the tester's file has pressures, too, whose highest is another than the log's."""
    own = tester.beside.get("pressure", np.empty(0))
    most, logged = float(own[np.isfinite(own)].max(initial=-np.inf)), float(log.pressure.max())
    if log.source == tester.source or most < 0 or abs(most - logged) <= OTHER_PRESSURE * max(most, logged):
        return ""
    return (
        f"{tester.source}: its own pressures reach {most:.4g} kPa, those of {log.source} {logged:.4g} kPa, which "
        "are taken: are their units right, and are they of one run?"
    )


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
    if np.ptp(recording.force) == 0:
        return f"forces are {recording.force.mean():.4g} N in every sample: is it the right column?"
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
        "none of: was the load cell balanced with the actuators at their own length, without pressure?"
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
        f"{which} out from those about, {_sample(recording, worst)} the most, by "
        f"{abs(out[worst]):.3g} N at strain {recording.strain[worst]:.3g} and {recording.pressure[worst]:.4g} kPa "
        f"(RMSE {rmse:.3g} N): --loss huber bears such"
    )


def _beyond(model: Actuator) -> str:
    known, limit = float(model.pressure_range[1]), float(model.max_pressure)
    if not isinstance(model, Measured) or limit <= known * (1 + 1e-6):
        return ""
    return f"max_pressure: {limit:g} kPa is beyond {known:.4g} kPa, above which nothing was measured"
