"""Equilibria of force models and bending laws that the engine knows by tables only."""

import math

import numpy as np
import pytest
import torch

import torcharm as ta

F64 = torch.float64
PRESSURE, PLANAR, SPATIAL = [20.0, 30.0, 15.0, 25.0], [2.0, -3.0, 0.1], [2.0, -3.0, 1.0, 0.0, 0.1, 0.1]


class Own:
    """A model of a user's: another's force by a factor, which may be a parameter."""

    def __init__(self, model, factor=1.0):
        self.model, self.factor = model, factor
        self.bending_stiffness, self.max_pressure = model.bending_stiffness, model.max_pressure
        self.strain_range, self.pressure_range = model.strain_range, model.pressure_range

    def force(self, strain, pressure):
        return self.model.force(strain, pressure) * self.factor


def arms(models):
    """The same actuators in the plane and in space, with the loads."""
    flat = ta.ArmDesign([-0.08, -0.015, 0.015, 0.08], 0.5, models)
    return ((flat, PLANAR), (ta.ArmDesign(offsets=ta.ring(0.05, 4), length=0.5, actuators=models), SPATIAL))


@pytest.mark.parametrize("model", [ta.Bellows(), ta.McKibben()])
def test_a_users_model_has_the_equilibria_of_the_same_model_written_out(model):
    generator = torch.Generator().manual_seed(0)
    pressure = torch.rand(20, 4, dtype=F64, generator=generator) * model.max_pressure
    for known, own in zip(arms([ta.Bellows(), model] * 2), arms([ta.Bellows(), Own(model)] * 2), strict=True):
        expected, found = (ta.solve_equilibrium(arm, pressure, load) for arm, load in (known, own))
        both = expected.continued & found.continued
        assert int(both.sum()) >= 18
        torch.testing.assert_close(found.twists[both], expected.twists[both], rtol=0, atol=1e-9)


def test_gradients_by_a_parameter_of_a_users_model():
    factor = torch.tensor(0.9, dtype=F64, requires_grad=True)
    for written, own in zip(
        arms([ta.Bellows(force_scale=factor)] * 4), arms([Own(ta.Bellows(), factor)] * 4), strict=True
    ):
        slopes = [
            torch.autograd.grad(ta.solve_equilibrium(arm, PRESSURE, load).poses[-1].sum(), factor)[0]
            for arm, load in (written, own)
        ]
        torch.testing.assert_close(*slopes, rtol=1e-9, atol=0)

        def tip(value, own=own):
            arm = type(own[0]).with_values(own[0], own[0].radii, own[0].length, own[0].max_pressure)
            object.__setattr__(arm, "actuators", (Own(ta.Bellows(), value),) * 4)
            return ta.solve_equilibrium(arm, PRESSURE, own[1], tolerance=1e-12).poses[-1].sum()

        difference = (tip(0.9 + 1e-5) - tip(0.9 - 1e-5)) / 2e-5
        torch.testing.assert_close(slopes[1], difference, rtol=1e-6, atol=1e-9)


def test_bending_laws_that_are_no_stiffness():
    linear = ta.BendingFunction(lambda k, p: -(1 / 3.5) * (p / 50) * k, 50.0)
    for known, own in zip(arms([ta.Bellows()] * 4), arms([ta.Bellows(bending_stiffness=linear)] * 4), strict=True):
        expected, found = (ta.solve_equilibrium(arm, PRESSURE, load).twists for arm, load in (known, own))
        torch.testing.assert_close(found, expected, rtol=0, atol=1e-9)
    stiffening = ta.BendingFunction(lambda k, p: -(0.05 + p / 200) * (k + 0.2 * k**3), 50.0)
    for arm, load in arms([ta.Bellows(bending_stiffness=stiffening)] * 4):
        found = ta.solve_equilibrium(arm, PRESSURE, load)
        assert found.status == "converged"
        assert found.residual < 1e-10
        pressure = torch.tensor(PRESSURE, dtype=F64, requires_grad=True)
        assert torch.autograd.gradcheck(
            lambda p, arm=arm, load=load: ta.solve_equilibrium(arm, p, load, 3, tolerance=1e-12).twists,
            pressure,
            eps=1e-4,
            atol=1e-7,
            rtol=1e-5,
        )


def test_a_model_that_fails_names_its_actuator():
    class Broken(Own):
        def force(self, strain, pressure):
            raise RuntimeError("no sensor")

    arm = ta.ArmDesign([-0.05, 0.05], 0.5, [ta.Bellows(), Broken(ta.Bellows())])
    with pytest.raises(ValueError, match=r"actuators\[1\]: must return a value .*no sensor"):
        ta.solve_equilibrium(arm, [1.0, 1.0], PLANAR)


BENT = ta.affine_curvature(0.0, 0.5, length=0.42)
ASKED = {
    "evaluate": lambda arm: ta.evaluate(arm, ta.Task(BENT, PLANAR), ("absolute",)),
    "solve_equilibrium": lambda arm: ta.solve_equilibrium(arm, 1.0, PLANAR),
    "predict_error": lambda arm: ta.predict_error(arm, ta.Task(BENT, PLANAR)),
    "search_pressure": lambda arm: ta.search_pressure(arm, ta.Task(BENT, PLANAR)),
    "load_capacity": lambda arm: ta.load_capacity(arm, ta.Task(BENT, PLANAR)),
    "plan_shape": lambda arm: ta.plan_shape(arm, [0.1, -0.4, -1.0], PLANAR),
    "wrench_hulls": lambda arm: ta.wrench_hulls(arm, BENT),
    "reaction_wrench": lambda arm: ta.reaction_wrench(arm, BENT, 1.0),
}
FORCES = {
    "numpy": lambda strain, pressure: np.where(strain > 0, 0.8 * pressure - 40 * strain, 0.8 * pressure),
    "if": lambda strain, pressure: 0.8 * pressure - (40 if strain > 0 else 50) * strain,
    "math": lambda strain, pressure: 0.8 * pressure - 40 * math.sinh(strain),
}


@pytest.mark.parametrize("asked", ASKED)
@pytest.mark.parametrize("force", FORCES)
def test_a_force_that_is_no_torch_names_the_actuator_and_what_to_use(force, asked):
    class Mistaken(Own):
        def force(self, strain, pressure):
            return FORCES[force](strain, pressure)

    arm = ta.ArmDesign([-0.05, 0.0, 0.05], 0.4, [ta.Bellows(), Mistaken(ta.Bellows()), Mistaken(ta.Bellows())])
    with pytest.raises(ValueError, match=r"^actuators\[1\].*torch operations on tensors \(torch\.where, not if"):
        ASKED[asked](arm)


@pytest.mark.parametrize("number", [float("nan"), float("inf")])
def test_a_model_without_a_number_has_no_equilibrium(number):
    arm = ta.ArmDesign([-0.05, 0.05], 0.5, [Own(ta.Bellows(), number)] * 2)
    assert ta.solve_equilibrium(arm, [1.0, 1.0], PLANAR).status in ("not converged", "impossible")
