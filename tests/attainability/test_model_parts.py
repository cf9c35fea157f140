"""Models whose parts contradict each other: one that overrides its force alone is evaluated by that force."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import pytest
import torch
from hull_cases import unchecked

import torcharm as ta
from experiments.reference import converged_distance

D = torch.float64
TASK = ta.Task(ta.affine_curvature(-1.0, 1.5, 0.55, 6), torch.tensor([6.0, -40.0, 1.5], dtype=D))
GRID = ta.GriddedActuator(
    (-0.3, 0.0, 0.3, 0.7), (0.0, 20.0, 60.0), tuple((0.0, 18.0 - 9 * e, 50.0 - e) for e in range(4)), 50.0
)


@pytest.fixture(autouse=True)
def _unchecked():
    with unchecked():
        yield


class Plain:
    """A force from scratch, that says nothing more of itself: what the others are to agree with."""

    bending_stiffness, max_pressure = ta.Bellows().bending_stiffness, 50.0
    strain_range, pressure_range = (-0.5, 0.7), (0.0, 100.0)

    def __init__(self, model, factor, bending_stiffness=None):
        self.model, self.factor, self.max_pressure = model, factor, model.max_pressure
        if bending_stiffness is not None:
            self.bending_stiffness = bending_stiffness

    def force(self, strain, pressure):
        return self.factor * self.model.force(strain, pressure)


class Soft(ta.Bellows):
    def force(self, strain, pressure):
        return 0.5 * super().force(strain, pressure)


@dataclass(frozen=True)
class Softer(Soft):
    """The same, one class further away, as a dataclass."""


class SoftMuscle(ta.McKibben):
    def force(self, strain, pressure):
        return 0.5 * super().force(strain, pressure)


class SoftGrid(ta.GriddedActuator):
    def force(self, strain, pressure):
        return 0.5 * super().force(strain, pressure)


class Mixed:
    """Overrides the force from the side."""

    def force(self, strain, pressure):
        return 0.5 * super().force(strain, pressure)


class MixedBellows(Mixed, ta.Bellows):
    pass


class Forwarding:
    """Hands on whatever it does not have: also what was written of another force."""

    def __init__(self, model):
        self.model = model

    def __getattr__(self, name):
        return getattr(self.model, name)

    def force(self, strain, pressure):
        return 0.5 * self.model.force(strain, pressure)


class Straight:
    """Says in its constructor that it is linear in pressure, as it is."""

    bending_stiffness, max_pressure = Plain.bending_stiffness, 50.0
    strain_range, pressure_range = Plain.strain_range, Plain.pressure_range

    def __init__(self):
        self.model, self.pressure_degree = ta.Bellows(), 1

    def force(self, strain, pressure):
        return pressure - 60 * strain


class Bent(Straight):
    """And one that inherits the constructor, but is not."""

    def force(self, strain, pressure):
        return 0.5 * self.model.force(strain, pressure)


def on_the_object():
    model = ta.Bellows()
    object.__setattr__(model, "force", Soft().force)
    return model


@dataclass(frozen=True)
class HalfBent(ta.LinearBending):
    def active(self, curvature):
        return 0.5 * super().active(curvature)


@dataclass(frozen=True)
class RestingBent(ta.LinearBending):
    def passive(self, curvature):
        return -0.1 * curvature


HALF = Plain(ta.Bellows(), 0.5)
PAIRS = {
    "a subclass": (Soft(), HALF),
    "its subclass": (Softer(), HALF),
    "a muscle": (SoftMuscle(), Plain(ta.McKibben(), 0.5)),
    "a grid": (SoftGrid(GRID.strains, GRID.pressures, GRID.forces, 50.0), Plain(GRID, 0.5)),
    "from the side": (MixedBellows(), HALF),
    "forwarded": (Forwarding(ta.Bellows()), HALF),
    "in a constructor": (Bent(), HALF),
    "on the object": (on_the_object(), HALF),
    "bending": (
        ta.Bellows(bending_stiffness=HalfBent(-0.4)),
        Plain(ta.Bellows(), 1.0, ta.BendingFunction(lambda k, p: -0.2 * k * p / 50, 50.0)),
    ),
    "bending at rest": (
        ta.Bellows(bending_stiffness=RestingBent(-0.4)),
        Plain(ta.Bellows(), 1.0, ta.BendingFunction(lambda k, p: (-0.1 - 0.4 * p / 50) * k, 50.0)),
    ),
}
LOAD = torch.tensor([1.0, -3.0, 0.2], dtype=D)
NEAR = ta.Task(ta.affine_curvature(-0.6, 0.9, 0.6, 4), torch.tensor([0.6, -1.8, 0.1], dtype=D))


def absolute(arm, **options):
    found = ta.evaluate(arm, TASK, ("absolute", "relative"), **options)
    assert found.converged
    return found.absolute


ANSWERS = {
    "evaluate": (absolute, 1e-6),
    "edges": (lambda arm: absolute(arm, hull="edges"), 1e-9),
    "capacity": (lambda arm: ta.load_capacity(arm, TASK).t_max_per_node, 1e-6),
    "equilibrium": (lambda arm: ta.solve_equilibrium(arm, PRESSURE, LOAD, raise_on_failure=True).twists, 1e-7),
    "fit": (lambda arm: ta.fit_pressure(arm, NEAR, starts=2).distance, 1e-6),
}
PRESSURE = torch.tensor([40.0, 10.0, 20.0], dtype=D)


@pytest.mark.parametrize("kind", PAIRS)
@pytest.mark.parametrize("answer", ANSWERS)
def test_models_that_override_one_part_agree_with_the_same_written_from_scratch(kind, answer):
    question, tolerance = ANSWERS[answer]
    found, right = (question(ta.ArmDesign([-0.06, 0.0, 0.06], 0.5, [m, ta.Bellows(), m])) for m in PAIRS[kind])
    off = (found - right).abs().nan_to_num() / right.abs().nan_to_num().max().clamp(min=1e-3)
    print(f"{kind}, {answer}: {found.flatten()[0]:.9g}, from scratch {right.flatten()[0]:.9g}, {off.max():.1e} off")
    assert torch.equal(found.isfinite(), right.isfinite())
    assert off.max() <= tolerance


@pytest.mark.parametrize("kind", ["a subclass", "a grid", "forwarded", "bending"])
def test_predictions_agree_with_the_same_written_from_scratch(kind):
    arms = [ta.ArmDesign([-0.05, 0.05], 0.5, [model, ta.Bellows()]) for model in PAIRS[kind]]
    found, right = (ta.predict_error(arm, NEAR) for arm in arms)
    assert found.converged
    assert found.shape_error.item() == pytest.approx(right.shape_error.item(), rel=1e-6)


def test_the_soft_bellows_beside_a_muscle():
    arm = ta.ArmDesign([-0.06, 0.0, 0.06], 0.5, [Soft(), ta.McKibben(), Soft()])
    task = replace(TASK, wrench_at="start")
    assert ta.evaluate(arm, task, ("absolute", "relative")).absolute.item() == pytest.approx(164.95488, abs=1e-4)
    assert ta.predict_error(arm, task).cost.sqrt().item() == pytest.approx(0.2536, abs=1e-4)
    assert ta.solve_equilibrium(arm, [40.0, 10.0, 20.0], [1.0, -3.0, 0.2]).converged


# --- what is still believed ---


class Renamed(ta.Bellows):
    """Overrides nothing."""


class Rewritten(Soft):
    """Writes out what it overrode: a force linear in pressure."""

    pressure_degree = 1

    def force(self, strain, pressure):
        return pressure - 60 * strain


class Knotted(ta.Bellows):
    """Overrides the force, and names its kink beside it."""

    asked = SimpleNamespace(count=0)

    def force(self, strain, pressure):
        return pressure + (pressure - 17.3).relu() - 60 * strain

    def pressure_knots(self, strain):
        self.asked.count += 1
        return torch.full_like(strain, 17.3).unsqueeze(0)


def test_what_is_written_beside_the_force_counts():
    assert ta.actuators.pressure_degree(Renamed()) == 3
    assert ta.actuators.is_linear_in_pressure(Rewritten())
    assert ta.actuators.is_linear_in_pressure(Straight())
    assert not ta.actuators.is_linear_in_pressure(Bent())
    assert ta.actuators.pressure_degree(Knotted()) is None
    arm = ta.ArmDesign([-0.05, 0.05], 0.5, [Knotted()] * 2)
    found = ta.evaluate(arm, replace(TASK, wrench_at="start"), ("absolute", "relative")).absolute
    assert Knotted.asked.count > 0
    expected = converged_distance(arm, TASK.twists, TASK.tip_load).sum()
    assert found.item() == pytest.approx(expected, rel=1e-9)


class Counting(ta.Bellows):
    calls: list = []  # noqa: RUF012

    def force(self, strain, pressure):
        self.calls.append(strain.shape)
        return super().force(strain, pressure)


def test_plain_equal_copies_are_evaluated_together():
    counts = []
    for models in ([Counting()] * 3, [Counting(), Counting(), Counting()], [Counting(), Counting(force_scale=2.0)]):
        Counting.calls.clear()
        with torch.no_grad():
            ta.evaluate(ta.ArmDesign([-0.05, 0.0, 0.05][: len(models)], 0.5, models), TASK, metrics="absolute")
        counts.append(len(Counting.calls))
    assert counts[0] == counts[1]
    assert counts[2] == 2 * counts[0]
    with pytest.raises(ValueError, match="like: must be a polynomial that does not override its force"):
        ta.TensorPolynomial(Soft(), ta.coefficient_tensor(ta.Bellows()))


@pytest.mark.parametrize("lost", ["strain", "pressure"])
def test_a_force_whose_slope_is_lost_is_refused(lost):
    class Lossy(Soft):
        def force(self, strain, pressure):
            given = {"strain": strain, "pressure": pressure}
            given[lost] = torch.as_tensor(given[lost].detach().numpy().copy())
            return super().force(**given)

    arm = ta.ArmDesign([-0.05, 0.05], 0.5, [Lossy()] * 2)
    with pytest.raises(ValueError, match=f"Lossy.force: must be made of torch operations on {lost}"):
        ta.evaluate(arm, NEAR)


def test_a_force_that_no_pressure_changes_is_no_fault():
    class Core(Soft):
        def force(self, strain, pressure):
            return -60 * strain

    found = ta.evaluate(ta.ArmDesign([-0.05, 0.0, 0.05], 0.5, [Soft(), Core(), Soft()]), NEAR)
    assert found.absolute.isfinite()
