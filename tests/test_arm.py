import dataclasses

import numpy as np
import pytest
import torch

from torcharm import (
    ArmDesign,
    Bellows,
    McKibben,
    antagonistic_arm,
    bellows_arm,
    mckibben_arm,
    reaction_wrench,
    ring,
    save_actuator,
    solve_equilibrium,
)
from torcharm.actuators import SHIPPED

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


FIELDS = ("radii", "length", "max_pressure", "out_of_plane", "diameter", "mass", "torsion_stiffness")


@pytest.mark.parametrize("number", [0.02, 1, np.float64(0.02), torch.tensor(0.02)], ids=lambda one: type(one).__name__)
def test_every_field_of_numbers_takes_one_number(number):
    for batch in ((), (3,)):
        given = {"radii": torch.full((*batch, 2), 0.1)} | {name: number for name in FIELDS if name != "radii"}
        arm = ArmDesign(actuators=PAIR, **given)
        assert arm.batch_shape == batch
        for name in FIELDS[1:]:
            each_design = name in ("mass", "torsion_stiffness")
            assert getattr(arm, name).shape == (batch if each_design else (*batch, 2))
            assert getattr(arm, name).flatten().tolist() == pytest.approx([float(number)] * getattr(arm, name).numel())


def test_one_radius_serves_all_actuators():
    assert pair(0.02).radii.tolist() == [0.02, 0.02]
    assert pair(0.02, [[0.3, 0.4], [0.5, 0.6]]).radii.tolist() == [[0.02, 0.02]] * 2
    assert ArmDesign(0.02, 0.5, Bellows()).radii.tolist() == [0.02]


@pytest.mark.parametrize("name", FIELDS)
def test_a_tensor_of_one_number_keeps_its_gradient(name):
    value = torch.tensor(0.02, dtype=torch.float64, requires_grad=True)
    arm = ArmDesign(actuators=PAIR, **({"radii": [-0.02, 0.03], "length": 0.5} | {name: value}))
    count = 1 if name in ("mass", "torsion_stiffness") else 2
    assert torch.autograd.grad(getattr(arm, name).sum(), value)[0].item() == count


def test_ready_arms_and_rings_take_numbers_and_tensors_of_one():
    size = torch.tensor(0.05, dtype=torch.float64, requires_grad=True)
    for make in (antagonistic_arm, bellows_arm, mckibben_arm):
        arm = make(size, 0.01, np.float64(0.4))
        assert arm.length.tolist() == [0.4] * 4
        assert torch.autograd.grad(arm.radii[3], size)[0].item() == 1.0
    arm = ArmDesign(offsets=ring(size, 3), length=1, actuators="bellows", max_pressure=200.0, diameter=0.03)
    assert arm.max_pressure.tolist() == [200.0] * 3
    assert torch.autograd.grad(arm.offsets[0, 0], size)[0].item() == 1.0


def test_one_pressure_serves_all_actuators():
    arm, load = antagonistic_arm(), [0.0, -1.0, 0.0]
    all_alike = solve_equilibrium(arm, 20.0, load, nodes=3)
    assert torch.equal(all_alike.twists, solve_equilibrium(arm, [20.0] * 4, load, nodes=3).twists)
    pressure = torch.tensor(20.0, dtype=torch.float64, requires_grad=True)
    bent = reaction_wrench(ArmDesign([0.01, 0.02], 0.5, PAIR), all_alike.twists, pressure)
    assert torch.autograd.grad(bent.sum(), pressure)[0].isfinite()


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


def test_names_stand_for_the_shipped_models(tmp_path):
    assert ArmDesign([0.1, 0.2], 0.5, "bellows").actuators == (Bellows(), Bellows())
    own = McKibben(force_scale=2.0)
    save_actuator(tmp_path / "own.toml", own)
    given = ["bellows", "mckibben", own, tmp_path / "own.toml", str(tmp_path / "own.toml")]
    arm = ArmDesign([0.1] * 5, 0.5, given)
    assert arm.actuators == (Bellows(), McKibben(), own, own, own)
    assert arm.max_pressure.tolist() == [50.0, 100.0, 100.0, 100.0, 100.0]
    assert {name: ArmDesign(0.1, 0.5, name).actuators[0] for name in SHIPPED} == {
        name: make() for name, make in SHIPPED.items()
    }


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


def test_offsets_are_one_for_each_model():
    with pytest.raises(ValueError, match=r"^offsets: must hold one \(y, z\) for each of the 3 actuators, got 4$"):
        ArmDesign(offsets=ring(0.05, 4), length=0.4, actuators=["bellows"] * 3)
