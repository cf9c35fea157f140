"""Where lines through the origin leave sums of curves, from where they leave polygons inside these.

Between two points of the set, one on either side of the line, a chord crosses it. The set's furthest point along
the chord's normal, closed form for a sum of curves, is a point nearer the boundary that replaces one of the two; when
nothing lies beyond the chord, the chord is a face. On a smooth boundary the error falls fourfold with each round.
"""

from dataclasses import replace
from itertools import product
from math import cos, sin
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from torcharm.distance.support import LEAST, NARROW, REFITS, WINDOW, CurveSum, Ends, Touch
from torcharm.hulls import Sections
from torcharm.pieces import Pieces, fit_pieces, refit_pieces
from torcharm.wrenches import actuator_force

if TYPE_CHECKING:
    from torcharm.capacity import Hits

ROUNDS = 60
TURNS = (1e-3, 1e-2, 0.1, 1.0)
"""Angles [rad] to turn a normal by, either way, to touch a set either side of a ray."""
SETTLED = 1e-10
"""Share of a hull's size by which a hit may move and count as settled."""
SLACK_ULPS = 32
"""Roundings of a hull's size by which a point may lie beyond a chord that counts as a face."""


def polish_hits(
    sections: Sections, hits: "Hits", fraction: Tensor, point: tuple[Tensor, Tensor], *, relative: bool
) -> tuple["Hits", Tensor, Tensor]:
    """Better hits, the pressure fractions at the ends of the faces hit, and whether (2, B, L) they converged.

    Args:
        sections: the actuators.
        hits: of sampled polygons.
        fraction: (2, M, 2, B, L) at the ends of the faces hit.
        point: (B, L) each, the directions of the lines.
        relative: whether the sets are of differences from node 1.
    """
    speed = torch.hypot(*point)
    open_ones = hits.factor.isfinite() & (speed > 0) & (hits.factor[0] <= hits.factor[1])
    end, section, load = open_ones.nonzero(as_tuple=True)
    if not len(end):
        return hits, fraction, torch.ones_like(open_ones)
    sign, own_speed = 2.0 * end.to(speed.dtype) - 1, speed[section, load]
    direction = torch.stack([sign * value[section, load] / own_speed for value in point])
    search = _Search(sections, section, direction, hits.size[section, load], relative)
    found, converged = search.run(fraction[:, :, end, section, load])

    reach, normal = search.crossing(found)
    factor = sign * reach / own_speed
    gain = sign * (factor - hits.factor[end, section, load]) * own_speed
    blur = SLACK_ULPS * torch.finfo(gain.dtype).eps * search.size
    better = converged & (gain * (normal * direction).sum(0) >= -blur)  # along a face that it grazes, a line is long
    kept = end[better], section[better], load[better]
    fraction = fraction.clone()
    fraction[:, :, kept[0], kept[1], kept[2]] = found.fraction[..., better]
    normals = hits.normal.clone()
    normals[:, kept[0], kept[1], kept[2]] = normal[:, better]
    polished = replace(hits, factor=hits.factor.index_put(kept, factor[better]), normal=normals)
    return polished, fraction, (~open_ones).index_put((end, section, load), better)


def _within(touch: Touch, ends: Ends, index: Tensor, side: Tensor) -> Touch:
    """What was touched on stretches of the ends' pieces, with the pieces it came from, on its side or the other."""
    own = [getattr(ends, name)[side, :, index].T for name in ("begin", "span", "rough")]
    other = [getattr(ends, name)[1 - side, :, index].T for name in ("begin", "span", "rough")]
    held = (touch.fraction >= own[0]) & (touch.fraction <= own[0] + own[1])
    begin, span, rough = (torch.where(held, a, b) for a, b in zip(own, other, strict=True))
    return replace(touch, begin=begin, span=span, rough=rough)


class _Search:
    """Q rays, each in the set of one section, from a point inside it.

    Attributes:
        sections, section: all sections, and (Q) those of the rays.
        direction: (2, Q) unit vectors; of what is left behind, the reverse of the load's.
        size: (Q) of the numbers.
    """

    def __init__(self, sections: Sections, section: Tensor, direction: Tensor, size: Tensor, relative: bool):
        self.sections, self.section, self.direction, self.size, self.relative = (
            sections,
            section,
            direction,
            size,
            relative,
        )
        bending = sections.bending - sections.at_first_node(sections.bending) if relative else sections.bending
        self.bending = bending[:, section]
        resting = sections.resting_moment(relative=relative)
        self.resting = torch.zeros_like(size) if resting is None else resting[section]

    def run(self, fraction: Tensor) -> tuple[Ends, Tensor]:
        """Ends of the faces hit, and whether (Q) they converged, from those (2, M, Q) of polygons' faces."""
        sections, everyone = self.sections, torch.arange(len(self.section), device=self.section.device)
        pieces = fit_pieces(sections, self.section, relative=self.relative)
        sums = CurveSum(pieces, self.bending, sections.radii[:, self.section], (1.0, 1.0))
        ends = self._bracket(fraction, pieces)
        converged = self._close(ends, everyone, sums)
        index = (ends.rough.flatten(0, 1).any(0) & converged).nonzero().squeeze(-1)
        share = torch.full_like(self.size, WINDOW)
        for _ in range(REFITS if len(index) else 0):
            begin, width = ends.window(index, share[index])
            fit = refit_pieces(sections, self.section[index], begin, width, relative=self.relative)
            self._place(ends, index)
            before, normal = self.crossing(ends)
            before, near = before[index], replace(sums.of(index), pieces=fit)
            closed = self._open(ends, index, near, normal[:, index]) & self._close(ends, index, near, keep_pieces=True)
            moved = (self.crossing(ends)[0][index] - before).abs() > SETTLED * self.size[index]
            # Held by its window's edge, an end may have further to go; unless the way there is as good as level.
            held = ends.held(index, begin, width).flatten(0, 1).any(0) & moved
            converged[index] = closed & ~held
            share[index] = torch.where(held, share[index], share[index] * NARROW)
            index = index[share[index] >= LEAST]
            if not len(index):
                break
        self._place(ends, everyone)
        return ends, converged

    def crossing(self, ends: Ends) -> tuple[Tensor, Tensor]:
        """How far (Q) along the rays the chords between the ends lie, and the chords' outward normals (2, Q)."""
        aside, ahead = self._across(ends.x, ends.y), self._ahead(ends.x, ends.y)
        gap = aside[1] - aside[0]
        share = (-aside[0] / torch.where(gap == 0, torch.ones_like(gap), gap)).clamp(0, 1)
        chord_x, chord_y = ends.x[1] - ends.x[0], ends.y[1] - ends.y[0]
        length = torch.hypot(chord_x, chord_y)
        point = length == 0
        safe = torch.where(point, torch.ones_like(length), length)
        normal = torch.stack((chord_y, -chord_x)) / safe
        return torch.lerp(ahead[0], ahead[1], share), torch.where(point, self.direction, normal)

    def _bracket(self, fraction: Tensor, pieces: Pieces) -> Ends:
        """The polygons' faces' ends, the one to the right of the ray first, and the pieces that hold them."""
        x, y = self._wrench(self.section, fraction)
        swapped = self._across(x[0], y[0]) > self._across(x[1], y[1])
        fraction = torch.where(swapped, fraction.flip(0), fraction).clone()
        x, y = (torch.where(swapped, value.flip(0), value).clone() for value in (x, y))
        end = pieces.start + pieces.width
        holds = (pieces.width > 0) & (fraction.unsqueeze(1) >= pieces.start) & (fraction.unsqueeze(1) <= end)
        piece = holds.to(torch.uint8).argmax(1, keepdim=True)  # (2, 1, M, Q)
        begin, span, rough = (
            value.expand(2, *value.shape).gather(1, piece).squeeze(1)
            for value in (pieces.start, pieces.width, pieces.rough)
        )
        return Ends(x, y, fraction, begin, span, rough)

    def _close(self, ends: Ends, index: Tensor, sums: CurveSum, *, keep_pieces: bool = False) -> Tensor:
        """Bring the ends in `index` (q) to a face; whether (q) they are."""
        done = torch.zeros_like(index, dtype=torch.bool)
        left = torch.arange(len(index), device=index.device)
        slack = SLACK_ULPS * torch.finfo(ends.x.dtype).eps * self.size[index]
        for _ in range(ROUNDS):
            own = index[left]
            (ax, ay), (bx, by) = ends.corner(0, own), ends.corner(1, own)
            nx, ny = by - ay, ax - bx
            length = torch.hypot(nx, ny)
            apart = length > slack[left]
            # Ends that are one point are a corner of the set, or as near to it as numbers go.
            nx, ny = torch.where(apart, nx, self.direction[0, own]), torch.where(apart, ny, self.direction[1, own])
            length = torch.hypot(nx, ny)
            nx, ny = nx / length, ny / length
            touch = self._lifted(sums.touch(nx, ny), own)
            beyond = nx * (touch.x - ax) + ny * (touch.y - ay)
            finished = (beyond <= slack[left]) | ~apart
            done[left] = finished
            going = (~finished).nonzero().squeeze(-1)
            if not len(going):
                break
            touch, own = touch.of(going), own[going]
            side = (self._across(touch.x, touch.y, own) >= 0).long()
            if keep_pieces:
                touch = _within(touch, ends, own, side)
            ends.put(own, side, touch)
            left, sums = left[going], sums.of(going)
        return done

    def _open(self, ends: Ends, index: Tensor, sums: CurveSum, normal: Tensor) -> Tensor:
        """Put the ends in `index` (q) where sums nearby are touched either side of the rays; whether (q) they are.

        Ends of another fit may lie a little outside of this one, and then bracket nothing.
        """
        known = torch.zeros(2, len(index), dtype=torch.bool, device=index.device)
        for side, turn in product((0, 1), TURNS):
            left = (~known[side]).nonzero().squeeze(-1)
            if not len(left):
                continue
            own, angle = index[left], (2 * side - 1) * turn
            nx, ny = normal[:, left]
            turned = nx * cos(angle) - ny * sin(angle), ny * cos(angle) + nx * sin(angle)
            touch = self._lifted(sums.of(left).touch(*turned), own)
            found = (self._across(touch.x, touch.y, own) >= 0) == bool(side)
            put = found.nonzero().squeeze(-1)
            sides = torch.full_like(own[put], side)
            ends.put(own[put], sides, _within(touch.of(put), ends, own[put], sides))
            known[side, left] = found
        return known.all(0)

    def _place(self, ends: Ends, index: Tensor) -> None:
        """Put the ends in `index` where the forces themselves are, not the cubics near them."""
        ends.x[:, index], ends.y[:, index] = self._wrench(self.section[index], ends.fraction[..., index], index)

    def _wrench(self, section: Tensor, fraction: Tensor, index: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Reactions (2, q) at fractions (2, M, q)."""
        sections = self.sections
        pressure = fraction * sections.limit[:, section]
        force = actuator_force(sections.actuators, sections.strain[:, section], pressure, dim=-2)
        if self.relative:
            first = sections.at_first_node(sections.strain)[:, section]
            force = force - actuator_force(sections.actuators, first, pressure, dim=-2)
        bending, resting = (
            (self.bending, self.resting) if index is None else (self.bending[:, index], self.resting[index])
        )
        return force.sum(1), (bending * fraction - sections.radii[:, section] * force).sum(1) + resting

    def _lifted(self, touch: Touch, index: Tensor) -> Touch:
        """What was touched of the sums in `index`, with the moment that they bear at no pressure."""
        return replace(touch, y=touch.y + self.resting[index])

    def _across(self, x: Tensor, y: Tensor, index: Tensor | slice = slice(None)) -> Tensor:
        return self.direction[0, index] * y - self.direction[1, index] * x

    def _ahead(self, x: Tensor, y: Tensor) -> Tensor:
        return self.direction[0] * x + self.direction[1] * y
