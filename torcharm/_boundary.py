"""Where the branch that continuation follows turns from one side to the other: the boundary of what can be reached.

Next to a bifurcation the equilibria are no function of load and pressure, but the pressure along one direction is one
of the rest: `t = P(x, s)` of a share s of the load and of a coordinate x along the way in which the arm gives way. As
the load rises an arm goes to one side or the other of a saddle of P: with `P_x = P_s = 0` there, its pressure is on the
boundary (Golubitsky and Schaeffer, *Singularities and Groups in Bifurcation Theory*, 1985, ch. III). Newton's method
finds it; the derivatives of P follow from the arm's own, by implicit differentiation, and the second ones from two
points nearby. The batch comes last, as in `mechanics.march`.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from torcharm import mechanics
from torcharm._descent import Searches
from torcharm.mechanics import pick

AWAY = 1e-4
"""Steps to the two points nearby, as shares of the load and of the arm's bend [rad]."""
FARTHEST = 0.3
"""Newton step, in these."""
CLOSE, TIGHT = 1e-3, 1e-6
"""Newton step at which the saddle is found, and at which nothing more is done."""


class Boundary(NamedTuple):
    """Points on the boundary.

    Attributes:
        place: (M, B) as shares of the limits.
        normal: (M, B) unit vectors, into what is reached on the side from which the saddle was looked for.
        unknowns: (C, N, B) at the saddle.
        share: (B,) of the load there.
        shift: (C, N, M, B) change of the unknowns by the place, without giving way.
        found: (B,) whether.
    """

    place: Tensor
    normal: Tensor
    unknowns: Tensor
    share: Tensor
    shift: Tensor
    found: Tensor

    def at(self, index: Tensor) -> "Boundary":
        return Boundary(*(pick(value, index) for value in self))

    def part(self, start: int, end: int | None) -> "Boundary":
        return Boundary(*(value[..., start:end] for value in self))


def find_boundary(
    own: Searches, place: Tensor, unknowns: Tensor, share: Tensor, measure: Tensor, direction: Tensor, rounds: int
) -> Boundary:
    """The saddles next to equilibria near a bifurcation.

    Args:
        own: B searches.
        place: (M, B) pressures as shares of their limits.
        unknowns: (C, N, B) equilibria there, or nearly.
        share: (B,) of the load there.
        measure: (C, N, B) of x: `x = sum(measure * unknowns)`.
        direction: (M, B) along which pressures change.
    """
    count = place.shape[-1]
    own = own[torch.arange(count, device=place.device).repeat(3)]
    lines, ways = measure.repeat(1, 1, 3), direction.repeat(1, 3)
    gap_x = AWAY * (own.scale.length[:count].reciprocal() * measure.square().sum((0, 1)).sqrt())
    z, p, s = (torch.cat((value, value, value), -1) for value in (unknowns, place, share))
    on = torch.ones_like(share, dtype=torch.bool)
    size = torch.full_like(share, float("inf"))
    by_place, by_way, gain = None, None, None
    for turn in range(rounds):
        look = mechanics.march(
            own.arms, z, p * own.limits, s, each_pressure=own.limits, load=own.arms.tip_load, poses=False
        )
        newton, by_share, by_place = look.change[:, :, 0], look.change[:, :, 1], look.change[:, :, 2:]
        by_way = (by_place * ways).sum(2)
        gain = (lines * by_way).sum((0, 1))
        slope_x, slope_s = 1 / gain, -(lines * by_share).sum((0, 1)) / gain
        back = -(lines * newton).sum((0, 1)) / gain
        z1, p1 = z + newton + by_way * back, p + ways * back
        along_x, along_s = by_way * slope_x, by_share + by_way * slope_s
        x0, x1, x2 = slope_x.view(3, count)
        s0, s1, s2 = slope_s.view(3, count)
        dx, ds = torch.zeros_like(share), torch.zeros_like(share)
        if turn:
            xx, sx, xs, ss = (x1 - x0) / gap_x, (s1 - s0) / gap_x, (x2 - x0) / AWAY, (s2 - s0) / AWAY
            determinant = xx * ss - xs * sx
            dx, ds = -(ss * x0 - xs * s0) / determinant, -(xx * s0 - sx * x0) / determinant
            latest = torch.maximum((dx / gap_x).abs() * AWAY, ds.abs())
            size = torch.where(on & latest.isfinite(), latest, size)
            on = on & (latest > TIGHT)
            short = (FARTHEST / latest).clamp(max=1.0)
            dx, ds = dx * short, ds * short
        z0, p0, d0 = z1[..., :count], p1[:, :count], ways[:, :count]
        tx, ts = along_x[..., :count], along_s[..., :count]
        z0 = z0 + tx * dx + ts * ds
        p0 = p0 + d0 * (x0 * dx + s0 * ds)
        base = s[:count] + ds
        z1 = torch.cat((z0, z0 + tx * gap_x, z0 + ts * AWAY), -1)
        p1 = torch.cat((p0, p0 + d0 * x0 * gap_x, p0 + d0 * s0 * AWAY), -1)
        on3 = on.repeat(3)
        z, p, s = (
            torch.where(on3, z1, z),
            torch.where(on3, p1, p),
            torch.where(on3, torch.cat((base, base, base + AWAY)), s),
        )
        if turn > 1 and not bool(on.any()):
            break
    z0, p0, base = z[..., :count], p[:, :count], s[:count]
    gains = (measure.unsqueeze(2) * by_place[..., :count]).sum((0, 1))
    normal = gains * gain[:count].sign()
    normal = normal / normal.norm(dim=0)
    shift = by_place[..., :count] - by_way[..., :count].unsqueeze(2) * (gains / gain[:count])
    found = (size < CLOSE) & z0.isfinite().all(0).all(0) & p0.isfinite().all(0) & (base > 0) & (base < 1)
    found &= normal.isfinite().all(0)
    normal, shift = torch.where(found, normal, 0.0), torch.where(found, shift, 0.0)
    return Boundary(torch.where(found, p0, place), normal, torch.where(found, z0, unknowns), base, shift, found)
