"""The pressure search: equilibria that loading reaches, costs no worse than scipy's and a grid's."""

import pytest
import torch

import torcharm as ta
from torcharm.actuators.deviation import ForceDeviation
from torcharm.pressure.starts import spread_points

ARMS = {"antagonistic": ta.antagonistic_arm, "bellows": ta.bellows_arm}


def planar_task(count, moment=2.0):
    return ta.Task(ta.affine_curvature(-3.0, 3.0), ta.sample_loads(count, (20, 20, moment)))


@pytest.mark.parametrize("name", ARMS)
def test_what_is_found_is_what_loading_reaches(name):
    arm, task = ARMS[name](), planar_task(30)
    found = ta.search_pressure(arm, task)
    assert bool(found.stable.all())
    assert float(found.converged.double().mean()) > 0.4
    # one arm is so near to where it snaps that twists move by 50,000 times what is left of the balance
    loaded = ta.solve_equilibrium(arm, found.pressure, task.tip_load, tolerance=1e-12)
    assert bool((loaded.continued == found.continued).all())
    torch.testing.assert_close(loaded.twists, found.twists, rtol=0, atol=1e-7)
    gap = ta.poses(task.twists) - loaded.poses
    torch.testing.assert_close(found.tip_error, gap[..., -1, :2].norm(dim=-1), rtol=1e-6, atol=1e-9)
    torch.testing.assert_close(ta.PoseCost()(gap), found.cost, rtol=1e-6, atol=1e-12)
    assert bool(((found.pressure >= 0) & (found.pressure <= arm.max_pressure)).all())
    assert set(found.status) <= {"converged", "snapped", "not converged"}


@pytest.mark.parametrize("method", ["multistart", "scipy"])
@pytest.mark.parametrize("dimension", [2, 3])
def test_what_leaves_an_actuator_no_length_is_impossible_as_predicted(dimension, method):
    """As far as the prediction says it: errors are infinite, though pressures may bring the tip somewhere near."""
    arm, towards = (ta.bellows_arm(), {}) if dimension == 2 else (ta.antagonistic_ring(), {"direction": 0.3})
    coiled = torch.stack([ta.constant_curvature(bend, 0.5, 3, **towards) for bend in (0.3, 7.0)])
    task = ta.Task(coiled, torch.zeros(3 * dimension - 3, dtype=torch.float64))
    found = ta.search_pressure(arm, task, method, starts=1, progress=False)
    assert found.possible.tolist() == ta.predict_error(arm, task).possible.tolist() == [True, False]
    assert (found.status[1], bool(found.stable[1]), bool(found.converged[1])) == ("impossible", False, False)
    assert found.tip_error.isfinite().tolist() == found.shape_error.isfinite().tolist() == [True, False]


@pytest.mark.parametrize("name", ARMS)
def test_scipy_finds_nothing_better_where_it_converges(name):
    arm, task = ARMS[name](), planar_task(6)
    ours = ta.search_pressure(arm, task)
    theirs = ta.search_pressure(arm, task, "scipy", scipy_method="SLSQP", progress=False)
    assert bool((ours.cost <= theirs.cost + 1e-9)[ours.converged].all())
    again = ta.solve_equilibrium(arm, theirs.pressure, task.tip_load)
    gap = ta.poses(task.twists) - again.poses
    torch.testing.assert_close(ta.PoseCost()(gap), theirs.cost, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("kinds", [(ta.Bellows, ta.Bellows), (ta.McKibben, ta.Bellows)])
def test_no_converged_search_of_two_actuators_is_worse_than_a_grid(kinds):
    arm = ta.ArmDesign([-0.04, 0.05], 0.5, [kind() for kind in kinds])
    task = ta.Task(ta.affine_curvature(1.0, 1.5, nodes=6), ta.sample_loads(4, (6, 6, 1)))
    found = ta.search_pressure(arm, task)
    side = torch.linspace(0, 1, 60, dtype=torch.float64)
    places = torch.cartesian_prod(side, side) * arm.max_pressure
    loaded = ta.solve_equilibrium(arm, places[:, None], task.tip_load, 6)
    cost = ta.PoseCost()(ta.poses(task.twists) - loaded.poses)
    best = torch.where(loaded.stable & loaded.continued, cost, torch.inf).amin(0)
    assert bool((found.cost <= 1.01 * best)[found.converged].all())
    assert bool(found.converged.any())


@pytest.mark.parametrize(
    ("name", "load", "cost_of_scipy"),
    [
        ("antagonistic", 77, 0.002698),  # L-BFGS-B's
        ("bellows", 16, 0.46367),  # SLSQP's
        ("bellows", 31, 0.250585),  # SLSQP's
    ],
)
def test_along_a_boundary_no_seed_does_worse_than_scipy(name, load, cost_of_scipy):
    arm = ARMS[name]()
    task = ta.Task(ta.affine_curvature(-3.0, 3.0), ta.sample_loads(100)[load], wrench_at="start")
    for seed in range(8):
        found = ta.search_pressure(arm, task, seed=seed)
        assert float(found.cost) <= cost_of_scipy, seed
        loaded = ta.solve_equilibrium(arm, found.pressure, task.tip_load, wrench_at="start")
        torch.testing.assert_close(loaded.twists, found.twists, rtol=0, atol=1e-7)


def test_gradients_of_the_cost_are_those_of_the_minimum():
    given, task = ta.bellows_arm(), ta.Task(ta.affine_curvature(-1.0, 2.0), [1.0, -2.0, 0.3])

    def cost(radii):
        return ta.search_pressure(ta.ArmDesign(radii, given.length, given.actuators), task)

    radii = given.radii.clone().requires_grad_()
    found = cost(radii)
    assert found.status == "converged"
    (gradient,) = torch.autograd.grad(found.cost, radii)
    for index in range(4):
        ends = []
        for sign in (1, -1):
            moved = given.radii.clone()
            moved[index] += sign * 1e-5
            ends.append(float(cost(moved).cost))
        assert float(gradient[index]) == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=2e-3, abs=1e-7)


def test_spread_points_begin_in_the_middle_and_are_the_same_at_every_call():
    points = spread_points(9, 3)
    assert points[0].tolist() == [0.5, 0.5, 0.5]
    assert ((points >= 0) & (points <= 1)).all()
    assert (points == spread_points(9, 3)).all()
    assert (points != spread_points(9, 3, seed=1))[1:].any()


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"method": "magic"}, "method"),
        ({"starts": 0}, "starts"),
        ({"rounds": -1}, "rounds"),
        ({"shear_stiffness": 0.0}, "shear_stiffness"),
        ({"seed": -1}, "seed"),
    ],
)
def test_mistakes_are_named(given, named):
    with pytest.raises(ValueError, match=named):
        ta.search_pressure(ta.bellows_arm(), planar_task(1), **given)


def random_arms(count, size):
    """Arms of bellows and muscles in any order, side by side."""
    for seed in range(count):
        draw = torch.Generator().manual_seed(300 + seed)
        kinds = torch.randint(2, (size,), generator=draw).tolist()
        radii = 0.16 * torch.rand(size, generator=draw, dtype=torch.float64) - 0.08
        yield ta.ArmDesign(radii, 0.5, [(ta.Bellows, ta.McKibben)[kind]() for kind in kinds])


@pytest.mark.parametrize("size", [3, 4, 6])
def test_no_converged_search_is_better_with_one_pressure_at_its_other_end(size):
    task = ta.Task(ta.affine_curvature(-2.0, 2.0, nodes=6), ta.sample_loads(20, (20, 20, 3)))
    compared = 0
    for arm in random_arms(4, size):
        found = ta.search_pressure(arm, task)
        for other in range(size):
            pressure, limit = found.pressure.clone(), arm.max_pressure[other]
            pressure[:, other] = torch.where(pressure[:, other] < 0.5 * limit, limit, 0.0)
            loaded = ta.solve_equilibrium(arm, pressure, task.tip_load, 6)
            cost = ta.PoseCost()(ta.poses(task.twists) - loaded.poses)
            counts = found.converged & loaded.stable & loaded.continued
            compared += int(counts.sum())
            assert bool((found.cost <= cost * (1 + 1e-6) + 1e-12)[counts].all())
    assert compared > 100


def test_seeds_hardly_change_a_converged_search():
    apart = compared = 0
    for arm in random_arms(6, 4):
        task = ta.Task(ta.affine_curvature(-2.0, 2.0, nodes=6), ta.sample_loads(20, (20, 20, 3)))
        one, other = (ta.search_pressure(arm, task, seed=seed) for seed in (0, 1))
        both = one.converged & other.converged
        compared += int(both.sum())
        apart += int(((one.shape_error - other.shape_error).abs() > 1e-3)[both].sum())
    assert compared > 60
    assert apart <= 0.02 * compared


def test_a_search_whose_tip_is_left_to_chance_is_not_converged():
    """Of two segments in series the first is wanted alone, longer than it gets: the other one's pressures are free."""
    arm = ta.series([ta.antagonistic_arm(), ta.antagonistic_arm()])
    task = ta.Task(ta.constant_curvature(1.3, nodes=10), [1.0, 0.0, 0.0], segment_nodes=(5, 5))
    first = ta.search_pressure(arm, task, pose_cost=ta.PoseCost([1.0] * 5 + [0.0] * 5))
    assert float(first.start_cost.median()) < 1.01 * float(first.cost)  # descents agree on what counts
    assert first.status == "not converged"


def test_nothing_is_tried_beyond_a_pressure_that_leaves_no_error():
    arm = ta.antagonistic_arm()
    held = ta.solve_equilibrium(arm, 0.5 * arm.max_pressure, [2.0, 0.0, 0.1])
    found = ta.search_pressure(arm, ta.Task(held.twists, [2.0, 0.0, 0.1]))
    assert found.status == "converged"
    assert float(found.shape_error) < 1e-5 * 0.5
    assert int(found.start_cost.isnan().sum()) > 8


def test_three_others_come_as_close_as_a_converged_search_that_leaves_an_error():
    doubted = 0
    for arm in random_arms(6, 4):
        task = ta.Task(ta.affine_curvature(-2.0, 2.0, nodes=6), ta.sample_loads(20, (20, 20, 3)))
        found = ta.search_pressure(arm, task)
        each = found.shape_error[:, None] * (found.start_cost / found.cost[:, None]).sqrt()
        apart = (each - found.shape_error[:, None]).abs()
        as_close = (apart <= 3 * 5e-4 * 0.5).sum(-1) > 3  # the best may have been bettered three times since
        near = found.shape_error <= 1e-3 * 0.5
        assert bool((as_close | near)[found.converged].all())
        doubted += int((found.continued & ~as_close & ~near).sum())
    assert doubted > 3


def test_a_search_from_one_start_needs_no_other():
    task = planar_task(20)
    assert int(ta.search_pressure(ta.antagonistic_arm(), task, starts=1).converged.sum()) > 5


def test_scipy_meets_each_built_arm_with_its_own_forces():
    """Factors on forces, and what is added to them, are of each design, as its offsets are."""
    arm = ta.ArmDesign(torch.tensor([[-0.04, 0.04]] * 2, dtype=torch.float64), 0.4, ["bellows"] * 2)
    scale = torch.tensor([[1.0, 1.0], [1.6, 1.3]], dtype=torch.float64)
    built = arm.with_deviation(ForceDeviation(scale, torch.ones_like(scale), ((0, 0),), (scale - 1,)))
    task = ta.Task(ta.constant_curvature(0.4, 0.46, 4), [0.5, 0.0, 0.0])
    both = ta.search_pressure(built, task, "scipy", progress=False)
    for index in range(2):
        alone = ta.search_pressure(built[index], task, "scipy", progress=False)
        torch.testing.assert_close(both.pressure[index], alone.pressure, rtol=1e-5, atol=1e-4)
        torch.testing.assert_close(both.cost[index], alone.cost, rtol=1e-6, atol=1e-12)
    assert float((both.pressure[0] - both.pressure[1]).abs().max()) > 1.0
