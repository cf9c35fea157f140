import math
from itertools import permutations

import numpy as np
import pytest
import torch
from hull_cases import unchecked
from scipy.optimize import root

import torcharm as ta
from experiments.benchmark_search import reference
from torcharm.equilibrium import gradient
from torcharm.geometry import rod, se2
from torcharm.geometry.rod import BASE_POSE
from torcharm.statics.balance import balance_residual

ARMS = {
    "antagonistic": (ta.antagonistic_arm(), reference.ANTAGONISTIC),
    "bellows": (ta.bellows_arm(), reference.BELLOWS),
}


def double(values):
    return torch.as_tensor(values, dtype=torch.float64)


def balance(arm, twists, pressure, load, shear=None):
    """R (..., N, C) at twists, in torch."""
    whole, nodes = ta.ExternalLoad(double(load)), (twists.shape[-2],)
    return balance_residual(arm, twists, double(pressure), whole, double(BASE_POSE), nodes, "middle", shear)


def hard_pressures(arm):
    bases = [(50, 0, 0, 0), (1, 1, 1, 1), (1.3, 2.65, 1.59, 4.59), (20, 50, 10, 5), (0, 0, 0, 0)]
    chosen = [order for base in bases for order in sorted(set(permutations(base)))]
    return torch.minimum(double([*chosen, (1000,) * 4]), arm.max_pressure)


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("moment", [2.0, 5.0])
def test_hard_points_converge_or_are_flagged(name, moment):
    arm, _ = ARMS[name]
    pressure, loads = hard_pressures(arm)[::4], ta.sample_loads(100, (20, 20, moment))[::4]
    found = ta.solve_equilibrium(arm, pressure[:, None], loads)
    solved = found.residual <= 1e-10
    assert solved.double().mean() >= 0.995
    scale = torch.maximum(loads[:, :2].norm(dim=-1), loads[:, 2].abs() / 0.5).clamp(min=1)
    miss = balance(arm, found.twists, pressure[:, None], loads)
    size = torch.maximum(miss[..., 0].abs().amax(-1), miss[..., 1].abs().amax(-1) / 0.5) / scale
    soft = solved & (found.strain_excess < 0.3)  # stiffness of strains far out of range counts as load
    torch.testing.assert_close(size[soft], found.residual[soft], rtol=1e-6, atol=1e-12)
    length, curvature = found.twists[..., 0], found.twists[..., 2]
    own = torch.cat((length.unsqueeze(-1), length.unsqueeze(-1) - arm.radii * curvature.unsqueeze(-1)), -1)
    assert torch.equal(found.converged, solved & (own > 0).flatten(2).all(-1))  # a folded arm is no equilibrium
    assert found.converged.double().mean() >= 0.99
    assert not (found.stable & ~found.converged).any()
    assert not (found.continued & ~found.converged).any()


@pytest.mark.parametrize("name", ARMS)
def test_agrees_with_scipy_on_all_equations_and_by_shooting(name):
    arm, other = ARMS[name]
    pressure, loads = hard_pressures(arm)[::13], ta.sample_loads(100, (20, 20, 5))[3::31]
    found = ta.solve_equilibrium(arm, pressure[:, None], loads, wrench_at="start")
    compared = 0
    for i, p in enumerate(pressure.numpy()):
        for j, load in enumerate(loads.numpy()):
            if not found.converged[i, j]:
                continue
            ours = np.concatenate(found.twists[i, j, :, ::2].numpy().T)
            nudged = ours * (1 + 1e-4 * np.sin(np.arange(20)))
            theirs = reference.solve_all(other, p, load, nudged)
            if theirs is not None and np.abs(theirs - ours).max() < 1e-2:  # scipy may leave for another branch
                np.testing.assert_allclose(theirs, ours, rtol=0, atol=1e-7)
                compared += 1
            shot = reference.shoot(other, p, load, nudged)
            if shot is not None:
                np.testing.assert_allclose(shot, ours, rtol=0, atol=1e-6)
                compared += 1
    assert compared >= 30


@pytest.mark.parametrize("name", ARMS)
def test_is_the_branch_that_small_steps_of_the_load_follow(name):
    arm, other = ARMS[name]
    pressure, load = double([20.0, 5.0, 10.0, 10.0]), double([3.0, -4.0, 0.3])
    found = ta.solve_equilibrium(arm, pressure, load, wrench_at="start")
    assert found.continued
    theirs = reference.continue_all(other, pressure.numpy(), load.numpy(), 10)
    np.testing.assert_allclose(theirs, np.concatenate(found.twists[:, ::2].numpy().T), rtol=0, atol=1e-8)


def test_no_load_and_equal_pressures_only_change_the_length():
    spring = ta.PolynomialActuator(((1, 0, -40.0), (0, 1, 0.8)), (-0.5, 0.5), (0.0, 60.0), 60.0)
    arm = ta.ArmDesign([-0.05, 0.0, 0.05], 0.4, [spring] * 3)
    found = ta.solve_equilibrium(arm, [10.0] * 3, [0.0] * 3, nodes=4)
    torch.testing.assert_close(found.twists[:, 0], torch.full((4,), 0.4 * (1 + 0.8 * 10 / 40)).double())
    torch.testing.assert_close(found.twists[:, 1:], torch.zeros(4, 2).double(), rtol=0, atol=1e-12)


def test_a_tip_moment_bends_to_a_circle():
    """Linear springs: `m = κ (2 k r²/l̂ - K Σ p/p_ref / l)`, at the length without load."""
    spring = ta.PolynomialActuator(((1, 0, -40.0),), (-0.5, 0.5), (0.0, 60.0), 60.0, bending_stiffness=0.0)
    arm = ta.ArmDesign([-0.05, 0.05], 0.4, [spring] * 2)
    found = ta.solve_equilibrium(arm, [0.0, 0.0], [0.0, 0.0, 0.6], nodes=5)
    expected = 0.6 / (2 * 40 * 0.05**2 / 0.4)
    torch.testing.assert_close(found.twists[:, 2], torch.full((5,), expected).double())
    torch.testing.assert_close(found.twists[:, 0], torch.full((5,), 0.4).double())
    assert found.poses[-1, 2] == pytest.approx(-math.pi / 2 + expected)


def test_small_loads_move_the_tip_by_the_linear_compliance():
    arm, pressure = ta.antagonistic_arm(), double([20.0, 30.0, 20.0, 25.0])
    rest = ta.solve_equilibrium(arm, pressure, [0.0, 0.0, 0.0]).twists
    none, unit = torch.zeros(3, dtype=torch.float64), torch.eye(3, dtype=torch.float64)
    by_twist, by_load = torch.autograd.functional.jacobian(
        lambda *at: balance(arm, at[0], pressure, at[1]), (rest, none)
    )
    by_twist = by_twist[..., ::2].flatten(2).flatten(0, 1)
    by_tip = torch.autograd.functional.jacobian(lambda twists: rod.poses(twists)[-1], rest)[..., ::2].flatten(1)
    compliance = -by_tip @ torch.linalg.solve(by_twist, by_load.flatten(0, 1))
    small = 1e-3
    ahead, back = (ta.solve_equilibrium(arm, pressure, sign * small * unit, tolerance=1e-12) for sign in (1, -1))
    slope = (ahead.poses[:, -1] - back.poses[:, -1]).T / (2 * small)
    torch.testing.assert_close(slope, compliance, rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize(("wrench_at", "order"), [("start", 1), ("middle", 2)])
def test_refinement_converges_at_its_order_to_what_scipy_finds(wrench_at, order):
    arm, pressure, load = ta.antagonistic_arm(), double([20.0, 30.0, 20.0, 25.0]), double([2.0, -3.0, 0.1])
    tips = []
    for nodes in (5, 10, 20, 40):
        found = ta.solve_equilibrium(arm, pressure, load, nodes, wrench_at=wrench_at)
        tips.append(found.poses[-1].numpy())
        start = np.concatenate(found.twists[:, ::2].numpy().T) * 1.001
        given = (reference.ANTAGONISTIC, pressure.numpy(), load.numpy(), wrench_at == "middle")
        answer = root(reference.imbalance, start, given, options={"xtol": 1e-13})
        assert np.abs(answer.fun).max() < 1e-9
        np.testing.assert_allclose(reference.march(*np.split(answer.x, 2))[-1], tips[-1], rtol=0, atol=1e-8)
    gaps = np.linalg.norm(np.diff(tips, axis=0), axis=1)
    np.testing.assert_allclose(np.log2(gaps[:-1] / gaps[1:]), order, atol=0.2)


def test_finite_shear_gives_way_to_the_load_and_vanishes_when_stiff():
    arm, pressure, load = ta.antagonistic_arm(), [20.0, 30.0, 20.0, 25.0], [2.0, -3.0, 0.1]
    soft = ta.solve_equilibrium(arm, pressure, load, shear_stiffness=1e3)
    assert soft.converged
    assert balance(arm, soft.twists, pressure, load, 1e3).abs().max() < 1e-8
    across = -ta.required_wrench(soft.twists, double(load))[:, 1]
    torch.testing.assert_close(soft.twists[:, 1], across / 4e3, rtol=1e-7, atol=1e-12)
    stiff = ta.solve_equilibrium(arm, pressure, load, shear_stiffness=1e9)
    rigid = ta.solve_equilibrium(arm, pressure, load)
    torch.testing.assert_close(stiff.poses, rigid.poses, rtol=0, atol=1e-7)
    assert (soft.poses - rigid.poses).abs().max() > 1e-4


@pytest.mark.parametrize("shear", [None, 500.0])
def test_gradients_by_finite_differences(shear):
    arm = ta.antagonistic_arm()
    inputs = [
        double([20.0, 30.0, 20.0, 25.0]),
        double([2.0, -3.0, 0.1]),
        arm.radii.clone(),
        double([0.5, 0.49, 0.5, 0.51]),
        double(BASE_POSE),
    ]

    def twists(pressure, load, radii, lengths, base):
        design = ta.ArmDesign(radii, lengths, arm.actuators)
        found = ta.solve_equilibrium(design, pressure, load, 3, base_pose=base, shear_stiffness=shear, tolerance=1e-12)
        assert found.converged
        return found.twists

    leaves = [value.requires_grad_() for value in inputs]
    assert torch.autograd.gradcheck(twists, leaves, eps=1e-5, atol=1e-6, rtol=1e-4)
    (gradient,) = torch.autograd.grad(twists(*leaves).square().sum(), leaves[:1], create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        gradient.sum().backward()


def test_gradients_are_the_same_in_parts(monkeypatch):
    arm, loads = ta.bellows_arm(), ta.sample_loads(7)
    pressure, slopes = double([20.0, 10.0, 5.0, 30.0]).requires_grad_(), []
    for count in (gradient.AT_ONCE, 3):
        monkeypatch.setattr(gradient, "AT_ONCE", count)
        found = ta.solve_equilibrium(arm, pressure, loads)
        slopes.append(torch.autograd.grad(found.poses[:, -1].square().sum(), pressure)[0])
    torch.testing.assert_close(*slopes)


def unanswerable():
    """A force without bound is asked for: no shape can bear it."""
    weak = ta.PolynomialActuator(((1, 0, -4.0), (3, 0, 4.0)), (-0.5, 0.5), (0.0, 60.0), 60.0, bending_stiffness=0.0)
    return ta.ArmDesign([-0.05, 0.05], 0.4, [weak] * 2), [[0.0, -1.0, 0.0], [0.0, -500.0, 0.0]]


def test_what_has_no_equilibrium_is_flagged_and_has_no_gradient():
    arm, loads = unanswerable()
    loads = double(loads).requires_grad_()
    found = ta.solve_equilibrium(arm, [0.0, 0.0], loads, nodes=3)
    assert found.converged.tolist() == [True, False]
    assert found.residual[1] > 1e-3
    (slope,) = torch.autograd.grad(found.twists.sum(), loads, retain_graph=True)
    assert slope[0].isfinite().all()
    assert slope[1].isnan().all()
    (slope,) = torch.autograd.grad(found.twists[found.converged].sum(), loads)
    assert slope.isfinite().all()
    with pytest.raises(ta.NotConvergedError, match="1 of 2 equilibria"):
        ta.solve_equilibrium(arm, [0.0, 0.0], loads, nodes=3, raise_on_failure=True)


def test_batches_broadcast_and_agree_with_single_calls():
    arm = ta.antagonistic_arm(double([[0.06], [0.08]]))
    pressure, loads = (
        double([[20.0, 30.0, 20.0, 25.0], [5.0, 0.0, 50.0, 30.0], [0.0, 0.0, 0.0, 0.0]]),
        ta.sample_loads(3),
    )
    found = ta.solve_equilibrium(arm, pressure, loads, nodes=6)
    assert found.twists.shape == (2, 3, 6, 3)
    assert found.poses.shape == (2, 3, 7, 3)
    for i in range(2):
        for j in range(3):
            one = ta.solve_equilibrium(arm[i, 0], pressure[j], loads[j], nodes=6)
            torch.testing.assert_close(found.twists[i, j], one.twists, rtol=0, atol=1e-8)
            assert one.residual.shape == ()


def test_an_empty_batch():
    found = ta.solve_equilibrium(ta.bellows_arm(), torch.zeros(0, 4), [1.0, 0.0, 0.0], nodes=2)
    assert found.twists.shape == (0, 2, 3)
    assert found.converged.shape == (0,)


def test_mirrored_arms_take_mirrored_shapes():
    arm, pressure, load = ta.antagonistic_arm(), double([20.0, 30.0, 10.0, 5.0]), double([2.0, -3.0, 0.1])
    found = ta.solve_equilibrium(arm, pressure, load)
    mirror = ta.solve_equilibrium(arm, pressure.flip(0), load * double([-1.0, 1.0, -1.0]))
    torch.testing.assert_close(mirror.twists, found.twists * double([1.0, -1.0, -1.0]), rtol=0, atol=1e-8)


def test_turning_base_and_load_turns_the_arm():
    arm, pressure, load = ta.antagonistic_arm(), [20.0, 30.0, 10.0, 5.0], double([2.0, -3.0, 0.1])
    angle = 0.7
    turned = torch.cat((se2.turned(double(angle), load[:2]), load[2:]))
    found = ta.solve_equilibrium(arm, pressure, load)
    other = ta.solve_equilibrium(arm, pressure, turned, base_pose=[0.3, -0.2, -math.pi / 2 + angle])
    torch.testing.assert_close(found.twists, other.twists, rtol=0, atol=1e-8)


def test_the_order_of_actuators_does_not_matter():
    arm, pressure, load = ta.antagonistic_arm(), double([20.0, 30.0, 10.0, 5.0]), [2.0, -3.0, 0.1]
    order = [2, 0, 3, 1]
    other = ta.ArmDesign(arm.radii[order], 0.5, [arm.actuators[i] for i in order])
    found, shuffled = (ta.solve_equilibrium(a, p, load) for a, p in ((arm, pressure), (other, pressure[order])))
    torch.testing.assert_close(found.twists, shuffled.twists, rtol=0, atol=1e-8)


def test_a_warm_start_finds_the_equilibrium_nearby():
    arm, pressure, load = ta.antagonistic_arm(), [20.0, 30.0, 10.0, 5.0], double([2.0, -3.0, 0.1])
    near = ta.solve_equilibrium(arm, pressure, load * 0.9)
    found = ta.solve_equilibrium(arm, pressure, load, start=near.twists)
    torch.testing.assert_close(found.twists, ta.solve_equilibrium(arm, pressure, load).twists, rtol=0, atol=1e-8)
    assert found.converged
    assert not found.continued


def test_single_precision():
    arm = ta.ArmDesign(*(x.float() for x in (ta.bellows_arm().radii, ta.bellows_arm().length)), [ta.Bellows()] * 4)
    pressure, loads = torch.tensor([20.0, 10.0, 5.0, 30.0]), ta.sample_loads(20)
    found = ta.solve_equilibrium(arm, pressure, loads.float())
    exact = ta.solve_equilibrium(ta.bellows_arm(), pressure.double(), loads)
    assert found.twists.dtype == torch.float32
    assert found.converged.all()
    torch.testing.assert_close(found.poses.double(), exact.poses, rtol=0, atol=2e-3)


def test_strains_and_pressures_out_of_range_are_reported():
    found = ta.solve_equilibrium(
        ta.bellows_arm(), [[5.0] * 4, [5.0] * 4, [93.0] * 4], [[0.0] * 3, [0.0, -60.0, 0.0], [0.0] * 3]
    )
    assert found.in_range.tolist() == [True, False, False]
    assert found.strain_excess[0] == 0
    assert found.strain_excess[1] > 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"pressure": [1.0, 2.0]}, "pressure: must have shape"),
        ({"pressure": [-1.0, 0.0, 0.0, 0.0]}, "pressure: must be at least 0 kPa, as vacuum is not supported, got -1"),
        ({"load": [0.0, float("nan"), 0.0]}, "load: must be finite, got nan"),
        ({"load": [0.0, 1e200, 0.0]}, r"load: must be finite, and at most 1.3e\+150 in size, got 1e\+200"),
        ({"raise_on_failure": "yes"}, "raise_on_failure: must be True or False, got 'yes'"),
        ({"nodes": 0}, "nodes: must be an integer of at least 1"),
        ({"shear_stiffness": 0.0}, "shear_stiffness: must be a finite number above 0"),
        ({"tolerance": -1.0}, "tolerance: must be"),
        ({"arm": None}, "arm: must be an ArmDesign or an ArmSeries, got None"),
        ({"nodes": [5, 5]}, "nodes: must be one number, or one for each of 1 segments"),
        ({"wrench_at": "end"}, "wrench_at: must be one of start, middle, got 'end'"),
        ({"load": [0.0] * 6}, r"load: must have shape \(..., 3\), got \(6,\)"),
        ({"load": ta.ExternalLoad([0.0] * 6)}, "load: must be of 3 components as the arm is, got 6"),
        ({"pressure": torch.zeros(2, 4), "load": torch.zeros(3, 3)}, "batch shapes do not broadcast"),
    ],
)
def test_bad_input(change, message):
    given = {"arm": ta.bellows_arm(), "pressure": [1.0] * 4, "load": [0.0] * 3} | change
    with unchecked(), pytest.raises(ValueError, match=message):
        ta.solve_equilibrium(**given)
