"""What is doubtful about a fit is said, and what is not is not."""

import warnings
from dataclasses import replace

import layouts
import numpy as np
import pytest
import torch

import torcharm as ta
from torcharm.characterise.doubts import warn_of_doubts


def recording(noise=0.2, spikes=(), count=2000):
    random = np.random.default_rng(2)
    time = np.arange(count) * 0.02
    strain, pressure = 0.25 + 0.3 * np.sin(time / 3.1), 40 * (1 - np.cos(time))
    force = ta.Bellows().force(torch.from_numpy(strain), torch.from_numpy(pressure)).numpy()
    force = force + noise * random.normal(size=count)
    for index, size in spikes:
        force[index] += size
    run = np.repeat([0, 1], count // 2)
    return ta.Recording(strain, pressure, force, run, ("a.csv, a.txt", "b.csv"))


def doubts(given, **options):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warn_of_doubts(ta.fit_recording(given, **options), given)
    return [str(one.message) for one in caught]


@pytest.mark.parametrize("noise", [0.0, 0.2, 3.0])
def test_a_good_fit_has_none(noise):
    assert doubts(recording(noise)) == []
    smooth = recording(0.0)  # a law that the cubic does not quite follow is no spike
    assert doubts(replace(smooth, force=smooth.force + 3 * np.sin(9 * smooth.strain))) == []


def test_spikes_are_told_by_file_sample_and_size():
    (said,) = doubts(recording(spikes=[(1400, 35.0)]))
    assert "a sample stands out from those about, sample 1401 of b.csv the most, by 35" in said
    (said,) = doubts(recording(spikes=[(300, -20.0), (301, -30.0), (1400, 20.0)]))
    assert "3 samples stand out" in said
    assert "sample 302 of a.csv, a.txt the most, by 29.7 N" in said


def test_a_load_cell_that_was_not_balanced_is_told():
    given = recording()
    (said,) = doubts(replace(given, force=given.force - 8.0))
    assert "with a force at rest, which models have none of: was the load cell balanced" in said


def test_forces_that_are_not_explained_are_told():
    given = recording()
    said = doubts(replace(given, force=np.random.default_rng(0).permutation(given.force)))
    assert "strain and pressure hardly tell the force" in said[0]


def test_limits_beyond_what_was_measured_are_told():
    assert doubts(recording(), max_pressure=500.0) == [
        "max_pressure: 500 kPa is beyond 80 kPa, above which nothing was measured"
    ]


def law(strain, pressure, count=400):
    """Samples of a law that the models hold, with the noise of sensors."""
    random = np.random.default_rng(5)
    force = sum(c * strain**i * pressure**j for (i, j), c in layouts.TRUTH.items()) + 0.05 * random.normal(size=count)
    strain, pressure = strain + 1e-4 * random.normal(size=count), (pressure + 0.1 * random.normal(size=count)).clip(0)
    return ta.Recording(strain, pressure, force, np.zeros(count, int), ("a.csv",))


TIME = np.arange(400) * 0.1


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_strain_and_pressure_that_move_together_are_told(degree):
    together = np.abs(np.sin(TIME / 2))
    (said,) = doubts(law(0.1 * together, 60 * together), degree=degree)
    assert said.startswith("strain and pressure moved together: samples cover ")
    assert "test at several pressures for each strain" in said


@pytest.mark.parametrize("degree", [2, 3])
def test_coefficients_that_samples_leave_open_are_told(degree):
    apart = law(np.where(TIME < 20, 0.1 * np.sin(TIME), 0.0), np.where(TIME < 20, 0.0, 30 * (1 - np.cos(0.942 * TIME))))
    (said,) = doubts(apart, degree=degree)
    assert f"{len(layouts.TRUTH) if degree == 2 else 9} coefficients are more than the samples determine" in said
    assert not doubts(apart, degree=1)
    assert not doubts(law(0.1 * np.sin(TIME), 30 * (1 - np.cos(0.942 * TIME))), degree=degree)


def test_forces_that_are_all_the_same_are_told():
    given = recording()
    assert doubts(replace(given, force=np.full_like(given.force, 5.0)))[-1].startswith("R² is")
