from dataclasses import replace

import pytest
import torch

import torcharm as ta
from torcharm.equilibrium.sensitivity import pressure_sensitivity

TWISTED = ta.ArmDesign(
    offsets=ta.ring(0.03, 3), length=0.2, actuators=["bellows", "mckibben", "bellows"], mass=0.1, torsion_stiffness=1.0
)
PAIR = ta.series([ta.bellows_arm(length=0.2), ta.RigidLink(0.02), ta.antagonistic_arm(length=0.2)])
ARMS = {
    "plane": (ta.antagonistic_arm(), [1.0, -2.0, 0.1]),
    "series": (
        ta.series([ta.bellows_arm(length=0.2), ta.RigidLink(0.02), ta.antagonistic_arm(length=0.2)]),
        [0.5, 1.0, 0.0],
    ),
    "space": (TWISTED, [0.5, -1.0, 0.7, 0.0, 0.02, 0.01]),
}


@pytest.mark.parametrize("name", ARMS)
def test_twists_change_with_pressure_as_differences_do(name):
    arm, load = ARMS[name]
    pressure = 10.0 + 5.0 * torch.arange(arm.actuator_count, dtype=torch.float64)

    def solved(pressures):
        return ta.solve_equilibrium(arm, pressures, torch.tensor(load, dtype=torch.float64), 4, tolerance=1e-13)

    found = solved(pressure)
    problem = replace(found._problem, pressure=pressure[None], batch=(1,))
    rate = pressure_sensitivity(problem, found.twists[None])[0]
    step = 1e-3 * torch.eye(arm.actuator_count, dtype=torch.float64)
    difference = (solved(pressure + step).twists - solved(pressure - step).twists) / 2e-3
    assert difference.abs().max() > 1e-4
    torch.testing.assert_close(rate, difference, rtol=1e-5, atol=1e-9)
