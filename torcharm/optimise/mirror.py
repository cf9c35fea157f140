"""Whether an architecture and its mirror image are the same problem: only if everything else is its own mirror image.

Mounted the other way round, actuator α is in the place of M + 1 - α, at the opposite radius, and of the same length and
limit. Two architectures that are each other's mirror image are the same problem if the tasks, the designs given, the
bounds, the ties and the moments of the models all stay what they are in that mirror.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torcharm.actuators import Actuator
from torcharm.actuators.bending import active_moment, bending_model, passive_moment
from torcharm.arm import ArmDesign
from torcharm.optimise.space import DesignSpace, tied_groups
from torcharm.task import Task

Array = npt.NDArray[np.float64]
SAME = 1e-12
"""Radii, lengths [m] and limits [kPa] no further apart are the same: a rounding of numbers that a person typed."""
CURVATURES = torch.linspace(0.0, 30.0, 61, dtype=torch.float64)
"""Material curvatures [rad/m] at which a model's moments are compared with those to the other side."""


def is_mirror_symmetric(arm: ArmDesign, models: Sequence[Actuator], tasks: Sequence[Task], space: DesignSpace) -> bool:
    """Whether the choice of models is all that is not its own mirror image.

    Args:
        arm: the designs given, of which radii and lengths count.
        models: to choose from.
        tasks, space: as of `optimise_architectures`.
    """
    return (
        all(_is_odd(model) for model in models)
        and _is_mirrored("radii", arm.radii)
        and _is_mirrored("length", arm.length)
        and all(_bounds_are_mirrored(name, space.bounds[name], arm.actuator_count) for name in space.bounds)
        and all(_ties_are_mirrored(space, name, arm) for name in space.free)
        and tasks_are_mirrored(tasks)
    )


def _is_mirrored(name: str, values: Tensor) -> bool:
    """Whether each row (..., M) of radii or lengths is its own mirror image."""
    sign = -1.0 if name == "radii" else 1.0
    return bool(((values - sign * values.flip(-1)).abs() <= SAME).all())


def _is_odd(model: Actuator) -> bool:
    """Whether a model bears the opposite moment at the opposite curvature."""
    stiffness = model.bending_stiffness
    if bending_model(stiffness) is None:
        return True
    with torch.no_grad():
        left, right = CURVATURES, -CURVATURES
        pairs = [(active_moment(stiffness, left), active_moment(stiffness, right))]
        passive = passive_moment(stiffness, left), passive_moment(stiffness, right)
        pairs += [] if passive[0] is None or passive[1] is None else [(passive[0], passive[1])]
        return all(bool(((a + b).abs() <= SAME * a.abs().amax()).all()) for a, b in pairs)


def _bounds_are_mirrored(name: str, bounds: Sequence[float | Sequence[float]], count: int) -> bool:
    try:
        low, high = (np.broadcast_to(np.asarray(end, dtype=np.float64), (count,)) for end in bounds)
    except (TypeError, ValueError):
        return False  # said where the bounds are put to use
    if name == "radii":
        return bool((np.abs(low + high[::-1]) <= SAME).all())
    return bool((np.abs(low - low[::-1]) <= SAME).all() and (np.abs(high - high[::-1]) <= SAME).all())


def _ties_are_mirrored(space: DesignSpace, name: str, arm: ArmDesign) -> bool:
    """Whether the groups that share a free value are each other's mirror images, signs included."""
    values = arm.flatten()[0] if arm.batch_shape else arm
    last = arm.actuator_count - 1
    groups = tied_groups(space, name, arm.actuator_count, getattr(values, name).detach().double().cpu().numpy())
    signs: dict[frozenset[int], Mapping[int, float]] = {
        frozenset(members): dict(zip(members, sign.tolist(), strict=True)) for members, sign in groups
    }
    for members, own in signs.items():
        image = signs.get(frozenset(last - index for index in members))
        if image is None or len({own[index] * image[last - index] for index in members}) > 1:
            return False
    return True


def tasks_are_mirrored(tasks: Sequence[Task]) -> bool:
    """Whether tasks, reflected about the axis of the base, are the same tasks."""
    rows, reflected = [], []
    for task in tasks:
        twists = task.twists.detach().double().cpu().expand(*task.batch_shape, task.nodes, 3)
        load = task.tip_load.detach().double().cpu().expand(*task.batch_shape, 3)
        rows.append(_rows(twists, load))
        flip = torch.tensor((1.0, -1.0, -1.0), dtype=torch.float64)
        heading = float(task.base_pose[2])
        cos, sin = math.cos(2 * heading), math.sin(2 * heading)
        x, y, moment = load.unbind(-1)
        reflected.append(_rows(twists * flip, torch.stack((cos * x + sin * y, sin * x - cos * y, -moment), -1)))
    if len({row.shape[1] for row in rows}) > 1 or len({task.base_pose[2].item() for task in tasks}) > 1:
        return all(_same(a, b) for a, b in zip(rows, reflected, strict=True))
    return _same(torch.cat(rows), torch.cat(reflected))


def _rows(twists: Tensor, load: Tensor) -> Tensor:
    return torch.cat((twists.flatten(-2), load), -1).reshape(-1, twists.shape[-2] * 3 + 3)


def _same(rows: Tensor, others: Tensor) -> bool:
    """Whether two sets of rows are equal, in any order, to 1e-9."""
    ordered = [sorted(map(tuple, (value / 1e-9).round().tolist())) for value in (rows, others + 0.0)]
    pairs = zip(ordered[0], ordered[1], strict=True)
    return all(abs(a - b) <= 1 for one, other in pairs for a, b in zip(one, other, strict=True))
