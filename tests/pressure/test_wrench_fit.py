"""Fits in wrenches: certificates, scipy's least squares, plane and space."""

import numpy as np
import pytest
import torch
from scipy.optimize import least_squares

import torcharm as ta


def test_a_pressure_that_holds_the_shape_is_found():
    arm = ta.antagonistic_arm()
    pressure, load = torch.tensor([20.0, 30.0, 5.0, 10.0]).double(), torch.tensor([1.0, 2.0, 0.2]).double()
    held = ta.solve_equilibrium(arm, pressure, load)
    found = ta.fit_pressure(arm, ta.Task(held.twists, load))
    assert float(found.distance) < 1e-8
    assert bool(found.converged)


@pytest.mark.parametrize("make", [ta.antagonistic_arm, ta.bellows_arm])
def test_scipy_finds_nothing_closer(make):
    arm, task = make(), ta.Task(ta.affine_curvature(-1.0, 2.0), ta.sample_loads(4))
    weights = (2.0, 30.0)
    found = ta.fit_pressure(arm, task, weights=weights)
    required = ta.required_wrench(task.twists, task.tip_load)[..., [0, 2]]
    root = np.sqrt(np.array(weights))
    for index in range(4):

        def miss(place, index=index):
            reaction = ta.reaction_wrench(arm, task.twists, torch.as_tensor(place) * arm.max_pressure)
            return ((reaction - required[index]).numpy() * root).ravel()

        best = min(
            float(np.linalg.norm(least_squares(miss, start, bounds=(0, 1)).fun))
            for start in np.random.default_rng(0).uniform(0.1, 0.9, (6, 4))
        )
        assert float(found.distance[index]) <= best * (1 + 1e-7)
        own = miss((found.pressure[index] / arm.max_pressure).numpy())
        assert float(found.distance[index]) == pytest.approx(float(np.linalg.norm(own)), rel=1e-9)


def test_in_space_a_pressure_that_holds_the_shape_is_found():
    arm = ta.ArmDesign(offsets=ta.ring(0.05, 3), length=0.4, actuators=ta.Bellows(), mass=0.3)
    load = ta.ExternalLoad(torch.tensor([0.3, 0.5, 0.2, 0.0, 0.0, 0.0]).double(), gravity=True)
    held = ta.solve_equilibrium(arm, [10.0, 25.0, 5.0], load, 6)
    assert bool(held.converged)
    found = ta.fit_pressure(arm, ta.Task(held.twists, load=load))
    assert float(found.distance) < 1e-7
