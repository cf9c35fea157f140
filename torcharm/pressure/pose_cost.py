"""How far poses are from those of a task: errors of poses, and the cost that search and prediction minimise."""

from dataclasses import dataclass

import torch
from torch import Tensor

from torcharm.geometry import se2, se3
from torcharm.inputs import TensorLike, as_floating, check_choice, check_count, shown

NODE_WEIGHTS = ("ramp", "uniform", "tip")
TURN_WEIGHT = 0.2
"""Weight of squared turns [1/rad²], over the arm's squared length, where squared distances have 1: a turn counts as the
distance that it moves the end of a tool of 0.45 arm lengths. On the paper's arms of 0.5 m that is its 0.05 m²."""
PAPER_LENGTH = 0.5
"""Neutral length of the paper's arms [m]."""


@dataclass(frozen=True)
class PoseCost:
    """`Σ_i ω_i e_iᵀ K e_i` [m²] of the errors e_i of `ĝ_i⁻¹ g_i*`, the target seen from the pose reached.

    In the plane `e = (x, y, θ)`, in space a position and a rotation vector.

    Attributes:
        node_weights: ω. "ramp" is `linspace(0, 1, N)` on nodes 1 to N (the paper's validation), "uniform" ones on
            these (its shape study), "tip" the tip alone; or N or N+1 numbers, the last of N+1 for the tip.
        error_weights: K's diagonal: in the plane three numbers, on x², y² [1] and θ² [m²/rad²], in space six; None is
            1 on positions and 0.2 L² on turns, L the arm's neutral length: on arms of 0.5 m the paper's 0.05 m².
            (1, 1, 0) counts positions only; in space a 0 in the fourth place leaves the roll out, which no pressure
            steers where torsion is rigid.

    Raises:
        ValueError: a weight is negative or not finite, all are 0, or the words are none of those allowed.

    Example:
        >>> task, place = ta.Task(ta.constant_curvature(0.5), [1.0, 0.0, 0.0]), ta.PoseCost("tip", (1.0, 1.0, 0.0))
        >>> round(1e3 * float(ta.predict_error(ta.antagonistic_arm(), task, place).tip_error), 2)  # else 0.58 mm
        0.0
    """

    node_weights: str | TensorLike = "ramp"
    error_weights: TensorLike | None = None

    def __post_init__(self) -> None:
        if isinstance(self.node_weights, str):
            check_choice("node_weights", self.node_weights, NODE_WEIGHTS)
        else:
            object.__setattr__(self, "node_weights", _weights("node_weights", self.node_weights))
        if self.error_weights is not None:
            weights = _weights("error_weights", self.error_weights)
            if len(weights) not in (3, 6):
                raise ValueError(
                    "error_weights: must be three numbers (x, y, θ) in the plane or six in space, "
                    f"got {shown(self.error_weights)}"
                )
            object.__setattr__(self, "error_weights", weights)

    def weights(self, nodes: int, length: Tensor, dimension: int = 2) -> Tensor:
        """`ω_i K` of every pose, (..., N+1, 3) in the plane or (..., N+1, 6) in space, like the lengths.

        Args:
            nodes: N.
            length: (...) neutral lengths of arms [m].
            dimension: 2 or 3.

        Raises:
            ValueError: weights were given, and are neither N nor N+1, or not of this dimension; or none of them is
                above 0.
        """
        return self.omega(nodes, length).unsqueeze(-1) * self.diagonal(length, dimension).unsqueeze(-2)

    def diagonal(self, length: Tensor, dimension: int = 2) -> Tensor:
        """The diagonal of K, (..., 3) in the plane or (..., 6) in space, for arms of neutral lengths (...) [m]."""
        count = 3 if dimension == 2 else 6
        if self.error_weights is None:
            places = length.new_ones(*length.shape, dimension)
            turn = TURN_WEIGHT * length.square().unsqueeze(-1)
            return torch.cat((places, turn.expand(*length.shape, count - dimension)), -1)
        (diagonal,) = as_floating(error_weights=self.error_weights)
        if len(diagonal) != count:
            where = "the plane" if dimension == 2 else "space"
            raise ValueError(f"error_weights: must be {count} numbers in {where}, got {shown(self.error_weights)}")
        return diagonal.to(length).expand(*length.shape, count)

    def omega(self, nodes: int, like: Tensor) -> Tensor:
        """ω (N+1,), like a tensor in dtype and device; raises as `weights`."""
        check_count("nodes", nodes, 1)
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
        elif self.node_weights == "tip" or nodes == 1:  # the end of a single element is its only pose that moves
            omega[-1] = 1.0
        elif self.node_weights == "ramp":
            omega[:-1] = torch.linspace(0.0, 1.0, nodes, dtype=like.dtype, device=like.device)
        else:
            omega[:-1] = 1.0
        if not bool(omega[1:].any()):
            raise ValueError(f"node_weights: must be above 0 at a pose that moves, got {shown(self.node_weights)}")
        return omega

    def __call__(self, error: Tensor, length: Tensor | float = PAPER_LENGTH) -> Tensor:
        """The cost (...) [m²] of errors (..., N+1, 3 or 6) [m, rad] of arms of neutral lengths (...) [m], by default
        the paper's."""
        dimension = 2 if error.shape[-1] == 3 else 3
        weights = self.weights(error.shape[-2] - 1, torch.as_tensor(length).to(error), dimension)
        return (weights * error.square()).sum((-2, -1))


def pose_errors(reached: Tensor, wanted: Tensor) -> Tensor:
    """Errors of `g⁻¹ g*`, the target g* seen from the pose g, differentiable in both.

    Args:
        reached, wanted: poses (..., 3) [m, m, rad] or (..., 4, 4).

    Returns:
        (..., 3) `(x, y, θ)`, of headings that are not wrapped: a whole turn too many is an error of 2π; or (..., 6)
        position and rotation vector, which jumps at half a turn.
    """
    if wanted.shape[-2:] == (4, 4):
        gap = se3.compose(se3.inverse(reached), wanted)
        return torch.cat((se3.position(gap), se3.log(gap)[..., 3:]), -1)
    along = se2.rotate_back(reached, wanted[..., :2] - reached[..., :2])
    return torch.cat((along, wanted[..., 2:] - reached[..., 2:]), -1)


def _weights(field: str, values: TensorLike) -> tuple[float, ...]:
    """As a tuple, so that equal costs are equal and can be keys."""
    (weights,) = as_floating(**{field: values})
    if weights.ndim != 1 or not bool((weights >= 0).all() & weights.isfinite().all() & weights.any()):
        raise ValueError(f"{field}: must be a list of numbers, finite, at least 0 and not all 0, got {shown(values)}")
    return tuple(weights.tolist())
