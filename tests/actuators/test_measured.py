"""A fitted model carries what was measured: its region, and whether its bending stiffness is anyone's."""

import sys

import numpy as np
import pytest
import torch
from scipy.spatial import Delaunay

import torcharm as ta
from torcharm import cli
from torcharm.actuators.measured import SLACK, measured_region
from torcharm.attainability.questions import note_on_bending
from torcharm.characterise.model_file import ASSUMED

RANDOM = np.random.default_rng(5)


def wedge(count=2000):
    """Samples of which high pressures go with long actuators alone."""
    strain, pressure = RANDOM.uniform(-0.15, 0.6, count), RANDOM.uniform(0, 90, count)
    own = pressure < 20 + 90 * strain
    force = ta.Bellows().force(torch.from_numpy(strain), torch.from_numpy(pressure)).numpy()
    return strain[own], pressure[own], force[own]


@pytest.mark.parametrize("kind", ["polynomial", "gridded"])
def test_the_region_is_the_hull_of_the_samples_and_a_file_keeps_it(tmp_path, kind):
    strain, pressure, force = wedge()
    if kind == "polynomial":
        model = ta.fit_force_model(strain, pressure, force)
    else:
        axes = np.linspace(strain.min(), strain.max(), 5), np.linspace(0, pressure.max(), 5)
        model = ta.fit_gridded_model(strain, pressure, force, *axes)
    ta.save_actuator(tmp_path / "m.toml", model)
    model = ta.load_actuator(tmp_path / "m.toml")
    tried = RANDOM.uniform((-0.3, -5), (0.8, 100), (3000, 2))
    hull = Delaunay(np.column_stack((strain, pressure)))
    inside = hull.find_simplex(tried) >= 0
    found = model.characterised(*torch.from_numpy(tried).T).numpy()
    assert found[inside].all()
    # Beyond the hull grown by the slack about its middle, to which no grown edge is nearer, nothing is
    widths = np.ptp(model.region, axis=0)
    nearest = [np.abs((point - np.column_stack((strain, pressure))) / widths).max(-1).min() for point in tried]
    assert not found[np.array(nearest) > 3 * SLACK].any()
    assert 0.2 < found.mean() < 0.6


def test_a_line_of_samples_has_no_region():
    assert measured_region(np.linspace(0, 1, 9), np.linspace(0, 50, 9)) == ()
    assert measured_region(np.zeros(9), np.linspace(0, 50, 9)) == ()


def test_equilibria_beyond_the_region_are_out_of_range_though_within_the_box():
    strain, pressure, force = wedge()
    model = ta.fit_force_model(strain, pressure, force, max_pressure=50.0, bending_stiffness=-0.1)
    arm = ta.ArmDesign([-0.05, 0.05], 0.4, [model, model])
    free = ta.solve_equilibrium(arm, [5.0, 5.0], [0.0, 0.0, 0.0], nodes=4)
    held = ta.solve_equilibrium(arm, [45.0, 45.0], [0.0, 76.0, 0.0], nodes=4)
    for found in (free, held):
        length = found.twists[..., 0] / 0.4 - 1
        assert bool(((length > model.strain_range[0]) & (length < model.strain_range[1])).all())
    assert bool(free.in_range)
    assert not bool(held.in_range)
    plain = ta.ArmDesign([-0.05, 0.05], 0.4, [ta.PolynomialActuator(
        model.coefficients, model.strain_range, model.pressure_range, 50.0, -0.1)] * 2)  # fmt: skip
    assert bool(ta.solve_equilibrium(plain, [45.0, 45.0], [0.0, 76.0, 0.0], nodes=4).in_range)


def test_an_assumed_bending_stiffness_is_told_by_files_and_commands(tmp_path, monkeypatch, capsys):
    model = ta.fit_force_model(*wedge())
    assert model.bending_stiffness.assumed
    ta.save_actuator(tmp_path / "m.toml", model)
    text = (tmp_path / "m.toml").read_text()
    assert text.index(ASSUMED) < text.index("[bending]")
    assert ta.load_actuator(tmp_path / "m.toml") == model
    known = ta.fit_force_model(*wedge(), bending_stiffness=-0.1)
    ta.save_actuator(tmp_path / "known.toml", known)
    assert ASSUMED not in (tmp_path / "known.toml").read_text()
    arm = ta.ArmDesign([-0.05, 0.0, 0.05], 0.4, [model, known, model])
    assert note_on_bending([arm]).startswith("the bending stiffness of actuators 1, 3 is assumed, -0.286 N·m²")
    assert note_on_bending([ta.bellows_arm()]) is None
    study = """
        name = "assumed"
        [[arm]]
        name = "ours"
        radii = [-0.05, 0.05]
        length = 0.4
        actuators = {{ kind = "file", path = "m.toml"{0} }}
        [[arm]]
        name = "wider"
        radii = [-0.06, 0.06]
        length = 0.4
        actuators = {{ kind = "file", path = "m.toml"{0} }}
        [[task]]
        name = "bend"
        shape = {{ kind = "constant", curvature = 0.3 }}
        """
    for more, told in (("", True), (", bending_stiffness = -0.2", False)):
        (tmp_path / "study.toml").write_text(study.format(more))
        monkeypatch.setattr(sys, "argv", ["torcharm", "evaluate", str(tmp_path / "study.toml")])
        with pytest.raises(SystemExit, match="0"):
            cli.main()
        said = capsys.readouterr().err
        assert ("torcharm: ours, wider: the bending stiffness of all actuators is assumed" in said) is told
