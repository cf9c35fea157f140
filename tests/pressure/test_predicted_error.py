"""Predicted errors: minima that scipy confirms, equilibria, gradients by differences, failures that say so."""

import numpy as np
import pytest
import torch
from oracle.spatial import SCENES, arm_and_task
from scipy.optimize import minimize

import torcharm as ta

ARMS = {"antagonistic": ta.antagonistic_arm, "bellows": ta.bellows_arm, "muscles": ta.mckibben_arm}


def planar_task(count=12, moment=2.0, nodes=10):
    return ta.Task(ta.affine_curvature(-3.0, 3.0, nodes=nodes), ta.sample_loads(count, (20, 20, moment)))


@pytest.mark.parametrize("name", ARMS)
def test_shapes_predicted_are_equilibria_and_errors_are_those_of_their_poses(name):
    arm, task = ARMS[name](), planar_task()
    found = ta.predict_error(arm, task)
    held = ta.solve_equilibrium(arm, found.pressure, task.tip_load, start=found.twists)
    assert bool(found.stable.all())
    assert bool(held.converged.all())
    torch.testing.assert_close(held.twists, found.twists, rtol=0, atol=1e-8)
    reached, wanted = ta.poses(found.twists), ta.poses(task.twists)
    gap = wanted - reached
    torch.testing.assert_close(found.tip_error, gap[..., -1, :2].norm(dim=-1), rtol=1e-9, atol=1e-12)
    torch.testing.assert_close(found.tip_rotation_error, gap[..., -1, 2].abs(), rtol=1e-9, atol=1e-12)
    square = gap[..., :2].square().sum(-1) + 0.05 * gap[..., 2].square()
    weight = torch.cat((torch.linspace(0, 1, 10, dtype=torch.float64), torch.zeros(1).double()))
    torch.testing.assert_close(found.cost, (weight * square).sum(-1), rtol=1e-9, atol=1e-14)
    torch.testing.assert_close(found.shape_error, ((weight * square).sum(-1) / weight.sum()).sqrt(), rtol=1e-9, atol=0)
    torch.testing.assert_close(found.per_node, square.sqrt(), rtol=1e-9, atol=1e-12)


def test_scipy_finds_no_less_nearby():
    arm, task = ta.bellows_arm(), planar_task(6)
    found = ta.predict_error(arm, task)
    cost, limits = ta.PoseCost(), arm.max_pressure
    for index in range(6):
        load, start = task.tip_load[index], found.twists[index]

        def value(place, load=load, start=start):
            pressure = torch.as_tensor(place).clamp(0, 1) * limits
            held = ta.solve_equilibrium(arm, pressure, load, start=start)
            gap = ta.poses(task.twists) - held.poses
            return float(cost(gap))

        place = (found.pressure[index] / limits).numpy()
        answer = minimize(value, place, method="SLSQP", bounds=[(0, 1)] * 4, options={"maxiter": 30})
        assert answer.fun >= float(found.cost[index]) * (1 - 1e-6)


def test_the_number_of_nodes_does_not_change_what_a_designer_reads():
    few, many = (
        ta.predict_error(
            ta.bellows_arm(),
            ta.Task(ta.affine_curvature(-3.0, 3.0, nodes=nodes), ta.sample_loads(5, (4, 4, 1))),
        )
        for nodes in (20, 40)
    )
    assert bool((few.converged & many.converged).all())
    torch.testing.assert_close(few.tip_error, many.tip_error, rtol=0.08, atol=2e-3)
    torch.testing.assert_close(few.shape_error, many.shape_error, rtol=0.08, atol=2e-3)
    assert bool((many.cost > 1.5 * few.cost).all())


@pytest.mark.parametrize("index", range(len(SCENES)))
def test_in_space_shapes_are_equilibria_of_the_scene(index):
    arm, task = arm_and_task(SCENES[index])
    found = ta.predict_error(arm, task)
    assert found.pose_errors.shape == (task.nodes + 1, 6)
    if not bool(found.stable):
        assert found.status in ("unstable", "impossible")
        assert bool(found.cost.isinf())
        return
    held = ta.solve_equilibrium(
        arm,
        found.pressure,
        task.load,
        task.segment_nodes or task.nodes,
        base_pose=task.base_pose,
        wrench_at=task.wrench_at,
        start=found.twists,
    )
    assert bool(held.converged)
    torch.testing.assert_close(held.twists, found.twists, rtol=0, atol=1e-7)


def differences(function, value, step):
    """Central differences of a scalar function of a tensor."""
    out = torch.zeros_like(value)
    for index in np.ndindex(*value.shape):
        ends = []
        for sign in (1, -1):
            moved = value.clone()
            moved[index] += sign * step
            ends.append(function(moved))
        out[index] = (ends[0] - ends[1]) / (2 * step)
    return out


def test_gradients_of_the_cost_are_those_of_the_minimum():
    given = ta.bellows_arm()
    twists, load = ta.affine_curvature(-1.0, 2.0), torch.tensor([1.0, -2.0, 0.3]).double()
    values = {
        "radii": given.radii.clone(),
        "length": given.length.clone(),
        "limit": given.max_pressure.clone(),
        "twists": twists,
        "load": load,
    }
    steps = {"radii": 1e-5, "length": 1e-5, "limit": 1e-3, "twists": 1e-5, "load": 1e-4}

    def cost(**changed):
        own = {**values, **changed}
        arm = ta.ArmDesign(own["radii"], own["length"], given.actuators, own["limit"])
        return ta.predict_error(arm, ta.Task(own["twists"], own["load"]))

    base = cost()
    assert bool(base.converged)
    for name, step in steps.items():
        leaf = values[name].clone().requires_grad_()
        found = cost(**{name: leaf})
        (gradient,) = torch.autograd.grad(found.cost, leaf)
        theirs = differences(lambda moved, name=name: cost(**{name: moved}).cost, values[name], step)
        torch.testing.assert_close(gradient, theirs, rtol=2e-3, atol=2e-5 * float(theirs.abs().max()) + 1e-9)


def test_gradients_in_space_are_those_of_the_minimum():
    offsets = ta.ring(0.05, 3)
    load = ta.ExternalLoad(torch.tensor([0.4, 1.0, 0.3, 0.0, 0.02, 0.05]).double(), gravity=True)
    twists = torch.tensor([0.45, 0, 0, 0, 0.6, 0.9]).double().expand(6, 6)

    def cost(offsets, twists):
        arm = ta.ArmDesign(offsets=offsets, length=0.42, actuators=ta.Bellows(), mass=0.3)
        return ta.predict_error(arm, ta.Task(twists, load=load))

    leaf, shape = offsets.clone().requires_grad_(), twists.clone().requires_grad_()
    found = cost(leaf, shape)
    assert found.status in ("converged", "not reached")
    gradients = torch.autograd.grad(found.cost, (leaf, shape))
    theirs = differences(lambda moved: cost(moved, twists).cost, offsets, 1e-5)
    torch.testing.assert_close(gradients[0], theirs, rtol=2e-3, atol=2e-4 * float(theirs.abs().max()))
    theirs = differences(lambda moved: cost(offsets, moved).cost, twists, 1e-5)
    torch.testing.assert_close(gradients[1], theirs, rtol=2e-3, atol=2e-4 * float(theirs.abs().max()))


def test_gradients_of_what_did_not_converge_are_no_numbers():
    arm, task = ta.mckibben_arm(), planar_task(20, 5.0)
    found = ta.predict_error(arm, task)
    lost, sure = (~found.converged).nonzero()[0], found.converged.nonzero()[0]
    for index, known in ((lost, False), (sure, True)):
        radii = arm.radii.clone().requires_grad_()
        own = ta.ArmDesign(radii, arm.length, arm.actuators)
        one = ta.predict_error(own, ta.Task(task.twists, task.tip_load[index]))
        (gradient,) = torch.autograd.grad(one.cost.sum(), radii)
        assert bool(gradient.isfinite().all()) == known


def test_impossible_and_unstable_tasks_say_so():
    arm = ta.antagonistic_arm()
    found = ta.predict_error(arm, ta.Task(ta.affine_curvature(0.0, 60.0), [0.0, 0.0, 0.0]))
    assert found.status == "impossible"
    assert bool(found.tip_error.isinf() & found.cost.isinf() & ~found.converged)
    pushed = ta.predict_error(ta.bellows_arm(), ta.Task(ta.affine_curvature(0.0, 0.0), [0.0, 4000.0, 0.0]))
    assert pushed.status in ("unstable", "not converged", "not reached")


def test_batches_are_every_design_on_every_task():
    arm = ta.antagonistic_arm(outer_radius=torch.tensor([0.07, 0.08]).double())
    task = planar_task(3)
    found = ta.predict_error(arm, task)
    assert found.cost.shape == (2, 3)
    one = ta.predict_error(arm[1], ta.Task(task.twists, task.tip_load[2]))
    torch.testing.assert_close(found.cost[1, 2], one.cost, rtol=1e-9, atol=0)
    assert ta.predict_error(arm, ta.Task(task.twists, task.tip_load[:0])).cost.shape == (2, 0)
    single = ta.predict_error(arm.to(torch.float32), task.to(torch.float32))
    assert single.cost.dtype == torch.float32
    torch.testing.assert_close(single.cost.double(), found.cost, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("nodes", [10, 40])
def test_shapes_that_an_arm_has_been_seen_to_hold_are_predicted_to_be_held(nodes):
    """Equilibria at random pressures, reached from rest: half of their pressures are far from those tried first."""
    generator = torch.Generator().manual_seed(3)
    arm = ta.mckibben_arm()
    load = (torch.rand(60, 3, generator=generator, dtype=torch.float64) - 0.5) * torch.tensor(
        [10.0, 10.0, 0.6]
    ).double()
    share = torch.rand(60, 4, generator=generator, dtype=torch.float64)
    pressure = arm.max_pressure * share * (torch.rand(60, 4, generator=generator) > 0.4)
    held = ta.solve_equilibrium(arm, pressure, load, nodes=nodes)
    kept = held.stable & held.continued & held.in_range
    assert kept.sum() > 50
    found = ta.predict_error(arm, ta.Task(held.twists[kept], load[kept]))
    assert found.shape_error.max() < 1e-3
