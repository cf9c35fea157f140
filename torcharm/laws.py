"""Reaction curves as functions of pressure, written out: what polishing works with.

Over pressure fractions u from 0 to 1 each force, or difference of two, is
`Σ c_j u^j + Σ s_k max(0, u - t_k) + Σ g_q u^x_q`.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torcharm._arrays import Array, as_array
from torcharm.actuators import PressureLaw, pressure_law
from torcharm.hulls import Sections
from torcharm.wrenches import group_alike

LEAST = 1e-30
"""A pressure fraction as good as none."""
STRAIGHT = 1e-9
"""A power's exponent so near 1 makes a straight line: by less than 1e-9 of its force is it another curve."""

Rows = slice | list[int]


@dataclass(frozen=True)
class Law:
    """Forces of m actuators of one kind at B sections.

    Attributes:
        rows: which of the arm's actuators they are.
        coefficients: up to four, (m, B) each [N].
        kinks, slopes: (K, m, B); a slope of 0 makes a kink nothing.
        gain, exponent: (P, m, B).
    """

    rows: Rows
    coefficients: tuple[Array, ...]
    kinks: Array
    slopes: Array
    gain: Array
    exponent: Array

    def minus_first(self, sections: Sections) -> "Law":
        """Differences from node 1's forces at the same pressures."""

        def first(value: Array) -> Array:
            by_node = value.reshape(*value.shape[:-1], *sections.shape)
            return np.broadcast_to(by_node[..., :1, :], by_node.shape).reshape(value.shape)

        def both(value: Array, factor: int = 1) -> Array:
            return np.concatenate((value, factor * first(value))) if len(value) else value

        coefficients = [value - first(value) for value in self.coefficients]
        while len(coefficients) > 1 and not coefficients[-1].any():
            coefficients.pop()
        return Law(
            self.rows,
            tuple(coefficients),
            both(self.kinks),
            both(self.slopes, -1),
            both(self.gain, -1),
            both(self.exponent),
        )

    def force(self, u: Array) -> Array:
        """Forces (S, m, B) at fractions (S, m, B) or (S, 1, 1)."""
        total: Array = np.empty((len(u), *self.coefficients[0].shape), u.dtype)
        total[:] = self.coefficients[-1]
        for coefficient in self.coefficients[-2::-1]:
            total *= u
            total += coefficient
        part = np.empty_like(total)
        for kink, slope in zip(self.kinks, self.slopes, strict=True):
            np.subtract(u, kink, out=part)
            np.maximum(part, 0, out=part)
            part *= slope
            total += part
        if len(self.gain):
            log = np.log(np.maximum(u, LEAST))
            for gain, exponent in zip(self.gain, self.exponent, strict=True):
                np.multiply(exponent, log, out=part)
                np.exp(part, out=part)
                part *= gain
                total += part
        return total


@dataclass(frozen=True)
class Laws:
    """The forces of an arm's M actuators at B sections, by kind.

    Attributes:
        groups: of actuators alike.
        holds: (B) whether the laws hold up to the pressure limits.
    """

    groups: tuple[Law, ...]
    holds: Array

    def minus_first(self, sections: Sections) -> "Laws":
        """Differences from node 1's forces at the same pressures."""
        groups = tuple(law.minus_first(sections) for law in self.groups)
        shape = sections.shape
        first = np.broadcast_to(self.holds.reshape(shape)[:, :1], shape).reshape(-1)
        return Laws(groups, self.holds & first)

    def samples(self, like: Tensor, count: int, *, kinks: bool) -> tuple[Tensor, Tensor]:
        """Evenly spaced fractions (S, 1, 1), or with the laws' kinks (S, M, B), and the forces (S, M, B) there.

        Args:
            like: (M, B).
            count: of fractions.
            kinks: whether to add the kinks.
        """
        numbers = as_array(like)
        grid = np.linspace(0, 1, count, dtype=numbers.dtype).reshape(-1, 1, 1)
        most = max(len(law.kinks) for law in self.groups)
        if kinks and most:
            more = np.zeros((most, *numbers.shape), numbers.dtype)
            for law in self.groups:
                inner = (law.kinks > 0) & (law.kinks < 1)
                more[: len(law.kinks), law.rows] = np.where(inner, law.kinks, 0.0)
            grid = np.sort(np.concatenate((np.broadcast_to(grid, (count, *numbers.shape)), more)), 0)
        force = np.empty((len(grid), *numbers.shape), numbers.dtype)
        for law in self.groups:
            force[:, law.rows] = law.force(grid if grid.shape[1] == 1 else grid[:, law.rows])
        return torch.from_numpy(grid).to(like.device), torch.from_numpy(force).to(like.device)


@np.errstate(all="ignore")
def section_laws(sections: Sections) -> Laws | None:
    """The laws of absolute forces, if every model writes its own."""
    limit = as_array(sections.limit)
    groups, holds = [], np.ones(limit.shape[1], dtype=bool)
    for model, rows in group_alike(sections.actuators):
        law = pressure_law(model, sections.strain[rows])
        if law is None or (law.gain is not None and len(law.coefficients) > 2):
            return None
        groups.append(_over_fractions(law, rows, limit[rows]))
        if law.until is not None:
            holds = holds & (limit[rows] <= as_array(law.until)).all(0)
    return Laws(tuple(groups), holds)


def _over_fractions(law: PressureLaw, rows: Rows, limit: Array) -> Law:
    """A model's law, over fractions of the pressure limits (m, B)."""
    coefficients = [as_array(law.coefficients[0])]
    power = limit
    for coefficient in law.coefficients[1:]:
        coefficients.append(as_array(coefficient) * power)
        power = power * limit
    kinks = slopes = gain = exponent = np.empty((0, *limit.shape), limit.dtype)
    least = np.maximum(limit, LEAST)
    if law.kinks is not None and law.slopes is not None:
        kinks, slopes = as_array(law.kinks) / least, as_array(law.slopes) * limit
        if not ((slopes != 0) & (kinks < 1)).any():
            kinks = slopes = kinks[:0]
    if law.gain is not None and law.exponent is not None and bool(law.gain.any()):
        exponent = as_array(law.exponent)[None]
        gain = as_array(law.gain) * least**exponent
    return Law(rows, tuple(coefficients), kinks, slopes, gain, exponent)
