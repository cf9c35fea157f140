"""The rod: from strains to poses, and from the centreline to each actuator.

Twists are rows `(l, γ, κ)` in the plane or `(l, γ_y, γ_z, κ_x, κ_y, κ_z)` in space, one for each of N elements, per
unit of their own segment's normalised arc; the number of columns says which.
"""

import math
from collections.abc import Sequence
from types import ModuleType
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torcharm.geometry import se2, se3
from torcharm.inputs import broadcast_shapes, check_choice, check_count, check_tensor, shown

HEADINGS = {"hanging": -math.pi / 2, "upright": math.pi / 2, "horizontal": 0.0}
"""Where a base may point by name, as the heading in the plane z = 0 [rad]: x is right, y is up."""
HANGING = "hanging"
RIGID = 1e-6
"""How far a pose's rotation may be from one, by the entries of RᵀR - 1: what single precision rounds to, and less
than any typing error."""
BASE_POSE = (0.0, 0.0, HEADINGS[HANGING])
"""Of a planar arm that hangs from the origin."""


def group_of(columns: int) -> ModuleType:
    """`se2` for vectors of 3 components, `se3` for 6."""
    return {3: se2, 6: se3}[columns]


def goes_by_name(base_pose: object) -> bool:
    """Whether a base pose is one of `HEADINGS`, or None, which is one, too."""
    return base_pose is None or isinstance(base_pose, str)


def check_base_shape(base_pose: Tensor, columns: int) -> None:
    """Raise a ValueError unless a base pose is one pose of the plane or of space, for twists of so many columns."""
    shape = group_of(columns).POSE_SHAPE
    if base_pose.shape != shape:
        given = tuple(base_pose.shape)
        raise ValueError(f"base_pose: must be {', '.join(HEADINGS)} or a pose of shape {shape}, got shape {given}")


def check_rigid(name: str, pose: Tensor) -> None:
    """Raise a ValueError unless poses (..., 3) or (..., 4, 4) in space are homogeneous matrices of rotations."""
    if pose.shape[-2:] != (4, 4):
        return
    rotation = pose[..., :3, :3].detach()
    off = (rotation.mT @ rotation - torch.eye(3).to(pose)).abs()
    last = (pose[..., 3, :].detach() - pose.new_tensor((0.0, 0.0, 0.0, 1.0))).abs()
    if bool((off > RIGID).any() or (last > RIGID).any() or (torch.linalg.det(rotation) < 0).any()):
        raise ValueError(
            f"{name}: must be a homogeneous matrix, a rotation and a position above a row (0, 0, 0, 1), "
            f"got {shown(pose.detach().tolist())}"
        )


def as_base(base_pose: Any, like: Tensor, columns: int) -> Any:
    """The pose (3,) or (4, 4) that a name stands for, in the dtype and on the device of a tensor; None hangs the arm.

    A pose stays as it is. In space body x points where the heading says, body z along world z.

    Raises:
        ValueError: there is no such name.
    """
    if not goes_by_name(base_pose):
        return base_pose
    name = HANGING if base_pose is None else base_pose
    check_choice("base_pose", name, HEADINGS)
    heading = HEADINGS[name]
    if columns == 3:
        return like.new_tensor((0.0, 0.0, heading))
    cosine, sine = round(math.cos(heading)), round(math.sin(heading))
    rows = ((cosine, -sine, 0, 0), (sine, cosine, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))
    return like.new_tensor(rows)


def poses(
    twists: Float[Tensor, "*#batch N K"],
    base_pose: Tensor | str | None = None,
    *,
    segment_nodes: Sequence[int] | None = None,
    links: Sequence[Tensor | None] | None = None,
) -> Tensor:
    """Poses of the N+1 nodes of a rod of N elements of constant twist, in the world frame.

    The product of exponentials `g_{i+1} = g_i ∘ exp(twist_i / N)`: node i is the start of element i, and the last
    pose is the tip. In the plane it is written as two running sums, because headings add, without a loop
    over the nodes.

    Args:
        twists: (..., N, 3) `(l, γ, κ)` or (..., N, 6) `(l, γ_y, γ_z, κ_x, κ_y, κ_z)` per unit of the segment's own
            normalised arc [m, rad], segment after segment.
        base_pose: pose of node 1, (..., 3) [m, m, rad] or (..., 4, 4); or of `HEADINGS`: None is "hanging".
        segment_nodes: the number of elements of each segment in series; None is one segment.
        links: for each segment the constant pose of the rigid link after it, or None. The link of the last segment
            lies between its end and the tip.

    Returns:
        (..., N+1, 3) or (..., N+1, 4, 4).

    Raises:
        ValueError: shapes do not fit.

    Example:
        >>> ta.poses(ta.constant_curvature(math.pi / 3, length=0.5))[-1].round(decimals=3).tolist()  # the tip, hanging
        [0.239, -0.413, -0.524]
    """
    group, counts, base = check_rod(twists, base_pose, segment_nodes)
    step = with_links(group.exp(element_twists(twists, counts)), counts, links)
    return chain(base, step, group)


def check_rod(
    twists: Tensor, base_pose: Tensor | str | None, segment_nodes: Sequence[int] | None
) -> tuple[ModuleType, tuple[int, ...], Tensor]:
    """The group, the elements of each segment and the base, once shapes are known to fit.

    Raises:
        ValueError: they do not.
    """
    columns = 6 if isinstance(twists, Tensor) and twists.ndim > 1 and twists.shape[-1] == 6 else 3
    check_tensor("twists", twists, "N", columns)
    group = group_of(columns)
    base = as_base(base_pose, twists, columns)
    check_tensor("base_pose", base, *group.POSE_SHAPE)
    broadcast_shapes(twists=twists.shape[:-2], base_pose=base.shape[: base.ndim - len(group.POSE_SHAPE)])
    return group, check_segment_nodes(segment_nodes, twists.shape[-2]), base


def check_segment_nodes(segment_nodes: Sequence[int] | None, nodes: int) -> tuple[int, ...]:
    """The number of elements of each segment, which must sum to that of the twists.

    Raises:
        ValueError: they do not, or one is no positive integer.
    """
    if segment_nodes is None:
        return (nodes,)
    if not isinstance(segment_nodes, Sequence) or isinstance(segment_nodes, str):
        raise ValueError(f"segment_nodes: must be a list of integers, got {shown(segment_nodes)}")
    counts = tuple(check_count("segment_nodes", count, 1) for count in segment_nodes)
    if sum(counts) != nodes:
        raise ValueError(f"segment_nodes: must sum to the {nodes} rows of the twists, got {shown(list(counts))}")
    return counts


def element_twists(twists: Float[Tensor, "*batch N K"], counts: Sequence[int]) -> Float[Tensor, "*batch N K"]:
    """Each element's own twist: that of its segment over the segment's number of elements."""
    if len(counts) == 1:
        return twists / counts[0]
    divisor = [float(count) for count in counts for _ in range(count)]
    return twists / twists.new_tensor(divisor).unsqueeze(-1)


def with_links(step: Tensor, counts: Sequence[int], links: Sequence[Tensor | None] | None) -> Tensor:
    """Steps from node to node: those of the elements, and after a segment's last element its link as well."""
    if links is None or all(link is None for link in links):
        return step
    group = group_of(6 if step.shape[-2:] == (4, 4) else 3)
    if len(links) != len(counts):
        raise ValueError(f"links: must be one for each of the {len(counts)} segments, got {len(links)}")
    axis = -1 - len(group.POSE_SHAPE)
    parts = list(step.split(list(counts), axis))
    for index, (part, link) in enumerate(zip(parts, links, strict=True)):
        if link is not None:
            check_tensor(f"links[{index}]", link, *group.POSE_SHAPE)
            last = group.compose(part.narrow(axis, part.shape[axis] - 1, 1), link.unsqueeze(axis))
            kept = part.narrow(axis, 0, part.shape[axis] - 1)
            parts[index] = torch.cat((kept.expand(*last.shape[:axis], *kept.shape[axis:]), last), axis)
    batch = torch.broadcast_shapes(*(part.shape[:axis] for part in parts))
    return torch.cat([part.expand(*batch, *part.shape[axis:]) for part in parts], axis)


def chain(base: Tensor, step: Tensor, group: ModuleType) -> Tensor:
    """The base and its products with the steps, one after the other: N+1 poses of N steps."""
    if group is se3:
        return _chain_in_space(base, step)
    turned = torch.cat((torch.zeros_like(step[..., :1, 2]), step[..., 2].cumsum(-1)), -1)
    heading = base[..., 2:] + turned
    moved = se2.turned(heading[..., :-1], step[..., :2].expand(*heading.shape[:-1], step.shape[-2], 2)).cumsum(-2)
    start = base[..., None, :2].expand(*moved.shape[:-2], 1, 2)
    return torch.cat((torch.cat((start, start + moved), -2), heading.unsqueeze(-1)), -1)


def _chain_in_space(base: Tensor, step: Tensor) -> Tensor:
    """Running products, node after node: in large batches a scan of fewer but wider products costs twice as much."""
    found = [base.expand(*torch.broadcast_shapes(base.shape[:-2], step.shape[:-3]), 4, 4)]
    for one in step.unbind(-3):
        found.append(se3.compose(found[-1], one))
    return torch.stack(found, -3)


def actuator_lengths(twists: Float[Tensor, "*#batch N K"], radii: Tensor) -> Float[Tensor, "... N M"]:
    """Each actuator's own length [m]: in the plane `l - r κ`, in space `l + z κ_y - y κ_z`.

    It is the first component of `Ad⁻¹` of the centreline's twist for an offset across the arm.

    Args:
        twists: (..., N, 3) or (..., N, 6).
        radii: (..., M) offsets r [m] in the plane, (..., M, 2) offsets (y, z) in space.
    """
    if twists.shape[-1] == 3:
        return offset_length(twists[..., None, 0], twists[..., None, 2], radii.unsqueeze(-2))
    y, z = radii.unsqueeze(-3).unbind(-1)
    return offset_length(twists[..., None, 0], twists[..., None, 5], y, twists[..., None, 4], z)


def offset_length(
    length: Float[Tensor, "..."],
    curvature: Float[Tensor, "..."],
    radius: Float[Tensor, "..."],
    curvature_y: Float[Tensor, "..."] | None = None,
    out_of_plane: Float[Tensor, "..."] | None = None,
) -> Float[Tensor, "..."]:
    """Length `l - y κ_z + z κ_y` [m] of an actuator beside a centreline of length l [m] and curvature κ [rad].

    Args:
        length, curvature: of the centreline; the curvature is κ_z in space.
        radius: the offset y, or the radius in the plane [m].
        curvature_y, out_of_plane: κ_y and the offset z [m] in space; left out in the plane.
    """
    own_length = length - radius * curvature
    if curvature_y is None or out_of_plane is None:
        return own_length
    return own_length + out_of_plane * curvature_y


def strain(actuator_length: Float[Tensor, "..."], neutral_length: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
    """`ε = (l_α - l̂_α)/l̂_α`, without unit."""
    return (actuator_length - neutral_length) / neutral_length


def material_curvature(
    curvature: Float[Tensor, "..."],
    actuator_length: Float[Tensor, "..."],
    neutral_length: Float[Tensor, "..."],
) -> Float[Tensor, "..."]:
    """Curvature per metre of the actuator as it lies, `κ/l_α` [rad/m].

    An actuator squeezed to nothing has no curvature: below a millionth of its neutral length
    (a strain of -1, far outside every force model's range) the length is held there, so that the
    quotient stays finite.
    """
    floor = 1e-6 * neutral_length
    held = torch.where(actuator_length < 0, -floor, floor)
    return curvature / torch.where(actuator_length.abs() < floor, held, actuator_length)
