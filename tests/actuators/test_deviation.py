"""Built actuators: an arm that deviates is the arm of other models."""

from dataclasses import dataclass, replace

import pytest
import torch

import torcharm as ta
from torcharm.actuators.deviation import ForceDeviation
from torcharm.actuators.polynomial import BELLOWS_COEFFICIENTS

RADII = [-0.04, -0.02, 0.02, 0.04]
SCALE, BENDING = [1.1, 0.9, 1.05, 0.95], [1.2, 0.8, 1.0, 1.1]
OFFSET, CROSS = [0.4, 0.0, 0.0, -0.3], [0.02, 0.0, 0.0, -0.01]
TASK = ta.Task(ta.affine_curvature(0.5, 0.5, length=0.5), ta.sample_loads(4, (3, 3, 0.3)))


@dataclass(frozen=True)
class Rubber:
    """A model that the engine samples, with a bending law that it samples, too."""

    scale: float = 1.0
    stiffening: float = 1.0
    offset: float = 0.0
    max_pressure: float = 60.0
    strain_range: tuple = (-0.3, 0.5)
    pressure_range: tuple = (0.0, 60.0)

    @property
    def bending_stiffness(self):
        own = self.stiffening
        return ta.BendingFunction(lambda k, p: -own * (0.02 + 0.001 * p) * torch.tanh(k / 4) * 4, 60.0)

    def force(self, strain, pressure):
        return self.scale * (0.9 * pressure - 40 * torch.tanh(2 * strain) + self.offset)


def tensor(values):
    return torch.tensor(values, dtype=torch.float64)


def deviation(powers=(), terms=()):
    return ForceDeviation(tensor(SCALE), tensor(BENDING), tuple(powers), tuple(map(tensor, terms)))


def other_bellows(index, terms=()):
    own = ta.Bellows()
    coefficients = (*BELLOWS_COEFFICIENTS, *((i, j, values[index]) for (i, j), values in terms))
    bending = BENDING[index] * own.bending_stiffness
    return replace(own, coefficients=coefficients, force_scale=SCALE[index], bending_stiffness=bending)


def other_muscle(index):
    own = ta.McKibben()
    return replace(own, force_scale=SCALE[index], bending_stiffness=BENDING[index] * own.bending_stiffness)


def planar(models, **options):
    return ta.ArmDesign(radii=RADII, length=0.5, actuators=models, **options)


def assert_alike(one, other, task=TASK, metrics=("absolute", "relative", "predicted_error")):
    left, right = ta.evaluate(one, task, metrics), ta.evaluate(other, task, metrics)
    assert bool(right.prediction.converged.any())
    torch.testing.assert_close(left.tip_error, right.tip_error, rtol=0, atol=1e-9)
    torch.testing.assert_close(left.pressure, right.pressure, rtol=0, atol=1e-5)
    for name in metrics[:-1]:
        torch.testing.assert_close(getattr(left, name), getattr(right, name), rtol=0, atol=1e-8)


def test_scales_of_forces_and_moments_are_those_of_other_models():
    arm = planar(["bellows", "mckibben", "mckibben", "bellows"], deviation=deviation())
    assert_alike(arm, planar([other_bellows(0), other_muscle(1), other_muscle(2), other_bellows(3)]))


def test_offsets_and_further_terms_are_those_of_other_polynomials():
    arm, terms = planar(["bellows", "mckibben", "mckibben", "bellows"]), [((0, 0), OFFSET), ((1, 1), CROSS)]
    for some, metrics in ((terms[:1], ("absolute", "relative", "predicted_error")), (terms, ("predicted_error",))):
        built = arm.with_deviation(deviation(*zip(*some, strict=True)))
        others = [other_bellows(0, some), other_muscle(1), other_muscle(2), other_bellows(3, some)]
        assert_alike(built, planar(others), metrics=metrics)


def test_muscles_bear_offsets_too():
    arm = planar(["bellows", "mckibben", "mckibben", "bellows"])
    built = arm.with_deviation(deviation([(0, 0)], [[0.0, 0.5, -0.2, 0.0]]))
    pressure = torch.tensor([20.0, 40.0, 30.0, 25.0], dtype=torch.float64)
    found = ta.solve_equilibrium(built, pressure, [1.0, -1.0, 0.1])
    assert found.status == "converged"
    wrench = ta.reaction_wrench(built, found.twists, pressure)
    plain = ta.reaction_wrench(arm.with_deviation(deviation()), found.twists, pressure)
    added = tensor([0.0, 0.5 * 0.9, -0.2 * 1.05, 0.0])
    expected = torch.stack((added.sum(), -(added * tensor(RADII)).sum()))
    torch.testing.assert_close(wrench - plain, expected.expand_as(wrench), rtol=0, atol=1e-12)
    assert float(found.residual) < 1e-10


def test_sampled_models_and_bending_laws_deviate_alike():
    arm = planar([Rubber(), "mckibben", "mckibben", Rubber()])
    built = arm.with_deviation(deviation([(0, 0)], [OFFSET]))
    others = [Rubber(SCALE[i], BENDING[i], OFFSET[i]) if i in (0, 3) else other_muscle(i) for i in range(4)]
    pressure = torch.tensor([20.0, 40.0, 30.0, 25.0], dtype=torch.float64)
    one, other = (ta.solve_equilibrium(arm, pressure, [1.0, -1.0, 0.1]) for arm in (built, planar(others)))
    assert one.status == other.status == "converged"
    torch.testing.assert_close(one.twists, other.twists, rtol=0, atol=1e-9)
    assert_alike(built, planar(others))


def test_in_space_with_torsion_and_in_series():
    place = ta.ring(radius=0.04, count=4)

    def arm(models, **options):
        lower = ta.ArmDesign(offsets=place, length=0.3, actuators=models, torsion_stiffness=2.0, **options)
        upper = ta.ArmDesign(offsets=0.8 * place, length=0.25, actuators="bellows", torsion_stiffness=2.0)
        return ta.series([lower, ta.RigidLink(length=0.02), upper])

    built = arm(["bellows", "mckibben", "mckibben", "bellows"], deviation=deviation([(0, 0)], [OFFSET]))
    some = [((0, 0), OFFSET)]
    other = arm([other_bellows(0, some), other_muscle(1), other_muscle(2), other_bellows(3, some)])
    pressure = torch.tensor([20.0, 40.0, 30.0, 25.0, 10.0, 20.0, 10.0, 5.0], dtype=torch.float64)
    load = [0.5, -1.0, 0.4, 0.02, 0.05, -0.1]
    one, same = (ta.solve_equilibrium(each, pressure, load, 4) for each in (built, other))
    assert one.status == same.status == "converged"
    torch.testing.assert_close(one.twists, same.twists, rtol=0, atol=1e-10)


def test_gradients_by_deviations_are_exact():
    arm = planar(["bellows", "mckibben", "mckibben", "bellows"])
    parts = [tensor(SCALE), tensor(BENDING), tensor(OFFSET)]

    def tip(*values):
        own = ForceDeviation(*values[:2], ((0, 0),), values[2:])
        found = ta.solve_equilibrium(arm.with_deviation(own), [20.0, 40.0, 30.0, 25.0], [1.0, -1.0, 0.1])
        return found.poses[-1, :2]

    assert torch.autograd.gradcheck(tip, [part.requires_grad_() for part in parts], eps=1e-6, atol=1e-7)

    def missing(*values):
        own = ForceDeviation(*values[:2], ((0, 0),), values[2:])
        heavy = ta.Task(TASK.twists, [[30.0, -20.0, 2.0], [-25.0, 10.0, -3.0]])
        found = ta.evaluate(arm.with_deviation(own), heavy, ("absolute", "relative"))
        return found.absolute, found.relative

    assert all(bool((value > 0).any()) for value in missing(*parts))
    assert torch.autograd.gradcheck(missing, parts, eps=1e-6, atol=1e-5)


def test_sets_refuse_terms_that_depend_on_strain():
    arm = planar("bellows").with_deviation(deviation([(1, 1)], [CROSS]))
    with pytest.raises(ValueError, match="metrics: must be predicted_error alone"):
        ta.evaluate(arm, TASK)


def test_batches_are_indexed_moved_and_flattened_with_their_deviations():
    arm = ta.ArmDesign(radii=[RADII] * 3, length=0.5, actuators="bellows")
    scale = torch.linspace(0.9, 1.1, 3, dtype=torch.float64).unsqueeze(-1)
    built = arm.with_deviation(ForceDeviation(scale, torch.ones_like(scale)))
    assert built.deviation.force_scale.shape == (3, 4)
    assert float(built[2].deviation.force_scale[0]) == 1.1
    assert built.to(torch.float32).deviation.force_scale.dtype == torch.float32
    moved = built[0].with_values(arm.radii, arm.length, arm.max_pressure)
    assert moved.deviation.force_scale.shape == (3, 4)
    assert bool((moved.deviation.force_scale == 0.9).all())
    single = ta.evaluate(built[1], TASK, "predicted_error").tip_error
    torch.testing.assert_close(ta.evaluate(built, TASK, "predicted_error").tip_error[1], single, rtol=0, atol=1e-12)
