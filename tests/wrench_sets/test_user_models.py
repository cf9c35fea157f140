"""Force models that only torch knows: one design alone, and among hundreds whose curves follow from a few strains."""

import math
from dataclasses import dataclass

import numpy as np
import oracle
import pytest
import torch
from hull_cases import double

import torcharm as ta
from experiments.exactness.models import SmoothModel


class Overflowing(SmoothModel):
    def force(self, strain, pressure):
        return pressure * (0.5 + strain) + pressure * torch.exp(100 * (strain - 1))


class Undefined(SmoothModel):
    """Without a number from a strain of 1 on."""

    def force(self, strain, pressure):
        bump = 30 * torch.exp(-(((pressure - 30) / 5) ** 2))
        return (0.2 * pressure + bump - 40 * strain) * (1 - strain).sqrt()


class Stepping(SmoothModel):
    """A force that jumps where a muscle begins to stretch, and does not change with strain otherwise."""

    def force(self, strain, pressure):
        return torch.where(strain > 0.0, pressure, 1.2 * pressure) + 0.01 * pressure**2


class Steep(SmoothModel):
    def force(self, strain, pressure):
        return 50 * torch.tanh((pressure - 20) / 0.5) * (1 - strain) - 40 * strain


@pytest.mark.parametrize("model", [Overflowing(), Undefined(), Stepping(), Steep(), SmoothModel()])
@pytest.mark.parametrize("odd", [None, 0.05, 0.1])
@pytest.mark.parametrize("metric", ["absolute", "relative"])
def test_a_design_among_others_is_what_it_is_alone(model, odd, metric):
    generator = torch.Generator().manual_seed(3)
    radii = 0.04 + 0.04 * torch.rand(60, 3, generator=generator, dtype=torch.float64)
    radii[:, 0] *= -1
    length = torch.full((60, 3), 0.5, dtype=torch.float64)
    if odd is not None:
        length[31] = odd
    limit = 60.0 * torch.ones(60, 3, dtype=torch.float64)
    task = ta.Task(ta.affine_curvature(1.0, 0.2, length=0.5, nodes=4), [-500.0, 20.0, 1.0])
    together = ta.evaluate(ta.ArmDesign(radii, length, model, limit), task, (metric,))
    for design in (0, 30, 59):
        alone = ta.evaluate(ta.ArmDesign(radii[design], length[design], model, limit[design]), task, (metric,))
        value, other = getattr(together, metric)[design], getattr(alone, metric)
        assert together.distances_converged[design]
        assert value.item() == pytest.approx(other.item(), abs=1e-5, rel=1e-7)


def test_in_single_precision_a_named_kink_is_where_it_is():
    class Kinked(SmoothModel):
        pressure_degree = 1

        def pressure_knots(self, strain):
            return (20 + 20 * strain).unsqueeze(0)

        def force(self, strain, pressure):
            return 0.5 * pressure + 2 * (pressure - 20 - 20 * strain).relu() - 40 * strain

    task = ta.Task(ta.affine_curvature(1.0, 0.2, length=0.5, nodes=4), [10.0, 2.0, 1.0])
    found = {}
    for dtype in (torch.float64, torch.float32):
        radii = torch.tensor([-0.05, 0.04, 0.07], dtype=dtype)
        arm = ta.ArmDesign(radii, torch.full((3,), 0.5, dtype=dtype), Kinked(), torch.full((3,), 60.0, dtype=dtype))
        own = ta.Task(task.twists.to(dtype), task.tip_load.to(dtype))
        found[dtype] = ta.evaluate(arm, own, ("absolute", "relative"))
        assert ta.evaluate(arm, own, ("absolute",)).distances_converged
    for metric in ("absolute", "relative"):
        single, double = (getattr(found[dtype], metric).item() for dtype in (torch.float32, torch.float64))
        assert single == pytest.approx(double, abs=1e-3)


@pytest.mark.parametrize(
    ("force", "said"),
    [
        (lambda strain, pressure: (pressure - 40 * strain).sum(), "a sum or a mean"),
        (lambda strain, pressure: 3.0, "'float' object"),
        (lambda strain, pressure: (pressure * strain).detach().numpy(), "numpy"),
        (lambda strain, pressure: pressure.detach() * strain.detach(), "autograd finds no slope"),
    ],
)
def test_a_force_that_is_none_is_refused_by_the_actuators_name(force, said):
    class Wrong(SmoothModel):
        pass

    Wrong.force = lambda self, strain, pressure: force(strain, pressure)
    task = ta.Task(ta.affine_curvature(1.0, 0.2, length=0.5, nodes=4), [10.0, 2.0, 1.0])
    with pytest.raises(ValueError, match=r"^actuators\[1\]") as error:
        ta.evaluate(ta.ArmDesign([-0.05, 0.05], 0.5, [ta.Bellows(), Wrong()]), task, ("absolute",))
    assert said in str(error.value)


SHAPE = double([[0.48, 0.01, 0.7], [0.51, -0.01, -0.9], [0.5, 0.02, 0.2]])


@dataclass(frozen=True)
class Piston:
    """An actuator that shares nothing with torcharm's own."""

    area: float = 0.8
    bending_stiffness: float = -0.1
    max_pressure: float = 60.0
    strain_range: tuple[float, float] = (-0.3, 0.3)
    pressure_range: tuple[float, float] = (0.0, 60.0)

    def force(self, strain, pressure):
        return self.area * pressure * torch.exp(-strain) - 20 * strain


@pytest.mark.parametrize("kind", ["exact", "edges"])
def test_a_force_model_of_ones_own_mixes_with_the_librarys(kind):
    twin = oracle.Actuator(lambda e, p: 0.8 * p * math.exp(-e) - 20 * e, -0.1, 60.0)
    bellows = oracle.Actuator(oracle.bellows_force)
    arm = ta.ArmDesign([-0.05, 0.01, 0.04], 0.5, [Piston(), ta.Bellows(), Piston()])
    limits = (60.0, 50.0, 60.0)
    expected_arm = oracle.Arm((-0.05, 0.01, 0.04), (0.5,) * 3, limits, (twin, bellows, twin))
    twists, load = SHAPE, double([[-8.3, 3.1, 0.6]])
    options = {"hull": "edges"} if kind == "edges" else {"distance": "scipy"}
    task = ta.Task(twists, load, wrench_at="start")
    result = ta.evaluate(arm, task, ("absolute", "relative"), samples=5, **options)
    exact = ta.evaluate(arm, task, ("absolute", "relative"))
    assert (exact.absolute_per_node <= result.absolute_per_node + 1e-10).all()
    assert (exact.relative_per_node <= result.relative_per_node + 1e-10).all()
    expected = oracle.node_distances(expected_arm, twists, load[0], kind=kind, samples=5)
    np.testing.assert_allclose(result.absolute_per_node[0], expected.absolute.clip(min=0), rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(result.relative_per_node[0], expected.relative.clip(min=0), rtol=1e-9, atol=1e-10)
    assert arm.max_pressure.tolist() == list(limits)


def test_a_force_that_is_one_number_counts_everywhere():
    class Constant(ta.Bellows):
        def force(self, strain, pressure):
            return torch.tensor(3.0)

    spread = ta.PolynomialActuator(((0, 0, 3.0),), (-1.0, 1.0), (0.0, 50.0), 50.0, ta.Bellows().bending_stiffness)
    task = ta.Task(ta.affine_curvature(0.0, 1.0, length=0.4, nodes=5), [1.0, -2.0, 0.1])
    one, other = (
        ta.evaluate(ta.ArmDesign([-0.05, 0.05], 0.42, [model] * 2), task, ("absolute", "relative"))
        for model in (Constant(), spread)
    )
    assert one.absolute.item() == pytest.approx(other.absolute.item(), rel=1e-12)
    assert one.relative.item() == pytest.approx(other.relative.item(), rel=1e-12)


def test_nan_from_a_force_model_stays_nan():
    arm = ta.ArmDesign([-0.05, 0.04], 0.5, [ta.Bellows(), Piston(area=math.nan)])
    result = ta.evaluate(arm, ta.Task(SHAPE, ta.sample_loads(3)), ("absolute", "relative"))
    assert result.absolute.isnan().all()
    assert result.relative.isnan().all()
