"""What only SE(2) has: ratios exact to rounding with their derivatives, and turns that are remembered."""

import math

import mpmath
import pytest
import torch
from hypothesis import given, strategies as st

from torcharm.geometry import se2

mpmath.mp.dps = 40

ANGLES = [0.0]
ANGLES += [sign * size for size in (1e-12, 1e-6, 1e-3, 0.999999, 1.0, 1.000001, 20.0) for sign in (1, -1)]

coordinate = st.floats(-3.0, 3.0)


def assert_close(actual, expected, tolerance=1e-12):
    torch.testing.assert_close(actual, expected, rtol=tolerance, atol=tolerance)


@given(angle=st.floats(-7.0, 7.0), x=coordinate, y=coordinate)
def test_rotate_is_multiplication_by_a_unit_complex_number(angle, x, y):
    turned = se2.turned(torch.tensor(angle, dtype=torch.float64), torch.tensor([x, y], dtype=torch.float64))
    expected = complex(x, y) * complex(math.cos(angle), math.sin(angle))
    assert_close(turned, torch.tensor([expected.real, expected.imag], dtype=torch.float64))


def test_rotate_by_a_quarter_turn_is_counter_clockwise():
    turned = se2.turned(torch.tensor(math.pi / 2, dtype=torch.float64), torch.tensor([1.0, 0.0], dtype=torch.float64))
    assert_close(turned, torch.tensor([0.0, 1.0], dtype=torch.float64))


def test_a_pose_remembers_its_turns():
    turn = torch.tensor([0.0, 0.0, 5.0], dtype=torch.float64)
    assert se2.compose(turn, turn)[2].item() == 10.0
    assert se2.exp(torch.tensor([1.0, 0.0, 20.0], dtype=torch.float64))[2].item() == 20.0


@pytest.mark.parametrize("turns", [1, -2, 3])
def test_log_sees_poses_up_to_whole_turns(turns):
    pose = torch.tensor([0.3, -0.2, 0.7], dtype=torch.float64)
    turned = pose + torch.tensor([0.0, 0.0, 2 * math.pi * turns], dtype=torch.float64)
    assert_close(se2.log(turned), se2.log(pose))


def derivatives(function, angle, order):
    """Value and derivatives up to `order` of a function of one angle, by autograd."""
    x = torch.tensor(angle, dtype=torch.float64, requires_grad=True)
    value = function(x)
    found = [value.item()]
    for _ in range(order):
        (value,) = torch.autograd.grad(value, x, create_graph=True)
        found.append(value.item())
    return found


def exact_sine_ratio(x, order):
    """d^n/dx^n sin(x)/x = ∫_0^1 t^n cos(x t + n π/2) dt."""
    return mpmath.quad(lambda t: t**order * mpmath.cos(mpmath.mpf(x) * t + order * mpmath.pi / 2), [0, 0.5, 1])


def exact_cosine_ratio(x, order):
    """d^n/dx^n (1 - cos x)/x = ∫_0^1 t^n sin(x t + n π/2) dt."""
    return mpmath.quad(lambda t: t**order * mpmath.sin(mpmath.mpf(x) * t + order * mpmath.pi / 2), [0, 0.5, 1])


@pytest.mark.parametrize("order", [0, 1, 2], ids=["value", "first derivative", "second derivative"])
@pytest.mark.parametrize("angle", ANGLES)
def test_sine_ratio_is_exact(angle, order):
    exact = float(exact_sine_ratio(angle, order))
    assert derivatives(se2.sine_ratio, angle, order)[order] == pytest.approx(exact, rel=1e-14, abs=1e-15)


@pytest.mark.parametrize("order", [0, 1, 2], ids=["value", "first derivative", "second derivative"])
@pytest.mark.parametrize("angle", ANGLES)
def test_cosine_ratio_is_exact(angle, order):
    exact = float(exact_cosine_ratio(angle, order))
    assert derivatives(se2.cosine_ratio, angle, order)[order] == pytest.approx(exact, rel=1e-14, abs=1e-15)


@pytest.mark.parametrize("angle", [1e-12, 1e-9, -1e-6])
def test_cosine_ratio_keeps_its_digits_near_zero(angle):
    value = se2.cosine_ratio(torch.tensor(angle, dtype=torch.float64)).item()
    assert value == pytest.approx(float(exact_cosine_ratio(angle, 0)), rel=1e-15, abs=0)


@pytest.mark.parametrize("order", [0, 1, 2], ids=["value", "first derivative", "second derivative"])
@pytest.mark.parametrize("turn", ANGLES)
def test_exp_and_its_derivatives_in_curvature_are_exact(turn, order):
    length, shear = 0.7, -0.4

    def position(component):
        return lambda x: se2.exp(torch.stack((x.new_tensor(length), x.new_tensor(shear), x)))[component]

    along, across = exact_sine_ratio(turn, order), exact_cosine_ratio(turn, order)
    exact = along * length - across * shear, across * length + along * shear
    for component in (0, 1):
        found = derivatives(position(component), turn, order)[order]
        assert found == pytest.approx(float(exact[component]), rel=1e-14, abs=1e-15)


@pytest.mark.parametrize("turn", ANGLES)
def test_exp_is_linear_in_length_and_shear(turn):
    twist = torch.tensor([0.7, -0.4, turn], dtype=torch.float64)
    jacobian = torch.autograd.functional.jacobian(se2.exp, twist)
    along, across = float(exact_sine_ratio(turn, 0)), float(exact_cosine_ratio(turn, 0))
    expected = torch.tensor([[along, -across], [across, along], [0.0, 0.0]], dtype=torch.float64)
    assert_close(jacobian[:, :2], expected, 1e-14)


def test_float32_is_accurate_to_its_own_rounding():
    twist = torch.tensor([[0.5, 0.1, angle] for angle in ANGLES], dtype=torch.float32)
    torch.testing.assert_close(se2.exp(twist), se2.exp(twist.double()).float(), rtol=0, atol=2e-7)
