"""The boundary of what continuation reaches: where, as the load rises, an arm just goes to one side or to the other.

Next to a bifurcation the equilibria are no function of load and pressure. They are one of the share s of the load and
of a coordinate x along which the arm gives way: with pressures changed along one direction only, `t = P(x, s)`. An arm
that comes along t = const. from below passes a saddle of P on one side or on the other; a pressure is on the boundary
if it meets the saddle, `P_x = P_s = 0` (an unfolding of a transcritical bifurcation; Golubitsky and Schaeffer,
*Singularities and Groups in Bifurcation Theory*, 1985, ch. III). Both slopes follow from the arm's derivatives by
pressure and load, and are regular where the stiffness is singular. Newton's method on them, with their own slopes from
two equilibria beside, finds the saddle from either side. The batch comes last, as in `mechanics.march`.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from torcharm import mechanics
from torcharm._descent import Searches
from torcharm.mechanics import pick

ASIDE = 1e-4
"""Steps to the two equilibria beside: in the share of the load, and in x over the arm's length."""
LARGEST = 0.3
"""Newton step, in these units."""
FOUND, DONE = 1e-3, 1e-6
"""Newton step at which the saddle counts as found, and at which nothing more is done."""


class Boundary(NamedTuple):
    """B points on the boundary.

    Attributes:
        place: (M, B) pressures as shares of their limits.
        normal: (M, B) unit vectors, of either sign.
        unknowns: (C, N, B) at the saddle.
        share: (B,) of the load there.
        shift: (C, N, M, B) change of the unknowns by the place, at x held.
        found: (B,) whether; where not, place and unknowns are the given ones.
    """

    place: Tensor
    normal: Tensor
    unknowns: Tensor
    share: Tensor
    shift: Tensor
    found: Tensor

    def at(self, index: Tensor) -> "Boundary":
        return Boundary(*(pick(value, index) for value in self))


class _State(NamedTuple):
    """B equilibria, then these with x, then these with s a little larger; (3B,) after each other, and what is known.

    Attributes:
        unknowns, place, share: of all.
        shift, gains: (C, N, M, B) and (M, B) of the first: changes of z and of x by the place.
        size: (B,) of the last Newton step.
        on: (B,) whether there is more to do.
    """

    unknowns: Tensor
    place: Tensor
    share: Tensor
    shift: Tensor
    gains: Tensor
    size: Tensor
    on: Tensor


def find_boundary(
    own: Searches, place: Tensor, unknowns: Tensor, share: Tensor, measure: Tensor, direction: Tensor, steps: int
) -> Boundary:
    """The boundary next to equilibria that are near a bifurcation.

    Args:
        own: B searches.
        place: (M, B) pressures as shares of their limits.
        unknowns: (C, N, B) equilibria there, or nearly.
        share: (B,) of the load there.
        measure: (C, N, B) of x, the sum of its products with the unknowns; a unit vector.
        direction: (M, B) along which pressures change.
        steps: of Newton's method, at most.
    """
    three = own[torch.arange(len(share), device=place.device).repeat(3)]
    aside = ASIDE / own.scale.length
    state = _State(
        unknowns.repeat(1, 1, 3),
        place.repeat(1, 3),
        share.repeat(3),
        place.new_zeros(*unknowns.shape[:2], *place.shape),
        torch.zeros_like(place),
        torch.full_like(share, float("inf")),
        torch.ones_like(share, dtype=torch.bool),
    )
    for step in range(steps + 1 if len(share) else 0):
        state = _advance(three, state, measure, direction, aside, share.new_tensor(float(step > 0)))
        if not bool(state.on.any()):
            break
    count = len(share)
    end, there, when = state.unknowns[..., :count], state.place[:, :count], state.share[:count]
    normal = state.gains / state.gains.norm(dim=0)
    along = (direction * state.gains).sum(0)
    shift = state.shift - (state.shift * direction.unsqueeze(0)).sum(2, keepdim=True) * (state.gains / along)
    numbers = end.isfinite().all(0).all(0) & (there + normal).isfinite().all(0) & shift.isfinite().all(0).all(0).all(0)
    found = numbers & (state.size < FOUND) & (when > 0) & (when < 1)
    return Boundary(
        torch.where(found, there, place),
        torch.where(found, normal, 0.0),
        torch.where(found, end, unknowns),
        torch.where(found, when, share),
        torch.where(found, shift, 0.0),
        found,
    )


def _advance(own: Searches, state: _State, measure: Tensor, direction: Tensor, aside: Tensor, moving: Tensor) -> _State:
    """One evaluation of the balance for each, and the Newton step that follows; at first (0) only the equilibria
    beside are taken. What is done stays as it is."""
    count = len(aside)
    look = mechanics.march(
        own.arms,
        state.unknowns,
        state.place * own.limits,
        state.share,
        each_pressure=own.limits,
        load=own.arms.tip_load,
        poses=False,
    )
    newton, by_share, by_place = look.change[:, :, 0], look.change[:, :, 1], look.change[:, :, 2:]
    lines, ways = measure.repeat(1, 1, 3), direction.repeat(1, 3)
    by_way = (by_place * ways).sum(2)
    gain = (lines * by_way).sum((0, 1))
    slope_x, slope_s = gain.reciprocal(), -(lines * by_share).sum((0, 1)) / gain

    # Newton's step to the equilibrium at this x and s, and the saddle of P
    back = -(lines * newton).sum((0, 1)) / gain
    unknowns, place = state.unknowns + newton + by_way * back, state.place + ways * back
    x0, x1, x2 = slope_x.view(3, count)
    s0, s1, s2 = slope_s.view(3, count)
    xx, sx, xs, ss = (x1 - x0) / aside, (s1 - s0) / aside, (x2 - x0) / ASIDE, (s2 - s0) / ASIDE
    determinant = xx * ss - xs * sx
    move_x, move_s = (xs * s0 - ss * x0) / determinant, (sx * x0 - xx * s0) / determinant
    size = torch.maximum(move_x.abs() * (ASIDE / aside), move_s.abs())
    short = (LARGEST / size).clamp(max=1.0)
    starting = moving == 0
    move_x = torch.where(starting, 0.0, move_x * short)
    move_s = torch.where(starting, 0.0, move_s * short)

    # Along the equilibria, and beside
    way = ways[:, :count]
    along_x = (by_way * slope_x)[..., :count]
    along_s = (by_share + by_way * slope_s)[..., :count]
    base = unknowns[..., :count] + along_x * move_x + along_s * move_s
    here = place[:, :count] + way * (x0 * move_x + s0 * move_s)
    when = state.share[:count] + move_s
    gains = (measure.unsqueeze(2) * by_place[..., :count]).sum((0, 1))
    on, three = state.on, state.on.repeat(3)
    return _State(
        torch.where(three, torch.cat((base, base + along_x * aside, base + along_s * ASIDE), -1), state.unknowns),
        torch.where(three, torch.cat((here, here + way * (x0 * aside), here + way * (s0 * ASIDE)), -1), state.place),
        torch.where(three, torch.cat((when, when, when + ASIDE)), state.share),
        torch.where(on, by_place[..., :count], state.shift),
        torch.where(on, gains, state.gains),
        torch.where(on & ~starting, size, state.size),
        on & (starting | (size > DONE)),
    )
