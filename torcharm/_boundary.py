"""The boundary of what continuation reaches: where, as the load rises, an arm just goes to one side or to the other.

Next to a bifurcation the equilibria are no function of load and pressure. They are one of the share s of the load and
of a coordinate x along which the arm gives way: with pressures changed along one direction only, `t = P(x, s)`. An arm
that comes along t = const. from below passes a saddle of P on one side or on the other; a pressure is on the boundary
if it meets the saddle, `P_x = P_s = 0` (an unfolding of a transcritical bifurcation; Golubitsky and Schaeffer,
*Singularities and Groups in Bifurcation Theory*, 1985, ch. III). Both slopes follow from the arm's derivatives by
pressure and load, and are regular where the stiffness is singular. Newton's method on them, with their own slopes from
two equilibria beside, finds the saddle from either side. The batch comes last, as in `mechanics.march`.
"""

from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from torcharm import mechanics
from torcharm._descent import Searches
from torcharm._underway import run
from torcharm.mechanics import put

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


class _State(NamedTuple):
    """Three equilibria for each of A points: one at x and s, one with x and one with s a little larger; and what is
    known of the first.

    Attributes:
        element: (A,) place in the batch.
        unknowns, place, share: (C, N, 3, A), (M, 3, A), (3, A).
        measure, direction: (C, N, A) of x, (M, A) along which pressures change.
        shift, gains: (C, N, M, A), (M, A) changes of z and of x by the place.
        size: (A,) of the last Newton step.
        beside: (A,) whether the equilibria beside are taken.
        over: (A,) whether nothing more is to be done.
    """

    element: Tensor
    unknowns: Tensor
    place: Tensor
    share: Tensor
    measure: Tensor
    direction: Tensor
    shift: Tensor
    gains: Tensor
    size: Tensor
    beside: Tensor
    over: Tensor


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
    find = partial(_find, own) if own.fleet is None else own.fleet.find_boundary
    end, there, when, shift, gains, size = find(place, unknowns, share, measure, direction, steps + 1)
    normal = gains / gains.norm(dim=0)
    along = (direction * gains).sum(0)
    shift = shift - (shift * direction.unsqueeze(0)).sum(2, keepdim=True) * (gains / along)
    numbers = end.isfinite().all(0).all(0) & (there + normal).isfinite().all(0) & shift.isfinite().all(0).all(0).all(0)
    found = numbers & (size < FOUND) & (when > 0) & (when < 1)
    return Boundary(
        torch.where(found, there, place),
        torch.where(found, normal, 0.0),
        torch.where(found, end, unknowns),
        torch.where(found, when, share),
        torch.where(found, shift, 0.0),
        found,
    )


def _find(
    own: Searches, place: Tensor, unknowns: Tensor, share: Tensor, measure: Tensor, direction: Tensor, looks: int
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Unknowns, places and shares where Newton's method ended, (C, N, M, B) shifts, (M, B) gains, and (B,) sizes."""
    count, none = len(share), torch.zeros_like(share)
    state = _State(
        torch.arange(count, device=share.device),
        unknowns.unsqueeze(2).repeat(1, 1, 3, 1),
        place.unsqueeze(1).repeat(1, 3, 1),
        share.repeat(3, 1),
        measure,
        direction,
        place.new_zeros(*unknowns.shape[:2], *place.shape),
        torch.zeros_like(place),
        none + float("inf"),
        none.bool(),
        none.bool(),
    )
    out = _State(*(value.clone() for value in state))

    def store(state: _State) -> None:
        put(out, state.element, state)

    run(_advance, own, state, looks, store, ())
    return out.unknowns[:, :, 0], out.place[:, 0], out.share[0], out.shift, out.gains, out.size


def _advance(own: Searches, state: _State) -> _State:
    """One evaluation of the balance for each, and the Newton step that follows; at first only the equilibria beside are
    taken. What is over stays as it is."""
    count = len(state.over)
    three = own[torch.arange(count, device=state.over.device).repeat(3)]
    look = mechanics.march(
        three.arms,
        state.unknowns.flatten(2),
        state.place.flatten(1) * three.limits,
        state.share.flatten(),
        each_pressure=three.limits,
        load=three.arms.tip_load,
        poses=False,
    )
    change = look.change.unflatten(-1, (3, count))  # (C, N, 2 + M, 3, A)
    newton, by_share, by_place = change[:, :, 0], change[:, :, 1], change[:, :, 2:]
    lines, ways = state.measure.unsqueeze(2), state.direction.unsqueeze(1)
    by_way = (by_place * ways).sum(2)
    gain = (lines * by_way).sum((0, 1))
    slope_x, slope_s = gain.reciprocal(), -(lines * by_share).sum((0, 1)) / gain

    # Newton's step to the equilibrium at this x and s, and the saddle of P
    back = -(lines * newton).sum((0, 1)) / gain
    unknowns, place = state.unknowns + newton + by_way * back, state.place + ways * back
    aside = ASIDE / own.scale.length
    (x0, x1, x2), (s0, s1, s2) = slope_x.unbind(0), slope_s.unbind(0)
    xx, sx, xs, ss = (x1 - x0) / aside, (s1 - s0) / aside, (x2 - x0) / ASIDE, (s2 - s0) / ASIDE
    determinant = xx * ss - xs * sx
    move_x, move_s = (xs * s0 - ss * x0) / determinant, (sx * x0 - xx * s0) / determinant
    size = torch.maximum(move_x.abs() * (ASIDE / aside), move_s.abs())
    short = (LARGEST / size).clamp(max=1.0)
    move_x = torch.where(state.beside, move_x * short, 0.0)
    move_s = torch.where(state.beside, move_s * short, 0.0)

    # Along the equilibria, and beside
    along_x = (by_way * slope_x)[:, :, 0]
    along_s = (by_share + by_way * slope_s)[:, :, 0]
    base = unknowns[:, :, 0] + along_x * move_x + along_s * move_s
    here = place[:, 0] + state.direction * (x0 * move_x + s0 * move_s)
    when, way, on = state.share[0] + move_s, state.direction, ~state.over
    gains = (state.measure.unsqueeze(2) * by_place[:, :, :, 0]).sum((0, 1))
    return _State(
        state.element,
        torch.where(on, torch.stack((base, base + along_x * aside, base + along_s * ASIDE), 2), state.unknowns),
        torch.where(on, torch.stack((here, here + way * (x0 * aside), here + way * (s0 * ASIDE)), 1), state.place),
        torch.where(on, torch.stack((when, when, when + ASIDE)), state.share),
        state.measure,
        state.direction,
        torch.where(on, by_place[:, :, :, 0], state.shift),
        torch.where(on, gains, state.gains),
        torch.where(on & state.beside, size, state.size),
        state.beside | on,
        state.over | (state.beside & ~(size > DONE)),
    )
