"""From recordings to a force model whose quality is stated.

    model = fit_recording(pool([align(read_tester(csv), read_pressure(log), actuators=4), ...]))

The model is a polynomial actuator, ready for any arm; `model.quality` says how far to trust it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from torcharm.actuators.bending import Bending, LinearBending
from torcharm.actuators.measured import SLACK, Measured, Provenance, measured_region
from torcharm.actuators.polynomial import PAPER_BENDING_STIFFNESS, PolynomialActuator
from torcharm.characterise.alignment import Recording, is_table
from torcharm.characterise.least_squares import (
    LOSSES,
    Array,
    Monomials,
    Powers,
    Solution,
    correlation_length,
    covariance,
    exponents,
    held_monotonic,
    robust,
)
from torcharm.characterise.monotonicity import Monotonicity, monotonicity
from torcharm.characterise.signs import LEAST_STRAIN
from torcharm.inputs import TensorLike, as_floating, check_choice, check_count, check_number

HIGHEST_DEGREE = 9
VACUUM_SHARE = 0.1
"""Of the range of pressures, how much may lie below 0: more than the zero of any sensor is off."""
LEAST_PRESSURE = 0.1
"""A range of pressures [kPa] below which samples differ by noise alone, as `LEAST_STRAIN` is of strains."""


@dataclass(frozen=True)
class HoldOut:
    """One run predicted by a fit to the others.

    Attributes:
        run: which, counted from 0.
        samples: in it.
        r_squared, rmse [N]: of the prediction.
    """

    run: int
    samples: int
    r_squared: float
    rmse: float


@dataclass(frozen=True)
class FitQuality:
    """How well a polynomial fits, and how well its K coefficients are known.

    Attributes:
        samples, runs: how many.
        r_squared: 1 - Σ r² / Σ (f - mean f)².
        rmse: root of the mean squared residual [N].
        standard_errors: (K) of the coefficients, in their order and units.
        covariance: (K, K) of the coefficients.
        correlation_length: samples over which residuals were taken as correlated.
        force_range: of the data [N].
        loss, loss_scale [N]: of the fit; the scale is 0 for least squares.
        constrained: whether it was held monotonic.
        hold_out: for each run; empty if there is one run.
        monotonicity: in pressure, over the range of the data.

    Example:
        >>> round(ta.fit_force_model([0, 0.1, 0, 0.1], [0, 0, 50, 50], [0, -3, 45, 40], degree=1).quality.rmse, 2)
        0.58
    """

    samples: int
    runs: int
    r_squared: float
    rmse: float
    standard_errors: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]
    correlation_length: int
    force_range: tuple[float, float]
    loss: str
    loss_scale: float
    constrained: bool
    hold_out: tuple[HoldOut, ...]
    monotonicity: Monotonicity


@dataclass(frozen=True)
class FittedActuator(Measured, PolynomialActuator):
    """A polynomial actuator that knows where it comes from and how good it is.

    Attributes:
        quality: of the fit.
        region, provenance: as of `Measured`; all others as of `PolynomialActuator`.

    Example:
        >>> ta.fit_force_model([0, 0.1, 0, 0.1], [0, 0, 50, 50], [0, -3, 45, 42], degree=1).pressure_range  # measured
        (0.0, 50.0)
    """

    name: ClassVar[str] = "fitted polynomial"
    quality: FitQuality | None = field(default=None, repr=False)


def fit_force_model(
    strain: TensorLike,
    pressure: TensorLike,
    force: TensorLike,
    degree: int = 3,
    *,
    run: TensorLike | None = None,
    loss: str = "linear",
    loss_scale: float | None = None,
    monotonic: bool = False,
    correlated: int | None = None,
    max_pressure: float | None = None,
    bending_stiffness: float | Bending | None = None,
    terms: Powers | None = None,
    provenance: Provenance = (),
) -> FittedActuator:
    """Fit `f(ε, p) = Σ c_ij ε^i p^j`, `1 ≤ i + j ≤ degree`: no force at rest without pressure.

    Standard errors hold for noise that is uneven and correlated in time (Newey and West, as of
    `torcharm.characterise.least_squares.covariance`): give samples in order of time.

    Args:
        strain, pressure [kPa], force [N]: n samples each, positive force pushing outward.
        degree: total, 1 to 9; the paper's is 3.
        run: n labels: samples of the same label come from one run, and stand together. None: all from one.
        loss: of residuals, as of `scipy.optimize.least_squares`: "linear" is least squares; "huber", "soft_l1"
            and "cauchy" bear outliers.
        loss_scale: residual [N] at which a robust loss bends; None takes 1.345 σ of the residuals' bulk.
        monotonic: whether to constrain the force to be monotonic in pressure, over the strains of the data and
            pressures from 0 to `max_pressure` (or the data's highest).
        correlated: samples over which noise is correlated, 1 for independent; None estimates it.
        max_pressure: highest pressure in use [kPa]; None: to where the fit is monotonic at all strains of the data.
        bending_stiffness: K [N·m²] at `max_pressure`, or a bending model. A tensile test does not measure it: None
            takes the paper's estimate, and marks it as assumed.
        terms: powers (i, j) of strain and pressure, in place of all up to the degree.
        provenance: names and values to keep with the model.

    Raises:
        ValueError: samples do not match in number, are not finite, tell nothing (see `check_informative`) or are too
            few to determine the coefficients, or an argument is none of those allowed.

    Example:
        >>> strain, pressure, force = [0.0, 0.1, 0.0, 0.1], [0.0, 0.0, 50.0, 50.0], [0.0, -3.0, 45.0, 42.0]
        >>> [(i, j, round(c, 3)) for i, j, c in ta.fit_force_model(strain, pressure, force, degree=1).coefficients]
        [(1, 0, -30.0), (0, 1, 0.9)]
    """
    x, y, f = checked_samples(strain, pressure, force)
    runs = _runs(run, len(f))
    _check_options(degree, loss, loss_scale, correlated, max_pressure)
    powers = terms or exponents(int(degree))
    check_informative(x, y, f)
    top = float(y.max()) if max_pressure is None else max_pressure
    fitter = partial(_fit, powers=powers, loss=loss, scale=loss_scale, monotonic=monotonic, top=top)
    monomials, found = fitter(x, y, f)
    length = correlation_length(found.residual, runs) if correlated is None else correlated
    spread = covariance(found, runs, length) / np.outer(monomials.scale, monomials.scale)
    strains, pressures = (float(x.min()), float(x.max())), characterised_pressures(y)
    values = (found.coefficients / monomials.scale).tolist()
    coefficients = tuple((i, j, c) for (i, j), c in zip(powers, values, strict=True))
    shape = monotonicity(PolynomialActuator(coefficients, strains, pressures, max(pressures[1], 1e-9)))
    if max_pressure is None:
        max_pressure = shape.up_to if shape.up_to > pressures[0] else pressures[1]
    quality = FitQuality(
        samples=len(f),
        runs=len(runs),
        **_errors(f, found.residual),
        standard_errors=tuple(np.sqrt(np.diag(spread)).tolist()),
        covariance=tuple(map(tuple, spread.tolist())),
        correlation_length=length,
        force_range=(float(f.min()), float(f.max())),
        loss=loss,
        loss_scale=0.0 if loss == "linear" else found.scale,
        constrained=monotonic,
        hold_out=_hold_out(x, y, f, runs, fitter),
        monotonicity=shape,
    )
    return FittedActuator(
        coefficients,
        strains,
        pressures,
        max_pressure,
        known_bending(bending_stiffness),
        quality=quality,
        region=measured_region(x, y.clip(min=0)),
        provenance=provenance,
    )


def known_bending(given: float | Bending | None) -> float | Bending:
    """A bending stiffness or model; None: the paper's estimate, marked as assumed."""
    return LinearBending(PAPER_BENDING_STIFFNESS, assumed=True) if given is None else given


def characterised_pressures(pressure: Array) -> tuple[float, float]:
    """The range of pressures [kPa], from 0 on if the least is as good as that."""
    low, high = (max(0.0, float(end)) for end in (pressure.min(), pressure.max()))
    return (0.0 if low <= SLACK * high else low), high


def check_informative(strain: Array, pressure: Array, force: Array) -> None:
    """Raise a ValueError, a sentence each, about samples that tell nothing of a force by strain and pressure.

    All forces are 0, strain or pressure does not vary, or pressures lie below that of the surroundings: sets, limits
    and searches of pressure begin at 0.
    """
    if not force.any():
        raise ValueError(
            "force: must not be 0 in every sample: a test of free lengths tells how far an actuator moves, and nothing "
            "of its force"
        )
    deepest, highest = float(pressure.min()), float(pressure.max())
    if deepest < 0 and -deepest > VACUUM_SHARE * (highest - deepest):
        raise ValueError(
            f"pressure: must be gauge pressures from 0 up, got {deepest:g} to {highest:g} kPa: vacuum is not supported "
            "as such; give its depth as the pressure (torcharm fit --vacuum), positive as limits and results will be"
        )
    for name, values, least, unit in (
        ("strain", strain, LEAST_STRAIN, ""),
        ("pressure", pressure, LEAST_PRESSURE, " kPa"),
    ):
        if np.ptp(values) < least:
            raise ValueError(
                f"{name}: must vary by {least:g}{unit} or more, got {values.mean():.4g}{unit} in every sample, which "
                f"tells nothing of what {name} does"
            )


def fit_recording(recording: Recording, degree: int = 3, **options: Any) -> FittedActuator:
    """`fit_force_model` on one run or several pooled, with files and settings as provenance; same options and errors.

    Example:
        >>> _ = (path := folder / "data.csv").write_text("strain,p [kPa],F [N]\\n0,0,0\\n0.1,0,-3\\n0,50,45\\n")
        >>> [round(c, 3) for *_, c in ta.fit_recording(ta.read_table(path, positive="push"), degree=1).coefficients]
        [-30.0, 0.9]
    """
    own = (*provenance_of(recording), *options.pop("provenance", ()))
    if is_table(recording):
        options.setdefault("correlated", 1)
    return fit_force_model(
        recording.strain, recording.pressure, recording.force, degree, run=recording.run, provenance=own, **options
    )


def provenance_of(recording: Recording) -> Provenance:
    """Where a model of a recording comes from: this version, files and settings."""
    from torcharm import __version__

    files = tuple((f"run {index + 1}", source) for index, source in enumerate(recording.sources))
    return (("torcharm", __version__), *files, *recording.settings)


def _runs(labels: TensorLike | None, count: int) -> list[slice]:
    """Where each run's samples are, which stand together."""
    if labels is None:
        return [slice(0, count)]
    own = _column("run", labels)
    if len(own) != count:
        raise ValueError(f"run: must hold one label for each of {count} samples, got {len(own)}")
    edges = [0, *(np.flatnonzero(np.diff(own)) + 1).tolist(), count]
    if len(np.unique(own)) < len(edges) - 1:
        raise ValueError("run: samples of one run must stand together, got labels that come back")
    return [slice(*ends) for ends in pairwise(edges)]


def checked_samples(strain: TensorLike, pressure: TensorLike, force: TensorLike) -> tuple[Array, Array, Array]:
    """Three columns of as many finite numbers.

    Raises:
        ValueError: they are not.
    """
    x, y, f = (_column(n, v) for n, v in (("strain", strain), ("pressure", pressure), ("force", force)))
    if not 0 < len(f) == len(x) == len(y):
        raise ValueError(
            f"strain, pressure, force: must hold one number for each sample, got {len(x)}, {len(y)}, {len(f)}"
        )
    return x, y, f


def _column(name: str, value: TensorLike) -> Array:
    (tensor,) = as_floating(**{name: value})
    column: Array = tensor.detach().cpu().double().flatten().numpy()
    bad = ~np.isfinite(column)
    if bad.any():
        raise ValueError(f"{name}: must be finite, got {column[bad][0]} at sample {int(bad.argmax()) + 1}")
    return column


def _check_options(
    degree: int, loss: str, loss_scale: float | None, correlated: int | None, max_pressure: float | None
) -> None:
    if check_count("degree", degree, 1) > HIGHEST_DEGREE:
        raise ValueError(f"degree: must be at most {HIGHEST_DEGREE}, got {degree}")
    check_choice("loss", loss, LOSSES)
    for name, value in (("loss_scale", loss_scale), ("max_pressure", max_pressure)):
        if value is not None:
            check_number(name, value, 0.0, strict=True)
    if correlated is not None:
        check_count("correlated", correlated, 1)


def _fit(
    strain: Array,
    pressure: Array,
    force: Array,
    *,
    powers: Powers,
    loss: str,
    scale: float | None,
    monotonic: bool,
    top: float,
) -> tuple[Monomials, Solution]:
    """Scaled monomials and their coefficients."""
    monomials = Monomials.for_data(powers, strain, pressure)
    matrix = monomials.values(strain, pressure)
    free = robust(matrix, force, loss, scale)
    if not monotonic:
        return monomials, free
    box = (float(strain.min()), float(strain.max())), (0.0, top)
    return monomials, held_monotonic(monomials, free, box, partial(robust, matrix, force, loss, free.scale))


def _hold_out(
    strain: Array, pressure: Array, force: Array, runs: Sequence[slice], fitter: Callable[..., Any]
) -> tuple[HoldOut, ...]:
    """Each run, predicted from the others; a run that the others cannot predict has no entry."""
    found = []
    for index, own in enumerate(runs if len(runs) > 1 else []):
        rest = np.ones(len(force), bool)
        rest[own] = False
        try:
            monomials, fit = fitter(strain[rest], pressure[rest], force[rest])
        except ValueError:  # too few strains or pressures are left
            continue
        residual = force[own] - monomials.values(strain[own], pressure[own]) @ fit.coefficients
        found.append(HoldOut(index, len(residual), **_errors(force[own], residual)))
    return tuple(found)


def _errors(force: Array, residual: Array) -> dict[str, float]:
    """R² and RMSE [N]."""
    total = float(((force - force.mean()) ** 2).sum())
    share = 1 - float(residual @ residual) / total if total > 0 else 0.0
    return {"r_squared": share, "rmse": float(np.sqrt(np.mean(residual**2)))}
