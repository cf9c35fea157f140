"""Gradients by what a force model holds, while nothing else asks for any: every kind of parameter by every result."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import pytest
import torch
from hull_cases import unchecked

import torcharm as ta

D = torch.float64


@pytest.fixture(autouse=True)
def _unchecked():
    with unchecked():
        yield


RADII = torch.tensor([-0.05, 0.02, 0.05], dtype=D)
TASK = ta.Task(
    ta.affine_curvature(-1.0, 2.0, 0.53, 4), torch.tensor([[9.0, -21.0, 1.5], [-90.0, -30.0, -2.0]], dtype=D)
)
GENTLE = ta.Task(ta.affine_curvature(-0.6, 0.9, 0.6, 4), torch.tensor([0.6, -1.8, 0.1], dtype=D))
"""What a model beside a bellows is predicted to come to rest at, converged and stable."""
PRESSURE, LOAD = torch.tensor([22.0, 9.0, 31.0], dtype=D), torch.tensor([1.0, -3.0, 0.15], dtype=D)
BELLOWS = ta.Bellows()
GRID = ta.GriddedActuator(
    (-0.3, 0.0, 0.3, 0.7), (0.0, 20.0, 60.0), tuple((0, 18 - 9 * e, 50 - e) for e in range(4)), 50
)


class Net(torch.nn.Module):
    """A force model as a module: what it learns is a parameter."""

    bending_stiffness, max_pressure = -0.2, 50.0
    strain_range, pressure_range = (-0.2, 0.7), (0.0, 60.0)

    def __init__(self, at):
        super().__init__()
        self.at = torch.nn.Parameter(at.detach().clone())

    def force(self, strain, pressure):
        return self.at * pressure * (1 - 0.4 * torch.tanh(strain)) - 30 * strain - 2e-3 * pressure**2


class Closure:
    """A force model whose force captured what it depends on."""

    bending_stiffness, max_pressure = -0.2, 50.0
    strain_range, pressure_range = (-0.2, 0.7), (0.0, 60.0)

    def __init__(self, force):
        self.force = force


class Branching(Closure):
    """A force that depends on its parameter only where an actuator is stretched."""

    def __init__(self, at):
        self.at = at

    def force(self, strain, pressure):
        force = pressure * (1.1 - 4e-3 * pressure - 0.3 * strain) - 20 * strain
        return force - self.at * strain.clamp(min=0) * pressure if bool((strain > 0).any()) else force


@dataclass(frozen=True)
class Scaled(ta.Bellows):
    """A subclass that adds a field to its parent's force, and nothing to what the parent wrote out."""

    at: object = 1.0

    def force(self, strain, pressure):
        return super().force(strain, pressure) * self.at


@dataclass(frozen=True)
class Halved(ta.LinearBending):
    """A subclass of a bending model that overrides its moment alone."""

    at: object = 1.0

    def active(self, curvature):
        return super().active(curvature) * self.at


def coefficient(x):
    powers = [c if (i, j) != (0, 1) else x for i, j, c in BELLOWS.coefficients]
    return ta.TensorPolynomial(BELLOWS, torch.stack([torch.as_tensor(c, dtype=D) for c in powers]))


MODELS: dict[str, tuple[float, Callable]] = {
    "coefficient": (1.068, coefficient),
    "module": (1.1, Net),
    "force_scale of a polynomial": (1.1, lambda x: replace(BELLOWS, force_scale=x)),
    "force_scale of a muscle": (1.1, lambda x: ta.McKibben(force_scale=x)),
    "force_scale of a grid": (1.1, lambda x: replace(GRID, force_scale=x)),
    "captured by a force": (0.9, lambda x: Closure(lambda e, p: x * p - 25 * e + 0 * e * p)),
    "behind a branch": (0.6, Branching),
    "field of a subclass": (1.1, lambda x: Scaled(at=x)),
    "max_pressure": (50.0, lambda x: replace(BELLOWS, max_pressure=x)),
    "K": (-0.3, lambda x: replace(BELLOWS, bending_stiffness=x)),
    "K near 0": (-1e-5, lambda x: replace(BELLOWS, bending_stiffness=x)),
    "K of LinearBending": (-0.3, lambda x: replace(BELLOWS, bending_stiffness=ta.LinearBending(x, 40.0))),
    "its reference pressure": (45.0, lambda x: replace(BELLOWS, bending_stiffness=ta.LinearBending(-0.4, x))),
    "K of ConstantBending": (-0.3, lambda x: replace(BELLOWS, bending_stiffness=ta.ConstantBending(x))),
    "captured by a BendingFunction": (
        -0.3,
        lambda x: replace(BELLOWS, bending_stiffness=ta.BendingFunction(lambda k, p: x * k * (0.3 + p / 50), 50.0)),
    ),
    "field of a bending model": (0.9, lambda x: replace(BELLOWS, bending_stiffness=Halved(-0.4, at=x))),
}


def metric(name, **options):
    return lambda arm: getattr(ta.evaluate(arm, TASK, metrics=name, **options), name)


def equilibrium(**options):
    return lambda arm: ta.solve_equilibrium(arm, PRESSURE, LOAD, 4, **options).poses[-1]


RESULTS: dict[str, Callable] = {
    "absolute": metric("absolute"),
    "relative": metric("relative"),
    "edges": metric("absolute", hull="edges"),
    "signed": metric("relative", signed=True, power=2),
    "in chunks": metric("absolute", chunk_size=1),
    "by scipy": metric("absolute", distance="scipy", samples=3),
    "relative in chunks": metric("relative", chunk_size=1),
    "signed relative": metric("relative", signed=True),
    "predicted": lambda arm: ta.evaluate(pair(arm), GENTLE, metrics="predicted_error").shape_error,
    "equilibrium": equilibrium(),
    "sheared equilibrium": equilibrium(shear_stiffness=1e3),
    "capacity": lambda arm: ta.load_capacity(arm, TASK).t_max_per_node,
    "capacity in chunks": lambda arm: ta.load_capacity(arm, TASK, chunk_size=1).t_max_per_node,
    "reaction": lambda arm: ta.reaction_wrench(arm, TASK.twists, PRESSURE),
    "hulls": lambda arm: areas(ta.wrench_hulls(arm, TASK.twists, samples=3).vertices),
}


VARIANTS = ("in chunks", "by scipy", "relative in chunks", "signed relative")
VARIANTS += ("sheared equilibrium", "capacity in chunks")
"""Of other results, for which a few parameters stand for all."""
KINKED_NOWHERE = ("predicted", "equilibrium", "reaction")
"""Of K near 0, where actuators' edges in their hulls turn about."""


def areas(vertices):
    x, y = vertices.unbind(-1)
    return (x * y.roll(-1, -1) - y * x.roll(-1, -1)).sum(-1) / 2


def pair(arm):
    return ta.ArmDesign(RADII[[0, 2]], 0.5, arm.actuators[:2])


def arm_of(model):
    return ta.ArmDesign(RADII, 0.5, [model, ta.Bellows(), model])


def weighted(value):
    """One number of a result, in which entries that are infinite or unknown have no part."""
    flat = value.flatten()
    known = flat.isfinite()
    return (flat * torch.linspace(1.0, 2.0, len(flat), dtype=D))[known].sum()


def leaf(value):
    return torch.tensor(value, dtype=D, requires_grad=True)


CASES = [
    (parameter, result)
    for parameter in MODELS
    for result in RESULTS
    if (parameter != "K near 0" or result in KINKED_NOWHERE)
    and (result not in VARIANTS or parameter in ("module", "K", "captured by a force"))
]


@pytest.mark.filterwarnings("error::UserWarning")  # as of tensors that become numbers
@pytest.mark.parametrize(("parameter", "result"), CASES)
def test_gradients_agree_with_differences(parameter, result):
    (start, make), answer = MODELS[parameter], RESULTS[result]
    at = leaf(start)
    model = make(at)
    wanted = model.at if parameter == "module" else at
    value = weighted(answer(arm_of(model)))
    (gradient,) = torch.autograd.grad(value, wanted)
    step = 2e-5 * max(abs(start), 0.3)
    with torch.no_grad():
        high, low = (weighted(answer(arm_of(make(at + side * step)))) for side in (1, -1))
    assert not high.requires_grad
    difference = float(high - low) / (2 * step)
    rounding = 64 * torch.finfo(D).eps * abs(float(high)) / step
    error = max(abs(float(gradient) - difference) - rounding, 0.0) / max(abs(difference), 1e-3)
    print(f"{parameter}, {result}: gradient {gradient:.9g}, difference {difference:.9g}, off by {error:.1e}")
    assert error < 1e-5


# --- parameters that happen to be equal ---


@dataclass(frozen=True)
class Tagged(ta.Bellows):
    """A model whose force depends on an attribute that is no field, by which `==` does not tell it apart."""

    def force(self, strain, pressure):
        return super().force(strain, pressure) * self.gain


def tagged(gain):
    model = Tagged()
    object.__setattr__(model, "gain", gain)
    return model


EQUAL: dict[str, Callable] = {
    "fields": lambda x: ta.McKibben(force_scale=x),
    "bending": lambda x: replace(BELLOWS, bending_stiffness=ta.LinearBending(-x)),
    "attributes": tagged,
}
ANSWERS: dict[str, Callable] = {
    "evaluate": lambda arm: ta.evaluate(arm, TASK, ("absolute", "relative")).absolute,
    "relative": lambda arm: ta.evaluate(arm, TASK, ("absolute", "relative")).relative,
    "equilibrium": lambda arm: ta.solve_equilibrium(arm, PRESSURE, LOAD, 4).poses[-1],
}


@pytest.mark.parametrize("kind", EQUAL)
@pytest.mark.parametrize("name", ANSWERS)
def test_equal_parameters_have_gradients_of_their_own(kind, name):
    make, answer = EQUAL[kind], ANSWERS[name]
    pair = [leaf(0.9), leaf(0.9)]

    def value(a, b):
        return weighted(answer(ta.ArmDesign(RADII, 0.5, [make(a), ta.Bellows(), make(b)])))

    gradients = torch.autograd.grad(value(*pair), pair)
    step = 1e-5
    with torch.no_grad():
        for place, gradient in enumerate(gradients):
            high, low = (value(*(x + side * step * (i == place) for i, x in enumerate(pair))) for side in (1, -1))
            difference = float(high - low) / (2 * step)
            print(f"{kind}, {name}: gradient {gradient:.9g}, difference {difference:.9g}")
            assert float(gradient) == pytest.approx(difference, rel=1e-5, abs=1e-7)
    assert gradients[0] != gradients[1]


def test_attributes_that_are_no_fields_tell_models_apart():
    arm = ta.ArmDesign(RADII, 0.5, [tagged(1.0), ta.Bellows(), tagged(0.5)])
    other = ta.ArmDesign(RADII, 0.5, [ta.Bellows(), ta.Bellows(), replace(BELLOWS, force_scale=0.5)])
    found, right = (ta.evaluate(one, TASK, ("absolute", "relative")).absolute for one in (arm, other))
    torch.testing.assert_close(found, right, rtol=1e-9, atol=1e-9)


# --- what is not differentiable says so, or goes on without ---


@pytest.mark.filterwarnings("error::UserWarning")
def test_fits_take_such_models_without_a_gradient_and_searches_with_one():
    for model in (ta.McKibben(force_scale=leaf(1.1)), Net(leaf(1.1)), replace(BELLOWS, bending_stiffness=leaf(-0.2))):
        with torch.no_grad():
            plain = ta.fit_pressure(arm_of(model), GENTLE)
        fit = ta.fit_pressure(arm_of(model), GENTLE)
        assert not fit.distance.requires_grad
        assert torch.equal(fit.pressure, plain.pressure)
        found = ta.search_pressure(pair(arm_of(model)), GENTLE, starts=1, rounds=0)
        assert found.cost.requires_grad  # by the envelope theorem
        assert found.cost.isfinite()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda x: replace(BELLOWS, coefficients=((0, 1, x),)), "coefficients: .*TensorPolynomial"),
        (lambda x: replace(GRID, pressures=(0.0, x, 60.0)), "pressures: .*force_scale"),
        (lambda x: replace(GRID, forces=((0.0, x, 50.0),) * 4), "forces: .*force_scale"),
        (lambda x: ta.BendingFunction(lambda k, p: -0.2 * k, x), "reference_pressure: .*does not depend"),
    ],
)
def test_fields_that_are_kept_as_numbers_refuse_graphs(make, message):
    with pytest.raises(ValueError, match=message):
        make(leaf(1.0))


TRANSFORMS = (torch.func.grad, torch.func.jacfwd, torch.func.jacrev, torch.func.hessian, torch.func.vmap)


@pytest.mark.parametrize("transform", TRANSFORMS)
@pytest.mark.parametrize(
    "function",
    [
        lambda x: ta.evaluate(
            ta.ArmDesign(RADII + x, 0.5, [BELLOWS] * 3), TASK, ("absolute", "relative")
        ).absolute.mean(),
        lambda x: ta.predict_error(ta.ArmDesign(RADII + x, 0.5, [BELLOWS] * 3), GENTLE).error,
        lambda x: ta.load_capacity(ta.ArmDesign(RADII + x, 0.5, [BELLOWS] * 3), GENTLE).factor,
        lambda x: ta.solve_equilibrium(ta.ArmDesign(RADII, 0.5, [BELLOWS] * 3), PRESSURE + x, LOAD).poses[-1, 0],
    ],
)
def test_transforms_are_refused_in_one_sentence(transform, function):
    at = torch.zeros(2, dtype=D) if transform is torch.func.vmap else torch.zeros((), dtype=D)
    with pytest.raises(RuntimeError, match=r"torch\.func .* are not supported; use plain autograd .*batches") as error:
        transform(function)(at)
    assert "\n" not in str(error.value)
