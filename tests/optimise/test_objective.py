"""What designs are judged by, and its gradient."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import torch

import torcharm as ta
from torcharm.optimise.feasible import feasible_designs
from torcharm.optimise.objective import Objective, Problem
from torcharm.optimise.space import DesignSpace

TASK = ta.Task(
    ta.affine_curvature([[-3.0], [1.0], [6.0]], [[3.0], [1.5], [-1.5]]), ta.sample_loads(4, (20.0, 20.0, 5.0))
)


def _problem(objective: Objective, tasks: tuple[ta.Task, ...] = (TASK,), **space: Any) -> Problem:
    polytope = feasible_designs(DesignSpace(**space), ta.antagonistic_arm(), tasks)
    return Problem((polytope,), tasks, objective)


@pytest.mark.parametrize(
    "objective",
    [
        Objective(),
        Objective(relative_weight=0.3, power=2),
        Objective(over="worst", size_weight=2.0),
        Objective(over="cvar", tail=0.3),
        Objective(over="count", threshold=1.0),
    ],
)
def test_gradient_is_that_of_finite_differences_at_100_designs(objective: Objective) -> None:
    """Central differences at two step sizes agree except at kinks; where they do, so does the gradient."""
    problem = _problem(objective, free=("radii", "length", "max_pressure"))
    points = problem.polytopes[0].sample(100, seed=3)
    zero, heat = torch.zeros(100, dtype=torch.long), torch.full((100,), 3.0).double()
    slope = problem.judge(points, zero, heat, gradient=True).gradient
    assert slope is not None
    direction = torch.randn(points.shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    direction = direction / direction.norm(dim=-1, keepdim=True)

    def difference(step: float) -> torch.Tensor:
        ends = [problem.judge(points + sign * step * direction, zero, heat, gradient=False).smooth for sign in (1, -1)]
        return (ends[0] - ends[1]) / (2 * step)

    coarse, fine = difference(2e-6), difference(1e-6)
    smooth = (coarse - fine).abs() < 1e-5 * (1 + fine.abs())
    assert int(smooth.sum()) >= 90
    torch.testing.assert_close((slope * direction).sum(-1)[smooth], fine[smooth], rtol=1e-4, atol=1e-4)


def test_totals_are_what_their_names_say() -> None:
    values = torch.tensor([[3.0, 1.0, 0.0, -2.0], [-1.0, -2.0, -3.0, -4.0]]).double()
    assert Objective().total(values).tolist() == [1.0, -2.5]  # the mean miss; all attainable: the mean margin
    assert Objective(over="worst").total(values).tolist() == [3.0, -1.0]
    assert Objective(over="cvar", tail=0.5).total(values).tolist() == [2.0, -1.5]
    assert Objective(over="count").total(values).tolist() == [2.0 + 1.0 / 2.0, 0.0]
    assert Objective(over="count", threshold=1.0).total(values).tolist() == [1.0 + 1.0 / 2.0, 0.0]


@pytest.mark.parametrize("over", ["worst", "count"])
def test_stand_ins_become_the_total_as_they_cool(over: str) -> None:
    objective = Objective(over=over)
    values = torch.tensor([[3.0, 1.0, 0.5, -2.0]]).double()
    exact = values.amax(-1) if over == "worst" else torch.tensor([3.0]).double()
    errors = [
        float((objective.smooth_total(values, torch.tensor([heat]).double()) - exact).abs())
        for heat in (1.0, 0.1, 1e-3)
    ]
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 0.01


def test_several_batches_of_tasks_count_as_one() -> None:
    shapes = ta.affine_curvature([-3.0, 1.0], [3.0, 1.5])
    loads = ta.sample_loads(2)
    whole = ta.Task(shapes, loads)
    parts = tuple(ta.Task(shape, load) for shape, load in zip(shapes, loads, strict=True))
    arm = ta.bellows_arm(outer_radius=torch.tensor([0.03, 0.05]).double())
    torch.testing.assert_close(Objective().per_task(arm, parts), Objective().per_task(arm, (whole,)))


@dataclass(frozen=True)
class Brittle(ta.Bellows):
    """A model without an answer for long neutral lengths."""

    def force(self, strain: torch.Tensor, pressure: torch.Tensor) -> torch.Tensor:
        return super().force(torch.where(strain < -0.1, torch.nan, strain), pressure)


def test_what_is_no_number_is_infinite_and_has_no_gradient() -> None:
    arm = ta.ArmDesign([-0.02, -0.01, 0.01, 0.02], 0.5, [Brittle()] * 4)
    polytope = feasible_designs(DesignSpace(free="length", in_range=False), arm, [TASK])
    points = torch.tensor([[1.0], [0.05]]).double().expand(2, 4)
    problem = Problem((polytope,), (TASK,), Objective())
    found = problem.judge(points, torch.zeros(2, dtype=torch.long), torch.ones(2).double(), gradient=True)
    assert found.gradient is not None
    assert found.value[0] == torch.inf
    assert found.smooth[0] == torch.inf
    assert found.gradient[0].tolist() == [0.0] * 4
    assert bool(found.value[1].isfinite())
    assert bool((found.gradient[1] != 0).any())


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"metric": "error"}, "metric"),
        ({"over": "median"}, "over"),
        ({"relative_weight": -1}, "relative_weight"),
        ({"tail": 0.0}, "tail"),
        ({"margin": True, "metric": "predicted_error"}, "margin"),
        ({"power": 3}, "power"),
        ({"weights": (1.0, 0.0)}, "weights"),
        ({"size_weight": np.inf}, "size_weight"),
    ],
)
def test_objectives_are_checked(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Objective(**options)
