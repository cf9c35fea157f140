"""Reaction curves as functions of pressure, written out: what polishing differentiates.

Over pressure fractions u from 0 to 1 each force, or difference of two, is
`Σ c_j u^j + Σ s_k max(0, u - t_k) + Σ g_q u^x_q`.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from torcharm.actuators import pressure_law
from torcharm.hulls import Curves, Sections
from torcharm.wrenches import group_alike

LEAST = 1e-30
"""A pressure fraction as good as none."""
EVEN_KINKS = 2
"""Of curves without kinks, samples in place of them."""


@dataclass(frozen=True)
class Laws:
    """M actuators' forces at B sections.

    Attributes:
        coefficients: (4, M, B) [N].
        kinks, slopes: (K, M, B); a slope of 0 makes a kink a mere sample.
        rows: the m actuators that have powers.
        gain, exponent: (P, m, B).
        holds: (B) whether the laws hold up to the pressure limits.
        bent: whether any has kinks.
        winding: whether any may be convex here and concave there, kinks aside, so that a maximum may hide
            between samples.
    """

    coefficients: Tensor
    kinks: Tensor
    slopes: Tensor
    rows: slice | list[int]
    gain: Tensor
    exponent: Tensor
    holds: Tensor
    bent: bool
    winding: bool

    def of(self, index: Tensor) -> "Laws":
        """Those of some sections (Q)."""
        names = ("coefficients", "kinks", "slopes", "gain", "exponent", "holds")
        parts = (getattr(self, name).index_select(-1, index) for name in names)
        coefficients, kinks, slopes, gain, exponent, holds = parts
        return Laws(coefficients, kinks, slopes, self.rows, gain, exponent, holds, self.bent, self.winding)

    def minus_first(self, sections: Sections) -> "Laws":
        """Differences from node 1's forces at the same pressures."""

        def both(value: Tensor, factor: int = 1) -> Tensor:
            return torch.cat((value, factor * sections.at_first_node(value)))

        return Laws(
            self.coefficients - sections.at_first_node(self.coefficients),
            both(self.kinks) if self.bent else self.kinks,
            both(self.slopes, -1) if self.bent else self.slopes,
            self.rows,
            both(self.gain, -1),
            both(self.exponent),
            self.holds & sections.at_first_node(self.holds),
            self.bent,
            len(self.gain) > 0 or self.winding,
        )

    def force(self, u: Tensor) -> Tensor:
        """Forces at fractions (..., M, B)."""
        c0, c1, c2, c3 = self.coefficients
        total = torch.addcmul(c2, c3, u).mul_(u).add_(c1).mul_(u).add_(c0)
        for kink, slope in zip(self.kinks, self.slopes, strict=True) if self.bent else ():
            total.addcmul_((u - kink).relu_(), slope)
        if len(self.gain):
            log = u[..., self.rows, :].clamp(min=LEAST).log_()
            for gain, exponent in zip(self.gain, self.exponent, strict=True):
                total[..., self.rows, :] += (exponent * log).exp_().mul_(gain)
        return total

    def around(self, u: Tensor) -> tuple[Tensor, ...]:
        """About fractions (M, B): forces, their first two derivatives but for kinks, and of these the slopes
        right and left of u, and the last before and the next after u."""
        c0, c1, c2, c3 = self.coefficients
        curve = torch.addcmul(c2, c3, u)
        force = torch.addcmul(c1, curve, u).mul_(u).add_(c0)
        slope = torch.addcmul(c2, c3, u, value=2).add_(curve).mul_(u).add_(c1)
        bend = torch.addcmul(c2, c3, u, value=3).mul_(2)
        low, high = torch.zeros_like(u), torch.ones_like(u)
        after = before = low
        if self.bent:
            above, below = self.kinks > u, self.kinks < u
            passed = self.slopes * below
            before, after = passed.sum(0), (self.slopes * ~above).sum(0)
            force.addcmul_(before, u).sub_(passed.mul_(self.kinks).sum(0))
            real = self.slopes != 0
            low = torch.where(below.logical_and_(real), self.kinks, 0.0).amax(0)
            high = torch.where(above.logical_and_(real), self.kinks, 1.0).amin(0)
        if len(self.gain):
            some = u[self.rows].clamp(min=LEAST)
            log = some.log()
            for gain, exponent in zip(self.gain, self.exponent, strict=True):
                power = ((exponent - 1) * log).exp_().mul_(gain)
                force[self.rows] += power * some
                power.mul_(exponent)
                slope[self.rows] += power
                bend[self.rows] += power.mul_(exponent - 1).div_(some)
        return force, slope, bend, after, before, low.clamp(min=0), high.clamp(max=1)

    def beside(self, u: Tensor) -> Tensor:
        """Slopes (2, S, M, B) just before and just after fractions (S, M, B)."""
        _, c1, c2, c3 = self.coefficients
        slope = torch.addcmul(2 * c2, c3, u, value=3).mul_(u).add_(c1)
        if len(self.gain):
            log = u[..., self.rows, :].clamp(min=LEAST).log_()
            for gain, exponent in zip(self.gain, self.exponent, strict=True):
                slope[..., self.rows, :] += ((exponent - 1) * log).exp_().mul_(gain * exponent)
        both = torch.stack((slope, slope))
        for kink, change in zip(self.kinks, self.slopes, strict=True) if self.bent else ():
            both[0].addcmul_((u > kink).to(u.dtype), change)
            both[1].addcmul_((u >= kink).to(u.dtype), change)
        return both

    def turning(self) -> Tensor:
        """Fractions (1, M, B) at which curves turn from convex to concave or back; of others, a half."""
        c2, c3 = self.coefficients[2:]
        found = -c2 / (3 * c3)
        if len(self.gain) == 2:
            (g, h), (x, y) = self.gain, self.exponent
            ratio = -(h * y * (y - 1)) / (g * x * (x - 1))
            found[self.rows] = torch.where(g * h != 0, (ratio.log() / (x - y)).exp(), found[self.rows])
        return torch.where((found > 0) & (found < 1), found, 0.5)[None]


def section_laws(sections: Sections) -> Laws | None:
    """The laws of absolute forces, if every model writes its own."""
    strain, limit = sections.strain, sections.limit
    groups = [(members, pressure_law(model, strain[members])) for model, members in group_alike(sections.actuators)]
    laws = [(members, law) for members, law in groups if law is not None]
    if len(laws) < len(groups):
        return None
    count = max([EVEN_KINKS, *(len(law.kinks) for _, law in laws if law.kinks is not None)])
    even = torch.linspace(0, 1, count + 2, dtype=strain.dtype, device=strain.device)[1:-1, None, None]
    coefficients, slopes = strain.new_zeros(4, *strain.shape), strain.new_zeros(count, *strain.shape)
    kinks, holds = even.expand_as(slopes).clone(), torch.ones_like(strain[0], dtype=torch.bool)
    for members, law in laws:
        own = limit[members]
        for degree, coefficient in enumerate(law.coefficients):
            coefficients[degree, members] = coefficient * own**degree
        if law.kinks is not None and law.slopes is not None:
            kinks[: len(law.kinks), members] = law.kinks / own.clamp(min=LEAST)
            slopes[: len(law.kinks), members] = law.slopes * own
        elif len(law.coefficients) > 3:
            kinks[:2, members] = _tangents(coefficients[2:, members], kinks[:2, members])
        if law.until is not None:
            holds = holds & (own <= law.until).all(0)
    powered = [
        (members, law.gain * limit[members].clamp(min=LEAST).pow(law.exponent), law.exponent)
        for members, law in laws
        if law.gain is not None and law.exponent is not None
    ]
    rows = _rows([members for members, _, _ in powered])
    gain = exponent = strain.new_zeros(0, 0, strain.shape[1])
    if any(bool(gain.any()) for _, gain, _ in powered):
        gain = torch.cat([gain for _, gain, _ in powered])[None]
        exponent = torch.cat([exponent for _, _, exponent in powered])[None]
    c2, c3 = coefficients[2:]
    winding = bool((c2 * (c2 + 3 * c3) < 0).any())
    bent = any(law.kinks is not None for _, law in laws)
    return Laws(coefficients, kinks, slopes, rows, gain, exponent, holds, bent, winding)


def _tangents(bends: Tensor, otherwise: Tensor) -> Tensor:
    """Fractions (2, m, B) at which cubics, of coefficients c_2 and c_3, are touched by lines from either end.

    As samples they make the straight faces of the curves' hulls exact. Others where there is none.
    """
    c2, c3 = bends
    total = -c2 / (c3 + (c3 == 0).to(c3.dtype) * LEAST)  # of the three fractions at which a line meets the cubic
    touch = torch.stack((total / 2, (total - 1) / 2))
    return torch.where((touch > 0) & (touch < 1), touch, otherwise)


def _rows(members: list[slice | list[int]]) -> slice | list[int]:
    """Several groups' actuators, one after the other."""
    if len(members) == 1:
        return members[0]
    groups = (list(range(one.start, one.stop, one.step)) if isinstance(one, slice) else one for one in members)
    return [row for group in groups for row in group]


def law_curves(laws: Laws, bending: Tensor, radii: Tensor, samples: int, resting: Tensor | None = None) -> Curves:
    """Curves sampled at the laws' kinks and at evenly spaced fractions.

    Args:
        laws: of M actuators at B sections.
        bending: (M, B) bending moment at fraction 1 [N·m].
        radii: (M, B) [m].
        samples: how many are evenly spaced, 0 and 1 among them.
        resting: (B) moment at no pressure [N·m]; None is none.
    """
    even = torch.linspace(0, 1, samples, dtype=radii.dtype, device=radii.device)
    even = even.view(-1, 1, 1).expand(-1, *radii.shape)
    inner = [even, laws.kinks.clamp(0, 1)]
    inner += [laws.turning()] if laws.winding else []
    grid = torch.cat(inner).sort(0).values
    return Curves(grid, laws.force(grid), bending, radii, resting)
