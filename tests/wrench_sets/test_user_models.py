"""Force models that only torch knows: one design alone, and among hundreds whose curves follow from a few strains."""

import pytest
import torch

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
