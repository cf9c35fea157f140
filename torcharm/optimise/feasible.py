"""The polytope of feasible designs: whether there is one, its middle, points in it, and the nearest to a given one."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.optimise import qp
from torcharm.optimise.space import (
    Coordinates,
    DesignSpace,
    Rows,
    coordinates,
    given_values,
    spacing_rows,
    strain_rows,
)
from torcharm.task import Task

Array = npt.NDArray[np.float64]
THICKNESS = 1e-9
"""Free values whose bounds lie closer, as a fraction of their size, are fixed."""
FEASIBLE = 1e-9
"""A point that is no further outside, in scaled values, shows that the polytope is not empty."""


@dataclass(frozen=True, eq=False)
class Polytope:
    """Feasible designs `A u ≤ b` in scaled free values u, each from 0 to 1 between its bounds.

    Attributes:
        arm: whose actuators, dtype and device the designs have.
        spread: (3M, F) and
        fixed: (3M,): the design's radii, lengths and limits are `spread u + fixed`.
        rows: (C, F) A, each row of length 1.
        bound: (C,) b.
        names: C words, what each constraint is.
    """

    arm: ArmDesign
    spread: Tensor
    fixed: Tensor
    rows: Tensor
    bound: Tensor
    names: tuple[str, ...]

    @property
    def dimension(self) -> int:
        """F."""
        return self.spread.shape[1]

    @property
    def centre(self) -> Tensor:
        """(F,) the middle of the largest ball inside."""
        return self._ball[0]

    @property
    def radius(self) -> float:
        """Of that ball; 0 if the polytope is flat."""
        return self._ball[1]

    @cached_property
    def _ball(self) -> tuple[Tensor, float]:
        centre, radius = _middle(Rows(self.rows.numpy(), self.bound.numpy(), self.names))
        assert centre is not None
        return torch.from_numpy(centre), radius

    def design(self, point: Tensor) -> ArmDesign:
        """Designs of batch shape (...) from scaled values (..., F), differentiable."""
        values = (point @ self.spread.T + self.fixed).to(self.arm.radii)
        parts = values.unflatten(-1, (3, -1)).unbind(-2)
        held = self.fixed_fields
        return self.arm.with_values(*(part.detach() if own else part for part, own in zip(parts, held, strict=True)))

    @cached_property
    def fixed_fields(self) -> tuple[bool, ...]:
        """Whether radii, lengths and limits have no free values: gradients need not follow them."""
        return tuple((self.spread.unflatten(0, (3, -1)) == 0).flatten(1).all(-1).tolist())

    def project(self, point: Tensor) -> Tensor:
        """The nearest feasible points (S, F) to points (S, F)."""
        return point + qp.project(point, self.rows[None], self.bound[None]).step

    def nearest(self, arm: ArmDesign) -> Tensor:
        """The feasible points (B, F) nearest to designs, in scaled values."""
        target = torch.from_numpy(given_values(arm)) - self.fixed
        point = target @ self.spread / self.spread.square().sum(0)
        outside = (self.violation(point) > 0).unsqueeze(-1)
        return torch.where(outside, self.project(point), point)

    def violation(self, point: Tensor) -> Tensor:
        """By how much points (..., F) lie outside, in scaled values; 0 inside."""
        return (point @ self.rows.T - self.bound).amax(-1).clamp(min=0)

    def sample(self, count: int, seed: int, steps: int = 50) -> Tensor:
        """Points (count, F) spread over the polytope: hit-and-run walks from its middle."""
        if count == 0:
            return self.rows.new_zeros(0, self.dimension)
        generator = torch.Generator().manual_seed(seed)
        point = self.centre.expand(count, -1).clone()
        for _ in range(steps):
            direction = torch.randn(point.shape, generator=generator, dtype=point.dtype)
            direction = direction / direction.norm(dim=-1, keepdim=True)
            speed, room = direction @ self.rows.T, (self.bound - point @ self.rows.T).clamp(min=0)
            time = room / torch.where(speed.abs() > 1e-14, speed, torch.inf)
            ahead = torch.where(speed > 1e-14, time, torch.inf).amin(-1, keepdim=True)
            behind = torch.where(speed < -1e-14, time, -torch.inf).amax(-1, keepdim=True)
            share = torch.rand(count, 1, generator=generator, dtype=point.dtype)
            point = point + (behind + share * (ahead - behind)) * direction
        return point


def feasible_designs(space: DesignSpace, arm: ArmDesign, tasks: Sequence[Task]) -> Polytope:
    """The polytope of designs that a space allows on the shapes of tasks.

    Raises:
        ValueError: no design satisfies all constraints; the message names which contradict each other.
    """
    frame = coordinates(space, arm)
    fixed = frame.high - frame.low <= THICKNESS * np.maximum(1e-3, np.abs(frame.high))
    base = frame.fixed + frame.spread @ np.where(fixed, frame.low, 0.0)
    if fixed.all():
        raise ValueError("bounds: leave nothing free, the lowest and highest of every free value are the same")
    frame = Coordinates(frame.spread[:, ~fixed], base, frame.low[~fixed], frame.high[~fixed])
    spread, base = frame.spread * (frame.high - frame.low), frame.fixed + frame.spread @ frame.low
    parts = (spacing_rows(space, arm), strain_rows(space, arm, tasks))
    rows = _scaled(parts, spread, base)
    maps, origin, matrix, bound = (
        torch.from_numpy(np.ascontiguousarray(value)) for value in (spread, base, rows.matrix, rows.bound)
    )
    found = Polytope(arm.flatten()[0], maps, origin, matrix, bound, rows.names)
    # A feasible design near the given one says that there is one, sooner than a linear program does.
    near = found.nearest(arm)
    if bool(found.violation(near).amax() > FEASIBLE) and _middle(rows)[0] is None:
        raise ValueError(_contradiction(rows, spread, base, arm, parts[1]))
    return found


def _scaled(parts: Sequence[Rows], spread: Array, base: Array) -> Rows:
    """Constraints over θ, and the bounds, as rows over u of length 1.

    Raises:
        ValueError: a constraint is broken that u has no part in.
    """
    free = spread.shape[1]
    unit = np.eye(free)
    matrix = np.concatenate([part.matrix @ spread for part in parts])
    bound = np.concatenate([part.bound - part.matrix @ base for part in parts])
    names = [name for part in parts for name in part.names]
    size = np.linalg.norm(matrix, axis=1)
    empty = size < 1e-12
    for index in np.flatnonzero(empty & (bound < -1e-9)):
        raise ValueError(f"space: the {names[index]} is out of bounds, and nothing that is free changes it")
    matrix, bound = matrix[~empty] / size[~empty, None], bound[~empty] / size[~empty]
    names = [name for name, gone in zip(names, empty, strict=True) if not gone]
    # Equal rows, as of tied actuators, are one.
    _, first = np.unique(np.round(np.column_stack((matrix, bound)), 12), axis=0, return_index=True)
    first = np.sort(first)
    return Rows(
        np.concatenate((matrix[first], unit, -unit)),
        np.concatenate((bound[first], np.ones(free), np.zeros(free))),
        (*(names[index] for index in first), *("bounds",) * (2 * free)),
    )


def _middle(rows: Rows) -> tuple[Array | None, float]:
    """The Chebyshev centre, and the radius of the ball about it; None if nothing is feasible."""
    from scipy.optimize import linprog

    free = rows.matrix.shape[1]
    cost = np.zeros(free + 1)
    cost[-1] = -1
    answer = linprog(
        cost,
        A_ub=np.column_stack((rows.matrix, np.ones(len(rows.bound)))),
        b_ub=rows.bound,
        bounds=[(None, None)] * free + [(0, None)],
    )
    if answer.status != 0:
        return None, 0.0
    return np.asarray(answer.x[:-1]), float(answer.x[-1])


def _contradiction(rows: Rows, spread: Array, base: Array, arm: ArmDesign, strains: Rows) -> str:
    """What cannot be had together, in one line."""
    kinds = np.array([name.split(" of ")[0] for name in rows.names])
    unstrained = kinds != "strain"
    without = Rows(rows.matrix[unstrained], rows.bound[unstrained], ())
    if _middle(without)[0] is None:
        return "space: no design within the bounds has its actuators in order and that far apart"
    only = Rows(rows.matrix[kinds != "spacing"], rows.bound[kinds != "spacing"], ())
    spaced = "" if _middle(only)[0] is None else " and with that spacing"
    worst, excess = _least_excess(without, Rows(strains.matrix @ spread, strains.bound - strains.matrix @ base, ()))
    index = int(strains.names[worst].split()[-1])
    return (
        f"space: no design within the bounds{spaced} keeps all strains on all task shapes in the characterised "
        f"range; at best, actuator {index} ({type(arm.actuators[index - 1]).__name__}) is {excess:.2g} m too long or "
        "too short; widen the bounds or the model's strain_range, or give in_range=False"
    )


def _least_excess(kept: Rows, strains: Rows) -> tuple[int, float]:
    """The row that is worst off, and by how much, where the largest excess is least."""
    from scipy.optimize import linprog

    free = kept.matrix.shape[1]
    matrix = np.concatenate((kept.matrix, strains.matrix))
    elastic = np.repeat((0.0, -1.0), (len(kept.bound), len(strains.bound)))
    answer = linprog(
        np.append(np.zeros(free), 1.0),
        A_ub=np.column_stack((matrix, elastic)),
        b_ub=np.concatenate((kept.bound, strains.bound)),
        bounds=[(None, None)] * free + [(0, None)],
    )
    over = strains.matrix @ answer.x[:-1] - strains.bound
    return int(over.argmax()), float(over.max())
