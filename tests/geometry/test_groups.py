"""One axiom suite for the rigid motions of the plane and of space."""

import math

import numpy as np
import pytest
import scipy.linalg
import torch

from torcharm.geometry import se2, se3

F64 = torch.float64
GROUPS = pytest.mark.parametrize("group", [se2, se3], ids=["plane", "space"])
TURNS = (0.0, 1e-300, 1e-160, 1e-12, 1e-8, 1e-4, 0.1, 1.0, 1.9999999, 2.0, 2.0000001, 3.0, math.pi, 2 * math.pi, 20.0)


def columns(group):
    return 3 if group is se2 else 6


def twists(group, count, turn=None, seed=0):
    """Random twists (count, 3 | 6): linear parts up to 1, and turns of the angle asked for, else up to 7."""
    generator = np.random.default_rng(seed)
    linear = generator.uniform(-1, 1, (count, group.DIMENSION))
    angles = generator.uniform(0, 7, (count, 1)) if turn is None else np.full((count, 1), turn)
    axis = generator.normal(size=(count, columns(group) - group.DIMENSION))
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    return torch.from_numpy(np.concatenate((linear, angles * axis), -1))


def hat(twist):
    """The matrix whose exponential the pose is, 3x3 or 4x4."""
    *linear, last = twist.tolist() if len(twist) == 3 else (*twist.tolist(), None)
    if last is not None:
        return np.array([[0, -last, linear[0]], [last, 0, linear[1]], [0, 0, 0]])
    x, y, z = linear[3:]
    return np.array([[0, -z, y, linear[0]], [z, 0, -x, linear[1]], [-y, x, 0, linear[2]], [0, 0, 0, 0]])


def matrix(pose):
    """The homogeneous matrix of one pose."""
    if pose.shape == (4, 4):
        return pose.numpy()
    x, y, angle = pose.tolist()
    return np.array([[math.cos(angle), -math.sin(angle), x], [math.sin(angle), math.cos(angle), y], [0, 0, 1]])


def assert_same_pose(found, expected, tolerance=2e-15):
    """Poses of the plane are compared up to whole turns."""
    difference = found - expected
    if found.shape[-2:] != (4, 4):
        angle = difference[..., 2]
        turned = angle - 2 * math.pi * (angle / (2 * math.pi)).round()
        difference = torch.cat((difference[..., :2], turned.unsqueeze(-1)), -1)
    assert difference.abs().max().item() <= tolerance


def close(found, expected, tolerance):
    torch.testing.assert_close(found, expected, rtol=0, atol=tolerance)


@GROUPS
@pytest.mark.parametrize("turn", TURNS)
def test_exp_is_the_matrix_exponential(group, turn):
    for twist in twists(group, 20, turn):
        expected = scipy.linalg.expm(hat(twist))
        np.testing.assert_allclose(matrix(group.exp(twist)), expected, rtol=0, atol=2e-15 * (3 + turn**2))


@GROUPS
@pytest.mark.parametrize("turn", [turn for turn in TURNS if turn < math.pi])
def test_log_undoes_exp(group, turn):
    every = twists(group, 200, turn)
    close(group.log(group.exp(every)), every, 5e-15)


@GROUPS
@pytest.mark.parametrize("short", [1e-3, 1e-6, 1e-9, 1e-12, 1e-15, 0.0])
def test_log_undoes_exp_up_to_half_a_turn(group, short):
    """At half a turn an axis and its opposite are one rotation: there the exponentials are compared."""
    every = twists(group, 200, math.pi - short)
    found = group.log(group.exp(every))
    if short >= 1e-12:
        close(found, every, 1e-14)
    assert_same_pose(group.exp(found), group.exp(every), 4e-15)
    assert torch.isfinite(found).all()


def test_log_of_half_turns_about_the_axes_and_the_diagonals():
    for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, 0, 0), (1, 1, 0), (1, 0, -1), (0, -1, 1), (1, 1, 1)):
        turn = math.pi * torch.tensor(axis, dtype=F64) / math.sqrt(sum(k * k for k in axis))
        pose = se3.exp(torch.cat((torch.tensor([0.3, -0.2, 0.5], dtype=F64), turn)))
        found = se3.log(pose)
        assert found[3:].norm().item() == pytest.approx(math.pi, abs=2e-15)
        close(se3.exp(found), pose, 2e-15)


@GROUPS
def test_exp_undoes_log_at_any_turn(group):
    every = group.exp(twists(group, 2000))
    found = group.log(every)
    assert_same_pose(group.exp(found), every, 4e-15)
    turn = found[..., group.DIMENSION :].norm(dim=-1)
    assert turn.max().item() <= math.pi + 1e-15


@GROUPS
@pytest.mark.parametrize("beyond", [-1e-3, -1e-9, 0.0, 1e-9, 1e-3])
def test_a_full_turn_is_no_turn(group, beyond):
    """Near a full turn the rotation is near the identity, and the logarithm the short way there."""
    every = twists(group, 100, 2 * math.pi + beyond)
    pose = group.exp(every)
    found = group.log(pose)
    axis = every[:, group.DIMENSION :] / (2 * math.pi + beyond)
    close(found[:, group.DIMENSION :], beyond * axis, 4e-15)
    assert_same_pose(group.exp(found), pose, 4e-15)


@GROUPS
def test_identity_is_neutral_and_is_exp_of_zero(group):
    pose = group.exp(twists(group, 10))
    one = group.identity(pose)
    assert torch.equal(group.compose(one, pose), pose)
    assert torch.equal(group.compose(pose, one), pose)
    assert torch.equal(group.exp(torch.zeros(columns(group), dtype=F64)), one)
    assert torch.equal(group.log(one), torch.zeros(columns(group), dtype=F64))


@GROUPS
def test_compose_is_associative_and_the_matrix_product(group):
    first, second, third = (group.exp(twists(group, 200, seed=seed)) for seed in range(3))
    left = group.compose(group.compose(first, second), third)
    assert_same_pose(left, group.compose(first, group.compose(second, third)), 8e-15)
    for one, other in zip(first, second, strict=True):
        expected = matrix(one) @ matrix(other)
        np.testing.assert_allclose(matrix(group.compose(one, other)), expected, rtol=0, atol=4e-15)


@GROUPS
def test_inverse_on_either_side_gives_the_identity(group):
    pose = group.exp(twists(group, 200))
    one = group.identity(pose).expand_as(pose)
    assert_same_pose(group.compose(pose, group.inverse(pose)), one)
    assert_same_pose(group.compose(group.inverse(pose), pose), one)
    every = twists(group, 200)
    assert_same_pose(group.inverse(group.exp(every)), group.exp(-every), 4e-15)


@GROUPS
def test_exponentials_along_one_twist_add(group):
    every = twists(group, 200)
    joined = group.compose(group.exp(0.3 * every), group.exp(0.7 * every))
    assert_same_pose(joined, group.exp(every), 8e-15)


@GROUPS
def test_adjoint_is_a_homomorphism(group):
    first, second = group.exp(twists(group, 200)), group.exp(twists(group, 200, seed=1))
    joined = group.adjoint(group.compose(first, second))
    close(joined, group.adjoint(first) @ group.adjoint(second), 2e-14)
    one = torch.eye(columns(group), dtype=F64).expand(200, -1, -1)
    close(group.adjoint(group.inverse(first)) @ group.adjoint(first), one, 1e-14)


@GROUPS
def test_adjoint_carries_a_twist_through_a_pose(group):
    pose, twist = group.exp(twists(group, 200)), twists(group, 200, seed=1)
    conjugate = group.compose(group.compose(pose, group.exp(twist)), group.inverse(pose))
    carried = (group.adjoint(pose) @ twist.unsqueeze(-1)).squeeze(-1)
    assert_same_pose(conjugate, group.exp(carried), 5e-14)


@GROUPS
def test_carry_is_the_transposed_inverse_adjoint(group):
    """A wrench does the same work wherever it is felt."""
    pose, wrench, twist = group.exp(twists(group, 200)), twists(group, 200, seed=1), twists(group, 200, seed=2)
    felt = group.carry(pose, wrench)
    close(felt, (group.adjoint(group.inverse(pose)).mT @ wrench.unsqueeze(-1)).squeeze(-1), 2e-14)
    carried = (group.adjoint(pose) @ twist.unsqueeze(-1)).squeeze(-1)
    close((felt * carried).sum(-1), (wrench * twist).sum(-1), 1e-13)


@GROUPS
def test_points_and_vectors_move_as_matrices_move_them(group):
    pose, point = group.exp(twists(group, 50)), twists(group, 50, seed=1)[:, : group.DIMENSION]
    for one, at, acted, turned, back in zip(
        pose, point, group.act(pose, point), group.rotate(pose, point), group.rotate_back(pose, point), strict=True
    ):
        whole, place = matrix(one), at.numpy()
        np.testing.assert_allclose(acted, (whole @ [*place, 1.0])[:-1], rtol=0, atol=2e-15)
        np.testing.assert_allclose(turned, whole[:-1, :-1] @ place, rtol=0, atol=2e-15)
        np.testing.assert_allclose(back, whole[:-1, :-1].T @ place, rtol=0, atol=2e-15)
        np.testing.assert_allclose(group.position(one), whole[:-1, -1], rtol=0, atol=0)


@GROUPS
@pytest.mark.parametrize("turn", TURNS[:-1])
def test_the_centroid_is_the_mean_position_along_the_path(group, turn):
    """Gauss-Legendre over the path; 40 points integrate these to rounding."""
    node, weight = np.polynomial.legendre.leggauss(40)
    node, weight = torch.from_numpy((node + 1) / 2), torch.from_numpy(weight / 2)
    for twist in twists(group, 5, turn):
        path = group.position(group.exp(node.unsqueeze(-1) * twist))
        close(group.centroid(twist), weight @ path, 2e-15)


@GROUPS
@pytest.mark.parametrize("turn", [0.0, 1e-9, 0.5, 1.9999999, 2.0000001, 3.0, 2 * math.pi])
def test_exp_and_centroid_are_differentiable_twice(group, turn):
    every = twists(group, 2, turn).requires_grad_()
    for function in (group.exp, group.centroid):
        assert torch.autograd.gradcheck(function, every, atol=1e-7, rtol=1e-6)
        assert torch.autograd.gradgradcheck(function, every, atol=1e-7, rtol=1e-6)


@GROUPS
@pytest.mark.parametrize("turn", [0.0, 1e-9, 0.5, 2.0, 3.0, 3.14])
def test_log_is_differentiable_twice(group, turn):
    """By way of exp: a perturbed matrix is no pose."""
    every = twists(group, 2, turn).requires_grad_()
    shift = group.exp(0.001 * twists(group, 1, 0.5, seed=3))[0]

    def both(twist):
        return group.log(group.compose(group.exp(twist), shift))

    assert torch.autograd.gradcheck(both, every, atol=1e-7, rtol=1e-6)
    assert torch.autograd.gradgradcheck(both, every, atol=1e-7, rtol=1e-6)


@GROUPS
@pytest.mark.parametrize("turn", [0.0, 1e-200, 1e-9, 1e-3, 1.0, 3.0])
def test_log_has_the_inverse_jacobian_of_exp(group, turn):
    twist = twists(group, 1, turn, seed=4)[0]
    jacobian = torch.autograd.functional.jacobian(lambda k: group.log(group.exp(k)), twist)
    close(jacobian, torch.eye(columns(group), dtype=F64), 1e-13)


@GROUPS
@pytest.mark.parametrize("turn", TURNS)
def test_the_derivative_of_exp_is_that_of_the_matrix_exponential(group, turn):
    """scipy's Fréchet derivative of the matrix exponential is the oracle, in every direction, zero turn included."""
    twist = twists(group, 1, turn, seed=5)[0]
    jacobian = torch.autograd.functional.jacobian(group.exp, twist)
    for index, direction in enumerate(torch.eye(columns(group), dtype=F64)):
        expected = scipy.linalg.expm_frechet(hat(twist), hat(direction), compute_expm=False)
        found = jacobian[..., index].numpy() if group is se3 else jacobian[:2, index].numpy()
        wanted = expected if group is se3 else expected[:2, 2]
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-14 * (1 + turn**2))


@GROUPS
@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_dtype_is_kept_and_is_accurate_to_its_rounding(group, dtype):
    every = torch.cat([twists(group, 4, turn) for turn in TURNS[:-2]])
    own = every.to(dtype)
    pose = group.exp(own)
    results = [pose, group.log(pose), group.inverse(pose), group.compose(pose, pose), group.adjoint(pose)]
    results += [group.centroid(own), group.carry(pose, own), group.identity(own)]
    assert all(result.dtype == dtype for result in results)
    assert (pose - group.exp(own.double())).abs().max().item() <= 4 * torch.finfo(dtype).eps


@GROUPS
def test_leading_dimensions_broadcast(group):
    first = group.exp(twists(group, 6)).unflatten(0, (3, 2)).unsqueeze(1)
    second = group.exp(twists(group, 4, seed=1)).unsqueeze(1)
    composed = group.compose(first, second)
    assert composed.shape == (3, 4, 2, *group.POSE_SHAPE)
    close(composed[1, 2, 0], group.compose(first[1, 0, 0], second[2, 0]), 4e-16)
    wrench = twists(group, 3)[:, None, None]
    assert group.carry(second, wrench).shape == (3, 4, 1, columns(group))
    assert group.act(second, wrench[..., : group.DIMENSION]).shape == (3, 4, 1, group.DIMENSION)


@pytest.mark.parametrize("turn", TURNS)
def test_the_plane_is_the_plane_z_0_of_space(turn):
    every, pose = twists(se2, 50, turn), se2.exp(twists(se2, 50, seed=1))
    wide, wide_pose = se3.vector_from_plane(every), se3.from_plane(pose)
    close(se3.exp(wide), se3.from_plane(se2.exp(every)), 2e-15)
    close(se3.compose(wide_pose, se3.exp(wide)), se3.from_plane(se2.compose(pose, se2.exp(every))), 4e-15)
    close(se3.inverse(wide_pose), se3.from_plane(se2.inverse(pose)), 0)
    close(se3.adjoint(wide_pose)[:, [0, 1, 5]][:, :, [0, 1, 5]], se2.adjoint(pose), 0)
    close(se3.carry(wide_pose, wide), se3.vector_from_plane(se2.carry(pose, every)), 1e-14)
    close(se3.centroid(wide)[:, :2], se2.centroid(every), 2e-15)
    assert (se3.centroid(wide)[:, 2] == 0).all()
    if turn < math.pi:
        close(se3.log(se3.exp(wide)), se3.vector_from_plane(se2.log(se2.exp(every))), 1e-14)
