"""Shapes predicted, with the gradients of minima."""

from typing import Any

import pytest
import torch

import torcharm as ta
from torcharm.pressure.followed import beyond_range, followed_twists

PLANE = ta.Task(ta.affine_curvature(0.3, 0.3, nodes=6), ta.sample_loads(4, (2.0, 2.0, 0.2)))
SPACE = ta.Task([[0.44, 0.0, 0.0, 0.0, 0.4, -0.5]] * 5, [1.0, -0.5, 0.5, 0.0, 0.0, 0.0])
POSITIONS = torch.tensor([-0.06, -0.02, 0.02, 0.05]).double()


def planar(change: torch.Tensor) -> ta.ArmDesign:
    """Bellows outside and muscles inside, all changed in radius, length and limit."""
    way = torch.tensor([0.3, -0.1, 0.2, -0.2]).double() * change
    models = [ta.Bellows(), ta.McKibben(), ta.McKibben(), ta.Bellows()]
    limits = torch.tensor([50.0, 100.0, 100.0, 50.0]).double() * (1 + way)
    return ta.ArmDesign(POSITIONS + 0.05 * way, 0.48 - way, models, limits)


def spatial(change: torch.Tensor) -> ta.ArmDesign:
    """A ring of bellows that grows and is stretched."""
    return ta.ArmDesign(offsets=ta.ring(0.05, 3).double() * (1 + change), length=0.4 + change, actuators=ta.Bellows())


@pytest.mark.parametrize(("arm", "task"), [(planar, PLANE), (spatial, SPACE)])
def test_gradients_of_strains_are_those_of_new_predictions(arm: Any, task: ta.Task) -> None:
    """Pressures that stay as they are would leave them far off: of the plane's, by a factor of ten."""

    def beyond(change: float) -> torch.Tensor:
        design = arm(torch.tensor(change).double())
        return beyond_range(design, task, ta.predict_error(design, task).twists).reshape(-1)

    change = torch.zeros((), dtype=torch.float64, requires_grad=True)
    found = ta.predict_error(arm(change), task)
    assert bool(found.converged.all())
    shapes = followed_twists(arm(change), task, None, found)
    torch.testing.assert_close(shapes, found.twists)
    ours = beyond_range(arm(change), task, shapes).reshape(-1)
    torch.testing.assert_close(ours, beyond(0.0))
    differences = (beyond(1e-5) - beyond(-1e-5)) / 2e-5
    for value, wanted in zip(ours, differences, strict=True):
        (slope,) = torch.autograd.grad(value, change, retain_graph=True)
        assert float(slope) == pytest.approx(float(wanted), rel=1e-4)


def test_shares_beyond_the_range_are_those_of_strains() -> None:
    model = ta.Bellows(strain_range=(-0.1, 0.3))
    arm = ta.ArmDesign([0.0], 0.5, model)
    for length, share in ((0.5, -0.25), (0.7, 0.25), (0.4, 0.25), (0.6, -0.25)):
        task = ta.Task([[length, 0.0, 0.0]] * 3)
        assert float(beyond_range(arm, task, task.twists)) == pytest.approx(share)
    endless = ta.ArmDesign([0.0], 0.5, ta.Bellows(strain_range=(-0.1, float("inf"))))
    assert float(beyond_range(endless, task, task.twists)) == pytest.approx(-0.3)
