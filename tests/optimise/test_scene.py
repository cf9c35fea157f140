"""Prepared tasks: the same numbers and gradients as evaluate's, whatever is prepared, and however many at once."""

from dataclasses import replace
from typing import Any

import pytest
import torch

import torcharm as ta
from torcharm.optimise import DesignSpace, Objective
from torcharm.optimise.feasible import feasible_designs
from torcharm.optimise.objective import Problem

TASK = ta.Task(
    ta.affine_curvature([[-3.0], [1.0], [6.0]], [[3.0], [1.5], [-1.5]], nodes=4), ta.sample_loads(5, (20.0, 20.0, 5.0))
)
SINGLE = ta.Task(ta.affine_curvature(0.5, 0.2, nodes=6), (3.0, -2.0, 0.5))
ARMS = [ta.antagonistic_arm(), ta.bellows_arm(), ta.mckibben_arm()]


def _judged(problem: Problem, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    count = len(points)
    found = problem.judge(points, torch.zeros(count).long(), torch.ones(count).double(), gradient=True)
    assert found.gradient is not None
    return found.value, found.gradient


@pytest.mark.parametrize("arm", ARMS)
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"relative_weight": 0.3, "power": 2},
        {"margin": False, "weights": (2.0, 0.5)},
        {"over": "cvar", "tail": 0.4, "size_weight": 3.0},
    ],
)
def test_values_and_gradients_are_those_of_evaluate(arm: ta.ArmDesign, options: dict[str, Any]) -> None:
    objective, tasks = Objective(**options), (TASK, SINGLE)
    polytope = feasible_designs(DesignSpace(free=("radii", "length", "max_pressure")), arm, tasks)
    points = polytope.sample(4, seed=1)
    values, slopes = _judged(Problem((polytope,), tasks, objective), points)
    at = points.clone().requires_grad_()
    design = polytope.design(at)
    plain = objective.total(objective.per_task(design, tasks)) + objective.size(design)
    (slope,) = torch.autograd.grad(plain.sum(), at)
    torch.testing.assert_close(values, plain.detach(), rtol=1e-12, atol=1e-12)
    torch.testing.assert_close(slopes, slope, rtol=1e-9, atol=1e-9)


def test_blocks_do_not_matter() -> None:
    polytope = feasible_designs(DesignSpace(), ARMS[0], [TASK])
    points = polytope.sample(7, seed=2)
    whole = _judged(Problem((polytope,), (TASK,), Objective()), points)
    for chunk in (4, 31):  # less than one design's tasks, and two designs'
        problem = Problem((polytope,), (TASK,), Objective(chunk_size=chunk))
        torch.testing.assert_close(_judged(problem, points), whole, rtol=1e-11, atol=1e-11)


def test_what_is_not_free_has_no_gradient_to_follow() -> None:
    polytope = feasible_designs(DesignSpace(free="length", in_range=False), ARMS[0], [TASK])
    point = polytope.sample(1, seed=0).requires_grad_()
    design = polytope.design(point)
    assert design.length.requires_grad
    assert not design.radii.requires_grad
    assert not design.max_pressure.requires_grad
    torch.testing.assert_close(design.radii[0], ARMS[0].radii)


def test_margins_follow_where_every_node_is_inside() -> None:
    arm = ta.bellows_arm(outer_radius=0.03, inner_radius=0.01, length=0.45)
    easy = ta.Task(ta.affine_curvature(0.1, 0.2, length=0.5, nodes=5), (0.1, 0.0, 0.0))
    polytope = feasible_designs(DesignSpace(), arm, [easy])
    value, slope = _judged(Problem((polytope,), (easy,), Objective()), polytope.nearest(arm))
    found = ta.evaluate(arm, easy, "absolute", signed=True).absolute
    assert found is not None
    assert float(value) == pytest.approx(float(found), rel=1e-12)
    assert float(value) < 0
    assert bool((slope != 0).any())


def test_other_objectives_go_through_evaluate() -> None:
    polytope = feasible_designs(DesignSpace(), ARMS[0], [TASK])
    problem = Problem((polytope,), (TASK,), Objective(metric="predicted_error"))
    assert problem.scenes == (None,)
    assert replace(problem, objective=Objective()).scenes != (None,)
