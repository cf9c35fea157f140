"""How far poses are from those of a task, as one number: the cost that search and prediction minimise."""

from dataclasses import dataclass

import torch
from torch import Tensor

from torcharm._inputs import TensorLike, as_floating, check_choice, check_count, shown

NODE_WEIGHTS = ("ramp", "uniform", "tip")


@dataclass(frozen=True)
class PoseCost:
    """`Σ_i ω_i e_iᵀ K e_i` [m²] of errors `e_i = (x, y, θ)` of `ĝ_i⁻¹ g_i*`, the target seen from the pose reached.

    Attributes:
        node_weights: ω. "ramp" is `linspace(0, 1, N)` on nodes 1 to N (the paper's validation), "uniform" ones on
            these (its shape study), "tip" the tip alone; or N or N+1 numbers, the last of N+1 for the tip.
        error_weights: K's diagonal, on x², y² [1] and θ² [m²/rad²]; (1, 1, 0) counts positions only.

    Raises:
        ValueError: a weight is negative or not finite, all are 0, or the words are none of those allowed.
    """

    node_weights: str | TensorLike = "ramp"
    error_weights: TensorLike = (1.0, 1.0, 0.05)

    def __post_init__(self) -> None:
        if isinstance(self.node_weights, str):
            check_choice("node_weights", self.node_weights, NODE_WEIGHTS)
        else:
            object.__setattr__(self, "node_weights", _weights("node_weights", self.node_weights))
        object.__setattr__(self, "error_weights", _weights("error_weights", self.error_weights))
        if len(self.diagonal(torch.zeros(()))) != 3:
            raise ValueError(f"error_weights: must be three numbers (x, y, θ), got {shown(self.error_weights)}")

    def weights(self, nodes: int, like: Tensor) -> Tensor:
        """`ω_i K` of every pose, (N+1, 3), in the dtype and on the device of a tensor.

        Raises:
            ValueError: weights were given, and are neither N nor N+1; or none of them is above 0.
        """
        check_count("nodes", nodes, 1)
        return self._omega(nodes, like).unsqueeze(-1) * self.diagonal(like)

    def diagonal(self, like: Tensor) -> Tensor:
        """The diagonal of K, (3,)."""
        (diagonal,) = as_floating(error_weights=self.error_weights)
        return diagonal.to(like)

    def _omega(self, nodes: int, like: Tensor) -> Tensor:
        omega = like.new_zeros(nodes + 1)
        if not isinstance(self.node_weights, str):
            (given,) = as_floating(node_weights=self.node_weights)
            count = len(given)
            if count not in (nodes, nodes + 1):
                raise ValueError(
                    f"node_weights: must be one of {', '.join(NODE_WEIGHTS)}, or {nodes} or {nodes + 1} numbers, "
                    f"got {count}"
                )
            omega[:count] = given.to(like)
        elif self.node_weights == "tip":
            omega[-1] = 1.0
        elif self.node_weights == "ramp":
            omega[:-1] = torch.linspace(0.0, 1.0, nodes, dtype=like.dtype, device=like.device)
        else:
            omega[:-1] = 1.0
        if not bool(omega[1:].any()):
            alone = ", of which one segment has the base alone ('tip' weighs its end)" if nodes == 1 else ""
            raise ValueError(
                f"node_weights: must be above 0 at a pose that moves, got {shown(self.node_weights)}{alone}"
            )
        return omega

    def __call__(self, error: Tensor) -> Tensor:
        """The cost (...) [m²] of errors (..., N+1, 3) [m, m, rad]."""
        return (self.weights(error.shape[-2] - 1, error) * error.square()).sum((-2, -1))


def _weights(field: str, values: TensorLike) -> tuple[float, ...]:
    """As a tuple, so that equal costs are equal and can be keys."""
    (weights,) = as_floating(**{field: values})
    if weights.ndim != 1 or not bool((weights >= 0).all() & weights.isfinite().all() & weights.any()):
        raise ValueError(f"{field}: must be a list of numbers, finite, at least 0 and not all 0, got {shown(values)}")
    return tuple(weights.tolist())
