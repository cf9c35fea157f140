"""Every layout of recordings and tables gives the law back, by the command; what is not told is asked for."""

import re
import sys
import time
import tomllib

import layouts
import numpy as np
import pytest
import torch
from typer.testing import CliRunner

import torcharm as ta
from torcharm import cli
from torcharm.characterise.force_table import read_table
from torcharm.cli.app import app

FIT = ("--smoothing", 0, "--degree", 2)


@pytest.fixture
def fit(tmp_path, monkeypatch, capsys):
    """Runs the command on texts of files, and gives what it wrote and printed."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments, **texts):
        for name, text in texts.items():
            data = text if isinstance(text, bytes) else text.encode()
            (tmp_path / f"{name}.txt").write_bytes(data)
        monkeypatch.setattr(sys, "argv", ["torcharm", "fit", *map(str, arguments), "--out", "m.toml"])
        code = 0
        try:
            cli.main()
        except SystemExit as end:
            code = end.code or 0
        shown = capsys.readouterr()
        if code:
            assert code == 2
            assert shown.err.count("\n") == 1
            assert not (tmp_path / "m.toml").exists()
            return shown.err
        return ta.load_actuator("m.toml"), shown.out

    return run


def assert_law(model, truth, rest=0.0):
    found = {(i, j): c for i, j, c in model.coefficients}
    for powers, value in truth.items():
        assert found.pop(powers) == pytest.approx(value, rel=0.02)
    assert all(abs(value) <= rest for value in found.values())


def assert_found(result, truth=layouts.TRUTH):
    assert not isinstance(result, str), result
    assert_law(result[0], truth)


RUN = ("--tester", "tester.txt", "--pressure", "log.txt", *FIT)


@pytest.mark.parametrize("name", layouts.TESTERS)
def test_testers_files(fit, name):
    text, options = layouts.TESTERS[name]
    assert_found(fit(*RUN, *options, tester=text, log=layouts.REFERENCE_LOG))


@pytest.mark.parametrize("name", layouts.LOGS)
def test_pressure_logs(fit, name):
    text, options = layouts.LOGS[name]
    assert_found(fit(*RUN, *options, tester=layouts.REFERENCE, log=text))


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp1252"])
def test_encodings(fit, encoding):
    tester = layouts.REFERENCE.replace("Displacement,", "Länge,", 1).encode(encoding)
    assert_found(fit(*RUN, tester=tester, log=layouts.REFERENCE_LOG.encode(encoding)))


def test_one_file_without_header(fit):
    text, options = layouts.ONE_FILE
    assert_found(fit("--tester", "tester.txt", *FIT, *options, tester=text))


def test_one_file_with_a_header(fit):
    columns = (layouts.TIME, 100 * layouts.STRAIN, layouts.PULL, layouts.pressure_at(layouts.TIME))
    text = layouts.text("Time (ms),Strain (%),Force (N),Pressure (kPa)", layouts.lines(*columns))
    assert_found(fit("--tester", "tester.txt", *FIT, tester=text))


def hint(said):
    """The columns that a message says to paste."""
    return re.search(r'--columns[^"]*"([^"]+)"', said)[1]


@pytest.mark.parametrize(
    ("header", "factors"),
    [
        ("t,eps,F,p", (1e-3, 1, 1, 1)),
        ("time,strain,force,pressure", (1, 100, 1, 0.01)),
        ("Time (s),Strain (%),Force (N),Channel 4", (1e-3, 100, 1, 1)),
        ("a,b,c,d", (1e-3, 80, 1, 1)),
        ("", (1, 80, 1, 1)),
    ],
)
def test_what_is_pasted_fits_the_file(fit, header, factors):
    columns = [layouts.TIME, layouts.STRAIN, layouts.PULL, layouts.pressure_at(layouts.TIME)]
    order, more = ((0, 2, 1, 3), ["--gauge-length", "80 mm"]) if header in ("", "a,b,c,d") else ((0, 1, 2, 3), [])
    columns = [factor * own for factor, own in zip(factors, columns, strict=True)]
    rows = layouts.lines(*(columns[k] for k in order), formats=["{:.9f}"] * 4)
    text, said = layouts.text([header] if header else [], rows), ""
    for options in ((), *[("--columns",)] * 3):
        pasted = [hint(said)] if options else []
        found = fit("--tester", "tester.txt", *FIT, *more, *options, *pasted, tester=text)
        if not isinstance(found, str):
            break
        said = found
    assert_found(found)


def test_a_sensors_reading_is_no_force(fit):
    text = layouts.REFERENCE.replace("(N)", "(mV)")
    said = fit(*RUN, tester=text, log=layouts.REFERENCE_LOG)
    assert "must hold forces, got a sensor's reading in mV: convert it in the file" in said
    assert "--columns" not in said


def test_notes_say_what_was_left_out_averaged_and_assumed(fit):
    model, shown = fit(
        *RUN, tester=layouts.TESTERS["words in three lines"][0], log=layouts.LOGS["two samples in one line"][0]
    )
    words = "lines 53, 84 of words or with empty cells passed over"
    assert f"Notes on tester.txt: {words}" in shown
    assert "Notes on log.txt: line 201 damaged, left out; names no unit: read time in ms and pressure in psi" in shown
    assert dict(model.provenance)["notes on tester.txt"] == words
    text = layouts.LOGS["three samples a stamp, no closing line"][0]
    _, shown = fit(*RUN, tester=layouts.TESTERS["stamps that repeat"][0], log=text)
    assert "Notes on tester.txt: 10 of 410 stamps repeat or step back, averaged with those before them" in shown
    assert "820 of 1230 stamps repeat or step back" in shown
    assert "has no closing line, taken as whole" in shown


def test_a_first_sample_glued_to_the_header_is_read(tmp_path):
    (tmp_path / "log.txt").write_text(layouts.LOGS["the first sample in the header's line"][0])
    record = ta.read_pressure(tmp_path / "log.txt")
    assert (len(record.time), record.time[0]) == (410, 13.0)
    names, units, *rows = layouts.REFERENCE.splitlines()
    (tmp_path / "run.csv").write_text("\n".join([names, units + rows[0], *rows[1:], ""]))
    assert ta.read_tester(tmp_path / "run.csv").time.tolist() == layouts.TIME.tolist()


BOTH = ("reference", "reference")
ASKED = [
    (("no strain", "reference"), (), r"gauge_length: is missing, .* tester.txt .*: --gauge-length '80 mm'"),
    (
        ("two strains, one to be named", "reference"),
        (),
        r"tester.txt: line 1: must name one column of strain, .* got 'Strain 1' and 'Strain 2'; --columns says .*",
    ),
    (
        ("reference", "kPa in brackets"),
        ("--unit", "psi"),
        r"unit: must be left out or be kPa, which log.txt or --pressure-columns names, got psi",
    ),
    (
        ("kgf", "reference"),
        ("--columns", "force=Force:N"),
        r"columns: force: must be left without a unit or be in kgf, which tester.txt names in line 1, .*, got N",
    ),
    (("no strain", "reference"), ("--gauge-length", 80), r"gauge_length: must be at most 3 m, .*'80 mm' then"),
    (
        BOTH,
        ("--gauge-length", "80 mm", "--columns", "strain=3"),
        r"gauge_length: must stand with .* that are lengths, .* got one and strain in % in column 3 of tester.txt",
    ),
    (BOTH, ("--columns", "3"), r"columns: must be as in 'time=Time:s, force=4', got '3'"),
    (BOTH, ("--columns", "force=9"), r"columns: force: must be from 1 to 4, .*, got 9"),
    (BOTH, ("--columns", "force=Kraft"), r"columns: force: must be the number or .*, got 'Kraft'"),
    (BOTH, ("--pressure-columns", "forse=4"), r"--pressure-columns: must be one of .*, got 'forse'; did you mean .*"),
    (BOTH, ("--model", "mckibben"), r"--degree: must be left out with --model mckibben, for which it means .*"),
    (BOTH, ("--columns", "forse=4"), r"columns: must be one of .*, got 'forse'; did you mean force\?"),
    (BOTH, ("--columns", "force=4:furlong"), r"columns: force: the unit of force must be one of N, .*, got 'furlong'"),
    (
        BOTH,
        ("--columns", "strain=3,extension=2"),
        r"columns: must name one of strain, contraction, extension, length, .*",
    ),
    (
        ("reference", "seconds since 1970, no header"),
        ("--unit", "kPa"),
        r"tester.txt and log.txt: do not overlap in time: .*; an offset of -1690000000013 ms \(--offset\) would .*",
    ),
]


@pytest.mark.parametrize(("files", "options", "message"), ASKED)
def test_what_is_lacking_or_contradicts_is_one_line(fit, files, options, message):
    said = fit(*RUN, *options, tester=layouts.TESTERS[files[0]][0], log=layouts.LOGS[files[1]][0])
    assert isinstance(said, str)
    assert re.fullmatch(f"torcharm: {message}\n", said)


def test_a_tester_without_pressures_needs_a_log(fit):
    assert re.match(
        r"torcharm: tester.txt: line 1: must name one column of pressure, .*; or --pressure names its log",
        fit("--tester", "tester.txt", tester=layouts.REFERENCE),
    )
    assert fit().startswith("torcharm: --instron: is missing, must name a tester's file; or --table")


def test_vacuum_is_refused_or_taken_by_its_depth(fit):
    p = layouts.pressure_at(layouts.TIME) * -40 / 60
    columns = (layouts.TIME, 100 * layouts.STRAIN, -(1.2 * p - 30 * layouts.STRAIN), p)
    text = layouts.text("Time (ms),Strain (%),Force (N),Pressure (kPa)", layouts.lines(*columns))
    said = fit("--tester", "tester.txt", "--smoothing", 0, "--degree", 1, tester=text)
    assert isinstance(said, str)
    assert re.match(r"torcharm: tester.txt.*: pressure: must be gauge .* vacuum is not supported .*--vacuum", said)
    model, shown = fit("--tester", "tester.txt", "--smoothing", 0, "--degree", 1, "--vacuum", tester=text)
    assert_law(model, {(1, 0): -30.0, (0, 1): -1.2})
    assert model.pressure_range == (0.0, pytest.approx(40.0, rel=1e-3))
    assert "Pressures: depths of vacuum" in shown


# Tables

TABLES = {
    "long": (layouts.LONG, ()),
    "wide": (layouts.WIDE, ()),
    "turned": (layouts.TURNED, ()),
    "contractions in mm": (layouts.MILLIMETRES, ("--gauge-length", "200 mm")),
    "contractions in mm, a line each": (
        layouts.LONG.replace("strain", "shortening (mm)").replace("\n-", "\n"),
        ("--gauge-length", "1 mm"),
    ),
    "forces at pressures, units behind numbers": (layouts.FORCES_AT, ()),
    "forces at pressures in MPa": (
        re.sub(r"(\d) bar", r"force at 0.\1 MPa [N]", layouts.WIDE.replace(",", ".")),
        (),
    ),
    "strains above 0 of what pulls": (layouts.WIDE.replace("contraction", "strain"), ("--positive", "pull")),
    "strains that count shortening": (layouts.WIDE.replace("contraction", "strain"), ("--columns", "contraction=1:%")),
    "absolute pressures": (layouts.ABSOLUTE, ()),
}


TABLES |= {
    "a letter in the corner": (layouts.WIDE.replace("contraction [%]", "h [%]"), ("--columns", "contraction=1:%")),
    "grams": (
        layouts.text(
            "contraction (%),pressure (kPa),Load (g)",
            [
                f"{-100 * float(e):g},{p},{-float(f) / 9.80665e-3:.1f}"
                for e, p, f in (row.split(",") for row in layouts.LONG.splitlines()[1:])
            ],
        ),
        (),
    ),
}


@pytest.mark.parametrize("name", TABLES)
def test_tables_give_the_law(fit, name):
    text, options = TABLES[name]
    model, shown = fit("--table", "table.txt", *options, table=text)
    assert_law(model, layouts.MUSCLE, rest=0.5)  # N per unit of strain: the digits printed
    assert "Taken: mckibben" in shown
    assert model.strain_range == (pytest.approx(-0.25), 0.0)
    assert model.pressure_range == (0.0, pytest.approx(600.0))
    table = ("--table", "table.txt", *options, "--model", "polynomial")
    assert_law(fit(*table, table=text)[0], layouts.MUSCLE, rest=0.5)


def test_which_way_positive_forces_act_is_told_or_said(fit):
    pulls = layouts.LONG.replace(",-", ",")
    model, shown = fit("--table", "table.txt", "--positive", "pull", table=pulls)
    assert_law(model, layouts.MUSCLE, rest=0.5)
    assert "Positive forces: pull, as said" in shown
    model, shown = fit("--table", "table.txt", table=pulls)
    assert_law(model, layouts.MUSCLE, rest=0.5)
    assert "Positive forces: pull, as what is stretched pulls back (--positive push takes them the other" in shown


def test_empty_cells_of_a_table_are_no_samples(tmp_path):
    rows = layouts.WIDE.splitlines()
    rows[-1] = ";".join(rows[-1].split(";")[:4]) + ";;;;"
    (tmp_path / "t.csv").write_text("\n".join([*rows, ""]))
    recording = read_table(tmp_path / "t.csv")
    assert len(recording.force) == 6 * 7 - 4
    np.testing.assert_allclose(recording.force, layouts.muscle(recording.strain, recording.pressure), atol=1e-3)


@pytest.mark.parametrize(("name", "more"), [("strain [%]", ()), ("stroke [mm]", ("--gauge-length", "100 mm"))])
def test_what_may_contract_or_extend_is_asked_about(fit, name, more):
    said = fit("--table", "table.txt", *more, table=layouts.WIDE.replace("contraction [%]", name))
    assert "or a bellows that extends and pushes (--positive push)" in said


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("%", ""), r"table.txt: strains must be above -1, .* from contraction .* --columns .*\"contraction=1:%\""),
        (
            (" bar", ""),
            r"table.txt: line 1: the unit of pressure must be one of .*\"pressure=2:bar\", or --unit",
        ),
        (("contraction", "wear"), r"table.txt: line 1: must begin with what the first column holds, .*'wear \[%\]'"),
        (("\n5;", "\n5;x"), r"table.txt: line 3: must be 8 cells with finite numbers .*"),
        (("contraction [%];0 bar", "contraction [%];1 bar"), r"table.txt: line 1: must name each of its columns once"),
        (("1 bar", "1 psi"), r"table.txt: line 1: must name one unit of its columns, got bar and psi"),
    ],
)
def test_bad_tables(fit, change, message):
    said = fit("--table", "table.txt", table=layouts.WIDE.replace(*change))
    assert isinstance(said, str)
    assert re.match(f"torcharm: {message}", said)


def test_a_data_sheets_muscle_is_fitted_by_the_best_model_to_a_part_of_its_force(fit):
    contraction, pressure = np.linspace(0, 0.25, 11), np.linspace(0, 600, 7)
    pull = layouts.data_sheet_muscle(contraction[:, None], pressure)
    rows = [f"{100 * k:.1f}," + ",".join(f"{f:.0f}" for f in row) for k, row in zip(contraction, pull, strict=True)]
    text = layouts.text("contraction [%]," + ",".join(f"{p:.0f} kPa" for p in pressure), rows)
    model, shown = fit("--table", "table.txt", table=text)
    grid = torch.from_numpy(-contraction)[:, None], torch.from_numpy(pressure)
    assert np.abs(model.force(*grid).numpy() + pull).max() < 0.03 * pull.max()
    errors = dict(re.findall(r"(\w+) \(\d+ numbers\), on samples left out: ([\d.e+]+) N off", shown))
    assert set(errors) == {"mckibben", "polynomial", "gridded"}
    (taken,) = re.findall(r"Taken: (\w+)", shown)
    assert float(errors[taken]) <= 1.1 * min(map(float, errors.values()))
    # Between the table's lines, where no model saw anything
    between = -contraction[:-1] - 0.0125, pressure[:-1] + 50
    strain, p = (torch.from_numpy(x) for x in np.meshgrid(*between, indexing="ij"))
    off = model.force(strain, p).numpy() + layouts.data_sheet_muscle(-strain.numpy(), p.numpy())
    assert np.sqrt((off**2).mean()) < 2 * float(errors[taken])


# What is pasted, and how long it takes


def test_the_last_line_is_toml_for_any_path(fit, monkeypatch, tmp_path):
    _, shown = fit(*RUN, tester=layouts.REFERENCE, log=layouts.REFERENCE_LOG)
    assert tomllib.loads(shown.splitlines()[-1])["actuators"] == {"kind": "file", "path": "m.toml"}
    assert "In a study in this folder" in shown
    monkeypatch.setattr(sys, "argv", ["torcharm", "fit", *map(str, RUN), "--out", r"C:\models\b.toml"])
    with pytest.raises(SystemExit, match="0"):
        cli.main()
    assert (tmp_path / r"C:\models\b.toml").is_file()


def test_ten_megabytes_take_less_than_two_seconds(tmp_path):
    time_ = np.arange(0, 240_000 * 20.0, 20.0)
    rows = layouts.lines(
        time_, 0 * time_, 100 * layouts.strain_at(time_), time_ % 7.0, quote='"', formats=["{:.4f}"] * 4
    )
    rows[1000] = rows[1000].replace(",", ",x", 1)
    path = tmp_path / "long.csv"
    path.write_text(layouts.text("Time,Displacement,Strain,Force", "(ms),(mm),(%),(N)", rows))
    assert path.stat().st_size > 10e6
    started = time.process_time()
    record = ta.read_tester(path)
    assert time.process_time() - started < 2.0
    assert len(record.time) == 240_000


# What stands for nothing, or for two things, is no model


def test_one_file_s_pressures_are_not_smoothed_unless_told(fit):
    columns = (layouts.TIME, 100 * layouts.STRAIN, layouts.PULL, layouts.pressure_at(layouts.TIME))
    text = layouts.text("Time (ms),Strain (%),Force (N),Pressure (kPa)", layouts.lines(*columns))
    model, _ = fit("--tester", "tester.txt", "--degree", 2, tester=text)
    assert_law(model, layouts.TRUTH)
    smoothed, _ = fit("--tester", "tester.txt", "--degree", 2, "--smoothing", 40, tester=text)
    assert smoothed.quality.rmse > 2 * model.quality.rmse


TABLE = (
    "contraction (%),pressure (bar),force (N)\n0,0,0\n0,2,500\n0,4,1000\n10,0,0\n10,2,350\n10,4,700\n20,0,0\n20,2,200\n"
)


@pytest.mark.parametrize(
    ("option", "value"),
    [("--actuators", 4), ("--smoothing", 5), ("--offset", 3), ("--find-offset", 3), ("--max-gap", 3)],
)
def test_options_of_runs_are_refused_with_a_table(fit, option, value):
    said = fit("--table", "table.txt", option, value, table=TABLE)
    assert said.startswith(f"torcharm: {option}: must be left out with a --table, for which it means nothing, got")


def test_columns_of_a_log_are_refused_without_one(fit):
    said = fit("--table", "table.txt", "--pressure-columns", "time=1:s", table=TABLE)
    assert said.startswith("torcharm: --pressure-columns: must be left out with no --pressure")


def test_percents_without_a_unit_are_asked_about(fit):
    said = fit("--table", "table.txt", table=TABLE.replace("contraction (%)", "contraction"))
    assert "strains must be above -1, at which no length is left, and at most 5, got -20 to 0 from contraction" in said
    assert '--columns says the unit, as in "contraction=1:%"' in said
    model, _ = fit("--table", "table.txt", "--columns", "contraction=1:%", table=TABLE.replace(" (%)", ""))
    assert model.strain_range[0] == pytest.approx(-0.2)


@pytest.mark.parametrize(("unit", "newtons"), [("kN", 1000.0), ("N", 1.0)])
def test_commas_behind_a_leading_zero_are_decimal_signs(tmp_path, unit, newtons):
    samples = [line.split(",") for line in layouts.LONG.splitlines()[1:]]
    quoted = [f"{float(force) / newtons:.3f}".replace(".", ",") for *_, force in samples]
    rows = [f'{100 * float(e):.0f},{p},"{force}"' for (e, p, _), force in zip(samples, quoted, strict=True)]
    text = layouts.text(f"strain [%],pressure [kPa],force [{unit}]", rows)
    (tmp_path / "t.csv").write_text(text)
    found = read_table(tmp_path / "t.csv", positive="push")
    np.testing.assert_allclose(found.force, layouts.muscle(found.strain, found.pressure), atol=0.501e-3 * newtons)


@pytest.mark.parametrize(("separator", "read"), [(",", "thousands"), (";", "decimal signs")])
def test_commas_that_may_be_either_are_a_warning(tmp_path, separator, read):
    rows = [separator.join((str(10 * (k % 4)), str(k // 4), f'"{1200 + 37 * k:,}"')) for k in range(16)]
    names = separator.join(("contraction [%]", "pressure [bar]", "force [N]"))
    (tmp_path / "t.csv").write_text(layouts.text(names, rows))
    with pytest.warns(UserWarning, match=f"t.csv: commas read as {read}, as in 1,234, but no number tells"):
        found = read_table(tmp_path / "t.csv")
    assert abs(found.force[0]) == pytest.approx(1200 if read == "thousands" else 1.2)


def test_decimal_commas_beside_points_are_named(fit):
    rows = [f'{k / 10:.1f},"{k % 7},50","{k % 5},125"' for k in range(40)]
    said = fit("--tester", "tester.txt", tester=layouts.text("Time (s),Strain (%),Force (N)", rows))
    assert "are there decimal commas beside decimal points?" in said


def test_parts_of_1_in_a_column_of_percents_and_units_taken_are_told(fit, tmp_path):
    (tmp_path / "t.csv").write_text(layouts.LONG.replace("strain", "strain [%]"))
    with pytest.warns(UserWarning, match=r"is its unit %, are the cells parts of 1, is"):
        read_table(tmp_path / "t.csv")
    _, shown = fit("--table", "table.txt", table=layouts.LONG)
    assert "names no unit of strain: read as parts of 1" in shown


def test_one_column_is_not_two_quantities(fit):
    said = fit("--table", "table.txt", "--columns", "force=2:N", table=TABLE)
    assert "line 1: force must be in another column than pressure, got 2 for both" in said


def test_a_file_that_is_no_model_is_not_replaced(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "table.txt").write_text(TABLE)
    (tmp_path / "m.toml").write_text('name = "my study"\n')
    result = CliRunner().invoke(app, ["fit", "--table", "table.txt", "--out", "m.toml"])
    assert result.exit_code == 2
    assert (tmp_path / "m.toml").read_text() == 'name = "my study"\n'
    assert "is there and is no force model, must be another file" in " ".join(result.output.split())


# What a file says of its columns, and what it cannot mean


def one_file(header, *columns):
    return layouts.text(header, layouts.lines(layouts.TIME, 100 * layouts.STRAIN, layouts.PULL, *columns))


def test_a_stress_is_no_pressure(fit):
    text = one_file("Time (ms),Strain (%),Force (N),Tensile stress (kPa)", layouts.pressure_at(layouts.TIME))
    assert "must name one column of pressure" in fit("--tester", "tester.txt", tester=text)


def test_decimal_commas_between_commas_are_no_columns(fit):
    rows = layouts.lines(layouts.TIME, 100 * layouts.STRAIN, layouts.PULL, decimal=",")
    said = fit("--tester", "tester.txt", tester=layouts.text("Time (ms),Strain (%),Force (N)", rows))
    assert "tester.txt: line 1: must name all 6 columns, got 3 names" in said
    assert "are there decimal commas between commas?" in said


def test_lines_that_are_left_out_are_warnings_with_their_numbers(tmp_path):
    names, units, *rows = layouts.REFERENCE.splitlines()
    rows = [row if k % 40 else "start of a cycle" for k, row in enumerate(rows)]
    rows[7] = rows[7].replace('"0', '"o', 1).replace(".", ".x", 1)
    (tmp_path / "run.csv").write_text(layouts.text(names, units, rows))
    words = "run.csv: lines 43, 83, 123, 163, 203 and 4 more of words or with empty cells passed over"
    with pytest.warns(UserWarning, match=words), pytest.warns(UserWarning, match=r"run.csv: line 10 damaged, left out"):
        ta.read_tester(tmp_path / "run.csv")


def test_the_file_and_the_command_say_whose_bending_stiffness_it_is(fit, tmp_path):
    _, shown = fit("--table", "table.txt", "--model", "mckibben", table=layouts.WIDE)
    assert "-0.286 N·m², which the paper estimated for its own bellows and muscles, is assumed" in shown
    text = (tmp_path / "m.toml").read_text()
    assert "# The paper's estimate for its own bellows and muscles, assumed: neither" in text
    _, shown = fit("--table", "table.txt", "--model", "mckibben", "--bending", "-0.1", table=layouts.WIDE)
    assert "assumed" not in shown + (tmp_path / "m.toml").read_text()
