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
    assert "a sample stands out from those about, sample 401 of b.csv the most, by 35" in said
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


def test_a_pressure_that_is_clipped_is_told():
    pressure = 30 * (1 - np.cos(0.942 * TIME))
    run = law(0.1 * np.sin(TIME), pressure)
    (said,) = (one for one in doubts(replace(run, pressure=pressure.clip(max=40.0))) if "exactly" in one)
    assert "are at exactly 40 kPa, the highest pressure, while forces change by " in said
    held = law(0.1 * np.sin(TIME), pressure.clip(max=40.0))  # one that a regulator holds is none
    assert not doubts(replace(held, pressure=pressure.clip(max=40.0)))


@pytest.mark.parametrize("factor", [1e3, 1e-4])
def test_forces_that_no_soft_actuator_has_are_told(factor):
    given = recording()
    (said,) = doubts(replace(given, force=factor * given.force))
    assert "those of soft ones 0.05 to 10000 N: are the unit of force and the number of actuators right?" in said


def test_forces_that_are_all_the_same_are_told():
    given = recording()
    assert doubts(replace(given, force=np.full_like(given.force, 5.0)))[-1].startswith("forces are 5 N in every sample")


def rest(low, high, force):
    """A run from one pressure to another, of such forces."""
    pressure = np.linspace(low, high, 500)
    strain = 0.1 * np.sin(np.arange(500) / 40)
    return ta.Recording(strain, pressure, force(strain, pressure), np.zeros(500, int), ("t.csv",))


@pytest.mark.parametrize(
    ("ends", "law", "words"),
    [
        ((101.4, 141.3), lambda e, p: -60 * e + 0.9 * (p - 101.4), "never below 101.4 kPa, where the actuator has no"),
        ((101.4, 61.3), lambda e, p: -60 * e + 0.9 * (101.4 - p), "never above 101.4 kPa, where the actuator has no"),
    ],
)
def test_pressures_that_rest_at_the_atmosphere_are_asked_about(ends, law, words):
    (said,) = (one for one in doubts(rest(*ends, law)) if "absolute" in one)
    assert words in said
    assert "are they absolute? --columns or --pressure-columns says so" in said
    assert ("beside --vacuum" in said) == (ends[1] < ends[0])


def test_pressures_that_forces_tell_are_not_asked_about():
    assert not any("absolute" in one for one in doubts(rest(101.4, 141.3, lambda e, p: -60 * e + 0.9 * p)))
    assert not any("absolute" in one for one in doubts(rest(0.0, 141.3, lambda e, p: -60 * e + 0.9 * p)))


def test_forces_of_a_table_that_contradict_each_other_are_told():
    strain, pressure = (x.ravel() for x in np.meshgrid(np.linspace(0, -0.25, 6), np.arange(0, 700.0, 100.0)))
    strain, pressure = np.append(strain, strain[8]), np.append(pressure, pressure[8])
    table = ta.Recording(strain, pressure, layouts.muscle(strain, pressure), np.zeros(43, int), ("t.csv",))
    assert not doubts(table, degree=3)
    table.force[42] += 0.1 * np.abs(table.force).max()
    (said,) = (one for one in doubts(table, degree=3) if "contradict" in one)
    assert "sample 9 of t.csv and sample 43 of t.csv contradict each other" in said
    assert said.endswith("1 such in all")
    pooled = replace(table, run=np.repeat([0, 1], [40, 3]), sources=("t.csv", "u.csv"))
    (said,) = (one for one in doubts(pooled, degree=3) if "contradict" in one)
    assert "sample 9 of t.csv and sample 3 of u.csv contradict each other" in said


def files_told(tmp_path, header, *rows, gauge=None):
    """What is doubtful of a tester's file, and of its log, which reaches 50 kPa."""
    tester, log = tmp_path / "t.csv", tmp_path / "p.txt"
    tester.write_text("\n".join([header, *rows, ""]))
    log.write_text("time_ms,pressure_kPa\n" + "".join(f"{k},{k / 200}\n" for k in range(0, 10001, 100)))
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        files = ta.read_tester(tester, gauge_length=gauge), ta.read_pressure(log)
        given = recording()
        warn_of_doubts(ta.fit_recording(given), given, [files])
    return [str(one.message) for one in found]


def test_a_gauge_length_that_is_not_the_files_own_is_told(tmp_path):
    rows = [f"{k},{2 * k},{100 * 2 * k / 60:.4f},{k}" for k in range(8)]
    header = "Time (s),Extension (mm),Strain (%),Force (N)"
    assert not files_told(tmp_path, header, *rows, gauge=0.06)
    assert not files_told(tmp_path, header, *rows)
    (said,) = files_told(tmp_path, header, *rows, gauge=0.08)
    assert said.endswith("t.csv: its own strains mean a gauge length of 60 mm, got 80 mm, which is taken")


def test_strains_and_lengths_that_contradict_each_other_are_told(tmp_path):
    rows = [f"{20 * k},{k},{(7 * k) % 5},1" for k in range(9)]
    (said,) = files_told(tmp_path, "Time (ms),Displacement (mm),Strain (%),Force (N)", *rows)
    assert "its strains and its lengths do not go together: is the header right, or are columns swapped" in said


def test_pressures_of_the_tester_that_are_not_the_logs_are_told(tmp_path):
    header = "Time (s),Strain (%),Force (N),Pressure (kPa)"
    rows = [f"{k},{k},{k},{{}}" for k in range(9)]
    assert not files_told(tmp_path, header, *(row.format(6 * k) for k, row in enumerate(rows)))
    (said,) = files_told(tmp_path, header, *(row.format(3 * k) for k, row in enumerate(rows)))
    assert "its own pressures reach 24 kPa, those of" in said
    assert "p.txt 50 kPa, which are taken" in said
