"""Reading what a test bench wrote: right files give right numbers, wrong ones one error that names file and line."""

import os
import re
import warnings
from pathlib import Path

import numpy as np
import pytest

import torcharm as ta
from torcharm.characterise import recordings
from torcharm.characterise.misfit import smooth
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


@pytest.mark.parametrize(
    ("head", "got"), [("time_s,pressure\n", "got none in 'time_s,pressure'"), ("", "got none in no header")]
)
def test_pressures_of_no_unit_are_refused_but_in_the_papers_layout(tmp_path, head, got):
    with pytest.raises(ValueError, match=rf"the unit of pressure must be one of kPa, .*{got}; .*=2:bar\", or --unit"):
        ta.read_pressure(log(tmp_path, head=head))
    np.testing.assert_array_equal(ta.read_pressure(log(tmp_path, head=head), "kPa").pressure, [0, 3, 5, 5.5])


@pytest.mark.parametrize("unit", ["kPa", "Pa", "MPa"])
def test_an_implausible_pressure_is_a_warning(tmp_path, unit):
    with pytest.warns(UserWarning, match=rf"log.txt: pressures reach .* kPa when read as {unit}"):
        ta.read_pressure(log(tmp_path), unit)


def test_a_plausible_pressure_is_none(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ta.read_pressure(log(tmp_path))


def test_pressures_are_read_as_absolute_if_they_are_said_or_named_so(tmp_path):
    named = log(tmp_path, ["0,1014", "10,1213", "20,1413"], head="time_ms,pressure_mbar_abs\n")
    with pytest.warns(UserWarning, match=r"101.325 kPa of the surroundings taken off, assumed"):
        np.testing.assert_allclose(ta.read_pressure(named).pressure, [0.075, 19.975, 39.975])
    path = log(tmp_path, ["0,101.4", "10,121.3", "20,141.3"], head="Time (ms),Pressure (kPa)\n")
    with pytest.warns(UserWarning, match=r"101.325 kPa of the surroundings taken off, assumed"):
        found = ta.read_pressure(path, columns="pressure=2:kPa abs")
    np.testing.assert_allclose(found.pressure, [0.075, 19.975, 39.975])


def test_a_strain_that_is_none_is_a_warning(tmp_path):
    path = csv_file(tmp_path, ['"0","0","0","1"', '"20","0","0.4","1"'])
    with pytest.warns(UserWarning, match=r"strains are 0 to 0.004, .* is its unit %, are the cells parts of 1, is"):
        ta.read_tester(path)


def test_positions_are_no_extensions(tmp_path):
    rows = [f"{k},{2 * k - 82},{k}" for k in range(5)]
    path = write(tmp_path / "t.csv", "\n".join(["Time (s),Position (mm),Force (N)", *rows, ""]))
    with pytest.raises(ValueError, match=r"t.csv: strains must be above -1, .* and at most 5, got -1.0"):
        ta.read_tester(path, gauge_length=0.08)
    with pytest.raises(ValueError, match=r"t.csv: strains must count from the actuators' own length, got 4.67 to 4.78"):
        ta.read_tester(write(path, path.read_text().replace(",-", ",3")), gauge_length=0.08)


@pytest.mark.parametrize("strains", [(0, -80, 10), (40, 60, 80), (0, 60, 140)])
def test_strains_of_no_soft_actuator_are_a_warning(tmp_path, strains):
    path = csv_file(tmp_path, [f'"{20 * k}","{0.6 * e}","{e}","1"' for k, e in enumerate(strains)])
    with pytest.warns(UserWarning, match=r"strains are .* those of soft actuators near 0 .* whole lengths .length="):
        ta.read_tester(path)


@pytest.mark.parametrize("name", ["Length", "Height", "Länge"])
def test_lengths_count_from_the_gauge_length(tmp_path, name):
    path = write(tmp_path / "t.csv", f"Time (s),{name} (mm),Force (N)\n0,80,1\n1,88,2\n2,76,3\n")
    np.testing.assert_allclose(ta.read_tester(path, gauge_length=0.08).strain, [0, 0.1, -0.05], atol=1e-15)
    said = ta.read_tester(path, columns="length=2", gauge_length=0.08)
    np.testing.assert_allclose(said.strain, [0, 0.1, -0.05], atol=1e-15)
    with pytest.raises(ValueError, match=r"gauge_length: is missing, .* gives lengths in mm and no strains"):
        ta.read_tester(path)


def test_a_second_header_that_swaps_columns_is_refused(tmp_path):
    rows = [f"{k},{0.01 * k},{k}" for k in range(40)]
    lines = ["Time (s),Strain (mm/mm),Force (N)", *rows[:20], "Time (s),Force (N),Strain (mm/mm)", *rows[20:], ""]
    path = write(tmp_path / "t.csv", "\n".join(lines))
    message = r"t.csv: line 22: must not name columns otherwise than line 1, .* two recordings or tables in one file\?"
    with pytest.raises(ValueError, match=message):
        ta.read_tester(path)
    with pytest.warns(UserWarning, match="line 22 of words or with empty cells passed over"):
        assert len(ta.read_tester(write(path, "\n".join([*lines[:21], lines[0], *lines[22:]]))).force) == 40
    table = write(
        tmp_path / "s.csv", "contraction [%];0 bar;1 bar\n0;0;40\n10;-5;30\nextension [%];0 bar;1 bar\n20;5;50\n"
    )
    with pytest.raises(ValueError, match=r"s.csv: line 4: must not name columns otherwise than line 1"):
        ta.read_table(table)


@pytest.mark.parametrize("head", ["Compressive force [N]\ncontraction [%]", "contraction [%] / Druckkraft [N]"])
def test_a_tables_forces_that_are_named_compressive_push(tmp_path, head):
    table = ta.read_table(write(tmp_path / "s.csv", f"{head};0 bar;1 bar\n0;0;40\n10;-5;30\n"))
    assert table.force.tolist() == [0, 40, -5, 30]
    assert dict(table.settings)["positive forces"] == "push, as its name says"


def test_percents_that_are_said_to_be_parts_of_1_are_refused(tmp_path):
    path = csv_file(tmp_path, ['"0","0","0","1"', '"20","0","66.8","1"'], HEAD.replace("(%)", "(mm/mm)"))
    with pytest.raises(ValueError, match=r"tester.csv: strains must be .* at most 5, got 0 to 66.8 from strain in mm"):
        ta.read_tester(path)


BAD_TESTERS = {
    "one line": ("Time,Force\n", "line 1: must be followed by lines of two or more numbers each, got 'Time,Force'"),
    "no rows": (HEAD, "line 1: must be followed by lines of two or more numbers each"),
    "unit": (
        HEAD.replace("(N)", "(kPa)") + "\r\n".join(ROWS) + "\r\n",
        r"line 1: must name one column of force, .* got none in",
    ),
    "inf": (
        HEAD + "\r\n".join([ROWS[0], '"20.0","0.6","1.0","inf"', ROWS[2]]) + "\r\n",
        "line 4: must be 4 cells with finite numbers in columns 1, 3, 4, got '20.0 0.6 1.0 inf'$",
    ),
    "few": (HEAD + "\r\n".join([ROWS[0], '"20.0","0.6"', ROWS[2]]) + "\r\n", "line 4: must be 4 cells with"),
    "cut in a number": (HEAD + "\r\n".join(ROWS)[:-3], "line 5: must be a whole line of 4 cells, .* it is cut short"),
    "cut in a line": (HEAD + "\r\n".join(ROWS)[:-8], "line 5: must be a whole line of 4 cells, .* it is cut short"),
    "back": (
        HEAD + "\r\n".join([*(f'"{20 * k}","0","{k}","1"' for k in range(30)), ROWS[1]]) + "\r\n",
        "line 33: time must increase, got 20 ms, which comes after 580 ms",
    ),
}


@pytest.mark.parametrize("case", BAD_TESTERS)
def test_bad_tester_files(tmp_path, case):
    text, message = BAD_TESTERS[case]
    path = write(tmp_path / "tester.csv", text)
    with pytest.raises(ValueError, match=rf"^{re.escape(str(path))}: {message}") as error:
        ta.read_tester(path)
    assert "\n" not in str(error.value)


def test_blank_lines_are_passed_over_and_lines_are_counted_with_them(tmp_path):
    path = write(tmp_path / "tester.csv", HEAD + ROWS[0] + "\r\n\r\n" + ROWS[1] + '\r\n"40","x","2","x"\r\n')
    with pytest.raises(ValueError, match=r"line 6: must be 4 cells"):
        ta.read_tester(path)


def test_truncated_files_are_read_when_asked(tmp_path):
    record = ta.read_tester(write(tmp_path / "a.csv", HEAD + "\r\n".join(ROWS)[:-8]), truncated=True)
    assert len(record.time) == 2
    assert record.notes == ("line 5 has no end and may be cut, left out",)
    rows = "Time,Pressure\r\r" + "\r\r".join(LOG)
    record = ta.read_pressure(write(tmp_path / "b.txt", rows + "\r\r44,"), truncated=True)
    assert len(record.time) == 4
    assert len(ta.read_pressure(write(tmp_path / "c.txt", rows)).time) == 4  # as many decimals as before: whole


def test_a_last_number_that_may_lack_digits_is_left_out(tmp_path):
    rows = [f"{10 * k},{value!r}" for k, value in enumerate((30.25, 31.5, 32.125, 33.0625))]
    record = ta.read_pressure(write(tmp_path / "b.txt", "Time (ms),Pressure (kPa)\n" + "\n".join(rows)))
    assert len(record.time) == 3
    assert "line 5 has no end and may be cut, left out" in record.notes


def test_a_clock_that_stands_or_steps_back_a_little_is_averaged(tmp_path):
    rows = ["0,30", "10,31", "10,33", "20,34", "18,36", "30,37", "40,38"]
    record = ta.read_pressure(write(tmp_path / "b.txt", "Time (ms),Pressure (kPa)\n" + "\n".join([*rows, "end"])))
    np.testing.assert_allclose(record.time, [0, 10, 19, 30, 40])
    np.testing.assert_allclose(record.pressure, [30, 32, 35, 37, 38])
    assert record.notes == ("2 of 7 stamps repeat or step back, averaged with those before them",)


def test_units_that_agree_and_names_in_the_plural(tmp_path):
    path = log(tmp_path, ["0,30.0", "10,60.0"], head="Times (ms),Pressures (kPa)\n")
    np.testing.assert_allclose(ta.read_pressure(path, "kPa").pressure, [30, 60])
    with pytest.raises(ValueError, match=r"^unit: must be left out or be kPa, which .*log.txt.*, got bar"):
        ta.read_pressure(path, "bar")
    with pytest.raises(ValueError, match=r"^unit: must be one of kPa, Pa"):
        ta.read_pressure(path, "torr")


def test_forces_that_push_are_turned(tmp_path):
    record = ta.read_tester(csv_file(tmp_path), positive="push")
    np.testing.assert_array_equal(record.force, [-1.5, 2.5, 6.0])
    with pytest.raises(ValueError, match=r"^positive: must be one of pull, push, got 'both'"):
        ta.read_tester(csv_file(tmp_path), positive="both")


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
    with pytest.warns(UserWarning, match=r"p.txt: has no pressures for 1.02 s, .* 51 samples .*--max-gap 510 leaves"):
        bridged = ta.align(run, paused, smoothing=0)
    assert len(bridged.strain) == len(run.time)
    found = ta.align(run, paused, smoothing=0, max_gap=100.0)
    times = found.strain * run.time[-1] / 0.5
    assert not ((times > 1001) & (times < 1999)).any()
    assert len(found.strain) == ((run.time <= 990) | (run.time >= 2010)).sum() == 149


def test_a_log_in_seconds_that_is_read_in_milliseconds():
    run, pressure = records()
    short = PressureRecord(pressure.time / 1000, pressure.pressure, "p.txt")
    with pytest.raises(ValueError, match=r"^p.txt: lasts 3.99 ms, and t.csv 3980 ms, .* --pressure-columns .*time=1:s"):
        ta.align(run, short)


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
    assert ("smoothing of pressure, ms", 0.0) in both.settings
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


def test_an_offset_says_how_sure_it_is():
    found = ta.estimate_offset(*delayed(137.0), smoothing=0, search=2000.0)
    assert found.deviation < 1.0
    assert found.rmse < 0.01
    assert found.other_rmse > 10.0
    # The pressure repeats itself after 2π 900 ms: the nearer offset is taken, the other told
    again = ta.estimate_offset(*delayed(900.0), smoothing=0, search=10_000.0)
    assert again.offset == pytest.approx(900.0, abs=1.0)
    assert abs(again.other - 900.0) == pytest.approx(2 * np.pi * 900.0, abs=1.0)
    assert "fits as well, as the run repeats itself" in again.words


@pytest.mark.parametrize("noise", [0.3, 3.0])
def test_the_offsets_deviation_is_that_of_repeated_noise(noise):
    run, log = delayed(137.0)
    random, found = np.random.default_rng(3), []
    for _ in range(12):
        force = run.force + noise * random.normal(size=len(run.force))
        noisy = recordings.TesterRecord(run.time, run.strain, force, "t.csv")
        found.append(ta.estimate_offset(noisy, log, smoothing=0, search=300.0))
    spread = np.std([one.offset for one in found])
    assert 0.4 * spread < np.median([one.deviation for one in found]) < 2.5 * spread


def test_clocks_that_do_not_overlap_are_searched_from_a_common_start():
    run, log = delayed(137.0)
    late = PressureRecord(log.time[500:] + 1.69e12, log.pressure[500:], "p.txt")
    assert ta.estimate_offset(run, late, smoothing=0).offset + 1.69e12 == pytest.approx(137.0, abs=1.0)


def test_a_search_goes_no_further_than_both_files_reach():
    run, log = delayed(300.0)
    near, far = (ta.estimate_offset(run, log, smoothing=0, search=search) for search in (5e3, 1e12))
    assert far.offset == pytest.approx(near.offset, abs=1.0)


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
        if whole[: int(share * len(whole))].endswith(b"235557,8.53"):  # with all its decimals: whole
            assert "has no closing line, taken as whole" in read(part).notes
            continue
        with pytest.raises(ValueError, match=rf"{name}: line \d+: .*cut short"):
            read(part)
