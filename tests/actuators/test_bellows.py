import numpy as np
import pytest
import torch

from torcharm import Bellows


def printed_formula(e, p):
    """The fit as printed in the paper, which counts a push as negative."""
    fit = 10.47 * e - 1.068 * p - 7.344 * e**2 + 0.5504 * e * p + 0.00205 * p**2
    fit += 19.39 * e**3 - 0.03461 * e**2 * p - 0.006294 * e * p**2 + 3.081e-5 * p**3
    return -fit


def grid(strains, pressures):
    strain = torch.linspace(*strains, 200, dtype=torch.float64)
    pressure = torch.linspace(*pressures, 300, dtype=torch.float64)
    return strain.unsqueeze(-1), pressure


def test_force_is_the_printed_formula():
    strain, pressure = grid((-0.3, 0.8), (0.0, 120.0))
    force = Bellows().force(strain, pressure)
    expected = printed_formula(strain.numpy(), pressure.numpy())
    np.testing.assert_allclose(force.numpy(), expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_force_at_a_point_worked_by_hand():
    # ε = 0.1, p = 10: -(1.047 - 10.68 - 0.07344 + 0.5504 + 0.205 + 0.01939 - 0.003461 - 0.06294 + 0.03081)
    force = Bellows().force(torch.tensor(0.1, dtype=torch.float64), torch.tensor(10.0, dtype=torch.float64))
    assert force.item() == pytest.approx(8.967241, rel=1e-12)


def test_an_unloaded_bellows_at_rest_exerts_nothing():
    assert Bellows().force(torch.zeros(1), torch.zeros(1)).item() == 0.0


def test_force_rises_with_pressure_up_to_50_kpa_at_every_characterised_strain():
    model = Bellows()
    force = model.force(*grid(model.strain_range, (0.0, 50.0)))
    assert bool((force.diff(dim=-1) > 0).all())


def test_force_is_not_monotonic_up_to_92_kpa():
    model = Bellows()
    force = model.force(*grid(model.strain_range, (50.0, 92.0)))
    assert bool((force.diff(dim=-1) < 0).any())


def test_published_ranges_and_limit():
    model = Bellows()
    assert model.strain_range == (-0.167, 0.668)
    assert model.pressure_range == (0.0, 92.0)
    assert model.max_pressure == 50.0
    assert model.bending_stiffness == pytest.approx(-1 / 3.5, rel=1e-15)


def test_force_is_differentiable_twice():
    strain = torch.tensor([-0.1, 0.0, 0.5], dtype=torch.float64, requires_grad=True)
    pressure = torch.tensor([0.0, 25.0, 50.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(Bellows().force, (strain, pressure))
    assert torch.autograd.gradgradcheck(Bellows().force, (strain, pressure))


def test_two_side_by_side_push_twice_as_hard():
    strain, pressure = grid((-0.1, 0.6), (0.0, 50.0))
    torch.testing.assert_close(
        Bellows(force_scale=2.0).force(strain, pressure), 2.0 * Bellows().force(strain, pressure)
    )


def test_a_bellows_is_hashable_and_equal_to_its_copies():
    assert Bellows() == Bellows()
    assert hash(Bellows()) == hash(Bellows())
    assert Bellows() != Bellows(force_scale=2.0)
