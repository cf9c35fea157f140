import math

import numpy as np
import pytest
import torch

from torcharm import McKibben

A1, A2 = 1.038555666, 0.511454549
B1, B2, B3 = 1.963398204, -3.169979385, 4.231857967
STRAIN_LIM, STRAIN_CRIT = -0.274484489, -0.303225592


def passive_extension(e):
    return 89998.04265 * e**3 + 836.5810641 * e**2 + 62.59606786 * e


def passive_compression(e):
    return 265.2968218 * e**4 + 320.5906703 * e**3 + 126.11975 * e**2 + 21.92761236 * e


def threshold(e):
    return 34610.2847 * e**4 + 5991.799518 * e**3 - 1032.874471 * e**2 - 395.9792747 * e


def recovery(e):
    return 0.637225654 * (0.453137516 + e) ** 2


ONSET = passive_compression(STRAIN_LIM) / recovery(STRAIN_LIM) + threshold(STRAIN_LIM)


def published_force(e, p):
    """The published piecewise model, branch by branch, for one strain and one pressure."""
    if e >= 0:
        pull = passive_extension(e) + B1 * (math.sqrt(A1 * A2**2 / B1) + B2 * e) ** 2 * p ** (1 + B3 * e)
    elif p >= threshold(e):
        pull = A1 * (A2 + e) ** 2 * (p - threshold(e))
    elif e >= STRAIN_LIM:
        c = passive_compression(e)
        pull = c + max(0.0, recovery(e) * (p - threshold(e)) - c)
    else:
        k = recovery(STRAIN_LIM) / (STRAIN_LIM - STRAIN_CRIT) ** 2 if e >= STRAIN_CRIT else -3.695687763
        pull = passive_compression(e) + k * (e - STRAIN_CRIT) ** 2 * max(0.0, p - ONSET)
    return -pull


def force(strain, pressure, **changes):
    return McKibben(**changes).force(*(torch.as_tensor(v, dtype=torch.float64) for v in (strain, pressure)))


def gradient(strain, pressure):
    inputs = [torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in (strain, pressure)]
    return [part.item() for part in torch.autograd.grad(McKibben().force(*inputs), inputs)]


def hessian(strain, pressure):
    point = torch.tensor([strain, pressure], dtype=torch.float64)
    return torch.autograd.functional.hessian(lambda v: McKibben().force(v[0], v[1]), point)


KINK_STRAINS = [0.0, -0.0, STRAIN_LIM, STRAIN_CRIT]
STRAINS = np.unique(np.concatenate([np.linspace(-0.5, 0.3, 401), KINK_STRAINS]))
PRESSURES = np.unique(np.concatenate([np.linspace(0.0, 150.0, 301), [1e-12, 1e-3, ONSET]]))


def test_force_is_the_published_model_on_a_dense_grid():
    expected = np.array([[published_force(e, p) for p in PRESSURES] for e in STRAINS])
    found = force(STRAINS[:, None], PRESSURES).numpy()
    # Rounding is relative to the terms of a row: the cubic of extension spans kilonewtons.
    scale = 1.0 + np.abs(expected).max(axis=1, keepdims=True)
    assert (np.abs(found - expected) / scale).max() < 1e-12


def test_force_is_the_published_model_close_to_every_border():
    for e in [*KINK_STRAINS, -0.05, -0.1, -0.2, -0.26]:
        for p in (threshold(e), ONSET, threshold(e) + passive_compression(e) / recovery(e), 0.0):
            for e_side, p_side in ((e * (1 - 1e-9), p), (e * (1 + 1e-9), p), (e, p * (1 - 1e-9)), (e, p * (1 + 1e-9))):
                p_side = abs(p_side)
                assert force(e_side, p_side).item() == pytest.approx(
                    published_force(e_side, p_side), rel=1e-12, abs=1e-11
                )


@pytest.mark.parametrize("strain", KINK_STRAINS)
def test_force_is_continuous_across_the_borders_in_strain(strain):
    pressure = np.linspace(0.0, 100.0, 101)
    step = 1e-12
    jump = force(strain + step, pressure) - force(strain - step, pressure)
    assert jump.abs().max().item() < 1e-8  # slopes reach a few hundred newtons


@pytest.mark.parametrize("strain", np.linspace(-0.27, -0.001, 40))
def test_force_is_continuous_across_the_threshold_pressure(strain):
    z = threshold(strain)
    assert z > 0
    assert force(strain, z * (1 + 1e-13)).item() == pytest.approx(force(strain, z * (1 - 1e-13)).item(), abs=1e-10)
    assert force(strain, z).item() == pytest.approx(0.0, abs=1e-10)


@pytest.mark.parametrize("strain", [-0.5, -0.4, -0.31, STRAIN_CRIT, -0.29, -0.28])
def test_force_is_continuous_across_the_onset_of_recovery(strain):
    assert force(strain, ONSET + 1e-10).item() == pytest.approx(force(strain, ONSET - 1e-10).item(), abs=1e-8)


def test_the_threshold_of_strongly_contracted_muscles_is_out_of_the_pressure_range():
    """Only beyond it would the published branches part: the collapse has no border in range."""
    strain = np.linspace(-0.5, STRAIN_LIM, 200)
    assert threshold(strain).min() > McKibben().pressure_range[1]


def test_gradients_are_finite_everywhere():
    strain = torch.tensor(STRAINS).unsqueeze(-1).requires_grad_()
    pressure = torch.tensor(PRESSURES).requires_grad_()
    for part in torch.autograd.grad(McKibben().force(strain, pressure).sum(), (strain, pressure)):
        assert bool(part.isfinite().all())


KINKS = [(e, p) for e in KINK_STRAINS for p in (0.0, 50.0, 100.0, threshold(e), ONSET)] + [
    (-0.1, threshold(-0.1)),
    (-0.1, threshold(-0.1) + passive_compression(-0.1) / recovery(-0.1)),
    (-0.29, ONSET),
    (-0.4, ONSET),
    (0.03, 0.0),
    (0.2, 0.0),
    (-0.1, 0.0),
    (-0.45, 0.0),
]


@pytest.mark.parametrize(("strain", "pressure"), KINKS)
def test_first_and_second_derivatives_are_finite_and_symmetric_at_kinks(strain, pressure):
    assert all(math.isfinite(part) for part in gradient(strain, pressure))
    second = hessian(strain, pressure)
    assert bool(second.isfinite().all())
    torch.testing.assert_close(second, second.T, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("pressure", [0.0, 1.0, 50.0, 100.0])
def test_at_rest_length_the_strain_gradient_is_that_of_extension(pressure):
    """A straight arm at its neutral length sits on this kink: the gradient must not be a mixture."""
    slope = 62.59606786 + 2 * B1 * math.sqrt(A1 * A2**2 / B1) * B2 * pressure
    slope += A1 * A2**2 * B3 * pressure * (math.log(pressure) if pressure else 0.0)
    assert gradient(0.0, pressure)[0] == pytest.approx(-slope, rel=1e-12)


def test_at_rest_length_the_pressure_gradient_is_the_pull_per_pressure():
    for pressure in (0.0, 1.0, 100.0):
        assert gradient(0.0, pressure)[1] == pytest.approx(-A1 * A2**2, rel=1e-12)


@pytest.mark.parametrize("strain", [-0.05, -0.1, -0.2])
def test_at_the_threshold_the_gradient_is_that_of_one_side(strain):
    """Among neighbouring floats one is the threshold as the model rounds it; its gradient must not vanish."""
    z = threshold(strain)
    pressures = [z + n * math.ulp(z) for n in range(-20, 21)]
    below, above = -recovery(strain), -A1 * (A2 + strain) ** 2
    slopes = [gradient(strain, pressure)[1] for pressure in pressures]
    assert slopes[0] == pytest.approx(below, rel=1e-12)
    assert slopes[-1] == pytest.approx(above, rel=1e-12)
    assert all(slope == pytest.approx(below, rel=1e-12) or slope == pytest.approx(above, rel=1e-12) for slope in slopes)


@pytest.mark.parametrize("strain", [-0.48, -0.35, -0.306, -0.3, -0.28, -0.26, -0.15, -0.05, -1e-3, 1e-3, 0.03, 0.2])
@pytest.mark.parametrize("pressure", [0.5, 7.0, 33.0, 62.0, 99.0, 140.0])
def test_gradients_are_right_between_the_kinks(strain, pressure):
    step_e, step_p = 1e-6, 1e-4
    by_strain = (published_force(strain + step_e, pressure) - published_force(strain - step_e, pressure)) / (2 * step_e)
    by_pressure = (published_force(strain, pressure + step_p) - published_force(strain, pressure - step_p)) / (
        2 * step_p
    )
    assert gradient(strain, pressure) == pytest.approx([by_strain, by_pressure], rel=1e-6, abs=1e-6)


def test_second_derivatives_are_right_between_the_kinks():
    strain = torch.tensor([-0.45, -0.29, -0.15, -0.05, 0.02, 0.04], dtype=torch.float64, requires_grad=True)
    pressure = torch.tensor([[20.0], [90.0]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(McKibben().force, (strain, pressure))
    assert torch.autograd.gradgradcheck(McKibben().force, (strain, pressure))


def test_pull_grows_with_pressure_above_the_critical_strain():
    strain = np.linspace(STRAIN_CRIT, 0.05, 300)[:, None]
    steps = force(strain, np.linspace(0.0, 100.0, 401)).diff(dim=-1)
    assert steps.max().item() <= 1e-12


def test_pull_falls_with_pressure_somewhere_below_the_critical_strain():
    strain = np.linspace(-0.5, STRAIN_CRIT - 1e-3, 50)[:, None]
    steps = force(strain, np.linspace(0.0, 100.0, 101)).diff(dim=-1)
    assert bool((steps.amax(-1) > 1e-6).all())


def test_a_pressurised_muscle_pulls_from_its_threshold_on():
    strain = np.linspace(-0.27, -1e-6, 200)[:, None]
    pressure = threshold(strain) + np.linspace(1e-6, 100.0, 50)
    assert bool((force(strain, pressure) < 0).all())
    assert bool((force(np.linspace(0.0, 0.05, 30)[:, None], np.linspace(1e-6, 100.0, 50)) < 0).all())


def test_a_compressed_muscle_without_pressure_pushes_back_and_a_stretched_one_pulls():
    assert bool((force(np.linspace(-0.27, -1e-6, 100), 0.0) > 0).all())
    assert bool((force(np.linspace(1e-6, 0.05, 100), 0.0) < 0).all())
    assert force(0.0, 0.0).item() == 0.0


@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_force_scale_multiplies_the_force(scale):
    strain, pressure = np.linspace(-0.4, 0.05, 20)[:, None], np.linspace(0, 100, 30)
    torch.testing.assert_close(force(strain, pressure, force_scale=scale), scale * force(strain, pressure))


@pytest.mark.parametrize(
    ("strain", "pressure"), [((), ()), ((3, 1), (4,)), ((4,), (3, 1)), ((0, 2), ()), ((2,), ())], ids=str
)
def test_strain_and_pressure_broadcast(strain, pressure):
    result = McKibben().force(torch.full(strain, -0.1), torch.full(pressure, 50.0))
    assert result.shape == torch.broadcast_shapes(strain, pressure)
    assert result.allclose(McKibben().force(torch.tensor(-0.1), torch.tensor(50.0)))


def test_float32_is_kept_and_finite():
    strain = torch.tensor(STRAINS, dtype=torch.float32).unsqueeze(-1).requires_grad_()
    pressure = torch.tensor(PRESSURES, dtype=torch.float32).requires_grad_()
    result = McKibben().force(strain, pressure)
    assert result.dtype == torch.float32
    expected = McKibben().force(strain.detach().double(), pressure.detach().double())
    scale = 1 + expected.abs().amax(1, keepdim=True)
    assert ((result - expected).abs() / scale).max().item() < 1e-5
    for part in torch.autograd.grad(result.sum(), (strain, pressure)):
        assert bool(part.isfinite().all())


@pytest.mark.parametrize(("strain", "pressure"), [(math.nan, 50.0), (-0.1, math.nan), (0.02, math.nan)])
def test_a_nan_stays_a_nan(strain, pressure):
    assert force(strain, pressure).isnan().item()


def test_published_ranges_and_limit():
    model = McKibben()
    assert model.strain_range == (-0.5, 0.05)
    assert model.pressure_range == (0.0, 100.0)
    assert model.max_pressure == 100.0
    assert model.bending_stiffness == pytest.approx(-1 / 3.5, rel=1e-15)


def test_a_muscle_is_hashable_and_equal_to_its_copies():
    assert McKibben() == McKibben()
    assert hash(McKibben()) == hash(McKibben())
    assert McKibben() != McKibben(force_scale=2.0)
