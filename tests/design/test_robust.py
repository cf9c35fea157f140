"""Objectives over built arms: their totals, their gradients, and a design that is better once built."""

import numpy as np
import pytest
import torch
from scipy.stats.mstats import hdquantiles

import torcharm as ta
from torcharm.design.feasible import feasible_designs
from torcharm.design.objective import Problem
from torcharm.design.optimise import starting_points

ARM = ta.antagonistic_arm()
TASK = ta.Task(ta.affine_curvature(0.5, 0.5, length=0.5), ta.sample_loads(2, (2, 2, 0.2)))
SCATTER = ta.Scatter(radii=1e-3, length=2e-3, force=0.05)
SPACE = ta.DesignSpace(bounds={"radii": (-0.1, 0.1), "length": (0.25, 0.75)}, tied="mirror")


@pytest.mark.parametrize("quantile", [0.5, 0.9, 0.95])
def test_quantiles_are_those_of_harrell_and_davis(quantile):
    values = torch.randn(3, 40, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    found = ta.Robust(SCATTER, quantile, samples=40).total(values)
    wanted = [float(hdquantiles(row.numpy(), [quantile])[0]) for row in values]
    assert np.allclose(found, wanted, rtol=0, atol=1e-12)
    torch.testing.assert_close(ta.Robust(SCATTER, None, samples=40).total(values), values.mean(-1))


@pytest.mark.parametrize("compensated", [False, True])
@pytest.mark.parametrize("quantile", [None, 0.9])
def test_gradients_are_those_of_finite_differences(compensated, quantile):
    robust = ta.Robust(SCATTER, quantile, samples=6, compensated=compensated)
    problem = Problem(feasible_designs(SPACE, ARM, [TASK]), (TASK,), ta.Objective(robust=robust))
    point = starting_points(problem, ARM, 1, 0)[0]
    _, value, gradient = problem.slope(point)
    assert value == pytest.approx(float(problem.value(problem.designs.design(point))), rel=1e-9)
    step = 1e-5
    ways = step * np.eye(len(point))
    numeric = [(problem.slope(point + way)[0] - problem.slope(point - way)[0]) / (2 * step) for way in ways]
    assert np.abs(gradient - numeric).max() < 1e-3 * np.abs(gradient).max()


@pytest.mark.parametrize("compensated", [False, True])
def test_segments_in_series_in_space_have_gradients_too(compensated):
    lower = ta.ArmDesign(offsets=ta.ring(radius=0.05, count=4), length=0.3, actuators=["bellows", "mckibben"] * 2)
    upper = ta.ArmDesign(offsets=ta.ring(0.04, 3), length=0.2, actuators="bellows")
    arm = ta.series([lower, ta.RigidLink(length=0.02), upper])
    shape = torch.tensor([[0.31, 0, 0, 0, 0.1, 0.2]] * 3 + [[0.21, 0, 0, 0, -0.05, 0.1]] * 3, dtype=torch.float64)
    task = ta.Task(shape, [0.2, -0.5, 0.1, 0, 0, 0], segment_nodes=[3, 3])
    objective = ta.Objective(robust=ta.Robust(SCATTER, samples=4, compensated=compensated))
    problem = Problem(feasible_designs(ta.DesignSpace(), arm, [task]), (task,), objective)
    point = starting_points(problem, arm, 1, 0)[0]
    gradient = problem.slope(point)[2]
    way, step = np.linspace(-1, 1, len(point)), 1e-5
    sides = [problem.slope(point + sign * step * way)[0] for sign in (1, -1)]
    assert gradient @ way == pytest.approx((sides[0] - sides[1]) / (2 * step), rel=1e-3)


def test_a_batch_of_designs_has_a_value_each():
    problem = Problem(feasible_designs(SPACE, ARM, [TASK]), (TASK,), ta.Objective(robust=ta.Robust(SCATTER, samples=6)))
    arms = ta.antagonistic_arm(outer_radius=torch.tensor([0.05, 0.06], dtype=torch.float64))
    each = [float(problem.value(arms[index])) for index in (0, 1)]
    assert np.allclose(problem.value(arms), each, rtol=1e-9)


def test_a_robust_design_is_better_once_built():
    space = ta.DesignSpace(free="radii", bounds={"radii": (-0.1, 0.1)}, tied="mirror")
    nominal = ta.optimise_design(ARM, TASK, space, starts=1, iterations=15)
    objective = ta.Objective(robust=ta.Robust(SCATTER, samples=16))
    tolerance = ta.PoseTolerance(tip=0.01, rotation=0.2, shape=0.015)
    found = ta.optimise_design(nominal.best, TASK, space, objective, starts=1, iterations=15, tolerance=tolerance)
    assert found.value < found.given_value
    assert "built arms" in found.status
    before, after = (
        ta.tolerance(arm, TASK, radii=1e-3, length=2e-3, force=0.05, tolerance=tolerance, seed=77)
        for arm in (nominal.best, found.best)
    )
    assert after.pooled_percentile(90) < before.pooled_percentile(90)
    assert int(after.within.sum()) > int(before.within.sum())
    assert found.built_after is not None
    assert found.built_after.within.double().mean() > found.built_before.within.double().mean()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: ta.Robust(SCATTER, quantile=1.0), "quantile: must be between 0 and 1"),
        (lambda: ta.Robust(SCATTER, samples=1), "samples: must be an integer of at least 2"),
        (lambda: ta.Objective("unattainability", robust=ta.Robust(SCATTER)), "robust: must be a Robust, with metric"),
    ],
)
def test_what_makes_no_sense_is_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()
