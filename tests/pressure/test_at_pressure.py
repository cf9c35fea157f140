"""Errors at pressures that a person has chosen, against the equilibrium there and against searches."""

import pytest
import torch

import torcharm as ta
from torcharm.pressure.at_pressure import error_at_pressure

PLANE = ta.antagonistic_arm(), ta.Task(ta.affine_curvature(-1.0, 1.5, nodes=5), [0.5, -1.0, 0.05])
SPACE = (
    ta.antagonistic_ring(),
    ta.Task(
        ta.constant_curvature(0.5, nodes=4, direction=0.4), load=ta.ExternalLoad([0.0, 0.0, 1.0, 0.0, 0.0, 0.0], True)
    ),
)


@pytest.mark.parametrize(("arm", "task"), [PLANE, SPACE], ids=["plane", "space"])
def test_at_the_pressures_of_a_search_errors_are_the_search_s(arm, task):
    search = ta.search_pressure(arm, task)
    found = error_at_pressure(arm, task, search.pressure)
    for name in ("tip_error", "tip_rotation_error", "shape_error", "cost", "per_node", "twists"):
        torch.testing.assert_close(getattr(found, name), getattr(search, name), rtol=1e-6, atol=1e-8)
    torch.testing.assert_close(found.pressure, search.pressure)
    assert ta.evaluate(arm, task, found=found).verdict == ta.evaluate(arm, task, found=search).verdict


@pytest.mark.parametrize(("arm", "task"), [PLANE, SPACE], ids=["plane", "space"])
def test_elsewhere_they_are_the_distance_of_the_equilibrium_s_tip(arm, task):
    pressure = 0.3 * arm.max_pressure
    found = error_at_pressure(arm, task, pressure)
    equilibrium = ta.solve_equilibrium(arm, pressure, task.load, task.nodes, base_pose=task.base_pose)
    group = (slice(None, 3), 3) if task.dimension == 3 else slice(None, 2)
    off = (equilibrium.poses[-1] - ta.poses(task.twists, task.base_pose)[-1])[group].norm()
    torch.testing.assert_close(found.tip_error, off, rtol=1e-9, atol=1e-12)
    assert found.status == "converged"


def test_a_passive_actuator_s_limit_of_none_is_no_pressure():
    arm = ta.ArmDesign([-0.03, 0.0, 0.03], 0.3, ["bellows", ta.elastic_core(40.0, 2e-3), "bellows"])
    task = ta.Task(ta.constant_curvature(0.2, 0.3, 4))
    found = error_at_pressure(arm, task, torch.tensor([10.0, 0.0, 5.0], dtype=torch.float64))
    assert found.pressure.tolist() == [10.0, 0.0, 5.0]
    assert bool(found.tip_error.isfinite())
