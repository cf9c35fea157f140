"""How an arm is without pressure and load."""

import pytest
import torch

import torcharm as ta
from torcharm.design.rest import rest_words


@pytest.mark.parametrize(
    "arm",
    [
        ta.ArmDesign([-0.05, 0.05], 0.5, "bellows"),
        ta.ArmDesign(offsets=ta.ring(0.05, 3), length=0.5, actuators="bellows"),
    ],
)
def test_nothing_is_said_of_an_arm_that_hangs_straight(arm: ta.ArmDesign) -> None:
    assert rest_words(arm) == ""


@pytest.mark.parametrize("in_space", [False, True])
def test_a_lopsided_arm_hangs_to_the_side(in_space: bool) -> None:
    """What is alike along the arm bends it to an arc, whose tip is l (1 - cos κ) / κ aside."""
    if in_space:
        offsets = [[0.0, -0.05], [0.0, 0.05], [-0.05, 0.0], [0.05, 0.0]]
        arm = ta.ArmDesign(offsets=offsets, length=[0.45, 0.55, 0.5, 0.5], actuators="bellows")
    else:
        arm = ta.ArmDesign([-0.05, 0.05], [0.45, 0.55], "bellows")
    rest = ta.solve_equilibrium(arm, 0.0, [0.0] * (6 if in_space else 3), nodes=40)
    length, bend = float(rest.twists[..., 0].mean()), float(rest.twists[..., 1 + 2 * in_space :].norm(dim=-1).mean())
    aside = 1e3 * length / bend * (1 - torch.tensor(bend).cos())
    assert f"its tip hangs {float(aside):.0f} mm to the side, and it is {1e3 * length:.0f} mm long" in rest_words(arm)


def test_strains_beyond_the_range_are_told_of_a_straight_arm() -> None:
    stiff = ta.PolynomialActuator(((1, 0, -500.0),), (-0.01, 0.01), (0.0, 50.0), 50.0)
    arm = ta.ArmDesign([-0.05, 0.0, 0.05], [0.5, 0.6, 0.5], [stiff, stiff, stiff])
    assert rest_words(arm).endswith("mm long, strained beyond the characterised range")
