"""Arms as tables of a study, and back."""

import dataclasses
import re

import pytest
import torch

import torcharm as ta
from torcharm.arm_series import segments_of
from torcharm.characterise.model_file import save_actuator
from torcharm.study import arm_to_toml, load_study, parse_study

REST = '\n[[task]]\nname = "t"\n'
STRAIGHT = "twists = [[0.5, 0, 0]]\nloads = [[0, 0, 0]]\n"
POLYNOMIAL = ta.PolynomialActuator(((0, 1, 0.1 + 0.2), (1, 0, -100 / 3), (2, 3, 1e-17)), (-0.3, 1 / 3), (0, 50), 50)


def read(text, folder=".", twists=STRAIGHT):
    (arm,) = parse_study(f'name = "s"\n{text}{REST}{twists}', folder=folder).arms
    return arm


def numbers(value):
    """What a force model is made of, class by class and number by number."""
    if dataclasses.is_dataclass(value):
        yield type(value)
        value = [getattr(value, field.name) for field in dataclasses.fields(value)]
    if isinstance(value, (list, tuple)):
        for item in value:
            yield from numbers(item)
    elif isinstance(value, torch.Tensor):
        yield value.item()
    else:
        yield value


def check_same(arm, again):
    """To 1e-9 of each number."""
    for given, read in zip(numbers(arm.actuators), numbers(again.actuators), strict=True):
        assert read == (pytest.approx(given, rel=1e-9, abs=0) if isinstance(given, float) else given)
    for one, other in zip(segments_of(arm)[0], segments_of(again)[0], strict=True):
        for name in ("radii", "out_of_plane", "length", "max_pressure", "mass", "torsion_stiffness", "diameter"):
            given, read = getattr(one, name), getattr(other, name)
            assert (read is None) == (given is None), name
            if given is not None:
                torch.testing.assert_close(read, given.double(), rtol=1e-9, atol=1e-12)
    for one, other in zip(segments_of(arm)[1], segments_of(again)[1], strict=True):
        assert (one is None) == (other is None)
        if one is not None:
            assert other.length.item() == pytest.approx(one.length.item(), rel=1e-9)
            assert other.mass.item() == pytest.approx(one.mass.item(), rel=1e-9)


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
        f'actuators = ["bellows", {{ kind = "file", path = "own.toml", force_scale = 3.0 }}]\n{REST}{STRAIGHT}'
    )
    (arm,) = load_study(tmp_path / "study.toml").arms
    assert arm.files == (None, "own.toml")
    check_same(arm.design, read(arm_to_toml(arm.design, "b", arm.files), tmp_path).design)
    with pytest.raises(ValueError, match=r"^actuators\[2\]: a study holds Bellows\(\) and McKibben\(\)"):
        arm_to_toml(arm.design, "b")
    with pytest.raises(ValueError, match="files: must be a path or None for each of 2"):
        arm_to_toml(arm.design, "b", ["own.toml"])


SPATIAL = ta.ArmDesign(
    offsets=torch.cat((ta.ring(0.05 / 3, 3, 0.1), torch.zeros(1, 2))),
    length=0.3,
    actuators=[ta.chamber(8e-5)] * 3 + [ta.elastic_core(40.0 / 7, 1e-3)],
    mass=0.1,
    torsion_stiffness=0.01,
    diameter=0.01,
)

CHANGED = [
    dataclasses.replace(ta.chamber(8e-5, strain_range=(-0.2, 0.5)), max_pressure=50.0),
    dataclasses.replace(ta.elastic_core(40.0, 1e-3), bending_stiffness=-0.2),
]
PAIR = ta.ArmDesign(offsets=ta.ring(0.03, 2), length=1 / 7, actuators="bellows")


@pytest.mark.parametrize(
    "arm",
    [
        SPATIAL,
        ta.ArmDesign([0.0, 0.05], 0.4, ta.Bellows(), mass=0.3, diameter=[0.03, 0.02]),
        ta.series([SPATIAL, ta.RigidLink(0.1 / 3, mass=0.05)]),
        ta.series(
            [SPATIAL, ta.RigidLink(0.02), ta.ArmDesign(offsets=ta.ring(0.03, 2), length=0.2, actuators="bellows")]
        ),
        ta.series([ta.bellows_arm(), ta.mckibben_arm()]),
    ],
    ids=["space", "mass", "tip", "series in space", "series in the plane"],
)
def test_arms_in_space_with_mass_or_in_series_read_back(arm):
    counts = [1] * len(segments_of(arm)[0])
    shape = [0.4, 0, 0] if arm.dimension == 2 else [0.4, 0, 0, 0, 0, 0]
    twists = f"twists = {[shape] * len(counts)}\nsegment_nodes = {counts}\nloads = [{[0] * len(shape)}]"
    check_same(arm, read(arm_to_toml(arm, "a"), twists=twists).design)


def test_ready_models_are_written_as_what_they_are_and_in_few_digits():
    text = arm_to_toml(SPATIAL, "a")
    assert text.count('{ kind = "chamber", area = 8e-05, max_pressure = 100.0 }') == 3
    assert '{ kind = "elastic_core", axial_stiffness = 5.714285714, bending_stiffness = 0.001 }' in text
    assert max(len(number.strip("0.").replace(".", "")) for number in re.findall(r"[\d.]+", text)) <= 10
    ring = arm_to_toml(ta.ArmDesign(offsets=ta.ring(0.05, 4), length=0.3, actuators="bellows"), "a")
    assert "[0.0, 0.05]" in ring  # and not the cosine of a right angle
    bounded = arm_to_toml(ta.ArmDesign([0.0], 0.1, ta.chamber(8e-5, strain_range=(-0.2, 0.5)), 50.0), "a")
    assert "strain_range = [-0.2, 0.5]" in bounded


def test_a_ready_model_that_was_changed_is_written_as_a_polynomial():
    arm = read(arm_to_toml(ta.ArmDesign([-0.01, 0.0], 0.1, CHANGED), "a")).design
    strain, pressure = torch.tensor([[-0.1, 0.2]]).double().mT, torch.tensor([0.0, 30.0]).double()
    for given, found in zip(CHANGED, arm.actuators, strict=True):
        assert type(found) is ta.PolynomialActuator
        torch.testing.assert_close(found.force(strain, pressure), given.force(strain, pressure), rtol=1e-9, atol=0)
        assert found.bending_stiffness == given.bending_stiffness
        assert (found.max_pressure, found.strain_range) == (given.max_pressure, given.strain_range)


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
        (ta.series([SPATIAL, ta.RigidLink(pose=torch.eye(4))]), "link.pose: must be left out"),
        (ta.series([SPATIAL, ta.RigidLink(pose=torch.eye(4)), SPATIAL]), r"segment\[1\].link.pose: must be left out"),
    ],
)
def test_arms_that_no_study_holds_are_refused(arm, words):
    with pytest.raises(ValueError, match=words):
        arm_to_toml(arm, "a")


def test_a_name_is_one_line():
    with pytest.raises(ValueError, match="name: must be a text of one line"):
        arm_to_toml(ta.bellows_arm(), "two\nlines")
