"""How uncertain a result is because a force model's coefficients are: to first order, by the gradient."""

from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter

import torch
from jaxtyping import Float
from torch import Tensor

from torcharm.actuators.deviation import added_force
from torcharm.actuators.inspection import follows
from torcharm.actuators.polynomial import PolynomialActuator
from torcharm.inputs import HoldsTensors, TensorLike, as_floating, check_tensor, shown


@dataclass(frozen=True, eq=False)
class TensorPolynomial(HoldsTensors):
    """A polynomial force model whose coefficients are a tensor, so that results differentiate by them.

    Actuators that share one of these share the coefficients. Equal to itself alone.

    Attributes:
        like: powers, ranges and limits are this model's.
        coefficients: (K) of `ε^i p^j` [N/kPa^j], in the order of its terms.

    Raises:
        ValueError: the coefficients do not match the terms, or the model's force is not that of its coefficients.

    Example:
        >>> coefficients = ta.coefficient_tensor(ta.Bellows())
        >>> ta.TensorPolynomial(ta.Bellows(), coefficients).force(torch.tensor(0.1), torch.tensor(50.0)).backward()
        >>> round(float(coefficients.grad[1]), 3)  # newtons for each N/kPa by which the second is off
        50.0
    """

    like: PolynomialActuator
    coefficients: Tensor

    def __post_init__(self) -> None:
        if not follows(self.like, PolynomialActuator, "force"):
            raise ValueError(f"like: must be a polynomial that does not override its force, got {shown(self.like)}")
        check_tensor("coefficients", self.coefficients, len(self.like.coefficients))

    bending_stiffness = property(attrgetter("like.bending_stiffness"))
    max_pressure = property(attrgetter("like.max_pressure"))
    strain_range = property(attrgetter("like.strain_range"))
    pressure_range = property(attrgetter("like.pressure_range"))

    @property
    def pressure_degree(self) -> int:
        """The highest power of pressure."""
        return max([0, *(j for _, j, _ in self.like.coefficients)])

    def force(self, strain: Tensor, pressure: Tensor) -> Tensor:
        """Axial force [N]; strain and pressure [kPa] broadcast."""
        powers = tuple((i, j) for i, j, _ in self.like.coefficients)
        total = added_force(powers, self.coefficients.to(strain).unbind(), strain, pressure)
        return total * self.like.force_scale


def coefficient_tensor(model: PolynomialActuator) -> Float[Tensor, " K"]:
    """A model's K coefficients of `ε^i p^j` [N/kPa^j], in the order of its terms, asking for gradients.

    Example:
        >>> ta.coefficient_tensor(ta.Bellows())[:2].tolist()  # of strain [N], and of pressure [N/kPa]
        [-10.47, 1.068]
    """
    return torch.tensor([c for *_, c in model.coefficients], dtype=torch.float64, requires_grad=True)


def standard_deviation(
    values: Float[Tensor, "*batch"],
    coefficients: Float[Tensor, " K"],
    covariance: TensorLike | Sequence[Sequence[float]],
) -> Float[Tensor, "*batch"]:
    """`sqrt(gᵀ Σ g)` of each value, with g its gradient by the coefficients: how far they may be off, to first order.

    Args:
        values: computed from `coefficients`, of any shape; one backward pass each.
        coefficients: of a `TensorPolynomial`.
        covariance: (K, K) Σ, as of `FitQuality`.

    Raises:
        ValueError: the covariance does not match, or values do not depend on the coefficients.

    Example:
        >>> c, covariance = ta.coefficient_tensor(ta.Bellows()), torch.diag(torch.tensor([0.0, 4e-4] + [0.0] * 7))
        >>> force = ta.TensorPolynomial(ta.Bellows(), c).force(torch.tensor([0.1]), torch.tensor([50.0]))
        >>> ta.standard_deviation(force, c, covariance).round(decimals=3).tolist()  # by 0.02 N/kPa, at 50 kPa [N]
        [1.0]
    """
    (spread,) = as_floating(covariance=covariance)
    check_tensor("covariance", spread, len(coefficients), len(coefficients))
    if not values.requires_grad:
        raise ValueError("values: must depend on the coefficients, got a tensor without gradient")
    rows = [torch.autograd.grad(value, coefficients, retain_graph=True)[0] for value in values.flatten()]
    gradient = torch.stack(rows)
    variance = ((gradient @ spread.to(gradient)) * gradient).sum(-1)
    return variance.clamp(min=0).sqrt().view(values.shape)
