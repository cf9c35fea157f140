import math

import numpy as np
import oracle
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import torcharm as ta
from torcharm import mechanics
from torcharm.geometry import se2
from torcharm.geometry.rod import BASE_POSE

BASE = torch.tensor(BASE_POSE, dtype=torch.float64)
MIXED = ta.ArmDesign(
    [[-0.07, -0.01, 0.02, 0.03, 0.08]],
    [[0.5, 0.45, 0.52, 0.48, 0.55]],
    [ta.Bellows(), ta.McKibben(), ta.McKibben(bending_stiffness=0.0), ta.Bellows(force_scale=0.5), ta.McKibben()],
)
BENDING = ta.ArmDesign(
    [[-0.06, 0.0, 0.05]],
    [[0.5, 0.5, 0.48]],
    [
        ta.Bellows(bending_stiffness=ta.ConstantBending(-0.2)),
        ta.McKibben(bending_stiffness=ta.LinearBending(-0.1, 60.0)),
        ta.Bellows(bending_stiffness=ta.BendingFunction(lambda k, p: -0.1 * k.tanh() - 0.02 * p * k**3, 40.0)),
    ],
)


def scene(arm, *, batch=3, nodes=6, shear=False, seed=0):
    generator = torch.Generator().manual_seed(seed)

    def drawn(*shape):
        return torch.rand(*shape, generator=generator, dtype=torch.float64)

    rows = [0.42 + 0.12 * drawn(batch, nodes), 6 * (drawn(batch, nodes) - 0.5)]
    if shear:
        rows.insert(1, 0.05 * (drawn(batch, nodes) - 0.5))
    unknowns = torch.stack(rows, 1)
    pressure = (0.1 + 0.8 * drawn(batch, arm.actuator_count)) * arm.max_pressure
    load = torch.tensor([20.0, 20.0, 5.0], dtype=torch.float64) * (drawn(batch, 3) - 0.5)
    return unknowns, pressure, load


@pytest.mark.parametrize("stiffness", [None, 250.0])
def test_residual_is_reaction_plus_load_written_independently(stiffness):
    unknowns, pressure, load = scene(MIXED, shear=stiffness is not None)
    found = mechanics.balance_residual(MIXED, unknowns, pressure, load, BASE, stiffness)
    models = {ta.Bellows: oracle.bellows_force, ta.McKibben: oracle.mckibben_force}
    actuators = tuple(
        oracle.Actuator(
            oracle.scaled(models[type(a)], a.force_scale), a.bending_stiffness, 50.0 if type(a) is ta.Bellows else 100.0
        )
        for a in MIXED.actuators
    )
    arm = oracle.Arm(
        tuple(MIXED.radii[0].tolist()),
        tuple(MIXED.length[0].tolist()),
        tuple(MIXED.max_pressure[0].tolist()),
        actuators,
    )
    for row in range(len(unknowns)):
        twists = mechanics.to_twists(unknowns[row]).numpy()
        required = oracle.required_wrenches(twists, load[row].tolist())
        for node, twist in enumerate(twists):
            axial, moment = oracle.reaction(arm, twist, pressure[row].tolist()) - required[node, [0, 2]]
            expected = [axial, moment]
            if stiffness is not None:
                expected.insert(1, -stiffness * len(actuators) * twist[1] - required[node, 1])
            np.testing.assert_allclose(found[row, :, node], expected, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("stiffness", [None, 250.0])
@pytest.mark.parametrize("nodes", [1, 2, 7])
@pytest.mark.parametrize("arm", [MIXED, BENDING], ids=["mixed", "bending models"])
def test_stiffness_and_pressure_slope_are_those_of_the_residual(arm, stiffness, nodes):
    unknowns, pressure, load = scene(arm, nodes=nodes, shear=stiffness is not None)
    found = mechanics.balance(arm, unknowns, pressure, load, BASE, stiffness)
    for row in range(len(unknowns)):

        def residual(z, p, row=row):
            return mechanics.balance_residual(arm[0], z, p, load[row], BASE, stiffness)

        by_z, by_p = torch.autograd.functional.jacobian(residual, (unknowns[row], pressure[row]))
        torch.testing.assert_close(found.stiffness[row], by_z, rtol=1e-11, atol=1e-10)
        torch.testing.assert_close(found.by_pressure[row], by_p, rtol=1e-11, atol=1e-11)
        torch.testing.assert_close(found.residual[row], residual(unknowns[row], pressure[row]), rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("shear", [False, True])
def test_pose_jacobian_and_error_slope_against_autograd(shear):
    unknowns, _, _ = scene(MIXED, batch=2, shear=shear)
    motion = mechanics.kinematics(unknowns, BASE)
    twists = mechanics.to_twists(unknowns)
    torch.testing.assert_close(motion.pose, ta.poses(twists), rtol=1e-13, atol=1e-13)
    jacobian = mechanics.pose_jacobian(motion, shear=shear)
    change = torch.rand(*unknowns.shape, 3, dtype=torch.float64)
    moved = torch.einsum("bipcn,bcnk->bipk", jacobian, change)
    torch.testing.assert_close(mechanics.pose_change(motion, change), moved, rtol=1e-11, atol=1e-12)
    target = ta.poses(twists * 1.1)[:, 1:]
    error, slope = mechanics.pose_error(motion.pose[:, 1:], target)
    assert error.shape == target.shape
    torch.testing.assert_close(error, se2.compose(se2.inverse(motion.pose[:, 1:]), target), rtol=1e-12, atol=1e-12)
    for row in range(2):
        expected = torch.autograd.functional.jacobian(lambda z: ta.poses(mechanics.to_twists(z)), unknowns[row])
        torch.testing.assert_close(jacobian[row], expected.movedim(1, 0), rtol=1e-11, atol=1e-12)
        expected = torch.autograd.functional.jacobian(
            lambda pose, row=row: mechanics.pose_error(pose, target[row])[0], motion.pose[row, 1:]
        )
        torch.testing.assert_close(slope[row], torch.einsum("iajb,ij->iab", expected, torch.eye(6).double()))


@pytest.mark.parametrize("arm", [MIXED, BENDING], ids=["mixed", "bending models"])
def test_reaction_is_that_of_the_wrenches(arm):
    unknowns, pressure, _ = scene(arm)
    expected = ta.reaction_wrench(arm, mechanics.to_twists(unknowns), pressure).mT
    torch.testing.assert_close(mechanics.actuator_wrench(arm, unknowns, pressure), expected)
    torch.testing.assert_close(mechanics.actuator_part(arm, unknowns, pressure).wrench, expected)


@pytest.mark.parametrize("arm", [MIXED, BENDING], ids=["mixed", "bending models"])
def test_derivatives_can_be_differentiated_again(arm):
    unknowns, pressure, load = scene(arm, batch=1, nodes=3)
    inputs = (arm.radii.clone().requires_grad_(), unknowns.requires_grad_(), pressure.requires_grad_())

    def derivatives(radii, z, p):
        design = ta.ArmDesign(radii, arm.length, arm.actuators)
        found = mechanics.balance(design, z, p, load, BASE, create_graph=True)
        return found.residual, found.stiffness, found.by_pressure

    assert torch.autograd.gradcheck(derivatives, inputs, atol=1e-4)


def test_derivatives_come_detached_unless_asked_for():
    unknowns, pressure, load = scene(MIXED)
    found = mechanics.balance(MIXED, unknowns.requires_grad_(), pressure.requires_grad_(), load, BASE)
    assert not any(x.requires_grad for x in (found.residual, found.stiffness, found.by_pressure, found.kinematics.pose))


def test_arms_pressures_and_loads_broadcast():
    arm = ta.antagonistic_arm(torch.tensor([[0.06], [0.08]]).double().expand(2, 3))
    unknowns, pressure, load = scene(arm, batch=3)
    found = mechanics.balance(arm, unknowns[:1], pressure, load, BASE)
    assert found.stiffness.shape == (2, 3, 2, 6, 2, 6)
    assert found.by_pressure.shape == (2, 3, 2, 6, 4)
    one = mechanics.balance(arm[1, 2], unknowns[0], pressure[1, 2], load[2], BASE)
    torch.testing.assert_close(found.stiffness[1, 2], one.stiffness)


def test_a_force_model_without_pressure_or_bending():
    spring = ta.PolynomialActuator(((1, 0, -40.0),), (-0.5, 0.5), (0.0, 50.0), 50.0, bending_stiffness=0.0)
    arm = ta.ArmDesign([-0.05, 0.05], 0.4, [spring, spring])
    unknowns, pressure, load = scene(arm, batch=1)
    found = mechanics.balance(arm, unknowns, pressure, load, BASE)
    assert not found.by_pressure.any()
    part = mechanics.actuator_part(arm, unknowns, pressure)
    torch.testing.assert_close(part.stiffness[:, 0, 0], torch.full((1, 6), -200.0).double())
    torch.testing.assert_close(part.stiffness[:, 1, 1], torch.full((1, 6), -200.0 * 0.05**2).double())


def test_singular_elements_do_not_disturb_the_others():
    matrices = torch.eye(4, dtype=torch.float64).repeat(3, 1, 1)
    matrices[1] = 0
    right = torch.ones(3, 2, 2, 1, dtype=torch.float64)
    found = mechanics.solve(matrices.view(3, 2, 2, 2, 2), right)
    torch.testing.assert_close(found[::2], right[::2])
    assert found[1].isnan().all()


@given(st.floats(-30.0, 30.0))
def test_slopes_of_the_trigonometric_ratios(angle):
    x = torch.tensor(angle, dtype=torch.float64, requires_grad=True)
    for ratio, slope in ((se2.sine_ratio, se2.sine_ratio_slope), (se2.cosine_ratio, se2.cosine_ratio_slope)):
        (expected,) = torch.autograd.grad(ratio(x), x)
        torch.testing.assert_close(slope(x).detach(), expected, rtol=1e-12, atol=2e-15)
    assert torch.autograd.gradcheck(se2.sine_ratio_slope, (x,))
    assert torch.autograd.gradcheck(se2.cosine_ratio_slope, (x,))


def test_slopes_at_zero():
    zero = torch.zeros(1, dtype=torch.float64)
    assert se2.sine_ratio_slope(zero) == 0
    assert se2.cosine_ratio_slope(zero) == 0.5
    assert se2.sine_ratio_slope(zero + math.pi) == pytest.approx(-1 / math.pi)
