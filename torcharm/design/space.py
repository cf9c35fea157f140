"""What an optimiser may change of an arm, and how far."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from torcharm.actuators.inspection import same_model
from torcharm.actuators.protocol import is_moulded
from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries, rebuilt, segments_of, with_slices
from torcharm.inputs import check_choice, check_flag, check_number, shown
from torcharm.task import Task, for_each_task, task_list
from torcharm.wrench_sets.design_task_grid import fitted

UNITS = {"radii": "m", "angles": "rad", "length": "m", "max_pressure": "kPa"}
FIELDS = tuple(UNITS)
"""Of each actuator, in the order in which their values are kept."""
TIES = ("mirror", "equal", "ring", "none")
SAME = 1e-6
"""Radii, lengths [m] and limits [kPa] no further apart count as equal in a given arm: single precision rounds so."""
FARTHEST = 0.1
"""The default bound on radii [m], unless a given arm reaches further: a wider arm is no slender rod."""
LEAST_SPACING = 0.005
"""Between the centres of actuators of unknown diameter [m]: thinner ones can hardly be bought."""

Array = npt.NDArray[np.float64]
Ties = str | Sequence[Sequence[int]] | None
Limits = tuple[float | Sequence[float], float | Sequence[float]]
Arm = ArmDesign | ArmSeries


@dataclass(frozen=True)
class DesignSpace:
    """What an optimiser may change, and how far; of arms in series in each segment alike.

    Attributes:
        free: which of "radii", "angles", "length", "max_pressure" may change; the rest stays as given. In the plane
            radii are the offsets, positive to the left; in space, with the angles from the arm's left towards body z,
            they are polar coordinates.
        tied: which actuators change together. "ring", in space: those of one model, radius, length, limit and diameter
            stay alike and turn together, and one on the backbone stays there. "mirror" makes a symmetric arm:
            actuator α and M + 1 - α have opposite radii in the plane, equal ones in space and angles that turn
            oppositely, and equal lengths and limits. "equal" gives all one value (in the plane of no use for radii),
            and turns all angles together. "none" ties nothing. Groups such as ((0, 3), (1, 2)) have radii of equal
            size, whose signs are the given arm's, equal lengths and limits, and turn together. A mapping ties each
            field in its own way: {"radii": "mirror", "length": "equal"}. None, and fields that a mapping leaves out:
            "ring" in space, "none" in the plane. Whatever the ties, those that are moulded in one body, as chambers and
            their elastic core, have one length.
        bounds: for each free field (lowest, highest), as numbers or one number for each actuator [m, rad, m, kPa].
            Without them: radii within ±0.1 m, in space up to 0.1 m (or what the given arm has), angles within half a
            turn of the given ones, lengths from half to one and a half times the given ones, limits from 0 to the
            given ones: what a pump cannot give is not asked of it.
        spacing: least distance between the centres of two actuators of a segment [m]; None takes what the arm's
            diameters need, or 5 mm where they are not known. In the plane actuators stay in their given order. What is
            never under pressure and has no diameter, such as an elastic core, takes no room.
        in_range: whether strains on all task shapes, and limits, stay in the models' characterised range; and whether
            predicted strains beyond it count in an `Objective` of predicted errors.

    Raises:
        ValueError: an argument is none of those allowed.

    Example:
        >>> space = ta.DesignSpace(free="radii", tied="mirror", bounds={"radii": (-0.06, 0.06)}, spacing=0.02)
        >>> float(space.spacing_of(ta.bellows_arm())[0, 1])  # what an optimiser keeps between two actuators [m]
        0.02
    """

    free: str | Sequence[str] = ("radii", "length")
    tied: Ties | Mapping[str, Ties] = None
    bounds: Mapping[str, Limits] = field(default_factory=dict)
    spacing: float | None = None
    in_range: bool = True

    def __post_init__(self) -> None:
        free = (self.free,) if isinstance(self.free, str) else tuple(self.free)
        if not free:
            raise ValueError(f"free: must name at least one of {', '.join(FIELDS)}, got none")
        for name in (*free, *self.bounds):
            check_choice("free" if name in free else "bounds", name, FIELDS)
        for name in self.bounds:
            if name not in free:
                raise ValueError(f"bounds: {name} is not free, so it cannot have bounds; free are {', '.join(free)}")
        for name, tie in self.tied.items() if isinstance(self.tied, Mapping) else [(FIELDS[0], self.tied)]:
            check_choice("tied", name, FIELDS)
            if isinstance(tie, str):
                check_choice("tied", tie, TIES)
        check_flag("in_range", self.in_range)
        if self.spacing is not None:
            check_number("spacing", self.spacing, 0.0, strict=True, unit="m")
        object.__setattr__(self, "free", tuple(name for name in FIELDS if name in free))

    def apart(self, segment: ArmDesign) -> list[int]:
        """The actuators of a segment that keep their distance."""
        if segment.diameter is None:
            wide = segment.max_pressure
        else:
            wide = torch.maximum(segment.max_pressure, segment.diameter)
        return torch.nonzero((wide > 0).reshape(-1, segment.actuator_count).any(0)).flatten().tolist()

    def spacing_of(self, segment: ArmDesign) -> Array:
        """(M, M) least distances between the centres of actuators [m]."""
        count = segment.actuator_count
        if self.spacing is not None:
            return np.full((count, count), self.spacing)
        if segment.diameter is None:
            return np.full((count, count), LEAST_SPACING)
        half = segment.diameter.detach().double().cpu().reshape(-1, count).amax(0).numpy() / 2
        return np.asarray(half[:, None] + half)


def fitting_tasks(arm: Arm, task: Task | Sequence[Task]) -> tuple[Task, ...]:
    """The tasks as a tuple, as they fit some designs.

    Raises:
        ValueError: there is none, one is no task, or they do not fit.
    """
    tasks = task_list(task)
    if any(0 in one.batch_shape for one in tasks):
        raise ValueError("task: must hold at least one task, got none")
    found = for_each_task(task, lambda one: fitted(arm, one)[1])
    return found if isinstance(found, tuple) else (found,)


def given_values(arm: Arm) -> Array:
    """Designs as (B, 4, M): radii, angles, lengths and limits of all actuators; in the plane all angles are 0."""
    batch, parts = arm.batch_shape, []
    for segment in segments_of(arm)[0]:
        across = segment.offsets
        radii = segment.radii if segment.dimension == 2 else across.norm(dim=-1)
        angles = 0.0 * segment.radii if segment.dimension == 2 else across[..., 1].atan2(across[..., 0])
        fields = torch.stack(torch.broadcast_tensors(radii, angles, segment.length, segment.max_pressure), -2)
        parts.append(fields.detach().double().cpu().expand(*batch, *fields.shape[-2:]))
    return np.asarray(torch.cat(parts, -1).reshape(-1, len(FIELDS), arm.actuator_count))


def one_of_batch(arm: Arm, index: int) -> Arm:
    """A design of a flattened batch; the arm itself if it is no batch."""
    if not arm.batch_shape:
        return arm
    segments = segments_of(arm)[0]
    whole = [one._map(lambda value: value.expand(*arm.batch_shape, value.shape[-1])).flatten() for one in segments]
    return rebuilt(arm, [one[index] for one in whole])


@dataclass(frozen=True)
class FreeValues:
    """From F free values u, 0 and 1 at their bounds, to a design's values (4, M): `spread · u + base`.

    Attributes:
        spread: (4, M, F).
        base: (4, M).
        low, high: (F,) bounds of the free values.
        fields: F names of `FIELDS`, what each is of
        members: these actuators.
    """

    spread: Array
    base: Array
    low: Array
    high: Array
    fields: tuple[str, ...]
    members: tuple[tuple[int, ...], ...]

    @property
    def names(self) -> tuple[str, ...]:
        """What each is, in words."""
        return tuple(_name(field, own) for field, own in zip(self.fields, self.members, strict=True))

    def __call__(self, point: Array) -> Array:
        """The values (..., 4, M) of points (..., F): of each the same, whichever others are asked beside it."""
        return np.asarray((self.spread @ point[..., None, :, None])[..., 0] + self.base)

    def inverse(self, values: Array) -> Array:
        """The points (..., F) whose values come nearest to some (..., 4, M)."""
        matrix = np.linalg.pinv(self.spread.reshape(-1, len(self.low)))
        return np.asarray((matrix @ (values - self.base).reshape(*values.shape[:-2], -1, 1))[..., 0])

    def in_order(self, point: Array, order: Sequence[Sequence[int]]) -> Array:
        """Points (..., F) with their radii sorted: for each segment the actuators, that with the least radius first."""
        values = self(point)
        for own in order:
            values[..., 0, own] = np.sort(values[..., 0, own], -1)
        return self.inverse(values)


def free_values(space: DesignSpace, arm: Arm) -> FreeValues:
    """The free values of designs like `arm`.

    Raises:
        ValueError: given arms differ in what is not free, ties name no actuators or contradict each other, bounds are
            empty, or leave nothing free.
    """
    values = given_values(arm)
    if not len(values):
        raise ValueError("arm: must hold at least one design, got none")
    if "angles" in space.free and arm.dimension == 2:
        raise ValueError("free: angles must be left out, the arm is planar")
    base = values[0].copy()
    found: list[tuple[Array, float, float, str, tuple[int, ...]]] = []
    for segment, own in with_slices(segments_of(arm)[0]):
        for place, name in enumerate(FIELDS):
            given = values[:, place, own]
            if name not in space.free:
                if np.ptp(given, axis=0).max() > 1e-12:
                    raise ValueError(f"arm: the given designs must agree in {name}, which is not free")
                continue
            base[place, own] = zero = given[0] if name == "angles" else 0 * given[0]
            least, most = _bounds(space, name, segment, given)
            for members, signs in tied_groups(space, name, values[0, :, own], segment):
                sides = np.stack((least[members] - zero[members], most[members] - zero[members])) * signs
                low, high = float(sides.min(0).max()), float(sides.max(0).min())
                which = tuple(own.start + index for index in members)
                if low > high:
                    raise ValueError(
                        f"bounds: {_name(name, which)} are tied and have none in common, got from {low:g} to {high:g}"
                    )
                column = np.zeros_like(base)
                column[place, own][members] = signs
                if high - low > 1e-9 * max(1e-3, abs(high)):
                    found.append((column, low, high, name, which))
                else:
                    base += column * low
    if not found:
        raise ValueError("bounds: leave nothing free, the lowest and highest of every free value are the same")
    columns, lows, highs, fields, whose = zip(*found, strict=True)
    low_, high_, spread = np.array(lows), np.array(highs), np.stack(columns, -1)
    return FreeValues(spread * (high_ - low_), base + spread @ low_, low_, high_, fields, whose)


def _name(field: str, members: Sequence[int]) -> str:
    """A free value in words."""
    return f"{field} of actuator{'s' * (len(members) > 1)} {', '.join(str(index + 1) for index in members)}"


def _bounds(space: DesignSpace, name: str, segment: ArmDesign, values: Array) -> tuple[Array, Array]:
    """Lowest and highest (M,) of one field of a segment."""
    count, planar = segment.actuator_count, segment.dimension == 2
    farthest = np.full(count, max(FARTHEST, float(np.abs(values).max())))
    default = {
        "radii": (-farthest if planar else np.zeros(count), farthest),
        "angles": (values.min(0) - np.pi, values.max(0) + np.pi),
        "length": (0.5 * values.min(0), 1.5 * values.max(0)),
        "max_pressure": (np.zeros(count), values.max(0)),
    }[name]
    given = space.bounds.get(name)
    try:
        ends = default if given is None else given
        least, most = (np.broadcast_to(np.asarray(end, dtype=np.float64), (count,)) for end in ends)
    except (TypeError, ValueError):
        raise ValueError(
            f"bounds: {name} must be (lowest, highest), each a number or one for each of {count} actuators, "
            f"got {shown(given)}"
        ) from None
    floor = {"radii": -np.inf if planar else 0.0, "angles": -np.inf, "length": 1e-6, "max_pressure": 0.0}[name]
    if not (np.isfinite(least).all() and np.isfinite(most).all() and (least <= most).all() and (least >= floor).all()):
        above = {"length": " and above 0 m"}.get(name, "" if floor < 0 else f" and at least 0 {UNITS[name]}")
        raise ValueError(f"bounds: {name} must be finite, the lowest first{above}, got {shown(given)}")
    if space.in_range and name == "max_pressure":
        most = np.minimum(most, [float(model.pressure_range[1]) for model in segment.actuators])
        if (least > most).any():
            raise ValueError(
                f"bounds: max_pressure must allow the models' characterised pressures, up to "
                f"{most[least > most][0]:g} kPa, got {shown(given)}"
            )
    return least, most


def tied_groups(space: DesignSpace, name: str, given: Array, segment: ArmDesign) -> list[tuple[list[int], Array]]:
    """Actuators of a segment of values (4, M) that share one free value of a field, and with which sign."""
    tie = space.tied.get(name) if isinstance(space.tied, Mapping) else space.tied
    planar, count = segment.dimension == 2, segment.actuator_count
    word = tie if isinstance(tie, str) else None
    if word == "mirror":
        opposite = name == "angles" or (name == "radii" and planar)
        pairs = [[index, count - 1 - index] for index in range(count // 2)]
        groups = [(pair, np.array([-1.0, 1.0] if opposite else [1.0, 1.0])) for pair in pairs]
        if count % 2 and not opposite:  # else one in the middle mirrors itself, in the plane at radius 0
            groups.append(([count // 2], np.ones(1)))
    else:
        signs = np.ones(count)
        if word == "equal":
            alike = [list(range(count))]
        elif word == "ring" or (tie is None and not planar):
            alike = _rings(name, given, segment)
        else:
            alike = _checked_groups(() if tie is None or word == "none" else tie, count)
            if name == "radii" and planar:
                signs[[index for group in alike if len(group) > 1 for index in group if given[0, index] < 0]] = -1
        groups = [(group, signs[group]) for group in alike]
    body = {index for index, model in enumerate(segment.actuators) if name == "length" and is_moulded(model)}
    joined = sorted({index for members, _ in groups if body & set(members) for index in members})
    apart = [group for group in groups if not body & set(group[0])]
    return [*apart, (joined, np.ones(len(joined)))] if joined else apart


def _rings(name: str, given: Array, segment: ArmDesign) -> list[list[int]]:
    """Actuators that are alike in all but their angle; of those on the backbone, none that could leave it."""
    if segment.dimension == 2:
        raise ValueError("tied: must not be 'ring' for a planar arm, which has no rings")
    radius, _, *rest = given
    diameter = segment.radii if segment.diameter is None else segment.diameter
    size = diameter.detach().double().cpu().reshape(-1, len(radius))[0].numpy() * (segment.diameter is not None)
    values = np.stack((radius, *rest, size))
    found: list[list[int]] = []
    for index, model in enumerate(segment.actuators):
        if name in ("radii", "angles") and radius[index] <= SAME:
            continue
        for group in found:
            first = group[0]
            if same_model(model, segment.actuators[first]) and np.ptp(values[:, [first, index]], axis=1).max() <= SAME:
                group.append(index)
                break
        else:
            found.append([index])
    return found


def _checked_groups(tie: Any, count: int) -> list[list[int]]:
    """Groups of actuators as asked for, and each of the others for itself."""
    try:
        groups = [[int(index) for index in group] for group in tie]
    except (TypeError, ValueError):
        groups = [[-1]]
    named = [index for group in groups for index in group]
    if any(not 0 <= index < count for index in named) or len(set(named)) < len(named) or not all(groups):
        raise ValueError(
            f"tied: must be {', '.join(TIES)} or groups of actuators counted from 0, each below {count} and in one "
            f"group only, got {shown(tie)}"
        )
    return groups + [[index] for index in range(count) if index not in named]
