"""Words for flags."""

import torch

from torcharm.equilibrium.status import status_word

WORDS = ("fine", "dubious", "wrong")


def test_the_last_flag_that_is_not_set_has_the_word():
    sure, right = torch.tensor([True, False, True, False]), torch.tensor([True, True, False, False])
    assert status_word(WORDS, sure, right).tolist() == ["fine", "dubious", "wrong", "wrong"]
    assert status_word(WORDS, sure[1], right[1]) == "dubious"
