"""Reading what a test bench wrote: right files give right numbers, wrong ones one error that names file and line."""

import os
import re
import warnings
from pathlib import Path

import numpy as np
import pytest

import torcharm as ta
from torcharm.characterise import recordings
from torcharm.characterise.alignment import smooth
from torcharm.characterise.recordings import PressureRecord

HEAD = "Time,Displacement,Tensile strain (Displacement),Force\r\n(ms),(mm),(%),(N)\r\n"
ROWS = ['"0.0","0.0","0.0","1.5"', '"20.0","0.6","1.0","-2.5"', '"40.0","1.2","2.0","-6.0"']
LOG = ["0,0.0", "11,3.0", "22,5.0", "33,5.5"]


def write(path, text):
    path.write_bytes(text.encode())
    return path


def csv_file(tmp_path, rows=ROWS, head=HEAD, end="\r\n\r\n"):
    return write(tmp_path / "tester.csv", head + "\r\n".join(rows) + end)


def log(tmp_path, rows=LOG, head="Time,Pressure\r\r", end="\r\rLogging end\r\r"):
    return write(tmp_path / "log.txt", head + "\r\r".join(rows) + end)


def test_a_csv_file(tmp_path):
    record = ta.read_tester(csv_file(tmp_path))
    np.testing.assert_array_equal(record.time, [0, 20, 40])
    np.testing.assert_allclose(record.strain, [0, 0.01, 0.02], rtol=1e-15)
    np.testing.assert_array_equal(record.force, [1.5, -2.5, -6.0])
    assert record.source.endswith("tester.csv")


def test_columns_are_known_by_name_and_units_by_the_second_line(tmp_path):
    text = "Force,Time,Strain\n(kN),(s),(mm/mm)\n0.5,0.25,0.125\n1,0.5,0.25\n"
    record = ta.read_tester(write(tmp_path / "other.csv", text))
    np.testing.assert_array_equal(record.force, [500, 1000])
    np.testing.assert_array_equal(record.time, [250, 500])
    np.testing.assert_array_equal(record.strain, [0.125, 0.25])


@pytest.mark.parametrize("ending", ["\r", "\n", "\r\n", "\r\r", "\r\r\n"])
def test_a_pressure_log_with_any_line_ending(tmp_path, ending):
    path = write(tmp_path / "log.txt", ending.join(["Time,Pressure", *LOG, "Logging end", ""]))
    record = ta.read_pressure(path)
    np.testing.assert_array_equal(record.time, [0, 11, 22, 33])
    np.testing.assert_allclose(record.pressure, np.array([0, 3, 5, 5.5]) * 6.894757293168361, rtol=1e-15)


@pytest.mark.parametrize(("unit", "factor"), [("kPa", 1.0), ("bar", 100.0), ("MPa", 1000.0), ("Pa", 1e-3)])
def test_pressure_units(tmp_path, unit, factor):
    rows = [f"{10 * i},{value / factor!r}" for i, value in enumerate((0.0, 30.0, 60.0))]
    np.testing.assert_allclose(ta.read_pressure(log(tmp_path, rows), unit).pressure, [0, 30, 60], rtol=1e-12)


@pytest.mark.parametrize("unit", ["kPa", "Pa", "MPa"])
def test_an_implausible_pressure_is_a_warning(tmp_path, unit):
    with pytest.warns(UserWarning, match=rf"log.txt: pressures reach .* kPa when read as {unit}"):
        ta.read_pressure(log(tmp_path), unit)


def test_a_plausible_pressure_is_none(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ta.read_pressure(log(tmp_path))


def test_an_implausible_strain_is_a_warning(tmp_path):
    path = csv_file(tmp_path, ['"0","0","0","1"', '"20","0","66.8","1"'], HEAD.replace("(%)", "(mm/mm)"))
    with pytest.warns(UserWarning, match=r"tester.csv: strains reach 66.8"):
        ta.read_tester(path)


BAD_TESTERS = {
    "empty": ("", "is empty"),
    "one line": ("Time,Force\n", "line 1: is the only line"),
    "no rows": (HEAD, "line 2: is the last line, must be followed by numbers"),
    "no force": (HEAD.replace("Force", "Load"), "line 1: must name one column of each of time, strain, force, got 0"),
    "unit": (HEAD.replace("(N)", "(kg)"), r"line 2: the unit of force must be one of N, kN, lbf, got .*kg"),
    "nan": (HEAD + "\r\n".join([ROWS[0], '"20.0","0.6","1.0","NaN"', ROWS[2]]) + "\r\n", "line 4: must be 4 finite"),
    "word": (HEAD + "\r\n".join([ROWS[0], ROWS[1], '"40.0","1.2","2.0","over"']) + "\r\n", "line 5: must be 4 finite"),
    "few": (HEAD + "\r\n".join([ROWS[0], '"20.0","0.6"', ROWS[2]]) + "\r\n", "line 4: must be 4 finite numbers, got"),
    "many": (HEAD + ROWS[0] + ',"1"\r\n', "line 3: must be 4 finite numbers"),
    "blank field": (HEAD + '"0.0","0.0","","1.5"\r\n', "line 3: must be 4 finite numbers"),
    "cut in a number": (HEAD + "\r\n".join(ROWS)[:-3], "line 5: must be 4 finite numbers, got .* it is cut short"),
    "cut in a line": (HEAD + "\r\n".join(ROWS)[:-8], "line 5: must be 4 finite numbers, got .* it is cut short"),
    "twice": (HEAD + "\r\n".join([ROWS[0], ROWS[1], ROWS[1]]) + "\r\n", "line 5: time .* 20, which repeats"),
    "back": (HEAD + "\r\n".join([ROWS[0], ROWS[2], ROWS[1]]) + "\r\n", "line 5: time .* 20, which comes after 40"),
}


@pytest.mark.parametrize("case", BAD_TESTERS)
def test_bad_tester_files(tmp_path, case):
    text, message = BAD_TESTERS[case]
    path = write(tmp_path / "tester.csv", text)
    with pytest.raises(ValueError, match=rf"^{re.escape(str(path))}: {message}") as error:
        ta.read_tester(path)
    assert "\n" not in str(error.value)


BAD_LOGS = {
    "empty": ("", "is empty"),
    "header alone": ("Time,Pressure\r\r", "line 1: is the last line"),
    "nothing logged": ("Time,Pressure\r\rLogging end\r\r", "line 2: is the last line"),
    "no closing line": (
        "Time,Pressure\r\r" + "\r\r".join(LOG) + "\r\r",
        "line 5: the log ends with '33,5.5', must end",
    ),
    "cut": ("Time,Pressure\r\r" + "\r\r".join(LOG)[:-2], "line 5: the log ends with '33,5'"),
    "word": ("Time,Pressure\r\r0,0\r\r11,high\r\r22,1\r\rend\r\r", "line 3: must be 2 finite numbers, got '11,high'"),
    "nan": ("Time,Pressure\r\r0,0\r\r11,nan\r\r22,1\r\rend\r\r", "line 3: must be 2 finite numbers, got '11,nan'"),
    "inf": ("Time,Pressure\r\r0,0\r\r11,inf\r\r22,1\r\rend\r\r", "line 3: must be 2 finite numbers"),
    "twice": ("Time,Pressure\r\r0,0\r\r11,1\r\r11,2\r\rend\r\r", "line 4: time must increase, got 11, which repeats"),
    "back": ("Time,Pressure\r\r0,0\r\r\r\r22,1\r\r11,2\r\rend\r\r", "line 4: time must increase, got 11, which comes"),
}


@pytest.mark.parametrize("case", BAD_LOGS)
def test_bad_pressure_logs(tmp_path, case):
    text, message = BAD_LOGS[case]
    path = write(tmp_path / "log.txt", text)
    with pytest.raises(ValueError, match=rf"^{re.escape(str(path))}: {message}") as error:
        ta.read_pressure(path)
    assert "\n" not in str(error.value)


def test_blank_lines_are_passed_over_and_lines_are_counted_with_them(tmp_path):
    path = write(tmp_path / "tester.csv", HEAD + ROWS[0] + "\r\n\r\n" + ROWS[1] + '\r\n"40","x","2","3"\r\n')
    with pytest.raises(ValueError, match=r"line 6: must be 4 finite"):
        ta.read_tester(path)


def test_truncated_files_are_read_when_asked(tmp_path):
    record = ta.read_tester(write(tmp_path / "a.csv", HEAD + "\r\n".join(ROWS)[:-8]), truncated=True)
    assert len(record.time) == 2
    record = ta.read_pressure(
        write(tmp_path / "b.txt", "Time,Pressure\r\r" + "\r\r".join(LOG) + "\r\r44,"), truncated=True
    )
    assert len(record.time) == 4


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(ValueError, match=r"none.csv: cannot be read: No such file"):
        ta.read_tester(tmp_path / "none.csv")
    (tmp_path / "bytes.csv").write_bytes(b"Time\xff\n")
    with pytest.raises(ValueError, match=r"bytes.csv: must be UTF-8 text, got byte 5"):
        ta.read_tester(tmp_path / "bytes.csv")
    with pytest.raises(ValueError, match=r"^unit: must be one of psi, kPa"):
        ta.read_pressure(log(tmp_path), "torr")


# Alignment


def records(count=200, start=0.0):
    time = np.arange(count) * 20.0
    run = recordings.TesterRecord(time, np.linspace(0, 0.5, count), -np.linspace(0, 40, count), "t.csv")
    clock = start + np.arange(2 * count) * 10.0
    return run, PressureRecord(clock, 0.01 * clock, "p.txt")


def test_pressure_is_interpolated_to_the_testers_stamps_and_force_is_one_actuators():
    run, pressure = records()
    found = ta.align(run, pressure, actuators=4, smoothing=0)
    np.testing.assert_allclose(found.pressure, 0.01 * run.time, rtol=1e-12)
    np.testing.assert_allclose(found.force, np.linspace(0, 10, 200), rtol=1e-12)
    np.testing.assert_array_equal(found.strain, run.strain)
    assert dict(found.settings)["actuators in parallel"] == 4


def test_the_offset_is_added_to_the_logs_clock_and_stamps_outside_are_dropped():
    run, pressure = records()
    found = ta.align(run, pressure, smoothing=0, offset=100.0)
    np.testing.assert_allclose(found.pressure, 0.01 * (run.time[5:] - 100), atol=1e-12)
    assert found.strain[0] == run.strain[5]


def test_smoothing_is_a_gaussian_mean_that_ends_at_the_ends():
    values = np.random.default_rng(0).random(300)
    found = smooth(values, 8.0)
    for centre in (0, 3, 150, 299):
        offset = np.arange(300) - centre
        weight = np.exp(-0.5 * (offset / 8.0) ** 2) * (np.abs(offset) <= 20)
        assert found[centre] == pytest.approx((weight * values).sum() / weight.sum(), rel=1e-12)
    np.testing.assert_allclose(smooth(np.full(50, 3.0), 40.0), 3.0, rtol=1e-14)


def test_pauses_of_the_log():
    run, pressure = records()
    kept = (pressure.time < 1000) | (pressure.time > 2000)
    paused = PressureRecord(pressure.time[kept], pressure.pressure[kept], "p.txt")
    bridged = ta.align(run, paused, smoothing=0)
    assert len(bridged.strain) == len(run.time)
    found = ta.align(run, paused, smoothing=0, max_gap=100.0)
    times = found.strain * run.time[-1] / 0.5
    assert not ((times > 1001) & (times < 1999)).any()
    assert len(found.strain) == ((run.time <= 990) | (run.time >= 2010)).sum() == 149


def test_no_overlap():
    run, pressure = records(start=1e6)
    with pytest.raises(ValueError, match=r"^t.csv and p.txt: do not overlap in time: the tester ran from 0 to 3980 ms"):
        ta.align(run, pressure)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"actuators": 0}, "actuators: must be an integer of at least 1, got 0"),
        ({"smoothing": -1.0}, "smoothing: must be a finite number and at least 0"),
        ({"offset": np.nan}, "offset: must be a finite number"),
        ({"max_gap": -5.0}, "max_gap: must be a finite number and at least 0"),
    ],
)
def test_bad_settings(setting, message):
    with pytest.raises(ValueError, match=f"^{message}"):
        ta.align(*records(), **setting)


def test_pooled_runs_keep_their_labels_and_settings():
    one = ta.align(*records(), offset=5.0, smoothing=0)
    other = ta.align(*records(100), smoothing=0)
    both = ta.pool([one, other, one])
    assert [int((both.run == k).sum()) for k in range(3)] == [len(one.force), len(other.force), len(one.force)]
    assert ("smoothing of pressure, samples", 0.0) in both.settings
    assert ("offset of the log, ms, run 2", 0.0) in both.settings
    np.testing.assert_array_equal(both.pressure[both.run == 1], other.pressure)
    with pytest.raises(ValueError, match=r"^recordings: must hold at least one run"):
        ta.pool([])


def delayed(true_offset):
    """A run whose log's clock is late: pressure p(t) stands at t - true_offset in the log."""
    time = np.arange(0, 60_000, 20.0)
    strain = 0.3 * time / time[-1]
    force = 1.2 * 30 * (1 + np.sin(time / 900.0)) - 8 * strain
    clock = np.arange(-5_000, 65_000, 10.0)
    pressure = 30 * (1 + np.sin((clock + true_offset) / 900.0))
    return recordings.TesterRecord(time, strain, -force, "t.csv"), PressureRecord(clock, pressure, "p.txt")


@pytest.mark.parametrize("offset", [0.0, 137.0, -820.0])
def test_the_offset_is_found(offset):
    assert ta.estimate_offset(*delayed(offset), smoothing=0).offset == pytest.approx(offset, abs=1.0)


def test_an_offset_out_of_reach_is_a_warning():
    with pytest.warns(UserWarning, match=r"best offset lies at the edge of ±300 ms"):
        ta.estimate_offset(*delayed(900.0), smoothing=0, search=300.0)


# The real ones

DATA = Path(os.environ["TORCHARM_DATA"]) / "bellows_characterisation" if "TORCHARM_DATA" in os.environ else None
needs_data = pytest.mark.skipif(DATA is None, reason="needs raw test-bench recordings: TORCHARM_DATA names no folder")


@needs_data
def test_the_real_recordings_are_read_whole():
    for run, rows, lines in ((1, 34340, 46709), (2, 34368, 46714)):
        record = ta.read_tester(DATA / f"instron_run_{run}.csv")
        pressures = ta.read_pressure(DATA / f"pressure_run_{run}.txt")
        assert (len(record.time), len(pressures.time)) == (rows, lines)
        assert record.strain.max() == pytest.approx(0.66802, abs=1e-4)
        assert 80 < pressures.pressure.max() < 96


@needs_data
@pytest.mark.parametrize("share", [0.3, 0.77, 0.9999])
def test_the_real_recordings_cut_short(tmp_path, share):
    for name, read in (("instron_run_1.csv", ta.read_tester), ("pressure_run_1.txt", ta.read_pressure)):
        whole = (DATA / name).read_bytes()
        part = tmp_path / name
        part.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(ValueError, match=rf"{name}: line \d+: .*cut short"):
            read(part)
