"""Reaction curves as functions of pressure, written out: what polishing works with.

Over pressure fractions u from 0 to 1 each force, or difference of two, is
`Σ c_j u^j + Σ s_k max(0, u - t_k) + Σ g_q u^x_q`.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

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
    coefficients: tuple[Tensor, ...]
    kinks: Tensor
    slopes: Tensor
    gain: Tensor
    exponent: Tensor

    def minus_first(self, sections: Sections) -> "Law":
        """Differences from node 1's forces at the same pressures."""

        def both(value: Tensor, factor: int = 1) -> Tensor:
            return torch.cat((value, factor * sections.at_first_node(value))) if len(value) else value

        coefficients = [value - sections.at_first_node(value) for value in self.coefficients]
        while len(coefficients) > 1 and not bool(coefficients[-1].any()):
            coefficients.pop()
        return Law(
            self.rows,
            tuple(coefficients),
            both(self.kinks),
            both(self.slopes, -1),
            both(self.gain, -1),
            both(self.exponent),
        )

    def force(self, u: Tensor) -> Tensor:
        """Forces (S, m, B) at fractions (S, m, B) or (S, 1, 1)."""
        total = self.coefficients[-1].expand(len(u), *self.coefficients[0].shape)
        for coefficient in self.coefficients[-2::-1]:
            total = torch.addcmul(coefficient, total, u)
        for kink, slope in zip(self.kinks, self.slopes, strict=True):
            total = torch.addcmul(total, (u - kink).relu_(), slope)
        if len(self.gain):
            log = u.clamp(min=LEAST).log_()
            for gain, exponent in zip(self.gain, self.exponent, strict=True):
                total = torch.addcmul(total, (exponent * log).exp_(), gain)
        return total


@dataclass(frozen=True)
class Laws:
    """The forces of an arm's M actuators at B sections, by kind.

    Attributes:
        groups: of actuators alike.
        holds: (B) whether the laws hold up to the pressure limits.
    """

    groups: tuple[Law, ...]
    holds: Tensor

    @property
    def requires_grad(self) -> bool:
        """Whether the force models hold something that wants a gradient."""
        parts = (part for law in self.groups for part in (*law.coefficients, law.kinks, law.slopes, law.gain))
        return any(part.requires_grad for part in parts)

    def minus_first(self, sections: Sections) -> "Laws":
        """Differences from node 1's forces at the same pressures."""
        groups = tuple(law.minus_first(sections) for law in self.groups)
        return Laws(groups, self.holds & sections.at_first_node(self.holds))

    def samples(self, like: Tensor, count: int, *, kinks: bool) -> tuple[Tensor, Tensor]:
        """Evenly spaced fractions (S, 1, 1), or with the laws' kinks (S, M, B), and the forces (S, M, B) there.

        Args:
            like: (M, B).
            count: of fractions.
            kinks: whether to add the kinks.
        """
        grid = torch.linspace(0, 1, count, dtype=like.dtype, device=like.device).view(-1, 1, 1)
        most = max(len(law.kinks) for law in self.groups)
        if kinks and most:
            grid = torch.cat((grid.expand(-1, *like.shape), like.new_zeros(most, *like.shape)))
            for law in self.groups:
                inner = (law.kinks > 0) & (law.kinks < 1)
                grid[count : count + len(law.kinks), law.rows] = torch.where(inner, law.kinks, 0.0)
            grid = grid.sort(0).values
        force = like.new_empty(len(grid), *like.shape)
        for law in self.groups:
            force[:, law.rows] = law.force(grid if grid.shape[1] == 1 else grid[:, law.rows])
        return grid, force


def section_laws(sections: Sections) -> Laws | None:
    """The laws of absolute forces, if every model writes its own."""
    limit = sections.limit
    groups, holds = [], torch.ones_like(limit[0], dtype=torch.bool)
    for model, rows in group_alike(sections.actuators):
        law = pressure_law(model, sections.strain[rows])
        if law is None or (law.gain is not None and len(law.coefficients) > 2):
            return None
        groups.append(_over_fractions(law, rows, limit[rows]))
        if law.until is not None:
            holds = holds & (limit[rows] <= law.until).all(0)
    return Laws(tuple(groups), holds)


def _over_fractions(law: PressureLaw, rows: Rows, limit: Tensor) -> Law:
    """A model's law, over fractions of the pressure limits (m, B)."""
    coefficients = [law.coefficients[0]]
    power = limit
    for coefficient in law.coefficients[1:]:
        coefficients.append(coefficient * power)
        power = power * limit
    kinks = slopes = gain = exponent = limit.new_empty(0, *limit.shape)
    if law.kinks is not None and law.slopes is not None:
        kinks, slopes = law.kinks / limit.clamp(min=LEAST), law.slopes * limit
        if not bool(((slopes != 0) & (kinks < 1)).any()):
            kinks = slopes = kinks[:0]
    if law.gain is not None and law.exponent is not None and bool(law.gain.any()):
        gain, exponent = (law.gain * limit.clamp(min=LEAST).pow(law.exponent))[None], law.exponent[None]
    return Law(rows, tuple(coefficients), kinks, slopes, gain, exponent)
