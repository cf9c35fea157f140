"""What designs are compared by, and its gradient."""

from typing import Any

import numpy as np
import pytest
import torch

import torcharm as ta
from torcharm.design.feasible import feasible_designs
from torcharm.design.objective import NEAR_EDGE, PRICE, Objective, Problem, counted, task_values
from torcharm.design.space import DesignSpace

TASK = ta.Task(ta.affine_curvature([[-3.0], [1.0]], [[3.0], [1.5]], nodes=5), ta.sample_loads(3, (20.0, 20.0, 5.0)))
RING = ta.ArmDesign(offsets=ta.ring(radius=0.05, count=3), length=0.4, actuators=ta.Bellows())
AT_THE_EDGE = ta.Task(ta.affine_curvature(0.0, 1.0, nodes=5), ta.sample_loads(3, (4.0, 4.0, 0.4)))
IN_SPACE = ta.Task([[0.42, 0.0, 0.0, 0.0, 0.5, -0.8]] * 4, [1.0, -0.5, 0.5, 0.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("objective", "arm", "task"),
    [
        (Objective("unattainability", relative_weight=0.3, power=2), ta.antagonistic_arm(), TASK),
        (Objective("unattainability", over="worst"), ta.antagonistic_arm(), TASK),
        (Objective(), ta.antagonistic_arm(), TASK),
        (Objective(over="worst"), ta.bellows_arm(outer_radius=0.04), TASK),
        (Objective(pose_cost=ta.PoseCost("tip")), RING, IN_SPACE),
        (Objective(), ta.antagonistic_arm(), AT_THE_EDGE),
    ],
)
def test_gradient_is_that_of_finite_differences(objective: Objective, arm: ta.ArmDesign, task: ta.Task) -> None:
    """Differences ahead and behind agree but at kinks and jumps; where they do, the gradient is theirs. The strains of
    a minimum at a kink of a force model, which is not converged, have a gradient that is theirs nearly."""
    free = ("radii", "length", "max_pressure") if arm.dimension == 2 else ("radii", "angles", "length")
    problem = Problem(feasible_designs(DesignSpace(free=free), arm, [task]), (task,), objective)
    random, checked = np.random.default_rng(0), 0
    for point in problem.designs.random(8, seed=3):
        found = ta.predict_error(problem.designs.design(point), task, objective.pose_cost)
        if objective.metric == "predicted_error" and not bool(found.converged.all()):
            continue
        way = random.normal(size=point.shape)
        _, here, gradient = problem.slope(point)
        ahead, behind = (sign * (problem.slope(point + sign * 1e-6 * way)[1] - here) / 1e-6 for sign in (1, -1))
        mean = (ahead + behind) / 2
        if abs(ahead - behind) < 1e-3 * (abs(mean) + 1e-3):
            checked += 1
            assert gradient @ way == pytest.approx(mean, rel=1e-3, abs=1e-5)
    assert checked >= 3


def test_totals_are_what_their_names_say() -> None:
    values = torch.tensor([[3.0, 1.0, 0.0, -2.0], [-1.0, -2.0, -3.0, -4.0]]).double()
    assert Objective().total(values).tolist() == [1.0, -2.5]  # the mean miss; all attainable: the mean margin
    assert Objective(over="worst").total(values).tolist() == [3.0, -1.0]
    assert Objective(task_weights=(1, 0, 0, 1)).total(values.abs()).tolist() == [2.5, 2.5]
    close = Objective(over="worst").smooth_total(values)
    assert bool(((close >= Objective(over="worst").total(values)) & (close < values.amax(-1) + 0.2)).all())
    with pytest.raises(ValueError, match="must be 4 numbers, got 2"):
        Objective(task_weights=(1, 2)).total(values)


def test_errors_beyond_the_range_count_ever_more_like_the_shape_s_length() -> None:
    length, error = torch.tensor([0.5, 0.1], dtype=torch.float64)
    stable, beyond = torch.tensor(True), torch.linspace(-0.5, 5.0, 100_001, dtype=torch.float64, requires_grad=True)
    value = counted(error.expand_as(beyond), stable, beyond, length)
    assert bool((value[beyond < -NEAR_EDGE] == error).all())
    assert bool((value.diff() >= 0).all())
    assert 0.45 < float(value[-1].detach()) < 0.5
    (slope,) = torch.autograd.grad(value.sum(), beyond)
    assert float(slope.diff().abs().max()) < 0.01 * float(slope.max()), "it has no kink"
    at_edge = slope[(beyond.detach().abs()).argmin()] * (1 + PRICE * NEAR_EDGE / 2) ** 2
    torch.testing.assert_close(at_edge, PRICE * (length - error), rtol=1e-2, atol=0.0)
    assert float(counted(error, ~stable, beyond.detach()[:1], length)) == 0.5
    torch.testing.assert_close(counted(error, stable, None, length), error)


def test_the_strains_predicted_have_a_price_where_designs_are_to_be_in_range() -> None:
    """An arm that is in range at the task's shape, and out of it at the one that is predicted."""
    arm, task = ta.bellows_arm(length=0.5), ta.Task(ta.affine_curvature(0.0, 0.2, 0.55, nodes=5), (0.0, -80.0, 0.0))
    found = ta.evaluate(arm, task)
    assert bool(found.shape_in_range)
    assert found.verdict == "excluded by range"
    free, priced = (float(task_values(Objective(), arm, task, in_range=asked)) for asked in (False, True))
    assert free == pytest.approx(float(found.shape_error))
    assert free < priced < 0.5


def test_tasks_weigh_alike_however_they_are_batched() -> None:
    parts = [ta.Task(TASK.twists[0], TASK.tip_load), ta.Task(TASK.twists[1, 0], TASK.tip_load)]
    arms = ta.bellows_arm(outer_radius=torch.tensor([0.03, 0.05]).double())
    for metric in ("predicted_error", "unattainability"):
        objective = Objective(metric)
        apart = torch.cat([task_values(objective, arms, part, in_range=True) for part in parts], -1)
        torch.testing.assert_close(apart, task_values(objective, arms, TASK, in_range=True))


def test_every_task_counts_and_none_poisons() -> None:
    """Tasks that are not converged count as what their pressures reach; those without a stable equilibrium as the
    length of the shape, with no gradient."""
    arm = ta.bellows_arm(length=torch.tensor([[0.5] * 4]).double())
    loads = torch.tensor([[0.0, 0.0, 0.0], [0.0, 400.0, 0.0], [5.0, 3.0, 0.2], [2.0, 60.0, 0.0]]).double()
    task = ta.Task(ta.affine_curvature(0.5, 1.0, length=0.48, nodes=5), loads)
    found = ta.predict_error(arm, task)
    lost, unsure = ~found.stable[0], found.stable[0] & ~found.converged[0]
    assert bool(lost.any()), "a load that no stable equilibrium bears"
    values = task_values(Objective(), arm, task, in_range=False)[0]
    assert bool((values[lost] == 0.48).all())
    torch.testing.assert_close(values[~lost], found.shape_error[0][~lost])
    assert bool(values[unsure].isfinite().all())
    problem = Problem(feasible_designs(DesignSpace(in_range=False), arm, [task]), (task,), Objective())
    value, followed, gradient = problem.slope(problem.designs.free.inverse(_values(arm))[0])
    assert value == followed == pytest.approx(float(values.mean()))
    assert np.isfinite(gradient).all()
    assert (gradient != 0).any()


def _values(arm: ta.ArmDesign) -> Any:
    from torcharm.design.space import given_values

    return given_values(arm)


def test_impossible_designs_count_as_the_shape_s_length() -> None:
    arm = ta.ArmDesign([-0.09, 0.09], 0.5, ta.Bellows())
    task = ta.Task(ta.affine_curvature(0.0, 7.0, 0.5, 4), (1.0, 0.0, 0.0))
    assert task_values(Objective(), arm, task, in_range=True).tolist() == [0.5]
    assert task_values(Objective("unattainability"), arm, task, in_range=True).tolist() == [torch.inf]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"metric": "error"}, "metric"),
        ({"over": "median"}, "over"),
        ({"relative_weight": -1}, "relative_weight"),
        ({"task_weights": (0, 0)}, "task_weights"),
        ({"task_weights": (1, 2), "over": "worst"}, "task_weights"),
        ({"power": 3}, "power"),
        ({"weights": (1.0, 0.0)}, "weights"),
    ],
)
def test_objectives_are_checked(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Objective(**options)
