import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize, root

import torcharm as ta
from torcharm import mechanics
from torcharm._box import optimality
from torcharm._box_least_squares import Model, box_step, minimise
from torcharm._response import Points, pose_errors, settle
from torcharm.geometry import se2
from torcharm.geometry.rod import BASE_POSE

BASE = torch.tensor(BASE_POSE, dtype=torch.float64)
ARMS = {"antagonistic": ta.antagonistic_arm(), "bellows": ta.bellows_arm(), "muscle": ta.mckibben_arm()}
MIXED = ta.ArmDesign(
    [-0.07, -0.01, 0.02, 0.03, 0.08],
    [0.5, 0.45, 0.52, 0.48, 0.55],
    [ta.Bellows(), ta.McKibben(), ta.McKibben(bending_stiffness=0.0), ta.Bellows(force_scale=0.5), ta.McKibben()],
)

BENT = ta.ArmDesign(
    MIXED.radii,
    MIXED.length,
    [
        ta.Bellows(bending_stiffness=ta.ConstantBending(-0.2)),
        ta.McKibben(bending_stiffness=ta.BendingFunction(lambda k, p: -(0.1 + 0.002 * p) * k**3, 50.0)),
        ta.McKibben(bending_stiffness=0.0),
        ta.Bellows(bending_stiffness=ta.LinearBending(-0.3, 20.0)),
        ta.McKibben(),
    ],
)


def predict(arm, task, **options):
    return ta.predict_error(arm, task, **options)


def resting_error(arm, twists, load, pressure, start, linear=False):
    """The square root of the paper's cost where scipy finds the balance from a start, and whether the arm stays there.

    The balance is written with public functions, its derivatives are autograd's. A linear load is carried to first
    order from `twists`.
    """
    shape, pressure = mechanics.to_unknowns(twists), torch.as_tensor(pressure, dtype=torch.float64)

    def required(z):
        return ta.required_wrench(mechanics.to_twists(z), load)[..., [0, 2]].T

    def residual(z):
        reaction = ta.reaction_wrench(arm, mechanics.to_twists(z), pressure).T
        if linear:
            return reaction - required(shape) - torch.func.jvp(required, (shape,), (z - shape,))[1]
        return reaction - required(z)

    def flat(z):
        return residual(torch.as_tensor(z).view_as(shape)).flatten().numpy()

    def slope(z):
        z = torch.as_tensor(z).view_as(shape)
        return torch.autograd.functional.jacobian(residual, z).flatten(2).flatten(0, 1).numpy()

    found = root(flat, mechanics.to_unknowns(start).flatten().numpy(), jac=slope, tol=1e-12)
    stiffness = slope(found.x)
    error = se2.compose(
        se2.inverse(ta.poses(mechanics.to_twists(torch.as_tensor(found.x).view_as(shape)))), ta.poses(twists)
    )
    kinds = torch.tensor([1.0, 1.0, 0.05], dtype=torch.float64)
    weight = torch.linspace(0, 1, len(twists), dtype=torch.float64).unsqueeze(-1) * kinds
    definite = bool((np.linalg.eigvalsh(stiffness + stiffness.T) < 0).all())
    balanced = bool(np.abs(flat(found.x)).max() < 1e-7)
    return math.sqrt(float((weight * error[:-1].square()).sum())), definite and balanced


# What is predicted


@pytest.mark.parametrize("steps", [None, 1])
@pytest.mark.parametrize("name", [*ARMS, "bent"])
def test_error_is_that_of_a_balance_written_independently(name, steps):
    arm = (ARMS | {"bent": BENT})[name]
    twists, loads = ta.affine_curvature(1.0, 1.5), ta.sample_loads(6)
    found = predict(arm, ta.Task(twists, loads), steps=steps)
    for row, load in enumerate(loads):
        expected, stays = resting_error(
            arm, twists, load, found.pressure[row], found.twists[row], linear=steps is not None
        )
        assert float(found.error[row]) == pytest.approx(expected, rel=1e-7)
        assert bool(found.stable[row]) == stays


def test_no_other_pressure_does_better_by_scipy():
    arm, twists = ta.antagonistic_arm(), ta.affine_curvature(-1.0, 1.0)
    limit = arm.max_pressure.numpy()
    for load in ta.sample_loads(40, (20.0, 20.0, 5.0))[:4]:
        found = predict(arm, ta.Task(twists, load))

        def objective(share, load=load, start=found.twists):
            error, stays = resting_error(arm, twists, load, share * limit, start)
            return error**2 if stays else 10.0

        start = (found.pressure / arm.max_pressure).numpy()
        again = minimize(objective, start, method="L-BFGS-B", bounds=[(0, 1)] * 4, options={"maxiter": 40})
        assert float(found.error) <= math.sqrt(again.fun) * (1 + 1e-3) + 1e-9


def held_tasks(arm, seed, count=100):
    """Shapes that the arm holds at known pressures, stably, with their loads."""
    generator = torch.Generator().manual_seed(seed)
    share = 0.1 + 0.8 * torch.rand(count, arm.actuator_count, generator=generator, dtype=torch.float64)
    loads = ta.sample_loads(count, (6.0, 6.0, 1.0), seed=seed)
    made = ta.solve_equilibrium(arm, share * arm.max_pressure, loads, 6)
    balance = mechanics.balance(arm, mechanics.to_unknowns(made.twists), share * arm.max_pressure, loads, BASE)
    flat = balance.stiffness.flatten(3).flatten(1, 2)
    usable = made.converged & (torch.linalg.eigvalsh(flat + flat.mT) < 0).all(-1)
    assert usable.sum() >= 0.98 * count
    return made.twists[usable], loads[usable]


@pytest.mark.parametrize("seed", [100, 3, 4])
@pytest.mark.parametrize("name", ["antagonistic", "bellows"])
def test_the_error_is_zero_where_the_task_is_an_equilibrium(name, seed):
    arm = ARMS[name]
    twists, loads = held_tasks(arm, seed)
    found = predict(arm, ta.Task(twists, loads))
    assert bool((found.error <= 1e-8).all())
    assert bool((found.converged & found.stable).all())
    again = ta.solve_equilibrium(arm, found.pressure, loads, 6, start=twists)
    assert bool(again.converged.all())
    torch.testing.assert_close(again.twists, twists, rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", ["antagonistic", "bellows"])
def test_the_error_of_a_linear_load_is_zero_there_too(name):
    twists, loads = held_tasks(ARMS[name], 5, 40)
    for steps in (1, 2):
        assert bool((predict(ARMS[name], ta.Task(twists, loads), steps=steps).error <= 1e-8).all())


def test_the_shape_predicted_is_an_equilibrium_of_the_forward_solver():
    arm, loads = ta.antagonistic_arm(), ta.sample_loads(12)
    task = ta.Task(ta.affine_curvature(1.0, 1.5), loads)
    found = predict(arm, task)
    forward = ta.solve_equilibrium(arm, found.pressure, loads, start=found.twists)
    assert bool((forward.converged & found.stable).all())
    torch.testing.assert_close(forward.twists, found.twists, rtol=0, atol=1e-6)
    cost = ta.PoseCost()(mechanics.pose_error(forward.poses, ta.poses(task.twists))[0])
    torch.testing.assert_close(found.error, cost.sqrt(), rtol=1e-6, atol=1e-9)


def test_steps_end_at_the_balance_itself():
    arm, loads = ta.antagonistic_arm(), ta.sample_loads(12)
    task = ta.Task(ta.affine_curvature(1.0, 1.5), loads)
    exact = predict(arm, task).error
    off = [((predict(arm, task, steps=steps).error - exact).abs() / exact).median() for steps in (1, 2, 4)]
    assert off[0] > off[1] > off[2]
    assert off[2] < 1e-4


def test_unstable_pressures_are_avoided_and_flagged_where_there_are_no_others():
    twists, loads = ta.affine_curvature(-3.0, 3.0), ta.sample_loads(100)
    found = predict(ta.bellows_arm(), ta.Task(twists, loads))
    assert found.stable.double().mean() >= 0.99
    # a straight column of bellows under twenty times the load that it can bear
    pushed = predict(ta.bellows_arm(), ta.Task(ta.affine_curvature(0.0, 0.0), [0.0, 100.0, 0.0]))
    assert not bool(pushed.stable)


def test_fits_in_wrench_space_follow_curved_valleys():
    """Four bellows of one kind: pressures of nearly no effect lie along a curve, along which plain steps creep."""
    twists, loads = held_tasks(ARMS["bellows"], 3)
    assert bool((ta.fit_pressure(ARMS["bellows"], ta.Task(twists[:30], loads[:30])).distance < 1e-8).all())


# Options and shapes


def test_evaluate_asks_for_what_is_wanted_only():
    arm, task = ta.antagonistic_arm(), ta.Task(ta.affine_curvature(1.0, 1.5), ta.sample_loads(5))
    only = ta.evaluate(arm, task, metrics=("predicted_error",))
    assert only.absolute is None
    assert only.relative is None
    both = ta.evaluate(arm, task, metrics=("absolute", "predicted_error"))
    hulls = ta.evaluate(arm, task, metrics=("absolute",))
    assert hulls.predicted_error is None
    assert hulls.prediction is None
    torch.testing.assert_close(both.predicted_error, only.predicted_error)
    torch.testing.assert_close(both.absolute, hulls.absolute)
    torch.testing.assert_close(only.strain_excess, hulls.strain_excess)
    assert torch.equal(only.in_range, hulls.in_range)
    own = predict(arm, task)
    torch.testing.assert_close(only.predicted_error, own.error)
    torch.testing.assert_close(only.predicted_pressure, own.pressure)
    torch.testing.assert_close(only.predicted_error_per_node, own.per_node)
    assert torch.equal(only.converged, own.converged & own.stable)


def test_fields_agree_with_each_other():
    arm, task = ta.antagonistic_arm(), ta.Task(ta.affine_curvature(-3.0, 3.0), ta.sample_loads(7))
    for cost in (ta.PoseCost(), ta.PoseCost("tip"), ta.PoseCost("uniform", (1.0, 1.0, 0.0))):
        found = predict(arm, task, pose_cost=cost)
        torch.testing.assert_close(found.error, cost(found.pose_errors).sqrt())
        reached = ta.poses(found.twists)
        torch.testing.assert_close(found.pose_errors, mechanics.pose_error(reached, ta.poses(task.twists))[0])
        part = (found.pose_errors.square() * cost.diagonal(found.error)).sum(-1).sqrt()
        torch.testing.assert_close(found.per_node, part)
        assert bool(((found.pressure >= 0) & (found.pressure <= arm.max_pressure)).all())
    tip = predict(arm, task, pose_cost=ta.PoseCost("tip", (1.0, 1.0, 0.0)))
    torch.testing.assert_close(tip.error, tip.pose_errors[:, -1, :2].norm(dim=-1))


@pytest.mark.parametrize("steps", [None, 2])
def test_designs_shapes_and_loads_are_an_outer_product_in_any_chunks(steps):
    designs = ta.antagonistic_arm(torch.tensor([0.06, 0.07, 0.08]).double())
    shapes = ta.affine_curvature(torch.tensor([[1.0], [-3.0]]).double(), 1.5)
    task = ta.Task(shapes, ta.sample_loads(4))
    whole = predict(designs, task, steps=steps)
    assert whole.error.shape == (3, 2, 4)
    assert whole.per_node.shape == (3, 2, 4, 11)
    assert whole.pressure.shape == (3, 2, 4, 4)
    assert whole.twists.shape == (3, 2, 4, 10, 3)
    parts = predict(designs, task, steps=steps, chunk_size=5)
    torch.testing.assert_close(parts.error, whole.error, rtol=1e-6, atol=1e-9)
    single = predict(designs[1], ta.Task(shapes[1, 0], ta.sample_loads(4)[2]), steps=steps)
    torch.testing.assert_close(single.error, whole.error[1, 1, 2], rtol=1e-6, atol=1e-9)


def test_no_tasks_at_all():
    found = ta.evaluate(
        ta.antagonistic_arm(), ta.Task(ta.affine_curvature(1.0, 1.5), ta.sample_loads(0)), metrics=("predicted_error",)
    )
    assert found.predicted_error.shape == (0,)
    assert found.predicted_pressure.shape == (0, 4)
    assert found.predicted_error_per_node.shape == (0, 11)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"steps": 0}, "steps"),
        ({"pose_cost": ta.PoseCost((1.0, 1.0))}, "node_weights"),
        ({"chunk_size": 0}, "chunk_size"),
    ],
)
def test_mistakes_are_named(options, named):
    task = ta.Task(ta.affine_curvature(1.0, 1.5), [1.0, 0.0, 0.0])
    with pytest.raises(ValueError, match=named):
        ta.predict_error(ta.antagonistic_arm(), task, **options)
    with pytest.raises(ValueError, match=named):
        ta.evaluate(ta.antagonistic_arm(), task, metrics=("predicted_error",), **options)


# Invariances


@settings(max_examples=8, deadline=None)
@given(st.floats(-3.0, 3.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_a_change_of_frame_changes_nothing(turn, x, y):
    arm, twists = ta.antagonistic_arm(), ta.affine_curvature(1.0, 1.5, nodes=5)
    loads = ta.sample_loads(3)
    plain = predict(arm, ta.Task(twists, loads))
    change = torch.tensor([x, y, turn], dtype=torch.float64)
    moved = torch.cat((se2.turned(change[2:], loads[:, :2]), loads[:, 2:]), -1)
    seen = predict(arm, ta.Task(twists, moved, se2.compose(change, BASE)))
    usable = plain.converged & seen.converged
    torch.testing.assert_close(seen.error[usable], plain.error[usable], rtol=1e-5, atol=1e-9)


def test_a_mirror_image_mirrors_pressures():
    arm, twists, loads = ta.antagonistic_arm(), ta.affine_curvature(1.0, 1.5), ta.sample_loads(8)
    plain = predict(arm, ta.Task(twists, loads))
    turned = twists * torch.tensor([1.0, 1.0, -1.0])
    mirror = ta.ArmDesign(-arm.radii, arm.length, arm.actuators, arm.max_pressure)
    # the arm hangs: across the vertical, forces along x and moments change sign
    seen = predict(mirror, ta.Task(turned, loads * torch.tensor([-1.0, 1.0, -1.0])))
    torch.testing.assert_close(seen.error, plain.error, rtol=1e-6, atol=1e-9)
    usable = plain.converged & (plain.error > 1e-6)
    torch.testing.assert_close(seen.pressure[usable], plain.pressure[usable], rtol=1e-4, atol=1e-3)


def test_scaling_forces_and_loads_together_changes_nothing():
    loads, twists = ta.sample_loads(6), ta.affine_curvature(1.0, 1.5)
    errors = []
    for scale in (1.0, 1000.0):
        kinds = [
            ta.Bellows(force_scale=scale, bending_stiffness=-scale / 3.5),
            ta.Bellows(force_scale=scale, bending_stiffness=-scale / 3.5),
        ]
        arm = ta.ArmDesign([-0.08, 0.08], 0.5, kinds)
        errors.append(predict(arm, ta.Task(twists, scale * loads)).error)
    torch.testing.assert_close(errors[1], errors[0], rtol=1e-6, atol=1e-9)


def test_actuators_in_another_order():
    order = [3, 0, 4, 2, 1]
    other = ta.ArmDesign(
        MIXED.radii[order], MIXED.length[order], [MIXED.actuators[i] for i in order], MIXED.max_pressure[order]
    )
    unknowns = mechanics.to_unknowns(ta.affine_curvature(1.0, 0.5)).unsqueeze(0)
    target, load = ta.poses(ta.affine_curvature(1.0, 0.5)).unsqueeze(0), torch.tensor([[2.0, -1.0, 0.3]]).double()
    pressure = 0.4 * MIXED.max_pressure.unsqueeze(0)
    rests = [
        settle(Points.of(arm.flatten(), unknowns, target, BASE, load, True), at, unknowns, 30, torch.tensor([1e-9]))
        for arm, at in ((MIXED, pressure), (other, pressure[:, order]))
    ]
    assert bool((rests[0].settled & rests[1].settled).all())
    torch.testing.assert_close(rests[1].unknowns, rests[0].unknowns)
    torch.testing.assert_close(rests[1].rate, rests[0].rate[..., order])


def test_float32_within_its_own_tolerance():
    arm, task = ta.antagonistic_arm(), ta.Task(ta.affine_curvature(1.0, 1.5), ta.sample_loads(20))
    double = predict(arm, task)
    single = predict(arm._map(torch.Tensor.float), task.to(torch.float32))
    assert single.error.dtype == torch.float32
    close = (single.error.double() - double.error).abs() <= 2e-2 * double.error + 1e-3
    assert close.double().mean() >= 0.9


# Extreme scenes: whatever is not a trustworthy number says so


@pytest.mark.parametrize("shape", [(40.0, -20.0, 0.5), (0.0, 0.0, 1e-3), (0.0, 30.0, 0.5), (0.0, 0.0, 50.0)])
@pytest.mark.parametrize("load", [(0.0, 0.0, 0.0), (1e6, -1e6, 1e5), (1e-12, 0.0, 0.0), (0.0, 500.0, 0.0)])
def test_extreme_tasks_are_answered_or_flagged(shape, load):
    slope, intercept, length = shape
    task = ta.Task(ta.affine_curvature(slope, intercept, length=length), list(load))
    for arm in (*ARMS.values(), MIXED):
        found = ta.evaluate(arm, task, metrics=("predicted_error",), steps=2)
        prediction = found.prediction
        trusted = prediction.converged & prediction.stable & prediction.small & prediction.in_range & found.in_range
        assert not bool(trusted) or float(found.predicted_error) < 5.0
        if bool(found.converged):
            assert bool(found.predicted_error.isfinite())
        assert bool(prediction.pressure.isfinite().all())


def test_limits_of_zero_and_force_models_without_pressure():
    task = ta.Task(ta.affine_curvature(0.0, 0.5), [0.5, -1.0, 0.0])
    idle = ta.ArmDesign([-0.08, 0.08], 0.5, [ta.Bellows(), ta.Bellows()], [0.0, 0.0])
    found = predict(idle, task)
    assert bool(found.converged)
    assert found.pressure.tolist() == [0.0, 0.0]
    expected, _ = resting_error(idle, task.twists, task.tip_load, [0.0, 0.0], found.twists)
    assert float(found.error) == pytest.approx(expected, rel=1e-7)
    spring = ta.PolynomialActuator(((1, 0, -40.0),), (-0.5, 0.5), (0.0, 50.0), 50.0, bending_stiffness=0.0)
    assert bool(predict(ta.ArmDesign([-0.05, 0.05], 0.5, [spring, spring]), task).converged)


def test_a_singular_stiffness_is_no_answer():
    push = ta.PolynomialActuator(((0, 1, 1.0),), (-0.5, 0.5), (0.0, 50.0), 50.0, bending_stiffness=0.0)
    arm = ta.ArmDesign([-0.05, 0.05], 0.5, [push, push])
    found = predict(arm, ta.Task(ta.affine_curvature(0.0, 0.5), [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    assert not bool(found.converged.any())
    assert not bool(found.stable.any())


@pytest.mark.parametrize("actuators", [1, 2, 7, 12])
@pytest.mark.parametrize("nodes", [2, 15])
def test_any_number_of_actuators_and_nodes(actuators, nodes):
    kinds = [ta.Bellows() if index % 2 == 0 else ta.McKibben() for index in range(actuators)]
    arm = ta.ArmDesign(torch.linspace(-0.08, 0.07, actuators, dtype=torch.float64), 0.5, kinds)
    twists, loads = ta.affine_curvature(0.5, 0.5, nodes=nodes), ta.sample_loads(3, (2.0, 2.0, 0.2))
    found = predict(arm, ta.Task(twists, loads))
    for row, load in enumerate(loads):
        expected, stays = resting_error(arm, twists, load, found.pressure[row], found.twists[row])
        assert float(found.error[row]) == pytest.approx(expected, rel=1e-7, abs=1e-9)
        assert bool(found.stable[row]) == stays


# Gradients


def gradient_scene(arm, load, shape):
    twists = ta.affine_curvature(*shape, nodes=5)
    inputs = [
        arm.radii.clone(),
        arm.length.clone(),
        arm.max_pressure.clone(),
        mechanics.to_unknowns(twists),
        torch.tensor(load, dtype=torch.float64),
    ]

    def error(radii, length, limit, unknowns, tip_load):
        design = ta.ArmDesign(radii, length, arm.actuators, limit)
        task = ta.Task(mechanics.to_twists(unknowns), tip_load)
        return ta.evaluate(design, task, metrics=("predicted_error",)).predicted_error

    return error, [value.requires_grad_() for value in inputs]


@pytest.mark.parametrize(
    ("name", "load", "shape"),
    [
        ("bellows", (3.0, -2.0, 0.5), (1.0, 1.5)),
        ("bellows", (4.0, -5.0, 0.0), (-1.0, 1.0)),
        ("antagonistic", (-6.0, -9.0, -0.8), (1.0, 1.5)),
    ],
)
def test_gradients_by_the_envelope_theorem_are_those_of_the_minimum(name, load, shape):
    error, inputs = gradient_scene(ARMS[name], load, shape)
    task = ta.Task(mechanics.to_twists(inputs[3].detach()), inputs[4].detach())
    found = predict(ARMS[name], task)
    assert bool(found.converged)
    assert float(found.error) > 1e-3
    assert torch.autograd.gradcheck(error, inputs, eps=1e-5, atol=2e-5, rtol=1e-3)


def test_gradients_of_a_linear_load_against_differences():
    arm, twists = ta.bellows_arm(), ta.affine_curvature(1.0, 1.5, nodes=5)
    load = torch.tensor([3.0, -2.0, 0.5], dtype=torch.float64, requires_grad=True)
    found = predict(arm, ta.Task(twists, load), steps=1)
    assert bool(found.converged)
    (slope,) = torch.autograd.grad(found.error, load)
    for index in range(3):
        step = torch.zeros(3, dtype=torch.float64)
        step[index] = 1e-5
        ends = [predict(arm, ta.Task(twists, load.detach() + s * step), steps=1).error for s in (1, -1)]
        assert float(slope[index]) == pytest.approx(float((ends[0] - ends[1]) / 2e-5), rel=1e-3, abs=1e-6)


def test_an_actuator_at_its_limit_moves_with_it():
    arm = ta.bellows_arm()
    limit = arm.max_pressure.clone().requires_grad_()
    design = ta.ArmDesign(arm.radii, arm.length, arm.actuators, limit)
    found = predict(design, ta.Task(ta.affine_curvature(-3.0, 3.0), [1.8, -7.2, 0.6]))
    at = (found.pressure >= limit).detach()
    assert bool(at.any())
    (slope,) = torch.autograd.grad(found.error, limit)
    assert bool((slope[at] != 0).all())
    assert bool((slope[~at] == 0).all())


def test_no_gradient_of_nothing_and_none_of_nan():
    arm = ta.antagonistic_arm()
    loads = torch.tensor([[0.5, 0.2, 0.01]], dtype=torch.float64)
    made = ta.solve_equilibrium(arm, 0.4 * arm.max_pressure, loads)
    radii = arm.radii.clone().requires_grad_()
    design = ta.ArmDesign(radii, arm.length, arm.actuators, arm.max_pressure)
    task = ta.Task(
        torch.cat((made.twists, ta.affine_curvature(1.0, 1.5)[None])), torch.cat((loads, ta.sample_loads(1)))
    )
    found = predict(design, task)
    assert float(found.error[0].detach()) < 1e-8
    (nothing,) = torch.autograd.grad(found.error[0], radii, retain_graph=True)
    assert nothing.abs().max() < 10
    (slope,) = torch.autograd.grad(found.error.sum(), radii)
    assert bool(slope.isfinite().all())


def test_gradients_in_chunks_are_those_of_the_whole():
    slopes = []
    for chunk in (None, 2):
        radii = ta.antagonistic_arm().radii.clone().requires_grad_()
        arm = ta.ArmDesign(radii, 0.5, ta.antagonistic_arm().actuators)
        found = predict(arm, ta.Task(ta.affine_curvature(1.0, 1.5), ta.sample_loads(5)), chunk_size=chunk)
        slopes.append(torch.autograd.grad(found.error.sum(), radii)[0])
    torch.testing.assert_close(slopes[0], slopes[1], rtol=1e-5, atol=1e-7)


# The parts


@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize("arm", [MIXED, BENT], ids=["mixed", "bent"])
def test_slope_by_pressure_against_differences(arm, exact):
    unknowns = mechanics.to_unknowns(ta.affine_curvature(1.0, 0.5)).unsqueeze(0)
    target = ta.poses(ta.affine_curvature(1.1, 0.4)).unsqueeze(0)
    points = Points.of(arm.flatten(), unknowns, target, BASE, torch.tensor([[2.0, -1.0, 0.3]]).double(), exact)
    pressure = 0.4 * arm.max_pressure.unsqueeze(0)

    def rest(at):
        found = settle(points, at, unknowns, 30, torch.tensor([1e-9]))
        assert bool(found.settled)
        again = settle(points, at, found.unknowns, 2, torch.tensor([1e-9]))  # with rates at the very balance
        return pose_errors(points, again.unknowns, again.rate)

    slope = rest(pressure).slope
    for index in range(5):
        step = torch.zeros_like(pressure)
        step[0, index] = 1e-4
        difference = (rest(pressure + step).error - rest(pressure - step).error) / 2e-4
        torch.testing.assert_close(slope[..., index], difference, rtol=1e-6, atol=1e-9)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 6))
def test_steps_in_the_box_solve_the_quadratic_programme(seed, size):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(size + 2, size))
    curvature, gradient = root.T @ root, rng.normal(size=size)
    place = rng.uniform(size=size) * (rng.uniform(size=size) > 0.3)
    step, promised = box_step(
        torch.tensor(gradient)[None], torch.tensor(curvature)[None], torch.tensor(place)[None], torch.zeros(1).double()
    )
    there = torch.tensor(place) + step[0]
    assert bool(((there >= -1e-15) & (there <= 1 + 1e-15)).all())
    slope = torch.tensor(gradient) + torch.tensor(curvature) @ step[0]
    assert optimality(slope[None], there[None]).max() < 1e-5
    assert float(promised) >= -1e-12


def test_least_squares_with_large_residuals_and_active_bounds():
    """Rosenbrock's valley with a residual that never vanishes; the bound u₁ ≤ 1 cuts the valley off."""
    target = 1.5

    def look(index, place, near, hint):
        x = place.detach().requires_grad_()
        with torch.enable_grad():
            miss = torch.stack((10 * (x[:, 1] - x[:, 0] ** 2), target - x[:, 0], x[:, 0] * x[:, 1] + 2), -1)
            rows = [torch.autograd.grad(miss[:, k].sum(), x, retain_graph=True)[0] for k in range(3)]
        jacobian, miss = torch.stack(rows, 1), miss.detach()
        gradient = (jacobian.mT @ miss.unsqueeze(-1)).squeeze(-1)
        return Model(0.5 * miss.square().sum(-1), gradient, jacobian.mT @ jacobian, hint)

    start = torch.rand(20, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    end, _ = minimise(
        look,
        start,
        start,
        lambda index, model, place: optimality(model.gradient, place) < 1e-10,
        100,
        worth=0.0,
    )
    model = look(None, end, end, end)
    assert optimality(model.gradient, end).max() < 1e-3
    best = min(
        minimize(
            lambda x: float(look(None, torch.tensor(x)[None], None, torch.zeros(1)).value),
            s,
            method="L-BFGS-B",
            bounds=[(0, 1)] * 2,
        ).fun
        for s in ([0.2, 0.2], [0.9, 0.9])
    )
    assert float(model.value.min()) == pytest.approx(best, rel=1e-6)
