"""SE(3), the rigid motions of space, as pure functions on matrices and vectors.

A pose is a 4x4 homogeneous matrix; a body twist is `(l, γ_y, γ_z, κ_x, κ_y, κ_z)` in m and rad, linear before
angular; a wrench is `(f_x, f_y, f_z, m_x, m_y, m_z)` in N and N·m. All functions are batched over leading
dimensions and differentiable, twice and through zero turn too. `se2` offers the same functions.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from torcharm.geometry import se2
from torcharm.geometry.turn_ratios import turn_ratios

POSE_SHAPE = (4, 4)
"""Shape of one pose."""

DIMENSION = 3
"""Components of a point or a force."""

_HALVINGS = 3
"""How often a rotation is halved before its logarithm is summed as a series: from half a turn, the largest, to
a sixteenth, where the tangent of half the angle left is below 0.2."""

_LOG_TERMS = 14
"""Terms of that series, of ratio below 0.04: the first one left out is below 1e-21."""


def identity(like: Tensor) -> Float[Tensor, "4 4"]:
    """The pose that moves nothing, in the dtype and on the device of a tensor."""
    return torch.eye(4, dtype=like.dtype, device=like.device)


def exp(twist: Float[Tensor, "*batch 6"]) -> Float[Tensor, "*batch 4 4"]:
    """The pose reached by following a constant body twist for unit time.

    With W the cross product by the turn: rotation `1 + A W + B W²`, position `(1 + B W + C W²)` times the
    linear part.
    """
    linear, turn = twist.split(3, -1)
    square = turn.square().sum(-1, keepdim=True)
    a, b, c, _ = turn_ratios(square)
    once = _cross(turn, linear)
    position = linear + b * once + c * _cross(turn, once)
    outer = turn.unsqueeze(-1) * (b * turn).unsqueeze(-2)
    rotation = torch.diag_embed((1.0 - b * square).expand_as(turn)) + _skew(a * turn) + outer
    return from_parts(rotation, position)


def log(pose: Float[Tensor, "*batch 4 4"]) -> Float[Tensor, "*batch 6"]:
    """The body twist, of turn at most π, whose exponential is the pose.

    At half a turn exactly, one of the two twists. The position is undone by
    `1 - W/2 + E W²`, `E = (1 - h cot h)/(4h²) = (B(h) - C(h))/(4 A(h))`, h half the angle.
    """
    turn, position = _rotation_vector(pose[..., :3, :3]), pose[..., :3, 3]
    a, b, c, _ = turn_ratios(turn.square().sum(-1, keepdim=True) / 4)
    once = _cross(turn, position)
    linear = position - once / 2 + (b - c) / (4 * a) * _cross(turn, once)
    return torch.cat((linear, turn), -1)


def _rotation_vector(rotation: Tensor) -> Tensor:
    """Axis times angle of a rotation matrix, by its quaternion: exact and smooth below half a turn.

    The matrix `4 q qᵀ` is linear in the rotation's; its row of the largest diagonal entry is the quaternion but
    for a factor that is far from zero. The quaternion's angle is halved until the series of the arc tangent
    is short, so there is no case for small angles.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = (row.unbind(-1) for row in rotation.unbind(-2))
    x, y, z = zy - yz, xz - zx, yx - xy
    rows = (
        (1 + xx + yy + zz, x, y, z),
        (x, 1 + xx - yy - zz, xy + yx, xz + zx),
        (y, xy + yx, 1 - xx + yy - zz, yz + zy),
        (z, xz + zx, yz + zy, 1 - xx - yy + zz),
    )
    products = torch.stack([torch.stack(row, -1) for row in rows], -2)
    largest = products.detach().diagonal(dim1=-2, dim2=-1).argmax(-1)
    row = products.gather(-2, largest[..., None, None].expand(*largest.shape, 1, 4)).squeeze(-2)
    quaternion = row / row.square().sum(-1, keepdim=True).sqrt()
    quaternion = torch.where(quaternion[..., :1] < 0, -quaternion, quaternion)
    real, imaginary = quaternion[..., :1], quaternion[..., 1:]
    for _ in range(_HALVINGS):
        real = ((1 + real) / 2).sqrt()
        imaginary = imaginary / (2 * real)
    square = imaginary.square().sum(-1, keepdim=True) / real.square()
    total = torch.full_like(square, (-1) ** (_LOG_TERMS - 1) / (2 * _LOG_TERMS - 1))
    for k in reversed(range(_LOG_TERMS - 1)):
        total = total * square + (-1) ** k / (2 * k + 1)
    return 2 ** (_HALVINGS + 1) * total / real * imaginary


def centroid(twist: Float[Tensor, "*batch 6"]) -> Float[Tensor, "*batch 3"]:
    """Mean position [m] along the path of a constant body twist over unit time: `(1/2 + C W + D W²)` linear."""
    linear, turn = twist.split(3, -1)
    _, _, c, d = turn_ratios(turn.square().sum(-1, keepdim=True))
    once = _cross(turn, linear)
    return linear / 2 + c * once + d * _cross(turn, once)


def compose(first: Float[Tensor, "*#a 4 4"], second: Float[Tensor, "*#a 4 4"]) -> Float[Tensor, "... 4 4"]:
    """The pose `first ∘ second`: `second` read in the frame of `first`."""
    return first @ second


def inverse(pose: Float[Tensor, "*batch 4 4"]) -> Float[Tensor, "*batch 4 4"]:
    """The pose g⁻¹ with `g ∘ g⁻¹ = 1`."""
    back = pose[..., :3, :3].mT
    return from_parts(back, -(back @ pose[..., :3, 3:]).squeeze(-1))


def adjoint(pose: Float[Tensor, "*batch 4 4"]) -> Float[Tensor, "*batch 6 6"]:
    """The matrix Ad_g with `g exp(ξ) g⁻¹ = exp(Ad_g ξ)`, on twists, linear before angular."""
    rotation = pose[..., :3, :3]
    upper = torch.cat((rotation, _skew(pose[..., :3, 3]) @ rotation), -1)
    return torch.cat((upper, torch.cat((torch.zeros_like(rotation), rotation), -1)), -2)


def carry(pose: Float[Tensor, "... 4 4"], wrench: Float[Tensor, "... 6"]) -> Float[Tensor, "... 6"]:
    """A wrench of the frame at `pose`, as it is felt in the frame that the pose is read in: `Ad⁻ᵀ_g w`."""
    force = rotate(pose, wrench[..., :3])
    moment = rotate(pose, wrench[..., 3:]) + lever_moment(position(pose), force)
    return torch.cat((force.expand_as(moment), moment), -1)


def act(pose: Float[Tensor, "... 4 4"], point: Float[Tensor, "... 3"]) -> Float[Tensor, "... 3"]:
    """The point, given in the frame at `pose`, in the frame that the pose is read in."""
    return rotate(pose, point) + position(pose)


def rotate(pose: Float[Tensor, "... 4 4"], vector: Float[Tensor, "... 3"]) -> Float[Tensor, "... 3"]:
    """The free vector, given in the frame at `pose`, in the frame that the pose is read in."""
    return (pose[..., :3, :3] @ vector.unsqueeze(-1)).squeeze(-1)


def rotate_back(pose: Float[Tensor, "... 4 4"], vector: Float[Tensor, "... 3"]) -> Float[Tensor, "... 3"]:
    """The free vector, given in the frame that the pose is read in, in the frame at `pose`."""
    return (pose[..., :3, :3].mT @ vector.unsqueeze(-1)).squeeze(-1)


def turn_wrench(pose: Float[Tensor, "... 4 4"], wrench: Float[Tensor, "... 6"]) -> Float[Tensor, "... 6"]:
    """The components of a wrench at the frame's origin, given in the frame at `pose`, along the outer axes."""
    return (wrench.unflatten(-1, (2, 3)) @ pose[..., :3, :3].mT).flatten(-2)


def turn_wrench_back(pose: Float[Tensor, "... 4 4"], wrench: Float[Tensor, "... 6"]) -> Float[Tensor, "... 6"]:
    """The components of a wrench at the frame's origin, given along the outer axes, in the frame at `pose`."""
    return (wrench.unflatten(-1, (2, 3)) @ pose[..., :3, :3]).flatten(-2)


def position(pose: Float[Tensor, "*batch 4 4"]) -> Float[Tensor, "*batch 3"]:
    """Where the frame's origin lies [m]."""
    return pose[..., :3, 3]


def lever_moment(lever: Float[Tensor, "... 3"], force: Float[Tensor, "... 3"]) -> Float[Tensor, "... 3"]:
    """Moment `lever × force` [N·m] of a force at the end of a lever."""
    return _cross(lever, force)


def from_parts(rotation: Float[Tensor, "*batch 3 3"], position: Float[Tensor, "*batch 3"]) -> Float[Tensor, "... 4 4"]:
    """The homogeneous matrix of a rotation and a position."""
    upper = torch.cat((rotation, position.unsqueeze(-1)), -1)
    last = upper.new_tensor((0.0, 0.0, 0.0, 1.0)).expand(*upper.shape[:-2], 1, 4)
    return torch.cat((upper, last), -2)


def from_plane(pose: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 4 4"]:
    """A pose `(x, y, θ)` of the plane z = 0 as a pose of space."""
    angle, zero = pose[..., 2], torch.zeros_like(pose[..., 2])
    cos, sin = angle.cos(), angle.sin()
    rows = ((cos, -sin, zero), (sin, cos, zero), (zero, zero, zero + 1))
    place = torch.cat((se2.position(pose), zero.unsqueeze(-1)), -1)
    return from_parts(torch.stack([torch.stack(row, -1) for row in rows], -2), place)


def vector_from_plane(vector: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 6"]:
    """A twist `(l, γ, κ)` or a wrench `(f_x, f_y, m)` of the plane z = 0 as one of space."""
    first, second, angular = vector.unbind(-1)
    zero = torch.zeros_like(first)
    return torch.stack((first, second, zero, zero, zero, angular), -1)


def _cross(first: Tensor, second: Tensor) -> Tensor:
    return torch.linalg.cross(*torch.broadcast_tensors(first, second), dim=-1)


def _skew(vector: Tensor) -> Tensor:
    """The matrix W with `W u = vector × u`."""
    x, y, z = vector.unbind(-1)
    zero = torch.zeros_like(x)
    rows = ((zero, -z, y), (z, zero, -x), (-y, x, zero))
    return torch.stack([torch.stack(row, -1) for row in rows], -2)
