"""Batches whose elements go at their own pace."""

from typing import NamedTuple

import torch
from torch import Tensor

from torcharm._underway import run


class Countdown(NamedTuple):
    element: Tensor
    left: Tensor
    over: Tensor


def countdown(own: Tensor, state: Countdown, by: float) -> Countdown:
    left = torch.where(state.over, state.left, state.left - by)
    return Countdown(state.element, left, state.over | (left <= own))


def test_all_go_to_their_end_at_their_own_pace():
    start = torch.tensor([3.0, 50.0, 2.0, 7.0, 20.0, 4.0, 2.0])
    for looks, wanted in ((100, torch.ones(7)), (5, start - 5)):
        out = torch.full_like(start, float("nan"))
        ended = torch.zeros(7, dtype=torch.bool)
        sizes = []

        def step(own, state, by, sizes=sizes):
            sizes.append(len(own))
            return countdown(own, state, by)

        def store(state, out=out, ended=ended):
            out[state.element], ended[state.element] = state.left, state.over

        state = Countdown(torch.arange(7), start, torch.zeros(7, dtype=torch.bool))
        run(step, torch.ones(7), state, looks, store, (1.0,))
        assert torch.equal(out, torch.maximum(torch.ones(7), wanted))
        assert torch.equal(ended, out == 1)
        assert sizes == sorted(sizes, reverse=True)
        assert sizes[-1] < 7
