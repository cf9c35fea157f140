"""What pictures of force models hold: the model's own values, the samples, axes with units."""

import numpy as np
import pytest
import torch
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

import torcharm as ta
from torcharm.characterise.alignment import held_strains
from torcharm.plot import characterisation as pc

LEVELS = (-0.1, 0.2, 0.5)


def made_recording(noise=0.5):
    """Three holds joined by ramps, pressure swept in each."""
    random = np.random.default_rng(0)
    strain = np.concatenate([np.r_[np.full(400, level), np.linspace(level, level + 0.3, 60)] for level in LEVELS])
    pressure = np.tile(np.r_[80 * np.sin(np.linspace(0, np.pi, 400)) ** 2, np.zeros(60)], 3)
    force = ta.Bellows().force(torch.from_numpy(strain), torch.from_numpy(pressure)).numpy()
    force = force + noise * random.normal(size=len(force))
    return ta.Recording(strain, pressure, force, np.zeros(len(force), np.int64), ("made",))


def panel(model, recording, **labels):
    """Of the page on a model, the axes whose property of that name begins so."""
    ((name, start),) = labels.items()
    (axes,) = [
        one for one in pc.characterisation_figure(model, recording).axes if one.properties()[name].startswith(start)
    ]
    return axes


RECORDING = made_recording()
MODEL = ta.fit_recording(RECORDING)


def test_holds_are_found_and_ramps_are_not():
    holds = held_strains(RECORDING)
    assert [float(np.median(RECORDING.strain[hold])) for hold in holds] == pytest.approx(LEVELS)
    assert all(340 <= len(hold) <= 400 for hold in holds)
    assert all(np.ptp(RECORDING.strain[hold]) < 1e-3 for hold in holds)
    both = ta.pool([RECORDING, RECORDING])
    assert [len(hold) for hold in held_strains(both)] == [2 * len(hold) for hold in holds]


def test_lines_at_held_strains_are_the_models():
    ax = Figure().add_subplot()
    assert pc.force_at_held_strains(MODEL, RECORDING, ax=ax, max_pressure=60.0) is ax
    lines = [line for line in ax.lines if line.get_linestyle() == "-" and len(line.get_xdata()) == pc.POINTS]
    colours = {line.get_color() for line in lines} - {"white"}
    assert len(lines) == 6  # each on a white one
    assert len(colours) == 3
    for level, line in zip(LEVELS, lines[1::2], strict=True):
        pressure, force = line.get_data()
        expected = MODEL.force(torch.tensor(level, dtype=torch.float64), torch.from_numpy(pressure)).numpy()
        np.testing.assert_allclose(force, expected, atol=0.1)
        assert pressure[-1] == 60.0
    assert ax.get_xlabel().endswith("[kPa]")
    assert ax.get_ylabel().endswith("[N]")
    moving = np.linspace(0, 1, 100)
    with pytest.raises(ValueError, match=r"^recording: must hold the strain still"):
        pc.force_at_held_strains(MODEL, ta.Recording(moving, moving, moving, np.zeros(100, np.int64), ("x",)))


def test_residuals_are_recorded_less_model():
    off = ta.Recording(RECORDING.strain, RECORDING.pressure, RECORDING.force + 3.0, RECORDING.run, ("made",))
    ax = panel(MODEL, off, title="residuals")
    (mesh,) = ax.collections
    assert float(np.ma.median(mesh.get_array())) == pytest.approx(3.0, abs=0.3)
    low, high = mesh.get_clim()
    assert low == -high
    assert "RMSE 3." in ax.get_title()


def test_the_free_strain_is_where_the_force_is_zero():
    ax = panel(ta.Bellows(), RECORDING, ylabel="free strain")
    contour = next(c for c in ax.collections if len(c.get_paths()) and c.get_edgecolor().size)
    points = np.concatenate([path.vertices for path in contour.get_paths()])
    force = ta.Bellows().force(torch.from_numpy(points[:, 1].copy()), torch.from_numpy(points[:, 0].copy()))
    assert force.abs().max() < 0.05
    assert any("not monotonic" in text.get_text() for text in ax.get_legend().get_texts())
    pushes = ta.PolynomialActuator(((0, 0, 5.0), (0, 1, 1.0)), (0.0, 1.0), (0.0, 1.0), 1.0)
    ax = panel(pushes, RECORDING, ylabel="free strain")
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["force is never 0 in this range"]


def test_the_blocked_force_is_the_models_at_that_strain():
    shifted = ta.Recording(RECORDING.strain - 0.2, RECORDING.pressure, RECORDING.force, RECORDING.run, ("made",))
    model = ta.fit_recording(shifted)
    dots, line = panel(model, shifted, ylabel="blocked force").lines
    expected = model.force(torch.tensor(0.0, dtype=torch.float64), torch.from_numpy(line.get_xdata())).numpy()
    np.testing.assert_allclose(line.get_ydata(), expected, rtol=1e-12)
    assert len(dots.get_xdata()) >= 400


def test_surface_and_page_are_drawn_for_any_model(tmp_path):
    grid = ta.fit_gridded_model(
        RECORDING.strain, RECORDING.pressure, RECORDING.force, [-0.1, 0.2, 0.5, 0.8], [0.0, 40.0, 80.0]
    )
    for index, model in enumerate((MODEL, grid)):
        figure = pc.characterisation_figure(model, RECORDING)
        figure.savefig(tmp_path / f"{index}.png", dpi=20)
        kinds = [axes.name for axes in figure.axes if axes.get_label() != "<colorbar>"]
        assert sorted(kinds) == ["3d"] + ["rectilinear"] * 4
    assert f"R² {MODEL.quality.r_squared:.4f}" in pc.characterisation_figure(MODEL, RECORDING).get_suptitle()
    assert not plt.get_fignums()


def test_models_are_drawn_by_name_and_by_path(tmp_path):
    ta.save_actuator(tmp_path / "m.toml", "bellows")
    drawn = [pc.characterisation_figure(model, RECORDING) for model in (ta.Bellows(), "bellows", tmp_path / "m.toml")]
    assert len({len(axes.get_children()) for figure in drawn for axes in figure.axes[:1]}) == 1
    with pytest.raises(ValueError, match=r"^model: must be .*got 'belows'; did you mean bellows\?"):
        pc.characterisation_figure("belows", RECORDING)
