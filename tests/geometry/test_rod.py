import math

import numpy as np
import pytest
import torch
from hypothesis import given, strategies as st
from scipy.linalg import expm

import torcharm as ta
from torcharm.geometry import rod, se2, se3


def random_twists(*shape, seed=0):
    """Shapes of about half a metre with shear, turning up to a few radians."""
    generator = np.random.default_rng(seed)
    scale = np.array([0.4, 0.2, 12.0])
    twists = scale * (generator.random((*shape, 3)) - 0.5) + np.array([0.5, 0.0, 0.0])
    return torch.from_numpy(twists)


def poses_one_by_one(twists, base):
    """Node after node with scipy's matrix exponential; headings are added so that turns are kept."""
    x, y, heading = base
    pose = np.array([[np.cos(heading), -np.sin(heading), x], [np.sin(heading), np.cos(heading), y], [0, 0, 1]])
    found = [[x, y, heading]]
    for length, shear, turn in twists / len(twists):
        pose = pose @ expm(np.array([[0, -turn, length], [turn, 0, shear], [0, 0, 0]]))
        heading += turn
        found.append([pose[0, 2], pose[1, 2], heading])
    return np.array(found)


@pytest.mark.parametrize("nodes", [1, 2, 10])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_poses_are_the_product_of_exponentials(nodes, seed):
    twists = random_twists(nodes, seed=seed)
    expected = poses_one_by_one(twists.numpy(), (0.0, 0.0, -math.pi / 2))
    np.testing.assert_allclose(rod.poses(twists).numpy(), expected, rtol=0, atol=1e-13)


def test_poses_of_a_long_chain_keep_their_accuracy():
    twists = random_twists(2000)
    expected = poses_one_by_one(twists.numpy(), (0.0, 0.0, -math.pi / 2))
    np.testing.assert_allclose(rod.poses(twists).numpy(), expected, rtol=0, atol=1e-11)


@given(seed=st.integers(0, 10_000), nodes=st.integers(1, 12))
def test_each_pose_follows_from_the_one_before(seed, nodes):
    twists = random_twists(nodes, seed=seed)
    poses = rod.poses(twists)
    stepped = se2.compose(poses[:-1], se2.exp(twists / nodes))
    torch.testing.assert_close(poses[1:], stepped, rtol=0, atol=1e-13)


@pytest.mark.parametrize("nodes", [1, 2, 50])
def test_a_straight_arm_hangs_down(nodes):
    twists = torch.tensor([0.4, 0.0, 0.0], dtype=torch.float64).expand(nodes, 3)
    poses = rod.poses(twists)
    assert poses.shape == (nodes + 1, 3)
    torch.testing.assert_close(poses[0], torch.tensor([0.0, 0.0, -math.pi / 2], dtype=torch.float64), rtol=0, atol=0)
    torch.testing.assert_close(
        poses[-1], torch.tensor([0, -0.4, -math.pi / 2], dtype=torch.float64), rtol=0, atol=1e-15
    )


@pytest.mark.parametrize("nodes", [1, 2, 7, 2000])
@pytest.mark.parametrize("turn", [-9.0, -1.0, 1e-9, 0.5, math.pi, 7.0])
def test_constant_curvature_is_an_arc_of_a_circle(nodes, turn):
    length = 0.5
    twists = torch.tensor([length, 0.0, turn], dtype=torch.float64).expand(nodes, 3)
    angle = turn * np.arange(nodes + 1) / nodes
    radius = length / turn
    # Hanging: the arm heads along -y, and its left is +x.
    x, y = 2 * radius * np.sin(angle / 2) ** 2, -radius * np.sin(angle)
    expected = np.stack((x, y, angle - math.pi / 2), -1)
    rounding = 1e-15 * (nodes + 10)  # a running sum of n terms may be off by n roundings
    np.testing.assert_allclose(rod.poses(twists).numpy(), expected, rtol=0, atol=rounding)


def test_positive_curvature_bends_a_hanging_arm_to_the_right():
    twists = torch.tensor([0.5, 0.0, 0.5], dtype=torch.float64).expand(5, 3)
    assert rod.poses(twists)[-1, 0].item() > 0.1


def test_a_full_turn_closes_and_is_remembered():
    twists = torch.tensor([0.5, 0.0, 2 * math.pi], dtype=torch.float64).expand(8, 3)
    tip = rod.poses(twists)[-1]
    torch.testing.assert_close(tip, torch.tensor([0, 0, 1.5 * math.pi], dtype=torch.float64), rtol=0, atol=1e-14)


@given(seed=st.integers(0, 10_000), x=st.floats(-2, 2), y=st.floats(-2, 2), angle=st.floats(-7, 7))
def test_moving_the_base_moves_the_whole_arm(seed, x, y, angle):
    twists = random_twists(6, seed=seed)
    base = torch.tensor([x, y, angle], dtype=torch.float64)
    from_identity = rod.poses(twists, torch.zeros(3, dtype=torch.float64))
    torch.testing.assert_close(rod.poses(twists, base), se2.compose(base, from_identity), rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    ("batch", "base_batch", "expected"),
    [
        ((), (), ()),
        ((4,), (), (4,)),
        ((), (4,), (4,)),
        ((3, 1), (4,), (3, 4)),
        ((1,), (2, 5), (2, 5)),
        ((0,), (), (0,)),
    ],
)
def test_batches_of_shapes_and_bases_broadcast(batch, base_batch, expected):
    twists = random_twists(*batch, 3)
    base = random_twists(*base_batch, seed=1)
    poses = rod.poses(twists, base)
    assert poses.shape == (*expected, 4, 3)
    all_twists, all_bases = twists.expand(*expected, 3, 3), base.expand(*expected, 3)
    for index in np.ndindex(*expected):
        torch.testing.assert_close(poses[index], rod.poses(all_twists[index], all_bases[index]), rtol=0, atol=1e-15)


def test_poses_are_differentiable_to_second_order_through_a_straight_arm():
    twists = torch.tensor([0.4, 0.0, 0.0], dtype=torch.float64).repeat(3, 1).requires_grad_()
    base = torch.tensor([0.1, 0.2, 0.3], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(rod.poses, (twists, base))
    assert torch.autograd.gradgradcheck(rod.poses, (twists, base))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_poses_keep_the_dtype(dtype):
    assert rod.poses(torch.ones(4, 3, dtype=dtype)).dtype == dtype


@given(seed=st.integers(0, 10_000))
def test_actuator_lengths_are_the_inverse_adjoint_of_the_centrelines(seed):
    twists = random_twists(5, seed=seed)
    radii = torch.tensor([-0.08, -0.015, 0.0, 0.02], dtype=torch.float64)
    found = rod.actuator_lengths(twists, radii)
    assert found.shape == (5, 4)
    for index, radius in enumerate(radii):
        offset = torch.stack((radius * 0, radius, radius * 0))
        expected = twists @ se2.adjoint(se2.inverse(offset)).T
        torch.testing.assert_close(found[:, index], expected[:, 0], rtol=0, atol=1e-15)


def test_an_actuator_lies_beside_the_centreline():
    """An arc's chord is that of the centreline's nodes, moved sideways by its radius."""
    twists, radii = random_twists(6, seed=3), torch.tensor([0.05, -0.03], dtype=torch.float64)
    twists[:, 1] = 0
    centre = rod.poses(twists)
    own = rod.actuator_lengths(twists, radii)
    half = 0.5 * twists[:, 2] / len(twists)
    for index, radius in enumerate(radii):
        beside = se2.compose(centre, torch.stack((radius * 0, radius, radius * 0)))
        chord = own[:, index] / len(twists) * half.sin() / half
        torch.testing.assert_close(beside[:, :2].diff(dim=0).norm(dim=-1), chord.abs(), rtol=0, atol=1e-14)


def test_actuator_lengths_broadcast_designs_and_shapes():
    twists, radii = random_twists(5, 1, 7), torch.rand(3, 4, dtype=torch.float64)
    assert rod.actuator_lengths(twists, radii).shape == (5, 3, 7, 4)


def test_strain_is_relative_elongation():
    length = torch.tensor([0.5, 0.6, 0.25, 0.0], dtype=torch.float64)
    expected = torch.tensor([0.0, 0.2, -0.5, -1.0], dtype=torch.float64)
    found = rod.strain(length, torch.tensor(0.5, dtype=torch.float64))
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-15)


def test_material_curvature_is_radians_per_metre_of_actuator():
    length = torch.tensor([0.5, 0.25, -0.1], dtype=torch.float64)
    neutral = torch.tensor(0.5, dtype=torch.float64)
    found = rod.material_curvature(torch.tensor(2.0, dtype=torch.float64), length, neutral)
    torch.testing.assert_close(found, torch.tensor([4.0, 8.0, -20.0], dtype=torch.float64), rtol=1e-15, atol=0)


@pytest.mark.parametrize("length", [0.0, -0.0, 1e-320, 1e-9, -1e-9, 4e-7, -4e-7])
def test_material_curvature_of_an_actuator_squeezed_to_nothing_is_finite(length):
    inputs = [torch.tensor(value, dtype=torch.float64, requires_grad=True) for value in (2.0, length, 0.5)]
    found = rod.material_curvature(*inputs)
    assert abs(found.item()) == pytest.approx(2.0 / 0.5e-6)
    assert all(torch.isfinite(gradient) for gradient in torch.autograd.grad(found, inputs))


@pytest.mark.parametrize("length", [0.3, -0.3, 6e-7, -6e-7])
def test_material_curvature_has_the_quotients_gradient_outside_the_guard(length):
    curvature, own = (torch.tensor(value, dtype=torch.float64, requires_grad=True) for value in (2.0, length))
    found = rod.material_curvature(curvature, own, torch.tensor(0.5, dtype=torch.float64))
    gradients = [gradient.item() for gradient in torch.autograd.grad(found, (curvature, own))]
    assert gradients == pytest.approx([1 / length, -2.0 / length**2], rel=1e-14)


def spatial_twists(*shape, seed=0):
    """Shapes of about half a metre with shear, turning up to a few radians about every axis."""
    generator = np.random.default_rng(seed)
    scale = np.array([0.4, 0.2, 0.2, 6.0, 8.0, 12.0])
    return torch.from_numpy(scale * (generator.random((*shape, 6)) - 0.5) + np.array([0.5, 0, 0, 0, 0, 0]))


def skewed(twist):
    x, y, z = twist[3:]
    rows = [[0, -z, y, twist[0]], [z, 0, -x, twist[1]], [-y, x, 0, twist[2]], [0, 0, 0, 0]]
    return np.array(rows, dtype=float)


HANGING = np.array([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


@pytest.mark.parametrize("nodes", [1, 2, 3, 7, 8, 9, 30])
def test_spatial_poses_are_the_product_of_exponentials(nodes):
    twists, pose, found = spatial_twists(nodes, seed=nodes), HANGING, [HANGING]
    for twist in twists.numpy() / nodes:
        pose = pose @ expm(skewed(twist))
        found.append(pose)
    np.testing.assert_allclose(rod.poses(twists).numpy(), np.array(found), rtol=0, atol=1e-14)


def test_spatial_poses_of_a_long_chain_stay_rigid():
    pose = rod.poses(spatial_twists(2000))
    rotation = pose[:, :3, :3]
    unit = torch.eye(3, dtype=torch.float64).expand_as(rotation)
    torch.testing.assert_close(rotation @ rotation.mT, unit, rtol=0, atol=1e-13)


def test_a_spatial_arm_hangs_as_the_planar_arm_does():
    straight = torch.tensor([0.4, 0, 0, 0, 0, 0], dtype=torch.float64).expand(5, 6)
    pose = rod.poses(straight)
    torch.testing.assert_close(pose[0], torch.from_numpy(HANGING), rtol=0, atol=0)
    torch.testing.assert_close(pose[-1, :3, 3], torch.tensor([0, -0.4, 0], dtype=torch.float64), rtol=0, atol=1e-16)


@pytest.mark.parametrize("linked", [False, True])
def test_the_plane_is_the_plane_z_0_of_space(linked):
    twists, base = random_twists(4, 7), random_twists(4, seed=1)
    link = random_twists(seed=2)
    counts = (3, 4) if linked else None
    planar = rod.poses(twists, base, segment_nodes=counts, links=(link, None) if linked else None)
    links = (se3.from_plane(link), None) if linked else None
    wide = rod.poses(se3.vector_from_plane(twists), se3.from_plane(base), segment_nodes=counts, links=links)
    torch.testing.assert_close(wide, se3.from_plane(planar), rtol=0, atol=1e-13)
    hanging = rod.poses(se3.vector_from_plane(twists))
    torch.testing.assert_close(hanging, se3.from_plane(rod.poses(twists)), rtol=0, atol=1e-13)


@pytest.mark.parametrize("group", [se2, se3], ids=["plane", "space"])
def test_segments_in_series_go_by_their_own_arc(group):
    """Two segments joined by a link: the second one's base is the first one's tip, carried through the link."""
    make = random_twists if group is se2 else spatial_twists
    lower, upper = make(2, 3), make(2, 5, seed=1)
    link, end = group.exp(make(2, seed=2)), group.exp(make(seed=3))
    first = rod.poses(lower)
    axis = 1
    start = group.compose(first.select(axis, 3), link)
    second = rod.poses(upper, start)
    tip = group.compose(second.select(axis, 5), end)
    whole = rod.poses(torch.cat((lower, upper), -2), segment_nodes=(3, 5), links=(link, end))
    expected = torch.cat((first.narrow(axis, 0, 3), second.narrow(axis, 0, 5), tip.unsqueeze(axis)), axis)
    torch.testing.assert_close(whole, expected, rtol=0, atol=1e-14)
    plain = rod.poses(torch.cat((lower, upper), -2), segment_nodes=(3, 5))
    joined = rod.poses(upper, first.select(axis, 3))
    torch.testing.assert_close(plain.narrow(axis, 3, 6), joined, rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"segment_nodes": (2, 2)}, "segment_nodes: must sum to the 5 rows"),
        ({"segment_nodes": (5, 0)}, "segment_nodes: must be an integer of at least 1"),
        ({"links": (None, torch.eye(4))}, "links: must be one for each of the 1 segments, got 2"),
        ({"links": (torch.zeros(3),)}, r"links\[0\]: must have shape"),
        ({"base_pose": torch.zeros(3)}, r"base_pose: must have shape \(..., 4, 4\)"),
        ({"base_pose": torch.zeros(2, 3, 4, 4)}, "twists, base_pose"),
    ],
)
def test_what_does_not_fit_is_named(arguments, words):
    with pytest.raises(ValueError, match=words):
        rod.poses(spatial_twists(4, 5), **arguments)


def test_spatial_poses_are_differentiable_to_second_order_through_a_straight_arm():
    twists = torch.tensor([0.4, 0, 0, 0, 0, 0], dtype=torch.float64).repeat(3, 1).requires_grad_()
    assert torch.autograd.gradcheck(rod.poses, (twists,))
    assert torch.autograd.gradgradcheck(rod.poses, (twists,))


def test_spatial_actuator_lengths_are_the_inverse_adjoint_of_the_centrelines():
    twists = spatial_twists(5)
    offsets = torch.tensor([[0.05, 0.0], [-0.02, 0.03], [0.0, -0.04]], dtype=torch.float64)
    found = rod.actuator_lengths(twists, offsets)
    for index, (y, z) in enumerate(offsets):
        beside = se3.from_parts(torch.eye(3, dtype=torch.float64), torch.stack((y * 0, y, z)))
        expected = twists @ se3.adjoint(se3.inverse(beside)).mT
        torch.testing.assert_close(found[:, index], expected[:, 0], rtol=0, atol=1e-15)


@pytest.mark.parametrize(("name", "heading"), [("hanging", (0, -1)), ("upright", (0, 1)), ("horizontal", (1, 0))])
def test_a_base_goes_by_name_in_the_plane_and_in_space(name, heading):
    straight = torch.tensor([[0.4, 0.0, 0.0]] * 3, dtype=torch.float64)
    flat = rod.poses(straight, name)
    assert torch.allclose(flat[-1, :2], 0.4 * torch.tensor(heading, dtype=torch.float64), atol=1e-15)
    space = rod.poses(se3.vector_from_plane(straight), name)
    torch.testing.assert_close(space, se3.from_plane(flat), rtol=0, atol=1e-15)
    shape = ta.affine_curvature(1.0, 0.5, nodes=4)
    task = ta.Task(shape, [1.0, 2.0, 0.3], name)
    assert torch.equal(task.base_pose, ta.Task(shape, [1.0, 2.0, 0.3], flat[0]).base_pose)
    arm = ta.antagonistic_arm()
    held = ta.solve_equilibrium(arm, [5.0, 20.0, 20.0, 5.0], [0.0, 0.0, 0.0], base_pose=name)
    assert torch.allclose(held.poses[0], flat[0])


def test_no_such_base_is_told():
    with pytest.raises(ValueError, match=r"^base_pose: must be one of hanging, upright, horizontal, got"):
        rod.poses(torch.zeros(2, 3), "sideways")
