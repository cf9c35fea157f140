"""Bicubic splines against scipy's, between, at and beyond the grid; and as actuators of arms."""

import numpy as np
import pytest
import torch
from hypothesis import given, strategies as st
from scipy.interpolate import RectBivariateSpline

import torcharm as ta

STRAINS = np.array([-0.2, -0.05, 0.0, 0.2, 0.35, 0.7])
PRESSURES = np.array([0.0, 8.0, 20.0, 33.0, 50.0])


def surface(strain, pressure):
    return pressure * (1 - 0.4 * np.tanh(3 * strain)) - 15 * strain + 3 * np.sin(8 * strain)


def gridded(strains=STRAINS, pressures=PRESSURES, values=None, **options):
    values = surface(*np.meshgrid(strains, pressures, indexing="ij")) if values is None else values
    rows = tuple(map(tuple, values.tolist()))
    return ta.GriddedActuator(tuple(strains), tuple(pressures), rows, **{"max_pressure": 50.0, **options})


def tensor(value):
    return torch.as_tensor(value, dtype=torch.float64)


def test_it_goes_through_the_grids_points():
    force = gridded().force(tensor(STRAINS)[:, None], tensor(PRESSURES))
    torch.testing.assert_close(force.numpy(), surface(STRAINS[:, None], PRESSURES), rtol=0, atol=1e-12)


@given(st.floats(-0.2, 0.7), st.floats(0, 50))
def test_between_them_it_is_scipys_spline(strain, pressure):
    values = surface(*np.meshgrid(STRAINS, PRESSURES, indexing="ij"))
    expected = RectBivariateSpline(STRAINS, PRESSURES, values)(strain, pressure)[0, 0]
    assert gridded().force(tensor(strain), tensor(pressure)).item() == pytest.approx(expected, abs=1e-10)


def test_beyond_it_goes_on_straight():
    model = gridded()
    for strain, pressure, step in (((0.7, 0.8, 0.9), 20.0, 0), ((-0.4, -0.3, -0.2), 20.0, 0), (0.1, (50, 60, 70), 1)):
        force = model.force(tensor(strain), tensor(pressure))
        assert force.diff().diff().item() == pytest.approx(0.0, abs=1e-11), step
    # and without a kink at the edge
    edge = torch.tensor([0.7 - 1e-9, 0.7 + 1e-9], dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(model.force(edge, tensor(20.0)).sum(), edge)
    assert slope.diff().abs().item() < 1e-5


def test_it_is_twice_continuously_differentiable():
    model = gridded()
    strain, pressure = tensor([-0.1, 0.1, 0.5]).requires_grad_(), tensor([[5.0], [25.0]]).requires_grad_()
    assert torch.autograd.gradcheck(model.force, (strain, pressure))
    assert torch.autograd.gradgradcheck(model.force, (strain, pressure))
    across = tensor([0.2 - 1e-7, 0.2 + 1e-7]).requires_grad_()
    (slope,) = torch.autograd.grad(model.force(across, tensor(25.0)).sum(), across, create_graph=True)
    (bend,) = torch.autograd.grad(slope.sum(), across)
    assert bend.diff().abs().item() < 1e-3


@pytest.mark.parametrize(("strains", "pressures"), [(2, 2), (3, 2), (2, 5), (4, 3)])
def test_small_grids(strains, pressures):
    """Two points a side are bilinear, three a parabola, four a cubic: exact for such forces."""
    axes = np.linspace(-0.1, 0.5, strains), np.linspace(0, 40, pressures)

    def force(e, p):
        return (1 + e) ** (strains - 1) * (1 + 0.1 * p) ** min(pressures - 1, 3)

    model = gridded(*axes, force(*np.meshgrid(*axes, indexing="ij")))
    e, p = np.random.default_rng(0).uniform((-0.1, 0), (0.5, 40), (20, 2)).T
    np.testing.assert_allclose(model.force(tensor(e), tensor(p)).numpy(), force(e, p), rtol=1e-10)


def test_shapes_dtypes_and_scale():
    model = gridded()
    assert model.force(torch.zeros(3, 1), torch.zeros(4)).shape == (3, 4)
    assert model.force(torch.zeros(2), torch.zeros(())).dtype == torch.float32
    twice = gridded(force_scale=2.0)
    assert twice.force(tensor(0.1), tensor(9.0)).item() == pytest.approx(
        2 * model.force(tensor(0.1), tensor(9.0)).item()
    )
    assert (model.strain_range, model.pressure_range) == ((-0.2, 0.7), (0.0, 50.0))
    assert gridded() == model
    assert hash(gridded()) == hash(model)


def test_an_arm_of_gridded_cubics_is_the_arm_of_polynomials():
    strains, pressures = np.linspace(-0.5, 0.9, 6), np.linspace(0, 60, 5)
    grid = ta.Bellows().force(tensor(strains)[:, None], tensor(pressures)).numpy()
    model = gridded(strains, pressures, grid)
    task = ta.Task(ta.affine_curvature(-2.0, 2.0, length=0.5, nodes=6), ta.sample_loads(20))
    for options in ({}, {"hull": "edges", "samples": 3}):
        found, expected = (
            ta.evaluate(ta.ArmDesign([-0.05, 0.01, 0.05], 0.5, [m] * 3), task, ("absolute", "relative"), **options)
            for m in (model, ta.Bellows())
        )
        torch.testing.assert_close(found.absolute, expected.absolute, rtol=1e-7, atol=1e-7)
        torch.testing.assert_close(found.relative, expected.relative, rtol=1e-7, atol=1e-7)
        assert bool(found.converged.all())


def test_strains_beyond_the_grid_are_flagged():
    arm = ta.ArmDesign([-0.05, 0.05], 0.5, [gridded()] * 2)
    bent = ta.Task(ta.affine_curvature(0.0, 4.0, length=0.5, nodes=3), [0.0, 0.0, 0.0])
    assert not bool(ta.evaluate(arm, bent, ("absolute", "relative")).in_range)


def scattered(count=4000, noise=0.05):
    random = np.random.default_rng(4)
    strain, pressure = random.uniform(-0.2, 0.7, count), random.uniform(0, 50, count)
    return strain, pressure, surface(strain, pressure) + noise * random.normal(size=count)


def test_a_grid_is_fitted_to_scattered_samples_where_no_cubic_fits():
    strain, pressure, force = scattered()
    grid = np.linspace(-0.2, 0.7, 10), np.linspace(0, 50, 5)
    model = ta.fit_gridded_model(strain, pressure, force, *grid, smoothness=1e-8)
    off = model.force(tensor(strain), tensor(pressure)).numpy() - surface(strain, pressure)
    cubic = ta.fit_force_model(strain, pressure, force).force(tensor(strain), tensor(pressure)).numpy()
    assert np.sqrt((off**2).mean()) < 0.02
    assert np.sqrt(((cubic - surface(strain, pressure)) ** 2).mean()) > 0.5
    assert model.max_pressure == 50.0


def test_cells_without_samples_are_bridged():
    strain, pressure, force = scattered()
    kept = (strain < 0.1) | (strain > 0.45)
    model = ta.fit_gridded_model(
        strain[kept], pressure[kept], force[kept], np.linspace(-0.2, 0.7, 10), np.linspace(0, 50, 5)
    )
    off = model.force(tensor(strain), tensor(pressure)).numpy() - surface(strain, pressure)
    assert np.abs(off).max() < 5.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"strains": (0.1,)}, "strains: must be two or more finite numbers that increase"),
        ({"pressures": (0.0, 2.0, 1.0)}, "pressures: must be two or more finite numbers that increase"),
        ({"forces": ((1.0, 2.0),)}, r"forces: must be 2 rows \(strains\) of 2 \(pressures\), got 1 rows of 2"),
        ({"forces": ((1.0, 2.0), (1.0, float("nan")))}, "forces: must be finite"),
        ({"max_pressure": 0.0}, "max_pressure: must be finite and above 0"),
    ],
)
def test_bad_grids(change, message):
    fields = {"strains": (0.0, 1.0), "pressures": (0.0, 1.0), "forces": ((0.0, 1.0), (0.0, 1.0)), "max_pressure": 1.0}
    with pytest.raises(ValueError, match=f"^{message}"):
        ta.GriddedActuator(**{**fields, **change})


def test_bad_smoothness():
    with pytest.raises(ValueError, match=r"^smoothness: must be a finite number and above 0"):
        ta.fit_gridded_model([0.0, 0.5], [0.0, 1.0], [0.0, 1.0], [0.0, 1.0], [0.0, 1.0], smoothness=0.0)
    with pytest.raises(ValueError, match=r"^force: must not be 0 in every sample"):
        ta.fit_gridded_model([0.0], [0.0], [0.0], [0.0, 1.0], [0.0, 1.0])
