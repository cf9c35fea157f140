import dataclasses

import numpy as np
import pytest
import torch

import torcharm
from torcharm import Task, affine_curvature, cubic_curvature, sample_loads


@pytest.mark.parametrize("moment", [2.0, 5.0])
def test_sampled_loads_are_the_published_ones(moment):
    expected = (np.random.RandomState(100).rand(100, 3) - 0.5) * np.array([20.0, 20.0, moment])
    loads = sample_loads(100, (20.0, 20.0, moment))
    assert loads.dtype == torch.float64
    np.testing.assert_array_equal(loads.numpy(), expected)


def test_the_defaults_draw_the_published_loads():
    assert torch.equal(sample_loads(100), sample_loads(100, (20.0, 20.0, 2.0), 100))


def test_fewer_loads_are_the_first_of_more():
    assert torch.equal(sample_loads(7), sample_loads(100)[:7])


def test_loads_fill_the_box_and_stay_within():
    loads = sample_loads(2000, (4.0, 0.0, 1.0), seed=3)
    assert (loads.abs() <= torch.tensor([2.0, 0.0, 0.5])).all()
    assert (loads.abs().amax(0) > torch.tensor([1.98, -1.0, 0.495])).all()


@pytest.mark.parametrize("mass", [0.0, [0.0, 0.1]])
def test_a_payload_may_begin_at_nothing(mass):
    """As one that a slider sets, alone and in a batch: it asks for as much as none."""
    shape = affine_curvature(0.5, 0.5, nodes=3)
    points = torcharm.PointLoad(mass=mass, at=0.5)
    none, some = (torcharm.ExternalLoad(gravity=True, points=given) for given in ((), points))
    arm = torcharm.ArmDesign([-0.03, 0.03], 0.5, "bellows", mass=0.2)
    errors = [torcharm.predict_error(arm, Task(shape, load=load)).tip_error for load in (none, some)]
    assert torch.equal(errors[0], errors[1].reshape(-1)[0])
    assert len(set(errors[1].reshape(-1).tolist())) == errors[1].numel()


def test_seeds_differ_and_repeat():
    assert torch.equal(sample_loads(5, seed=1), sample_loads(5, seed=1))
    assert not torch.equal(sample_loads(5, seed=1), sample_loads(5, seed=2))


def test_sampling_leaves_global_random_state_alone():
    np.random.seed(1)
    torch.manual_seed(1)
    expected = np.random.rand(), torch.rand(1).item()
    np.random.seed(1)
    torch.manual_seed(1)
    sample_loads(10)
    assert (np.random.rand(), torch.rand(1).item()) == expected


def test_no_loads_may_be_asked_for():
    assert sample_loads(0).shape == (0, 3)


@pytest.mark.parametrize(("slope", "intercept"), [(-3.0, 3.0), (1.0, 1.5), (6.0, -1.5)])
def test_affine_curvature_is_sampled_at_both_ends(slope, intercept):
    twists = affine_curvature(slope, intercept)
    assert twists.shape == (10, 3)
    assert twists.dtype == torch.float64
    np.testing.assert_allclose(twists[:, 2].numpy(), slope * np.linspace(0, 1, 10) + intercept, rtol=0, atol=1e-15)
    assert twists[:, 0].tolist() == [0.5] * 10
    assert twists[:, 1].tolist() == [0.0] * 10


def test_cubic_curvature_is_the_polynomial():
    twists = cubic_curvature(2.0, -3.0, 1.5, 0.25, length=0.4, nodes=7)
    expected = np.polyval([2.0, -3.0, 1.5, 0.25], np.linspace(0, 1, 7))
    np.testing.assert_allclose(twists[:, 2].numpy(), expected, rtol=0, atol=1e-15)
    assert twists[:, 0].tolist() == [0.4] * 7


def test_one_segment_has_the_curvature_at_the_base():
    assert affine_curvature(-3.0, 3.0, nodes=1).tolist() == [[0.5, 0.0, 3.0]]
    assert cubic_curvature(1.0, 1.0, 1.0, 2.0, nodes=1).tolist() == [[0.5, 0.0, 2.0]]


def test_shapes_broadcast_their_parameters():
    slope, intercept, length = torch.rand(4, 1), torch.rand(3), torch.rand(2, 1, 1) + 0.1
    twists = affine_curvature(slope, intercept, length, nodes=5)
    assert twists.shape == (2, 4, 3, 5, 3)
    torch.testing.assert_close(twists[1, 2, 0], affine_curvature(slope[2, 0], intercept[0], length[1, 0, 0], nodes=5))


def test_shapes_follow_dtype_and_gradients():
    slope = torch.tensor(1.0, requires_grad=True)
    twists = affine_curvature(slope, 0.5, nodes=3)
    assert twists.dtype == torch.float32
    assert torch.autograd.grad(twists[:, 2].sum(), slope)[0].item() == 1.5


@pytest.mark.parametrize(
    ("shapes", "loads", "batch"),
    [
        ((), (), ()),
        ((4,), (), (4,)),
        ((), (5,), (5,)),
        ((4, 1), (5,), (4, 5)),
        ((4, 5), (4, 5), (4, 5)),
        ((), (0,), (0,)),
    ],
)
def test_shapes_and_loads_broadcast_without_being_expanded(shapes, loads, batch):
    task = Task(torch.ones(*shapes, 6, 3), torch.ones(*loads, 3))
    assert task.batch_shape == batch
    assert task.nodes == 6
    assert task.twists.shape == (*shapes, 6, 3)
    assert task.tip_load.shape == (*loads, 3)


def test_the_arm_hangs_from_the_origin_by_default():
    task = Task(affine_curvature(0.0, 0.0), [0.0, 0.0, 0.0])
    assert task.base_pose.tolist() == [0.0, 0.0, -np.pi / 2]


def test_the_base_may_be_placed():
    assert Task(affine_curvature(0.0, 0.0), [0.0, 0.0, 0.0], [1, 2, 3]).base_pose.tolist() == [1.0, 2.0, 3.0]


def test_everything_has_one_dtype():
    task = Task(torch.ones(4, 3), [1, 2, 3])
    assert {task.twists.dtype, task.tip_load.dtype, task.base_pose.dtype} == {torch.float32}
    task = Task(torch.ones(4, 3), torch.ones(3, dtype=torch.float64))
    assert {task.twists.dtype, task.tip_load.dtype, task.base_pose.dtype} == {torch.float64}


def test_to_changes_every_tensor():
    task = Task(affine_curvature([1.0, 2.0], 3.0), sample_loads(2)).to(torch.float32)
    assert {task.twists.dtype, task.tip_load.dtype, task.base_pose.dtype} == {torch.float32}
    assert task.batch_shape == (2,)


@pytest.mark.parametrize("field", ["twists", "tip_load", "base_pose"])
def test_fields_cannot_be_assigned(field):
    task = Task(affine_curvature(0.0, 0.0), [0.0, 0.0, 0.0])
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(task, field, getattr(task, field))


def test_replace_makes_a_new_checked_task():
    task = Task(affine_curvature(0.0, 0.0), [0.0, 0.0, 0.0])
    heavier = dataclasses.replace(task, tip_load=[1.0, 0.0, 0.0])
    assert heavier.tip_load.tolist() == [1.0, 0.0, 0.0]
    assert heavier.twists is task.twists
    with pytest.raises(ValueError, match=r"^tip_load: must be finite"):
        dataclasses.replace(task, tip_load=[float("nan"), 0.0, 0.0])
    with pytest.raises(ValueError, match=r"^tip_load: must be finite, and at most 1.8e\+15 in size, got 1e\+20"):
        Task(affine_curvature(0.0, 0.0).float(), torch.tensor([1e20, 0.0, 0.0]))


def test_a_part_holds_tasks_of_the_flattened_batch_with_all_that_loads_them():
    masses = torch.arange(6.0, dtype=torch.float64).reshape(2, 3)
    points = [torcharm.PointLoad([0.0, 1.0, 0.0], at=0.5, frame="body"), torcharm.PointLoad(mass=masses)]
    shapes = torch.stack([affine_curvature(0.5, bend, nodes=3) for bend in (0.1, 0.2)]).unsqueeze(1)
    whole = Task(shapes, sample_loads(3), "upright", torcharm.ExternalLoad(gravity=True, points=points), "start")
    one, some = whole.part(4), whole.part([4, 1])
    assert (one.batch_shape, some.batch_shape, whole.part(slice(2, 9)).batch_shape) == ((), (2,), (4,))
    for part, row, column in ((one, 1, 1), (some.part(0), 1, 1), (some.part(1), 0, 1)):
        assert torch.equal(part.twists, shapes[row, 0])
        assert torch.equal(part.tip_load, sample_loads(3)[column])
        assert part.load.points[1].mass == masses[row, column]
        assert torch.equal(part.load.points[0].wrench, points[0].wrench)
        assert (part.load.points[0].frame, part.load.gravity, part.wrench_at) == ("body", True, "start")
        assert torch.equal(part.base_pose, whole.base_pose)
    with pytest.raises(IndexError):
        whole.part(6)


def test_gradients_flow_to_shape_and_load():
    load = torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64, requires_grad=True)
    twists = affine_curvature(1.0, 1.0).requires_grad_()
    task = Task(twists, load)
    assert torch.autograd.grad(task.tip_load.sum() + task.twists.sum(), (load, twists))[0].tolist() == [1.0] * 3


@pytest.mark.parametrize("change", ["scaled", "mirrored", "transposed position", "sheared"])
def test_a_base_in_space_must_be_a_rotation_and_a_position(change):
    base = torch.eye(4, dtype=torch.float64)
    if change == "scaled":
        base[:3, :3] *= 1.01
    elif change == "mirrored":
        base[0, 0] = -1.0
    elif change == "sheared":
        base[0, 1] = 1e-3
    else:
        base[3, 0] = 0.2
    twists = torch.tensor([[0.45, 0, 0, 0, 0.3, 0.5]] * 2, dtype=torch.float64)
    arm = torcharm.ArmDesign(offsets=torcharm.ring(radius=0.05, count=3), length=0.4, actuators=torcharm.Bellows())
    with pytest.raises(ValueError, match=r"^base_pose: must be a homogeneous matrix, a rotation and a position above"):
        Task(twists, [0.0] * 6, base)
    with pytest.raises(ValueError, match=r"^base_pose: must be a homogeneous matrix, a rotation and a position above"):
        torcharm.solve_equilibrium(arm, 1.0, [0.0] * 6, 2, base_pose=base)
    with pytest.raises(ValueError, match=r"^tip_pose: must be a homogeneous matrix, a rotation and a position above"):
        torcharm.plan_shape(arm, base, [0.0] * 6)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_rotation_is_one_to_its_rounding(dtype):
    turn = torch.linalg.matrix_exp(torch.tensor([[0, -1.1, 0.7], [1.1, 0, 0.3], [-0.7, -0.3, 0]], dtype=dtype))
    base = torch.eye(4, dtype=dtype)
    base[:3, :3] = turn
    assert Task(torch.zeros(2, 6, dtype=dtype), [0.0] * 6, base).base_pose is base
