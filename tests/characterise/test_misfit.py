"""How much pressures are smoothed, and whether clocks are apart: on runs whose law and clocks are known."""

import re
import warnings
from dataclasses import replace

import numpy as np
import pytest

import torcharm as ta
from torcharm.characterise import recordings
from torcharm.characterise.misfit import PAPER_SMOOTHING, smoothed

TRUTH = {(1, 0): -20.0, (0, 1): 1.1, (1, 1): -0.5}


def run(log_step=20.0, noise=0.0, period=10_000.0, late=0.0, count=3000):
    """A run of a minute, and a log at a rate of its own with noise [kPa]."""
    random, time = np.random.default_rng(6), np.arange(count) * 20.0
    strain = 0.25 + 0.2 * np.sin(time / 9100)

    def pressure(t):
        return 12 + 35 * (1 - np.cos(2 * np.pi * t / period))

    force = sum(c * strain**i * pressure(time) ** j for (i, j), c in TRUTH.items())
    clock = np.arange(0.0, time[-1] + log_step, log_step)
    logged = pressure(clock) + noise * random.normal(size=len(clock))
    return recordings.TesterRecord(time, strain, -force, "run.csv"), recordings.PressureRecord(
        clock - late, logged, "log.txt"
    )


def fitted(tester, log, **options):
    model = ta.fit_recording(ta.align(tester, log, **options), 2)
    return {(i, j): c for i, j, c in model.coefficients}


@pytest.mark.parametrize(("log_step", "period"), [(5.0, 2000.0), (20.0, 2000.0), (20.0, 10_000.0), (100.0, 10_000.0)])
def test_a_log_of_any_rate_gives_the_law_without_bias(log_step, period):
    found = fitted(*run(log_step, period=period))
    for powers, value in TRUTH.items():
        assert found[powers] == pytest.approx(value, rel=0.01)


def test_noise_is_smoothed_where_that_fits_better():
    tester, log = run(10.0, noise=3.0, period=30_000.0)
    recording = ta.align(tester, log)
    assert dict(recording.settings)["smoothing of pressure, ms"] == PAPER_SMOOTHING
    rough = ta.align(tester, log, smoothing=0.0)
    assert ta.fit_recording(recording, 2).quality.rmse < 0.5 * ta.fit_recording(rough, 2).quality.rmse


def test_a_spike_of_the_force_does_not_decide_about_smoothing():
    tester, log = run()
    force = tester.force.copy()
    force[1500] += 500.0
    assert dict(ta.align(replace(tester, force=force), log).settings)["smoothing of pressure, ms"] == 0.0


def test_smoothing_is_a_time():
    _, fine = run(10.0, noise=1.0)
    coarse = recordings.PressureRecord(fine.time[::2], fine.pressure[::2], "log.txt")
    plain = np.sin(fine.time / 3000)
    one = smoothed(replace(fine, pressure=plain), 440.0)[::2]
    other = smoothed(replace(coarse, pressure=plain[::2]), 440.0)
    np.testing.assert_allclose(one[200:-200], other[200:-200], atol=1e-4)
    with pytest.raises(ValueError, match=r"^smoothing: must be at most the length of log.txt, 59980 ms, got 1e\+09 ms"):
        smoothed(fine, 1e9)


@pytest.mark.parametrize("late", [-700.0, 1300.0])
def test_clocks_that_are_apart_are_a_warning(late):
    tester, log = run(noise=0.2, period=23_000.0, late=late)
    with pytest.warns(UserWarning, match=r"run.csv and log.txt: clocks seem to be apart: .* --find-offset") as caught:
        ta.align(tester, log)
    (shift,) = re.findall(r"with ([+-]\d+) ms", str(caught[0].message))
    assert float(shift) == pytest.approx(late, abs=100.0)


@pytest.mark.parametrize(("late", "options"), [(0.0, {}), (700.0, {"offset": 0.0}), (700.0, {"offset": 700.0})])
def test_clocks_that_agree_or_are_said_are_none(late, options):
    tester, log = run(noise=0.2, period=23_000.0, late=late)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ta.align(tester, log, **options)
        ta.align(tester, replace(log, time=log.time + late, source="run.csv"))  # one file, one clock
