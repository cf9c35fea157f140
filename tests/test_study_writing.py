"""Arms as tables of a study, and back."""

import dataclasses

import pytest
import torch

import torcharm as ta
from torcharm.actuators.model_file import save_actuator
from torcharm.study import arm_to_toml, load_study, parse_study

REST = '\n[[task]]\nname = "t"\ntwists = [[0.5, 0, 0]]\nloads = [[0, 0, 0]]\n'
POLYNOMIAL = ta.PolynomialActuator(((0, 1, 0.1 + 0.2), (1, 0, -100 / 3), (2, 3, 1e-17)), (-0.3, 1 / 3), (0, 50), 50)


def read(text, folder="."):
    (arm,) = parse_study(f'name = "s"\n{text}{REST}', folder=folder).arms
    return arm


def check_same(arm, again):
    for name in ("radii", "length", "max_pressure"):
        assert getattr(again, name).tolist() == getattr(arm, name).tolist()
    assert again.actuators == arm.actuators


MODELS = {
    "the paper's": [ta.Bellows(), ta.McKibben()],
    "scaled": [ta.Bellows(max_pressure=92 / 7, force_scale=0.1), ta.McKibben(bending_stiffness=-1 / 7, force_scale=2)],
    "polynomial": [POLYNOMIAL, dataclasses.replace(POLYNOMIAL, bending_stiffness=0.0, force_scale=-1.5)],
    "bending": [
        ta.Bellows(bending_stiffness=ta.ConstantBending(-0.1)),
        dataclasses.replace(POLYNOMIAL, bending_stiffness=ta.LinearBending(-0.3, 100 / 3)),
    ],
    "bending without a pressure": [ta.McKibben(bending_stiffness=ta.LinearBending(-0.3)), ta.Bellows()],
}


@pytest.mark.parametrize("models", MODELS.values(), ids=MODELS)
def test_an_arm_reads_back_as_it_was(models):
    arm = ta.ArmDesign([-0.1 / 3, 0.05], [0.4 / 7, 0.5], models, [1e-3 / 3, 50.0])
    found = read(arm_to_toml(arm, 'a "quoted" name, κ'))
    assert found.name == 'a "quoted" name, κ'
    check_same(arm, found.design)


@pytest.mark.parametrize("arm", [ta.antagonistic_arm(), ta.bellows_arm(), ta.mckibben_arm()])
def test_the_papers_arms(arm):
    check_same(arm, read(arm_to_toml(arm, "paper")).design)


def test_numbers_that_are_tensors_and_single_precision():
    arm = ta.ArmDesign([-0.05], 0.5, [ta.Bellows(force_scale=torch.tensor(1.5, requires_grad=True))]).to(torch.float32)
    check_same(arm, read(arm_to_toml(arm, "a")).design)


def test_models_of_files_keep_their_paths(tmp_path):
    fitted = ta.fit_force_model([0.0, 0.1, 0.2, 0.3] * 2, [0.0, 20, 40, 10, 30, 50, 5, 15], range(8), 1)
    save_actuator(tmp_path / "own.toml", fitted)
    (tmp_path / "study.toml").write_text(
        'name = "s"\n[[arm]]\nname = "a"\nradii = [0, 0.02]\nlength = 0.5\n'
        f'actuators = ["bellows", {{ kind = "file", path = "own.toml", force_scale = 3.0 }}]\n{REST}'
    )
    (arm,) = load_study(tmp_path / "study.toml").arms
    assert arm.files == (None, "own.toml")
    check_same(arm.design, read(arm_to_toml(arm.design, "b", arm.files), tmp_path).design)
    with pytest.raises(ValueError, match=r"^actuators\[2\]: a study holds Bellows\(\) and McKibben\(\)"):
        arm_to_toml(arm.design, "b")
    with pytest.raises(ValueError, match="files: must be a path or None for each of 2"):
        arm_to_toml(arm.design, "b", ["own.toml"])


class OwnBellows(ta.Bellows):
    pass


@pytest.mark.parametrize(
    ("model", "words"),
    [
        (OwnBellows(), r"actuators\[2\]: a study holds .* got OwnBellows"),
        (ta.Bellows(coefficients=((0, 1, 1.0),)), r"actuators\[2\]: a study holds"),
        (ta.McKibben(strain_range=(-0.2, 0.0)), r"actuators\[2\]: a study holds"),
        (ta.Bellows(bending_stiffness=ta.BendingFunction(lambda k, p: -k * p, 50.0)), r"actuators\[2\]: a study holds"),
        (dataclasses.replace(POLYNOMIAL, strain_range=(0.1, 0.1)), r"actuators\[2\]\.strain_range: must be \[lowest"),
        (dataclasses.replace(POLYNOMIAL, coefficients=((30, 0, 1.0),)), r"actuators\[2\]\.coefficients\[1\]: powers"),
    ],
)
def test_what_a_study_cannot_express_is_refused(model, words):
    with pytest.raises(ValueError, match=f"^{words}"):
        arm_to_toml(ta.ArmDesign([-0.05, 0.05], 0.5, [ta.Bellows(), model]), "a")


@pytest.mark.parametrize(
    ("arm", "words"),
    [
        (ta.bellows_arm(outer_radius=[0.07, 0.08]), "arm: must be a single design"),
        (ta.ArmDesign(offsets=ta.ring(0.05, 3), length=0.4, actuators=ta.Bellows()), "arm: must be a planar ArmDesign"),
        (ta.ArmDesign([0.0], 0.4, [ta.Bellows()], mass=0.3), "mass: must be left out"),
        (ta.ArmDesign([0.0], 0.4, [ta.Bellows()], diameter=0.03), "diameter: must be left out"),
    ],
)
def test_arms_that_no_study_holds_are_refused(arm, words):
    with pytest.raises(ValueError, match=words):
        arm_to_toml(arm, "a")


def test_a_name_is_one_line():
    with pytest.raises(ValueError, match="name: must be a text of one line"):
        arm_to_toml(ta.bellows_arm(), "two\nlines")
