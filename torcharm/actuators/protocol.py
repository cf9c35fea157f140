"""What torcharm asks of a force model, and the questions it asks on the model's behalf."""

import math
from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np
import torch
from torch import Tensor

from torcharm.actuators.bending import (
    Bending,
    ConstantBending,
    Number,
    active_moment,
    bending_model,
    check_restoring,
    passive_moment,
)
from torcharm.actuators.inspection import follows, holds_numbers_only, written_out
from torcharm.inputs import plain_number, shown

T = TypeVar("T")

PROBED = (-0.4, -0.1, 0.0, 0.1, 0.4)
"""Strains, beside the ends of its range, at which a model is asked whether its force wants gradients."""
NUDGES = {"strain": 1e-3, "pressure": 0.1}
"""By how much strain and pressure [kPa] are changed to see whether a force does that has no slope by them."""
PROBED_SHARES = (0.0, 0.1, 0.5, 1.0)
"""Pressures, in shares of its highest."""
PROBED_CURVATURES = (-10.0, -1.0, 0.0, 1.0, 10.0)
"""Material curvatures [rad/m], for bending moments."""


@runtime_checkable
class Actuator(Protocol):
    """A fluid-driven actuator: its axial force, and what is needed to trust it.

    Any object with the members listed in `MEMBERS` is an actuator; nothing needs to be inherited or
    registered. An object that stands in several places is evaluated once for all of them, and so are dataclasses of one
    class whose attributes are equal numbers, texts and tuples of these; tensors and parameters are never taken for
    one another, equal or not. Numbers may be tensors, and results are differentiable in them, in parameters
    of modules and in whatever else force and bending moments are computed from.

    All further members are optional:

    - `pressure_knots(strain)` returns pressures (k, *strain.shape) [kPa], in any order, at which the force has a kink.
    - `pressure_degree = 3` says that between its kinks the force is a polynomial in pressure of that degree:
      up to 3 one cubic piece stands for the whole curve, and at degree 1 two samples. Knots and degree let torcharm be
      exact where it would else be accurate, and count where they were written for the force: a subclass that overrides
      `force` has none of its parent's, unless it writes its own.
    - `characterised(strain, pressure)` says, by a mask, where within its ranges the model was measured: what is found
      elsewhere is out of range.
    - `moulded = True` says that it is part of one body with the others of its segment that say so: they have one
      length, which an optimiser changes for all of them.
    - `name`, a text, is what tables and legends call it, in place of its class.

    Example:
        >>> [isinstance(given, ta.Actuator) for given in (ta.Bellows(), ta.chamber(area=2e-4), "bellows")]
        [True, True, False]
    """

    @property
    def bending_stiffness(self) -> Number | Bending:
        """K [N·m²] of the bending moment `τ = K (p / max_pressure) κ/l`, at most 0: negative resists bending.

        Or a model of it: `LinearBending`, `ConstantBending`, `BendingFunction` or one's own.
        """
        ...

    @property
    def max_pressure(self) -> Number:
        """Highest pressure in use [kPa]: the default limit, and the pressure at which K holds by default."""
        ...

    @property
    def strain_range(self) -> tuple[float, float]:
        """Strains over which the model was characterised."""
        ...

    @property
    def pressure_range(self) -> tuple[float, float]:
        """Pressures [kPa] over which the model was characterised."""
        ...

    def force(self, strain: Tensor, pressure: Tensor) -> Tensor:
        """Axial force [N] at a strain and a pressure [kPa], positive pushing outward.

        Broadcasts its arguments, and is differentiable in both.
        """
        ...


MEMBERS = ("force", "bending_stiffness", "max_pressure", "strain_range", "pressure_range")
"""All that a force model must have."""


def model_name(actuator: Actuator) -> str:
    """What tables and legends call a force model: its own `name`, or its class's; else the class by its name."""
    name = {**vars(type(actuator)), **getattr(actuator, "__dict__", {})}.get("name")
    return name if isinstance(name, str) and name else type(actuator).__name__


def is_moulded(actuator: Actuator) -> bool:
    """Whether the model says that it is part of a moulded body, and so has no length of its own."""
    return getattr(actuator, "moulded", False) is True


def check_actuator(name: str, actuator: object) -> None:
    """Raise a ValueError unless the object has the `MEMBERS` of an actuator, with numbers in them."""
    missing = [member for member in MEMBERS if not hasattr(actuator, member)]
    if isinstance(actuator, type) or missing:
        what = "a class (an instance is needed)" if isinstance(actuator, type) else f"no {', '.join(missing)}"
        raise ValueError(
            f"{name}: must be a force model such as Bellows() or McKibben(), got {shown(actuator)} with {what}"
        )
    check_numbers(actuator, f"{name}.")


def check_numbers(actuator: Any, prefix: str = "") -> None:
    """Raise a ValueError, naming the field, unless the numbers of a force model make sense."""
    for field, low, allowed in (
        ("max_pressure", 0.0, "finite and above 0 kPa"),
        ("bending_stiffness", -math.inf, "a finite number or a bending model"),
        ("force_scale", -math.inf, "a finite number"),
    ):
        value = getattr(actuator, field, 1.0)
        modelled = field == "bending_stiffness" and bending_model(value) is not None and isinstance(value, Bending)
        if not modelled and not low < _number(value) < math.inf:
            raise ValueError(f"{prefix}{field}: must be {allowed}, got {shown(value)}")
        if field == "bending_stiffness":
            check_restoring(f"{prefix}{field}", value)
    for field in ("strain_range", "pressure_range"):
        value = getattr(actuator, field)
        ends = [_number(end) for end in value] if isinstance(value, (tuple, list)) else []
        if len(ends) != 2 or not ends[0] <= ends[1]:
            raise ValueError(f"{prefix}{field}: must be two numbers (lowest, highest), got {shown(value)}")


def _number(value: Any) -> float:
    try:
        return plain_number(value)
    except (TypeError, ValueError, RuntimeError):
        return math.nan


def pressure_degree(actuator: Actuator) -> int | None:
    """The degree in pressure of the force between its kinks, if the model says so."""
    if not written_out(actuator, "pressure_degree"):
        return None
    degree: int | None = actuator.pressure_degree  # type: ignore[attr-defined]
    return degree


def pressure_knots(actuator: Actuator, strain: Tensor) -> Tensor:
    """Pressures (k, *strain.shape) [kPa] at which the model says its force has a kink; k may be 0."""
    if not written_out(actuator, "pressure_knots"):
        return strain.new_empty(0, *strain.shape)
    knots: Tensor = actuator.pressure_knots(strain)  # type: ignore[attr-defined]
    return knots


def is_linear_in_pressure(actuator: Actuator) -> bool:
    """Whether the model says that its force is affine in pressure."""
    degree = pressure_degree(actuator)
    return degree is not None and degree <= 1 and not written_out(actuator, "pressure_knots")


def is_passive(actuator: Actuator) -> bool:
    """Whether the model says that pressure changes neither its force nor its moment: an elastic core, or a hose."""
    constant = follows(actuator.bending_stiffness, ConstantBending, "active")
    return constant and pressure_degree(actuator) == 0 and not written_out(actuator, "pressure_knots")


def force_slopes(actuator: Actuator, strain: Tensor, pressure: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """f, ∂f/∂ε and ∂f/∂p, detached.

    Raises:
        ValueError: the force changes with strain or pressure, but autograd finds no slope.
    """
    with torch.enable_grad():
        strain = strain.detach().requires_grad_()
        pressure = pressure.detach().expand_as(strain).clone().requires_grad_()
        given = actuator.force(strain, pressure)
        force = given.expand_as(strain)
        known: Sequence[Tensor | None] = (None, None)  # of a constant force
        if force.requires_grad:
            known = torch.autograd.grad(force.sum(), (strain, pressure), allow_unused=True)
    if given.numel() < strain.numel() and any(slope is not None for slope in known):
        raise ValueError(
            f"{type(actuator).__name__}.force: must return a force for each strain and pressure, got "
            f"{given.numel()} for {strain.numel()} (a sum or a mean?)"
        )
    slopes = [torch.zeros_like(strain) if slope is None else slope for slope in known]
    for name, slope in zip(("strain", "pressure"), known, strict=True):
        if slope is None:
            _check_constant(actuator, name, strain.detach(), pressure.detach(), force)
    return force.detach(), slopes[0], slopes[1]


def sampled_of(name: str, sample: Callable[..., T], *arguments: Any) -> T:
    """What is sampled of a model, or a ValueError that names the actuator."""
    try:
        with np.errstate(invalid="ignore", over="ignore"):  # what has no number has no equilibrium
            return sample(*arguments)
    except (TypeError, ValueError, RuntimeError, AttributeError, IndexError) as error:
        said = f"{type(error).__name__}: {' '.join(str(error).split()):.250}"
        raise ValueError(
            f"{name}: must return a value for every strain and pressure, by torch operations on tensors (torch.where, "
            f"not if; torch.exp, not numpy's or math's), got {said}"
        ) from error


def _check_constant(actuator: Actuator, name: str, strain: Tensor, pressure: Tensor, force: Tensor) -> None:
    """Raise a ValueError if a force without a slope by strain or pressure changes with it all the same, either way.

    Where it jumps it does so one way.
    """
    step, changed = NUDGES[name], torch.ones_like(force, dtype=torch.bool)
    for sign in (1, -1):
        by_strain, by_pressure = (sign * step, 0.0) if name == "strain" else (0.0, sign * step)
        with torch.no_grad():
            other = actuator.force(strain + by_strain, pressure + by_pressure).expand_as(force)
        changed &= ~torch.isclose(other, force, rtol=1e-9, atol=0.0, equal_nan=True)
    if bool(changed.any()):
        raise ValueError(
            f"{type(actuator).__name__}.force: must be made of torch operations on {name}: its values "
            f"change with {name}, but autograd finds no slope (detached, or worked out by numpy?)"
        )


def want_gradients(actuators: tuple[Actuator, ...], like: Tensor) -> bool:
    """Whether forces or bending moments hold something that wants a gradient, while gradients are recorded.

    Found by asking them for some: what they hold may be fields, parameters of modules, or captured by functions.
    """
    if not torch.is_grad_enabled():
        return False
    first = {id(model): index for index, model in reversed(list(enumerate(actuators)))}
    return any(sampled_of(f"actuators[{a}].force", _wants_gradient, actuators[a], like) for a in sorted(first.values()))


def _wants_gradient(model: Actuator, like: Tensor) -> bool:
    if holds_numbers_only(model):
        return False
    stiffness, most = model.bending_stiffness, plain_number(model.max_pressure)
    bending = bending_model(stiffness)
    held = (model.max_pressure, stiffness if bending is None else bending.reference_pressure)
    if any(isinstance(value, Tensor) and value.requires_grad for value in held):
        return True
    strains = (*PROBED, *(min(max(plain_number(end), -0.5), 1.0) for end in model.strain_range))
    pairs = [(strain, share * most) for strain in strains for share in PROBED_SHARES]
    strain, pressure = like.new_tensor(pairs).unbind(-1)
    if model.force(strain.clone(), pressure.clone()).requires_grad:
        return True
    if bending is None:
        return False
    curvature = like.new_tensor(PROBED_CURVATURES)
    moments = (active_moment(stiffness, curvature), passive_moment(stiffness, curvature))
    return any(moment is not None and moment.requires_grad for moment in moments)
