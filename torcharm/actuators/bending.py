"""Bending moments that actuators bear beside their axial force.

torcharm's attainable sets are exact because the moment is *affine in pressure*,

    τ(k, p) = τ_0(k) + (p / p_ref) τ_1(k),    k = κ/l, the material curvature [rad/m]

with any functions τ_0 and τ_1 of curvature. A moment that is not affine in pressure is refused.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import torch
from torch import Tensor

from torcharm.actuators.inspection import follows
from torcharm.inputs import HoldsTensors, check_number, plain_number, refuse_graphs, shown

Number = float | Tensor
"""A tensor of one number makes results differentiable in it."""
CHECKED_CURVATURES = (-30.0, -10.0, -1.0, 0.0, 1.0, 10.0, 30.0)
"""Curvatures [rad/m] at which a user's function is checked."""
CHECKED_SHARES = (0.25, 0.5, 0.75, 1.5)
"""Pressures, as shares of the reference pressure, at which it is."""
AFFINE = 1e-9
"""By how much of its largest moment a function may be off a straight line in pressure."""


@runtime_checkable
class Bending(Protocol):
    """A bending model: what an actuator's `bending_stiffness` may be instead of a number."""

    @property
    def reference_pressure(self) -> Number | None:
        """p_ref [kPa]; None stands for the actuator's own `max_pressure`."""
        ...

    def passive(self, curvature: Tensor) -> Tensor:
        """τ_0 [N·m]: what is borne at any pressure, at material curvatures [rad/m]."""
        ...

    def active(self, curvature: Tensor) -> Tensor:
        """τ_1 [N·m]: what is borne besides at p_ref, and in proportion at other pressures."""
        ...


@dataclass(frozen=True)
class LinearBending(HoldsTensors):
    """The paper's `τ = K (p / p_ref) κ/l` [N·m]; a plain number K as `bending_stiffness` is this, too.

    Attributes:
        stiffness: K [N·m²], at most 0: negative resists bending.
        reference_pressure: p_ref [kPa]; None stands for the actuator's `max_pressure`.
        assumed: whether nobody measured or chose K for this actuator, which results then say.

    Raises:
        ValueError: K is not finite or above 0, or p_ref not above 0.

    Example:
        >>> bending = ta.LinearBending(-0.1, reference_pressure=50.0)  # limp until it is inflated
        >>> round(float(bending.active(torch.tensor(2.0))), 3)  # by 50 kPa, at 2 rad/m [N·m]
        -0.2
    """

    stiffness: Number
    reference_pressure: Number | None = None
    assumed: bool = False

    def __post_init__(self) -> None:
        _check(self)

    def passive(self, curvature: Tensor) -> Tensor:
        """No moment without pressure."""
        return torch.zeros_like(curvature)

    def active(self, curvature: Tensor) -> Tensor:
        """`K κ/l`."""
        return self.stiffness * curvature


@dataclass(frozen=True)
class ConstantBending(HoldsTensors):
    """`τ = K κ/l` [N·m], whatever the pressure, as of a beam of rubber.

    Attributes:
        stiffness: K [N·m²], at most 0: negative resists bending.

    Raises:
        ValueError: K is not finite or above 0.

    Example:
        >>> rubber = ta.Bellows(bending_stiffness=ta.ConstantBending(-0.1))  # resists as much without pressure
        >>> round(float(rubber.bending_stiffness.passive(torch.tensor(2.0))), 3)  # at 2 rad/m [N·m]
        -0.2
    """

    stiffness: Number

    def __post_init__(self) -> None:
        _check(self)

    @property
    def reference_pressure(self) -> None:
        """Of no importance."""
        return None

    def passive(self, curvature: Tensor) -> Tensor:
        """`K κ/l`."""
        return self.stiffness * curvature

    def active(self, curvature: Tensor) -> Tensor:
        """Nothing is added by pressure."""
        return torch.zeros_like(curvature)


@dataclass(frozen=True)
class BendingFunction:
    """A user's `τ(k, p)` [N·m] of material curvature [rad/m] and pressure [kPa], affine in pressure.

    Of curvature it may be any function; torch's operations make it differentiable. That it is affine in pressure
    is checked when the model is made, at a few curvatures up to 30 rad/m and pressures up to 1.5 p_ref: a
    stiffness that grows as the square of pressure, say, is refused. Results are differentiable in tensors that the
    function holds.

    Attributes:
        function: of two tensors that broadcast.
        reference_pressure: p_ref [kPa], a pressure in the middle of what is used.

    Raises:
        ValueError: p_ref is not above 0, or the function fails, is not finite or not affine in pressure, or
            drives on what is bent.

    Example:
        >>> bending = ta.BendingFunction(lambda k, p: -(0.02 + 0.001 * p) * k, reference_pressure=50.0)
        >>> round(float(bending.active(torch.tensor(2.0))), 3)  # added by 50 kPa, at 2 rad/m [N·m]
        -0.1
    """

    function: Callable[[Tensor, Tensor], Tensor]
    reference_pressure: float

    def __post_init__(self) -> None:
        refuse_graphs("reference_pressure", self.reference_pressure, "the moment does not depend on it")
        _check(self)
        if not callable(self.function):
            raise ValueError(f"function: must be a function of curvature and pressure, got {shown(self.function)}")
        self._check_function()
        check_restoring("function", self)

    @torch.no_grad()
    def _check_function(self) -> None:
        curvature = torch.tensor(CHECKED_CURVATURES, dtype=torch.float64)
        try:
            rest, full = self.passive(curvature), self._at(curvature, self.reference_pressure)
            others = [self._at(curvature, share * self.reference_pressure) for share in CHECKED_SHARES]
        except (TypeError, ValueError, RuntimeError, AttributeError) as error:
            raise ValueError(
                f"function: must take tensors of curvature and pressure and return moments, got {shown(error)}"
            ) from None
        size = torch.stack((rest, full, *others)).abs().amax()
        if not bool(size.isfinite()):
            raise ValueError(f"function: must be finite up to 30 rad/m, got moments {shown(full.tolist())}")
        for share, moment in zip(CHECKED_SHARES, others, strict=True):
            off = (moment - torch.lerp(rest, full, share)).abs()
            if bool((off > AFFINE * size).any()):
                worst = int(off.argmax())
                raise ValueError(
                    "function: must be affine in pressure, got a moment "
                    f"{off[worst].item():.3g} N·m off the line between 0 and {self.reference_pressure:g} kPa "
                    f"at {share * self.reference_pressure:g} kPa and {CHECKED_CURVATURES[worst]:g} rad/m"
                )

    def passive(self, curvature: Tensor) -> Tensor:
        """`τ(k, 0)`."""
        return self._at(curvature, 0.0)

    def active(self, curvature: Tensor) -> Tensor:
        """`τ(k, p_ref) - τ(k, 0)`."""
        return self._at(curvature, self.reference_pressure) - self._at(curvature, 0.0)

    def _at(self, curvature: Tensor, pressure: float) -> Tensor:
        return self.function(curvature, torch.full_like(curvature, pressure)).expand_as(curvature)


def check_restoring(name: str, stiffness: "Number | Bending") -> None:
    """Raise a ValueError where a bending moment drives an arm on when it is bent: its sign was mistaken.

    A body resists bending: with `τ = K κ/l`, K is negative. Of models in place of a number, the moment, less that of
    the straight body, must not have the sign of curvature at all curvatures checked, at no pressure or at p_ref.
    """
    if bending_model(stiffness) is None or isinstance(stiffness, (LinearBending, ConstantBending)):
        value = plain_number(getattr(stiffness, "stiffness", stiffness))
        if value > 0:
            raise ValueError(
                f"{name}: must be at most 0 N·m², as K κ/l resists bending where K is negative, got {value:g}, which "
                f"drives an arm on when it is bent; was {-value:g} meant?"
            )
        return
    curvature = torch.tensor(CHECKED_CURVATURES, dtype=torch.float64)
    try:
        with torch.no_grad():
            rest = stiffness.passive(curvature).expand_as(curvature)  # type: ignore[union-attr]
            full = rest + stiffness.active(curvature)  # type: ignore[union-attr]
    except (TypeError, ValueError, RuntimeError, AttributeError):
        return  # what cannot be asked is said of where moments are needed
    bent = curvature != 0
    for moment in (rest, full):
        driven = ((moment - moment[~bent]) * curvature)[bent]
        if bool((driven > 0).all()):
            worst = float((moment - moment[~bent])[-1])
            raise ValueError(
                f"{name}: must resist bending, with a sign opposite to curvature's, got a moment that grows by "
                f"{worst:.3g} N·m at {CHECKED_CURVATURES[-1]:g} rad/m, which drives an arm on; was its negative meant?"
            )


def _check(model: Any) -> None:
    if hasattr(model, "stiffness"):
        check_number("stiffness", model.stiffness)
        check_restoring("stiffness", model)
    if model.reference_pressure is not None:
        check_number("reference_pressure", model.reference_pressure, 0.0, strict=True, unit="kPa")


def bending_model(stiffness: "Number | Bending") -> Bending | None:
    """The model that stands in place of a plain number K, if one does."""
    return stiffness if hasattr(stiffness, "active") else None  # type: ignore[return-value]


def reference_pressure(stiffness: "Number | Bending", max_pressure: Number) -> Number:
    """The pressure [kPa] at which an actuator's active moment holds."""
    model = bending_model(stiffness)
    own = None if model is None else model.reference_pressure
    return max_pressure if own is None else own


def linear_stiffness(stiffness: "Number | Bending") -> Number | None:
    """K [N·m²] of an active moment that is linear in curvature; None for others."""
    if follows(stiffness, LinearBending, "active"):
        return stiffness.stiffness  # type: ignore[union-attr]
    if follows(stiffness, ConstantBending, "active"):
        return 0.0
    return None if bending_model(stiffness) is not None else _number(stiffness)  # type: ignore[arg-type]


def active_moment(stiffness: "Number | Bending", curvature: Tensor) -> Tensor:
    """τ_1 [N·m]."""
    model = bending_model(stiffness)
    return _number(stiffness) * curvature if model is None else model.active(curvature)  # type: ignore[arg-type]


def passive_moment(stiffness: "Number | Bending", curvature: Tensor) -> Tensor | None:
    """τ_0 [N·m], or None where it is nothing."""
    model = bending_model(stiffness)
    none = model is None or follows(model, LinearBending, "passive")
    return None if none else model.passive(curvature)  # type: ignore[union-attr]


def _number(value: Number) -> Number:
    """A number; of a tensor with its graph."""
    return value.squeeze() if isinstance(value, Tensor) else float(value)
