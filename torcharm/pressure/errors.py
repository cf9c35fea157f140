"""Errors of the poses at pressures that were found, as functions of designs and tasks.

What was found is a minimum over the pressures. By the envelope theorem the gradient of its cost is that with the
pressures held, but for those at a limit, which move with it; the shape follows its balance by the implicit function
theorem.
"""

from dataclasses import dataclass, replace
from typing import Any, TypeVar

import torch
from torch import Tensor

from torcharm.engine.descent import FLOOR
from torcharm.equilibrium.gradient import with_gradients
from torcharm.equilibrium.stability import strain_excess
from torcharm.geometry.rod import group_of
from torcharm.inputs import HoldsTensors
from torcharm.pressure.pose_cost import pose_errors
from torcharm.pressure.prepared import Prepared


@dataclass(frozen=True, eq=False, repr=False)
class Errors(HoldsTensors):
    """Of the shapes of a batch, with their gradients; attributes as of `PredictedError`."""

    tip_error: Tensor
    tip_rotation_error: Tensor
    shape_error: Tensor
    cost: Tensor
    per_node: Tensor
    pose_errors: Tensor
    pressure: Tensor
    twists: Tensor


@dataclass(frozen=True, eq=False, repr=False)
class Outcome(Errors):
    """What is said alike of pressures that are predicted, searched for and given; attributes as of `PredictedError`."""

    optimality: Tensor
    converged: Tensor
    stable: Tensor
    strain_excess: Tensor
    in_range: Tensor
    possible: Tensor


Told = TypeVar("Told", bound=Outcome)


def outcome(kind: type[Told], prepared: Prepared, errors: Errors, **found: Tensor) -> Told:
    """Errors and what else was found, in the dtype and on the device of what was given.

    Args:
        kind: of outcome.
        prepared: the problems.
        errors: the errors, with the pressures and shapes that they are of.
        found: all other attributes, but those of what is in range and what is possible.
    """
    with torch.no_grad():
        excess, within = strain_excess(replace(prepared.problem, pressure=errors.pressure), errors.twists)
    ranges = {"strain_excess": excess, "in_range": within, "possible": prepared.possible}
    columns = vars(errors) | found | {name: value.expand(prepared.batch) for name, value in ranges.items()}
    return kind(**{name: prepared.given_back(value) for name, value in columns.items()})


def errors_at(prepared: Prepared, normalised: Tensor, twists: Tensor, known: Tensor, stable: Tensor) -> Errors:
    """The errors at equilibria that were found.

    Args:
        prepared: the problems, with their graphs.
        normalised: (*batch, M) normalised pressures.
        twists: (*batch, N, K) the equilibria there.
        known: (*batch) which are minima; the gradients of the others are NaN, unless nothing depends on them.
        stable: (*batch) which are stable equilibria; the errors of the others are infinite.
    """
    limit = prepared.problem.pressure
    pressure = torch.where(normalised >= 1, limit, normalised * limit.detach())  # what is at a limit moves with it
    reached = with_gradients(replace(prepared.problem, pressure=pressure), twists, known)
    return errors_of(prepared, pressure, reached, known, stable)


def errors_of(prepared: Prepared, pressure: Tensor, reached: Tensor, known: Tensor, stable: Tensor) -> Errors:
    """The same of shapes (*batch, N, K) reached at pressures (*batch, M) [kPa], with their graphs."""
    problem, weight = prepared.problem, prepared.weights
    diagonal = prepared.cost.diagonal(problem.arm.neutral_length, prepared.dimension).unsqueeze(-2)
    wanted = prepared.poses(prepared.twists).expand(*problem.batch, *_pose_shape(prepared))
    wanted = _Known.apply(wanted, known) if wanted.requires_grad else wanted
    found = prepared.poses(reached)
    error = pose_errors(found, wanted)
    omega = prepared.cost.omega(prepared.nodes, error).sum()
    square, floor = error.square(), FLOOR * _mean_length(prepared)
    cost = (weight * square).sum((-2, -1))
    split = prepared.dimension
    tip = square[..., -1, :]
    infinite = float("inf")
    return Errors(
        tip_error=_masked(root(tip[..., :split].sum(-1), floor), stable, infinite),
        tip_rotation_error=_masked(root(tip[..., split:].sum(-1), floor), stable, infinite),
        shape_error=_masked(root(cost / omega, floor), stable, infinite),
        cost=_masked(cost, stable, infinite),
        per_node=_masked(root((diagonal * square).sum(-1), floor.unsqueeze(-1)), stable, infinite),
        pose_errors=_masked(error, stable, float("nan")),
        pressure=pressure,
        twists=reached,
    )


def _masked(value: Tensor, kept: Tensor, other: float) -> Tensor:
    """Numbers (*batch, ...), but another where they are not kept (*batch)."""
    return _Filled.apply(value, kept.view(kept.shape + (1,) * (value.ndim - kept.ndim)), other)


def root(square: Tensor, floor: Tensor) -> Tensor:
    """The square root; of what is no more than rounding, without a gradient: it would be one of size 1 of nothing."""
    none = square.detach() <= floor.square()
    known = torch.where(none, torch.ones_like(square), square).sqrt()
    return torch.where(none, square.detach().sqrt(), known)


def _pose_shape(prepared: Prepared) -> tuple[int, ...]:
    columns = 3 if prepared.dimension == 2 else 6
    return prepared.nodes + 1, *group_of(columns).POSE_SHAPE


def _mean_length(prepared: Prepared) -> Tensor:
    """(*batch) mean neutral length of the segments [m]."""
    return prepared.shaped(prepared.problem.packed.scale.length)


class _Filled(torch.autograd.Function):
    """Numbers, with another in place of those that are not kept, whose gradients are asked for all the same."""

    @staticmethod
    def forward(ctx: Any, value: Tensor, kept: Tensor, other: float) -> Tensor:
        return value.masked_fill(~kept, other)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None]:
        return gradient, None, None


class _Known(torch.autograd.Function):
    """Numbers (*batch, ...) whose gradient is NaN where it is asked for and not known."""

    @staticmethod
    def forward(ctx: Any, value: Tensor, known: Tensor) -> Tensor:
        ctx.save_for_backward(known)
        return value.clone()

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:
        (known,) = ctx.saved_tensors
        asked = (gradient != 0).flatten(known.ndim).any(-1)
        lost = (asked & ~known).view(known.shape + (1,) * (gradient.ndim - known.ndim))
        return gradient.masked_fill(lost, float("nan")), None
