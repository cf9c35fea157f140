"""Batches in which each element goes at its own pace: steps until all is over, and whoever is over leaves."""

from collections.abc import Callable
from typing import Any

from torcharm.mechanics import pick

KEPT = 0.6
"""Whoever is through is dropped once no more than this share of the batch is under way."""
Step = Callable[..., Any]
"""From what the elements are of, which can be indexed, their state, and options, to their next state. A state is a
named tuple of tensors whose batch comes last: among them `element`, their places in the whole batch, and `over`,
whether they are through. What is over stays as it is."""


def run(
    step: Step,
    own: Any,
    state: Any,
    looks: int,
    store: Callable[[Any], None],
    options: tuple[float, ...],
) -> None:
    """Take steps until all is over, so many at most.

    Args:
        step: for all at once.
        own: what the elements are of.
        state: of all.
        looks: steps at most.
        store: takes states that are over, and in the end what is not.
        options: of the step.
    """
    for _ in range(looks):
        state = step(own, state, *options)
        count = len(state.over)
        left = count - int(state.over.sum())
        if left == 0:
            break
        if left <= KEPT * count:
            store(state)
            on = (~state.over).nonzero().squeeze(-1)
            state, own = pick(state, on), own[on]
    store(state)
