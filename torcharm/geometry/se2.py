"""SE(2), the rigid motions of the plane, as pure functions on vectors.

A pose is `(x, y, θ)` in m, m, rad; a body twist is `(l, γ, κ)` in m, m, rad; a wrench is
`(f_x, f_y, m)` in N, N, N·m. Angles are not wrapped: a pose remembers its turns. All
functions are batched over leading dimensions and differentiable, through κ = 0 too. `se3` offers the same
functions.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torcharm.geometry.turn_ratios import alternating_series, turn_ratios

POSE_SHAPE = (3,)
"""Shape of one pose."""

DIMENSION = 2
"""Components of a point or a force."""

_SERIES_RADIUS = 1.0
_SERIES_TERMS = 11  # the first term left out is below 1e-22 at the series' radius


def sine_ratio(angle: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
    """`sin(x)/x`, exact and smooth through zero (torch.sinc has wrong second derivatives there)."""
    small = angle.abs() < _SERIES_RADIUS
    safe = torch.where(small, torch.ones_like(angle), angle)
    near = torch.where(small, angle, torch.zeros_like(angle))
    return torch.where(small, alternating_series(near.square(), 1, _SERIES_TERMS), safe.sin() / safe)


def cosine_ratio(angle: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
    """`(1 - cos x)/x`, exact and smooth through zero."""
    small = angle.abs() < _SERIES_RADIUS
    safe = torch.where(small, torch.ones_like(angle), angle)
    near = torch.where(small, angle, torch.zeros_like(angle))
    far = 2.0 * (safe / 2).sin().square() / safe
    return torch.where(small, near * alternating_series(near.square(), 2, _SERIES_TERMS), far)


def turned(angle: Float[Tensor, "..."], vector: Float[Tensor, "... 2"]) -> Float[Tensor, "... 2"]:
    """The vector turned by the angle [rad], counter-clockwise."""
    cos, sin = angle.cos(), angle.sin()
    x, y = vector.unbind(-1)
    return torch.stack((cos * x - sin * y, sin * x + cos * y), -1)


def identity(like: Tensor) -> Float[Tensor, "3"]:
    """The pose that moves nothing, in the dtype and on the device of a tensor."""
    return like.new_zeros(3)


def exp(twist: Float[Tensor, "... 3"]) -> Float[Tensor, "... 3"]:
    """The pose reached by following a constant body twist for unit time: `V(κ)(l, γ)` and κ."""
    length, shear, turn = twist.unbind(-1)
    along, across = sine_ratio(turn), cosine_ratio(turn)
    return torch.stack((along * length - across * shear, across * length + along * shear, turn), -1)


def log(pose: Float[Tensor, "... 3"]) -> Float[Tensor, "... 3"]:
    """The body twist, of turn within [-π, π], whose exponential is the pose up to whole turns.

    `V(θ)⁻¹ = [[h, θ/2], [-θ/2, h]]` with `h = (θ/2) cot(θ/2)`.
    """
    x, y, angle = pose.unbind(-1)
    turn = angle - 2 * math.pi * (angle.detach() / (2 * math.pi)).round()
    half = turn / 2
    cotangent = half.cos() / sine_ratio(half)
    return torch.stack((cotangent * x + half * y, cotangent * y - half * x, turn), -1)


def centroid(twist: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 2"]:
    """Mean position [m] along the path of a constant body twist over unit time."""
    length, shear, turn = twist.unbind(-1)
    _, b, c, _ = turn_ratios(turn.square())
    across = c * turn
    return torch.stack((b * length - across * shear, across * length + b * shear), -1)


def compose(first: Float[Tensor, "*#a 3"], second: Float[Tensor, "*#a 3"]) -> Float[Tensor, "... 3"]:
    """The pose `first ∘ second`: `second` read in the frame of `first`."""
    position = first[..., :2] + turned(first[..., 2], second[..., :2])
    return torch.cat((position, (first[..., 2] + second[..., 2]).unsqueeze(-1)), -1)


def inverse(pose: Float[Tensor, "... 3"]) -> Float[Tensor, "... 3"]:
    """The pose g⁻¹ with `g ∘ g⁻¹ = (0, 0, 0)`."""
    return torch.cat((-turned(-pose[..., 2], pose[..., :2]), -pose[..., 2:]), -1)


def adjoint(pose: Float[Tensor, "... 3"]) -> Float[Tensor, "... 3 3"]:
    """The matrix Ad_g with `g exp(ξ) g⁻¹ = exp(Ad_g ξ)`, on twists `(l, γ, κ)`."""
    x, y, angle = pose.unbind(-1)
    cos, sin, zero = angle.cos(), angle.sin(), torch.zeros_like(x)
    rows = ((cos, -sin, y), (sin, cos, -x), (zero, zero, torch.ones_like(x)))
    return torch.stack([torch.stack(row, -1) for row in rows], -2)


def carry(pose: Float[Tensor, "... 3"], wrench: Float[Tensor, "... 3"]) -> Float[Tensor, "... 3"]:
    """A wrench of the frame at `pose`, as it is felt in the frame that the pose is read in: `Ad⁻ᵀ_g w`."""
    force = rotate(pose, wrench[..., :2])
    moment = wrench[..., 2:] + lever_moment(position(pose), force)
    return torch.cat((force.expand(*moment.shape[:-1], 2), moment), -1)


def act(pose: Float[Tensor, "... 3"], point: Float[Tensor, "... 2"]) -> Float[Tensor, "... 2"]:
    """The point, given in the frame at `pose`, in the frame that the pose is read in."""
    return rotate(pose, point) + position(pose)


def rotate(pose: Float[Tensor, "... 3"], vector: Float[Tensor, "... 2"]) -> Float[Tensor, "... 2"]:
    """The free vector, given in the frame at `pose`, in the frame that the pose is read in."""
    return turned(pose[..., 2], vector)


def rotate_back(pose: Float[Tensor, "... 3"], vector: Float[Tensor, "... 2"]) -> Float[Tensor, "... 2"]:
    """The free vector, given in the frame that the pose is read in, in the frame at `pose`."""
    return turned(-pose[..., 2], vector)


def turn_wrench(pose: Float[Tensor, "... 3"], wrench: Float[Tensor, "... 3"]) -> Float[Tensor, "... 3"]:
    """The components of a wrench at the frame's origin, given in the frame at `pose`, along the outer axes."""
    force = rotate(pose, wrench[..., :2])
    return torch.cat((force, wrench[..., 2:].expand(*force.shape[:-1], 1)), -1)


def turn_wrench_back(pose: Float[Tensor, "... 3"], wrench: Float[Tensor, "... 3"]) -> Float[Tensor, "... 3"]:
    """The components of a wrench at the frame's origin, given along the outer axes, in the frame at `pose`."""
    force = rotate_back(pose, wrench[..., :2])
    return torch.cat((force, wrench[..., 2:].expand(*force.shape[:-1], 1)), -1)


def position(pose: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 2"]:
    """Where the frame's origin lies [m]."""
    return pose[..., :2]


def lever_moment(lever: Float[Tensor, "... 2"], force: Float[Tensor, "... 2"]) -> Float[Tensor, "... 1"]:
    """Moment `lever × force` [N·m] of a force at the end of a lever."""
    return lever[..., :1] * force[..., 1:] - lever[..., 1:] * force[..., :1]
