import dataclasses

import numpy as np
import pytest
import torch

from torcharm import ArmDesign, Bellows, McKibben, antagonistic_arm, bellows_arm, mckibben_arm

PAIR = (Bellows(), McKibben())


def pair(radii=(-0.02, 0.03), length=0.5, **changes):
    return ArmDesign(radii, length, PAIR, **changes)


def test_one_design_has_no_batch():
    arm = pair()
    assert arm.batch_shape == ()
    assert arm.actuator_count == 2
    assert arm.radii.shape == arm.length.shape == arm.max_pressure.shape == (2,)


def test_lists_numbers_and_integers_become_float64():
    arm = ArmDesign([0, 1], 1, PAIR, [50, 100])
    assert {value.dtype for value in (arm.radii, arm.length, arm.max_pressure)} == {torch.float64}


def test_floating_inputs_decide_the_dtype():
    assert pair(torch.tensor([0.1, 0.2])).length.dtype == torch.float32
    assert pair(torch.tensor([0.1, 0.2]), torch.tensor(0.5, dtype=torch.float64)).radii.dtype == torch.float64
    assert pair(np.array([0.1, 0.2], dtype=np.float32)).max_pressure.dtype == torch.float32
    assert pair([torch.tensor(0.1), torch.tensor(0.2)]).radii.dtype == torch.float32
    assert pair(torch.tensor([0, 1])).radii.dtype == torch.float64


def test_the_models_give_the_default_limits():
    assert pair().max_pressure.tolist() == [50.0, 100.0]
    assert ArmDesign([0.1], 0.5, [Bellows(max_pressure=30.0)]).max_pressure.tolist() == [30.0]


@pytest.mark.parametrize(
    "limits", [[20.0, 0.0], [[20.0, 0.0]], torch.tensor([20.0, 0.0])], ids=["list", "row", "tensor"]
)
def test_limits_override_the_models(limits):
    assert pair(max_pressure=limits).max_pressure.flatten().tolist() == [20.0, 0.0]


def test_one_limit_may_serve_all_actuators():
    assert pair(max_pressure=[20.0]).max_pressure.tolist() == [20.0, 20.0]
    assert pair(max_pressure=[[20.0], [30.0]]).max_pressure.tolist() == [[20.0, 20.0], [30.0, 30.0]]


@pytest.mark.parametrize(
    ("radii", "length", "limits", "batch"),
    [
        ((2,), (), (2,), ()),
        ((2,), (2,), (2,), ()),
        ((5, 2), (), (2,), (5,)),
        ((5, 2), (5,), (2,), (5,)),
        ((5, 2), (2,), (2,), (5,)),
        ((5, 2), (5, 2), (5, 2), (5,)),
        ((5, 2), (5, 1), (5, 1), (5,)),
        ((2,), (5, 2), (2,), (5,)),
        ((2,), (5, 1), (2,), (5,)),
        ((2,), (), (5, 2), (5,)),
        ((3, 1, 2), (4, 2), (2,), (3, 4)),
        ((3, 4, 2), (3, 4), (4, 2), (3, 4)),
        ((2, 2), (1, 2), (2,), (2,)),
        ((2, 2), (2, 1), (2,), (2,)),
        ((0, 2), (), (2,), (0,)),
    ],
)
def test_batches_broadcast(radii, length, limits, batch):
    arm = pair(torch.full(radii, 0.01), torch.full(length, 0.4), max_pressure=torch.full(limits, 30.0))
    assert arm.batch_shape == batch
    assert arm.radii.shape == arm.length.shape == arm.max_pressure.shape == (*batch, 2)


def test_a_length_for_each_design_goes_to_all_its_actuators():
    arm = pair(torch.zeros(3, 2), torch.tensor([0.3, 0.4, 0.5]))
    assert torch.equal(arm.length, torch.tensor([[0.3, 0.3], [0.4, 0.4], [0.5, 0.5]]))


def test_a_length_for_each_actuator_goes_to_all_designs():
    arm = pair(torch.zeros(3, 2), torch.tensor([0.3, 0.4]))
    assert torch.equal(arm.length, torch.tensor([[0.3, 0.4]] * 3))


@pytest.mark.parametrize("batch", [(2,), (3, 2)])
def test_lengths_that_could_be_either_are_refused_with_the_way_out(batch):
    with pytest.raises(ValueError, match=r"^length: .* could be one for each actuator or one for each design; give \("):
        pair(torch.zeros(*batch, 2), torch.full(batch, 0.5))


def test_the_ways_out_of_an_ambiguous_length_work():
    lengths = torch.tensor([0.3, 0.4])
    assert pair(torch.zeros(2, 2), lengths[None]).length.tolist() == torch.tensor([[0.3, 0.4], [0.3, 0.4]]).tolist()
    assert pair(torch.zeros(2, 2), lengths[:, None]).length.tolist() == torch.tensor([[0.3, 0.3], [0.4, 0.4]]).tolist()


def test_a_single_actuator_is_an_arm():
    arm = ArmDesign([[0.0], [0.1], [0.2]], [0.3, 0.4, 0.5], [Bellows()])
    assert arm.batch_shape == (3,)
    assert arm.length.tolist() == [[0.3], [0.4], [0.5]]


@pytest.mark.parametrize("field", ["radii", "length", "actuators", "max_pressure"])
def test_fields_cannot_be_assigned(field):
    arm = pair()
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(arm, field, getattr(arm, field))


def test_replace_makes_a_new_checked_design():
    arm = pair(torch.zeros(3, 2))
    longer = dataclasses.replace(arm, length=0.7)
    assert longer.length.unique().tolist() == pytest.approx([0.7])
    assert torch.equal(longer.radii, arm.radii)
    assert arm.length.unique().tolist() == [0.5]
    with pytest.raises(ValueError, match=r"^length: must be above 0 m"):
        dataclasses.replace(arm, length=-0.7)


def test_later_changes_to_a_numpy_array_leave_the_design_alone():
    radii = np.array([-0.02, 0.03])
    arm = pair(radii)
    radii[0] = 9.0
    assert arm.radii.tolist() == [-0.02, 0.03]


def test_reversed_numpy_arrays_are_understood():
    assert pair(np.array([-0.02, 0.03])[::-1]).radii.tolist() == [0.03, -0.02]


def test_actuators_become_a_tuple():
    assert ArmDesign([0.1, 0.2], 0.5, [Bellows(), McKibben()]).actuators == PAIR


def test_any_object_with_the_five_members_is_an_actuator():
    class Spring:
        bending_stiffness = 0.0
        max_pressure = 10.0
        strain_range = (-1.0, 1.0)
        pressure_range = (0.0, 10.0)

        def force(self, strain, pressure):
            return -100.0 * strain + 0.0 * pressure

    assert ArmDesign([0.1], 0.5, [Spring()]).max_pressure.tolist() == [10.0]


def test_flatten_joins_the_batch():
    arm = pair(torch.arange(24.0).view(3, 4, 2))
    flat = arm.flatten()
    assert flat.batch_shape == (12,)
    assert torch.equal(flat.radii, torch.arange(24.0).view(12, 2))
    assert flat.actuators == arm.actuators
    assert pair().flatten().batch_shape == (1,)
    assert pair(torch.zeros(0, 2)).flatten().batch_shape == (0,)


@pytest.mark.parametrize(
    "index",
    [0, -1, slice(1, None), (1, 2), (slice(None), 0), (..., 1), (0, slice(1, 3)), torch.tensor([2, 0])],
    ids=str,
)
def test_indexing_is_that_of_the_batch(index):
    radii = torch.arange(24.0).view(3, 4, 2)
    arm = pair(radii, torch.full((3, 4, 2), 0.5), max_pressure=radii)
    place = torch.arange(12).view(3, 4)[index]
    chosen = arm[index]
    assert chosen.batch_shape == place.shape
    assert torch.equal(chosen.radii, radii.view(12, 2)[place])
    assert torch.equal(chosen.max_pressure, chosen.radii)


def test_a_mask_chooses_designs():
    arm = pair(torch.arange(6.0).view(3, 2))
    assert torch.equal(arm[torch.tensor([True, False, True])].radii, torch.tensor([[0.0, 1.0], [4.0, 5.0]]))


@pytest.mark.parametrize("index", [3, (0, 0), (slice(None), 0)], ids=str)
def test_an_index_cannot_leave_the_batch_or_reach_into_the_actuators(index):
    with pytest.raises(IndexError):
        pair(torch.zeros(3, 2))[index]


def test_a_batch_can_be_looped_over():
    arms = list(pair(torch.arange(6.0).view(3, 2)))
    assert [arm.radii.tolist() for arm in arms] == [[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]]


@pytest.mark.parametrize(
    ("make", "radii", "limits"),
    [
        (antagonistic_arm, [-0.08, -0.015, 0.015, 0.08], [50.0, 100.0, 100.0, 50.0]),
        (bellows_arm, [-0.08, -0.015, 0.015, 0.08], [50.0] * 4),
        (mckibben_arm, [-0.01, -0.01, 0.01, 0.01], [100.0] * 4),
    ],
)
def test_the_papers_arms(make, radii, limits):
    arm = make()
    assert arm.radii.tolist() == radii
    assert arm.length.tolist() == [0.5] * 4
    assert arm.max_pressure.tolist() == limits


def test_the_papers_arms_have_their_actuators():
    assert antagonistic_arm().actuators == (Bellows(), McKibben(), McKibben(), Bellows())
    assert bellows_arm().actuators == (Bellows(),) * 4
    assert mckibben_arm().actuators == (McKibben(force_scale=2.0),) * 4


@pytest.mark.parametrize("make", [antagonistic_arm, bellows_arm, mckibben_arm])
def test_tensors_of_radii_and_lengths_make_batches(make):
    outer, inner = torch.tensor([[0.05], [0.06], [0.07]]), torch.tensor([0.01, 0.02])
    arm = make(outer, inner, torch.tensor([[0.3], [0.4], [0.5]]).expand(3, 2))
    assert arm.batch_shape == (3, 2)
    expected = torch.tensor([-0.06, -0.02, 0.02, 0.06])
    assert torch.equal(arm[1, 1].radii, expected)
    assert torch.equal(arm[2, 0].length, torch.full((4,), 0.5))


def test_gradients_flow_to_what_was_passed():
    outer, length, limits = (
        torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in (0.08, 0.5, [50.0, 100.0])
    )
    arm = antagonistic_arm(outer, 0.015, length)
    assert torch.autograd.grad(arm.radii[3] - 2 * arm.radii[0], outer)[0].item() == 3.0
    assert torch.autograd.grad(arm.length.sum(), length)[0].item() == 4.0
    assert torch.autograd.grad(pair(max_pressure=limits).flatten()[0].max_pressure.sum(), limits)[0].tolist() == [1, 1]


@pytest.mark.parametrize("nested", [False, True], ids=["list", "nested list"])
def test_gradients_flow_through_lists_of_tensors(nested):
    radius = torch.tensor(0.02, dtype=torch.float64, requires_grad=True)
    radii = [-radius, 0.1]
    arm = pair([radii, radii] if nested else radii)
    assert arm.radii.flatten()[1].item() == 0.1
    assert torch.autograd.grad(arm.radii.sum(), radius)[0].item() == (-2.0 if nested else -1.0)


def test_float32_tensors_stay_float32():
    arm = antagonistic_arm(torch.tensor(0.08), torch.tensor(0.015), torch.tensor(0.5))
    assert {value.dtype for value in (arm.radii, arm.length, arm.max_pressure)} == {torch.float32}
