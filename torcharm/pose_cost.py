"""How far poses are from those of a task, as one number: the cost that search and prediction minimise."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torcharm._inputs import check_count, shown

NODE_WEIGHTS = ("rising", "even", "tip")


@dataclass(frozen=True)
class PoseCost:
    """`Σ_i ω_i e_iᵀ K e_i` [m²] of errors `e_i = (x, y, θ)` of `ĝ_i⁻¹ g_i*`, the target seen from the pose reached.

    Attributes:
        node_weights: ω of the N+1 poses. "rising", the paper's validation: `linspace(0, 1, N)` over nodes 1 to N,
            the tip left out; "even", its shape study: 1 at nodes 1 to N; "tip": 1 at the tip alone, pose
            N+1; or N+1 numbers.
        pose_weights: the diagonal of K, for x, y [1] and θ [m²/rad²].
        position_only: whether headings do not count: K = diag(k_x, k_y, 0).

    Raises:
        ValueError: a weight is negative or not finite, all are 0, or the words are none of those allowed.
    """

    node_weights: str | tuple[float, ...] = "rising"
    pose_weights: tuple[float, float, float] = (1.0, 1.0, 0.05)
    position_only: bool = False

    def __post_init__(self) -> None:
        if isinstance(self.node_weights, str):
            if self.node_weights not in NODE_WEIGHTS:
                raise ValueError(
                    f"node_weights: must be one of {', '.join(NODE_WEIGHTS)}, or N+1 numbers, "
                    f"got {shown(self.node_weights)}"
                )
        else:
            object.__setattr__(self, "node_weights", _weights("node_weights", self.node_weights))
        object.__setattr__(self, "pose_weights", _weights("pose_weights", self.pose_weights))
        if len(self.pose_weights) != 3:
            raise ValueError(f"pose_weights: must be three numbers (x, y, θ), got {shown(self.pose_weights)}")
        if not isinstance(self.position_only, bool):
            raise ValueError(f"position_only: must be True or False, got {shown(self.position_only)}")
        if not any(self._diagonal()):
            raise ValueError(f"pose_weights: must not all be 0, got {shown(self.pose_weights)}")

    def _diagonal(self) -> tuple[float, ...]:
        return (*self.pose_weights[:2], 0.0) if self.position_only else self.pose_weights

    def weights(self, nodes: int, like: Tensor) -> Tensor:
        """`ω_i K` of every pose, (N+1, 3), in the dtype and on the device of a tensor.

        Raises:
            ValueError: weights were given, and are not N+1.
        """
        check_count("nodes", nodes, 1)
        return self.omega(nodes, like).unsqueeze(-1) * self.diagonal(like)

    def omega(self, nodes: int, like: Tensor) -> Tensor:
        """ω (N+1,) of every pose; arguments and errors as for `weights`."""
        if not isinstance(self.node_weights, str):
            if len(self.node_weights) != nodes + 1:
                raise ValueError(
                    f"node_weights: must be {nodes + 1} numbers, one for each pose of {nodes} segments, "
                    f"got {len(self.node_weights)}"
                )
            return like.new_tensor(self.node_weights)
        omega = like.new_zeros(nodes + 1)
        if self.node_weights == "tip" or nodes == 1:  # of one segment, only the tip moves
            omega[-1] = 1.0
        elif self.node_weights == "rising":
            omega[:-1] = torch.linspace(0.0, 1.0, nodes, dtype=like.dtype, device=like.device)
        else:
            omega[:-1] = 1.0
        return omega

    def diagonal(self, like: Tensor) -> Tensor:
        """The diagonal of K (3,), with 0 for headings that do not count."""
        return like.new_tensor(self._diagonal())

    def __call__(self, error: Tensor) -> Tensor:
        """The cost (...) [m²] of errors (..., N+1, 3) [m, m, rad]."""
        return (self.weights(error.shape[-2] - 1, error) * error.square()).sum((-2, -1))


def _weights(field: str, values: Sequence[float]) -> tuple[float, ...]:
    try:
        weights = tuple(float(value) for value in values)
    except (TypeError, ValueError, RuntimeError):
        raise ValueError(f"{field}: must be numbers, got {shown(values)}") from None
    if not all(0 <= weight < float("inf") for weight in weights) or not any(weights):
        raise ValueError(f"{field}: must be finite, at least 0 and not all 0, got {shown(values)}")
    return weights
