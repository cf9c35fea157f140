"""Values that can be differentiated once, and say so instead of giving a wrong second derivative.

With normals, weights and pressures held (and in qpth's backward pass) second derivatives miss how the nearest point
moves along its face. Derivatives along a direction (`torch.autograd.functional.jvp`), which go through a graph of the
gradient too, are right.
"""

from typing import Any

import torch
from torch import Tensor


def once(value: Tensor) -> Tensor:
    """The same value, whose second derivatives are refused with a RuntimeError."""
    return _Once.apply(value) if value.requires_grad and torch.is_grad_enabled() else value


class _Once(torch.autograd.Function):
    """The identity; its gradient says that it depends on the value, but not how."""

    @staticmethod
    def forward(ctx: Any, value: Tensor) -> Tensor:
        ctx.save_for_backward(value)
        return value.view_as(value)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> Tensor:
        return _Tied.apply(gradient, _Refusal.apply(*ctx.saved_tensors)) if torch.is_grad_enabled() else gradient


class _Tied(torch.autograd.Function):
    """A gradient, made to depend on another tensor too."""

    @staticmethod
    def forward(ctx: Any, gradient: Tensor, other: Tensor) -> Tensor:
        return gradient.view_as(gradient)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Any:
        return *gradients, *gradients


class _Refusal(torch.autograd.Function):
    """The identity, which has no gradient: only asked for where a second derivative is."""

    @staticmethod
    def forward(ctx: Any, value: Tensor) -> Tensor:
        return value.view_as(value)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        raise RuntimeError("distance: has no second derivatives; differentiate once")
