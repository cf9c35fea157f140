import pytest
import torch

import torcharm as ta
from torcharm.geometry import se3
from torcharm.pressure.pose_cost import pose_errors


def test_weights_of_the_words():
    like = torch.tensor(0.5, dtype=torch.float64)  # the length of the paper's arms
    ramp = ta.PoseCost().weights(5, like)
    torch.testing.assert_close(ramp[:, 0], torch.tensor([0.0, 0.25, 0.5, 0.75, 1.0, 0.0]).double())
    torch.testing.assert_close(ramp[:, 2], 0.05 * ramp[:, 0])
    assert ta.PoseCost("uniform").weights(5, like)[:, 1].tolist() == [1, 1, 1, 1, 1, 0]
    assert ta.PoseCost("tip", (1, 1, 0)).weights(5, like)[-1].tolist() == [1, 1, 0]
    assert ta.PoseCost((0, 0, 2)).weights(3, like)[:, 0].tolist() == [0, 0, 2, 0]
    assert ta.PoseCost([0, 0, 2, 1]).weights(3, like)[:, 0].tolist() == [0, 0, 2, 1]


def test_an_arm_of_a_quarter_of_the_size_is_a_quarter_as_far_off():
    """Lengths, offsets and moments a quarter, forces the same: the mechanics do not know the size, nor do verdicts."""
    found = []
    for size in (1.0, 0.25):
        stiffness = size**2 * float(ta.Bellows().bending_stiffness)
        models = (ta.Bellows(bending_stiffness=stiffness), ta.Bellows(bending_stiffness=stiffness))
        arm = ta.ArmDesign([-0.08 * size, 0.08 * size], 0.5 * size, models)
        load = torch.tensor([[2.0, 1.0, 0.1 * size], [0.5, -4.0, 0.3 * size]], dtype=torch.float64)
        twists = ta.affine_curvature(0.5, 0.8) * torch.tensor([size, 1.0, 1.0], dtype=torch.float64)
        found.append(ta.evaluate(arm, ta.Task(twists, load)))
    torch.testing.assert_close(found[1].shape_error, 0.25 * found[0].shape_error, rtol=1e-6, atol=0)
    assert float(found[0].shape_error.min()) > 1e-3
    assert found[0].verdict.tolist() == found[1].verdict.tolist()


def test_weights_in_space():
    like = torch.tensor(0.5, dtype=torch.float64)
    assert ta.PoseCost().diagonal(like, 3).tolist() == [1, 1, 1, 0.05, 0.05, 0.05]
    assert ta.PoseCost("tip", (1, 1, 1, 0, 2, 2)).weights(4, like, 3)[-1].tolist() == [1, 1, 1, 0, 2, 2]
    with pytest.raises(ValueError, match="error_weights: must be 6 numbers in space"):
        ta.PoseCost("tip", (1, 1, 0)).weights(4, like, 3)


def test_errors_in_the_plane_are_those_of_space():
    generator = torch.Generator().manual_seed(0)
    reached, wanted = torch.rand(2, 7, 3, generator=generator, dtype=torch.float64)
    plane = pose_errors(reached, wanted)
    space = pose_errors(se3.from_plane(reached), se3.from_plane(wanted))
    torch.testing.assert_close(space[..., [0, 1, 5]], plane)
    torch.testing.assert_close(space[..., 2:5], torch.zeros_like(space[..., 2:5]), rtol=0, atol=1e-14)
    torch.testing.assert_close(ta.PoseCost()(space), ta.PoseCost()(plane))


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"node_weights": "rising"}, "node_weights"),
        ({"node_weights": [0.0, -1.0]}, "node_weights"),
        ({"node_weights": [0.0, 0.0]}, "node_weights"),
        ({"node_weights": 3}, "node_weights"),
        ({"error_weights": (1.0, 1.0)}, "error_weights"),
        ({"error_weights": (0.0, 0.0, 0.0)}, "error_weights"),
        ({"error_weights": (1.0, float("nan"), 0.0)}, "error_weights"),
    ],
)
def test_mistakes_are_named(given, named):
    with pytest.raises(ValueError, match=named):
        ta.PoseCost(**given)


def test_weights_that_do_not_fit_the_nodes():
    like = torch.zeros((), dtype=torch.float64)
    with pytest.raises(ValueError, match="node_weights: must be one of ramp, uniform, tip, or 3 or 4 numbers, got 2"):
        ta.PoseCost((1.0, 2.0)).weights(3, like)
    with pytest.raises(ValueError, match="a pose that moves"):
        ta.PoseCost((1.0, 0.0, 0.0)).weights(2, like)


@pytest.mark.parametrize("words", ["ramp", "uniform", "tip"])
def test_the_end_of_a_single_element_is_all_that_counts(words):
    found = ta.PoseCost(words).weights(1, torch.zeros((), dtype=torch.float64))
    assert found[:, 0].tolist() == [0.0, 1.0]
