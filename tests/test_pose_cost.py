import pytest
import torch

import torcharm as ta


def test_weights_of_the_words():
    like = torch.zeros((), dtype=torch.float64)
    ramp = ta.PoseCost().weights(5, like)
    torch.testing.assert_close(ramp[:, 0], torch.tensor([0.0, 0.25, 0.5, 0.75, 1.0, 0.0]).double())
    torch.testing.assert_close(ramp[:, 2], 0.05 * ramp[:, 0])
    assert ta.PoseCost("uniform").weights(5, like)[:, 1].tolist() == [1, 1, 1, 1, 1, 0]
    assert ta.PoseCost("tip", (1, 1, 0)).weights(5, like)[-1].tolist() == [1, 1, 0]
    assert ta.PoseCost((0, 0, 2)).weights(3, like)[:, 0].tolist() == [0, 0, 2, 0]
    assert ta.PoseCost([0, 0, 2, 1]).weights(3, like)[:, 0].tolist() == [0, 0, 2, 1]


def test_the_cost_is_that_of_the_search():
    arm, task = ta.antagonistic_arm(), ta.Task(ta.affine_curvature(1.0, 1.5), [2.0, -3.0, 0.4])
    for words in ({}, {"node_weights": "tip"}, {"node_weights": "uniform", "error_weights": (1.0, 1.0, 0.0)}):
        found = ta.search_pressure(arm, task, starts=1, hops=0, **words)
        error, _ = ta.mechanics.pose_error(ta.poses(found.twists), ta.poses(task.twists))
        torch.testing.assert_close(ta.PoseCost(**words)(error), found.cost, rtol=1e-6, atol=1e-12)


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
        ta.PoseCost("ramp").weights(1, like)
