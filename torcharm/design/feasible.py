"""Which designs satisfy the constraints of a space: bounds, spacing, strains within their range.

The strain of actuator α at a node with centreline length l and bending curvatures κ_y, κ_z stays within its model's
range [ε₋, ε₊] if

    (1 + ε₋) l̂_α ≤ l + z_α κ_y - y_α κ_z ≤ (1 + ε₊) l̂_α.

Task shapes are given, so that in the plane every constraint is linear in the free values; in space offsets are polar.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.arm_series import rebuilt, segments_of, with_slices
from torcharm.design.space import UNITS, Arm, Array, DesignSpace, FreeValues, free_values, given_values, one_of_batch
from torcharm.task import Task

SLACK = 1e-7
"""By how much [m] constraints are to be kept, so that neither the descent's tolerance nor rounding breaks them."""
FEASIBLE = 2e-8
"""By how much [m] one may be broken by what counts as feasible: less than the slack, more than the tolerance."""
ACTIVE = 1e-4
"""Constraints with less slack [m], and bounds with less of their range, count as met with equality."""
STIFF = 1e4
"""Price of breaking a constraint by a metre, in squared distances of points: above what any constraint is worth."""
SPACING_ADVICE = "lessen the spacing (optimise.spacing) or diameters, or widen the bounds (optimise.bounds)"
STRAIN_ADVICE = "widen the bounds (optimise.bounds) or the models' strain_range, or set in_range = false"
"""What may be changed where actuators find no room, or are strained too far; in brackets what a study calls it."""
Function = Callable[[Array], tuple[float, Array]]


@dataclass(frozen=True, eq=False)
class Constraints:
    """`g ≥ 0` over the offsets y, z and lengths l̂ of M actuators, one after the other in x (3 M).

    Attributes:
        rows, constant: (L, 3 M) and (L,) of `g = rows x + constant`: strains and, in the plane, distances.
        pairs: (P, 2) actuators whose distance in space is at least
        gap: (P,) [m].
        names: of the L + P, what each is.
    """

    rows: Array
    constant: Array
    pairs: Any
    gap: Array
    names: tuple[str, ...]

    def slack(self, x: Array) -> Array:
        """g (..., L + P) [m] at x (..., 3 M)."""
        return np.concatenate((x @ self.rows.T + self.constant, np.hypot(*self._apart(x)) - self.gap), -1)

    def slope(self, x: Array) -> Array:
        """Its derivatives (L + P, 3 M) at x (3 M)."""
        apart, (first, second), slope = self._apart(x), self.pairs.T, np.zeros((len(self.pairs), 3, len(x) // 3))
        for place, way in enumerate(apart / np.maximum(np.hypot(*apart), 1e-12)):
            slope[np.arange(len(way)), place, second] += way
            slope[np.arange(len(way)), place, first] -= way
        return np.concatenate((self.rows, slope.reshape(-1, len(x))))

    def _apart(self, x: Array) -> Array:
        """From the first to the second of each pair, along y and z (2, ..., P) [m]."""
        y, z, _ = np.split(x, 3, -1)
        first, second = self.pairs.T
        return np.stack((y[..., second] - y[..., first], z[..., second] - z[..., first]))

    def at(self, index: Any) -> "Constraints":
        """Those at some of their numbers, in order."""
        linear, others = index[index < len(self.rows)], index[index >= len(self.rows)] - len(self.rows)
        names = tuple(self.names[one] for one in index)
        return Constraints(self.rows[linear], self.constant[linear], self.pairs[others], self.gap[others], names)


@dataclass(frozen=True, eq=False)
class FeasibleDesigns:
    """Designs by their free values u, which are 0 and 1 at their bounds.

    Attributes:
        arm: whose actuators, dtype and device the designs have.
        free: what the free values are.
        constraints: on them, besides the bounds: those that the free values change, each once.
        in_range: whether strains are to stay in their characterised range, those of the shapes reached, too.
    """

    arm: Arm
    free: FreeValues
    constraints: Constraints
    in_range: bool

    @property
    def dimension(self) -> int:
        """F."""
        return len(self.free.low)

    def design(self, point: Tensor | Array) -> Arm:
        """Designs of batch shape (...) from free values (..., F), differentiable in tensors."""
        return designs_at(self.arm, self.free, point)

    def constraint_values(self, point: Array) -> tuple[Array, Array]:
        """g (C,) [m], at least 0 where all constraints are kept, and its derivatives (C, F)."""
        radius, angle, length, _ = self.free(point)
        along_radius, along_angle, along_length, _ = self.free.spread
        cos, sin = np.cos(angle), np.sin(angle)
        x = np.concatenate((radius * cos, radius * sin, length))
        y = cos[:, None] * along_radius - (radius * sin)[:, None] * along_angle
        z = sin[:, None] * along_radius + (radius * cos)[:, None] * along_angle
        return self.constraints.slack(x), self.constraints.slope(x) @ np.concatenate((y, z, along_length))

    def allows(self, points: Array) -> Any:
        """Whether each of points (n, F) breaks no constraint and no bound: (n,) of True and False."""
        radius, angle, length, _ = np.moveaxis(self.free(points), -2, 0)
        slack = self.constraints.slack(np.concatenate((radius * np.cos(angle), radius * np.sin(angle), length), -1))
        inside = ((points >= -FEASIBLE) & (points <= 1 + FEASIBLE)).all(-1)
        return (slack >= -FEASIBLE).all(-1) & inside

    @property
    def order(self) -> tuple[tuple[int, ...], ...]:
        """For each segment of a planar arm its actuators from right to left, as they stay; nothing in space."""
        if self.arm.dimension == 3:
            return ()
        slices = with_slices(segments_of(self.arm)[0])
        return tuple(tuple(own.start + index for index in _order(segment)) for segment, own in slices)

    @property
    def names(self) -> tuple[str, ...]:
        """What the constraints are."""
        return self.constraints.names

    def violation(self, point: Array) -> float:
        """By how much a point (F,) breaks a constraint [m] or a bound [share of its range]; 0 inside."""
        over = np.concatenate((-point, point - 1, -self.constraint_values(point)[0]))
        return float(max(over.max(), 0.0))

    def minimise(
        self, function: Function, start: Array, iterations: int, tolerance: float, elastic: bool = False
    ) -> Any:
        """SciPy's answer: the descent of a function, with its gradient, by sequential least squares.

        Args:
            function: of a point (F,).
            start: (F,).
            iterations, tolerance: of SciPy's SLSQP.
            elastic: whether one more unknown, which the function is given last, widens all constraints [m].
        """
        from scipy.optimize import minimize

        slack = {
            "type": "ineq",
            "fun": lambda u: self.constraint_values(u[: self.dimension])[0] - SLACK + u[self.dimension :].sum(),
            "jac": lambda u: np.pad(
                self.constraint_values(u[: self.dimension])[1], ((0, 0), (0, int(elastic))), constant_values=1.0
            ),
        }
        return minimize(
            function,
            start,
            jac=True,
            method="SLSQP",
            bounds=[(0.0, 1.0)] * self.dimension + [(0.0, None)] * elastic,
            constraints=[slack] if self.names else [],
            options={"maxiter": iterations, "ftol": tolerance},
        )

    def project(self, point: Array) -> Array:
        """A feasible point (F,), in the plane the nearest, to a point (F,).

        Raises:
            ValueError: none was found; the message says what cannot be had.
        """
        near = self._nearest(point)
        if self.violation(near) <= FEASIBLE:
            return near
        raise ValueError(self._conflict(point))

    def _nearest(self, point: Array) -> Array:
        """The feasible point nearest to a point (F,), or one where constraints are broken least."""
        inside = np.clip(point, 0, 1)
        if self.violation(inside) <= 0:
            return inside

        def distance(u: Array) -> tuple[float, Array]:
            way, wider = u[: self.dimension] - point, u[self.dimension :]
            return 0.5 * float(way @ way) + STIFF * float(wider.sum()), np.append(way, STIFF + 0 * wider)

        near = widened = inside
        for elastic in (False, True, False):  # the last from where constraints are broken least
            start = np.append(near, self.violation(near) + SLACK) if elastic else near
            near = np.clip(self.minimise(distance, start, 500, 1e-12, elastic).x[: self.dimension], 0, 1)
            if self.violation(near) <= FEASIBLE:
                return near
            widened = near if elastic else widened
        return widened

    def _conflict(self, point: Array) -> str:
        """Which constraints cannot be kept, near a point (F,): of one kind if that alone cannot be kept."""
        spacing = np.array([name.startswith("spacing") for name in self.names])
        kinds = {
            advice: replace(self, constraints=self.constraints.at(np.flatnonzero(which)))
            for advice, which in ((SPACING_ADVICE, spacing), (STRAIN_ADVICE, ~spacing))
        }
        broken = {advice: one for advice, one in kinds.items() if one.violation(one._nearest(point)) > FEASIBLE}
        words = []
        for one in broken.values() or (self,):
            value = one.constraint_values(one._nearest(point))[0]
            worst = dict.fromkeys(
                one.names[index] for index in np.argsort(value.round(6), kind="stable") if value[index] < -FEASIBLE
            )
            words.append(f"{', '.join(list(worst)[:3])} (broken by {-1e3 * value.min():.2g} mm at best)")
        return (
            "space: no design within the bounds keeps all constraints on all task shapes, among them "
            f"{', '.join(words)}; {'; '.join(broken or kinds)}"
        )

    def random(self, count: int, seed: int) -> list[Array]:
        """Feasible points, spread over the space; fewer where some draws led to none."""
        generator, found = np.random.default_rng(seed), []
        for _ in range(4 * count):
            point = generator.random(self.dimension)
            if self.order:  # a draw is brought into it
                point = self.free.in_order(point, self.order)
            try:
                found.append(self.project(point))
            except ValueError:
                continue
            if len(found) == count:
                break
        return found

    def active(self, point: Array) -> tuple[str, ...]:
        """What holds a point (F,) back: bounds and constraints that are met with equality, in words."""
        free, words = self.free, []
        for index, name in enumerate(free.names):
            for end, near in ((free.low, point[index]), (free.high, 1 - point[index])):
                if near < ACTIVE:
                    words.append(f"{name} at the bound of {end[index]:g} {UNITS[free.fields[index]]}")
        value, names = self.constraint_values(point)[0], self.names
        return (*words, *dict.fromkeys(names[index] for index in np.flatnonzero(value < ACTIVE)))

    def violated_by(self, arm: Arm) -> tuple[str, ...]:
        """Ties, bounds and constraints that one design breaks, in words."""
        free, given, words = self.free, given_values(arm)[0], []
        point = free.inverse(given)
        if np.abs(given - free(point)).max() > FEASIBLE:
            words.append("ties")
        for index, name in enumerate(free.names):
            if max(-point[index], point[index] - 1) > FEASIBLE:
                words.append(f"{name} beyond the bounds of {free.low[index]:g} to {free.high[index]:g}")
        value, names = self.constraint_values(point)[0], self.names
        worst: dict[str, float] = {}
        for index in np.flatnonzero(value < -FEASIBLE):
            worst[names[index]] = max(worst.get(names[index], 0.0), -value[index])
        return (*words, *(f"{name} by {1e3 * excess:.3g} mm" for name, excess in worst.items()))


def designs_at(arm: Arm, free: FreeValues, point: Tensor | Array) -> Arm:
    """Designs like an arm, of batch shape (...), from free values (..., F), differentiable in tensors."""
    segments = segments_of(arm)[0]
    at = torch.as_tensor(point)
    spread, base = (torch.from_numpy(value) for value in (free.spread, free.base))
    values = ((spread @ at[..., None, :, None]).squeeze(-1) + base).to(segments[0].radii)
    made = []
    for segment, own in zip(segments, values.split([one.actuator_count for one in segments], -1), strict=True):
        radius, angle, length, limit = own.unbind(-2)
        if segment.dimension == 2:
            made.append(segment.with_values(radius, length, limit))
        else:
            made.append(segment.with_values(radius * angle.cos(), length, limit, radius * angle.sin()))
    return rebuilt(arm, made)


def feasible_designs(space: DesignSpace, arm: Arm, tasks: Sequence[Task]) -> FeasibleDesigns:
    """The designs that a space allows on the shapes of tasks.

    Raises:
        ValueError: as of `free_values`, or a constraint is broken that nothing free changes.
    """
    constraints = _constraints(space, arm, tasks)
    probe = FeasibleDesigns(one_of_batch(arm, 0), free_values(space, arm), constraints, space.in_range)
    value, slope = probe.constraint_values(np.random.default_rng(0).random(probe.dimension))
    moved = np.abs(slope).max(-1, initial=0.0) > 1e-12
    for index in np.flatnonzero(~moved & (value < -FEASIBLE)):
        raise ValueError(f"space: the {probe.names[index]} is out of bounds, and nothing that is free changes it")
    # Equal ones, as of tied actuators, are one.
    _, first = np.unique(np.round(np.column_stack((value, slope)), 12), axis=0, return_index=True)
    return replace(probe, constraints=constraints.at(np.sort(first[moved[first]])))


def _constraints(space: DesignSpace, arm: Arm, tasks: Sequence[Task]) -> Constraints:
    none, planar = np.zeros((0, 3, arm.actuator_count)), arm.dimension == 2
    rows, constants, names = [none], [none[:, 0, 0]], list[str]()
    pairs, gaps = list[tuple[int, int]](), list[float]()
    for number, (segment, own) in enumerate(with_slices(segments_of(arm)[0])):
        if space.in_range:
            length, bend_y, bend_z = _corners(tasks, number).T
            for index, model in enumerate(segment.actuators, own.start):
                low, high = map(float, model.strain_range)
                for end, sign, edge in (("least", 1.0, low), ("largest", -1.0, high)):
                    if np.isfinite(edge):
                        row = np.zeros((len(length), *none.shape[1:]))
                        row[..., index] = sign * np.stack((-bend_z, bend_y, 0 * length - 1 - edge), -1)
                        rows.append(row)
                        constants.append(sign * length)
                        names += [f"{end} strain of actuator {index + 1}"] * len(length)
        if {"radii", "angles"} & set(space.free):
            apart = space.apart(segment)
            ordered = [index for index in _order(segment) if index in apart]
            gap = space.spacing_of(segment)
            for a, b in pairwise(ordered) if planar else combinations(apart, 2):
                pairs.append((own.start + a, own.start + b))
                gaps.append(gap[a, b])
    names += [f"spacing of actuators {a + 1} and {b + 1}" for a, b in pairs]
    found, least = np.array(pairs, dtype=np.int64).reshape(-1, 2), np.array(gaps, dtype=np.float64)
    if planar:  # where actuators keep their order, so that distances are linear
        unit = np.eye(arm.actuator_count)
        apart_y = unit[found[:, 1]] - unit[found[:, 0]]
        rows.append(np.stack((apart_y, 0 * apart_y, 0 * apart_y), 1))
        constants.append(-least)
        found, least = found[:0], least[:0]
    matrix = np.concatenate(rows).reshape(-1, 3 * arm.actuator_count)
    return Constraints(matrix, np.concatenate(constants), found, least, tuple(names))


def _order(segment: ArmDesign) -> list[int]:
    """Actuators from right to left."""
    radii = segment.radii.detach().double().cpu().reshape(-1, segment.actuator_count)[0].numpy()
    return list(np.argsort(radii, kind="stable").tolist())


def _corners(tasks: Sequence[Task], segment: int) -> Array:
    """The `(l, κ_y, κ_z)` of a segment's nodes on all shapes that are corners of their convex hull."""
    found = []
    for task in tasks:
        counts = task.nodes_of_segments
        own = task.twists.detach().double().cpu().split(counts, -2)[segment].numpy()
        bend = own[..., (2,)] if task.dimension == 2 else own[..., (4, 5)]
        none = np.zeros_like(bend[..., :0] if task.dimension == 3 else bend)
        found.append(np.concatenate((own[..., :1], none, bend), -1).reshape(-1, 3))
    return convex_corners(np.concatenate(found))


def convex_corners(points: Array) -> Array:
    """Those of points (P, D) that are corners of their convex hull, in the directions in which they differ."""
    from scipy.spatial import ConvexHull

    points = np.unique(points, axis=0)
    _, size, axes = np.linalg.svd(points - points.mean(0), full_matrices=False)
    flat = (points @ axes[size > 1e-9 * max(size.max(), 1e-300)].T).reshape(len(points), -1)
    if flat.shape[1] == 0:
        return points[:1]
    if flat.shape[1] == 1:
        return points[[flat.argmin(), flat.argmax()]]
    return np.asarray(points[ConvexHull(flat).vertices])
