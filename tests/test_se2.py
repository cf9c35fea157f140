import math

import mpmath
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from torcharm import se2

mpmath.mp.dps = 40

ANGLES = [0.0]
ANGLES += [sign * size for size in (1e-12, 1e-6, 1e-3, 0.999999, 1.0, 1.000001, 20.0) for sign in (1, -1)]

coordinate = st.floats(-3.0, 3.0)
vectors = st.tuples(coordinate, coordinate, st.floats(-7.0, 7.0)).map(lambda v: torch.tensor(v, dtype=torch.float64))
twists_within_half_a_turn = st.tuples(coordinate, coordinate, st.floats(-3.1, 3.1)).map(
    lambda v: torch.tensor(v, dtype=torch.float64)
)


def twist_matrix(twist):
    length, shear, turn = np.asarray(twist, dtype=float)
    return np.array([[0.0, -turn, length], [turn, 0.0, shear], [0.0, 0.0, 0.0]])


def pose_matrix(pose):
    x, y, angle = pose.tolist()
    return np.array([[math.cos(angle), -math.sin(angle), x], [math.sin(angle), math.cos(angle), y], [0.0, 0.0, 1.0]])


def assert_close(actual, expected, tolerance=1e-12):
    torch.testing.assert_close(actual, expected, rtol=tolerance, atol=tolerance)


@given(twist=twists_within_half_a_turn)
def test_log_undoes_exp(twist):
    assert_close(se2.log(se2.exp(twist)), twist)


@given(pose=vectors)
def test_exp_undoes_log_up_to_whole_turns(pose):
    again = se2.exp(se2.log(pose))
    assert_close(again[:2], pose[:2])
    turns = (again[2] - pose[2]) / (2 * math.pi)
    assert_close(turns, turns.round())
    assert abs(se2.log(pose)[2].item()) <= math.pi + 1e-12


@given(first=vectors, second=vectors, third=vectors)
def test_compose_is_associative(first, second, third):
    left = se2.compose(se2.compose(first, second), third)
    right = se2.compose(first, se2.compose(second, third))
    assert_close(left, right)


@given(pose=vectors)
def test_inverse_on_either_side_gives_the_identity(pose):
    identity = torch.zeros(3, dtype=torch.float64)
    assert_close(se2.compose(pose, se2.inverse(pose)), identity)
    assert_close(se2.compose(se2.inverse(pose), pose), identity)


@given(pose=vectors)
def test_the_zero_pose_is_neutral(pose):
    identity = torch.zeros(3, dtype=torch.float64)
    assert torch.equal(se2.compose(identity, pose), pose)
    assert_close(se2.compose(pose, identity), pose)


@given(first=vectors, second=vectors)
def test_compose_is_the_matrix_product(first, second):
    product = pose_matrix(first) @ pose_matrix(second)
    np.testing.assert_allclose(pose_matrix(se2.compose(first, second)), product, rtol=0, atol=1e-13)


@given(pose=vectors, twist=vectors)
def test_adjoint_carries_a_twist_through_a_pose(pose, twist):
    conjugate = se2.compose(se2.compose(pose, se2.exp(twist)), se2.inverse(pose))
    assert_close(conjugate, se2.exp(se2.adjoint(pose) @ twist))


@given(first=vectors, second=vectors)
def test_adjoint_of_a_composite_is_the_product(first, second):
    assert_close(se2.adjoint(se2.compose(first, second)), se2.adjoint(first) @ se2.adjoint(second))


@given(pose=vectors)
def test_adjoint_of_the_inverse_is_the_inverse(pose):
    assert_close(se2.adjoint(se2.inverse(pose)) @ se2.adjoint(pose), torch.eye(3, dtype=torch.float64))


@given(twist=vectors)
def test_exp_is_the_matrix_exponential(twist):
    np.testing.assert_allclose(pose_matrix(se2.exp(twist)), expm(twist_matrix(twist)), rtol=0, atol=1e-12)


@given(twist=vectors, parts=st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)))
def test_exponentials_along_one_twist_add(twist, parts):
    first, second = parts
    joined = se2.compose(se2.exp(first * twist), se2.exp(second * twist))
    assert_close(joined, se2.exp((first + second) * twist))


@given(angle=st.floats(-7.0, 7.0), x=coordinate, y=coordinate)
def test_rotate_is_multiplication_by_a_unit_complex_number(angle, x, y):
    turned = se2.rotate(torch.tensor(angle, dtype=torch.float64), torch.tensor([x, y], dtype=torch.float64))
    expected = complex(x, y) * complex(math.cos(angle), math.sin(angle))
    assert_close(turned, torch.tensor([expected.real, expected.imag], dtype=torch.float64))


def test_rotate_by_a_quarter_turn_is_counter_clockwise():
    turned = se2.rotate(torch.tensor(math.pi / 2, dtype=torch.float64), torch.tensor([1.0, 0.0], dtype=torch.float64))
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


@pytest.mark.parametrize("turn", [0.0, 1e-9, 0.5, 3.0])
def test_log_has_the_inverse_jacobian_of_exp(turn):
    twist = torch.tensor([0.7, -0.4, turn], dtype=torch.float64)
    forward = torch.autograd.functional.jacobian(se2.exp, twist)
    backward = torch.autograd.functional.jacobian(se2.log, se2.exp(twist))
    assert_close(backward @ forward, torch.eye(3, dtype=torch.float64))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_dtype_is_kept(dtype):
    twist = torch.tensor([[0.5, 0.1, 0.0], [0.5, 0.1, 2.0]], dtype=dtype)
    for result in (
        se2.exp(twist),
        se2.log(twist),
        se2.inverse(twist),
        se2.compose(twist, twist),
        se2.adjoint(twist),
        se2.rotate(twist[..., 2], twist[..., :2]),
    ):
        assert result.dtype == dtype


def test_float32_is_accurate_to_its_own_rounding():
    twist = torch.tensor([[0.5, 0.1, angle] for angle in ANGLES], dtype=torch.float32)
    torch.testing.assert_close(se2.exp(twist), se2.exp(twist.double()).float(), rtol=0, atol=2e-7)


def test_functions_batch_over_leading_dimensions():
    generator = torch.Generator().manual_seed(0)
    first = torch.rand(2, 1, 3, 3, dtype=torch.float64, generator=generator)
    second = torch.rand(4, 1, 3, dtype=torch.float64, generator=generator)
    composed = se2.compose(first, second)
    assert composed.shape == (2, 4, 3, 3)
    assert_close(composed[1, 2, 0], se2.compose(first[1, 0, 0], second[2, 0]))
    assert se2.adjoint(first).shape == (2, 1, 3, 3, 3)
    assert_close(se2.exp(first)[1, 0, 2], se2.exp(first[1, 0, 2]))
