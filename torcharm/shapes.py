"""Ready shapes, as twists: curvatures constant, affine or cubic in arc, in any plane through the backbone, and helices.

A shape of the plane has rows `(l, γ, κ)`. One that is given a direction is a shape of space, with rows
`(l, γ_y, γ_z, κ_x, κ_y, κ_z)`: it bends towards `(cos φ, sin φ)` across the backbone, in (y, z) of the body frame. That
is `κ_z = κ cos φ`, `κ_y = -κ sin φ`, without twist.
"""

import math

import torch
from torch import Tensor

from torcharm.geometry.rod import as_base, check_base_shape, goes_by_name
from torcharm.inputs import (
    TensorLike,
    as_floating,
    broadcast_shapes,
    check_at_least,
    check_count,
    check_finite,
)

AHEAD = 1e-9
"""Sine of the angle within which a point counts as straight ahead: the turn's own slope is good to the square of it."""
BEHIND = 1e-9
"""Sine of the angle within which a point straight behind the base is one: rounding decides which way round."""


def constant_curvature(
    curvature: TensorLike, length: TensorLike = 0.5, nodes: int = 10, direction: TensorLike | None = None
) -> Tensor:
    """Twists (..., N, 3), or (..., N, 6) with a direction, of an arc of a circle.

    Args:
        curvature: (...) the angle κ by which the arm turns from base to tip [rad].
        length: (...) centreline length l [m].
        nodes: N.
        direction: (...) φ towards which it bends in space [rad]; None is a shape of the plane.

    Raises:
        ValueError: as for `affine_curvature`.

    Example:
        >>> ta.constant_curvature(math.pi / 2, length=0.4, nodes=2).round(decimals=3).tolist()  # rows (l, γ, κ)
        [[0.4, 0.0, 1.571], [0.4, 0.0, 1.571]]
    """
    return _bent(length, nodes, direction, curvature=curvature)


def affine_curvature(
    slope: TensorLike,
    intercept: TensorLike,
    length: TensorLike = 0.5,
    nodes: int = 10,
    direction: TensorLike | None = None,
) -> Tensor:
    """Twists (..., N, 3), or (..., N, 6) with a direction, of `κ(s) = slope s + intercept`.

    Args:
        slope, intercept: (...) [rad]; sampled at `s = linspace(0, 1, N)`, as in the paper.
        length: (...) centreline length l [m].
        nodes: N.
        direction: (...) φ towards which it bends in space [rad]; None is a shape of the plane.

    Raises:
        ValueError: shapes do not broadcast, a value is not finite, a length is not positive, or N is
            no positive integer.

    Example:
        >>> ta.affine_curvature(slope=-3.0, intercept=3.0, nodes=4)[:, 2].tolist()  # straight at the tip
        [3.0, 2.0, 1.0, 0.0]
    """
    return _bent(length, nodes, direction, slope=slope, intercept=intercept)


def cubic_curvature(
    cubic: TensorLike,
    quadratic: TensorLike,
    slope: TensorLike,
    intercept: TensorLike,
    length: TensorLike = 0.5,
    nodes: int = 10,
    direction: TensorLike | None = None,
) -> Tensor:
    """Twists of `κ(s) = cubic s³ + quadratic s² + slope s + intercept` [rad]; else, and errors, as `affine_curvature`.

    Example:
        >>> ta.cubic_curvature(0.0, 4.0, -4.0, 1.0, nodes=3)[:, 2].tolist()  # bent at both ends, straight between
        [1.0, 0.0, 1.0]
    """
    powers = {"cubic": cubic, "quadratic": quadratic, "slope": slope, "intercept": intercept}
    return _bent(length, nodes, direction, **powers)


def helix(
    curvature: TensorLike,
    torsion: TensorLike,
    length: TensorLike = 0.5,
    nodes: int = 10,
    direction: TensorLike = 0.0,
) -> Tensor:
    """Twists (..., N, 6) of a helix: its bend keeps its size and goes round the backbone, which itself does not twist.

    Args:
        curvature: (...) κ, of the centreline times its length [rad].
        torsion: (...) τ, of the centreline times its length [rad]: the bend goes from φ to φ + τ; sampled at the middle
            of each element.
        length: (...) centreline length l [m].
        nodes: N.
        direction: (...) φ towards which it bends at the base [rad].

    Raises:
        ValueError: as for `affine_curvature`.

    Example:
        >>> ta.helix(curvature=2.0, torsion=math.pi, nodes=2)[:, 4:].round(decimals=2).tolist()  # (κ_y, κ_z) go round
        [[-1.41, 1.41], [-1.41, -1.41]]
    """
    check_count("nodes", nodes, 1)
    given = {"curvature": curvature, "torsion": torsion, "length": length, "direction": direction}
    bend, turn, along, first = _checked(given)
    arc = (torch.arange(nodes, dtype=along.dtype, device=along.device) + 0.5) / nodes
    return _towards(along, bend.expand(*bend.shape[:-1], nodes), first + turn * arc)


def arc_to(tip: TensorLike, nodes: int = 10, base_pose: TensorLike | str | None = None) -> Tensor:
    """Twists (..., N, 3 or 6) of the arc of a circle that leaves the base along its backbone and ends at a point.

    Args:
        tip: (..., 2) or (..., 3) the point in the world frame [m].
        nodes: N.
        base_pose: (3,) or (4, 4), or "hanging" (None), "upright" or "horizontal", from the origin.

    Raises:
        ValueError: shapes do not fit, a value is not finite, or the point is the base, or straight behind it, where
            no one arc leads.

    Example:
        >>> ta.poses(ta.arc_to([0.2, -0.3]))[-1, :2].round(decimals=3).tolist()  # it ends there
        [0.2, -0.3]
    """
    check_count("nodes", nodes, 1)
    given = {"tip": tip} if goes_by_name(base_pose) else {"tip": tip, "base_pose": base_pose}
    point, *pose = as_floating(**given)
    for name, value in zip(given, (point, *pose), strict=True):
        check_finite(name, value)
    if point.ndim < 1 or point.shape[-1] not in (2, 3):
        raise ValueError(f"tip: must have shape (..., 2) or (..., 3), got {tuple(point.shape)}")
    columns = 3 * point.shape[-1] - 3
    base = as_base(pose[0] if pose else base_pose, point, columns)
    check_base_shape(base, columns)
    ahead, *across = _from_base(point, base)
    square = sum(part * part for part in across)
    chord = (ahead * ahead + square).sqrt()
    if bool(((chord == 0) | ((square <= (BEHIND * chord) ** 2) & (ahead < 0))).any()):
        raise ValueError("tip: must lie neither at the base nor straight behind it, where no one arc leads")
    straight = square <= (AHEAD * chord) ** 2  # there the turn is (2/x) times the offset across, to rounding
    aside = torch.where(straight, chord, square).sqrt()
    half = torch.atan2(aside, ahead)
    turn = 2 * torch.where(straight, 1 / chord, half / aside)
    length = torch.where(straight, chord, chord / torch.sinc(half / math.pi))
    none = torch.zeros_like(length)
    bends = (turn * across[0],) if columns == 3 else (none, none, -turn * across[1], turn * across[0])
    return torch.stack((length, none, *bends), -1).unsqueeze(-2).expand(*length.shape, nodes, columns)


def _from_base(point: Tensor, base: Tensor) -> tuple[Tensor, ...]:
    """Coordinates of a point in the frame of a pose: along the backbone, and across it."""
    if len(base) == 3:
        off, cosine, sine = point - base[:2], base[2].cos(), base[2].sin()
        return off[..., 0] * cosine + off[..., 1] * sine, off[..., 1] * cosine - off[..., 0] * sine
    return ((point - base[:3, 3]) @ base[:3, :3]).unbind(-1)


def _bent(length: TensorLike, nodes: int, direction: TensorLike | None, **coefficients: TensorLike) -> Tensor:
    """Twists of a curvature that is a polynomial in arc, from the highest power down."""
    check_count("nodes", nodes, 1)
    given = {**coefficients, "length": length} | ({} if direction is None else {"direction": direction})
    values = dict(zip(given, _checked(given), strict=True))
    along, towards = values.pop("length"), values.pop("direction", None)
    arc = torch.linspace(0, 1, nodes, dtype=along.dtype, device=along.device)
    curvature = torch.zeros_like(arc).expand(*along.shape[:-1], nodes)
    for coefficient in values.values():
        curvature = curvature * arc + coefficient
    if towards is not None:
        return _towards(along, curvature, towards)
    return torch.stack((along.expand_as(curvature), torch.zeros_like(curvature), curvature), -1)


def _checked(given: dict[str, TensorLike]) -> list[Tensor]:
    """The values as tensors (..., 1) of one shape."""
    values = dict(zip(given, as_floating(**given), strict=True))
    for name, value in values.items():
        check_finite(name, value)
    check_at_least("length", values["length"], 0.0, strict=True, unit="m")
    shape = broadcast_shapes(**{name: value.shape for name, value in values.items()})
    return [value.expand(shape).unsqueeze(-1) for value in values.values()]


def _towards(length: Tensor, curvature: Tensor, direction: Tensor) -> Tensor:
    """Twists (..., N, 6) of curvatures (..., N) that bend towards a direction."""
    none = torch.zeros_like(curvature)
    bends = (-curvature * direction.sin(), curvature * direction.cos())
    return torch.stack((length.expand_as(curvature), none, none, none, *bends), -1)
