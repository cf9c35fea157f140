"""What an optimised design is worth to the arm: predicted errors as objective, the search as check."""

import pytest
import torch

import torcharm as ta
from torcharm.optimise import DesignSpace, Objective, optimise_design, verify_design
from torcharm.optimise.feasible import feasible_designs
from torcharm.optimise.objective import Problem

TASK = ta.Task(ta.affine_curvature(1.0, 1.5, nodes=3), (3.0, -2.0, 0.5))


def test_the_search_is_asked_before_and_after() -> None:
    found = optimise_design(ta.bellows_arm(), TASK, starts=1, iterations=6)
    checked = verify_design(found, TASK, options={"starts": 1, "rounds": 0})
    for design, error in ((found.given, checked.before), (found.best, checked.after)):
        search = ta.search_pressure(design, TASK, starts=1, rounds=0)
        assert bool(search.converged.all())
        torch.testing.assert_close(error, search.shape_error.reshape(1))
    assert checked.pressure_after.shape == (1, 4)
    assert checked.improved == float((checked.after < checked.before).double().mean())


def test_predicted_error_falls_when_it_is_the_objective() -> None:
    objective = Objective(metric="predicted_error")
    found = optimise_design(ta.antagonistic_arm(), TASK, objective=objective, starts=1, iterations=3, tolerance=1e-5)
    assert found.value < float(found.start_values[0])
    error = ta.evaluate(found.best, TASK, ("predicted_error",)).shape_error
    assert error is not None
    assert found.value == pytest.approx(float(error.mean()), rel=1e-6)
    torch.testing.assert_close(found.after["predicted_error"], error.reshape(1), rtol=1e-6, atol=1e-9)


def test_gradient_of_the_predicted_error_is_that_of_finite_differences() -> None:
    polytope = feasible_designs(DesignSpace(), ta.antagonistic_arm(), [TASK])
    problem = Problem((polytope,), (TASK,), Objective(metric="predicted_error"))
    points = polytope.sample(12, seed=1)
    owner, heat = torch.zeros(12, dtype=torch.long), torch.ones(12).double()
    direction = torch.randn(points.shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    slope = problem.judge(points, owner, heat, gradient=True).gradient
    assert slope is not None

    def difference(step: float) -> torch.Tensor:
        ends = [problem.judge(points + sign * step * direction, owner, heat, gradient=False).value for sign in (1, -1)]
        return (ends[0] - ends[1]) / (2 * step)

    coarse, fine = difference(2e-5), difference(1e-5)
    # Where the pressures found are not the best, the envelope theorem does not hold; where they jump, nothing does.
    sound = ta.evaluate(polytope.design(points), TASK, ("predicted_error",)).converged
    smooth = sound & ((coarse - fine).abs() < 1e-4 * (1 + fine.abs()))
    assert int(smooth.sum()) >= 6, int(sound.sum())
    torch.testing.assert_close((slope * direction).sum(-1)[smooth], fine[smooth], rtol=1e-3, atol=1e-4)
