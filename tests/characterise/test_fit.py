"""Fits against known truths, scipy's own solvers, published coefficients, and repeated noise."""

import os
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, strategies as st
from scipy.optimize import least_squares, minimize

import torcharm as ta
from torcharm.actuators.polynomial import BELLOWS_COEFFICIENTS
from torcharm.characterise.least_squares import (
    MARGIN,
    Monomials,
    correlation_length,
    covariance,
    exponents,
    robust,
    solve,
)

TRUTH = ta.Bellows()


def samples(count=4000, noise=0.0, seed=0, rho=0.0, model=TRUTH):
    """Samples of a model over the characterised box, with Gaussian noise of correlation rho from one to the next."""
    random = np.random.default_rng(seed)
    strain = random.uniform(*model.strain_range, count)
    pressure = random.uniform(0, model.pressure_range[1], count)
    force = model.force(torch.from_numpy(strain), torch.from_numpy(pressure)).numpy()
    return strain, pressure, force + noise * coloured(random, count, rho)


def coloured(random, count, rho):
    white = random.normal(size=count)
    from scipy.signal import lfilter

    return lfilter([np.sqrt(1 - rho**2)], [1, -rho], white)


def coefficients(model):
    return np.array([c for *_, c in model.coefficients])


PUBLISHED = np.array([c for *_, c in BELLOWS_COEFFICIENTS])


def test_terms_are_the_papers():
    assert exponents(3) == tuple((i, j) for i, j, _ in BELLOWS_COEFFICIENTS)
    assert all(len(exponents(degree)) == (degree + 1) * (degree + 2) // 2 - 1 for degree in range(1, 8))


def test_exact_data_give_the_exact_model():
    model = ta.fit_force_model(*samples())
    np.testing.assert_allclose(coefficients(model), PUBLISHED, rtol=1e-9)
    assert isinstance(model, ta.PolynomialActuator)
    assert model.quality.r_squared == pytest.approx(1.0, abs=1e-12)
    assert model.quality.rmse < 1e-10


def test_tensors_do_as_well_and_the_ranges_are_the_datas():
    strain, pressure, force = (torch.from_numpy(value) for value in samples())
    model = ta.fit_force_model(strain, pressure, force, max_pressure=50.0, bending_stiffness=-0.1)
    assert model.strain_range == (strain.min().item(), strain.max().item())
    assert model.pressure_range == (0.0, pressure.max().item())
    assert (model.max_pressure, model.bending_stiffness) == (50.0, -0.1)
    arm = ta.ArmDesign([-0.05, 0.05], 0.5, [model, model])
    task = ta.Task(ta.affine_curvature(0.5, 0.5), [1.0, -1.0, 0.0])
    paper = ta.ArmDesign([-0.05, 0.05], 0.5, [ta.Bellows(bending_stiffness=-0.1)] * 2)
    torch.testing.assert_close(
        ta.evaluate(arm, task, ("absolute", "relative")).absolute,
        ta.evaluate(paper, task, ("absolute", "relative")).absolute,
    )


@pytest.mark.parametrize("degree", [1, 2, 4, 6])
def test_any_degree_is_numpys_least_squares(degree):
    strain, pressure, force = samples(500, noise=1.0)
    model = ta.fit_force_model(strain, pressure, force, degree)
    columns = np.stack([(strain**i) * (pressure / 90) ** j for i, j in exponents(degree)], -1)
    expected, *_ = np.linalg.lstsq(columns, force, rcond=None)
    found = coefficients(model) * [90.0**j for _, j in exponents(degree)]
    np.testing.assert_allclose(found, expected, rtol=1e-6)


@given(st.floats(0.2, 5.0), st.floats(0.2, 5.0))
def test_units_do_not_matter(per_force, per_pressure):
    strain, pressure, force = samples(300, noise=1.0)
    one = ta.fit_force_model(strain, pressure, force)
    other = ta.fit_force_model(strain, per_pressure * pressure, per_force * force)
    scale = np.array([per_force / per_pressure**j for _, j in exponents(3)])
    np.testing.assert_allclose(coefficients(other), scale * coefficients(one), rtol=1e-7)
    assert other.quality.r_squared == pytest.approx(one.quality.r_squared, rel=1e-9)
    np.testing.assert_allclose(other.quality.standard_errors, scale * np.array(one.quality.standard_errors), rtol=1e-6)


# Standard errors


def test_standard_errors_of_independent_noise_are_the_textbooks():
    strain, pressure, force = samples(20_000, noise=1.0)
    quality = ta.fit_force_model(strain, pressure, force, correlated=1).quality
    columns = np.stack([strain**i * pressure**j for i, j in exponents(3)], -1)
    textbook = np.linalg.inv(columns.T @ columns) * quality.rmse**2
    np.testing.assert_allclose(quality.standard_errors, np.sqrt(np.diag(textbook)), rtol=0.05)
    np.testing.assert_allclose(np.diag(quality.covariance), np.square(quality.standard_errors), rtol=1e-12)


@pytest.mark.parametrize(("rho", "loss"), [(0.0, "linear"), (0.9, "linear"), (0.9, "huber"), (0.0, "cauchy")])
def test_repeated_noise_spreads_coefficients_as_the_standard_errors_say(rho, loss):
    """The check that errors are honest: the truth is missed by as many standard errors as a Gaussian misses it."""
    time = np.arange(3000)
    strain = 0.25 + 0.4 * np.sin(time / 40.0)
    pressure = 40 - 40 * np.cos(time / 9.0)
    clean = TRUTH.force(torch.from_numpy(strain), torch.from_numpy(pressure)).numpy()
    missed = []
    for seed in range(120):
        noise = coloured(np.random.default_rng(seed), 3000, rho)
        model = ta.fit_force_model(strain, pressure, clean + noise, loss=loss)
        missed.append((coefficients(model) - PUBLISHED) / model.quality.standard_errors)
    missed = np.array(missed)
    # 120 repetitions know a spread to 6.5 %; a window that is estimated underrates correlated noise a little.
    assert np.abs(missed.mean(0)).max() < 4 / np.sqrt(120)
    assert 0.85 < missed.std(0).mean() < (1.1 if rho == 0 else 1.25)
    assert (np.abs(missed) < 2).mean() > 0.88
    if rho:
        naive = ta.fit_force_model(strain, pressure, clean + noise, correlated=1).quality.standard_errors
        assert np.mean(np.array(model.quality.standard_errors) / naive) > 1.8


def test_the_window_follows_the_correlation():
    random = np.random.default_rng(1)
    runs = [slice(0, 20_000)]
    white, red = (correlation_length(coloured(random, 20_000, rho), runs) for rho in (0.0, 0.95))
    assert white <= 5
    assert 100 < red < 500


def test_bartletts_weights():
    """The windows' mean is the double sum over lags, run by run."""
    random = np.random.default_rng(2)
    matrix, force = random.normal(size=(60, 3)), random.normal(size=60)
    found = solve(matrix, force)
    runs, length = [slice(0, 25), slice(25, 60)], 7
    score = matrix * found.residual[:, None]
    spread = np.zeros((3, 3))
    for run in runs:
        own = score[run]
        for s in range(len(own)):
            for t in range(len(own)):
                spread += max(0, 1 - abs(s - t) / length) * np.outer(own[s], own[t])
    inverse = np.linalg.inv(matrix.T @ matrix)
    expected = inverse @ spread @ inverse * 60 / 57
    np.testing.assert_allclose(covariance(found, runs, length), expected, rtol=1e-10)


# Robust and constrained


@pytest.mark.parametrize("loss", ["huber", "soft_l1", "cauchy"])
def test_robust_fits_are_scipys(loss):
    strain, pressure, force = samples(800, noise=0.5)
    force[::15] += 40.0
    monomials = Monomials.for_data(exponents(3), strain, pressure)
    matrix = monomials.values(strain, pressure)
    found = robust(matrix, force, loss, 1.0)
    theirs = least_squares(
        lambda c: matrix @ c - force,
        found.coefficients + 0.3,
        lambda c: matrix.copy(),  # older scipy weights it in place
        loss=loss,
        f_scale=found.scale,
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-12,
    )
    np.testing.assert_allclose(found.coefficients, theirs.x, rtol=0, atol=2e-5 * np.abs(theirs.x).max())


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_the_unit_of_force_is_of_no_matter_to_a_robust_fit(unit):
    """The scale is the residual's own, and the rounds end when they move the force by a share of its size."""
    strain, pressure, force = samples(800, noise=0.5)
    force[::15] += 40.0
    monomials = Monomials.for_data(exponents(3), strain, pressure)
    matrix = monomials.values(strain, pressure)
    fits = [robust(matrix, one, "cauchy") for one in (force, unit * force)]
    np.testing.assert_allclose(fits[1].coefficients / unit, fits[0].coefficients, rtol=1e-7)


@pytest.mark.parametrize("loss", ["huber", "soft_l1", "cauchy"])
def test_outliers_move_a_robust_fit_little(loss):
    strain, pressure, force = samples(3000, noise=0.5)
    force[::20] -= 60.0
    box = torch.linspace(-0.1, 0.6, 30, dtype=torch.float64)[:, None], torch.linspace(0, 90, 30, dtype=torch.float64)
    off = {
        name: (ta.fit_force_model(strain, pressure, force, loss=name).force(*box) - TRUTH.force(*box))
        .abs()
        .max()
        .item()
        for name in ("linear", loss)
    }
    assert off["linear"] > 3.0
    assert off[loss] < off["linear"] / 5


def falling():
    """A cubic truth that falls with pressure in one corner."""
    return ta.PolynomialActuator(
        ((1, 0, -20.0), (0, 1, 1.0), (0, 2, -0.004), (1, 2, -0.004)), (-0.1, 0.6), (0.0, 90.0), 90.0
    )


def test_a_constrained_fit_is_monotonic_and_scipys():
    strain, pressure, force = samples(400, noise=0.3, model=falling())
    free = ta.fit_force_model(strain, pressure, force)
    held = ta.fit_force_model(strain, pressure, force, monotonic=True)
    assert not free.quality.monotonicity.monotonic
    assert held.quality.monotonicity.monotonic
    assert held.quality.constrained
    assert held.max_pressure == pytest.approx(pressure.max())
    assert ta.monotonicity(held, points=1001).monotonic
    assert held.quality.r_squared < free.quality.r_squared
    # an independent solver, with slopes held on a dense grid
    monomials = Monomials.for_data(exponents(3), strain, pressure)
    matrix = monomials.values(strain, pressure)
    grid = np.meshgrid(np.linspace(strain.min(), strain.max(), 30), np.linspace(0, pressure.max(), 30))
    slopes = monomials.slopes(grid[0].ravel(), grid[1].ravel())
    margin = MARGIN * (slopes @ (coefficients(free) * monomials.scale)).mean()
    theirs = minimize(
        lambda c: ((matrix @ c - force) ** 2).mean(),
        coefficients(held) * monomials.scale,
        jac=lambda c: 2 * matrix.T @ (matrix @ c - force) / len(force),
        constraints={"type": "ineq", "fun": lambda c: slopes @ c - margin, "jac": lambda c: slopes},
        method="SLSQP",
        options={"ftol": 1e-13, "maxiter": 500},
    )
    assert theirs.success
    assert held.quality.rmse**2 == pytest.approx(theirs.fun, rel=1e-4)


def test_a_constraint_that_does_not_bind_changes_nothing():
    strain, pressure, force = samples(500, noise=0.5)
    free = ta.fit_force_model(strain, pressure, force, max_pressure=40.0)
    held = ta.fit_force_model(strain, pressure, force, max_pressure=40.0, monotonic=True)
    np.testing.assert_allclose(coefficients(held), coefficients(free), rtol=1e-9)
    np.testing.assert_allclose(held.quality.standard_errors, free.quality.standard_errors, rtol=1e-6)


def test_falling_forces_are_held_to_fall_and_losses_go_with_constraints():
    strain, pressure, force = samples(400, noise=0.3, model=falling())
    held = ta.fit_force_model(strain, pressure, -force, monotonic=True, loss="huber")
    assert held.quality.monotonicity.monotonic
    assert not held.quality.monotonicity.rising


# Runs


def test_hold_out_is_each_run_predicted_by_the_others():
    strain, pressure, force = samples(900, noise=1.0)
    run = np.repeat([3, 1, 7], 300)
    found = ta.fit_force_model(strain, pressure, force, run=run).quality
    assert (found.runs, found.samples) == (3, 900)
    for index, one in enumerate(found.hold_out):
        own = run == run[300 * index]
        model = ta.fit_force_model(strain[~own], pressure[~own], force[~own])
        error = force[own] - model.force(torch.from_numpy(strain[own]), torch.from_numpy(pressure[own])).numpy()
        assert one.rmse == pytest.approx(np.sqrt((error**2).mean()), rel=1e-9)
        assert one.r_squared == pytest.approx(1 - (error**2).sum() / ((force[own] - force[own].mean()) ** 2).sum())
    assert ta.fit_force_model(strain, pressure, force).quality.hold_out == ()


def test_runs_of_which_one_alone_is_not_enough():
    strain, pressure, force = samples(600)
    strain[:300] = 0.1  # which cannot predict other strains
    quality = ta.fit_force_model(strain, pressure, force, run=np.repeat([0, 1], 300)).quality
    assert [one.run for one in quality.hold_out] == [0]


# Bad input


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"strain": np.full(50, 0.1)}, "strain: must vary by 0.001 or more, got 0.1 in every sample"),
        ({"pressure": np.full(50, 30.0)}, "pressure: must vary by 0.1 kPa or more, got 30 kPa in every sample"),
        ({"force": np.zeros(50)}, "force: must not be 0 in every sample: a test of free lengths"),
        ({"pressure": np.linspace(-40, 0, 50)}, "pressure: must be gauge .* -40 to 0 kPa: vacuum is not supported"),
        ({"force": np.zeros(49)}, "strain, pressure, force: must hold one number for each sample, got 50, 50, 49"),
        ({"force": np.r_[0, np.nan, np.ones(48)]}, "force: must be finite, got nan at sample 2$"),
        ({"strain": ["a"] * 50}, "strain: must be numbers"),
        ({"degree": 0}, "degree: must be an integer of at least 1, got 0"),
        ({"degree": 10}, "degree: must be at most 9, got 10"),
        ({"degree": 9}, "strain, pressure: must vary enough to determine 54 coefficients, got 50 samples"),
        ({"loss": "arctan"}, "loss: must be one of linear, huber, soft_l1, cauchy"),
        ({"loss_scale": 0.0}, "loss_scale: must be a finite number and above 0"),
        ({"max_pressure": -1.0}, "max_pressure: must be a finite number and above 0"),
        ({"correlated": 0}, "correlated: must be an integer of at least 1"),
        ({"run": np.zeros(3)}, "run: must hold one label for each of 50 samples, got 3"),
        ({"run": np.arange(50) % 2}, "run: samples of one run must stand together"),
    ],
)
def test_bad_input(change, message):
    strain, pressure, force = samples(50)
    arguments = {"strain": strain, "pressure": pressure, "force": force, **change}
    with pytest.raises(ValueError, match=f"^{message}"):
        ta.fit_force_model(**arguments)


# The paper's recordings

DATA = Path(os.environ["TORCHARM_DATA"]) / "bellows_characterisation" if "TORCHARM_DATA" in os.environ else None


@pytest.mark.skipif(DATA is None, reason="needs raw test-bench recordings: TORCHARM_DATA names no folder")
def test_the_published_fit():
    with pytest.warns(UserWarning, match="clocks seem to be apart"):  # by a quarter of a second, as was published
        runs = [
            ta.align(
                ta.read_tester(DATA / f"instron_run_{k}.csv"),
                ta.read_pressure(DATA / f"pressure_run_{k}.txt"),
                actuators=4,
            )
            for k in (1, 2)
        ]
    model = ta.fit_recording(ta.pool(runs))
    np.testing.assert_allclose(coefficients(model), PUBLISHED, rtol=2e-3)  # 0.1 % at most, on ε² p
    assert model.quality.r_squared == pytest.approx(0.9947, abs=1e-4)
    assert 80 < model.quality.monotonicity.up_to < 92
    assert [one.r_squared > 0.98 for one in model.quality.hold_out] == [True, True]
    assert dict(model.provenance)["run 2"] == "instron_run_2.csv, pressure_run_2.txt"
