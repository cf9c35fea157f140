"""Spatial arms, arms in series, and what arms and tasks carry besides."""

import copy
import dataclasses
import io
import math
import pickle

import numpy as np
import pytest
import torch

import torcharm as ta

F64 = torch.float64


def three(**changes):
    return ta.ArmDesign(**{"offsets": ta.ring(0.05, 3), "length": 0.4, "actuators": ta.Bellows(), **changes})


def planar(**changes):
    return ta.ArmDesign(**{"radii": [-0.04, 0.04], "length": 0.3, "actuators": ta.McKibben(), **changes})


def test_a_ring_begins_at_the_arms_left_and_turns_towards_body_z():
    found = ta.ring(0.05, 4, phase=0.1)
    angle = 0.1 + np.arange(4) * math.pi / 2
    np.testing.assert_allclose(found, 0.05 * np.stack((np.cos(angle), np.sin(angle)), -1), rtol=0, atol=1e-17)
    assert ta.ring(torch.rand(5, 1), 3, torch.rand(2)).shape == (5, 2, 3, 2)


def test_offsets_are_radii_and_what_lies_out_of_the_plane():
    arm = three()
    assert arm.dimension == 3
    assert arm.actuator_count == 3
    assert torch.equal(arm.offsets, ta.ring(0.05, 3))
    assert torch.equal(arm.radii, arm.offsets[:, 0])
    assert torch.equal(arm.out_of_plane, arm.offsets[:, 1])
    assert [type(model) for model in arm.actuators] == [ta.Bellows] * 3
    same = ta.ArmDesign(arm.radii, 0.4, ta.Bellows(), out_of_plane=arm.out_of_plane)
    assert torch.equal(same.offsets, arm.offsets)


def test_a_planar_arm_has_offsets_too():
    arm = planar()
    assert arm.dimension == 2
    assert arm.out_of_plane is None
    assert arm.offsets.tolist() == [[-0.04, 0.0], [0.04, 0.0]]
    assert arm.mass.item() == 0.0
    assert arm.torsion_stiffness is None
    assert arm.diameter is None


def test_lists_of_offsets_follow_the_dtype_of_the_other_fields():
    arm = three(offsets=[[0.05, 0.0], [0.0, 0.05]], length=torch.tensor(0.4))
    assert {arm.radii.dtype, arm.out_of_plane.dtype, arm.mass.dtype} == {torch.float32}


def test_what_is_one_for_each_design_goes_through_batches():
    radius = torch.linspace(0.03, 0.06, 6, dtype=F64).view(2, 3)
    mass = torch.arange(3.0, dtype=F64)
    arm = three(offsets=ta.ring(radius, 3), mass=mass, torsion_stiffness=0.3, diameter=[0.02, 0.03, 0.02])
    assert arm.batch_shape == (2, 3)
    assert arm.mass.tolist() == [[0.0, 1.0, 2.0]] * 2
    assert arm.torsion_stiffness.shape == (2, 3)
    assert arm.diameter.shape == (2, 3, 3)
    flat, one, some = arm.flatten(), arm[1, 2], arm[:, 1]
    assert flat.mass.tolist() == [0.0, 1.0, 2.0] * 2
    assert torch.equal(flat.offsets, ta.ring(radius.flatten(), 3))
    assert (one.mass.item(), one.batch_shape, one.dimension) == (2.0, (), 3)
    assert torch.equal(some.out_of_plane, ta.ring(radius[:, 1], 3)[..., 1])
    assert three().flatten().mass.shape == (1,)


def test_a_mass_may_make_the_batch():
    assert three(mass=[0.1, 0.2]).batch_shape == (2,)


def test_replace_keeps_what_it_does_not_change():
    arm = three(mass=0.4, torsion_stiffness=0.3, diameter=0.03)
    longer = dataclasses.replace(arm, length=0.5)
    assert torch.equal(longer.offsets, arm.offsets)
    assert (longer.mass.item(), longer.torsion_stiffness.item()) == (0.4, 0.3)
    assert torch.equal(longer.diameter, arm.diameter)


def test_with_values_keeps_mass_and_offsets_out_of_the_plane():
    arm = three(mass=0.4)
    batch = torch.rand(5, 3, dtype=F64)
    changed = arm.with_values(batch, batch, batch)
    assert changed.mass.tolist() == [0.4] * 5
    assert torch.equal(changed.out_of_plane, arm.out_of_plane.expand(5, 3))


def every_object():
    link = ta.RigidLink(0.03, mass=0.05)
    load = ta.ExternalLoad(torch.ones(4, 6, dtype=F64), True, ta.PointLoad(mass=0.2, at=0.5))
    twists = torch.ones(5, 6, dtype=F64)
    task = ta.Task(twists, load=load, wrench_at="middle", segment_nodes=(2, 3))
    return [three(mass=0.4), link, ta.series([three(), link, three()]), load.points[0], load, task]


def tensors_of(value):
    if isinstance(value, torch.Tensor):
        return [value]
    if isinstance(value, tuple):
        return [tensor for item in value for tensor in tensors_of(item)]
    if dataclasses.is_dataclass(value):
        return [tensor for field in dataclasses.fields(value) for tensor in tensors_of(getattr(value, field.name))]
    return []


@pytest.mark.parametrize("index", range(6))
def test_objects_survive_pickle_torch_save_and_copies(index):
    value = every_object()[index]
    buffer = io.BytesIO()
    torch.save(value, buffer)
    buffer.seek(0)
    copies = [pickle.loads(pickle.dumps(value)), torch.load(buffer, weights_only=False), copy.deepcopy(value)]
    for other in copies:
        assert repr(other) == repr(value)
        assert len(tensors_of(value)) > 0
        assert all(torch.equal(a, b) for a, b in zip(tensors_of(other), tensors_of(value), strict=True))


@pytest.mark.parametrize("index", range(6))
def test_to_changes_every_tensor(index):
    found = every_object()[index].to(torch.float32)
    assert {tensor.dtype for tensor in tensors_of(found)} == {torch.float32}


def test_reprs_are_short_and_hold_no_numbers():
    for value in every_object():
        assert len(repr(value)) < 400
        assert "tensor(" not in repr(value)


def test_a_series_keeps_order_and_links():
    link, mount = ta.RigidLink(0.03, mass=0.05), ta.RigidLink(pose=torch.eye(4, dtype=F64))
    arm = ta.series([three(mass=[0.1, 0.2]), link, three(offsets=ta.ring(0.03, 4)), mount])
    assert [segment.actuator_count for segment in arm.segments] == [3, 4]
    assert arm.links == (link, mount)
    assert (arm.dimension, arm.actuator_count, len(arm.actuators)) == (3, 7, 7)
    assert arm.batch_shape == (2,)
    assert arm.max_pressure.shape == (2, 7)
    whole = ta.series([arm, three()])
    assert whole.links == (link, mount, None)
    assert len(whole.segments) == 3


def test_a_straight_link_fits_either_dimension():
    link = ta.RigidLink(0.03)
    assert link.end(2).tolist() == [0.03, 0.0, 0.0]
    expected = np.eye(4)
    expected[0, 3] = 0.03
    np.testing.assert_array_equal(link.end(3), expected)
    assert ta.RigidLink(torch.tensor([0.1, 0.2], dtype=F64)).end(3).shape == (2, 4, 4)
    assert ta.series([planar(), link, planar()]).dimension == 2


def test_gradients_flow_through_offsets_masses_and_links():
    offsets, mass, length = (
        value.requires_grad_() for value in (ta.ring(0.05, 3), torch.tensor(0.4), torch.tensor(0.1))
    )
    arm = three(offsets=offsets, mass=mass.double())
    total = arm.offsets.sum() + arm.mass + ta.RigidLink(length).end(3)[0, 3]
    assert [gradient.sum().item() for gradient in torch.autograd.grad(total, (offsets, mass, length))] == [
        6.0,
        1.0,
        1.0,
    ]


def test_a_spatial_task_hangs_by_default():
    task = ta.Task(torch.ones(5, 6, dtype=F64), [1.0, 2.0, 3.0, 0.0, 0.0, 0.0])
    assert (task.dimension, task.nodes, task.batch_shape) == (3, 5, ())
    np.testing.assert_array_equal(task.base_pose, [[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    assert ta.Task(torch.ones(5, 3), [0.0, 0.0, 0.0]).dimension == 2


def test_a_tip_load_beside_a_load_is_its_tip():
    weight = ta.ExternalLoad(gravity=True)
    twists = torch.ones(5, 3, dtype=F64)
    task = ta.Task(twists, [1.0, 2.0, 3.0], load=weight)
    assert task.load.tip is task.tip_load
    assert task.tip_load.tolist() == [1.0, 2.0, 3.0]
    assert task.load.gravity
    assert ta.Task(twists, load=weight).tip_load.tolist() == [0.0, 0.0, 0.0]
    other = dataclasses.replace(task, tip_load=[4.0, 5.0, 6.0])
    assert (other.tip_load.tolist(), other.load.gravity) == ([4.0, 5.0, 6.0], True)
    changed = dataclasses.replace(task, load=ta.ExternalLoad([7.0, 8.0, 9.0]))
    assert (changed.tip_load.tolist(), changed.load.gravity) == ([7.0, 8.0, 9.0], False)


def test_batches_of_tips_points_and_shapes_broadcast():
    points = [ta.PointLoad(torch.ones(3, 1, 6)), ta.PointLoad(mass=torch.rand(2, 1, 1))]
    load = ta.ExternalLoad(torch.ones(4, 6), True, points)
    assert load.batch_shape == (2, 3, 4)
    assert ta.Task(torch.ones(3, 1, 5, 6), load=load).batch_shape == (2, 3, 4)
    with pytest.raises(ValueError, match=r"^twists, load: batch shapes do not broadcast"):
        ta.Task(torch.ones(5, 1, 5, 6), load=load)
    with pytest.raises(ValueError, match=r"^tip, points\[0\].wrench, points\[0\].mass: batch shapes do not broadcast"):
        ta.ExternalLoad(torch.ones(4, 6), points=ta.PointLoad(torch.ones(3, 6)))


def test_a_task_brings_its_load_to_its_dtype():
    load = ta.ExternalLoad(torch.ones(6), points=ta.PointLoad(torch.ones(6)))
    task = ta.Task(torch.ones(5, 6, dtype=F64), load=load)
    assert {tensor.dtype for tensor in tensors_of(task)} == {F64}


def test_a_task_may_say_how_its_rows_belong_to_segments():
    load = ta.ExternalLoad(points=ta.PointLoad([1.0, 0.0, 0.0], segment=1))
    task = ta.Task(torch.ones(7, 3), load=load, segment_nodes=[3, 4], wrench_at="middle")
    assert (task.segment_nodes, task.wrench_at) == ((3, 4), "middle")
    assert dataclasses.replace(task, wrench_at="start").segment_nodes == (3, 4)


def test_a_load_sits_on_the_last_segment_unless_told_otherwise():
    arm = ta.series([ta.ArmDesign([-0.05, 0.05], 0.3, "bellows"), ta.RigidLink(length=0.05), ta.bellows_arm()])
    found = []
    for where in ({}, {"segment": 1}, {"segment": 0}):
        load = ta.ExternalLoad(gravity=True, points=[ta.PointLoad([0.5, 0.0, 0.0], at=0.7, mass=0.1, **where)])
        rest = ta.solve_equilibrium(arm, [5.0, 6.0, 5.0, 6.0, 5.0, 6.0], load, nodes=4)
        task = ta.Task(rest.twists, load=load, segment_nodes=(4, 4))
        found.append((rest.poses, ta.required_wrench(task.twists, load, segment_nodes=(4, 4))))
    for last, explicit, first in zip(*found, strict=True):
        assert torch.equal(last, explicit)
        assert not torch.allclose(last, first, atol=1e-3)
