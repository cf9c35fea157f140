"""Words on what an optimisation found: distances, never the price of leaving a range."""

import math
from typing import Any

import pytest
import torch

from torcharm.design.result import compared_words, reached_words
from torcharm.design.task_errors import TaskErrors


def errors(millimetres: list[float], out_of_range: int, beyond: float = 0.0) -> TaskErrors:
    shape = 1e-3 * torch.tensor(millimetres, dtype=torch.float64)
    count, stable = len(millimetres), shape.isfinite()
    in_range = torch.arange(count) >= out_of_range
    return TaskErrors(shape, shape, torch.zeros(count, 2), stable, stable, in_range, torch.full((count,), beyond))


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        (([3.0, 1.0], 0), ([0.5, 0.3], 0), "shape off by 2 → 0.4 mm"),
        (([3.0, 1.0], 2), ([0.5, 0.3], 0), "shape off by 2 → 0.4 mm, out of range on 2 → 0 of 2 tasks"),
        (([3.0], 1), ([4.0], 0), "shape off by 3 → 4 mm, which is more, but out of range on 1 → 0 of 1 task"),
        (([3.0], 1), ([4.0], 1), "shape off by 3 → 4 mm, which is more, out of range on 1 → 1 of 1 task"),
        (
            ([3.0], 1, 0.3),
            ([4.0], 1, 0.1),
            "shape off by 3 → 4 mm, which is more, but less far beyond the range, out of range on 1 → 1 of 1 task",
        ),
        (
            ([3.0, math.inf], 0),
            ([4.0, 6.0], 0),
            "shape off by 3 → 5 mm, which is more, but without a stable equilibrium on 1 → 0 of 2 tasks",
        ),
    ],
)
def test_a_plain_error_that_rises_is_told_as_such(before: tuple[Any, ...], after: tuple[Any, ...], words: str) -> None:
    assert compared_words(errors(*before), errors(*after), "mean") == words


def test_the_worst_is_named_where_it_is_minimised() -> None:
    one = errors([3.0, 1.0, math.inf], 1)
    assert compared_words(one, one, "worst").startswith("shape off by at most 3 → 3 mm")
    assert reached_words(one, "worst") == "at most 3 mm, out of range on 1, without a stable equilibrium on 1"
