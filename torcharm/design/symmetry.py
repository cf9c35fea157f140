"""Which architectures are each other's image: an arm turned about its backbone, or mirrored, that meets the same tasks.

An orthogonal map Q across the backbone takes offsets `d` to `Q d`. With `T = diag(1, Q)` it takes body vectors v to
`T v` and body axial vectors (curvatures, moments) to `det(T) T v`; loads in the world likewise, by `B T Bᵀ` with B the
rotation of the base.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torcharm.actuators import Actuator
from torcharm.actuators.bending import active_moment, bending_model, passive_moment
from torcharm.arm import ArmDesign
from torcharm.design.checkpoint import CURVATURES
from torcharm.design.space import Arm, DesignSpace
from torcharm.geometry import se3
from torcharm.task import Task

SAME = 1e-9
"""Offsets, lengths [m] and bounds, loads and shapes no further apart are the same: roundings of a turn, or of what a
person typed."""
Order = tuple[int, ...]


def symmetries(arm: Arm, models: Sequence[Actuator], tasks: Sequence[Task], space: DesignSpace) -> list[Order]:
    """Orders of the positions that make of an architecture another with the same best design; the given one is first.

    An image counts if offsets, lengths, diameters, bounds and ties given are their own image, each model bears the
    opposite moment at the opposite curvature, and the tasks are the same in some order. Where an arm in space may turn
    freely, tasks need not be. What cannot be told at a glance counts as no image: then more is tried, and nothing lost.
    """
    found = [tuple(range(arm.actuator_count))]
    if not isinstance(arm, ArmDesign) or not isinstance(space.tied, str | None) or not all(map(_is_odd, models)):
        return found
    turns = "angles" in space.free and "angles" not in space.bounds and space.tied != "mirror"
    for turn in _candidates(arm):
        order = _order(arm, turn, space)
        if order is None or order in found or (space.tied == "mirror" and order != found[0][::-1]):
            continue
        if (turns and bool(torch.linalg.det(turn) > 0)) or _alike(_rows(tasks), _rows(tasks, turn)):
            found.append(order)
    return found


def _candidates(arm: ArmDesign) -> Iterator[Tensor]:
    """(3, 3) maps T that take an actuator to where some other is; in the plane the mirror image alone."""
    if arm.dimension == 2:
        yield torch.diag(torch.tensor((1.0, -1.0, 1.0), dtype=torch.float64))
        return
    y, z = arm.offsets.detach().double().cpu().reshape(-1, arm.actuator_count, 2)[0].unbind(-1)
    first = int(torch.hypot(y, z).argmax())
    angles = torch.atan2(z, y)
    for sign in (1.0, -1.0):
        for angle in (angles - sign * angles[first]).tolist():
            cos, sin = np.cos(angle), np.sin(angle)
            yield torch.tensor(((1.0, 0.0, 0.0), (0.0, cos, -sign * sin), (0.0, sin, sign * cos)), dtype=torch.float64)


def _order(arm: ArmDesign, turn: Tensor, space: DesignSpace) -> Order | None:
    """For each position that to which a map takes it, if the geometry given is its own image."""
    offsets = arm.offsets.detach().double().cpu().reshape(-1, arm.actuator_count, 2)
    image = offsets @ turn[1:, 1:].T
    order = torch.cdist(image[:1], offsets[:1])[0].argmin(-1)
    kept = [arm.length] if arm.diameter is None else [arm.length, arm.diameter]
    alike = [(image, offsets[:, order]), *((value, value[..., order]) for value in kept)]
    if len(set(order.tolist())) < len(order) or any(bool(((a - b).abs() > SAME).any()) for a, b in alike):
        return None
    if "angles" in space.bounds and order != tuple(range(len(order))):
        return None
    for name, bounds in space.bounds.items():
        try:
            low, high = (np.broadcast_to(np.asarray(end, dtype=np.float64), len(order)) for end in bounds)
        except (TypeError, ValueError):
            return None  # said where the bounds are put to use
        turned = (-high, -low) if name == "radii" and arm.dimension == 2 else (low, high)
        if max(np.abs(turned[0] - low[order]).max(), np.abs(turned[1] - high[order]).max()) > SAME:
            return None
    return tuple(order.tolist())


def _is_odd(model: Actuator) -> bool:
    """Whether a model bears the opposite moment at the opposite curvature."""
    if bending_model(model.bending_stiffness) is None:
        return True
    with torch.no_grad():
        moments = [part(model.bending_stiffness, CURVATURES) for part in (active_moment, passive_moment)]
    known = [moment for moment in moments if moment is not None]
    return all(bool(((one + one.flip(-1)).abs() <= SAME * one.abs().amax()).all()) for one in known)


def _rows(tasks: Sequence[Task], turn: Tensor | None = None) -> list[tuple[Any, ...]] | None:
    """Every task as numbers, in units of SAME, or its image under a map; None if not all that loads it has an image."""
    found: list[tuple[Any, ...]] = []
    for task in tasks:
        map_ = torch.eye(3, dtype=torch.float64) if turn is None else turn
        base = task.base_pose.detach().double().cpu()
        turned = (base if task.dimension == 3 else se3.from_plane(base))[:3, :3]
        world = turned @ map_ @ turned.T
        up = world.new_tensor((0.0, 1.0, 0.0))
        if task.load.gravity and float((world @ up - up).abs().max()) > SAME:
            return None
        points, batch = task.load.points, task.batch_shape
        known = {"tip", *(f"points[{index}].{part}" for index in range(len(points)) for part in ("wrench", "mass"))}
        if not task.load.tensors().keys() <= known:
            return None
        loads = [(task.tip_load, world)]
        loads += [(p.wrench, world if p.frame == "world" else map_) for p in points if p.wrench is not None]
        parts = [_image(task.twists, map_).expand(*batch, task.nodes, 6).flatten(-2)]
        parts += [_image(wrench, own).expand(*batch, 6) for wrench, own in loads]
        parts += [point.mass.detach().double().cpu().expand(batch).unsqueeze(-1) for point in points]
        places = tuple((point.segment, point.at, point.frame, point.wrench is None) for point in points)
        about = (*task.base_pose.flatten().tolist(), task.wrench_at, task.nodes, task.load.gravity, places)
        whole = torch.cat(parts, -1)
        found += [(about, *row) for row in (whole.reshape(-1, whole.shape[-1]) / SAME).round().add(0.0).tolist()]
    return sorted(found)


def _image(value: Tensor, turn: Tensor) -> Tensor:
    """The image (..., 6) of twists or wrenches of the plane or of space."""
    value = value.detach().double().cpu()
    whole = value if value.shape[-1] == 6 else se3.vector_from_plane(value)
    return torch.cat((whole[..., :3] @ turn.T, torch.linalg.det(turn) * whole[..., 3:] @ turn.T), -1)


def _alike(some: list[tuple[Any, ...]] | None, others: list[tuple[Any, ...]] | None) -> bool:
    """Whether sorted rows agree to one unit."""
    if some is None or others is None:
        return False
    return all(
        one[0] == other[0] and all(abs(a - b) <= 1 for a, b in zip(one[1:], other[1:], strict=True))
        for one, other in zip(some, others, strict=True)
    )
