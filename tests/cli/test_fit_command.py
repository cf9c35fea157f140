"""`torcharm fit`, and the file it writes, in studies and arms; on recordings of a bellows that is known."""

import re
import tomllib

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

import torcharm as ta
from torcharm import cli
from torcharm.cli.app import app
from torcharm.study import evaluate_study, load_study


def write_run(folder, name, peak=80.0, noise=0.2, offset=0.0):
    """Files of a run with five held strains; the log's clock reads `offset` ms less than the tester's."""
    random = np.random.default_rng(len(name))
    time = np.arange(0, 50_000, 20.0)
    strain = np.repeat(np.linspace(-0.15, 0.6, 5), len(time) // 5)

    def pressure(t):
        return peak * np.sin(np.pi * (t % 10_000) / 10_000) ** 2

    force = ta.Bellows().force(torch.from_numpy(strain), torch.from_numpy(pressure(time))).numpy()
    force = force + noise * random.normal(size=len(time))
    rows = [f'"{t:.4f}","0","{100 * e:.4f}","{-4 * f:.4f}"' for t, e, f in zip(time, strain, force, strict=True)]
    csv, log = folder / f"{name}.csv", folder / f"{name}.txt"
    csv.write_text(
        "Time,Displacement,Tensile strain (Displacement),Force\n(ms),(mm),(%),(N)\n" + "\n".join(rows) + "\n"
    )
    clock = np.arange(0, 50_000, 10.0)
    rows = [f"{t:.0f},{p / 6.894757293168361:.5f}" for t, p in zip(clock, pressure(clock + offset), strict=True)]
    log.write_text("\n".join(["Time,Pressure", *rows, "Logging end", ""]))
    return csv, log


@pytest.fixture
def runs(tmp_path):
    return [*write_run(tmp_path, "one"), *write_run(tmp_path, "second", 70.0)]


def arguments(runs, *more):
    pairs = [("--instron", csv, "--pressure", log) for csv, log in zip(runs[::2], runs[1::2], strict=True)]
    return [str(arg) for arg in (*sum(pairs, ()), "--actuators", 4, "--smoothing", 0, *more)]


def fit(runs, *more):
    result = CliRunner().invoke(app, ["fit", *arguments(runs, *more)], env={"COLUMNS": "80"})
    assert result.exit_code == 0, result.output
    return result


def test_pressures_of_the_tester_that_are_not_the_logs_are_told(runs, tmp_path):
    csv, log = runs[:2]
    rows = csv.read_text().splitlines()
    other = [f'{row},"{0.01 * i}"' for i, row in enumerate(rows[2:])]
    both = tmp_path / "both.csv"
    both.write_text("\n".join([f"{rows[0]},Pressure", f"{rows[1]},(kPa)", *other, ""]))
    said = "its own pressures reach 24.99 kPa, those of"
    assert said in " ".join(fit([both, log], "--out", tmp_path / "m.toml").output.split())
    assert said not in " ".join(fit([csv, log], "--out", tmp_path / "m.toml").output.split())


def test_a_fit_from_files_to_file(runs, tmp_path):
    out, figure = tmp_path / "bellows.toml", tmp_path / "fit.png"
    result = fit(runs, "--out", out, "--figure", figure, "--max-pressure", 50)
    model = ta.load_actuator(out)
    assert isinstance(model, ta.FittedActuator)
    off = np.array([c for *_, c in model.coefficients]) - [c for *_, c in ta.Bellows().coefficients]
    assert (np.abs(off) < 4 * np.array(model.quality.standard_errors)).all()
    assert model.max_pressure == 50.0
    assert f"R² {model.quality.r_squared:.5f}" in result.stdout
    assert "Run 2 from the others: R² 0.99" in result.stdout
    assert "Monotonic in pressure" in result.stdout
    assert f"Wrote {out}" in result.stdout
    assert figure.read_bytes().startswith(b"\x89PNG")
    provenance = tomllib.loads(out.read_text())["provenance"]
    assert provenance["run 2"] == "second.csv, second.txt"
    assert provenance["actuators in parallel"] == 4


def test_the_options_are_those_of_python(runs, tmp_path):
    out = tmp_path / "m.toml"
    fit(
        runs,
        "--out",
        out,
        "--degree",
        4,
        "--loss",
        "huber",
        "--monotonic",
        "--bending",
        "-0.1",
        "--max-gap",
        500,
    )
    model = ta.load_actuator(out)
    recording = ta.pool(
        [
            ta.align(ta.read_tester(csv), ta.read_pressure(log), actuators=4, smoothing=0.0, max_gap=500.0)
            for csv, log in (runs[:2], runs[2:])
        ]
    )
    assert model == ta.fit_recording(recording, 4, loss="huber", monotonic=True, bending_stiffness=-0.1)


def test_offsets_are_given_or_found(tmp_path):
    late = write_run(tmp_path, "late", noise=0.02, offset=150.0)
    out = tmp_path / "m.toml"
    (found,) = re.findall(r"Offset of the log, ms: (.*)", fit(late, "--out", out, "--find-offset").stdout)
    assert float(found) == pytest.approx(150.0, abs=0.5)
    assert ta.load_actuator(out).quality.rmse < 0.25
    assert "Offset of the log, ms: 150.0" in fit(late, "--out", out, "--offset", 150).stdout
    fit(late, "--out", out)
    assert ta.load_actuator(out).quality.rmse > 0.5


def test_a_wrong_unit_is_a_warning_on_stderr(runs, tmp_path):
    result = fit(runs[:2], "--out", tmp_path / "m.toml", "--unit", "kPa")
    (line,) = result.stderr.strip().splitlines()
    assert re.match(r"torcharm: warning: .*one.txt: pressures reach 11.6 kPa when read as kPa", line)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (["--pressure", "x.txt"], "--pressure: must be given once for each --instron, got 3 logs for 2 runs"),
        (["--offset", "1", "--find-offset"], "--find-offset: must not stand beside --offset"),
        (
            ["--offset", "1", "--offset", "2", "--offset", "3"],
            "--offset: must be given once, or once for each of 2 runs",
        ),
        (["--degree", "12"], "degree: must be at most 9, got 12"),
        (["--loss", "square"], "loss: must be one of linear, huber"),
        (["--unit", "torr"], "unit: must be one of kPa, Pa"),
        (["--figure", "a.txt"], "--figure: a.txt: must end in one of"),
        (["--actuators", "0"], "actuators: must be an integer of at least 1"),
    ],
)
def test_mistakes_are_one_line_and_write_nothing(runs, tmp_path, monkeypatch, capsys, change, message):
    out = tmp_path / "m.toml"
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["torcharm", "fit", *arguments(runs, "--out", out, *change)])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    error = capsys.readouterr().err
    assert caught.value.code == 2
    assert error.startswith(f"torcharm: {message}")
    assert error.count("\n") == 1
    assert not out.exists()


def test_the_recording_is_not_overwritten(runs, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["torcharm", "fit", *arguments(runs, "--out", runs[0])])
    with pytest.raises(SystemExit):
        cli.main()
    assert "is one of the recordings" in capsys.readouterr().err


# The file in studies and arms

STUDY = """
name = "files"
[[arm]]
name = "ours"
radii = [-0.05, 0.05]
length = 0.5
actuators = [{ACTUATOR}, "bellows"]
[[task]]
name = "bend"
shape = {{ kind = "affine", slope = 0.5, intercept = 0.5 }}
loads = {{ count = 5 }}
"""


def study(folder, actuator):
    path = folder / "study.toml"
    path.write_text(STUDY.replace("{ACTUATOR}", actuator).replace("{{", "{").replace("}}", "}"), encoding="utf-8")
    return path


def test_a_study_loads_a_model_file_from_its_own_folder(tmp_path, monkeypatch):
    (tmp_path / "models").mkdir()
    grid = ta.GriddedActuator((-0.2, 0.6), (0.0, 60.0), ((10.0, 80.0), (-20.0, 40.0)), 60.0)
    ta.save_actuator(tmp_path / "models" / "grid.toml", grid)
    monkeypatch.chdir("/")
    plan = load_study(
        study(tmp_path, '{ kind = "file", path = "models/grid.toml", max_pressure = 40, force_scale = 2 }')
    )
    model, bellows = plan.arms[0].design.actuators
    assert (model.force_scale, model.max_pressure, model.forces) == (2.0, 40.0, grid.forces)
    assert bellows == ta.Bellows()
    assert bool(next(evaluate_study(plan)).attainability.distances_converged.all())


@pytest.mark.parametrize(
    ("actuator", "bending"),
    [
        ('{ kind = "bellows", bending = { kind = "constant", stiffness = -0.1 } }', ta.ConstantBending(-0.1)),
        ('{ kind = "mckibben", bending = { kind = "linear", stiffness = -0.1 } }', ta.LinearBending(-0.1)),
        (
            '{ kind = "polynomial", coefficients = [[0, 1, 1]], strain_range = [-1, 1], pressure_range = [0, 9], '
            'max_pressure = 9, bending = { kind = "linear", stiffness = -1, reference_pressure = 40 } }',
            ta.LinearBending(-1.0, 40.0),
        ),
    ],
)
def test_a_study_sets_bending_models(tmp_path, actuator, bending):
    assert load_study(study(tmp_path, actuator)).arms[0].design.actuators[0].bending_stiffness == bending


@pytest.mark.parametrize(
    ("actuator", "message"),
    [
        ('{ kind = "file" }', "path: missing; must be a text in quotes"),
        ('{ kind = "file", path = "none.toml" }', "none.toml: cannot be read: No such file"),
        ('{ kind = "file", path = "study.toml" }', "study.toml: kind: must be one of polynomial"),
        ('{ kind = "bellows", bending = 3 }', "bending: must be a table, got 3"),
        ('{ kind = "bellows", bending = { kind = "wild", stiffness = 1 } }', "kind: must be one of linear, constant"),
        ('{ kind = "bellows", bending = { kind = "linear" } }', "stiffness: missing; must be a number"),
        (
            '{ kind = "bellows", bending_stiffness = 1, bending = { kind = "linear", stiffness = 1 } }',
            "bending: must not stand beside bending_stiffness",
        ),
        (
            '{ kind = "bellows", bending = { kind = "constant", stiffness = 1, reference_pressure = 3 } }',
            "bending.reference_pressure: must not be given for constant",
        ),
    ],
)
def test_bad_models_in_a_study(tmp_path, actuator, message):
    with pytest.raises(ValueError, match=re.escape(message)) as error:
        load_study(study(tmp_path, actuator))
    assert "study.toml: arm[1]" in str(error.value)
    assert "actuators[1]" in str(error.value)
    assert "\n" not in str(error.value)


def test_an_arm_loads_model_files(tmp_path):
    path = tmp_path / "m.toml"
    ta.save_actuator(path, ta.Bellows())
    arm = ta.ArmDesign([-0.05, 0.0, 0.05], 0.5, [path, str(path), ta.McKibben()])
    assert arm.actuators == (ta.Bellows(), ta.Bellows(), ta.McKibben())
    with pytest.raises(ValueError, match=r"none.toml: cannot be read"):
        ta.ArmDesign([0.0], 0.5, ["none.toml"])
