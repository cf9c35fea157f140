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


def test_also_of_a_bundle_and_of_modules_in_series_under_weight_and_payload():
    models = [ta.Bellows()] * 3 + [ta.McKibben()] * 6
    offsets = torch.cat((ta.ring(0.06, 3), ta.ring(0.03, 6, phase=0.5)))
    bundle = ta.ArmDesign(offsets=offsets, length=0.4, actuators=models, mass=0.5)
    lower = ta.ArmDesign(offsets=ta.ring(0.05, 3), length=0.3, actuators=ta.Bellows(), mass=0.25)
    upper = ta.ArmDesign(offsets=ta.ring(0.04, 3, phase=0.5), length=0.25, actuators=ta.Bellows(), mass=0.15)
    whole = ta.series([lower, ta.RigidLink(length=0.02, mass=0.05), upper])
    for arm, nodes, segment in ((bundle, (6,), 0), (whole, (4, 4), 1)):
        load = ta.ExternalLoad(gravity=True, points=[ta.PointLoad(mass=0.1, segment=segment)])
        share = 0.5 * torch.rand(arm.actuator_count, generator=torch.Generator().manual_seed(1)).double()
        held = ta.solve_equilibrium(arm, share * arm.max_pressure, load, nodes)
        assert bool(held.converged)
        own = nodes if len(nodes) > 1 else None
        found = ta.fit_pressure(arm, ta.Task(held.twists, load=load, segment_nodes=own), starts=32)
        assert float(found.distance) < 1e-6
        without = ta.fit_pressure(arm, ta.Task(held.twists, [0.0] * 6, segment_nodes=own))
        assert float(without.distance) > 0.1  # of the three newtons and more that weigh
