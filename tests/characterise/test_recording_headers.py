"""What a pressure log's first line says holds: its units, and a sample that is glued to it."""

import re
import sys

import numpy as np
import pytest

import torcharm as ta
from torcharm import cli

PSI = 6.894757293168361
CLOCK = np.arange(13.0, 41_000.0, 100.0)
"""[ms], as a logger with a late start has it: 410 stamps."""


def pressure_at(time):
    return 60 * np.sin(np.pi * time / 8_000) ** 2


def write_log(path, header, *, factor=1 / PSI, clock=1.0, end="\n", closing="Logging end\n", glued=False):
    rows = [f"{time * clock:.10g},{pressure_at(time) * factor:.6f}" for time in CLOCK]
    path.write_bytes((header + ("" if glued else end) + end.join(rows) + end + closing).encode())
    return path


def write_run(folder):
    """A tester's file of f = -60 ε + 0.9 p + 40 ε² - 0.55 ε p + 0.002 p², pulled, at five held strains."""
    time = np.arange(0, 40_000, 40.0)
    strain, p = np.repeat(np.linspace(0, 0.6, 5), 200), pressure_at(time)
    force = -60 * strain + 0.9 * p + 40 * strain**2 - 0.55 * strain * p + 0.002 * p**2
    rows = [f"{t},{100 * e:.8f},{-f:.8f}" for t, e, f in zip(time, strain, force, strict=True)]
    path = folder / "run.csv"
    path.write_text("\n".join(["Time,Strain,Force", "(ms),(%),(N)", *rows, ""]))
    return path


LOGS = {
    "kPa in brackets": ("Time (ms),Pressure (kPa)", 1.0, 1.0),
    "kPa as a word": ("timestamp_ms,pressure_kPa", 1.0, 1.0),
    "bar": ("Time [ms],Pressure [bar]", 0.01, 1.0),
    "hPa, which no option names": ("Time,Pressure (hPa)", 10.0, 1.0),
    "glued words": ("TimeMs,PressureMPa", 0.001, 1.0),
    "quoted": ('"Time (ms)","Pressure (mbar)"', 10.0, 1.0),
    "seconds": ("Time (s),Pressure (psi)", 1 / PSI, 0.001),
    "seconds as a word": ("time_sec,pressure", 1 / PSI, 0.001),
    "minutes": ("Time (min),Pressure (Pa)", 1000.0, 1 / 60_000),
    "none": ("Times,Pressures", 1 / PSI, 1.0),
}


@pytest.mark.parametrize("case", LOGS)
def test_units_in_the_header_hold(tmp_path, case):
    header, factor, clock = LOGS[case]
    for glued in (False, True):
        record = ta.read_pressure(
            write_log(tmp_path / "log.txt", header, factor=factor, clock=clock, end="\r\n", glued=glued)
        )
        assert len(record.time) == 410
        np.testing.assert_allclose(record.time, CLOCK, rtol=1e-8)
        # Six decimals of the file's unit.
        np.testing.assert_allclose(record.pressure, pressure_at(CLOCK), atol=1e-6 / factor)


@pytest.mark.parametrize(
    ("header", "unit", "message"),
    [
        ("Time (ms),Pressure (kPa)", "psi", r"unit: must be left out or be kPa, which .* names in line 1, .*, got psi"),
        ("timestamp_ms,pressure_kPa", "bar", "unit: must be left out or be kPa, .*, got bar"),
        ("Time,Pressure (hPa)", "kPa", "unit: must be left out or be mbar, .*, got kPa"),
        ("Time,Pressure (furlong)", None, ".*log.txt: line 1: units in brackets must be among .*, got 'furlong'"),
        ("Pressure (kPa),Time (ms)", None, ".*log.txt: line 1: the columns must be time and pressure, got a time"),
        ("Time,Pressure (kPa) (psi)", None, ".*log.txt: line 1: must name one unit of pressure, got kpa and psi"),
        ("13,0.0x", None, ".*log.txt: line 1: must be a header or 2 finite numbers, got '13,0.0x'"),
    ],
)
def test_what_contradicts_the_header_is_refused(tmp_path, header, unit, message):
    path = write_log(tmp_path / "log.txt", header, factor=1.0)
    with pytest.raises(ValueError, match=f"^{message}") as error:
        ta.read_pressure(path, unit)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(("header", "unit"), [("Time (ms),Pressure (kPa)", "kPa"), ("Time,Pressure", "kPa")])
def test_a_unit_that_agrees_is_taken(tmp_path, header, unit):
    record = ta.read_pressure(write_log(tmp_path / "log.txt", header, factor=1.0), unit)
    np.testing.assert_allclose(record.pressure, pressure_at(CLOCK), atol=1e-6)


def test_a_testers_first_sample_glued_to_its_units_is_not_lost(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("Time,Strain,Force,Displacement\n(ms),(%),(N),(mm)0,0,0,0\n10,1,2,3\n20,2,3,4\n")
    with pytest.raises(ValueError, match=r"line 2: must hold a unit for each of the 4 names in line 1, got .*0,0,0,0"):
        ta.read_tester(path)


def command(monkeypatch, *args):
    monkeypatch.setattr(sys, "argv", ["torcharm", *map(str, args)])
    try:
        cli.main()
    except SystemExit as end:
        return end.code


@pytest.mark.parametrize(
    ("header", "factor", "clock", "glued", "closing"),
    [
        ("Time (ms),Pressure (kPa)", 1.0, 1.0, False, "Logging end\n"),
        ("timestamp_ms,pressure_kPa", 1.0, 1.0, False, ""),
        ("Time (s),Pressure (psi)", 1 / PSI, 0.001, False, "Logging end\n"),
        ("Time,Pressure", 1 / PSI, 1.0, True, "Logging end\n"),
    ],
)
def test_a_fit_finds_the_law_whatever_the_units(tmp_path, monkeypatch, header, factor, clock, glued, closing):
    run, out = write_run(tmp_path), tmp_path / "m.toml"
    log = write_log(tmp_path / "log.csv", header, factor=factor, clock=clock, glued=glued, closing=closing)
    more = () if closing else ("--truncated",)
    args = ("fit", "--instron", run, "--pressure", log, "--smoothing", 0, "--degree", 2, "--out", out, *more)
    assert not command(monkeypatch, *args)
    found = {(i, j): value for i, j, value in ta.load_actuator(out).coefficients}
    truth = {(1, 0): -60.0, (0, 1): 0.9, (2, 0): 40.0, (1, 1): -0.55, (0, 2): 0.002}
    for powers, value in truth.items():
        assert found[powers] == pytest.approx(value, rel=0.02)


def test_a_unit_against_the_files_is_one_line(tmp_path, monkeypatch, capsys):
    run, log = write_run(tmp_path), write_log(tmp_path / "log.txt", "Time (ms),Pressure (kPa)", factor=1.0)
    out = tmp_path / "m.toml"
    assert command(monkeypatch, "fit", "--instron", run, "--pressure", log, "--out", out, "--unit", "psi") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert re.match(r"torcharm: unit: must be left out or be kPa, which .*log.txt names in line 1, .*, got psi$", line)
    assert not out.exists()
