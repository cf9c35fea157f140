"""A force model that was written and read is the one that was written."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, strategies as st

import torcharm as ta
from torcharm.characterise.model_file import actuator_text

RANDOM = np.random.default_rng(0)
FITTED = ta.fit_force_model(
    RANDOM.uniform(-0.1, 0.6, 300),
    RANDOM.uniform(0, 90, 300),
    RANDOM.normal(size=300),
    run=np.repeat([0, 1, 2], 100),
    provenance=(("run 1", 'über "quoted" \\ path\t\x7f.csv'), ("offset of the log, ms", 0.1), ("π", 1e-300)),
)
MODELS = {
    "paper": ta.Bellows(),
    "muscle": ta.McKibben(force_scale=2.0, max_pressure=80.0),
    "polynomial": ta.PolynomialActuator(((1, 0, -1 / 3), (0, 1, 1e-17)), (-0.1, 0.2 + 0.1), (0.0, 50.0), 50.0),
    "fitted": FITTED,
    "held monotonic": ta.fit_force_model(
        [0.1, 0.2, 0.3, 0.4], [1.0, 5.0, 2.0, 8.0], [1.0, 2.0, 0.0, 4.0], 1, monotonic=True
    ),
    "bare fitted": ta.FittedActuator(((0, 1, 1.0),), (0.0, 1.0), (0.0, 1.0), 1.0),
    "gridded": ta.GriddedActuator((0.0, 0.1, 0.3), (0.0, 20.0), ((0.0, 0.1), (0.2, 1 / 3), (1e22, 5.0)), 20.0),
    "linear": ta.Bellows(bending_stiffness=ta.LinearBending(-0.1, 30.0)),
    "linear at its own": ta.Bellows(bending_stiffness=ta.LinearBending(-0.1)),
    "constant": ta.McKibben(bending_stiffness=ta.ConstantBending(-0.02)),
    "gridded constant": ta.GriddedActuator((0.0, 1.0), (0.0, 1.0), ((0.0, 1.0),) * 2, 1.0, ta.ConstantBending(-0.1)),
}


@pytest.mark.parametrize("name", MODELS)
def test_a_round_trip_changes_nothing(name, tmp_path):
    path, model = tmp_path / "model.toml", MODELS[name]
    ta.save_actuator(path, model)
    found = ta.load_actuator(path)
    assert found == model
    assert type(found) is type(model)
    if isinstance(model, ta.FittedActuator):
        assert (found.quality, found.provenance) == (model.quality, model.provenance)
    ta.save_actuator(tmp_path / "again.toml", found)
    assert (tmp_path / "again.toml").read_bytes() == path.read_bytes()


def test_tensors_are_kept_as_their_numbers(tmp_path):
    half = torch.tensor(0.5, requires_grad=True)
    model = ta.Bellows(force_scale=5 * half, bending_stiffness=ta.LinearBending(-half, 30.0))
    ta.save_actuator(tmp_path / "m.toml", model)
    assert ta.load_actuator(tmp_path / "m.toml") == ta.Bellows(
        force_scale=2.5, bending_stiffness=ta.LinearBending(-0.5, 30.0)
    )


finite = st.floats(allow_nan=False, allow_infinity=False)


@given(st.lists(st.tuples(st.integers(0, 6), st.integers(0, 6), finite), min_size=1, max_size=5), st.text())
def test_any_numbers_and_texts_survive(terms, text):
    model = ta.FittedActuator(tuple(terms), (0.0, 1.0), (0.0, 1.0), 1.0, provenance=(("note", text),))
    raw = tomllib.loads(actuator_text(model))
    assert [tuple(term) for term in raw["coefficients"]] == [(i, j, c) for i, j, c in model.coefficients]
    assert raw["provenance"]["note"] == text


def test_a_file_says_what_it_holds():
    raw = tomllib.loads(actuator_text(FITTED))
    assert raw["kind"] == "fitted polynomial"
    assert raw["units"] == {"strain": "1", "pressure": "kPa", "force": "N", "bending_stiffness": "N·m²"}
    assert raw["quality"]["r_squared"] == FITTED.quality.r_squared
    assert len(raw["quality"]["hold_out"]) == 3
    assert raw["quality"]["monotonicity"]["up_to"] == FITTED.quality.monotonicity.up_to


def test_a_loaded_model_evaluates_as_the_one_saved(tmp_path):
    ta.save_actuator(tmp_path / "m.toml", ta.Bellows())
    task = ta.Task(ta.affine_curvature(0.5, 0.5), [1.0, -2.0, 0.1])
    arms = [ta.ArmDesign([-0.05, 0.05], 0.5, [m] * 2) for m in (ta.Bellows(), ta.load_actuator(tmp_path / "m.toml"))]
    one, other = (ta.evaluate(arm, task, ("absolute", "relative")).absolute for arm in arms)
    assert torch.equal(one, other)


class Own:
    bending_stiffness, max_pressure, strain_range, pressure_range = 0.0, 1.0, (0.0, 1.0), (0.0, 1.0)

    def force(self, strain, pressure):
        return strain


def test_models_that_no_file_holds(tmp_path):
    with pytest.raises(ValueError, match=r"^model: must be one of PolynomialActuator, .*, got <"):
        ta.save_actuator(tmp_path / "m.toml", Own())
    bent = ta.Bellows(bending_stiffness=ta.BendingFunction(lambda k, p: -k, 50.0))
    with pytest.raises(ValueError, match=r"^bending_stiffness: a file holds a number or a linear, constant"):
        ta.save_actuator(tmp_path / "m.toml", bent)
    assert not (tmp_path / "m.toml").exists()
    with pytest.raises(ValueError, match=r"^provenance: must name each thing once"):
        actuator_text(replace(FITTED, provenance=(("a", 1.0), ("a", 2.0))))


GOOD = actuator_text(MODELS["polynomial"])
BAD = {
    "": "kind: must be one of polynomial, fitted polynomial, gridded, chamber, elastic core, bellows, mckibben, got",
    "kind = 3": "kind: must be one of",
    'kind = "cubic"': "kind: must be one of .*'cubic'",
    "kind = ": "line 1: is not valid TOML: Invalid value, where the file ends: it is cut short",
    'kind = "bellows"\nnotes = "cut': r"line 2: is not valid .*: Unterminated string, where the file ends: it is cut",
    'kind = "bellows"\nforce = 3': "force: unknown, allowed: coefficients",
    'kind = "polynomial"': "coefficients: missing",
    'kind = "bellows"\nmax_pressure = "high"': "max_pressure: must be of type float, got 'high'",
    'kind = "bellows"\nmax_pressure = -2': "max_pressure: must be finite and above 0 kPa, got -2",
    'kind = "bellows"\nstrain_range = [1.0]': "strain_range: must be a list of 2",
    'kind = "bellows"\ncoefficients = [[0, 1.5, 2.0]]': "coefficients: must be of type int, got 1.5",
    'kind = "bellows"\n[units]\npressure = "psi"': r"units.pressure: must be among .*, got 'psi'",
    'kind = "bellows"\nbending_stiffness = 1.0\n[bending]\nkind = "linear"\nstiffness = 1.0': "bending: must not stand",
    'kind = "bellows"\n[bending]\nkind = "wild"': "bending.kind: must be one of linear, constant, got 'wild'",
    'kind = "bellows"\n[bending]\nkind = "linear"': "bending.stiffness: missing",
    'kind = "bellows"\n[bending]\nkind = "linear"\nstiffness = nan': "bending.stiffness: must be a finite number",
    'kind = "bellows"\nbending = 3': "bending: must be a table",
    'kind = "gridded"\nstrains = [0, 1]\npressures = [0, 1]\nforces = [[0]]\nmax_pressure = 1': "forces: must",
    GOOD.replace('"polynomial"', '"fitted polynomial"') + "[quality]\nr_squared = 1.0": "quality.samples: missing",
    GOOD.replace('"polynomial"', '"fitted polynomial"')
    + "[provenance]\nx = [1]": "provenance: must be a table of texts",
}


@pytest.mark.parametrize("text", BAD)
def test_bad_files(tmp_path, text):
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=f"bad.toml: {BAD[text]}") as error:
        ta.load_actuator(path)
    assert "\n" not in str(error.value)


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(ValueError, match=r"none.toml: cannot be read: No such file"):
        ta.load_actuator(tmp_path / "none.toml")
    (tmp_path / "b.toml").write_bytes(b'kind = "\xff"')
    with pytest.raises(ValueError, match=r"b.toml: must be UTF-8 text"):
        ta.load_actuator(tmp_path / "b.toml")
