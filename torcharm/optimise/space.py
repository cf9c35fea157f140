"""Which designs may be chosen: free fields, ties, bounds, spacing and strains, as a polytope.

Every constraint is linear in the radii, neutral lengths and pressure limits. The strain of actuator α at a
node with centreline length l and curvature κ stays within its model's range [ε₋, ε₊] if

    (1 + ε₋) l̂_α ≤ l - r_α κ ≤ (1 + ε₊) l̂_α,

so for given task shapes the feasible designs form a polytope, and constraints are kept by projection onto
it: there are no penalties to tune.
"""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from torcharm._inputs import check_choice, check_flag, shown
from torcharm.arm import ArmDesign
from torcharm.task import Task

FIELDS = ("radii", "length", "max_pressure")
TIES = ("mirror", "equal")
FARTHEST = 0.1
"""The default bound on radii [m], unless a given arm reaches further."""
STRAIN_SLACK = 1e-9
"""By how much of a length [m] strains stay off the ends of their range, so that rounding does not cross them."""

Array = npt.NDArray[np.float64]
Groups = Sequence[Sequence[int]]
Ties = str | Groups | None
Limits = tuple[float | Sequence[float], float | Sequence[float]]


@dataclass(frozen=True)
class DesignSpace:
    """What an optimiser may change, and how far.

    Attributes:
        free: which of "radii", "length", "max_pressure" may change; the rest stays as given.
        tied: which actuators change together. "mirror" makes the arm symmetric: actuator α and
            M + 1 - α have opposite radii, and equal lengths and limits. "equal" gives all one value
            (of no use for radii). Groups such as ((0, 3), (1, 2)) have radii of equal size, whose signs
            are the given arm's, and equal lengths and limits. A mapping ties each field in its own
            way: {"radii": "mirror", "length": "equal"}. None ties nothing.
        bounds: for each free field (lowest, highest), as numbers or one number per actuator [m, m, kPa].
            Without them: radii within ±0.1 m (or what the given arm has), lengths from half to
            one and a half times the given ones, limits from 0 to the models' `max_pressure`.
        spacing: least distance between the radii of neighbours [m].
        ordered: whether actuators stay in their given order across the arm. Spacing asks for it.
        in_range: whether strains on all task shapes, and limits, stay in the models' characterised range.
    """

    free: str | Sequence[str] = ("radii", "length")
    tied: Ties | Mapping[str, Ties] = None
    bounds: Mapping[str, Limits] = field(default_factory=dict)
    spacing: float = 0.0
    ordered: bool = True
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
        if isinstance(self.tied, Mapping):
            for name in self.tied:
                check_choice("tied", name, FIELDS)
        for name in ("ordered", "in_range"):
            check_flag(name, getattr(self, name))
        if not (isinstance(self.spacing, (int, float)) and 0 <= self.spacing < np.inf):
            raise ValueError(f"spacing: must be a distance of at least 0 m, got {shown(self.spacing)}")
        if self.spacing > 0 and not self.ordered:
            raise ValueError("ordered: must be True where spacing is asked for, got False")
        object.__setattr__(self, "free", tuple(name for name in FIELDS if name in free))


@dataclass(frozen=True)
class Rows:
    """Constraints `matrix · values ≤ bound`, each with what a person calls it."""

    matrix: Array
    bound: Array
    names: tuple[str, ...]


@dataclass(frozen=True)
class Coordinates:
    """From free values x to a design's values θ = (radii, lengths, limits), `θ = T x + c`.

    Attributes:
        spread: (3M, F) T, of entries 0, 1 and -1.
        fixed: (3M,) c.
        low, high: (F,) bounds of x.
    """

    spread: Array
    fixed: Array
    low: Array
    high: Array


def given_values(arm: ArmDesign) -> Array:
    """Designs as rows (B, 3M) of radii, lengths and limits."""
    flat = arm.flatten()
    parts = [getattr(flat, name).detach().double().cpu().numpy() for name in FIELDS]
    return np.concatenate(parts, -1)


def coordinates(space: DesignSpace, arm: ArmDesign) -> Coordinates:
    """The free values of designs like `arm`, and their bounds.

    Raises:
        ValueError: given arms differ in what is not free, ties name no actuators or contradict
            each other, or bounds are empty.
    """
    values, count = given_values(arm), arm.actuator_count
    if not len(values):
        raise ValueError("arm: must hold at least one design, got none")
    columns: list[Array] = []
    low: list[float] = []
    high: list[float] = []
    fixed = values[0].copy()
    for place, name in enumerate(FIELDS):
        own = slice(place * count, (place + 1) * count)
        if name not in space.free:
            if np.ptp(values[:, own], axis=0).max() > 0:
                raise ValueError(f"arm: the given designs must agree in {name}, which is not free")
            continue
        least, most = _bounds(space, name, arm, values[:, own])
        for members, signs in tied_groups(space, name, count, values[0, own]):
            column = np.zeros(3 * count)
            column[own][members] = signs
            columns.append(column)
            ends = np.stack((least[members] * signs, most[members] * signs))
            low.append(float(ends.min(0).max()))
            high.append(float(ends.max(0).min()))
            if low[-1] > high[-1]:
                raise ValueError(
                    f"bounds: {name} of tied actuators {_listed(members)} have none in common, "
                    f"got from {low[-1]:g} to {high[-1]:g}"
                )
        fixed[own] = 0
    return Coordinates(np.stack(columns, -1), fixed, np.array(low), np.array(high))


def _bounds(space: DesignSpace, name: str, arm: ArmDesign, values: Array) -> tuple[Array, Array]:
    """Lowest and highest (M,) of one field."""
    count = arm.actuator_count
    highest = np.array([float(model.max_pressure) for model in arm.actuators])
    farthest = max(FARTHEST, float(np.abs(values).max()))
    default = {
        "radii": (np.full(count, -farthest), np.full(count, farthest)),
        "length": (0.5 * values.min(0), 1.5 * values.max(0)),
        "max_pressure": (np.zeros(count), np.maximum(highest, values.max(0))),
    }[name]
    given = space.bounds.get(name)
    if given is None:
        least, most = default
    else:
        try:
            least, most = (np.broadcast_to(np.asarray(end, dtype=np.float64), (count,)) for end in given)
        except (TypeError, ValueError):
            raise ValueError(
                f"bounds: {name} must be (lowest, highest), each a number or one for each of {count} actuators, "
                f"got {shown(given)}"
            ) from None
    floor = {"radii": -np.inf, "length": 1e-6, "max_pressure": 0.0}[name]
    if not (np.isfinite(least).all() and np.isfinite(most).all() and (least <= most).all() and (least >= floor).all()):
        allowed = {"radii": "", "length": " and above 0 m", "max_pressure": " and at least 0 kPa"}[name]
        raise ValueError(f"bounds: {name} must be finite, the lowest first{allowed}, got {shown(given)}")
    if space.in_range and name == "max_pressure":
        most = np.minimum(most, [float(model.pressure_range[1]) for model in arm.actuators])
        if (least > most).any():
            raise ValueError(
                f"bounds: max_pressure must allow the models' characterised pressures, up to "
                f"{most[least > most][0]:g} kPa, got {shown(given)}"
            )
    return least, most


def tied_groups(space: DesignSpace, name: str, count: int, values: Array) -> list[tuple[list[int], Array]]:
    """Actuators that share one free value, and with which sign."""
    tie = space.tied.get(name) if isinstance(space.tied, Mapping) else space.tied
    signed = name == "radii"
    if tie is None:
        return [([index], np.ones(1)) for index in range(count)]
    if isinstance(tie, str):
        check_choice("tied", tie, TIES)
        if tie == "equal":
            return [(list(range(count)), np.ones(count))]
        pairs = [[index, count - 1 - index] for index in range(count // 2)]
        mirrored = [(pair, np.array([-1.0, 1.0] if signed else [1.0, 1.0])) for pair in pairs]
        # One in the middle mirrors itself: at radius 0, with a length of its own.
        middle = [([count // 2], np.array([0.0 if signed else 1.0]))] if count % 2 else []
        return [group for group in mirrored + middle if group[1].any()]
    groups = _checked_groups(tie, count)
    named = {index for group in groups for index in group}
    groups += [[index] for index in range(count) if index not in named]
    sign = np.where(values < 0, -1.0, 1.0) if signed else np.ones(count)
    return [(group, sign[group] if len(group) > 1 else np.ones(1)) for group in groups]


def _checked_groups(tie: Any, count: int) -> list[list[int]]:
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
    return groups


def spacing_rows(space: DesignSpace, arm: ArmDesign) -> Rows:
    """Neighbours in order, and so far apart: rows over θ."""
    count = arm.actuator_count
    if not space.ordered or "radii" not in space.free:
        return Rows(np.zeros((0, 3 * count)), np.zeros(0), ())
    order = np.argsort(given_values(arm)[0, :count], kind="stable")
    matrix = np.zeros((count - 1, 3 * count))
    rows = np.arange(count - 1)
    matrix[rows, order[:-1]], matrix[rows, order[1:]] = 1.0, -1.0
    names = tuple(f"spacing of actuators {a + 1} and {b + 1}" for a, b in itertools.pairwise(order))
    return Rows(matrix, np.full(count - 1, -float(space.spacing)), names)


def strain_rows(space: DesignSpace, arm: ArmDesign, tasks: Sequence[Task]) -> Rows:
    """Strains within the models' ranges on all task shapes: rows over θ, the redundant ones left out."""
    count = arm.actuator_count
    if not space.in_range:
        return Rows(np.zeros((0, 3 * count)), np.zeros(0), ())
    nodes = np.concatenate([_lengths_and_curvatures(task) for task in tasks])
    corners = convex_corners(nodes)
    matrix, bound, names = [], [], []
    for index, model in enumerate(arm.actuators):
        for sign, edge in ((-1.0, model.strain_range[0]), (1.0, model.strain_range[1])):
            if not np.isfinite(edge):
                continue
            # sign (l - r κ - (1 + ε) l̂) ≤ 0
            part = np.zeros((len(corners), 3 * count))
            part[:, index] = -sign * corners[:, 1]
            part[:, count + index] = -sign * (1 + edge)
            matrix.append(part)
            bound.append(-sign * corners[:, 0] - STRAIN_SLACK)
            names += [f"strain of actuator {index + 1}"] * len(corners)
    if not matrix:
        return Rows(np.zeros((0, 3 * count)), np.zeros(0), ())
    return Rows(np.concatenate(matrix), np.concatenate(bound), tuple(names))


def _lengths_and_curvatures(task: Task) -> Array:
    twists = task.twists.detach().double().cpu().numpy()
    return twists[..., (0, 2)].reshape(-1, 2)


def convex_corners(points: Array) -> Array:
    """The corners of the convex hull of points (P, 2), by Andrew's monotone chain."""
    ordered = np.unique(points, axis=0)
    if len(ordered) < 3:
        return ordered

    def chain(sequence: Iterable[Array]) -> list[Array]:
        kept: list[Array] = []
        for point in sequence:
            while len(kept) > 1 and _turn(kept[-2], kept[-1], point) <= 0:
                kept.pop()
            kept.append(point)
        return kept[:-1]

    return np.stack(chain(ordered) + chain(ordered[::-1]))


def _turn(a: Array, b: Array, c: Array) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def _listed(members: Sequence[int]) -> str:
    return ", ".join(str(index + 1) for index in members)
