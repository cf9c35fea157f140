"""Batches in which each element goes at its own pace: steps until all is over, and whoever is over leaves.

A step runs as PyTorch executes it, or compiled: then it is a few loops in place of some hundred operations, and 3 to 6
times as fast in batches of some hundred, where calls cost more than what they compute.
"""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from threading import RLock
from typing import Any

import torch

from torcharm.mechanics import pick

KEPT = 0.6
"""Whoever is through is dropped once no more than this share of the batch is under way."""
WORTH = 24
"""Compiled, only if these are so many at least."""
KINDS = 256
"""Kinds of arms for which a process keeps compiled steps, at most."""
SMALL_PRODUCT = 16
"""Sizes to which PyTorch compiles matrix products apart."""

ONE_AT_A_TIME = RLock()
"""Whoever sets PyTorch's settings, which are the whole process's."""

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
    compiled: bool,
) -> None:
    """Take steps until all is over, so many at most.

    Args:
        step: for all at once.
        own: what the elements are of.
        state: of all.
        looks: steps at most.
        store: takes states that are over, and in the end what is not.
        options: of the step.
        compiled: whether it runs compiled; within `compiling` only.
    """
    least, worth, settings = 0, 1, tuple[Any, ...](options)
    if compiled and len(state.over):
        step, least, worth = _compiled(step), _least_batch(state), WORTH
        settings = tuple(torch.tensor([value], dtype=torch.float64) for value in options)  # numbers would be constants
        index = torch.arange(max(least, len(state.over)), device=state.over.device) % len(state.over)
        state, own = pick(state, index), own[index]  # and no two tensors share memory, or code is for those that do
    for _ in range(looks):
        state = step(own, state, *settings)
        count = len(state.over)
        left = count - int(state.over.sum())
        if left == 0:
            break
        if left <= KEPT * count and count - max(left, least) >= worth:
            store(state)
            on = (~state.over).nonzero().squeeze(-1)
            if left < least:  # some that are over stay
                on = torch.cat((on, state.over.nonzero().squeeze(-1)[: least - left]))
            state, own = pick(state, on), own[on]
    store(state)


def _least_batch(state: Any) -> int:
    """Larger than any other dimension: code compiled for a batch that equals one is for such batches alone."""
    return 1 + max(SMALL_PRODUCT, *(size for value in state for size in value.shape[:-1]))


@cache
def _compiled(step: Step) -> Step:
    return torch.compile(step, dynamic=True, fullgraph=True, options={"cpp_wrapper": True})


@contextmanager
def compiling(device: torch.device) -> Iterator[None]:
    """Where compiled steps run: what a model is made of are constants of the code.

    Raises:
        ValueError: there is no C++ compiler, or the device is none that it compiles for.
    """
    if device.type != "cpu":
        raise ValueError(f"compiled: must be False for tensors that are not on the CPU, got them on {device}")
    check_compiler()
    settings = {
        "specialize_float": True,
        "specialize_int": True,
        "recompile_limit": KINDS,
        "accumulated_recompile_limit": 8 * KINDS,
    }
    with ONE_AT_A_TIME, torch._dynamo.config.patch(settings), warnings.catch_warnings():
        warnings.filterwarnings("ignore", category=FutureWarning, module="torch")  # of PyTorch by itself
        yield


def check_compiler() -> None:
    """Raise a ValueError where PyTorch finds no C++ compiler, or is too old."""
    if not hasattr(torch._dynamo.config, "accumulated_recompile_limit"):
        raise ValueError(f"compiled: must be False with a PyTorch as old as {torch.__version__}")
    from torch._inductor.cpp_builder import get_cpp_compiler
    from torch._inductor.exc import InvalidCxxCompiler

    try:
        get_cpp_compiler()
    except InvalidCxxCompiler:
        raise ValueError(
            "compiled: must be False without a C++ compiler, and none was found (g++, or what CXX names)"
        ) from None
